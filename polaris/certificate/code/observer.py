"""Observer of the flight code: its tables are the certificate's, and its rounding is bounded.

Rounding enters at every prediction and update. Besides, the observer on board knows the commands that are
flown, and the exact one those of the exact law: the bound on errors of commands bounds this difference, too.
Half of S's gain is counted with the motion of errors, so the other half is left of them, whoever flies.
"""

from dataclasses import dataclass
from functools import cached_property
from math import ceil, fsum

from flint import arb, arb_mat

from ..files.document import Document
from ..kernel.balls import (
    above,
    beside,
    column,
    exponential,
    identity,
    largest,
    magnitude,
    matrix,
    maxima,
    sums,
)
from ..kernel.motion import Plant
from ..kernel.verdict import Rejected
from ..model.plants import WHOLE
from .rounding import UNIT, least, rounding_factor
from .text import CENTRE, Table, Tables

FEWEST, LONGEST, LEFT = 8, 4096, 0.01
"""Periods until an error counts as forgotten, at least and at most, and the share of it that is left then."""
ROUNDS, STEP, LOWER = 50, 1.1, 5
"""Most enlargements of bounds until they hold with what they cause, by how much, and how often they are
lowered then."""


@dataclass(frozen=True, eq=False)
class OnBoard:
    """Observer that a certificate states, as the flight code makes its predictions and updates."""

    document: Document
    plant: Plant
    tables: Tables
    precision: str

    @cached_property
    def delay(self) -> arb:
        """Return the age of measurements [s]."""
        return arb(self.document.timing.get("delay", 0.0))

    @cached_property
    def output_map(self) -> arb_mat:
        """Return the map from the state predicted for now to the measured values."""
        assert self.document.observer is not None
        return matrix(self.document.observer["measures"]) * exponential(self.plant.A, -self.delay)[0]

    @cached_property
    def later(self) -> list[arb_mat]:
        """Return the unmeasured effect, mapped by `output_map`, of commands 1, 2, ... periods before."""
        h, parts = self.plant.h, list[arb_mat]()
        count = ceil(float((self.delay / h).mid()) * (1 - WHOLE))
        for age in range(max(count, 1)):
            duration = self.delay - age * h  # may exceed the last period, by a share of `WHOLE`
            gain = exponential(self.plant.A, h if duration > h else duration)[1] * self.plant.B
            parts.append(self.output_map * exponential(self.plant.A, age * h)[0] * gain)
        return parts

    @cached_property
    def updates(self) -> list[arb_mat]:
        """Return the gain on the difference from the prediction, after 0, 1, ... missed periods."""
        observer = self.document.observer or {}
        transition = exponential(self.plant.A, self.delay)[0]
        return [transition * matrix(gain) for gain in (observer["gain"], *observer.get("after", ()))]

    def exact(self) -> dict[str, list[arb_mat]]:
        """Return the tables as matrices that hold the exact numbers, by name."""
        if self.document.observer is None:
            raise Rejected("code", "the certificate states no observer")
        if self.tables.rows or any(not fault.get("pushes") for fault in self.document.transients):
            raise Rejected("code", "an observer flies without a monitor and where navigation is not lost")
        transition, integral = exponential(self.plant.A, self.plant.h)
        tables = {"held": [transition], "force": [integral * self.plant.B], "seen": [self.output_map]}
        return tables | {"later": self.later, "updates": self.updates}

    def heard(self, reach: list[float]) -> list[float]:
        """Return the largest measurements, of states within `reach`, for which rounding is bounded."""
        rows = (self.document.observer or {})["measures"]
        return [fsum(abs(x) * y for x, y in zip(row, reach, strict=True)) for row in rows]

    @cached_property
    def _rounding(self) -> tuple[arb_mat, list[arb_mat]]:
        """Bounds on the rounding of a prediction (n, 1), and of an update, by its kind."""
        tables, precision = self.tables, self.precision
        reach, limit, measured = (column(x) for x in (tables.range, tables.limit, tables.heard))
        (n, m), o, sent = (len(tables.range), len(tables.limit)), len(tables.heard), len(tables.later)
        exact, integral = exponential(self.plant.A, self.plant.h)
        transition, force, output_map = (matrix(x) for x in (tables.held, tables.force, tables.seen))
        size = magnitude(transition) * reach + magnitude(force) * limit
        wrong = magnitude(transition - exact) * reach + magnitude(force - integral * self.plant.B) * limit
        predicted = wrong + _loss(size, 0, precision, tables.held, tables.force) + least(n, n + m, precision)
        size = size + predicted
        total, wrong = measured + magnitude(output_map) * size, magnitude(output_map - self.output_map) * size
        for stored, true in zip(map(matrix, tables.later), self.later, strict=True):
            total += magnitude(stored) * limit
            wrong += magnitude(stored - true) * limit
        wrong += measured * arb(UNIT[precision] * (precision == "float"))
        wrong += _loss(total, 1, precision, tables.seen, *tables.later) + least(o, n + sent * m, precision)
        total, updated = total + wrong, list[arb_mat]()
        for rows, true in zip(tables.updates, self.updates, strict=True):
            stored = matrix(rows)
            error = magnitude(true) * wrong + magnitude(stored - true) * total
            error += _loss(size + magnitude(stored) * total, 1, precision, rows) + least(n, o, precision)
            updated.append(error)
        return predicted, updated

    @cached_property
    def _maps(self) -> tuple[arb_mat, arb_mat, list[arb_mat]]:
        """Maps of errors of the state, and of commands so far back: of a period, and of updates by kind.

        The second is what commands add that are off besides.
        """
        n, m, sent = len(self.tables.range), len(self.tables.limit), len(self.later)
        count, gain = (sent - 1) * m, matrix(self.document.laws[0].gain or [])
        transition, integral = exponential(self.plant.A, self.plant.h)
        force = above(integral * self.plant.B, identity(m), arb_mat(count, m))
        state_map = above(transition, arb_mat(sent * m, n)) - force * gain * arb(CENTRE)
        loop = beside(state_map, above(arb_mat(n + m, count), identity(count)), arb_mat(n + sent * m, m))
        updates = []
        for update in self.updates:
            rows = beside(identity(n) - update * self.output_map, *(update * part for part in self.later))
            updates.append(above(rows, beside(arb_mat(sent * m, n), identity(sent * m))))
        return loop, force, updates

    def command_error(self, other_error: arb) -> arb:
        """Bound errors of commands [N] by the stated bound: `other_error` is that of all but the estimate.

        By every pattern of missed periods, as errors of an observer are bounded (docs/theory.md, Proposition
        7). `Rejected` if rounding is not forgotten.
        """
        n, (loop, force, updates) = len(self.tables.range), self._maps
        differing = column([(arb(self.tables.rounding) + other_error) * (1 - CENTRE)] * force.ncols())
        state = above(identity(n), arb_mat(loop.nrows() - n, n))
        (predicted, updated), ways = self._rounding, beside(state, force)
        steps, sizes = [loop**age for age in range(len(updates) + 1)], above(predicted, differing)
        added, loops = list[tuple[arb_mat, arb_mat]](), list[arb_mat]()
        for kind, (Q, error) in enumerate(zip(updates, updated, strict=True), 1):
            columns = beside(state, *(Q * M * ways for M in steps[:kind]))
            added.append((columns, above(error, *[sizes] * kind)))
            loops.append(Q * steps[kind])
        input_error = column(self.tables.range) * arb(UNIT[self.precision] * (self.precision == "float"))
        powers, differences, bound = _settled(loops, added, state * input_error)
        rows = matrix(self.document.laws[0].gain or []) * state.transpose()
        growth, worst = rows * bound * 0, list[arb]()
        for M in steps[:-1]:  # of periods without a measurement
            maps = [rows * M * power for power in powers]
            worst += (_worst(maps, differences, added, state * input_error, bound) + growth).entries()
            growth += magnitude(rows * M * ways) * sizes
        return other_error + largest(worst)


