"""The safety argument, re-derived from the primary data of a certificate."""

from pathlib import Path as FilePath
from typing import Any

from flint import arb, arb_mat

from ..code.check import check_plausible, read_code
from ..code.online import check_online
from ..files.artefacts import FileClaims
from ..files.document import Document
from ..kernel.arcs import Path
from ..kernel.balls import largest, magnitude, matrix, plain, require
from ..kernel.verdict import Record, Rejected
from ..kernel.zonotopes import Directions, Merging, Zonotope
from ..model.craft.states import craft_of
from ..model.limits import Barrier
from ..model.plants import plant_of, within_limits
from ..model.transients import wrong_thrust
from .arrival import Arrival
from .coasting import JUMP_SLACK, PATH_SLACK, check_end, exact_path
from .continuation import Continuation, HandOver, Tracker
from .drift import Departures, Drifts
from .flights import ControllerModel, FlownStep, enclose_step
from .joint import check_joint
from .powered import check_aborts
from .spending import spent
from .upkeep import check_estimate, check_upkeep

ORDER = (
    64  # generators per state of the plant that sets are merged to where they come to several times as many
)

SAMPLES_SLACK = 1e-9
"""By how much the bound of black boxes may be off its exact value, relative to it: rounding."""


class Argument:
    """Argument of a certificate, step by step in the order in which `run` makes it.

    Confirmed claims are noted in a record; `stated` is what other files of the run folder claim besides. With
    `code`, a folder, S may take over at every node of an experimental step.
    """

    def __init__(
        self,
        document: Document,
        record: Record,
        stated: FileClaims | None = None,
        code: FilePath | None = None,
    ) -> None:
        self.document, self.record, self.claims, self.code = document, record, stated or FileClaims(), code
        self.n, self.K = len(document.A), document.steps
        self.plant = plant_of(document)
        assert document.laws[0].gain is not None  # as of every safety controller
        self.gain = matrix(document.laws[0].gain)
        self.craft = craft_of(document, self.plant, self.gain)
        self.controllers = [ControllerModel.for_law(law, self.craft, document) for law in document.laws]
        networks = [controller.policy for controller in self.controllers if controller.law.kind == "neural"]
        self.upsets = wrong_thrust(document, self.craft, networks)

    def run(self) -> None:
        """Check everything; returns only if every claim holds."""
        path = self.reference()
        self.record.holds("end", check_end(self.document, path))
        self.flights(path, Merging(ORDER, self.n, self.craft.merge_rows))
        if self.document.drift is not None:
            self.record.holds("passive", Drifts(self.document, self.plant).check(self.claims.least))
        if self.document.sampled_bound:
            self.record.holds("samples", check_statement(self.document.sampled_bound))
            self.record.sampled = True
            boxes = sum(fit is not None for fit in self.document.fits)
            text = f"statistical: {boxes} steps of black boxes rest on samples, the others are proven"
            self.record.holds("guarantee", text)
            return
        self.record.holds("guarantee", "proved")

    def flights(self, path: Path, merging: Merging) -> None:
        """Check everything that rests on the sets which the schedule reaches."""
        doc = self.document
        sets, steps = self.tubes(path, merging)
        node_sets = [z for step in steps for z in step.nodes]
        tracker = Tracker.from_sets(doc, self.craft, self.upsets, [*sets, *node_sets])
        flight = Continuation(doc, path, tracker)
        self.recoverability(flight, sets, steps)
        if self.code is not None:
            check_plausible(flight, [z.size() for z in [*sets, *node_sets]])
        if self.claims.goal is not None:
            last = max((k + 1 for k, mode in enumerate(doc.modes) if mode), default=0)
            hand_overs = tuple(HandOver(sets[k], k * doc.q, k * doc.q) for k in (last, self.K))
            delta_v = spent(steps, self.K * doc.q, doc.weights[: self.K]) / doc.mass
            arrival = Arrival(flight, hand_overs, delta_v, self.controllers[0], merging, steps)
            self.record.holds("goal", arrival.check(*self.claims.goal))
            if self.claims.joint is not None:
                self.record.holds("joint", check_joint(arrival, self.claims.joint))
            if self.claims.budget is not None:
                self.record.holds("schedule", arrival.keeps(self.claims.goal[0], self.claims.budget))
            if self.claims.upkeep is not None:
                self.record.holds("upkeep", check_upkeep(arrival, self.claims.upkeep, self.claims.tank))
            if self.claims.estimate is not None:
                self.record.holds("estimate", check_estimate(arrival, self.claims, steps))
        if doc.powered is not None:
            self.record.holds("powered_abort", check_aborts(tracker, sets, steps, self.claims))

    def reference(self) -> Path:
        """Check that the reference is the exact motion under the stored inputs, which are within limits."""
        doc = self.document
        path = exact_path(doc, self.plant, doc.states[self.K])
        size = [max(abs(state[i]) for state in doc.states) for i in range(self.n)]
        size = [x + 1e-6 * max(size) for x in size]  # a state that rests is zero up to rounding
        for k, (state, exact) in enumerate(zip(doc.states, path.starts, strict=True)):
            for i in range(self.n):
                gap = abs(exact[i, 0] - state[i])
                slack = arb(PATH_SLACK) * (size[i] if k else 0.0)
                require("reference", slack - gap, f"state {i} at the start of step {k} is {plain(gap)} off")
        jump = magnitude(path.jump).entries()
        for i, gap in enumerate(jump):
            limit = JUMP_SLACK * max(1.0, *size)
            require("reference", limit - gap, f"the tail starts {float(gap):.6g} off state {i} reached at T")
        within_limits(doc, doc.inputs, "thrust", "the reference")
        self.record.holds("thrust", "the reference keeps the limits; those of S are part of recoverable")
        self.record.holds(
            "reference", f"{doc.cells} steps obey the dynamics, jump at T {float(largest(jump)):.3g}"
        )
        return path

    def tubes(self, path: Path, merging: Merging) -> tuple[list[Zonotope], list[FlownStep]]:
        """Reachable sets of the schedule; every step of an experimental controller is separate."""
        doc = self.document
        start = self.craft.start(Zonotope(arb_mat(self.n, 1), matrix(doc.generators, self.n).transpose()))
        sets, steps, directions = [start], [], dict[Any, Directions]()
        for k, mode in enumerate(doc.modes):
            barrier = Barrier.for_cell(doc, self.plant.C, k, doc.facets[k], directions) if mode else None
            parts = doc.drift.steps[k] if doc.drift is not None else None
            departures = None if parts is None else Departures(self.plant, k, parts, doc.state_offset)
            steps.append(
                enclose_step(
                    self.controllers[mode], sets[-1], k, path, barrier, merging, departures, self.upsets
                )
            )
            sets.append(steps[-1].end)
        share = sum(mode > 0 for mode in doc.modes) / self.K
        self.record.holds("separation", f"{self.K} steps, {share:.1%} of them U's, stay clear")
        return sets, steps

    def recoverability(self, flight: Continuation, sets: list[Zonotope], steps: list[FlownStep]) -> None:
        """Check that S keeps all limits to the end if it takes over before or after any experimental step."""
        doc = self.document
        margins = self.claims.margins or [0.0] * self.K
        claimed = {0: self.claims.start_margin or 0.0}
        for k, mode in enumerate(doc.modes):
            for at in (k, k + 1) if mode > 0 or margins[k] > 0 else ():
                claimed[at * doc.q] = max(claimed.get(at * doc.q, 0.0), margins[k])
        reached = {node: sets[node // doc.q] for node in claimed if node < flight.recovery.nodes}
        for k, mode in enumerate(doc.modes):  # a fault is isolated, or a command of U is missing, at any node
            node_sets = steps[k].nodes if mode > 0 and (doc.transients or self.code is not None) else []
            reached |= {k * doc.q + i: z for i, z in enumerate(node_sets, 1)}
        flight.keeps(reached, claimed)
        horizon = f"{flight.tracker.settling.periods} periods ahead and beyond"
        self.record.holds("recoverable", f"S can take over at {len(reached)} instants, {horizon}")
        claims = [margin for margin in claimed.values() if margin > 0]
        bound = f", at least {min(claims):.3g} of the clearance" if claims else ""
        self.record.holds("margins", f"derived at {len(claims)} instants next to steps under U{bound}")
        if self.code is not None:
            _, tables, precision, _ = read_code(self.code)
            if tables.rows:
                self.record.holds("monitor", check_online(flight, tables, precision))


def check_statement(claim: dict[str, Any]) -> str:
    """Confirm the bound on the probability of leaving the bands, from the numbers of flights.

    Were it higher, so few flights outside would have at most the attempt's share of the doubt: a half of it
    for the first, a quarter for the second (Clopper and Pearson 1934). It trusts that they were flown.
    """
    flights, outside, attempts = claim["flights"], claim["outside"], claim["attempts"]
    if not (0 < claim["confidence"] < 1 and 0 < claim["probability"] < 1 and 1 <= attempts <= 64):
        raise Rejected("samples", "probability and confidence must be between 0 and 1, attempts from 1 to 64")
    p, risk = arb(claim["probability"]) * (1 + SAMPLES_SLACK), (1 - arb(claim["confidence"])) / 2**attempts
    chance = term = (1 - p) ** flights
    for j in range(outside):
        term = term * (flights - j) / (j + 1) * p / (1 - p)
        chance += term
    text = f"{outside} of {flights} flights outside have probability {float(chance):.4g} at that bound"
    require("samples", risk * (1 + SAMPLES_SLACK) - chance, text)
    return f"{outside} of {flights} flights outside: at most {claim['probability']:.4g}, attempt {attempts}"
