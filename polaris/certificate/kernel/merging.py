"""Choice of generators to merge: nearly parallel ones with each other, those next to an axis with the box."""

from __future__ import annotations

from collections.abc import Sequence
from math import hypot
from operator import add, sub
from typing import NamedTuple

NOTHING = 1e-8  # share of a set's extents that generators may come to which a box replaces in any case
ALIKE = 4  # next ones by direction that each generator is compared with: more take longer, and find no better
ROUND = 3  # part of the generators that go in one round, so that none is boxed for want of a partner
TINY = 1e-300  # length of generators that rows do not see

Column = Sequence[float]


class GeneratorGroup(NamedTuple):
    """Generators and their sum, each turned by its sign so that they point the same way."""

    members: tuple[int, ...]
    shares: tuple[float, ...]  # of each in the sum, negative for one that is turned
    column: Column  # what a box around the sum adds to extents along rows, by coordinate
    image: Column  # the sum along rows, in shares of the set's extents
    length: float  # of the image
    unit: Column  # the column for a length of one
    direction: float  # a number of the image, nearly the same for nearly parallel ones

    @classmethod
    def from_members(
        cls, members: tuple[int, ...], shares: tuple[float, ...], column: Column, image: Column
    ) -> GeneratorGroup:
        """Turn a sum so that the largest number of its image is positive."""
        if max(image, key=abs, default=0.0) < 0:
            shares = tuple(-a for a in shares)
            column, image = [-x for x in column], [-x for x in image]
        length = max(hypot(*image), TINY)
        direction = (sum(image[::2]) - sum(image[1::2])) / length
        return cls(members, shares, column, image, length, [x / length for x in column], direction)

    def boxed(self) -> float:
        """Return the growth of extents along rows if the box around the sum replaces it."""
        return sum(map(abs, self.column)) - sum(map(abs, self.image))

    def joined(self, other: GeneratorGroup) -> float:
        """Return the growth of extents along rows if both become one generator and a box of the rests."""
        distance: float = sum(map(abs, map(sub, self.unit, other.unit)))
        return 2 * distance * self.length * other.length / (self.length + other.length)

    def plus(self, other: GeneratorGroup) -> GeneratorGroup:
        """Return the group of both, of which each has a share by its length."""
        a, b = (each.length / (self.length + other.length) for each in (self, other))
        shares = *(a * x for x in self.shares), *(b * x for x in other.shares)
        column, image = map(add, self.column, other.column), map(add, self.image, other.image)
        return GeneratorGroup.from_members(self.members + other.members, shares, [*column], [*image])


def grouped(columns: Sequence[Column], images: Sequence[Column], limit: int) -> list[GeneratorGroup]:
    """Return at most so many groups of generators to be merged; a box is to replace all others.

    Columns are generators by coordinate, in shares of extents along rows that a box of that size adds; images
    are generators along the rows.
    """
    order = sorted(range(len(columns)), key=lambda j: -sum(map(abs, columns[j])))
    total = 0.0
    while order and (total := total + sum(map(abs, columns[order[-1]]))) <= NOTHING:
        order.pop()
    groups = [GeneratorGroup.from_members((j,), (1.0,), columns[j], images[j]) for j in order]
    while len(groups) > max(limit, 0):
        groups = _fewer(groups, min(len(groups) - max(limit, 0), len(groups) // ROUND + 1))
    return groups


def _fewer(groups: list[GeneratorGroup], surplus: int) -> list[GeneratorGroup]:
    """Drop or merge the groups with which least is lost, each at most once."""
    options = [(group.boxed(), i, i) for i, group in enumerate(groups)]
    order = sorted(range(len(groups)), key=lambda i: (groups[i].direction, i))
    for place, i in enumerate(order):
        options += [(groups[i].joined(groups[j]), i, j) for j in order[place + 1 : place + 1 + ALIKE]]
    merged, touched = list[GeneratorGroup](), set[int]()
    for _, i, j in sorted(options):
        if len(touched) - len(merged) == surplus:
            break
        if i not in touched and j not in touched:
            touched |= {i, j}
            merged += [groups[i].plus(groups[j])] if i != j else []
    return [group for i, group in enumerate(groups) if i not in touched] + merged
