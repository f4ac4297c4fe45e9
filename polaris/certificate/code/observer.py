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
    def seen(self) -> arb_mat:
        """Return the map from the state predicted for now to the measured values."""
        assert self.document.observer is not None
        return matrix(self.document.observer["measures"]) * exponential(self.plant.A, -self.delay)[0]

    @cached_property
    def later(self) -> list[arb_mat]:
        """Return the unmeasured effect, mapped by `seen`, of commands 1, 2, ... periods before."""
        h, parts = self.plant.h, list[arb_mat]()
        count = ceil(float((self.delay / h).mid()) * (1 - WHOLE))
        for age in range(max(count, 1)):
            left = self.delay - age * h  # may exceed the last period, by a share of `WHOLE`
            pushed = exponential(self.plant.A, h if left > h else left)[1] * self.plant.B
            parts.append(self.seen * exponential(self.plant.A, age * h)[0] * pushed)
        return parts

    @cached_property
    def updates(self) -> list[arb_mat]:
        """Return the gain on the difference from the prediction, after 0, 1, ... missed periods."""
        stated = self.document.observer or {}
        ahead = exponential(self.plant.A, self.delay)[0]
        return [ahead * matrix(gain) for gain in (stated["gain"], *stated.get("after", ()))]

    def exact(self) -> dict[str, list[arb_mat]]:
        """Return the tables as matrices that hold the exact numbers, by name."""
        if self.document.observer is None:
            raise Rejected("code", "the certificate states no observer")
        if self.tables.rows or any(not fault.get("pushes") for fault in self.document.transients):
            raise Rejected("code", "an observer flies without a monitor and where navigation is not lost")
        held, whole = exponential(self.plant.A, self.plant.h)
        known = {"held": [held], "force": [whole * self.plant.B], "seen": [self.seen]}
        return known | {"later": self.later, "updates": self.updates}

    def heard(self, reach: list[float]) -> list[float]:
        """Return the largest measurements, of states within `reach`, for which rounding is bounded."""
        rows = (self.document.observer or {})["measures"]
        return [fsum(abs(x) * y for x, y in zip(row, reach, strict=True)) for row in rows]

    @cached_property
    def _rounded(self) -> tuple[arb_mat, list[arb_mat]]:
        """Bounds on the rounding of a prediction (n, 1), and of an update, by its kind."""
        tables, precision = self.tables, self.precision
        reach, limit, heard = (column(x) for x in (tables.range, tables.limit, tables.heard))
        (n, m), o, sent = (len(tables.range), len(tables.limit)), len(tables.heard), len(tables.later)
        held, whole = exponential(self.plant.A, self.plant.h)
        known, pushed, seen = (matrix(x) for x in (tables.held, tables.force, tables.seen))
        size = magnitude(known) * reach + magnitude(pushed) * limit
        wrong = magnitude(known - held) * reach + magnitude(pushed - whole * self.plant.B) * limit
        predicted = wrong + _lost(size, 0, precision, tables.held, tables.force) + least(n, n + m, precision)
        size = size + predicted
        off, wrong = heard + magnitude(seen) * size, magnitude(seen - self.seen) * size
        for given, true in zip(map(matrix, tables.later), self.later, strict=True):
            off += magnitude(given) * limit
            wrong += magnitude(given - true) * limit
        wrong += heard * arb(UNIT[precision] * (precision == "float"))
        wrong += _lost(off, 1, precision, tables.seen, *tables.later) + least(o, n + sent * m, precision)
        off, updated = off + wrong, list[arb_mat]()
        for rows, true in zip(tables.updates, self.updates, strict=True):
            given = matrix(rows)
            made = magnitude(true) * wrong + magnitude(given - true) * off
            made += _lost(size + magnitude(given) * off, 1, precision, rows) + least(n, o, precision)
            updated.append(made)
        return predicted, updated

    @cached_property
    def _maps(self) -> tuple[arb_mat, arb_mat, list[arb_mat]]:
        """Maps of errors of the state, and of commands so far back: of a period, and of updates by kind.

        The second is what commands add that are off besides.
        """
        n, m, sent = len(self.tables.range), len(self.tables.limit), len(self.later)
        kept, gain = (sent - 1) * m, matrix(self.document.laws[0].gain or [])
        held, whole = exponential(self.plant.A, self.plant.h)
        force = above(whole * self.plant.B, identity(m), arb_mat(kept, m))
        known = above(held, arb_mat(sent * m, n)) - force * gain * arb(CENTRE)
        moved = beside(known, above(arb_mat(n + m, kept), identity(kept)), arb_mat(n + sent * m, m))
        updates = []
        for update in self.updates:
            rows = beside(identity(n) - update * self.seen, *(update * part for part in self.later))
            updates.append(above(rows, beside(arb_mat(sent * m, n), identity(sent * m))))
        return moved, force, updates

    def command_error(self, rest: arb) -> arb:
        """Bound errors of commands [N] by the stated bound: `rest` is that of all but the estimate.

        By every pattern of missed periods, as errors of an observer are bounded (docs/theory.md, Proposition
        7). `Rejected` if rounding is not forgotten.
        """
        n, (moved, force, updates) = len(self.tables.range), self._maps
        differing = column([(arb(self.tables.rounding) + rest) * (1 - CENTRE)] * force.ncols())
        state = above(identity(n), arb_mat(moved.nrows() - n, n))
        (predicted, updated), ways = self._rounded, beside(state, force)
        steps, sizes = [moved**age for age in range(len(updates) + 1)], above(predicted, differing)
        added, turned = list[tuple[arb_mat, arb_mat]](), list[arb_mat]()
        for kind, (Q, made) in enumerate(zip(updates, updated, strict=True), 1):
            each = beside(state, *(Q * M * ways for M in steps[:kind]))
            added.append((each, above(made, *[sizes] * kind)))
            turned.append(Q * steps[kind])
        handed = column(self.tables.range) * arb(UNIT[self.precision] * (self.precision == "float"))
        left, apart, known = _settled(turned, added, state * handed)
        rows = matrix(self.document.laws[0].gain or []) * state.transpose()
        pushed, worst = rows * known * 0, list[arb]()
        for M in steps[:-1]:  # of periods without a measurement
            maps = [rows * M * power for power in left]
            worst += (_worst(maps, apart, added, state * handed, known) + pushed).entries()
            pushed += magnitude(rows * M * ways) * sizes
        return rest + largest(worst)


