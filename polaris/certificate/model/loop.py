"""The safety controller from a set of errors to the end of time: what its error needs along fixed rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, reduce
from itertools import pairwise

from flint import arb, arb_mat, arb_poly

from ..kernel.balls import above, column, identity, largest, magnitude, norms, sums
from ..kernel.motion import Motion, Push
from ..kernel.verdict import Imprecise, Undecided
from ..kernel.zonotopes import Zonotope
from .timing import late

FORGOTTEN = 1e-6  # what is left of an error once the loop counts as having forgotten it

LONGEST = 20000  # most periods that are followed one by one


@dataclass(frozen=True, eq=False)
class Memory:
    """After how many periods the loop has forgotten an error.

    With ``z > 0`` and ``|phi^N| z <= c z``, c < 1, every undisturbed error that was within ``|e| <= z`` is
    within ``c^a z`` at node ``a N``, and this needs nothing but a product of two matrices to be checked.
    """

    powers: list[arb_mat]  # phi^l for l = 0 ... N + 1
    z: arb_mat  # shape (n, 1)
    c: arb
    errors: list[list[arb]] = field(default_factory=list)
    """Bounds, l periods after a hand-over, on the part of the errors of every input that commands cause."""
    rates: list[Needs] = field(default_factory=list, repr=False)
    """Of ``A_c e`` and of ``A A_c e``, once they are known."""

    @property
    def periods(self) -> int:
        """N."""
        return len(self.powers) - 2

    def left(self, box: arb_mat) -> tuple[arb_mat, arb_mat]:
        """What errors in a box have become after N periods, and a bound on that after 2 N."""
        first = magnitude(self.powers[self.periods]) * box
        share = largest(a / b for a, b in zip(first.entries(), self.z.entries(), strict=True))
        return magnitude(first), magnitude(self.z * (share * self.c))

    @classmethod
    def of(cls, motion: Motion, extent: arb_mat, multiple: int, profile: Sequence[list[arb]] = ()) -> Memory:
        """Find N, a multiple of a number of periods, for errors up to an extent.

        `profile` bounds what feedback commands l periods after a hand-over; its last entry holds for ever.
        `Undecided` if there is none, `Imprecise` if the powers' own radii, which grow, have come to more.
        """
        p = motion.disturbance_box
        z0 = column([x + 10 * y + 1e-30 for x, y in zip(extent.entries(), p.entries(), strict=True)])
        powers = [identity(len(z0.entries()))]
        while len(powers) < LONGEST:
            for _ in range(multiple):
                powers.append(powers[-1] * motion.phi)
            last = magnitude(powers[-1])
            z = magnitude(z0 + last * z0 + last * (last * z0))
            c = largest(a / b for a, b in zip((last * z).entries(), z.entries(), strict=True))
            if c < FORGOTTEN:
                errors = _caused(motion, profile, len(powers) + 1) if profile else []
                return cls([*powers, powers[-1] * motion.phi], z, c, errors)
            radii = arb_mat(*(len(z0.entries()),) * 2, [x.rad() for x in powers[-1].entries()]) * z
            if not largest(a / b for a, b in zip(radii.entries(), z.entries(), strict=True)) < FORGOTTEN:
                raise Imprecise("recoverable", f"precision is lost within {len(powers)} periods of the loop")
        raise Undecided("recoverable", f"the loop has not forgotten errors after {LONGEST} periods")


def _caused(motion: Motion, profile: Sequence[list[arb]], count: int) -> list[list[arb]]:
    """Errors of inputs by commands within a profile, and by those before them that are not measured yet."""
    plant, last = motion.plant, len(profile) - 1
    parts = [plant.thruster_part(most) for most in profile]
    gain, since = motion.held, (plant.u_max, *profile)
    known = [late(plant, gain, most) for most in since] if plant.hidden and gain is not None else []
    errors = []
    for lag in range(count):
        at = lag - plant.hidden + 1  # what is commanded before a hand-over is limited by the thrusters alone
        more = known[min(max(at, 0), last + 1)] if known else [arb(0)] * len(parts[0])
        errors.append(sums(parts[min(lag, last)], more))
    return errors


@dataclass(frozen=True, eq=False)
class Needs:
    """What errors need along fixed rows, lag by lag."""

    motion: Motion  # the safety controller's loop
    memory: Memory
    rows: arb_mat  # shape (r, n)
    upset: list[list[arb]] = field(default_factory=list)
    """What a fault that is isolated late needs by the end of the period after node l, once in a flight."""
    _bowed: dict[tuple[int, int], tuple[Zonotope, list[arb]]] = field(default_factory=dict, repr=False)

    @cached_property
    def carried(self) -> list[arb_mat]:
        """``row phi^l`` for l = 0 ... N + 1, each of shape (r, n)."""
        return [self.rows * power for power in self.memory.powers]

    @cached_property
    def bend(self) -> list[arb_mat]:
        """What is booked between nodes per unit of ``|e|`` at the start, for the periods next to node l."""
        curved = self.motion.bend(self.rows)
        per = [magnitude(curved * magnitude(self.motion.closed * power)) for power in self.memory.powers]
        return [per[0], *(_larger(a, b) for a, b in pairwise(per))]

    @cached_property
    def _steady(self) -> list[list[arb]]:
        """Response at node L to what does not depend on commands, from rest, for L = 0 ... N + 1."""
        found = [[arb(0)] * self.rows.nrows()]
        stacked = above(*self.carried[:-1])
        for gains in self._split(self.motion.gains_over(stacked, self.motion.disturbances, 1)[0]):
            found.append([x.upper() for x in sums(found[-1], gains)])
        return found

    @cached_property
    def _gains(self) -> list[list[list[arb]]]:
        """What one unit of an input's error in a period adds so many periods later, ``[input][lag][row]``."""
        stacked, columns = above(*self.carried[:-1]), self.motion.plant.B.transpose().tolist()
        pushes = [Push.in_box(column(entries), [arb(1)]) for entries in columns]
        return [self._split(self.motion.push_gain(stacked, push)) for push in pushes]

    def summed(self, errors: list[list[arb]]) -> list[list[arb]]:
        """Response at node L to errors of the inputs in each period before, from rest, L = 0, 1, ...

        What is older than N periods is left to `late`.
        """
        count, series = len(errors), [arb_poly(list(each)) for each in zip(*errors, strict=True)]
        found = []
        for row in range(self.rows.nrows()):
            total = arb_poly()
            for gains, error in zip(self._gains, series, strict=True):
                total += arb_poly([each[row] for each in gains]) * error
            found.append([arb(0), *(total[i].upper() for i in range(count))])
        return [list(each) for each in zip(*found, strict=True)] if found else [[]] * (count + 1)

    @cached_property
    def _all(self) -> list[list[arb]]:
        """`_gains` of all periods together, ``[input][row]``."""
        return [[x.upper() for x in sums(*gains)] for gains in self._gains]

    def always(self, error: list[arb]) -> list[arb]:
        """Response to errors of the inputs that have always been as large; N periods of them."""
        return sums(*([x * size for x in each] for each, size in zip(self._all, error, strict=True)))

    def within(self, error: list[arb]) -> list[arb]:
        """What errors of the inputs add within one period."""
        parts = [[x * size for x in gains[0]] for gains, size in zip(self._gains, error, strict=True)]
        return sums(*parts)

    @cached_property
    def responses(self) -> list[list[arb]]:
        """Response at node L to all that disturbs from rest, for L = 0 ... N + 1."""
        if not self.memory.errors:
            return self._steady
        caused = self.summed(self.memory.errors[:-1])
        return [sums(*each) for each in zip(self._steady, caused, strict=True)]

    def _split(self, stacked: list[arb]) -> list[list[arb]]:
        """Numbers for the rows of one lag after the other, as a list per lag."""
        count = self.rows.nrows()
        return [stacked[at : at + count] for at in range(0, len(stacked), count)]

    def late(self, box: arb_mat) -> list[arb]:
        """Bound on the share of all that is older than N periods, if each adds no more than a box."""
        first, later = self.memory.left(box)
        return list((self._reached * (first + later / (1 - self.memory.c))).entries())

    @cached_property
    def _reached(self) -> arb_mat:
        total = magnitude(self.carried[0])
        for carried in self.carried[1 : self.memory.periods]:
            total = total + magnitude(carried)
        return total

    @cached_property
    def settled(self) -> list[arb]:
        """Bound on the disturbance's share at every node more than N periods after a hand-over."""
        box = self.motion.disturbance_box
        if self.memory.errors:
            box += self.motion.box_of(Push.in_box(self.motion.plant.B, self.memory.errors[0]))
        return [x.upper() for x in sums(self.responses[-1], self.late(box))]

    @property
    def rates(self) -> tuple[Needs, Needs]:
        """The same of ``A_c e`` and of ``A A_c e``, which bend the motion between nodes."""
        known, closed = self.memory.rates, self.motion.closed
        if not known or known[0].motion is not self.motion:
            known[:] = [Needs(self.motion, self.memory, M) for M in (closed, self.motion.A * closed)]
        return known[0], known[1]

    @cached_property
    def peak(self) -> list[arb]:
        """Bound on the disturbance's share at every node."""
        return [largest(each) for each in zip(*self.responses, self.settled, strict=True)]

    @cached_property
    def disturbed(self) -> list[list[arb]]:
        """The disturbance's share until the end of the period after node l, l = 0 ... N, then for ever."""
        # Bounds on what the disturbance adds to ``A_c e`` and ``A A_c e`` at any node.
        rates = (magnitude(column(needs.peak)) for needs in self.rates)
        curved = self.motion.lesser_bow(self.rows, *rates)
        first = [self._steady[1]] * len(self.memory.powers)
        if self.memory.errors:
            first = [
                sums(steady, self.within(e)) for steady, e in zip(first, self.memory.errors, strict=True)
            ]
        until = [
            [largest((a + f, b)) + k for a, b, f, k in zip(now, following, begun, curved, strict=True)]
            for (now, following), begun in zip(pairwise(self.responses), first, strict=False)
        ]
        return self._upset([*until, sums(self.settled, first[-1], curved)])

    @cached_property
    def at_nodes(self) -> list[list[arb]]:
        """The disturbance's share at node l alone, l = 0 ... N, then at every later one."""
        return self._upset([*self.responses[:-1], self.settled])

    def _upset(self, found: list[list[arb]]) -> list[list[arb]]:
        return [sums(*each) for each in zip(found, self.upset, strict=True)] if self.upset else found

    @cached_property
    def forgotten(self) -> list[arb]:
        """What any undisturbed error within ``z`` at the start still needs after N periods."""
        each = [self.boxed(self.memory.z, lag) for lag in range(self.memory.periods)]
        return [largest(values) * self.memory.c for values in zip(*each, strict=True)]

    def boxed(self, size: arb_mat, lag: int) -> list[arb]:
        """What any undisturbed error up to a size needs in the periods next to node l."""
        return list(((magnitude(self.carried[lag]) + self.bend[lag]) * size).entries())

    @cached_property
    def _most(self) -> arb_mat:
        """What a unit of each state's error needs at most in the first N periods."""
        pairs = zip(self.carried[: self.memory.periods], self.bend, strict=False)
        return reduce(_larger, (magnitude(carried) + bend for carried, bend in pairs))

    def still(self, size: arb_mat) -> list[arb]:
        """The same after N periods."""
        first, later = self.memory.left(size)
        return list((self._most * (first + later)).entries())

    def ever(self, size: arb_mat) -> list[arb]:
        """The same at any time."""
        each = [*(self.boxed(size, lag) for lag in range(len(self.carried))), self.still(size)]
        return list(map(largest, zip(*each, strict=True)))

    def tube(self, start: Zonotope) -> list[list[arb]]:
        """What one set needs at lag l = 0 ... N, disturbance apart: exact support and what is booked."""
        support = self._split(start.support(above(*self.carried[:-1])))
        return [sums(most, self.booked(start, lag)) for lag, most in enumerate(support)]

    def booked(self, start: Zonotope, lag: int) -> list[arb]:
        """What is booked between nodes for one set, for the periods next to node l: no more than `bend`."""
        bows = [self._bow(start, at) for at in {lag, max(lag - 1, 0)}]
        return [largest(each) for each in zip(*bows, strict=True)]

    def _bow(self, start: Zonotope, lag: int) -> list[arb]:
        """How far one set bends within the period after node l, once: two lags ask."""
        if (id(start), lag) not in self._bowed:
            rate = start.image(self.motion.closed * self.memory.powers[lag])
            self._bowed[id(start), lag] = start, self.motion.closer_bow(self.rows, rate)
        return self._bowed[id(start), lag][1]

    def per_norm(self, inverse: arb_mat) -> list[list[arb]]:
        """What a unit ball of ``norm(V e, 2)`` needs at lag l, given ``V^-1``."""
        curved = self.motion.bend(self.rows)
        bent = [
            norms(curved * magnitude(self.motion.closed * power * inverse))
            for power in self.memory.powers[:-1]
        ]
        straight = [norms(row * inverse) for row in self.carried[:-1]]
        before = [bent[0], *bent[:-1]]
        return [
            [a + largest((b, c)) for a, b, c in zip(*each, strict=True)]
            for each in zip(straight, bent, before, strict=True)
        ]


def _larger(a: arb_mat, b: arb_mat) -> arb_mat:
    """The larger of two bounds, entry by entry."""
    return arb_mat(a.nrows(), a.ncols(), list(map(largest, zip(a.entries(), b.entries(), strict=True))))
