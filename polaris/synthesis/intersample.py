"""What a flight does between its nodes: elementwise bounds for `TubeSegment.bow`.

Under continuous feedback two things are bounded at once: the path itself, and the curve
``y(t)`` of where the error ends up at the next node if S takes over at t (docs/theory.md, Lemma 5).
Under sampled feedback S can only take over at a node.
"""

import numpy as np

from reach.sets.zonotope import Zonotope

from ..model.system import Array
from .affine_law import AffineLaw, clipped_motion


def affine_bow(law: AffineLaw, start: Zonotope, k: int) -> Array:
    """Bow of an unclipped tube after each node, shape (q, n).

    `start` is a stack of q sets, the states about the law's own reference at the nodes; k the planning step.
    """
    flow, safe = law.flow, law.tracking
    image = flow.A_c @ start
    if law.feedback.sampled:
        return _bow(law, k, image.extent @ law.open_flow.growth.T @ np.abs(law.system.A).T)
    rate = image.extent @ flow.growth.T
    path = (flow.A_c @ image).extent @ flow.growth.T
    difference = safe.gain - law.gain
    known = law.own.nu[k] - law.reference.nu[k] + law.offset[k][:-1] @ safe.gain.T
    inputs = np.abs(known + start.c @ difference.T) + np.abs(difference @ start.G).sum(axis=-1)
    return _bow(law, k, path, _switch(law, inputs, rate @ np.abs(difference).T, k))


def clipped_bow(law: AffineLaw, start: Zonotope, k: int) -> Array:
    """Bow of a tube whose command may be clipped, shape (q, n); arguments as `affine_bow`."""
    system, safe, mu = law.system, law.tracking, law.own.nu[k]
    extent = start.extent
    command = (law.gain @ start).extent + np.maximum(np.abs(mu) - system.u_max, 0)
    if law.feedback.sampled:
        push = np.minimum(command, system.u_max + np.abs(mu))
        rate = ((system.A @ start).extent + push @ np.abs(system.B).T) @ law.open_flow.growth.T
        return _bow(law, k, rate @ np.abs(system.A).T)
    moved, push = clipped_motion(law, extent, command, mu)
    rate = (extent + moved) @ np.abs(system.A).T + push @ np.abs(system.B).T
    path = rate @ (np.abs(system.A) + np.abs(system.B) @ np.abs(law.gain)).T
    known = mu - law.reference.nu[k] + law.offset[k][:-1] @ safe.gain.T
    inputs = np.abs(known) + push + (safe.gain @ start).extent
    return _bow(law, k, path, _switch(law, inputs, rate @ (np.abs(safe.gain) + np.abs(law.gain)).T, k))


def _bow(law: AffineLaw, k: int, path: Array, switch: Array | float = 0.0) -> Array:
    """``h^2/8`` times the curvature of path and zeta, or of a switch; and the disturbance of a period."""
    own = _own_rate(law, k) @ np.abs(law.system.A).T  # |zeta''|
    return np.asarray(law.flow.h**2 / 8 * np.maximum(path + own, switch) + law.period_box)


def _own_rate(law: AffineLaw, k: int) -> Array:
    """``|zeta'|`` over each period, for ``zeta = xi_U - xi``, shape (q, n)."""
    system = law.system
    push = (law.own.nu[k] - law.reference.nu[k]) @ system.B.T
    return np.asarray(np.abs(law.offset[k][:-1] @ system.A.T + push) @ law.open_flow.growth.T)


def _switch(law: AffineLaw, inputs: Array, slope: Array, k: int) -> Array:
    """``|y''| = |e^{A_c (t1 - t)} (B Delta' - A_c B Delta)|``, Delta the difference of U's input and S's.

    Bounds, shape (q, m): `inputs` on ``|Delta|`` at the nodes, `slope` on ``|Delta'|`` but for zeta's share.
    """
    system, safe = law.system, law.tracking
    slope = slope + _own_rate(law, k) @ np.abs(safe.gain).T
    inputs = inputs + law.flow.h * slope
    inner = slope @ np.abs(system.B).T + inputs @ np.abs(safe.flow.A_c @ system.B).T
    return np.asarray(inner @ safe.flow.growth.T)


def at_nodes(parts: Array) -> Array:
    """Bounds at q+1 nodes from those on the q parts between them, shape (..., q+1, n): the larger of both."""
    end = np.zeros((*parts.shape[:-2], 1, parts.shape[-1]))
    left, right = np.concatenate([parts, end], axis=-2), np.concatenate([end, parts], axis=-2)
    return np.asarray(np.maximum(left, right))
