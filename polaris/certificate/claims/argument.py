"""The safety argument, re-derived from the primary data of a certificate."""

from dataclasses import replace
from typing import Any

from flint import arb, arb_mat

from ..files.artefacts import Stated
from ..files.document import Document
from ..kernel.arcs import Path
from ..kernel.balls import above, absolute, column, identity, largest, magnitude, matrix, plain, require, sums
from ..kernel.verdict import Record, Rejected, Undecided
from ..kernel.zonotopes import Merging, Zonotope, widest
from ..model.bodies import Whereabouts
from ..model.craft.memory import Memory
from ..model.craft.needs import Needs
from ..model.craft.scheduled import Scheduled
from ..model.craft.states import craft_of
from ..model.limits import Barrier, Limits
from ..model.plants import plant_of, within_limits
from ..model.transients import lost, misled, moved, upset
from .arrival import Arrival
from .coasting import JUMP_SLACK, PATH_SLACK, check_end, flown_path, prolonged
from .drift import Departures, Drifts
from .flights import Flown, Pilot, fly
from .powered import check_aborts
from .recovery import Recovery
from .spending import spent
from .upkeep import check_upkeep

ORDERS = ((24, 1), (80, 1), (400, 3), (400, 1))
"""What is tried in turn: generators per dimension that sets keep from one step to the next, and how many
periods in a row have theirs made one. Long flights under errors need the third; no box needs many."""
NETWORK_ORDER = 30, 1
"""The same to begin with where a network or a black box flies: fewer widen too much what turns."""

NARROWER = (
    *("controllers", "separation", "enclosures", "recoverable", "margins"),
    *("goal", "passive", "powered_abort"),
)
"""Claims that may fail because sets are wider than they need to be."""

TUBE_SLACK = 1e-6  # by how much a stored bound may fall short of the derived one, relative to it

BOX_SLACK = 0.05
"""By how much a stored enclosure may fall short of the derived one, as a share of its own width.

Both enclose the same set, but merge generators differently. Nothing is derived from a stored enclosure.
"""

SAMPLES_SLACK = 1e-9
"""By how much the bound of black boxes may be off its exact value, relative to it: rounding."""


