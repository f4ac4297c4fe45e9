"""Primary controllers of the paper's simulations: none at all, and aggressive LQRs."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ...model.checks import non_negative, positive
from ...model.errors import ScenarioError
from ...model.system import Array
from ...synthesis.tracker.lqr import lqr_gain
from ..inspection import Inspection


class Primary(Protocol):
    """Desired inputs for many runs at once."""

    def __call__(self, t: float, x: Array) -> Array:
        """Desired thrust [N], shape (R, N, 3), not necessarily within the limits, at states (R, N, 6)."""


class NoInput:
    """No thrust, as in the paper's Monte Carlo."""

    def __call__(self, t: float, x: Array) -> Array:
        """Zeros of shape (R, N, 3)."""
        return np.zeros((*x.shape[:-1], 3))


class LQR:
    """Aggressive regulator to a distance from the chief.

    Parameters
    ----------
    inspection : Inspection
    distance : float
        Each deputy is sent to this distance [m] in the direction it is in: 0 for the chief itself.
    position_weight, velocity_weight, thrust_weight : float
        Diagonal weights of the position [1/m^2], the velocity [s^2/m^2] (may be 0) and the thrust [1/N^2].
    """

    def __init__(
        self,
        inspection: Inspection,
        distance: float = 0.0,
        position_weight: float = 1.0,
        velocity_weight: float = 1.0,
        thrust_weight: float = 1.0,
    ) -> None:
        weights = [positive("position_weight", position_weight, "1/m^2")] * 3
        weights += [non_negative("velocity_weight", velocity_weight, "s^2/m^2")] * 3
        thrust = [positive("thrust_weight", thrust_weight, "1/N^2")] * 3
        self.gain = lqr_gain(inspection.system, weights, thrust)
        self.distance = distance

    def __call__(self, t: float, x: Array) -> Array:
        """Desired thrust [N], shape (R, N, 3)."""
        target = np.zeros_like(x)
        if self.distance:
            p = x[..., :3]
            length = np.sqrt((p * p).sum(axis=-1, keepdims=True))
            target[..., :3] = self.distance * p / np.maximum(length, 1e-9)
        return np.asarray((target - x) @ self.gain.T)


@dataclass(frozen=True)
class Phases:
    """One controller after another.

    Parameters
    ----------
    starts : sequence of float
        Times [s] at which each takes over; the first is 0, strictly increasing.
    controllers : sequence of Primary
    """

    starts: Sequence[float]
    controllers: Sequence[Primary]

    def __post_init__(self) -> None:
        starts = list(self.starts)
        rising = starts[:1] == [0] and sorted(set(starts)) == starts
        if not rising or len(starts) != len(self.controllers):
            raise ScenarioError("starts", starts, "must begin with 0, increase, one for each controller")

    def __call__(self, t: float, x: Array) -> Array:
        """Desired thrust [N] of the controller on duty."""
        on_duty = int(np.searchsorted(self.starts, t, side="right")) - 1
        return self.controllers[max(on_duty, 0)](t, x)
