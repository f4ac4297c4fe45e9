"""Check of the online monitor's tables: where it lets U fly, S can take over at the next node.

A decision at a node looks at the estimate alone. If it is for U, then under any thrust within the limits the
error keeps to the facets until the next node, and S keeps to every limit from there on, whatever was before.
"""

from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from math import inf, nextafter

from flint import arb, arb_mat

from ..claims.continuation import Continuation, Tracker
from ..kernel.balls import (
    above,
    absolute,
    beside,
    column,
    diagonal,
    identity,
    largest,
    magnitude,
    matrix,
    maxima,
    plain,
    require,
    row_sums,
    rows_of,
    sums,
    widths,
)
from ..kernel.motion import InputSet
from ..kernel.verdict import Rejected
from ..kernel.zonotopes import Directions
from ..model.craft.tightening import part
from ..model.limits import NodeLimit
from .check import check_plausible
from .rounding import UNIT, gap_error, least, rounding_factor, row_maxima
from .text import Tables

CLAIM = "monitor"
ROUNDS, SPARE = 500, 1 + 1e-9  # in which sizes of what the loop remembers are sought, and their growth
NEAR = 64  # roundings by which stored rows may be off, relative to the largest entry


@dataclass(frozen=True, eq=False)
class DecisionBound:
    """Bounds that a decision for U rests on, along the rows of all limits, node by node."""

    flight: Continuation
    tables: Tables
    precision: str

    @cached_property
    def max_reference_input(self) -> arb_mat:
        """Largest input of the reference up to T (m, 1), with that of the tables."""
        K = self.flight.document.steps
        return row_maxima([column(u) for u in [*self.flight.document.inputs[:K], *self.tables.feed]])

    @cached_property
    def rounding(self) -> arb_mat:
        """Bound on the change of the estimate error by rounding, (n, 1)."""
        flight = self.flight
        return gap_error(flight.document, self.tables, self.precision, flight.path)

    @cached_property
    def unmeasured(self) -> arb_mat:
        """Generators of the loop state that the estimate hides: its error, and states the loop remembers.

        Shape (N, k). The states beside the error move by themselves, whatever flies, within `remembered`.
        """
        craft = self.flight.tracker.craft
        n = craft.plant.A.nrows()
        missed = craft.carry * diagonal(craft.missed(craft.lag_error(craft.plant.u_max)))
        error = craft.lifted(missed)
        if craft.free.nrows() == n:
            return error
        columns, sizes = rest_of(craft.sees, n), remembered(craft.free, n, widths(self.added)[n:], craft.box)
        return beside(error, above(-columns, identity(len(sizes))) * diagonal(sizes))

    def start(self, share: int) -> arb_mat:
        """Size of the loop state where a decision may be for U, a share of the largest on board, (N, 1)."""
        lifted = self.flight.tracker.craft.lifted(self.error * share + self.rounding)
        return magnitude(lifted + column(widths(self.unmeasured)))

    @property
    def error(self) -> arb_mat:
        """Largest computed error for which U may fly: its share of the table's is rounded, (n, 1)."""
        return column(self.tables.apart) * (1 + 4 * arb(UNIT[self.precision]))

    @cached_property
    def pushes(self) -> list[InputSet]:
        """Return all that thrust may do in a period beside the reference's input."""
        plant = self.flight.tracker.craft.plant
        return [InputSet.in_box(plant.B, plant.u_max), *plant.push(plant.thruster_error(plant.u_max))]

    @cached_property
    def added(self) -> arb_mat:
        """Generators of the thrust, disturbances and errors of a period."""
        craft = self.flight.tracker.craft
        error = craft.plant.thruster_error(craft.plant.u_max)
        return beside(craft.lifted(craft.motion.effect(self.pushes[0])), *craft.added(error))

    def end(self, share: int) -> arb_mat:
        """Size of the loop state at the next node, affine in the share, (N, 1)."""
        craft = self.flight.tracker.craft
        size = (
            magnitude(craft.free) * self.start(share) + magnitude(craft.held_map) * self.max_reference_input
        )
        return magnitude(size + column(widths(self.added)))

    @cached_property
    def within(self) -> list[tuple[list[arb], list[arb]]]:
        """Tightening of facets in the period under U at its start and its end, for both ends of the share.

        Of both intersample bounds, which are affine in the share, the one that is less at its end counts.
        """
        craft, tightenings = self.flight.tracker.craft, self.flight.recovery.tightenings
        plant, count = craft.plant, tightenings.full_rows.nrows() - 2 * craft.plant.B.ncols()
        if not count:
            return [([], [])] * 2
        rows = part(rows_of(tightenings.full_rows, *range(count)), plant.A.nrows())
        along, whole = craft.intersample(Directions(rows))
        intersamples = []
        for share in (0, 1):
            rates, accelerations = (
                magnitude(M * craft.drifts) * self.start(share)
                + magnitude(M * plant.B) * self.max_reference_input
                for M in (identity(plant.A.nrows()), plant.A)
            )
            intersamples.append(
                ((along.curvatures[0] * rates).entries(), (along.curvatures[1] * accelerations).entries())
            )
        which = [0 if a <= b else 1 for a, b in zip(*intersamples[1], strict=True)]
        curvature, last = along.disturbance
        for push in self.pushes:
            curvature = sums(curvature, along.motion.push_curvature(rows, push))
            last = sums(last, along.motion.push_gain(rows, push))
        hidden = [widths(each * self.unmeasured) for each in (whole.M, whole.M * craft.free)]
        firsts = [sums([both[i][row] for row, i in enumerate(which)], curvature) for both in intersamples]
        return [(sums(first, hidden[0]), sums(first, last, hidden[1])) for first in firsts]

    def tightening(self, lag: int, share: int) -> list[arb]:
        """Need of every row at a node so many after the decision, beside the estimate's error."""
        craft, tightenings = self.flight.tracker.craft, self.flight.recovery.tightenings
        if lag == 0:
            return self.within[share][0]
        carried = tightenings.carried[lag - 1]
        terms = (
            widths(carried * craft.free * self.unmeasured),
            (tightenings.curvature[lag - 1] * self.end(share)).entries(),
        )
        total = sums(row_sums(carried * self.added), *terms, tightenings.disturbed[lag - 1])
        if lag == 1:
            facets = self.within[share][1]
            total = [*maxima(total[: len(facets)], facets), *total[len(facets) :]]
        return total

    @cached_property
    def stored(self) -> list[tuple[int, int, arb_mat]]:
        """Stored row of every limit's row, the side on which it limits, and by how much it is off (1, n)."""
        limit_rows, facets = self.flight.recovery.tightenings.full_rows, len(self.within[0][0])
        rows = [matrix([row]) for row in self.tables.rows]
        nearest = list[tuple[int, int, arb_mat]]()
        for i in range(limit_rows.nrows()):
            exact = part(rows_of(limit_rows, i), len(self.tables.apart))
            first, last = (0, self.tables.facets) if i < facets else (self.tables.facets, len(rows))
            sides = ((k, side, sign) for k in range(first, last) for side, sign in ((0, 1), (2, -1)))
            candidates = [(k, side, magnitude(exact + sign * rows[k])) for k, side, sign in sides]
            closest = min(candidates, key=lambda one: float(largest(one[2].entries())), default=None)
            allowed = NEAR * UNIT[self.precision] * float(largest(absolute(exact).entries()))
            if closest is None or not float(largest(closest[2].entries())) <= allowed:
                raise Rejected(CLAIM, f"the tables have no row for limit {i}")
            nearest.append(closest)
        return nearest

    @cached_property
    def rounding_loss(self) -> list[list[arb]]:
        """Bound on the rounding error of the value along every row, node by node."""
        craft, tightenings, tables = self.flight.tracker.craft, self.flight.recovery.tightenings, self.tables
        n, m, precision = len(tables.apart), len(tables.limit), self.precision
        transition, force, loop = matrix(tables.held), matrix(tables.force), matrix(tables.loop)
        free, push, F = (rows_of(M, *range(n)) for M in (craft.free, craft.held_map, craft.F))
        free, F = part(free, n), part(F, n)
        reach, feed = self.error, row_maxima([column(u) for u in tables.feed])
        inputs = zip(tables.feed, self.flight.document.inputs, strict=False)
        wrong = row_maxima([column(u) - column(v) for u, v in inputs])
        first = magnitude(transition) * reach + magnitude(force) * feed
        rounded = first * rounding_factor(n + m, precision) + least(n, n + m, precision)
        next_error = magnitude(free) * self.rounding + magnitude(transition - free) * reach
        next_error += magnitude(force - push) * feed + magnitude(push) * wrong + rounded
        loop_powers = tightenings.settling.powers[: len(tables.booked)]
        powers = [magnitude(part(rows_of(power, *range(n)), n)) for power in loop_powers]
        spread = [magnitude(part(carried, n)) for carried in tightenings.carried[: len(tables.booked)]]
        rounding = magnitude(loop) * rounding_factor(n, precision) + magnitude(loop - F)
        stored = [rows_of(matrix(tables.rows), kind) for kind, _, _ in self.stored]
        along = above(*(magnitude(row) for row in stored)) * (
            rounding_factor(n, precision) + 4 * UNIT[precision]
        )
        along += above(*(off_row for *_, off_row in self.stored))
        underflow = least(len(stored), n, precision)
        losses, added = [spread[0] * self.rounding + along * reach + underflow], list[arb_mat]()
        for lag in range(len(tables.booked) - 1):
            size, total = powers[lag] * (first + rounded), spread[lag] * next_error + underflow
            for age, error in enumerate(reversed(added)):  # rounded so many periods before
                size, total = size + powers[age] * error, total + spread[age] * error
            losses.append(total + along * size)
            added.append(rounding * size + least(n, n, precision))
        return [loss.entries() for loss in losses]

    def check(self) -> str:
        """Confirm every tightening and clearance, and all limits beyond; return the confirmation."""
        tables, u = self.tables, UNIT[self.precision]
        for lag, (bases, slopes) in enumerate(zip(tables.booked, tables.sized, strict=True)):
            for share in (0, 1):
                for row, tightening in enumerate(self.tightening(lag, share)):
                    base, slope = (arb(table[self.stored[row][0]]) for table in (bases, slopes))
                    stored = base + slope * share - (abs(base) + abs(slope)) * (8 * u)
                    context = f"row {row}, {lag} nodes on, errors of share {share}"
                    slack = stored - tightening - self.rounding_loss[lag][row]
                    require(CLAIM, slack, f"{context}: needs {plain(tightening)}, {plain(stored)} is booked")
        return f"S can take over wherever U may fly, {len(tables.booked)} nodes ahead and beyond"


