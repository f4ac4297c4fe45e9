"""Tightening of fixed rows under the safety controller, from a set of loop states to the end of time."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property, partial, reduce
from itertools import pairwise

from flint import arb, arb_mat

from ...kernel.balls import (
    above,
    column,
    identity,
    kinds,
    largest,
    magnitude,
    matrix,
    maxima,
    rows_of,
    sums,
    widths,
)
from ...kernel.motion import Motion, RowIntersample
from ...kernel.zonotopes import Zonotope
from .craft import Craft
from .settling import Gains, Settling

FEW = 8  # generators per dimension of sets whose intersample bounds are made: with more, hardly smaller ones

Differences = list[tuple[arb_mat, arb_mat]]
"""Differences of flights after each number of periods: what one adds to those of fewer, and of the start."""


@dataclass(frozen=True, eq=False)
class Tightening:
    """Bounds on rows of the error under the safety controller, lag by lag."""

    craft: Craft
    settling: Settling
    full_rows: arb_mat  # rows of the error, shape (r, n), or of the loop state
    fault: list[list[arb]] = field(default_factory=list)
    """Need of a fault that is isolated late by the end of the period after node l, once in a flight."""

    @property
    def motion(self) -> Motion:
        """Motion of the error alone."""
        return self.craft.motion

    @cached_property
    def rows(self) -> arb_mat:
        """Rows of the error, shape (r, n)."""
        return part(self.full_rows, self.motion.A.nrows())

    @cached_property
    def carried(self) -> list[arb_mat]:
        """``row F^l`` for l = 0 ... N + 1, each of shape (r, states)."""
        rows = self.craft.pad(self.full_rows)
        return [rows * power for power in self.settling.powers]

    @cached_property
    def curvature(self) -> list[arb_mat]:
        """Intersample bound per unit of ``|z|`` at the start, for the periods next to node l."""
        curved = self.motion.curvature(self.rows)
        per = [magnitude(curved * magnitude(rate)) for rate in self.rates[0].carried]
        return [per[0], *(_larger(a, b) for a, b in pairwise(per))]

    @cached_property
    def kinds(self) -> tuple[list[int], list[int]]:
        """One row of each kind, equal or opposite ones being of a kind, and the kind of every row."""
        first, pairs = kinds(self.full_rows)
        return first, [kind for kind, _ in pairs]

    @cached_property
    def _stacked(self) -> arb_mat:
        rows = self.craft.pad(rows_of(self.full_rows, *self.kinds[0]))
        return above(*(rows * power for power in self.settling.powers[:-1]))

    @cached_property
    def _steady(self) -> list[list[arb]]:
        """Tightening at node L by errors that do not depend on commands, L = 0 ... N + 1."""
        first, which = self.kinds
        responses = [[arb(0)] * len(first)]
        for gains in self._split(self.craft.varying.supports(self._stacked)):
            responses.append([x.upper() for x in sums(responses[-1], gains)])
        for constants in self.craft.constants:
            responses = [sums(*each) for each in zip(responses, self._constant(constants), strict=True)]
        return [[each[i] for i in which] for each in responses]

    def _constant(self, constants: arb_mat) -> list[list[arb]]:
        """Largest response so far at node L to constants, which may cancel, by kind of row."""
        first, total = [arb(0)] * len(self.kinds[0]), arb_mat(len(self.kinds[0]), constants.ncols())
        bounds, gains = [first], (self._stacked * constants).tolist()
        for at in range(0, len(gains), len(first)):
            total = total + matrix(gains[at : at + len(first)])
            bounds.append(maxima(bounds[-1], widths(total)))
        return bounds

    def _by_lag(self, gains: arb_mat) -> Gains:
        """Gains of rows and lags, one over the other."""
        return Gains([self._split(each) for each in gains.transpose().tolist()], self.kinds[1])

    @cached_property
    def thrust(self) -> Gains:
        """Gains of errors of the inputs."""
        return self._by_lag(self.craft.thrust_gains(self._stacked))

    @cached_property
    def noise(self) -> Gains:
        """Gains of errors of the estimates."""
        return self._by_lag(self.craft.noise_gains(self._stacked))

    @cached_property
    def responses(self) -> list[list[arb]]:
        """Tightening at node L without the handed state, for L = 0 ... N + 1."""
        feedback_bound, plant, craft = self.settling.feedback_bound, self.craft.plant, self.craft
        if not feedback_bound:
            return self._steady
        count, last = len(self._steady) - 1, len(feedback_bound) - 1
        thrust = [plant.thruster_part(commands) for commands in feedback_bound]
        parts = [self._steady, self.thrust.summed([thrust[min(lag, last)] for lag in range(count)])]
        if craft.lag:  # what is commanded before a hand-over is limited by the thrusters alone
            limits = [plant.u_max, *feedback_bound]

            def before(lag: int, periods: int) -> list[arb]:
                return limits[min(max(lag - periods + 1, 0), last + 1)]

            parts.append(self.noise.summed([craft.lag_error_since(partial(before, i)) for i in range(count)]))
        return [[x.upper() for x in sums(*each)] for each in zip(*parts, strict=True)]

    def _split(self, stacked: list[arb]) -> list[list[arb]]:
        """Numbers for one row of each kind, of one lag after the other, as a list per lag."""
        count = len(self.kinds[0])
        return [stacked[at : at + count] for at in range(0, len(stacked), count)]

    def tail_bound(self, box: arb_mat) -> list[arb]:
        """Bound on the share of all that is older than N periods, if each adds at most a box (states, 1)."""
        first, later = self.settling.decayed(box)
        return list((self._reached * (first + later / (1 - self.settling.c))).entries())

    @cached_property
    def _reached(self) -> arb_mat:
        first, *others = self.carried[: self.settling.periods]
        return sum(map(magnitude, others), magnitude(first))

    @cached_property
    def settled_tightening(self) -> list[arb]:
        """Tightening without the handed state at every node more than N periods after a hand-over."""
        craft, first = self.craft, self.settling.feedback_bound[0] if self.settling.feedback_bound else []
        one = identity(craft.F.nrows())
        box = column(craft.supports(one))
        if first:
            box += craft.thrust_gains(one) * column(craft.plant.thruster_part(first))
            box += craft.noise_gains(one) * column(craft.lag_error(craft.plant.u_max))
        return [x.upper() for x in sums(self.responses[-1], self.tail_bound(box))]

    @property
    def rates(self) -> tuple[Tightening, Tightening]:
        """Tightening of ``e'`` and of ``A e'`` at nodes, which give the intersample bound."""
        cached, rates = self.settling.rates, self.craft.rates
        if not cached:
            cached[:] = [Tightening(self.craft, self.settling, M) for M in (rates, self.motion.A * rates)]
        return cached[0], cached[1]

    @cached_property
    def peak(self) -> list[arb]:
        """Tightening without the handed state at any node."""
        return maxima(*self.responses, self.settled_tightening)

    @cached_property
    def disturbed(self) -> list[list[arb]]:
        """Tightening without the handed state at node l = 0 ... N, and ever after; chords hold between."""
        craft, plant, feedback_bound = self.craft, self.craft.plant, self.settling.feedback_bound
        rates = magnitude(column(self.rates[0].peak)), magnitude(column(self.rates[1].peak))
        bound = craft.off_chord_always(self.rows, rates)
        if feedback_bound:
            none = arb_mat(len(self.rates[0].peak), 1)
            noise, error = craft.lag_error(plant.u_max), plant.thruster_part(feedback_bound[0])
            bound = sums(bound, craft.off_chord(self.rows, (none, none), noise, error))
        return self._faulted([sums(each, bound) for each in (*self.responses[:-1], self.settled_tightening)])

    @cached_property
    def at_nodes(self) -> list[list[arb]]:
        """Tightening without the handed state at node l alone, l = 0 ... N, then at every later one."""
        return self._faulted([*self.responses[:-1], self.settled_tightening])

    def response(self, sizes: list[list[arb]], noisy: bool) -> tuple[list[arb], list[arb]]:
        """Response to sizes of a channel, period by period: to those older than N periods, and between nodes.

        `noisy` says that these are errors of estimates.
        """
        worst, one = maxima(*sizes), identity(self.craft.F.nrows())
        box = (self.craft.noise_gains(one) if noisy else self.craft.thrust_gains(one)) * column(worst)
        rates = ((each, each.noise if noisy else each.thrust) for each in self.rates)
        first, last = (
            magnitude(column(sums(rate.always(worst), each.tail_bound(box)))) for each, rate in rates
        )
        bound = self.craft.off_chord(self.rows, (first, last), worst if noisy else [], [] if noisy else worst)
        return self.tail_bound(box), bound

    def _faulted(self, tightenings: list[list[arb]]) -> list[list[arb]]:
        return (
            [sums(*each) for each in zip(tightenings, self.fault, strict=True)] if self.fault else tightenings
        )

    @cached_property
    def after_settling(self) -> list[arb]:
        """Need of any undisturbed state within ``z`` at the start after N periods."""
        each = (self.boxed(self.settling.z, lag) for lag in range(self.settling.periods))
        return [tightening * self.settling.c for tightening in maxima(*each)]

    def boxed(self, size: arb_mat, lag: int) -> list[arb]:
        """Need of any undisturbed state, or error, up to a size in the periods next to node l."""
        return list((self._sizes[lag] * self.craft.lifted(size)).entries())

    @cached_property
    def _sizes(self) -> list[arb_mat]:
        """Need of a unit of each state in the periods next to node l."""
        return [
            magnitude(carried) + curvature
            for carried, curvature in zip(self.carried, self.curvature, strict=True)
        ]

    def difference(self, flights: Differences, lag: int) -> list[arb]:
        """Need of a difference of two flights at node l, and in the period after it."""
        rates = column(difference_along(self.rates[0].carried[lag], flights))
        return sums(
            difference_along(self.carried[lag], flights), (self.motion.curvature(self.rows) * rates).entries()
        )

    @cached_property
    def _largest(self) -> arb_mat:
        """Largest need of a unit of each state in the first N periods."""
        return reduce(_larger, self._sizes[: self.settling.periods])

    def tightening_after_settling(self, size: arb_mat) -> list[arb]:
        """Need of any undisturbed state, or error, up to a size after N periods."""
        first, later = self.settling.decayed(self.craft.lifted(size))
        return list((self._largest * (first + later)).entries())

    def tightening_at_any_time(self, size: arb_mat) -> list[arb]:
        """Need of any undisturbed state, or error, up to a size at any time."""
        each = [
            *(self.boxed(size, lag) for lag in range(len(self.carried))),
            self.tightening_after_settling(size),
        ]
        return list(map(largest, zip(*each, strict=True)))

    @cached_property
    def intersample(self) -> RowIntersample:
        """Intersample bounds along the rows."""
        return RowIntersample(self.motion, self.rows)


@dataclass(frozen=True, eq=False)
class SetIntersample:
    """Intersample bounds of one set under the safety controller, lag by lag."""

    tightenings: Tightening
    start: Zonotope
    _cache: dict[int, list[arb]] = field(default_factory=dict, repr=False)

    @cached_property
    def _start(self) -> Zonotope:
        return self.start.reduced(FEW * self.start.c.nrows())

    def next_to(self, lag: int) -> list[arb]:
        """Bounds for the periods next to node l: no more than the bound for all periods."""
        return maxima(*(self._within(at) for at in {lag, max(lag - 1, 0)}))

    def _within(self, lag: int) -> list[arb]:
        """Bounds within the period after node l."""
        if lag not in self._cache:
            rate = self._start.image(self.tightenings.rates[0].carried[lag])
            self._cache[lag] = self.tightenings.intersample.tight_intersample(rate)
        return self._cache[lag]


def difference_along(rows: arb_mat, flights: Differences) -> list[arb]:
    """Support along rows of the loop state of a difference of two flights, the largest."""
    total = peak = arb_mat(rows.nrows(), 1)
    for gain, start in flights:
        total = total + magnitude(rows * gain) * column([1.0] * gain.ncols())
        peak = _larger(peak, total + magnitude(rows * start) * column([1.0] * start.ncols()))
    return list(peak.entries())


def _larger(a: arb_mat, b: arb_mat) -> arb_mat:
    """Return the larger of two bounds, entry by entry."""
    return arb_mat(a.nrows(), a.ncols(), list(map(largest, zip(a.entries(), b.entries(), strict=True))))


def part(M: arb_mat, columns: int) -> arb_mat:
    """First columns of a matrix."""
    if M.ncols() == columns:
        return M
    return arb_mat(M.nrows(), columns, [x for row in M.tolist() for x in row[:columns]])
