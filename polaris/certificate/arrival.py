"""What a run claims of the goal and of the velocity change, derived again from the sets of the argument.

The goal is stated by linear rows, as lengths: positions as they are, velocities divided by a rate. A polygon
with N sides stands for a circle, inside it where it must not be left, around it where it must not be entered.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

from flint import arb, arb_mat

from .balls import above, largest, magnitude, matrix, norms, plain, require, row_of, smallest
from .document import Document
from .loop import Memory, Needs
from .motion import Motion, Path
from .verdict import Rejected
from .zonotopes import Zonotope

USUAL_RATE = 1e-2
"""Rate [1/s] by which velocities are divided where there is no mean motion."""
SHARE, SOON = 0.05, 0.25
"""Share of the goal's size that counts as reached; of the horizon, in which a velocity is a length."""
SLACK = 1e-6
"""By how much a claim may fall short of what is derived, relative to it."""

Row = tuple[list[arb], arb]
"""Coefficients of the states, and what they may come to."""


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
class Arrival:
    """S from the set reached at T on, along the coasting tail.

    `spent` bounds the velocity change until T [m/s].
    """

    document: Document
    path: Path
    loop: Motion
    memory: Memory
    final: Zonotope
    spent: arb

    def check(self, claim: dict[str, Any], spec: dict[str, Any]) -> str:
        """Refuse a claim that does not hold; returns what was confirmed."""
        doc = self.document
        if claim["reached"] is not True:
            if claim["by_s"] is not None:
                raise Rejected("goal", "an instant is named, but the goal is not claimed to be reached")
            self._no_less("velocity change until T", claim["delta_v_max_m_s"], self.spent)
            return "not claimed to be reached"
        if claim["by_s"] is None:
            raise Rejected("goal", "the goal is claimed to be reached, but not when")
        node = round((claim["by_s"] - doc.steps * doc.delta) / doc.delta * doc.q)
        at = (doc.steps + arb(node) / doc.q) * doc.delta
        if not (0 <= node <= (doc.cells - doc.steps) * doc.q and abs(at - claim["by_s"]) <= 1e-9 * at):
            raise Rejected("goal", f"{claim['by_s']} s is no instant of the tail")
        goal = GOALS[spec["kind"]](doc, spec)
        distance, settled = self._distance(goal, node)
        self._no_less("distance from the goal", claim["distance_m"], distance)
        allowed = (
            arb(spec["tolerance_m"])
            if "tolerance_m" in spec
            else largest((arb(SHARE) * goal.scale, 2 * settled))
        )
        require(
            "goal", allowed * (1 + SLACK) - claim["tolerance_m"], "the tolerance is more than the scenario's"
        )
        require(
            "goal", arb(claim["tolerance_m"]) - claim["distance_m"], "the distance is more than tolerated"
        )
        self._drift(claim["drift_m_per_orbit"], node)
        self._no_less("velocity change", claim["delta_v_max_m_s"], self.spent + self._correcting(node))
        return f"reached by {claim['by_s']:.6g} s, within {claim['distance_m']:.4g} m"

    def _no_less(self, what: str, claimed: float, derived: arb) -> None:
        spare = arb(claimed) * (1 + SLACK) - derived
        require("goal", spare, f"{what}: {claimed:.6g} claimed, {plain(derived)} derived")

    def _needs(self, rows: arb_mat) -> Needs:
        return Needs(self.loop, self.memory, rows)

    def _need(self, needs: Needs, node: int) -> list[arb]:
        """What errors need along rows at a node after T, and in the periods on both sides of it."""
        size = magnitude(self.path.jump)
        if node > self.memory.periods:
            parts = largest(
                a / b for a, b in zip(self.final.size().entries(), self.memory.z.entries(), strict=True)
            )
            jumped = largest(a / b for a, b in zip(size.entries(), self.memory.z.entries(), strict=True))
            return [
                late * (parts + jumped) + most
                for late, most in zip(needs.forgotten, needs.disturbed[-1], strict=True)
            ]
        jump = ((magnitude(needs.carried[node]) + needs.bend[node]) * size).entries()
        support = self.final.support(needs.carried[node])
        booked = needs.booked(self.final, node)
        return [
            a + b + c + d for a, b, c, d in zip(support, booked, needs.disturbed[node], jump, strict=True)
        ]

    def _state(self, node: int) -> arb_mat:
        """State of the reference at a node of the tail."""
        cell, place = divmod(node, self.document.q)
        arcs, at = self.path.arcs, self.document.steps + cell
        return arcs[at].nodes[place] if at < len(arcs) else arcs[-1].nodes[-1]

    def _distance(self, goal: Goal, node: int) -> tuple[arb, arb]:
        """Largest excess over the goal's rows at a node, and what S needs along them in the end."""
        every = [*goal.rows, *(row for group in goal.groups for row in group)]
        rows = matrix([row for row, _ in every])
        weights = self._weights(rows)
        rows = matrix([[x * w for x in row_of(rows, i).entries()] for i, w in enumerate(weights)])
        needs, x = self._needs(rows), self._state(node)
        over = [
            value - side * weight + need
            for value, (_, side), weight, need in zip(
                (rows * x).entries(), every, weights, self._need(needs, node), strict=True
            )
        ]
        found, at = [arb(0), *over[: len(goal.rows)]], len(goal.rows)
        for group in goal.groups:
            found.append(smallest(over[at : at + len(group)]))
            at += len(group)
        return largest(found), largest(self._need(needs, self.memory.periods + 1))

    def _weights(self, rows: arb_mat) -> list[arb]:
        """A row of velocities alone counts for no more than the length made in `SOON` of the horizon."""
        doc = self.document
        place = norms(rows * matrix(doc.C).transpose())
        soon = SOON * arb(doc.steps) * doc.delta
        found = []
        for along, length in zip(place, norms(rows), strict=True):
            weight = soon / length if along == 0 and length > 0 else arb(1)
            found.append(weight if weight < 1 else arb(1))
        return found

    def _drift(self, claimed: float | None, node: int) -> None:
        doc = self.document
        if doc.mean_motion is None:
            if claimed is not None:
                raise Rejected("goal", "a drift per orbit needs Hill's frame")
            return
        if claimed is None:
            return
        row = [arb(2), *[arb(0)] * 3, 1 / arb(doc.mean_motion), arb(0)]
        both = above(matrix([row]), -matrix([row]))
        x, needs = self._state(node), self._needs(both)
        most = largest(
            value + need for value, need in zip((both * x).entries(), self._need(needs, node), strict=True)
        )
        self._no_less("drift per orbit", claimed, 6 * arb.pi() * most)

    def _correcting(self, nodes: int) -> arb:
        """Bound on S's velocity change over periods after T [m/s]."""
        plant, gain = self.loop.plant, matrix(self.document.laws[0].gain or [])
        both = above(gain, -gain)
        m, total = gain.nrows(), arb(0)
        needs = self._needs(both)
        for first, last in pairwise(self._need(needs, node) for node in range(nodes + 1)):
            most = [largest((first[i], first[m + i], last[i], last[m + i])) for i in range(m)]
            total += sum((smallest(pair) for pair in zip(most, plant.u_max, strict=True)), arb(0))
        return total * plant.h / self.document.mass
