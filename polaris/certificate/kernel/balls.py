"""Matrices of balls: every number is enclosed, every operation rounds outwards (python-flint's arb)."""

from collections.abc import Iterable, Sequence
from functools import cache
from math import hypot
from typing import Any

from flint import arb, arb_mat

from .verdict import Rejected, Undecided

PRECISION = 128  # bits of the midpoints
TERMS = 8  # terms of the Taylor series of an exponential over an interval of time
FEW, TINY = 1e-15, 1e-300
"""More than doubles lose in a norm of numbers that are rounded to doubles, relative to it and near zero."""

Number = arb | float  # an entry: a float is exact


def matrix(rows: Sequence[Sequence[Number]], columns: int | None = None) -> arb_mat:
    """Matrix of rows of floats (exact) or balls; `columns` is needed if there are no rows."""
    width = columns if columns is not None else len(rows[0])
    return arb_mat(len(rows), width, [x for row in rows for x in row])


def column(values: Sequence[Number]) -> arb_mat:
    """Return one column."""
    return arb_mat(len(values), 1, list(values))


def diagonal(values: Sequence[Number]) -> arb_mat:
    """Diagonal matrix."""
    n = len(values)
    return arb_mat(n, n, [values[i] if i == j else 0 for i in range(n) for j in range(n)])


def scaled(values: Sequence[Number], M: arb_mat) -> arb_mat:
    """Rows of a matrix, each times a number."""
    rows = zip(values, M.tolist(), strict=True)
    return arb_mat(M.nrows(), M.ncols(), [x * y for x, row in rows for y in row])


def identity(n: int) -> arb_mat:
    """Unit matrix."""
    return diagonal([1.0] * n)


def rows_of(M: arb_mat, *which: int) -> arb_mat:
    """Return some of the rows."""
    table = M.tolist()
    return matrix([table[i] for i in which], M.ncols())


def kinds(M: arb_mat) -> tuple[list[int], list[tuple[int, int]]]:
    """One row of each kind, equal or opposite ones being of a kind; the kind of every row, and its sign."""
    first, kind_of, pairs = list[int](), dict[Any, tuple[int, int]](), list[tuple[int, int]]()
    for i, row in enumerate(M.tolist()):
        exact = tuple((*x.mid().man_exp(), *x.rad().man_exp()) for x in row)
        if exact not in kind_of:
            kind_of[tuple((-man, *rest) for man, *rest in exact)] = len(first), -1
            kind_of[exact] = len(first), 1
            first.append(i)
        pairs.append(kind_of[exact])
    return first, pairs


def sums(*lists: Iterable[arb]) -> list[arb]:
    """Sums of lists, entry by entry."""
    return [sum(values[1:], values[0]) for values in zip(*lists, strict=True)]


def maxima(*lists: Iterable[arb]) -> list[arb]:
    """Largest of lists, entry by entry."""
    return [largest(values) for values in zip(*lists, strict=True)]


def dot(a: Iterable[arb], b: Iterable[Number]) -> arb:
    """Inner product, enclosed."""
    return sum((x * y for x, y in zip(a, b, strict=True)), arb(0))


def absolute_dot(a: Iterable[arb], b: Iterable[Number]) -> arb:
    """Sum of the absolute values of the products: the scale of an inner product's rounding."""
    return sum((abs(x * y) for x, y in zip(a, b, strict=True)), arb(0))


def cross(a: Sequence[arb], b: Sequence[arb]) -> list[arb]:
    """Vector product in space."""
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def plain(x: arb) -> str:
    """Return the middle of a ball, for messages."""
    return f"{float(x.mid()):.6g}"


def beside(*blocks: arb_mat) -> arb_mat:
    """Blocks with the same number of rows, side by side."""
    rows = zip(*(block.tolist() for block in blocks), strict=True)
    columns = sum(block.ncols() for block in blocks)
    return arb_mat(blocks[0].nrows(), columns, [x for row in rows for part in row for x in part])


def above(*blocks: arb_mat) -> arb_mat:
    """Blocks with the same number of columns, one above the other."""
    entries = [x for block in blocks for x in block.entries()]
    return arb_mat(sum(block.nrows() for block in blocks), blocks[0].ncols(), entries)


