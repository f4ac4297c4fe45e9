"""Plot data of figures, taken from results or from the files of a run folder."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from reach.sets.zonotope import Zonotope

from ..model.craft import Craft
from ..model.scene.obstacle import Obstacle
from ..model.scene.state_limits import StateLimit
from ..model.system import Array, LinearSystem
from ..planning.reference import Reference
from ..simulation.baselines import FlightEnvelope

PRINTED = 8  # most hand-overs that are drawn with their slices


def seconds(t: float) -> str:
    """Return a time in a figure."""
    return f"{t:.0f}" if t >= 100 else f"{t:.3g}"


def taking_over(time: float, mode: int | None) -> str:
    """Return the label of the slice of a time [s], at which a controller may take over."""
    return f"{'' if mode is None else 'S from ' if mode == 0 else 'U from '}{seconds(time)} s"


def directions(count: int = 32) -> Array:
    """Unit vectors all round, shape (count, 2)."""
    angle = 2 * np.pi * np.arange(count) / count
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


@dataclass(frozen=True)
class Frame:
    """Coordinates a figure shows, with labels; of Hill's frame along-track, radial, cross-track."""

    axes: tuple[int, ...]
    labels: tuple[str, ...]

    @classmethod
    def from_system(cls, system: LinearSystem) -> Self:
        """Frame of a system: Hill's, or plain position coordinates."""
        if system.mean_motion is not None and system.d == 3:
            return cls((1, 0, 2), ("Along-track (m)", "Radial (m)", "Cross-track (m)"))
        return cls(tuple(range(system.d)), tuple(f"Position {letter} (m)" for letter in "xyz"[: system.d]))

    @property
    def flat(self) -> list[int]:
        """Return the two coordinates (or the one) of a plane view."""
        return list(self.axes[:2])


@dataclass(frozen=True, eq=False)
class TubeData:
    """Reachable set of the position, d = 2 or 3, or of the state, d = n, absolute, of all `TubeSegment`s."""

    centre: Array  # (K, q+1, d)
    generators: Array  # (K, q+1, d, g)
    intersample: Array  # (K, q, d)


@dataclass(frozen=True, eq=False)
class SliceData:
    """Positions recoverable at some instants, all else of the state being that of a run at the time."""

    times: Array  # (S,) [s]
    places: Array  # where the chaser then is in each run, (S, R, d) [m]; nan if not recoverable
    outlines: Array  # in the plane, (S, R, M, 2), or on the line, (S, R, 2, 1) [m]; nan likewise


class PrintedSlice(NamedTuple):
    """Time [s], who then takes over (None if nobody does), the chaser's place (d,), the slice (M, e) [m]."""

    time: float
    mode: int | None
    place: Array
    outline: Array


@dataclass(frozen=True, eq=False)
class ApproachData:
    """Closest approach of the safe path to one unsafe set: time [s], distance [m] and position (d,) [m]."""

    time: float
    distance: float
    place: Array