def check_online(flight: Continuation, tables: Tables, precision: str) -> str:
    """Check the tables of an online monitor against the limits of a flight."""
    doc = flight.document
    if doc.transients or doc.pulse_thrust or doc.late or doc.carried_impulse or any(doc.state_offset):
        raise Rejected(CLAIM, "the monitor needs thrust without pulses, jitter and faults isolated late")
    flight = _with_largest_errors(flight)
    last = doc.steps * doc.q + len(tables.booked) - 2
    if len(tables.booked) < 2 or len(tables.booked) > flight.tracker.settling.periods:
        raise Rejected(CLAIM, f"the tables look {len(tables.booked)} nodes ahead, which is not supported")
    if len(tables.clearance) <= last // doc.q:
        raise Rejected(CLAIM, f"the tables have {len(tables.clearance)} steps, but use {last // doc.q + 1}")
    decision = DecisionBound(flight, tables, precision)
    check_plausible(flight, [decision.start(1), decision.end(1)])
    confirmed = decision.check()
    _check_clearances(decision)
    _check_later(decision)
    return confirmed


def remembered(free: arb_mat, n: int, added: list[arb], box: list[arb]) -> list[arb]:
    """Return sizes of the states beside the error (N - n) that hold at all nodes, from a box at the start.

    They are no less than what one more period makes of them; `Rejected` if none are found, or if the error
    changes these states.
    """
    below = rows_of(free, *range(n, free.nrows()))
    alone, size = rest_of(below, n), list(box)
    for _ in range(ROUNDS):
        after = sums((magnitude(alone) * column(size)).entries(), added)
        if all(x <= y for x, y in zip(after, size, strict=True)):
            break
        size = [x * SPARE if not x * SPARE < y else y for x, y in zip(after, size, strict=True)]
    else:
        raise Rejected(CLAIM, "no box holds what the loop remembers")
    if not all(x.is_zero() for x in part(below, n).entries()):
        raise Rejected(CLAIM, "what the loop remembers depends on the error")
    return size


