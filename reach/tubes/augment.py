"""Constant parts of a motion as one more state, so that they are followed exactly."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from scipy import sparse

from ..numerics.checks import require_single
from ..numerics.errors import ReachError
from ..sets.convex import ConvexSet
from ..sets.ellipsoid import Ellipsoid
from ..sets.interval import Interval
from ..sets.lazy import AffineImage
from ..sets.zonotope import Zonotope
from .systems import LinearSystem


def augmented(system: LinearSystem, start: Any) -> tuple[LinearSystem, Any]:
    """The system with its drift and the centre of its input moved into one more state, constantly 1.

    What is left of the input varies about 0. Of an input that changes its set only the drift is moved.

    Parameters
    ----------
    system : LinearSystem
    start : ConvexSet

    Returns
    -------
    system : LinearSystem
        The same system if there is nothing to move.
    start : ConvexSet
        With the last coordinate 1 if there is.
    """
    require_single("the initial set", start)
    if start.dim != system.dim:
        raise ReachError(f"the initial set has dimension {start.dim}, the system has {system.dim} states")
    inputs, drift = system.U, system.c
    if len(inputs) == 1:
        try:
            middle = inputs[0].center
        except ReachError as exc:
            raise ReachError(f"an input set must be bounded and not empty: {exc}") from None
        drift = drift + np.asarray(system.B @ middle).ravel()
        inputs = (inputs[0] + (-middle),) if np.any(middle) else inputs
    if not np.any(drift):
        return replace(system, U=inputs or None, c=None), start
    n, m = system.dim, system.inputs
    one = 1.0 if system.discrete else 0.0
    A: Any = np.zeros((n + 1, n + 1))
    if system.sparse:
        A = sparse.bmat([[system.A, drift[:, None]], [None, [[one]]]], format="csr")
        B = sparse.vstack([system.B, sparse.csr_matrix((1, m))])
    else:
        A[:n, :n], A[:n, n], A[n, n] = system.A, drift, one
        B = np.vstack([sparse.csr_matrix(system.B).toarray(), np.zeros((1, m))])
    bigger = replace(system, A=A, B=B, U=inputs or None, c=None)
    return bigger, _with_constant(start)


def _with_constant(start: ConvexSet) -> Any:
    n = start.dim
    if isinstance(start, Interval):
        return Interval(np.r_[start.lo, 1.0], np.r_[start.hi, 1.0])
    if isinstance(start, Zonotope):
        return Zonotope(np.r_[start.c, 1.0], np.vstack([start.G, np.zeros((1, start.order_count))]))
    if isinstance(start, Ellipsoid):
        return Ellipsoid(np.r_[start.c, 1.0], np.vstack([start.L, np.zeros((1, start.L.shape[1]))]))
    return AffineImage(np.eye(n + 1, n), start, np.eye(n + 1)[n])
