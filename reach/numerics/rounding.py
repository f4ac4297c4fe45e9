"""Rounding: error bounds of sums, and exact integers (floats times a power of two)."""

from fractions import Fraction
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .checks import Array

Whole = NDArray[np.object_]


def gamma(terms: int) -> float:
    """Relative error of a sum of so many products, with a margin (Higham 2002, section 3.1)."""
    return float((terms + 4) * np.finfo(float).eps)


def add_up(a: Array, b: Array) -> Array:
    """The sum, rounded up; unchanged where it is exact (two-sum, Knuth)."""
    total = np.asarray(a + b)
    part = total - a
    error = (a - (total - part)) + (b - part)
    return np.where(error > 0, np.nextafter(total, np.inf), total)


def add_down(a: Array, b: Array) -> Array:
    """The sum, rounded down; unchanged where it is exact."""
    return -add_up(-a, -b)


def integers(*arrays: Array) -> list[Whole]:
    """Return all entries of arrays times one common power of two, as Python integers."""
    parts = [np.frexp(np.asarray(a, dtype=float)) for a in arrays]
    used = [e[m != 0] for m, e in parts if np.any(m != 0)]
    lowest = min((int(e.min()) for e in used), default=0)
    out = []
    for mantissa, exponent in parts:
        digits = (mantissa * 2.0**53).astype(np.int64).astype(object)
        shift = np.where(mantissa != 0, exponent - lowest, 0).astype(object)
        out.append(np.asarray(digits * 2**shift, dtype=object))
    return out


def is_product(product: Array, left: Array, right: Array) -> bool:
    """Return True if ``product = left @ right`` without rounding, `product` and `left` being finite."""
    if not (np.all(np.isfinite(product)) and np.all(np.isfinite(left))):
        return False
    whole, first, second, one = integers(product, left, right, np.ones(1))
    return np.array_equal(first @ second, whole * one[0])


def floats(whole: Whole) -> Array:
    """Columns divided by their largest entry, each entry correctly rounded; zero columns stay zero."""
    largest = np.abs(whole).max(axis=0, initial=0)
    return np.asarray(whole / np.where(largest > 0, largest, 1), dtype=float)


def cross(columns: NDArray[Any]) -> NDArray[Any]:
    """Vectors (n, k) orthogonal to k groups of n - 1 given ones, columns (n - 1, n, k) of floats or integers.

    The generalised cross product; zero where the n - 1 vectors are linearly dependent. Laplace expansion,
    minors shared between the n determinants: no division, no pivoting, exact for integers.
    """
    n, k = columns.shape[1], columns.shape[2]
    minors: dict[tuple[int, ...], Any] = {(): np.ones(k, dtype=columns.dtype)}
    for j in range(n - 1):
        minors = {
            rows: sum(
                (-1) ** (at + j) * columns[j, row] * minors[rows[:at] + rows[at + 1 :]]
                for at, row in enumerate(rows)
            )
            for rows in combinations(range(n), j + 1)
        }
    all_rows = tuple(range(n))
    return np.stack([(-1) ** i * minors[all_rows[:i] + all_rows[i + 1 :]] for i in range(n)])


def mixture(rows: Array, target: Array) -> list[Fraction] | None:
    """Exact weights of rows (k, n), k <= n, whose sum is a target (n,); None if there are none, or many."""
    k = len(rows)
    whole, whole_target = integers(rows, target)
    system = [
        [Fraction(int(v)) for v in column] + [Fraction(int(t))]
        for column, t in zip(whole.T, whole_target, strict=True)
    ]
    for j in range(k):
        pivot_row = next((i for i in range(j, len(system)) if system[i][j]), None)
        if pivot_row is None:
            return None
        system[j], system[pivot_row] = system[pivot_row], system[j]
        pivot = system[j]
        for i in range(len(system)):
            if i != j and system[i][j]:
                share = system[i][j] / pivot[j]
                system[i] = [a - share * p for a, p in zip(system[i], pivot, strict=True)]
    if any(line[k] for line in system[k:]):
        return None
    return [system[j][k] / system[j][j] for j in range(k)]