@dataclass(frozen=True, eq=False)
class PlotData:
    """One synthesis, to be drawn."""

    title: str
    system: Craft
    obstacles: tuple[Obstacle, ...]
    goal: Any
    initial_set: Zonotope
    reference: Reference  # with its coasting tail
    planned: int  # number K of steps before the tail
    controllers: tuple[str, ...] = ("safety",)  # names, by mode
    # mode of every step, (K,), and share of the clearance left, -inf if none is; empty without a schedule
    modes: NDArray[np.int_] = field(default_factory=lambda: np.zeros(0, dtype=int))
    margins: Array = field(default_factory=lambda: np.zeros(0))
    limits: tuple[str, ...] = ()  # what limits each step
    flights: Mapping[str, FlightEnvelope] = field(
        default_factory=dict
    )  # of safety, experimental, polaris, as flown
    tube: TubeData | None = None
    state_tube: TubeData | None = None
    state_limits: tuple[StateLimit, ...] = ()  # taken out of the obstacles
    slices: SliceData | None = None
    reached: float | None = None  # by when the goal is proven to be reached [s]
    delta_v_max: float | None = None  # bound on the velocity change until then [m/s]

    def __post_init__(self) -> None:
        """Part limits on the whole state from sets that have a place."""
        limits = tuple(item for item in self.obstacles if isinstance(item, StateLimit))
        placed = tuple(item for item in self.obstacles if not isinstance(item, StateLimit))
        object.__setattr__(self, "obstacles", placed)
        object.__setattr__(self, "state_limits", (*self.state_limits, *limits))

    @property
    def frame(self) -> Frame:
        """Coordinates shown."""
        return Frame.from_system(self.system)

    @property
    def duration(self) -> float:
        """Return the horizon T [s]."""
        return self.planned * self.reference.delta

    def path(self, parts: int = 8) -> tuple[Array, Array]:
        """Positions [m] of the reference up to T and after it, shapes (.., d)."""
        arcs = self.reference.fine(parts) @ self.system.position.T
        first, tail = arcs[: self.planned], arcs[self.planned :]
        d = self.system.d
        return first.reshape(-1, d), tail.reshape(-1, d)

    def path_times(self, parts: int = 8) -> Array:
        """Times [s] of the positions of `path` up to T."""
        steps = np.arange(self.planned)[:, None] + np.linspace(0, 1, parts + 1)
        return np.asarray(steps.ravel() * self.reference.delta)

    @property
    def initial_positions(self) -> Zonotope:
        """Positions of the initial set."""
        return self.system.position @ self.initial_set

    def positions(self, flights: FlightEnvelope, run: int = 0) -> Array:
        """Positions of one run [m], shape (N+1, d)."""
        return np.asarray(flights.states[run] @ self.system.position.T)

    @property
    def arrival(self) -> str:
        """Describe by when the goal is proven to be reached; "" if it is not."""
        if self.reached is None:
            return ""
        after = ", under S after T" if self.reached > self.duration * (1 + 1e-9) else ""
        return f"goal reached by {self.reached:.6g} s{after}"

    def velocity_change(self, runs: FlightEnvelope) -> Array:
        """Return the velocity change so far, the 1-norm of the input over the mass [m/s], shape (r, N+1)."""
        parts = np.abs(runs.inputs).sum(axis=2) * np.diff(runs.times) / self.system.mass
        return np.pad(np.cumsum(parts, axis=1), ((0, 0), (1, 0)))

    def safe_path(self) -> tuple[Array, Array]:
        """Times [s] and positions [m] of the first run under Polaris, or of the reference: (N,), (N, d)."""
        flights = self.flights.get("polaris")
        if flights is not None:
            return flights.times, self.positions(flights)
        return self.path_times(), self.path()[0]

    def approach(self, obstacle: Obstacle) -> ApproachData:
        """Return the closest approach to an unsafe set (of another satellite: to its nominal place)."""
        times, path = self.safe_path()
        distances = obstacle.signed_distance(times, path, self.system)
        nearest = int(np.argmin(distances))
        return ApproachData(float(times[nearest]), float(distances[nearest]), path[nearest])

    @property
    def closest(self) -> float:
        """Time at which the safe path is closest to any unsafe set [s]; the horizon if that is the start."""
        approaches = [self.approach(obstacle) for obstacle in self.obstacles]
        nearest = min(approaches, key=lambda one: one.distance).time if approaches else 0.0
        return nearest or self.duration

    @property
    def hand_overs(self) -> dict[float, int]:
        """Times [s] of hand-overs and the mode that takes over; of very many some, evenly spread."""
        nodes = np.flatnonzero(np.diff(self.modes)) + 1
        if len(nodes) > PRINTED:
            nodes = nodes[np.linspace(0, len(nodes) - 1, PRINTED).astype(int)]
        return {float(k * self.reference.delta): int(self.modes[k]) for k in nodes}

    def printed_slices(self) -> Iterator[PrintedSlice]:
        """Slices of the first run at its hand-overs, or at its closest approach and a few more instants."""
        if self.slices is None:
            return
        times, recoverable = self.slices.times, ~np.isnan(self.slices.places[:, 0, 0])
        spread = (self.closest, *np.linspace(0, self.duration, 3))
        mode_by_slice: dict[int, int | None] = {}
        for t, mode in (self.hand_overs or dict.fromkeys(spread)).items():
            i = int(np.argmin(np.abs(times - t) + np.where(recoverable | (mode is not None), 0.0, np.inf)))
            if recoverable[i] and (mode is None or abs(times[i] - t) <= 1e-6 * self.reference.delta):
                mode_by_slice[i] = mode
        for i, mode in sorted(mode_by_slice.items()):
            yield PrintedSlice(float(times[i]), mode, self.slices.places[i, 0], self.slices.outlines[i, 0])

    def mode_name(self, mode: int) -> str:
        """Return the name of a controller in legends."""
        if mode == 0:
            return "safety (S)"
        return f"{self.controllers[mode]} (U)" if len(self.controllers) == 2 else self.controllers[mode]
