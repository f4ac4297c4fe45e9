"""Polytopes whose facets differ from sample to sample: distance, and when a ray enters."""

from __future__ import annotations

from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from ..model.shapes import CHUNK, Polytope
from ..model.system import Array


def unit_rows(A: Array, b: Array) -> tuple[Array, Array]:
    """Rows ``A p <= b`` scaled to unit length; shapes (M or 1, F, d) and (M, F)."""
    peak = np.abs(A).max(axis=-1, keepdims=True)
    length = np.linalg.norm(A / peak, axis=-1, keepdims=True)
    return A / peak / length, b / (peak * length)[..., 0]


def turned(H: Array, i: int) -> Array:
    """Normals of sample i, which may be the same for all."""
    return np.asarray(H[i if len(H) > 1 else 0])


def facet_distance(H: Array, b: Array, p: Array) -> Array:
    """Exact signed distance [m] of p (N, d) to ``H p <= b``, sample by sample, shape (N,).

    Parameters
    ----------
    H : ndarray, shape (N or 1, F, d)
        Unit rows.
    b : ndarray, shape (N, F)

    Notes
    -----
    The same dual as in `polaris.model.shapes.Polytope.signed_distance`, over all sets of at most d
    independent facets: which of them meet differs from sample to sample.
    """
    out = np.empty(len(p))
    _, F, d = H.shape
    sets = [np.array(list(combinations(range(F), s))) for s in range(2, min(F, d) + 1)]
    shared = [_inverses(H, index) for index in sets] if len(H) == 1 else None
    step = max(1, CHUNK // (F + sum(index.size for index in sets) * d))
    for i in range(0, len(p), step):
        part = slice(i, i + step)
        rows = np.broadcast_to(H, (len(p), F, d))[part]
        r = np.einsum("nfd,nd->nf", rows, p[part]) - b[part]
        worst = r.max(axis=1)
        outside = np.flatnonzero(worst > 0)
        if outside.size:
            inverses = shared or [_inverses(rows[outside], index) for index in sets]
            pairs = zip(sets, inverses, strict=True)
            square = [_square(inverse, r[outside][:, index]) for index, inverse in pairs]
            worst[outside] = np.sqrt(np.maximum.reduce([worst[outside] ** 2, *square]))
        out[part] = worst
    return out


def _inverses(H: Array, index: NDArray[np.int64]) -> Array:
    """``(H_S H_S')^-1`` of sets S of facets, shape (n, C, s, s); nan where they are not independent."""
    rows = H[:, index]
    gram = rows @ np.swapaxes(rows, -1, -2)
    fit = (np.linalg.eigvalsh(gram)[..., 0] > 1e-11)[..., None, None]
    return np.where(fit, np.linalg.inv(np.where(fit, gram, np.eye(gram.shape[-1]))), np.nan)


def _square(inverse: Array, r: Array) -> Array:
    """Largest ``r_S' (H_S H_S')^-1 r_S`` with multipliers >= 0, shape (n,); r is (n, C, s)."""
    multipliers = (inverse @ r[..., None])[..., 0]
    value = np.sum(multipliers * r, axis=-1)
    return np.asarray(np.where(np.all(multipliers >= 0, axis=-1), value, 0.0).max(axis=1))


def facet_entry(H: Array, b: Array, p: Array, v: Array) -> Array:
    """Seconds until the rays p + s v enter ``H p <= b``, sample by sample, shape (N,).

    Arguments as `facet_distance`. In the coordinates ``H p`` all facets are the same.
    """
    shape = (len(p), *H.shape[1:])
    reach, rate = (np.einsum("nfd,nd->nf", np.broadcast_to(H, shape), x) for x in (p, v))
    return Polytope(np.eye(H.shape[1]), b).entry_time(reach, rate)
