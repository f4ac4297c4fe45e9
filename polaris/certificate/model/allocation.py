"""Thrusters that push only: every input within the limits is made, whichever one of them has failed.

Each input has a mix of thrusters either way. What is commanded is made by the sum of these mixes, or by
thrusts that are bounded by it.
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
INVERSE = 1e-9  # share of a direction by which a table may miss the equation of the pseudo-inverse
MIXED = BEYOND / 2  # share of an input's limit that mixes may be off it where all inputs are at their limits


def per_axis(values: Any, count: int) -> list[float]:
    """Return one number for all, or one each, as a list."""
    return list(values) if isinstance(values, list) else [values] * count


def check_allocation(document: Document, scenario: dict[str, Any]) -> None:
    """Check limits of the inputs: within the scenario's, and reached by its thrusters in every fault.

    The set they reach is convex. It holds a box if for each of its corners it has a point that lies, in every
    input, at least as far out as the corner: no plane separates the box from those points (Proposition 5).
    Sums of mixes are such points.
    """
    spec, all_faults = scenario.get("thrusters", {}), scenario.get("faults", [])
    faults = [fault for fault in all_faults if fault["kind"] != "navigation_lost"]
    allocation, m, layout = document.allocation, len(document.u_max), "directions" in spec
    if (allocation is not None) != (layout or bool(faults)) or layout != ("thrust_max_N" in spec):
        raise Rejected("system", "only one of certificate and scenario has a layout of thrusters")
    if allocation is None:
        return
    hill = scenario["system"]["kind"] == "clohessy_wiltshire"
    tops = per_axis(scenario["system"]["thrust_max_N" if hill else "input_max"], m)
    if any(u > top for u, top in zip(document.u_max, tops, strict=True)) or m > MOST_INPUTS:
        raise Rejected("system", "limits of the inputs exceed those of the scenario")
    directions = [[float(s * (i == k)) for k in range(m)] for s in (1, -1) for i in range(m)]
    limits = tops * 2
    if layout:
        directions = spec["directions"]
        limits = per_axis(spec["thrust_max_N"], len(directions))
    if (allocation["directions"], allocation["limits"], allocation["layout"]) != (directions, limits, layout):
        raise Rejected("system", "thrusters are not those of the scenario")
    kind = spec.get("allocation", "least_thrust_mixes") if layout else None
    if allocation.get("kind") != kind:
        raise Rejected(
            "system", f"allocation is {allocation.get('kind')} in the certificate, {kind} in the scenario"
        )
    strengths = [arb(1) - arb(fault["share"]) if fault["kind"] == "loss" else arb(0) for fault in faults]
    cases = [(0, arb(1)), *((j, strength) for strength in strengths for j in range(len(limits)))]
    if len(allocation["mixes"]) != len(cases):
        raise Rejected("system", "mixes of thrusters are missing")
    for (failed, strength), mixes in zip(cases, allocation["mixes"], strict=True):
        for j, u_max in enumerate(document.u_max):
            column, error = [arb(row[j]) for row in directions], arb(0)
            for i, u in enumerate(document.u_max):
                signed_mixes = zip((1, -1), mixes, strict=True)
                error += u * largest(abs(dot(column, mix[i]) - sign * (i == j)) for sign, mix in signed_mixes)
            reason = f"mixes do not make {document.input_names[j]} exactly, with thruster {failed} failed"
            require("system", MIXED * arb(u_max) - error, reason)
        for j, limit in enumerate(limits):
            thrusts = [u * arb(max(mixes[0][i][j], mixes[1][i][j])) for i, u in enumerate(document.u_max)]
            top = arb(limit) * strength if j == failed else arb(limit)
            reason = f"mixes exceed the limit of thruster {j}, with thruster {failed} failed"
            require("system", top - sum(thrusts, arb(0)) * (1 + BEYOND), reason)
        if kind == "pseudo_inverse":
            _check_pairs(directions, mixes, [j != failed or bool(strength > 0) for j in range(len(limits))])


def _line(direction: list[float]) -> tuple[tuple[float, ...], int]:
    """Return a direction with its first number above 0, and 1 if it was turned round for that, else 0."""
    flipped = next((x for x in direction if x), 0.0) < 0
    return tuple(-x if flipped else x for x in direction), int(flipped)


def _check_pairs(directions: list[list[float]], mixes: list[list[list[float]]], alive: list[bool]) -> None:
    """Check that mixes are twice the positive part of the pseudo-inverse of pairs of opposite thrusters.

    Two of a pair then push along their line by a linear function of u, and mixes that are exact make u exact.
    """
    sides: dict[tuple[float, ...], tuple[list[int], list[int]]] = {}
    for j, direction in enumerate(directions):
        line, side = _line(direction)
        sides.setdefault(line, ([], []))[side].append(j)
    rows, used = [[[row[j] for row in mix] for mix in mixes] for j in range(len(directions))], list[int]()
    consistent = all(
        not (x and y) for forwards, backwards in rows for x, y in zip(forwards, backwards, strict=True)
    )
    for pair in sides.values():
        each = [
            sorted(rows[j][:: 1 - 2 * side] for j in pair[side] if any(map(any, rows[j]))) for side in (0, 1)
        ]
        consistent &= each[0] == each[1] and len(each[0]) == min(sum(alive[j] for j in side) for side in pair)
        used += [j for side in pair for j in side if any(map(any, rows[j]))]
    if not consistent:
        raise Rejected("system", "mixes of opposite thrusters differ")
    for j in used:
        push = [arb(x) - y for x, y in zip(*rows[j], strict=True)]
        image = [arb(0)] * len(push)
        for other in used:
            part = dot(push, directions[other])
            image = [x + part * d for x, d in zip(image, directions[other], strict=True)]
        for x, d in zip(image, directions[j], strict=True):
            allowance = INVERSE * arb(max(map(abs, directions[j])))
            require(
                "system",
                allowance - abs(x - 2 * arb(d)),
                f"mixes of thruster {j} are not those of the pseudo-inverse",
            )


def _norm(x: list[arb]) -> arb:
    return root(dot(x, x))


@dataclass(frozen=True)
class Nozzles:
    """Errors of thrusters one by one, and their allocation, as a certificate states them."""

    allocation: dict[str, Any]
    along: float  # of what each makes, per unit of its command and along it
    across: float  # and to its side
    mass: float

    @classmethod
    def from_document(cls, document: Document) -> "Nozzles | None":
        """Return None without a layout."""
        allocation = document.allocation
        return cls(allocation, *document.shares) if allocation is not None and allocation["layout"] else None

    @property
    def ways(self) -> list[list[arb]]:
        """Return the directions of the thrusters, (N, m)."""
        return [list(map(arb, d)) for d in self.allocation["directions"]]

    @property
    def sizes(self) -> list[list[arb]]:
        """Return the size of every input by a unit of thrust of each thruster, (N, m)."""
        return [[abs(x) for x in d] for d in self.ways]

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
        """Return the largest sums over thrusters that are asked at once, of (N, m), shape (m).

        What a program asks lies on one side of a plane: of opposite thrusters one side alone.
        """
        m, used = len(each[0]), set[tuple[int, ...]]()
        if self.solves:
            sides: dict[tuple[float, ...], list[list[arb]]] = {}
            for (line, side), row in zip(map(_line, self.allocation["directions"]), each, strict=True):
                pair = sides.setdefault(line, [[arb(0)] * m, [arb(0)] * m])
                pair[side] = [x + y for x, y in zip(pair[side], row, strict=True)]
            return [sum((largest([x[j], y[j]]) for x, y in sides.values()), arb(0)) for j in range(m)]
        for mixes in self.allocation["mixes"]:
            for signs in product((0, 1), repeat=m):
                by_thruster = zip(*(mixes[sign][i] for i, sign in enumerate(signs)), strict=True)
                used.add(tuple(int(any(x > 0 for x in thrusts)) for thrusts in by_thruster))
        return [largest(dot([x[j] for x in each], row) for row in used) for j in range(m)]

    @property
    def solves(self) -> bool:
        """Return True if a program is solved for each command."""
        return self.allocation.get("kind") in ("linear_program", "nearest")

    @cached_property
    def lengths(self) -> list[arb]:
        """Return the length of each thruster's direction, (N)."""
        return [root(dot(d, d)) for d in self.ways]

    def weighted_thrust(self, each: list[arb], multipliers: list[list[float]]) -> list[arb]:
        """Return the largest sum of thrusts times `each` (N) per unit of every input, (m).

        Of a program it is ``sum_t f_t each_t <= lambda u + rest size(f)``, whatever lambda is for inputs of
        some signs, and its thrusts have no larger size than mixes (Proposition 5 (d)).
        """
        mixes, program = self.allocation["mixes"], self.allocation.get("kind") == "linear_program"
        m, size = len(mixes[0][0]), (lambda mix: dot(self.lengths, mix)) if program else _norm
        if not self.solves:
            return [largest([dot(each, mix[sign][i]) for mix in mixes for sign in (0, 1)]) for i in range(m)]
        sizes = [
            [largest([size(list(map(arb, mix[sign][i]))) for mix in mixes]) for i in range(m)]
            for sign in (0, 1)
        ]
        bounds = [arb(0)] * m
        for signs, factors in zip(product((0, 1), repeat=m), multipliers, strict=True):
            excess = [largest([arb(0), x - dot(d, factors)]) for x, d in zip(each, self.ways, strict=True)]
            pairs = zip(excess, self.lengths, strict=True)
            rest = (
                largest([arb(0), *(x / y for x, y in pairs if not y.is_zero())]) if program else _norm(excess)
            )
            bound = [
                x * (1 - 2 * s) + rest * sizes[s][i]
                for i, (x, s) in enumerate(zip(factors, signs, strict=True))
            ]
            bounds = [largest(pair) for pair in zip(bounds, bound, strict=True)]
        return bounds

    @cached_property
    def bounds(self) -> list[list[arb]]:
        """Return the errors of the inputs, and all thrust, by a unit of each input, (m + 1, m)."""
        columns = [*(list(column) for column in zip(*self.error, strict=True)), self.lengths]
        m, factors = len(self.error[0]), self.allocation.get("multipliers", [])
        if len(factors) != (2**m if self.solves else 0):
            raise Rejected(
                "system",
                "linear_program and nearest, no other kind, need multipliers for all signs of the inputs",
            )
        each = map(list, zip(*factors, strict=True)) if factors else [[]] * (m + 1)
        return [self.weighted_thrust(*pair) for pair in zip(columns, each, strict=True)]

    @property
    def weights(self) -> tuple[arb, ...]:
        """Return the most thrust of all thrusters that a unit of each input takes, (m)."""
        return tuple(self.bounds[-1])

    @property
    def shares(self) -> list[list[arb]]:
        """Return the error of every input, rows, by a unit of each command, (m, m)."""
        rows = self.bounds[:-1]
        errors = [[x + self.mass * (i == j) for i, x in enumerate(row)] for j, row in enumerate(rows)]
        return [[x / (1 - arb(self.mass)) for x in row] for row in errors]

    @property
    def part_sums(self) -> list[list[arb]]:
        """Return the sum of the thrusters' parts of every input, rows, by a unit of each command, (m, m).

        Sizes are added. No part of a thrust is longer than the thrust itself.
        """
        m = len(self.weights)
        sides = [
            largest([abs(d[j]) / x for d, x in zip(self.ways, self.lengths, strict=True)]) for j in range(m)
        ]
        rows = zip(sides, self.bounds[:-1], strict=True)
        return [
            [(side * x + y) / (1 - arb(self.mass)) for x, y in zip(self.weights, row, strict=True)]
            for side, row in rows
        ]

    def dropped(self, bit: arb, period: arb, carried: bool) -> list[arb]:
        """Bound the error of each input by rounding to impulse bits [N s], (m)."""
        pairs = zip(self.largest, self.allocation["directions"], strict=True)
        if carried:
            errors = [[x - abs(d) for x, d in zip(*rows, strict=True)] for rows in pairs]
        else:
            errors = [[x / 2 for x in row] for row in self.largest]
        return [bit / period * x for x in self.at_once(errors)]

    def max_carried(self, bit: arb) -> arb:
        """Return the most of an input's impulse that may be left in all thrusters, of bits [N s]."""
        columns = list(zip(*self.allocation["directions"], strict=True))
        sides = [
            dot([max(s * x, 0.0) for x in column], [1.0] * len(column)) for column in columns for s in (1, -1)
        ]
        return bit * largest(sides)

    def in_turn(self, u_max: list[float], bit: arb) -> arb:
        """Return the share of a period that pulses take one after another; `bit` is that of thrusts [N]."""
        limits = list(map(arb, self.allocation["limits"]))
        longest = largest([1 / (x * y) for x, y in zip(limits, self.lengths, strict=True)])
        return dot(self.weights, u_max) * longest + bit * self.at_once([[1 / x] for x in limits])[0]

    def fired(self) -> list[arb]:
        """Return bounds on every input by pulses of thrusters that are asked at once."""
        rows = zip(self.largest, self.allocation["limits"], strict=True)
        return self.at_once([[x * limit for x in row] for row, limit in rows])
