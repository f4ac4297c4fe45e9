"""How far what thrusters apply may be from what they are commanded."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .errors import ScenarioError


@dataclass(frozen=True)
class Thrusters:
    """Errors of what is applied, at any time and however they change (docs/theory.md, Proposition 5 (b))."""

    along: float = 0.0  # of every input, as a share of its own command
    across: float = 0.0  # of every input, as a share of the 2-norm of the commands of the others
    bit: float | tuple[float, ...] = 0.0  # of every input, or of each, whatever its command [N]
    shares: tuple[tuple[float, ...], ...] = ()
    """Of a layout: by how much a unit of command i puts input j off, rows j, (m, m); else none."""

    def __post_init__(self) -> None:
        sizes = (self.along, self.across, *np.ravel(self.bit), *np.ravel(self.shares))
        if not all(np.isfinite(size) and size >= 0 for size in sizes):
            raise ScenarioError("thrusters", sizes, "must be finite numbers >= 0")

    @classmethod
    def of(cls, magnitude: float, misalignment: float, mass: float, rounding: float, m: int) -> "Thrusters":
        """From errors of magnitude, direction [rad], mass and rounding [N] of m inputs; rounded up."""
        across = float(np.sin(misalignment)) * (1 + magnitude) / (1 - mass)
        least = float(np.cos(misalignment)) * (1 - magnitude) / (1 + mass)
        along = max((magnitude + mass) / (1 - mass), 1 - least)
        bounds = along, across, rounding * (1 + along + across * (m - 1) ** 0.5)
        along, across, bit = (x * (1 + 1e-9) if x > 0 else 0.0 for x in bounds)
        return cls(along, across, bit)

    def rounding(self, m: int) -> float:
        """Multiple of which every input is commanded [N]: twice what `of` was given."""
        return 2 * float(np.max(self.bit)) / (1 + self.along + self.across * float(np.sqrt(m - 1)))

    def raised(self, bit: float) -> "Thrusters":
        """Return the errors with more of every input, whatever its command [N]."""
        each = tuple(x + bit for x in self.bit) if isinstance(self.bit, tuple) else self.bit + bit
        return replace(self, bit=each)

    @property
    def exact(self) -> bool:
        """Whether what is commanded is what is applied."""
        return self == Thrusters()

    @property
    def proportional(self) -> bool:
        """Whether the errors depend on what is commanded."""
        return self.along > 0 or self.across > 0 or bool(self.shares)

    def table(self, m: int) -> NDArray[np.float64]:
        """Bound the error in each input by a unit of each command, rows are errors, shape (m, m)."""
        return self._with_shares(np.eye(m) * self.along + self.across, np.eye(m)).T

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
        apart = 1.0 - np.eye(u.shape[-1])
        others = np.maximum(np.sqrt(np.square(u) @ apart), 1e-300)
        found = self.along * weights * np.sign(u) + self.across * u * ((weights / others) @ apart)
        return np.asarray(found + weights @ np.array(self.shares) * np.sign(u) if self.shares else found)

    def _with_shares(self, part: NDArray[np.float64], size: NDArray[np.float64]) -> NDArray[np.float64]:
        """Add what sizes of commands (..., m) make by the table of a layout."""
        return np.asarray(part + size @ np.array(self.shares).T if self.shares else part)
