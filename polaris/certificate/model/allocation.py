"""Thrusters that push only: every input within the limits is made, whichever one of them has failed."""

from itertools import product
from typing import Any

from flint import arb

from ..files.document import Document
from ..kernel.balls import dot, require
from ..kernel.verdict import Rejected

MOST_INPUTS = 6  # most inputs: their box has two corners for each


def per_axis(given: Any, count: int) -> list[float]:
    """One number for all, or one each."""
    return list(given) if isinstance(given, list) else [given] * count


def check_allocation(document: Document, scenario: dict[str, Any]) -> None:
    """The limits of the inputs lie within the scenario's, and within what its thrusters make in every fault.

    What they make is convex. It holds a box if for each of its corners it has a point that lies, in every
    input, at least as far out as the corner: no plane separates the box from those points (Proposition 5).
    """
    spec, every = scenario.get("thrusters", {}), scenario.get("faults", [])
    faults = [fault for fault in every if fault["kind"] != "navigation_lost"]
    made, m, told = document.allocation, len(document.u_max), "directions" in spec or bool(faults)
    if (made is not None) != told or ("directions" in spec) != ("thrust_max_N" in spec):
        raise Rejected("system", "certificate and scenario do not both speak of the thrusters")
    if made is None:
        return
    hill = scenario["system"]["kind"] == "clohessy_wiltshire"
    most = per_axis(scenario["system"]["thrust_max_N" if hill else "input_max"], m)
    if any(u > top for u, top in zip(document.u_max, most, strict=True)) or m > MOST_INPUTS:
        raise Rejected("system", "limits of the inputs exceed those of the scenario")
    directions = [[float(s * (i == k)) for k in range(m)] for s in (1, -1) for i in range(m)]
    limits = most * 2
    if "directions" in spec:
        directions = spec["directions"]
        limits = per_axis(spec["thrust_max_N"], len(directions))
        if any(spec.get(key, 0.0) > 0 for key in ("magnitude_error", "impulse_bit_N_s")):
            raise Rejected(
                "system", "errors of single thrusters are not covered with directions of their own"
            )
    if made["directions"] != directions or made["limits"] != limits:
        raise Rejected("system", "thrusters are not those of the scenario")
    shares = [arb(1) - arb(fault["share"]) if fault["kind"] == "loss" else arb(0) for fault in faults]
    cases = [(j, left) for left in shares for j in range(len(limits))] or [(0, arb(1))]
    if [len(case) for case in made["corners"]] != [2**m] * len(cases):
        raise Rejected("system", "corners are missing from the limits of the inputs")
    for (failed, left), thrusts in zip(cases, made["corners"], strict=True):
        for signs, f in zip(product((1, -1), repeat=m), thrusts, strict=True):
            for j, (x, limit) in enumerate(zip(f, limits, strict=True)):
                top = arb(limit) * left if j == failed else arb(limit)
                if not x >= 0:
                    raise Rejected("system", f"thruster {j} is to push backwards")
                require("system", top * (1 + arb(2) ** -50) - arb(x), f"thruster {j} with {failed} failed")
            for i, (sign, u) in enumerate(zip(signs, document.u_max, strict=True)):
                along = dot([arb(row[i]) for row in directions], f) * sign
                told_of = f"{document.input_names[i]} with thruster {failed} failed"
                require("system", along - arb(u), f"{told_of}: {u:.6g} are not made")
