"""Recoverability: from the set reached at a switch, the safety controller keeps to every limit to the end.

The limits are facets of unsafe sets, and the thrusters'.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

from flint import arb, arb_mat

from .arcs import Path
from .balls import TINY, above, beside, largest, magnitude, matrix, plain, require, row_of, spans, sums
from .document import Document
from .loop import Needs
from .scheduled import Along
from .verdict import Rejected
from .zonotopes import Zonotope


@dataclass(frozen=True)
class Target:
    """One limit at one node."""

    row: int  # which of the rows
    room: arb  # what there is for errors
    name: str  # unsafe set or input
    whole: arb  # the room before a jump of the reference took its part: what shares refer to

    def less(self, taken: arb) -> Target:
        """The same with less room."""
        return Target(self.row, (self.room - taken).lower(), self.name, self.whole)

    @cached_property
    def least(self) -> tuple[int, float, float]:
        """Row, room and whole in doubles; the room less what rounding may do to them and to needs."""
        room, whole = float(self.room.lower()), float(self.whole.upper())
        return self.row, room - SPARE * (abs(room) + abs(whole)) - TINY, whole


@dataclass(frozen=True, eq=False)
class Barrier:
    """The separating facets of one cell."""

    names: list[str]  # of the unsafe sets
    rows: arb_mat  # -n C: an error e, about a path, is separate if row e is less than the path's room
    offsets: list[tuple[arb, arb]]  # of the facets, at the start and the end of the cell

    @classmethod
    def of(cls, document: Document, position: arb_mat, cell: int, chosen: list[int]) -> Barrier:
        """Some facets, one of every unsafe set, in a cell; beyond the last one sets are as at its end."""
        facets = list(zip(document.unsafe, chosen, strict=True))
        rows = _against([item.normals[f] for item, f in facets], position)
        ends = [
            (item.start[cell][f], item.end[cell][f]) if cell < document.cells else (item.end[-1][f],) * 2
            for item, f in facets
        ]
        return cls([item.name for item, _ in facets], rows, [(arb(a), arb(b)) for a, b in ends])


def _against(normals: list[list[float]], position: arb_mat) -> arb_mat:
    """``-n C`` of some normals, maybe none."""
    return -(matrix(normals) * position) if normals else arb_mat(0, position.ncols())


@dataclass(frozen=True, eq=False)
class Limits:
    """Limits of every cell: distinct rows, and the room along them at the nodes."""

    rows: arb_mat  # an error e keeps to a limit if row e <= room
    targets: list[list[list[Target]]]  # [cell][node]; one that need not be met at a node is missing there

    @classmethod
    def of(cls, document: Document, path: Path, gain: arb_mat, chosen: list[list[int]]) -> Limits:
        """Limits around a path, with one facet per cell and unsafe set."""
        plant = path.plant
        pairs = sorted({(o, f) for row in chosen for o, f in enumerate(row)})
        index = {pair: i for i, pair in enumerate(pairs)}
        facets = _against([document.unsafe[o].normals[f] for o, f in pairs], plant.C)
        targets = []
        for cell, arc in enumerate(path.arcs):
            barrier = Barrier.of(document, plant.C, cell, chosen[cell])
            error = replace(plant, estimate=tuple(document.known_to(cell))).command_error(gain) * 2
            thrust = sums(plant.u_max * 2, above(arc.u, -arc.u).entries(), [-x for x in error])
            inputs = [
                Target(len(pairs) + j, room, name, room)
                for j, (room, name) in enumerate(zip(thrust, document.input_names * 2, strict=True))
            ]
            nodes = []
            for i, rooms in enumerate(arc.room(barrier.rows, barrier.offsets)):
                met = [
                    Target(index[o, f], room, barrier.names[o], room)
                    for o, (f, room) in enumerate(zip(chosen[cell], rooms, strict=True))
                ]
                # A held input is renewed at the end of its period.
                nodes.append(met + inputs if i < plant.q or not plant.sampled else met)
            targets.append(nodes)
        return cls(above(facets, gain, -gain), targets)

    def less_jump(self, needs: Needs, path: Path) -> Limits:
        """The same limits, the tail's reduced by what the jump at its start needs."""
        size = magnitude(path.jump)
        cost, late = [needs.boxed(size, lag) for lag in range(len(needs.carried))], needs.still(size)
        targets = self.targets[: path.planned]
        for tail, nodes in enumerate(self.targets[path.planned :]):
            reduced = []
            for i, met in enumerate(nodes):
                lag = tail * path.plant.q + i
                spent = cost[lag] if lag <= needs.memory.periods else late
                reduced.append([t.less(spent[t.row]) for t in met])
            targets.append(reduced)
        return Limits(self.rows, targets)

    def less(self, taken: Along) -> Limits:
        """The same limits, each reduced by what is taken of it at its node, along its row."""
        targets = [
            [[t.less(at[t.row]) for t in met] for met, at in zip(*cell, strict=True)]
            for cell in zip(self.targets, taken, strict=True)
        ]
        return Limits(self.rows, targets)

    def at(self, node: int, first: bool) -> list[Target]:
        """Limits at a node of the grid: of the cell on its right and, unless it is the first, on its left."""
        q = len(self.targets[0]) - 1
        cell, place = divmod(node, q)
        met = list(self.targets[cell][place]) if cell < len(self.targets) else []
        if place == 0 and cell > 0 and not first:
            met += self.targets[cell - 1][q]
        return met