def rest_of(M: arb_mat, n: int) -> arb_mat:
    """Columns of a matrix after the first."""
    return arb_mat(M.nrows(), M.ncols() - n, [x for row in M.tolist() for x in row[n:]])


def _with_largest_errors(flight: Continuation) -> Continuation:
    """Return the flight with errors of thrusters and estimates as large as they ever are, at all times.

    Thrusters err as at full thrust, whoever flies: what the schedule claims of S's commands after a hand-over
    does not hold where the monitor decides.
    """
    doc, tracker = copy(flight.document), flight.tracker
    craft, plant = tracker.craft, tracker.craft.plant
    extra = maxima(*(craft.extra(doc, k) for k in range(doc.steps + 1)))
    missed = craft.missed(sums(extra, craft.lag_error(plant.u_max)))
    error = [nextafter(float(x.upper()), inf) for x in plant.thruster_error(plant.u_max)]
    doc.feedback_bound, doc.error_by_step = [], []
    plant = replace(plant, along=0.0, across=0.0, shares=(), constant=False, bits=error, by_lag=[])
    craft = replace(craft, plant=plant, errors=missed, base=None, _along={})
    settling = replace(tracker.settling, feedback_bound=[], rates=[])
    tracker = Tracker(doc, craft, settling, tracker.upsets)
    return replace(flight, document=doc, tracker=tracker, _cache={}, _responses={})


