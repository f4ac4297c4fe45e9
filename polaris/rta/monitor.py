"""The online Polaris monitor: U flies as long as S could still take over when the next decision takes effect.

From the measured state and its error bound, the reachable set of U at the end of the next decision
interval, latency included, must be recoverable; else S flies. U may be taken at its declared model, or at
nothing but the thrust limits (always where its command might be clipped).

Why this is a proof: whoever flies, the state is recoverable when a decision takes effect. If S is chosen,
it stays safe for ever. If U is, every state that it can reach at the nodes up to the next moment of effect
meets the facets there, the path between nodes too (`polaris.rta.recovery`), and at that moment the state
is recoverable again.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reach.flow import LinearFlow

from ..checks import whole
from ..controllers import AffineController
from ..errors import NotCertified, ScenarioError
from ..system import Array
from ..tolerances import ROUNDING
from .method import Choice, Claim, Seen
from .recovery import Recovery
from .scene import Scene

TRUST = ("declared", "thrust_limits")


@dataclass(frozen=True, eq=False)
class Stage:
    """Where a flight is some nodes after a measurement: ``e -> M e + offset(k) + G b, |b_i| <= 1``."""

    M: Array
    offset: Array
    G: Array


class Leg:
    """How one controller moves errors from node to node.

    Parameters
    ----------
    recovery : Recovery
    mode : int
    declared : bool
        Whether it is taken at its declared (unclipped) law, else at the thrust limits.
    """

    def __init__(self, recovery: Recovery, mode: int, declared: bool) -> None:
        scene = recovery.scene
        system, law = scene.system, scene.controllers[mode]
        self.declared = declared
        nodes = scene.clearance.planned * scene.clearance.q
        if declared:
            assert isinstance(law, AffineController)
            self.law = law
            flow = scene.tracking.feedback.flow(system, law.gain, scene.tracking.delta)
            zeta = scene.own[mode][: nodes + 1] - scene.xi[: nodes + 1] if mode in scene.own else 0.0
            self.zeta = np.broadcast_to(zeta, (nodes + 1, system.n))
            self.steps = self.zeta[1:] - self.zeta[:-1] @ flow.phi.T
            self.G = flow.period_zonotope.G
        else:
            flow = recovery.open_flow
            size = np.abs(system.B) @ system.u_max
            push = flow.input_zonotope(system.B, np.diag(system.u_max), size)
            self.steps = -scene.mu[:nodes] @ flow.input_map(system.B).T
            self.G = np.hstack([push.G, flow.period_zonotope.G])
        self.phi = flow.phi
        self.flow: LinearFlow = flow

    def after(self, stage: Stage, shift: int) -> Stage:
        """One node further; the stage is `shift` nodes after the measurement."""
        steps = np.zeros_like(stage.offset)
        available = self.steps[shift:]
        steps[: len(available)] = available[: len(steps)]
        return Stage(
            self.phi @ stage.M,
            stage.offset @ self.phi.T + steps,
            np.hstack([self.phi @ stage.G, self.G]),
        )


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
        scene = recovery.scene
        n, c = scene.system.n, scene.nodes
        self.recovery, self.scene = recovery, scene
        self.last = scene.clearance.planned * scene.clearance.q
        stages = [Stage(np.eye(n), np.zeros((self.last, n)), np.diag(half_widths))]
        for i in range(scene.delay + c):
            flying = before if before is not None and i < scene.delay else leg
            stages.append(flying.after(stages[-1], i))
        self.inner, self.end = stages[scene.delay + 1 : -1], stages[-1]
        self.command = _Command(scene, leg, stages[scene.delay :]) if leg.declared else None
        # One product gives the end, what the norms need, and the commands.
        W = scene.tracking.W
        blocks = [self.end.M, *(W @ stage.M for stage in stages)]
        known = [self.end.offset, *(stage.offset @ W.T for stage in stages)]
        if self.command is not None:
            blocks.append(self.command.matrix)
            known.append(self.command.known)
        self.stack, self.known = np.vstack(blocks).T.copy(), np.hstack(known)[::c].copy()
        self.commands = n * (1 + len(stages))
        self.radius = max(recovery.size(stage.G) for stage in stages) * (1 + ROUNDING)
        self.tall = recovery.tall(self.end.G)
        self.inner_tall = [recovery.tall(stage.G) for stage in self.inner]

    def share(self, k: int, e: Array) -> tuple[Array, Any]:
        """Share of the room needed if U flies on, and whether its law holds (its command is not clipped).

        Parameters
        ----------
        k : int
            Decision.
        e : ndarray, shape (R, n) or (n,)
            Errors as measured at it.
        """
        n, first = e.shape[-1], k * self.scene.nodes + self.scene.delay
        if first + self.scene.nodes > self.last:  # nothing is planned up to the next moment of effect
            return np.full(e.shape[:-1], np.inf), np.ones(e.shape[:-1], dtype=bool)
        moved = e @ self.stack
        moved += self.known[k]
        squares = (moved[..., n : self.commands] ** 2).reshape(*e.shape[:-1], -1, n)
        size = np.sqrt(squares.sum(axis=-1).max(axis=-1)) + self.radius
        share = self.recovery.share(first + self.scene.nodes, moved[..., :n], size, self.tall)
        for j, (stage, tall) in enumerate(zip(self.inner, self.inner_tall, strict=True)):
            there = e @ stage.M.T + stage.offset[k * self.scene.nodes]
            share = np.maximum(share, self.recovery.facets_share(first + j + 1, there, size, tall))
        if self.command is None:
            return share, True
        return share, self.command.holds(moved[..., self.commands :], size)

    def tightest(self, k: int, e: Array) -> str:
        """What an error (n,) measured at decision k comes nearest to."""
        node = k * self.scene.nodes + self.scene.delay + self.scene.nodes
        if node > self.last:
            return "the end of the plan"
        moved = e @ self.end.M.T + self.end.offset[k * self.scene.nodes]
        size = float(np.linalg.norm(self.scene.tracking.W @ moved)) + self.radius
        return self.recovery.tightest(node, moved, size, self.tall)


class _Command:
    """Where the command of a declared law stays within the thrust limits over all of its periods."""

    def __init__(self, scene: Scene, leg: Leg, stages: list[Stage]) -> None:
        law, system, q = leg.law, scene.system, scene.clearance.q
        count = len(stages[0].offset)
        W_size = np.linalg.norm(scene.tracking.W_inverse, axis=1)
        sampled = scene.tracking.feedback.sampled
        matrices, known, room, per_size = [], [], [], []
        steps = np.repeat(law.own.nu[: scene.clearance.planned], q, axis=0)[:count]
        for j in range(len(stages) - 1):
            cells = np.minimum(np.arange(count) + scene.delay + j, count - 1)
            for end in (0,) if sampled else (0, 1):
                stage = stages[j + end]
                zeta = leg.zeta[np.minimum(np.arange(count) + scene.delay + j + end, count)]
                matrices.append(-law.gain @ stage.M)
                known.append(steps[cells] + (zeta - stage.offset) @ law.gain.T)
                spread = np.abs(law.gain @ stage.G).sum(axis=1)
                bent = np.zeros((system.m, system.n))
                if not sampled:
                    spread = spread + 2 * np.abs(law.gain) @ leg.flow.period_box
                    curve = np.abs(law.gain @ leg.flow.A_c @ leg.flow.A_c) @ leg.flow.growth
                    bent = leg.flow.h**2 / 8 * curve
                    spread = spread + bent @ np.abs(leg.zeta).max(axis=0)
                room.append(system.u_max * (1 - ROUNDING) - spread)
                per_size.append(bent @ W_size)
        self.matrix, self.known = np.vstack(matrices), np.hstack(known)
        self.room, self.per_size = np.concatenate(room), np.concatenate(per_size)

    def holds(self, command: Array, size: Array) -> Any:
        """Whether commands (..., rows) at the nodes are within the limits, from node to node too."""
        room = self.room - np.multiply.outer(size, self.per_size)
        return (np.abs(command) <= room).all(axis=-1)


class Monitor:
    """The online monitor as a method of the arena.

    Parameters
    ----------
    scene : Scene
    trust : {"declared", "thrust_limits"}
        What is assumed of U: its declared law (and its thrust limits where the law would clip), or the
        thrust limits alone. Controllers that may do anything are always taken at the limits.
    dwell : int
        Decisions for which S keeps control once it has it.

    Raises
    ------
    ScenarioError
        If an option has no such value.
    NotCertified
        If the initial set is not inside the first of its recoverable sets.
    """

    key = "monitor"
    name = "Polaris online monitor"
    reasons = ("U is recoverable", "U is not recoverable", "dwell in S")

    def __init__(self, scene: Scene, trust: str = "declared", dwell: int = 1) -> None:
        if trust not in TRUST:
            raise ScenarioError("trust", trust, f"must be one of {', '.join(TRUST)}")
        self.dwell = whole("dwell", dwell, 1)
        self.scene, self.recovery, self.trust = scene, Recovery(scene), trust
        any_thrust, safe = Leg(self.recovery, 1, False), Leg(self.recovery, 0, True)
        befores = {0: safe, 1: any_thrust} if scene.delay else {0: None, 1: None}
        self.cautious = {
            flown: Prospect(self.recovery, before, any_thrust, scene.half_widths)
            for flown, before in befores.items()
        }
        self.declared: dict[tuple[int, int], Prospect] = {}
        for mode, law in enumerate(scene.controllers):
            if mode and trust == "declared" and isinstance(law, AffineController):
                leg = Leg(self.recovery, mode, True)
                for flown, before in befores.items():
                    self.declared[mode, flown] = Prospect(self.recovery, before, leg, scene.half_widths)
        self._since = np.zeros(0, dtype=int)
        start = scene.schedule.safety.start
        self.start_share = float(self._start(start.c, start.G))
        if not self.start_share <= 1:
            raise NotCertified(
                "the initial set is not inside the first recoverable set of the online monitor:"
                f" it needs {self.start_share:.4g} of the room there"
            )

    def _start(self, c: Array, G: Array) -> Array:
        recovery = self.recovery
        size = np.asarray(np.linalg.norm(self.scene.tracking.W @ c) + recovery.size(G))
        return recovery.share(0, c, size, recovery.tall(G))

    @property
    def claim(self) -> Claim:
        """Proved; see the module."""
        what = "its declared model" if self.trust == "declared" else "nothing but its thrust limits"
        end = self.scene.schedule.safety.end.reason
        return Claim("proved", f"state estimate within its error bound, U obeys {what}; {end}")

    def start(self, runs: int) -> None:
        """Nobody dwells."""
        self._since = np.full(runs, self.dwell)

    def decide(self, seen: Seen) -> Choice:
        """The first controller that is recoverable, in order of preference; else S."""
        e = seen.estimate - self.scene.xi[seen.k * self.scene.nodes]
        mode, margin = self.judge(seen.k, e, seen.mode)
        why = np.where(mode > 0, 0, 1)
        waiting = (mode > 0) & (seen.mode == 0) & (self._since < self.dwell)
        mode, why = np.where(waiting, 0, mode), np.where(waiting, 2, why)
        self._since = np.where(mode > 0, self.dwell, np.where(seen.mode > 0, 1, self._since + 1))
        return Choice(mode, margin, why)

    def judge(self, k: int, e: Array, flown: NDArray[np.int_]) -> tuple[NDArray[np.int_], Array]:
        """Mode and margin (least share of room left, of the controller chosen or the best refused).

        Parameters
        ----------
        k : int
        e : ndarray, shape (R, n)
            Errors ``x - xi`` as measured.
        flown : ndarray of int, shape (R,)
            Modes that fly until the decision takes effect.
        """
        if len(e) == 1:
            chosen, left = self.judge_one(k, e[0], int(flown[0]))
            return np.array([chosen]), np.array([left])
        R = len(e)
        mode, margin = np.zeros(R, dtype=int), np.full(R, -np.inf)
        for candidate in range(1, len(self.scene.controllers)):
            share = np.full(R, np.inf)
            for before in (0, 1) if self.scene.delay else (0,):
                mine = ((flown != 0) == before) if self.scene.delay else np.ones(R, dtype=bool)
                if mine.any():
                    share[mine] = self._share(k, e[mine], candidate, before)
            undecided = mode == 0
            margin = np.where(undecided, np.maximum(margin, 1 - share), margin)
            mode = np.where(undecided & (share <= 1), candidate, mode)
        return mode, margin

    def _share(self, k: int, e: Array, candidate: int, before: int) -> Array:
        if (candidate, before) not in self.declared:
            return self.cautious[before].share(k, e)[0]
        share, holds = self.declared[candidate, before].share(k, e)
        if not holds.all():
            share[~holds] = self.cautious[before].share(k, e[~holds])[0]
        return share

    def judge_one(self, k: int, e: Array, flown: int) -> tuple[int, float]:
        """`judge` of one run, e of shape (n,): the quick way through."""
        before = 1 if self.scene.delay and flown else 0
        best = -np.inf
        for candidate in range(1, len(self.scene.controllers)):
            prospect = self.declared.get((candidate, before), self.cautious[before])
            share, holds = prospect.share(k, e)
            if not holds:
                share, _ = self.cautious[before].share(k, e)
            if share <= 1:
                return candidate, float(1 - share)
            best = max(best, float(1 - share))
        return 0, best
