"""What figures are drawn from: plain data, taken from results or from the files of a run folder."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from reach.sets.zonotope import Zonotope

from ..model.obstacle import Obstacle
from ..model.system import Array, LinearSystem
from ..planning.reference import Reference

if TYPE_CHECKING:
    from ..simulation.baselines import Flights

PRINTED = 4
"""Most slices in a printed figure."""


def directions(count: int = 32) -> Array:
    """Unit vectors all round, shape (count, 2)."""
    angle = 2 * np.pi * np.arange(count) / count
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


@dataclass(frozen=True)
class Frame:
    """Which coordinates a figure shows, horizontal one first, and their labels with units.

    In Hill's frame along-track is drawn to the right and radial (outward) upward, neither reversed; the third
    is cross-track.
    """

    axes: tuple[int, ...]
    labels: tuple[str, ...]

    @classmethod
    def of(cls, system: LinearSystem) -> Frame:
        """Frame of a system: Hill's, or plain position coordinates."""
        if system.mean_motion is not None and system.d == 3:
            return cls((1, 0, 2), ("Along-track (m)", "Radial (m)", "Cross-track (m)"))
        return cls(tuple(range(system.d)), tuple(f"Position {letter} (m)" for letter in "xyz"[: system.d]))

    @property
    def flat(self) -> list[int]:
        """The two coordinates (or the one) of a plane view."""
        return list(self.axes[:2])


@dataclass(frozen=True, eq=False)
class TubePicture:
    """Reachable set of the position [m], absolute: see `polaris.synthesis.controllers.TubeSegment`."""

    centre: Array  # (K, q+1, d)
    generators: Array  # (K, q+1, d, g)
    bow: Array  # (K, q, d)


@dataclass(frozen=True, eq=False)
class SlicePicture:
    """Positions that are recoverable at some instants, with all else of the state as it then is in a run.

    A slice contains the place of its own run: those that are not recoverable have none. It says nothing
    of other instants, nor of other runs, whose velocities differ.

    Attributes
    ----------
    times : ndarray, shape (S,)
        [s]
    places : ndarray, shape (S, R, d)
        Where the chaser then is in each run [m]; nan if not recoverable.
    outlines : ndarray, shape (S, R, M, 2) or, on the line, (S, R, 2, 1)
        Slices in the plane of the figures [m], through the chaser's place; nan likewise.
    """

    times: Array
    places: Array
    outlines: Array


@dataclass(frozen=True, eq=False)
class Approach:
    """Where the safe path is closest to one unsafe set: time [s], distance [m] and position (d,) [m]."""

    time: float
    distance: float
    place: Array


@dataclass(frozen=True, eq=False)
class Picture:
    """One synthesis, to be drawn."""

    title: str
    system: LinearSystem
    obstacles: tuple[Obstacle, ...]
    goal: Any
    initial_set: Zonotope
    reference: Reference  # with its coasting tail
    planned: int  # number K of steps before the tail
    controllers: tuple[str, ...] = ("safety",)  # names, by mode
    # mode of every step, (K,), and share of the room left, -inf where there is none; empty without a schedule
    modes: NDArray[np.int_] = field(default_factory=lambda: np.zeros(0, dtype=int))
    margins: Array = field(default_factory=lambda: np.zeros(0))
    limits: tuple[str, ...] = ()  # what limits each step
    flights: Mapping[str, Flights] = field(default_factory=dict)  # of safety, experimental, polaris, as flown
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

    def printed_slices(self) -> Iterator[tuple[float, Array, Array]]:
        """Time [s], chaser's place (d,) and slice (M, e) about it [m], of few instants of the first run.

        The closest approach and some of the switches, or of the decisions if there are none.
        """
        if self.slices is None:
            return
        times, known = self.slices.times, np.flatnonzero(~np.isnan(self.slices.places[:, 0, 0]))
        switches = (np.flatnonzero(np.diff(self.modes)) + 1) * self.reference.delta
        spread = switches if len(switches) else np.linspace(0, self.duration, PRINTED)
        wanted = [self.closest, *spread[np.linspace(0, len(spread) - 1, PRINTED - 1).astype(int)]]
        near = {int(known[np.argmin(np.abs(times[known] - t))]) for t in wanted} if len(known) else set()
        for i in sorted(near):
            yield float(times[i]), self.slices.places[i, 0], self.slices.outlines[i, 0]

    def mode_name(self, mode: int) -> str:
        """How legends call a controller."""
        if mode == 0:
            return "safety (S)"
        return f"{self.controllers[mode]} (U)" if len(self.controllers) == 2 else self.controllers[mode]
