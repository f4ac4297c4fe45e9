"""The forces on two craft in low orbit: central gravity, J2, drag of a resting atmosphere."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...model.errors import ScenarioError
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
