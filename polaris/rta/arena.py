"""Every method on the same scene: same references to choose from, same disturbances, same U."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from reach.short_repr import short_repr

from ..model.checks import one_of, whole
from ..model.errors import PolarisError, ScenarioError
from ..model.system import Array
from ..simulation.baselines import FlightEnvelope
from ..simulation.metrics import Metrics, finite
from ..simulation.on_board import FlightCode
from ..synthesis.schedule.schedule import Schedule
from .decision_grid import DecisionGrid
from .flight import Conditions, Flight, fly
from .method import Method
from .method_result import MethodResult, executed_modes, measure
from .methods import METHODS

BATCH = 100  # runs flown at a time, to bound the memory used

Tuning = Mapping[str, float]

CODED = "code", "monitor_code"
"""Methods that take flight code."""

SHOWN = 3  # runs per method kept for pictures


@short_repr
@dataclass(frozen=True, eq=False)
class Comparison:
    """All methods on one scene.

    Attributes
    ----------
    grid : DecisionGrid
    runs, seed : int
    results : dict of str to MethodResult
        By method; experimental controllers alone are ``experimental``, ``experimental_2``, ...
    shown : dict of str to FlightEnvelope
        Some flights of every method, for pictures: the closest to a set, ``run 0``, ...
    decisions : dict of str to list of dict
        Of the run closest to a set: time, mode, margin, reason.
    refused : dict of str to str
        Methods that the scene does not admit, and why.
    """

    grid: DecisionGrid
    runs: int
    seed: int
    results: dict[str, MethodResult]
    shown: dict[str, FlightEnvelope]
    decisions: dict[str, list[dict[str, Any]]]
    refused: dict[str, str]

    def paired(self, reference: str = "schedule") -> list[dict[str, Any]]:
        """Differences of every method to one of them, run by run."""
        if reference not in self.results:
            return []
        other = self.results[reference]
        return [row for key, one in self.results.items() if key != reference for row in one.against(other)]


def compare_methods(
    scene: Schedule | DecisionGrid,
    runs: int = 50,
    seed: int = 0,
    *,
    methods: Sequence[str] | None = None,
    tuning: Tuning | None = None,
    progress: Callable[[str, int, int], None] | None = None,
    code: FlightCode | None = None,
) -> Comparison:
    """Fly every method under the same conditions.

    Parameters
    ----------
    scene : Schedule or DecisionGrid
        With an experimental controller: result of `synthesize`, or of `DecisionGrid.from_schedule` where the
        time between decisions, the latency or the error of the state estimate are not the usual ones.
    runs, seed : int
        Number of runs, and what their conditions are drawn from (`Conditions.draw`).
    methods : sequence of str, optional
        Keys of `polaris.rta.method.METHODS`; default all, ``monitor_code`` with code alone.
    tuning : mapping of str to float, optional
        Values by ``method.option``, such as ``monitor.dwell`` (see `tunable`). The defaults are those of the
        methods.
    progress : callable, optional
        Called with (method, decisions flown, decisions in all).
    code : FlightCode, optional
        Flies as ``monitor_code`` if the online monitor is in it, else as ``code``.

    Raises
    ------
    ScenarioError
        If a method has no such name or option, the scene has no experimental controller, or the code is of
        another schedule.
    """
    grid = scene if isinstance(scene, DecisionGrid) else DecisionGrid.from_schedule(scene)
    whole("runs", runs, 1)
    keys, options = selected(methods, tuning)
    keys = [key for key in keys if methods is not None or code is not None or key != "monitor_code"]
    if len(grid.controllers) < 2:
        raise ScenarioError("experimental", "none", "must hold at least one controller for a comparison")
    parts = [Conditions.draw(grid, min(BATCH, runs - first), seed + first) for first in range(0, runs, BATCH)]
    results, envelopes, decisions, refused = {}, {}, {}, {}
    modes = [{"mode": mode} for mode in range(1, len(grid.controllers))]
    cases = [(key, one) for key in keys for one in (modes if key == "experimental" else [{}])]
    options |= {key: {"code": code} for key in CODED if code is not None}
    for key, extra in cases:
        start = time.perf_counter()
        method = _build_method(key, grid, options.get(key, {}) | extra)
        if isinstance(method, str):
            refused[key] = method
            continue
        built = _synthesis(grid, key) + time.perf_counter() - start
        report = partial(progress, key) if progress else None
        results[method.key], envelopes[method.key], decisions[method.key] = _fly_method(
            grid, method, parts, built, report
        )
    return Comparison(grid, runs, seed, results, envelopes, decisions, refused)


def _build_method(key: str, grid: DecisionGrid, options: Mapping[str, Any]) -> Method | str:
    """A method on the grid, or why it does not admit it; an option of its own that is wrong is raised."""
    try:
        return METHODS[key].on(grid, **options)
    except PolarisError as error:
        if isinstance(error, ScenarioError) and error.field in options:
            raise
        return str(error)


def tunable() -> list[str]:
    """Return the names of all tuning options, ``method.option`` each."""
    return [f"{key}.{option.name}" for key, one in METHODS.items() for option in one.options]


def selected(
    methods: Sequence[str] | None, tuning: Tuning | None
) -> tuple[list[str], dict[str, dict[str, Any]]]:
    """Return keys of the methods that are asked for, and options by method; refuse wrong names and values."""
    keys = list(dict.fromkeys(METHODS if methods is None else methods))
    for key in keys:
        one_of("methods", key, METHODS)
    out: dict[str, dict[str, Any]] = {}
    for name, value in (tuning or {}).items():
        one_of("tuning", name, tunable())
        key, _, option = name.partition(".")
        definition = next(one for one in METHODS[key].options if one.name == option)
        value = int(value) if definition.unit == "decisions" and float(value).is_integer() else value
        definition.check(name, value)
        out.setdefault(key, {})[option] = value
    return keys, out


def _fly_method(
    grid: DecisionGrid,
    method: Method,
    parts: Sequence[Conditions],
    synthesis_s: float,
    progress: Callable[[int, int], None] | None,
) -> tuple[MethodResult, FlightEnvelope, list[dict[str, Any]]]:
    """Fly one method in all conditions, and once alone to time its decisions."""
    collected: list[Metrics] = []
    deviations, counts, closest = [], np.zeros(len(method.reasons), dtype=int), None
    for conditions in parts:
        flight = fly(method.grid, method, conditions, progress)
        metrics = measure(method.grid, flight, conditions, method.name)
        if closest is None or metrics.min_distance.min() < min(one.min_distance.min() for one in collected):
            closest = flight, metrics.worst
        collected.append(metrics)
        deviations.append(flight.deviation)
        counts += np.bincount(flight.why.ravel(), minlength=len(counts))
    assert closest is not None
    seconds = fly(method.grid, method, parts[0].only(0)).seconds
    outcome = MethodResult(
        method.key,
        method.name,
        method.claim,
        Metrics.join(collected),
        np.concatenate(deviations),
        (float(np.median(seconds)), float(np.percentile(seconds, 99))),
        synthesis_s,
        dict(zip(method.reasons, counts.tolist(), strict=True)),
        method.settings,
    )
    return outcome, *_show(grid, method, *closest, outcome.metrics.nearest)


def _show(
    grid: DecisionGrid, method: Method, flight: Flight, worst: int, nearest: Array
) -> tuple[FlightEnvelope, list[dict[str, Any]]]:
    chosen = [worst, *(run for run in range(len(flight.states)) if run != worst)][: 1 + SHOWN]
    modes = executed_modes(grid, flight)
    decisions = [
        {
            "t": k * grid.period,
            "mode": int(modes[worst, min(k * grid.nodes + grid.delay, modes.shape[1] - 1)]),
            "margin": finite(flight.margins[worst, k]),
            "reason": method.reasons[int(flight.why[worst, k])],
        }
        for k in range(grid.decisions)
    ]
    labels = ("closest", *(f"run {run}" for run in chosen[1:]))
    paths = flight.states[chosen], flight.inputs[chosen], modes[chosen]
    return FlightEnvelope(method.key, labels, flight.times, *paths, nearest), decisions


def _synthesis(grid: DecisionGrid, key: str) -> float:
    """Wall time of the method's use of the two algorithms [s]."""
    seconds = grid.schedule.seconds
    if key == "experimental":
        return 0.0
    return sum(duration for stage, duration in seconds.items() if key == "schedule" or stage != "schedule")
