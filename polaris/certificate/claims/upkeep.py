"""What S spends for as long as it flies on after T, and how long the tank lasts."""

import math
from typing import Any

from flint import arb

from ..kernel.balls import largest, require
from ..kernel.verdict import Rejected
from ..model.timing import owed
from .arrival import Arrival


def check_upkeep(arrival: Arrival, claim: dict[str, Any], tank: float | None) -> str:
    """What S spends for as long as it flies on, and how long the scenario's tank lasts."""
    doc, plant = arrival.document, arrival.flight.tracker.craft.plant
    node = arrival.node_at(claim["settled_s"])
    if any(any(u) for u in doc.inputs[doc.steps :]):
        raise Rejected("upkeep", "the tail does not coast")
    later = range(node, max(node, arrival.flight.tracker.memory.periods + 1) + 1)
    most = list(map(largest, zip(*map(arrival.tops, later), strict=True)))
    for top, x in zip(plant.u_max, most, strict=True):
        require("upkeep", top - x, "S may ask for more thrust than there is")
    rate = plant.spent(most) / plant.h / doc.mass
    arrival.no_less("velocity change per second", claim["rate_m_s2"], rate)
    ahead = rate * plant.h if doc.fired else arb(0)  # a pulse ends before its period does
    until = arrival.spent + arrival.correcting(node) + ahead
    arrival.no_less("velocity change until it is settled", claim["until_settled_m_s"], until)
    orbit, lasts = claim["per_orbit_m_s"], claim["lasts_s"]
    if orbit is not None:
        if doc.system_kind != "clohessy_wiltshire":
            raise Rejected("upkeep", "a velocity change per orbit needs Hill's frame")
        turn = 2 * arb.pi() / arb(doc.mean_motion or 0.0)
        before = owed(plant) / doc.mass  # what an orbit may find left
        arrival.no_less("velocity change per orbit", orbit, rate * turn + ahead + before)
    if claim["tank_m_s"] != tank or (lasts is not None and tank is None):
        raise Rejected("upkeep", "the tank is not that of the scenario")
    if tank is not None:
        _lasts(arrival, claim, tank, until, rate)
    return f"at most {claim['rate_m_s2']:.4g} m/s per second from {claim['settled_s']:.6g} s on"


def _lasts(arrival: Arrival, claim: dict[str, Any], tank: float, until: arb, rate: arb) -> None:
    """The tank lasts for as long as is claimed; `until` is what is spent until S has settled."""
    T, lasts = arrival.document.steps * arrival.document.delta, claim["lasts_s"]
    beyond = math.inf if lasts is None else lasts
    if T < beyond < claim["settled_s"]:
        raise Rejected("upkeep", f"the tank until {beyond:.6g} s, when S has not settled")
    spent = arrival.spent if beyond <= T else until
    if lasts is None:
        require("upkeep", -rate, "the tank is claimed to last for ever")
    elif lasts > T:
        spent += (arb(lasts) - claim["settled_s"]) * rate
    if beyond > 0:
        require("upkeep", tank - spent, f"the tank until {beyond:.6g} s")
