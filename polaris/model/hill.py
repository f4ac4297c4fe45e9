"""Clohessy-Wiltshire dynamics in Hill's frame, free flight, natural motion trajectories (Example 1).

Frame: x radial (outward), y along-track, z cross-track; origin at the target.
"""

import numpy as np
from numpy.typing import ArrayLike

from .system import Array, LinearSystem

STATE_NAMES = ("r_x", "r_y", "r_z", "v_x", "v_y", "v_z")


def cw_matrix(mean_motion: float) -> Array:
    """State matrix of eq. 1, shape (6, 6), for a mean motion [rad/s]."""
    eta = mean_motion
    A = np.zeros((6, 6))
    A[:3, 3:] = np.eye(3)
    A[3, 0], A[3, 4] = 3 * eta**2, 2 * eta
    A[4, 3] = -2 * eta
    A[5, 2] = -(eta**2)
    return A


def clohessy_wiltshire(mean_motion: float, mass: float, u_max: ArrayLike, w_max: float = 0.0) -> LinearSystem:
    """The system of Example 1 (eq. 1).

    Parameters
    ----------
    mean_motion : float
        Orbital rate of the target [rad/s].
    mass : float
        Mass of the chaser [kg].
    u_max : array_like, shape (3,) or scalar
        Thrust limit per axis [N].
    w_max : float
        Bound on the 2-norm of the disturbance acceleration [m/s^2].
    """
    zero, eye = np.zeros((3, 3)), np.eye(3)
    return LinearSystem(
        A=cw_matrix(mean_motion),
        B=np.vstack([zero, eye / mass]),
        D=np.vstack([zero, eye]),
        u_max=np.broadcast_to(np.asarray(u_max, dtype=float), (3,)).copy(),
        w_max=w_max,
        C=np.hstack([eye, zero]),
        mass=mass,
        mean_motion=mean_motion,
        state_names=STATE_NAMES,
    )


def free_flight(mean_motion: float, t: ArrayLike) -> Array:
    """Closed-form transition matrices of unforced motion (Dunlap eq. 20), shape (..., 6, 6).

    Parameters
    ----------
    mean_motion : float
        Orbital rate [rad/s], > 0.
    t : array_like
        Times of flight [s], any shape.
    """
    eta = mean_motion
    t = np.asarray(t, dtype=float)
    s, c = np.sin(eta * t), np.cos(eta * t)
    o, i = np.zeros(t.shape), np.ones(t.shape)
    rows = [
        [4 - 3 * c, o, o, s / eta, 2 / eta * (1 - c), o],
        [6 * (s - eta * t), i, o, -2 / eta * (1 - c), (4 * s - 3 * eta * t) / eta, o],
        [o, o, c, o, o, s / eta],
        [3 * eta * s, o, o, c, 2 * s, o],
        [-6 * eta * (1 - c), o, o, -2 * s, 4 * c - 3, o],
        [o, o, -eta * s, o, o, c],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def elliptical_nmt(
    mean_motion: float,
    semi_minor: float,
    phase: ArrayLike,
    cross_track: float = 0.0,
    cross_phase: float = 0.0,
) -> Array:
    """States on a closed elliptical NMT about the target, shape (..., 6).

    Satisfies ``v_y = -2 eta r_x`` and ``v_x = eta r_y / 2`` (eq. 22). The ellipse has semi-minor
    axis `semi_minor` [m] radially and twice that along-track.
    """
    eta, b, psi = mean_motion, semi_minor, np.asarray(phase, dtype=float)
    zeta = psi + cross_phase
    position = b * np.sin(psi), 2 * b * np.cos(psi), cross_track * np.sin(zeta)
    velocity = b * eta * np.cos(psi), -2 * b * eta * np.sin(psi), cross_track * eta * np.cos(zeta)
    return np.stack([*position, *velocity], axis=-1)
