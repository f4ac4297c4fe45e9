"""What may have become of an error when the next decision takes effect, and whether S can still take over.

Everything that does not depend on the measurement is worked out beforehand.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from reach.tubes.flow import LinearFlow

from ..model.system import Array
from ..model.tolerances import ROUNDING
from ..synthesis.controllers import AffineController
from .decision_grid import DecisionGrid
from .recovery import Recovery


@dataclass(frozen=True, eq=False)
class Stage:
    """Where a flight is some nodes after a measurement: ``e -> M e + offset(k) + G b, |b_i| <= 1``."""

    M: Array
    offset: Array
    G: Array


@dataclass(frozen=True, eq=False)
class Leg:
    """How one controller moves errors from node to node: ``e -> phi e + steps[node] + G b``.

    Attributes
    ----------
    flow : LinearFlow
        Its motion, over the spacing of the nodes.
    steps : ndarray, shape (nodes, n)
    G : ndarray, shape (n, g)
    law : AffineController or None
        Whose declared, unclipped law this is.
    zeta : ndarray, shape (nodes, 2, n)
        Its own reference minus the safe one, at both ends of every period: waypoints of a reference need
        not join.
    """

    flow: LinearFlow
    steps: Array
    G: Array
    law: AffineController | None = None
    zeta: Array = field(default_factory=lambda: np.zeros((0, 2, 0)))

    @classmethod
    def declared(cls, recovery: Recovery, mode: int) -> Leg:
        """A controller at its declared law, unclipped."""
        grid, law = recovery.grid, recovery.grid.controllers[mode]
        assert isinstance(law, AffineController)
        system, nodes = grid.system, grid.last
        flow = grid.tracking.feedback.flow(system, law.gain, grid.tracking.delta)
        zeta = np.zeros((nodes, 2, system.n))
        if mode in grid.own:
            clearance = grid.clearance
            arcs = law.own.fine(clearance.q)[: clearance.planned] - clearance.nodes[: clearance.planned]
            zeta = np.stack([arcs[:, :-1], arcs[:, 1:]], axis=2).reshape(nodes, 2, system.n)
        return cls(flow, zeta[:, 1] - zeta[:, 0] @ flow.phi.T, flow.period_zonotope.G, law, zeta)

    @classmethod
    def held(cls, recovery: Recovery) -> Leg:
        """An input that is held from node to node, less what it does: ``input_map`` adds that."""
        grid, flow = recovery.grid, recovery.open_flow
        steps = -grid.mu[: grid.last] @ flow.input_map(grid.system.B).T
        return cls(flow, steps, flow.period_zonotope.G)

    @classmethod
    def any_thrust(cls, recovery: Recovery) -> Leg:
        """Anything within the thrust limits."""
        system, held = recovery.grid.system, cls.held(recovery)
        size = np.abs(system.B) @ system.u_max
        push = held.flow.input_zonotope(system.B, np.diag(system.u_max), size)
        return replace(held, G=np.hstack([push.G, held.G]))

    def after(self, stage: Stage, shift: int) -> Stage:
        """One node further; the stage is `shift` nodes after the measurement."""
        steps = np.zeros_like(stage.offset)
        available = self.steps[shift:]
        steps[: len(available)] = available[: len(steps)]
        phi = self.flow.phi
        return Stage(phi @ stage.M, stage.offset @ phi.T + steps, np.hstack([phi @ stage.G, self.G]))


class Prospect:
    """What is checked before U may fly on: everything that does not depend on the measurement.

    Parameters
    ----------
    recovery : Recovery
    before : Leg or None
        Who flies during the latency; None without one.
    leg : Leg
        Who flies afterwards.
    half_widths : ndarray, shape (n,)
        Of the measurement's error.
    """

    def __init__(self, recovery: Recovery, before: Leg | None, leg: Leg, half_widths: Array) -> None:
        grid = recovery.grid
        n, c = grid.system.n, grid.nodes
        self.recovery, self.grid = recovery, grid
        stages = [Stage(np.eye(n), np.zeros((grid.last, n)), np.diag(half_widths))]
        for i in range(grid.delay + c):
            flying = before if before is not None and i < grid.delay else leg
            stages.append(flying.after(stages[-1], i))
        self.inner, self.end = stages[grid.delay + 1 : -1], stages[-1]
        self.command = _Command(grid, leg, stages[grid.delay :]) if leg.law is not None else None
        # One product gives the end, what the norms need, and the commands.
        W = grid.tracking.W
        blocks = [self.end.M, *(W @ stage.M for stage in stages)]
        known = [self.end.offset, *(stage.offset @ W.T for stage in stages)]
        if self.command is not None:
            blocks.append(self.command.matrix)
            known.append(self.command.known)
        self.stack, self.known = np.vstack(blocks).T.copy(), np.hstack(known)[::c].copy()
        self.commands = n * (1 + len(stages))
        self.radius = max(recovery.size(stage.G) for stage in stages) * (1 + ROUNDING)
        self.demand = recovery.demand(self.end.G)
        self.inner_demand = [recovery.demand(stage.G) for stage in self.inner]

    def share(self, k: int, e: Array) -> tuple[Array, Any]:
        """Share of the room needed if U flies on, and whether its law holds (its command is not clipped).

        Parameters
        ----------
        k : int
            Decision.
        e : ndarray, shape (R, n) or (n,)
            Errors as measured at it.
        """
        n, first = e.shape[-1], k * self.grid.nodes + self.grid.delay
        if first + self.grid.nodes > self.grid.last:  # nothing is planned up to the next moment of effect
            return np.full(e.shape[:-1], np.inf), np.ones(e.shape[:-1], dtype=bool)
        moved = e @ self.stack
        moved += self.known[k]
        size = self._size(moved, n)
        share = self.recovery.share(first + self.grid.nodes, moved[..., :n], size, self.demand)
        for j, (stage, demand) in enumerate(zip(self.inner, self.inner_demand, strict=True)):
            there = e @ stage.M.T + stage.offset[k * self.grid.nodes]
            share = np.maximum(share, self.recovery.facets_share(first + j + 1, there, size, demand))
        if self.command is None:
            return share, True
        return share, self.command.holds(moved[..., self.commands :], size)

    def size(self, k: int, e: Array) -> Array:
        """Bound on ``norm(W e)`` at every node until the next decision takes effect, shape (...)."""
        return self._size(e @ self.stack + self.known[k], e.shape[-1])

    def _size(self, moved: Array, n: int) -> Array:
        squares = (moved[..., n : self.commands] ** 2).reshape(*moved.shape[:-1], -1, n)
        return np.asarray(np.sqrt(squares.sum(axis=-1).max(axis=-1)) + self.radius)


class _Command:
    """Where the command of a declared law stays within the thrust limits over all of its periods."""

    def __init__(self, grid: DecisionGrid, leg: Leg, stages: list[Stage]) -> None:
        law, system, q = leg.law, grid.system, grid.clearance.q
        assert law is not None
        count = len(stages[0].offset)
        W_size = np.linalg.norm(grid.tracking.W_inverse, axis=1)
        sampled = grid.tracking.feedback.sampled
        matrices, known, room, per_size = [], [], [], []
        steps = np.repeat(law.own.nu[: grid.clearance.planned], q, axis=0)[:count]
        for j in range(len(stages) - 1):
            cells = np.minimum(np.arange(count) + grid.delay + j, count - 1)
            for end in (0,) if sampled else (0, 1):
                stage = stages[j + end]
                zeta = leg.zeta[cells, end]
                matrices.append(-law.gain @ stage.M)
                known.append(steps[cells] + (zeta - stage.offset) @ law.gain.T)
                spread = np.abs(law.gain @ stage.G).sum(axis=1)
                bent = np.zeros((system.m, system.n))
                if not sampled:
                    spread = spread + 2 * np.abs(law.gain) @ leg.flow.period_box
                    curve = np.abs(law.gain @ leg.flow.A_c @ leg.flow.A_c) @ leg.flow.growth
                    bent = leg.flow.h**2 / 8 * curve
                    spread = spread + bent @ np.abs(leg.zeta).max(axis=(0, 1))
                room.append(system.u_max * (1 - ROUNDING) - spread)
                per_size.append(bent @ W_size)
        self.matrix, self.known = np.vstack(matrices), np.hstack(known)
        self.room, self.per_size = np.concatenate(room), np.concatenate(per_size)

    def holds(self, command: Array, size: Array) -> Any:
        """Whether commands (..., rows) at the nodes are within the limits, from node to node too."""
        room = self.room - np.multiply.outer(size, self.per_size)
        return (np.abs(command) <= room).all(axis=-1)
