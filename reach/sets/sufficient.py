"""Zonotope containment by one linear program: proves it or leaves it open."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..numerics.rounding import gamma
from .zonotope import Zonotope

Array = NDArray[np.float64]


def scale_to_hold(outer: Zonotope, inner: Zonotope) -> float:
    """A factor t with ``inner`` inside ``{c + t G b}`` of the outer set, proved; inf if none was found.

    The least t for which ``[G_in, c_in - c] = G Gamma`` with row sums ``sum_j |Gamma_ij| <= t``
    (Sadraddini and Tedrake 2019, theorem 3). What rounding leaves of the equation is mapped back
    through a right inverse of G and added to the rows, so t needs no trust in the solver. For a flat
    outer set there is no right inverse, hence no proof.
    """
    from scipy import sparse
    from scipy.optimize import linprog

    size = outer.half_widths
    if np.any(size == 0):
        return np.inf
    G = outer.G[:, np.any(outer.G != 0, axis=0)] / size[:, None]
    target = np.c_[inner.G, inner.c - outer.c] / size[:, None]
    target = target[:, np.any(target != 0, axis=0)]
    (n, p), q = G.shape, target.shape[1]
    R = np.linalg.pinv(G)
    defect = np.abs(np.eye(n) - G @ R) + gamma(p) * (np.abs(G) @ np.abs(R))
    loss = float(defect.sum(axis=1).max())
    if not loss < 0.5:
        return np.inf
    if q == 0:
        return 0.0
    equal = sparse.hstack(
        [sparse.kron(sparse.eye(q), G), -sparse.kron(sparse.eye(q), G), np.zeros((n * q, 1))]
    )
    sums = sparse.kron(np.ones((1, 2 * q)), sparse.eye(p))
    solved = linprog(
        np.r_[np.zeros(2 * p * q), 1.0],
        sparse.hstack([sums, -np.ones((p, 1))]).tocsr(),
        np.zeros(p),
        equal.tocsr(),
        target.T.ravel(),
        bounds=(0, None),
    )
    if solved.status != 0:
        return np.inf
    Gamma = (solved.x[: p * q] - solved.x[p * q : -1]).reshape(q, p).T
    left = np.abs(target - G @ Gamma) + gamma(p) * (np.abs(target) + np.abs(G) @ np.abs(Gamma))
    repair = np.abs(R).sum(axis=1) * left.max(axis=0).sum() / (1 - loss)
    return float((np.abs(Gamma).sum(axis=1) + repair).max() * (1 + gamma(q)))
