"""The backup that always ends: brake to rest in axes that keep their direction in space, and hold there.

Seen from such axes the sun stands still, and with it both cones; what is left of gravity is the tide, at most
``2 n^2 r``. Lemmas and proofs are in ``docs/inspection-theory.md``, section 6.
"""

import numpy as np
from numpy.typing import ArrayLike

from ...model.checks import of_kind, positive
from ...model.errors import ScenarioError
from ...model.hill import free_flight
from ...model.system import Array
from ..inspection import Inspection
from ..vectors import length
from .tube import ErrorTube, HeldThrust, Uncertainty

MOST = 2000  # most samples of a plan: what would take longer is not proven
RESPONSES = (10.0, 20.0, 40.0)
"""Time constants [s] of the feedback that holds a plan, of which the one with the thinnest tube is taken."""

LOOKS = 2048  # instants at which free flight from rest is looked at, once


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
        of_kind("inspection", inspection, Inspection)
        self.inspection, self.period = q, D = inspection, positive("period", period, "s")
        self.uncertainty = uncertainty or Uncertainty()
        self.estimate = self.uncertainty.predicted(q)
        n = q.mean_motion
        self.motion = Phi, Gamma = q.discretize(D)
        self.spin = np.array([[0.0, n, 0.0], [-n, 0.0, 0.0], [0.0, 0.0, 0.0]])  # w x p
        to_rest = np.hstack([-self.spin, np.eye(3)])  # V of a state
        self._solve = np.linalg.inv(to_rest @ Gamma)  # the thrust after which V is v: solve v - hold x
        self._hold = self._solve @ to_rest @ Phi
        self.to_rest = to_rest
        self._turn = np.kron(np.eye(2), rotate(-n * D))  # a state at rest, a period later
        self.resting = np.vstack([np.eye(3), self.spin])
        # The constant thrust after which a state at rest has the velocity of rest again, per metre.
        self._pushed = np.linalg.inv(Gamma[3:])  # the thrust that changes the velocity so
        self._still = self._pushed @ (self._turn @ self.resting - Phi @ self.resting)[3:]
        slip = Phi @ self.resting + Gamma @ self._still - self._turn @ self.resting
        # What holding takes at each instant turns with the deputy; it is held for a period.
        needed = self.spin @ self.spin - q.system.A[3:] @ self.resting
        uneven = np.linalg.norm(needed - self._still / q.mass, 2) + np.linalg.norm(needed, 2) * n * D
        hold = HeldThrust(q, D, self.motion, self.resting, self._still, slip, float(uneven))
        tubes = [ErrorTube(hold, self.uncertainty, max(response, 5 * D)) for response in RESPONSES]
        self.tube = min(tubes, key=lambda tube: tube.widest @ (1.0, q.passive_time))
        self.gain, self.available = self.tube.gain, q.thrust_max - self.tube.feedback
        self.holding = float(length(self._still).max())  # N per axis and metre
        if self.available <= 2 * self.holding * q.distance_max:
            rule = f"must be larger: errors and disturbance already take {self.tube.feedback:.3g} N"
            raise ScenarioError("thrust_max", q.thrust_max, rule)
        self.drifting = self._free_flight()

    def _free_flight(self) -> tuple[float, float]:
        """Lemma F: least shares left, up to T without thrust, of distances held in the plane, across it."""
        n, T = self.inspection.mean_motion, self.inspection.passive_time
        step = T / (LOOKS - 1)
        flights = free_flight(n, np.linspace(0.0, T, LOOKS)) @ self.resting
        places, speeds = flights[:, :3], flights[:, 3:]
        # Speeds as seen from axes that do not turn; their change is the tide's, at most 2 n^2 times what is
        # the largest distance.
        rates = speeds - self.spin @ places
        fastest = float(np.linalg.norm(rates, 2, axis=(1, 2)).max())
        distance = float(np.linalg.norm(places, 2, axis=(1, 2)).max()) + fastest * step
        intersample = (fastest + 2 * n**2 * distance * step) * step / 2
        plane = np.linalg.svd(places[:, :2, :2], compute_uv=False)[:, -1].min()
        across = np.abs(places[:, 2, 2]).min()
        return max(float(plane - intersample), 0.0), max(float(across - intersample), 0.0)

    def steps(self, change: Array) -> Array:
        """Periods that changes of V (..., 3) [m/s] take, about: at most a quarter of `MOST`."""
        q = self.inspection
        available = self.available - self.holding * q.distance_max
        size = np.abs(change).max(axis=-1) + 0.02 * length(change)  # the thrusters' axes turn meanwhile
        return np.asarray(np.ceil(np.clip(size * q.mass / (self.period * available), 0.5, MOST / 4)))

    def plan(self, x: Array, toward: Array | None = None, shift: Array | None = None) -> Array:
        """States (L+1, N, 6) at samples from x (N, 6) on; at rest at the end.

        Motion `toward` a boundary, unit vectors or zeros (N, 3), is ended before the rest of the motion, and
        after it a deputy is moved by a `shift` (N, 3) [m]; both in Hill's axes at the start.
        """
        V = x @ self.to_rest.T
        none = np.zeros_like(V)
        direction = none if toward is None else toward
        first = np.maximum((V * direction).sum(axis=1, keepdims=True), 0.0) * direction
        remainder = V - first
        begin = np.where(first.any(axis=1), self.steps(first), 0.0)
        brakes = self.steps(remainder)
        glide, ramp, coast = self._glide(none if shift is None else shift)
        stop = begin + brakes
        count = int((stop + np.where(glide.any(axis=1), 2 * ramp + coast, 0)).max())
        k = np.arange(1.0, count + 1)[:, None]
        rise = np.clip((k - stop) / ramp, 0.0, 1.0) - np.clip((k - stop - ramp - coast) / ramp, 0.0, 1.0)
        velocities = (
            first * np.clip(1 - k / np.maximum(begin, 1.0), 0.0, 1.0)[..., None]
            + remainder * np.clip(1 - (k - begin) / brakes, 0.0, 1.0)[..., None]
            + glide * rise[..., None]
        )
        return self._flown(x, velocities)

    def _glide(self, shift: Array) -> tuple[Array, Array, Array]:
        """Velocities (N, 3) by which shifts are made, periods to reach them, and for which they are kept."""
        distance = length(shift)
        speed = np.where(distance > 0, self.inspection.docking_speed, 0.0)
        unit = _divided(shift, distance)
        ramp = self.steps(2 * speed[:, None] * unit)
        coast = np.ceil(np.clip(_divided(distance, speed * self.period) - ramp, 0.0, MOST / 2))
        return unit * (distance / (self.period * (ramp + coast)))[:, None], ramp, coast

    def _flown(self, x: Array, velocities: Array) -> Array:
        """Exact flight that has V, seen from axes that do not turn, as wanted (L, N, 3) at its samples."""
        n, D = self.inspection.mean_motion, self.period
        Phi, Gamma = self.motion
        loop, input_map = (Phi - Gamma @ self._hold).T, (Gamma @ self._solve).T
        rotations = rotate(n * D * np.arange(1, len(velocities) + 1))
        increments = velocities @ rotations @ input_map
        out = np.empty((len(velocities) + 1, *x.shape))
        out[0] = x
        for k in range(len(velocities)):
            out[k + 1] = out[k] @ loop + increments[k]
        out[-1, :, 3:] = out[-1, :, :3] @ self.spin.T  # at rest, but for rounding
        return out

    def extended(self, x: Array, count: int) -> Array:
        """A plan with at least `count` samples: one that ends at rest stays so."""
        if len(x) >= count:
            return x
        turn = rotate(self.inspection.mean_motion * self.period * np.arange(1, count - len(x) + 1))
        return np.concatenate([x, np.concatenate([x[-1, :, :3] @ turn, x[-1, :, 3:] @ turn], axis=2)])

    def thrusts(self, x: Array) -> Array:
        """Thrust [N] between the samples of plans (L+1, N, 6), shape (L, N, 3), and how to fly them."""
        delta_v = x[1:, :, 3:] - x[:-1] @ self.motion[0][3:].T
        return np.asarray(delta_v @ self._pushed.T)

    def around(self, plan: Array, before: Array | None = None) -> Array:
        """Return bounds (L+1, N, 2) on errors about new plans (L+1, N, 6); see `ErrorTube.around`."""
        return self.tube.around(self.thrusts(plan), length(plan[-1, :, :3]), before)

    def follow(self, x: Array, plan: Array) -> Array:
        """Thrust [N] of the coming period, (N, 3), at estimates x (N, 6) of deputies on plans (L+1, N, 6)."""
        limit = self.inspection.thrust_max
        u = self.thrusts(plan[:2])[0] + (x - plan[0]) @ self.gain.T
        return np.asarray(np.clip(u, -limit, limit))


def rotate(angle: ArrayLike) -> Array:
    """Rotations about z by angles (...) [rad], shape (..., 3, 3)."""
    out = np.zeros((*np.shape(angle), 3, 3))
    out[..., 0, 0] = out[..., 1, 1] = np.cos(angle)
    out[..., 1, 0], out[..., 2, 2] = np.sin(angle), 1.0
    out[..., 0, 1] = -out[..., 1, 0]
    return out


def _divided(a: Array, b: Array) -> Array:
    """Quotients, 0 where the divisor is; the divisors broadcast from the left."""
    b = b.reshape(b.shape + (1,) * (a.ndim - b.ndim))
    return np.asarray(np.divide(a, b, out=np.zeros(np.broadcast_shapes(a.shape, b.shape)), where=b > 0))