def levels_of(document: Document, noise: list[arb], needs: Needs, path: Path) -> list[list[Target]]:
    """The profile of commands as limits l periods after a hand-over, whatever is left of their room."""
    size, count = magnitude(path.jump), 2 * len(noise)
    first = needs.rows.nrows() - count
    costs = [*(needs.boxed(size, lag) for lag in range(len(needs.carried))), needs.still(size)]
    jumps = list(map(largest, zip(*costs, strict=True)))[first:]
    names = [f"{name} that errors are booked for" for name in document.input_names * 2]
    return [
        [
            Target(first + j, (top - noise[j % len(noise)] - jumps[j]).lower(), names[j], arb(0))
            for j, top in enumerate(map(arb, most * 2))
        ]
        for most in document.profile
    ]


@dataclass(frozen=True, eq=False)
class Recovery:
    """Limits, reduced by the jump at the start of the tail, against needs along their rows."""

    document: Document
    limits: Limits
    needs: Needs
    levels: list[list[Target]] = field(default_factory=list)
    """What feedback may command l periods after a hand-over; the last ones hold from then on."""

    @property
    def nodes(self) -> int:
        """Number of the last node."""
        return self.document.q * len(self.limits.targets)

    def time(self, node: int) -> str:
        """Time of a node, for messages."""
        return f"{node / self.document.q * self.document.delta:.6g} s"

    def lags(self, node: int) -> int:
        """Number of periods after a node that are looked at one by one."""
        return min(self.needs.memory.periods, self.nodes - node)

    @cached_property
    def _least(self) -> list[dict[int, Target]]:
        """For every cell the limit of least room, by row, among those of that cell and all later ones."""
        found: list[dict[int, Target]] = [{}]
        for nodes in reversed(self.limits.targets[: self.document.cells]):
            least = dict(found[-1])
            for target in (target for met in nodes for target in met):
                if target.row not in least or not least[target.row].room <= target.room:
                    least[target.row] = target
            found.append(least)
        return found[::-1]

    def _far_cell(self, node: int) -> int:
        """First cell whose limits lie beyond the memory, seen from a node."""
        doc = self.document
        most = doc.steps if doc.horizon == "infinite" else doc.cells  # all of a tail that repeats lies ahead
        return min(node // doc.q + self.needs.memory.periods // doc.q, most)

    def check_sets(self, reached: dict[int, Zonotope], margins: dict[int, float]) -> float:
        """Check that each set is recoverable, and inside by the share of the room that is claimed.

        `reached` are sets of errors at nodes, `margins` shares of the room claimed to be left.
        A bound from the extents of the set comes first; only where it does not do, the exact support. Returns
        the least share found where that was needed; 1 if nowhere.
        """
        sizes = beside(*(reached[k].size() for k in sorted(reached)))
        worst = 1.0
        coarse = [
            [[float(x.abs_upper()) for x in row] for row in (spans(rows, sizes) + bend * sizes).tolist()]
            for rows, bend in zip(self.needs.carried, self.needs.bend, strict=True)
        ]
        for place, k in enumerate(sorted(reached)):
            share = max(margins.get(k, 0.0), 0.0)
            close: dict[tuple[int, int], list[Target]] = {}
            for lag in range(self.lags(k) + 1):
                of, most, more = self._of(share, k, lag), coarse[lag], self._disturbed[lag]
                for target in self._all(k, lag):
                    row, room, whole = target.least
                    if not most[row][place] + more[row] <= room - of * whole:
                        close.setdefault((lag, row), []).append(target)
            if close:
                worst = min(worst, self._check_close(k, reached[k], close, share))
            if share > 0:
                self._check_late(k, reached[k], share)
        return worst

    @cached_property
    def _disturbed(self) -> list[list[float]]:
        return [[float(x.abs_upper()) for x in each] for each in self.needs.disturbed]

    def _all(self, node: int, lag: int) -> list[Target]:
        """Limits that a set at a node must keep to some periods later."""
        booked = self.levels[min(lag, len(self.levels) - 1)] if self.levels else []
        return self.limits.at(node + lag, first=lag == 0) + booked

    def _of(self, share: float, node: int, lag: int) -> float:
        """The share claimed of limits some periods after a node: none of those flown on to."""
        return share if node + lag <= self.document.cells * self.document.q else 0.0

    def _check_late(self, k: int, z: Zonotope, share: float) -> None:
        """The share claimed at a set is left of all limits beyond the memory, too."""
        late = self.needs.still(z.size())
        for row, target in self._least[self._far_cell(k)].items():
            need = late[row] + self.needs.disturbed[-1][row]
            where = f"the set at {self.time(k)}, {target.name} beyond the memory of the loop"
            self._leaves(share, target, need, where)

    def _leaves(self, share: float, target: Target, need: arb, where: str) -> None:
        """A need, that of a jump included, leaves a share of the room, up to rounding of the stored share."""
        room, whole = target.room, target.whole
        if not room - need >= share * whole * (1 - MARGIN_SLACK) - whole * MARGIN_SLACK:
            left = float(((room - need) / whole).mid()) if room > 0 else 0.0
            told = f"share {left:.6g} left, {share:.6g} claimed, for {where}"
            raise Rejected("margins", f"{told}: needs {plain(need)} of {plain(room)}", share - left)

    def _check_close(
        self, k: int, z: Zonotope, close: dict[tuple[int, int], list[Target]], share: float
    ) -> float:
        needs, worst = self.needs, 1.0
        support = z.support(above(*(row_of(needs.carried[lag], row) for lag, row in close)))
        booked = above(*(row_of(needs.bend[lag], row) for lag, row in close)) * z.size()
        for ((lag, row), targets), most, extra in zip(close.items(), support, booked.entries(), strict=True):
            disturbance, of = needs.disturbed[lag][row], self._of(share, k, lag)
            for target in targets:
                need, room = most + extra + disturbance, target.room
                if not room - need >= of * target.whole:  # all of it can be had more exactly
                    at = row_of(needs.carried[lag], row)
                    most = sums((at * z.c).entries(), z.spread(at))[0]
                    need = most + needs.booked(z, lag)[row] + disturbance
                where = f"the set at {self.time(k)}, {target.name} at t = {self.time(k + lag)}"
                where += " under the safety controller"
                require("recoverable", room - need, f"{where}: needs {plain(need)} of {plain(room)}")
                if target.whole > 0:
                    worst = min(worst, float(((room - need) / target.whole).lower()) if room > 0 else 0.0)
                self._leaves(of, target, need, where)
        return worst

    def check_far(self) -> None:
        """Check the limits beyond the memory of the loop, for every set within the memory's extent."""
        need = sums(self.needs.forgotten, self.needs.disturbed[-1])
        for cell in range(self._far_cell(0), len(self.limits.targets)):
            for i, met in enumerate(self.limits.targets[cell]):
                for t in (*met, *(self.levels[-1] if self.levels else ())):
                    if need[t.row] <= t.room:
                        continue
                    at = self.time(cell * self.document.q + i)
                    where = f"errors forgotten by the loop, {t.name} at t = {at}"
                    told = f"{where}: needs {plain(need[t.row])} of {plain(t.room)}"
                    require("recoverable", t.room - need[t.row], told)

    def check_balls(self, radii: list[float], inverse: arb_mat) -> None:
        """Check that every error of a step's ball ``norm(V e, 2) <= radius`` is recoverable."""
        per = self.needs.per_norm(inverse)
        coarse = [[float(x.abs_upper()) for x in each] for each in per]
        for step, radius in enumerate(radii):
            k = step * self.document.q
            for lag in range(self.lags(k) + 1) if radius > 0 else ():
                most, more = coarse[lag], self._disturbed[lag]
                for t in self._all(k, lag):
                    row, room, _ = t.least
                    if most[row] * radius + more[row] <= room:
                        continue
                    spare = t.room - self.needs.disturbed[lag][t.row] - per[lag][t.row] * radius
                    if not spare >= -MARGIN_SLACK * abs(t.room):
                        where = f"radius {radius:.6g} at {self.time(k)}, {t.name} at {self.time(k + lag)}"
                        require("recoverable_sets", spare, where)


SPARE = 1e-12
"""Of rooms in doubles, which tell where a need is certainly within: far above their rounding."""

MARGIN_SLACK = 1e-6
"""Slack of stored margins and radii, as a share of the room: they are results in double precision."""
