"""The backup that always ends: brake to rest in axes that keep their direction in space, and hold there.

Seen from such axes the sun stands still, and with it both cones; what is left of gravity is the tide, at most
``2 n^2 r``. Lemmas and proofs are in ``docs/inspection-theory.md``, section 6.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...model.checks import non_negative, positive
from ...model.errors import ScenarioError
from ...model.hill import free_flight
from ...model.system import Array
from ..inspection import Inspection
from ..vectors import length

SHRUNK = 1e-3
"""Norm of the loop's power behind which the rest of a sum is bounded geometrically."""

LONGEST = 4096
"""Most powers of the loop that are summed exactly."""

TOLERANCE = 1e-9
"""By how much a plan may ask for more than the thrust there is [N]; the tube pays for what is clipped."""

MOST = 2000
"""Most samples of a plan: what would take longer is not proven."""

RESPONSES = (10.0, 20.0, 40.0)
"""Time constants [s] of the feedback that holds a plan, of which the one with the thinnest tube is taken."""

LOOKS = 2048
"""Instants at which free flight from rest is looked at, once."""


@dataclass(frozen=True)
class Uncertainty:
    """What is not known exactly, at any time and however it changes.

    Parameters
    ----------
    position, velocity : float
        Bounds per axis on the error of the estimated states [m], [m/s].
    disturbance : float
        Bound on the 2-norm of an acceleration that the model does not have [m/s^2].
    thrust : float
        Bound on the error of each thrust, as a share of the thrust limit.
    """

    position: float = 0.0
    velocity: float = 0.0
    disturbance: float = 0.0
    thrust: float = 0.0

    def __post_init__(self) -> None:
        units = {"position": "m", "velocity": "m/s", "disturbance": "m/s^2", "thrust": "-"}
        for name, unit in units.items():
            non_negative(name, getattr(self, name), unit)

    @property
    def exact(self) -> bool:
        """Whether nothing is unknown."""
        return self == Uncertainty()


@dataclass(frozen=True, eq=False)
class Tube:
    """How far the true state may be from a plan, in 2-norms: position [m], velocity [m/s], shape (K,).

    The numbers are for the periods since the plan was made, rising, the last of them for ever; half a period
    before and after a sample is included. `feedback` is the most thrust per axis [N] that keeps it there.
    """

    position: Array
    velocity: Array
    feedback: float

    def during(self, age: NDArray[np.intp], count: int) -> tuple[Array, Array]:
        """Positions and velocities, (count, N) each, for the periods of plans made `age` (N,) periods ago.

        The last is for ever.
        """
        at = np.minimum(age + np.arange(1, count + 1)[:, None], len(self.position) - 1)
        at[-1] = len(self.position) - 1
        return self.position[at], self.velocity[at]


