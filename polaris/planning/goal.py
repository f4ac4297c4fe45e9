"""What a goal is to the planner: a few linear conditions on the last state."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np

from ..model.system import Array
from ..model.tolerances import GOAL


@dataclass(frozen=True, eq=False)
class GoalConditions:
    """Linear conditions on the last state x: ``E x = e``, ``G x <= g``, and one of each group.

    Rows are scaled so that a residual is a length [m] (velocities are divided by a rate).

    Attributes
    ----------
    E, e : ndarray, shapes (n_e, n), (n_e,)
        Equalities.
    G, g : ndarray, shapes (n_g, n), (n_g,)
        Inequalities.
    one_of : tuple of (ndarray, ndarray), shapes (J, n), (J,)
        For each group, at least one row must satisfy ``N x >= c``.
    scale : float
        Length [m] to which residuals are compared.
    """

    E: Array
    e: Array
    G: Array
    g: Array
    one_of: tuple[tuple[Array, Array], ...] = ()
    scale: float = 1.0

    def residual(self, x: Array) -> float:
        """Largest violation at x [m]; 0 if all conditions hold."""
        worst = max(
            np.max(np.abs(self.E @ x - self.e), initial=0.0), np.max(self.G @ x - self.g, initial=0.0)
        )
        for N, c in self.one_of:
            worst = max(worst, float(np.min(c - N @ x)))
        return float(worst)


class Goal(ABC):
    """Base of all goals. A new goal states `n`, `conditions` and `describe`; the rest follows."""

    @property
    @abstractmethod
    def n(self) -> int:
        """Number of states the goal speaks about."""

    @property
    @abstractmethod
    def conditions(self) -> GoalConditions:
        """The linear conditions the planner uses; they imply the goal."""

    @abstractmethod
    def describe(self) -> str:
        """One line for messages and reports."""

    def residual(self, x: Array) -> tuple[float, str]:
        """Largest violation of the goal itself [m] and what it is, at a state x of shape (n,)."""
        return self.conditions.residual(x), self.describe()

    def violation(self, x: Array) -> tuple[float, str]:
        """Violation relative to the goal's scale, 0.0 if met within `tolerances.GOAL`, and its name."""
        worst, name = self.residual(np.asarray(x, dtype=float))
        relative = worst / self.conditions.scale
        return (0.0, "") if relative <= GOAL else (relative, name)
