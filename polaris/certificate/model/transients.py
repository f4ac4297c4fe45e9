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
from .timing import carried_away, predicted


def check_transients(document: Document, scenario: dict[str, Any]) -> None:
    """Check that each late fault of the scenario is told: for how long, and how far inputs are off."""
    faults = [fault for fault in scenario.get("faults", []) if _lasts(fault) > 0]
    given = [(fault["kind"], _lasts(fault)) for fault in faults]
    stated = [(each["name"], each["lasts"]) for each in document.transients]
    if stated != given:
        raise Rejected(
            "system", f"faults isolated late are {stated} in the certificate, {given} in the scenario"
        )
    for fault, each in zip(faults, document.transients, strict=True):
        lost, pushes = fault["kind"] == "navigation_lost", each.get("pushes") or []
        if lost == bool(pushes):
            raise Rejected("system", f"{fault['kind']} belongs to thrusters, or to none")
        made = document.allocation or {"directions": [], "limits": []}
        thrusters = [] if lost else zip(made["directions"], made["limits"], strict=True)
        turns = len(document.u_max) if document.pulse_place == "staggered" and not made.get("layout") else 1
        for way, limit in thrusters:
            thrust = arb(limit) * arb(fault.get("share", 1.0)) * turns * (1 - ROUNDED)
            least = [abs(x) * thrust for x in way]
            if not any(all(x >= y for x, y in zip(push, least, strict=True)) for push in pushes):
                raise Rejected("system", f"what {fault['kind']} does to a thruster is not covered")


def _lasts(fault: dict[str, Any]) -> float:
    return float(fault["lasts_s"] if fault["kind"] == "navigation_lost" else fault.get("isolation_s", 0.0))


def check_attribution(
    document: Document, stored: list[dict[str, Any]] | None, limits: set[str]
) -> list[dict[str, Any]] | None:
    """Check the fault attribution: steps of S, names and times that exist; shortfalls are no claims."""
    laws, delta = {law.name for law in document.laws[1:]}, document.delta
    for row in (row for fault in stored or [] for row in fault["steps"]):
        k, at = row["step"], row["limit_time_s"]
        if not (k < document.steps and document.modes[k] == 0 and row["controller"] in laws):
            raise Rejected("schedule", f"step {k} must be flown by S in place of another controller")
        if row["limit"] not in limits or row["shortfall"] != row["tightening"] - row["clearance"]:
            raise Rejected("schedule", f"in step {k} {row['limit']} is not the limit that is exceeded")
        if row["t_s"] != k * delta or at < 0 or row["limit_step"] != int(at / delta + 1e-9):
            raise Rejected("schedule", f"step {k} neither begins nor ends at that time")
    known = [(each["name"], each["lasts"]) for each in document.transients]
    if known != [(fault["fault"], fault["lasts_s"]) for fault in stored or []]:
        raise Rejected("schedule", f"steps of the fault attribution name faults other than {known}")
    return stored


def wrong_thrust(document: Document, craft: Craft, networks: list[Policy]) -> list[arb_mat]:
    """Return bounds on the change of the loop state by each kind of wrong thrust, (N, 1) each.

    They hold at the node where S takes over, until no command rests on an older state, and for states of the
    plant also in the period before. A black box may answer with any command, a law with its steepest gain.
    Commands that are made without the thruster take effect as late as any do.
    """
    plant, added = craft.plant, list[arb_mat]()
    gains = [absolute(matrix(law.gain)) for law in document.laws if law.gain is not None]
    gains += [_steepest(policy) for policy in networks if document.transients]
    asked = any(law.kind == "black_box" for law in document.laws)
    gain = None if asked else arb_mat(plant.B.ncols(), plant.A.nrows(), maxima(*(K.entries() for K in gains)))
    delay, missed = document.timing.get("delay", 0.0), document.timing.get("missed", 0)
    hidden = 0 if remembers(document) else _periods(plant, delay) + missed
    for fault in (each for each in document.transients if each.get("pushes")):
        lasts = fault["lasts"] + document.timing.get("jitter", 0.0) + document.timing.get("edge", 0.0)
        count, lasts = _periods(plant, lasts), arb(lasts)
        first, later = list[arb_mat](), list[arb_mat]()  # by periods since: of errors, and of commands beside
        begun, power = craft.last(lasts - (count - 1) * plant.h), identity(craft.free.nrows())
        while len(first) < count + hidden:
            rows = above(power, craft.sees * power)
            first.append(magnitude(begun.thrust_gains(rows)))
            later.append(magnitude(beside(rows * craft.held_map, craft.thrust_gains(rows))))
            power = power * craft.free
        for push in fault["pushes"]:
            size = [arb(x) for x in push]
            off = sums(size, plant.thruster_part(size)[: len(size)])
            wrong = column([*off, *[arb(0)] * (plant.entering.ncols() - len(off))])
            added.append(_spread(craft, gain, (first, later), wrong, count))
    return added


