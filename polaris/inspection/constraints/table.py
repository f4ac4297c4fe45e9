"""All constraints of an inspection problem as rows in one fixed order: whom each concerns, its formula."""

from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...model.checks import one_of
from ...model.errors import ScenarioError
from ...model.system import Array
from ..closest import ClosestApproach
from ..inspection import Inspection
from .barriers import Braking, Radial, SunCone
from .constraint import Constraint, Printed
from .passive import Passive
from .speeds import Speed, Velocity
from .strengthening import FAMILIES

Index = NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class ConstraintGroup:
    """Constraints of one formula: where they are in the stack (see `ConstraintTable.stack`), and their rows.

    The places are a slice if they follow each other: a view is quicker than a copy.
    """

    barrier: Constraint
    at: Index | slice
    rows: slice


def printed(q: Inspection, approach: ClosestApproach | None = None, beyond: float = np.inf) -> list[Printed]:
    """Return the paper's constraints; those on free flights only with their closest `approach`."""
    braking = partial(Braking, depth=q.smoothing, back=q.return_speed)
    cone = partial(SunCone, q.field_of_view / 2, q.mean_motion, braking(q.a_max))
    constraints: list[Printed] = [
        Radial(q.separation, braking(q.a_max), 1.0, label="phi1"),
        Radial(q.deputy_separation, braking(2 * q.a_max), 1.0, label="phi2"),
        Radial(q.distance_max, braking(q.a_inside), -1.0, label="phi6"),
        cone(1.0, label="phi4"),
        cone(1.0, label="phi5"),
        cone(-1.0, label="phi5"),
    ]
    if approach is not None:
        constraints.append(Passive(q.separation, approach, beyond, label="phi7"))
        constraints.append(Passive(q.deputy_separation, approach, beyond, label="phi8"))
    constraints.append(Speed(q.docking_speed, q.nu_1, label="phi3"))
    return constraints + [Velocity(axis, q.speed_max, label=f"phi{9 + axis}") for axis in range(3)]


class ConstraintTable:
    """The constraints of all deputies and pairs, in one fixed order of M rows: the paper's, then one's own.

    Families `without` are left out, free flights also where no `approach` is given; it and `beyond` are as in
    `Passive`. Where they are `sampled`, barriers have the forms that bound their curvature.

    Attributes
    ----------
    constraints : tuple of Constraint, length M
        Of each row.
    labels, family : tuple of str, length M
        Of each row: its name, as in ``h1[2]`` or ``h5+[0,3]`` (``5+`` and ``5-`` are the two cones of a
        pair), and its family.
    first, second : ndarray of int, shape (M,)
        The deputies a row concerns; second is -1 where there is one only.
    place : ndarray of int, shape (M,)
        Place of each in the stack; `everyone` (N + P, 2) are the deputies of all places.
    known : int
        Number of rows that are the paper's.
    """

    def __init__(
        self,
        inspection: Inspection,
        without: Collection[str],
        approach: ClosestApproach | None = None,
        sampled: bool = False,
        beyond: float = np.inf,
    ) -> None:
        custom = inspection.constraints
        families = (*FAMILIES, *(one.family or one.label for one in custom))
        if isinstance(without, str) or not isinstance(without, Collection):
            raise ScenarioError("without", without, "must be a collection of names of families")
        for name in without:
            one_of("without", name, families)
        self.inspection = inspection
        alone = np.arange(inspection.deputies)
        self.everyone = np.concatenate([np.stack([alone, np.full_like(alone, -1)], axis=1), inspection.pairs])
        self.groups: list[ConstraintGroup] = []
        self._rows: list[tuple[Constraint, int]] = []
        by_type: dict[type, list[Constraint]] = {}
        for one in printed(inspection, approach, beyond):
            by_type.setdefault(type(one), []).append(one)
        for members in by_type.values():
            self._add([one.sampled() if sampled else one for one in members if one.family not in without])
        self.printed = len(self._rows)
        for single in custom:
            if (single.family or single.label) not in without:
                self._add([single.sampled() if sampled else single])
        if not self._rows:
            raise ScenarioError("without", sorted(without), "must leave a constraint")
        self.constraints = tuple(one for one, _ in self._rows)
        self.family = tuple(one.family or one.label for one in self.constraints)
        self.place = np.array([place for _, place in self._rows])
        self.first, self.second = np.ascontiguousarray(self.everyone[self.place].T)
        self.labels = tuple(
            f"{one.row}[{i},{j}]" if j >= 0 else f"{one.row}[{i}]"
            for one, i, j in zip(self.constraints, self.first, self.second, strict=True)
        )

    def _add(self, members: list[Constraint]) -> None:
        """Add the rows of constraints of one formula."""
        N, P = self.inspection.deputies, len(self.inspection.pairs)
        ranges = [np.arange(N, N + P) if one.pair else np.arange(N) for one in members]
        if not (size := [len(places) for places in ranges if len(places)]):
            return
        members = [one for one, places in zip(members, ranges, strict=True) if len(places)]
        place, barrier = np.concatenate(ranges), members[0]
        if isinstance(barrier, Printed):
            columns = {
                name: _column([getattr(one, name) for one in members], size) for name in barrier.COLUMNS
            }
            barrier = replace(barrier, **columns)
        contiguous = np.array_equal(place, np.arange(place[0], place[-1] + 1))
        at = slice(int(place[0]), int(place[-1]) + 1) if contiguous else place
        start = len(self._rows)
        of_each = [one for one, count in zip(members, size, strict=True) for _ in range(count)]
        for one, k in zip(of_each, place.tolist(), strict=True):
            self._rows += [(one, k)] * barrier.repeat
        self.groups.append(ConstraintGroup(barrier, at, slice(start, len(self._rows))))

    def among(self, *families: str) -> NDArray[np.bool_]:
        """Return True for each row of some families, shape (M,)."""
        return np.isin(self.family, families)

    def stack(self, x: Array) -> Array:
        """Stack (..., N, d) of the deputies, then of each pair, relative to each other: (..., N + P, d)."""
        if self.inspection.deputies == 1:
            return x
        first, second = self.inspection.pairs.T
        return np.concatenate([x, x.take(first, axis=-2) - x.take(second, axis=-2)], axis=-2)

    def relative(self, x: Array) -> Array:
        """State or input that each row is about, shape (..., M, d), of those of the deputies (..., N, d)."""
        return self.stack(x).take(self.place, axis=-2)


def _column(values: list[Any], size: list[int]) -> Any:
    """Repeat the value of each group for its rows, `size` many."""
    if isinstance(values[0], Braking):
        return replace(values[0], acceleration=_column([one.acceleration for one in values], size))
    return np.repeat(values, size)
