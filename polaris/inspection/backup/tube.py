"""Distance of the true state from a plan that is held by feedback: lemma B of the theory of inspection."""

from dataclasses import dataclass, field, replace

import numpy as np

from ...model.checks import non_negative, of_kind
from ...model.craft import Array, Craft
from ...model.errors import ScenarioError
from ...model.estimates.prediction import prediction_error
from ...model.thrusters import Thrusters
from ..inspection import Inspection
from ..vectors import length
from .decay import Decay

TOLERANCE = 1e-9
"""Thrust [N] beyond the limit that a plan may ask for; the tube pays for what is clipped."""

JITTER = 0.002  # default tolerance on the time of a call [s]: calls within 1 ms of an even clock
VARIATION = 24.0
"""Largest sum of all changes of a plan's thrust (2-norms), in thrust limits; more is not proven."""


@dataclass(frozen=True)
class Uncertainty:
    """Bounds on all that is not known exactly, at any time and however it changes.

    Parameters
    ----------
    position, velocity : float or tuple of 3 floats
        Bounds per axis on the error of the estimated states [m], [m/s].
    disturbance : float
        Bound on the 2-norm of an acceleration that the model does not have [m/s^2].
    thrusters : Thrusters
        Errors of what is applied.
    jitter : float
        Tolerance [s] on the time of a call: earlier or later than a whole number of periods after the one at
        which the plan that is flown was made, so that a slow clock adds up while any deputy is on its plan.
        The time itself is known. It is no error: `exact` says nothing of it.
    """

    position: float | tuple[float, ...] = 0.0
    velocity: float | tuple[float, ...] = 0.0
    disturbance: float = 0.0
    thrusters: Thrusters = field(default_factory=Thrusters)
    jitter: float = JITTER

    def __post_init__(self) -> None:
        of_kind("thrusters", self.thrusters, Thrusters)
        units = {"position": "m", "velocity": "m/s", "disturbance": "m/s^2", "jitter": "s"}
        for name, unit in units.items():
            values = np.ravel(getattr(self, name)).tolist()
            if len(values) not in ((1, 3) if name in ("position", "velocity") else (1,)):
                raise ScenarioError(name, values, "must be one number, or one per axis")
            for value in values:
                non_negative(name, value, unit)

    @property
    def estimate(self) -> Array:
        """Bounds on the errors of an estimated state, shape (6,)."""
        return np.concatenate([np.broadcast_to(part, 3) for part in (self.position, self.velocity)])

    def predicted(self, inspection: Inspection) -> Array:
        """Bounds (6,) on the errors of a state that is moved to when the call was due."""
        system = Craft.from_system(replace(inspection.system, w_max=self.disturbance))
        worst = self.thrusters.error(system.u_max)
        return prediction_error(system, self.estimate, worst, self.jitter)

    @property
    def exact(self) -> bool:
        """Return True if states, thrust and motion are known exactly."""
        return not self.estimate.any() and self.disturbance == 0 and self.thrusters.exact


@dataclass(frozen=True, eq=False)
class HeldThrust:
    """A deputy's motion with thrust held for a period [s], and the thrust that keeps it at rest.

    `motion` has the transition (6, 6) and the input's (6, 3); `resting` (6, 3) the state at rest at a place;
    `still` (3, 3) the thrust per metre that keeps its velocity; `slip` (6, 3) what that misses of the place
    after a period; `uneven` by how much acceleration per metre it is wrong within one.
    """

    inspection: Inspection
    period: float
    motion: tuple[Array, Array]
    resting: Array
    still: Array
    slip: Array
    uneven: float


