"""Loop of a craft under a linear law: tracking error, delay, carried impulses, observer.

The loop state ``z`` begins with the error ``e = x - xi``. In every period ``z+ = F z + ...``, the rest being
what uncertain inputs add. What is not the error moves by itself, whatever law flies.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

from flint import arb, arb_mat

from ...files.document import ROUNDED, Document
from ...kernel.balls import above, absolute, beside, column, diagonal, exponential, magnitude, sums
from ...kernel.motion import InputSet, Motion, Plant, RowIntersample
from ...kernel.zonotopes import Directions, Zonotope

LAGS = 0, 1, 8, 64  # periods after which extents of sets count in the choice of what to merge


@dataclass(frozen=True)
class Sample:
    """One value per period in a box, added to the next loop state and to the input of the period."""

    adds: arb_mat  # shape (N, k)
    push: arb_mat  # shape (m, k)
    size: list[arb]
    constant: list[arb] = field(default_factory=list)  # part of it that is one value for the whole flight


@dataclass(frozen=True, eq=False)
class Craft:
    """The loop, and its uncertainties."""

    plant: Plant
    gain: arb_mat  # of the law, shape (m, n)
    free: arb_mat  # from one node to the next without commands, shape (N, N)
    sees: arb_mat  # the error as a law takes it to be, errors of estimates apart, shape (n, N)
    drifts: arb_mat  # rate of the error at a node without commands, shape (n, N)
    parts: list[tuple[arb, arb, arb_mat]]  # of a period, and how what is added in them enters, (N, n)
    steady: list[InputSet]  # what pushes at every instant, errors of the inputs apart
    samples: list[Sample]
    box: list[arb]  # bounds on the states beside the error at the start of a flight, (N - n)
    carry: arb_mat  # from errors of estimates to what the law sees, shape (n, k)
    errors: list[arb]  # bounds on these errors, commands apart, (k)
    base: list[arb] | None  # bounds on errors of estimates beyond which they count by the step of the flight
    _along: dict[Directions, tuple[RowIntersample, Directions]] = field(default_factory=dict, repr=False)

    def with_gain(self, gain: arb_mat) -> Craft:
        """Return the loop under another law."""
        return replace(self, gain=gain, _along={})

    def last(self, duration: arb) -> Craft:
        """Return the loop with additions in the last seconds of a period alone."""
        begin = (self.plant.h - duration).lower()
        parts = [(begin if begin > a else a, b, enters) for a, b, enters in self.parts if not b <= begin]
        return replace(self, parts=parts, _along={})

    @property
    def motion(self) -> Motion:
        """Motion of the error alone, without commands."""
        return self.plant.open

    @cached_property
    def bits(self) -> list[InputSet]:
        """Errors of the inputs, commands apart."""
        return self.plant.push(self.plant.thruster_error([arb(0)] * self.plant.B.ncols()))

    @cached_property
    def commands(self) -> arb_mat:
        """K: the law commands ``-K z``, beside the effect of estimate errors; shape (m, N)."""
        return self.gain * self.sees

    @cached_property
    def held_map(self) -> arb_mat:
        """Map of inputs, held over a period, into the next loop state, shape (N, m)."""
        return self.lifted(self.motion.gamma * self.plant.B)

    @cached_property
    def F(self) -> arb_mat:
        """Return the transition of the loop from one node to the next, shape (N, N)."""
        return self.free - self.held_map * self.commands

    @cached_property
    def rates(self) -> arb_mat:
        """Rate of the error at a node, shape (n, N)."""
        return self.drifts - self.plant.B * self.commands

    def noise(self, more: list[arb]) -> list[arb]:
        """Bounds on the difference of a command from ``-K z``, with estimate errors larger by `more` (n)."""
        return (absolute(self.gain * self.carry) * column(self.missed(more))).entries()

    def noise_in(self, document: Document, k: int) -> list[arb]:
        """`noise` in a step, after commands up to the thrusters' limits."""
        return self.noise(sums(self.extra(document, k), self.lag_error(self.plant.u_max)))

    def missed(self, more: list[arb]) -> list[arb]:
        """Bounds on errors of estimates with some `more`, which there are only where nothing carries them."""
        return sums(self.errors, more) if any(x > 0 for x in more) else self.errors

    @property
    def lag(self) -> int:
        """Return for how many periods at most commands add to errors of estimates; 0 if they do not."""
        return max((periods for periods, _ in self.plant.by_lag), default=0)

    def lag_error(self, commands: Sequence[arb]) -> list[arb]:
        """Bounds on errors of estimates by commands up to some sizes, (n)."""
        return self.lag_error_since(lambda periods: commands)

    def lag_error_since(self, commands: Callable[[int], Sequence[arb]]) -> list[arb]:
        """Bounds on errors of estimates by commands, given the largest of so many periods before, (n)."""
        errors = [arb(0)] * self.gain.ncols()
        for periods, gain in self.plant.by_lag:
            errors = sums(errors, (gain * column(self.plant.thruster_part(commands(periods)))).entries())
        return errors

    def extra(self, document: Document, k: int) -> list[arb]:
        """Bounds on the excess of estimate errors in a step over those in the loop, shape (n)."""
        if self.base is None or not document.error_by_step:
            return [arb(0)] * self.gain.ncols()
        pairs = zip(document.errors_in(k), self.base, strict=True)
        excess = ((x * arb(1 + ROUNDED) - y).upper() for x, y in pairs)
        return [x if x > 0 else arb(0) for x in excess]

    def pad(self, rows: arb_mat) -> arb_mat:
        """Rows of the error as rows of the loop state."""
        missing = self.free.ncols() - rows.ncols()
        return beside(rows, arb_mat(rows.nrows(), missing)) if missing else rows

    def lifted(self, M: arb_mat) -> arb_mat:
        """Return an addition to the error (n, .) as one to the loop state (N, .), with zeros below."""
        missing = self.free.nrows() - M.nrows()
        return above(M, arb_mat(missing, M.ncols())) if missing else M

    def start(self, z: Zonotope) -> Zonotope:
        """Loop states at the start of a flight, from its errors."""
        zeros = arb_mat(self.plant.A.nrows(), len(self.box))
        return Zonotope(self.lifted(z.c), beside(self.lifted(z.G), above(zeros, diagonal(self.box))))

    @cached_property
    def spans(self) -> list[tuple[arb_mat, Motion]]:
        """Matrices by which additions in each part of the period enter the state, and its motions."""
        if len(self.parts) == 1 and self.parts[0][0] == 0:
            return [(self.parts[0][2], self.motion)]
        plant = self.plant
        return [
            (enters * exponential(plant.A, plant.h - end)[0], replace(plant, h=end - begin).open)
            for begin, end, enters in self.parts
        ]

    def added(self, error: list[arb]) -> list[arb_mat]:
        """Generators of a period's additions, errors of inputs up to some sizes included, noise apart."""
        pushes = [*self.plant.push(error), *self.steady]
        sampled = [sample.adds * diagonal(sample.size) for sample in self.samples]
        return [*sampled, *(enters * motion.effect(*pushes) for enters, motion in self.spans)]

    def intersample(self, rows: Directions) -> tuple[RowIntersample, Directions]:
        """Intersample bounds along rows of the error, and these as rows of the loop state; made once."""
        if rows not in self._along:
            sampled = [InputSet.in_box(self.plant.B * each.push, each.size) for each in self.samples]
            bounds = RowIntersample(self.motion, rows.M, [*self.steady, *sampled])
            self._along[rows] = bounds, Directions(self.pad(rows.M))
        return self._along[rows]

    @cached_property
    def unit(self) -> Directions:
        """Rows of the error itself."""
        return Directions(diagonal([1.0] * self.plant.A.nrows()))

    @cached_property
    def merge_rows(self) -> arb_mat:
        """Rows of the error and of commands, now and some periods later under the law."""
        rows = above(self.pad(self.unit.M), self.commands)
        return above(*(rows * self.F**lag for lag in LAGS))

    @cached_property
    def varying(self) -> Craft:
        """Return the loop without errors that are constant in a whole flight."""
        steady = [push for push in self.steady if push not in self.plant.bias]
        samples = [
            replace(each, size=[x - y for x, y in zip(each.size, each.constant, strict=True)], constant=[])
            if each.constant
            else each
            for each in self.samples
        ]
        return replace(self, steady=steady, samples=samples, _along={})

    @cached_property
    def constants(self) -> list[arb_mat]:
        """Generators of errors that are constant over all periods, shape (N, k) each."""
        generators = [each.adds * diagonal(each.constant) for each in self.samples if each.constant]
        for push in self.plant.bias:
            each = [enters * motion.gamma * push.V * push.cover for enters, motion in self.spans]
            generators.append(sum(each[1:], each[0]))
        return generators

    @cached_property
    def uneven(self) -> arb_mat:
        """Bound on the effect of a unit of each input's error that varies within a period, shape (N, m).

        Of mean zero and a root mean square of one it moves the plant by at most ``(h^2/2) |A| E |B|``, and by
        ``h E |B|`` in the first part of the period, which enters in another way than the rest.
        """
        plant, maps = self.plant, [enters for _, _, enters in self.parts]
        shift = magnitude(self.motion.over) * magnitude(plant.B) * plant.h
        bound = magnitude(maps[-1]) * magnitude(plant.A) * shift * (plant.h / 2)
        return bound if len(maps) == 1 else bound + magnitude(maps[0] - maps[1]) * shift

    def disturbed(self, rows: arb_mat) -> list[arb]:
        """Support along rows (r, N) of the disturbances of a period beside errors of inputs and estimates."""
        total = [arb(0)] * rows.nrows()
        for sample in self.samples:
            total = sums(total, (magnitude(rows * sample.adds) * column(sample.size)).entries())
        return sums(total, self._support(rows, self.steady))

    def supports(self, rows: arb_mat) -> list[arb]:
        """Support along rows (r, N) of all that enters in a period, errors that grow with commands apart."""
        noise = (magnitude(rows * self._noise_map * self.carry) * column(self.errors)).entries()
        return sums(self.disturbed(rows), noise, self._support(rows, self.bits))

    def _support(self, rows: arb_mat, pushes: list[InputSet]) -> list[arb]:
        gains = [motion.push_gain(rows * enters, push) for enters, motion in self.spans for push in pushes]
        return sums([arb(0)] * rows.nrows(), *gains)

    def thrust_gains(self, rows: arb_mat) -> arb_mat:
        """Support along rows (r, N) of a unit of each error of thrusters over a period, shape (r, k)."""
        gains = [motion.unit_gains(rows * enters, 1) for enters, motion in self.spans]
        return sum(gains[1:], gains[0])

    def noise_gains(self, rows: arb_mat) -> arb_mat:
        """Support along rows (r, N) of a unit error of each estimate over a period, shape (r, n)."""
        return magnitude(rows * self._noise_map)

    @cached_property
    def _noise_map(self) -> arb_mat:
        return self.held_map * self.gain

    def off_chord(
        self, rows: arb_mat, rates: tuple[arb_mat, arb_mat], noise: list[arb], error: list[arb]
    ) -> list[arb]:
        """Intersample bound of rows of the error, beside the chord of their bounds at nodes.

        `rates` bound ``e'`` and ``A e'`` at nodes; `noise` and `error` errors of estimates and of inputs that
        are not counted in them.
        """
        inputs = absolute(self.gain) * column(noise) if noise else arb_mat(self.gain.nrows(), 1)
        return self._off_chord(rows, rates, inputs, self.plant.push(error))

    def off_chord_always(self, rows: arb_mat, rates: tuple[arb_mat, arb_mat]) -> list[arb]:
        """Intersample bound under all that is sampled, and all that pushes at every instant."""
        inputs = absolute(self.gain * self.carry) * column(self.errors)
        for sample in self.samples:
            inputs += absolute(sample.push) * column(sample.size)
        return self._off_chord(rows, rates, inputs, [*self.steady, *self.bits])

    def _off_chord(
        self, rows: arb_mat, rates: tuple[arb_mat, arb_mat], inputs: arb_mat, pushes: list[InputSet]
    ) -> list[arb]:
        """Intersample bound under more inputs up to `inputs` (m, 1), constant over the period, and pushes."""
        motion, B = self.motion, self.plant.B
        terms = absolute(B) * inputs, absolute(self.plant.A * B) * inputs
        intersample = RowIntersample(motion, rows).least_bound(rates[0] + terms[0], rates[1] + terms[1])
        return sums(intersample, *(motion.push_curvature(rows, push) for push in pushes))
