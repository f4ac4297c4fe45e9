"""Limits on the whole state: sets of positions and velocities to stay inside or out of, and speed limits."""

from abc import abstractmethod
from copy import copy
from dataclasses import dataclass
from typing import Annotated, Any, NoReturn, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from ..checks import vector
from ..craft import Craft
from ..errors import ScenarioError, quoted
from ..keys import Index, Key, Matrix, NonNegative, Positive, PositivePerAxis, Vector, Whole
from ..system import Array, LinearSystem, as_finite, speeds
from ..tolerances import ROUNDING
from .keep_in import FAR, during
from .obstacle import FACETS, NAME, Obstacle, directions, is_holding
from .shapes import BallShape
from .timed_polytope import TimedPolytope

RATE = 1e-2  # rate [1/s] by which velocities are divided to read as lengths, as in goals

BEGINS, ENDS = Key("from_s", "s", NonNegative), Key("until_s", "s", Positive)
ROWS = Key("rows", "bound/state", Matrix, "state")
BOUNDS = Key("bounds", "of rows x", Vector)


def state_lengths(system: LinearSystem) -> Array:
    """Return the length [m] that a unit of each state counts as, (n,): ``1 / RATE`` for 1 m/s."""
    speed = speeds(system.A, system.position)
    return np.where(speed > 0, speed / RATE, 1.0)


def covering_cosine(d: int, count: int) -> float:
    """Return c: velocities v with ``e v <= c`` for all e of `directions` have ``|v| <= 1``."""
    if d == 2:
        return float(np.cos(np.pi / count))
    corner = {6: (1, 1), 14: (3**0.5 - 1, 0), 18: (0.5**0.5, 0), 26: (2**0.5 - 1, 3**0.5 - 2**0.5)}
    return 1.0 if d == 1 else float(1 / np.linalg.norm([1.0, *corner[count]]))


class StateLimit(Obstacle):
    """Base of sets of states that are unsafe from `begins` until `ends` [s]; in proofs for whole steps.

    Distances are lengths [m], in which velocities count by `state_lengths`. The point that is navigated is
    limited, whatever the chaser's size.

    Parameters
    ----------
    begins : float [s]
        Start.
    ends : float [s], optional
        End, at most the horizon; by default none.
    """

    begins: float
    ends: float | None
    inside = True  # what is unsafe is the outside of a set

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.ends is not None and self.ends <= self.begins:
            raise ScenarioError(f"{self.path}.ends", self.ends, f"must be after from_s = {self.begins:g}")

    @property
    def span(self) -> tuple[float, float]:
        """From `begins` until `ends`."""
        return self.begins, np.inf if self.ends is None else self.ends

    @property
    def path(self) -> str:
        """Beginning of error messages."""
        return f"{'keep_in' if self.inside else 'obstacles'}[{quoted(self.name)}]"

    @abstractmethod
    def polytopes(self, system: LinearSystem) -> list[tuple[Array, Array]]:
        """Return polytopes of states ``rows x <= bounds``, (F, n) and (F,), whose union is unsafe."""

    def slack(self, x: Array, system: LinearSystem) -> Array:
        """Return the distance [m] along rows from states (..., n) to the unsafe set, negative inside."""
        parts = [self._measured(*part, system) for part in self.polytopes(system)]
        return np.asarray(np.min([np.max(x @ rows.T - b, axis=-1) for rows, b in parts], axis=0))

    def _measured(self, rows: Array, bounds: Array, system: LinearSystem) -> tuple[Array, Array]:
        """Scale rows so that they measure lengths."""
        length = np.linalg.norm(rows / state_lengths(system), axis=1)
        return rows / length[:, None], bounds / length

    def timed_polytopes(self, system: LinearSystem, delta: float, cells: int) -> tuple[TimedPolytope, ...]:
        """One timed polytope for each polytope of states, far away in steps in which it does not hold.

        Each grows by how far true states may be from the model's within a period.
        """
        self._check_cells(system, delta, cells, system.d)
        holds = self.steps(delta, cells)
        static, timed = max(self.begins, self.ends or 0.0) <= cells * delta, []
        state_offset = system.state_offset if isinstance(system, Craft) else np.zeros(system.n)
        for i, part in enumerate(self.polytopes(system)):
            rows, b = self._measured(*part, system)
            active = b + np.abs(rows) @ state_offset + ROUNDING * np.abs(b)
            inactive = -(FAR**2) * (FAR + np.abs(b))
            offsets = np.where(holds[:, None, None], active, inactive) + np.zeros((cells, 2, 1))
            name = f"{self.name}[{i}]" if self.inside else self.name
            timed.append(TimedPolytope(name, rows, offsets, self.inside, static, of_state=True))
        return tuple(timed)

    def steps(self, delta: float, cells: int) -> NDArray[np.bool_]:
        """Return True for the steps, of `delta` [s], in which it holds at any time, (cells,)."""
        return during(*self.span, np.arange(cells, dtype=float) * delta, delta)

    def signed_distance(
        self, t: ArrayLike, p: ArrayLike, system: LinearSystem | None = None, state: ArrayLike | None = None
    ) -> Array:
        """Return the slack [m] of states p (..., n) at times t; inf while it does not hold."""
        if system is None or np.shape(p)[-1] != system.n:
            raise ScenarioError("p", np.shape(p), f"must be states of a known system for {self.path}")
        slack = self.slack(np.asarray(p, dtype=float), system)
        return np.asarray(np.where(is_holding(self.span, t), slack, np.inf))

    def blurred(self, clock: float, margin: float) -> Self:
        """Return the limit: it counts by the schedule's clock; its polytopes grow by `margin`."""
        return self

    def _inflated(self, radius: float) -> Self:
        return copy(self)  # it limits the point that is navigated

    def _no_place(self) -> NoReturn:
        raise ScenarioError(self.path, type(self).__name__, "is a set of states: it has no shape in position")

    @property
    def shape(self) -> BallShape:
        """None: it is a set of states."""
        self._no_place()

    drawn = shape

    def motion(
        self, t: ArrayLike, system: LinearSystem | None = None, state: ArrayLike | None = None
    ) -> tuple[Array, Array]:
        """Refuse: it is nowhere in position."""
        self._no_place()


