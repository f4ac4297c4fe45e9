"""Errors that depend on the time of the flight: of scheduled commands in proportion, and of navigation."""

from math import ceil

from flint import arb, arb_mat

from ...files.document import Document
from ...kernel.arcs import Path
from ...kernel.balls import absolute, column, largest, smallest, sums
from ...kernel.verdict import Undecided
from .craft import Craft
from .memory import Memory
from .needs import Needs

ROUNDS, SPARE = 300, 1e-3
"""Most rounds until a bound holds that allows for the errors which it causes, and what each adds to it."""

Along = list[list[list[arb]]]
"""Bounds by step, node of the step and row."""


class Scheduled:
    """The input of the reference, what S corrects of its errors, and their response along rows.

    So of estimates that may be off by more in a step than in the best known one: `document` says by how much.

    The tail is flown again and again: bounds on commands do not grow over it, and are constant over the end
    of it that later turns remember.
    """

    def __init__(self, document: Document, craft: Craft, memory: Memory, path: Path) -> None:
        self.craft, self.memory, self.planned = craft, memory, min(path.planned, len(path.arcs))
        self.off = [craft.extra(document, k) for k in range(len(path.arcs))]
        gain, plant = absolute(craft.gain), craft.plant
        noise = [(gain * column(off)).entries() for off in self.off]
        nu = [[x.abs_upper() for x in arc.u.entries()] for arc in path.arcs]
        nu = [sums(*pair) for pair in zip(nu, noise, strict=True)]
        self.commanded, needs = nu, Needs(craft, memory, craft.commands)
        for _ in range(ROUNDS):
            more = [[largest(each) for each in zip(*nodes, strict=True)] for nodes in self._along(needs)]
            end = max(len(more) - ceil((memory.periods + 2) / plant.q), self.planned)
            for k in range(len(more) - 2, self.planned - 1, -1):
                more[k] = [largest(pair) for pair in zip(more[k], more[k + 1], strict=True)]
            more[end:] = [more[end]] * (len(more) - end) if end < len(more) else []
            cells = zip(nu, more, self.commanded, strict=True)
            if all(u + x <= most for each in cells for u, x, most in zip(*each, strict=True)):
                return
            if any(x > top for each in more for x, top in zip(each, plant.u_max, strict=True)):
                break  # which leaves S no thrust
            grown = [[(x * (1 + SPARE)).upper() for x in each] for each in more]
            self.commanded = [sums(*pair) for pair in zip(nu, grown, strict=True)]
        raise Undecided("recoverable", "errors of thrusters feed on themselves along the reference")

    def along(self, rows: arb_mat) -> Along:
        """Response to them along rows at every node of every step; between nodes chords of it hold."""
        return self._along(Needs(self.craft, self.memory, rows))

    def _along(self, needs: Needs) -> Along:
        plant, q, off = self.craft.plant, self.craft.plant.q, self.off
        parts, back = [], ceil(self.craft.lag / q)
        if self.memory.profile:
            if self.craft.lag:
                since = (self.commanded[max(k - back, 0) : k + 1] for k in range(len(off)))
                before = [[largest(each) for each in zip(*some, strict=True)] for some in since]
                lagged = (self.craft.lagged(self._clipped(most)) for most in before)
                off = [sums(*pair) for pair in zip(off, lagged, strict=True)]
            thrust = [plant.thruster_part(self._clipped(most)) for most in self.commanded]
            parts.append((needs.thrust, [[x.upper() for x in each] for each in thrust], False))
        if any(x > 0 for each in off for x in each):
            parts.append((needs.noise, [[x.upper() for x in each] for each in off], True))
        zero = [arb(0)] * needs.rows.nrows()
        at, for_ever, booked = [zero] * (len(off) * q + 1), zero, zero
        for gains, sizes, seen in parts:
            nodes, older, bent = needs.caused(gains, [size for size in sizes for _ in range(q)], seen)
            at = [sums(*pair) for pair in zip(at, nodes, strict=True)]
            booked, for_ever = sums(booked, older, bent), sums(for_ever, gains.always(sizes[-1]))
        found = []
        for cell in range(len(off)):
            nodes = at[cell * q : (cell + 1) * q + 1]
            if cell >= self.planned:  # as if the tail's last commands had always been
                nodes = [[largest(pair) for pair in zip(each, for_ever, strict=True)] for each in nodes]
            found.append([sums(each, booked) for each in nodes])
        return found

    def _clipped(self, most: list[arb]) -> list[arb]:
        return [smallest(pair) for pair in zip(most, self.craft.plant.u_max, strict=True)]
