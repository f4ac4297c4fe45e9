"""Errors that are possible when the next decision takes effect, and the test that S can still take over.

Everything that does not depend on the measurement is worked out beforehand. Many errors are judged at once by
`Permission.share`, a single one in a few microseconds by `Permission.share_one`: the same arithmetic, up to
the order of sums.
"""

from dataclasses import dataclass, field, replace
from math import hypot, inf

import numpy as np
from numpy.typing import NDArray

from reach.tubes.flow import LinearFlow

from ..model.system import Array
from ..model.tolerances import ROUNDING
from ..synthesis.controllers.controllers import AffineController
from ..synthesis.safety.feedforward import hand_over_error
from .decision_grid import DecisionGrid
from .recovery import Recovery


@dataclass(frozen=True, eq=False)
class PredictedError:
    """Error of a flight some nodes after a measurement: ``e -> M e + offset(k) + G b, |b_i| <= 1``."""

    M: Array
    offset: Array
    G: Array


@dataclass(frozen=True, eq=False)
class ErrorMotion:
    """Motion of errors under one controller over a period of the nodes: ``e -> phi e + steps[node] + G b``.

    Of a declared, unclipped `law`, `zeta` (nodes, 2, n) is its own reference minus the safe one at both ends
    of every period: waypoints of a reference need not join.
    """

    flow: LinearFlow
    steps: Array
    G: Array
    law: AffineController | None = None
    zeta: Array = field(default_factory=lambda: np.zeros((0, 2, 0)))

    @classmethod
    def declared(cls, recovery: Recovery, mode: int) -> "ErrorMotion":
        """A controller at its declared law, unclipped on the exact state: the clip then adds to no error."""
        grid, law = recovery.grid, recovery.grid.controllers[mode]
        assert isinstance(law, AffineController)
        system, nodes = grid.system, grid.last
        error = law.error if mode else hand_over_error(grid.tracking, grid.clearance.reference)
        flow = grid.tracking.feedback.flow(system, law.gain, grid.tracking.delta, error)
        zeta = np.zeros((nodes, 2, system.n))
        if mode in grid.own_references:
            clearance = grid.clearance
            arcs = law.own.fine(clearance.q)[: clearance.planned] - clearance.nodes[: clearance.planned]
            zeta = np.stack([arcs[:, :-1], arcs[:, 1:]], axis=2).reshape(nodes, 2, system.n)
        return cls(flow, zeta[:, 1] - zeta[:, 0] @ flow.phi.T, flow.period_zonotope.G, law, zeta)

    @classmethod
    def held_input(cls, recovery: Recovery) -> "ErrorMotion":
        """An input that is held from node to node, without its effect: ``input_map`` adds that."""
        grid, flow = recovery.grid, recovery.open_flow
        steps = -grid.mu[: grid.last] @ flow.input_map(grid.system.B).T
        return cls(flow, steps, flow.period_zonotope.G)

    @classmethod
    def any_thrust(cls, recovery: Recovery) -> "ErrorMotion":
        """Anything within the thrust limits."""
        system, motion = recovery.grid.system, cls.held_input(recovery)
        size = np.abs(system.B) @ system.u_max
        push = motion.flow.input_zonotope(system.B, np.diag(system.u_max), size)
        return replace(motion, G=np.hstack([push.G, motion.G]))

    def advance(self, stage: PredictedError, shift: int) -> PredictedError:
        """Return the stage one node later; the given one is `shift` nodes after the measurement."""
        steps = np.zeros_like(stage.offset)
        available = self.steps[shift:]
        steps[: len(available)] = available[: len(steps)]
        phi = self.flow.phi
        return PredictedError(phi @ stage.M, stage.offset @ phi.T + steps, np.hstack([phi @ stage.G, self.G]))


