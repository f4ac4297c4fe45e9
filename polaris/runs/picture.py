"""What figures are drawn from: plain data, taken from results or from the files of a run folder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from reach.sets.zonotope import Zonotope

from ..model.obstacles import Obstacle
from ..planning.reference import Reference
from ..model.system import Array, LinearSystem

if TYPE_CHECKING:
    from ..simulation.baselines import Flights
    from ..synthesis.get_safety import Safety
    from ..synthesis.schedule import Schedule

SLICES = 8
"""Recoverable sets shown along the path."""


@dataclass(frozen=True, eq=False)
class TubePicture:
    """Reachable set of the position, absolute: see `polaris.synthesis.controllers.Flight`.

    Attributes
    ----------
    centre : ndarray, shape (K, q+1, d)
        [m]
    generators : ndarray, shape (K, q+1, d, g)
    bow : ndarray, shape (K, q, d)
    """

    centre: Array
    generators: Array
    bow: Array


@dataclass(frozen=True, eq=False)
class SlicePicture:
    """Recoverable errors of position, at rest relative to the reference, at some instants.

    Attributes
    ----------
    centre : ndarray, shape (S, 2)
        Reference position [m] in the plane of the figures.
    outline : ndarray, shape (S, M, 2)
        Recoverable errors [m] in the same plane.
    """

    centre: Array
    outline: Array


@dataclass(frozen=True, eq=False)
class Approach:
    """Where the safe path is closest to one unsafe set: time [s], distance [m] and position (d,) [m]."""

    time: float
    distance: float
    place: Array


@dataclass(frozen=True, eq=False)
class Picture:
    """One synthesis, to be drawn.

    Attributes
    ----------
    title : str
    system : LinearSystem
    obstacles : tuple of Obstacle
    goal : Goal
    initial_set : Zonotope
    reference : Reference
        With its coasting tail.
    planned : int
        Number K of steps before the tail.
    controllers : tuple of str
        Names, by mode.
    modes : ndarray of int, shape (K,)
        Empty if there is no schedule yet.
    margins : ndarray, shape (K,)
        Share of room left; -inf where there is none.
    limits : tuple of str, length K
        What limits each step.
    flights : mapping
        ``safety``, ``experimental`` and ``polaris``, as far as they were flown.
    """

    title: str
    system: LinearSystem
    obstacles: tuple[Obstacle, ...]
    goal: Any
    initial_set: Zonotope
    reference: Reference
    planned: int
    controllers: tuple[str, ...] = ("safety",)
    modes: NDArray[np.int_] = field(default_factory=lambda: np.zeros(0, dtype=int))
    margins: Array = field(default_factory=lambda: np.zeros(0))
    limits: tuple[str, ...] = ()
    flights: Mapping[str, Flights] = field(default_factory=dict)
    tube: TubePicture | None = None
    slices: SlicePicture | None = None

    @property
    def frame(self) -> Frame:
        """Coordinates shown."""
        return Frame.of(self.system)

    @property
    def duration(self) -> float:
        """The horizon T [s]."""
        return self.planned * self.reference.delta

    def path(self, parts: int = 8) -> tuple[Array, Array]:
        """Positions [m] of the reference up to T and after it, shapes (.., d)."""
        arcs = self.reference.fine(parts) @ self.system.position.T
        first, rest = arcs[: self.planned], arcs[self.planned :]
        d = self.system.d
        return first.reshape(-1, d), rest.reshape(-1, d)

    def path_times(self, parts: int = 8) -> Array:
        """Times [s] of the positions of `path` up to T."""
        steps = np.arange(self.planned)[:, None] + np.linspace(0, 1, parts + 1)
        return np.asarray(steps.ravel() * self.reference.delta)

    @property
    def initial_positions(self) -> Zonotope:
        """Positions of the initial set."""
        return self.system.position @ self.initial_set

    def positions(self, flights: Flights, run: int = 0) -> Array:
        """Positions of one run [m], shape (N+1, d)."""
        return np.asarray(flights.states[run] @ self.system.position.T)

    def safe_path(self) -> tuple[Array, Array]:
        """Times [s] and positions [m] of the first run under Polaris, or of the reference: (N,), (N, d)."""
        flights = self.flights.get("polaris")
        if flights is not None:
            return flights.times, self.positions(flights)
        return self.path_times(), self.path()[0]

    def approach(self, obstacle: Obstacle) -> Approach:
        """When the safe path comes closest to an unsafe set (of another satellite, where it is nominally)."""
        times, path = self.safe_path()
        found = obstacle.signed_distance(times, path, self.system)
        least = int(np.argmin(found))
        return Approach(float(times[least]), float(found[least]), path[least])

    @property
    def closest(self) -> float:
        """When the safe path comes closest to any unsafe set [s]; the horizon if that is where it starts."""
        found = [self.approach(obstacle) for obstacle in self.obstacles]
        least = min(found, key=lambda one: one.distance).time if found else 0.0
        return least or self.duration

    def mode_name(self, mode: int) -> str:
        """How legends call a controller."""
        if mode == 0:
            return "safety (S)"
        return f"{self.controllers[mode]} (U)" if len(self.controllers) == 2 else self.controllers[mode]


def picture_of_safety(safety: Safety) -> Picture:
    """What Algorithm 1 found."""
    problem = safety.problem
    return Picture(
        "Safe reference",
        problem.system,
        tuple(problem.unsafe),
        problem.goal,
        problem.initial_set,
        safety.reference,
        problem.K,
        slices=recoverable_slices(safety),
    )


def picture_of(schedule: Schedule) -> Picture:
    """What Algorithm 2 found, flown once without disturbance."""
    from ..simulation.baselines import fly_nominal

    flights = {"polaris": fly_nominal(schedule, None, "polaris")}
    if len(schedule.controllers) > 1:
        flights["experimental"] = fly_nominal(schedule, 1, schedule.controllers[1].name)
    return replace(
        picture_of_safety(schedule.safety),
        title="Switching schedule",
        controllers=tuple(controller.name for controller in schedule.controllers),
        modes=schedule.modes,
        margins=schedule.margins,
        limits=tuple(step.margin.limit for step in schedule.steps),
        flights=flights,
        tube=tube_of(schedule),
    )


def tube_of(schedule: Schedule) -> TubePicture:
    """Positions that the schedule may reach, step by step."""
    C = schedule.safety.problem.system.position
    q = schedule.safety.tracking.feedback.nodes_per_cell
    xi = schedule.safety.reference.fine(q)[: len(schedule.steps)]
    flown = [C @ step.flight.nodes for step in schedule.steps]
    together = Zonotope.stack(flown)
    bow = np.stack([step.flight.bow @ np.abs(C).T for step in schedule.steps])
    return TubePicture(together.c + xi @ C.T, together.G, bow)


def shown_steps(planned: int, most: int = SLICES) -> NDArray[np.int_]:
    """Steps at whose start recoverable sets are shown."""
    return np.unique(np.linspace(0, planned - 1, min(most, planned)).astype(int))


def recoverable_slices(safety: Safety, steps: Sequence[int] | None = None) -> SlicePicture | None:
    """Slice the recoverable sets at the start of some steps with the plane of the figures.

    Works on any kind of set: each is convex and asked only whether it contains points, which are
    tried along rays on ever finer scales (to 0.3 % of a step of the first). None on the line.
    """
    system, reference = safety.problem.system, safety.reference
    frame = Frame.of(system)
    if system.d < 2:
        return None
    chosen = shown_steps(safety.problem.K) if steps is None else np.asarray(steps)
    circle = directions(24)
    rays = circle @ np.linalg.pinv(system.position)[:, frame.flat].T  # (M, n)
    sizes = np.linalg.norm(rays @ safety.tracking.W.T, axis=1)
    q = safety.tracking.feedback.nodes_per_cell
    outlines = []
    for k in chosen:
        node = int(k) * q
        known = safety.recoverable.radius(node) / sizes  # a ball that is inside
        low = np.zeros_like(known)
        scales = known[:, None] * np.geomspace(0.9, 1e3, 10)
        for _ in range(5):
            low, high = _bracket(safety, node, rays, low, scales)
            scales = low[:, None] + (high - low)[:, None] * np.linspace(0, 1, 6)[1:-1]
        outlines.append(low[:, None] * circle)
    centre = reference.chi[chosen] @ system.position.T
    return SlicePicture(centre[:, frame.flat], np.array(outlines))


def _bracket(safety: Safety, node: int, rays: Array, low: Array, scales: Array) -> tuple[Array, Array]:
    """Largest scale inside (at least `low`) and the next one, per ray."""
    errors = (rays[:, None] * scales[..., None]).reshape(-1, rays.shape[1])
    inside = np.asarray(safety.recoverable.contains(node, errors)).reshape(scales.shape)
    known = np.concatenate([low[:, None], scales, scales[:, -1:]], axis=1)
    count = np.cumprod(inside, axis=1).sum(axis=1)
    place = np.arange(len(rays))
    return known[place, count], known[place, count + 1]


@dataclass(frozen=True)
class Frame:
    """Which coordinates a figure shows, and what they are called.

    Attributes
    ----------
    axes : tuple of int
        Position coordinates, horizontal one first. In Hill's frame along-track is drawn to the
        right and radial (outward) upward, neither reversed; the third is cross-track.
    labels : tuple of str
        Axis labels with units, in the same order.
    """

    axes: tuple[int, ...]
    labels: tuple[str, ...]

    @classmethod
    def of(cls, system: LinearSystem) -> Frame:
        """Frame of a system: Hill's, or plain position coordinates."""
        if system.mean_motion is not None and system.d == 3:
            names = ("Along-track (m)", "Radial (m)", "Cross-track (m)")
            return cls((1, 0, 2), names)
        letters = "xyz"
        return cls(tuple(range(system.d)), tuple(f"Position {letters[i]} (m)" for i in range(system.d)))

    @property
    def flat(self) -> list[int]:
        """The two coordinates (or the one) of a plane view."""
        return list(self.axes[:2])


def directions(count: int = 32) -> Array:
    """Unit vectors all round, shape (count, 2)."""
    angle = 2 * np.pi * np.arange(count) / count
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)
