"""What faults do until they are isolated: boxes of what they add to the states, and whether all are told."""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from functools import partial
from itertools import repeat
from math import ceil
from typing import Any

from flint import arb, arb_mat

from ..files.document import ROUNDED, Document
from ..kernel.balls import (
    absolute,
    column,
    diagonal,
    exponential,
    identity,
    largest,
    magnitude,
    matrix,
    smallest,
    sums,
)
from ..kernel.motion import Plant
from ..kernel.verdict import Rejected, Undecided
from .craft.craft import Craft
from .craft.memory import Memory
from .craft.needs import Needs
from .networks import FOLDED, Policy, Weights
from .plants import WHOLE
from .timing import predicted

PARTS, LEFT, LONGEST = 4, 0.1, 4096
"""Parts of an observer's period, what of an error it leaves that is followed no further, and its periods."""


def check_transients(document: Document, scenario: dict[str, Any]) -> None:
    """Every fault of the scenario that is isolated late is told: for how long, and how far inputs are off."""
    faults = [fault for fault in scenario.get("faults", []) if _lasts(fault) > 0]
    given = [(fault["kind"], _lasts(fault)) for fault in faults]
    told = [(each["name"], each["lasts"]) for each in document.transients]
    if told != given:
        raise Rejected(
            "system", f"faults isolated late are {told} in the certificate, {given} in the scenario"
        )
    for fault, each in zip(faults, document.transients, strict=True):
        lost, pushes = fault["kind"] == "navigation_lost", each.get("pushes") or []
        if lost == bool(pushes):
            raise Rejected("system", f"{fault['kind']} belongs to thrusters, or to none")
        made = document.allocation or {"directions": [], "limits": []}
        thrusters = [] if lost else zip(made["directions"], made["limits"], strict=True)
        for way, limit in thrusters:
            least = [abs(x) * arb(limit) * arb(fault.get("share", 1.0)) * (1 - ROUNDED) for x in way]
            if not any(all(x >= y for x, y in zip(push, least, strict=True)) for push in pushes):
                raise Rejected("system", f"what {fault['kind']} does to a thruster is not covered")


def _lasts(fault: dict[str, Any]) -> float:
    return float(fault["lasts_s"] if fault["kind"] == "navigation_lost" else fault.get("isolation_s", 0.0))


def check_withheld(
    document: Document, stored: list[dict[str, Any]] | None, limits: set[str]
) -> list[dict[str, Any]] | None:
    """What is told of faults: of steps of S, names and times that there are; what is short is no claim."""
    laws, delta = {law.name for law in document.laws[1:]}, document.delta
    for row in (row for fault in stored or [] for row in fault["steps"]):
        k, at = row["step"], row["limit_time_s"]
        if not (k < document.steps and document.modes[k] == 0 and row["controller"] in laws):
            raise Rejected("schedule", f"step {k} is not one that S flies in the place of another")
        if row["limit"] not in limits or row["short"] != row["need"] - row["room"]:
            raise Rejected("schedule", f"in step {k} {row['limit']} is not what is short")
        if row["t_s"] != k * delta or at < 0 or row["limit_step"] != int(at / delta + 1e-9):
            raise Rejected("schedule", f"step {k} does not begin or end at that time")
    known = [(each["name"], each["lasts"]) for each in document.transients]
    if known != [(fault["fault"], fault["lasts_s"]) for fault in stored or []]:
        raise Rejected("schedule", f"S flies because of faults that are not {known}")
    return stored


