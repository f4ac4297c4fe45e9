"""A bound on the error of Hill's linear equations, sound over whole sets of relative states.

Every part is an inequality proven in docs/model-error-theory.md; nothing here is sampled.
"""

import math
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike

from ...model.errors import ScenarioError
from ...model.system import Array
from ...model.tolerances import ROUNDING
from .environment import MU, Environment


@dataclass(frozen=True, eq=False)
class Residual:
    """Bounds on the parts of the residual acceleration [m/s^2], each of the shape of the sets asked for.

    Central gravity beyond its gradient at the target; that gradient and the turning of the frame on an
    ellipse instead of the circle; the gradient where the target's distance is not that of the ellipse; J2's
    pull on the two craft; Coriolis, centrifugal and Euler terms of a frame that does not turn as on the
    ellipse; drag by different ballistic coefficients; drag by different density and velocity; what is
    declared.
    """

    curvature: Array
    eccentricity: Array
    radius: Array
    oblateness: Array
    rotation: Array
    drag_ballistic: Array
    drag_place: Array
    other: Array

    @property
    def parts(self) -> dict[str, Array]:
        """All parts by name."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @property
    def total(self) -> Array:
        """Their sum, with round-off: a bound on the 2-norm of the residual."""
        return np.asarray(sum(self.parts.values()) * (1 + ROUNDING))


def residual_bound(env: Environment, radial: ArrayLike, distance: ArrayLike, speed: ArrayLike) -> Residual:
    """Bound the residual over ``|r_x| <= radial, norm(r) <= distance, norm(v) <= speed`` [m, m, m/s].

    The environment bounds the target's orbit and the forces.
    """
    x, r, v = np.broadcast_arrays(*(np.asarray(value, dtype=float) for value in (radial, distance, speed)))
    near = env.distances[0]
    if not np.all(near - r > 0.5 * env.radius):
        rule = "must be smaller: it reaches half-way to the Earth's centre"
        raise ScenarioError("orbit.radius_deviation_max_m", env.radius_deviation, rule)
    closest = near - r  # of any point on the line between the two craft
    turns = _turning(env)
    return Residual(
        curvature=3 * MU * r**2 / closest**4,
        eccentricity=_eccentric(env, x, r, v),
        radius=2 * MU * (near**-3 - (near + env.radius_deviation) ** -3) * r,
        oblateness=env.k_j2 / closest**5 * _gradient(env.inclination_max + r / closest) * r,
        rotation=2 * turns.wobble * v + (turns.centrifugal + turns.euler) * r,
        drag_ballistic=0.5 * env.ballistic_difference * _dense(env, r) * _fast(env, r, v) ** 2,
        drag_place=_drag_place(env, x, r, v),
        other=np.full(r.shape, env.other),
    )


def two_digits(value: float) -> float:
    """Return the next number up with two significant digits."""
    if value <= 0:
        return 0.0
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return float(f"{math.ceil(value / unit * (1 - 1e-12)) * unit:.1e}")


PIECES = 64  # into which the range of e cos(anomaly) is cut; with more the bound of ellipses falls by little


def _eccentric(env: Environment, x: Array, r: Array, v: Array) -> Array:
    """Linear relative motion on any of the ellipses, at any place on it, against that on the circle.

    With ``q = 1 + alpha, alpha = e cos(anomaly)`` and ``m`` the square of ``eta / (1 - e^2)^(3/2)`` the frame
    turns at ``sqrt(m) q^2``, which changes at ``-2 m q^3 e sin(anomaly)``, and gravity has the gradient
    ``m q^3 diag(2, -1, -1)``. All are monotone in q and m, so the ends of each piece bound them there.
    """
    e, eta = env.eccentricity, env.mean_motion
    ends = np.linspace(-e, e, PIECES + 1)
    low, high, nearest = 1 + ends[:-1], 1 + ends[1:], np.minimum(np.abs(ends[:-1]), np.abs(ends[1:]))
    nearest[(ends[:-1] <= 0) & (ends[1:] >= 0)] = 0.0
    m = eta**2 / (1 - e**2) ** 3  # the largest; eta^2 is the least
    radial = np.maximum(m * (high**4 + 2 * high**3) - 3 * eta**2, eta**2 * (3 - low**4 - 2 * low**3))
    along = m * high**3 * np.maximum(np.abs(low - 1), np.abs(high - 1))
    normal = np.maximum(m * high**3 - eta**2, eta**2 * (1 - low**3))
    euler = 2 * m * high**3 * np.sqrt(e**2 - nearest**2)
    slow, fast, _ = env.ellipse_rates
    first = float(np.max(np.hypot(radial, euler)))  # of a radial unit vector
    other = float(np.max(np.maximum(np.hypot(along, euler), normal)))  # of one across it
    size = max(np.hypot(first, other), np.finfo(float).tiny)
    height = np.minimum(
        np.minimum(x, r), r * first / size
    )  # where first h + other sqrt(r^2 - h^2) is largest
    stretched = first * height + other * np.sqrt(r**2 - height**2)
    return np.asarray(stretched + 2 * max(fast - eta, eta - slow) * v)


def _gradient(latitude: Array) -> Array:
    """Largest norm of J2's gradient, in units of ``k / d^5``, up to a latitude [rad].

    With ``s`` the square of the sine of the latitude the eigenvalues are ``1 - 5 s`` and those of
    ``[[12 s - 4, -8 c], [-8 c, 3 - 7 s]]``, ``c^2 = s (1 - s)``; the norm first falls with s and then rises.
    """
    s = np.sin(np.minimum(latitude, np.pi / 2)) ** 2
    return np.asarray(np.maximum(4.0, np.abs(5 * s - 1) / 2 + np.sqrt(26.25 * s**2 - 2.5 * s + 12.25)))


@dataclass(frozen=True)
class _Turning:
    """Bounds on how the frame's rotation is off that on the ellipse: as a rate [rad/s]; others [rad/s^2]."""

    wobble: float
    centrifugal: float
    euler: float