def _check_clearances(decision: DecisionBound) -> None:
    """Check that each clearance, as it is computed, is at most that of the limit."""
    tables, u = decision.tables, UNIT[decision.precision]
    for cell, nodes in enumerate(decision.flight.recovery.limits.targets[: len(tables.clearance)]):
        for place, targets in enumerate(nodes):
            for target in targets:
                kind, side, _ = decision.stored[target.row]
                first, slope = (arb(x) for x in tables.clearance[cell][kind][side : side + 2])
                clearance = first + slope * place + (abs(first) + abs(slope) * place) * (4 * u)
                context = f"{target.name} in step {cell}, period {place}"
                require(
                    CLAIM,
                    target.clearance - clearance,
                    f"{context}: clearance {plain(clearance)} of {plain(target.clearance)}",
                )


def _check_later(decision: DecisionBound) -> None:
    """Check limits further ahead than a decision looks, for every error with which U may fly."""
    flight = decision.flight
    doc, recovery, tightenings = flight.document, flight.recovery, flight.recovery.tightenings
    least_of = [dict[int, NodeLimit]()]
    for nodes in reversed(recovery.limits.targets):
        clearances = dict(least_of[-1])
        for target in (target for targets in nodes for target in targets):
            if target.row not in clearances or not clearances[target.row].clearance <= target.clearance:
                clearances[target.row] = target
        least_of.append(clearances)
    least_of.reverse()
    periods, end = flight.tracker.settling.periods, decision.end(1)
    for lag in range(len(decision.tables.booked) - 1, periods + 2):
        beyond = lag > periods
        by_error = tightenings.tightening_after_settling(end) if beyond else tightenings.boxed(end, lag)
        tightening = sums(by_error, tightenings.disturbed[lag])
        cell = periods // doc.q if beyond else lag // doc.q
        cell = min(cell, doc.steps if doc.horizon == "infinite" and beyond else len(least_of) - 1)
        for row, target in least_of[cell].items():
            context = f"{target.name}, {lag} periods after a hand-over: needs {plain(tightening[row])}"
            require(CLAIM, target.clearance - tightening[row], f"{context} of {plain(target.clearance)}")
