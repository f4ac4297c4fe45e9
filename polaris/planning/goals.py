"""Goals: where a plan must end. To the planner each is a few linear conditions on the last state."""

from abc import ABC, abstractmethod
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated, Any, Self

import numpy as np
from pydantic import Field

from ..model import keys as f
from ..model.checks import exact, positive, whole
from ..model.errors import ScenarioError
from ..model.system import Array, LinearSystem, speeds
from ..model.tolerances import GOAL


@dataclass(frozen=True, eq=False)
class GoalConditions:
    """Linear conditions on the last state x: ``E x = e``, ``G x <= g``, and one of each group.

    Rows are scaled so that a residual is a length [m] (velocities are divided by a rate).
    """

    E: Array  # equalities, (n_e, n) and (n_e,)
    e: Array
    G: Array  # inequalities, (n_g, n) and (n_g,)
    g: Array
    one_of: tuple[tuple[Array, Array], ...] = ()  # groups (J, n), (J,): one row of each has ``N x >= c``
    scale: float = 1.0  # length [m] to which residuals are compared

    @property
    def inequalities(self) -> bool:
        """True if some conditions may be met with slack."""
        return len(self.g) > 0 or len(self.one_of) > 0

    def residual(self, x: Array) -> float:
        """Largest violation at x [m]; 0 if all conditions hold."""
        worst = [
            np.max(np.abs(self.E @ x - self.e), initial=0.0),
            np.max(self.G @ x - self.g, initial=0.0),
            *(np.min(c - N @ x) for N, c in self.one_of),
        ]
        return float(max(worst))


class Goal(ABC):
    """Base of all goals. A new goal states `n`, `conditions` and `describe`; the rest follows."""

    @property
    @abstractmethod
    def n(self) -> int:
        """Number of states the goal speaks about."""

    @property
    @abstractmethod
    def conditions(self) -> GoalConditions:
        """The linear conditions the planner uses; they imply the goal."""

    @abstractmethod
    def describe(self) -> str:
        """One line for messages and reports."""

    def for_system(self, system: LinearSystem) -> Self:
        """Return the goal for a system, which says which states are velocities."""
        return self

    def residual(self, x: Array) -> tuple[float, str]:
        """Largest violation of the goal itself [m] and its name, at a state x of shape (n,)."""
        return self.conditions.residual(x), self.describe()

    def violation(self, x: Array) -> tuple[float, str]:
        """Violation relative to the goal's scale, 0.0 if met within `tolerances.GOAL`, and its name."""
        worst, name = self.residual(np.asarray(x, dtype=float))
        relative = worst / self.conditions.scale
        return (0.0, "") if relative <= GOAL else (relative, name)


@dataclass(frozen=True, eq=False)
class Inset(Goal):
    """A goal whose inequalities a plan must meet with slack; equalities stay as they are."""

    goal: Goal
    clearance: tuple[Array, ...]  # [m], of the rows of G, then of those of each group

    @property
    def n(self) -> int:
        """Number of states."""
        return self.goal.n

    @cached_property
    def conditions(self) -> GoalConditions:
        """The conditions of the goal, inequalities tightened."""
        base = self.goal.conditions
        first, *others = self.clearance
        one_of = tuple((N, c + inset) for (N, c), inset in zip(base.one_of, others, strict=True))
        return replace(base, g=base.g - first, one_of=one_of)

    def describe(self) -> str:
        """One line for messages."""
        return self.goal.describe()


class _StateGoal(Goal):
    """Base of goals that bound every state: `center`, `half_widths` (n,), and a `rate` for residuals."""

    center: Any
    half_widths: Any
    rate: float
    _word = "box about"
    _speeds: Array = np.zeros(1)  # of a unit of each state [m/s]; 0 until `of` a system

    def __post_init__(self) -> None:
        f.check_fields(self, "goal")
        positive("goal.rate", self.rate, "1/s")

    def for_system(self, system: LinearSystem) -> Self:
        """Return the same goal, its velocities those of a system."""
        goal = copy(self)
        goal.__dict__.pop("conditions", None)  # of other velocities
        object.__setattr__(goal, "_speeds", speeds(system.A, system.position))
        return goal

    @property
    def n(self) -> int:
        """Number of states."""
        return len(self.center)

    @cached_property
    def conditions(self) -> GoalConditions:
        """Two inequalities per bounded state, an equality where the half-width is 0."""
        center, widths, speeds = self.center, self.half_widths, self._speeds
        weight = np.where(speeds > 0, speeds * (1 / self.rate), np.ones(self.n))
        W, middle = np.diag(weight), weight * center
        fixed, boxed = widths == 0, np.isfinite(widths) & (widths > 0)
        rows, reach = W[boxed], weight[boxed] * widths[boxed]
        sides = np.r_[middle[boxed] + reach, reach - middle[boxed]]
        scale = max(1.0, float(np.max(np.abs(center))))
        return GoalConditions(W[fixed], middle[fixed], np.vstack([rows, -rows]), sides, (), scale)

    def describe(self) -> str:
        """One line for messages."""
        return f"{self._word} (" + ", ".join(f"{s:g}" for s in self.center) + ")"


