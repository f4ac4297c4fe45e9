"""Passive safety: if all thrust stops at any instant of a step, the drift stays clear of the unsafe sets.

A flight whose thrust stops in a step drifts as if it had been at a place of the step's start all along. The
certificate encloses these places by parallelotopes, one after another for groups of periods; that they do is
shown period by period (`Departures`), that the drift from each stays clear, over a time that begins with the
step, facet by facet (`clear`).
"""

from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import accumulate

from flint import arb, arb_mat

from ..files.document import Document
from ..files.entries import Departure, DriftClaim
from ..kernel.arcs import Arc
from ..kernel.balls import (
    beside,
    column,
    exponential,
    exponential_over,
    identity,
    magnitude,
    matrix,
    maxima,
    plain,
    require,
    row_sums,
    smallest,
    sums,
)
from ..kernel.motion import Motion, Plant
from ..kernel.verdict import Rejected, Undecided
from ..kernel.zonotopes import Zonotope

SLACK = 1e-9  # by how much a horizon and a distance may fall short, relative to them: they are rounded
MOST_PARTS = 20_000  # most parts of steps over which a drift is followed


@dataclass(frozen=True, eq=False)
class Departures:
    """States in which thrust may stop in one step, as of its start, in the periods one after another."""

    plant: Plant
    k: int
    groups: list[Departure]
    state_offset: list[float]  # how far jitter may displace every state

    @cached_property
    def _group(self) -> list[int]:
        """Return the number of the group that each period belongs to."""
        return [g for g, group in enumerate(self.groups) for _ in range(group.periods)]

    @cached_property
    def _inverses(self) -> list[arb_mat]:
        try:
            return [matrix(group.axes).transpose().inv() for group in self.groups]
        except ZeroDivisionError as error:
            raise Rejected(
                "passive", f"axes of the departures in step {self.k} are not independent"
            ) from error

    @cached_property
    def _back(self) -> list[arb_mat]:
        """``e^{-A t}`` from every node of the step."""
        plant = self.plant
        return [exponential(-plant.A, plant.h * i)[0] for i in range(plant.q + 1)]

    @cached_property
    def _over(self) -> arb_mat:
        return magnitude(exponential_over(-self.plant.A, self.plant.h))

    def check(
        self, i: int, base: Arc, d: Zonotope, change: Zonotope, end: Zonotope, intersample: list[arb]
    ) -> None:
        """Check that states in which thrust may stop in period i lead back into the group's parallelotope.

        `d` and `end` are the ends of the chords of undisturbed motion about the base arc, `change` the
        second less the first, point by point; `intersample` bounds the distance from the chords
        (Proposition 15 (a)).
        """
        A, h, first, last = self.plant.A, self.plant.h, base.nodes[i], base.nodes[i + 1]
        group = self.groups[self._group[i]]
        inverse, centre = self._inverses[self._group[i]], column(group.center)
        ends = d.translate(first), end.translate(last)
        size = column(maxima(*(z.size().entries() for z in ends)))
        length = change.translate(last - first).size()
        deviation = magnitude(A * A) * size * (h * h / 8) + magnitude(A) * length * (h / 4)
        excess = (
            magnitude(inverse * self._back[i])
            * (self._over * (column(intersample) + column(self.state_offset) + deviation))
        ).entries()
        for z, back in zip(ends, self._back[i : i + 2], strict=True):
            M = inverse * back
            middle = (M * z.c - inverse * centre).entries()
            for axis, (at, spread, extra) in enumerate(zip(middle, z.spread(M), excess, strict=True)):
                text = f"axis {axis} of where thrust may stop, step {self.k}, part {i}"
                require("passive", 1 - abs(at) - spread - extra, text)


