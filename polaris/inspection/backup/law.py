"""Laws of the fuel limit, whose flights can be predicted: what they are, and the flights under them.

Flights are exact motion with the thrust held period by period.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...model.checks import positive
from ...model.errors import ScenarioError
from ...model.system import Array
from ..inspection import Inspection

LONGEST = 20_000
"""Most periods of one predicted flight."""

LOOK = 4
"""Every so many periods it is asked whether the flight has settled."""


@dataclass(frozen=True, eq=False)
class Outlook:
    """What is known about the flight under a backup law for ever after, for each of N deputies.

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
        nothing = {"delta_v": np.inf, "distance": -np.inf}
        for name, value in nothing.items():
            object.__setattr__(self, name, np.where(self.settled, getattr(self, name), value))


class Law(ABC):
    """A backup controller whose flights can be predicted: all that it remembers is handed to it.

    Each thrust is held for the period [s]; `motion` is the exact motion meanwhile, ``x -> Phi x + Gamma u``.
    """

    def __init__(self, inspection: Inspection, period: float = 1.0) -> None:
        self.inspection, self.period = inspection, positive("period", period, "s")
        self.motion = inspection.held(self.period)

    @abstractmethod
    def start(self, x: Array) -> Array:
        """What the law remembers when it takes over at states (N, 6); shape (N, m)."""

    @abstractmethod
    def thrust(self, x: Array, memory: Array) -> tuple[Array, Array]:
        """Thrust of the next period [N], shape (N, 3), within the limits, and the memory after it."""

    @abstractmethod
    def settled(self, x: Array, memory: Array, share: float = 1.0) -> NDArray[np.bool_]:
        """Whether the loop is linear from here on, shape (N,), with at most a share of the thrust."""

    @abstractmethod
    def outlook(self, x: Array, memory: Array) -> Outlook:
        """What is known about all the future."""

    @abstractmethod
    def __call__(self, t: float, x: Array) -> Array:
        """Thrust [N], shape (N, 3), at finite states (N, 6): as a `Backup`."""


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

    That is until no more than a `share` of the thrust limit will be used.
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