class ErrorTube:
    """Bounds on the 2-norms of the error of position [m] and velocity [m/s], for a loop's time constant [s].

    A part is the same for all plans, by the periods since they were made; errors of thrusters are those of
    what a plan asks for, and of all that feedback may.

    Attributes
    ----------
    gain : ndarray, shape (3, 6)
        Thrust per distance from the plan.
    feedback : float
        The most thrust per axis [N] that it asks for.
    widest : ndarray, shape (2,)
        Bounds for ever, under full thrust.
    """

    def __init__(self, hold: HeldThrust, unknown: Uncertainty, response: float) -> None:
        q, D, n = hold.inspection, hold.period, hold.inspection.mean_motion
        (Phi, Gamma), errors, eta = hold.motion, unknown.thrusters, unknown.predicted(q)
        self._period, self._grow = D, np.exp((2 + np.sqrt(3)) * n * D)
        self.gain = -q.mass * np.hstack([np.eye(3) / response**2, 2 * np.eye(3) / response])
        scale = np.repeat([response, 1.0], 3)
        loop = Decay(Phi + Gamma @ self.gain, np.vstack([np.eye(6), self.gain]), scale)
        powers = loop.powers
        # Acceleration per newton that is asked for (2-norm), and whatever is asked for.
        self.share = (errors.along + np.sqrt(3) * errors.across) / q.mass
        fixed = unknown.disturbance + np.sqrt(3) * (np.max(errors.bit) + TOLERANCE) / q.mass
        full, self._hold = np.sqrt(3) * q.thrust_max, float(np.linalg.norm(hold.still, 2))
        kick, step = self._grow * np.array([D**2 / 2, D]), self._grow * np.array([D, 1.0])
        missed = np.array([np.linalg.norm(hold.slip[k : k + 3], 2) for k in (0, 3)]) * q.distance_max
        gains, steps = _jump_response(powers, *kick), _jump_response(powers, *step)
        # Velocity per newton by which thrust changes late; changes of each period while a deputy is held.
        self._late, turns = unknown.jitter / q.mass, self._hold * n * D * q.distance_max
        axes = np.cumsum(np.abs(powers @ Gamma @ self.gain) @ eta, axis=0)
        axes = axes + np.abs(powers @ (Phi * eta)).sum(-1)
        axes = np.vstack([np.abs(powers[0]) @ eta, axes])
        common = np.stack([length(axes[:, :3]), length(axes[:, 3:6]), axes[:, 6:].max(axis=1)], axis=1)
        common[1:] += np.cumsum(_jump_response(powers, *missed), axis=0)
        total, late = (np.vstack([np.zeros(3), np.cumsum(part, axis=0)]) for part in (gains, steps))
        common += fixed * total + self._late * turns * late
        # What the powers that are left out add, for ever.
        size = length((Gamma @ self.gain * eta).T / scale).sum() + length((Phi * eta).T / scale).sum()
        size += np.hypot(*((missed + (fixed + self.share * full) * kick) / (response, 1.0)))
        stepped = np.hypot(step[0] / response, step[1])
        tail = _sizes(loop.left * (size + self._late * turns * stepped))
        varied = self._late * VARIATION * q.thrust_max
        bound = common + self.share * full * total
        bound = bound.max(axis=0) + varied * (steps.max(axis=0) + _sizes(loop.later) * stepped) + tail
        # Feedback changes from period to period as well, by twice its largest value.
        loop_gain = self._late * 2 * np.sqrt(3) * (late[-1, 2] + _sizes(loop.left)[2] * stepped)
        if loop_gain > 0.5 or unknown.jitter > D / 2:
            raise ScenarioError("jitter", unknown.jitter, f"must be well below the period of {D:g} s")
        self.feedback = float((bound[2] + (np.abs(self.gain) @ eta).max()) / (1 - loop_gain))
        recurring = self._late * 2 * np.sqrt(3) * self.feedback
        base = common + self.share * np.sqrt(3) * self.feedback * total + recurring * late
        tail += recurring * _sizes(loop.left) * stepped + varied * _sizes(loop.later) * stepped
        base = np.vstack([base, base.max(axis=0) + tail])
        self._base = np.maximum.accumulate(base, axis=0)[:, :2]
        self._gains, self._steps = (
            np.maximum.accumulate(part[::-1])[::-1, :2] for part in (gains, self._late * steps)
        )
        self._total = total[-1, :2]
        extra = np.sqrt(3) * self.feedback * (1 / q.mass + self.share) + fixed + hold.uneven * q.distance_max
        self._extra = float(extra + 4 / D * (recurring + self._late * turns))
        self._spin = np.sqrt(3) * n
        widest = self._base[-1] + self.share * full * self._total + 2 * full * self._steps[0]
        self.widest = self._spread(widest, self.share * full + 8 / D * self._late * full)

    def around(self, u: Array, far: Array, before: Array | None = None) -> Array:
        """Bounds over every period of plans that ask for u (L, N, 3) [N], and for ever, (L+1, N, 2).

        From when they were made; then they hold at `far` (N,) [m]. Samples and all between them are counted.
        The thrust `before` (N, 3) [N] is given where the plans begin at another time than the call.
        """
        L, base, step = len(u), self._base, self._late
        bounds = np.repeat(base[np.minimum(np.arange(L + 1), len(base) - 1), None], len(far), axis=1)
        final = np.repeat(base[-1:], len(far), axis=0)
        errors = self.share * np.vstack([length(u), self._hold * far])
        change = length(np.diff(u, axis=0, prepend=u[:1] if before is None else before[None]))
        change = np.vstack([change, length(u[-1]) + self._hold * far])
        for i, j in np.ndindex(len(far), 2 if self.share > 0 or step > 0 else 0):
            bounds[1:, i, j] += np.convolve(errors[:-1, i], self._gains[:L, j])[:L]
            bounds[1:, i, j] += np.convolve(change[:-1, i], self._steps[:L, j])[:L]
        if self.share > 0 or step > 0:
            final += bounds[-1] - base[min(L, len(base) - 1)]
            final += errors[-1, :, None] * self._total + change[-1, :, None] * self._steps[0]
        # Late or early, a change is between samples, before its own or after it.
        errors = errors + 2 / self._period * step * (change + np.vstack([change[1:], change[-1:]]))
        return self._spread(np.concatenate([np.maximum(bounds[1:], bounds[:-1]), final[None]]), errors)

    def _spread(self, error: Array, errors: Array | float) -> Array:
        """Bounds (..., 2) at samples, extended to all between by missing acceleration [m/s^2]."""
        between = error[..., 1] + self._spin * error[..., 0] + (errors + self._extra) * self._period / 2
        between = between * self._grow
        return np.stack([error[..., 0] + between * self._period / 2, between], axis=-1)


def _sizes(outputs: Array) -> Array:
    """Lengths of the position and the velocity, and the largest thrust per axis, of outputs (9,)."""
    return np.array([length(outputs[:3]), length(outputs[3:6]), outputs[6:].max()])


def _jump_response(powers: Array, place: float, speed: float) -> Array:
    """Position, velocity and thrust per axis, (K, 3), of jumps by so much [m], [m/s] in any direction."""
    blocks = [np.linalg.norm(powers[:, k : k + 3, j : j + 3], 2, axis=(1, 2)) for k in (0, 3) for j in (0, 3)]
    thrust = length(powers[:, 6:, :3]) * place + length(powers[:, 6:, 3:]) * speed
    sums = [blocks[0] * place + blocks[1] * speed, blocks[2] * place + blocks[3] * speed]
    return np.stack([*sums, thrust.max(axis=1)], axis=1)
