"""The paper's backup controller: LQR tracking of a closed eNMT with integral action (eqs. 40, 41).

Its flights can be predicted: exact motion with the thrust held period by period.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...model.checks import positive
from ...model.errors import ScenarioError
from ...model.system import Array
from ...synthesis.tracker.lqr import solve_are
from ..enmt import Ellipses, semi_axes, stopping_point
from ..inspection import Inspection
from .decay import Decay

LONGEST = 20_000  # most periods of one predicted flight
LOOK = 4  # every so many periods it is asked whether the flight has settled
BRAKING = 0.5  # share of the thrust with which the stopping point of the reference is estimated


@dataclass(frozen=True, eq=False)
class TailBound:
    """Bounds on the flight under a backup law for ever after, for each of N deputies.

    Valid without disturbances, while the law is followed period by period.

    Attributes
    ----------
    settled : ndarray of bool, shape (N,)
        The loop is linear from here on: no thrust is clipped and no limit of the eNMT is reached. The
        other fields mean something only here.
    delta_v : ndarray, shape (N,)
        Upper bound on what will still be spent [m/s]; inf where not settled.
    distance : ndarray, shape (N,)
        Lower bound on the distance from the chief's centre [m]; -inf where not settled.
    """

    settled: NDArray[np.bool_]
    delta_v: Array
    distance: Array

    def __post_init__(self) -> None:
        unsettled = {"delta_v": np.inf, "distance": -np.inf}
        for name, value in unsettled.items():
            object.__setattr__(self, name, np.where(self.settled, getattr(self, name), value))


def augmented(inspection: Inspection) -> tuple[Array, Array]:
    """System of the tracking error and the integral of its positions, shapes (9, 9) and (9, 3)."""
    system = inspection.system
    A = np.zeros((9, 9))
    A[:6, :6] = system.A
    A[6:, :3] = np.eye(3)
    return A, np.vstack([system.B, np.zeros((3, 3))])


class BackupTracker:
    """LQR with integral action about a reference that moves on an eNMT: ``u = clip(-K_1 e - K_2 z)``.

    Eq. 41 builds the desired state from the present position. Its position error is identically zero: so
    would be an integral of it, and integrating the velocity error as well leaves the system uncontrollable
    (theory, item 15). Eq. 40 is therefore read with a reference of its own. When the controller takes
    over, the eNMT nearest to where braking brings the deputy is chosen (`Ellipses.nearest`,
    `stopping_point`); the reference starts at its nearest phase and moves freely from then on, which needs
    no thrust. ``e = x - x_ref(t)`` then obeys the linear equations of motion, z integrates its three
    positions, and both go to zero: so does the thrust.

    z does not grow further on an axis whose thrust is clipped and would be more so (anti-windup).

    What it remembers, per deputy: the reference's state (6 numbers) and z (3 numbers, [m s]).

    Parameters
    ----------
    inspection : Inspection
    ellipses : Ellipses, optional
        Default ``Ellipses.for_inspection(inspection)``.
    period : float
        Time for which each thrust is held [s].
    response : float
        Time constant [s] for which the weights are chosen.

    Raises
    ------
    ScenarioError
        If a value is out of range, or the loop with thrust held for a period is unstable.
    """

    def __init__(
        self,
        inspection: Inspection,
        ellipses: Ellipses | None = None,
        period: float = 1.0,
        response: float = 20.0,
    ) -> None:
        q, self.period = inspection, positive("period", period, "s")
        self.inspection, self.motion = q, q.discretize(period)
        self.ellipses = ellipses or Ellipses.for_inspection(q)
        if self.ellipses.mean_motion != q.mean_motion:  # there they are no flights
            rule = f"must be for {q.mean_motion:g} rad/s"
            raise ScenarioError("ellipses", self.ellipses.mean_motion, rule)
        A, B = augmented(q)
        # Without gravity, a velocity error decays with the response, a position error with twice that.
        damping = q.mass / positive("response", response, "s")
        stiffness = damping / (4 * response)
        weights = [stiffness**2] * 3 + [damping**2 - 2 * q.mass * stiffness] * 3
        weights += [(stiffness / (8 * response)) ** 2] * 3
        self.gain = solve_are(A, B, np.diag(weights), np.eye(3))[1]
        loop = np.zeros((9, 9))
        loop[:6, :6] = self.motion[0]
        loop[:6] -= self.motion[1] @ self.gain
        loop[6:, 6:] = np.eye(3)
        loop[6:, :3] += self.period * np.eye(3)
        scale = np.array([response] * 3 + [1.0] * 3 + [response**2] * 3)
        self._thrusts = Decay(loop, -self.gain, scale)
        self._errors = Decay(loop, np.eye(6, 9), scale)

    def start(self, x: Array) -> Array:
        """Choose the reference for each state of shape (N, 6); shape (N, 9)."""
        q = self.inspection
        stop = stopping_point(x, q.mean_motion, BRAKING * q.thrust_max / q.mass)
        # The reference reaches the stopping point when the deputy does; now it is where it was before.
        return np.concatenate([self.ellipses.nearest(stop), np.zeros((len(x), 3))], axis=1)

    def thrust(self, x: Array, memory: Array) -> tuple[Array, Array]:
        """Thrust of the next period [N], shape (N, 3), and the memory after it."""
        q = self.inspection
        error = x - memory[:, :6]
        unclipped = -_errors(x, memory) @ self.gain.T
        u = np.clip(unclipped, -q.thrust_max, q.thrust_max)
        growing = -error[:, :3] * np.diag(self.gain[:, 6:]) * unclipped > 0
        frozen = (u != unclipped) & growing
        after = np.empty_like(memory)
        after[:, :6] = memory[:, :6] @ self.motion[0].T
        after[:, 6:] = memory[:, 6:] + np.where(frozen, 0.0, self.period * error[:, :3])
        return u, after

    def is_linear(self, x: Array, memory: Array, share: float = 1.0) -> NDArray[np.bool_]:
        """Return True for deputies whose loop is linear from here on, shape (N,)."""
        return self._thrusts.never_above(_errors(x, memory), share * self.inspection.thrust_max)

    def outlook(self, x: Array, memory: Array) -> TailBound:
        """Return bounds on all the future: in the linear range, by sums over the loop's powers."""
        q, D = self.inspection, self.period
        s = _errors(x, memory)
        settled = self._thrusts.never_above(s, q.thrust_max)
        peaks = self._errors.peak(s)
        # Between samples: the errors' acceleration is the thrust's and little else.
        push = 1.1 * np.sqrt(3) * q.thrust_max / q.mass
        strays = np.linalg.norm(peaks[:, :3], axis=1) + push * D**2 / 8
        delta_v = self._thrusts.total(s).sum(axis=1) * D / q.mass
        distance = semi_axes(memory, q.mean_motion)[0] - strays
        return TailBound(settled, delta_v, distance)