def moved(document: Document, plant: Plant, networks: list[Policy]) -> list[arb_mat]:
    """Boxes, one of which holds what thrust that is not as commanded has added to the states, (n, 1) each.

    Every law answers with no more than its gain times the deviation, whatever clips it; networks also with
    no more than twice the limits from the first node after the fault on, so that of two bounds each entry is
    the smaller; black boxes with that.
    """
    asked = any(law.kind == "black_box" for law in document.laws)
    gains = [absolute(matrix(law.gain)) for law in document.laws if law.gain is not None]
    found, both = [], gains + [_steepest(policy) for policy in networks if document.transients]
    misleading = misled(document, plant, 0)
    for each in document.transients:
        lasts = arb(each["lasts"])
        answered = ceil(float((lasts / plant.h).mid()) * (1 - WHOLE)) - 1
        for push in each.get("pushes") or []:
            size, off = [arb(x) for x in push], next(misleading)[0]
            spread, limits = partial(_spread, document, plant), [2 * top for top in plant.u_max]
            free = spread(lasts, gains, (size, off))
            if answered > 0 and (asked or networks):
                free += spread(answered * plant.h, gains, (limits, [0 * x for x in off]))
            if networks and not asked:
                pairs = zip(free.entries(), spread(lasts, both, (size, off)).entries(), strict=True)
                free = column([smallest(x.upper() for x in pair) for pair in pairs])
            found.append(free)
    return found


def _spread(
    document: Document, plant: Plant, lasts: arb, gains: list[arb_mat], given: tuple[list[arb], list[arb]]
) -> arb_mat:
    """The same under laws with gains up to these; `given` is how far inputs and estimates are off."""
    n, m, (size, off) = plant.B.nrows(), plant.B.ncols(), given
    most = arb_mat(m, n, [largest(each) for each in zip(*(K.entries() for K in gains), strict=True)])
    along, across, _ = plant.thrusters or (0.0, 0.0, 0.0)
    answer = diagonal([1 + arb(along)] * m) + arb_mat(m, m, [arb(across)] * m * m)
    growth = absolute(plant.A) + absolute(plant.B) * answer * most
    late = exponential(growth, lasts + _hidden(document, plant))[1] * absolute(plant.B)
    wrong = [a + b for a, b in zip(size, plant.thruster_part(size), strict=True)]
    return magnitude(late * (column(wrong) + answer * most * column(off)))


def misled(document: Document, plant: Plant, count: int) -> Iterator[list[list[arb]]]:
    """How far estimates are off because an observer does not know of a fault, by period and then for ever.

    One after another of all kinds of wrong thrust, from when S flies and no command is older, the first row
    before, too; then of outages of navigation.
    """
    n, delay = plant.A.nrows(), arb(document.timing.get("delay", 0.0))
    if document.observer is None:
        yield from repeat([[arb(0)] * n] * (count + 1))
        return
    rest = identity(n) - matrix(document.observer["gain"]) * matrix(document.observer["measures"])
    loop, known = rest * exponential(plant.A, plant.h)[0], column(document.measured)
    P, last = 1, magnitude(loop)
    while not all(x < LEFT * y for x, y in zip((last * known).entries(), document.measured, strict=True)):
        P, last = 2 * P, magnitude(loop ** (2 * P))
        if P > LONGEST:
            raise Undecided("system", "the observer does not forget its errors")
    periods = float((delay / plant.h).mid())
    off = abs(periods - round(periods)) > WHOLE  # measurements are not those of nodes
    thrust = [each for each in document.transients if each.get("pushes")]
    lasting = [ceil(float((arb(each["lasts"]) / plant.h).mid()) * (1 - WHOLE)) + off for each in thrust]
    left, part = [identity(n)], replace(plant, h=plant.h / PARTS).open
    while len(left) < count + P + max([1, *lasting]):
        left.append(left[-1] * loop)
    over = magnitude(exponential(plant.A, delay)[0])

    def falling(each: list[arb_mat]) -> list[list[arb]]:
        """Bounds that do not grow, from those of each period: what P more leave is less than all before."""
        more = [_peak([x.entries() for x in each[count:]])]
        more.append((last * column(more[0])).entries())
        share = largest(x / y for x, y in zip(more[1], document.measured, strict=True))
        found = [_peak([*more, [x * share * LEFT for x in document.measured]])]
        for one in reversed(each[:count]):
            found.append(_peak([found[-1], one.entries()]))
        return [(over * column(one)).entries() for one in reversed(found)]

    gains = [magnitude(part.unit_gains(rows * rest, PARTS)) for rows in left] if thrust else []
    early = plant.unseen if delay > 0 else arb_mat(n, plant.B.ncols())
    for each, length in zip(thrust, lasting, strict=True):
        for push in each["pushes"]:
            wrong = column(sums(map(arb, push), plant.thruster_part([arb(x) for x in push])))
            one = [gain * wrong for gain in gains]
            found = falling([sum(one[i : i + length], arb_mat(n, 1)) for i in range(count + P)])
            yield [sums(found[0], (early * wrong).entries()), *found[1:]]
    for each in document.transients:
        if not each.get("pushes"):
            box = column(predicted(plant, _seen(document, n), arb(each["lasts"]) + plant.h))
            yield falling([magnitude(rows * rest) * box for rows in left[: count + P]])