@dataclass(frozen=True, eq=False)
class KeepInStates(StateLimit):
    """A convex set of positions and velocities to stay inside: ``rows x <= bounds``.

    Parameters
    ----------
    name : str
        Name.
    rows : array_like, shape (F, n)
        One row per limit.
    bounds : array_like, shape (F,)
        One bound per row.
    """

    name: Annotated[str, NAME]
    rows: Annotated[ArrayLike, ROWS]
    bounds: Annotated[ArrayLike, BOUNDS]
    begins: Annotated[float, BEGINS] = 0.0
    ends: Annotated[float | None, ENDS] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        rows = as_finite(f"{self.path}.rows", self.rows, 2)
        if not np.all(np.abs(rows).max(axis=1, initial=0.0) > 0):
            raise ScenarioError(f"{self.path}.rows", rows.tolist(), "must not have a row of zeros")
        vector(f"{self.path}.bounds", self.bounds, len(rows), "rows has")

    @property
    def _halfspaces(self) -> tuple[Array, Array]:
        return np.asarray(self.rows, dtype=float), np.asarray(self.bounds, dtype=float)

    def polytopes(self, system: LinearSystem) -> list[tuple[Array, Array]]:
        """Return the outside of every row."""
        H, b = self._halfspaces
        return [(-H[f : f + 1], -b[f : f + 1]) for f in range(len(b))]


@dataclass(frozen=True, eq=False)
class StateObstacle(KeepInStates):
    """A convex set of positions and velocities to stay out of: ``rows x <= bounds``."""

    inside = False

    def polytopes(self, system: LinearSystem) -> list[tuple[Array, Array]]:
        """Return the set."""
        return [self._halfspaces]


