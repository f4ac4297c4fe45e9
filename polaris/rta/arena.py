"""Every method on the same scene: same reference, same disturbances, same experimental controller."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from ..model.checks import of_kind, whole
from ..model.errors import PolarisError, ScenarioError
from ..synthesis.schedule import Schedule
from .alone import Alone, Precomputed
from .asif_explicit import ExplicitASIF
from .asif_implicit import ImplicitASIF
from .flight import Conditions, Flight, fly
from .lookahead import ForwardReachability, Simulation
from .method import Method
from .monitor import Monitor
from .outcome import Outcome, flown, measure
from .scene import Scene
from .simplex import ExplicitSimplex, ImplicitSimplex

BATCH = 100
"""Runs flown at a time, to bound the memory used."""

METHODS: dict[str, Callable[..., Method]] = {
    "safety": lambda scene: Alone(scene, 0),
    "experimental": lambda scene: Alone(scene, 1),
    "schedule": Precomputed,
    "monitor": Monitor,
    "monitor_declared": partial(Monitor, trust="declared"),
    "simplex_explicit": ExplicitSimplex,
    "simplex_implicit": ImplicitSimplex,
    "asif_explicit": ExplicitASIF,
    "asif_implicit": ImplicitASIF,
    "simulation": Simulation,
    "reachability": ForwardReachability,
}
"""How each method is made for a scene, by its name on the command line."""

TUNING = {
    "monitor": "dwell",
    "monitor_declared": "dwell",
    "asif_explicit": "alpha",
    "asif_implicit": "slope",
    "simulation": "horizon",
    "reachability": "horizon",
}
"""What may be tuned, by method; the others have nothing of the kind."""

Tuning = Mapping[str, float]

SHOWN = 3
"""Runs per method kept for pictures."""


@dataclass(frozen=True, eq=False)
class Shown:
    """Some flights of one method, for pictures.

    Attributes
    ----------
    labels : tuple of str
        ``closest``, ``run 0``, ...
    times : ndarray, shape (N+1,)
    states : ndarray, shape (r, N+1, n)
    inputs : ndarray, shape (r, N, m)
    modes : ndarray of int, shape (r, N)
        0 is S, 1, 2, ... U, -1 a filtered input.
    nearest : ndarray, shape (3, N+1)
        Least, mean and largest distance over all runs [m].
    decisions : list of dict
        Those of the run closest to an unsafe set: time, mode, margin, reason.
    """

    labels: tuple[str, ...]
    times: Any
    states: Any
    inputs: Any
    modes: Any
    nearest: Any
    decisions: list[dict[str, Any]]


@dataclass(frozen=True, eq=False)
class Comparison:
    """All methods on one scene.

    Attributes
    ----------
    scene : Scene
    runs, seed : int
    outcomes : dict of str to Outcome
        By method.
    shown : dict of str to Shown
    refused : dict of str to str
        Methods that the scene does not admit, and why.
    """

    scene: Scene
    runs: int
    seed: int
    outcomes: dict[str, Outcome]
    shown: dict[str, Shown]
    refused: dict[str, str]

    def paired(self, reference: str = "schedule") -> list[dict[str, Any]]:
        """Differences of every method to one of them, run by run."""
        if reference not in self.outcomes:
            return []
        other = self.outcomes[reference]
        return [row for key, one in self.outcomes.items() if key != reference for row in one.against(other)]


def compare_methods(
    schedule: Schedule,
    runs: int = 50,
    seed: int = 0,
    *,
    methods: Sequence[str] = tuple(METHODS),
    period: float | None = None,
    latency: float = 0.0,
    half_widths: Any = 0.0,
    tuning: Tuning | None = None,
    progress: Callable[[str, int, int], None] | None = None,
) -> Comparison:
    """Fly every method under the same conditions.

    Parameters
    ----------
    schedule : Schedule
        Result of `synthesize`, with an experimental controller.
    runs, seed : int
        Number of runs, and what their conditions are drawn from (`Conditions.draw`).
    methods : sequence of str
        Keys of `METHODS`.
    period, latency : float
        Between decisions, and from measurement to effect [s]; see `Scene.of`.
    half_widths : array_like
        Largest error of the state estimate.
    tuning : mapping of str to float, optional
        Values by ``method.option``: ``monitor.dwell`` and ``monitor_declared.dwell`` [decisions],
        ``asif_explicit.alpha`` [1/s], ``asif_implicit.slope``, ``simulation.horizon`` and
        ``reachability.horizon`` [s]. The defaults are those of the methods.
    progress : callable, optional
        Called with (method, decisions flown, decisions in all).

    Raises
    ------
    ScenarioError
        If a method has no such name or option, or the scene does not fit the options.
    """
    of_kind("schedule", schedule, Schedule, "polaris.synthesize")
    whole("runs", runs, 1)
    for key in methods:
        if key not in METHODS:
            raise ScenarioError("methods", key, f"must be one of {', '.join(METHODS)}")
    options = _options(tuning or {})
    if len(schedule.controllers) < 2:
        raise ScenarioError("experimental", "none", "a comparison needs an experimental controller")
    scene = Scene.of(schedule, period, latency, half_widths)
    parts = [
        Conditions.draw(scene, min(BATCH, runs - first), seed + first) for first in range(0, runs, BATCH)
    ]
    outcomes, shown, refused = {}, {}, {}
    for key in dict.fromkeys(methods):
        begun = time.perf_counter()
        try:
            method = METHODS[key](scene, **options.get(key, {}))
        except PolarisError as error:
            if isinstance(error, ScenarioError) and error.field in options.get(key, {}):
                raise
            refused[key] = str(error)
            continue
        built = time.perf_counter() - begun

        def report(done: int, total: int, key: str = key) -> None:
            if progress:
                progress(key, done, total)

        outcomes[key], shown[key] = _flown(scene, key, method, parts, built, report)
    return Comparison(scene, runs, seed, outcomes, shown, refused)


def _options(tuning: Tuning) -> dict[str, dict[str, float]]:
    """Options by method."""
    out: dict[str, dict[str, float]] = {}
    for name, value in tuning.items():
        key, _, option = name.partition(".")
        if TUNING.get(key) != option:
            known = ", ".join(f"{one}.{other}" for one, other in TUNING.items())
            raise ScenarioError("tuning", name, f"must be one of {known}")
        whole_number = option == "dwell" and float(value).is_integer()
        out[key] = {option: int(value) if whole_number else value}
    return out


def _flown(
    scene: Scene,
    key: str,
    method: Method,
    parts: Sequence[Conditions],
    built: float,
    progress: Callable[[int, int], None],
) -> tuple[Outcome, Shown]:
    """Fly one method in all conditions, and once alone to time its decisions."""
    found, deviations, counts, kept = [], [], np.zeros(len(method.reasons), dtype=int), None
    for conditions in parts:
        flight = fly(scene, method, conditions, progress)
        metrics = measure(scene, flight, conditions, method.name)
        if kept is None or metrics.min_distance.min() < kept[1].min_distance.min():
            kept = flight, metrics
        found.append(metrics)
        deviations.append(flight.deviation)
        counts += np.bincount(flight.why.ravel(), minlength=len(counts))
    seconds = fly(scene, method, parts[0].only(0)).seconds
    outcome = Outcome(
        key,
        method.name,
        method.claim,
        type(found[0]).join(found),
        np.concatenate(deviations),
        (float(np.median(seconds)), float(np.percentile(seconds, 99))),
        _synthesis(scene, key) + built,
        dict(zip(method.reasons, counts.tolist(), strict=True)),
        dict(getattr(method, "settings", {})),
    )
    assert kept is not None
    return outcome, _show(scene, method, *kept, nearest=outcome.metrics.nearest)


def _show(scene: Scene, method: Method, flight: Flight, metrics: Any, nearest: Any) -> Shown:
    worst = metrics.worst
    chosen = [worst, *(run for run in range(len(flight.states)) if run != worst)][: 1 + SHOWN]
    who = flown(scene, flight)
    decisions = [
        {
            "t": k * scene.period,
            "mode": int(who[worst, min(k * scene.nodes + scene.delay, who.shape[1] - 1)]),
            "margin": float(flight.margins[worst, k]) if np.isfinite(flight.margins[worst, k]) else None,
            "reason": method.reasons[int(flight.why[worst, k])],
        }
        for k in range(scene.decisions)
    ]
    labels = ("closest", *(f"run {run}" for run in chosen[1:]))
    return Shown(
        labels,
        flight.times,
        flight.states[chosen],
        flight.inputs[chosen],
        who[chosen],
        nearest,
        decisions,
    )


def _synthesis(scene: Scene, key: str) -> float:
    """Wall time of what the method needs of the two algorithms [s]."""
    seconds = scene.schedule.seconds
    if key == "experimental":
        return 0.0
    return sum(spent for stage, spent in seconds.items() if key == "schedule" or stage != "schedule")
