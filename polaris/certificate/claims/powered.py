"""Powered abort: from any instant of a step S reaches an orbit, in time and within a budget.

S flies on along the reference until a branch leaves it. Everything that is shown of S along the reference is
shown along each branch, too, from the sets that the schedule reaches in the steps that it serves.
"""

import copy
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from flint import arb

from ..files.artefacts import FileClaims
from ..files.document import Document
from ..files.entries import AbortBranch, AbortStep
from ..kernel.balls import largest, magnitude, plain, require, smallest
from ..kernel.verdict import Rejected
from ..kernel.zonotopes import Zonotope, widest
from ..model.craft.tightening import Tightening
from ..model.plants import within_limits
from ..model.timing import carried_impulse
from .arrival import Arrival
from .coasting import JUMP_SLACK, check_end, exact_path
from .continuation import Continuation, HandOver, Tracker
from .corrections import Corrections
from .flights import FlownStep
from .goal_rows import WeightedRows
from .recovery import CLAIM_SLACK

CLAIM = "powered_abort"


def check_aborts(tracker: Tracker, sets: list[Zonotope], steps: list[FlownStep], claims: FileClaims) -> str:
    """Check that S keeps all limits in every claimed abort, and reaches the orbit, if known, as is claimed.

    It keeps to the budget and to the scenario's tank. The sets are those that the schedule reaches.
    """
    document, powered, before = tracker.document, tracker.document.powered, arb(0)
    assert powered is not None
    takeovers, since = list[Takeover](), 0
    for k, (mode, way) in enumerate(zip(document.modes, powered.steps, strict=True)):
        reached = [sets[k], *steps[k].nodes, sets[k + 1]] if mode else [sets[since]]
        step = sum((spell.impulse for spell in steps[k].spells), arb(0)) / document.mass
        if mode or k == since:  # in later steps S has taken over already
            hand_over = HandOver.within(widest(reached), k * document.q, k * document.q + len(reached) - 1)
        if way is not None:
            takeovers.append(Takeover(way, k, reached, hand_over, before + step if mode else before))
        before += step
        since = k + 1 if mode else since
    facets = [row for branch in powered.branches for row in branch.facets]
    corrections = Corrections(tracker)
    for place, branch in enumerate(powered.branches):
        served = [abort for abort in takeovers if abort.step.branch == place]
        if served:
            motion = BranchMotion.for_branch(branched(document, branch), branch, corrections, facets, claims)
            motion.flight.keeps(
                {abort.start.first + i: z for abort in served for i, z in enumerate(abort.sets)}
            )
            for abort in served:
                motion.arrives(abort)
                motion.affords(abort, powered.budget, claims)
    return f"{len(takeovers)} of {document.steps} steps, along {len(powered.branches)} branches"


@dataclass(frozen=True, eq=False)
class Takeover:
    """Nodes, one after another, and sets from which S may take over if step k is aborted."""

    step: AbortStep
    k: int
    sets: list[Zonotope]
    start: HandOver  # a box of all errors there
    before: arb  # bound on the velocity change until then [m/s]


