"""Arguments of a filter, made safe to compute with: unknown states, missing and impossible inputs."""

from collections.abc import Callable
from dataclasses import dataclass
from math import isfinite, isnan
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..model.system import Array
from ..model.tolerances import FARTHEST
from ..model.untrusted import kind_of, numbers, real

MEMORY = 60.0  # time [s] for which the last good state is propagated in place of an unknown one


class Formation(Protocol):
    """Craft of one kind that fly together, with n states and m inputs each."""

    @property
    def deputies(self) -> int:
        """Number of craft, N."""

    @property
    def thrust_max(self) -> float | Array:
        """Limit of every input [N], one number or shape (m,)."""

    def discretize(self, duration: float) -> tuple[Array, Array]:
        """Transition (n, n) over a time [s], and the effect of an input held meanwhile, (n, m)."""


def commanded(
    law: Callable[..., Any],
    arguments: tuple[Any, ...],
    shape: tuple[int, ...],
    caught: type[BaseException] = Exception,
) -> tuple[Array | None, str]:
    """Return an untrusted controller's command, an array of our own, and its faults, in words.

    None where it raises what is `caught` or answers no numbers of the shape; numbers need not be finite.
    """
    try:
        answer = law(*arguments)
    except caught as error:
        return None, f"raised {kind_of(error)}"
    u = numbers(answer)
    if u is None or u.shape != shape:
        detail = kind_of(answer) if u is None else f"of shape {u.shape}"
        return None, f"the command is malformed: {detail}"
    return u.copy(), "" if np.isfinite(u).all() else "the command is not finite"


@dataclass(frozen=True, eq=False)
class FilterInput:
    """One call of a filter, made safe: everything is finite.

    The time [s]; states (N, n), estimates where they are not `known`, zeros where not even `estimated`: then
    nothing could be propagated from the last good one. Desired thrusts (N, m), clipped to the limits and as
    `wanted` [N], zero where not `given` in time as finite numbers; whose were `clipped`. `odd` says in words
    what was wrong with the time, and what was no numbers of the right shape; `steady` whether the time went
    on from the last call's without a break: what lasted till then lasts; `timed` that it was a finite number;
    `whole` that nothing is missing or odd.
    """

    t: float
    x: Array
    known: NDArray[np.bool_]
    estimated: NDArray[np.bool_]
    u: Array
    given: NDArray[np.bool_]
    clipped: NDArray[np.bool_]
    wanted: Array
    odd: tuple[str, ...] = ()
    steady: bool = True
    whole: bool = False
    timed: bool = True

    def fallback(self) -> str | None:
        """Return the missing or odd parts of the input, in words; None if there are none."""
        if self.whole:
            return None
        parts = [*self.odd]
        if not self.known.all():
            parts.append(f"state not known: deputy {listed(~self.known)}")
        if not self.given.all():
            parts.append(f"desired input missing or not finite: deputy {listed(~self.given)}")
        return "; ".join(parts) or None


def listed(chosen: NDArray[np.bool_]) -> str:
    """Their numbers, in words."""
    return ", ".join(map(str, np.flatnonzero(chosen)))


