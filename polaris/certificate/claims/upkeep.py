"""Cost of flying on under S after T, and the life of the tank."""

import math
from collections.abc import Sequence
from typing import Any

from flint import arb

from ..files.artefacts import FileClaims
from ..kernel.balls import (
    above,
    absolute,
    column,
    diagonal,
    identity,
    largest,
    maxima,
    require,
    smallest,
    sums,
)
from ..kernel.verdict import Rejected, Undecided
from ..model.craft.tightening import Tightening
from ..model.timing import carried_impulse
from .arrival import Arrival
from .flights import FlownStep
from .mean_spending import MeanCommands


def check_upkeep(arrival: Arrival, claim: dict[str, Any], tank: float | None) -> str:
    """Check the bound on S's spending for as long as it flies on, and the life of the scenario's tank.

    By the most that it commands in any period or, if that is not enough, in the mean over periods.
    """
    doc, plant = arrival.document, arrival.flight.tracker.craft.plant
    node = arrival.node_at(claim["settled_s"])
    if any(any(u) for u in doc.inputs[doc.steps :]):
        raise Rejected("upkeep", "the tail must coast, but has thrust")
    nodes = range(node, max(node, arrival.flight.tracker.settling.periods + 1) + 1)
    tops = list(map(largest, zip(*map(arrival.max_commands, nodes), strict=True)))
    for top, x in zip(plant.u_max, tops, strict=True):
        require("upkeep", top - x, "S may ask for more thrust than there is")
    thrust = plant.spending(tops) / plant.h, arb(0)
    try:
        check_sizes(arrival, claim, tank, tops, thrust)
    except (Rejected, Undecided):
        check_sizes(arrival, claim, tank, tops, _mean(arrival, nodes, tops) or thrust)
    return f"at most {claim['rate_m_s2']:.4g} m/s per second from {claim['settled_s']:.6g} s on"


def check_estimate(arrival: Arrival, claims: FileClaims, flights: Sequence[FlownStep]) -> str:
    """Check bounds on the errors of an observer's estimates, by state: while others than S fly, and later."""
    craft, settling, doc = arrival.flight.tracker.craft, arrival.flight.tracker.settling, arrival.document
    n, claim, checked = len(doc.A), claims.estimate or {}, []
    excess = maxima(*(craft.extra(doc, k) for k in range(doc.steps + 1)))
    rows = craft.sees - craft.pad(identity(n))
    signed = above(rows, -rows)
    if (claimed := claim["experimental"]) is not None:
        steps = [each for each in flights if each.controller.law.kind != "safety"]
        tightenings = [z.support(signed) for each in steps for z in (each.start, *each.nodes, each.end)]
        checked.append(("while others fly", claimed, maxima(*tightenings), craft.plant.u_max))
    if (claimed := claim["settled"]) is not None:
        if claims.upkeep is None:
            raise Rejected("goal", "settled estimate errors must be given exactly with an upkeep")
        first, T = arrival.node_at(claims.upkeep["settled_s"]), doc.steps * doc.q
        along, nodes = Tightening(craft, settling, signed), range(first, max(first, settling.periods + 1) + 1)
        tightenings = [arrival.flight.tightening(along, arrival.boxes, T + node) for node in nodes]
        checked.append(("once S has settled", claimed, maxima(*tightenings), arrival.tops_before(first)))
    for phase, bounds, tightening, most_before in checked:
        extra = absolute(craft.carry) * column(craft.missed(sums(excess, craft.lag_error(most_before))))
        error = sums(maxima(tightening[:n], tightening[n:]), extra.entries())
        errors = sums(map(smallest, zip(error, map(arb, doc.estimate), strict=True)), map(arb, doc.at_nodes))
        for i, (bound, x) in enumerate(zip(bounds, errors, strict=True)):
            arrival.require_bound(f"error of the estimate of state {i} {phase}", bound, x)
    return ", ".join(phase for phase, *_ in checked) or "nothing claimed"


def _mean(arrival: Arrival, nodes: range, tops: list[arb]) -> tuple[arb, arb] | None:
    """Bound the spending from the first of some nodes on: in a period, and once besides, times 1/h [N].

    The last of the nodes stands for all later ones.
    """
    doc, craft = arrival.document, arrival.flight.tracker.craft
    plant = craft.plant
    errors = sums(craft.extra(doc, doc.steps), craft.lag_error(arrival.tops_before(nodes.start)))
    noise = craft.gain * craft.carry * diagonal(craft.missed(errors))
    storage = MeanCommands(craft, plant.thruster_error(tops), noise).storage()
    if storage is None:
        return None
    tightenings = Tightening(craft, arrival.flight.tracker.settling, storage.rows)
    sizes = zip(*(arrival.states(tightenings, node) for node in nodes), strict=True)
    once = sum((x * x for x in map(largest, sizes)), arb(0)) / 2
    bits = plant.weighted(list(map(arb, plant.without_delay.bits or [0.0] * len(tops))))
    longest = 1 + 2 * arb(plant.jitter) / plant.h
    return (storage.cost + bits) * longest, once * longest


def check_sizes(
    arrival: Arrival, claim: dict[str, Any], tank: float | None, tops: list[arb], thrust: tuple[arb, arb]
) -> None:
    """Refuse a claim that does not follow from the largest commands and the mean thrust."""
    doc, plant = arrival.document, arrival.flight.tracker.craft.plant
    rate, once = (part / doc.mass for part in thrust)
    arrival.require_bound("velocity change per second", claim["rate_m_s2"], rate)
    one_time = once * plant.h
    if doc.pulse_thrust:  # a pulse ends before its period does
        one_time += plant.spending(tops) / doc.mass
    until = arrival.delta_v_until(arrival.node_at(claim["settled_s"])) + one_time
    arrival.require_bound("velocity change until it is settled", claim["until_settled_m_s"], until)
    orbit, lasts = claim["per_orbit_m_s"], claim["lasts_s"]
    if orbit is not None:
        if doc.system_kind != "clohessy_wiltshire":
            raise Rejected("upkeep", "per_orbit_m_s needs Hill's frame")
        turn = 2 * arb.pi() / arb(doc.mean_motion or 0.0)
        carried = carried_impulse(plant) / doc.mass  # what an orbit may find left
        arrival.require_bound("velocity change per orbit", orbit, rate * turn + one_time + carried)
    if claim["tank_m_s"] != tank or (lasts is not None and tank is None):
        raise Rejected("upkeep", "the tank differs from that of the scenario")
    if tank is not None:
        _lasts(arrival, claim, tank, until, rate)


def _lasts(arrival: Arrival, claim: dict[str, Any], tank: float, until: arb, rate: arb) -> None:
    """Check that the tank lasts as long as is claimed; `until` is the spending until S has settled."""
    T, lasts = arrival.document.steps * arrival.document.delta, claim["lasts_s"]
    end = math.inf if lasts is None else lasts
    if T < end < claim["settled_s"]:
        raise Rejected("upkeep", f"the tank is claimed to last until {end:.6g} s, before S has settled")
    delta_v = arrival.cost if end <= T else until
    if lasts is None:
        require("upkeep", -rate, "the tank is claimed to last for ever")
    elif lasts > T:
        delta_v += (arb(lasts) - claim["settled_s"]) * rate
    if end > 0:
        require("upkeep", tank - delta_v, f"the tank until {end:.6g} s")
