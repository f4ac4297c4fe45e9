"""Faults until they are isolated: boxes of their effects on the states, and a check that all are stated."""

from collections.abc import Sequence
from math import ceil
from typing import Any

from flint import arb, arb_mat

from ..files.document import ROUNDED, Document
from ..kernel.balls import (
    above,
    absolute,
    beside,
    column,
    diagonal,
    exponential,
    identity,
    largest,
    magnitude,
    matrix,
    maxima,
    smallest,
    sums,
)
from ..kernel.motion import Plant
from ..kernel.verdict import Rejected
from .craft.craft import Craft
from .craft.observer import ObserverErrors
from .craft.settling import Settling
from .craft.states import craft_of, remembers
from .craft.tightening import Differences, Tightening, difference_along
from .networks import FOLDED, Policy, Weights
from .plants import WHOLE
from .timing import carry_offset, predicted


def check_transients(document: Document, scenario: dict[str, Any]) -> None:
    """Check that each late fault of the scenario is told: for how long, and how far inputs are off."""
    faults = [fault for fault in scenario.get("faults", []) if _lasts(fault) > 0]
    specified = [(fault["kind"], _lasts(fault)) for fault in faults]
    claimed = [(each["name"], each["lasts"]) for each in document.transients]
    if claimed != specified:
        raise Rejected(
            "system", f"faults isolated late are {claimed} in the certificate, {specified} in the scenario"
        )
    for fault, each in zip(faults, document.transients, strict=True):
        is_outage, pushes = fault["kind"] == "navigation_lost", each.get("pushes") or []
        if is_outage == bool(pushes):
            raise Rejected("system", f"{fault['kind']} belongs to thrusters, or to none")
        layout = document.allocation or {"directions": [], "limits": []}
        thrusters = [] if is_outage else zip(layout["directions"], layout["limits"], strict=True)
        turns = len(document.u_max) if document.pulse_place == "staggered" and not layout.get("layout") else 1
        for direction, limit in thrusters:
            thrust = arb(limit) * arb(fault.get("share", 1.0)) * turns * (1 - ROUNDED)
            needed = [abs(x) * thrust for x in direction]
            if not any(all(x >= y for x, y in zip(push, needed, strict=True)) for push in pushes):
                raise Rejected("system", f"what {fault['kind']} does to a thruster is not covered")


def _lasts(fault: dict[str, Any]) -> float:
    return float(fault["lasts_s"] if fault["kind"] == "navigation_lost" else fault.get("isolation_s", 0.0))


def check_attribution(
    document: Document, stored: list[dict[str, Any]] | None, limits: set[str]
) -> list[dict[str, Any]] | None:
    """Check the fault attribution: steps of S, names and times that exist; shortfalls are no claims."""
    laws, delta = {law.name for law in document.laws[1:]}, document.delta
    for row in (row for fault in stored or [] for row in fault["steps"]):
        k, time = row["step"], row["limit_time_s"]
        if not (k < document.steps and document.modes[k] == 0 and row["controller"] in laws):
            raise Rejected("schedule", f"step {k} must be flown by S in place of another controller")
        if row["limit"] not in limits or row["shortfall"] != row["tightening"] - row["clearance"]:
            raise Rejected("schedule", f"in step {k} {row['limit']} is not the limit that is exceeded")
        if row["t_s"] != k * delta or time < 0 or row["limit_step"] != int(time / delta + 1e-9):
            raise Rejected("schedule", f"step {k} neither begins nor ends at that time")
    faults = [(each["name"], each["lasts"]) for each in document.transients]
    if faults != [(fault["fault"], fault["lasts_s"]) for fault in stored or []]:
        raise Rejected("schedule", f"steps of the fault attribution name faults other than {faults}")
    return stored


def wrong_thrust(document: Document, craft: Craft, networks: list[Policy]) -> list[arb_mat]:
    """Return bounds on the change of the loop state by each kind of wrong thrust, (N, 1) each.

    They hold at the node where S takes over, until no command rests on an older state, and for states of the
    plant also in the period before. A black box may answer with any command, a law with its steepest gain.
    Commands that are made without the thruster take effect as late as any do.
    """
    plant, changes = craft.plant, list[arb_mat]()
    gains = [absolute(matrix(law.gain)) for law in document.laws if law.gain is not None]
    gains += [_steepest(policy) for policy in networks if document.transients]
    any_u = any(law.kind == "black_box" for law in document.laws)
    gain = None if any_u else arb_mat(plant.B.ncols(), plant.A.nrows(), maxima(*(K.entries() for K in gains)))
    delay, missed = document.timing.get("delay", 0.0), document.timing.get("missed", 0)
    latency = 0 if remembers(document) else _periods(plant, delay) + missed
    for fault in (each for each in document.transients if each.get("pushes")):
        lasts = fault["lasts"] + document.timing.get("jitter", 0.0) + document.timing.get("edge", 0.0)
        count, lasts = _periods(plant, lasts), arb(lasts)
        first, later = list[arb_mat](), list[arb_mat]()  # by periods since: of errors, and of commands beside
        partial, power = craft.last(lasts - (count - 1) * plant.h), identity(craft.free.nrows())
        while len(first) < count + latency:
            rows = above(power, craft.sees * power)
            first.append(magnitude(partial.thrust_gains(rows)))
            later.append(magnitude(beside(rows * craft.held_map, craft.thrust_gains(rows))))
            power = power * craft.free
        for push in fault["pushes"]:
            size = [arb(x) for x in push]
            errors = sums(size, plant.thruster_part(size)[: len(size)])
            wrong = column([*errors, *[arb(0)] * (plant.entering.ncols() - len(errors))])
            changes.append(_spread(craft, gain, (first, later), wrong, count))
    return changes


