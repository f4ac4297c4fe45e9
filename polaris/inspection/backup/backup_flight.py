"""Flights under a backup law, predicted from given states: exact motion, thrust held period by period."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...model.checks import positive
from ...model.errors import ScenarioError
from ...model.system import Array
from .parking import Law, Memoryless, Outlook

LONGEST = 20_000
"""Most periods of one predicted flight."""

LOOK = 4
"""Every so many periods it is asked whether the flight has settled."""


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
    outlook: Outlook

    def delta_v(self, mass: float, period: float) -> Array:
        """Upper bound on all that is spent for ever after the start [m/s] (eq. 25), shape (N,).

        The flight's is exact, what follows bounded; inf where the flight has not settled.
        """
        return np.asarray(np.abs(self.u).sum(axis=(0, 2)) * (period / mass) + self.outlook.delta_v)


def fly_backup(law: Law, x: Array, steps: int, share: float = 1.0) -> BackupFlight:
    """Fly from states (N, 6) until all deputies have settled, at most `steps` periods.

    That is until no more than a `share` of the thrust limit will be used: the smaller, the longer the flight,
    and the nearer its end to the parking orbit.
    """
    memory = law.start(x)
    Phi, Gamma = (matrix.T for matrix in law.motion)
    states, inputs = [x], []
    for k in range(steps):
        if k % LOOK == 0 and law.settled(x, memory, share).all():
            break
        u, memory = law.thrust(x, memory)
        x = x @ Phi + u @ Gamma
        states.append(x)
        inputs.append(u)
    outlook = law.outlook(x, memory)
    flown = np.stack(inputs) if inputs else np.empty((0, len(x), 3))
    return BackupFlight(np.stack(states), flown, memory, outlook)


def sensitivities(law: Memoryless, x: Array) -> Array:
    """Derivatives of a flight's states x (K+1, N, 6) by its first, shape (K+1, N, 6, 6).

    Clipped axes do not answer to the state. Where the thrust itself jumps (the limits of `Ellipses`) the
    derivative leaves the jump out.
    """
    count, N = x.shape[:2]
    Phi, Gamma = law.motion
    steps = Phi + Gamma @ law.thrust_slope(x[:-1].reshape(-1, 6)).reshape(count - 1, N, 3, 6)
    out = np.empty((count, N, 6, 6))
    out[0] = np.eye(6)
    for k in range(count - 1):
        np.matmul(steps[k], out[k], out=out[k + 1])
    return out
