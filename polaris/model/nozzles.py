"""Thrusters of a layout: errors of each, and the impulses that it makes, as bounds on those of the inputs."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .allocation import Allocation
from .system import Array
from .thrusters import Thrusters


@dataclass(frozen=True, eq=False)
class Nozzles:
    """Errors of thrusters one by one, and how impulses are made by each, for the inputs that they make.

    What a thruster makes of its command f lies within ``f (along |d| + across side)`` of ``f d``, d being its
    direction and `side` the length of what it has in the other inputs.
    """

    allocation: Allocation
    along: float  # share by which thrust may be off along a nozzle
    across: float  # share that it may have to its side
    mass: float  # share by which the mass may be off
    bit: float = 0.0  # impulse of which every thruster makes multiples [N s]
    carried: bool = False  # whether it carries what is left
    pulsed: bool = False

    @classmethod
    def of(
        cls, allocation: Allocation, magnitude: float, turned: float, mass: float, bit: float, *kinds: bool
    ) -> "Nozzles":
        """From errors of magnitude, of direction [rad] and of the mass, and how impulses are made."""
        along = max(magnitude, 1 - float(np.cos(turned)) * (1 - magnitude))
        return cls(allocation, along, float(np.sin(turned)) * (1 + magnitude), mass, bit, *kinds)

    @cached_property
    def error(self) -> Array:
        """Bound on the error in each input of a unit of thrust, the mass being exact, (N, m)."""
        d = self.allocation.directions
        side = np.sqrt(np.maximum(np.sum(d**2, axis=1, keepdims=True) - d**2, 0.0))
        return np.asarray(self.along * np.abs(d) + self.across * side)

    @cached_property
    def largest(self) -> Array:
        """The most that a unit of thrust makes in each input, errors included, (N, m)."""
        return np.asarray((np.abs(self.allocation.directions) + self.error) / (1 - self.mass))

    def errors(self, period: float) -> Thrusters:
        """Bound errors of the inputs, renewed every `period` [s], by inputs (docs/theory.md, Prop. 5 (d))."""
        T = self.allocation.shares(self.error)
        T = (T + self.mass * np.eye(len(T))) / (1 - self.mass)
        apart = T - np.diag(np.diag(T))
        wrong = self.largest - np.abs(self.allocation.directions) if self.carried else self.largest / 2
        bit = self.bit / period * float(self.allocation.at_once(wrong).max())
        bounds = float(np.diag(T).max()), float(np.linalg.norm(apart, axis=1).max()), bit
        return Thrusters(*(x * (1 + 1e-9) if x > 0 else 0.0 for x in bounds))

    @cached_property
    def weights(self) -> Array:
        """Return the most thrust, of all thrusters together, that a unit of each input takes, (m,)."""
        return np.asarray(np.max(self.allocation.mixes @ self.allocation.lengths, axis=(0, 1)) * (1 + 1e-9))

    @property
    def left(self) -> float:
        """Most of an input's impulse that may be left in all thrusters [N s]."""
        d = self.allocation.directions
        return self.bit * self.carried * max(float(np.maximum(s * d, 0).sum(axis=0).max()) for s in (1, -1))

    @property
    def fired(self) -> tuple[float, ...]:
        """Bound on what pulses of thrusters asked at once make in every input [N]; none if they are held."""
        if not self.pulsed:
            return ()
        return tuple(self.allocation.at_once(self.largest * self.allocation.limits[:, None]).tolist())
