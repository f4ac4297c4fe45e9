"""What faults do until they are isolated: boxes of what they add to the states, and whether all are told."""

from functools import partial
from math import ceil
from typing import Any

from flint import arb, arb_mat

from .balls import absolute, column, diagonal, exponential, identity, largest, magnitude, matrix, smallest
from .document import ROUNDED, Document
from .loop import Memory, Needs
from .motion import Motion, Plant
from .networks import Policy
from .plants import WHOLE
from .timing import predicted
from .verdict import Rejected


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
    for each in document.transients:
        lasts = arb(each["lasts"])
        answered = ceil(float((lasts / plant.h).mid()) * (1 - WHOLE)) - 1
        for push in each.get("pushes") or []:
            size, spread = [arb(x) for x in push], partial(_spread, document, plant)
            free = spread(lasts, gains, size)
            if answered > 0 and (asked or networks):
                free += spread(answered * plant.h, gains, [2 * top for top in plant.u_max])
            if networks and not asked:
                pairs = zip(free.entries(), spread(lasts, both, size).entries(), strict=True)
                free = column([smallest(x.upper() for x in pair) for pair in pairs])
            found.append(free)
    return found


def _spread(document: Document, plant: Plant, lasts: arb, gains: list[arb_mat], size: list[arb]) -> arb_mat:
    """The same under laws with gains up to these, inputs being off by some size besides."""
    n, m = plant.B.nrows(), plant.B.ncols()
    most = arb_mat(m, n, [largest(each) for each in zip(*(K.entries() for K in gains), strict=True)])
    along, across, _ = plant.thrusters or (0.0, 0.0, 0.0)
    answer = diagonal([1 + arb(along)] * m) + arb_mat(m, m, [arb(across)] * m * m)
    growth = absolute(plant.A) + absolute(plant.B) * answer * most
    late = exponential(growth, lasts + _hidden(document, plant))[1] * absolute(plant.B)
    wrong = [a + b for a, b in zip(size, plant.thruster_part(size), strict=True)]
    return magnitude(late * column(wrong))


def _steepest(policy: Policy) -> arb_mat:
    """Largest size of every entry of its derivative by the state: no activation is steeper than 1."""
    M, bent = policy.reads, False
    for layer in policy.layers:
        if isinstance(layer, tuple):
            M = (absolute(layer[0]) if bent else layer[0]) * M
        else:
            M, bent = absolute(M), True
    return absolute(M)


def _hidden(document: Document, plant: Plant) -> arb:
    """For how long what happens may be hidden from commands."""
    delay, missed = arb(document.timing.get("delay", 0.0)), document.timing.get("missed", 0)
    periods: int = ceil(float((delay / plant.h).mid()) * (1 - WHOLE)) + missed
    return plant.h * arb(periods)


def lost(document: Document, loop: Motion, memory: Memory) -> list[arb_mat]:
    """The same while navigation is lost: errors of predictions, and what is left of the first estimate's."""
    plant, n = loop.plant, loop.plant.A.nrows()
    measured = zip(document.measured or [0.0] * n, document.displaced, strict=True)
    known, found = [arb(x) + y for x, y in measured], []
    for each in document.transients:
        if not each.get("pushes"):
            age = arb(each["lasts"]) + document.timing.get("delay", 0.0)
            age += plant.h * (2 * document.timing.get("missed", 0) + 1)
            estimate = column(document.estimate or [0.0] * n)
            carried = zip(estimate.entries(), (magnitude(plant.open.phi) * estimate).entries(), strict=True)
            first = upset(Needs(loop, memory, identity(n)), [column([largest(pair) for pair in carried])])[-1]
            found.append(column(predicted(plant, known, age)) + column(first))
    return found


def upset(needs: Needs, boxes: list[arb_mat]) -> list[list[arb]]:
    """What errors in any of some boxes need along rows by the end of the period after node l + 1."""
    most = _largest([[arb(0)] * needs.rows.nrows(), *map(needs.still, boxes)])
    steps = []
    for lag in range(len(needs.carried)):
        most = _largest([most, *(needs.boxed(box, lag) for box in boxes)])
        steps.append(most)
    last = len(steps) - 1
    return [steps[min(lag + 2, last)] for lag in range(last + 1)]


def _largest(lists: list[list[arb]]) -> list[arb]:
    """The largest of each entry."""
    return [largest(each) for each in zip(*lists, strict=True)]
