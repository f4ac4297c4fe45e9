"""Intersample bounds: distance of a flight from the chords between its nodes (docs/theory.md, Theorem 10)."""

import numpy as np

from reach.sets.zonotope import Zonotope

from ...model.system import Array
from .affine_law import AffineLaw


def affine_bow(law: AffineLaw, start: Zonotope, k: int) -> Array:
    """Bow of an unclipped tube after each node, shape (q, n).

    `start` is a stack of q sets, the states about the law's own reference at the nodes; k the planning step.
    """
    return _bow(law, k, (law.flow.A_c @ start).extent @ law.flow.growth.T)


def clipped_bow(law: AffineLaw, start: Zonotope, k: int) -> Array:
    """Bow of a tube whose command may be clipped, shape (q, n); arguments as `affine_bow`."""
    system, mu = law.system, law.own.nu[k]
    command = (law.gain @ start).extent + np.maximum(np.abs(mu) - system.u_max, 0)
    push = np.minimum(command, system.u_max + np.abs(mu))
    rate = ((system.A @ start).extent + push @ np.abs(system.B).T) @ law.flow.growth.T
    return _bow(law, k, rate)


def _bow(law: AffineLaw, k: int, rate: Array) -> Array:
    """``h^2/8`` times the curvature of the path and of zeta, and the disturbance of a period.

    `rate`, shape (q, n), bounds the rate of the path about the law's own reference in every period.
    """
    system = law.system
    push = (law.own.nu[k] - law.reference.nu[k]) @ system.B.T
    own = np.abs(law.offset[k][:-1] @ system.A.T + push) @ law.flow.growth.T  # |zeta'|
    path, own = rate @ np.abs(system.A).T, own @ np.abs(system.A).T
    return np.asarray(law.flow.h**2 / 8 * (path + own) + law.flow.period_box)


def at_nodes(parts: Array) -> Array:
    """Bounds at q+1 nodes from those on the q parts between them, shape (..., q+1, n): the larger of both."""
    end = np.zeros((*parts.shape[:-2], 1, parts.shape[-1]))
    left, right = np.concatenate([parts, end], axis=-2), np.concatenate([end, parts], axis=-2)
    return np.asarray(np.maximum(left, right))