def _lost(size: arb_mat, before: int, precision: str, *tables: Table) -> arb_mat:
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
    turned: list[arb_mat], added: Added, first: arb_mat
) -> tuple[list[arb_mat], list[arb_mat], arb_mat]:
    """Bound errors just after updates, the first within `first`; each kind turns them and adds to them.

    Before the bounds are maps of an error over so many periods, and what kinds change of it.
    """
    loop, kinds, count = turned[0], len(turned), FEWEST
    apart = [M - loop ** (j + 1) for j, M in enumerate(turned)]
    left = [identity(loop.nrows())]
    while True:
        while len(left) < count + kinds:
            left.append(left[-1] * loop)
        known = _worst(left, apart, added, first, 0 * first)
        rest = maxima(*((magnitude(M) * known).entries() for M in left[count:]))
        if all(x <= LEFT * y for x, y in zip(rest, known.entries(), strict=True)):
            break
        if count >= LONGEST:
            raise Rejected("rounding", f"the observer remembers errors for more than {count} periods")
        count *= 2
    for _ in range(ROUNDS):
        more = _worst(left, apart, added, first, known).entries()
        if all(x <= y for x, y in zip(more, known.entries(), strict=True)):
            break
        known = column([x * STEP for x in maxima(more, known.entries())])
    else:
        raise Rejected("rounding", "errors of the observer grow by missed periods")
    for _ in range(LOWER if kinds > 1 else 1):
        known = _worst(left, apart, added, first, known)
    return left, apart, known


def _worst(
    left: list[arb_mat], apart: list[arb_mat], added: Added, first: arb_mat, known: arb_mat
) -> arb_mat:
    """Bound rows of errors just after updates by every pattern, if those before were within `known`."""
    kinds, count = len(added), len(left) - len(added)
    come, total = [[arb(0)] * M.nrows() for M in left], list[list[arb]]()
    for age, M in enumerate(left):
        start = first if age < count else known
        total.append([x.upper() for x in sums(come[age], (magnitude(M) * start).entries())])
        for j in range(kinds if age < count else 0):
            more = magnitude(M * added[j][0]) * added[j][1] + magnitude(M * apart[j]) * known
            later = [x.upper() for x in sums(come[age], more.entries())]
            come[age + j + 1] = maxima(come[age + j + 1], later)
    return column([x.upper() for x in maxima(*total)])
