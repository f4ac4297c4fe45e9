"""What thrusters make of commands, and what centred pulses make of a flight."""

from functools import cached_property

import numpy as np
from scipy.linalg import expm

from ..model.craft import Array, Craft
from ..model.thrusters import Thrusters
from .allocating import thrusts_of
from .failing import Failing


class Firing:
    """Thrusters over steps of an integration, R runs at once.

    Errors, as shares of the largest that what is commanded allows, are `thrust` (steps, R, m). Of N thrusters
    that push along the rows of `ways` (N, m), those of a layout or else one both ways along every input,
    pulses have the thrust `fired` (N,); without any, what is commanded is held. From `begin` on, the rest of
    an impulse is `left` (R, N) [N s] if it is carried. What fails is `failing`.
    """

    system: Craft
    thrusters: Thrusters
    asked: Array  # of each thruster without errors, (R, N)
    dt: float
    substeps: int
    thrust: Array | None = None
    failing: Failing | None = None
    left: Array | None = None

    @cached_property
    def ways(self) -> Array:
        """Return what a unit of thrust of each thruster makes of every input, (N, m)."""
        layout = self.system.nozzles
        return np.eye(self.system.m) if layout is None else layout.allocation.directions

    @cached_property
    def fired(self) -> Array:
        """Return the thrust of pulses, (N,); empty where what is commanded is held."""
        layout, timing = self.system.nozzles, self.system.timing
        return np.array(timing.fired) if layout is None or not layout.pulsed else layout.allocation.limits

    def begin(self, runs: int) -> None:
        """Nothing is left of impulses."""
        self.left = np.zeros((runs, len(self.ways))) if self.system.timing.carried else None

    def applied(self, raw: Array, step: int) -> Array:
        """What the thrusters make of commands in a step."""
        told = np.clip(raw, -self.system.u_max, self.system.u_max)
        layout, timing, most = self.system.nozzles, self.system.timing, self.system.u_max
        f = told if layout is None else thrusts_of(layout.allocation, told)
        if self.left is not None:
            bit, most = (timing.carried, most) if layout is None else (layout.bit, layout.allocation.limits)
            h = self.dt * self.substeps
            due = f * h + self.left
            whole = bit * np.floor(np.abs(due) / bit * (1 + 1e-12))  # of impulses; not less by rounding
            f = np.sign(due) * np.minimum(whole / h, most)
            self.left = due - f * h
        self.asked, made = f, f @ self.ways
        u = made if self.thrust is None else made + self.thrust[step] * self.thrusters.error(told)
        return u if self.failing is None else u + self.failing.added(made, step)

    def size(self, u: Array) -> Array:
        """Return what counts of velocity change while inputs u (R, m) are applied, (R,) [N].

        Of a layout the thrust of every thruster, and what is applied beside it.
        """
        if (layout := self.system.nozzles) is None:
            return np.asarray(np.abs(u).sum(axis=1))
        return np.asarray(
            np.abs(self.asked) @ layout.allocation.lengths + np.abs(u - self.asked @ self.ways).sum(axis=1)
        )

    def pulsed(self, start: Array | float, end: Array | float) -> Array:
        """Mean thrust of the pulses from one share of a period to another, less what is commanded, (R, m)."""
        on = np.abs(self.asked) / self.fired / 2
        within = np.maximum(np.minimum(0.5 + on, end) - np.maximum(0.5 - on, start), 0)
        mean = np.sign(self.asked) * self.fired * within / np.maximum(end - start, 1e-300)
        return np.asarray((mean - self.asked) @ self.ways)

    def bow(self) -> Array | float:
        """What pulses within one step add to the state at its end beyond their mean, (R, n); 0 without."""
        if not len(self.fired) or self.substeps > 1:
            return 0.0
        on, sign = np.abs(self.asked) / self.fired, np.sign(self.asked) * self.fired
        parts = [sign * (on ** (2 * i + 3) - on) @ term for i, term in enumerate(self._series)]
        return np.asarray(sum(parts, np.zeros(self.system.n)))

    @cached_property
    def _series(self) -> list[Array]:
        """A pulse about a step's middle: per share of the step to the third, fifth, ... power, (N, n)."""
        A, h = self.system.A, self.dt
        parts: list[Array] = []
        term = first = expm(A * h / 2) @ self.system.B @ self.ways.T * h
        while np.abs(term).max() > 1e-15 * np.abs(first).max():
            power = 2 * len(parts) + 2
            term = (h / 2) ** 2 / (power * (power + 1)) * A @ A @ term
            parts.append(term.T)
        return parts
