"""What faults do until they are isolated: thrust that is not as commanded, or no measurement, for a while."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Transient:
    """Of one fault, once in a flight, the time until S flies on for good (docs/theory.md, Lemma 41).

    Attributes
    ----------
    name : str
        Kind of the fault.
    lasts : float
        For how long at most [s].
    thrust : ndarray, shape (N, m)
        Inputs that each thruster alone makes at its limit, of which one may fail [N]; none of them where it
        is navigation that is lost, and S flies on at once.
    share : float
        Of its thrust that is lost, or pushes without being asked to.
    gains : ndarray, shape (m, n)
        Largest size of every entry of the gains of all experimental controllers that have one.
    networks : ndarray, shape (m, n), optional
        The same of networks, where any fly: how steep they are in the state.
    """

    name: str
    lasts: float
    thrust: NDArray[np.float64]
    share: float
    gains: NDArray[np.float64]
    networks: NDArray[np.float64] | None = None

    @property
    def pushes(self) -> NDArray[np.float64]:
        """How far inputs may be from what is commanded meanwhile: a row for each kind, shape (J, m) [N]."""
        return np.asarray(np.unique(np.abs(self.thrust) * self.share, axis=0))