class Permission:
    """Test before U may fly on, after a measurement within the grid's half widths.

    During the latency `before` flies (None without one), then `leg` does. For sets of such errors about a
    measured e, `stack` and `base` give the centre at the end, what bounds ``norm(W e)`` at every stage, and
    from column `commands` on the commands of a declared law.
    """

    def __init__(self, recovery: Recovery, before: ErrorMotion | None, leg: ErrorMotion) -> None:
        grid = recovery.grid
        n, c = grid.system.n, grid.nodes
        self.recovery, self.grid = recovery, grid
        stages = [PredictedError(np.eye(n), np.zeros((grid.last, n)), np.diag(grid.half_widths))]
        for i in range(grid.delay + c):
            flying = before if before is not None and i < grid.delay else leg
            stages.append(flying.advance(stages[-1], i))
        self.end = stages[-1]
        W = grid.tracking.W
        blocks = [self.end.M, *(W @ stage.M for stage in stages)]
        offsets = [self.end.offset, *(stage.offset @ W.T for stage in stages)]
        self.commands = n * (1 + len(stages))
        self.clearance = np.zeros(0)  # of the commands
        if leg.law is not None:
            matrix, offset, self.clearance = _commands(grid, leg, leg.law, stages[grid.delay :])
            blocks.append(matrix)
            offsets.append(offset)
        self.stack, self.base = np.vstack(blocks).T.copy(), np.hstack(offsets)[::c].copy()
        self.radius = max(recovery.size(stage.G) for stage in stages) * (1 + ROUNDING)
        self.demand = recovery.demand(self.end.G)
        self._lay_out_inner(stages[grid.delay + 1 : -1])
        near = self.demand.near
        self._near_rows = np.ascontiguousarray(self.demand.tall[:near].T)
        self._far_rows = np.ascontiguousarray(self.demand.tall[near:].T)
        self._norms = [(i, i + n) for i in range(n, self.commands, n)]
        self._clearances = self.clearance.tolist()
        self._beyond = recovery.far_shares.tolist()

    def _lay_out_inner(self, inner: list[PredictedError]) -> None:
        """The facets at the nodes before the end: one matrix, and one row of constants per decision."""
        recovery, o, n = self.recovery, len(self.recovery.intersample), self.grid.system.n
        facets, starts = recovery.matrix[:o], np.arange(len(self.base)) * self.grid.nodes
        self.inner, none = len(inner) * o, np.zeros((len(starts), 0))
        tightenings = [recovery.demand(stage.G).tall[:o, -1] for stage in inner]
        self.inner_rows = np.hstack([np.zeros((n, 0)), *((facets[:, :n] @ stage.M).T for stage in inner)])
        offsets = (stage.offset[starts] @ facets[:, :n].T for stage in inner)
        self.inner_base = np.hstack([none, *(a + b for a, b in zip(offsets, tightenings, strict=True))])
        self.inner_size = np.tile(facets[:, n], len(inner))
        nodes = starts[:, None] + self.grid.delay + 1 + np.arange(len(inner))
        limits = recovery.reciprocals.reshape(-1, len(recovery.rows))[:, :o]
        nodes = np.minimum(nodes, len(limits) - 1)  # later ones are never asked for
        self.inner_limits = limits[nodes].reshape(len(starts), -1)

    def inner_share(self, k: int, e: Array, size: Array, extra: Array | float = 0.0) -> Array:
        """Share of the clearance used by facets before the end, `size` bounding every ``norm(W e)``; (...).

        What `extra` (..., facets) is added to their rows by what the legs leave out.
        """
        tightening = (
            e @ self.inner_rows + extra + np.multiply.outer(size, self.inner_size) + self.inner_base[k]
        )
        return np.asarray((tightening * self.inner_limits[k]).max(axis=-1, initial=0.0))

    def share(self, k: int, e: Array) -> tuple[Array, NDArray[np.bool_]]:
        """Share of the clearance used if U flies on from measured errors (R, n) at decision k, shape (R,).

        Also whether the law of its leg holds, its command being not clipped.
        """
        R, n = e.shape
        end = (k + 1) * self.grid.nodes + self.grid.delay
        if end > self.grid.last:  # nothing is planned up to the next moment of effect
            return np.full(R, np.inf), np.ones(R, dtype=bool)
        predicted = e @ self.stack + self.base[k]
        size = self._size(predicted, n)
        share = self.recovery.share(end, predicted[:, :n], size, self.demand)
        if self.inner:
            share = np.maximum(share, self.inner_share(k, e, size))
        return share, (np.abs(predicted[:, self.commands :]) <= self.clearance).all(axis=-1)

    def size(self, k: int, e: Array) -> Array:
        """Bound on ``norm(W e)`` at every node until the next decision takes effect, shape (R,)."""
        return self._size(e @ self.stack + self.base[k], e.shape[-1])

    def _size(self, predicted: Array, n: int) -> Array:
        squares = (predicted[:, n : self.commands] ** 2).reshape(len(predicted), -1, n)
        return np.asarray(np.sqrt(squares.sum(axis=-1).max(axis=-1)) + self.radius)

    def share_one(self, k: int, e: Array) -> tuple[float, int, bool]:
        """Return `share` of one error (n,), the tightest limit's index (see `limit`), True if the law holds.

        Nothing else is worked out if it does not.
        """
        n, r, near = self.grid.system.n, len(self.recovery.rows), self.demand.near
        end = (k + 1) * self.grid.nodes + self.grid.delay
        if end > self.grid.last:
            return inf, 0, True
        predicted = np.dot(e, self.stack)
        predicted += self.base[k]
        values = predicted.tolist()
        size = max([hypot(*values[i:j]) for i, j in self._norms]) + self.radius
        for value, clearance in zip(values[self.commands :], self._clearances, strict=True):
            if not abs(value) <= clearance:
                return inf, 0, False
        vector = np.array([*values[:n], size, 1.0])
        share, index = self._worst(vector, self._near_rows, end * r)
        beyond = max([base + slope * size for base, slope in self._beyond[end]])
        if beyond > share:
            share, index = beyond, -1
        far_share = self.demand.base + self.demand.slope * size
        if far_share > 1:
            far_share, row = self._worst(vector, self._far_rows, end * r + near)
            index = near + row if far_share > share else index
        share = max(share, far_share)
        if self.inner:
            tightening = np.dot(e, self.inner_rows)
            tightening += self.inner_size * size
            tightening += self.inner_base[k]
            tightening *= self.inner_limits[k]
            worst = int(tightening.argmax())
            if tightening[worst] > share:
                j, row = divmod(worst, len(self.recovery.intersample))
                share, index = float(tightening[worst]), row + (j + 1 - self.grid.nodes) * r  # before the end
        return share, index, True

    def _worst(self, vector: Array, rows: Array, first: int) -> tuple[float, int]:
        """Largest share needed of some rows whose limits begin at `first`, and which of them needs it."""
        if not rows.shape[1]:
            return 0.0, 0
        limits = slice(first, first + rows.shape[1])
        tightening = np.dot(vector, rows)
        tightening *= self.recovery.reciprocals[limits]
        tightening += self.recovery.shares[limits]
        index = int(tightening.argmax())
        return float(tightening[index]), index

    def limit(self, k: int, index: int) -> str:
        """The tightest limit that `share_one` found, and when S would meet it, in words."""
        end = (k + 1) * self.grid.nodes + self.grid.delay
        if end > self.grid.last:
            return "the end of the plan"
        if index == -1:
            return "limits beyond the settling horizon"
        lag, row = divmod(index, len(self.recovery.rows))
        return f"{self.recovery.names[row]} at t = {(end + lag) * self.grid.h:g} s"


def _commands(
    grid: DecisionGrid, leg: ErrorMotion, law: AffineController, stages: list[PredictedError]
) -> tuple[Array, Array, Array]:
    """Commands ``matrix e + offsets`` at every node, within limits if at most ``clearance``."""
    system, count = grid.system, len(stages[0].offset)
    matrices, offsets, clearance = [], [], []
    steps = np.repeat(law.own.nu[: grid.clearance.planned], grid.clearance.q, axis=0)[:count]
    for j, stage in enumerate(stages[:-1]):
        cells = np.minimum(np.arange(count) + grid.delay + j, count - 1)
        matrices.append(-law.gain @ stage.M)
        offsets.append(steps[cells] + (leg.zeta[cells, 0] - stage.offset) @ law.gain.T)
        clearance.append(system.u_max * (1 - ROUNDING) - np.abs(law.gain @ stage.G).sum(axis=1))
    return np.vstack(matrices), np.hstack(offsets), np.concatenate(clearance)
