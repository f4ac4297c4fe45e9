"""Orbits in inertial axes: Kepler's elements, propagation with J2 and drag, and states in Hill's frame.

Inertial axes have the Earth's axis as z (EME2000 and TEME are within 0.2 degrees of it until 2035). Hill's
frame keeps the target's velocity in its x-y plane, so it turns at ``(omega_x, 0, omega_z)``: J2 tilts it by
up to 2e-6 rad/s in low orbit. Velocities in it are those that an observer sees who turns with it.
"""

import itertools

import numpy as np
from scipy.integrate import solve_ivp

from ...model.errors import NotCertified
from ...model.system import Array
from .environment import K_J2, MU, Environment

MOST_RATES = 60_000  # evaluations, some seconds: twenty revolutions need fewer unless drag is absurd
AXIS = np.array([0.0, 0.0, 1.0])  # of the Earth


def state_of_elements(
    a: float, e: float, inclination: float, node: float, perigee: float, anomaly: float
) -> Array:
    """Return the inertial state (6,) [m, m/s] of Kepler's elements [m, -, rad; true anomaly]."""
    p, c, s = a * (1 - e**2), np.cos(anomaly), np.sin(anomaly)
    place = p / (1 + e * c) * np.array([c, s, 0.0])
    velocity = np.sqrt(MU / p) * np.array([-s, e + c, 0.0])
    turn = _about(2, node) @ _about(0, inclination) @ _about(2, perigee)
    return np.concatenate([turn @ place, turn @ velocity])


def _about(axis: int, angle: float) -> Array:
    """Rotation matrix about an axis of coordinates."""
    i, j = (axis + 1) % 3, (axis + 2) % 3
    turn = np.eye(3)
    turn[[i, j], [i, j]] = np.cos(angle)
    turn[j, i] = np.sin(angle)
    turn[i, j] = -turn[j, i]
    return turn


def elements_of_state(state: Array) -> tuple[float, float, float, float, float, float]:
    """Return Kepler's elements of an inertial state (6,): a [m], e, then angles [rad] as above.

    Where a node or a perigee does not exist, the x axis or the node stands for it.
    """
    r, v = state[:3], state[3:]
    R, h = float(np.linalg.norm(r)), np.cross(r, v)
    inward = np.cross(v, h) / MU - r / R
    e, normal = float(np.linalg.norm(inward)), h / np.linalg.norm(h)
    node = np.cross(AXIS, normal)
    node = node / size if (size := float(np.linalg.norm(node))) > 1e-11 else np.array([1.0, 0.0, 0.0])
    ahead = np.cross(normal, node)
    perigee = float(np.arctan2(inward @ ahead, inward @ node)) if e > 1e-11 else 0.0
    latitude = float(np.arctan2(r @ ahead, r @ node))
    a = 1 / (2 / R - float(v @ v) / MU)
    angles = np.arctan2(node[1], node[0]), perigee, latitude - perigee
    ascending, perigee, anomaly = (float(angle % (2 * np.pi)) for angle in angles)
    return a, e, float(np.arctan2(np.hypot(normal[0], normal[1]), normal[2])), ascending, perigee, anomaly


def propagate(env: Environment, state: Array, times: Array) -> Array:
    """Inertial states (N, 6) at increasing times [s] from 0 on under gravity, J2 and drag of the target.

    Raises
    ------
    NotCertified
        If the integration does not reach the last of them.
    """
    count = itertools.count()

    def rate(_: float, x: Array) -> Array:
        if next(count) > MOST_RATES:
            raise NotCertified(
                "the target's orbit cannot be integrated; check density_kg_m3 and ballistic_coefficient_m2_kg"
            )
        pull = env.gravity(x[:3], AXIS) + env.drag(x[:3], x[3:], env.ballistic)
        return np.concatenate([x[3:], pull])

    span = 0.0, max(float(times[-1]), 1e-9)
    solution = solve_ivp(rate, span, state, method="DOP853", t_eval=times, rtol=1e-12, atol=1e-6)
    if not solution.success or not np.isfinite(solution.y).all():
        raise NotCertified(f"the target's orbit cannot be integrated ({solution.message})")
    return np.asarray(solution.y.T)


def hill_axes(target: Array, j2: bool = True) -> tuple[Array, Array]:
    """Axes of Hill's frame as rows (..., 3, 3), and its rotation (..., 3) [rad/s] in these axes."""
    p, v = target[..., :3], target[..., 3:]
    R = np.linalg.norm(p, axis=-1, keepdims=True)
    h = np.cross(p, v)
    size = np.linalg.norm(h, axis=-1, keepdims=True)
    axes = np.stack([p / R, np.cross(h / size, p / R), h / size], axis=-2)
    pole = axes @ AXIS
    normal = -2 * (K_J2 if j2 else 0.0) / R**4 * pole[..., :1] * pole[..., 2:]
    return axes, np.concatenate([normal * R / size, np.zeros_like(R), size / R**2], axis=-1)


def to_hill(target: Array, chaser: Array, j2: bool = True) -> Array:
    """States (..., 6) in the target's frame of craft at inertial states (..., 6)."""
    axes, omega = hill_axes(target, j2)
    r = np.einsum("...ij,...j->...i", axes, chaser[..., :3] - target[..., :3])
    v = np.einsum("...ij,...j->...i", axes, chaser[..., 3:] - target[..., 3:])
    return np.concatenate([r, v - np.cross(omega, r)], axis=-1)


def from_hill(target: Array, x: Array, j2: bool = True) -> Array:
    """Inertial states (..., 6) of craft at states (..., 6) in the target's frame: inverse of `to_hill`."""
    axes, omega = hill_axes(target, j2)
    r, v = x[..., :3], x[..., 3:] + np.cross(omega, x[..., :3])
    rotated = [np.einsum("...ji,...j->...i", axes, part) for part in (r, v)]
    return np.asarray(target + np.concatenate(rotated, axis=-1))
