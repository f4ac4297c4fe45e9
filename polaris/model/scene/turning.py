"""Corridors that turn with a tumbling target, as limits on the state."""

from dataclasses import dataclass, replace
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from ..checks import halfspaces
from ..craft import Craft
from ..errors import ScenarioError
from ..keys import Key, Matrix, NonNegative, Number, Real, Vector
from ..system import Array, LinearSystem
from ..tolerances import ROUNDING
from .keep_in import FAR
from .obstacle import NAME
from .state_limits import BEGINS, ENDS, StateLimit
from .timed_polytope import TimedPolytope

WIDEST = 1.0  # angle [rad] by which a side may turn about its middle direction in a step
CORNERS = 3  # rows that stand for a side in a step


@dataclass(frozen=True, eq=False)
class TurningKeepIn(StateLimit):
    """A corridor or polyhedral cone to stay inside that turns about the origin at a constant rate.

    In each step one side is kept, in all directions that it takes, errors included.

    Parameters
    ----------
    name : str
        Name.
    H : array_like, shape (F, d), d = 2 or 3
        Outward facet normals at t = 0.
    b : array_like, shape (F,) [m]
        Offsets.
    rate : float [rad/s]
        Rate about the axis, in the scenario's frame.
    ends : float [s]
        End, at most the horizon.
    axis : array_like, shape (3,)
        Axis in space; none in the plane.
    rate_error : float [rad/s]
        Rate error.
    angle_error_rad : float [rad]
        Angle error at t = 0.
    """

    name: Annotated[str, NAME]
    H: Annotated[ArrayLike, Key("normals", "-", Matrix, "axis")]
    b: Annotated[ArrayLike, Key("offsets_m", "m", Vector)]
    rate: Annotated[float, Key("rate_rad_s", "rad/s", Number)]
    ends: Annotated[float, ENDS]
    axis: Annotated[Any, Key("axis", "-", Vector, "axis")] = None
    rate_error: Annotated[float, Key("rate_error_rad_s", "rad/s", NonNegative)] = 0.0
    angle_error_rad: Annotated[float, Key("angle_error_deg", "deg", Annotated[Real, Field(ge=0, le=45)])] = (
        0.0
    )
    begins: Annotated[float, BEGINS] = 0.0

    def __post_init__(self) -> None:
        H, b = halfspaces(self.path, self.H, self.b)
        object.__setattr__(self, "H", H)
        object.__setattr__(self, "b", b)
        super().__post_init__()
        if H.shape[1] not in (2, 3) or (H.shape[1] == 3) == (self.axis is None):
            raise ScenarioError(
                f"{self.path}.axis", self.axis, "must be given in space, and left out in the plane"
            )
        if self.axis is not None and not np.any(self.axis):
            raise ScenarioError(f"{self.path}.axis", self.axis, "must not be zero")

    def _inflated(self, radius: float) -> Self:
        return replace(self, b=np.asarray(self.b) - radius)

    def _rotate(self, angles: Array) -> tuple[Array, Array]:
        return rotate(np.asarray(self.H), self.axis, angles)

    def polytopes(self, system: LinearSystem) -> list[tuple[Array, Array]]:
        """Return the outside of every side at t = 0."""
        rows, b = -np.asarray(self.H) @ system.position, -np.asarray(self.b)
        return [(rows[f : f + 1], b[f : f + 1]) for f in range(len(b))]

    def timed_polytopes(self, system: LinearSystem, delta: float, cells: int) -> tuple[TimedPolytope, ...]:
        """One timed polytope for each row of a side, with a facet for each step in which it holds.

        The directions of a side lie in the triangle of the first one, the last one and the corner of the
        tangents there (docs/theory.md, Lemma 16).
        """
        self._check_cells(system, delta, cells, np.asarray(self.H).shape[1])
        steps = np.flatnonzero(self.steps(delta, cells))
        clock, offset = 0.0, np.zeros(system.n)
        if isinstance(system, Craft):
            clock, offset = system.timing.clock, system.state_offset
        late: Array = np.asarray((steps + 1) * delta + clock, dtype=float)
        half_angle = abs(self.rate) * (delta / 2 + clock) + self.angle_error_rad + self.rate_error * late
        if np.any(half_angle > WIDEST):
            rule = f"must turn by at most {WIDEST:g} rad about the middle of a step, errors included: here"
            raise ScenarioError(
                f"{self.path}.rate", self.rate, f"{rule} {half_angle.max():.3g}; take shorter steps"
            )
        middle: Array = np.asarray(self.rate * (steps + 0.5) * delta, dtype=float)
        along, across = self._rotate(middle)
        sides = [along + self._rotate(middle + angle)[1] for angle in (-half_angle, half_angle)]
        corners = np.stack([*sides, along + across / np.cos(half_angle)[:, None, None]])  # (3, k, F, d)
        timed, far, each = [], FAR**3, np.arange(len(steps))
        for f, b in enumerate(np.asarray(self.b)):
            for i in range(CORNERS):
                rows = -corners[i, :, f] @ system.position
                offsets = np.full((cells, 2, max(len(steps), 1)), -far)
                offsets[steps] = far
                bound = -b + np.abs(rows) @ offset + ROUNDING * abs(b)
                offsets[steps, :, each] = bound[:, None]
                rows = rows if len(steps) else np.ones((1, system.n))
                name = f"{self.name}[{CORNERS * f + i}]"
                static = self.ends <= cells * delta
                timed.append(TimedPolytope(name, rows, offsets, True, static, of_state=True))
        return tuple(timed)

    def signed_distance(
        self, t: ArrayLike, p: ArrayLike, system: LinearSystem | None = None, state: ArrayLike | None = None
    ) -> Array:
        """Return the distance [m] from states p (..., n) at times t to leaving it, at its worst errors.

        Errors of the angle are none or as large as they may be; inf while it does not hold.
        """
        nominal = super().signed_distance(t, p, system, state)
        assert system is not None
        t, place = np.asarray(t, dtype=float), np.asarray(p, dtype=float) @ system.position.T
        error, distance = self.angle_error_rad + self.rate_error * t, np.full(nominal.shape, np.inf)
        for share in (-1.0, 0.0, 1.0):
            along, across = self._rotate(self.rate * t + share * error)
            slack = self.b - np.einsum("...fd,...d->...f", along + across, place)
            distance = np.minimum(distance, slack.min(axis=-1))
        return np.asarray(np.where(np.isinf(nominal), np.inf, distance))


def rotate(H: Array, axis: ArrayLike | None, angles: Array) -> tuple[Array, Array]:
    """Return parts of normals H (F, d) along the axis, and across it turned by angles [rad], (..., F, d)."""
    s, c = np.sin(angles)[..., None, None], np.cos(angles)[..., None, None]
    if axis is None:
        return 0 * H, c * H + s * H[:, ::-1] * [-1.0, 1.0]
    unit = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    along = (H @ unit)[:, None] * unit
    return along, c * (H - along) + s * np.cross(unit, H)
