"""Powered abort: from whatever instant of a step S reaches an orbit, in time and within a budget.

S flies on along the reference until a branch leaves it. Everything that is shown of S along the reference is
shown along each branch, too, from the sets that the schedule reaches in the steps that it serves.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from flint import arb, arb_mat

from .arcs import Path
from .argument import JUMP_SLACK, Argument
from .arrival import SLACK, Arrival
from .balls import above, absolute, column, largest, magnitude, plain, require, smallest, sums
from .document import Document
from .flights import Flown
from .goal_rows import GOALS, Weighted
from .loop import Memory, Needs
from .parts import Branch
from .plants import within_limits
from .recovery import Limits, Recovery, levels_of
from .scheduled import Scheduled
from .verdict import Record, Rejected
from .zonotopes import Zonotope, widest

CLAIM = "powered_abort"


class WithAborts(Argument):
    """The argument for a schedule, and for the aborts with thrust that are claimed of it."""

    def aborts(self, sets: list[Zonotope], flown: list[Flown]) -> None:
        """S keeps to all limits in every abort that is claimed, and reaches the orbit as is claimed."""
        asked = self.document.powered
        if asked is None:
            return
        if self.document.error_by_step and any(b.step != self.K or b.inputs for b in asked.branches):
            raise Rejected(CLAIM, "errors of estimates by step are those of the schedule's own path")
        takeovers, since = dict[int, Takeover](), 0
        for k, (mode, way) in enumerate(zip(self.document.modes, asked.steps, strict=True)):
            reached = [sets[k], *flown[k].nodes, sets[k + 1]] if mode else [sets[since]]
            if way is not None:
                takeovers[k] = Takeover(k, (k if mode else since) * self.document.q, reached)
            since = k + 1 if mode else since
        every = [z for taken in takeovers.values() for z in taken.sets]
        if every:
            profile = [[arb(x) for x in most] for most in self.document.profile]
            memory = Memory.of(self.loop, widest([*sets, *every]), self.document.q, profile)
            known: dict[Any, Needs] = {}
            steps = [way and way.branch for way in asked.steps]
            for place, branch in enumerate(asked.branches):
                served = [taken for k, taken in takeovers.items() if steps[k] == place]
                along = Along.of(self, branch, memory, known)
                along.recovers(served)
                for taken in served if self.stated.orbit is not None else ():
                    self._arrives(along, taken)
        told = f"{len(takeovers)} of {self.K} steps, along {len(asked.branches)} branches"
        self.record.holds(CLAIM, told)

    def _arrives(self, along: Along, taken: Takeover) -> None:
        """The orbit is reached when it is claimed to be, for no more than is claimed and allowed."""
        asked = self.document.powered
        assert asked is not None
        way = asked.steps[taken.k]
        assert way is not None
        told = f"abort in step {taken.k}"
        off = along.distance(taken, way.cell)
        require(CLAIM, along.branch.tolerance * (1 + SLACK) - off, f"{told}: {plain(off)} m off the orbit")
        spent = along.spent(taken, way.cell)
        short = f"{told}: {way.delta_v:.6g} m/s claimed, {plain(spent)} derived"
        require(CLAIM, way.delta_v * (1 + SLACK) - spent, short)


@dataclass(frozen=True, eq=False)
class Takeover:
    """Where S may take over if step k is aborted: at which nodes, one after another, from which sets."""

    k: int
    first: int
    sets: list[Zonotope]

    @cached_property
    def size(self) -> arb_mat:
        """Bound on all errors there, shape (n, 1)."""
        each = zip(*(z.size().entries() for z in self.sets), strict=True)
        return column([largest(x) for x in each])

    def window(self, node: int, until: int) -> range:
        """How many periods it may be since the takeover, between two nodes."""
        return range(max(node - self.first - len(self.sets) + 1, 0), max(until - self.first, 0) + 1)


@dataclass(frozen=True, eq=False)
class Along:
    """S along one branch: `argument` is the schedule's, with the branch in the place of its reference."""

    argument: Argument
    branch: Branch
    path: Path
    memory: Memory
    facets: list[list[int]]  # of all branches, so that they have the same rows of limits
    known: dict[Any, Needs]  # by what their rows are of, for all branches

    @classmethod
    def of(cls, argument: Argument, branch: Branch, memory: Memory, known: dict[Any, Needs]) -> Along:
        """The branch is the exact motion under its inputs, which are within the limits, and it may coast."""
        along, doc = copy.copy(argument), branched(argument.document, branch)
        along.document, along.K, along.record = doc, doc.steps, Record()
        tail = column(branch.tail)
        if doc.system_kind == "clohessy_wiltshire" and doc.horizon == "infinite":
            tail[4, 0] = -along.plant.A[3, 4] * tail[0, 0]  # the orbit closes exactly
        path = Path.propagate(along.plant, column(doc.center), doc.inputs, doc.steps, tail)
        size = [float(largest(abs(x[i, 0]) for x in path.starts)) for i in range(along.n)]
        off = largest(magnitude(path.jump).entries())
        require(CLAIM, JUMP_SLACK * max(1.0, *size) - off, "the tail of a branch starts elsewhere")
        within_limits(doc, doc.inputs, CLAIM, "a branch")
        along.end(path)
        assert argument.document.powered is not None
        facets = [row for each in argument.document.powered.branches for row in each.facets]
        return cls(along, branch, path, memory, facets, known)

    @property
    def document(self) -> Document:
        """That of the branch."""
        return self.argument.document

    def recovers(self, served: list[Takeover]) -> None:
        """S keeps to every limit to the end, whenever it takes over."""
        argument, doc = self.argument, self.document
        prolonged, chosen = argument.prolonged(self.path, self.memory)
        chosen = [*chosen, *self.facets]
        limits = Limits.of(doc, prolonged, argument.gain, chosen)
        needs = self._needs(frozenset(pair for row in chosen for pair in enumerate(row)), limits.rows)
        limits = limits.less_jump(needs, prolonged)
        if self.scheduled is not None:
            limits = limits.less(self.scheduled.along(limits.rows))
        levels = levels_of(doc, argument.noise, needs, prolonged)
        recovery = Recovery(doc, limits, needs, levels)
        reached = {taken.first + i: z for taken in served for i, z in enumerate(taken.sets)}
        recovery.check_sets(reached, {})
        recovery.check_far()

    @cached_property
    def scheduled(self) -> Scheduled | None:
        """Errors by the time of the flight, if any."""
        if not (self.document.profile or self.document.error_by_step):
            return None
        path = self.argument.prolonged(self.path, self.memory)[0]
        return Scheduled(self.document, self.argument.loop, self.memory, path, self.argument.gain)

    def _needs(self, of: Any, rows: arb_mat) -> Needs:
        """What errors need along rows, once for all branches."""
        return self.known.setdefault(of, Needs(self.argument.loop, self.memory, rows))

    @cached_property
    def _commands(self) -> tuple[Needs, list[arb]]:
        """What errors need of commands, and what the jump into the tail does."""
        gain = self.argument.gain
        needs = self._needs("commands", above(gain, -gain))
        return needs, self._jump(needs)

    @cached_property
    def _caused(self) -> list[list[arb]]:
        """What errors by the time of the flight need of commands in every cell; empty without any."""
        if self.scheduled is None:
            return []
        every = self.scheduled.along(self._commands[0].rows)
        return [[largest(each) for each in zip(*nodes, strict=True)] for nodes in every]

    @cached_property
    def _orbit(self) -> tuple[Weighted, Needs, list[arb]]:
        """Rows of the orbit, what errors need along them, and what they need besides in the tail."""
        doc, spec = self.document, self.argument.stated.orbit
        assert spec is not None
        arrival = Arrival(doc, self.path, self.argument.loop, self.memory, (), arb(0), self.scheduled)
        rows = Weighted.of(GOALS[spec["kind"]](doc, spec), arrival.soon, doc)
        needs = self._needs(("orbit", doc.steps), rows.rows)
        claim = {"tolerance_m": self.branch.tolerance, "reached": False}
        arrival.tolerated(claim, spec, rows.scale, arrival.holding(needs))
        more = sums(self._jump(needs), (absolute(rows.rows) * column(doc.at_nodes)).entries())
        if self.scheduled is None:
            return rows, needs, more
        tail = self.scheduled.along(rows.rows)[min(doc.steps, doc.cells - 1) :]
        caused = [largest(x) for x in zip(*(node for nodes in tail for node in nodes), strict=True)]
        return rows, needs, sums(more, caused)

    def distance(self, taken: Takeover, cell: int) -> arb:
        """How far flights that are aborted in a step may be from the orbit at the start of a cell."""
        if not self.document.steps <= cell <= self.document.cells:
            raise Rejected(CLAIM, f"cell {cell} is not one of the tail of its branch")
        (rows, needs, more), arcs = self._orbit, self.path.arcs
        state = arcs[cell].nodes[0] if cell < len(arcs) else arcs[-1].nodes[-1]
        return rows.distance(sums(rows.over(state), self._most(needs, taken, cell, cell), more))

    def spent(self, taken: Takeover, cell: int) -> arb:
        """Bound on S's velocity change from the abort until the start of a cell [m/s]."""
        doc, plant, m = self.document, self.argument.plant, len(self.document.u_max)
        (needs, jump), total = self._commands, m * arb(doc.carried)
        for c in range(taken.k, cell):
            known = replace(plant, estimate=tuple(doc.known_to(c))).command_error(self.argument.gain)
            parts = [self._most(needs, taken, c, c + 1), *self._caused[c : c + 1], *[jump] * (c >= doc.steps)]
            need = sums(*parts)
            both = zip(need[:m], need[m:], doc.inputs[c], known, plant.u_max, strict=True)
            tops = [smallest((top, largest((a, b)) + abs(u) + e)) for a, b, u, e, top in both]
            total += plant.spent(tops) * doc.q
        return total / doc.mass

    def _most(self, needs: Needs, taken: Takeover, cell: int, until: int) -> list[arb]:
        """What errors of an abort in a step need along rows between the starts of two cells."""
        lags, periods = taken.window(cell * self.document.q, until * self.document.q), self.memory.periods
        found = []
        for lag in lags[: max(periods + 1 - lags[0], 0)]:
            most = (magnitude(needs.carried[lag]) + needs.bend[lag]) * taken.size
            found.append(sums(most.entries(), needs.disturbed[lag]))
        if lags[-1] > periods:
            share = largest(a / b for a, b in zip(taken.size.entries(), self.memory.z.entries(), strict=True))
            found.append(sums([x * share for x in needs.forgotten], needs.disturbed[-1]))
        return [largest(each).upper() for each in zip(*found, strict=True)]

    def _jump(self, needs: Needs) -> list[arb]:
        size = magnitude(self.path.jump)
        each = zip(needs.carried, needs.bend, strict=True)
        found = [((magnitude(row) + bend) * size).entries() for row, bend in each]
        return [largest(x) for x in zip(*found, strict=True)]


