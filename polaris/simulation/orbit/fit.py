"""Ellipses of one mean motion that a real orbit is near, for the bound on the model error."""

import math
from dataclasses import replace

import numpy as np

from ...model.errors import ScenarioError
from ...model.system import Array
from .environment import MU, Environment
from .frame import ellipse_place, on_ellipse
from .residual import residual_bound

CIRCLES = 41  # half major axes that are tried, within 0.2 % of the mean osculating one, which J2 ripples by
SHARE = 1e-4  # of the mean motion, by which the real rate may be off the ephemeris


def fit_ellipses(states: Array, env: Environment, motion: float | None) -> tuple[float, float, float]:
    """Return mean motion, largest eccentricity and share of the rate of ellipses that states (N, 6) are on.

    Of several mean motions [rad/s] the one with the least bound on the model error is taken, unless one is
    given. The eccentricity and the share are rounded up to 1e-4, the latter with `SHARE` to spare.

    Raises
    ------
    ScenarioError
        If the orbit is too eccentric, or the mean motion that is given is not near its own.
    """
    p, v = states[:, :3], states[:, 3:]
    R = np.linalg.norm(p, axis=1)
    V, turn = np.sum(p * v, axis=1) / R, np.linalg.norm(np.cross(p, v), axis=1) / R**2
    axis = float(np.mean(1 / (2 / R - np.sum(v * v, axis=1) / MU)))
    tried = axis * (1 + np.linspace(-2e-3, 2e-3, CIRCLES))
    motions = [float(f"{math.sqrt(MU / a**3):.8g}") for a in tried] if motion is None else [motion]
    ranked = []
    for eta in motions:
        near = replace(env, mean_motion=eta)
        largest = math.ceil(1e4 * float(ellipse_place(near, R, V, math.inf)[0].max())) / 1e4
        _, _, rate = on_ellipse(near, *ellipse_place(near, R, V, min(largest, 0.9)))
        share = math.ceil(1e4 * (float(np.abs(turn / eta - rate / eta).max()) + SHARE)) / 1e4
        if largest <= 0.1 and share <= 0.1:
            near = replace(near, eccentricity=largest, rate_deviation=share)
            ranked.append((float(residual_bound(near, 1.0, 1.0, 2 * eta).total), eta, largest, share))
    if not ranked and motion is not None:
        rule = f"must be that of the orbit, near {math.sqrt(MU / axis**3):.8g} rad/s; leave it out"
        raise ScenarioError("system.mean_motion_rad_s", motion, rule)
    if not ranked:
        raise ScenarioError("orbit", f"eccentricity {largest:g}", "must have an eccentricity of at most 0.1")
    return min(ranked)[1:]
