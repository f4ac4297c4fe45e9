"""A box around the true state: all states that accepted measurements allow together.

The box is moved by the dynamics under any input within given bounds and any admissible disturbance, and cut
with the box of the next measurement. If nothing is left, that measurement or an earlier one was further
from the truth than its error bound.

A box is one vector ``[hi, -lo]``, so that moving it is a product with a non-negative matrix and cutting it
is one minimum.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import factorial, log, sqrt

import numpy as np
from numpy.typing import ArrayLike

from ...model.craft import Array, Craft
from ...model.errors import ScenarioError
from ...model.tolerances import ROUNDING, TIME
from ...model.untrusted import Unreadable, kind_of, sanitize

FARTHEST_MOTION = 20.0
"""Largest logarithm of what the bounds on ``norm(A^i) t^i / i!`` sum to: beyond it boxes bound nothing."""

KEPT = 32  # motions over so many different durations are kept


@dataclass(frozen=True, eq=False)
class Measurement:
    """A state estimate as it arrives; nothing is checked here.

    Attributes
    ----------
    stamp : float
        The time [s] that the state is for, counted from the start of the plan: that of the measurement, or
        that which it was predicted for. With ``[timing]`` a measured state with a later stamp is no proof.
    state : array_like, shape (n,)
    half_widths : array_like, shape (n,), or None
        Bound on the error, entry by entry; None: the scene's.
    """

    stamp: float
    state: ArrayLike
    half_widths: ArrayLike | None = None

    @staticmethod
    def sanitize(value: object) -> Measurement | Unreadable | None:
        """Read each part of an untrusted measurement once; `Unreadable` if it is none."""
        if value is None:
            return None
        try:
            if isinstance(value, Measurement):
                return Measurement(sanitize(value.stamp), sanitize(value.state), sanitize(value.half_widths))
        except BaseException:  # the value's own code has run
            pass
        return Unreadable(kind_of(value))


class BoxMotion:
    """Motion of boxes of states in a given time, under any controller and disturbance.

    With ``x(t) = e^{At} x + int e^{As} (B u + D w)``, every entry of the transition is a power series in
    t, and so are the bounds ``sum |A^i B| t^{i+1}/(i+1)!`` and ``sum norm(A^i D) t^{i+1}/(i+1)!`` on what
    inputs about their mean and the disturbance add. Durations, up to `longest` [s], are rounded to multiples
    of ``TIME period``; the rounding is included. A `ScenarioError` says that the motion is too fast for that.
    """

    def __init__(self, system: Craft, period: float, longest: float) -> None:
        self.system, self.longest, self._grain = system, longest, TIME * period
        errors = (fault.wrong(system.thrusters) for fault in system.transients)
        self.unasked = np.vstack([np.zeros((1, system.m)), *errors]).max(axis=0)  # by faults not isolated yet
        self.most = system.u_max + system.thrusters.error(system.u_max) + self.unasked
        norm, square_norm = (float(np.linalg.norm(power, 1)) for power in (system.A, system.A @ system.A))
        rate = max(sqrt(square_norm), 1e-3 * norm)  # norm(A^i) <= lead rate^i: two factors at a time
        lead = norm / rate if norm else 1.0
        farthest = FARTHEST_MOTION - log(lead)
        if not rate * longest <= farthest:
            rule = f"must be at most {farthest / rate:.3g} s for the fastest mode of the system"
            raise ScenarioError("memory", longest, rule)
        terms = [np.eye(system.n)]
        while len(terms) < 100 and np.abs(terms[-1]).max() * longest ** len(terms) > 1e-30:
            terms.append(system.A @ terms[-1] / len(terms))  # A^i / i!
        self._state = np.array(terms)
        integrated = self._state / np.arange(1, len(terms) + 1)[:, None, None]  # A^i / (i+1)!
        self._input, self._spread = integrated @ system.B, np.abs(integrated @ system.B)
        self._disturbance = np.linalg.norm(integrated @ system.D, axis=2) * system.w_max
        self._disturbance += np.abs(integrated @ system.unknown).sum(axis=2)
        self._rest = lead * rate ** len(terms) / factorial(len(terms)) * np.exp(rate * longest)
        self._slip = ROUNDING * (np.eye(system.n) + np.abs(system.A) * period)
        self._matrix = lru_cache(KEPT)(self._over)

    def over(self, duration: float) -> Array:
        """Matrix from ``[hi, -lo, bound on |x|, u high, -u low, 1]`` to ``[hi, -lo]`` so much later [s]."""
        return self._matrix(round(duration / self._grain))

    def _over(self, grains: int) -> Array:
        n, m, t = self.system.n, self.system.m, grains * self._grain
        weights = t ** np.arange(len(self._state))
        Phi = np.tensordot(weights, self._state, 1)
        push, spread = t * np.tensordot(weights, self._input, 1), t * np.tensordot(weights, self._spread, 1)
        tail = self._rest * t ** len(weights)
        slip = self._slip @ np.abs(Phi) + tail
        spread = spread * (1 + ROUNDING) + tail * np.abs(self.system.B).sum(axis=0)
        const = t * (weights @ self._disturbance) * (1 + ROUNDING)
        const += tail * (self.system.w_max * np.abs(self.system.D).sum() + np.abs(self.system.unknown).sum())
        const += 2 * ROUNDING * (spread @ self.most)
        out = np.zeros((2 * n, 3 * n + 2 * m + 1))
        for first, sign in ((0, 1.0), (n, -1.0)):
            rows = slice(first, first + n)
            out[rows, :n], out[rows, n : 2 * n] = np.maximum(sign * Phi, 0), np.maximum(-sign * Phi, 0)
            out[rows, 2 * n : 3 * n] = slip
            out[rows, 3 * n : 3 * n + m] = (spread + sign * push) / 2
            out[rows, 3 * n + m : -1] = (spread - sign * push) / 2
            out[rows, -1] = const
        return out


class BoxFilter:
    """The box of states that all accepted measurements allow, and its instant; at first one at time zero."""

    def __init__(self, motion: BoxMotion, low: Array, high: Array) -> None:
        self.motion, self.t = motion, 0.0
        self._box, self._n = np.concatenate([high, -low]), len(low)
        self._any_input = np.tile(motion.most, 2)
        self._inputs = self._any_input  # bounds [high, -low] since the instant of the box

    @property
    def low(self) -> Array:
        """Lower ends at the instant of the last accepted measurement, shape (n,)."""
        return -self._box[self._n :]

    @property
    def high(self) -> Array:
        """Upper ends, shape (n,)."""
        return self._box[: self._n].copy()

    def note_commands(self, bounds: Array | None, fresh: bool) -> None:
        """Note bounds (2, m) on the commands since the last call; None where only their limits are known.

        The box is fresh if it is not older than the last call: earlier inputs no longer matter then.
        """
        if bounds is None:
            self._inputs = self._any_input
            return
        system = self.motion.system
        largest = np.minimum([bounds[1], -bounds[0]], system.u_max)  # of +u and of -u
        inputs = (largest + system.thrusters.error(largest.max(axis=0)) + self.motion.unasked).ravel()
        self._inputs = inputs if fresh else np.maximum(self._inputs, inputs)

    def reaches(self, t: float) -> bool:
        """Return True if the box can be moved to the time t [s]."""
        return 0 <= t - self.t <= self.motion.longest

    def propagated(self, t: float) -> Array:
        """``[hi, -lo]`` at a time that it `reaches`."""
        return self._propagate(self._box, t - self.t)

    def cut(self, t: float, x: Array, half: Array) -> int:
        """Take in a measurement at a time that the box `reaches`: -1 if it agrees.

        Else the state that disagrees most, and the box stays as it was.
        """
        box = np.minimum(self.propagated(t), _boxed(x, half))
        width = box[: self._n] + box[self._n :]
        if not min(width.tolist()) >= 0:
            return int(width.argmin())
        self._box, self.t = box, t
        return -1

    def ahead(self, x: Array, half: Array, duration: float) -> tuple[Array, Array]:
        """Lower and upper ends, from one measurement alone, so much later [s]."""
        box = self._propagate(_boxed(x, half), duration)
        return -box[self._n :], box[: self._n]

    def restart(self, t: float, x: Array, half: Array) -> None:
        """Forget everything but this measurement."""
        self._box, self.t = _boxed(x, half), t

    def _propagate(self, box: Array, duration: float) -> Array:
        size = np.maximum(box[: self._n], box[self._n :])
        bounded = np.concatenate([box, size, self._inputs, (1.0,)])
        return np.asarray(np.dot(self.motion.over(duration), bounded))


def _boxed(x: Array, half: Array) -> Array:
    return np.concatenate([half + x, half - x])
