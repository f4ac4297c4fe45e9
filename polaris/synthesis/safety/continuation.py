"""Continuation of a flight by S: from which errors it keeps every limit to the end, and by which margin."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from reach.sets.zonotope import Zonotope

from ...model.system import Array
from ...model.tolerances import ROUNDING
from ..tracker.intersample import at_nodes
from .carried_rows import CarriedRows
from .clearance import Clearance, by_ends
from .recoverable import Margin, RecoverableSet, slack_share

COARSE = (
    0.5  # limits that a bound by the norm shows to need no more of the clearance are looked at only if needed
)
FIRST = 64  # limits of the least share by the norm, whose exact tightenings show which others matter

Where = tuple[NDArray[np.int_], NDArray[np.int_], NDArray[np.int_]]
"""Indices into `Limits.available`: end of the period (entries,), period (sets, entries), row (entries,)."""


class HandOver(NamedTuple):
    """Set of errors or loop states that S takes over at some node from `first` to `last`."""

    states: Zonotope
    first: int
    last: int


@dataclass(frozen=True, eq=False)
class PathRows:
    """Rows of the loop state under S along a path, and their tightenings by the node of the flight.

    All that is proven of S is the tightening of some rows against some limits: facets and thrust
    (`Continuation`), the conditions of a goal at a node, or a budget of commands. Tightenings at nodes
    alone are of the true state.
    """

    clearance: Clearance
    rows: Array
    faults: bool = True  # these two as `CarriedRows` has them
    between: bool = True

    @cached_property
    def table(self) -> CarriedRows:
        """Rows, carried back through S's loop."""
        return CarriedRows.from_tracking(self.clearance.tracking, self.rows, self.faults, self.between)

    @cached_property
    def path(self) -> Array:
        """Tightening by the path at both ends of each period, in the tail ever after, (2, periods + 1, r)."""
        clearance, plant = self.clearance, self.table.plant
        tightening = by_ends(clearance.scheduled(self.rows, self.between) + clearance.jumped(plant)[:, None])
        tightening = np.concatenate([tightening, np.stack([tightening[1, -1:]] * 2)], axis=1)
        tail = tightening[:, clearance.planned * clearance.q :]
        tail[:] = np.maximum.accumulate(tail[:, ::-1], axis=1)[:, ::-1]
        state_offset = np.abs(plant) @ clearance.tracking.system.state_offset_at_nodes
        return np.asarray(tightening + clearance.round_off(plant) + state_offset * (not self.between))

    def tightenings(self, hand_over: HandOver, first: int, last: int) -> Array:
        """Return the tightenings at both ends of the periods between two nodes, (2, last - first, r)."""
        ages = np.arange(first, last + 1)[:, None] - np.arange(hand_over.first, hand_over.last + 1)
        tightenings = self.table.tube(hand_over.states).at_ages(ages).max(axis=1)
        if not self.between:
            far = ages[:, -1] > self.clearance.tracking.long
            tightenings[far] = np.minimum(tightenings[far], self.table.long_after(hand_over.states))
        period = np.minimum(np.arange(first, last), self.path.shape[1] - 1)
        return np.stack([tightenings[:-1], tightenings[1:]]) + self.path[:, period]


