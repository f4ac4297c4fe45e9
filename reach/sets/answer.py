"""Answers to yes-or-no questions about sets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Answer:
    """Answer to a question about two sets; true in an ``if`` only when proved.

    Attributes
    ----------
    holds : bool or None
        True: proved, rounding included. False: `witness` shows why not. None: not decided, either
        because the method is only sufficient or because the sets touch to within rounding.
    margin : float
        By how much it holds, never too large; negative where it does not. For containment in a
        polytope or an interval: the distance to the nearest facet. In a zonotope or an ellipsoid:
        one minus the factor by which it must be scaled about its centre to hold the inner set. For
        disjointness: the distance of the sets, 0 where they meet.
    witness : ndarray, shape (n,), or None
        With a "no": a point of the inner set outside the outer one; a point in both sets.
    direction : ndarray, shape (n,), or None
        What separates: the facet that the witness is beyond; for disjoint sets a d with
        ``d . x < d . y`` for all their points.
    reason : str
        Why it was not decided.
    """

    holds: bool | None
    margin: float
    witness: Array | None = None
    direction: Array | None = None
    reason: str = ""

    def __bool__(self) -> bool:
        return self.holds is True
