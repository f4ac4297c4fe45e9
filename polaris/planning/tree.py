"""Branch and bound on separating facets, with rows that enter only where a relaxed path lacks them.

This decides the binaries of the mixed-integer program before a back end sees it. A node is a choice
of facets for some cells; its linear program leaves every other cell free, so its optimum bounds
everything below it. The path of the best open node is re-checked; where it lacks clearance most, the
node is split into one child per facet that can separate. No big-M, hence no weak relaxation; and
cells far from every obstacle are never looked at.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any

import numpy as np

from .search import Candidate, Cell, PathSearch

DIVE_EVERY, DIVE_EVERY_WANTING = 25, 5
"""Nodes between two dives from the best open node for a better path; more often while none has the
full margin."""


@dataclass(order=True)
class Node:
    """An open node: its bound, a tie breaker, its path (which holds the choices), its simplex basis."""

    bound: float
    number: int
    path: Candidate = field(compare=False)
    basis: Any = field(compare=False)


@dataclass(eq=False)
class Outcome:
    """What the tree found out: best path or None, bound, and "optimal", "infeasible" or "open"."""

    best: Candidate | None
    bound: float
    status: str
    nodes: int
    cells: frozenset[Cell]


def branch(
    search: PathSearch,
    best: Candidate | None,
    gap: float,
    deadline: float,
    max_nodes: int,
    listen: Callable[[float, float], None],
    hand_over: tuple[float, int] = (np.inf, 0),
) -> Outcome:
    """Minimise the search's objective over all facet choices.

    Parameters
    ----------
    search : PathSearch
        With levels and prices set.
    best : Candidate or None
        A certified path with the same levels.
    gap : float
        Relative gap at which to stop.
    deadline : float
        Value of `time.perf_counter` at which to stop with the tree open.
    max_nodes : int
        Linear programs after which to stop with the tree open.
    listen : callable
        Told the incumbent and the bound.
    hand_over : tuple of (float, int)
        Stop at this earlier time too, if no more than this many cells were touched.
    """
    groups = len(search.rows.problem.goal.conditions.one_of)
    touched: set[Cell] = set(best.choice) if best is not None else set()
    root = search.solve({}, (-1,) * groups)
    if root is None:
        status = "infeasible" if perf_counter() < deadline else "open"
        return Outcome(best, np.inf if status == "infeasible" else -np.inf, status, 1, frozenset(touched))
    heap = [Node(search.value(root), 0, root, search.lp.basis())]
    top = search.value(best) if best is not None else np.inf
    count, bound, popped, dropped = 1, heap[0].bound, 0, np.inf

    def cut() -> float:
        return top - gap * abs(top) if np.isfinite(top) else np.inf

    while heap:
        node = heap[0]
        bound = max(bound, min(node.bound, top))
        listen(top, bound)
        if node.bound >= cut():
            break
        soft = perf_counter() > hand_over[0] and len(touched) <= hand_over[1]
        if soft or perf_counter() > deadline or count > max_nodes:
            return Outcome(best, min(bound, dropped), "open", count, frozenset(touched))
        heapq.heappop(heap)
        popped += 1
        path = node.path
        check = search.recheck(path)
        lacking = search.lacking(path, check)
        search.book({c: v for c, v in lacking.items() if c in path.choice}, path.choice)
        stale = any(c in path.choice for c in lacking)
        new = {c: v for c, v in lacking.items() if c not in path.choice}
        split = search.split(path, check, new)
        if split is None:
            if not stale:
                if search.value(path) < top:
                    best, top = path, search.value(path)
                continue
            split = [({}, path.sides)]  # only booked lengths were short: solve the node again
        touched |= new.keys()
        wanting = best is None or best.level < search.levels.high * (1 - 1e-9)
        if popped % (DIVE_EVERY_WANTING if wanting else DIVE_EVERY) == 0:
            found = search.dive({}, path.sides, path.choice)
            if found is not None and found.short == 0 and search.value(found) < top:
                best, top = found, search.value(found)
                touched |= found.choice.keys()
        search.lay(path.choice, path.sides)
        mark = search.lp.rows
        for more, sides in split:
            search.lp.take_back(mark)
            search.lp.use(node.basis)
            child = search.descend(path, more, sides)
            count += 1
            if child is None:
                if perf_counter() > deadline:
                    return Outcome(best, min(bound, dropped), "open", count, frozenset(touched))
            elif search.value(child) < cut():
                heapq.heappush(
                    heap, Node(max(search.value(child), node.bound), count, child, search.lp.basis())
                )
            else:
                dropped = min(dropped, search.value(child))
    else:
        if best is None:
            return Outcome(None, np.inf, "infeasible", count, frozenset(touched))
        bound = top
    return Outcome(best, min(bound, dropped, top), "optimal", count, frozenset(touched))
