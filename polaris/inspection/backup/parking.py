"""The backup controller that parks on a closed eNMT by feedback of the state alone.

`polaris.inspection.backup.tracker.Tracker` is the paper's, with integral action and a moving reference.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...model.checks import positive
from ...model.system import Array
from ...synthesis.tracking import solve_are
from ..enmt import Ellipses, semi_axes, velocity_error
from ..inspection import Inspection
from .law import Law, Outlook
from .settled import Decay


class Parking(Law):
    """LQR tracker to a closed eNMT, by the present state alone: ``u = clip(-K (x - inside(x)))``.

    ``inside(x)`` is the state on the nearest eNMT within limits (`Ellipses.inside`). Within the limits it
    is x_des of eq. 41: position and cross-track motion are kept, and only the velocity error
    ``e = (v_x - n y / 2, v_y + 2 n x)`` is fed back. e obeys an equation of its own, goes to zero, and the
    thrust with it: on the eNMT none is used. Outside the limits (too near the chief, too far) the position
    is fed back as well.

    Parameters
    ----------
    inspection : Inspection
    ellipses : Ellipses, optional
        Default ``Ellipses.of(inspection)``.
    period : float
        Time for which each thrust is held [s].
    response : float
        Time constant of the velocity error while the thrust is not clipped [s].

    Raises
    ------
    ScenarioError
        If a value is out of range, or the loop with thrust held for a period is unstable.

    Notes
    -----
    At the limits of the ellipses the thrust jumps. Convergence from there, and with clipped thrust, is
    tested and not proven; `outlook` says from where on it is proven.
    """

    def __init__(
        self,
        inspection: Inspection,
        ellipses: Ellipses | None = None,
        period: float = 1.0,
        response: float = 20.0,
    ) -> None:
        super().__init__(inspection, period)
        q = inspection
        self.ellipses = Ellipses.fitting(q, ellipses)
        self.gain = lqr_gain(q, response)
        Phi, Gamma = self.motion
        E = velocity_error(np.eye(6), q.mean_motion).T
        feedback = -self.gain[:, 3:5] @ E
        axes = np.zeros((4, 6))  # whose squares add up in pairs to those of a and c
        axes[[0, 1, 2, 3], [0, 1, 2, 5]] = [1.0, 0.5, 1.0, 1 / q.mean_motion]
        self._seen = np.concatenate([feedback, axes]).T
        loop = E @ (Phi + Gamma @ feedback) @ np.eye(6)[:, 3:5]
        self._thrusts = Decay(loop, -self.gain[:, 3:5], np.ones(2))
        self._errors = Decay(loop, np.eye(2), np.ones(2))

    def __call__(self, t: float, x: Array) -> Array:
        """Thrust [N], shape (N, 3), at finite states of shape (N, 6)."""
        limit, rings = self.inspection.thrust_max, self.ellipses
        seen = x @ self._seen
        squares = seen * seen
        a, c = squares[:, 3] + squares[:, 4], squares[:, 5] + squares[:, 6]
        if ((a >= rings.least**2) & (a <= rings.largest**2) & (c <= rings.cross_track**2)).all():
            u = seen[:, :3]  # as below, and quicker
        else:
            u = -(x - rings.inside(x)) @ self.gain.T
        return np.asarray(np.minimum(np.maximum(u, -limit), limit))

    def start(self, x: Array) -> Array:
        """Nothing: shape (N, 0)."""
        return np.empty((len(x), 0))

    def thrust(self, x: Array, memory: Array) -> tuple[Array, Array]:
        """Thrust of the next period [N], shape (N, 3), and the memory."""
        return self(0.0, x), memory

    def settled(self, x: Array, memory: Array, share: float = 1.0) -> NDArray[np.bool_]:
        """Whether the loop is linear from here on, shape (N,)."""
        n, rings = self.inspection.mean_motion, self.ellipses
        e, (a, c) = velocity_error(x, n), semi_axes(x, n)
        calm = self._thrusts.never_above(e, share * self.inspection.thrust_max)
        moved = 2 * self.period * self._errors.total_gain * np.sqrt((e * e).sum(axis=1))  # the axis, by most
        room = (a >= rings.least + moved) & (a <= rings.largest - moved) & (c <= rings.cross_track)
        return np.asarray(calm & room)

    def outlook(self, x: Array, memory: Array) -> Outlook:
        """What is known about all the future.

        In the linear range the semi-minor axis changes by at most ``integral norm(e) dt``, because
        ``dq/dt`` is a turn plus ``(e_x, e_y / 2)``; between samples e is
        nearly a straight line: twice the sum over the samples is more than the integral.
        """
        q = self.inspection
        n, D = q.mean_motion, self.period
        e = velocity_error(x, n)
        moved = 2 * D * np.linalg.norm(self._errors.total(e), axis=1)
        settled = self.settled(x, memory)
        delta_v = self._thrusts.total(e).sum(axis=1) * D / q.mass
        return Outlook(settled, delta_v, semi_axes(x, n)[0] - moved)


def lqr_weights(inspection: Inspection, response: float) -> tuple[float, list[float]]:
    """Stiffness [N/m] and weights of the six states for a time constant [s] of the velocity error.

    The weights are such that, without gravity, a velocity error decays with it and a position error with
    twice that.
    """
    damping = inspection.mass / positive("response", response, "s")
    stiffness = damping / (4 * response)
    return stiffness, [stiffness**2] * 3 + [damping**2 - 2 * inspection.mass * stiffness] * 3


def lqr_gain(inspection: Inspection, response: float) -> Array:
    """Gain of an LQR on the six states [N/m, N s/m], shape (3, 6); see `lqr_weights`."""
    system, weights = inspection.system, lqr_weights(inspection, response)[1]
    gain = solve_are(system.A, system.B, np.diag(weights), np.eye(3))[1]
    gain[2, [0, 1, 3, 4]] = 0.0  # the cross-track motion is apart; what the solver leaves is rounding
    gain[:2, 2::3] = 0.0
    return gain
