"""The joint of two legs: the nodes of GO, from whose states the next leg starts (Proposition 12 (d))."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from reach.numerics.linear import growth

from ...model.system import Array
from ...model.tolerances import ROUNDING
from ..safety.continuation import PathRows
from ..safety.end_condition import in_hills_frame
from ..schedule.arrival import Tail, slack_factor
from ..schedule.rules import CHECKED
from ..schedule.schedule import Schedule

Windows = list[tuple[int, int]]


@dataclass(frozen=True)
class Joint:
    """Instants at which S may hand over to the next leg, and the estimates required of flight software then.

    Nodes count from the end of the horizon, T.
    """

    center: Array  # of the next leg's start set, (n,)
    half_widths: Array  # of the estimates that give GO, (n,): those of the start set less errors of estimates
    first: Windows  # nodes, first and last, that S reaches once, in the tail
    later: Windows
    """Phases of one turn, in periods since T, at which nodes may lie in all later turns."""
    assured: bool  # True if every estimate of an admissible flight is in the GO box at these nodes
    nearest: tuple[float, int, int]
    """Least share of the start set that S's set takes at a node, the row that takes it, and the node."""

    def nodes(self, turn: float, end: int, since: int) -> int | None:
        """Return the first node from `since` on at which GO may be given; None if there is none.

        `turn` is the length of a turn in periods, infinite where the reference rests, and `end` the last node
        of the tail.
        """
        early = [max(a, since) for a, b in self.first if b >= since]
        if early or not self.later:
            return min(early, default=None)
        node = max(end + 1, since)
        if np.isinf(turn):
            return node
        for at in range(node, node + int(np.ceil(turn)) + 2):
            if any(a <= at % turn <= b for a, b in self.later):
                return at
        return None


def joint(schedule: Schedule, center: Array, half_widths: Array, only: int | None = None) -> Joint:
    """Return when every state under S is within a box, and the box of estimates that show it.

    Parameters
    ----------
    schedule : Schedule
        Of a leg; S flies on after its horizon.
    center, half_widths : ndarray, shape (n,)
        The next leg's start set.
    only : int, optional
        The one node after T at which GO may be given, where later legs have sets that move.
    """
    safety = schedule.safety
    tracking, K = safety.tracking, safety.problem.K
    system, q, rows = (
        tracking.system,
        safety.clearance.q,
        np.vstack([np.eye(len(center)), -np.eye(len(center))]),
    )
    sides = np.concatenate([center + half_widths, half_widths - center])
    tail, along = schedule.tail, PathRows(safety.clearance, rows, between=False)
    cells = safety.reference.fine(q)[K:]
    states = np.concatenate([safety.reference.chi[K][None], *(cell[1:] for cell in cells)])
    clearance = sides - states @ rows.T - ROUNDING * (np.abs(states) @ np.abs(rows).T + np.abs(sides))
    clearance = clearance - CHECKED * np.abs(np.concatenate([half_widths, half_widths]))
    tightening, settled = tail.tightenings(along, len(states)), _settled(tail, along, len(states))
    error = system.navigation + system.state_offset_at_nodes
    if system.error_by_step is not None:
        error = system.error_by_step[-1] + system.state_offset_at_nodes
    errors = np.concatenate([error, error])
    inside = np.all(tightening <= clearance, axis=1)
    shares = 1 + (tightening - clearance) / np.maximum(np.concatenate([half_widths, half_widths]), 1e-300)
    node = min(only, len(shares) - 1) if only is not None else int(np.argmin(shares.max(axis=1)))
    if only is not None:
        inside &= np.arange(len(states)) == only
    later, h = np.zeros(len(states), dtype=bool), tracking.flow.h
    curvature = np.max(np.abs(states @ (system.A @ system.A).T), axis=0) @ growth(system.A, h).T * h**2 / 8
    settled = settled + np.concatenate([curvature, curvature])
    if only is None and safety.end.horizon == "infinite":
        later = np.all(settled <= clearance, axis=1)
    checks = [tightening[inside] + 2 * errors <= clearance[inside], settled + 2 * errors <= clearance[later]]
    first, repeated = _windows(inside), _windows(later)
    if in_hills_frame(system):
        repeated = [(a, b) for a, b in repeated if b > a]  # no node need lie at a single phase
    assured = bool(first or repeated) and all(map(np.all, checks))
    nearest = float(shares[node].max()), int(shares[node].argmax()), node
    return Joint(center, np.asarray(half_widths * (1 - ROUNDING) - error), first, repeated, assured, nearest)


def turn_periods(schedule: Schedule) -> float:
    """Return the length of a turn of the reference after T in periods; infinite where it rests."""
    safety = schedule.safety
    eta, h = safety.problem.system.mean_motion, safety.tracking.flow.h
    rests = not np.any(safety.problem.system.A @ safety.reference.chi[safety.problem.K])
    if rests or eta is None or not in_hills_frame(safety.problem.system):
        return np.inf
    return float(2 * np.pi / eta / h)


def _settled(tail: Tail, along: PathRows, nodes: int) -> Array:
    """Bound rows at all nodes after the tail, shape (r,)."""
    node = tail.T + max(nodes, tail.safety.tracking.settling + 3)
    tightening = np.min([along.tightenings(each, node, node + 1)[0, 0] for each in tail.starts], axis=0)
    return np.asarray(tightening * (1 + slack_factor(tail.safety.tracking)))


def _windows(inside: NDArray[np.bool_]) -> Windows:
    """Return the first and the last index of every run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], inside, [False]]).astype(int)))
    return [(int(a), int(b) - 1) for a, b in edges.reshape(-1, 2)]