@dataclass(frozen=True, eq=False)
class Box(_StateGoal):
    """End anywhere in a box of states.

    Parameters
    ----------
    center : array_like, shape (n,) [m, m/s]
        Centre.
    half_widths : array_like, shape (n,) [m, m/s]
        Half-widths; inf for no condition.
    rate : float
        Rate [1/s] by which velocities are divided to read as lengths. It only weighs residuals.
    """

    center: Annotated[Any, f.Key("center", f.STATES, f.Vector, "state")]
    half_widths: Annotated[Any, f.Key("half_widths", f.STATES, f.OpenWidthVector, "state")]
    rate: float = 1e-2


@dataclass(frozen=True, eq=False)
class StationaryPoint(_StateGoal):
    """End at rest, in a state that needs no input (A x = 0).

    Parameters
    ----------
    state : array_like, shape (n,) [m, m/s]
        State at rest; in Hill's frame on the along-track axis.
    rate : float
        Rate [1/s] by which velocities are divided to read as lengths. It only weighs residuals.
    """

    state: Annotated[Any, f.Key("state", f.STATES, f.Vector, "state")]
    rate: float = 1e-2
    _word = "stationary point"

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "center", self.state)
        object.__setattr__(self, "half_widths", np.zeros(self.n))


class HillGoal(Goal):
    """A goal in Hill's frame; subclasses have a `mean_motion` and the number of `sides` of their polygons."""

    mean_motion: float
    sides: int
    n = 6

    def __post_init__(self) -> None:
        f.check_fields(self, "goal")
        positive("goal.mean_motion", self.mean_motion, "rad/s")
        whole("goal.sides", self.sides, 4)

    @property
    def _rows(self) -> tuple[Array, Array]:
        """Unit rows of position and of velocity over the mean motion [m], shape (3, 6)."""
        eye = np.eye(6)
        return eye[:3], eye[3:] / self.mean_motion


def ellipse_polygon(semi_minor: float, sides: int, circumscribed: bool) -> tuple[Array, Array]:
    """Polygon of the ellipse of semi-axes (b, 2 b), ``normals p <= offsets``, shapes (sides, 2), (sides,).

    Inscribed: within the ellipse. Circumscribed: around it. Works on the circle of radius b (r_y halved),
    where the polygon is regular; every unit normal in (r_x, r_y) points outwards. The printed eq. 20 takes
    ``alpha_y = q_x,j - q_x,j+1``, whose sign is wrong.
    """
    angle = 2 * np.pi * (np.arange(sides) + 0.5) / sides
    normals = np.stack([np.cos(angle), np.sin(angle) / 2], axis=1)
    radius = semi_minor if circumscribed else semi_minor * np.cos(np.pi / sides)
    length = np.linalg.norm(normals, axis=1)
    return normals / length[:, None], radius / length


