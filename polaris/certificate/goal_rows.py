"""The goal as linear rows, in lengths: positions as they are, velocities divided by a rate.

A polygon with N sides stands for a circle, inside it where it must not be left, around it where it must not
be entered.
"""

import math
from dataclasses import dataclass
from typing import Any

from flint import arb, arb_mat

from .balls import diagonal, largest, matrix, norms, smallest
from .document import Document

USUAL_RATE = 1e-2  # rate [1/s] by which velocities are divided where there is no mean motion

Row = tuple[list[arb], arb]  # coefficients of the states, and what they may come to


@dataclass(frozen=True)
class Goal:
    """``row x <= side`` for all rows, and for one of each group."""

    rows: list[Row]
    groups: list[list[Row]]
    scale: float


def _row(n: int, entries: dict[int, Any], side: Any) -> Row:
    return [arb(entries.get(i, 0)) for i in range(n)], arb(side)


def _within(n: int, entries: dict[int, Any], middle: Any, half: Any = 0) -> list[Row]:
    """A row and its negative: within a length of a value."""
    opposite = {i: -x for i, x in entries.items()}
    return [_row(n, entries, arb(middle) + half), _row(n, opposite, arb(half) - middle)]


def _state_rows(document: Document, spec: dict[str, Any]) -> Goal:
    middle, half = spec.get("center") or spec["state"], spec.get("half_widths")
    n, rate = len(middle), document.mean_motion or USUAL_RATE
    weights = [arb(1)] * (n - n // 2) + [1 / arb(rate)] * (n // 2)
    half = half or [0.0] * n
    rows: list[Row] = []
    for i, (weight, c, h) in enumerate(zip(weights, middle, half, strict=True)):
        if not math.isinf(h):
            rows += _within(n, {i: weight}, weight * c, weight * h)
    return Goal(rows, [], max(1.0, *(abs(c) for c in middle)))


def _angles(sides: int) -> list[tuple[arb, arb]]:
    turns = [2 * arb.pi() * (2 * j + 1) / (2 * sides) for j in range(sides)]
    return [(angle.cos(), angle.sin()) for angle in turns]


def _linear_rows(document: Document, spec: dict[str, Any]) -> Goal:
    per, sides = 1 / arb(document.mean_motion or 0), 16
    amplitude, along = spec["amplitude_max_m"], spec.get("along_track_m", 0.0)
    rows = [*_within(6, {0: 1}, 0), *_within(6, {1: 1}, along)]
    rows += [*_within(6, {3: per}, 0), *_within(6, {4: per}, 0)]
    room = arb(amplitude) * (arb.pi() / sides).cos()
    rows += [_row(6, {2: c, 5: s * per}, room) for c, s in _angles(sides)]
    return Goal(rows, [], max(amplitude, abs(along), 1.0))


def _elliptical_rows(document: Document, spec: dict[str, Any]) -> Goal:
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
    return Goal(rows, [group] if inner > 0 else [], spec["outer_semi_minor_m"])


GOALS = {
    "stationary": _state_rows,
    "box": _state_rows,
    "linear_nmt": _linear_rows,
    "elliptical_nmt": _elliptical_rows,
}
"""By kind of goal, its rows; every kind that `scenario_keys` knows is here."""


@dataclass(frozen=True, eq=False)
class Weighted:
    """A goal's rows one below the other, groups last; those of velocities alone weighed less.

    Such a row counts for no more than the length that the velocity makes in some time [s].
    """

    rows: arb_mat
    sides: list[arb]
    groups: list[int]  # how many rows belong to each group
    scale: float

    @classmethod
    def of(cls, goal: Goal, soon: arb, document: Document) -> "Weighted":
        """Weigh a goal's rows."""
        every = [*goal.rows, *(row for group in goal.groups for row in group)]
        every = every or [_row(len(document.A), {}, 0)]  # any state will do
        rows = matrix([row for row, _ in every])
        weights = []
        for along, length in zip(norms(rows * matrix(document.C).transpose()), norms(rows), strict=True):
            weight = soon / length if along == 0 and length > 0 else arb(1)
            weights.append(weight if weight < 1 else arb(1))
        sides = [side * weight for (_, side), weight in zip(every, weights, strict=True)]
        return cls(diagonal(weights) * rows, sides, [len(group) for group in goal.groups], goal.scale)

    def over(self, x: arb_mat) -> list[arb]:
        """By how much a state is beyond each row's side."""
        return [a - b for a, b in zip((self.rows * x).entries(), self.sides, strict=True)]

    def distance(self, over: list[arb]) -> arb:
        """The largest excess, of each group the smallest; 0 if none is beyond its side."""
        at = len(over) - sum(self.groups)
        found = [arb(0), *over[:at]]
        for count in self.groups:
            found.append(smallest(x.upper() for x in over[at : at + count]))
            at += count
        return largest(found)
