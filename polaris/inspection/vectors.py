"""Vectors along the last axis: inner products, lengths and directions that stay continuous at zero."""

import numpy as np

from ..model.system import Array

CENTRE = 0.1
"""Below this distance [m] from a centre or an axis, directions fade to zero instead of jumping.

Both lie inside what must be avoided, or are far from any boundary: nothing admissible is changed.
"""

STANDSTILL = 1e-6
"""Below this speed [m/s] the length of the velocity is rounded off, upwards by at most half of it."""


def dot(a: Array, b: Array) -> Array:
    """Inner products along the last axis."""
    # The first is quicker for a few vectors, the second for thousands.
    return np.asarray(np.vecdot(a, b) if a.size < 1000 else np.einsum("...i,...i->...", a, b))


def length(vectors: Array) -> Array:
    """Lengths along the last axis."""
    return np.asarray(np.sqrt(dot(vectors, vectors)))


def rounded_length(vectors: Array, least: float) -> tuple[Array, Array]:
    """Length and direction, both continuous: below `least` the length is a parabola (never too small)."""
    exact = length(vectors)
    if not (exact < least).any():
        return exact, vectors / exact[..., None]
    bounded = np.maximum(exact, least)
    rounded = exact + (bounded - exact) ** 2 / (2 * least)
    return rounded, vectors / bounded[..., None]


def turning(vectors: Array, outward: Array, along: Array, distance: Array) -> Array:
    """Change of a direction for a motion along `vectors`: their part across it, over the distance.

    Closer than `CENTRE` a direction is the position over `CENTRE`, and all of the motion changes it.
    """
    if (distance <= CENTRE).any():
        along = np.where(distance > CENTRE, along, 0.0)
        distance = np.maximum(distance, CENTRE)
    return (vectors - along[..., None] * outward) / distance[..., None]
