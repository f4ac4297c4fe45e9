"""The forces on two craft in low orbit: central gravity, J2, drag of a resting atmosphere."""

from dataclasses import dataclass
from functools import partial
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from ...model.errors import ScenarioError
from ...model.keys import Key, NonNegative, Positive, Real, check_fields
from ...model.system import Array

MU = 3.986004418e14  # gravitational parameter of the Earth [m^3/s^2] (WGS 84)
J2 = 1.08262668e-3  # second zonal harmonic
EARTH_RADIUS_M = 6378137.0  # equatorial radius [m] that J2 refers to

K_J2 = 1.5 * MU * J2 * EARTH_RADIUS_M**2
"""``3/2 mu J2 R_E^2`` [m^5/s^2]: J2's acceleration at distance d is of the size ``K_J2 / d^4``."""

Given = partial(Key, required=True)
Right, Tenth = Annotated[Real, Field(ge=0, le=90)], Annotated[Real, Field(ge=0, le=0.1)]


@dataclass(frozen=True)
class Environment:
    """The target's real orbit, near an ellipse and perturbed by J2 and drag.

    The disturbance bound must cover the error of Hill's equations that follows (`polaris model-error`). While
    the guarantee holds, the target must stay within these deviations of a point on an ellipse with the
    system's mean motion and at most this eccentricity.

    Parameters
    ----------
    mean_motion : float
        eta [rad/s] of Hill's linear equations.
    inclination_max : float [rad]
        Largest inclination, of a retrograde orbit 180 degrees minus it; 90 covers every orbit.
    radius_deviation : float [m]
        Largest deviation of the geocentric distance.
    radial_rate : float [m/s]
        Largest deviation of its rate.
    rate_deviation : float
        Largest relative deviation of the frame's rate about the orbit normal.
    density : float [kg/m^3]
        Air density at the semi-major axis.
    scale_height : float [m]
        Smallest scale height of the density.
    ballistic : float [m^2/kg]
        Drag coefficient times area over mass of the target.
    ballistic_difference : float [m^2/kg]
        Largest difference of another craft's coefficient.
    other : float [m/s^2]
        Bound on all other relative accelerations, such as radiation pressure.
    eccentricity : float
        Largest eccentricity.
    j2 : bool
        Whether J2 acts; without it (and without density) what is left is the two-body problem.
    """

    mean_motion: float
    inclination_max: Annotated[float, Key("inclination_max_deg", "deg", Right)] = np.pi / 2
    radius_deviation: Annotated[float, Given("radius_deviation_max_m", "m", NonNegative)] = 0.0
    radial_rate: Annotated[float, Given("radial_rate_max_m_s", "m/s", NonNegative)] = 0.0
    rate_deviation: Annotated[float, Given("rate_deviation_max", "-", Tenth)] = 0.0
    density: Annotated[float, Given("density_kg_m3", "kg/m^3", NonNegative)] = 0.0
    scale_height: Annotated[float, Given("scale_height_m", "m", Positive)] = 1e4
    ballistic: Annotated[float, Given("ballistic_coefficient_m2_kg", "m^2/kg", NonNegative)] = 0.0
    ballistic_difference: Annotated[float, Given("ballistic_difference_max_m2_kg", "m^2/kg", NonNegative)] = (
        0.0
    )
    other: Annotated[float, Key("other_acceleration_max_m_s2", "m/s^2", NonNegative)] = 0.0
    eccentricity: Annotated[float, Key("eccentricity_max", "-", Tenth)] = 0.0
    j2: bool = True

    def __post_init__(self) -> None:
        check_fields(self, "orbit")

    @classmethod
    def from_scenario(cls, scenario: Any) -> "Environment":
        """Return the environment a scenario declares.

        Raises
        ------
        ScenarioError
            If it has no ``[orbit]`` table.
        """
        table, eta = scenario.model.orbit, scenario.system().mean_motion
        if table is None or eta is None:
            rule = "must be given to bound the model error (see the scenario reference)"
            raise ScenarioError("orbit", None, rule, scenario.source)
        environment: Environment = table.make("orbit", mean_motion=eta)
        return environment

    @property
    def radius(self) -> float:
        """Half the major axis, a [m], of Kepler orbits of that mean motion: the radius of the circle."""
        return float((MU / self.mean_motion**2) ** (1 / 3))

    @property
    def distances(self) -> tuple[float, float]:
        """Least and largest distance [m] of the target from the Earth's centre."""
        deviation = self.radius * self.eccentricity + self.radius_deviation
        return self.radius - deviation, self.radius + deviation

    @property
    def ellipse_rates(self) -> tuple[float, float, float]:
        """Least and largest rate of true anomaly [rad/s], and largest radial rate [m/s], on the ellipses."""
        e, eta = self.eccentricity, self.mean_motion
        slow, fast = (eta * np.sqrt(1 + s * e) / (1 - s * e) ** 1.5 for s in (-1, 1))
        return float(slow), float(fast), float(e * self.radius * eta / np.sqrt(1 - e**2))

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
        return np.asarray((-0.5 * self.density_at(d) * ballistic * speed)[..., None] * velocity)