@dataclass(eq=False)
class LimitsAhead:
    """Tightenings and clearances of a stack of sets along the limits ahead, shape (sets, entries).

    A tightening along the first entries, twice as many as `near` has, is the bound by the norm until it
    is worked out; the part due to disturbances is separate. The last entries, `beyond`, stand for all
    times beyond the settling horizon.
    """

    near: Array  # (sets, entries of the table)
    disturbance: Array  # (entries of the table,)
    beyond: Array  # (sets, rows)
    scheduled: Array
    clearance: Array
    places: Where
    exact: Callable[[NDArray[np.int_]], Array]
    """Exact tightenings of the table's entries with some indices, without `disturbance`."""

    def __post_init__(self) -> None:
        self._worked_out = np.zeros(self.near.shape[1], dtype=bool)

    @property
    def is_final(self) -> NDArray[np.bool_]:
        """Return True for the entries whose tightening is final, shape (entries,)."""
        return np.concatenate([self._worked_out] * 2 + [np.ones(self.beyond.shape[1], dtype=bool)])

    @property
    def tightening(self) -> Array:
        """Return the tightenings, rounded up."""
        near = self.near + self.disturbance
        tightening = np.hstack([near, near, self.beyond])
        return np.asarray(tightening * (1 + ROUNDING * np.sign(tightening)) + self.scheduled)

    def satisfied(self) -> NDArray[np.bool_]:
        """Return True where tightenings are less than the clearance, or nothing limits them."""
        clearance = self.clearance
        return (clearance > 0) & (self.tightening / np.where(clearance > 0, clearance, 1) < 1) | np.isinf(
            clearance
        )

    def work_out(self, entries: NDArray[np.bool_]) -> None:
        """Replace bounds by the norm by exact tightenings, where these are less, of entries (entries,)."""
        count = len(self.disturbance)
        pending = np.flatnonzero((entries[:count] | entries[count : 2 * count]) & ~self._worked_out)
        self._worked_out[pending] = True
        self.near[:, pending] = np.minimum(self.exact(pending), self.near[:, pending])


def _least(values: Array, count: int) -> NDArray[np.bool_]:
    """Return True for the least values, so many or all."""
    least = np.zeros(len(values), dtype=bool)
    least[np.argpartition(values, count - 1)[:count] if len(values) > count else slice(None)] = True
    return least


