"""Order reduction: fewer generators, a set that still contains the original."""

from __future__ import annotations

import numpy as np

from .errors import ReachError
from .zonotope import Zonotope


def reduce(zonotope: Zonotope, order: float, method: str = "pca") -> Zonotope:
    """Enclose a zonotope by one with at most ``order * n`` generators.

    Keeps the longest generators and encloses the rest in a parallelotope of n generators.

    Parameters
    ----------
    zonotope : Zonotope
        One set or a stack (a stack is reduced set by set).
    order : float
        Largest number of generators per dimension, >= 1.
    method : {"pca", "girard"}
        Frame of the parallelotope: principal axes of what is enclosed, or the coordinate axes
        (Girard 2005).

    Raises
    ------
    ReachError
        If `order` is below 1 or the method is unknown.
    """
    if method not in ("pca", "girard"):
        raise ReachError(f"method must be 'pca' or 'girard', got {method!r}")
    if not order >= 1:
        raise ReachError(f"order must be at least 1, got {order}")
    n, g = zonotope.dim, zonotope.order_count
    budget = int(order * n)
    if g <= budget:
        return zonotope
    if zonotope.batch:
        flat_c, flat_G = zonotope.c.reshape(-1, n), zonotope.G.reshape(-1, n, g)
        parts = [reduce(Zonotope(c, G), order, method) for c, G in zip(flat_c, flat_G, strict=True)]
        out = Zonotope.stack(parts)
        shape = zonotope.batch
        return Zonotope(out.c.reshape(*shape, n), out.G.reshape(*shape, n, out.order_count))
    # Units differ between axes: lengths are compared after scaling by the hull.
    scale = np.where(zonotope.half_widths > 0, zonotope.half_widths, 1.0)
    G = zonotope.G / scale[:, None]
    longest = np.argsort(-np.linalg.norm(G, axis=0), kind="stable")
    kept, merged = longest[: budget - n], longest[budget - n :]
    frame = np.eye(n)
    if method == "pca":
        frame = np.linalg.svd(G[:, merged], full_matrices=True)[0]
    radii = np.abs(frame.T @ G[:, merged]).sum(axis=1)
    # The computed frame is orthogonal only to rounding; enclosing F F^T x instead of x would miss
    # by that much, so the radii are inflated to cover it.
    slack = 4 * np.finfo(float).eps * n * len(merged) * (1 + radii.max(initial=0.0))
    box = frame * (radii + slack)
    return Zonotope(zonotope.c, np.hstack([zonotope.G[:, kept], box * scale[:, None]]))
