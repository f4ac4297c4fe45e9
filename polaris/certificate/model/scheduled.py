"""Errors that depend on the time of the flight: of scheduled commands in proportion, and of navigation."""

from dataclasses import replace
from math import ceil

from flint import arb, arb_mat

from ..files.document import Document
from ..kernel.arcs import Path
from ..kernel.balls import column, largest, magnitude, sums
from ..kernel.motion import Motion, Push
from ..kernel.verdict import Undecided
from .loop import Memory, Needs
from .timing import late

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

    def __init__(self, document: Document, loop: Motion, memory: Memory, path: Path, gain: arb_mat) -> None:
        self.loop, self.memory, self.path, self.gain = loop, memory, path, gain
        least, at = replace(loop.plant, estimate=tuple(document.calmest)).command_error(gain), loop.plant
        known = [replace(at, estimate=tuple(document.known_to(k))) for k in range(len(path.arcs))]
        parts = [zip(plant.command_error(gain), least, strict=True) for plant in known]
        self.noise = [[(x - y).abs_upper() for x, y in each] for each in parts]
        self.planned = min(path.planned, len(path.arcs))
        nu = [[x.abs_upper() for x in arc.u.entries()] for arc in path.arcs]
        nu = [sums(*pair) for pair in zip(nu, self.noise, strict=True)]
        self.commanded, needs = nu, Needs(loop, memory, gain)
        self._rates = needs.rates
        for _ in range(ROUNDS):
            more = [[largest(each) for each in zip(*nodes, strict=True)] for nodes in self._along(needs)]
            end = max(len(more) - ceil((memory.periods + 2) / loop.plant.q), self.planned)
            for k in range(len(more) - 2, self.planned - 1, -1):
                more[k] = [largest(pair) for pair in zip(more[k], more[k + 1], strict=True)]
            more[end:] = [more[end]] * (len(more) - end) if end < len(more) else []
            cells = zip(nu, more, self.commanded, strict=True)
            if all(u + x <= most for each in cells for u, x, most in zip(*each, strict=True)):
                return
            if any(x > top for each in more for x, top in zip(each, loop.plant.u_max, strict=True)):
                break  # which leaves S no thrust
            grown = [[(x * (1 + SPARE)).upper() for x in each] for each in more]
            self.commanded = [sums(*pair) for pair in zip(nu, grown, strict=True)]
        raise Undecided("recoverable", "errors of thrusters feed on themselves along the reference")

    def along(self, rows: arb_mat) -> Along:
        """What they add along rows in the periods next to every node."""
        return self._along(Needs(self.loop, self.memory, rows))

    def _along(self, needs: Needs) -> Along:
        plant, q = self.loop.plant, self.loop.plant.q
        back, caused = ceil(plant.hidden / q), []
        for k, (most, noise) in enumerate(zip(self.commanded, self.noise, strict=True)):
            since = self.commanded[max(k - back, 0) : k + 1]
            before = [largest(each) for each in zip(*since, strict=True)]
            caused.append(sums(plant.thruster_part(most), late(plant, self.gain, before), noise))
        errors = [[x.upper() for x in each] for each in caused]
        worst = [largest(each) for each in zip(*errors, strict=True)]
        box = self.loop.box_of(Push.in_box(plant.B, worst))
        rates = (magnitude(column(sums(rate.always(worst), rate.late(box)))) for rate in self._rates)
        booked = sums(needs.late(box), self.loop.lesser_bow(needs.rows, *rates))
        sums_at = needs.summed([error for error in errors for _ in range(q)])
        for_ever, found = needs.always(errors[-1]), []  # as if the tail's last commands had always been
        for cell, error in enumerate(errors):
            first, parts = needs.within(error), []
            repeated = [sums(for_ever, first)] if cell >= self.planned else []
            for p in range(cell * q, (cell + 1) * q):
                both = [sums(sums_at[p], first), sums_at[p + 1], *repeated]
                parts.append(sums(map(largest, zip(*both, strict=True)), booked))
            ends = [parts[max(i - 1, 0) : i + 1] for i in range(q + 1)]
            found.append([list(map(largest, zip(*each, strict=True))) for each in ends])
        return found
