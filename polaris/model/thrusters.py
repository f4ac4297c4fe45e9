"""Bounds on the errors of applied thrust: of inputs, and of each thruster of a layout."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from .allocation import Allocation
from .errors import ScenarioError
from .system import Array


@dataclass(frozen=True)
class Thrusters:
    """Errors of applied inputs, at any time and however they change (docs/theory.md, Proposition 5 (b)).

    With `constant` those that grow with commands are one matrix M in a flight: ``u + M u`` is applied, up to
    `bit`, with ``|M_jj| <= along`` and ``norm(M_jk, k != j) <= across``.
    """

    along: float = 0.0  # of every input, as a share of its own command
    across: float = 0.0  # of every input, as a share of the 2-norm of the commands of the others
    bit: float | tuple[float, ...] = 0.0  # of every input, or of each, whatever its command [N]
    shares: tuple[tuple[float, ...], ...] = ()
    """Of a layout: by how much a unit of command i puts input j off, rows j, (m, m); else none."""
    constant: bool = False

    def __post_init__(self) -> None:
        sizes = (self.along, self.across, *np.ravel(self.bit), *np.ravel(self.shares))
        if not all(np.isfinite(size) and size >= 0 for size in sizes):
            raise ScenarioError("thrusters", sizes, "must be finite numbers >= 0")

    @classmethod
    def from_errors(
        cls, magnitude: float, misalignment: float, mass: float, rounding: float, m: int
    ) -> "Thrusters":
        """Return errors of m inputs by magnitude, direction [rad], mass and rounding [N], rounded up."""
        across = float(np.sin(misalignment)) * (1 + magnitude) / (1 - mass)
        least = float(np.cos(misalignment)) * (1 - magnitude) / (1 + mass)
        along = max((magnitude + mass) / (1 - mass), 1 - least)
        bounds = along, across, rounding * (1 + along + across * (m - 1) ** 0.5)
        along, across, bit = (x * (1 + 1e-9) if x > 0 else 0.0 for x in bounds)
        return cls(along, across, bit)

    def stretched(self, share: float, inputs: int | None = None) -> "Thrusters":
        """Return the errors if commands may be in force for longer or shorter by a share of their period.

        Their impulse changes by as much (docs/theory.md, Lemma 6 (a)). Of a layout that makes some `inputs`
        the table of shares grows.
        """
        if not share > 0:
            return self
        scale, extra = (1 + share) * (1 + 1e-9), share * (1 + 1e-9)
        bit = tuple(x * scale for x in self.bit) if isinstance(self.bit, tuple) else self.bit * scale
        if inputs is None:
            return Thrusters(self.along * scale + extra, self.across * scale, bit)
        table = np.array(self.shares or np.zeros((inputs, inputs))) * scale + extra * np.eye(inputs)
        return replace(self, bit=bit, shares=tuple(map(tuple, table.tolist())))

    def rounding(self, m: int) -> float:
        """Return the multiple of which every input is commanded [N], all of `bit` being its rounding."""
        return 2 * float(np.max(self.bit)) / (1 + self.along + self.across * float(np.sqrt(m - 1)))

    def raised(self, bit: float) -> "Thrusters":
        """Return the errors with `bit` [N] added to every input."""
        each = tuple(x + bit for x in self.bit) if isinstance(self.bit, tuple) else self.bit + bit
        return replace(self, bit=each)

    @property
    def exact(self) -> bool:
        """True if commands are applied without error."""
        return not self.proportional and not np.any(self.bit)

    @property
    def proportional(self) -> bool:
        """True if the errors depend on the command."""
        return self.along > 0 or self.across > 0 or bool(self.shares)

    def table(self, m: int) -> NDArray[np.float64]:
        """Bound the error in each input by a unit of each command, rows are errors, shape (m, m)."""
        return self._with_shares(np.eye(m) * self.along + self.across, np.eye(m)).T

    def matrices(self, ways: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return errors of inputs as shares of commands at their bounds, (..., m, m).

        `ways` (..., m, m) give sign and size of the own shares, within 1, and directions of those of others.
        """
        diagonal = np.eye(ways.shape[-1])
        size = np.linalg.norm(ways * (1 - diagonal), axis=-1, keepdims=True)
        others = self.across * ways * (1 - diagonal) / np.maximum(size, 1e-300)
        return np.asarray(self.along * np.clip(ways, -1, 1) * diagonal + others)

    def made(self, impulse: float) -> float:
        """Most impulse of an input that is asked for one by one."""
        return impulse * (1 + self.along)

    def error(self, u: NDArray[np.float64]) -> NDArray[np.float64]:
        """Bounds on the errors under commands up to u in size, shape (..., m)."""
        return np.asarray(self.part(u) + self.bit)

    def part(self, u: NDArray[np.float64]) -> NDArray[np.float64]:
        """The part of `error` that is proportional to u: that of a sum is at most the sum of the parts."""
        others = np.sqrt(np.square(u) @ (1.0 - np.eye(u.shape[-1])))
        return self._with_shares(self.along * np.abs(u) + self.across * others, np.abs(u))

    def summed(self, u: NDArray[np.float64]) -> NDArray[np.float64]:
        """Bound sums of `part` over many periods by sums of the sizes of the commands, shape (..., m)."""
        return self._with_shares(self.along * u + self.across * (u @ (1.0 - np.eye(u.shape[-1]))), u)

    def slope(self, u: NDArray[np.float64], weights: NDArray[np.float64]) -> NDArray[np.float64]:
        """Derivative in u of the sum of `part` with weights >= 0, shape (..., m)."""
        off_diag = 1.0 - np.eye(u.shape[-1])
        others = np.maximum(np.sqrt(np.square(u) @ off_diag), 1e-300)
        slope = self.along * weights * np.sign(u) + self.across * u * ((weights / others) @ off_diag)
        return np.asarray(slope + weights @ np.array(self.shares) * np.sign(u) if self.shares else slope)

    def _with_shares(self, part: NDArray[np.float64], size: NDArray[np.float64]) -> NDArray[np.float64]:
        """Add the errors by sizes of commands (..., m) of a layout's table."""
        return np.asarray(part + size @ np.array(self.shares).T if self.shares else part)


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
    def from_errors(
        cls, allocation: Allocation, magnitude: float, angle: float, mass: float, bit: float, *kinds: bool
    ) -> "Nozzles":
        """Return the layout with errors of magnitude, direction [rad] and mass, and how impulses are made."""
        along = magnitude + (1 - magnitude) * 2 * float(np.sin(angle / 2)) ** 2
        return cls(allocation, along, float(np.sin(angle)) * (1 + magnitude), mass, bit, *kinds)

    @cached_property
    def error(self) -> Array:
        """Bound on the error in each input of a unit of thrust, the mass being exact, (N, m)."""
        d = self.allocation.directions
        side = np.sqrt(np.maximum(np.sum(d**2, axis=1, keepdims=True) - d**2, 0.0))
        return np.asarray(self.along * np.abs(d) + self.across * side)

    @cached_property
    def largest(self) -> Array:
        """Bound the force in each input by a unit of thrust, errors included, (N, m)."""
        return np.asarray((np.abs(self.allocation.directions) + self.error) / (1 - self.mass))

    def errors(self, period: float) -> Thrusters:
        """Bound errors of the inputs, renewed every `period` [s], by inputs (docs/theory.md, Prop. 5 (d))."""
        T = self.bounds[:-1]
        T = (T + self.mass * np.eye(len(T))) / (1 - self.mass)
        wrong = self.largest - np.abs(self.allocation.directions) if self.carried else self.largest / 2
        bit = self.bit / period * self.allocation.at_once(wrong) * (1 + 1e-9)
        shares = tuple(map(tuple, (T * (1 + 1e-9)).tolist())) if np.any(T) else ()
        return Thrusters(0.0, 0.0, tuple(bit.tolist()) if np.any(bit) else 0.0, shares)

    @cached_property
    def multipliers(self) -> Array:
        """Return multipliers of `bounds` by signs of the inputs, (2^m, m + 1, m); none without a program."""
        return self.allocation.multipliers(np.column_stack([self.error, self.allocation.lengths]))

    @cached_property
    def bounds(self) -> Array:
        """Bound the error of each input, and all thrust, by a unit of each input, (m + 1, m)."""
        each = np.column_stack([self.error, self.allocation.lengths])
        return self.allocation.shares(each, self.multipliers)

    @cached_property
    def weights(self) -> Array:
        """Return the most thrust, of all thrusters together, that a unit of each input takes, (m,)."""
        return np.asarray(self.bounds[-1] * (1 + 1e-9))

    @property
    def max_carried(self) -> float:
        """Bound the impulse of an input that all thrusters carry [N s]."""
        d = self.allocation.directions
        return self.bit * self.carried * max(float(np.maximum(s * d, 0).sum(axis=0).max()) for s in (1, -1))

    def in_turn(self, period: float) -> tuple[float, float]:
        """Bound the share of a `period` [s] that pulses take one after another.

        First what the inputs take at their limits, then what bits take besides.
        """
        mixing, bit = self.allocation, self.bit / period * (1.0 if self.carried else 0.5)
        longest = float(self.weights @ mixing.u_max) * float(np.max(1 / (mixing.limits * mixing.lengths)))
        return longest, bit * float(mixing.at_once(1 / mixing.limits))

    @property
    def fired(self) -> tuple[float, ...]:
        """Bound on every input by pulses of all thrusters at once [N]; none if commands are held."""
        if not self.pulsed:
            return ()
        return tuple(self.allocation.at_once(self.largest * self.allocation.limits[:, None]).tolist())
