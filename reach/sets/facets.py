"""Facets of zonotopes by the combinations of their generators, membership by a linear program."""

from __future__ import annotations

from itertools import combinations
from math import comb

import numpy as np

from ..numerics.checks import Array
from ..numerics.errors import ReachError
from ..numerics.rounding import Whole, cross, floats, gamma, integers

FLAT = 1e-9  # ratio of singular values (axes scaled to unit size) below which a zonotope is treated as flat


def combination_count(G: Array) -> int:
    """How many groups of n - 1 vectors `facet_normals` looks at."""
    return comb(_spanning(G).shape[1], len(G) - 1)


def facet_normals(G: Array, most: int) -> Whole:
    """Normals of all facets of ``{G b : |b_i| <= 1}``, one of each opposite pair, exact: integers (n, k).

    They are scaled by some power of two. A flat zonotope is the limit of its sum with a vanishing box, so
    the axes join its generators; the normals then include those of the flat. A facet is spanned by n - 1
    generators (Althoff, Stursberg and Buss 2010, theorem 7): ``comb(g, n - 1)`` are looked at, `most` at
    the most.
    """
    n, candidates = len(G), _spanning(G)
    count = comb(candidates.shape[1], n - 1)
    if count > most:
        raise ReachError(
            f"{candidates.shape[1]} generators in dimension {n} span up to {count} facets, more than {most}"
        )
    (whole,) = integers(candidates)
    groups = np.array(list(combinations(range(candidates.shape[1]), n - 1)), dtype=int).reshape(count, n - 1)
    normals = cross(np.transpose(whole[:, groups], (2, 0, 1)))
    return np.asarray(normals[:, np.any(normals != 0, axis=0)])


def unit_columns(normals: Whole) -> Array:
    """Exact columns to floats of unit length, the first entry that is not zero positive."""
    columns = floats(normals)
    first = np.take_along_axis(columns, (columns != 0).argmax(axis=0)[None], axis=0)
    return np.asarray(columns * np.sign(first) / np.linalg.norm(columns, axis=0) + 0.0)


def _spanning(G: Array) -> Array:
    """The generators that matter, with the axes if they do not span the space."""
    G = G[:, np.any(G != 0, axis=0)]
    size = np.abs(G).sum(axis=1)
    if G.shape[1] < len(G) or np.any(size == 0):
        return np.hstack([G, np.eye(len(G)) * np.where(size > 0, size, 1.0)])
    values = np.linalg.svd(G / size[:, None], compute_uv=False)
    return np.hstack([G, np.diag(size)]) if values[-1] < FLAT * values[0] else G


def least_level(c: Array, G: Array, point: Array) -> float:
    """Least t with ``point = c + G b``, ``|b_i| <= t``; inf if none. On a flat axis rounding is forgiven."""
    from scipy.optimize import linprog

    G, scale, gap = G[:, np.any(G != 0, axis=0)], np.abs(G).sum(axis=1), point - c
    if np.any(np.abs(gap[scale == 0]) > gamma(1) * np.abs(c[scale == 0])):
        return np.inf
    G, gap = G[scale > 0] / scale[scale > 0, None], gap[scale > 0] / scale[scale > 0]
    least = float(np.abs(gap).max(initial=0.0))
    g = G.shape[1]
    if g == 0 or least > 2:  # far outside the interval hull: the bound is answer enough
        return least if g else 0.0
    bound = np.block([[np.eye(g), -np.ones((g, 1))], [-np.eye(g), -np.ones((g, 1))]])
    solved = linprog(
        np.r_[np.zeros(g), 1.0],
        bound,
        np.zeros(2 * g),
        np.c_[G, np.zeros(len(G))],
        gap,
        bounds=[(None, None)] * g + [(0, None)],
    )
    return float(solved.fun) if solved.status == 0 else np.inf
