"""Powered abort: from whatever instant of a step S reaches an orbit, in time and within a budget.

S flies on along the reference until a branch leaves it. Everything that is shown of S along the reference is
shown along each branch, too, from the sets that the schedule reaches in the steps that it serves.
"""

import copy
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from flint import arb, arb_mat

from ..files.artefacts import Stated
from ..files.document import Document
from ..files.parts import Branch, Way
from ..kernel.arcs import Path
from ..kernel.balls import above, absolute, column, largest, magnitude, plain, require, smallest, sums
from ..kernel.verdict import Rejected
from ..kernel.zonotopes import Zonotope, widest
from ..model.craft.craft import Craft
from ..model.craft.memory import Memory
from ..model.craft.needs import Needs
from ..model.craft.scheduled import Scheduled
from ..model.limits import Limits
from ..model.plants import within_limits
from ..model.timing import owed
from .arrival import SLACK, Arrival
from .coasting import JUMP_SLACK, check_end, flown_path, prolonged
from .flights import Flown
from .goal_rows import Weighted
from .recovery import Recovery

CLAIM = "powered_abort"


def check_aborts(
    document: Document,
    craft: Craft,
    sets: list[Zonotope],
    flown: list[Flown],
    stated: Stated,
    late: tuple[list[arb_mat], Callable[[Memory, arb_mat], Needs]],
) -> str:
    """S keeps to all limits in every abort that is claimed, and reaches the orbit, if known, as is claimed.

    So for the tank, of which the scenario tells besides. The sets are those that the schedule reaches; `late`
    is what faults add until isolated, and what errors need with them. Returned is what is confirmed.
    """
    powered, orbit, tank, before = document.powered, stated.orbit, stated.tank, arb(0)
    assert powered is not None
    most = stated.aborts or [powered.budget] * document.steps
    takeovers, since = dict[int, Takeover](), 0
    for k, (mode, way) in enumerate(zip(document.modes, powered.steps, strict=True)):
        reached = [sets[k], *flown[k].nodes, sets[k + 1]] if mode else [sets[since]]
        spent, step = before, sum((spell.spent for spell in flown[k].spells), arb(0))
        before += step / document.mass
        if way is not None and tank is not None and (needed := most[k]) is not None:
            left = arb(tank) * (1 + SLACK) - (before if mode else spent) - needed
            require(CLAIM, left, f"abort in step {k}: the tank of {tank:.6g} m/s")
        if way is not None:
            takeovers[k] = Takeover(way, k, (k if mode else since) * document.q, reached)
        since = k + 1 if mode else since
    if every := [z for taken in takeovers.values() for z in taken.sets]:
        memory = Memory.of(craft, widest([*sets, *every], late[0]), document.q, document.profile)
        facets = [row for branch in powered.branches for row in branch.facets]
        common = Common(craft, memory, facets, orbit, late[1])
        for place, branch in enumerate(powered.branches):
            along = Along(branched(document, branch), branch, common)
            served = [taken for taken in takeovers.values() if taken.way.branch == place]
            along.recovers(served)
            for taken in served if orbit is not None else ():
                along.arrives(taken, most[taken.k])
    return f"{len(takeovers)} of {document.steps} steps, along {len(powered.branches)} branches"


@dataclass(frozen=True, eq=False)
class Takeover:
    """Where S may take over if step k is aborted: at which nodes, one after another, from which sets."""

    way: Way
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
class Common:
    """What all branches have in common."""

    craft: Craft
    memory: Memory
    facets: list[list[int]]  # of all branches, so that they have the same rows of limits
    orbit: dict[str, Any] | None
    made: Callable[[Memory, arb_mat], Needs]  # with a fault that is isolated late
    _known: dict[Any, Needs] = field(default_factory=dict, repr=False)

    def needs(self, of: Any, rows: arb_mat) -> Needs:
        """What errors need along rows, and a fault that is isolated late, once; `of` tells them apart."""
        if of not in self._known:
            self._known[of] = self.made(self.memory, rows)
        return self._known[of]