def magnitude(M: arb_mat) -> arb_mat:
    """Exact upper bounds on the absolute values of the entries."""
    return arb_mat(M.nrows(), M.ncols(), [x.abs_upper() for x in M.entries()])


def absolute(M: arb_mat) -> arb_mat:
    """Absolute values of the entries, as balls."""
    return arb_mat(M.nrows(), M.ncols(), [abs(x) for x in M.entries()])


def row_sums(M: arb_mat) -> list[arb]:
    """Sum of the absolute values of every row."""
    return [sum(map(abs, row), arb(0)) for row in M.tolist()]


def spans(M: arb_mat, sizes: arb_mat) -> arb_mat:
    """Exact upper bounds on ``|M| sizes``, close to it: the radii of a product with balls about zero."""
    balls = [arb(0, x) for x in sizes.entries()]
    return magnitude(M * arb_mat(sizes.nrows(), sizes.ncols(), balls))


def widths(M: arb_mat) -> list[arb]:
    """`row_sums` from above: exact numbers."""
    return [x.abs_upper() for x in (M * _unit_balls(M.ncols())).entries()]


@cache
def _unit_balls(count: int) -> arb_mat:
    return column([arb(0, 1)] * count)


def norms(M: arb_mat) -> list[arb]:
    """2-norm of every row."""
    return [root(sum((x * x for x in row), arb(0))) for row in M.tolist()]


def lengths(M: arb_mat) -> list[arb]:
    """`norms` from above, in doubles: exact numbers; of a row of zeros, zero."""
    table = [[float(x.abs_upper()) for x in row if not x.is_zero()] for row in M.tolist()]
    return [arb(hypot(*row) * (1 + FEW) + TINY if row else 0.0) for row in table]


def root(square: arb) -> arb:
    """Square root of a number that is not negative, though its ball may reach below 0."""
    value = square.sqrt()
    if value.is_nan() and not square.is_nan():
        return arb(0).union(square.abs_upper().sqrt())
    return value


def largest(values: Iterable[arb]) -> arb:
    """Return a number that is at least every one of the values (their largest upper bound)."""
    highest: arb | None = None
    for upper in (value.upper() for value in values):
        if upper.is_nan():
            return upper
        highest = upper if highest is None or upper > highest else highest
    return arb(0) if highest is None else highest


def smallest(values: Iterable[arb]) -> arb:
    """Return a number that is at most every one of the values."""
    return -largest(-value for value in values)


def require(claim: str, slack: arb, witness: str) -> None:
    """Go on only if a number is certainly at least 0; `Rejected` if certainly not, else `Undecided`."""
    if slack >= 0:
        return
    if slack < 0:
        raise Rejected(claim, witness, -float(slack.mid()))
    raise Undecided(claim, f"{witness} (precision: {slack})")


# -- exponentials -----------------------------------------------------------------------------------


def exponential(X: arb_mat, time: arb) -> tuple[arb_mat, arb_mat]:
    """``e^{X t}`` and ``int_0^t e^{X s} ds``, enclosed; both from one exponential of a block matrix."""
    n = X.nrows()
    zeros = arb_mat(n, n)
    block = above(beside(X * time, identity(n) * time), beside(zeros, zeros)).exp().tolist()
    return matrix([row[:n] for row in block[:n]]), matrix([row[n:] for row in block[:n]])


def exponential_over(X: arb_mat, time: arb) -> arb_mat:
    """Enclosure of ``e^{X s}`` for all s in [0, t].

    Taylor's series with every power of s replaced by the interval it ranges over. What is cut off is
    at most what the same series of ``|X| t`` has left over, entry by entry.
    """
    n, size = X.nrows(), magnitude(X)
    total, bound = identity(n), identity(n)
    power, absolute = identity(n), identity(n)
    for j in range(1, TERMS):
        power, absolute = power * X * (arb(1) / j), absolute * size * (time / j)
        total, bound = total + power * arb(0).union(time**j), bound + absolute
    remainder = magnitude((size * time).exp() - bound)
    return total + arb_mat(n, n, [arb(0, x) for x in remainder.entries()])
