"""What thrusters make of commands, and what centred pulses make of a flight."""

from functools import cached_property

import numpy as np
from scipy.linalg import expm

from ..model.craft import Array, Craft
from ..model.thrusters import Thrusters
from .failing import Failing


class Firing:
    """Thrusters over steps of an integration, R runs at once.

    Errors, as shares of the largest that what is commanded allows, are `thrust` (steps, R, m). Pulses have
    the thrust `fired` (m,); without any, what is commanded is held. From `begin` on, the rest of an impulse
    is `left` (R, m) [N s] if it is carried. What fails is `failing`.
    """

    system: Craft
    thrusters: Thrusters
    fired: Array
    asked: Array  # without errors, (R, m)
    dt: float
    substeps: int
    thrust: Array | None = None
    failing: Failing | None = None
    left: Array | None = None

    def begin(self, runs: int) -> None:
        """Nothing is left of impulses."""
        self.left = np.zeros((runs, self.system.m)) if self.system.timing.carried else None

    def applied(self, raw: Array, step: int) -> Array:
        """What the thrusters make of commands in a step."""
        told = u = np.clip(raw, -self.system.u_max, self.system.u_max)
        if self.left is not None:
            h, bit = self.dt * self.substeps, self.system.timing.carried
            due = told * h + self.left
            whole = bit * np.floor(np.abs(due) / bit * (1 + 1e-12))  # of impulses; not less by rounding
            u = np.sign(due) * np.minimum(whole / h, self.system.u_max)
            self.left = due - u * h
        self.asked = u
        u = u if self.thrust is None else u + self.thrust[step] * self.thrusters.error(told)
        return u if self.failing is None else u + self.failing.added(self.asked, step)

    def pulsed(self, start: Array | float, end: Array | float) -> Array:
        """Mean thrust of the pulses from one share of a period to another, less what is commanded, (R, m)."""
        on = np.abs(self.asked) / self.fired / 2
        within = np.maximum(np.minimum(0.5 + on, end) - np.maximum(0.5 - on, start), 0)
        mean = np.sign(self.asked) * self.fired * within / np.maximum(end - start, 1e-300)
        return np.asarray(mean - self.asked)

    def bow(self) -> Array | float:
        """What pulses within one step add to the state at its end beyond their mean, (R, n); 0 without."""
        if not len(self.fired) or self.substeps > 1:
            return 0.0
        on, sign = np.abs(self.asked) / self.fired, np.sign(self.asked) * self.fired
        parts = [sign * (on ** (2 * i + 3) - on) @ term for i, term in enumerate(self._series)]
        return np.asarray(sum(parts, np.zeros(self.system.n)))

    @cached_property
    def _series(self) -> list[Array]:
        """A pulse about a step's middle: per share of the step to the third, fifth, ... power, (m, n)."""
        A, h = self.system.A, self.dt
        parts: list[Array] = []
        term = first = expm(A * h / 2) @ self.system.B * h
        while np.abs(term).max() > 1e-15 * np.abs(first).max():
            power = 2 * len(parts) + 2
            term = (h / 2) ** 2 / (power * (power + 1)) * A @ A @ term
            parts.append(term.T)
        return parts
