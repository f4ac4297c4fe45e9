"""Recoverability: from the set reached at a switch, the safety controller keeps to every limit to the end.

The limits are facets of unsafe sets, and the thrusters'.
"""

from dataclasses import dataclass, field
from functools import cached_property

from flint import arb

from ..files.document import Document
from ..kernel.arcs import Path
from ..kernel.balls import above, beside, plain, require, rows_of, spans, sums
from ..kernel.verdict import Rejected
from ..kernel.zonotopes import Zonotope
from ..model.craft.feedforward import Feedforward
from ..model.craft.tightening import SetIntersample, Tightening
from ..model.limits import Limits, NodeLimit, levels_of

CLAIM_SLACK = 1e-2
"""Exactness of claimed figures, as a share of the clearance or of themselves; demands have no such slack."""


@dataclass(frozen=True, eq=False)
class Recovery:
    """Limits, reduced by the jump at the start of the tail, against the tightening of their rows."""

    document: Document
    limits: Limits
    tightenings: Tightening
    levels: list[list[NodeLimit]] = field(default_factory=list)
    """Bounds on feedback commands l periods after a hand-over; the last ones hold from then on."""

    @classmethod
    def from_limits(
        cls,
        document: Document,
        path: Path,
        limits: Limits,
        tightenings: Tightening,
        scheduled: Feedforward | None,
    ) -> "Recovery":
        """Build it of limits around a path, less the jump and the errors by the time of the flight."""
        limits = limits.less_jump(tightenings, path)
        if scheduled is not None:
            limits = limits.less(scheduled.response(tightenings))
        return cls(document, limits, tightenings, levels_of(document, tightenings, path))

    @property
    def nodes(self) -> int:
        """Number of the last node."""
        return self.document.q * len(self.limits.targets)

    def time(self, node: int) -> str:
        """Time of a node, for messages."""
        return f"{node / self.document.q * self.document.delta:.6g} s"

    def lags(self, node: int) -> int:
        """Number of periods after a node that are looked at one by one."""
        return min(self.tightenings.settling.periods, self.nodes - node)

    @cached_property
    def _least(self) -> list[dict[int, NodeLimit]]:
        """Return for each cell the limits of least clearance, by row, in that cell and all later ones."""
        by_cell: list[dict[int, NodeLimit]] = [{}]
        for nodes in reversed(self.limits.targets[: self.document.cells]):
            tightest = dict(by_cell[-1])
            for target in (target for targets in nodes for target in targets):
                if target.row not in tightest or not tightest[target.row].clearance <= target.clearance:
                    tightest[target.row] = target
            by_cell.append(tightest)
        return by_cell[::-1]

    def _far_cell(self, node: int) -> int:
        """First cell whose limits lie beyond the settling horizon, seen from a node."""
        doc = self.document
        last = doc.steps if doc.horizon == "infinite" else doc.cells  # all of a tail that repeats lies ahead
        return min(node // doc.q + self.tightenings.settling.periods // doc.q, last)

    def check_sets(self, reached: dict[int, Zonotope], margins: dict[int, float]) -> None:
        """Check that each set is recoverable, and inside by the share of the clearance that is claimed.

        `reached` are sets of errors at nodes, `margins` shares of the clearance claimed to be left.
        A bound from the extents of the set comes first; only where it does not do, the exact support.
        """
        sizes = beside(*(reached[k].size() for k in sorted(reached)))
        first, which = self.tightenings.kinds
        pairs = zip(self.tightenings.carried, self.tightenings.curvature, strict=True)
        blocks = ((rows_of(rows, *first), rows_of(curvature, *first)) for rows, curvature in pairs)
        extents = (spans(rows, sizes) + curvature * sizes for rows, curvature in blocks)
        coarse = [[[float(x.abs_upper()) for x in row] for row in M.tolist()] for M in extents]
        for place, k in enumerate(sorted(reached)):
            share = max(margins.get(k, 0.0), 0.0)
            close: dict[tuple[int, int], list[NodeLimit]] = {}
            for lag in range(self.lags(k) + 1):
                fraction, needed, extra = self._share(share, k, lag), coarse[lag], self._disturbed[lag]
                for target in self._all(k, lag):
                    row, clearance, whole = target.least
                    if not needed[which[row]][place] + extra[row] <= clearance - fraction * whole:
                        close.setdefault((lag, row), []).append(target)
            if close:
                self._check_close(k, reached[k], close, share)
            if share > 0:
                self._check_late(k, reached[k], share)

    @cached_property
    def _disturbed(self) -> list[list[float]]:
        return [[float(x.abs_upper()) for x in each] for each in self.tightenings.disturbed]

    def _all(self, node: int, lag: int) -> list[NodeLimit]:
        """Limits that a set at a node must keep to some periods later."""
        levels = self.levels[min(lag, len(self.levels) - 1)] if self.levels else []
        return self.limits.at_node(node + lag, first=lag == 0) + levels

    def _share(self, share: float, node: int, lag: int) -> float:
        """Return the share claimed of limits some periods after a node: none of those flown on to."""
        return share if node + lag <= self.document.cells * self.document.q else 0.0

    def _check_late(self, k: int, z: Zonotope, share: float) -> None:
        """Check that the share claimed at a set is left of all limits beyond the settling horizon, too."""
        settled = self.tightenings.tightening_after_settling(z.size())
        for row, target in self._least[self._far_cell(k)].items():
            tightening = settled[row] + self.tightenings.disturbed[-1][row]
            context = f"the set at {self.time(k)}, {target.name} beyond the settling horizon"
            self._leaves(share, target, tightening, context)

    def _leaves(self, share: float, target: NodeLimit, tightening: arb, context: str) -> None:
        """Check that a tightening, that of a jump included, leaves a share of the clearance as it is told."""
        clearance, whole = target.clearance, target.total
        if not clearance - tightening >= (share - CLAIM_SLACK) * whole:
            slack = float(((clearance - tightening) / whole).mid()) if clearance > 0 else 0.0
            text = f"share {slack:.6g} left, {share:.6g} claimed, for {context}"
            raise Rejected(
                "margins", f"{text}: needs {plain(tightening)}, available {plain(clearance)}", share - slack
            )

    def _check_close(
        self, k: int, z: Zonotope, close: dict[tuple[int, int], list[NodeLimit]], share: float
    ) -> None:
        tightenings, intersamples = self.tightenings, SetIntersample(self.tightenings, z)
        support = z.support(above(*(rows_of(tightenings.carried[lag], row) for lag, row in close)))
        bounds = above(*(rows_of(tightenings.curvature[lag], row) for lag, row in close)) * z.size()
        for ((lag, row), targets), reach, extra in zip(close.items(), support, bounds.entries(), strict=True):
            disturbance, fraction = tightenings.disturbed[lag][row], self._share(share, k, lag)
            for target in targets:
                tightening, clearance = reach + extra + disturbance, target.clearance
                if not clearance - tightening >= fraction * target.total:  # all of it can be had more exactly
                    rows = rows_of(tightenings.carried[lag], row)
                    reach = sums((rows * z.c).entries(), z.spread(rows))[0]
                    tightening = reach + intersamples.next_to(lag)[row] + disturbance
                context = f"the set at {self.time(k)}, {target.name} at t = {self.time(k + lag)}"
                context += " under the safety controller"
                require(
                    "recoverable",
                    clearance - tightening,
                    f"{context}: needs {plain(tightening)}, available {plain(clearance)}",
                )
                self._leaves(fraction, target, tightening, context)

    def check_far(self) -> None:
        """Check the limits beyond the settling horizon for every set."""
        tightening = sums(self.tightenings.after_settling, self.tightenings.disturbed[-1])
        for cell in range(self._far_cell(0), len(self.limits.targets)):
            for i, targets in enumerate(self.limits.targets[cell]):
                for t in (*targets, *(self.levels[-1] if self.levels else ())):
                    if tightening[t.row] <= t.clearance:
                        continue
                    at = self.time(cell * self.document.q + i)
                    context = f"errors forgotten by the loop, {t.name} at t = {at}"
                    text = f"{context}: needs {plain(tightening[t.row])}, available {plain(t.clearance)}"
                    require("recoverable", t.clearance - tightening[t.row], text)
