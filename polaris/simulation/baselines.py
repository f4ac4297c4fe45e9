"""The safety controller alone, the experimental one alone, and Polaris, flown under the same conditions."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..model.checks import of_kind
from ..model.system import Array
from ..synthesis.schedule import Schedule
from .metrics import Metrics
from .run_metrics import Runs, evaluate
from .simulate import simulate

BATCH = 1000
"""Runs simulated at a time, to bound the memory used."""


@dataclass(frozen=True, eq=False)
class Flights:
    """Some simulated runs of one controller, and the envelope of all of them.

    Attributes
    ----------
    controller : str
        Who flew.
    labels : tuple of str
        What each run shown is: ``nominal`` (from the centre, undisturbed), ``closest``, ``run 3``.
    times : ndarray, shape (N+1,)
        [s]
    states : ndarray, shape (r, N+1, n)
        Absolute states.
    inputs : ndarray, shape (r, N, m)
        Applied after every node.
    modes : ndarray of int, shape (cells,)
        Mode of every step.
    nearest : ndarray, shape (3, N+1)
        Distance to the nearest unsafe set [m]: least, mean and largest over all runs.
    input_range : ndarray, shape (2, N, m)
        Least and largest input over all runs.
    """

    controller: str
    labels: tuple[str, ...]
    times: Array
    states: Array
    inputs: Array
    modes: NDArray[np.int_]
    nearest: Array
    input_range: Array

    @classmethod
    def of(cls, runs: Runs, metrics: Metrics, labels: Mapping[int, str]) -> Flights:
        """Keep the runs that are given a label."""
        chosen = list(labels)
        return cls(
            metrics.controller,
            tuple(labels.values()),
            runs.times,
            runs.states[chosen],
            runs.inputs[chosen],
            runs.modes,
            metrics.nearest,
            np.stack([runs.inputs.min(axis=0), runs.inputs.max(axis=0)]),
        )

    def _followed_by(self, other: Flights) -> Flights:
        """The runs of both, in the envelope of the second."""
        return replace(
            other,
            labels=self.labels + other.labels,
            states=np.concatenate([self.states, other.states]),
            inputs=np.concatenate([self.inputs, other.inputs]),
        )


@dataclass(frozen=True, eq=False)
class Flown:
    """What one controller did.

    Attributes
    ----------
    metrics : Metrics
        Of all its runs.
    flights : Flights
        Some of the runs, and the envelope of all.
    """

    metrics: Metrics
    flights: Flights


def fly_nominal(schedule: Schedule, mode: int | None, name: str) -> Flights:
    """One run from the centre of the initial set, undisturbed."""
    run = simulate(schedule, 1, mode=mode, initial="center", disturbance="none", substeps=2)
    return Flights.of(run, evaluate(run, controller=name), {0: "nominal"})


def compare(
    schedule: Schedule, n: int = 100, seed: int = 0, progress: Callable[[int, int], None] | None = None
) -> dict[str, Flown]:
    """Fly ``safety`` (S alone), ``experimental`` (the preferred U alone) and ``polaris`` n times each.

    Parameters
    ----------
    schedule : Schedule
        Result of `synthesize`.
    n : int
        Runs per controller: half from corners of the initial set, half under worst-case disturbances.
    seed : int
        Same seed, same runs.
    progress : callable, optional
        Called with (runs flown, runs in all).

    Returns
    -------
    dict
        Without ``experimental`` if the schedule knows no such controller.
    """
    of_kind("schedule", schedule, Schedule, "polaris.synthesize")
    plans: dict[str, int | None] = {"safety": 0, "experimental": 1, "polaris": None}
    if len(schedule.controllers) == 1:
        del plans["experimental"]
    out: dict[str, Flown] = {}
    for done, (key, mode) in enumerate(plans.items()):
        name = key if mode is None else schedule.controllers[mode].name
        parts: list[tuple[Metrics, Flights]] = []
        for first in range(0, n, BATCH):
            if progress:
                progress(done * n + first, len(plans) * n)
            runs = simulate(schedule, min(BATCH, n - first), seed + first, mode=mode)
            metrics = evaluate(runs, seed + first, name)
            labels = {metrics.worst: "closest"}
            if first == 0:
                labels |= {i: f"run {i}" for i in range(min(3, len(runs.states))) if i != metrics.worst}
            parts.append((metrics, Flights.of(runs, metrics, labels)))
        joined = Metrics.join([metrics for metrics, _ in parts])
        out[key] = Flown(joined, fly_nominal(schedule, mode, name)._followed_by(_join(parts, joined)))
    return out


def _join(parts: list[tuple[Metrics, Flights]], joined: Metrics) -> Flights:
    """Flights of the first batch, with the closest run of all and the envelope of all."""
    first = parts[0][1]
    worst = min(parts, key=lambda part: float(part[0].min_distance.min()))[1]
    where: Any = worst.labels.index("closest")
    here: Any = first.labels.index("closest")
    states, inputs = first.states.copy(), first.inputs.copy()
    states[here], inputs[here] = worst.states[where], worst.inputs[where]
    ranges = np.stack([flights.input_range for _, flights in parts])
    return replace(
        first,
        states=states,
        inputs=inputs,
        nearest=joined.nearest,
        input_range=np.stack([ranges[:, 0].min(axis=0), ranges[:, 1].max(axis=0)]),
    )