def _spread(
    craft: Craft, gain: arb_mat | None, gains: tuple[list[arb_mat], ...], wrong: arb_mat, count: int
) -> arb_mat:
    """Return the change of the loop state by inputs that are wrong by `wrong` (m, 1) in some periods.

    `gain` bounds the answer of any law to what it sees, and twice the limits do; they alone without it.
    """
    plant, n, N = craft.plant, craft.plant.A.nrows(), craft.free.nrows()
    size, limits = absolute(plant.A), column([2 * top for top in plant.u_max])
    grown, over = (size * plant.h).exp(), exponential(size, plant.h)[1]
    pushed, off = over * absolute(plant.B), over * absolute(plant.entering)
    z, added, bounds = arb_mat(N + n, 1), list[arb_mat](), list[list[arb]]()
    for i, first in enumerate(gains[0]):
        answer = limits if gain is None else magnitude(gain * column(z.entries()[N:]))
        least = [smallest(pair) for pair in zip(answer.entries(), limits.entries(), strict=True)]
        command = column(least) * int(i > 0)  # the first one is made before the fault
        error = plant.every_table * command + wrong * int(i < count)
        added.append(above(command, error))
        within = grown * column(z.entries()[:n]) + pushed * command + off * error
        z = magnitude(sum((gains[1][i - q] * added[q] for q in range(1, i + 1)), first * wrong))
        if i + 1 >= count:
            bounds += [z.entries()[:N], craft.lifted(within).entries()]
    return column(_peak(bounds))


def _steepest(policy: Policy) -> arb_mat:
    """Largest size of every entry of its derivative by the state, rounding in proportion to it included."""
    own = policy.rounding
    grown = [arb(1) if own is None else 1 + own.relative(count) for count in (3, 2)]
    M, bent = policy.reads * grown[0], own is not None
    M = absolute(M) if bent else M
    for layer in policy.layers:
        if isinstance(layer, Weights):
            M = (layer.size if bent else layer).times(M)
            if own is not None and layer is not policy.layers[-1]:
                M = M * (1 + own.relative(layer.terms + FOLDED))
        else:
            M, bent = absolute(M) * (grown[1] * layer.steepest), True
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
    n, late, stated = plant.A.nrows(), filtering.late, document.observer or {}
    M, noise = absolute(matrix(stated["measures"])), column(stated["noise"])
    measured = sums(map(arb, document.measured_error or [0.0] * n), map(arb, document.state_offset))
    seen = [M * column(predicted(plant, measured, plant.h * each.periods)) for each in filtering.updates]
    pairs = list(zip((each.gain for each in filtering.updates), seen, strict=True))
    less = [column([largest((x, arb(0))) for x in (y - noise).entries()]) for y in seen]
    each = column(maxima(*((absolute(L) * y).entries() for (L, _), y in zip(pairs, less, strict=True))))
    over = [exponential(plant.A, plant.h * (j + 1))[0] for j in range(late + 1)]
    apart, missing = arb_mat(n, 1), _periods(plant, lasts) + 2 * late
    for _ in range(missing // (late + 1)):
        apart = magnitude(over[-1]) * apart + each
    rest = filtering.updates[-1].rest
    first = maxima(*((magnitude(rest * step) * apart).entries() for step in over))
    other = maxima(*((absolute(L - pairs[-1][0]) * (y + noise)).entries() for L, y in pairs))
    left = filtering.fading(sums(first, other), document)
    for i in range(len(left) - 2, -1, -1):
        left[i] = maxima(left[i], left[i + 1])
    delay = arb(document.timing.get("delay", 0.0))
    ages = (absolute(exponential(plant.A, delay + plant.h * j)[0]).entries() for j in range(late + 1))
    carried = arb_mat(n, n, maxima(*ages))
    known = [maxima(left[0], apart.entries())] * (missing - late) + [left[0]] * late + left
    off = [(carried * column(known[min(i, len(known) - 1)])).entries() for i in range(count)]
    tightenings = Tightening(craft, settling, identity(n))
    older, bent = tightenings.response(off, True)
    return sums(maxima(*tightenings.noise.summed(off)), older, bent, off[0])


def _unmade(document: Document, craft: Craft, count: int) -> Differences:
    """Return the difference that up to `count` updates in a row make which an observer does not make.

    The other flight has the same disturbances and errors, and measures meanwhile as exactly as what is
    constant in its errors lets it. They differ first in the update after a node at which the observer's error
    is within its bounds.
    """
    plant, blind = craft.plant, craft_of(document, craft.plant, craft.gain, observing=False)
    error = sums(map(arb, document.measured_error), carried_away(plant))
    n, box = len(error), [*craft.box[: -len(error)], *error]
    start = above(arb_mat(n, len(box)), diagonal(box))
    pushes = plant.thruster_error(plant.u_max)
    added = [beside(*each.added(pushes)[1:]) for each in (craft, blind)]  # measurements are the first
    seen = craft.samples[0]
    if seen.constant:
        left = [largest([arb(0), 2 * x - size]) for x, size in zip(seen.constant, seen.size, strict=True)]
        inexact = seen.adds * diagonal(left)
        added = [beside(added[0], inexact), beside(added[1], inexact * 0)]
    first = second = identity(n + len(box))
    pairs = []
    for _ in range(count):
        more = second * added[1] - first * added[0]
        first, second = craft.F * first, blind.F * second
        pairs.append((more, (second - first) * start))
    return pairs


def transient_tightening(
    tightenings: Tightening, boxes: list[arb_mat], others: Sequence[Differences] = ()
) -> list[list[arb]]:
    """Return tightenings along rows for boxes or differences of two flights, by the end of a period.

    That is the period after node l + 1, the state being added up to two periods after a hand-over.
    """
    worst, steps = [arb(0)] * tightenings.rows.nrows(), list[list[arb]]()
    whole = [difference_along(identity(tightenings.carried[0].ncols()), each) for each in others]
    ever = [
        tightenings.tightening_after_settling(each) for each in (*boxes, *(column(each) for each in whole))
    ]
    for lag in range(len(tightenings.carried)):
        now = [tightenings.boxed(box, lag) for box in boxes] + [
            tightenings.difference(each, lag) for each in others
        ]
        worst = _peak([worst, *ever, *now])
        steps.append(worst)
    last = len(steps) - 1
    return [steps[min(lag + 2, last)] for lag in range(last + 1)]