@dataclass(frozen=True)
class EllipticalNMT(HillGoal):
    """End on a closed ellipse about the target that needs no thrust (eqs. 20-22). Hill's frame only.

    Parameters
    ----------
    mean_motion : float
        eta [rad/s].
    inner_semi_minor : float [m]
        Radial semi-axis of the inner ellipse, or 0.
    outer_semi_minor : float [m]
        Radial semi-axis of the outer ellipse.
    sides : int
        Sides of the polygons for the ellipses.
    cross_track_max : float [m], optional
        Bound on |r_z| and |v_z|/eta at the end; by default both are 0.
    """

    mean_motion: float
    inner_semi_minor: Annotated[float, f.Key("inner_semi_minor_m", "m", f.NonNegative)]
    outer_semi_minor: Annotated[float, f.Key("outer_semi_minor_m", "m", f.Positive)]
    sides: Annotated[int, f.Key("sides", "-", Annotated[f.Whole, Field(ge=4, le=64)])] = 16
    cross_track_max: Annotated[float | None, f.Key("cross_track_max_m", "m", f.Positive)] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        apothem = self.outer_semi_minor * np.cos(np.pi / self.sides)
        if self.inner_semi_minor >= apothem:
            reason = f"the {self.sides}-sided outer polygon reaches no further"
            rule = f"must be below {exact(apothem)} m ({reason})"
            raise ScenarioError("goal.inner_semi_minor", self.inner_semi_minor, rule)

    @cached_property
    def conditions(self) -> GoalConditions:
        """Two equalities, the outer polygon (inscribed), and one side of the inner one (circumscribed)."""
        r, v = self._rows
        E, G, g = [v[1] + 2 * r[0], v[0] - r[1] / 2], list[Array](), list[float]()
        if self.cross_track_max is None:
            E += [r[2], v[2]]
        else:
            G, g = [r[2], -r[2], v[2], -v[2]], [self.cross_track_max] * 4
        outer, reach = ellipse_polygon(self.outer_semi_minor, self.sides, circumscribed=False)
        inner, inner_b = ellipse_polygon(self.inner_semi_minor, self.sides, circumscribed=True)
        one_of = ((inner @ r[:2], inner_b),) if self.inner_semi_minor > 0 else ()
        rows, sides = np.array([*G, *(outer @ r[:2])]), np.array([*g, *reach])
        return GoalConditions(np.array(E), np.zeros(len(E)), rows, sides, one_of, self.outer_semi_minor)

    def semi_minor(self, x: Array) -> float:
        """Radial semi-axis [m] of the ellipse through the position of x."""
        return float(np.hypot(x[0], x[1] / 2))

    def residual(self, x: Array) -> tuple[float, str]:
        """Measured against the ellipses themselves, not their polygons."""
        eta, b = self.mean_motion, self.semi_minor(x)
        inner, outer, c = self.inner_semi_minor, self.outer_semi_minor, self.cross_track_max or 0.0
        terms = [
            (abs(x[4] / eta + 2 * x[0]), "v_y = -2 eta r_x"),
            (abs(x[3] / eta - x[1] / 2), "v_x = eta r_y / 2"),
            (b - outer, f"inside the outer ellipse (semi-minor axis {outer:g} m)"),
            (inner - b, f"outside the inner ellipse (semi-minor axis {inner:g} m)"),
            (abs(x[2]) - c, f"cross-track |r_z| <= {c:g} m"),
            (abs(x[5]) / eta - c, f"cross-track |v_z| <= eta {c:g} m"),
        ]
        worst, name = max(terms, key=lambda term: term[0])
        return max(float(worst), 0.0), name

    def describe(self) -> str:
        """One line for messages."""
        return f"elliptical NMT with semi-minor axis {self.inner_semi_minor:g} to {self.outer_semi_minor:g} m"


@dataclass(frozen=True)
class LinearNMT(HillGoal):
    """End on a cross-track oscillation through a point of the along-track axis. Hill's frame only.

    Parameters
    ----------
    mean_motion : float
        eta [rad/s].
    amplitude_max : float [m]
        Largest amplitude.
    along_track : float [m]
        Along-track position.
    sides : int
        Sides of the polygon inscribed in the amplitude circle.
    """

    mean_motion: float
    amplitude_max: Annotated[float, f.Key("amplitude_max_m", "m", f.Positive)]
    along_track: Annotated[float, f.Key("along_track_m", "m", f.Number)] = 0.0
    sides: int = 16

    @cached_property
    def conditions(self) -> GoalConditions:
        """Four equalities and a polygon in ``(r_z, v_z / eta)``."""
        r, v = self._rows
        angle = 2 * np.pi * (np.arange(self.sides) + 0.5) / self.sides
        G = np.cos(angle)[:, None] * r[2] + np.sin(angle)[:, None] * v[2]
        g = np.full(self.sides, self.amplitude_max * np.cos(np.pi / self.sides))
        E, e = np.array([r[0], r[1], v[0], v[1]]), np.array([0.0, self.along_track, 0.0, 0.0])
        return GoalConditions(E, e, G, g, (), max(self.amplitude_max, abs(self.along_track), 1.0))

    def describe(self) -> str:
        """One line for messages."""
        return f"linear NMT at along-track {self.along_track:g} m, amplitude up to {self.amplitude_max:g} m"
