"""All constraints of an inspection problem as rows in one fixed order: whom each concerns, its formula."""

from collections.abc import Callable, Collection
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...model.errors import ScenarioError
from ...model.system import Array
from ..closest import ClosestApproach
from ..inspection import Inspection
from .allowable_set import FAMILIES
from .barriers import Barrier, Braking, Radial, SunCone
from .passive import Passive, PassiveSegments
from .speeds import Speed, SpeedInSquares, Velocity, VelocitySide

Index = NDArray[np.intp]


class _Member(NamedTuple):
    """A constraint of all deputies or pairs: what it is called behind ``h``, its places, its parameters."""

    family: str
    number: str
    places: Index
    values: tuple[float, ...]


Formula = tuple[Callable[..., Barrier], list[_Member]]


@dataclass(frozen=True, eq=False)
class Group:
    """Constraints of one formula: where they are in the stack (see `Table.stack`), and their rows.

    The places are a slice if they follow each other: a view is quicker than a copy.
    """

    barrier: Barrier
    at: Index | slice
    rows: slice


def _formulas(q: Inspection, approach: ClosestApproach, sampled: bool, beyond: float) -> list[Formula]:
    """The formulas, from columns of parameters, and the constraints that have them."""
    alone, pairs = np.arange(q.deputies), q.deputies + np.arange(len(q.pairs))
    braking = partial(Braking, depth=q.smoothing, back=q.return_speed)
    speed, velocity = (SpeedInSquares, VelocitySide) if sampled else (Speed, Velocity)

    def passive(radius: Array) -> Barrier:
        return PassiveSegments(radius, approach) if sampled else Passive(radius, approach, beyond)

    spheres = [
        _Member("chief_separation", "1", alone, (q.separation, q.a_max, 1.0)),
        _Member("deputy_separation", "2", pairs, (q.deputy_separation, 2 * q.a_max, 1.0)),
        _Member("keep_in", "6", alone, (q.distance_max, q.a_inside, -1.0)),
    ]
    cones = [
        _Member("sun", "4", alone, (q.a_max, 1.0)),
        _Member("deputy_sun", "5+", pairs, (q.a_max, 1.0)),
        _Member("deputy_sun", "5-", pairs, (q.a_max, -1.0)),
    ]
    axes = [_Member("velocity", str(9 + axis), alone, (axis,)) for axis in range(3)]
    flights = [
        _Member("passive", "7", alone, (q.separation,)),
        _Member("deputy_passive", "8", pairs, (q.deputy_separation,)),
    ]
    return [
        (lambda radius, a, side: Radial(radius, braking(a), side), spheres),
        (lambda a, side: SunCone(q.field_of_view / 2, q.mean_motion, braking(a), side), cones),
        (passive, flights),
        (lambda: speed(q.docking_speed, q.nu_1), [_Member("speed", "3", alone, ())]),
        (lambda axis: velocity(axis.astype(np.intp), q.speed_max), axes),
    ]


class Table:
    """The constraints of all deputies and pairs, in one fixed order of M rows.

    Families `without` are left out; `approach` and `beyond` are as in `Passive`. Where they are `sampled`,
    barriers have the forms that bound their curvature.


    Attributes
    ----------
    labels, family : tuple of str, length M
        Of each row: its name, as in ``h1[2]`` or ``h5+[0,3]`` (``5+`` and ``5-`` are the two cones of a
        pair), and its family.
    first, second : ndarray of int, shape (M,)
        The deputies a row concerns; second is -1 where there is one only.
    place : ndarray of int, shape (M,)
        Where each is in the stack; `everyone` (N + P, 2) are the deputies of all places.
    """

    def __init__(
        self,
        inspection: Inspection,
        without: Collection[str],
        approach: ClosestApproach,
        sampled: bool,
        beyond: float,
    ) -> None:
        for name in without:
            if name not in FAMILIES:
                raise ScenarioError("without", name, f"must be one of {', '.join(FAMILIES)}")
        self.inspection = inspection
        alone = np.arange(inspection.deputies)
        self.everyone = np.concatenate([np.stack([alone, np.full_like(alone, -1)], axis=1), inspection.pairs])
        self.groups: list[Group] = []
        rows: list[tuple[str, str, np.intp]] = []
        for make, members in _formulas(inspection, approach, sampled, beyond):
            kept = [m for m in members if m.family not in without and len(m.places)]
            if not kept:
                continue
            size = [len(m.places) for m in kept]
            columns = zip(*(m.values for m in kept), strict=True)
            barrier = make(*(np.repeat(column, size) for column in columns))
            place = np.concatenate([m.places for m in kept])
            straight = np.array_equal(place, np.arange(place[0], place[-1] + 1))
            at = slice(int(place[0]), int(place[-1]) + 1) if straight else place
            of_each = ((m.family, f"h{m.number}", k) for m in kept for k in m.places)
            start = len(rows)
            rows += [row for row in of_each for _ in range(barrier.repeat)]
            self.groups.append(Group(barrier, at, slice(start, len(rows))))
        if not rows:
            raise ScenarioError("without", sorted(without), "must leave a constraint")
        self.family = tuple(family for family, _, _ in rows)
        self.place = np.array([place for _, _, place in rows])
        self.first, self.second = np.ascontiguousarray(self.everyone[self.place].T)
        self.labels = tuple(
            f"{number}[{i},{j}]" if j >= 0 else f"{number}[{i}]"
            for (_, number, _), i, j in zip(rows, self.first, self.second, strict=True)
        )

    def among(self, *families: str) -> NDArray[np.bool_]:
        """Which rows are of some families, shape (M,)."""
        return np.isin(self.family, families)

    def stack(self, x: Array) -> Array:
        """What the deputies have, then each pair relative to each other: (..., N, d) to (..., N + P, d)."""
        if self.inspection.deputies == 1:
            return x
        first, second = self.inspection.pairs.T
        return np.concatenate([x, x.take(first, axis=-2) - x.take(second, axis=-2)], axis=-2)

    def relative(self, x: Array) -> Array:
        """State or input that each row is about, shape (..., M, d), of those of the deputies (..., N, d)."""
        return self.stack(x).take(self.place, axis=-2)
