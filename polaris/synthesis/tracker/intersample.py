"""Intersample bounds: distance of a flight from the chords between its nodes (docs/theory.md, Theorem 10)."""

import numpy as np

from reach.sets.zonotope import Zonotope

from ...model.system import Array
from .affine_law import AffineLaw


def affine_bound(law: AffineLaw, start: Zonotope, k: int) -> Array:
    """Intersample bound of an unclipped tube after each node, shape (q, n).

    `start` is a stack of q sets, loop states about the law's own reference at the nodes; k the planning step.
    """
    return _intersample(law, k, (law.closed.rates @ start).extent + law.held_rates)


def clipped_bound(law: AffineLaw, start: Zonotope, k: int) -> Array:
    """Intersample bound of a tube with clipped commands, shape (q, n); arguments as `affine_bound`."""
    loop, mu, u_max, B = law.closed.loop, law.own.nu[k], law.system.u_max, np.abs(law.system.B)
    command = (law.closed.K @ start).extent + np.maximum(np.abs(mu) - u_max, 0)
    push = np.minimum(command, u_max + np.abs(mu))
    rates = np.pad(loop.A, ((0, 0), (0, loop.N - loop.n))) + loop.B @ loop.applied
    rate = (rates @ start).extent + push @ B.T + law.held_rates
    return _intersample(law, k, rate)


def _intersample(law: AffineLaw, k: int, rate: Array) -> Array:
    """``h^2/8`` times the curvature of the path and of zeta, and the disturbance of a period.

    `rate`, shape (q, n), bounds the rate of the path about the law's own reference at every node.
    """
    system, (h, growth) = law.system, (law.flow.h, law.flow.growth)
    push = (law.own.nu[k] - law.reference.nu[k]) @ system.B.T
    zeta = np.abs(law.offset[k][:-1] @ system.A.T + push)  # |zeta'|
    path, zeta = rate @ growth.T @ np.abs(system.A).T, zeta @ growth.T @ np.abs(system.A).T
    return np.asarray(h**2 / 8 * (path + zeta) + law.within_period)


def at_nodes(parts: Array) -> Array:
    """Bounds at q+1 nodes from those on the q parts between them, shape (..., q+1, n): the larger of both."""
    end = np.zeros((*parts.shape[:-2], 1, parts.shape[-1]))
    left, right = np.concatenate([parts, end], axis=-2), np.concatenate([end, parts], axis=-2)
    return np.asarray(np.maximum(left, right))
