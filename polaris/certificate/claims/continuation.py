"""S along one path to the end of time: the limits that it keeps, and the tightening of any rows."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

from flint import arb, arb_mat

from ..files.document import Document
from ..kernel.arcs import Path
from ..kernel.balls import above, column, diagonal, largest, magnitude, maxima, smallest, sums
from ..kernel.zonotopes import Zonotope, widest
from ..model.craft.craft import Craft
from ..model.craft.feedforward import Feedforward
from ..model.craft.settling import Settling
from ..model.craft.tightening import Differences, SetIntersample, Tightening
from ..model.limits import Limits
from ..model.transients import outage_differences, transient_tightening
from .coasting import prolonged
from .recovery import Recovery


@dataclass(frozen=True, eq=False)
class Tracker:
    """The safety controller from any of some sets: its loop, settling horizon, and tightening of rows."""

    document: Document
    craft: Craft
    settling: Settling
    upsets: Sequence[arb_mat]  # boxes, one of which holds what a fault adds until it is isolated
    _cache: dict[Any, Tightening] = field(default_factory=dict, repr=False)

    @classmethod
    def from_sets(
        cls, document: Document, craft: Craft, upsets: Sequence[arb_mat], sets: Sequence[Zonotope]
    ) -> "Tracker":
        """Build the tracker from errors within any of the sets."""
        settling = Settling.for_craft(craft, widest([*sets], upsets), document.q, document.feedback_bound)
        return cls(document, craft, settling, upsets)

    def tightenings(self, key: Any, rows: arb_mat) -> Tightening:
        """Return the tightening of rows by errors and a transient fault; `key` names the rows."""
        if key not in self._cache:
            doc, tightenings = self.document, Tightening(self.craft, self.settling, rows)
            if doc.transients:
                tightenings = replace(
                    tightenings, fault=transient_tightening(tightenings, [*self.upsets], self.outages)
                )
            self._cache[key] = tightenings
        return self._cache[key]

    @cached_property
    def outages(self) -> list[Differences]:
        """Differences that losses of navigation make of the loop state."""
        return outage_differences(self.document, self.craft, self.settling)

    @property
    def commands(self) -> arb_mat:
        """Rows of the feedback commands, of both signs."""
        return above(self.craft.commands, -self.craft.commands)


@dataclass(frozen=True, eq=False)
class HandOver:
    """Set that holds all errors where S takes over, at some node from `first` to `last`."""

    errors: Zonotope
    first: int
    last: int
    box: arb_mat | None = None  # its size (N, 1), which alone gives the intersample bound
    _since: dict[tuple[Tightening, int, bool], list[arb]] = field(default_factory=dict, repr=False)
    _intersamples: dict[Tightening, SetIntersample] = field(default_factory=dict, repr=False)

    @classmethod
    def within(cls, size: arb_mat, first: int, last: int) -> "HandOver":
        """Build the hand-over from any loop state up to a size (N, 1)."""
        return cls(Zonotope(arb_mat(size.nrows(), 1), diagonal(size.entries())), first, last, size)

    def tightening(self, tightenings: Tightening, lag: int, around: bool) -> list[arb]:
        """Bound the errors alone along rows after `lag` periods; if `around`, next to that node, too."""
        key = tightenings, lag, around
        if key not in self._since:
            if lag > tightenings.settling.periods:
                self._since[key] = tightenings.tightening_after_settling(self.errors.size())
            elif around and self.box is not None:
                self._since[key] = tightenings.boxed(self.box, lag)
            else:
                intersamples = self._intersamples.setdefault(
                    tightenings, SetIntersample(tightenings, self.errors)
                )
                extra = [intersamples.next_to(lag)] if around else []
                self._since[key] = sums(self.errors.support(tightenings.carried[lag]), *extra)
        return self._since[key]


@dataclass(frozen=True, eq=False)
class Continuation:
    """The tracker along one path, which the document has for its reference."""

    document: Document
    path: Path
    tracker: Tracker
    facets: Sequence[list[int]] = ()  # others of the same tracker, so that rows of limits are the same
    _cache: dict[Any, list[arb]] = field(default_factory=dict, repr=False)
    _responses: dict[tuple[Tightening, bool], list[list[arb]]] = field(default_factory=dict, repr=False)

    def tightening(
        self, tightenings: Tightening, hand_overs: tuple[HandOver, ...], node: int, around: bool = False
    ) -> list[arb]:
        """Bound errors along rows at a node and, if `around`, in the periods on both sides of it.

        Each of the sets holds all errors that S may have taken over.
        """
        key = tightenings, hand_overs, node, around
        if key not in self._cache:
            last, bounds = tightenings.settling.periods + 1, []
            disturbance = tightenings.disturbed if around else tightenings.at_nodes
            for each in hand_overs:
                lags = {min(max(node - at, 0), last) for at in range(each.first, each.last + 1)}
                totals = [sums(each.tightening(tightenings, lag, around), disturbance[lag]) for lag in lags]
                bounds.append([x.upper() for x in maxima(*totals)])
            parts = [[smallest(x) for x in zip(*bounds, strict=True)]]
            if self.scheduled:
                parts.append(self.from_thrust(tightenings, node, around))
            if not around:  # commands do not answer to what is displaced
                parts.append((magnitude(tightenings.rows) * column(self.document.at_nodes)).entries())
            if (since := node - self.document.steps * self.document.q) >= 0:
                parts.append(self._jump.tightening(tightenings, min(since, last), around))
            self._cache[key] = sums(*parts)
        return self._cache[key]

    def from_thrust(self, tightenings: Tightening, node: int, around: bool = False) -> list[arb]:
        """Bound errors by the time of the flight along rows: at a node; in the tail, from it on."""
        if (key := (tightenings, around)) not in self._responses:
            assert self.scheduled is not None
            cells, T = self.scheduled.response(tightenings, around), self.document.steps * self.document.q
            nodes = [each for cell in cells for each in cell[:-1]] + [cells[-1][-1]]
            for at in range(len(nodes) - 2, T - 1, -1):
                nodes[at] = maxima(nodes[at], nodes[at + 1])
            self._responses[key] = nodes
        return self._responses[key][min(node, len(self._responses[key]) - 1)]

    def commanded(self, tightenings: Tightening, hand_overs: tuple[HandOver, ...], period: int) -> list[arb]:
        """Bound S's commands in a period [N]; `tightenings` are those of `Tracker.commands`."""
        doc, m = self.document, len(self.document.u_max)
        cell, ends = (
            period // doc.q,
            [self.tightening(tightenings, hand_overs, period + i, around=True) for i in (0, 1)],
        )
        pairs = zip(doc.inputs[min(cell, doc.cells - 1)], self.tracker.craft.noise_in(doc, cell), strict=True)
        tops = [largest([end[i] for end in ends for i in (axis, m + axis)]) for axis in range(m)]
        return [(top + abs(u) + error).upper() for top, (u, error) in zip(tops, pairs, strict=True)]

    def spending(self, tightenings: Tightening, hand_overs: tuple[HandOver, ...], period: int) -> arb:
        """Bound on S's spending in a period [N s]."""
        plant = self.tracker.craft.plant
        pairs = zip(plant.u_max, self.commanded(tightenings, hand_overs, period), strict=True)
        return plant.spending([smallest(pair) for pair in pairs])

    @cached_property
    def _jump(self) -> HandOver:
        """Step of the reference at the start of the tail, as an error from then on."""
        return HandOver.within(self.tracker.craft.lifted(self.jump), 0, 0)

    @cached_property
    def further(self) -> tuple[Path, list[list[int]]]:
        """Return the path and its facets until the loop has forgotten its state at T."""
        return prolonged(self.document, self.path, self.tracker.settling)

    @cached_property
    def scheduled(self) -> Feedforward | None:
        """Errors by the time of the flight, if there are any."""
        by_step = self.document.error_by_step and self.tracker.craft.base is not None
        if not (self.document.feedback_bound or by_step):
            return None
        return Feedforward(self.document, self.tracker.craft, self.tracker.settling, self.further[0])

    @cached_property
    def recovery(self) -> Recovery:
        """Return the limits of the path against the tightening of their rows by errors."""
        path, facets = self.further
        facets = [*facets, *self.facets]
        limits = Limits.for_path(self.document, path, self.tracker.craft, facets)
        key = frozenset(pair for row in facets for pair in enumerate(row))
        tightenings = self.tracker.tightenings(key, limits.rows)
        return Recovery.from_limits(self.document, path, limits, tightenings, self.scheduled)

    def keeps(self, reached: dict[int, Zonotope], margins: dict[int, float] | None = None) -> None:
        """Check that every limit is kept to the end from sets at nodes, by a share of its clearance."""
        self.recovery.check_sets(reached, margins or {})
        self.recovery.check_far()

    @cached_property
    def jump(self) -> arb_mat:
        """Size of the step of the reference at the start of the tail, shape (n, 1)."""
        return magnitude(self.path.jump)
