"""Settling of the loop of a craft, and sums of responses by the age of their causes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import accumulate
from typing import Any

from flint import arb, arb_mat, arb_poly

from ...kernel.balls import column, identity, largest, magnitude, smallest, sums
from ...kernel.verdict import Imprecise, Undecided
from .craft import Craft

FORGOTTEN = 1e-6  # what is left of an error once the loop counts as having forgotten it

LONGEST = 20000  # most periods that are followed one by one


@dataclass(frozen=True, eq=False)
class Settling:
    """Settling horizon N: the number of periods after which the loop has forgotten its first state.

    With ``z > 0`` and ``|F^N| z <= c z``, c < 1, every undisturbed state of the loop that was within z is
    within ``c^a z`` at node ``a N``, and this needs nothing but a product of two matrices to be checked.
    """

    powers: list[arb_mat]  # F^l for l = 0 ... N + 1
    z: arb_mat  # shape (states, 1)
    c: arb
    feedback_bound: list[list[arb]] = field(default_factory=list)
    """Bounds on S's commands l periods after a hand-over, within limits; the last one holds for ever."""
    rates: list[Any] = field(default_factory=list, repr=False)
    """`Tightening` of ``e'`` and of ``A e'`` at nodes, once they are known."""

    @property
    def periods(self) -> int:
        """N."""
        return len(self.powers) - 2

    def decayed(self, box: arb_mat) -> tuple[arb_mat, arb_mat]:
        """Bounds on loop states in a box after N periods, and after 2 N."""
        first = magnitude(self.powers[self.periods]) * box
        share = largest(a / b for a, b in zip(first.entries(), self.z.entries(), strict=True))
        return magnitude(first), magnitude(self.z * (share * self.c))

    @classmethod
    def for_craft(
        cls, craft: Craft, extent: arb_mat, multiple: int, feedback_bound: Sequence[Sequence[float]] = ()
    ) -> Settling:
        """Find N, a multiple of a number of periods, for states, or errors, up to an extent.

        `Undecided` if there is none, `Imprecise` if the powers' own radii, which grow, have come to more.
        """
        p, count = craft.supports(identity(craft.F.nrows())), craft.F.nrows()
        size = zip(craft.lifted(extent).entries(), p, strict=True)
        z0 = column([x + 10 * y + 1e-30 for x, y in size])
        powers = [identity(count)]
        while len(powers) < LONGEST:
            for _ in range(multiple):
                powers.append(powers[-1] * craft.F)
            last = magnitude(powers[-1])
            z = magnitude(z0 + last * z0 + last * (last * z0))
            c = largest(a / b for a, b in zip((last * z).entries(), z.entries(), strict=True))
            if c < FORGOTTEN:
                pairs = (
                    [smallest((arb(x), top)) for x, top in zip(level, craft.plant.u_max, strict=True)]
                    for level in feedback_bound
                )
                return cls([*powers, powers[-1] * craft.F], z, c, list(pairs))
            radii = arb_mat(count, count, [x.rad() for x in powers[-1].entries()]) * z
            if not largest(a / b for a, b in zip(radii.entries(), z.entries(), strict=True)) < FORGOTTEN:
                raise Imprecise("recoverable", f"precision is lost within {len(powers)} periods of the loop")
        raise Undecided("recoverable", f"errors of the loop do not decay within {LONGEST} periods")


@dataclass(frozen=True, eq=False)
class Gains:
    """Support of unit values of some channels along rows, by age."""

    each: list[list[list[arb]]]  # ``[channel][lag][kind of row]``
    which: list[int]  # kind of every row

    def summed(self, sizes: list[list[arb]]) -> list[list[arb]]:
        """Response at node L to sizes of the channels in each period before, from rest, L = 0, 1, ...

        What is older than N periods is left out.
        """
        count, series = len(sizes), [arb_poly(list(each)) for each in zip(*sizes, strict=True)]
        rows, by_row = len(self.each[0][0]), []
        for row in range(rows):
            total = arb_poly()
            for gains, size in zip(self.each, series, strict=True):
                total += arb_poly([lag[row] for lag in gains]) * size
            by_row.append([arb(0), *(total[i].upper() for i in range(count))])
        by_node = zip(*by_row, strict=True) if by_row else [()] * (count + 1)
        return [[each[kind] for kind in self.which] for each in by_node]

    @cached_property
    def _before(self) -> list[list[list[arb]]]:
        """Return the gains of a lag and all longer ones together, ``[channel][lag][kind]``."""
        none = [arb(0)] * len(self.each[0][0])
        return [list(accumulate(gains[::-1], sums, initial=none))[::-1] for gains in self.each]

    def always(self, sizes: list[arb], until: int = 0) -> list[arb]:
        """Response to sizes that have been as large until some periods ago, not more than N periods."""
        pairs = zip((each[min(until, len(each) - 1)] for each in self._before), sizes, strict=True)
        response = sums(*([x * size for x in each] for each, size in pairs))
        return [response[kind].upper() for kind in self.which]
