"""Branch and bound on separating facets, with rows that enter only where a relaxed path lacks them.

This decides the binaries of the mixed-integer program before a back end sees it. A node is a choice
of facets for some cells; its linear program leaves every other cell free, so its optimum bounds
everything below it. The path of the best open node is re-checked; where it lacks clearance, the
node is split into one child per facet that can separate. No big-M, hence no weak relaxation; and
cells far from every obstacle are never looked at. A child waits with a bound read off its parent's
simplex basis and is solved only when no open node has a lower one; most never are.
"""

import heapq
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any

import numpy as np

from ..model.system import Array
from .rows import Key
from .search import Candidate, PathSearch

DIVE_EVERY, DIVE_EVERY_WANTING = 10, 2
"""Splits between two dives from the best open node for a better path; more often while there is none."""

LOOK_AT = 8  # cells of which all facets are priced when a node is split


@dataclass(order=True)
class Node:
    """An open node: bound, tie breaker, facets, a basis with the number of them it knows, whether solved."""

    bound: float
    number: int
    choice: dict[Key, int] = field(compare=False)
    start: tuple[Any, int] | None = field(compare=False)
    solved: bool = field(default=False, compare=False)


@dataclass(eq=False)
class SearchOutcome:
    """Best path or None, bound, how it ended, nodes solved.

    It ended "optimal", "infeasible", or with what told it to stop ("effort_limit", "time_limit").
    """

    best: Candidate | None
    bound: float
    status: str
    nodes: int = 0


def branch(
    search: PathSearch,
    best: Candidate | None,
    gap: float,
    stop: Callable[[Candidate | None], str],
    listen: Callable[[float, float], None] = lambda top, bound: None,
) -> SearchOutcome:
    """Minimise the search's objective, at the prices set, over all facet choices, to a relative gap.

    `best` is a certified path at the same prices, if one is known. `stop` is asked before every node, given
    the best path so far, why to stop with the tree open (or ""); `listen` is told incumbent and bound.
    """
    tree = _Tree(search, best, gap)
    while tree.open:
        tree.bound = max(tree.bound, min(tree.open[0].bound, tree.top))
        listen(tree.top, tree.bound)
        if tree.open[0].bound >= tree.cut:
            return tree.outcome("optimal")
        reason = stop(tree.best) or tree.visit(heapq.heappop(tree.open))
        if reason:
            return tree.outcome(reason)
    tree.bound = tree.top
    return tree.outcome("infeasible" if tree.best is None else "optimal")


class _Tree:
    """Open nodes, lowest bound first, and the best path so far."""

    def __init__(self, search: PathSearch, best: Candidate | None, gap: float) -> None:
        self.search, self.best, self.gap = search, best, gap
        self.top = search.value(best) if best is not None else np.inf
        self.open = [Node(-np.inf, 0, {}, None)]
        self.bound, self.dropped = -np.inf, np.inf
        self.count = self.splits = 0

    @property
    def cut(self) -> float:
        """Bound from which on a node is of no more use."""
        return self.top - self.gap * abs(self.top) if np.isfinite(self.top) else np.inf

    def outcome(self, status: str) -> SearchOutcome:
        return SearchOutcome(self.best, min(self.bound, self.dropped, self.top), status, self.count)

    def visit(self, node: Node) -> str:
        """Solve a node, and close it, split it or put it back; return a reason to stop, or an empty text."""
        search = self.search
        path = search.solve(node.choice, node.start)
        self.count += 1
        if path is None:
            return "time_limit" if perf_counter() > search.deadline else ""
        value, start = max(search.value(path), node.bound), (search.lp.basis(), len(node.choice))
        if self.open and value > self.open[0].bound and not node.solved:
            heapq.heappush(self.open, Node(value, self.count, node.choice, start, True))
            return ""
        checked = search.look(path)
        lacking = search.lacking(path, checked)
        if lacking:
            self._split(node, path, lacking, value, start)
        elif value < self.top:
            if search.confirmed(path, checked):
                self.best, self.top = path, search.value(path)
            else:
                heapq.heappush(self.open, Node(value, self.count, node.choice, start))  # solve it again
        return ""

    def _split(
        self, node: Node, path: Candidate, lacking: Mapping[Key, float], value: float, start: tuple[Any, int]
    ) -> None:
        # the goal's disjunctions first, then the cells where most is lacking
        keys = sorted(lacking, key=lambda key: (key[0] >= 0, -lacking[key]))
        children, least = split(self.search.bounds(path, keys[:LOOK_AT]), value, self.cut)
        self.splits += 1
        self.dropped = min(self.dropped, least)
        for at_least, facets in children:
            heapq.heappush(self.open, Node(at_least, self.count, {**node.choice, **facets}, start))
        if self.splits % (DIVE_EVERY if self.best is not None else DIVE_EVERY_WANTING) == 0:
            improved = self.search.dive(path.choice)
            improved = self.search.improve(improved) if improved is not None else None
            if improved is not None and improved.short == 0 and self.search.value(improved) < self.top:
                self.best, self.top = improved, self.search.value(improved)


def split(
    bounds: Mapping[Key, Array], value: float, cut: float
) -> tuple[list[tuple[float, dict[Key, int]]], float]:
    """Children of a node, with their bounds, and the least bound of the parts that need no child.

    Cells with one facet left below the cut get it at once, all in one child. Otherwise the first cell
    is split.
    """
    floor = max(value, *(float(np.min(b)) for b in bounds.values()))
    if floor >= cut:
        return [], floor
    forced = {key: int(np.argmin(b)) for key, b in bounds.items() if np.sum(b < cut) == 1}
    first = next(iter(bounds))
    split_up = [forced] if forced else [{first: int(j)} for j in np.nonzero(bounds[first] < cut)[0]]
    children = [(max(floor, *(float(bounds[key][j]) for key, j in more.items())), more) for more in split_up]
    closed = np.concatenate([bounds[key] for key in forced or (first,)])
    return children, float(np.min(closed[closed >= cut], initial=np.inf))