def _turning(env: Environment) -> _Turning:
    """Bound how unevenly the frame may turn, from the exact formulas of `frame_rates`, term by term."""
    eta, eps, deviation = env.mean_motion, env.rate_deviation, env.radius_deviation
    near, far = env.distances
    slowest, fastest, climb = env.ellipse_rates
    slow, fast, V = slowest - eps * eta, fastest + eps * eta, climb + env.radial_rate
    sine = np.sin(env.inclination_max)
    mixed = np.sin(min(2 * env.inclination_max, np.pi / 2))  # sup of |2 p_x p_z| and of |2 p_y p_z|
    force = env.k_j2 / near**4
    brake = 0.5 * float(_dense(env, np.asarray(0.0))) * env.ballistic * float(_own_speed(env))
    tilt = force * mixed / (near * slow)
    spin_accel = (force * sine**2 + brake * far * fast) / near
    turn_rate = spin_accel + 2 * V * fast / near
    # R' omega_z / R against that on the ellipse: each of its factors is off by no more than is declared
    uneven = env.radial_rate * fast + climb * eps * eta + climb * fastest * deviation / near
    # normal = -2 k p_x p_z / R^4, and p' = -omega x p
    normal_rate = force * (fast * mixed + tilt * sine**2) + 4 * V / near * force * mixed
    tilt_rate = normal_rate / (near * slow) + tilt * (V / near + turn_rate / slow)
    return _Turning(
        wobble=float(np.hypot(tilt, eps * eta)),
        centrifugal=float(fast**2 - fastest**2 + tilt**2 + tilt * fast),
        euler=float(np.hypot(tilt_rate, spin_accel + 2 * uneven / near)),
    )


# -- drag -------------------------------------------------------------------------------------------


def _dense(env: Environment, r: Array) -> Array:
    """Largest density at the target and around it."""
    return np.asarray(env.density * np.exp((env.distances[1] - env.radius + r) / env.scale_height))


def _own_speed(env: Environment) -> float:
    """Largest inertial speed of the target [m/s]."""
    _, fastest, climb = env.ellipse_rates
    fastest += env.rate_deviation * env.mean_motion
    return float(np.hypot(climb + env.radial_rate, env.distances[1] * fastest))


def _against(env: Environment, r: Array, v: Array) -> Array:
    """Largest difference of the two inertial velocities [m/s]."""
    return np.asarray(v + (env.ellipse_rates[1] + _turning(env).wobble) * r)


def _fast(env: Environment, r: Array, v: Array) -> Array:
    """Largest inertial speed of the other craft [m/s]."""
    return np.asarray(_own_speed(env) + _against(env, r, v))


def _drag_place(env: Environment, x: Array, r: Array, v: Array) -> Array:
    """Drag on two equal craft: the density differs by height, the velocity by the relative motion."""
    higher = x + r**2 / (2 * (env.distances[0] - r))
    thicker = _dense(env, np.asarray(0.0)) * np.expm1(higher / env.scale_height)
    fast = _fast(env, r, v)
    slip = _dense(env, np.asarray(0.0)) * (fast + _own_speed(env)) * _against(env, r, v)
    return np.asarray(0.5 * env.ballistic * (thicker * fast**2 + slip))