@dataclass(frozen=True, eq=False)
class Along:
    """S along one branch, which `document` has in the place of the reference."""

    document: Document
    branch: Branch
    common: Common

    @cached_property
    def path(self) -> Path:
        """The exact motion under the inputs, which are within the limits, and it may coast."""
        doc, plant = self.document, self.common.craft.plant
        path = flown_path(doc, plant, self.branch.tail)
        size = [float(largest(abs(x) for x in start.entries())) for start in path.starts]
        off = largest(magnitude(path.jump).entries())
        require(CLAIM, JUMP_SLACK * max(1.0, *size) - off, "the tail of a branch starts elsewhere")
        within_limits(doc, doc.inputs, CLAIM, "a branch")
        check_end(doc, path)
        return path

    @cached_property
    def further(self) -> tuple[Path, list[list[int]]]:
        """The path and its facets until the loop has forgotten what it was at T."""
        return prolonged(self.document, self.path, self.common.memory)

    def recovers(self, served: list[Takeover]) -> None:
        """S keeps to every limit to the end, whenever it takes over."""
        common, (path, chosen) = self.common, self.further
        chosen = [*chosen, *common.facets]
        limits = Limits.of(self.document, path, common.craft, chosen)
        needs = common.needs(frozenset(pair for row in chosen for pair in enumerate(row)), limits.rows)
        recovery = Recovery.of(self.document, path, limits, needs, self.scheduled)
        reached = {taken.first + i: z for taken in served for i, z in enumerate(taken.sets)}
        recovery.check_sets(reached, {})
        recovery.check_far()

    @cached_property
    def scheduled(self) -> Scheduled | None:
        """Errors by the time of the flight, if any."""
        if not (self.document.profile or self.document.error_by_step):
            return None
        common = self.common
        return Scheduled(self.document, common.craft, common.memory, self.further[0])

    @cached_property
    def _commands(self) -> tuple[Needs, list[arb]]:
        """What errors need of commands, and what the jump into the tail does."""
        K = self.common.craft.commands
        needs = self.common.needs("commands", above(K, -K))
        return needs, needs.ever(magnitude(self.path.jump))

    @cached_property
    def _caused(self) -> list[list[arb]]:
        """What errors by the time of the flight need of commands in every cell; empty without any."""
        if self.scheduled is None:
            return []
        every = self.scheduled.along(self._commands[0].given)
        return [[largest(each) for each in zip(*nodes, strict=True)] for nodes in every]

    @cached_property
    def _orbit(self) -> tuple[Weighted, Needs, list[arb], Arrival]:
        """Rows of the orbit, what errors need along them, and what they need besides in the tail."""
        doc, common, spec = self.document, self.common, self.common.orbit
        assert spec is not None
        arrival = Arrival(doc, self.path, common.craft, common.memory, (), arb(0), self.scheduled)
        rows = Weighted.of(spec, arrival.soon, doc)
        needs = common.needs(("orbit", doc.steps), rows.rows)
        claim = {"tolerance_m": self.branch.tolerance, "reached": False}
        arrival.tolerated(claim, spec, rows.scale, arrival.holding(needs))
        more = sums(
            needs.ever(magnitude(self.path.jump)), (absolute(rows.rows) * column(doc.at_nodes)).entries()
        )
        return rows, needs, more, arrival

    def arrives(self, taken: Takeover, most: float | None) -> None:
        """The orbit is reached when it is claimed to be, for no more than is claimed, or allowed."""
        way, told = taken.way, f"abort in step {taken.k}"
        off = self.distance(taken, way.cell)
        require(CLAIM, self.branch.tolerance * (1 + SLACK) - off, f"{told}: {plain(off)} m off the orbit")
        if most is not None:
            spent = self.spent(taken, way.cell)
            short = f"{told}: {most:.6g} m/s claimed, {plain(spent)} derived"
            require(CLAIM, arb(most) * (1 + SLACK) - spent, short)

    def distance(self, taken: Takeover, cell: int) -> arb:
        """How far flights that are aborted in a step may be from the orbit at the start of a cell."""
        if not self.document.steps <= cell <= self.document.cells:
            raise Rejected(CLAIM, f"cell {cell} is not one of the tail of its branch")
        (rows, needs, more, arrival), arcs, doc = self._orbit, self.path.arcs, self.document
        state = arcs[cell].nodes[0] if cell < len(arcs) else arcs[-1].nodes[-1]
        parts = [rows.over(state), self._most(needs, taken, cell, cell), more]
        parts += [arrival.from_thrust(needs, (cell - doc.steps) * doc.q)] if self.scheduled else []
        return rows.distance(sums(*parts))

    def spent(self, taken: Takeover, cell: int) -> arb:
        """Bound on S's velocity change from the abort until the start of a cell [m/s]."""
        doc, plant, m = self.document, self.common.craft.plant, len(self.document.u_max)
        (needs, jump), total, unasked = self._commands, owed(plant), [arb(0)]
        for c in range(taken.k, cell):
            known = self.common.craft.noise_in(doc, c)
            parts = [self._most(needs, taken, c, c + 1), *self._caused[c : c + 1], *[jump] * (c >= doc.steps)]
            need = sums(*parts)
            both = zip(need[:m], need[m:], doc.inputs[c], known, plant.u_max, strict=True)
            tops = [smallest((top, largest((a, b)) + abs(u) + e)) for a, b, u, e, top in both]
            total += plant.spent(tops) * doc.q
        for fault in doc.transients:  # what wrong thrust spends
            pushes = ([arb(x) for x in push] for push in fault.get("pushes") or [])
            wrong = [sum(push, arb(0)) + sum(plant.thruster_part(push), arb(0)) for push in pushes]
            unasked.append(largest([arb(0), *wrong]) * arb(fault["lasts"]))
        return (total + largest(unasked)) / doc.mass

    def _most(self, needs: Needs, taken: Takeover, cell: int, until: int) -> list[arb]:
        """What errors of an abort in a step need along rows between the starts of two cells, or at one."""
        q, periods, found = self.document.q, self.common.memory.periods, []
        lags = taken.window(cell * q, until * q)
        pushed = needs.disturbed if until > cell else needs.at_nodes
        for lag in lags[: max(periods + 1 - lags[0], 0)]:
            found.append(sums(needs.boxed(taken.size, lag), pushed[lag]))
        if lags[-1] > periods:
            found.append(sums(needs.still(taken.size), pushed[-1]))
        return [largest(each).upper() for each in zip(*found, strict=True)]


def branched(document: Document, branch: Branch) -> Document:
    """The certificate with a branch in the place of the reference from its first step on."""
    least, doc = document.calmest, copy.copy(document)
    doc.steps, doc.cells = branch.step + len(branch.inputs), len(branch.facets)
    coast = [[0.0] * len(doc.u_max)] * (doc.cells - doc.steps)
    doc.inputs = [*document.inputs[: branch.step], *branch.inputs, *coast]
    doc.facets, doc.horizon = branch.facets, branch.horizon
    doc.drift = doc.powered = None
    if document.error_by_step:  # in the tail the largest of all that are met from then on
        later = document.error_by_step[min(doc.steps, document.steps) :]
        known = [document.known_to(k) for k in range(doc.steps)]
        doc.calmest = least
        doc.error_by_step = [*known, [max(each) for each in zip(*later, strict=True)]]
    return doc