def _errors(x: Array, memory: Array) -> Array:
    """Tracking errors and the integrals of their positions, shape (N, 9)."""
    return np.concatenate([x - memory[:, :6], memory[:, 6:]], axis=1)


def periods(horizon: float, period: float) -> int:
    """Whole periods [s] in a horizon [s]; a ScenarioError if there is none, or more than `LONGEST`."""
    count = int(positive("horizon", horizon, "s") / period + 1e-9)
    if not 1 <= count <= LONGEST:
        raise ScenarioError("horizon", horizon, f"must be {period:g} s to {LONGEST * period:g} s")
    return count


@dataclass(frozen=True, eq=False)
class BackupFlight:
    """A predicted flight of N deputies over K periods.

    States x (K+1, N, 6) at the ends of the periods, the first those given; thrust u (K, N, 3) held [N];
    what the law remembers at the end (N, m); and what is known from there on.
    """

    x: Array
    u: Array
    memory: Array
    outlook: TailBound

    def delta_v(self, mass: float, period: float) -> Array:
        """Upper bound on all that is spent for ever after the start [m/s] (eq. 25), shape (N,).

        The flight's is exact, what follows bounded; inf where the flight has not settled.
        """
        return np.asarray(np.abs(self.u).sum(axis=(0, 2)) * (period / mass) + self.outlook.delta_v)


def fly_backup(law: BackupTracker, x: Array, steps: int, share: float = 1.0) -> BackupFlight:
    """Fly from states (N, 6) until all deputies have settled, at most `steps` periods.

    That is until no more than a `share` of the thrust limit will be used.
    """
    memory = law.start(x)
    Phi, Gamma = (matrix.T for matrix in law.motion)
    states, inputs = [x], []
    for k in range(steps):
        if k % LOOK == 0 and law.is_linear(x, memory, share).all():
            break
        u, memory = law.thrust(x, memory)
        x = x @ Phi + u @ Gamma
        states.append(x)
        inputs.append(u)
    outlook = law.outlook(x, memory)
    thrusts = np.stack(inputs) if inputs else np.empty((0, len(x), 3))
    return BackupFlight(np.stack(states), thrusts, memory, outlook)