@dataclass(frozen=True, eq=False)
class BranchMotion:
    """S along one branch, which the document of its flight has in the place of the reference."""

    flight: Continuation
    branch: AbortBranch
    corrections: Corrections
    orbit: dict[str, Any] | None

    @classmethod
    def for_branch(
        cls,
        doc: Document,
        branch: AbortBranch,
        corrections: Corrections,
        facets: list[list[int]],
        claims: FileClaims,
    ) -> "BranchMotion":
        """Build the exact motion under the inputs; check that these are within limits, and it may coast."""
        tracker = corrections.tracker
        path = exact_path(doc, tracker.craft.plant, branch.tail)
        size = [float(largest(abs(x) for x in start.entries())) for start in path.starts]
        jump = largest(magnitude(path.jump).entries())
        require(CLAIM, JUMP_SLACK * max(1.0, *size) - jump, "the tail of a branch starts elsewhere")
        within_limits(doc, doc.inputs, CLAIM, "a branch")
        check_end(doc, path)
        return cls(Continuation(doc, path, tracker, facets), branch, corrections, claims.orbit)

    @cached_property
    def _orbit(self) -> tuple[WeightedRows, Tightening]:
        """Rows of the orbit, and their tightening by errors."""
        doc, spec = self.flight.document, self.orbit
        assert spec is not None
        arrival = Arrival(self.flight, (), arb(0))
        rows = WeightedRows.from_goal(spec, arrival.velocity_time, doc)
        tightenings = self.flight.tracker.tightenings(("orbit", doc.steps), rows.rows)
        arrival.tolerated(self.branch.tolerance, spec, rows.scale, arrival.holding(tightenings))
        return rows, tightenings

    def arrives(self, abort: Takeover) -> None:
        """Check that the orbit, if it is known, is reached when it is claimed to be."""
        if self.orbit is not None:
            distance, context = self.distance(abort, abort.step.cell), f"abort in step {abort.k}"
            require(CLAIM, self.branch.tolerance - distance, f"{context}: {plain(distance)} m off the orbit")

    def affords(self, abort: Takeover, budget: float | None, claims: FileClaims) -> None:
        """Check S's spending against the budget, the tank, and the stated figure."""
        delta_v, claim = self.cost(abort, abort.step.cell), claims.aborts[abort.k] if claims.aborts else None
        limits = {"claimed": claim, "the budget of": budget, "the tank of": claims.tank}
        for limit, top in limits.items():
            if top is not None:
                slack = arb(top) * (1 + CLAIM_SLACK) if limit == "claimed" else arb(top)
                slack -= delta_v + abort.before if limit == "the tank of" else delta_v
                text = f"abort in step {abort.k}: {plain(delta_v)} m/s, {limit} {top:.6g} m/s"
                require(CLAIM, slack, text)

    def distance(self, abort: Takeover, cell: int) -> arb:
        """Bound the distance from the orbit of flights aborted in a step, at the start of a cell."""
        doc = self.flight.document
        if not doc.steps <= cell <= doc.cells:
            raise Rejected(CLAIM, f"cell {cell} is not one of the tail of its branch")
        return Arrival(self.flight, (abort.start,), arb(0)).distance(*self._orbit, (cell - doc.steps) * doc.q)

    def cost(self, abort: Takeover, cell: int) -> arb:
        """Bound on S's velocity change from the abort until the start of a cell [m/s].

        The lesser of the sum of its periods' bounds and of that of all periods at once.
        """
        doc, tracker = self.flight.document, self.flight.tracker
        plant, tightenings = tracker.craft.plant, tracker.tightenings("commands", tracker.commands)
        combined, by_faults = self._together(abort, cell), [arb(0)]
        periods = range(abort.k * doc.q, cell * doc.q)
        total = sum((self.flight.spending(tightenings, (abort.start,), i) for i in periods), arb(0))
        for fault in doc.transients:  # what wrong thrust spends
            pushes = ([arb(x) for x in push] for push in fault.get("pushes") or [])
            wrong = [
                sum(push, arb(0)) + sum(plant.without_delay.thruster_part(push), arb(0)) for push in pushes
            ]
            by_faults.append(largest([arb(0), *wrong]) * arb(fault["lasts"]))
        total += largest(by_faults)
        total = total if combined is None else smallest([total, combined])
        return (total + carried_impulse(plant)) / doc.mass

    def _together(self, abort: Takeover, cell: int) -> arb | None:
        """Bound the spending in all periods at once since S may have taken over, dues apart [N s]."""
        corrections, doc = self.corrections, self.flight.document
        if corrections.mean is None:
            return None
        plant, first = corrections.tracker.craft.plant, min(abort.start.first, abort.k * doc.q)
        count, inputs = cell * doc.q - first, doc.inputs[first // doc.q : cell]
        parts = (
            count * corrections.mean,
            corrections.once(abort.sets, count),
            corrections.planned(inputs, doc.q),
            corrections.answer_bound(self.flight.jump, count),
            corrections.late_fault_thrust(count),
        )
        longest = 1 + 2 * arb(plant.jitter) / plant.h
        return longest * sum(parts, arb(0)) * plant.h


def branched(document: Document, branch: AbortBranch) -> Document:
    """Return the certificate with a branch in the place of the reference from its first step on."""
    calmest, doc = document.calmest, copy.copy(document)
    doc.steps, doc.cells = branch.step + len(branch.inputs), len(branch.facets)
    coast = [[0.0] * len(doc.u_max)] * (doc.cells - doc.steps)
    doc.inputs = [*document.inputs[: branch.step], *branch.inputs, *coast]
    doc.facets, doc.horizon = branch.facets, branch.horizon
    doc.drift = doc.powered = None
    if document.error_by_step:  # in the tail the largest of all that are met from then on
        later = document.error_by_step[min(doc.steps, document.steps) :]
        errors = [document.errors_in(k) for k in range(doc.steps)]
        doc.calmest = calmest
        doc.error_by_step = [*errors, [max(each) for each in zip(*later, strict=True)]]
    return doc
