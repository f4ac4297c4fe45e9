"""Bound the spending of flights under linear laws, by a storage in each period (Proposition 14 (c))."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, hypot
from operator import mul
from typing import Any

from flint import arb, arb_mat

from ..files.entries import Vector
from ..kernel.balls import above, beside, diagonal, magnitude, maxima, rows_of, scaled, smallest
from ..kernel.verdict import Rejected, Undecided
from ..kernel.zonotopes import Zonotope
from .flights import FlownStep
from .mean_spending import MeanCommands, TurnedCommands, WeightedPeriod, carried_across, pivots

GROWN, APART = 1e-7, 1e-4
"""Share by which a storage grows in every period, to hold what its numbers are rounded by; and at a jump of
the reference, to hold what that adds."""
FEW, TURNS, VECTOR, LOOSER, TINY = 64, 30, 6, 1.02, 1e-300
"""Generators of a start whose weights are looked for, how long, and in vectors of how many entries. By how
much weights rise until they are enough, and the least weight and growth."""


@dataclass(frozen=True, eq=False)
class Storage:
    """Storage ``y' P y / 2 + p' y`` of a loop state y from the middle, and the spending beside it [N]."""

    P: arb_mat  # exact
    p: arb_mat  # exact, shape (N, 1)
    cost: arb

    def largest(self, start: Zonotope) -> arb:
        """Bound the storage, its cost included, over a set about its centre."""
        within, along = start.G.transpose() * self.P * start.G, start.G.transpose() * self.p
        within = (within + within.transpose()) * 0.5
        coarse = sum(map(abs, within.entries()), arb(0)) / 2 + sum(map(abs, along.entries()), arb(0))
        bounds, sizes = [coarse], _sizes(within, along) if 0 < start.count <= FEW else []
        for i in range(1, TURNS) if sizes else ():
            weights = diagonal([x * arb(LOOSER) ** i for x in sizes])
            if pivots(weights - within) is not None:
                added = (along.transpose() * (weights - within).solve(along))[0, 0]
                bounds.append((sum(map(arb, sizes), arb(0)) * arb(LOOSER) ** i + added) / 2)
        return self.cost + smallest(bounds)

    def before(self, period: WeightedPeriod, middle: arb_mat) -> Storage:
        """Return the storage before a period, in whose middle a command is given (m, 1)."""
        spare, N = period.spare(self.P), self.P.nrows()
        if pivots(spare) is None:
            raise Undecided("goal", "weights are too small to bound the delta-v")
        weighted = scaled(period.C, middle)
        crossed = period.enter.transpose() * self.P * period.F - period.cross_cost
        entered = period.enter.transpose() * self.p + period.feed.transpose() * weighted
        solved = spare.solve(beside(crossed, entered))
        product = beside(crossed, entered).transpose() * solved
        P = period.F.transpose() * self.P * period.F + period.state_cost + _part(product, 0, N, 0, N)
        p = period.F.transpose() * self.p - period.K_t * weighted + _part(product, 0, N, N, N + 1)
        added = (middle.transpose() * weighted)[0, 0] + product[N, N]
        return _enlarged(P, p, self.cost + period.cost + added / 2)

    def jumped(self, jump: arb_mat) -> Storage:
        """Return the storage before the loop state moves by up to a box (N, 1)."""
        product = magnitude(self.P) * jump
        quadratic = sum((x * y for x, y in zip(product.entries(), jump.entries(), strict=True)), arb(0))
        linear = sum((abs(x) * y for x, y in zip(self.p.entries(), jump.entries(), strict=True)), arb(0))
        cost = self.cost + linear + quadratic * (1 + 1 / arb(APART)) / 2
        return _enlarged(self.P * (1 + arb(APART)), self.p, cost)


def _sizes(M: arb_mat, p: arb_mat) -> list[float]:
    """Return weights of numbers up to 1 that bound ``v' M v / 2 + p' v``: those of a v of vectors."""
    rows = [[float(x.mid()) for x in row] for row in M.tolist()]
    first, sizes = [float(x.mid()) for x in p.entries()], list[float]()
    v = [[cos(i * j + i * i) for i in range(1, len(rows) + 1)] for j in range(1, VECTOR + 1)]
    for _ in range(TURNS):
        products = [[sum(map(mul, row, each)) for row in rows] for each in v]
        products[0] = [x + y for x, y in zip(products[0], first, strict=True)]
        sizes = [hypot(*column_of) + TINY for column_of in zip(*products, strict=True)]
        v = [[x / size for x, size in zip(each, sizes, strict=True)] for each in products]
    return sizes


def _part(M: arb_mat, top: int, bottom: int, left: int, right: int) -> arb_mat:
    """Return a block of a matrix."""
    rows = rows_of(M, *range(top, bottom)).transpose()
    return rows_of(rows, *range(left, right)).transpose()


def _enlarged(P: arb_mat, p: arb_mat, cost: arb) -> Storage:
    """Return a storage of exact numbers that is at least as large."""
    P = (P + P.transpose()) * 0.5
    radii = [4 * sum(float(x.rad()) for x in row) for row in P.tolist()]
    growth = [GROWN * float(P[i, i].mid()) + x or TINY for i, x in enumerate(radii)]  # of no storage too
    exact, middle = (P + diagonal(growth)).mid(), p.mid()
    if pivots(exact - P - diagonal([x / 2 for x in growth])) is None:
        raise Undecided("goal", "the storage function is not bounded at this rounding")
    pairs = zip((p - middle).entries(), growth, strict=True)
    return Storage(exact, middle, cost + sum((x.abs_upper() ** 2 / y for x, y in pairs), arb(0)))


def _periods(step: FlownStep, weights: Vector, count: int) -> list[tuple[WeightedPeriod, arb_mat]]:
    """Return the first periods of a step as those of its loop about the middle, with middles of commands."""
    if step.controller.law.kind not in ("safety", "affine", "saturated_affine"):
        raise Rejected("goal", "weights must be left out in steps without an affine law")
    craft, m = step.controller.craft, len(step.spells[0].bounds)
    error = craft.plant.thruster_error(maxima(*(spell.bounds for spell in step.spells)))
    periods, loops = list[tuple[WeightedPeriod, arb_mat]](), dict[Any, MeanCommands]()
    for spell in step.spells[:count]:
        key = tuple(part.man_exp() for x in (*spell.bands, *spell.K.entries()) for part in (x.mid(), x.rad()))
        if key not in loops:
            loops[key] = MeanCommands(craft, error, diagonal(spell.bands), spell.K)
        loop, middle = loops[key], spell.middle
        if craft.plant.matrix:
            loop, middle = TurnedCommands(craft, loop, middle), above(middle, arb_mat(m, 1))
        sizes = list(map(float, map(abs, middle.mid().entries())))
        r = [x + y for x, y in zip(weights[: len(sizes)], sizes, strict=True)]
        periods.append((WeightedPeriod(loop, r, by_value(loop, weights[len(sizes) :])), middle))
    return periods


def by_value(loop: MeanCommands, weights: Vector) -> list[float]:
    """Return the weight of every value from those of groups of values."""
    n_errors = loop.enter.ncols() - loop.count
    if len(weights) != len(loop.groups) + n_errors:
        raise Rejected(
            "goal", f"{len(weights)} weights are given for {len(loop.groups) + n_errors} inputs of the loop"
        )
    expanded = [weights[g] for g, group in enumerate(loop.groups) for _ in group]
    return [*expanded, *weights[len(loop.groups) :]]


def together(
    flights: Sequence[FlownStep],
    weights: Sequence[Vector],
    count: int,
    jump: tuple[int, arb_mat] | None = None,
) -> arb:
    """Bound the integral of the thrust in the first periods of linear steps on end.

    At the start of the step that `jump` names, the loop state moves by up to a box (N, 1).
    """
    plant, start = flights[0].controller.plant, flights[0].start
    if bounds := [x for _, _, x in plant.matrix]:
        fixed, states = arb_mat(len(bounds), 1), beside(start.G, carried_across(flights[0].controller.craft))
        G = above(
            beside(states, arb_mat(states.nrows(), len(bounds))),
            beside(arb_mat(len(bounds), states.ncols()), diagonal(bounds)),
        )
        start, jump = Zonotope(above(start.c, fixed), G), jump and (jump[0], above(jump[1], fixed))
    N = start.c.nrows()
    storage = Storage(arb_mat(N, N), arb_mat(N, 1), arb(0))
    lengths = [min(max(count - i * plant.q, 0), plant.q) for i in range(len(flights))]
    for i in range(len(flights) - 1, -1, -1):
        periods = _periods(flights[i], weights[i], lengths[i])
        for j in range(lengths[i] - 1, -1, -1):
            storage = storage.before(*periods[j])
        if jump is not None and jump[0] == i > 0:
            storage = storage.jumped(jump[1])
    bits = plant.weighted(list(map(arb, plant.without_delay.bits or [0.0] * len(plant.u_max))))
    return (storage.largest(start) + count * bits) * (plant.h + 2 * arb(plant.jitter))
