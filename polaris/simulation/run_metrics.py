"""Metrics of simulated runs: distances, times to collision, usage and velocity change per run."""

from collections.abc import Iterable, Mapping
from dataclasses import astuple, dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reach.numerics.linear import discretize
from reach.short_repr import short_repr

from ..model.checks import of_kind
from ..model.scene.distances import (
    SampledApproach,
    closest,
    count_switches,
    mode_shares,
    ray_ttc,
    signed_distances,
)
from ..model.scene.free_drift import drift_ttc
from ..model.scene.satellite import true_states
from ..model.scene.state_limits import StateLimit
from ..model.system import Array, LinearSystem
from ..synthesis.schedule.schedule import Schedule
from .fault_times import FaultTimes
from .metrics import Metrics

PARTS = 8  # parts of a period in which limits on the whole state are looked at
PART = 250  # runs evaluated at a time, to bound the memory used


@short_repr
@dataclass(frozen=True, eq=False)
class Runs:
    """Simulated closed loops.

    Attributes
    ----------
    schedule : Schedule
        What was flown, whole or one of its controllers.
    times : ndarray, shape (N+1,)
        Instants of the states [s]: the nodes of the time grid.
    states : ndarray, shape (R, N+1, n)
        Absolute states.
    inputs : ndarray, shape (R, N, m)
        Input right after every node [N], after the thrusters' clipping and before their errors.
    demanded : ndarray, shape (R, N)
        Largest ratio of commanded to available thrust within each period; above 1 the thrusters
        clipped.
    delta_v : ndarray, shape (R,)
        Velocity change [m/s]: the integral of the 1-norm of the input over the mass.
    modes : ndarray of int, shape (cells,)
        Mode of every step.
    bodies : dict of str to ndarray, shapes (R, N+1, n)
        True states of other satellites where a network was told of them.
    faults : FaultTimes, optional
        What failed in each run, in nodes.
    """

    schedule: Schedule
    times: Array
    states: Array
    inputs: Array
    demanded: Array
    delta_v: Array
    modes: NDArray[np.int_]
    bodies: Mapping[str, Array] = field(default_factory=dict)
    faults: FaultTimes | None = None

    def some(self, chosen: slice | list[int]) -> "Runs":
        """Return some of the runs."""
        parts = ("states", "inputs", "demanded", "delta_v")
        bodies = {name: states[chosen] for name, states in self.bodies.items()}
        faults = None if self.faults is None else self.faults.pick(chosen)
        selected = {name: getattr(self, name)[chosen] for name in parts}
        return replace(self, bodies=bodies, faults=faults, **selected)

    @property
    def positions(self) -> Array:
        """Positions [m], shape (R, N+1, d)."""
        return np.asarray(self.states @ self.schedule.safety.tracking.system.position.T)

    @property
    def flown(self) -> NDArray[np.int_]:
        """Return the mode over the period after every node, S because of a fault included, (R, N)."""
        modes = np.repeat(self.modes, (len(self.times) - 1) // len(self.modes))
        planned, faults = np.broadcast_to(modes, self.demanded.shape), self.faults
        by_s = False if faults is None else faults.by_s(np.arange(planned.shape[1])[:, None]).T
        return np.where(by_s, 0, planned)

    def metrics(self) -> Metrics:
        """Distances, times to collision, usage and velocity change; see `Metrics`."""
        return evaluate(self)


def evaluate(runs: Runs, seed: int = 0, controller: str | None = None) -> Metrics:
    """Measure every run against the true unsafe sets.

    Parameters
    ----------
    runs : Runs
        Result of `simulate`.
    seed : int
        For the true states of other satellites, drawn from what is known of them.
    controller : str, optional
        Who flew, if the runs are to be called something else than their modes tell.

    Returns
    -------
    Metrics

    Notes
    -----
    Sets count while they hold (`Obstacle.span`), for times to collision at the instant of the collision. The
    closest approach is refined between the nodes along held inputs, every chord between nodes is checked
    for having entered a set, and limits on the whole state are looked at within every period, too.
    """
    of_kind("runs", runs, Runs, "polaris.simulate")
    rng, label = np.random.default_rng(seed), _controller_name(runs) if controller is None else controller
    count = len(runs.states)
    return Metrics.join([_measured(runs.some(slice(i, i + PART)), rng, label) for i in range(0, count, PART)])


def drift_horizon(system: LinearSystem, duration: float) -> float:
    """Return how far free drift looks ahead [s]: one orbit in Hill's frame, else the horizon."""
    return duration if system.mean_motion is None else 2 * np.pi / system.mean_motion


def _measured(runs: Runs, rng: np.random.Generator, controller: str) -> Metrics:
    """Metrics of so few runs that all their distances fit into memory."""
    problem = runs.schedule.safety.problem
    system, times, x = problem.system, runs.times, runs.states
    obstacles, limits = _placed(problem.unsafe)
    R, N = x.shape[0], x.shape[1] - 1
    h, q = float(times[1] - times[0]), N // len(runs.modes)
    truth = true_states(obstacles, system, times, R, rng) | dict(runs.bodies)
    p, v = x @ system.position.T, x @ system.velocity.T
    distances = signed_distances(obstacles, times, p, system, truth)
    nearest = _refined(runs, truth, closest(distances, times))
    distance = distances.min(axis=0, initial=np.inf)
    measured = np.compress(np.isfinite(distance[0]), distance, axis=1)  # while any set holds
    horizon = drift_horizon(system, problem.K * problem.delta)
    ttc = ray_ttc(obstacles, times, p, v, system, truth)
    before = {name: states[:, :-1] for name, states in truth.items()}
    entry = ray_ttc(obstacles, times[:-1], p[:, :-1], np.diff(p, axis=1) / h, system, before)
    collided = (nearest.distance <= 0) | (entry <= h).any(axis=(0, 2))
    starts = {name: states[:, ::q] for name, states in truth.items()}
    drift = drift_ttc(obstacles, system, times[::q], x[:, ::q], horizon, starts, tolerance=0.05)
    for share in np.arange(len(limits) and PARTS) / PARTS:
        within = period_path(system, h, x[:, :-1], x[:, 1:], np.array([share]))[..., 0, :]
        collided |= (signed_distances(limits, times[:-1] + share * h, within, system) <= 0).any(axis=(0, 2))
    collided |= (signed_distances(limits, times[-1:], x[:, -1:], system) <= 0).any(axis=(0, 2))
    node_modes = runs.flown
    modes = node_modes[:, ::q] if runs.faults is None else node_modes
    return Metrics(
        controller=controller,
        names=tuple(obstacle.name for obstacle in obstacles),
        times=times,
        min_distance=nearest.distance,
        mean_distance=measured.mean(axis=1) if measured.size else distance[:, 0],
        closest_time=nearest.time,
        closest_set=nearest.obstacle.astype(np.int64),
        min_ttc=ttc.min(axis=(0, 2), initial=np.inf),
        min_ttc_free_drift=drift.min(axis=(0, 2), initial=np.inf),
        drift_horizon=horizon,
        experimental_share=experimental_share(times[:: N // modes.shape[1]], modes),
        switches=count_switches(modes),
        delta_v=runs.delta_v,
        collided=collided,
        max_thrust_ratio=runs.demanded.max(axis=1),
        max_thrust_ratio_safety=peak(runs.demanded, node_modes == 0),
        max_thrust_ratio_experimental=peak(runs.demanded, node_modes > 0),
        nearest=np.stack([distance.min(axis=0), distance.mean(axis=0), distance.max(axis=0)]),
    )


def _placed(unsafe: Iterable[Any]) -> tuple[tuple[Any, ...], tuple[StateLimit, ...]]:
    """Unsafe sets in position, to which there are distances, and limits on the whole state."""
    limits = tuple(item for item in unsafe if isinstance(item, StateLimit))
    return tuple(item for item in unsafe if not isinstance(item, StateLimit)), limits


def _refined(runs: Runs, truth: Mapping[str, Array], nearest: SampledApproach) -> SampledApproach:
    """Return a closer approach in the two periods about the closest node, if there is one."""
    problem, times = runs.schedule.safety.problem, runs.times
    system, h, N = problem.system, float(times[1] - times[0]), len(times) - 1
    node = np.clip(np.nan_to_num(np.round(nearest.time / h)).astype(int), 0, N)
    starts = np.stack([np.maximum(node - 1, 0), np.minimum(node, N - 1)], axis=1)  # (R, 2)
    s = np.linspace(0.0, 1.0, PARTS + 1)
    run = np.arange(len(starts))[:, None]

    def between(x: Array) -> Array:
        return period_path(system, h, x[run, starts], x[run, starts + 1], s).reshape(len(x), -1, x.shape[-1])

    t = (times[starts][..., None] + s * h).reshape(len(starts), -1)
    states = {name: between(path) for name, path in truth.items()}
    obstacles, _ = _placed(problem.unsafe)
    finer = closest(
        signed_distances(obstacles, t, between(runs.states) @ system.position.T, system, states), t
    )
    closer = finer.distance < nearest.distance
    pairs = zip(astuple(finer), astuple(nearest), strict=True)
    return SampledApproach(*(np.where(closer, new, old) for new, old in pairs))


def period_path(system: LinearSystem, h: float, before: Array, after: Array, shares: Array) -> Array:
    """Return states (..., S, n) at shares (S,) of a period h [s] between the states (..., n) at its ends.

    What is added to the free motion is constant: a held input, a held disturbance.
    """
    eye = np.eye(system.n)
    carried, added = discretize(system.A, eye, h)
    rate = (after - before @ carried.T) @ np.linalg.inv(added).T
    parts = [discretize(system.A, eye, share * h) for share in shares]
    return np.stack([before @ Ad.T + rate @ Bd.T for Ad, Bd in parts], axis=-2)


def experimental_share(t: Array, modes: NDArray[np.int_]) -> Array:
    """Share of the time under experimental controllers, shape (R,), from modes (R, K) that begin at t."""
    parts = [share for mode, share in mode_shares(t, modes).items() if mode > 0]
    return np.asarray(sum(parts, np.zeros(len(modes))))


def peak(demanded: Array, chosen: NDArray[np.bool_]) -> Array:
    """Largest demand of thrust in the chosen periods, (N,) or (R, N), per run; nan without any."""
    peaks = np.where(chosen, demanded, -np.inf).max(axis=1)
    return np.where(np.isfinite(peaks), peaks, np.nan)


def _controller_name(runs: Runs) -> str:
    if np.array_equal(runs.modes[: len(runs.schedule.modes)], runs.schedule.modes):
        return "polaris"
    modes = np.unique(runs.modes[: len(runs.schedule.modes)])
    return runs.schedule.controllers[int(modes[0])].name if len(modes) == 1 else "mixed"
