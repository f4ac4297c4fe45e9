"""What faults do until they are isolated: thrust that is not as commanded, or no measurement, for a while."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .thrusters import Thrusters


@dataclass(frozen=True, eq=False)
class Transient:
    """Of one fault, once in a flight, the time until S flies on for good (docs/theory.md, Lemma 41)."""

    name: str  # kind of the fault
    lasts: float  # for how long at most [s]
    thrust: NDArray[np.float64]
    """Inputs that each thruster alone makes at its limit, of which one may fail [N], (N, m); none of them
    where it is navigation that is lost, and S flies on at once."""
    share: float  # of its thrust that is lost, or pushes without being asked to
    gains: NDArray[np.float64]  # largest sizes of the entries of all experimental controllers' gains, (m, n)
    asked: bool = False  # whether black boxes fly, whose answers may be any
    networks: NDArray[np.float64] | None = None  # the same of networks: how steep they are in the state
    after: float = 0.0  # so much longer [s] decisions on predictions go on that did not know of it
    unseen: int = 1  # periods since the last estimate after which S flies at the latest, where they are lost

    @property
    def pushes(self) -> NDArray[np.float64]:
        """How far inputs may be from what is commanded meanwhile: a row for each kind, shape (J, m) [N]."""
        return np.asarray(np.unique(np.abs(self.thrust) * self.share, axis=0))

    def wrong(self, thrusters: Thrusters) -> NDArray[np.float64]:
        """The same with the errors that it brings along of thrusters."""
        return np.asarray(self.pushes + thrusters.part(self.pushes))
