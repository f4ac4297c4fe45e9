"""Sampled-data safety: barrier conditions that hold between samples, not only at them.

The filter holds its input for a period D. If ``d^2 h / dt^2 >= -M`` over the period whatever the admissible
input, then ``h(t) >= h + t dh/dt - M t^2 / 2``. So

    dh/dt >= -share h / D + M D / 2,    0 < share <= 1,

at the sample gives ``h(t) >= (1 - share t / D) h + M t (D - t) / 2 >= (1 - share) h`` over the whole period.
Each barrier bounds its M from the state at the sample and the `MotionBound` that is possible within a
period. A
row that no admissible input can make negative within the period gets ``-inf``: it may be dropped. One for
which there is no bound gets ``inf``: no input satisfies it. The proofs are in ``docs/inspection-theory.md``.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...model.checks import number, positive
from ...model.errors import ScenarioError
from ...model.system import Array
from ..vectors import length


@dataclass(frozen=True)
class SampledData:
    """Tightening of the barrier conditions for sampled data.

    Parameters
    ----------
    period : float
        Control period D [s].
    share : float
        Part of h that may be lost in one period, in (0, 1]. Less is calmer.

    Raises
    ------
    ScenarioError
        If a number is out of range.
    """

    period: float
    share: float = 0.5

    def __post_init__(self) -> None:
        positive("period", self.period, "s")
        if not 0 < number("share", self.share) <= 1:
            raise ScenarioError("share", self.share, "must be in (0, 1]")

    def growth(self, n: float) -> float:
        """Return the factor by which the acceleration may grow within a period from its start; n in rad/s.

        Raises
        ------
        ScenarioError
            If the period is so long that there is no bound: ``2 n D + 3 (n D)^2 >= 1``, D above 1 / (3 n).
        """
        D = self.period
        rest = 1 - 2 * n * D - 3 * n**2 * D**2
        if rest <= 0:
            rule = f"must be below {1 / (3 * n):.6g} s, a third over the mean motion"
            raise ScenarioError("period", D, rule)
        return 1 / rest

    def motion(self, z: Array, rates: Array, n: float, thrust: Array, known: bool = False) -> "MotionBound":
        """Bounds over the period, from states z (..., 6) at the sample, of deputies or relative ones.

        `rates` (..., 6) are natural ones, n the mean motion [rad/s], `thrust` (...) the largest acceleration
        by thrust [m/s^2]. If thrust is `known`, that is its length, and `rates` have what it gives.
        """
        D, speed = self.period, length(z[..., 3:])
        first = length(rates[..., 3:]) + (0.0 if known else thrust)
        # a <= first + 3 n^2 (speed + a D) D + 2 n a D, solved for a: thrust does not change it meanwhile.
        a = (first + 3 * n**2 * speed * D) * self.growth(n)
        fastest = speed + a * D
        # Thrust is within a box whose half-diagonal is `thrust`; the rest is natural motion.
        along = a if known else a - (1 - 1 / np.sqrt(3)) * thrust
        return MotionBound(
            D, fastest, a, 3 * n**2 * fastest + 2 * n * a, np.asarray(thrust, dtype=float), along
        )


@dataclass(frozen=True, eq=False)
class MotionBound:
    """Bounds on speed, acceleration and jerk over one period [s], each of shape (...), in SI units.

    `thrust` is the part of the acceleration that is held; along one axis there is at most `along`.
    """

    period: float
    speed: Array
    acceleration: Array
    jerk: Array
    thrust: Array
    along: Array

    def __getitem__(self, place: NDArray[np.intp] | slice) -> "MotionBound":
        """The bounds of some states."""
        parts = (self.speed, self.acceleration, self.jerk, self.thrust, self.along)
        return MotionBound(self.period, *(part[..., place] for part in parts))
