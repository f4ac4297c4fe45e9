"""Sets with flat faces as images of polytopes, for linear programs over several of them at once."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import block_diag

from ..numerics.checks import Array
from .intersection import Intersection
from .interval import Interval
from .lazy import AffineImage, MinkowskiSum
from .polytope import HPolytope
from .zonotope import Zonotope


@dataclass(frozen=True)
class Lifted:
    """``{c + G z : A z <= b}``, the z of about unit size where the set's own size is known."""

    c: Array
    G: Array
    A: Array
    b: Array


def lifted(X: Any, middle: Array, size: Array) -> Lifted | None:
    """A set with flat faces as the image of a polytope; None for any other set.

    Polytopes are written in ``(x - middle) / size``, about where the points of interest lie.
    """
    if isinstance(X, Interval):
        return Lifted(X.center, np.diag(X.half_widths), *_cube(X.dim))
    if isinstance(X, Zonotope):
        return Lifted(X.c, X.G, *_cube(X.order_count))
    if isinstance(X, HPolytope):
        return Lifted(middle, np.diag(size), X.A * size, X.b - X.A @ middle)
    if isinstance(X, AffineImage):
        base = lifted(X.base, *_frame(X.base))
        return base and Lifted(X.M @ base.c + X.v, X.M @ base.G, base.A, base.b)
    if isinstance(X, MinkowskiSum | Intersection):
        parts = [lifted(part, *_frame(part)) for part in X.parts]
        known = [part for part in parts if part is not None]
        if len(known) == len(parts):
            return _summed(known) if isinstance(X, MinkowskiSum) else _shared(known)
    return None


def _cube(g: int) -> tuple[Array, Array]:
    return np.vstack([np.eye(g), -np.eye(g)]), np.ones(2 * g)


def _frame(X: Any) -> tuple[Array, Array]:
    """A point and sizes to measure a set with; those of its offsets where it is unbounded."""
    if isinstance(X, HPolytope):
        return X.frame
    return np.zeros(X.dim), np.ones(X.dim)


def _summed(parts: list[Lifted]) -> Lifted:
    A = block_diag(*(part.A for part in parts))
    c = np.sum([part.c for part in parts], axis=0)
    return Lifted(c, np.hstack([part.G for part in parts]), A, np.hstack([part.b for part in parts]))


def _shared(parts: list[Lifted]) -> Lifted:
    """Points of the first set that are points of all others, each equation as two rows."""
    first, A = parts[0], block_diag(*(part.A for part in parts))
    rows, offsets, at = [A], [part.b for part in parts], first.G.shape[1]
    for part in parts[1:]:
        same = np.zeros((len(first.c), A.shape[1]))
        same[:, : first.G.shape[1]] = first.G
        same[:, at : at + part.G.shape[1]] = -part.G
        at += part.G.shape[1]
        live = same.any(axis=1)
        rows += [same[live], -same[live]]
        offsets += [(part.c - first.c)[live], (first.c - part.c)[live]]
    G = np.zeros((len(first.c), A.shape[1]))
    G[:, : first.G.shape[1]] = first.G
    return Lifted(first.c, G, np.vstack(rows), np.hstack(offsets))
