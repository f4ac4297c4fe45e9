"""Thrusters that push only: every input within the limits is made, whichever one of them has failed.

Each input has a mix of thrusters either way, and what is commanded is the sum of these mixes.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any

from flint import arb

from ..files.document import Document
from ..kernel.balls import dot, largest, require, root
from ..kernel.verdict import Rejected

MOST_INPUTS = 6  # most inputs: their signs have two combinations for each
BEYOND = 1e-11  # share by which thrusters can make more than is needed, so that they make that exactly
MIXED = BEYOND / 2  # share of an input's limit that mixes may be off it where all inputs are at their limits


def per_axis(given: Any, count: int) -> list[float]:
    """One number for all, or one each."""
    return list(given) if isinstance(given, list) else [given] * count


def check_allocation(document: Document, scenario: dict[str, Any]) -> None:
    """The limits of the inputs lie within the scenario's, and within what its thrusters make in every fault.

    What they make is convex. It holds a box if for each of its corners it has a point that lies, in every
    input, at least as far out as the corner: no plane separates the box from those points (Proposition 5).
    Sums of mixes are such points.
    """
    spec, every = scenario.get("thrusters", {}), scenario.get("faults", [])
    faults = [fault for fault in every if fault["kind"] != "navigation_lost"]
    made, m, layout = document.allocation, len(document.u_max), "directions" in spec
    if (made is not None) != (layout or bool(faults)) or layout != ("thrust_max_N" in spec):
        raise Rejected("system", "certificate and scenario do not both speak of the thrusters")
    if made is None:
        return
    hill = scenario["system"]["kind"] == "clohessy_wiltshire"
    most = per_axis(scenario["system"]["thrust_max_N" if hill else "input_max"], m)
    if any(u > top for u, top in zip(document.u_max, most, strict=True)) or m > MOST_INPUTS:
        raise Rejected("system", "limits of the inputs exceed those of the scenario")
    directions = [[float(s * (i == k)) for k in range(m)] for s in (1, -1) for i in range(m)]
    limits = most * 2
    if layout:
        directions = spec["directions"]
        limits = per_axis(spec["thrust_max_N"], len(directions))
    if (made["directions"], made["limits"], made["layout"]) != (directions, limits, layout):
        raise Rejected("system", "thrusters are not those of the scenario")
    shares = [arb(1) - arb(fault["share"]) if fault["kind"] == "loss" else arb(0) for fault in faults]
    cases = [(0, arb(1)), *((j, left) for left in shares for j in range(len(limits)))]
    if len(made["mixes"]) != len(cases):
        raise Rejected("system", "mixes of thrusters are missing")
    for (failed, left), mixes in zip(cases, made["mixes"], strict=True):
        for j, whole in enumerate(document.u_max):
            column, off = [arb(row[j]) for row in directions], arb(0)
            for i, u in enumerate(document.u_max):
                ways = zip((1, -1), mixes, strict=True)
                off += u * largest(abs(dot(column, mix[i]) - sign * (i == j)) for sign, mix in ways)
            reason = f"mixes do not make {document.input_names[j]} exactly, with thruster {failed} failed"
            require("system", MIXED * arb(whole) - off, reason)
        for j, limit in enumerate(limits):
            asked = [u * arb(max(mixes[0][i][j], mixes[1][i][j])) for i, u in enumerate(document.u_max)]
            top = arb(limit) * left if j == failed else arb(limit)
            reason = f"mixes exceed the limit of thruster {j}, with thruster {failed} failed"
            require("system", top - sum(asked, arb(0)) * (1 + BEYOND), reason)


def input_weights(made: dict[str, Any] | None) -> tuple[arb, ...]:
    """Return the most thrust of all thrusters that a unit of each input takes; nothing without a layout."""
    if made is None or not made["layout"]:
        return ()
    lengths = [root(dot(d, d)) for d in map(list, (map(arb, d) for d in made["directions"]))]
    mixes = [mixes[sign] for mixes in made["mixes"] for sign in (0, 1)]
    return tuple(largest(dot(lengths, mix[i]) for mix in mixes) for i in range(len(mixes[0])))


@dataclass(frozen=True)
class Nozzles:
    """Errors of thrusters one by one, as the scenario declares them, in the allocation of a certificate."""

    allocation: dict[str, Any]
    along: arb
    across: arb
    mass: arb
    bit: arb  # impulse of which every thruster makes multiples

    @classmethod
    def of(cls, document: Document, spec: dict[str, Any]) -> "Nozzles | None":
        """From the table of thrusters of a scenario; None without directions."""
        if "directions" not in spec or document.allocation is None:
            return None
        names = "magnitude_error", "mass_error", "misalignment_deg", "impulse_bit_N_s"
        magnitude, mass, angle, bit = (arb(spec.get(name, 0.0)) for name in names)
        turn = angle * arb.pi() / 180
        along = largest((magnitude, 1 - turn.cos() * (1 - magnitude)))
        return cls(document.allocation, along, turn.sin() * (1 + magnitude), mass, bit)

    @cached_property
    def error(self) -> list[list[arb]]:
        """Return bounds on the error of a unit of thrust in every input, the mass being exact, (N, m)."""
        rows = []
        for d in self.allocation["directions"]:
            sides = [[x for k, x in enumerate(d) if k != j] for j in range(len(d))]
            each = zip(d, sides, strict=True)
            rows.append([self.along * abs(x) + self.across * root(dot(y, y)) for x, y in each])
        return rows

    @cached_property
    def largest(self) -> list[list[arb]]:
        """Return the most that a unit of thrust makes of every input, (N, m)."""
        each = zip(self.allocation["directions"], self.error, strict=True)
        return [[(abs(x) + y) / (1 - self.mass) for x, y in zip(*rows, strict=True)] for rows in each]

    def at_once(self, each: list[list[arb]]) -> list[arb]:
        """Return the largest sums over thrusters that are asked at once, of (N, m), shape (m)."""
        m, used = len(each[0]), set[tuple[int, ...]]()
        for mixes in self.allocation["mixes"]:
            for signs in product((0, 1), repeat=m):
                asked = zip(*(mixes[sign][i] for i, sign in enumerate(signs)), strict=True)
                used.add(tuple(int(any(x > 0 for x in thrusts)) for thrusts in asked))
        return [largest(dot([x[j] for x in each], row) for row in used) for j in range(m)]

    def errors(self, period: arb, carried: bool) -> tuple[arb, arb, arb]:
        """Return errors of the inputs along, across, and of the bit, as `Document.thrusters` has them."""
        m, columns = len(self.error[0]), list(zip(*self.error, strict=True))
        mixes = [mixes[sign] for mixes in self.allocation["mixes"] for sign in (0, 1)]
        T = [[largest([dot(mix[i], column) for mix in mixes]) for i in range(m)] for column in columns]
        own = largest([(T[j][j] + self.mass) / (1 - self.mass) for j in range(m)])
        apart = [[x for i, x in enumerate(row) if i != j] for j, row in enumerate(T)]
        across = largest([root(dot(row, row)) for row in apart]) / (1 - self.mass)
        ways = zip(self.largest, self.allocation["directions"], strict=True)
        if carried:
            wrong = [[x - abs(d) for x, d in zip(*rows, strict=True)] for rows in ways]
        else:
            wrong = [[x / 2 for x in row] for row in self.largest]
        return own, across, self.bit / period * largest(self.at_once(wrong))

    def left(self, carried: bool) -> arb:
        """Return the most of an input's impulse that may be left in all thrusters."""
        columns = list(zip(*self.allocation["directions"], strict=True))
        sides = [
            dot([max(s * x, 0.0) for x in column], [1.0] * len(column)) for column in columns for s in (1, -1)
        ]
        return self.bit * carried * largest(sides)

    def fired(self) -> list[arb]:
        """Return bounds on what pulses of thrusters that are asked at once make of every input."""
        rows = zip(self.largest, self.allocation["limits"], strict=True)
        return self.at_once([[x * limit for x in row] for row, limit in rows])
