"""Loop of a craft under its safety controller: tracking error, delay, carried impulses, observer.

The loop state ``z`` begins with the error ``e = x - xi``. In every period ``z+ = F z + ...``, the rest being
what uncertain inputs add. What is not the error moves by itself, whatever law flies.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

from flint import arb, arb_mat

from ...files.document import ROUNDED, Document
from ...kernel.balls import above, absolute, beside, column, exponential, magnitude, sums
from ...kernel.motion import Along, Motion, Plant, Push


@dataclass(frozen=True)
class Sample:
    """One value per period in a box, added to the next loop state and to the input of the period."""

    adds: arb_mat  # shape (N, k)
    push: arb_mat  # shape (m, k)
    size: list[arb]


@dataclass(frozen=True, eq=False)
class Craft:
    """The loop, and what is uncertain in it."""

    motion: Motion  # of the error alone, under the law
    F: arb_mat  # shape (N, N)
    commands: arb_mat  # K: the law commands -K z, and what estimates are off beside; shape (m, N)
    rates: arb_mat  # of the error at a node, shape (n, N)
    parts: list[tuple[arb, arb, arb_mat]]  # of a period, and how what is added in them enters, (N, n)
    steady: list[Push]  # what pushes at every instant, commands apart
    samples: list[Sample]
    box: arb_mat  # bounds on what else is handed over with an error, and on its own offset, shape (N, 1)
    seen: arb_mat  # what noise adds to a command of the same period, shape (m, k)
    off: list[arb]  # bounds on this noise, commands apart, (k); empty if there is none
    lag: int  # for how many periods commands add to these; 0 if they do not
    base: list[arb]  # bounds on errors of estimates beyond which they count by the step of the flight

    @property
    def plant(self) -> Plant:
        """The craft."""
        return self.motion.plant

    @cached_property
    def noise(self) -> list[arb]:
        """Bounds on what a command may differ from ``-K z`` in any step, those of `extra` apart."""
        late = (absolute(self.gain) * column(self.lagged(self.plant.u_max))).entries()
        return sums((absolute(self.seen) * column(self.off)).entries(), late) if self.off else late

    def noise_in(self, document: Document, k: int) -> list[arb]:
        """`noise` with what estimates are off more in a step."""
        return sums(self.noise, (absolute(self.gain) * column(self.extra(document, k))).entries())

    @property
    def gain(self) -> arb_mat:
        """The law's, shape (m, n)."""
        assert self.motion.held is not None
        return self.motion.held

    def lagged(self, most: Sequence[arb]) -> list[arb]:
        """Bounds on errors of estimates by commands up to some sizes that no measurement shows yet, (n)."""
        if not self.lag:
            return [arb(0)] * self.gain.ncols()
        return (self.plant.unseen * column(self.plant.thruster_part(most))).entries()

    def extra(self, document: Document, k: int) -> list[arb]:
        """Bounds on what estimates are off more in a step than in the loop, shape (n)."""
        known = zip(document.known_to(k), self.base, strict=True)
        more = ((x * arb(1 + ROUNDED) - y).upper() for x, y in known)
        return [x if x > 0 else arb(0) for x in more] if document.error_by_step else [arb(0)] * len(self.base)

    def whole(self, rows: arb_mat) -> arb_mat:
        """Rows of the error as rows of the loop state."""
        missing = self.F.ncols() - rows.ncols()
        return beside(rows, arb_mat(rows.nrows(), missing)) if missing else rows

    def supports(self, rows: arb_mat) -> list[arb]:
        """Support along rows (r, N) of all that enters in a period, errors that grow with commands apart."""
        found = [arb(0)] * rows.nrows()
        for sample in self.samples:
            found = sums(found, (magnitude(rows * sample.adds) * column(sample.size)).entries())
        for at, motion in self._over(rows):
            found = sums(found, *(motion.push_gain(at, push) for push in self.steady))
        return found

    def thrust_gains(self, rows: arb_mat) -> arb_mat:
        """Support along rows (r, N) of a unit error of each input over a period, shape (r, m)."""
        gains = [motion.unit_gains(at, 1) for at, motion in self._over(rows)]
        return sum(gains[1:], gains[0])

    def noise_gains(self, rows: arb_mat) -> arb_mat:
        """Support along rows (r, N) of a unit error of each estimate over a period, shape (r, n)."""
        return magnitude(rows * self._seen)

    @cached_property
    def _seen(self) -> arb_mat:
        held = self.motion.gamma * self.plant.B * self.gain
        return above(held, arb_mat(self.F.nrows() - held.nrows(), held.ncols()))

    def _over(self, rows: arb_mat) -> list[tuple[arb_mat, Motion]]:
        """Rows of what is added in each part of the period, and the motion over the part."""
        found = []
        for begin, end, enters in self.parts:
            carried = rows * (enters * exponential(self.plant.A, self.plant.h - end)[0])
            found.append((carried, replace(self.plant, h=end - begin).open))
        return found

    def bent(
        self, rows: arb_mat, rates: tuple[arb_mat, arb_mat], off: list[arb], error: list[arb]
    ) -> list[arb]:
        """Intersample bound of rows of the error, beside the chord of their bounds at nodes.

        `rates` bound ``e'`` and ``A e'`` at nodes; `off` and `error` errors of estimates and of inputs that
        are not counted in them.
        """
        held = absolute(self.gain) * column(off) if off else arb_mat(self.gain.nrows(), 1)
        return self._bent(rows, rates, held, [Push.in_box(self.plant.B, error)] if error else [])

    def always_bent(self, rows: arb_mat, rates: tuple[arb_mat, arb_mat]) -> list[arb]:
        """Intersample bound under all that is sampled, and all that pushes at every instant."""
        held = arb_mat(self.gain.nrows(), 1)
        for sample in self.samples:
            held += absolute(sample.push) * column(sample.size)
        return self._bent(rows, rates, held, self.steady)

    def _bent(
        self, rows: arb_mat, rates: tuple[arb_mat, arb_mat], held: arb_mat, pushes: list[Push]
    ) -> list[arb]:
        """Intersample bound under more inputs up to `held` (m, 1), constant over the period, and pushes."""
        motion, B = self.motion, self.plant.B
        more = absolute(B) * held, absolute(self.plant.A * B) * held
        bow = Along(motion, rows).lesser_bow(rates[0] + more[0], rates[1] + more[1])
        return sums(bow, *(motion.push_bend(rows, push) for push in pushes))