def _loss(size: arb_mat, before: int, precision: str, *tables: Table) -> arb_mat:
    """Bound the rounding error of sums of products, by their sizes: a product with 0 rounds nothing.

    Sums begin with a number `before` them, or with none.
    """
    rows = ([x for table in tables for x in table[i]] for i in range(len(tables[0])))
    terms = (sum(x != 0 for x in row) + before for row in rows)
    return column(
        [x * rounding_factor(count - 1, precision) for x, count in zip(size.entries(), terms, strict=True)]
    )


Added = list[tuple[arb_mat, arb_mat]]
"""Errors that an update adds, by its kind: ways in which they enter, and bounds on their sizes."""


def _settled(
    loops: list[arb_mat], added: Added, first: arb_mat
) -> tuple[list[arb_mat], list[arb_mat], arb_mat]:
    """Bound errors just after updates, the first within `first`; each kind turns them and adds to them.

    Before the bounds are maps of an error over so many periods, and what kinds change of it.
    """
    loop, kinds, count = loops[0], len(loops), FEWEST
    differences = [M - loop ** (j + 1) for j, M in enumerate(loops)]
    powers = [identity(loop.nrows())]
    while True:
        while len(powers) < count + kinds:
            powers.append(powers[-1] * loop)
        bound = _worst(powers, differences, added, first, 0 * first)
        remaining = maxima(*((magnitude(M) * bound).entries() for M in powers[count:]))
        if all(x <= LEFT * y for x, y in zip(remaining, bound.entries(), strict=True)):
            break
        if count >= LONGEST:
            raise Rejected("rounding", f"the observer remembers errors for more than {count} periods")
        count *= 2
    for _ in range(ROUNDS):
        after = _worst(powers, differences, added, first, bound).entries()
        if all(x <= y for x, y in zip(after, bound.entries(), strict=True)):
            break
        bound = column([x * STEP for x in maxima(after, bound.entries())])
    else:
        raise Rejected("rounding", "errors of the observer grow by missed periods")
    for _ in range(LOWER if kinds > 1 else 1):
        bound = _worst(powers, differences, added, first, bound)
    return powers, differences, bound


def _worst(
    powers: list[arb_mat], differences: list[arb_mat], added: Added, first: arb_mat, bound: arb_mat
) -> arb_mat:
    """Bound rows of errors just after updates by every pattern, if those before were within `bound`."""
    kinds, count = len(added), len(powers) - len(added)
    by_age, total = [[arb(0)] * M.nrows() for M in powers], list[list[arb]]()
    for age, M in enumerate(powers):
        start = first if age < count else bound
        total.append([x.upper() for x in sums(by_age[age], (magnitude(M) * start).entries())])
        for j in range(kinds if age < count else 0):
            increment = magnitude(M * added[j][0]) * added[j][1] + magnitude(M * differences[j]) * bound
            later = [x.upper() for x in sums(by_age[age], increment.entries())]
            by_age[age + j + 1] = maxima(by_age[age + j + 1], later)
    return column([x.upper() for x in maxima(*total)])
