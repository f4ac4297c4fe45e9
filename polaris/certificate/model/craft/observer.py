"""Errors of an observer's estimates by every pattern of missed periods, as a certificate states them."""

from dataclasses import dataclass, field, replace
from itertools import pairwise

from flint import arb, arb_mat

from ...files.document import ROUNDED, Document
from ...kernel.balls import (
    absolute,
    column,
    exponential,
    identity,
    largest,
    magnitude,
    matrix,
    maxima,
    require,
    smallest,
    sums,
)
from ...kernel.motion import InputSet, Motion, Plant
from ...kernel.verdict import Rejected
from ..timing import state_offset

PARTS = 4  # parts of a period over each of which integrals are bounded by the trapezoid rule

FORGOTTEN, LONGEST = 1e-9, 4096
"""Share of an observer's error that counts as forgotten, and the most periods for it."""

Bounds = list[arb]
"""Bounds on errors, by state."""


@dataclass(frozen=True, eq=False)
class Update:
    """Update of an observer after missed periods: the share of errors it leaves, less that of periods."""

    gain: arb_mat
    rest: arb_mat
    other: arb_mat
    periods: int


@dataclass(frozen=True, eq=False)
class ObserverErrors:
    """An observer: all that updates may add so many periods later, by kind of update and source.

    Sources are numbered: 0 is all that does not grow with commands, and leads of pulses at full thrust; i + 1
    is a unit of errors of input i.
    """

    plant: Plant
    updates: list[Update]
    loop: arb_mat  # what an update and the period before make of an error
    noisy: arb_mat  # bounds on errors of what is measured, (r, 1)
    part: Motion  # of a part of a period
    pushes: list[InputSet]
    powers: list[arb_mat] = field(default_factory=list)
    older: list[list[arb_mat]] = field(default_factory=list)  # by age and kind, of an error before
    added: list[list[list[Bounds]]] = field(default_factory=list)  # by age, kind and source

    @classmethod
    def from_document(cls, document: Document, plant: Plant) -> "ObserverErrors":
        """Return the observer that a certificate states."""
        observer, missed = document.observer or {}, document.timing.get("missed", 0)
        n, one, M = plant.A.nrows(), identity(plant.A.nrows()), matrix(observer["measures"])
        gains = [matrix(gain) for gain in (observer["gain"], *observer.get("after", ()))]
        if len(gains) != missed + 1:
            raise Rejected("system", f"the observer must be designed for up to {missed} missed periods")
        loop, updates = (one - gains[0] * M) * exponential(plant.A, plant.h)[0], []
        for j, gain in enumerate(gains):
            rest = one - gain * M
            other = (
                rest * exponential(plant.A, plant.h * (j + 1))[0] - loop ** (j + 1) if j else arb_mat(n, n)
            )
            updates.append(Update(gain, rest, other, j + 1))
        offset = absolute(M) * column(state_offset(document, document.timing.get("delay", 0.0)))
        noisy = column(sums(map(arb, observer["noise"]), offset.entries()))
        m = plant.B.ncols()
        error = plant.thruster_error([arb(0)] * m)[:m] + plant.thruster_error(plant.u_max)[m:]
        pushes = plant.disturbances(error)
        return cls(plant, updates, loop, noisy, replace(plant, h=plant.h / PARTS).open, pushes, [one])

    @property
    def late(self) -> int:
        """Return how many periods in a row may be missed."""
        return len(self.updates) - 1

    def error_map(self, age: int) -> arb_mat:
        """Return the map of an error over so many periods."""
        while len(self.powers) <= age:
            self.powers.append(self.powers[-1] * self.loop)
        return self.powers[age]

    def _extend(self, age: int) -> None:
        """Compute the errors that updates up to so many periods ago add."""
        for at in range(len(self.added), age + 1):
            power, errors = self.error_map(at), list[list[Bounds]]()
            self.older.append([magnitude(power * update.other) for update in self.updates])
            for update in self.updates:
                rows, count = power * update.rest, PARTS * update.periods
                disturbed, _ = self.part.gains_over(rows, self.pushes, count)
                fixed = sums((magnitude(power * update.gain) * self.noisy).entries(), disturbed)
                units = self.part.unit_gains(rows, count).transpose().tolist()
                errors.append([[x.upper() for x in each] for each in (fixed, *units)])
            self.added.append(errors)

    def adds(self, age: int, kind: int, source: int | None) -> Bounds:
        """Bound the error that an update adds so many periods later."""
        self._extend(age)
        return [arb(0)] * self.loop.nrows() if source is None else self.added[age][kind][source]

    def require(self, bounds: Bounds, source: int) -> None:
        """Check that errors by a source stay within bounds, by every pattern of updates.

        The observer has long been at work, or nothing came before. Every way back into the past comes by one
        of as many periods in a row as there are kinds of updates.
        """
        n, box = len(bounds), column(bounds)
        errors = [[arb(0)] * n for _ in range(LONGEST + len(self.updates) + 1)]
        passed, slacks = 0, [arb(0)] * n

        def spare(age: int, before: Bounds) -> Bounds:
            return [b * arb(1 + ROUNDED) - x - y for b, x, y in zip(bounds, errors[age], before, strict=True)]

        for age in range(LONGEST):
            for i, x in enumerate(spare(age, [arb(0)] * n)):
                require("system", x, f"error of the observer's state {i}: {bounds[i]}")
            for kind, update in enumerate(self.updates):
                to, adds = age + update.periods, self.adds(age, kind, source)
                carried = (self.older[age][kind] * box).entries()
                errors[to] = maxima(errors[to], [x.upper() for x in sums(errors[age], adds, carried)])
            older = (magnitude(self.error_map(age + 1)) * box).entries()
            slacks = spare(age + 1, older)
            passed = passed + 1 if all(x >= 0 for x in slacks) else 0
            if passed == len(self.updates):
                return
            if not passed and all(x <= FORGOTTEN * bound for x, bound in zip(older, bounds, strict=True)):
                break
        for i, x in enumerate(slacks):
            require("system", x, f"error of the observer's state {i}: {bounds[i]}")

    def bounds_after(self, first: Bounds, periods: int, source: int | None) -> list[Bounds]:
        """Bounds so many periods after errors were within `first`, just after an update, by every pattern."""
        n, bounds = len(first), [column(first)]
        self._extend(periods)
        for age in range(1, periods + 1):
            errors = [arb_mat(n, 1)] * (age + 1)
            for at in range(age):
                for kind, update in enumerate(self.updates[: age - at]):
                    to = at + update.periods
                    total = errors[at] + self.older[at][kind] * bounds[age - to] if kind else errors[at]
                    if source is not None:
                        total = total + column(self.added[at][kind][source])
                    errors[to] = total if at == 0 else column(maxima(errors[to].entries(), total.entries()))
            initial = magnitude(self.error_map(age)) * bounds[0]
            bounds.append(column([x.upper() for x in (errors[age] + initial).entries()]))
        return [each.entries() for each in bounds]

    def fading(self, first: Bounds, document: Document) -> list[Bounds]:
        """Bounds so many periods after errors were within `first`, nothing being added, and ever after."""
        count, settled = (document.observer or {}).get("followed", 0), settled_errors(document)
        errors, steady = (self.bounds_after(each, count + self.late, None) for each in (first, settled))
        for bounds in steady[count:]:
            for x, y in zip(bounds, settled, strict=True):
                require("system", y - x, f"errors of an observer after {count} periods")
        share = largest(x / y for each in errors[count:] for x, y in zip(each, settled, strict=True))
        return [*errors[: count + 1], [x * share for x in maxima(*steady)]]

    def check_settled(self, document: Document) -> Bounds:
        """Check settled errors, and a certificate's statements on those by thrusters, by their age.

        Returned are bounds on errors without what grows with commands, leads of pulses apart.
        """
        plant, observer, settled = self.plant, document.observer or {}, settled_errors(document)
        full = column(plant.thruster_part(plant.u_max)[: plant.B.ncols()])
        if "by_age" not in observer:
            pushes = plant.disturbances(plant.thruster_error(plant.u_max))
            replace(self, pushes=pushes, added=[], older=[]).require(settled, 0)
            return settled
        ages, by_age = observer["ages"], [matrix(each) for each in observer["by_age"]]
        valid = all(b - a >= 1 + self.late * (a == 0) for a, b in pairwise(ages))
        if not (self.late and ages[0] == 0 and valid and ages[-1] <= observer.get("followed", 0) + self.late):
            raise Rejected("system", "thruster errors must be given by age")
        independent = [x - y for x, y in zip(settled, (by_age[0] * full).entries(), strict=True)]
        self.require(independent, 0)
        for i in range(plant.B.ncols()):
            each = [M.transpose().tolist()[i] for M in by_age]
            self.require(each[0], i + 1)
            decay = self.fading(each[0], document)
            for age, newer, older in zip(ages[1:], each, each[1:], strict=False):
                bound = maxima(*decay[age - self.late :])  # the first update since may be so much later
                for x, y, z, total in zip(newer, older, bound, each[0], strict=True):
                    slack = smallest((x - y, y * arb(1 + ROUNDED) - smallest((z, total))))
                    require("system", slack, f"errors of thrusters by input {i} of {age} periods ago: {y}")
        return independent

    def by_step(self, document: Document, first: Bounds, independent: Bounds) -> list[Bounds]:
        """Bound the errors that first errors add to settled ones in each step, and ever after.

        Those that are `independent` are there without errors by commands.
        """
        q, total, late = document.q, document.steps * document.q, self.late
        if not late:
            return _fading(self.loop, column(first), document)
        decay = self.fading(first, document)
        joint = self.bounds_after(first, len(decay) - 2, 0)
        for age, each in enumerate(joint):
            decay[age] = [smallest((x, y - z)) for x, y, z in zip(decay[age], each, independent, strict=True)]
        decay += [decay[-1]] * (total + 1 - len(decay))
        by_period = [maxima(*decay[max(i - late, 0) : i + 1]) for i in range(total)]
        steps = [maxima(*by_period[k * q : (k + 1) * q]) for k in range(document.steps)]
        return [*steps, maxima(*decay[max(total - late, 0) :])]


def settled_errors(document: Document) -> Bounds:
    """Bounds on the errors of an observer that has long been at work."""
    bounds = (document.observer or {}).get("settled") or document.measured_error
    return list(map(arb, bounds or [0.0] * len(document.A)))


def _fading(loop: arb_mat, initial: arb_mat, document: Document) -> list[list[arb]]:
    """Bound the errors that first errors of an observer still add in each step, and ever after."""
    power, each, first = identity(loop.nrows()), [], document.steps * document.q
    for _ in range(first):
        each.append((magnitude(power) * initial).entries())
        power = power * loop
    q = document.q
    steps = [list(map(largest, zip(*each[k * q : (k + 1) * q], strict=True))) for k in range(document.steps)]
    final, turn = (magnitude(power) * initial).entries(), loop
    for _ in range(LONGEST):  # until so many periods make no more of what they begin with
        if all(x <= y for x, y in zip((magnitude(turn) * column(final)).entries(), final, strict=True)):
            return [*steps, final]
        power, turn = power * loop, turn * loop
        final = [largest(pair) for pair in zip(final, (magnitude(power) * initial).entries(), strict=True)]
    raise Rejected("system", "errors of the first estimate do not decay")
