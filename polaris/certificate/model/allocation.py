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


@dataclass(frozen=True)
class Nozzles:
    """Errors of thrusters one by one, and their allocation, as a certificate states them."""

    allocation: dict[str, Any]
    along: float  # of what each makes, per unit of its command and along it
    across: float  # and to its side
    mass: float

    @classmethod
    def of(cls, document: Document) -> "Nozzles | None":
        """Return None without a layout."""
        made = document.allocation
        return cls(made, *document.shares) if made is not None and made["layout"] else None

    @property
    def ways(self) -> list[list[arb]]:
        """Return the directions of the thrusters, (N, m)."""
        return [list(map(arb, d)) for d in self.allocation["directions"]]

    @cached_property
    def error(self) -> list[list[arb]]:
        """Return bounds on the error of a unit of thrust in every input, the mass being exact, (N, m)."""
        rows = []
        for d in self.ways:
            sides = [[x for k, x in enumerate(d) if k != j] for j in range(len(d))]
            each = zip(d, sides, strict=True)
            rows.append([arb(self.along) * abs(x) + self.across * root(dot(y, y)) for x, y in each])
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

    def most(self, each: list[arb]) -> list[arb]:
        """Return the largest sum of thrusts times `each` (N) per unit of every input, (m)."""
        mixes = [mixes[sign] for mixes in self.allocation["mixes"] for sign in (0, 1)]
        return [largest([dot(mix[i], each) for mix in mixes]) for i in range(len(mixes[0]))]

    @property
    def weights(self) -> tuple[arb, ...]:
        """Return the most thrust of all thrusters that a unit of each input takes, (m)."""
        return tuple(self.most([root(dot(d, d)) for d in self.ways]))

    @property
    def shares(self) -> list[list[arb]]:
        """Return the error of every input, rows, by a unit of each command, (m, m)."""
        rows = [self.most(list(column)) for column in zip(*self.error, strict=True)]
        own = [[x + self.mass * (i == j) for i, x in enumerate(row)] for j, row in enumerate(rows)]
        return [[x / (1 - arb(self.mass)) for x in row] for row in own]

    def dropped(self, bit: arb, period: arb, carried: bool) -> list[arb]:
        """Return errors of the inputs by impulses [N s] of which thrusters make multiples, (m)."""
        ways = zip(self.largest, self.allocation["directions"], strict=True)
        if carried:
            wrong = [[x - abs(d) for x, d in zip(*rows, strict=True)] for rows in ways]
        else:
            wrong = [[x / 2 for x in row] for row in self.largest]
        return [bit / period * x for x in self.at_once(wrong)]

    def left(self, bit: arb) -> arb:
        """Return the most of an input's impulse that may be left in all thrusters, of bits [N s]."""
        columns = list(zip(*self.allocation["directions"], strict=True))
        sides = [
            dot([max(s * x, 0.0) for x in column], [1.0] * len(column)) for column in columns for s in (1, -1)
        ]
        return bit * largest(sides)

    def fired(self) -> list[arb]:
        """Return bounds on what pulses of thrusters that are asked at once make of every input."""
        rows = zip(self.largest, self.allocation["limits"], strict=True)
        return self.at_once([[x * limit for x in row] for row, limit in rows])
