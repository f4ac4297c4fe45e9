"""The inspection problem: N deputies about a passive chief, with the values of the paper's Table 1."""

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from reach.numerics.linear import discretize

from ..model.checks import number, of_kind, whole
from ..model.errors import ScenarioError
from ..model.hill import clohessy_wiltshire
from ..model.keys import Key, Positive, Real, check_fields
from ..model.system import Array, LinearSystem
from .constraints.constraint import Constraint
from .vectors import CENTRE

Rate, Opening = Annotated[Real, Field(gt=0, le=0.01)], Annotated[Real, Field(gt=0, lt=180)]
MOST_DEPUTIES = 50  # most deputies of one problem: 50 of them have 1,225 pairs and 5,750 constraints


@dataclass(frozen=True)
class Inspection:
    """Parameters of the inspection problem, in Hill's frame about the chief (Table 1).

    Parameters
    ----------
    deputies : int
        Number N of active spacecraft.
    mass : float [kg]
        Mass m of a deputy.
    mean_motion : float [rad/s]
        Mean motion n of the chief's orbit.
    deputy_radius : float [m]
        Collision radius r_d of a deputy.
    chief_radius : float [m]
        Collision radius r_c of the chief.
    docking_speed : float [m/s]
        Speed limit nu_0 at the chief.
    speed_slope : float [1/s], optional
        Slope nu_1 of the speed limit over distance; by default 2 n.
    delta_v_max : float [m/s]
        Fuel limit.
    field_of_view : float [rad]
        Full opening angle alpha_FOV of the sensor.
    distance_max : float [m]
        Largest distance r_max from the chief.
    passive_time : float [s]
        Duration T of safe free flight.
    speed_max : float [m/s]
        Largest speed v_max along each axis.
    thrust_max : float [N]
        Thrust limit u_max per axis.
    smoothing : float [m]
        Depth of the boundary layer in which the square roots of eqs. 29, 30, 35 and 36 become linear; it
        costs half as much distance.
    constraints : tuple of Constraint
        Of one's own, beside phi1 to phi11.

    Raises
    ------
    ScenarioError
        If a value is out of range, or eq. 28, 32, 36 or 37 does not hold: the thrust is then too weak for
        the constraints to be control invariant. If a collision radius or the field of view is so small
        that a boundary lies within `polaris.inspection.vectors.CENTRE` of a centre or an axis.
    """

    deputies: int = 5
    mass: Annotated[float, Key("mass_kg", "kg", Annotated[Real, Field(ge=1e-3, le=1e7)])] = 12.0
    mean_motion: Annotated[float, Key("mean_motion_rad_s", "rad/s", Rate)] = 0.001027
    deputy_radius: Annotated[float, Key("deputy_radius_m", "m", Positive)] = 5.0
    chief_radius: Annotated[float, Key("chief_radius_m", "m", Positive)] = 5.0
    docking_speed: Annotated[float, Key("docking_speed_m_s", "m/s", Positive)] = 0.2
    speed_slope: Annotated[float | None, Key("speed_slope_1_s", "1/s", Positive)] = None
    delta_v_max: Annotated[float, Key("delta_v_max_m_s", "m/s", Positive)] = 20.0
    field_of_view: Annotated[float, Key("field_of_view_deg", "deg", Opening)] = np.pi / 3
    distance_max: Annotated[float, Key("distance_max_m", "m", Positive)] = 1000.0
    passive_time: Annotated[float, Key("passive_time_s", "s", Positive)] = 500.0
    speed_max: Annotated[float, Key("speed_max_m_s", "m/s", Positive)] = 1.0
    thrust_max: Annotated[float, Key("thrust_max_N", "N", Positive)] = 1.0
    smoothing: Annotated[float, Key("smoothing_m", "m", Positive)] = 0.1
    constraints: tuple[Constraint, ...] = ()

    def __post_init__(self) -> None:
        whole("deputies", self.deputies, 1)
        if self.deputies > MOST_DEPUTIES:
            raise ScenarioError("deputies", self.deputies, f"must be at most {MOST_DEPUTIES}")
        check_fields(self)
        if self.distance_max <= self.separation:
            rule = f"must exceed the sum of the collision radii, {self.separation:g} m"
            raise ScenarioError("distance_max", self.distance_max, rule)
        if self.passive_time * self.mean_motion > np.pi:
            rule = "must be at most half an orbit"
            raise ScenarioError("passive_time", self.passive_time, f"{rule}, {np.pi / self.mean_motion:g} s")
        of_kind("constraints", self.constraints, tuple | list)
        object.__setattr__(self, "constraints", tuple(self.constraints))
        for k, one in enumerate(self.constraints):
            of_kind("constraints", one, Constraint)
            one.check()
            if one.label in [other.label for other in self.constraints[:k]]:
                raise ScenarioError("constraints", one.label, "must have labels, each different")
        self._check_directions()
        self._check_authority()

    def _check_directions(self) -> None:
        """Directions fade below `CENTRE`: no boundary may come as near to a centre or an axis."""
        least = min(self.separation, self.deputy_separation)
        if least <= CENTRE:
            rule = f"two deputies, or one and the chief, must be more than {CENTRE:g} m apart"
            raise ScenarioError("deputy_radius", self.deputy_radius, rule)
        if least * np.sin(self.field_of_view / 2) <= CENTRE:
            widest = 2 * np.arcsin(CENTRE / least)
            rule = f"must exceed {widest:.4g} rad, so that the cone is wider than {CENTRE:g} m at {least:g} m"
            raise ScenarioError("field_of_view", self.field_of_view, rule)

    def _check_authority(self) -> None:
        """Refuse thrust too weak against the natural motion (eqs. 28, 32, 36 and 37)."""
        n, v, r = self.mean_motion, self.speed_max, self.distance_max
        fastest, natural = np.sqrt(3) * v, 3 * n**2 * r + 2 * n * v
        slow_down = self.nu_1 * fastest + 3 * n**2 * (fastest - self.docking_speed) / self.nu_1 + 2 * n * v
        inside = r - self.smoothing
        around = 3 * self.fastest**2 / inside if inside > 0 else np.inf  # half of a_max left: see a_inside
        equations = {
            "eq. 28 (braking before a boundary)": natural,
            "eq. 36 (turning before r_max)": natural + around,
            "eq. 32 (dynamic speed limit)": slow_down,
            "eq. 37 (velocity limit, radial)": natural,
            "eq. 37 (velocity limit, along-track)": 2 * n * v,
            "eq. 37 (velocity limit, cross-track)": n**2 * r,
        }
        broken = [name for name, needed in equations.items() if needed * self.mass >= self.thrust_max]
        if broken:
            least = max(equations.values()) * self.mass
            rule = f"must exceed {least:.4g} N; too weak for {', '.join(broken)}"
            raise ScenarioError("thrust_max", self.thrust_max, rule)

    @property
    def nu_1(self) -> float:
        """Rate at which the allowed speed grows with distance [1/s]."""
        return 2 * self.mean_motion if self.speed_slope is None else self.speed_slope

    @property
    def separation(self) -> float:
        """Least distance between the centres of a deputy and the chief [m]."""
        return self.deputy_radius + self.chief_radius

    @property
    def deputy_separation(self) -> float:
        """Least distance between the centres of two deputies [m]."""
        return 2 * self.deputy_radius

    @property
    def a_max(self) -> float:
        """Acceleration left for braking in the worst case of natural motion [m/s^2] (eq. 28)."""
        n = self.mean_motion
        natural = 3 * n**2 * self.distance_max + 2 * n * self.speed_max
        return self.thrust_max / self.mass - natural

    @property
    def fastest(self) -> float:
        """Largest speed that eqs. 14 and 23 allow anywhere [m/s]."""
        return float(min(np.sqrt(3) * self.speed_max, self.docking_speed + self.nu_1 * self.distance_max))

    @property
    def a_inside(self) -> float:
        """Acceleration left for braking before r_max [m/s^2]: `a_max` less that for going round the sphere.

        The distance's second derivative has a term ``v_t^2 / r`` that pushes outwards, which eq. 28 leaves
        out. With half of a_max or more left, braking begins at most v^2 / a_max, and the layer, from r_max.
        """
        nearest = self.distance_max - self.smoothing - self.fastest**2 / self.a_max
        return self.a_max - self.fastest**2 / nearest

    @property
    def return_speed(self) -> float:
        """Fastest way back that is asked for from outside [m/s].

        The least speed allowed anywhere, so that going back breaks no other speed limit.
        """
        return self.docking_speed

    @cached_property
    def pairs(self) -> NDArray[np.intp]:
        """Unordered pairs of deputies, shape (N (N-1) / 2, 2)."""
        return np.array(list(combinations(range(self.deputies), 2)), dtype=np.intp).reshape(-1, 2)

    @cached_property
    def system(self) -> LinearSystem:
        """Motion of one deputy (eq. 9)."""
        return clohessy_wiltshire(self.mean_motion, self.mass, self.thrust_max)

    def discretize(self, duration: float) -> tuple[Array, Array]:
        """Exact motion over a time with the thrust held: ``x(t + duration) = Phi x + Gamma u``."""
        number("duration", duration)
        return discretize(self.system.A, self.system.B, duration)

    def sun_angle(self, t: ArrayLike, start: ArrayLike = 0.0) -> Array:
        """Angle theta_s of the sun from the x axis [rad] at the time t [s]; it turns at ``-n`` (eq. 11)."""
        return np.asarray(start, dtype=float) - self.mean_motion * np.asarray(t, dtype=float)
