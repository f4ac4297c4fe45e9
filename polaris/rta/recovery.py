"""Recoverable sets laid out for speed: one matrix for all times, one window of limits per decision.

An error at a node is recoverable if S, taking over there, keeps clear of every unsafe set and of its
thrust limits from there on. All conditions read ``row phi^l e + tightening <= limit(node + l)``, and neither
the rows nor the tightening depends on time: a decision is one product of a tall matrix with the error, one
with the reciprocals of the limits (a window of one array), and one maximum.

The facets are drawn in by what any motion under any admissible input may stray from its chord between two
nodes (`Recovery.intersample`). So if two successive nodes meet the facets of the cell between them, the
path from one to the other does, whoever flies.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from reach.sets.zonotope import Zonotope
from reach.tubes.flow import LinearFlow

from ..model.errors import NotCertified
from ..model.system import Array
from ..model.tolerances import ROUNDING
from ..synthesis.safety.continuation import Continuation
from ..synthesis.safety.feedforward import hand_over_error
from .decision_grid import DecisionGrid

NEVER = 1e200  # reciprocal of a limit that leaves no clearance; times any error it is still a number
NEAR = 1500  # limits per set that are always worked out; those further ahead are first bounded all at once


@dataclass(frozen=True, eq=False)
class SetDemand:
    """Demand of error sets of one shape on every limit.

    `tall` (L r, n + 2) is ``[row phi^l, per unit of size, constant]``, applied to ``[e, size, 1]``, size a
    bound on ``norm(W e)`` over the set. Its first `near` rows are always worked out; the share of the
    clearance that the others need is at most ``base + slope size``.
    """

    tall: Array
    near: int
    base: float
    slope: float


@dataclass(frozen=True, eq=False)
class Recovery:
    """Conditions under which S saves the day from a node on."""

    grid: DecisionGrid

    @classmethod
    def certified(cls, grid: DecisionGrid, decided: DecisionGrid | None = None) -> "Recovery":
        """Return the conditions if the initial set meets them at the first node, as every proof requires.

        Those of `decided`, if given: a grid with grown unsafe sets, whose conditions imply those of `grid`.
        Raises `NotCertified` if the initial set does not meet the conditions of `grid`.
        """
        recovery, start = cls(grid), grid.tracking.error(grid.schedule.safety.start)
        size = np.asarray(np.linalg.norm(grid.tracking.W @ start.c) + recovery.size(start.G))
        share = float(recovery.share(0, start.c, size, recovery.demand(start.G)))
        if not share <= 1:
            raise NotCertified(
                "the initial set is not inside the first recoverable set of the run-time methods:"
                f" it needs {share:.4g} of the clearance there"
            )
        return recovery if decided is None or decided is grid else cls(decided)

    @cached_property
    def sets(self) -> Continuation:
        """S from any node of the grid on."""
        return Continuation(self.grid.clearance)

    @cached_property
    def rows(self) -> Array:
        """Facets, then ``+Lambda`` and ``-Lambda``, once or twice (see `Limits`), shape (r, n)."""
        return self.sets.table.plant

    @property
    def lags(self) -> int:
        """Number L of nodes each set looks ahead to, its own included."""
        return len(self.grid.tracking.transitions)

    @cached_property
    def matrix(self) -> Array:
        """``[row phi^l, tightening per unit of norm(W e)]``, shape (L r, n + 1), lag by lag."""
        tracking = self.grid.tracking
        carried, slope = self.sets.table.carried[..., : tracking.system.n], self.sets.table.curvature.copy()
        slope[:, : len(self._curvature)] += self._curvature * tracking.decay_before[:, None]
        slope += ROUNDING * np.abs(carried) @ np.linalg.norm(tracking.W_inverse, axis=1)
        out = np.concatenate([carried, slope[..., None]], axis=-1)
        return np.ascontiguousarray(out.reshape(-1, out.shape[-1]))

    @cached_property
    def tightening(self) -> Array:
        """Tightening of every row by S's disturbance, round-off and the path between nodes, shape (L r,)."""
        out = self.sets.beside_errors[: self.lags].copy()
        out[:, : len(self.intersample)] += self.intersample + self._curvature * self._radius
        return np.asarray(out.reshape(-1) * (1 + ROUNDING))

    @cached_property
    def _radius(self) -> float:
        """Bound on ``norm(W e)`` reached under S by all that pushes, at any node, however late."""
        tracking = self.grid.tracking
        error = hand_over_error(tracking, self.grid.clearance.reference)
        box = replace(tracking.flow, w_max=0.0, E=self.grid.system.B * error).period_box
        input_radius = float(np.linalg.norm(np.abs(tracking.W) @ box)) * (tracking.accumulated + 1.0)
        return tracking.disturbance_radius + input_radius

    @cached_property
    def open_flow(self) -> LinearFlow:
        """Motion under a known command within the limits, from node to node; errors of thrusters included."""
        system = self.grid.system
        E = system.error_map(system.thrusters.error(system.u_max))
        return LinearFlow.continuous(system.A, system.D, system.w_max, self.grid.h, E)

    @cached_property
    def intersample(self) -> Array:
        """Intersample bound per facet [m], (o,): inputs and disturbance take no path farther off its chord.

        By ``h^2/8`` times the second derivative, commands being held; a rate along the row that is not
        constant in a period takes it off by another ``h/2`` times its bound.
        """
        system, flow = self.grid.system, self.open_flow
        rows = self.grid.clearance.obstacle_rows[0]
        spread = 2 * system.u_max  # |u - mu|, of commands
        input_box = LinearFlow.continuous(system.A, system.B * spread, 1.0, self.grid.h).period_box
        within = input_box + flow.period_box
        rate = rows @ system.A
        applied = spread + system.thrusters.error(system.u_max)
        curvature = np.abs(rate @ system.A) @ within + np.abs(rate @ system.B) @ applied
        impulses = system.impulse_rates[
            :, system.m * bool(system.timing.carried_impulse) :
        ]  # not constant over a period
        curvature = curvature + np.abs(rate @ system.unknown).sum(axis=1)
        curvature = flow.h**2 / 8 * (curvature + np.linalg.norm(rate @ system.D, axis=1) * system.w_max)
        varying = np.abs(rows @ impulses).sum(axis=1) + np.linalg.norm(rows @ system.D, axis=1) * system.w_max
        uneven = system.thrusters.error(system.u_max) + spread * bool(system.transients)  # a fault begins
        varying = varying + np.abs(rows @ system.B) @ uneven
        return np.asarray(curvature + flow.h / 2 * varying)

    @cached_property
    def _curvature(self) -> Array:
        """Intersample bound by the error itself per unit of ``norm(W e)`` at the start of a period, (o,)."""
        flow, rows = self.open_flow, self.grid.clearance.obstacle_rows[0]
        size = np.linalg.norm(self.grid.tracking.W_inverse, axis=1)
        return np.asarray(flow.h**2 / 8 * np.abs(rows @ flow.A_x @ flow.A_x) @ flow.growth @ size)

    @cached_property
    def limits(self) -> Array:
        """Least clearance of every row at every node (at a border, of both cells), (nodes + L + 1, r)."""
        begin, end = self.grid.clearance.limits.available
        out = np.full((len(begin) + 1 + self.lags, len(self.rows)), np.inf)
        out[: len(begin)] = begin
        out[1 : len(end) + 1] = np.minimum(out[1 : len(end) + 1], end)
        return out

    @cached_property
    def _jump(self) -> Array:
        """Tightening of `limits` by the jump into the tail; it counts against the whole clearance."""
        out = np.zeros_like(self.limits)
        out[self.grid.last :] = self.grid.clearance.jump_tightening(self.rows)
        return out

    @cached_property
    def reciprocals(self) -> Array:
        """``1 / (limits + jump)``, flat: node by node, row by row."""
        available = self.limits + self._jump
        with np.errstate(divide="ignore"):
            return np.asarray(np.where(available > 0, 1 / available, NEVER).reshape(-1))

    @cached_property
    def shares(self) -> Array:
        """Share of the clearance that the jump uses, flat as `reciprocals`."""
        return np.asarray(self._jump.reshape(-1) * self.reciprocals)

    def window(self, node: int) -> Array:
        """The limits that a set at a node must meet, shape (L r,)."""
        return np.asarray(self.limits[node : node + self.lags].reshape(-1))

    def size(self, G: Array) -> float:
        """Bound on ``norm(W e)`` over the set about zero with these generators (n, g)."""
        return float(Zonotope(np.zeros(len(G)), G).norm_bound(self.grid.tracking.W))

    def demand(self, G: Array) -> SetDemand:
        """Return the demand of sets with generators G (n, g) on the rows."""
        r, W_inverse = len(self.rows), self.grid.tracking.W_inverse
        tightening = self.tightening + np.abs(self.matrix[:, :-1] @ G).sum(axis=1) * (1 + ROUNDING)
        first = min(max(NEAR // r, 1), self.lags)
        tightest, jump = self.reciprocals.reshape(-1, r).max(axis=0), self.shares.reshape(-1, r).max(axis=0)
        size = np.linalg.norm(self.matrix[:, :-1] @ W_inverse, axis=1) * (1 + ROUNDING) + self.matrix[:, -1]
        slope, base = size.reshape(-1, r) * tightest, tightening.reshape(-1, r) * tightest + jump
        far = (float(part[first:].max(initial=0.0)) for part in (base, slope))
        return SetDemand(np.ascontiguousarray(np.hstack([self.matrix, tightening[:, None]])), first * r, *far)

    def share(self, node: int, e: Array, size: Array, demand: SetDemand) -> Array:
        """Share of the available clearance that sets of errors need at the tightest place; above 1: too much.

        About centres e (..., n), with bounds (...) on ``norm(W e)``. Where the bound on the far lags is all
        that matters, the result is that bound: never too small.
        """
        first, vector = node * len(self.rows), extended(e, size)
        tightening = self._tightenings(vector, first, demand, slice(demand.near))
        beyond = self.far_shares[node, :, 0] + np.multiply.outer(size, self.far_shares[node, :, 1])
        share = np.maximum(tightening.max(axis=-1), beyond.max(axis=-1))
        far_share = demand.base + demand.slope * size
        if (far_share > 1).any():
            far_share = self._tightenings(vector, first, demand, slice(demand.near, None)).max(
                axis=-1, initial=0.0
            )
        return np.asarray(np.maximum(share, far_share))

    def _tightenings(self, vector: Array, first: int, demand: SetDemand, part: slice) -> Array:
        """Shares of the clearance needed at some of a demand's rows; `first`: where its limits begin."""
        limits = slice(first, first + len(demand.tall))
        tightening = vector @ demand.tall[part].T
        tightening *= self.reciprocals[limits][part]
        tightening += self.shares[limits][part]
        return tightening

    def far(self, node: int) -> float:
        """Largest ``norm(W e)`` at a node with which all limits beyond the settling horizon are met."""
        allowed = self._far[0]
        return float(allowed[min(node, len(allowed) - 1)])

    @cached_property
    def _far(self) -> tuple[Array, Array, Array]:
        """`far` at all nodes; shares of the clearance used without any error, and per unit of ``norm(W e)``.

        `intersample` and `_bent` count here too: U may take over when S has flown for longer than
        the settling horizon, and the facets of the node where it does were met by this condition alone.
        """
        tracking, clearance = self.grid.tracking, self.grid.clearance
        tail, o = (clearance.cells - clearance.planned) * clearance.q, len(self.intersample)
        ends = self.grid.clearance.limits.available
        tightening = np.zeros_like(ends) + self.sets.beside_errors[-1] * (1 + ROUNDING)
        path = (self.intersample + self._curvature * self._radius) * (1 + ROUNDING)
        tightening[0, : self.grid.last + 1, :o] += path  # after T nobody but S flies
        tightening[1, : self.grid.last, :o] += path
        weight = tracking.per_size(self.rows)
        weight[:o] += self._curvature
        # The tail repeats itself for ever: an error is at least as old as one tail when that begins.
        weight *= tracking.decay[min(tail, len(tracking.decay) - 1) if tail else -1]
        allowed = np.min((ends - tightening) / np.maximum(weight, 1e-300), axis=2)
        jump = np.stack([self._jump[: ends.shape[1]], self._jump[1 : ends.shape[1] + 1]])
        possible, available = allowed > 0, np.maximum(ends + jump, 1 / NEVER)
        base = np.where(possible, np.max((tightening + jump) / available, axis=2), NEVER)
        steep = np.where(possible, np.max(weight / available, axis=2), NEVER)
        last = self.grid.last if tail else ends.shape[1]
        at = np.minimum(np.arange(len(self.limits)) + tracking.settling, last)
        worst = np.stack([-allowed, base, steep]).max(axis=1)  # of both ends
        worst = np.hstack([worst, [[-np.inf], [0.0], [0.0]]])  # nothing limits beyond the last period
        later = np.maximum.accumulate(worst[:, ::-1], axis=1)[:, ::-1][:, at]
        return -later[0], later[1], later[2]

    @cached_property
    def far_shares(self) -> Array:
        """Share of the clearance after settling, at most the larger of ``a + b norm(W e)``, (nodes, 2, 2).

        The largest of the limits' shares is convex in the norm, and at most 1 at the largest allowed. Below
        that the chord lies above it, beyond that the line of the steepest share.
        """
        allowed, base, steep = self._far
        slope = np.where(allowed > 0, (1 - base) / np.where(allowed > 0, allowed, 1.0), NEVER)
        beyond = 1 - steep * np.where(np.isinf(allowed), 0.0, allowed)
        return np.stack([np.stack([base, slope], axis=1), np.stack([beyond, steep], axis=1)], axis=1)

    @cached_property
    def names(self) -> list[str]:
        """Names of the limits, one for every row."""
        clearance, axes = self.grid.clearance, self.grid.system.input_names
        index = clearance.obstacle_rows[1]
        names = [
            " or ".join(dict.fromkeys(u.name for o, u in enumerate(clearance.unsafe) if row in index[:, o]))
            for row in range(len(self.intersample))
        ]
        return [*names, *axes * ((len(self.rows) - len(names)) // len(axes))]


def extended(e: Array, size: Array) -> Array:
    """``[e, size, 1]``, shape (..., n + 2)."""
    out = np.ones((*e.shape[:-1], e.shape[-1] + 2))
    out[..., :-2] = e
    out[..., -2] = size
    return out
