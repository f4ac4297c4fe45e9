"""The goal as linear rows, in lengths: positions as they are, velocities divided by a rate.

A polygon with N sides stands for a circle, inside it where it must not be left, around it where it must not
be entered.
"""

import math
from dataclasses import dataclass
from itertools import product
from typing import Any

from flint import arb, arb_mat

from ..files.document import Document
from ..kernel.balls import absolute, diagonal, largest, matrix, norms, smallest
from ..kernel.verdict import Rejected

ZERO = 1e-12  # share of the terms of an entry of C A below which it counts as zero
USUAL_RATE = 1e-2  # rate [1/s] by which velocities are divided where there is no mean motion

Row = tuple[list[arb], arb]  # coefficients of the states, and what they may come to


@dataclass(frozen=True)
class GoalRows:
    """``row x <= side`` for all rows, and for one of each group."""

    rows: list[Row]
    groups: list[list[Row]]
    scale: float
    equal: int = 0  # how many rows, the first ones, are halves of equalities in several states


def velocities(document: Document) -> arb_mat:
    """Rate of the position [m/s] that a unit of each state makes: 0 for a state that is no velocity."""
    C, A = matrix(document.C), matrix(document.A)
    rate, terms = C * A, absolute(C) * absolute(A)
    for i, j in product(range(C.nrows()), range(C.ncols())):
        if any(row[j] for row in document.C) or not abs(rate[i, j]) > ZERO * terms[i, j]:
            rate[i, j] = 0
    return rate


def speeds(document: Document) -> list[arb]:
    """Speed of the position [m/s] that a unit of each state makes: 0 for a state that is no velocity."""
    return norms(velocities(document).transpose())


def _row(n: int, entries: dict[int, Any], side: Any) -> Row:
    return [arb(entries.get(i, 0)) for i in range(n)], arb(side)


def _within(n: int, entries: dict[int, Any], middle: Any, half: Any = 0) -> list[Row]:
    """Return a row and its negative: within a length of a value."""
    opposite = {i: -x for i, x in entries.items()}
    return [_row(n, entries, arb(middle) + half), _row(n, opposite, arb(half) - middle)]


def _state_rows(document: Document, spec: dict[str, Any]) -> GoalRows:
    middle, half = spec.get("center") or spec["state"], spec.get("half_widths")
    n, rate = len(middle), arb(document.mean_motion or USUAL_RATE)
    weights = [s / rate if s > 0 else arb(1) for s in speeds(document)]
    half = half or [0.0] * n
    rows: list[Row] = []
    for i, (weight, c, h) in enumerate(zip(weights, middle, half, strict=True)):
        if not math.isinf(h):
            rows += _within(n, {i: weight}, weight * c, weight * h)
    return GoalRows(rows, [], max(1.0, *(abs(c) for c in middle)))


def _angles(sides: int) -> list[tuple[arb, arb]]:
    turns = [2 * arb.pi() * (2 * j + 1) / (2 * sides) for j in range(sides)]
    return [(angle.cos(), angle.sin()) for angle in turns]


def _linear_rows(document: Document, spec: dict[str, Any]) -> GoalRows:
    per, sides = 1 / arb(document.mean_motion or 0), 16
    amplitude, along = spec["amplitude_max_m"], spec.get("along_track_m", 0.0)
    rows = [*_within(6, {0: 1}, 0), *_within(6, {1: 1}, along)]
    rows += [*_within(6, {3: per}, 0), *_within(6, {4: per}, 0)]
    clearance = arb(amplitude) * (arb.pi() / sides).cos()
    rows += [_row(6, {2: c, 5: s * per}, clearance) for c, s in _angles(sides)]
    return GoalRows(rows, [], max(amplitude, abs(along), 1.0))


