"""Errors that depend on the time of the flight: of scheduled commands in proportion, and of navigation."""

from functools import partial
from math import ceil

from flint import arb

from ...files.document import Document
from ...kernel.arcs import Path
from ...kernel.balls import absolute, column, largest, maxima, smallest, sums
from ...kernel.verdict import Undecided
from .craft import Craft
from .settling import Settling
from .tightening import Tightening

ROUNDS, SPARE = 300, 1e-3
"""Most rounds until a bound holds that allows for the errors which it causes, and the enlargement by each."""

Along = list[list[list[arb]]]
"""Bounds by step, node of the step and row."""


class Feedforward:
    """The input of the reference, S's corrections of its errors, and their response along rows.

    So of estimates that may be off by more in a step than in the best known one: `document` says by how much.
    The tail is flown again and again: over it bounds on commands do not grow, over its second half they last.
    """

    def __init__(self, document: Document, craft: Craft, settling: Settling, path: Path) -> None:
        self.craft, self.settling, self.planned = craft, settling, min(path.planned, len(path.arcs))
        self.constant = self.planned + (len(path.arcs) - self.planned) // 2  # bounds do not change from it on
        self.excess = [craft.extra(document, k) for k in range(len(path.arcs))]
        gain, plant = absolute(craft.gain), craft.plant
        noise = [(gain * column(errors)).entries() for errors in self.excess]
        nu = [[x.abs_upper() for x in arc.u.entries()] for arc in path.arcs]
        nu = [sums(*pair) for pair in zip(nu, noise, strict=True)]
        self.commanded, tightenings = nu, Tightening(craft, settling, craft.commands)
        for _ in range(ROUNDS):
            peaks = [maxima(*nodes) for nodes in self.response(tightenings)]
            for k in range(len(peaks) - 2, self.planned - 1, -1):
                peaks[k] = maxima(peaks[k], peaks[k + 1])
            peaks[self.constant :] = peaks[self.constant : self.constant + 1] * (len(peaks) - self.constant)
            cells = zip(nu, peaks, self.commanded, strict=True)
            if all(u + x <= limit for each in cells for u, x, limit in zip(*each, strict=True)):
                return
            if any(x > top for each in peaks for x, top in zip(each, plant.u_max, strict=True)):
                break  # which leaves S no thrust
            enlarged = [[(x * (1 + SPARE)).upper() for x in each] for each in peaks]
            self.commanded = [sums(*pair) for pair in zip(nu, enlarged, strict=True)]
        raise Undecided("recoverable", "thruster errors amplify themselves along the reference")

    def response(self, tightenings: Tightening, between: bool = True) -> Along:
        """Response to them along rows at every node of every step; between nodes, if asked, chords of it."""
        plant, q, errors = self.craft.plant, self.craft.plant.q, self.excess
        parts = []
        if self.settling.feedback_bound:
            if self.craft.lag:
                lagged = [self.craft.lag_error_since(partial(self._largest, k)) for k in range(len(errors))]
                errors = [sums(*pair) for pair in zip(errors, lagged, strict=True)]
            thrust = [plant.thruster_part(self._clipped(commands)) for commands in self.commanded]
            parts.append((tightenings.thrust, [[x.upper() for x in each] for each in thrust], False))
        if any(x > 0 for each in errors for x in each):
            parts.append((tightenings.noise, [[x.upper() for x in each] for each in errors], True))
        T, constant, total = (
            self.planned * q,
            (len(errors) - self.constant) * q,
            [arb(0)] * tightenings.rows.nrows(),
        )
        by_node, later = [total] * (len(errors) * q + 1), [total] * (len(errors) * q - T + 1)
        for gains, by_cell, noisy in parts:
            sizes = [size for size in by_cell for _ in range(q)]
            older, intersample = tightenings.response(sizes, noisy)
            total = sums(total, older, intersample) if between else sums(total, older)
            by_node = [sums(*pair) for pair in zip(by_node, gains.summed(sizes), strict=True)]
            if constant:  # before a later turn of the tail are its own last sizes, and larger ones before
                last, highest = (maxima(*part_sizes) for part_sizes in (sizes[-constant:], sizes[T:]))
                excess, steady = gains.summed([_over(size, last) for size in sizes[T:]]), gains.always(last)
                before = (gains.always(_over(highest, last), constant + j) for j in range(len(excess)))
                later = [sums(*each, steady) for each in zip(later, excess, before, strict=True)]
        tail = [maxima(*pair) for pair in zip(by_node[T:], later, strict=True)]
        ends = [part[i : i + q + 1] for part in (by_node[: T + 1], tail) for i in range(0, len(part) - 1, q)]
        return [[sums(each, total) for each in nodes] for nodes in ends]

    def _largest(self, k: int, periods: int) -> list[arb]:
        """Bound commands in a step, and in so many periods before it."""
        return self._clipped(maxima(*self.commanded[max(k - ceil(periods / self.craft.plant.q), 0) : k + 1]))

    def _clipped(self, commands: list[arb]) -> list[arb]:
        return [smallest(pair) for pair in zip(commands, self.craft.plant.u_max, strict=True)]


def _over(sizes: list[arb], lows: list[arb]) -> list[arb]:
    return [largest((x - low, arb(0))).upper() for x, low in zip(sizes, lows, strict=True)]