class InputCheck:
    """Check of a filter's input, with the last good states and the thrusts since.

    Times are taken as they come, and what is odd about one is said in `FilterInput.odd`:

    - one that is not a finite number is replaced by the last plus the last step (0 at the first call);
    - one that stands still is the same instant again;
    - one that runs backwards, or is more than `MEMORY` later than the last, is taken for the new time, and
      what was remembered is forgotten: no state is propagated across it;
    - one later than the period for which the last answer was made is told, and by two periods is a break.

    The period [s] is the time for which an answer is held; default any. A call may be `late` [s].
    """

    def __init__(self, craft: Formation, period: float | None = None, late: float = 0.0) -> None:
        self.craft, self.period, self.late = craft, period, late
        N, (n, m) = craft.deputies, craft.discretize(1.0)[1].shape
        self._every, self._none = np.ones(N, dtype=bool), np.zeros(N, dtype=bool)
        self._every.flags.writeable = self._none.flags.writeable = False
        self._least = float(np.min(craft.thrust_max))
        self._x, self._applied = np.zeros((N, n)), np.zeros((N, m))
        self.forget()

    def forget(self) -> None:
        """Forget the last states: a new flight begins."""
        self._step, self._t = 0.0, np.nan
        self._x, self._applied = np.zeros_like(self._x), np.zeros_like(self._applied)
        self._seen = np.full(len(self._x), -np.inf)  # when each state was last known

    def receive(self, t: float, x: ArrayLike, u_des: ArrayLike | None) -> FilterInput:
        """Take in one call; arguments as of `RunTimeFilter.filter`.

        States and desired thrusts that are no numbers of the right shape are not known and not given:
        whatever a primary controller or navigation hands over, there is an answer.
        """
        limit, shape = self.craft.thrust_max, self._applied.shape
        raw_time, (t, clock, steady) = real(t), self._time(t)
        odd = [clock] if clock else []
        states = numbers(x, self._x.shape)
        if states is None:
            odd.append(f"the states are malformed: {kind_of(x)}")
            states = np.full(self._x.shape, np.nan)
        inputs = numbers(u_des, shape)
        if inputs is None and u_des is not None:
            odd.append(f"the desired input is malformed: {kind_of(u_des)}")
        if not odd and inputs is not None:
            x, u = states.copy(), inputs.copy()
            # Squares that add up to little are little each, and numbers.
            if np.vdot(x, x) <= FARTHEST**2 and (size := np.vdot(u, u)) < np.inf:
                return self._whole(t, x, u, bool(size <= self._least**2), steady)
        known = np.asarray((np.abs(states) <= FARTHEST).all(axis=1))  # false for nan and inf
        known_at, estimate = self._estimate(t)
        known_at = np.where(known, t, known_at)
        estimated = np.asarray(t - known_at <= MEMORY)
        states = np.where(known[:, None], states, np.where(estimated[:, None], estimate, 0.0))
        self._x, self._t, self._seen = states, t, np.where(estimated, known_at, -np.inf)
        self._applied = np.zeros(shape)
        desired = np.full(shape, np.nan) if inputs is None else inputs
        given = np.asarray(np.isfinite(desired).all(axis=1))
        desired = np.where(given[:, None], desired, 0.0)
        u = np.clip(desired, -limit, limit)
        clipped = np.asarray((u != desired).any(axis=1))
        timed = raw_time is not None and isfinite(raw_time)
        fields = known, estimated, u, given, clipped, desired
        return FilterInput(t, states, *fields, tuple(odd), steady, timed=timed)

    def _whole(self, t: float, x: Array, desired: Array, within: bool, steady: bool) -> FilterInput:
        """Return a call with nothing missing or odd; `within`: the desired thrust is within the limits."""
        self._x, self._t, self._seen = x, t, np.full(len(x), t)
        u, clipped = desired, self._none
        if not within:
            u = np.minimum(np.maximum(desired, -self.craft.thrust_max), self.craft.thrust_max)
            clipped = np.asarray((u != desired).any(axis=1))
        return FilterInput(t, x, self._every, self._every, u, self._every, clipped, desired, (), steady, True)

    def applied(self, u: Array) -> None:
        """Note the thrust [N], shape (N, m), that was answered to the last call."""
        self._applied = np.array(u)

    def _time(self, t: object) -> tuple[float, str | None, bool]:
        """The time to go by [s], the fault of the one given, and if it goes on steadily."""
        time = real(t)
        if time is None or not isfinite(time):
            time = 0.0 if isnan(self._t) else self._t + self._step
            return time, f"the time is not a finite number: taken for {time:g} s", False
        passed = time - self._t
        if isnan(passed):  # the first call
            return time, None, True
        if passed < 0:
            return time, f"the time runs backwards by {-passed:g} s", False
        if passed == 0:
            return time, "the time stands still", True
        if passed > MEMORY:
            return time, f"the time jumps by {passed:g} s", False
        self._step = passed
        if self.period is None or passed <= self.period * (1 + 1e-6) + self.late:
            return time, None, True
        detail = f"called after {passed:g} s: the last answer was for {self.period:g} s"
        return time, detail, passed < 2 * self.period

    def _estimate(self, t: float) -> tuple[Array, Array]:
        """Last good states, moved to the time t with the thrust held, and when they were known."""
        passed = t - self._t
        if not 0 <= passed <= MEMORY:  # also at the first call, and where the time has jumped
            return np.full(len(self._x), -np.inf), self._x
        if passed == 0 or (self._seen == -np.inf).all():
            return self._seen, self._x
        Phi, Gamma = self.craft.discretize(passed)
        return self._seen, self._x @ Phi.T + self._applied @ Gamma.T