def _peak(lists: list[list[arb]]) -> list[arb]:
    """The largest of each entry."""
    return [largest(each).upper() for each in zip(*lists, strict=True)]


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


def _hidden(document: Document, plant: Plant) -> arb:
    """For how long what happens may be hidden from commands."""
    delay, missed = arb(document.timing.get("delay", 0.0)), document.timing.get("missed", 0)
    periods: int = ceil(float((delay / plant.h).mid()) * (1 - WHOLE)) + missed
    return plant.h * arb(periods)


def _seen(document: Document, n: int) -> list[arb]:
    """Errors of estimates when states are measured."""
    measured = zip(document.measured or [0.0] * n, document.displaced, strict=True)
    return [arb(x) + y for x, y in measured]


def lost(document: Document, craft: Craft, memory: Memory) -> list[arb_mat]:
    """The same while navigation is lost: errors of predictions, and what is left of the first estimate's."""
    plant, n = craft.plant, craft.plant.A.nrows()
    found = []
    for each in document.transients:
        if not each.get("pushes"):
            age = arb(each["lasts"]) + document.timing.get("delay", 0.0)
            age += plant.h * (2 * document.timing.get("missed", 0) + 1)
            estimate = column(document.estimate or [0.0] * n)
            carried = zip(estimate.entries(), (magnitude(plant.open.phi) * estimate).entries(), strict=True)
            first = upset(Needs(craft, memory, identity(n)), [column([largest(pair) for pair in carried])])[
                -1
            ]
            found.append(column(predicted(plant, _seen(document, n), age)) + column(first))
    return found


def upset(
    needs: Needs, boxes: list[arb_mat], off: Iterable[list[list[arb]]] | None = None
) -> list[list[arb]]:
    """What errors in any of some boxes need along rows by the end of the period after node l + 1.

    With what S makes of estimates that are `off`, for every box, where an observer has been misled.
    """
    found, misleading = [], None if off is None else iter(off)
    for box in boxes:
        most, steps = _peak([[arb(0)] * needs.rows.nrows(), needs.still(box)]), []
        for lag in range(len(needs.carried)):
            most = _peak([most, needs.boxed(box, lag)])
            steps.append(most)
        if misleading is not None:
            steps = [sums(*pair) for pair in zip(steps, _answered(needs, next(misleading)), strict=True)]
        found.append(steps)
    steps = [_peak(list(each)) for each in zip(*found, strict=True)]
    last = len(steps) - 1
    return [steps[min(lag + 2, last)] for lag in range(last + 1)]


def _answered(needs: Needs, off: list[list[arb]]) -> list[list[arb]]:
    """What errors of estimates, by period, need along rows, and what they do to what is commanded itself."""
    at, older, bent = needs.caused(needs.noise, off[: len(needs.carried)], True)
    own, found = (absolute(needs.rows) * column(off[0])).entries(), list[list[arb]]()
    for each in at[1:]:
        found.append(_peak([*found[-1:], each]))
    return [sums(each, older, bent, own) for each in found]
