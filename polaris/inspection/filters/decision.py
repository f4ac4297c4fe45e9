"""What every run-time filter answers, and what it asks of a backup controller."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...model.system import Array


@dataclass(frozen=True, eq=False)
class Decision:
    """One answer of a filter.

    Attributes
    ----------
    u : ndarray, shape (N, 3)
        Thrust to apply [N]: always finite and within the limits.
    intervened : ndarray of bool, shape (N,)
        Whose input differs from the desired one.
    active : tuple of str
        Constraints that hold with equality, or the rule that decided.
    margins : dict of str to float
        Values of the constraints, by name (``h2[0,3]``), nan where not known.
    status : str
        ``desired``, ``filtered``, ``short`` (no input satisfies all conditions: the one that violates them
        least, see `priorities`), ``backup`` (the backup controller's), ``coast`` (no thrust).
    fallback : str or None
        Why the answer is not the filter's regular one; None if it is.
    missed : dict of str to float
        Conditions that the answer does not meet, by name, and by how much [N]; inf where no input changes it.
    """

    u: Array
    intervened: NDArray[np.bool_]
    active: tuple[str, ...]
    margins: dict[str, float] = field(repr=False)
    status: str
    fallback: str | None = None
    missed: dict[str, float] = field(default_factory=dict, repr=False)


class RunTimeFilter(Protocol):
    """Anything between a primary controller and the thrusters."""

    def filter(self, t: float, x: ArrayLike, u_des: ArrayLike | None) -> Decision:
        """Decide on the inputs of the next control period.

        Parameters
        ----------
        t : float
            Time [s]. Whatever it is, there is an answer: that it is no number, stands still, runs backwards
            or jumps is noted in the decision (see `Receiver`).
        x : array_like, shape (N, 6)
            States in Hill's frame [m, m/s]; not finite where unknown. What is no such numbers is unknown.
        u_des : array_like, shape (N, 3), or None
            Desired thrust [N]; None if it came too late. What is no such numbers did not come at all.
        """
        ...


class Backup(Protocol):
    """A controller to fall back to."""

    def __call__(self, t: float, x: Array) -> Array:
        """Thrust [N], shape (N, 3), within the limits, for finite states of shape (N, 6)."""
        ...