def _spread(
    craft: Craft, gain: arb_mat | None, gains: tuple[list[arb_mat], ...], wrong: arb_mat, count: int
) -> arb_mat:
    """Return the change of the loop state by inputs that are wrong by `wrong` (m, 1) in some periods.

    `gain` bounds the answer of any law to what it sees, and twice the limits do; they alone without it.
    """
    plant, n, N = craft.plant, craft.plant.A.nrows(), craft.free.nrows()
    size, limits = absolute(plant.A), column([2 * top for top in plant.u_max])
    growth, integral = (size * plant.h).exp(), exponential(size, plant.h)[1]
    command_gain, error_gain = integral * absolute(plant.B), integral * absolute(plant.entering)
    z, inputs, bounds = arb_mat(N + n, 1), list[arb_mat](), list[list[arb]]()
    for i, first in enumerate(gains[0]):
        answer = limits if gain is None else magnitude(gain * column(z.entries()[N:]))
        limited = [smallest(pair) for pair in zip(answer.entries(), limits.entries(), strict=True)]
        command = column(limited) * int(i > 0)  # the first one is made before the fault
        error = plant.every_table * command + wrong * int(i < count)
        inputs.append(above(command, error))
        within = growth * column(z.entries()[:n]) + command_gain * command + error_gain * error
        z = magnitude(sum((gains[1][i - q] * inputs[q] for q in range(1, i + 1)), first * wrong))
        if i + 1 >= count:
            bounds += [z.entries()[:N], craft.lifted(within).entries()]
    return column(_peak(bounds))


def _steepest(policy: Policy) -> arb_mat:
    """Largest size of every entry of its derivative by the state, rounding in proportion to it included."""
    model = policy.rounding
    factors = [arb(1) if model is None else 1 + model.relative(count) for count in (3, 2)]
    M, nonlinear = policy.reads * factors[0], model is not None
    M = absolute(M) if nonlinear else M
    for layer in policy.layers:
        if isinstance(layer, Weights):
            M = (layer.size if nonlinear else layer).times(M)
            if model is not None and layer is not policy.layers[-1]:
                M = M * (1 + model.relative(layer.terms + FOLDED))
        else:
            M, nonlinear = absolute(M) * (factors[1] * layer.steepest), True
    return absolute(M)


def _periods(plant: Plant, time: float) -> int:
    """Periods that a time touches at most."""
    return ceil(float((arb(time) / plant.h).mid()) * (1 - WHOLE))


def _peak(lists: list[list[arb]]) -> list[arb]:
    """Return the largest of each entry."""
    return [largest(each).upper() for each in zip(*lists, strict=True)]


def outage_differences(document: Document, craft: Craft, settling: Settling) -> list[Differences]:
    """Return the differences of the loop state by each loss of navigation; at most one loss occurs."""
    outages = [each["lasts"] for each in document.transients if not each.get("pushes")]
    if document.observer is not None and remembers(document):
        return [_unmade(document, craft, _periods(craft.plant, lasts)) for lasts in outages]
    boxed = _predicted if document.observer is None else _unlearned
    boxes = (boxed(document, craft, settling, lasts) for lasts in outages)
    return [[(diagonal(box), arb_mat(len(box), 0))] for box in boxes]


def _predicted(document: Document, craft: Craft, settling: Settling, lasts: float) -> list[arb]:
    """Return errors of predictions while navigation is lost, and the rest of the first estimate's."""
    plant, n = craft.plant, craft.plant.A.nrows()
    age = arb(lasts) + document.timing.get("delay", 0.0)
    age += plant.h * (2 * document.timing.get("missed", 0) + 1)
    estimate = column(document.estimate or [0.0] * n)
    first = column(_peak([estimate.entries(), (magnitude(plant.open.phi) * estimate).entries()]))
    measured = sums(map(arb, document.measured_error or [0.0] * n), map(arb, document.state_offset))
    return sums(
        predicted(plant, measured, age),
        Tightening(craft, settling, identity(n)).tightening_at_any_time(first),
    )


