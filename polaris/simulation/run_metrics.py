"""What simulated runs amount to: distances, times to collision, usage and velocity change per run."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..model.checks import of_kind
from ..model.distances import closest, count_switches, drift_ttc, mode_shares, ray_ttc, signed_distances
from ..model.obstacles import Obstacle
from ..model.system import Array, LinearSystem
from ..model.truth import true_states
from ..synthesis.schedule import Schedule

PART = 250
"""Runs evaluated at a time, to bound the memory used."""

DEFINITIONS = {
    "runs": "closed-loop runs from random and extreme initial states, under random and worst disturbances",
    "min_distance_m": "least signed distance to any true unsafe set over all runs and times; negative inside",
    "min_distance_mean_m": "mean over runs of each run's least distance",
    "mean_distance_m": "mean over runs and times of the signed distance to the nearest unsafe set",
    "min_ttc_s": "least time, over all runs and times, until a straight line at the present velocity "
    "enters an unsafe set; null if none ever does",
    "min_ttc_free_drift_s": "the same with thrusters off from the start of each step, looking ahead for "
    "drift_horizon_s; null if none enters",
    "experimental_share": "share of time under experimental controllers, mean over runs",
    "switches": "changes of controller within a run, most over runs",
    "delta_v_m_s": "velocity change (integral of the 1-norm of the input over the mass), mean over runs",
    "delta_v_max_m_s": "velocity change, largest over runs",
    "collided": "whether any run entered a true unsafe set",
    "collided_runs": "number of runs that entered a true unsafe set",
    "max_thrust_ratio": "largest commanded over available thrust, over runs, times and axes; "
    "above 1 it was clipped",
    "max_thrust_ratio_safety": "the same while S flies, at most 1 where it is proven; null if it never does",
    "max_thrust_ratio_experimental": "the same while an experimental controller flies; null if none does",
}
"""What each number of a summary means, and how it joins the runs."""


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


@dataclass(frozen=True, eq=False)
class Metrics:
    """Metrics of every run of one controller.

    Attributes
    ----------
    controller : str
        Who flew: ``polaris`` (the schedule) or the name of one controller.
    names : tuple of str
        Unsafe sets.
    times : ndarray, shape (N+1,)
        [s]
    min_distance : ndarray, shape (R,)
        Least signed distance to a true unsafe set [m]; inf without any.
    mean_distance : ndarray, shape (R,)
        Mean over the instants of the distance to the nearest of them [m]; inf without any.
    closest_time : ndarray, shape (R,)
        When it was least [s]; nan without unsafe sets.
    closest_set : ndarray of int, shape (R,)
        Which unsafe set; -1 without any.
    min_ttc, min_ttc_free_drift : ndarray, shape (R,)
        Least time to collision [s], by a straight line and by free drift; inf if none.
    drift_horizon : float
        How far free drift looks ahead [s].
    experimental_share : ndarray, shape (R,)
        Share of time under experimental controllers.
    switches : ndarray of int, shape (R,)
        Changes of controller.
    delta_v : ndarray, shape (R,)
        [m/s]
    collided : ndarray of bool, shape (R,)
        Whether the run entered a true unsafe set.
    max_thrust_ratio : ndarray, shape (R,)
        Commanded over available thrust.
    max_thrust_ratio_safety, max_thrust_ratio_experimental : ndarray, shape (R,)
        The same while S flies, and while an experimental controller does; nan if none ever does.
    nearest : ndarray, shape (3, N+1)
        Distance to the nearest unsafe set at every instant [m]: least, mean and largest over runs.
    """

    controller: str
    names: tuple[str, ...]
    times: Array
    min_distance: Array
    mean_distance: Array
    closest_time: Array
    closest_set: NDArray[np.int64]
    min_ttc: Array
    min_ttc_free_drift: Array
    drift_horizon: float
    experimental_share: Array
    switches: NDArray[np.int64]
    delta_v: Array
    collided: NDArray[np.bool_]
    max_thrust_ratio: Array
    max_thrust_ratio_safety: Array
    max_thrust_ratio_experimental: Array
    nearest: Array

    @classmethod
    def join(cls, parts: Sequence[Metrics]) -> Metrics:
        """Metrics of several batches of runs of the same controller, together."""
        if len(parts) == 1:
            return parts[0]
        weights = np.array([len(part.min_distance) for part in parts], dtype=float)
        nearest = np.stack([part.nearest for part in parts])
        mean = np.tensordot(weights / weights.sum(), nearest[:, 1], axes=1)
        per_run: dict[str, Any] = {
            field.name: np.concatenate([getattr(part, field.name) for part in parts])
            for field in fields(cls)
            if field.name not in ("controller", "names", "times", "drift_horizon", "nearest")
        }
        together = np.stack([nearest[:, 0].min(axis=0), mean, nearest[:, 2].max(axis=0)])
        return replace(parts[0], nearest=together, **per_run)

    @property
    def worst(self) -> int:
        """The run that came closest to an unsafe set."""
        return int(np.argmin(self.min_distance))

    def summary(self) -> dict[str, Any]:
        """The numbers of a run folder's summary, joined over runs as `DEFINITIONS` says; strict JSON."""
        return {
            "controller": self.controller,
            "runs": len(self.min_distance),
            "min_distance_m": _finite(self.min_distance.min()),
            "min_distance_mean_m": _finite(self.min_distance.mean()),
            "mean_distance_m": _finite(self.mean_distance.mean()),
            "min_ttc_s": _finite(self.min_ttc.min()),
            "min_ttc_free_drift_s": _finite(self.min_ttc_free_drift.min()),
            "drift_horizon_s": self.drift_horizon,
            "experimental_share": float(self.experimental_share.mean()),
            "switches": int(self.switches.max()),
            "delta_v_m_s": float(self.delta_v.mean()),
            "delta_v_max_m_s": float(self.delta_v.max()),
            "collided": bool(self.collided.any()),
            "collided_runs": int(self.collided.sum()),
            "max_thrust_ratio": float(self.max_thrust_ratio.max()),
            "max_thrust_ratio_safety": _finite(self.max_thrust_ratio_safety.max()),
            "max_thrust_ratio_experimental": _finite(self.max_thrust_ratio_experimental.max()),
        }

    def columns(self) -> dict[str, Array]:
        """One array per metric, one entry per run; units in the names."""
        return {
            "min_distance_m": self.min_distance,
            "mean_distance_m": self.mean_distance,
            "closest_time_s": self.closest_time,
            "closest_set": np.array([*self.names, ""])[self.closest_set],
            "min_ttc_s": self.min_ttc,
            "min_ttc_free_drift_s": self.min_ttc_free_drift,
            "experimental_share": self.experimental_share,
            "switches": self.switches,
            "delta_v_m_s": self.delta_v,
            "collided": self.collided,
            "max_thrust_ratio": self.max_thrust_ratio,
            "max_thrust_ratio_safety": self.max_thrust_ratio_safety,
            "max_thrust_ratio_experimental": self.max_thrust_ratio_experimental,
        }

    def to_pandas(self) -> Any:
        """`columns` as a ``pandas.DataFrame`` (pandas is not a dependency; install it first)."""
        import pandas  # type: ignore[import-untyped,import-not-found,unused-ignore]

        return pandas.DataFrame(self.columns())


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


def _finite(value: Any) -> float | None:
    return float(value) if np.isfinite(value) else None
