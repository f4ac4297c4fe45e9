"""The safety controller alone, each experimental one alone, and Polaris, flown under the same conditions."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from reach.short_repr import short_repr

from ..model.checks import of_kind
from ..model.system import Array
from ..synthesis.schedule.schedule import Schedule
from .metrics import Metrics
from .run_metrics import evaluate
from .simulate import simulate

BATCH = 1000  # runs simulated at a time, to bound the memory used


@short_repr
@dataclass(frozen=True, eq=False)
class FlightEnvelope:
    """Some simulated runs of one controller or method, and the envelope of all of them.

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
    modes : ndarray of int, shape (cells,) or (r, N)
        Mode of every step, or of every run after each node: 0 is S, 1, 2, ... U, -1 a filtered input.
    nearest : ndarray, shape (3, N+1)
        Distance to the nearest unsafe set [m]: least, mean and largest over all runs.
    input_range : ndarray, shape (2, N, m), or None
        Least and largest input over all runs, of a controller.
    """

    controller: str
    labels: tuple[str, ...]
    times: Array
    states: Array
    inputs: Array
    modes: NDArray[np.int_]
    nearest: Array
    input_range: Array | None = None


@short_repr
@dataclass(frozen=True, eq=False)
class ControllerRuns:
    """Runs of one controller.

    Attributes
    ----------
    metrics : Metrics
        Of all its runs.
    flights : FlightEnvelope
        Some of the runs, and the envelope of all.
    """

    metrics: Metrics
    flights: FlightEnvelope


def alone_key(mode: int) -> str:
    """Return the key of an experimental controller alone: ``experimental``, ``experimental_2``, ..."""
    return "experimental" if mode == 1 else f"experimental_{mode}"


def fly_nominal(schedule: Schedule, mode: int | None, name: str) -> FlightEnvelope:
    """One run from the centre of the initial set, undisturbed."""
    runs = simulate(schedule, 1, mode=mode, initial="center", disturbance="none", substeps=2)
    nearest, inputs = evaluate(runs, controller=name).nearest, runs.inputs
    ranges = np.concatenate([inputs, inputs])
    return FlightEnvelope(name, ("nominal",), runs.times, runs.states, inputs, runs.modes, nearest, ranges)


def compare(
    schedule: Schedule, n: int = 100, seed: int = 0, progress: Callable[[int, int], None] | None = None
) -> dict[str, ControllerRuns]:
    """Fly S alone, each U alone and Polaris n times each.

    Parameters
    ----------
    schedule : Schedule
        Result of `synthesize`.
    n : int
        Runs per controller: half from corners of the initial set, half under worst-case disturbances, none
        with a fault that is isolated late, as what they are shown beside is claimed of flights without.
    seed : int
        Same seed, same runs.
    progress : callable, optional
        Called with (runs flown, runs in all).

    Returns
    -------
    dict
        By ``safety``, ``experimental`` (the preferred one), ``experimental_2`` and so on, ``polaris``.
    """
    of_kind("schedule", schedule, Schedule, "polaris.synthesize")
    alone = {alone_key(mode): mode for mode in range(1, len(schedule.controllers))}
    plans: dict[str, int | None] = {"safety": 0, **alone, "polaris": None}
    out: dict[str, ControllerRuns] = {}
    for done, (key, mode) in enumerate(plans.items()):
        name = key if mode is None else schedule.controllers[mode].name
        nominal = fly_nominal(schedule, mode, name)
        parts: list[Metrics] = []
        lowest, highest = [], []
        for first in range(0, n, BATCH):
            if progress:
                progress(done * n + first, len(plans) * n)
            runs = simulate(schedule, min(BATCH, n - first), seed + first, mode=mode, disturbance="mixed")
            metrics = evaluate(runs, seed + first, name)
            worst = metrics.worst
            if not parts:
                labels = [i for i in range(min(3, len(runs.states))) if i != worst]
                others = runs.some(labels)
            if not parts or metrics.min_distance[worst] < min(part.min_distance.min() for part in parts):
                closest = runs.some([worst])
            parts.append(metrics)
            lowest.append(runs.inputs.min(axis=0))
            highest.append(runs.inputs.max(axis=0))
        joined = Metrics.join(parts)
        flights = FlightEnvelope(
            name,
            ("nominal", "closest", *(f"run {i}" for i in labels)),
            nominal.times,
            np.concatenate([nominal.states, closest.states, others.states]),
            np.concatenate([nominal.inputs, closest.inputs, others.inputs]),
            nominal.modes,
            joined.nearest,
            np.stack([np.min(lowest, axis=0), np.max(highest, axis=0)]),
        )
        out[key] = ControllerRuns(joined, flights)
    return out