def _unlearned(document: Document, craft: Craft, settling: Settling, lasts: float) -> list[arb]:
    """Bound, by a box, the change of the state by estimates of an observer that misses an outage.

    They are compared with those it would have made if only as many periods had been missed as may be, with
    measurements as close to what it expects as their errors allow.
    """
    plant, filtering, count = (
        craft.plant,
        ObserverErrors.from_document(document, craft.plant),
        settling.periods,
    )
    n, late, observer = plant.A.nrows(), filtering.late, document.observer or {}
    M, noise = absolute(matrix(observer["measures"])), column(observer["noise"])
    measured = sums(map(arb, document.measured_error or [0.0] * n), map(arb, document.state_offset))
    errors = [M * column(predicted(plant, measured, plant.h * each.periods)) for each in filtering.updates]
    pairs = list(zip((each.gain for each in filtering.updates), errors, strict=True))
    excess = [column([largest((x, arb(0))) for x in (y - noise).entries()]) for y in errors]
    each = column(maxima(*((absolute(L) * y).entries() for (L, _), y in zip(pairs, excess, strict=True))))
    transitions = [exponential(plant.A, plant.h * (j + 1))[0] for j in range(late + 1)]
    gap, missing = arb_mat(n, 1), _periods(plant, lasts) + 2 * late
    for _ in range(missing // (late + 1)):
        gap = magnitude(transitions[-1]) * gap + each
    rest = filtering.updates[-1].rest
    first = maxima(*((magnitude(rest * step) * gap).entries() for step in transitions))
    other = maxima(*((absolute(L - pairs[-1][0]) * (y + noise)).entries() for L, y in pairs))
    decay = filtering.fading(sums(first, other), document)
    for i in range(len(decay) - 2, -1, -1):
        decay[i] = maxima(decay[i], decay[i + 1])
    delay = arb(document.timing.get("delay", 0.0))
    ages = (absolute(exponential(plant.A, delay + plant.h * j)[0]).entries() for j in range(late + 1))
    carried = arb_mat(n, n, maxima(*ages))
    gaps = [maxima(decay[0], gap.entries())] * (missing - late) + [decay[0]] * late + decay
    deviations = [(carried * column(gaps[min(i, len(gaps) - 1)])).entries() for i in range(count)]
    tightenings = Tightening(craft, settling, identity(n))
    older, intersample = tightenings.response(deviations, True)
    return sums(maxima(*tightenings.noise.summed(deviations)), older, intersample, deviations[0])


def _unmade(document: Document, craft: Craft, count: int) -> Differences:
    """Return the difference that up to `count` updates in a row make which an observer does not make.

    The other flight has the same disturbances and errors, and measures meanwhile as exactly as what is
    constant in its errors lets it. They differ first in the update after a node at which the observer's error
    is within its bounds.
    """
    plant, blind = craft.plant, craft_of(document, craft.plant, craft.gain, observing=False)
    error = sums(map(arb, document.measured_error), carry_offset(plant))
    n, box = len(error), [*craft.box[: -len(error)], *error]
    start = above(arb_mat(n, len(box)), diagonal(box))
    pushes = plant.thruster_error(plant.u_max)
    gains = [beside(*each.added(pushes)[1:]) for each in (craft, blind)]  # measurements are the first
    noise = craft.samples[0]
    if noise.constant:
        sizes = [largest([arb(0), 2 * x - size]) for x, size in zip(noise.constant, noise.size, strict=True)]
        inexact = noise.adds * diagonal(sizes)
        gains = [beside(gains[0], inexact), beside(gains[1], inexact * 0)]
    first = second = identity(n + len(box))
    pairs = []
    for _ in range(count):
        noise_gain = second * gains[1] - first * gains[0]
        first, second = craft.F * first, blind.F * second
        pairs.append((noise_gain, (second - first) * start))
    return pairs


def transient_tightening(
    tightenings: Tightening, boxes: list[arb_mat], others: Sequence[Differences] = ()
) -> list[list[arb]]:
    """Return tightenings along rows for boxes or differences of two flights, by the end of a period.

    That is the period after node l + 1, the state being added up to two periods after a hand-over.
    """
    worst, steps = [arb(0)] * tightenings.rows.nrows(), list[list[arb]]()
    bounds = [difference_along(identity(tightenings.carried[0].ncols()), each) for each in others]
    steady = [
        tightenings.tightening_after_settling(each) for each in (*boxes, *(column(each) for each in bounds))
    ]
    for lag in range(len(tightenings.carried)):
        at_lag = [tightenings.boxed(box, lag) for box in boxes] + [
            tightenings.difference(each, lag) for each in others
        ]
        worst = _peak([worst, *steady, *at_lag])
        steps.append(worst)
    last = len(steps) - 1
    return [steps[min(lag + 2, last)] for lag in range(last + 1)]