@dataclass(frozen=True, eq=False)
class Drifts:
    """Free motion from the steps of a certificate that claims something of it."""

    document: Document
    plant: Plant
    _cache: dict[tuple[int, int], tuple[arb_mat, arb_mat, list[arb]]] = field(
        default_factory=dict, repr=False
    )

    @cached_property
    def _claim(self) -> DriftClaim:
        drift = self.document.drift
        assert drift is not None
        return drift

    @cached_property
    def _cells(self) -> int:
        """Steps that a drift is followed over: those of the horizon, and the one in which thrust stops."""
        doc, drift = self.document, self._claim
        runs = [run for groups in drift.steps for group in groups or () for run in group.facets[:1]]
        parts = max((sum(length for length, _ in run) for run in runs), default=0)
        cells = -(-parts // drift.parts)
        if parts > MOST_PARTS:
            raise Undecided("passive", f"the drift has more than {MOST_PARTS} parts of steps")
        if runs:
            slack = (cells - 1) * arb(doc.delta) - arb(drift.horizon) * (1 - SLACK)
            require("passive", slack, f"the drift is followed for {cells} steps")
            if any(len(item.start) < doc.steps + cells for item in doc.unsafe):
                raise Rejected("passive", "unsafe sets are not known for as long as the drift is followed")
        return cells

    @cached_property
    def _motion(self) -> Motion:
        """Free motion over one part of a step."""
        return replace(self.plant, h=arb(self.document.delta) / self._claim.parts, q=1).open

    @cached_property
    def _powers(self) -> list[arb_mat]:
        powers = [identity(len(self.document.A))]
        for _ in range(self._cells * self._claim.parts):
            powers.append(powers[-1] * self._motion.phi)
        return powers

    def _bookings(self, item: int, facet: int) -> tuple[arb_mat, arb_mat, list[arb]]:
        """Return a facet's row ``-n C``, its curvature in a part, and the disturbance by the end of each."""
        key = item, facet
        if key not in self._cache:
            motion = self._motion
            row = -self.document.unsafe[item].rows(self.plant.C, [facet])
            rows = matrix([(row * M).entries() for M in self._powers[:-1]])
            gains = motion.push_gain(rows, self.plant.disturbance)
            disturbance = list(accumulate(gains, lambda a, b: (a + b).upper()))
            constants = (motion.constant_gain(rows, push, self._claim.parts) for push in self.plant.bias)
            disturbance = sums(disturbance, *constants)
            self._cache[key] = row, motion.curvature(row * self.plant.A), disturbance
        return self._cache[key]

    def check(self, least: float | None) -> str:
        """Check that every drift that the certificate calls clear is; return the confirmed facts."""
        doc, drift = self.document, self._claim
        clearances = [
            clearance
            for k, groups in enumerate(drift.steps)
            for group in groups or ()
            for clearance in self._clear(k, group)
        ]
        if least is not None and clearances:
            text = f"the drift keeps {least:.6g} m"
            require("passive", smallest(clearances) - arb(least) * (1 - SLACK), text)
        count = sum(groups is not None for groups in drift.steps)
        return f"the drift from {count} of {doc.steps} steps stays clear for {drift.horizon:.6g} s"

    def _clear(self, k: int, group: Departure) -> list[arb]:
        """Least clearance of the drift from one group of periods of step k to every unsafe set."""
        count, clearances = len(self._powers) - 1, []
        sets = beside(column(group.center), matrix(group.axes).transpose())
        states = [power * sets for power in self._powers]
        sizes = [column(row_sums(state)) for state in states]
        unsafe = [o for o, item in enumerate(self.document.unsafe) if self._claim.keep_in or not item.keep_in]
        if len(unsafe) != len(group.facets):
            text = f"step {k} has facets of {len(group.facets)} unsafe sets, not {len(unsafe)}"
            raise Rejected("passive", text)
        for o, runs in zip(unsafe, group.facets, strict=True):
            valid = range(len(self.document.unsafe[o].normals))
            if sum(length for length, _ in runs) != count or any(f not in valid for _, f in runs):
                raise Rejected("passive", f"step {k} must name a facet in {count} parts")
            facets = [facet for length, facet in runs for _ in range(length)]
            clearances.append(smallest(self._clearances(k, o, facets, states, sizes)))
        return clearances

    def _clearances(
        self, k: int, o: int, facets: list[int], states: list[arb_mat], sizes: list[arb_mat]
    ) -> list[arb]:
        """Clearance beyond one facet of one unsafe set in every part."""
        p, item, clearances = self._claim.parts, self.document.unsafe[o], []
        for j, facet in enumerate(facets):
            row, curvature, disturbance = self._bookings(o, facet)
            cell, place = divmod(j, p)
            first, last = arb(item.start[k + cell][facet]), arb(item.end[k + cell][facet])
            extra = (curvature * sizes[j])[0, 0] + disturbance[j]
            for at in (0, 1):
                middle, *spread = (row * states[j + at]).entries()
                offset = first + (last - first) * arb(place + at) / p
                clearance = -offset - middle - sum(map(abs, spread), extra)
                text = f"the drift from step {k} to {item.name}, {j + 1} parts on: {plain(clearance)} m"
                require("passive", clearance, text)
                clearances.append(clearance)
        return clearances
