"""How far the true state may be from a plan that is held by feedback: lemma B of the theory of inspection."""

from dataclasses import dataclass, field

import numpy as np

from ...model.checks import non_negative
from ...model.system import Array
from ...model.thrusters import Thrusters
from ..inspection import Inspection
from ..vectors import length
from .settled import Decay

TOLERANCE = 1e-9
"""By how much a plan may ask for more than the thrust there is [N]; the tube pays for what is clipped."""


@dataclass(frozen=True)
class Uncertainty:
    """What is not known exactly, at any time and however it changes.

    Parameters
    ----------
    position, velocity : float or tuple of 3 floats
        Bounds per axis on the error of the estimated states [m], [m/s].
    disturbance : float
        Bound on the 2-norm of an acceleration that the model does not have [m/s^2].
    thrusters : Thrusters
        Errors of what is applied.
    """

    position: float | tuple[float, ...] = 0.0
    velocity: float | tuple[float, ...] = 0.0
    disturbance: float = 0.0
    thrusters: Thrusters = field(default_factory=Thrusters)

    def __post_init__(self) -> None:
        units = {"position": "m", "velocity": "m/s", "disturbance": "m/s^2"}
        for name, unit in units.items():
            for value in np.ravel(getattr(self, name)).tolist():
                non_negative(name, value, unit)

    @property
    def estimate(self) -> Array:
        """Bounds on the errors of an estimated state, shape (6,)."""
        return np.concatenate([np.broadcast_to(part, 3) for part in (self.position, self.velocity)])

    @property
    def exact(self) -> bool:
        """Whether nothing is unknown."""
        return not self.estimate.any() and self.disturbance == 0 and self.thrusters.exact


@dataclass(frozen=True, eq=False)
class Held:
    """A deputy's motion with thrust held for a period [s], and what keeps it at rest where it is.

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


class Tube:
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

    def __init__(self, held: Held, unknown: Uncertainty, response: float) -> None:
        q, D, n = held.inspection, held.period, held.inspection.mean_motion
        (Phi, Gamma), errors, eta = held.motion, unknown.thrusters, unknown.estimate
        self._period, self._grow = D, np.exp((2 + np.sqrt(3)) * n * D)
        self.gain = -q.mass * np.hstack([np.eye(3) / response**2, 2 * np.eye(3) / response])
        scale = np.repeat([response, 1.0], 3)
        loop = Decay(Phi + Gamma @ self.gain, np.vstack([np.eye(6), self.gain]), scale)
        powers = loop.powers
        # Acceleration per newton that is asked for (2-norm), and whatever is asked for.
        self.share = (errors.along + np.sqrt(3) * errors.across) / q.mass
        always = unknown.disturbance + np.sqrt(3) * (errors.bit + TOLERANCE) / q.mass
        full = np.sqrt(3) * q.thrust_max
        kick = self._grow * np.array([D**2 / 2, D])
        missed = np.array([np.linalg.norm(held.slip[k : k + 3], 2) for k in (0, 3)]) * q.distance_max
        gains, by_slip = _pushed(powers, *kick), _pushed(powers, *missed)
        axes = np.cumsum(np.abs(powers @ Gamma @ self.gain) @ eta, axis=0)
        axes = axes + np.abs(powers @ (Phi * eta)).sum(-1)
        axes = np.vstack([np.abs(powers[0]) @ eta, axes])
        known = np.stack([length(axes[:, :3]), length(axes[:, 3:6]), axes[:, 6:].max(axis=1)], axis=1)
        known[1:] += np.cumsum(by_slip, axis=0)
        total = np.vstack([np.zeros(3), np.cumsum(gains, axis=0)])
        # What the powers that are left out add, for ever.
        size = length((Gamma @ self.gain * eta).T / scale).sum() + length((Phi * eta).T / scale).sum()
        size += np.hypot(*((missed + (always + self.share * full) * kick) / (response, 1.0)))
        left = loop.left * size
        rest = np.array([length(left[:3]), length(left[3:6]), left[6:].max()])
        most = known + (always + self.share * full) * total
        self.feedback = float(most[:, 2].max() + rest[2] + (np.abs(self.gain) @ eta).max())
        base = known + (always + self.share * np.sqrt(3) * self.feedback) * total
        base = np.vstack([base, base.max(axis=0) + rest])
        self._base = np.maximum.accumulate(base, axis=0)[:, :2]
        self._gains, self._total = np.maximum.accumulate(gains[::-1])[::-1, :2], total[-1, :2]
        extra = np.sqrt(3) * self.feedback * (1 / q.mass + self.share) + always + held.uneven * q.distance_max
        self._extra = float(extra)
        self._spin = np.sqrt(3) * n
        self._hold = float(np.linalg.norm(held.still, 2))
        self.widest = self._spread(self._base[-1] + self.share * full * self._total, self.share * full)

    def around(self, u: Array, far: Array) -> Array:
        """Bounds over every period of plans that ask for u (L, N, 3) [N], and for ever, (L+1, N, 2).

        From when they were made; then they hold at `far` (N,) [m]. Samples and all between them are counted.
        """
        L, base = len(u), self._base
        at = np.repeat(base[np.minimum(np.arange(L + 1), len(base) - 1), None], len(far), axis=1)
        ever = np.repeat(base[-1:], len(far), axis=0)
        missed = self.share * np.vstack([length(u), self._hold * far])
        for i, j in np.ndindex(len(far), 2 if self.share > 0 else 0):
            at[1:, i, j] += np.convolve(missed[:-1, i], self._gains[:L, j])[:L]
        if self.share > 0:
            ever += at[-1] - base[min(L, len(base) - 1)] + missed[-1, :, None] * self._total
        return self._spread(np.concatenate([np.maximum(at[1:], at[:-1]), ever[None]]), missed)

    def _spread(self, error: Array, missed: Array | float) -> Array:
        """Bounds (..., 2) at samples, and what thrusters miss [m/s^2], made bounds of all between as well."""
        between = error[..., 1] + self._spin * error[..., 0] + (missed + self._extra) * self._period / 2
        between = between * self._grow
        return np.stack([error[..., 0] + between * self._period / 2, between], axis=-1)


def _pushed(powers: Array, place: float, speed: float) -> Array:
    """Position, velocity and thrust per axis, (K, 3), of jumps by so much [m], [m/s] in any direction."""
    blocks = [np.linalg.norm(powers[:, k : k + 3, j : j + 3], 2, axis=(1, 2)) for k in (0, 3) for j in (0, 3)]
    thrust = length(powers[:, 6:, :3]) * place + length(powers[:, 6:, 3:]) * speed
    sums = [blocks[0] * place + blocks[1] * speed, blocks[2] * place + blocks[3] * speed]
    return np.stack([*sums, thrust.max(axis=1)], axis=1)
