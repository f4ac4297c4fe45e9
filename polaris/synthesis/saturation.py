"""One period of a feedback law whose command is clipped by the thrusters, as a set."""

import numpy as np

from reach.numerics.linear import discretize
from reach.numerics.relaxation import clip_relaxation
from reach.sets.zonotope import Zonotope

from ..model.system import Array
from .affine_law import AffineLaw

SLOPES = 8  # different slopes of the relaxed clip per axis: each needs its own matrix exponentials, kept


def clipped_step(law: AffineLaw, d: Zonotope, mu: Array) -> tuple[Zonotope, Array]:
    """Enclose the next node of ``d' = A d + B (clip(mu - Lambda_U d) - mu) + D w``.

    d is relative to the law's own reference, mu, shape (m,), that reference's input. Returned with the set
    are the slopes of the band, shape (m,): what the set rests on, and a certificate repeats.
    """
    phi, known, push, slope = clipped_map(law, d, mu)
    noise = law.flow if law.feedback.sampled else law.relaxed_flow(slope)
    out = phi @ d + known + noise.period_zonotope
    return (out + push if np.any(push.G) else out).reduce(6), slope


def clipped_map(law: AffineLaw, d: Zonotope, mu: Array) -> tuple[Array, Array, Zonotope, Array]:
    """What `clipped_step` makes of d but for the disturbance, ``phi d + known + push``, and the slopes.

    The clip is replaced by an affine band over the range of the command: at the node for sampled
    feedback (the input is then held), over the whole period for continuous feedback.
    """
    system = law.system
    image = law.gain @ d
    lo, hi = mu - image.c - image.half_widths, mu - image.c + image.half_widths
    if law.feedback.sampled:
        slope, offset, radius = clip_relaxation(lo, hi, system.u_max)
        Ah, Bh = discretize(system.A, system.B, law.flow.h)
        known = Bh @ (slope * mu + offset - mu)
        return Ah - Bh @ (slope[:, None] * law.gain), known, Zonotope(np.zeros(system.n), Bh * radius), slope
    command = np.maximum(np.abs(mu - lo), np.abs(hi - mu)) + np.maximum(np.abs(mu) - system.u_max, 0)
    moved, _ = clipped_motion(law, d.extent, command, mu)
    drift = np.abs(law.gain) @ moved
    slope, offset, radius = clip_relaxation(lo - drift, hi + drift, system.u_max, SLOPES)
    step = law.relaxed_flow(slope)
    push = step.input_zonotope(system.B, np.diag(radius), np.abs(system.B) @ radius)
    return step.phi, step.input_map(system.B) @ (slope * mu + offset - mu), push, slope


def clipped_motion(law: AffineLaw, extent: Array, command: Array, mu: Array) -> tuple[Array, Array]:
    """How far a clipped law moves within one period, and how hard it can push, elementwise.

    From bounds on ``|d|`` at the node (..., n) and on ``|Lambda_U d|`` there (..., m), plus what mu (m,), the
    law's own input, exceeds the limits by: bounds on ``|d(s) - d(0)|``, disturbance included, and on
    ``|clip(mu - Lambda_U d) - mu|``: at most ``|Lambda_U d|``, as the clip has slope at most 1, and at most
    what the thrusters have.
    """
    system, loose = law.system, law.open_flow
    most = system.u_max + np.abs(mu)
    push = np.broadcast_to(most, command.shape)
    still = extent @ (loose.growth - np.eye(system.n)).T + loose.period_box
    for _ in range(3):
        moved = still + loose.h * push @ np.abs(system.B).T @ loose.growth.T
        push = np.minimum(most, command + moved @ np.abs(law.gain).T)
    return still + loose.h * push @ np.abs(system.B).T @ loose.growth.T, push
