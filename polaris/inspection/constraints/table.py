"""All constraints of an inspection problem as rows in one fixed order: whom each concerns, its formula."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ...model.errors import ScenarioError
from ...model.system import Array
from ..braking import Braking
from ..closest import ClosestApproach
from ..inspection import Inspection
from .barriers import Barrier, Radial, SunCone
from .catalogue import FAMILIES
from .passive import Passive, PassiveSegments
from .speeds import Speed, SpeedInSquares, Velocity, VelocitySide

Index = NDArray[np.intp]

_Member = tuple[str, str, Index, float, float, float]
"""Family, number of the constraint, places, and the parameters of the formula."""


@dataclass(frozen=True, eq=False)
class Group:
    """Constraints of one formula: a barrier with a parameter per place in the stack (`Table.stack`).

    Of each place: its family, what the constraint is called behind ``h`` or ``phi``, and as many rows as
    `repeat` says.
    """

    barrier: Barrier
    family: list[str]
    number: list[str]
    place: Index
    repeat: int = 1

    @cached_property
    def at(self) -> Index | slice:
        """The places as a slice if they follow each other: a view is quicker than a copy."""
        first, last = int(self.place[0]), int(self.place[-1])
        straight = np.array_equal(self.place, np.arange(first, last + 1))
        return slice(first, last + 1) if straight else self.place


def _groups(
    q: Inspection,
    without: Collection[str],
    approach: ClosestApproach | None,
    sampled: bool,
    beyond: float,
) -> list[Group]:
    """Stack what shares a formula; parameters as of `Table`."""
    alone, pairs = np.arange(q.deputies), q.deputies + np.arange(len(q.pairs))

    def stack(*members: _Member) -> tuple[tuple[list[str], list[str], Index], Array]:
        """Families, numbers and places of the members that are kept, and each of their three parameters."""
        kept = [member for member in members if member[0] not in without]
        family = [member[0] for member in kept for _ in member[2]]
        number = [member[1] for member in kept for _ in member[2]]
        place = np.concatenate([alone[:0], *(member[2] for member in kept)])
        values = np.array([member[3:] for member in kept for _ in member[2]], dtype=float)
        return (family, number, place), values.reshape(-1, 3).T

    rows, (radius, a, side) = stack(
        ("chief_separation", "1", alone, q.separation, q.a_max, 1.0),
        ("deputy_separation", "2", pairs, q.deputy_separation, 2 * q.a_max, 1.0),
        ("keep_in", "6", alone, q.distance_max, q.a_inside, -1.0),
    )
    groups = [Group(Radial(radius, Braking(a, q.smoothing, q.return_speed), side), *rows)]
    rows, (a, side, _) = stack(
        ("sun", "4", alone, q.a_max, 1.0, 0.0),
        ("deputy_sun", "5+", pairs, q.a_max, 1.0, 0.0),
        ("deputy_sun", "5-", pairs, q.a_max, -1.0, 0.0),
    )
    braking = Braking(a, q.smoothing, q.return_speed)
    groups.append(Group(SunCone(q.field_of_view / 2, q.mean_motion, braking, side), *rows))
    if approach is not None:
        rows, (radius, _, _) = stack(
            ("passive", "7", alone, q.separation, 0.0, 0.0),
            ("deputy_passive", "8", pairs, q.deputy_separation, 0.0, 0.0),
        )
        segments = PassiveSegments(radius, approach)
        flights: Barrier = segments if sampled else Passive(radius, approach, beyond)
        groups.append(Group(flights, *rows, repeat=segments.rows if sampled else 1))
    rows, _ = stack(("speed", "3", alone, 0.0, 0.0, 0.0))
    groups.append(Group((SpeedInSquares if sampled else Speed)(q.docking_speed, q.nu_1), *rows))
    rows, (axis, _, _) = stack(*(("velocity", str(9 + axis), alone, axis, 0.0, 0.0) for axis in range(3)))
    limit = VelocitySide if sampled else Velocity
    groups.append(Group(limit(axis.astype(np.intp), q.speed_max), *rows))
    return [group for group in groups if len(group.place)]


class Table:
    """The constraints of all deputies and pairs, in one fixed order of rows.

    Parameters
    ----------
    inspection : Inspection
    without : collection of str
        Families left out, of `FAMILIES`.
    approach : ClosestApproach, optional
        Of the free flights; without it those of `passive` and `deputy_passive` are left out.
    sampled : bool
        The forms of the barriers that bound their curvature.
    beyond : float
        See `Passive`.

    Attributes
    ----------
    family : tuple of str, length M
        Family of each row.
    number : tuple of str, length M
        Of each row, as in ``h5+``; ``5+`` and ``5-`` are the two cones of a pair.
    first, second : ndarray of int, shape (M,)
        The deputies a row concerns; second is -1 where there is one only.
    """

    def __init__(
        self,
        inspection: Inspection,
        without: Collection[str] = (),
        approach: ClosestApproach | None = None,
        sampled: bool = False,
        beyond: float = np.inf,
    ) -> None:
        for name in without:
            if name not in FAMILIES:
                raise ScenarioError("without", name, f"must be one of {', '.join(FAMILIES)}")
        q, self.approach = inspection, approach
        self.inspection = inspection
        self.groups = _groups(q, without, approach, sampled, beyond)
        if not self.groups:
            raise ScenarioError("without", sorted(without), "must leave a constraint")
        self.place = np.concatenate([np.repeat(group.place, group.repeat) for group in self.groups])
        self.family = tuple(name for g in self.groups for name in g.family for _ in range(g.repeat))
        self.number = tuple(name for g in self.groups for name in g.number for _ in range(g.repeat))
        alone = np.stack([np.arange(q.deputies), np.full(q.deputies, -1)], axis=1)
        self.everyone = np.concatenate([alone, q.pairs])
        self.first, self.second = self.everyone[self.place].T

    def names(self, letter: str) -> tuple[str, ...]:
        """Names of the rows: ``h1[2]``, ``h2[0,3]``, for a letter of h or phi."""
        return tuple(
            f"{letter}{number}[{i},{j}]" if j >= 0 else f"{letter}{number}[{i}]"
            for number, i, j in zip(self.number, self.first, self.second, strict=True)
        )

    def among(self, *families: str) -> NDArray[np.bool_]:
        """Which rows are of some families, shape (M,)."""
        return np.isin(self.family, families)

    def stack(self, x: Array) -> Array:
        """What the deputies have, then each pair relative to each other: (..., N, d) to (..., N + P, d)."""
        pairs = self.inspection.pairs
        return np.concatenate([x, x[..., pairs[:, 0], :] - x[..., pairs[:, 1], :]], axis=-2)

    def relative(self, x: Array) -> Array:
        """State or input that each row is about, shape (..., M, d), of those of the deputies (..., N, d)."""
        return np.asarray(self.stack(x)[..., self.place, :])