@dataclass(frozen=True, eq=False)
class SpeedLimit(StateLimit):
    """A speed limit, of the velocity's length or of each axis, that may grow with the distance.

    Parameters
    ----------
    name : str
        Name.
    top : float or array_like, shape (d,) [m/s]
        Largest speed, or one limit per axis.
    per_distance : float [1/s]
        Increase of the limit per metre of distance from the origin.
    facets : int
        Directions that bound the length, as of a ball: in space the enforced limit is 58, 81, 82 or 89 % of
        the given one (6, 14, 18, 26).
    towards : array_like, shape (k, d)
        Directions d that measure the distance as ``d r / |d|``, one chosen per step; by default those of the
        velocities.
    """

    name: Annotated[str, NAME]
    top: Annotated[Any, Key("max_m_s", "m/s", PositivePerAxis)]
    per_distance: Annotated[float, Key("per_distance_1_s", "1/s", NonNegative)] = 0.0
    facets: Annotated[int | None, FACETS] = None
    towards: Annotated[Any, Key("towards", "-", Matrix, "axis")] = None
    begins: Annotated[float, BEGINS] = 0.0
    ends: Annotated[float | None, ENDS] = None

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.towards is not None and not np.all(np.linalg.norm(self.towards, axis=1) > 0):
            raise ScenarioError(f"{self.path}.towards", self.towards, "must not have a row of zeros")

    def polytopes(self, system: LinearSystem) -> list[tuple[Array, Array]]:
        """Return, of each direction of the velocity, where it is too fast by every direction of distance."""
        d, C, V = system.d, system.position, velocity_rows(self.path, system)
        ways = directions(d, self.facets, f"{self.path}.facets")
        per_axis = np.ndim(self.top) > 0
        E = np.vstack([np.eye(d), -np.eye(d)]) if per_axis else ways
        share = 1.0 if per_axis else covering_cosine(d, len(ways))
        tops = share * np.broadcast_to(np.tile(self.top, 2) if per_axis else self.top, len(E))
        if not self.per_distance:
            return [(-(e @ V)[None], -top[None]) for e, top in zip(E, tops, strict=True)]
        aims = ways if self.towards is None else np.asarray(self.towards, dtype=float)
        aims = aims / np.linalg.norm(aims, axis=1, keepdims=True)
        far = share * self.per_distance * aims @ C
        return [(far - e @ V, np.full(len(far), -top)) for e, top in zip(E, tops, strict=True)]

    def slack(self, x: Array, system: LinearSystem) -> Array:
        """Return the distance [m] of speeds of states (..., n) from the true limit, negative beyond it."""
        v = x @ velocity_rows(self.path, system).T
        speed = np.abs(v) if np.ndim(self.top) else np.linalg.norm(v, axis=-1, keepdims=True)
        more = self.per_distance * np.linalg.norm(x @ system.position.T, axis=-1, keepdims=True)
        return np.asarray(np.min(np.asarray(self.top) + more - speed, axis=-1) / RATE)


@dataclass(frozen=True, eq=False)
class SpeedPolygon(StateLimit):
    """A regular polygon of velocities in a plane to stay inside.

    Parameters
    ----------
    name : str
        Name.
    top : float [m/s]
        Distance of the sides from zero; the first is normal to the first axis.
    sides : int
        Sides.
    axes : array_like, shape (2,)
        Velocity axes of the plane, counted from 0.
    """

    name: Annotated[str, NAME]
    top: Annotated[float, Key("max_m_s", "m/s", Positive)]
    sides: Annotated[int, Key("sides", "-", Annotated[Whole, Field(ge=3, le=64)])] = 8
    axes: Annotated[
        Any, Key("axes", "-", Annotated[tuple[Index, ...], Field(min_length=2, max_length=2)])
    ] = (0, 1)
    begins: Annotated[float, BEGINS] = 0.0
    ends: Annotated[float | None, ENDS] = None

    def polytopes(self, system: LinearSystem) -> list[tuple[Array, Array]]:
        """Return the outside of every side."""
        first, second = (int(axis) for axis in self.axes)
        if first == second or max(first, second) >= system.d:
            rule = f"must be two of the {system.d} axes of the velocity, counted from 0"
            raise ScenarioError(f"{self.path}.axes", list(self.axes), rule)
        V, bound = velocity_rows(self.path, system), np.array([-self.top])
        ways = directions(2, self.sides)
        return [(-(x * V[first] + y * V[second])[None], bound) for x, y in ways]


def velocity_rows(path: str, system: LinearSystem) -> Array:
    """Return rows of the state that give the velocity, (d, n); refused where inputs act on the position."""
    if np.any(system.position @ system.B) or np.any(system.position @ system.D):
        rule = "needs a velocity that is part of the state: inputs and disturbances must not act on C x"
        raise ScenarioError(path, "a limit of speed", rule)
    return system.velocity
