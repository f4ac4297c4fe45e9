"""States that the loop of a craft has beside its tracking error, and how uncertainties enter them."""

from dataclasses import dataclass, field, replace
from math import ceil

from flint import arb, arb_mat

from ...files.document import Document
from ...kernel.balls import above, absolute, column, exponential, identity, magnitude, matrix, sums
from ...kernel.motion import InputSet, Plant
from ..plants import WHOLE
from ..timing import carry_offset, state_offset
from .craft import Craft, Sample

Blocks = dict[int, arb_mat]
"""Entries by block of the loop state; block 0 is the tracking error."""

Noise = tuple[arb_mat, list[arb]]
"""Map of errors of estimates into the law's input, (n, k), and bounds on them, (k)."""


@dataclass
class States:
    """Blocks of the loop state while they are put together."""

    plant: Plant
    sizes: list[int] = field(default_factory=list)
    moves: dict[tuple[int, int], arb_mat] = field(default_factory=dict)  # without commands
    sensed: Blocks = field(default_factory=dict)  # the error that the law sees
    parts: list[tuple[arb, arb, Blocks]] = field(default_factory=list)  # how additions of a period enter
    shown: Blocks = field(default_factory=dict)  # additions that the next measurement shows first
    shown_now: list[arb_mat] = field(default_factory=list)  # the same of the parts of the period
    samples: list[tuple[Blocks, arb_mat, list[arb], list[arb]]] = field(default_factory=list)
    box: list[arb] = field(default_factory=list)  # bounds on all but the error, whatever law has flown
    carries: int = 0  # block of the impulses that are carried, which the flight computer does not know of

    @classmethod
    def from_plant(cls, plant: Plant) -> "States":
        """Return the error alone."""
        one = identity(plant.A.nrows())
        parts = [(arb(0), plant.h, {0: one})]
        return cls(plant, [one.nrows()], {(0, 0): plant.open.phi}, {0: one}, parts, {}, [one])

    def add(self, box: list[arb]) -> int:
        """Add a block, with bounds on it; returns its number."""
        self.sizes.append(len(box))
        self.box = [*self.box, *box]
        return len(self.sizes) - 1

    def laid_out(self, blocks: Blocks, columns: int) -> arb_mat:
        """Blocks one above the other, zero where there is none."""
        return above(*(blocks.get(i, arb_mat(size, columns)) for i, size in enumerate(self.sizes)))

    def beside(self, blocks: Blocks, rows: int) -> arb_mat:
        """Blocks side by side, zero where there is none."""
        transposed = {i: block.transpose() for i, block in blocks.items()}
        return self.laid_out(transposed, rows).transpose()

    def delay(self, delay: float, pushes: list[InputSet]) -> None:
        """Remember additions that no measurement has shown: a line of them, or one per part of periods."""
        plant, h, one = self.plant, self.plant.h, identity(self.plant.A.nrows())
        periods = max(ceil(float((arb(delay) / h).mid()) - WHOLE), 1)
        late = arb(delay) - (periods - 1) * h
        is_whole = float((late / h).mid()) >= 1 - WHOLE
        split = arb(0) if is_whole else h - late
        if not is_whole:
            self.parts = [(arb(0), split, {0: one}), (split, h, {0: one})]
            self.shown_now = [0 * one, 0 * one]
        for early in (False, True)[: 1 if is_whole else 2]:
            ages, back = periods - early, exponential(plant.A, -h)[0]
            begin, end = (arb(0), split) if early else (split, h)
            for age in range(ages):
                carried = exponential(plant.A, h * (age + 1) - end)[0]
                part = replace(plant, h=end - begin).open
                remainder = magnitude(carried * part.gamma * plant.B) * column(
                    [2 * plant.carried / h] * plant.B.ncols()
                )
                disturbed = part.gains_over(carried, pushes, 1)[0]
                block = self.add([x.upper() for x in sums(disturbed, remainder.entries())])
                self.sensed[block] = -one
                if age:
                    self.moves[block, block - 1] = plant.open.phi
                else:
                    self.parts[-1 if not early else 0][2][block] = one
            transition = exponential(plant.A, -(h - split) if early else split)[0]
            if ages:
                self.shown[len(self.sizes) - 1] = transition * back ** (ages - 1)
            else:
                self.shown_now[0] = transition
        if is_whole:
            self.shown_now = [0 * one]

    def impulses(self) -> None:
        """Carry the rest of the impulses of a period to the next one."""
        self.carries = self.add([arb(self.plant.carried)] * self.plant.B.ncols())

    def _carry(self) -> None:
        """Add the carried impulses to the blocks: the impulse of a period is its rest less the next."""
        plant, m, block = self.plant, self.plant.B.ncols(), self.carries
        gains: Blocks = {}
        for begin, end, enters in self.parts:
            transition = exponential(plant.A, plant.h - end)[0]
            gain = transition * replace(plant, h=end - begin).open.gamma * plant.B * (1 / plant.h)
            for i, each in enters.items():
                gains[i] = gains[i] + each * gain if i in gains else each * gain
        for i, each in gains.items():
            self.moves[i, block] = each
        adds = {i: -each for i, each in gains.items()} | {block: identity(m)}
        self.samples.append((adds, identity(m) * (1 / plant.h), [arb(plant.carried)] * m, []))

    def observer(
        self,
        gain: arb_mat,
        measures: arb_mat,
        noise: tuple[list[arb], list[arb]],
        carry: arb_mat,
        settled: list[arb],
    ) -> None:
        """Add estimates from measurements, with an error that lasts; of their noise a part is constant."""
        rest, block = identity(gain.nrows()) - gain * measures, self.add(settled)
        self.moves[block, block] = rest * self.plant.open.phi
        self.sensed[block] = carry
        for i, each in self.shown.items():
            self.moves[block, i] = -rest * each
        for (_, _, enters), visible in zip(self.parts, self.shown_now, strict=True):
            enters[block] = -rest * visible
        self.samples.append(({block: gain}, arb_mat(self.plant.B.ncols(), gain.ncols()), *noise))

    def closed(self, gain: arb_mat, steady: list[InputSet], noise: Noise, base: list[arb] | None) -> Craft:
        """Close the loop by a law."""
        plant, n, m = self.plant, self.sizes[0], self.plant.B.ncols()
        if self.carries:
            self._carry()
        rows = [
            self.beside({j: b for (i, j), b in self.moves.items() if i == row}, size)
            for row, size in enumerate(self.sizes)
        ]
        unit = {self.carries: identity(m) * (1 / plant.h)} if self.carries else {}
        drifts = self.beside({0: plant.A}, n) + plant.B * self.beside(unit, m)
        parts = [(a, b, self.laid_out(enters, n)) for a, b, enters in self.parts]
        samples = [
            Sample(self.laid_out(adds, len(size)), push, size, constant)
            for adds, push, size, constant in self.samples
        ]
        sees, sources = self.beside(self.sensed, n), (steady, samples, self.box, *noise)
        return Craft(plant, gain, above(*rows), sees, drifts, parts, *sources, base)


