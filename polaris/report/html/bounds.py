"""How near the proof lets the spacecraft come to each unsafe set, read off the tubes of a run folder."""

from __future__ import annotations

import numpy as np

from reach.numerics.linear import growth

from ...model.obstacles import perceive
from ...model.system import Array
from ...model.tolerances import ROUNDING
from ...runs.picture import Picture


def proven_distance(picture: Picture) -> Array | None:
    """Least distance from all unsafe sets that a proved schedule promises over every period.

    The tube over a period lies in the hull of the sets at its ends, up to its bow and that of the
    reference, and the offsets of a timed polytope run linearly over it: the gap to one facet is least at
    an end. Where this comes out negative the proof rests on S taking over from a recoverable set, and
    promises no more than 0.

    Parameters
    ----------
    picture : Picture
        Of a schedule whose guarantee is ``proved``; otherwise the result means nothing.

    Returns
    -------
    ndarray, shape (K, q), or None
        [m], at least 0; None without a tube or without unsafe sets.
    """
    tube, system = picture.tube, picture.system
    unsafe = perceive(picture.obstacles, system, picture.reference.delta, picture.planned)
    if tube is None or not unsafe:
        return None
    q = tube.bow.shape[1]
    bow = tube.bow + _reference_bow(picture, q)
    found = []
    for timed in unsafe:
        rows, offsets = timed.normals, timed.fine(q)
        reach = np.abs(np.einsum("fd,kqdg->kqfg", rows, tube.generators)).sum(axis=-1)
        size = np.abs(tube.centre).sum(axis=-1, keepdims=True) + np.abs(offsets)
        gap = tube.centre @ rows.T - reach - offsets - ROUNDING * size
        between = np.minimum(gap[:, :-1], gap[:, 1:]) - bow @ np.abs(rows).T
        found.append(between.max(axis=-1))
    return np.asarray(np.maximum(np.min(found, axis=0), 0.0))


def _reference_bow(picture: Picture, q: int) -> Array:
    """How far the reference's position leaves its chords between nodes, per axis, shape (K, q, d) [m]."""
    system, reference, K = picture.system, picture.reference, picture.planned
    h = reference.delta / q
    rate = reference.fine(q)[:K, :-1] @ system.A.T + (reference.nu[:K] @ system.B.T)[:, None, :]
    grown = np.abs(rate) @ growth(system.A, h).T
    return np.asarray(h**2 / 8 * grown @ np.abs(system.position @ system.A).T)
