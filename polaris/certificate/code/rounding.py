"""Rounding on board: how far a command may be off the exact one, and its share of disturbances.

Sums are bounded in the order of the step function: ``c`` roundings in a row are off by at most
``c u / (1 - c u)`` of the sum of magnitudes (Higham 2002, chapter 3), contracted or not, and underflow adds
at most the smallest normal number each time.
"""

from collections.abc import Iterator

from flint import arb, arb_mat

from ..files.document import Document
from ..kernel.arcs import Path
from ..kernel.balls import absolute, column, diagonal, largest, magnitude, matrix, row_sums
from ..kernel.motion import Plant
from .text import Tables

UNIT = {"double": 2.0**-53, "float": 2.0**-24}
"""Largest relative error of one rounding, by precision."""
SMALLEST = {"double": 2.0**-1022, "float": 2.0**-126}
"""Smallest normal number, by precision: the largest loss by flushing to zero."""


def command_error(document: Document, tables: Tables, precision: str, path: Path) -> arb:
    """Bound on ``|command - exact command|`` of every input and node [N], for states within the range.

    The exact one is that of S along the exact reference `path`, or a command of U, both clipped.
    """
    n, m = len(document.A), len(document.u_max)
    unit = arb(0) if precision == "double" else arb(UNIT[precision])  # of numbers that are handed over
    gain, limit, feed = (
        matrix(tables.gain),
        column(tables.limit),
        row_maxima([column(u) for u in tables.feed]),
    )
    worst = [arb(0)] * m
    for error, size in _gaps(document, tables, precision, path):
        spread = magnitude(gain) * (size + error) + feed + limit
        total = magnitude(gain) * error + spread * (rounding_factor(n + 1, precision) + 2 * unit)
        total += least(m, n + 1, precision)
        worst = [largest(pair) for pair in zip(worst, total.entries(), strict=True)]
    return largest(worst)


def gap_error(document: Document, tables: Tables, precision: str, path: Path) -> arb_mat:
    """Bound on the change of a state's error by rounding, for states within the range, (n, 1)."""
    return row_maxima([error for error, _ in _gaps(document, tables, precision, path)])


def _gaps(
    document: Document, tables: Tables, precision: str, path: Path
) -> Iterator[tuple[arb_mat, arb_mat]]:
    """Rounding of the error at the nodes of a step, and the size of the error, (n, 1) each, part by part."""
    n, m = len(document.A), len(document.u_max)
    unit = arb(0) if precision == "double" else arb(UNIT[precision])
    input_unit = unit * (not tables.seen)  # the observer's estimate is apart
    reach, starts = column(tables.range), [column(x) for x in tables.waypoints]
    feeds = [column(u) for u in tables.feed] + [arb_mat(m, 1)] * (len(starts) - len(tables.feed))
    top = row_maxima(starts), row_maxima(feeds)
    for part, rows in enumerate(zip(tables.moved, tables.pushed, strict=True)):
        transition, gain = map(matrix, rows)
        reference = magnitude(transition) * top[0] + magnitude(gain) * top[1]
        gaps = [
            arc.nodes[part] - transition * x - gain * u
            for arc, x, u in zip(path.arcs[: len(starts)], starts, feeds, strict=True)
        ]
        error = row_maxima(gaps) + reference * rounding_factor(n + m, precision) + least(n, n + m, precision)
        size = reference + error + reach
        yield error + size * arb(UNIT[precision]) + reach * input_unit, size


def row_maxima(columns: list[arb_mat]) -> arb_mat:
    """Largest magnitude of every entry of some columns."""
    rows = zip(*(absolute(one).entries() for one in columns), strict=True)
    return column([largest(row) for row in rows])


def rounding_factor(count: int, precision: str) -> arb:
    """Bound on the relative error of so many roundings in a row."""
    error = arb(UNIT[precision]) * (count + 1)
    return error / (1 - error)


def least(rows: int, count: int, precision: str) -> arb_mat:
    """Bound on the underflow error of `count` operations, shape (rows, 1)."""
    return column([arb(SMALLEST[precision]) * 2 * (count + 1)] * rows)


def as_disturbance(document: Document, plant: Plant, error: arb) -> arb | None:
    """Bound on disturbances with the effect of command errors up to `error`; None if none has it.

    The thrusters' own errors grow with commands, by their shares.
    """
    rows = [i for i, row in enumerate(plant.D.tolist()) if any(not x.is_zero() for x in row)]
    others = [row for i, row in enumerate(plant.B.tolist()) if i not in rows]
    if len(rows) != plant.D.ncols() or any(not x.is_zero() for row in others for x in row):
        return None
    D, B = (matrix([M.tolist()[i] for i in rows]) for M in (plant.D, plant.B))
    try:
        sizes = row_sums(D.solve(B) * diagonal([error] * B.ncols()))
    except ZeroDivisionError:
        return None
    return sum((x * x for x in sizes), arb(0)).sqrt() * (1 + sum(map(arb, document.shares), arb(0)))
