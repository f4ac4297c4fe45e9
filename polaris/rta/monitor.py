"""The online Polaris monitor: U flies as long as S could still take over when the next decision takes effect.

From the measured state and its error bound, the reachable set of U at the end of the next decision
interval, latency included, must be recoverable; else S flies. U is taken at nothing but the thrust limits,
or, where that is asked for, at its declared model as long as its command cannot be clipped.

Why this is a proof: whoever flies, the state is recoverable when a decision takes effect. If S is chosen,
it stays safe for ever. If U is, every state that it can reach at the nodes up to the next moment of effect
meets the facets there, the path between nodes too (`polaris.rta.recovery`), and at that moment the state
is recoverable again.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..model.checks import whole
from ..model.errors import ScenarioError
from ..model.system import Array
from ..synthesis.controllers import AffineController
from .method import Choice, Claim, Seen
from .prospect import Leg, Prospect
from .quick import QuickProspect
from .recovery import Recovery
from .scene import Scene

TRUST = ("declared", "thrust_limits")


class Monitor:
    """The online monitor as a method of the arena.

    Parameters
    ----------
    scene : Scene
    trust : {"declared", "thrust_limits"}
        What is assumed of U: by default nothing but the thrust limits, so that no fault of U can break the
        proof; ``declared``: its law (and its thrust limits where the law would clip). Controllers that may do
        anything are always taken at the limits.
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
    reasons: tuple[str, ...] = ("U is recoverable", "U is not recoverable", "dwell in S")
    delayed = True

    def __init__(self, scene: Scene, trust: str = "thrust_limits", dwell: int = 1) -> None:
        if trust not in TRUST:
            raise ScenarioError("trust", trust, f"must be one of {', '.join(TRUST)}")
        self.dwell = whole("dwell", dwell, 1)
        self.settings = {"dwell": float(self.dwell)}
        if trust == "declared":
            self.key, self.name = "monitor_declared", "Polaris online monitor, U at its declared law"
        self.scene, self.recovery, self.trust = scene, Recovery.certified(scene), trust
        any_thrust, safe = Leg.any_thrust(self.recovery), Leg.declared(self.recovery, 0)
        befores = {0: safe, 1: any_thrust} if scene.delay else {0: None, 1: None}
        self.cautious = {
            flown: Prospect(self.recovery, before, any_thrust, scene.half_widths)
            for flown, before in befores.items()
        }
        self.declared: dict[tuple[int, int], Prospect] = {}
        for mode, law in enumerate(scene.controllers):
            if mode and trust == "declared" and isinstance(law, AffineController):
                leg = Leg.declared(self.recovery, mode)
                for flown, before in befores.items():
                    self.declared[mode, flown] = Prospect(self.recovery, before, leg, scene.half_widths)
        every = {**self.declared, **{(0, flown): prospect for flown, prospect in self.cautious.items()}}
        self._quick = {key: QuickProspect(prospect) for key, prospect in every.items()}
        self._since = np.zeros(0, dtype=int)
        self.start_share = self.recovery.start_share

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
        if len(e) == 1:
            return self._decide_one(seen.k, e[0], int(seen.mode[0]))
        mode, margin = self.judge(seen.k, e, seen.mode)
        why = np.where(mode > 0, 0, 1)
        waiting = (mode > 0) & (seen.mode == 0) & (self._since < self.dwell)
        mode, why = np.where(waiting, 0, mode), np.where(waiting, 2, why)
        self._since = np.where(mode > 0, self.dwell, np.where(seen.mode > 0, 1, self._since + 1))
        return Choice(mode, margin, why)

    def _decide_one(self, k: int, e: Array, flown: int) -> Choice:
        """`decide` of one run: the same without arrays, which take longer than the decision itself."""
        mode, margin = self.judge_one(k, e, flown)
        since, why = int(self._since[0]), 0 if mode else 1
        if mode and flown == 0 and since < self.dwell:
            mode, why = 0, 2
        self._since[0] = self.dwell if mode else (1 if flown else since + 1)
        return Choice(np.array([mode]), np.array([margin]), np.array([why]))

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
        """`judge` of one run, e of shape (n,): the quick way through; not for several threads at once."""
        mode, share, _ = self._quickest(k, e, flown)
        return mode, 1 - share

    def explained(self, k: int, e: Array, flown: int) -> tuple[int, float, str]:
        """The same, and the tightest limit in words: its name, and when S would meet it."""
        mode, share, prospect = self._quickest(k, e, flown)
        return mode, 1 - share, prospect.limit() if prospect else "there is no experimental controller"

    def _quickest(self, k: int, e: Array, flown: int) -> tuple[int, float, QuickProspect | None]:
        """Mode; share of the room and prospect of the controller chosen, or of the best refused."""
        before, best, nearest = 1 if self.scene.delay and flown else 0, np.inf, None
        for candidate in range(1, len(self.scene.controllers)):
            prospect = self._quick.get((candidate, before), self._quick[0, before])
            share = prospect.share(k, e)
            if not prospect.holds:
                prospect = self._quick[0, before]
                share = prospect.share(k, e)
            if share <= 1:
                return candidate, share, prospect
            if nearest is None or share < best:
                best, nearest = share, prospect
        return 0, best, nearest
