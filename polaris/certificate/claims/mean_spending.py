"""Bound S's mean spending over any number of periods, by a storage function (Proposition 14 (d))."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from math import cos, pi, sin

from flint import acb, acb_mat, arb, arb_mat

from ..kernel.balls import above, beside, diagonal, identity, matrix, scaled, sums
from ..kernel.motion import InputSet
from ..model.craft.craft import Craft

FREQUENCIES = 100  # among which the worst of every input is; weights are those of a sine of it
SLOW, STEADY, FLOOR = 3e-4, 0.1, 1e-6
"""Least frequency per period. Least errors of thrusters, by which weights are chosen, as a share of their
largest; and of other weights."""
LOOSER, ATTEMPTS, PERIODS, SINES = 1.01, 120, 3000, 30
"""By how much weights rise until a storage lasts, how often at most, in how many periods it is there, and how
often the worst sine is looked for anew with the errors of thrusters that it leads to."""
LARGEST = 1e18  # beyond this a storage runs away
STRICT, SETTLED, LEAST = 1e-5, 1e-7, 1e-12  # of a storage: growth a period, change that ends, least entry


@dataclass(frozen=True, eq=False)
class LastingStorage:
    """Storage that lasts: rows whose sum of squares is twice as large, and the cost of a period [N]."""

    rows: arb_mat
    cost: arb


class MeanCommands:
    """Commands of a loop about their middle; every period spends at most their cost.

    Errors of thrusters are up to `error` (k). Columns of `noise` (m, k), each times at most one, are what
    errors of estimates add to commands. These answer the loop state by `K` (m, N), if not as in the loop.
    """

    def __init__(self, craft: Craft, error: Sequence[arb], noise: arb_mat, K: arb_mat | None = None) -> None:
        plant, spans, m = craft.plant, craft.spans, craft.plant.B.ncols()
        leads = [] if plant.lead is None else [InputSet.in_box(plant.A * plant.B, list(error[m:]))]
        steady = [*craft.steady, *leads]
        enter, groups = [craft.held_map * noise], [[i] for i in range(noise.ncols())]
        for each in craft.samples:
            enter.append(each.adds * diagonal(each.size))
            groups += [[len(groups) + i] for i in range(len(each.size))]
        place = len(groups)
        for enters, motion in spans:
            for push in steady:
                radius = push.radius
                cover = push.cover if radius is None else diagonal([radius] * push.V.ncols())
                enter.append(enters * motion.gamma * push.V * cover)
                indices = list(range(place, place + cover.ncols()))
                groups += [[i] for i in indices] if radius is None else [indices]
                place += cover.ncols()
            box = motion.uneven(*steady, InputSet.in_box(plant.B, list(error[:m])))
            enter.append(enters * diagonal(box.entries()))
            groups += [[place + i] for i in range(box.nrows())]
            place += box.nrows()
        self.count, self.groups, self.m, self.plant = place, groups, m, plant
        thrust_maps = [enters * motion.gamma * plant.B for enters, motion in spans]
        self.enter, self.parts = beside(*enter, *thrust_maps, *thrust_maps), len(spans)
        width = self.enter.ncols() - noise.ncols()
        self.feed = beside(noise, arb_mat(self.m, width))
        self.F, self.K = (craft.F, craft.commands) if K is None else (craft.free + craft.held_map * K, -K)

    @cached_property
    def spends(self) -> list[arb]:
        """Return the thrust that a unit of each command spends, errors of thrusters included."""
        weights = list(map(arb, self.plant.weights or [1.0] * self.m))
        return sums(weights, (matrix([weights]) * self.plant.without_delay.alone).entries())

    @cached_property
    def squares(self) -> arb_mat:
        """Bound on squares of errors of thrusters per squares of commands, (m, m)."""
        plant = self.plant
        total = [sum(row, arb(0)) for row in plant.shares] or [arb(plant.along) + plant.across] * self.m
        return scaled(total, plant.alone)

    @cached_property
    def sine(self) -> tuple[list[float], list[float]]:
        """Weights of commands and of values, which are those of the worst sine: any are as good."""
        number, tops = len(self.groups), list(map(float, self.plant.u_max))
        each = [self._gains(SLOW * (pi / SLOW) ** (i / (FREQUENCIES - 1))) for i in range(FREQUENCIES)]
        squares = [[float(x.mid()) for x in row] for row in self.squares.tolist()]
        bits = list(self.plant.bits or [0.0] * self.m)
        size, r, responses = [bits, bits], tops, list[list[float]]()
        for _ in range(SINES):
            errors = [x for part in size for _ in range(self.parts) for x in part]
            responses = [[_dot(g[number:], errors, sum(g[:number])) for g in at] for at in each]
            r = [max(*x, FLOOR * top) for x, top in zip(zip(*responses, strict=True), tops, strict=True)]
            size = [size[0], [_dot(row, [x * x for x in r]) ** 0.5 for row in squares]]
        worst = [max(range(FREQUENCIES), key=lambda i: responses[i][a]) for a in range(self.m)]
        peaks = [each[i][a] for a, i in enumerate(worst)]
        spends = [float(x.mid()) for x in self.spends]
        b = [_dot(spends, column_of) for column_of in zip(*peaks, strict=True)]
        b = [max(x, FLOOR * max(b)) for x in b]
        levels = [
            max(x, STEADY * max(pair)) + FLOOR * y
            for part in size
            for x, pair, y in zip(part, zip(*size, strict=True), r, strict=True)
        ]
        scales = [levels[k * self.m + a] for k in range(2) for _ in range(self.parts) for a in range(self.m)]
        weights = [b[k] for k, group in enumerate(self.groups) for _ in group]
        return r, [*weights, *(x / y for x, y in zip(b[number:], scales, strict=True))]

    def _gains(self, frequency: float) -> list[list[float]]:
        """Sizes of commands that answer to a sine, by input: to each group, then to errors of thrusters."""
        z, N = acb(cos(frequency), sin(frequency)), self.F.nrows()
        loop = acb_mat(N, N, [z if i == j else 0 for i in range(N) for j in range(N)]) - acb_mat(self.F)
        answers = acb_mat(self.feed) - acb_mat(self.K) * loop.mid().solve(acb_mat(self.enter).mid())
        rows = [[float(abs(x).mid()) for x in row] for row in answers.tolist()]
        return [
            [*(sum(row[i] ** 2 for i in group) ** 0.5 for group in self.groups), *row[self.count :]]
            for row in rows
        ]

    def storage(self) -> LastingStorage | None:
        """Return a storage that lasts, if one is there."""
        r, b = self.sine
        for attempt in range(ATTEMPTS):
            factor = LOOSER**attempt
            scaled_b = [x * factor if i < self.count else x for i, x in enumerate(b)]
            period = WeightedPeriod(self, [x * factor for x in r], scaled_b)
            P = period.storage()
            if P is None or pivots(period.spare(P)) is None:
                continue
            try:
                drop, rows = P - period.before(P), pivots(P)
            except ZeroDivisionError:
                continue
            if rows is not None and pivots((drop + drop.transpose()) * 0.5) is not None:
                return LastingStorage(matrix(rows), period.cost)
        return None


class TurnedCommands(MeanCommands):
    """Commands about a middle (m, 1) in a loop whose state ends with the constant matrix of a plant.

    Commands are twice as many: what is applied about the middle but for errors of the deviation, and the
    deviation. Errors that grow do so with the deviation alone.
    """

    def __init__(self, craft: Craft, loop: MeanCommands, middle: arb_mat) -> None:
        plant, m, N, q = craft.plant, loop.m, loop.F.nrows(), len(craft.plant.matrix)
        deviation, applied = arb_mat(m, q), arb_mat(m, q)
        for place, (i, j, _) in enumerate(plant.matrix):
            deviation[i, place] = middle[j, 0]
            applied[i, place] = middle[j, 0] * (i == j or not plant.carried)
        late, (enters, owns) = carried_across(craft), (_split(M, loop.count) for M in (loop.enter, loop.feed))
        self.loop, self.plant, self.m, self.count = loop, plant, m, loop.count + late.ncols()
        self.groups = [*loop.groups, *([i] for i in range(loop.count, self.count))]
        self.F = above(beside(loop.F, unknown_inputs(craft) * deviation), beside(arb_mat(q, N), identity(q)))
        self.K = above(beside(loop.K, -applied), beside(loop.K, arb_mat(m, q)))
        enter = beside(enters[0], late - loop.F * late, enters[1])
        direct = beside(owns[0], loop.K * late, owns[1])
        self.enter, self.feed = above(enter, arb_mat(q, enter.ncols())), above(direct, direct)

    @cached_property
    def spends(self) -> list[arb]:
        """Return the thrust that a unit of each command spends."""
        shares, along = [x - 1 for x in self.loop.spends], arb(self.plant.along)
        if self.plant.carried:  # thrust across is made in other periods than what it is a share of
            applied = [1 + (x - along) / (1 - along) for x in shares]
            return [*applied, *(along * x for x in applied)]
        return [*[arb(1)] * self.m, *shares]

    @cached_property
    def squares(self) -> arb_mat:
        """Bound on squares of errors of thrusters per squares of commands, (m, 2 m)."""
        return beside(arb_mat(self.m, self.m), self.loop.squares)


def unknown_inputs(craft: Craft) -> arb_mat:
    """Return the change of the loop state per unit of inputs in a period that no law knows of, (N, m)."""
    each = [enters * motion.gamma * craft.plant.B for enters, motion in craft.spans]
    return sum(each[1:], each[0])


def carried_across(craft: Craft) -> arb_mat:
    """Return the largest changes of the loop state by shares of carried impulses in other inputs, (N, k)."""
    bits = craft.plant.without_delay.bits if craft.plant.carried else []
    return (
        unknown_inputs(craft) * diagonal([arb(x) for x in bits]) if any(bits) else arb_mat(craft.F.nrows(), 0)
    )


def _split(M: arb_mat, column: int) -> tuple[arb_mat, arb_mat]:
    """Return the columns of a matrix until one, and those from it on."""
    rows = M.tolist()
    return matrix([row[:column] for row in rows]), matrix([row[column:] for row in rows])


class WeightedPeriod:
    """One period under weights of commands and values: storage before it by storage after it."""

    def __init__(self, loop: MeanCommands, r: list[float], b: list[float]) -> None:
        steady, growing = (
            [sum(map(arb, part[a :: loop.m]), arb(0)) for a in range(loop.m)]
            for part in (b[loop.count : (loop.count + len(b)) // 2], b[(loop.count + len(b)) // 2 :])
        )
        extra = (matrix([growing]) * loop.squares).entries()
        C = [s / x + y for s, x, y in zip(loop.spends, r, extra, strict=True)]
        self.F, self.enter, self.b, self.C = loop.F, loop.enter, diagonal(b), C
        self.feed, self.K = loop.feed, loop.K
        self.feed_cost, self.K_t = loop.feed.transpose() * scaled(C, loop.feed), loop.K.transpose()
        self.cross_cost = loop.feed.transpose() * scaled(C, loop.K)
        self.state_cost = self.K_t * scaled(C, loop.K)
        bits = [x * arb(bit) ** 2 for x, bit in zip(steady, loop.plant.bits or [0.0] * loop.m, strict=True)]
        weights = [arb(b[group[0]]) for group in loop.groups]
        costs = [s * x for s, x in zip(loop.spends, r, strict=True)]
        self.cost = sum([*bits, *weights, *costs], arb(0)) / 2

    def spare(self, P: arb_mat) -> arb_mat:
        """Return the matrix of weights of values, less the matrix by which values raise storage and cost."""
        S = self.b - self.enter.transpose() * P * self.enter - self.feed_cost
        return (S + S.transpose()) * 0.5

    def before(self, P: arb_mat) -> arb_mat:
        """Return the storage before the period."""
        crossed = self.enter.transpose() * P * self.F - self.cross_cost
        stored = self.F.transpose() * P * self.F + self.state_cost
        return stored + crossed.transpose() * self.spare(P).solve(crossed)

    def storage(self) -> arb_mat | None:
        """Return a storage that lasts as far as is known, in exact numbers."""
        N = self.F.nrows()
        P = arb_mat(N, N)
        for _ in range(PERIODS):
            try:
                later = self.before(P)
            except ZeroDivisionError:
                return None
            size = [float(later[i, i].mid()) for i in range(N)]
            last = [float(P[i, i].mid()) for i in range(N)]
            floors = [y - 2 * STRICT * (y + LEAST * max(last)) for y in last]
            if not all(y <= x < LARGEST for x, y in zip(size, floors, strict=True)):
                return None
            candidate = (later + later.transpose()) * 0.5
            candidate = (candidate + diagonal([STRICT * (x + LEAST * max(size)) for x in size])).mid()
            change, size = (candidate - P).tolist(), [float(candidate[i, i]) ** 0.5 for i in range(N)]
            if all(abs(change[i][j]) <= SETTLED * size[i] * size[j] for i in range(N) for j in range(N)):
                return P
            P = candidate
        return None


def pivots(M: arb_mat) -> list[list[arb]] | None:
    """Rows L with ``M = L' L`` if a symmetric matrix is certainly positive definite."""
    rows, n = M.tolist(), M.nrows()
    for i, row in enumerate(rows):
        if not row[i] > 0:
            return None
        for j in range(i + 1, n):
            share = row[j] / row[i]
            later = rows[j]
            for k in range(j, n):
                later[k] -= share * row[k]
        size = row[i].sqrt()
        rows[i] = [arb(0)] * i + [x / size for x in row[i:]]
    return rows


def _dot(a: Sequence[float], b: Sequence[float], start: float = 0.0) -> float:
    return sum((x * y for x, y in zip(a, b, strict=True)), start)
