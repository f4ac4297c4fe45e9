"""Order reduction: fewer generators, a set that still contains the original."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import hadamard

from ..numerics.checks import Array, checked, require_alike, require_same_dim
from ..numerics.errors import ReachError
from ..numerics.rounding import gamma
from .zonotope import Zonotope

Order = NDArray[np.signedinteger[Any]]

ALIKE, ROUNDS = 2, 64
"""Next generators by direction that each is compared with; most additions to a box beside its generators."""

TINY = 1e-300
"""Least length: that of a generator of zeros."""


@checked
def reduce(zonotope: Zonotope, order: float, method: str = "pca") -> Zonotope:
    """Enclose zonotopes by ones with at most ``order * n`` generators each, rounding included.

    Units may differ between axes: lengths are compared in half-widths of the interval hull.

    Parameters
    ----------
    zonotope : Zonotope
        One set or a stack (each member is reduced on its own, all at once).
    order : float
        Largest number of generators per dimension, >= 1.
    method : {"pca", "girard", "combastel", "parallel", "auto"}
        "girard", "combastel" and "pca" keep the longest generators and enclose the rest in a
        parallelotope: along the axes, lengths being ``norm(g, 1) - norm(g, inf)`` (Girard 2005) or
        ``norm(g, 2)`` (Combastel 2003), or along the principal axes of what is enclosed (Kopetzki,
        Schuermann and Althoff 2017). "parallel" merges nearly parallel generators with each other
        and encloses the rests in a box: it loses least of many that turn slowly, one member after
        the other. "auto" takes, for each member, the least of these by `mean_width`.

    Raises
    ------
    ReachError
        If `order` is below 1 or the method is unknown.
    """
    if method != "auto" and method not in METHODS:
        raise ReachError(f"method must be 'auto' or one of {', '.join(map(repr, METHODS))}, got {method!r}")
    if not 1 <= order < np.inf:
        raise ReachError(f"order must be at least 1, got {order}")
    budget = int(order * zonotope.dim)
    if zonotope.order_count <= budget:
        return zonotope
    # Powers of two, so that scaling there and back leaves every number as it was.
    half = zonotope.half_widths[..., None]
    size = np.exp2(np.round(np.log2(np.where(half > 0, half, 1.0))))
    G, size = zonotope.G / size, np.where(half == 0, 0.0, size)
    if method != "auto":
        return Zonotope(zonotope.c, METHODS[method](G, budget) * size)
    candidates = [one(G, budget) for one in METHODS.values()]
    choice = _ranks(np.stack([mean_width(one) for one in candidates]), 0).argmin(axis=0)
    best = np.take_along_axis(np.stack(candidates), choice[None, ..., None, None], axis=0)[0]
    return Zonotope(zonotope.c, best * size)


def mean_width(G: Array) -> Array:
    """Mean half-width of ``{G b : |b_i| <= 1}`` over a fixed set of directions, shape (...)."""
    n = G.shape[-2]
    D = np.random.default_rng(0).normal(size=(32 * n, n))
    D /= np.linalg.norm(D, axis=1, keepdims=True)
    return np.asarray(np.abs(D @ G).sum(axis=-1).mean(axis=-1))


@checked
def reduction_loss(before: Zonotope, after: Zonotope) -> Array:
    """Half-widths of a box whose Minkowski sum with `before` contains `after`, shape (..., n).

    A bound, axis by axis, on how far the enclosure reaches beyond the original; zero for the
    original itself. Any matrix C with row sums ``sum_j |C_ij| <= 1`` writes ``after.G`` as
    ``before.G C`` plus what is counted here; C follows the cosines between the generators, raised to
    a few powers, and the best of these is taken.

    Raises
    ------
    ReachError
        If the dimensions differ.
    """
    require_same_dim(before, after)
    require_alike(before.batch, after.batch)
    shape = np.broadcast_shapes(before.batch, after.batch)
    n, g, k = before.dim, before.order_count, after.order_count
    B, A = np.broadcast_to(before.G, (*shape, n, g)), np.broadcast_to(after.G, (*shape, n, k))
    size = np.broadcast_to(before.half_widths, (*shape, n))[..., None]
    size = np.where(size > 0, size, 1.0)
    scaled = [M / size for M in (B, A)]
    lengths = [np.linalg.norm(M, axis=-2, keepdims=True) for M in scaled]
    units = [M / np.where(norm > 0, norm, 1.0) for M, norm in zip(scaled, lengths, strict=True)]
    cosines = np.swapaxes(units[0], -1, -2) @ units[1]
    best = np.full((*shape, n), np.inf)
    for power in (1, 2, 4, 16, 256):
        C = np.sign(cosines) * np.abs(cosines) ** power * lengths[1]
        C = C / np.maximum(np.abs(C).sum(axis=-1, keepdims=True), 1e-300) * (1 - gamma(k))
        residual = np.abs(A - B @ C) + gamma(g) * (np.abs(A) + np.abs(B) @ np.abs(C))
        loss = residual.sum(axis=-1)
        # One matrix for all axes: the bounds of two of them do not mix.
        smaller = (loss / size[..., 0]).sum(axis=-1) < (best / size[..., 0]).sum(axis=-1)
        best = np.where(smaller[..., None], loss, best)
    return np.asarray((best + np.abs(after.c - before.c)) * (1 + gamma(k)))


def _ranks(keys: Array, axis: int = -1) -> Array:
    """Keys to choose by without their last digits: rounding differs between processors, choices must not."""
    finite = np.isfinite(keys)
    largest = np.abs(np.where(finite, keys, 0.0)).max(axis=axis, keepdims=True, initial=0.0)
    mantissa, exponent = np.frexp(np.where(finite, keys, 0.0) / np.where(largest > 0, largest, 1.0))
    coarse = np.ldexp(np.rint(mantissa * 2.0**24), exponent - 24)
    return np.asarray(np.where(finite, np.where(np.abs(coarse) < 2.0**-40, 0.0, coarse), keys))


def _split(G: Array, lengths: Array, count: int) -> tuple[Array, Array]:
    """The longest generators, and the others."""
    order = np.argsort(-_ranks(lengths), axis=-1, kind="stable")[..., None, :]
    longest, others = (np.take_along_axis(G, part, axis=-1) for part in np.split(order, [count], axis=-1))
    return longest, others


def _boxed(kept: Array, merged: Array) -> Array:
    """Generators kept, and the axis-aligned box around the others."""
    radii = np.abs(merged).sum(axis=-1) * (1 + gamma(merged.shape[-1]))
    return np.concatenate([kept, radii[..., None] * np.eye(merged.shape[-2])], axis=-1)


def girard(G: Array, budget: int) -> Array:
    """Box around the generators that are closest to the axes."""
    size = np.abs(G)
    return _boxed(*_split(G, size.sum(axis=-2) - size.max(axis=-2), budget - G.shape[-2]))


def combastel(G: Array, budget: int) -> Array:
    """Box around the shortest generators."""
    return _boxed(*_split(G, np.linalg.norm(G, axis=-2), budget - G.shape[-2]))


def pca(G: Array, budget: int) -> Array:
    """Parallelotope along the principal axes of the shortest generators."""
    n = G.shape[-2]
    kept, merged = _split(G, np.linalg.norm(G, axis=-2), budget - n)
    frame = np.linalg.svd(merged, full_matrices=merged.shape[-1] < n)[0]
    radii = np.abs(np.swapaxes(frame, -1, -2) @ merged).sum(axis=-1)
    # The computed frame is orthogonal only to rounding; enclosing F F^T x instead of x would miss
    # by that much, so the radii are inflated to cover it.
    slack = 4 * np.finfo(float).eps * n * merged.shape[-1] * (1 + radii.max(axis=-1, keepdims=True))
    return np.concatenate([kept, frame * (radii + slack)[..., None, :]], axis=-1)


def parallel(G: Array, budget: int) -> Array:
    """Merge nearly parallel generators with each other, and the least of them with a box."""
    flat = G.reshape(-1, *G.shape[-2:])
    return np.reshape([_merged(one, budget) for one in flat], (*G.shape[:-1], budget))


def _merged(G: Array, budget: int) -> Array:
    """Merge generators (n, g) by rounds, with which Walsh's diagonals of the hull grow least.

    The sum u of two takes their place, ``g = a u + rest`` with shares a by length; a box holds the rests.
    """
    n, shares = len(G), 1 / np.maximum(np.abs(G).sum(axis=1), TINY)
    rows = hadamard(1 << (n - 1).bit_length())[:, :n] * shares
    price, box, terms = len(rows) * shares, np.zeros(n), gamma(G.shape[1] + ROUNDS)
    while (surplus := G.shape[1] - (budget - n)) > 0:
        images = rows @ G
        length = np.maximum(np.linalg.norm(images, axis=0), TINY)
        largest = _ranks(np.abs(images), 0).argmax(axis=0)[None]
        signs = np.where(np.take_along_axis(images, largest, axis=0)[0] < 0, -1.0, 1.0)
        direction = signs * (np.cos(np.arange(len(rows))) @ images) / length  # a number of it, any would do
        order = np.argsort(_ranks(direction), kind="stable")
        G, length, images = (G * signs)[:, order], length[order], images[:, order]
        unit, indices = price[:, None] * G / length, np.arange(len(order))
        options = [(np.abs(unit).sum(axis=0) * length - np.abs(images).sum(axis=0), indices, indices)]
        for stride in range(1, ALIKE + 1):
            i, j = indices[:-stride], indices[stride:]
            distance = np.abs(unit[:, i] - unit[:, j]).sum(axis=0)
            options.append((2 * distance * length[i] * length[j] / (length[i] + length[j]), i, j))
        costs, first, second = (np.concatenate(part) for part in zip(*options, strict=True))
        pairs = _least(costs, first, second, min(surplus, len(order) // 3 + 1))
        unpaired = pairs[0] == pairs[1]
        (i, j), boxed = pairs[:, ~unpaired], pairs[0, unpaired]
        a, u = length[i] / (length[i] + length[j]), G[:, i] + G[:, j]
        box += np.abs(G[:, boxed]).sum(axis=1) + terms * np.abs(G[:, [*i, *j]]).sum(axis=1)
        box += np.abs(G[:, i] - a * u).sum(axis=1) + np.abs(G[:, j] - (1 - a) * u).sum(axis=1)
        G = np.hstack([np.delete(G, pairs.ravel(), axis=1), u])
    return np.pad(np.hstack([G, np.diag(box * (1 + terms))]), ((0, 0), (0, -surplus)))


def _least(costs: Array, first: Order, second: Order, count: int) -> Order:
    """Choose at most `count` pairs of least cost without a common member, shape (2, pairs)."""
    chosen, members = list[tuple[int, int]](), set[int]()
    for index in np.argsort(_ranks(np.where(costs > 2.0**-40, costs, 0.0)), kind="stable"):
        i, j = int(first[index]), int(second[index])
        if i not in members and j not in members:
            chosen.append((i, j))
            members |= {i, j}
            if len(chosen) == count:
                break
    return np.array(chosen).T


METHODS: dict[str, Callable[[Array, int], Array]] = {
    "pca": pca,
    "girard": girard,
    "combastel": combastel,
    "parallel": parallel,
}
"""Reductions of generators measured in half-widths, to a number of them."""
