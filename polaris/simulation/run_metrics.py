"""What simulated runs amount to: distances, times to collision, usage and velocity change per run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..model.checks import of_kind
from ..model.distances import closest, count_switches, mode_shares, ray_ttc, signed_distances
from ..model.free_drift import drift_ttc
from ..model.obstacle import Obstacle
from ..model.satellite import true_states
from ..model.system import Array, LinearSystem
from ..synthesis.schedule import Schedule
from .metrics import Metrics

PART = 250
"""Runs evaluated at a time, to bound the memory used."""


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
        Input applied right after every node [N], after the thrusters' clipping.
    demanded : ndarray, shape (R, N)
        Largest ratio of commanded to available thrust within each period; above 1 the thrusters
        clipped.
    delta_v : ndarray, shape (R,)
        Velocity change [m/s]: the integral of the 1-norm of the input over the mass.
    modes : ndarray of int, shape (cells,)
        Mode of every step.
    """

    schedule: Schedule
    times: Array
    states: Array
    inputs: Array
    demanded: Array
    delta_v: Array
    modes: NDArray[np.int_]

    @property
    def positions(self) -> Array:
        """Positions [m], shape (R, N+1, d)."""
        return np.asarray(self.states @ self.schedule.safety.tracking.system.position.T)

    @property
    def mode_per_period(self) -> NDArray[np.int_]:
        """Mode over the period after every node, shape (N,)."""
        return np.repeat(self.modes, (len(self.times) - 1) // len(self.modes))

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
    The closest approach is refined between the nodes along cubics through the simulated positions
    and velocities, and every chord between nodes is checked for having entered a set.
    """
    of_kind("runs", runs, Runs, "polaris.simulate")
    safety = runs.schedule.safety
    obstacles: tuple[Obstacle, ...] = tuple(safety.problem.unsafe)
    horizon = drift_horizon(safety.problem.system, safety.problem.K * safety.problem.delta)
    rng = np.random.default_rng(seed)
    count = len(runs.states)
    parts = [
        _Part(runs, obstacles, slice(i, min(i + PART, count)), horizon, rng) for i in range(0, count, PART)
    ]

    def joined(name: str) -> Array:
        return np.concatenate([getattr(part, name) for part in parts])

    modes = np.broadcast_to(runs.modes, (count, len(runs.modes)))
    edges = runs.times[:: (len(runs.times) - 1) // len(runs.modes)]
    shares = mode_shares(edges, modes)
    experimental = sum((share for mode, share in shares.items() if mode > 0), np.zeros(count))
    distances = joined("nearest")
    return Metrics(
        controller=_who(runs) if controller is None else controller,
        names=tuple(obstacle.name for obstacle in obstacles),
        times=runs.times,
        min_distance=joined("distance"),
        mean_distance=distances.mean(axis=1),
        closest_time=joined("when"),
        closest_set=joined("which").astype(np.int64),
        min_ttc=joined("ttc"),
        min_ttc_free_drift=joined("drift"),
        drift_horizon=horizon,
        experimental_share=np.asarray(experimental),
        switches=count_switches(modes),
        delta_v=runs.delta_v,
        collided=joined("collided").astype(bool),
        max_thrust_ratio=runs.demanded.max(axis=1),
        max_thrust_ratio_safety=_peak(runs, runs.mode_per_period == 0),
        max_thrust_ratio_experimental=_peak(runs, runs.mode_per_period > 0),
        nearest=np.stack([distances.min(axis=0), distances.mean(axis=0), distances.max(axis=0)]),
    )


def drift_horizon(system: LinearSystem, duration: float) -> float:
    """How far free drift looks ahead [s]: one orbit in Hill's frame, else the horizon."""
    return duration if system.mean_motion is None else 2 * np.pi / system.mean_motion


class _Part:
    """Everything measured on some of the runs; arrays have one entry per run."""

    def __init__(
        self,
        runs: Runs,
        obstacles: Sequence[Obstacle],
        chosen: slice,
        horizon: float,
        rng: np.random.Generator,
    ) -> None:
        self.system, self.times = runs.schedule.safety.problem.system, runs.times
        self.obstacles, self.x = obstacles, runs.states[chosen]
        self.h = float(self.times[1] - self.times[0])
        R, N = self.x.shape[0], self.x.shape[1] - 1
        self.truth = true_states(obstacles, self.system, self.times, R, rng)
        p, v = self.x @ self.system.position.T, self.x @ self.system.velocity.T
        distances = signed_distances(obstacles, self.times, p, self.system, self.truth)
        nearest = closest(distances, self.times)
        self.distance, self.when, self.which = nearest.distance, nearest.time, nearest.obstacle
        self.ttc = self.drift = np.full(R, np.inf)
        self.collided = np.zeros(R, dtype=bool)
        self.nearest = np.full((R, N + 1), np.inf)
        if not obstacles:
            return
        self.nearest = distances.min(axis=0)
        self._refine()
        self.ttc = ray_ttc(obstacles, self.times, p, v, self.system, self.truth).min(axis=(0, 2))
        before = {name: states[:, :-1] for name, states in self.truth.items()}
        chord = np.diff(p, axis=1) / self.h
        entry = ray_ttc(obstacles, self.times[:-1], p[:, :-1], chord, self.system, before)
        self.collided = (self.distance <= 0) | (entry <= self.h).any(axis=(0, 2))
        q = N // len(runs.modes)
        starts = {name: states[:, ::q] for name, states in self.truth.items()}
        self.drift = drift_ttc(
            obstacles, self.system, self.times[::q], self.x[:, ::q], horizon, starts, tolerance=0.05
        ).min(axis=(0, 2))

    def _refine(self, parts: int = 8) -> None:
        """Look for a closer approach in the two periods about the closest node."""
        system = self.system
        if np.any(system.position @ system.B) or np.any(system.position @ system.D):
            return  # the velocity is no function of the state
        R, N = self.x.shape[0], self.x.shape[1] - 1
        node = np.clip(np.round(self.when / self.h).astype(int), 0, N)
        left = np.stack([np.maximum(node - 1, 0), np.minimum(node, N - 1)], axis=1)  # (R, 2)
        s = np.linspace(0.0, 1.0, parts + 1)
        t = (self.times[left][..., None] + s * self.h).reshape(R, -1)
        p = self._cubic(self.x, left, s) @ system.position.T
        states = {name: self._cubic(known, left, s) for name, known in self.truth.items()}
        finer = closest(signed_distances(self.obstacles, t, p, system, states), t)
        better = finer.distance < self.distance
        for name, value in (("distance", finer.distance), ("when", finer.time), ("which", finer.obstacle)):
            setattr(self, name, np.where(better, value, getattr(self, name)))

    def _cubic(self, x: Array, left: NDArray[np.int_], s: Array) -> Array:
        """States between nodes from the states there and their unforced rates, shape (R, 2 parts, n).

        Exact to third order in the positions, whose rate no input enters.
        """
        run = np.arange(len(x))[:, None]
        a, b = x[run, left][..., None, :], x[run, left + 1][..., None, :]
        da, db = self.h * a @ self.system.A.T, self.h * b @ self.system.A.T
        s = s[:, None]
        out = (1 + 2 * s) * (1 - s) ** 2 * a + s * (1 - s) ** 2 * da
        out = out + s**2 * (3 - 2 * s) * b + s**2 * (s - 1) * db
        return np.asarray(out.reshape(len(x), -1, x.shape[-1]))


def _peak(runs: Runs, chosen: NDArray[np.bool_]) -> Array:
    """Largest demand of thrust in some of the periods, per run; nan without any."""
    return runs.demanded[:, chosen].max(axis=1) if chosen.any() else np.full(len(runs.demanded), np.nan)


def _who(runs: Runs) -> str:
    if np.array_equal(runs.modes[: len(runs.schedule.modes)], runs.schedule.modes):
        return "polaris"
    alone = np.unique(runs.modes[: len(runs.schedule.modes)])
    return runs.schedule.controllers[int(alone[0])].name if len(alone) == 1 else "mixed"
