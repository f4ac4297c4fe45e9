"""Schedules that rest on samples: how surely the commands of black boxes keep to their bands.

Everything is decided first: modes, sets, margins. Then flights that nothing was fitted to are drawn, and how
many of them leave any band is held against the asked probability by the exact binomial bound.
"""

from bisect import bisect_left
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reach.short_repr import short_repr

from ..model.checks import number
from ..model.errors import ScenarioError
from ..model.system import Array
from ..synthesis.controllers.black_box import Ask, BlackBox, FittedSegment, SampledBound
from ..synthesis.controllers.controllers import Controller
from ..synthesis.safety.get_safety import Safety, get_safety
from ..synthesis.schedule.schedule import Schedule
from ..synthesis.schedule.synthesize import synthesize
from .falsification.search import Falsification, falsify
from .run_metrics import Runs
from .simulate import simulate

ATTEMPTS = 4  # how often wider bands are tried, with other flights each, before no statement is made
WIDEN = 1.6  # by how much they are wider each time
SPARE = 8  # flights that may leave a band without a further attempt: what they cost is more flights
MOST = 10_000_000  # no more flights than this are ever drawn for a statement
BATCH = 1000  # flights at a time
FEW = slice(7, None, -1)  # of a batch, those about which boxes are asked on their own
ROUNDED = 1e-6  # by how much commands may be off then, as a share of the limits


@short_repr
@dataclass(frozen=True, eq=False)
class SampledSchedules:
    """Schedules of a scenario with black boxes, proven and sampled.

    Attributes
    ----------
    schedule : Schedule
        With the boxes, its guarantee ``statistical``; `proven` itself where no statement could be made.
    proven : Schedule
        With anything within the thrust limits in place of the boxes.
    worst : Falsification or None
        The worst that a search found with the boxes; None where none of them flies.
    adverse : float
        Share of flights from corners of the initial set under worst-case disturbances that leave a band:
        what the statement, which is about flights drawn at random, says nothing of.
    repeats : bool
        Whether the first flights come out the same when they are flown again, and a few of them when the
        boxes are asked about these alone: if not, they answer by chance, drift, or mix up flights.
    """

    schedule: Schedule
    proven: Schedule
    worst: Falsification | None
    adverse: float = 0.0
    repeats: bool = True


def flights_needed(probability: float, risk: float) -> int:
    """Least number of flights of which more than `SPARE` would leave a band, but for a chance of `risk`."""
    from scipy.stats import binom  # takes long to load

    return bisect_left(range(MOST), True, SPARE + 1, key=lambda n: binom.cdf(SPARE, n, probability) <= risk)


def at_most(outside: int, flights: int, risk: float) -> float:
    """Upper bound on a probability (Clopper and Pearson 1934), wrong with one of at most `risk`."""
    from scipy.stats import beta  # takes long to load

    return 1.0 if outside >= flights else float(beta.ppf(1 - risk, outside + 1, flights - outside))


def outside(runs: Runs) -> NDArray[np.float64]:
    """Return how far each flight leaves the bands of its boxes, at its worst, shape (R,); outside above 1."""
    schedule, excess = runs.schedule, np.zeros(len(runs.states))
    q = schedule.safety.tracking.feedback.nodes_per_cell
    system = schedule.safety.problem.system
    offset = system.state_offset_at_nodes * bool(
        system.timing.carried_impulse
    )  # bands are about errors without that
    arcs = schedule.safety.reference.fine(q)
    for step in schedule.steps:
        if isinstance(step.tube, FittedSegment):
            part = slice(step.k * q, (step.k + 1) * q)
            errors = runs.states[:, part] - arcs[step.k, :-1]
            excess = np.maximum(excess, step.tube.outside(errors, runs.inputs[:, part], offset))
    return np.asarray(excess)


def _drawn(schedule: Schedule, n: int, seed: int) -> Runs:
    """Flights from the distribution that the statement is about."""
    return simulate(schedule, n, seed, initial="random", disturbance="random")


