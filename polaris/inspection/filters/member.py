"""One deputy of a group that shares what it knows by messages that may be lost.

Each works out the same plans for all, from what all have told, and takes its own; who misses a message goes
on with the plan it has. New plans are proven for all that may come of it (``docs/inspection-theory.md``, 6).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ...model.checks import shaped
from ...model.errors import ScenarioError
from ...model.system import Array
from ...model.tolerances import FARTHEST
from ...rta.filter_input import MEMORY
from ..backup.planner import Proven
from .assured import Explicit, Implicit


class Message(NamedTuple):
    """Message of a deputy each period: its estimated state (6,), wanted thrust (3,) [N] and plan.

    The plan (L+1, 1, 6) is from the period's start t [s] on; the tube about it is (L+1, 1, 2). The `rule` is
    `Assured.settings` of its filter.
    """

    t: float
    x: Array
    wanted: Array
    plan: Array
    tube: Array
    rule: tuple[object, ...]


class Member:
    """The filter of one deputy: decides on its thrust from the messages that reached it.

    Parameters
    ----------
    me : int
        Number of this deputy.
    rule : Explicit or Implicit
        Filter that all would follow who had heard all; its planner must be `mixed`. Not shared with others.
    t : float
        Time [s] at which all know the states `x`, before there is anything to lose.
    x : ndarray, shape (N, 6)
        Those estimates.

    Attributes
    ----------
    moved : bool
        True if the last answer was the common one, and not the plan's.
    unproven : bool
        True if the state was not known or not within the tube, or the call not in time, since the plan was
        made, or another deputy's rule is not this one's: the assumptions do not hold, and what follows is
        unproven until there is a new plan.

    Raises
    ------
    ScenarioError
        If the planner is not mixed, the filter remembers whom it latched, or no plan from there is proven.
    """

    def __init__(self, me: int, rule: Explicit | Implicit, t: float, x: Array) -> None:
        if not isinstance(rule, Explicit | Implicit):
            raise ScenarioError("rule", type(rule).__name__, "must give equal answers to equal messages")
        if not rule.planner.mixed:
            raise ScenarioError("rule", type(rule).__name__, "needs a planner with mixed=True")
        self.me, self.rule, self.brake = me, rule, rule.brake
        proven = rule.planner.find(t, shaped("x", x, (rule.inspection.deputies, 6)))
        if not proven.good:
            worst = int(proven.margins.argmin())
            detail = f"{rule.check.labels[worst]} would be {proven.margins[worst]:.3g}"
            raise ScenarioError("x", x.tolist(), f"must have a proven plan: {detail}")
        self._none = np.zeros(len(rule.check.labels))
        self._due, self._plan = t, self._part(proven)
        self._next = np.array(x[me], dtype=float)  # the state that follows from the last known one
        self._unknown_s = 0.0  # for how long it has not been known [s]
        self.moved = self.unproven = False

    def message(self, x: Array, wanted: Array) -> Message:
        """Return the message to all, at an estimated state (6,) and with a wanted thrust (3,) [N]."""
        plan, tube = self._plan[:2]
        copies = np.array(x, dtype=float), np.array(wanted, dtype=float)
        return Message(self._due, *copies, plan, tube, self.rule.settings)

    def decide(self, t: float, messages: Sequence[Message | None]) -> Array:
        """Thrust (3,) [N] of the period that begins at t [s]; messages of all, the own among them, by number.

        None stands for one that has not arrived; one of another period or rule counts as such.
        """
        own_message, D = messages[self.me], self.brake.period
        if own_message is None:
            raise ScenarioError("messages", self.me, "must be the number of another deputy")
        sent = [message for message in messages if message is not None]
        same_rule = [message for message in sent if message.rule == self.rule.settings]
        current = [message for message in same_rule if abs(message.t - t) <= 1e-6 * D]
        self.unproven |= len(same_rule) < len(sent)
        measured, proven = _is_usable(own_message.x), self._plan
        on_time, self._due = abs(t - self._due) <= 1e-6 * D, (t if np.isfinite(t) else self._due) + D
        self._unknown_s = 0.0 if measured else self._unknown_s + D
        known = on_time and (measured or (self.brake.uncertainty.exact and self._unknown_s <= MEMORY))
        x = own_message.x if measured else self._next if known else proven.plan[0, 0]
        if on_time and len(current) == len(messages) and all(_is_usable(message.x) for message in current):
            plans = [Proven(message.plan, message.tube, np.zeros(0), t) for message in current]
            count = max(len(each.plan) for each in plans)
            longer, tubes = zip(*(self.rule.planner.extended(each, count) for each in plans), strict=True)
            time = current[0].t  # clocks may differ by rounding; all who move go by the same
            self.rule.take_over(Proven(np.hstack(longer), np.hstack(tubes), self._none, time))
            states, desired = np.array([m.x for m in current]), np.array([m.wanted for m in current])
            decision = self.rule.filter(time, states, desired)
            if self.rule.plan is not None:  # it has been proven
                self.moved, self._plan = True, self._part(self.rule.plan)
                self.unproven &= bool(decision.on_backup[self.me])
                return self._applied(x, decision.u[self.me])
        self.moved, self.unproven = False, self.unproven or not (known and self.rule.near(x, proven).all())
        later = self.rule.planner.extended(proven, 3)
        self._plan = Proven(later[0][1:], later[1][1:], self._none, self._due)
        return self._applied(x, self.brake.follow(x[None], proven.plan)[0])

    def _applied(self, x: Array, u: Array) -> Array:
        """Return a thrust (3,) [N], and note where it leads from a state (6,)."""
        Phi, Gamma = self.brake.motion
        self._next = Phi @ x + Gamma @ u
        return u

    def _part(self, proven: Proven) -> Proven:
        """The part of the plans of all that is this deputy's."""
        deputy = slice(self.me, self.me + 1)
        return Proven(proven.plan[:, deputy], proven.tube[:, deputy], self._none, proven.t)


def _is_usable(x: Array) -> bool:
    """Return True if an estimated state (6,) has numbers only, none beyond `FARTHEST`."""
    return bool((np.abs(x) <= FARTHEST).all())  # false for nan
