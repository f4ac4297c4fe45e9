"""Hill's frame of a real target: its orbit in six numbers, its rotation, and exact relative motion.

The target's state is ``[R, R', h, p_x, p_y, p_z]``: distance from the Earth's centre [m], its rate [m/s],
specific angular momentum [m^2/s], and the Earth's axis as seen in the frame (x radial, y along-track, z
along the orbit's normal). The frame turns at ``omega = (omega_x, 0, omega_z)``, for it keeps the velocity in
its x-y plane.
"""

import numpy as np

from ...model.hill import cw_matrix
from ...model.system import Array
from .environment import MU, Environment


def frame_rates(env: Environment, target: Array) -> tuple[Array, Array, Array]:
    """Rotation of the frame [rad/s], its rate of change [rad/s^2], and the rate of the target's state.

    Shapes (..., 3), (..., 3), (..., 6), for targets (..., 6).
    """
    R, V, h = target[..., 0], target[..., 1], target[..., 2]
    px, py, pz = target[..., 3], target[..., 4], target[..., 5]
    turn = h / R**2
    force = env.k_j2 / R**4
    speed = np.hypot(V, R * turn)
    brake = 0.5 * env.density_at(R) * env.ballistic * speed
    radial = -force * (1 - 3 * px**2) - brake * V
    along = -2 * force * px * py - brake * R * turn
    normal = -2 * force * px * pz
    tilt = normal / (R * turn)  # omega_x
    turn_rate = (along - 2 * V * turn) / R
    zero = np.zeros_like(R)
    omega = np.stack([tilt, zero, turn], axis=-1)
    pole_rate = np.stack([turn * py, -turn * px + tilt * pz, -tilt * py], axis=-1)
    normal_rate = -2 * force * (pole_rate[..., 0] * pz + px * pole_rate[..., 2]) - 4 * V / R * normal
    tilt_rate = normal_rate / (R * turn) - tilt * (V / R + turn_rate / turn)
    rate = np.concatenate(
        [np.stack([V, R * turn**2 - MU / R**2 + radial, R * along], axis=-1), pole_rate], axis=-1
    )
    return omega, np.stack([tilt_rate, zero, turn_rate], axis=-1), rate


def relative_rate(
    env: Environment, target: Array, x: Array, ballistic: Array | float
) -> tuple[Array, Array, Array]:
    """Exact free motion of another craft in the target's frame.

    For targets and states x (..., 6) [m, m/s] of craft with that drag coefficient times area over mass
    [m^2/kg]. Returned are the rates of both, without thrust, and what Hill's linear equations leave out of
    the acceleration (..., 3) [m/s^2].
    """
    omega, omega_rate, target_rate = frame_rates(env, target)
    p, v = x[..., :3], x[..., 3:]
    origin = np.zeros_like(p)
    origin[..., 0] = target[..., 0]
    pole, place = target[..., 3:], origin + p
    orbital = np.zeros_like(p)  # inertial velocity of the target, in the frame's axes
    orbital[..., 0], orbital[..., 1] = target[..., 1], target[..., 0] * omega[..., 2]
    across = np.cross(omega, p)
    pull = env.gravity(place, pole) - env.gravity(origin, pole)
    pull = pull + env.drag(place, orbital + v + across, ballistic) - env.drag(origin, orbital, env.ballistic)
    acceleration = pull - 2 * np.cross(omega, v) - np.cross(omega_rate, p) - np.cross(omega, across)
    linear = (x @ cw_matrix(env.mean_motion).T)[..., 3:]
    return np.concatenate([v, acceleration], axis=-1), target_rate, acceleration - linear


def on_ellipse(env: Environment, eccentricity: Array, anomaly: Array) -> tuple[Array, Array, Array]:
    """Distance [m], its rate [m/s] and the rate of true anomaly [rad/s] on ellipses of the mean motion.

    Eccentricities and eccentric anomalies [rad] have any shapes that go together.
    """
    e, a, eta = eccentricity, env.radius, env.mean_motion
    share = 1 - e * np.cos(anomaly)
    return a * share, a * eta * e * np.sin(anomaly) / share, eta * np.sqrt(1 - e**2) / share**2


def ellipse_place(env: Environment, R: Array, V: Array, most: float) -> tuple[Array, Array]:
    """Eccentricity and eccentric anomaly [rad] of the ellipse of the mean motion through (R, R') [m, m/s].

    Eccentricities beyond the largest are replaced by it, at the same anomaly.
    """
    across = 1 - R / env.radius
    ahead = R * V / (env.radius**2 * env.mean_motion)
    return np.minimum(np.hypot(across, ahead), most), np.arctan2(ahead, across)


def near_circular(env: Environment, latitude: Array, inclination: Array | float) -> Array:
    """Target states whose orbit stays as near to the circle as J2 lets it, shape (..., 6).

    To first order in J2 the radius then differs from a constant only by a ripple of twice the orbital rate,
    and the mean rate is the mean motion. Arguments of latitude and inclinations are in rad.
    """
    u, i = np.broadcast_arrays(np.asarray(latitude, dtype=float), np.asarray(inclination, dtype=float))
    a, eta = env.radius, env.mean_motion
    small, s2 = env.k_j2 / (MU * a**2), np.sin(i) ** 2
    # R'' = h^2/R^3 - mu/R^2 - k/R^4 (1 - 3 s2 sin^2 u), h' = -k/R^3 s2 sin 2u, linearised about the circle
    # with the mean rate held at eta: the constant parts of R and h, then the forced ripple at 2 eta.
    ripple = small * s2 / 6 * a
    steady = a * small * (1 - 1.5 * s2) / 3
    R = a + steady + ripple * np.cos(2 * u)
    V = -2 * eta * ripple * np.sin(2 * u)
    h = eta * (a + steady) ** 2 + eta * a**2 * small * s2 / 2 * np.cos(2 * u)
    pole = np.stack([np.sin(i) * np.sin(u), np.sin(i) * np.cos(u), np.cos(i)], axis=-1)
    return np.concatenate([np.stack([R, V, h], axis=-1), pole], axis=-1)


def near_ellipse(
    env: Environment, latitude: Array, inclination: Array | float, eccentricity: Array, anomaly: Array
) -> Array:
    """Target states on ellipses, shape (..., 6), each with the ripple of J2 that a circle has there.

    Arguments of latitude, inclinations and eccentric anomalies are in rad.
    """
    state = near_circular(env, latitude, inclination)
    R, V, turn = on_ellipse(env, eccentricity, anomaly)
    state[..., :3] += np.stack([R, V, R**2 * turn], axis=-1)
    state[..., [0, 2]] -= env.radius, env.radius**2 * env.mean_motion
    return state
