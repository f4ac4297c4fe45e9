"""Choice of generators to merge: nearly parallel ones with each other, those next to an axis with the box."""

from collections.abc import Sequence
from math import copysign
from operator import mul
from typing import NamedTuple

NOTHING = 1e-8  # share of a set's extents that generators may come to which a box replaces in any case
ALIKE = 4  # next ones by direction that each generator is compared with: more take longer, and find no better
ROUND = 3  # part of the generators that go in one round, so that none is boxed for want of a partner

Column = Sequence[float]


class Group(NamedTuple):
    """Generators and their sum, aligned in sign."""

    members: tuple[int, ...]
    shares: tuple[float, ...]  # of each in the sum
    column: Column  # what a box around the sum adds to extents along rows, by coordinate
    image: Column  # the sum along rows, in shares of the set's extents
    square: float  # length of the image, squared

    @property
    def direction(self) -> float:
        """A number of either sign of the image, nearly the same for nearly parallel ones."""
        sign = 1.0 if max(self.image, key=abs, default=0.0) >= 0 else -1.0
        turned = sum(self.image[::2]) - sum(self.image[1::2])
        return sign * turned / self.square**0.5 if self.square > 0 else 0.0

    def boxed(self) -> float:
        """Return the growth of extents along rows if the box around the sum replaces it."""
        return sum(map(abs, self.column)) - sum(map(abs, self.image))

    def parts(self, other: "Group") -> tuple[float, float]:
        """Return the shares of both sums in their common one; that of the other is negative if opposed."""
        both = sum(map(mul, self.image, other.image))
        whole = self.square + 2 * abs(both) + other.square
        a = (self.square + abs(both)) / whole if whole > 0 else 0.5
        return a, copysign(1 - a, both)

    def joined(self, other: "Group") -> float:
        """Return the growth of extents along rows if both become one generator and a box of the rests."""
        a, b = self.parts(other)
        a, b = copysign(a, b), abs(b)
        return 2 * sum([abs(b * x - a * y) for x, y in zip(self.column, other.column, strict=True)])

    def plus(self, other: "Group") -> "Group":
        """Return the group of both."""
        a, b = self.parts(other)
        shares = *(a * x for x in self.shares), *(b * x for x in other.shares)
        column, image = (
            [x + copysign(1.0, b) * y for x, y in zip(*pair, strict=True)]
            for pair in ((self.column, other.column), (self.image, other.image))
        )
        return Group(self.members + other.members, shares, column, image, sum(map(mul, image, image)))


def grouped(columns: Sequence[Column], images: Sequence[Column], most: int) -> list[Group]:
    """Return at most so many groups of generators to be merged; a box is to replace all others.

    Columns are generators by coordinate, in shares of extents along rows that a box of that size adds; images
    are generators along the rows.
    """
    made = enumerate(zip(columns, images, strict=True))
    groups = [Group((j,), (1.0,), column, image, sum(map(mul, image, image))) for j, (column, image) in made]
    groups.sort(key=lambda group: -sum(map(abs, group.column)))
    total = 0.0
    while groups and (total := total + sum(map(abs, groups[-1].column))) <= NOTHING:
        groups.pop()
    while len(groups) > max(most, 0):
        groups = _fewer(groups, min(len(groups) - max(most, 0), len(groups) // ROUND + 1))
    return groups


def _fewer(groups: list[Group], surplus: int) -> list[Group]:
    """Drop or merge the groups with which least is lost, each at most once."""
    options = [(group.boxed(), i, i) for i, group in enumerate(groups)]
    directions = [group.direction for group in groups]
    order = sorted(range(len(groups)), key=lambda i: (directions[i], i))
    for place, i in enumerate(order):
        options += [(groups[i].joined(groups[j]), i, j) for j in order[place + 1 : place + 1 + ALIKE]]
    made, touched = list[Group](), set[int]()
    for _, i, j in sorted(options):
        if len(touched) - len(made) == surplus:
            break
        if i not in touched and j not in touched:
            touched |= {i, j}
            made += [groups[i].plus(groups[j])] if i != j else []
    return [group for i, group in enumerate(groups) if i not in touched] + made