class Brake:
    """Plans of N deputies that brake to co-rotation with the sun and hold there, and the tube about them.

    A plan is a sequence of states at samples, flown exactly by the thrust between them. The velocity
    ``V = v - w x p``, w = (0, 0, -n), shrinks by equal parts to zero; from then on the deputy is held where
    it is, seen from axes that keep their direction in space. What is applied is the plan's thrust and
    feedback of the estimate's distance from the plan (lemmas A to C of the theory).

    Parameters
    ----------
    inspection : Inspection
    period : float
        Time for which each thrust is held [s].
    uncertainty : Uncertainty, optional

    Raises
    ------
    ScenarioError
        If the period is too long for the loop, or the thrust too weak for what is not known.
    """

    def __init__(
        self, inspection: Inspection, period: float = 1.0, uncertainty: Uncertainty | None = None
    ) -> None:
        self.inspection, self.period = q, D = inspection, positive("period", period, "s")
        self.uncertainty = uncertainty or Uncertainty()
        n = q.mean_motion
        self.motion = Phi, Gamma = q.held(D)
        self.spin = np.array([[0.0, n, 0.0], [-n, 0.0, 0.0], [0.0, 0.0, 0.0]])  # w x p
        to_rest = np.hstack([-self.spin, np.eye(3)])  # V of a state
        self._solve = np.linalg.inv(to_rest @ Gamma)  # the thrust after which V is v: solve v - hold x
        self._hold = self._solve @ to_rest @ Phi
        self.to_rest = to_rest
        self._turn = np.kron(np.eye(2), turned(-n * D))  # a state at rest, a period later
        self.resting = np.vstack([np.eye(3), self.spin])
        # The constant thrust after which a state at rest has the velocity of rest again, per metre.
        self._still = np.linalg.inv(Gamma[3:]) @ (self._turn @ self.resting - Phi @ self.resting)[3:]
        held = [self._tube(max(response, 5 * D)) for response in RESPONSES]
        self.gain, self.tube = min(
            held, key=lambda one: one[1].position[-1] + q.passive_time * one[1].velocity[-1]
        )
        self.available = q.thrust_max - self.tube.feedback
        self.holding = float(length(self._still).max())  # N per axis and metre
        if self.available <= 2 * self.holding * q.distance_max:
            rule = f"too weak: {self.tube.feedback:.3g} N go to what is not known exactly"
            raise ScenarioError("thrust_max", q.thrust_max, rule)
        self.drifting = self._free_flight()

    # -- the tube ---------------------------------------------------------------------------------

    def _tube(self, response: float) -> tuple[Array, Tube]:
        """Lemma B: the gain for a time constant [s]; sums over the loop's powers, and between samples."""
        q, D, u, n = self.inspection, self.period, self.uncertainty, self.inspection.mean_motion
        Phi, Gamma = self.motion
        grow = np.exp((2 + np.sqrt(3)) * n * D)
        # What holding with constant thrust misses of a state at rest, per metre of its distance.
        slip = Phi @ self.resting + Gamma @ self._still - self._turn @ self.resting
        missed = np.array([np.linalg.norm(slip[:3], 2), np.linalg.norm(slip[3:], 2)]) * q.distance_max
        w = u.disturbance + np.sqrt(3) * (u.thrust * q.thrust_max + TOLERANCE) / q.mass
        pushed = missed + w * grow * np.array([D**2 / 2, D])
        unknown = np.repeat([u.position, u.velocity], 3)
        gain = -q.mass * np.hstack([np.eye(3) / response**2, 2 * np.eye(3) / response])
        outputs = np.vstack([np.eye(6), gain])
        scale = np.repeat([response, 1.0], 3)
        error = self._sums(Phi + Gamma @ gain, outputs, Gamma @ gain, pushed, unknown, scale)
        error[0] = np.maximum(error[0], np.abs(outputs) @ unknown)
        error = np.maximum.accumulate(error)
        position, velocity = length(error[:, :3]), length(error[:, 3:6])
        feedback = float((error[-1, 6:] + np.abs(gain) @ unknown).max())
        # What holding takes at each instant turns with the deputy; it is held for a period.
        needed = self.spin @ self.spin - q.system.A[3:] @ self.resting
        uneven = np.linalg.norm(needed - self._still / q.mass, 2) + np.linalg.norm(needed, 2) * n * D
        extra = np.sqrt(3) * feedback / q.mass + w + uneven * q.distance_max
        between = (velocity + np.sqrt(3) * n * position + extra * D / 2) * grow
        return gain, Tube(position + between * D / 2, between, feedback)

    def _sums(
        self, loop: Array, outputs: Array, by_estimate: Array, pushed: Array, unknown: Array, scale: Array
    ) -> Array:
        """Bounds on the outputs of the error 0, 1, ... periods after a plan was made; the last for ever."""
        outer = length((by_estimate * unknown).T / scale).sum() + np.hypot(pushed[0] / scale[0], pushed[1])
        start, power = self.motion[0] * unknown, outputs
        sums, gains, closed, found = np.zeros(9), np.zeros(9), np.eye(6), [np.abs(outputs) @ unknown]
        for _ in range(LONGEST):
            sums = sums + np.abs(power @ by_estimate) @ unknown
            sums = sums + length(power[:, :3]) * pushed[0] + length(power[:, 3:]) * pushed[1]
            first = np.abs(power @ start).sum(axis=1)
            gains = gains + length(power * scale)
            found.append(sums + first)
            power, closed = power @ loop, closed @ loop
            shrunk = np.linalg.norm(closed * scale / scale[:, None], 2)
            if shrunk <= SHRUNK:
                rest = gains * shrunk / (1 - shrunk) * (outer + length(start.T / scale).sum())
                found.append(np.max(found, axis=0) + rest)
                return np.stack(found)
        raise ScenarioError("period", self.period, "too long: the loop that holds a plan does not settle")

    def _free_flight(self) -> tuple[float, float]:
        """Lemma F: what is left, after up to T without thrust, of a distance held in the plane and across it.

        Least share of the distance over the times of free flight from rest, lowered by what may happen
        between the instants that are looked at.
        """
        n, T = self.inspection.mean_motion, self.inspection.passive_time
        step = T / (LOOKS - 1)
        flights = free_flight(n, np.linspace(0.0, T, LOOKS)) @ self.resting
        places, speeds = flights[:, :3], flights[:, 3:]
        # Speeds as seen from axes that do not turn; their change is the tide's, at most 2 n^2 times what is
        # the largest distance.
        rates = speeds - self.spin @ places
        fastest = float(np.linalg.norm(rates, 2, axis=(1, 2)).max())
        far = float(np.linalg.norm(places, 2, axis=(1, 2)).max()) + fastest * step
        lost = (fastest + 2 * n**2 * far * step) * step / 2
        plane = np.linalg.svd(places[:, :2, :2], compute_uv=False)[:, -1].min()
        across = np.abs(places[:, 2, 2]).min()
        return max(float(plane - lost), 0.0), max(float(across - lost), 0.0)

    # -- plans ------------------------------------------------------------------------------------

    def steps(self, change: Array) -> Array:
        """Periods that changes of V (..., 3) [m/s] take, about: at most a quarter of `MOST`."""
        q = self.inspection
        room = self.available - self.holding * q.distance_max
        size = np.abs(change).max(axis=-1) + 0.02 * length(change)  # the thrusters' axes turn meanwhile
        return np.asarray(np.ceil(np.clip(size * q.mass / (self.period * room), 0.5, MOST / 4)))

    def plan(self, x: Array, toward: Array | None = None, shift: Array | None = None) -> Array:
        """States (L+1, N, 6) at samples from x (N, 6) on; at rest at the end.

        Motion `toward` a boundary, unit vectors or zeros (N, 3), is ended before the rest of the motion, and
        after it a deputy is moved by a `shift` (N, 3) [m]; both in Hill's axes at the start.
        """
        V = x @ self.to_rest.T
        none = np.zeros_like(V)
        ahead = none if toward is None else toward
        first = np.maximum((V * ahead).sum(axis=1, keepdims=True), 0.0) * ahead
        rest = V - first
        begin = np.where(first.any(axis=1), self.steps(first), 0.0)
        brakes = self.steps(rest)
        glide, ramp, still = self._glide(none if shift is None else shift)
        stop = begin + brakes
        count = int((stop + np.where(glide.any(axis=1), 2 * ramp + still, 0)).max())
        k = np.arange(1.0, count + 1)[:, None]
        rise = np.clip((k - stop) / ramp, 0.0, 1.0) - np.clip((k - stop - ramp - still) / ramp, 0.0, 1.0)
        wanted = (
            first * np.clip(1 - k / np.maximum(begin, 1.0), 0.0, 1.0)[..., None]
            + rest * np.clip(1 - (k - begin) / brakes, 0.0, 1.0)[..., None]
            + glide * rise[..., None]
        )
        return self._flown(x, wanted)

    def _glide(self, shift: Array) -> tuple[Array, Array, Array]:
        """Velocities (N, 3) by which shifts are made, periods to reach them, and for which they are kept."""
        far = length(shift)
        speed = np.where(far > 0, self.inspection.docking_speed, 0.0)
        unit = _divided(shift, far)
        ramp = self.steps(2 * speed[:, None] * unit)
        still = np.ceil(np.clip(_divided(far, speed * self.period) - ramp, 0.0, MOST / 2))
        return unit * (far / (self.period * (ramp + still)))[:, None], ramp, still

    def _flown(self, x: Array, wanted: Array) -> Array:
        """Exact flight that has V, seen from axes that do not turn, as wanted (L, N, 3) at its samples."""
        n, D = self.inspection.mean_motion, self.period
        Phi, Gamma = self.motion
        slow, push = (Phi - Gamma @ self._hold).T, (Gamma @ self._solve).T
        back = np.stack([turned(-n * D * k).T for k in range(1, len(wanted) + 1)])
        gained = wanted @ back @ push
        out = np.empty((len(wanted) + 1, *x.shape))
        out[0] = x
        for k in range(len(wanted)):
            out[k + 1] = out[k] @ slow + gained[k]
        out[-1, :, 3:] = out[-1, :, :3] @ self.spin.T  # at rest, but for rounding
        return out

    def extended(self, x: Array, count: int) -> Array:
        """A plan with at least `count` samples: what ends at rest stays so."""
        if len(x) >= count:
            return x
        more = [x[-1]]
        for _ in range(count - len(x)):
            more.append(more[-1] @ self._turn.T)
        return np.concatenate([x, np.stack(more[1:])])

    def thrusts(self, x: Array) -> Array:
        """Thrust [N] between the samples of plans (L+1, N, 6), shape (L, N, 3), and how to fly them."""
        Phi, Gamma = self.motion
        gained = x[1:, :, 3:] - x[:-1] @ Phi[3:].T
        return np.asarray(gained @ np.linalg.inv(Gamma[3:]).T)

    def follow(self, x: Array, plan: Array) -> Array:
        """Thrust [N] of the coming period, (N, 3), at estimates x (N, 6) of deputies on plans (L+1, N, 6)."""
        limit = self.inspection.thrust_max
        u = self.thrusts(plan[:2])[0] + (x - plan[0]) @ self.gain.T
        return np.asarray(np.clip(u, -limit, limit))


def turned(angle: float) -> Array:
    """Rotation about z, shape (3, 3)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _divided(a: Array, b: Array) -> Array:
    """Quotients, 0 where the divisor is; the divisors broadcast from the left."""
    b = b.reshape(b.shape + (1,) * (a.ndim - b.ndim))
    return np.asarray(np.divide(a, b, out=np.zeros(np.broadcast_shapes(a.shape, b.shape)), where=b > 0))
