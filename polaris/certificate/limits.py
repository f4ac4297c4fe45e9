"""Everything the safety controller must keep to: facets of unsafe sets, and the thrusters' limits."""

from __future__ import annotations

from dataclasses import dataclass, replace

from flint import arb, arb_mat

from .balls import above, largest, magnitude, matrix
from .document import Document
from .loop import Needs
from .path import Path


@dataclass(frozen=True)
class Target:
    """One limit at one node.

    Attributes
    ----------
    row : int
        Which of the rows.
    room : arb
        What there is for errors.
    name : str
        Unsafe set or input.
    whole : arb
        The room before a jump of the reference took its part: what shares refer to.
    """

    row: int
    room: arb
    name: str
    whole: arb


@dataclass(frozen=True, eq=False)
class Barrier:
    """The separating facets of one cell.

    Attributes
    ----------
    names : list of str
        Of the unsafe sets.
    rows : arb_mat, shape (o, n)
        ``-n C``: an error e, about a path, is separate if ``row e`` is less than the path's room.
    offsets : list of (arb, arb)
        Of the facets, at the start and the end of the cell.
    """

    names: list[str]
    rows: arb_mat
    offsets: list[tuple[arb, arb]]

    @classmethod
    def of(cls, document: Document, position: arb_mat, cell: int, chosen: list[int]) -> Barrier:
        """Some facets, one of every unsafe set, in a cell; beyond the last one sets are as at its end."""
        sets = document.unsafe
        normals = [item.normals[f] for item, f in zip(sets, chosen, strict=True)]
        rows = -(matrix(normals) * position) if normals else arb_mat(0, position.ncols())
        ends = [
            (item.start[cell], item.end[cell]) if cell < document.cells else (item.end[-1], item.end[-1])
            for item in sets
        ]
        offsets = [(arb(a[f]), arb(b[f])) for (a, b), f in zip(ends, chosen, strict=True)]
        return cls([item.name for item in sets], rows, offsets)


@dataclass(frozen=True, eq=False)
class Limits:
    """Limits of every cell: distinct rows, and the room along them at the nodes.

    Attributes
    ----------
    rows : arb_mat, shape (r, n)
        An error e keeps to a limit if ``row e <= room``.
    targets : list (cells) of list (q + 1) of list of Target
        A limit that need not be met at a node is missing there.
    """

    rows: arb_mat
    targets: list[list[list[Target]]]

    @classmethod
    def of(cls, document: Document, path: Path, gain: arb_mat, chosen: list[list[int]]) -> Limits:
        """Limits around a path, with one facet per cell and unsafe set."""
        plant, q = path.kinematics.plant, path.kinematics.q
        sets = document.unsafe
        pairs = sorted({(o, row[o]) for row in chosen for o in range(len(sets))})
        index = {pair: i for i, pair in enumerate(pairs)}
        normals = [sets[o].normals[f] for o, f in pairs]
        facets = -(matrix(normals) * plant.C) if normals else arb_mat(0, plant.C.ncols())
        rows, m = above(facets, gain, -gain), gain.nrows()
        inputs = document.input_names * 2
        targets = []
        for cell, (arc, u) in enumerate(zip(path.arcs, path.inputs, strict=True)):
            barrier = Barrier.of(document, plant.C, cell, chosen[cell])
            places = [index[o, f] for o, f in enumerate(chosen[cell])]
            room = path.kinematics.room(barrier.rows, barrier.offsets, arc)
            thrust = [top + x for top, x in zip(plant.u_max, u.entries(), strict=True)]
            thrust += [top - x for top, x in zip(plant.u_max, u.entries(), strict=True)]
            nodes = []
            for i in range(q + 1):
                met = [
                    Target(p, r, name, r) for p, r, name in zip(places, room[i], barrier.names, strict=True)
                ]
                if i < q or not plant.sampled:  # a held input is renewed at the end of its period
                    met += [Target(len(pairs) + j, thrust[j], inputs[j], thrust[j]) for j in range(2 * m)]
                nodes.append(met)
            targets.append(nodes)
        return cls(rows, targets)

    def less_jump(self, needs: Needs, path: Path) -> Limits:
        """The same limits, the tail's reduced by what the jump at its start needs."""
        if path.cells == path.planned:
            return self
        q, last = path.kinematics.q, needs.memory.periods
        size = magnitude(path.jump)
        cost = [
            ((magnitude(row) + bend) * size).entries()
            for row, bend in zip(needs.carried, needs.bend, strict=True)
        ]
        share = largest(a / b for a, b in zip(size.entries(), needs.memory.z.entries(), strict=True))
        late = [x * share for x in needs.forgotten]
        targets = self.targets[: path.planned]
        for tail, nodes in enumerate(self.targets[path.planned :]):
            reduced = []
            for i, met in enumerate(nodes):
                lag = tail * q + i
                spent = cost[lag] if lag <= last else late
                reduced.append([replace(t, room=(t.room - spent[t.row]).lower()) for t in met])
            targets = [*targets, reduced]
        return Limits(self.rows, targets)

    def at(self, node: int, first: bool) -> list[Target]:
        """Limits at a node of the grid: of the cell on its right and, unless it is the first, on its left."""
        q = len(self.targets[0]) - 1
        cell, place = divmod(node, q)
        met = list(self.targets[cell][place]) if cell < len(self.targets) else []
        if place == 0 and cell > 0 and not first:
            met += self.targets[cell - 1][q]
        return met
