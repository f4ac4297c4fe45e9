"""The scenario file's models of goals."""

from collections.abc import Callable
from typing import Annotated, ClassVar, Literal

import numpy as np

from ...model import keys as f
from ...model.errors import ScenarioError
from ...model.system import LinearSystem
from ...planning import goals
from .fields import BY_KIND, ScenarioPart, in_file_terms, unit

USUAL_RATE = 1e-2  # rate [rad/s] by which velocities are weighed against positions where there is no orbit


def hill_rate(system: LinearSystem, field: str, given: object) -> float:
    """Mean motion [rad/s] of what needs Hill's frame."""
    if system.mean_motion is None:
        raise ScenarioError(field, given, "needs Hill's frame (system.kind = 'clohessy_wiltshire')")
    return system.mean_motion


class GoalTable(ScenarioPart):
    """Base of goals; the class `makes` has the names of the file without their units, and a rate [rad/s]."""

    makes: ClassVar[Callable[..., goals.Goal]]
    tolerance_m: f.Positive | None = unit("m", default=None)
    """Distance at which the goal is reached. A condition on velocities alone counts as the length that they
    make in 1/eta (100 s without an orbit) or a quarter of the horizon, whichever is less. By default 5 % of
    the goal's size, or what the safety controller needs to hold a goal, if that is more."""
    velocity_tolerance_m_s: f.Positive | None = unit("m/s", default=None)
    """Largest error of velocities, beside tolerance_m, which it needs: conditions on velocities alone, and
    those that an orbit sets them at the place where the chaser is."""

    def build(self, system: LinearSystem) -> goals.Goal:
        """The goal."""
        if self.tolerance_m is None and self.velocity_tolerance_m_s is not None:
            raise ScenarioError("goal.tolerance_m", None, "is required with velocity_tolerance_m_s")
        with in_file_terms("goal", self):
            given = self.arguments().items()
            asked = {name: value for name, value in given if "tolerance" not in name}
            return type(self).makes(**asked, **self._rate(system)).of(system)

    def _rate(self, system: LinearSystem) -> dict[str, float]:
        return {"rate": system.mean_motion or USUAL_RATE}


class HillGoal(GoalTable):
    """Base of goals that Hill's frame alone has."""

    kind: str

    def _rate(self, system: LinearSystem) -> dict[str, float]:
        return {"mean_motion": hill_rate(system, "goal.kind", self.kind)}


class EllipticalNMTGoal(HillGoal):
    """End on a closed ellipse about the target that needs no thrust (eqs. 20-22). Hill's frame only."""

    makes = goals.EllipticalNMT
    kind: Literal["elliptical_nmt"] = unit("-", "Elliptical natural motion trajectory.")
    inner_semi_minor_m: f.NonNegative = unit("m", "Radial semi-axis of the inner ellipse; 0 for none.")
    outer_semi_minor_m: f.Positive = unit("m", "Radial semi-axis of the outer ellipse.")
    sides: f.Whole = unit("-", "Sides of the polygons that stand for the ellipses.", default=16, ge=4, le=64)
    cross_track_max_m: f.Positive | None = unit("m", default=None)
    """Bound on |r_z| and on |v_z|/eta at the end; without it both must be 0."""


class LinearNMTGoal(HillGoal):
    """End on a cross-track oscillation through a point of the along-track axis. Hill's frame only."""

    makes = goals.LinearNMT
    kind: Literal["linear_nmt"] = unit("-", "Linear natural motion trajectory.")
    amplitude_max_m: f.Positive = unit("m", "Largest amplitude of the oscillation.")
    along_track_m: f.Number = unit("m", "Along-track position r_y.", default=0.0)


class StationaryGoal(GoalTable):
    """End at rest, at a state that keeps itself without input (A x = 0)."""

    makes = goals.StationaryPoint
    kind: Literal["stationary"] = unit("-", "Hold point.")
    state: f.Vector = unit("m, m/s (state order)")
    """State to end in, n numbers. In Hill's frame: on the along-track axis, at rest. For a point that needs
    holding, use kind box."""

    def build(self, system: LinearSystem) -> goals.Goal:
        """The goal."""
        state = np.array(self.state, dtype=float)
        drift = float(np.abs(system.A @ state).max())
        if drift > 1e-9 * max(1.0, float(np.abs(state).max())) * max(1.0, float(np.abs(system.A).max())):
            rule = f"must keep itself without input (A x = 0, here {drift:.3g}); else use kind 'box'"
            raise ScenarioError("goal.state", list(self.state), rule)
        return super().build(system)


class BoxGoal(GoalTable):
    """End anywhere in a box of states."""

    makes = goals.Box
    kind: Literal["box"] = unit("-", "Axis-aligned box.")
    center: f.Vector = unit("m, m/s (state order)", "Centre, n numbers.")
    half_widths: f.OpenWidthVector = unit("m, m/s (state order)")
    """Half-width per state, n numbers >= 0; inf where any value will do."""


Goal = Annotated[EllipticalNMTGoal | LinearNMTGoal | StationaryGoal | BoxGoal, *BY_KIND]
