"""Forces on two craft in low orbit (central gravity, J2, drag of a resting atmosphere), and Hill's frame.

That of a real target: its orbit in six numbers, its rotation, and exact relative motion. The target's state
is ``[R, R', h, p_x, p_y, p_z]``: distance from the Earth's centre [m], its rate [m/s], specific angular
momentum [m^2/s], and the Earth's axis as seen in the frame (x radial, y along-track, z along the orbit's
normal). The frame turns at ``omega = (omega_x, 0, omega_z)``, for it keeps the velocity in its x-y plane.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...model.errors import ScenarioError
from ...model.hill import cw_matrix
from ...model.system import Array

MU = 3.986004418e14  # gravitational parameter of the Earth [m^3/s^2] (WGS 84)
J2 = 1.08262668e-3  # second zonal harmonic
EARTH_RADIUS_M = 6378137.0  # equatorial radius [m] that J2 refers to

K_J2 = 1.5 * MU * J2 * EARTH_RADIUS_M**2
"""``3/2 mu J2 R_E^2`` [m^5/s^2]: J2's acceleration at distance d is of the size ``K_J2 / d^4``."""


@dataclass(frozen=True)
class Environment:
    """Numbers of the ``[orbit]`` table, with the circle that the system's mean motion stands for.

    Parameters
    ----------
    mean_motion : float
        eta [rad/s] of Hill's linear equations.
    inclination_max : float
        [rad], at most pi/2.
    radius_deviation, radial_rate : float
        Bounds on ``|R - a|`` [m] and ``|R'|`` [m/s] of the target.
    rate_deviation : float
        Bound on ``|omega_z - eta| / eta``.
    density : float
        At the radius of the circle [kg/m^3].
    scale_height : float
        [m]
    ballistic, ballistic_difference : float
        Drag coefficient times area over mass [m^2/kg]: the target's, and how far another's may be off.
    other : float
        Further relative acceleration [m/s^2].
    j2 : bool
        Whether J2 acts; without it (and without density) what is left is the two-body problem.
    """

    mean_motion: float
    inclination_max: float = np.pi / 2
    radius_deviation: float = 0.0
    radial_rate: float = 0.0
    rate_deviation: float = 0.0
    density: float = 0.0
    scale_height: float = 1e4
    ballistic: float = 0.0
    ballistic_difference: float = 0.0
    other: float = 0.0
    j2: bool = True

    @classmethod
    def of(cls, scenario: Any) -> "Environment":
        """The environment a scenario declares.

        Raises
        ------
        ScenarioError
            If it has no ``[orbit]`` table.
        """
        spec, eta = scenario.model.orbit, scenario.system().mean_motion
        if spec is None or eta is None:
            rule = "is required: it says what the linear model leaves out (see the scenario reference)"
            raise ScenarioError("orbit", None, rule, scenario.source)
        return cls(
            eta,
            np.radians(spec.inclination_max_deg),
            spec.radius_deviation_max_m,
            spec.radial_rate_max_m_s,
            spec.rate_deviation_max,
            spec.density_kg_m3,
            spec.scale_height_m,
            spec.ballistic_coefficient_m2_kg,
            spec.ballistic_difference_max_m2_kg,
            spec.other_acceleration_max_m_s2,
        )

    @property
    def radius(self) -> float:
        """Radius a [m] of the circular Kepler orbit of that mean motion."""
        return float((MU / self.mean_motion**2) ** (1 / 3))

    @property
    def k_j2(self) -> float:
        """``3/2 mu J2 R_E^2`` [m^5/s^2], 0 where J2 is left out."""
        return K_J2 if self.j2 else 0.0

    def density_at(self, distance: Array) -> Array:
        """Density [kg/m^3] at distances from the Earth's centre [m]: exponential."""
        return np.asarray(self.density * np.exp((self.radius - distance) / self.scale_height))

    def gravity(self, place: Array, pole: Array) -> Array:
        """Central and J2 acceleration [m/s^2] at places (..., 3) for the Earth's axis (..., 3)."""
        d = np.linalg.norm(place, axis=-1, keepdims=True)
        return np.asarray(-MU * place / d**3 + self.oblate(place, pole))

    def oblate(self, place: Array, pole: Array) -> Array:
        """J2's acceleration alone [m/s^2], shape (..., 3)."""
        d = np.linalg.norm(place, axis=-1, keepdims=True)
        up = np.sum(place * pole, axis=-1, keepdims=True)
        return np.asarray(-self.k_j2 / d**5 * ((1 - 5 * (up / d) ** 2) * place + 2 * up * pole))

    def drag(self, place: Array, velocity: Array, ballistic: Array | float) -> Array:
        """Acceleration [m/s^2] by air at rest in inertial space; inertial velocity [m/s], shape (..., 3)."""
        d = np.linalg.norm(place, axis=-1)
        speed = np.linalg.norm(velocity, axis=-1)
        size = -0.5 * self.density_at(d) * ballistic * speed
        return np.asarray(size[..., None] * velocity)


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
    own = np.zeros_like(p)  # inertial velocity of the target, in the frame's axes
    own[..., 0], own[..., 1] = target[..., 1], target[..., 0] * omega[..., 2]
    across = np.cross(omega, p)
    pull = env.gravity(place, pole) - env.gravity(origin, pole)
    pull = pull + env.drag(place, own + v + across, ballistic) - env.drag(origin, own, env.ballistic)
    acceleration = pull - 2 * np.cross(omega, v) - np.cross(omega_rate, p) - np.cross(omega, across)
    linear = (x @ cw_matrix(env.mean_motion).T)[..., 3:]
    return np.concatenate([v, acceleration], axis=-1), target_rate, acceleration - linear


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
