"""The scenario file's models of goals."""

from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

import numpy as np

from ...model import keys as f
from ...model.errors import ScenarioError
from ...model.system import Array, LinearSystem
from ...planning import goals
from .fields import BY_KIND, Described, table, unit

USUAL_RATE = 1e-2  # rate [rad/s] by which velocities are weighed against positions where there is no orbit


def hill_rate(system: LinearSystem, field: str, given: object) -> float:
    """Mean motion [rad/s] of what needs Hill's frame."""
    if system.mean_motion is None:
        raise ScenarioError(field, given, "needs Hill's frame (system.kind = 'clohessy_wiltshire')")
    return system.mean_motion


class GoalTable(Described):
    """Base of goals; the class has the names of the file without their units, and a rate [rad/s]."""

    tolerance_m: f.Positive | None = unit("m", default=None)
    """Distance at which the goal is reached. A condition on velocities alone counts as the length that they
    make in 1/eta (100 s without an orbit) or a quarter of the horizon, whichever is less. By default 5 % of
    the goal's size, or what the safety controller needs to hold a goal, if that is more."""
    velocity_tolerance_m_s: f.Positive | None = unit("m/s", default=None)
    """Largest error of velocities, beside tolerance_m, which it needs: conditions on velocities alone, and
    those that an orbit sets them at the place where the chaser is."""

    def build(self, system: LinearSystem) -> goals.Goal:
        """Return the goal."""
        if self.tolerance_m is None and self.velocity_tolerance_m_s is not None:
            raise ScenarioError("goal.tolerance_m", None, "is required with velocity_tolerance_m_s")
        if issubclass(self.MAKES, goals.HillGoal):
            rate = {"mean_motion": hill_rate(system, "goal.kind", dict(self)["kind"])}
        else:
            rate = {"rate": system.mean_motion or USUAL_RATE}
        goal: goals.Goal = self.make("goal", **rate).of(system)
        if isinstance(goal, goals.StationaryPoint):
            _check_still(goal.center, system)
        return goal


def _check_still(state: Array, system: LinearSystem) -> None:
    """Refuse a state to rest in that does not keep itself."""
    drift = float(np.abs(system.A @ state).max())
    if drift > 1e-9 * max(1.0, float(np.abs(state).max())) * max(1.0, float(np.abs(system.A).max())):
        rule = f"must keep itself without input (A x = 0, here {drift:.3g}); else use kind 'box'"
        raise ScenarioError("goal.state", state.tolist(), rule)


def _goal(makes: type[goals.Goal], kind: str, says: str, name: str) -> Any:
    return table(__name__, makes, kind, says, name, GoalTable)


EllipticalNMTGoal = _goal(
    goals.EllipticalNMT, "elliptical_nmt", "Elliptical natural motion trajectory.", "EllipticalNMTGoal"
)
LinearNMTGoal = _goal(goals.LinearNMT, "linear_nmt", "Linear natural motion trajectory.", "LinearNMTGoal")
StationaryGoal = _goal(goals.StationaryPoint, "stationary", "Hold point.", "StationaryGoal")
BoxGoal = _goal(goals.Box, "box", "Axis-aligned box.", "BoxGoal")

if TYPE_CHECKING:
    Goal: TypeAlias = Any
else:
    Goal = Annotated[EllipticalNMTGoal | LinearNMTGoal | StationaryGoal | BoxGoal, *BY_KIND]
