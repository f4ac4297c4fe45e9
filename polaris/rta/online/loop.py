"""The flight loop around the monitor: answers take effect in time, permissions end, S is always there."""

from collections.abc import Callable, Sequence
from math import inf, isfinite
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ...model.errors import ScenarioError
from ...model.system import Array
from ...model.tolerances import TIME
from ...model.untrusted import numbers, real
from .estimate import Measurement
from .runtime import OnlineMonitor
from .runtime_options import OnlineDecision

Law = Callable[[float, Array], ArrayLike]


class Command(NamedTuple):
    """Command to the thrusters.

    Attributes
    ----------
    mode : int
        Controller that flies: 0 is S, 1, 2, ... an experimental one.
    u : ndarray, shape (m,)
        Input within the limits [N].
    until : float
        It may be held until then at most [s]: a permission ends or an answer takes effect there.
    """

    mode: int
    u: Array
    until: float


class FlightLoop:
    """One call per decision and one per control period; S flies wherever U has no permission.

    An answer takes effect at ``number * period + latency``. U flies until its permission ends, unless a new
    one is there by then, or until it raises or returns no finite input: then it has lost its permission,
    and every one that waits. Decisions that are missed, refused or late thus cost what they would have
    allowed, and nothing else. Where the clock is at fault, S flies at once.

    Parameters
    ----------
    online : OnlineMonitor
    laws : sequence of callable, optional
        ``law(t, x)`` gives the input [N] of every controller at a time [s] and a state (n,), S first. The
        time is the clock's reading, right or wrong: where S must not depend on it, hand in a law with a
        clock of its own. By default the laws of the scenario, along the references at the node at or before
        t.

    Raises
    ------
    ScenarioError
        If there is not one law per controller of the scene.
    """

    def __init__(self, online: OnlineMonitor, laws: Sequence[Law] | None = None) -> None:
        self.online, self.grid = online, online.grid
        count = len(self.grid.controllers)
        if laws is not None and len(laws) != count:
            raise ScenarioError("laws", len(laws), f"must be {count}, one per controller, S first")
        self.laws = tuple(laws) if laws is not None else tuple(map(self._declared, range(count)))
        self._tol = TIME * self.grid.period
        self._waiting: list[tuple[float, OnlineDecision]] = []  # by moment of effect
        self._mode, self._until = 0, -inf  # who may fly, and how long
        self._newest = -inf  # every reading of the clock must be later
        self._last_time, self._x = 0.0, self.grid.xi[0].copy()  # last readings that could be used

    def _declared(self, mode: int) -> Law:
        last = len(self.grid.mu) - 1

        def law(t: float, x: Array) -> Array:
            node = int(min(max((t + self._tol) / self.grid.h, 0.0), last))
            return self.grid.clipped(mode, node, x)

        return law

    def decide(
        self,
        number: int,
        now: float,
        measurement: Measurement | None = None,
        *,
        applied: ArrayLike | None = None,
        reference: float | None = None,
    ) -> OnlineDecision:
        """Ask the monitor, once per period; never raises.

        Parameters
        ----------
        number : int
            Of the decision, missed ones included: counted by timer ticks, say, not by dividing `now`. It is
            the second opinion on the clock.
        now, measurement, applied, reference : as in `OnlineMonitor.step`
            As of `OnlineMonitor.step`.
        """
        answer = self.online.step(now, measurement, applied, reference, number)
        if answer.k < 0:  # the clock is at fault: nobody knows which permissions still count
            self._revoke()
            return answer
        # The monitor has checked this reading: a later one of `command` was wrong, no earlier one can follow.
        instant = answer.k * self.grid.period
        tolerance = self.online.limits.tolerance
        if self._newest > instant + 2 * tolerance + self._tol:
            self._newest = -inf
        self._newest = max(self._newest, instant - tolerance - self._tol)
        effect = instant + self.grid.latency
        if answer.mode == 0 or effect > self._newest + self._tol:  # else it came after its moment of effect
            self._waiting = [*self._waiting[-1:], (effect, answer)]
        return answer

    def command(self, now: float, x: ArrayLike) -> Command:
        """Return who flies now, and its input; to be called once per control period.

        Nothing that U does is raised. A state that is no finite numbers is replaced by the last good one,
        and S flies.

        Parameters
        ----------
        now : float
            The clock [s]. It is believed between decisions as long as every reading is later than the last
            one: another ends the permission, and those that wait.
        x : array_like, shape (n,)
            The state that S and U act on.
        """
        t, state = real(now), numbers(x, self._x.shape)
        valid = False
        if t is not None and isfinite(t):
            self._last_time, valid = t, t > self._newest
            if valid:
                self._newest = t
                self._take_effect(t)
        if state is not None and np.isfinite(state).all():
            self._x = state.copy()
        else:
            valid = False
        if not valid:
            self._revoke()
        if self._mode:
            u = self.online.command(self.laws[self._mode], self._last_time, self._x.copy())
            if u is not None:
                return Command(self._mode, u, min(self._until, self._next()))
            self._revoke()
        limit = self.grid.system.u_max
        u = np.clip(np.asarray(self.laws[0](self._last_time, self._x.copy()), dtype=float), -limit, limit)
        return Command(0, np.asarray(u), self._next())

    def isolated(self) -> None:
        """Say that a fault is isolated, or measurements come again: U flies by decisions on later ones alone.

        S takes over where the permission in force ends, with the latency no later than the next decision.
        """
        self._waiting = []

    def _take_effect(self, t: float) -> None:
        while self._waiting and t >= self._waiting[0][0] - self._tol:
            effect, answer = self._waiting.pop(0)
            self._mode, self._until = answer.mode, answer.until
        if not t < self._until - self._tol:
            self._mode = 0  # the permission has ended

    def _next(self) -> float:
        return self._waiting[0][0] if self._waiting else inf

    def _revoke(self) -> None:
        self._mode, self._until, self._waiting = 0, -inf, []
