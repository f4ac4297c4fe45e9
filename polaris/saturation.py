"""One period of a feedback law whose command is clipped by the thrusters, as a set."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from reach.flow import LinearFlow
from reach.linear import discretize
from reach.relaxation import clip_relaxation
from reach.zonotope import Zonotope

from .system import Array

if TYPE_CHECKING:
    from .controllers import AffineController


def clipped_step(law: AffineController, d: Zonotope, mu: Array) -> Zonotope:
    """Enclose the next node of ``d' = A d + B (clip(mu - Lambda_U d) - mu) + D w``.

    The clip is replaced by an affine band over the range of the command: at the node for sampled
    feedback (the input is then held), over the whole period for continuous feedback.

    Parameters
    ----------
    law : AffineController
    d : Zonotope
        State relative to the controller's own reference at the node.
    mu : ndarray, shape (m,)
        Its own reference input over the period.
    """
    system, flow = law.system, law.flow
    image = law.gain @ d
    lo, hi = mu - image.c - image.half_widths, mu - image.c + image.half_widths
    if law.feedback.sampled:
        return _sampled(law, d, mu, lo, hi).reduce(20)
    drift = np.zeros_like(mu)
    applied = system.u_max  # bound on |clip|, sharpened by the second pass
    loose = law.open_flow
    extent = np.abs(d.c) + d.half_widths
    for _ in range(2):
        push = np.abs(system.B) @ (applied + np.abs(mu))
        moved = (loose.growth - np.eye(system.n)) @ extent + flow.h * loose.growth @ push + loose.period_box
        drift = np.abs(law.gain) @ moved
        applied = np.minimum(system.u_max, np.maximum(np.abs(lo - drift), np.abs(hi + drift)))
    slope, offset, radius = clip_relaxation(lo - drift, hi + drift, system.u_max)
    step = _relaxed_flow(law, slope)
    _, Bh = discretize(step.A_c, system.B, flow.h)
    known = Bh @ (slope * mu + offset - mu)
    out = step.phi @ d + known + step.period_zonotope
    if np.any(radius > 0):
        lipschitz = np.abs(step.A_c) @ step.growth
        rest = flow.h**2 / 3 * lipschitz @ np.abs(system.B) @ radius
        out = out + Zonotope(np.zeros(system.n), np.hstack([Bh * radius, np.diag(rest)]))
    return out.reduce(20)


def _sampled(law: AffineController, d: Zonotope, mu: Array, lo: Array, hi: Array) -> Zonotope:
    system, h = law.system, law.flow.h
    slope, offset, radius = clip_relaxation(lo, hi, system.u_max)
    Ah, Bh = discretize(system.A, system.B, h)
    out = (Ah - Bh @ (slope[:, None] * law.gain)) @ d + Bh @ (slope * mu + offset - mu)
    band = Zonotope(np.zeros(system.n), Bh * radius)
    return out + band + law.flow.period_zonotope


def _relaxed_flow(law: AffineController, slope: Array) -> LinearFlow:
    key = slope.tobytes()
    if key not in law._cache:
        system = law.system
        A_c = system.A - system.B @ (slope[:, None] * law.gain)
        law._cache[key] = LinearFlow.continuous(A_c, system.D, system.w_max, law.flow.h)
    return law._cache[key]
