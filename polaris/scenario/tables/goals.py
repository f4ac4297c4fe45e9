"""The scenario file's models of goals."""

from typing import Annotated

import numpy as np

from ...model import keys as f
from ...model.errors import ScenarioError
from ...model.system import LinearSystem
from ...planning import goals
from .fields import BY_KIND, Described, unit

USUAL_RATE = 1e-2  # rate [rad/s] by which velocities are weighed against positions where there is no orbit


def hill_rate(system: LinearSystem, field: str, value: object) -> float:
    """Mean motion [rad/s] of a scenario in Hill's frame."""
    if system.mean_motion is None:
        raise ScenarioError(field, value, "needs Hill's frame (system.kind = 'clohessy_wiltshire')")
    return system.mean_motion


class GoalTable(Described):
    """Base of goals; the class has the names of the file without their units, and a rate [rad/s]."""

    tolerance_m: f.Positive | None = unit("m", default=None)
    """Distance at which the goal counts as reached; by default 5 % of its size, or what S needs to hold it
    if more. A velocity error v counts as v*min(1/eta, T/4) metres, with 1/eta = 100 s without an orbit; in a
    condition on velocity and position together, such as an ellipse's, as v/eta."""
    velocity_tolerance_m_s: f.Positive | None = unit("m/s", default=None)
    """Additional tolerance of velocities; needs tolerance_m. For orbits: from the orbit's velocity at the
    chaser's position."""

    def build(self, system: LinearSystem) -> goals.Goal:
        """Return the goal."""
        if self.tolerance_m is None and self.velocity_tolerance_m_s is not None:
            raise ScenarioError("goal.tolerance_m", None, "must be given with velocity_tolerance_m_s")
        if issubclass(self.MAKES, goals.HillGoal):
            rate = {"mean_motion": hill_rate(system, "goal.kind", self.kind)}
        else:
            rate = {"rate": system.mean_motion or USUAL_RATE}
        goal: goals.Goal = self.make("goal", **rate).for_system(system)
        if isinstance(goal, goals.StationaryPoint):
            state, A = goal.center, system.A
            drift, size = (float(np.abs(x).max()) for x in (A @ state, state))
            if drift > 1e-9 * max(1.0, size) * max(1.0, float(np.abs(A).max())):
                rule = f"must be at rest without input (A x = 0, here {drift:.3g}); otherwise use kind 'box'"
                raise ScenarioError("goal.state", state.tolist(), rule)
        return goal


class EllipticalNMTGoal(
    GoalTable, makes=goals.EllipticalNMT, kind="elliptical_nmt", says="Elliptical natural motion trajectory."
):
    """See `goals.EllipticalNMT`."""


class LinearNMTGoal(
    GoalTable, makes=goals.LinearNMT, kind="linear_nmt", says="Linear natural motion trajectory."
):
    """See `goals.LinearNMT`."""


class StationaryGoal(GoalTable, makes=goals.StationaryPoint, kind="stationary", says="Hold point."):
    """See `goals.StationaryPoint`."""


class BoxGoal(GoalTable, makes=goals.Box, kind="box", says="Axis-aligned box."):
    """See `goals.Box`."""


Goal = Annotated[EllipticalNMTGoal | LinearNMTGoal | StationaryGoal | BoxGoal, *BY_KIND]
