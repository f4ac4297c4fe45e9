"""Sets ``c + G [-1, 1]^g`` whose centre and generators are enclosed by balls."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations, product
from math import copysign
from operator import mul

from flint import arb, arb_mat, ctx

from .balls import (
    Number,
    beside,
    column,
    cross,
    diagonal,
    dot,
    largest,
    magnitude,
    matrix,
    row_sums,
    smallest,
    sums,
    widths,
)
from .merging import GeneratorGroup, grouped

BITS = 64  # precision of products with generators, a word: more would not show beside what merging adds
PARTS = 8  # most parts in which generators are mapped; with fewer, more are copied in every period


def times(M: arb_mat, G: arb_mat) -> arb_mat:
    """Enclosure of a matrix times generators, to no more bits than sets need."""
    with ctx.workprec(BITS):
        return (M * 1) * G


class Directions:
    """Rows along which many sets and motions are bounded; their bounds are kept under this object."""

    def __init__(self, M: arb_mat) -> None:
        self.M = M


class Generators:
    """Generators, their products with rows and their support, each made once, part by part."""

    def __init__(self, *parts: arb_mat | Generators) -> None:
        self._parts = parts
        self._images: dict[Directions, Generators] = {}

    @cached_property
    def matrices(self) -> list[arb_mat]:
        """Matrices that hold them side by side."""
        parts = (part.matrices if isinstance(part, Generators) else [part] for part in self._parts)
        return [each for part in parts for each in part]

    @cached_property
    def G(self) -> arb_mat:
        """Return all generators in one matrix."""
        return self.matrices[0] if len(self.matrices) == 1 else beside(*self.matrices)

    def mapped(self, M: arb_mat) -> Generators:
        """Return the generators of the set mapped by a matrix."""
        few = self.matrices if len(self.matrices) <= PARTS else [self.G]
        return Generators(*(times(M, each) for each in few))

    @cached_property
    def widths(self) -> list[arb]:
        """Return the largest distance of every coordinate from the centre's."""
        return sums(*(part.widths if isinstance(part, Generators) else widths(part) for part in self._parts))

    def image(self, rows: Directions) -> Generators:
        """Return the generators of the set mapped by rows."""
        if rows not in self._images:
            parts = (
                part.image(rows) if isinstance(part, Generators) else times(rows.M, part)
                for part in self._parts
            )
            self._images[rows] = Generators(*parts)
        return self._images[rows]


@dataclass(frozen=True, eq=False)
class Zonotope:
    """A zonotope."""

    c: arb_mat  # centre, shape (n, 1)
    generators: arb_mat | Generators  # one per column, shape (n, g)

    @property
    def G(self) -> arb_mat:
        """Return the generators, shape (n, g)."""
        return self._generators.G

    @property
    def parts(self) -> list[arb_mat]:
        """Return the generators as they are kept, matrices side by side."""
        return self._generators.matrices

    @property
    def count(self) -> int:
        """Number of its generators."""
        return sum(part.ncols() for part in self.parts)

    def image(self, M: arb_mat) -> Zonotope:
        """Return the set mapped by a matrix."""
        return Zonotope(M * self.c, self._generators.mapped(M))

    def through(self, rows: Directions) -> Zonotope:
        """Return the set mapped by rows; the image is kept for this set, moved or grown."""
        return Zonotope(rows.M * self.c, self._generators.image(rows))

    @cached_property
    def _generators(self) -> Generators:
        return self.generators if isinstance(self.generators, Generators) else Generators(self.generators)

    def translate(self, v: arb_mat) -> Zonotope:
        """Return the set moved by a vector (n, 1)."""
        return Zonotope(self.c + v, self._generators)

    def plus(self, *generators: arb_mat) -> Zonotope:
        """Minkowski sum with zonotopes about zero, given by their generators."""
        return Zonotope(self.c, Generators(self._generators, *generators))

    def spread(self, rows: arb_mat) -> list[arb]:
        """Bound how far ``row x`` may be from its value at the centre."""
        return row_sums(rows * self.G)

    def support(self, rows: arb_mat) -> list[arb]:
        """``max row x`` over the set, for every row, from above."""
        return sums((rows * self.c).entries(), self._generators.mapped(rows).widths)

    @property
    def widths(self) -> list[arb]:
        """Return the largest distance of every coordinate from the centre's."""
        return self._generators.widths

    def size(self) -> arb_mat:
        """Exact upper bound on ``|x_i|`` over the set, shape (n, 1)."""
        centre = self.c.entries()
        return magnitude(column([abs(c) + width for c, width in zip(centre, self.widths, strict=True)]))

    def reduced(self, limit: int, rows: arb_mat | None = None) -> Zonotope:
        """Enclosing set with exact centre and at most `limit` exact generators, n of which are a box.

        The sum u of nearly parallel generators ``g_l = a_l u + rest`` takes their place. Rests, generators
        next to an axis and short ones, and the radii of all balls go into the box. Floats choose, by what
        is lost along rows (k, n), or else along diagonals of the set's box; any choice encloses the set.
        """
        middle = self.G.mid()
        columns, n = middle.transpose().tolist(), middle.nrows()
        rough = [list(map(float, g)) for g in columns]
        rows = _corners(self.widths) if rows is None else rows
        groups = _groups(rough, middle, rows, limit - n if len(columns) > n else n)
        chosen = {j for group in groups for j in group.members}
        generators, rests = list[Sequence[Number]](), [g for j, g in enumerate(columns) if j not in chosen]
        for group in groups:
            if len(group.members) == 1:
                generators += [columns[j] for j in group.members]
                continue
            signs = [copysign(1.0, a) for a in group.shares]
            u = [sum(map(mul, signs, x)) for x in zip(*(rough[j] for j in group.members), strict=True)]
            for a, j in zip(map(arb, group.shares), group.members, strict=True):  # products without rounding
                rests.append([x - a * y for x, y in zip(columns[j], u, strict=True)])
            factor = dot(map(arb, group.shares), signs)
            generators.append([x * factor for x in u])
        exact = matrix(generators, n).transpose()
        boxed = beside(exact - exact.mid(), self.G - middle, matrix(rests, n).transpose())
        box = [(x + c.rad()).abs_upper() for x, c in zip(widths(boxed), self.c.entries(), strict=True)]
        return Zonotope(self.c.mid(), beside(exact.mid(), diagonal(box)))


