"""Pulses that are ahead of held inputs of the same impulse, or behind them."""

from collections.abc import Sequence
from dataclasses import dataclass

from flint import arb

from .balls import dot, smallest


@dataclass(frozen=True)
class Lead:
    """Bounds on the mean impulses of a period by which pulses are ahead of held inputs, or behind [N s]."""

    shares: Sequence[Sequence[arb]]  # of each input, rows, by a unit of each command
    fixed: Sequence[arb]  # of each input, whatever is commanded
    cap: Sequence[arb]  # of each input besides, however much is commanded

    def part(self, commands: Sequence[arb]) -> list[arb]:
        """Return the part that is proportional to commands up to some sizes: subadditive in them."""
        rows = zip(self.shares, self.cap, strict=True)
        return [smallest((dot(row, commands), top)) for row, top in rows]
