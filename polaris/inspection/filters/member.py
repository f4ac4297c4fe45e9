"""One deputy of a group that shares what it knows by messages that may be lost.

Each works out the same plans for all, from what all have told, and takes its own; who misses a message goes
on with the plan it has. New plans are proven for all that may come of it (``docs/inspection-theory.md``, 6).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...model.errors import ScenarioError
from ...model.system import Array
from ..backup.planner import Proven
from .assured import Explicit, Implicit


class Message(NamedTuple):
    """What a deputy tells the others each period: estimated state (6,), wanted thrust (3,) [N], its plan.

    The plan (L+1, 6) is from now on; the tube about it is (L+1, 2).
    """

    x: Array
    wanted: Array
    plan: Array
    tube: Array


class Member:
    """The filter of one deputy: decides on its thrust from the messages that reached it.

    Parameters
    ----------
    me : int
        Which deputy this is.
    rule : Explicit or Implicit
        What all would do who had heard all; its planner must be `mixed`. Of its own: nobody else's.
    t : float
        Time [s] at which all know the states `x`, before there is anything to lose.
    x : ndarray, shape (N, 6)
        Those estimates.

    Attributes
    ----------
    moved : bool
        Whether the last answer was the common one, and not the plan's.
    unproven : bool
        Whether the state was not known, or not within the tube: the assumptions do not hold.

    Raises
    ------
    ScenarioError
        If the planner is not mixed, or no plan from there is proven.
    """

    def __init__(self, me: int, rule: Explicit | Implicit, t: float, x: Array) -> None:
        self.me, self.rule, self.brake = me, rule, rule.brake
        found = rule.planner.find(t, x)
        if not rule.planner.mixed:
            raise ScenarioError("rule", type(rule).__name__, "needs a planner that is mixed")
        if not found.good:
            worst = int(found.margins.argmin())
            told = f"{rule.check.labels[worst]} would be {found.margins[worst]:.3g}"
            raise ScenarioError("x", x.tolist(), f"no plan is proven from there: {told}")
        self.plan, self.tube = found.plan[:, me], found.tube[:, me]
        self.moved = self.unproven = False

    def message(self, x: Array, wanted: Array) -> Message:
        """What to tell all, at an estimated state (6,) and with a wanted thrust (3,) [N]."""
        return Message(np.array(x, dtype=float), np.array(wanted, dtype=float), self.plan, self.tube)

    def decide(self, t: float, told: Sequence[Message | None]) -> Array:
        """Thrust (3,) [N] of the period that begins at t [s]; messages of all, the own among them, by number.

        None stands for one that has not arrived.
        """
        own, heard = told[self.me], [message for message in told if message is not None]
        if own is None:
            raise ScenarioError("told", self.me, "a deputy knows what it tells itself")
        self.moved = False
        if len(heard) == len(told) and all(np.isfinite(message.x).all() for message in heard):
            count = max(len(message.plan) for message in heard)
            parts = [self.rule.planner.extended(_alone(message), count) for message in heard]
            plan, tube = (np.concatenate(values, axis=1) for values in zip(*parts, strict=True))
            self.rule.take_over(Proven(plan, tube, np.zeros(len(self.rule.check.labels))), t)
            x, wanted = np.array([m.x for m in heard]), np.array([m.wanted for m in heard])
            decision = self.rule.filter(t, x, wanted)
            self.moved = not decision.unproven
        if self.moved and self.rule.plan is not None:
            self.plan, self.tube = self.rule.plan.plan[:, self.me], self.rule.plan.tube[:, self.me]
            self.unproven = False
            return np.asarray(decision.u[self.me])
        seen = np.isfinite(own.x).all()
        x = np.where(seen, own.x, self.plan[0])
        error = self.brake.uncertainty
        self.unproven = not (seen or error.exact) or not self.rule.near(x[None], _alone(own)).all()
        u = np.asarray(self.brake.follow(x[None], self.plan[:, None])[0])
        plan, tube = self.rule.planner.extended(_alone(own), 3)
        self.plan, self.tube = plan[1:, 0], tube[1:, 0]
        return u


def _alone(message: Message) -> Proven:
    """The plan of one deputy."""
    return Proven(message.plan[:, None], message.tube[:, None], np.zeros(0))
