"""Good paths quickly: linear programs with the separating facets fixed, and a local search over them.

A path found here is a feasible point of the mixed-integer program; its velocity change bounds how far
the optimal path can stray, which is what makes the program small and its big-M tight.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from time import perf_counter

import numpy as np

from ..system import Array
from .lp import GrowingLP
from .recheck import Recheck, recheck
from .rows import Rows

Cell = tuple[int, int]  # (unsafe set, cell)


@dataclass(eq=False)
class Candidate:
    """A path with the facets it was made with.

    Attributes
    ----------
    z : ndarray, shape (N,)
        Input shares.
    level : float
        Value of the margin variable s (see `Levels`).
    short : float
        Length [m] by which required clearances had to be relaxed, 0 for a usable path.
    fuel : float
        Velocity change [m/s].
    choice : dict
        Facet of every constrained cell.
    sides : tuple of int
        Chosen row of every disjunction of the goal.
    """

    z: Array
    level: float
    short: float
    fuel: float
    choice: dict[Cell, int] = field(default_factory=dict)
    sides: tuple[int, ...] = ()


@dataclass(frozen=True)
class Levels:
    """Range of the margin variable s: clearances must exceed `margins` by ``extra * s``."""

    low: float
    high: float


class PathSearch:
    """Linear programs over input shares (z+, z-), the margin variable s and a shortfall e [length].

    Parameters
    ----------
    rows : Rows
    deadline : float
        Value of `time.perf_counter` at which to stop.
    """

    def __init__(self, rows: Rows, deadline: float) -> None:
        self.rows, self.deadline = rows, deadline
        self.levels = Levels(0.0, 0.0)
        self.prices, self.fuel_price = (0.0, np.inf), 1.0
        N = rows.N
        cost = np.r_[rows.price, rows.price, 0.0, 0.0]
        self.lp = GrowingLP(cost, np.zeros(2 * N + 2), np.r_[rows.limit, rows.limit, 0.0, 0.0])
        goal, last = rows.problem.goal.conditions, rows.free[rows.problem.K]
        unit = rows.length
        self._goal_add(goal.E, (goal.e - goal.E @ last) / unit, equal=True)
        self._goal_add(-goal.G, -(goal.g - goal.G @ last) / unit, equal=False)
        self.base = self.lp.rows
        self.seen: set[Cell] = set()
        self._reachable: dict[tuple[int, int, int], bool] = {}

    def _goal_add(self, g: Array, rhs: Array, equal: bool) -> None:
        if len(g):
            a = self.rows.state_rows(g, self.rows.problem.K) / self.rows.length
            self.lp.add(self._wide(a, 0.0, 0.0), rhs, rhs if equal else np.inf)

    @staticmethod
    def _wide(a: Array, slope: float, elastic: float) -> Array:
        R = len(a)
        return np.hstack([a, -a, np.full((R, 1), -slope), np.full((R, 1), elastic)])

    def set_levels(self, levels: Levels, margin_price: float, short_price: float) -> None:
        """Range and price of s, price of the shortfall (infinite: none allowed)."""
        self.levels = levels
        self.prices = (margin_price, short_price)
        N = self.rows.N
        self.lp.change(2 * N, -margin_price, levels.low, levels.high)
        free = np.isfinite(short_price)
        self.lp.change(2 * N + 1, short_price if free else 0.0, 0.0, np.inf if free else 0.0)

    def set_fuel_price(self, share: float) -> None:
        """Scale the price of fuel (0: only the margin counts)."""
        self.fuel_price = share
        N = self.rows.N
        cost = np.r_[self.rows.price, self.rows.price] * share
        self.lp.highs.changeColsCost(2 * N, np.arange(2 * N, dtype=np.int32), cost)

    def add_cell(self, cell: Cell, facet: int) -> None:
        """Constrain one cell to stay beyond one facet."""
        rows = self.rows.cell(*cell, facet)
        self.lp.add(self._wide(rows.a, rows.slope, 1.0), rows.need, np.inf)

    def add_side(self, group: int, side: int) -> None:
        """Choose one row of a disjunction of the goal."""
        goal, last = self.rows.problem.goal.conditions, self.rows.free[self.rows.problem.K]
        N, c = goal.one_of[group]
        self._goal_add(N[side : side + 1], (c - N @ last)[side : side + 1] / self.rows.length, equal=False)

    def value(self, path: Candidate) -> float:
        """Objective of a path at the prices set."""
        margin, short = self.prices
        value = self.fuel_price * path.fuel - margin * path.level
        return value + (short * path.short / self.rows.length if path.short > 0 else 0.0)

    def lay(self, choice: Mapping[Cell, int], sides: tuple[int, ...]) -> None:
        """Replace all rows but the goal's by those of these facets and sides."""
        self.lp.take_back(self.base)
        for group, side in enumerate(sides):
            if side >= 0:
                self.add_side(group, side)
        for cell, facet in choice.items():
            self.add_cell(cell, facet)

    def solve(self, choice: Mapping[Cell, int], sides: tuple[int, ...]) -> Candidate | None:
        """The best path with these facets, or None."""
        self.lay(choice, sides)
        return self.resolve(dict(choice), sides)

    def descend(self, path: Candidate, more: Mapping[Cell, int], sides: tuple[int, ...]) -> Candidate | None:
        """The best path with facets added to those of `path`, whose rows are in place."""
        if sides != path.sides:
            return self.solve({**path.choice, **more}, sides)
        for cell, facet in more.items():
            self.add_cell(cell, facet)
        return self.resolve({**path.choice, **more}, sides)

    def split(
        self, path: Candidate, check: Recheck, new: Mapping[Cell, float]
    ) -> list[tuple[dict[Cell, int], tuple[int, ...]]] | None:
        """Children of a node as (facets to add, sides); None if its path lacks nothing."""
        for cell in new:
            self.seen.add(cell)
        facets = {cell: self.options(cell, check) for cell in new}
        forced = {cell: f[0] for cell, f in facets.items() if len(f) == 1}
        if any(not f for f in facets.values()):
            return []
        if forced:
            return [(forced, path.sides)]
        goal, last = self.rows.problem.goal.conditions, check.reference.chi[-1]
        for group, (N, c) in enumerate(goal.one_of):
            if path.sides[group] < 0 and np.max(N @ last - c) < -1e-9 * goal.scale:
                before, after = path.sides[:group], path.sides[group + 1 :]
                return [({}, (*before, side, *after)) for side in np.argsort(c - N @ last).tolist()]
        if not new:
            return None
        worst = max(new, key=lambda cell: new[cell])
        return [({worst: f}, path.sides) for f in facets[worst]]

    def near_sides(self, last: Array, sides: tuple[int, ...]) -> tuple[int, ...]:
        """Sides of the goal with the nearest one filled in where the last state meets none."""
        goal = self.rows.problem.goal.conditions
        out = []
        for (N, c), side in zip(goal.one_of, sides, strict=True):
            room = N @ last - c
            out.append(side if side >= 0 or np.max(room) >= -1e-9 * goal.scale else int(np.argmax(room)))
        return tuple(out)

    def options(self, cell: Cell, check: Recheck) -> list[int]:
        """Facets that can separate in a cell, those with most room first."""
        order = np.argsort(-check.surplus[cell[0]][cell[1]])
        return [int(f) for f in order if self.reachable(*cell, int(f))]

    def resolve(self, choice: dict[Cell, int], sides: tuple[int, ...]) -> Candidate | None:
        """The best path with the rows as they stand."""
        answer = self.lp.solve(self.deadline - perf_counter())
        if answer is None:
            return None
        x, N = answer[1], self.rows.N
        z = x[:N] - x[N : 2 * N]
        fuel = float(np.sum(self.rows.price * np.abs(z)))
        short = x[2 * N + 1] * self.rows.length
        return Candidate(z, x[2 * N], short if short > 1e-9 else 0.0, fuel, choice, sides)

    def recheck(self, path: Candidate) -> Recheck:
        """Exact re-check of a candidate."""
        nu = path.z.reshape(self.rows.problem.K, -1) * self.rows.problem.system.u_max
        return recheck(self.rows.problem, nu)

    def lacking(self, path: Candidate, check: Recheck) -> dict[Cell, float]:
        """Cells whose best certified clearance falls short of what was asked, with the shortfall [m]."""
        out: dict[Cell, float] = {}
        for i, surplus in enumerate(check.surplus):
            gap = surplus.max(axis=1) - self.rows.extra[i][:, 0] * path.level + path.short
            for k in np.nonzero(gap < 0)[0]:
                out[(i, int(k))] = -float(gap[k])
        return out

    def reachable(self, i: int, k: int, f: int) -> bool:
        """Whether facet f can separate in cell k at all, given the thrust limits."""
        if np.isfinite(self.prices[1]):
            return True  # clearances may be relaxed
        key = (i, k, f)
        if key not in self._reachable:
            rows = self.rows.cell(i, k, f)
            floor = min(self.levels.low, 0.0) * rows.slope
            self._reachable[key] = bool(np.all(self.rows.extreme(rows.a) >= rows.need + floor))
        return self._reachable[key]

    def pick(self, cell: Cell, surplus: Array, wish: int | None = None) -> int:
        """The wished facet if it can separate, else the one with the largest surplus that can."""
        if wish is not None and self.reachable(*cell, wish):
            return wish
        order = np.argsort(-surplus)
        return next((int(f) for f in order if self.reachable(*cell, int(f))), int(order[0]))

    def dive(
        self,
        wishes: Mapping[int, int],
        sides: tuple[int, ...],
        start: Mapping[Cell, int] | None = None,
        rounds: int = 12,
        worse_than: float = np.inf,
    ) -> Candidate | None:
        """Add cells as they are found lacking until none is; None if it does not settle."""
        choice = dict(start or {})
        path = self.solve(choice, sides)
        for _ in range(rounds):
            if path is None or perf_counter() > self.deadline:
                return None
            if path.fuel > worse_than and path.short == 0:
                return None
            check = self.recheck(path)
            lacking = self.lacking(path, check)
            new = [cell for cell in lacking if cell not in choice]
            self.book({c: v for c, v in lacking.items() if c in choice}, choice)
            if not lacking:
                near = self.near_sides(check.reference.chi[-1], sides)
                if near == sides:
                    return path
                sides = near
                path = self.solve(choice, sides)
                continue
            for i, k in new:
                facet = self.pick((i, k), check.surplus[i][k], wishes.get(i))
                choice[(i, k)] = facet
                self.add_cell((i, k), facet)
                self.seen.add((i, k))
            path = self.resolve(choice, sides) if new else self.solve(choice, sides)
        return None

    def book(self, short: Mapping[Cell, float], choice: Mapping[Cell, int]) -> None:
        """Book more length for constrained cells that still came out short in the re-check."""
        for (i, k), lack in short.items():
            self.rows.booking[i][k, choice[(i, k)]] += 1.5 * lack + 1e-4

    def improve(self, path: Candidate, rounds: int = 6) -> Candidate:
        """Re-choose facets where the path has most room, and solve again, while it pays."""
        for _ in range(rounds):
            check = self.recheck(path)
            choice = {c: self.pick(c, check.surplus[c[0]][c[1]]) for c in path.choice}
            better = self.dive({}, path.sides, choice, rounds=4)
            if better is None or not self.beats(better, path, 1e-5):
                break
            path = better
        return path

    def beats(self, a: Candidate, b: Candidate | None, by: float = 0.0) -> bool:
        """Whether a is better than b: less shortfall, then more margin, then less fuel."""
        if b is None:
            return True
        for x, y, scale in (
            (-a.short, -b.short, self.rows.length),
            (a.level, b.level, self.levels.high or 1.0),
        ):
            if abs(x - y) > 1e-6 * abs(scale):
                return x > y
        return a.fuel < b.fuel * (1 - by)

    def first(self) -> Candidate | None:
        """A good path without branching: natural facets, a near side of the goal, local improvement."""
        goal, K = self.rows.problem.goal.conditions, self.rows.problem.K
        none = (-1,) * len(goal.one_of)
        free = self.solve({}, none)
        if free is None:
            return None
        sides = self.near_sides(self.rows.trajectory(free.z)[0][K], none)
        best = self.dive({}, sides)
        return self.improve(best) if best is not None else None