def _corners(extents: Sequence[arb]) -> arb_mat:
    """Perpendicular rows towards corners of a box (Walsh), in shares of its extents."""
    shares = [1 / x if x > 1e-300 else 0.0 for x in map(float, extents)]
    count = 1 << (len(shares) - 1).bit_length()
    return matrix([[(-1) ** (i & k).bit_count() * x for i, x in enumerate(shares)] for k in range(count)])


def _groups(
    columns: Sequence[Sequence[float]], G: arb_mat, rows: arb_mat, count: int
) -> list[GeneratorGroup]:
    """Choose at most so many groups of generators (columns of G) to be merged."""
    products = times(rows, G)
    shares = [1 / x if x > 1e-300 else 0.0 for x in map(float, widths(products))]
    prices = [sum(map(mul, shares, map(abs, map(float, row)))) for row in rows.transpose().tolist()]
    images = [list(map(mul, shares, map(float, g))) for g in products.transpose().tolist()]
    return grouped([list(map(mul, prices, g)) for g in columns], images, count)


@dataclass(frozen=True)
class Merging:
    """Number of generators that sets keep per state of the plant, and rows along which little may be lost."""

    order: int
    states: int
    rows: arb_mat | None = None

    @property
    def limit(self) -> int:
        """Generators that are kept."""
        return self.order * self.states

    def at_start(self, z: Zonotope, columns: int) -> Zonotope:
        """Merge a set at the start of a step if it would exceed twice the limit with so many columns more.

        A merge loses most of fresh generators, and that fades in a step: sets at its end lose little.
        """
        return z.reduced(self.limit, self.rows) if self.limit < z.count > 2 * self.limit - columns else z

    def within(self, z: Zonotope) -> Zonotope:
        """Merge a set within a step if it exceeds three times the limit."""
        return z.reduced(self.limit, self.rows) if z.count > 3 * self.limit else z


def inner_radius(G: arb_mat) -> arb:
    """Lower bound on the radius of the largest ball about zero inside a zonotope of dimension 1 to 3.

    The least support over the normals of its facets: perpendiculars of one generator in the plane, of
    two in space.
    """
    columns = [list(c) for c in G.transpose().tolist()]
    if G.nrows() == 1:
        return row_sums(G)[0]
    if G.nrows() == 2:
        normals = [[-y, x] for x, y in columns]
    else:
        normals = [cross(a, b) for a, b in combinations(columns, 2)]
    radii = []
    for normal, width in zip(normals, row_sums(matrix(normals) * G), strict=True):
        length = dot(normal, normal).sqrt()
        if length > 0:  # parallel generators span no facet
            radii.append(width / length)
    return smallest(radii)


def ball_cover(p: int, radius: arb) -> arb_mat:
    """Generators, shape (p, g), of a zonotope that contains the 2-norm ball of a radius."""
    if p == 1 or p > 3:
        return diagonal([radius] * p)
    if p == 2:
        angles = [arb.pi() * j / 8 for j in range(8)]
        rays = matrix([[a.cos() for a in angles], [a.sin() for a in angles]])
    else:
        weight = {1: 1.0, 2: 1.15 / 2**0.5, 3: 0.9 / 3**0.5}  # axes of the cube, weighted for roundness
        axes = [a for a in product((-1, 0, 1), repeat=3) if next((x for x in a if x), 0) > 0]
        rays = matrix([[a[i] * weight[sum(map(abs, a))] for a in axes] for i in range(3)])
    return rays * (radius / inner_radius(rays))


def widest(sets: list[Zonotope], boxes: Sequence[arb_mat] = ()) -> arb_mat:
    """Exact upper bound on ``|x_i|`` over several sets, and boxes about zero, shape (n, 1)."""
    sizes = [*(z.size().entries() for z in sets), *(box.entries() for box in boxes)]
    return column([largest(values) for values in zip(*sizes, strict=True)])