def branched(document: Document, branch: Branch) -> Document:
    """The certificate with a branch in the place of the reference from its first step on."""
    doc = copy.copy(document)
    doc.steps, doc.cells = branch.step + len(branch.inputs), len(branch.facets)
    coast = [[0.0] * len(doc.u_max)] * (doc.cells - doc.steps)
    doc.inputs = [*document.inputs[: branch.step], *branch.inputs, *coast]
    doc.facets, doc.horizon, doc.until = branch.facets, branch.horizon, branch.until
    doc.drift = doc.powered = None
    return doc


def check_asked_abort(document: Document, spec: dict[str, Any]) -> None:
    """What is claimed of aborts with thrust is what the scenario asks."""
    powered = document.powered
    if ("orbit" in spec) != (powered is not None):
        raise Rejected(CLAIM, "certificate and scenario do not both speak of an abort with thrust")
    if powered is None:
        return
    given = spec.get("within_s"), spec.get("delta_v_max_m_s")
    if (powered.within, powered.budget) != given:
        raise Rejected(CLAIM, "time and budget are not those of the scenario")
    if None in powered.steps and spec.get("required", False):
        raise Rejected(CLAIM, f"step {powered.steps.index(None)} has none, as is required")


def told_aborts(document: Document, stored: dict[str, Any] | None) -> dict[str, Any] | None:
    """What is told of aborts with thrust; why there is none in a step is no claim."""
    powered = document.powered
    if powered is None or stored is None:
        return None if powered is None else {}
    steps: list[dict[str, Any]] = []
    for k, (way, told) in enumerate(zip(powered.steps, stored["steps"], strict=True)):
        found = dict.fromkeys(("leaves_s", "by_s", "delta_v_m_s", "safe_until_s"))
        if (way is None) == (told["why"] is None):
            raise Rejected(CLAIM, f"a reason belongs to a step without an abort, unlike {k}")
        if way is not None:
            branch, by = powered.branches[way.branch], way.cell * document.delta
            found = {"leaves_s": branch.step * document.delta, "by_s": by, "delta_v_m_s": way.delta_v}
            found["safe_until_s"] = branch.until
        steps.append({"step": k, **found, "why": told["why"]})
    return {"within_s": powered.within, "delta_v_max_m_s": powered.budget, "steps": steps}
