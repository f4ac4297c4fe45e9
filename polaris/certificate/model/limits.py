"""Limits that errors about the reference keep to: facets of unsafe sets, and the thrusters'."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

from flint import arb, arb_mat

from ..files.document import Document
from ..files.entries import UnsafeSet
from ..kernel.arcs import Path
from ..kernel.balls import TINY, above, magnitude, sums
from ..kernel.zonotopes import Directions
from .craft.craft import Craft
from .craft.feedforward import Along
from .craft.tightening import Tightening

SPARE = 1e-12  # of clearances in doubles, far above their rounding: within it nothing counts as met


@dataclass(frozen=True)
class NodeLimit:
    """One limit at one node."""

    row: int  # which of the rows
    clearance: arb  # what there is for errors
    name: str  # unsafe set or input
    total: arb  # the clearance before a jump of the reference took its part: what shares refer to

    def less(self, tightening: arb) -> NodeLimit:
        """Return the limit with less clearance."""
        return NodeLimit(self.row, (self.clearance - tightening).lower(), self.name, self.total)

    @cached_property
    def least(self) -> tuple[int, float, float]:
        """Row, clearance and whole in doubles; the clearance less a rounding allowance."""
        clearance, whole = float(self.clearance.lower()), float(self.total.upper())
        return self.row, clearance - SPARE * (abs(clearance) + abs(whole)) - TINY, whole


@dataclass(frozen=True, eq=False)
class Barrier:
    """The separating facets of one cell."""

    names: list[str]  # of the unsafe sets
    rows: Directions  # -n C: an error e, about a path, is separate if row e is less than the path's clearance
    offsets: list[tuple[arb, arb]]  # of the facets, at the start and the end of the cell

    @classmethod
    def for_cell(
        cls, document: Document, position: arb_mat, cell: int, chosen: list[int], saved: dict[Any, Directions]
    ) -> Barrier:
        """Some facets, one of every unsafe set, in a cell; beyond the last one sets are as at its end.

        Rows that were `saved` are the same object for the same facets.
        """
        facets = list(zip(document.unsafe, chosen, strict=True))
        if (key := tuple(chosen)) not in saved:
            saved[key] = Directions(_against(facets, position))
        ends = [
            (item.start[cell][f], item.end[cell][f]) if cell < document.cells else (item.end[-1][f],) * 2
            for item, f in facets
        ]
        return cls([item.name for item, _ in facets], saved[key], [(arb(a), arb(b)) for a, b in ends])


def _against(facets: list[tuple[UnsafeSet, int]], position: arb_mat) -> arb_mat:
    """``-n C`` of some facets, maybe none, ``-n`` of sets of states."""
    rows = [item.rows(position, [f]) for item, f in facets]
    return -above(*rows) if rows else arb_mat(0, position.ncols())


@dataclass(frozen=True, eq=False)
class Limits:
    """Limits of every cell: distinct rows, and the clearance along them at the nodes."""

    rows: arb_mat  # an error e keeps to a limit if row e <= clearance
    targets: list[list[list[NodeLimit]]]  # [cell][node]; one that need not be met at a node is missing there

    @classmethod
    def for_path(cls, document: Document, path: Path, craft: Craft, chosen: list[list[int]]) -> Limits:
        """Limits around a path, with one facet per cell and unsafe set."""
        plant = path.plant
        pairs = sorted({(o, f) for row in chosen for o, f in enumerate(row)})
        index = {pair: i for i, pair in enumerate(pairs)}
        facets = _against([(document.unsafe[o], f) for o, f in pairs], plant.C)
        targets, saved = [], dict[Any, Directions]()
        for cell, arc in enumerate(path.arcs):
            barrier = Barrier.for_cell(document, plant.C, cell, chosen[cell], saved)
            error = craft.noise_in(document, cell) * 2
            thrust = sums(plant.u_max * 2, above(arc.u, -arc.u).entries(), [-x for x in error])
            inputs = [
                NodeLimit(len(pairs) + j, clearance, name, clearance)
                for j, (clearance, name) in enumerate(zip(thrust, document.input_names * 2, strict=True))
            ]
            nodes = []
            for i, clearances in enumerate(arc.clearance(barrier.rows.M, barrier.offsets)):
                limits = [
                    NodeLimit(index[o, f], clearance, barrier.names[o], clearance)
                    for o, (f, clearance) in enumerate(zip(chosen[cell], clearances, strict=True))
                ]
                # A held input is renewed at the end of its period.
                nodes.append(limits + inputs if i < plant.q else limits)
            targets.append(nodes)
        return cls(above(craft.pad(facets), craft.commands, -craft.commands), targets)

    def less_jump(self, tightenings: Tightening, path: Path) -> Limits:
        """Return the limits, the tail's tightened by the jump at its start."""
        size = magnitude(path.jump)
        by_lag, final = (
            [tightenings.boxed(size, lag) for lag in range(len(tightenings.carried))],
            tightenings.tightening_after_settling(size),
        )
        targets = self.targets[: path.planned]
        for tail, nodes in enumerate(self.targets[path.planned :]):
            reduced = []
            for i, limits in enumerate(nodes):
                lag = tail * path.plant.q + i
                tightening = by_lag[lag] if lag <= tightenings.settling.periods else final
                reduced.append([t.less(tightening[t.row]) for t in limits])
            targets.append(reduced)
        return Limits(self.rows, targets)

    def less(self, tightening: Along) -> Limits:
        """Return the limits, each tightened along its row by the tightening of its node."""
        targets = [
            [[t.less(by_row[t.row]) for t in limits] for limits, by_row in zip(*cell, strict=True)]
            for cell in zip(self.targets, tightening, strict=True)
        ]
        return Limits(self.rows, targets)

    def at_node(self, node: int, first: bool) -> list[NodeLimit]:
        """Limits at a node of the grid: of the cell on its right and, unless it is the first, on its left."""
        q = len(self.targets[0]) - 1
        cell, place = divmod(node, q)
        limits = list(self.targets[cell][place]) if cell < len(self.targets) else []
        if place == 0 and cell > 0 and not first:
            limits += self.targets[cell - 1][q]
        return limits


def levels_of(document: Document, tightenings: Tightening, path: Path) -> list[list[NodeLimit]]:
    """Return the feedback bound as limits on commands l periods after a hand-over, for any clearance."""
    noise = tightenings.craft.noise(tightenings.craft.lag_error(tightenings.craft.plant.u_max))
    first = tightenings.rows.nrows() - 2 * len(noise)
    jumps = tightenings.tightening_at_any_time(magnitude(path.jump))[first:]
    names = [f"{name} that errors are booked for" for name in document.input_names * 2]
    return [
        [
            NodeLimit(first + j, (top - noise[j % len(noise)] - jumps[j]).lower(), names[j], arb(0))
            for j, top in enumerate(map(arb, commands * 2))
        ]
        for commands in document.feedback_bound
    ]