def _repeats(first_runs: Runs, seed: int) -> bool:
    """Return True if flights come out the same again, and with boxes asked about few, the last first."""
    schedule, limits = first_runs.schedule, first_runs.schedule.safety.tracking.system.u_max
    h = schedule.safety.tracking.flow.h

    def only_few(ask: Ask) -> Ask:
        def asked(t: float, x: Array, xi: Array) -> Any:
            u = first_runs.inputs[:, round(t / h)].copy()
            u[FEW] = ask(t, x[FEW], xi)
            return u

        if hasattr(ask, "reset"):
            setattr(asked, "reset", lambda runs: ask.reset(len(range(runs)[FEW])))  # noqa: B010
        return asked

    repeat = _drawn(schedule, len(first_runs.states), seed)
    laws = (
        replace(law, ask=only_few(law.ask)) if isinstance(law, BlackBox) else law
        for law in schedule.controllers
    )
    few = _drawn(replace(schedule, controllers=tuple(laws)), len(first_runs.states), seed)
    deviation = np.abs(few.inputs - first_runs.inputs)  # a product over fewer rows may round otherwise
    return np.array_equal(first_runs.inputs, repeat.inputs) and bool(np.all(deviation <= ROUNDED * limits))


def with_boxes(
    scenario: Any,
    boxes: Mapping[str, Ask | None],
    safety: Safety | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> SampledSchedules:
    """`synthesize_sampled` as a scenario wants it, with the functions of its black boxes by their names."""
    scenario.check_black_boxes(boxes)
    safety = get_safety(scenario) if safety is None else safety
    laws = scenario.controllers(safety, boxes)
    return synthesize_sampled(scenario, safety, laws, **scenario.asked, progress=progress)


def synthesize_sampled(
    scenario: Any,
    safety: Safety,
    experimental: Sequence[Controller],
    *,
    probability: float = 0.01,
    confidence: float = 0.999,
    seed: int = 0,
    attacks: int = 1000,
    progress: Callable[[int, int], None] | None = None,
) -> SampledSchedules:
    """Schedules of controllers some of which are black boxes: one by samples, and the proven one beside it.

    Parameters
    ----------
    scenario, safety, experimental, progress
        As in `synthesize`.
    probability : float
        With which a flight may leave a band in any step that a box flies.
    confidence : float
        Of the statement that it is no more; over the samples.
    seed : int
        Of the samples.
    attacks : int
        Flights of the search for the worst.

    Raises
    ------
    ScenarioError
        If probability or confidence is not between 0 and 1; and as `synthesize` raises.

    Notes
    -----
    The doubt ``1 - confidence`` is shared out among the attempts: a half to the first, a quarter to the
    second, and so on, so that the statement holds though later attempts depend on earlier samples.
    """
    for name, value in (("probability", probability), ("confidence", confidence)):
        if not 0 < number(name, value) < 1:
            raise ScenarioError(name, value, "must be > 0 and < 1")
    models = [law.anything if isinstance(law, BlackBox) else law for law in experimental]
    proven = synthesize(scenario, safety, models, progress=progress, recourse=True)
    risk, laws = 1 - confidence, list(experimental)
    for attempt in range(ATTEMPTS):
        schedule, risk = synthesize(scenario, safety, laws, progress=progress), risk / 2
        if not schedule.sampled_steps:
            return SampledSchedules(schedule if schedule.share() > proven.share() else proven, proven, None)
        flights, outliers = flights_needed(probability, risk), 0
        for first in range(0, flights, BATCH):
            drawn = seed + MOST * (attempt + 1) + first  # no two attempts share flights
            runs = _drawn(schedule, min(BATCH, flights - first), drawn)
            outliers += int(np.count_nonzero(~(outside(runs) <= 1)))
            if not first:
                first_runs = runs
        bound = at_most(outliers, flights, risk)
        if bound <= probability:
            statement = SampledBound(bound, confidence, flights, outliers, seed, attempt + 1)
            schedule = replace(schedule, sampled_bound=statement)
            hostile = simulate(schedule, min(attacks, BATCH), seed, initial="corners", disturbance="worst")
            adverse = float(np.mean(~(outside(hostile) <= 1)))
            repeats = _repeats(first_runs, seed + MOST * (attempt + 1))
            return SampledSchedules(schedule, proven, falsify(schedule, attacks, seed), adverse, repeats)
        laws = [replace(law, wider=law.wider * WIDEN) if isinstance(law, BlackBox) else law for law in laws]
    return SampledSchedules(proven, proven, None)