def remembers(document: Document) -> bool:
    """Return True if delay, observer and carried impulses are states of the loop.

    A box stands for the estimate where any of several patterns of measurements may be met.
    """
    outage = any(not fault.get("pushes") for fault in document.transients)
    phases = bool(document.error_by_step) and document.timing.get("delay", 0.0) > 0
    return not (document.timing.get("missed", 0) or (document.observer is None and (outage or phases)))


def craft_of(document: Document, plant: Plant, gain: arb_mat, observing: bool = True) -> Craft:
    """Build the loop of the safety controller from a certificate; without updates if not `observing`."""
    n, m = plant.A.nrows(), plant.B.ncols()
    delay, design = document.timing.get("delay", 0.0), document.observer
    if not remembers(document):
        full = column(plant.thruster_part(plant.u_max))
        worst = sum((gains * full for _, gains in plant.by_lag), arb_mat(n, 1))
        estimate = list(map(arb, document.calmest or [0.0] * n))
        error = [(x - y).abs_upper() for x, y in zip(estimate, worst.entries(), strict=True)]
        noise = identity(n), error if document.estimate else [arb(0)] * n
        return States.from_plant(plant).closed(gain, plant.disturbances([]), noise, estimate)
    plant = replace(plant, by_lag=[])  # states hold that
    along = arb(plant.along) * plant.carried
    offset = (absolute(plant.B) * column([along] * m)).entries()
    carried = carry_offset(plant)
    shift = [
        _positive(x - y) + z for x, y, z in zip(state_offset(document, delay), carried, offset, strict=True)
    ]
    states = States.from_plant(plant)
    drift = [InputSet.in_box(plant.A * plant.B, [along] * m)] if along > 0 else []
    steady = [plant.disturbance, *plant.bias, *plant.shifting, *drift]
    if delay:
        states.delay(delay, [*steady, *plant.push(plant.thruster_error(plant.u_max))])
    if plant.carried:
        states.impulses()
    measured = list(map(arb, document.measured_error or document.estimate or [0.0] * n))
    carry, error = exponential(plant.A, arb(delay))[0] if delay else identity(n), [arb(0)] * n
    base: list[arb] | None = list(map(arb, document.calmest or [0.0] * n))
    if design is not None:  # first errors fade as all else that it remembers does
        first = design.get("initial") or design.get("settled") or document.measured_error or document.estimate
        M, base = matrix(design["measures"]), None
        noisy = sums(map(arb, design["noise"]), (absolute(M) * column(shift)).entries())
        L = matrix(design["gain"]) * int(observing)
        constant = list(map(arb, design.get("constant") or []))
        states.observer(L, M, (noisy, constant), carry, sums(map(arb, first), carried))
    elif delay:
        error = sums(measured, shift)
    elif document.estimate:
        error = [_positive(arb(x) - y) + z for x, y, z in zip(document.calmest, carried, offset, strict=True)]
    return states.closed(gain, steady, (carry, error), base)


def _positive(x: arb) -> arb:
    return x.abs_upper() if not x < 0 else arb(0)