def _elliptical_rows(document: Document, spec: dict[str, Any]) -> GoalRows:
    per, sides = 1 / arb(document.mean_motion or 0), spec.get("sides", 16)
    rows = [*_within(6, {4: per, 0: 2}, 0), *_within(6, {3: per, 1: arb(-1) / 2}, 0)]
    across = spec.get("cross_track_max_m", 0.0)
    rows += [*_within(6, {2: 1}, 0, across), *_within(6, {5: per}, 0, across)]
    outer, inner = arb(spec["outer_semi_minor_m"]) * (arb.pi() / sides).cos(), spec["inner_semi_minor_m"]
    group = []
    for c, s in _angles(sides):
        length = (c**2 + s**2 / 4).sqrt()
        rows.append(_row(6, {0: c / length, 1: s / 2 / length}, outer / length))
        group.append(_row(6, {0: -c / length, 1: -s / 2 / length}, -arb(inner) / length))
    return GoalRows(rows, [group] if inner > 0 else [], spec["outer_semi_minor_m"], 4)


GOALS = {
    "stationary": _state_rows,
    "box": _state_rows,
    "linear_nmt": _linear_rows,
    "elliptical_nmt": _elliptical_rows,
}
"""By kind of goal, its rows; every kind that `scenario_keys` knows is here."""


@dataclass(frozen=True, eq=False)
class WeightedRows:
    """A goal's rows one below the other, groups last; those of velocities alone weighed less.

    Such a row counts for no more than the length that the velocity makes in some time [s], or, where
    velocities have a tolerance of their own, for that in which this is the tolerance of lengths; so do
    equalities then that velocities are in.
    """

    rows: arb_mat
    sides: list[arb]
    groups: list[int]  # how many rows belong to each group
    scale: float
    seconds: arb | None = None  # time in which velocities make the length that they count for [s]

    @classmethod
    def from_goal(cls, spec: dict[str, Any], soon: arb, document: Document) -> "WeightedRows":
        """Weigh the rows of the scenario's goal."""
        goal, tolerance = GOALS[spec["kind"]](document, spec), spec.get("velocity_tolerance_m_s")
        if tolerance is not None and "tolerance_m" not in spec:
            raise Rejected("goal", "a tolerance of velocities is given, but none of lengths")
        all_rows = [*goal.rows, *(row for group in goal.groups for row in group)]
        all_rows = all_rows or [_row(len(document.A), {}, 0)]  # any state will do
        weights, times, speed = [], list[arb](), speeds(document)
        for i, (row, _) in enumerate(all_rows):
            alone = all(x == 0 for x, s in zip(row, speed, strict=True) if s == 0)
            ratios = [[x / s for x, s in zip(row, speed, strict=True) if s != 0]]
            weight, time = arb(1), norms(matrix(ratios))[0] if ratios[0] else arb(0)
            if time > 0 and (alone or (tolerance is not None and i < goal.equal)):
                span = smallest((time, soon)) if tolerance is None else arb(spec["tolerance_m"]) / tolerance
                weight = span / time
                times.append(span)
            weights.append(weight)
        moves = [any(x != 0 for x in row) for row in velocities(document).tolist()]
        if tolerance is not None and not (times and all(moves)):
            rule = "needs a velocity among the states for every coordinate, and a goal that bounds one"
            raise Rejected("goal", f"velocity_tolerance_m_s {tolerance:g} {rule}")
        rows, groups = matrix([row for row, _ in all_rows]), [len(group) for group in goal.groups]
        sides = [side * weight for (_, side), weight in zip(all_rows, weights, strict=True)]
        return cls(diagonal(weights) * rows, sides, groups, goal.scale, largest(times) if times else None)

    def over(self, x: arb_mat) -> list[arb]:
        """Return how far a state is beyond each row's side."""
        return [a - b for a, b in zip((self.rows * x).entries(), self.sides, strict=True)]

    def distance(self, over: list[arb]) -> arb:
        """Return the largest excess, of each group the smallest; 0 if none is beyond its side."""
        at = len(over) - sum(self.groups)
        excess = [arb(0), *over[:at]]
        for count in self.groups:
            excess.append(smallest(x.upper() for x in over[at : at + count]))
            at += count
        return largest(excess)
