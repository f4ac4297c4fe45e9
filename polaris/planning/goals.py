"""Goals: where a plan must end. Each is a few linear conditions on the last state."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..model.errors import ScenarioError
from ..model.system import Array, as_finite
from .goal import Goal, GoalConditions, positive
from .nmt import EllipticalNMT, LinearNMT, ellipse_polygon

__all__ = [
    "Box",
    "EllipticalNMT",
    "Goal",
    "GoalConditions",
    "LinearNMT",
    "StationaryPoint",
    "ellipse_polygon",
]


@dataclass(frozen=True, eq=False)
class StationaryPoint(Goal):
    """End exactly at a state. In Hill's frame only rest on the along-track axis needs no thrust after.

    Parameters
    ----------
    state : array_like, shape (n,)
    rate : float
        Rate [1/s] by which velocities are divided to read as lengths. It only weighs residuals.
    """

    state: Array
    rate: float = 1e-2

    def __post_init__(self) -> None:
        object.__setattr__(self, "state", as_finite("goal.state", self.state, 1))
        positive("goal.rate", self.rate)

    @property
    def n(self) -> int:
        """Number of states."""
        return len(self.state)

    @cached_property
    def conditions(self) -> GoalConditions:
        """One equality per state."""
        half = self.n // 2
        weights = np.r_[np.ones(self.n - half), np.full(half, 1 / self.rate)]
        E = np.diag(weights)
        return GoalConditions(
            E,
            E @ self.state,
            np.zeros((0, self.n)),
            np.zeros(0),
            (),
            max(1.0, float(np.max(np.abs(self.state)))),
        )

    def describe(self) -> str:
        """One line for messages."""
        return "stationary point (" + ", ".join(f"{s:g}" for s in self.state) + ")"


@dataclass(frozen=True, eq=False)
class Box(Goal):
    """End within a box of states.

    Parameters
    ----------
    center, half_widths : array_like, shape (n,)
        Half-widths may be infinite where any value will do.
    rate : float
        Rate [1/s] by which velocities are divided to read as lengths. It only weighs residuals.
    """

    center: Array
    half_widths: Array
    rate: float = 1e-2

    def __post_init__(self) -> None:
        object.__setattr__(self, "center", as_finite("goal.center", self.center, 1))
        widths = np.array(self.half_widths, dtype=float)
        if widths.shape != self.center.shape or not np.all(widths >= 0):
            raise ScenarioError("goal.half_widths", self.half_widths, f"must be {self.n} numbers >= 0")
        object.__setattr__(self, "half_widths", widths)
        positive("goal.rate", self.rate)

    @property
    def n(self) -> int:
        """Number of states."""
        return len(self.center)

    @cached_property
    def conditions(self) -> GoalConditions:
        """Two inequalities per bounded state, an equality where the half-width is 0."""
        half = self.n // 2
        W = np.diag(np.r_[np.ones(self.n - half), np.full(half, 1 / self.rate)])
        fixed, boxed = self.half_widths == 0, np.isfinite(self.half_widths) & (self.half_widths > 0)
        rows, center, reach = W[boxed], (W @ self.center)[boxed], np.diag(W)[boxed] * self.half_widths[boxed]
        return GoalConditions(
            W[fixed],
            (W @ self.center)[fixed],
            np.vstack([rows, -rows]),
            np.r_[center + reach, reach - center],
            (),
            max(1.0, float(np.max(np.abs(self.center)))),
        )

    def describe(self) -> str:
        """One line for messages."""
        return "box about (" + ", ".join(f"{s:g}" for s in self.center) + ")"