class Argument:
    """Every step of the argument, in the order in which `run` makes it.

    Confirmed claims are noted in a record; `stated` is what other files of the run folder claim besides.
    """

    def __init__(self, document: Document, record: Record, stated: Stated | None = None) -> None:
        self.document, self.record, self.stated = document, record, stated or Stated()
        self.n, self.K = len(document.A), document.steps
        self.plant = plant_of(document)
        given = self.plant, document.slopes, document.fits
        self.pilots = [Pilot(law, *given, Whereabouts.of(document, law, self.plant)) for law in document.laws]
        self.gain = self.pilots[0].gain
        self.craft = craft_of(document, self.plant, self.gain)
        networks = [pilot.policy for pilot in self.pilots if pilot.law.kind == "neural"]
        self.upsets = moved(document, self.plant, networks)

    def run(self) -> None:
        """Check everything; returns only if every claim holds.

        What fails with few generators is tried again with more, unless none had to be merged: an honest
        claim must not fail because the checker's own sets are wider than those that it was made from.
        """
        path, confirmed = self.reference(), len(self.record.checked)
        flies = {self.document.laws[mode].kind for mode in self.document.modes}
        orders = [NETWORK_ORDER, *ORDERS[1:]] if flies & {"neural", "black_box"} else [*ORDERS]
        if self.document.profile and len(orders) > 1:  # margins are tight: the fewest do not do
            orders = orders[1:]
        for order in orders:
            merging = Merging(*order)
            try:
                self.flights(path, merging)
                break
            except Rejected as error:
                if order == orders[-1] or not merging.lossy or error.claim not in NARROWER:
                    raise
                del self.record.checked[confirmed:]
        else:
            raise Undecided("separation", "no number of generators is given")
        self.record.holds("end", check_end(self.document, path))
        if self.document.drift is not None:
            self.record.holds("passive", Drifts(self.document, self.plant).check(self.stated.least))
        if self.document.statement:
            self.record.holds("samples", check_statement(self.document.statement))
            self.record.sampled = True
            boxes = sum(fit is not None for fit in self.document.fits)
            told = f"statistical: {boxes} steps of black boxes rest on samples, all else is proven"
            self.record.holds("guarantee", told)
            return
        self.record.holds("guarantee", "proved")

    def flights(self, path: Path, merging: Merging) -> None:
        """Everything that rests on the sets which the schedule reaches."""
        sets, flown = self.tubes(path, merging)
        self.flown = flown
        self.enclosures(sets, flown)
        profile = [[arb(x) for x in most] for most in self.document.profile]
        memory = Memory.of(self.craft, widest(sets, self.upsets), self.document.q, profile)
        further, chosen = prolonged(self.document, path, memory)
        scheduled = None
        if profile or self.document.error_by_step:
            scheduled = Scheduled(self.document, self.craft, memory, further)
        self.error_bounds(memory, sets[0], scheduled)
        self.recoverability(further, chosen, memory, sets, scheduled)
        if self.stated.goal is not None:
            taken = spent(flown) / self.document.mass
            last = max((k + 1 for k, mode in enumerate(self.document.modes) if mode), default=0)
            held = ((sets[last], (self.K - last) * self.document.q), (sets[-1], 0))
            given = self.document, path, self.craft, memory, held, taken, scheduled
            arrival = Arrival(*given, self.pilots[0], merging)
            self.record.holds("goal", arrival.check(*self.stated.goal))
            if self.stated.budget is not None:
                self.record.holds("schedule", arrival.keeps(self.stated.goal[0], self.stated.budget))
            if self.stated.upkeep is not None:
                self.record.holds("upkeep", check_upkeep(arrival, self.stated.upkeep, self.stated.tank))
        if self.document.powered is not None:
            asked, late = (self.stated.orbit, self.stated.tank), (self.upsets, self._needs)
            known = self.craft, sets, flown, asked, late
            self.record.holds("powered_abort", check_aborts(self.document, *known))

    def _needs(self, memory: Memory, rows: arb_mat) -> Needs:
        """What errors need along rows, a fault that is isolated late included."""
        needs = Needs(self.craft, memory, rows)
        boxes, doc = [*self.upsets, *lost(self.document, self.craft, memory)], self.document
        if not boxes or doc.observer is None:
            return replace(needs, upset=upset(needs, boxes)) if boxes else needs
        off = misled(doc, self.plant, len(memory.powers))
        return replace(needs, upset=upset(needs, boxes, off))

    def reference(self) -> Path:
        """The reference is the exact motion under the stored inputs, and these are within the limits."""
        doc = self.document
        path = flown_path(doc, self.plant, doc.states[self.K])
        size = [max(abs(state[i]) for state in doc.states) for i in range(self.n)]
        size = [x + 1e-6 * max(size) for x in size]  # a state that rests is zero up to rounding
        for k, (state, exact) in enumerate(zip(doc.states, path.starts, strict=True)):
            for i in range(self.n):
                off = abs(exact[i, 0] - state[i])
                slack = arb(PATH_SLACK) * (size[i] if k else 0.0)
                require("reference", slack - off, f"state {i} at the start of step {k} is {plain(off)} off")
        jump = magnitude(path.jump).entries()
        for i, off in enumerate(jump):
            most = JUMP_SLACK * max(1.0, *size)
            require("reference", most - off, f"the tail starts {float(off):.6g} off state {i} reached at T")
        within_limits(doc, doc.inputs, "thrust", "the reference")
        self.record.holds("reference", f"{doc.cells} steps, jump at T at most {float(largest(jump)):.3g}")
        return path

    def tubes(self, path: Path, merging: Merging) -> tuple[list[Zonotope], list[Flown]]:
        """Reachable sets of the schedule; every step of an experimental controller is separate."""
        doc = self.document
        start = Zonotope(arb_mat(self.n, 1), matrix(doc.generators, self.n).transpose())
        sets, flown = [start], []
        for k, mode in enumerate(doc.modes):
            barrier = Barrier.of(doc, self.plant.C, k, doc.facets[k]) if mode else None
            parts = doc.drift.steps[k] if doc.drift is not None else None
            departures = None if parts is None else Departures(self.plant, k, parts, doc.displaced)
            pilot = self.pilots[mode].knowing(doc.known_to(k))
            flown.append(fly(pilot, sets[-1], k, path, barrier, merging, departures, self.upsets))
            sets.append(flown[-1].end)
        share = sum(mode > 0 for mode in doc.modes) / self.K
        self.record.holds("separation", f"{self.K} steps, {share:.1%} of them experimental, whole intervals")
        return sets, flown

    def enclosures(self, sets: list[Zonotope], flown: list[Flown]) -> None:
        """Stored enclosures contain the derived ones, up to the slack of merged generators."""
        doc = self.document
        for k, z in enumerate(sets):
            reach = z.support(above(identity(self.n), -identity(self.n)))
            for i in range(self.n):
                middle, half = arb(doc.box_center[k][i]), arb(doc.box_half[k][i])
                slack = half * BOX_SLACK + abs(middle) * TUBE_SLACK - doc.displaced[i]
                where = f"state {i} at the start of step {k}"
                require("enclosures", middle + half + slack - reach[i], where)
                require("enclosures", half - middle + slack - reach[self.n + i], where)
        for k, step in enumerate(flown):
            for i in range(self.n):
                low, high = arb(doc.lower[k][i]), arb(doc.upper[k][i])
                slack = (high - low) * BOX_SLACK - doc.displaced[i]
                where = f"state {i} during step {k}"
                require("enclosures", high + slack - step.upper[i], where)
                require("enclosures", step.lower[i] - low + slack, where)
        self.record.holds("enclosures", f"{len(sets)} instants, {len(flown)} steps")

    def error_bounds(self, memory: Memory, start: Zonotope, scheduled: Scheduled | None) -> None:
        """Stored bounds on S's error from the initial set, and on its command, are no smaller than derived.

        Beyond the memory of the loop what is derived is the disturbance's share alone.
        """
        doc, q, C = self.document, self.document.q, self.plant.C
        K = self.craft.commands
        needs = self._needs(memory, above(self.craft.whole(above(C, -C)), K, -K))
        disturbed = needs.disturbed
        tube = needs.tube(start)
        names = [f"position {i}" for i in range(C.nrows())] * 2 + doc.input_names * 2
        d = 2 * C.nrows()
        apart = (absolute(above(C, -C)) * column(doc.displaced)).entries() + [arb(0)] * 2 * len(doc.u_max)
        taken = scheduled.along(needs.given) if scheduled else []
        more = [[largest(each) for each in zip(*nodes, strict=True)] for nodes in taken]
        for k in range(self.K):
            lags = range(k * q, (k + 1) * q + 1)
            if lags[-1] <= memory.periods:
                need = [largest(tube[lag][j] + disturbed[lag][j] for lag in lags) for j in range(len(names))]
            else:
                need = disturbed[-2]
            need = sums(need, apart, *more[k : k + 1])
            for j, name in enumerate(names):
                self._no_smaller("error_bounds", f"{name} in step {k}", doc.tube[k][j], need[j])
            error = self.craft.noise_in(doc, k)
            for i, top in enumerate(self.plant.u_max):
                below, over, u = need[d + i], need[d + len(doc.u_max) + i], doc.inputs[k][i]
                where = f"{doc.input_names[i]} in step {k}"
                self._no_smaller("thrust", where, doc.peaks[k][i], largest((over + u, below - u)) + error[i])
                require("thrust", top - doc.peaks[k][i], f"{where}, {doc.peaks[k][i]:.6g} claimed")
        settled = sums(disturbed[-2], apart, *more[doc.cells - 1 : doc.cells])
        for name, stored, most in zip(names, doc.settled, settled, strict=True):
            self._no_smaller("error_bounds", f"{name} from rest, for ever", stored, most)
        self.record.holds("error_bounds", f"{self.K} steps of S from the initial set, and from rest for ever")
        self.record.holds("thrust", "reference, and S from the initial set, within the limits")

    def _no_smaller(self, claim: str, what: str, stored: float, derived: arb) -> None:
        """A stored bound is at least the derived one, up to rounding."""
        spare = stored - derived + abs(derived) * TUBE_SLACK
        if not spare >= 0:
            require(claim, spare, f"{what}: {stored:.6g} stored, {plain(derived)} derived")

    def recoverability(
        self,
        path: Path,
        chosen: list[list[int]],
        memory: Memory,
        sets: list[Zonotope],
        scheduled: Scheduled | None,
    ) -> None:
        """S keeps to every limit to the end if it takes over before or after any experimental step."""
        doc = self.document
        limits = Limits.of(doc, path, self.craft, chosen)
        needs = self._needs(memory, limits.rows)
        recovery = Recovery.of(doc, path, limits, needs, scheduled)
        claimed = {0: self.stated.start_margin or 0.0}
        for k, mode in enumerate(doc.modes):
            for at in (k, k + 1) if mode > 0 or doc.margins[k] > 0 else ():
                claimed[at * doc.q] = max(claimed.get(at * doc.q, 0.0), doc.margins[k])
        reached = {node: sets[node // doc.q] for node in claimed if node < recovery.nodes}
        for k, mode in enumerate(doc.modes):  # a fault is isolated at any node
            within = self.flown[k].nodes if mode > 0 and doc.transients else []
            reached |= {k * doc.q + i: z for i, z in enumerate(within, 1)}
        least = recovery.check_sets(reached, claimed)
        recovery.check_far()
        ahead = f"{memory.periods} periods ahead and beyond, tightest share {least:.3g}"
        self.record.holds("recoverable", f"{len(reached)} instants of switching, {ahead}")
        claims = sum(margin > 0 for margin in claimed.values())
        self.record.holds("margins", f"{claims} instants next to experimental steps")
        recovery.check_balls(doc.radius[: self.K + (doc.cells > self.K)], matrix(doc.weight).inv())
        told = f"balls inside the sets of kind {doc.recoverable}, {self.K} instants"
        self.record.holds("recoverable_sets", told)


def check_statement(said: dict[str, Any]) -> str:
    """Confirm the bound on the probability of leaving the bands, from the numbers of flights.

    Were it higher, so few flights outside would have at most the attempt's share of the doubt: a half of it
    for the first, a quarter for the second (Clopper and Pearson 1934). It trusts that they were flown.
    """
    flights, outside, attempts = said["flights"], said["outside"], said["attempts"]
    if not (0 < said["confidence"] < 1 and 0 < said["probability"] < 1 and 1 <= attempts <= 64):
        raise Rejected("samples", "probability and confidence must be between 0 and 1, attempts from 1 to 64")
    p, doubt = arb(said["probability"]) * (1 + SAMPLES_SLACK), (1 - arb(said["confidence"])) / 2**attempts
    chance = term = (1 - p) ** flights
    for j in range(outside):
        term = term * (flights - j) / (j + 1) * p / (1 - p)
        chance += term
    told = f"{outside} of {flights} flights outside have a probability of {float(chance):.4g} at that bound"
    require("samples", doubt * (1 + SAMPLES_SLACK) - chance, told)
    return f"{outside} of {flights} flights outside: at most {said['probability']:.4g}, attempt {attempts}"