@dataclass(frozen=True, eq=False)
class Continuation(RecoverableSet):
    """All facets and thrust limits, carried back exactly through the closed loop (the default).

    ``C^t = {e : row_j Phi(t_j - t) e + disturbance <= clearance_j for every later t_j}``: exact for the
    chosen facets up to the intersample bound. Limits further away than the settling horizon of the
    loop are collected in one ball, which they can hardly touch (docs/theory.md, Proposition 11).
    """

    kind: ClassVar[str] = "polytope"

    @cached_property
    def table(self) -> CarriedRows:
        """Rows of the limits, carried back."""
        return CarriedRows.from_tracking(self.clearance.tracking, self.clearance.limits.rows)

    @cached_property
    def disturbance(self) -> Array:
        """Tightening besides the state, with the reference's round-off, by age, shape (settling + 3, r)."""
        tracking, table = self.clearance.tracking, self.table
        tightening = table.disturbance + self.clearance.round_off(table.plant)
        if tracking.feedback_bound is not None:  # a bound that falls is the first one, of which more is taken
            falls = tracking.feedback_bound[0] - np.vstack(
                [tracking.feedback_bound, tracking.feedback_bound[-1:]]
            )
            tightening[:, self.clearance.limits.levels :] += np.hstack([falls, falls])
        return tightening

    @cached_property
    def beside_errors(self) -> Array:
        """Tightening besides a true error, after any law, by age, shape (settling + 3, r)."""
        return self.disturbance + self.table.beside_errors

    @cached_property
    def _per_size(self) -> Array:
        """Bound on the tightening per unit of ``norm(W e)``, by lag, shape (settling + 2, r)."""
        sizes = self.table.sizes * (1 + ROUNDING)
        return np.asarray(np.maximum(sizes, np.concatenate([sizes[:1], sizes[:-1]])) + self.table.curvature)

    def _later(self, node: int) -> int:
        """Node from which on limits lie beyond the settling horizon, seen from a node."""
        # After the tail the reference repeats it: at any node, the whole tail lies ahead again.
        clearance = self.clearance
        return min(node + clearance.tracking.settling, clearance.planned * clearance.q)

    def _allowed(self, node: int) -> float:
        """Largest ``norm(W e)`` allowed by limits beyond the settling horizon, whoever has flown."""
        spare = self.clearance.limits.least_later[self._later(node)] - self.beside_errors[-1]
        return float(np.min(spare / self.table.beyond, initial=np.inf))

    def _limits_ahead(
        self,
        at: NDArray[np.int_],
        sets: Zonotope,
        intersample: Array,
        sizes: tuple[Array, Array],
        spare: float,
    ) -> "LimitsAhead":
        """Return all limits with a tightening that may exceed a share `spare` of their clearance.

        Of a stack of sets of the loop state at the nodes `at`, the first one least, or at the only one, with
        bounds on ``norm(W e)`` and on the other states of each. The entries are those of the table, where a
        period begins and where one ends, and one per row for all times beyond the settling horizon.
        """
        radius, others = sizes
        limits, table = self.clearance.limits, self.table
        r, last = len(limits.rows), limits.available.shape[1] - 1
        threshold = spare * limits.least_later[at[0]] - (1 - spare) * limits.max_tightening
        per_state, between = table.per_state
        from_others = per_state @ others.max(axis=0, initial=0.0)
        upper = (self._per_size * radius.max() + from_others[:-1] + self.disturbance[:-1]) * (1 + ROUNDING)
        lag, row = np.nonzero(upper > threshold)
        size, curvature, response = (
            part[lag, row] for part in (self._per_size, table.curvature, self.disturbance)
        )
        near = np.multiply.outer(radius, size) + others @ per_state[lag, row].T

        def exact(entries: NDArray[np.int_]) -> Array:
            tightening = table.supports(lag[entries], row[entries], sets, intersample) + np.multiply.outer(
                radius, curvature[entries]
            )
            return np.asarray(tightening + others @ between[lag[entries], row[entries]].T)

        node, start = at[:, None] + lag, self._later(int(at[0]))
        end, rows = np.repeat([0, 1, 0], [len(lag), len(lag), r]), np.concatenate([row, row, np.arange(r)])
        period = np.hstack([node, node - 1, np.full((len(at), r), start)])
        indices = end, np.clip(period, 0, last), rows
        clearance, by_time = limits.available[indices], limits.tightening[indices]
        clearance[(period < at[0]) | (period > last)] = np.inf
        clearance[:, -r:], by_time[:, -r:] = limits.least_later[start], limits.max_tightening
        beyond = np.multiply.outer(radius, table.beyond) + others @ per_state[-1].T + self.disturbance[-1]
        return LimitsAhead(near, response, beyond, by_time, clearance + by_time, (end, period, rows), exact)

    def _shares(self, *tube: Any) -> tuple[Array, Array, Array, Where]:
        """Return share of the clearance left, tightening, clearance and place of the limits ahead.

        They are exact wherever the least share may be; elsewhere the tightening is a larger one, by the norm.
        """
        limits_ahead = self._limits_ahead(*tube)
        limits_ahead.work_out(_least(self._slack(limits_ahead).min(axis=0), FIRST))
        share = self._slack(limits_ahead).min(axis=0)
        limits_ahead.work_out(np.asarray(share <= share[limits_ahead.is_final].min(initial=np.inf)))
        return self._slack(limits_ahead), limits_ahead.tightening, limits_ahead.clearance, limits_ahead.places

    def _slack(self, limits: "LimitsAhead") -> Array:
        """Return the slack as shares of the clearance; a limit of `levels` that is met is no tightest one."""
        share, rows = slack_share(limits.tightening, limits.clearance), limits.places[2]
        share[np.isinf(limits.clearance) | ((rows >= self.clearance.limits.levels) & (share >= 0))] = np.inf
        return share

    def _satisfied(
        self, at: NDArray[np.int_], sets: Zonotope, intersample: Array, sizes: tuple[Array, Array]
    ) -> NDArray[np.bool_]:
        """Return True where a share of 0 or more is left of every limit, without working out how much."""
        limits_ahead = self._limits_ahead(at, sets, intersample, sizes, 1.0)
        satisfied = limits_ahead.satisfied()
        if not satisfied.all():
            limits_ahead.work_out(np.asarray(~satisfied.all(axis=0)))
            satisfied = limits_ahead.satisfied()
        return np.asarray(np.all(satisfied, axis=1))

    def _sizes(self, sets: Zonotope, intersample: Array) -> tuple[Array, Array]:
        """Bounds over a tube on ``norm(W e)``, and on the other loop states at every node.

        Errors between two nodes are as large as the larger node's.
        """
        W, (radius, others) = self.clearance.tracking.W, self.table.sizes_of(sets)
        return np.full(
            len(intersample), np.max(radius + np.linalg.norm(intersample @ np.abs(W).T, axis=-1))
        ), others

    def tightest(self, first: int, sets: Zonotope, intersample: Array) -> Margin:
        """Margin of sets at nodes that follow one another from `first` on (`RecoverableSet.tightest`)."""
        sets = self.clearance.tracking.loop_state(sets)
        at, sizes = first + np.arange(len(intersample)), self._sizes(sets, intersample)
        shares = self._shares(at, sets, intersample, sizes, COARSE)
        if not shares[0].min() < 1 - COARSE:  # limits left out may be tighter than this one
            spare = max((1 - float(shares[0].min())) * (1 - ROUNDING), np.finfo(float).tiny)
            shares = self._shares(at, sets, intersample, sizes, spare)
        share, tightening, clearance, (end, period, row) = shares
        tight = i, entry = np.unravel_index(int(np.argmin(share)), share.shape)
        start, limit = int(period[tight]), int(row[entry])
        node, limits, q = start + int(end[entry]), self.clearance.limits, self.clearance.q
        if entry >= len(row) - len(
            limits.rows
        ):  # beyond the settling horizon: the start of the tightest step
            start = node = (start + int(limits.available[:, start:, limit].min(axis=0).argmin())) // q * q
        value, needed, available = (float(part[tight]) for part in (share, tightening, clearance))
        time = node * self.clearance.tracking.flow.h
        return Margin(value, limits.name(start // q, limit), time, needed, available)

    def holds(self, k: int, nodes: Zonotope, intersample: Array) -> bool:
        """Return True if a tube over cell k is inside: only cases left open by the norm are worked out."""
        first, intersample, nodes = (
            k * self.clearance.q,
            at_nodes(intersample),
            self.clearance.tracking.loop_state(nodes),
        )
        return bool(
            np.all(
                self._satisfied(
                    first + np.arange(len(intersample)), nodes, intersample, self._sizes(nodes, intersample)
                )
            )
        )

    def contains(self, node: int, errors: Array) -> NDArray[np.bool_]:
        """Return True for each error (runs, n) at a node that is recoverable."""
        errors = np.atleast_2d(errors)
        radius = np.linalg.norm(errors @ self.clearance.tracking.W.T, axis=-1)
        inside = np.asarray(radius <= self._allowed(node))
        if inside.any():
            points = Zonotope(errors[inside], np.zeros((int(inside.sum()), errors.shape[1], 0)))
            points = self.clearance.tracking.loop_state(points)
            sizes = self.table.sizes_of(points)
            inside[inside] = self._satisfied(np.array([node]), points, 0 * errors[inside], sizes)
        return inside

    def radius(self, node: int) -> float:
        """Return the radius of the largest ball ``norm(W e) <= r`` inside the set at a node."""
        allowed, per_size = self._allowed(node), self.table.sizes + self.table.curvature
        for end in (0, 1):  # of the periods that begin and that end at a node
            clearance = self.clearance.limits.available[end, node : node + len(per_size) - end]
            lags = slice(end, end + len(clearance))
            allowed = float(np.min((clearance - self.beside_errors[lags]) / per_size[lags], initial=allowed))
        return max(0.0, allowed)  # also where it is no number
