"""The scenario file's models of the scene: goals, obstacles, keep-in sets, experimental controllers."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field

from ..model import keep_in, obstacles, satellite
from ..model.errors import ScenarioError
from ..model.obstacle import Obstacle as Unsafe
from ..model.system import LinearSystem
from .fields import (
    DiagonalOrMatrix,
    Flag,
    Matrix,
    Name,
    NonNegative,
    Number,
    OpenWidthVector,
    Positive,
    Real,
    ScenarioPart,
    Vector,
    Whole,
    WidthVector,
    unit,
)

if TYPE_CHECKING:
    from ..planning import goals as ends

# -- where it ends ----------------------------------------------------------------------------------


USUAL_RATE = 1e-2
"""Rate [rad/s] by which velocities are weighed against positions where there is no orbit."""


def hill_rate(system: LinearSystem, field: str, given: object) -> float:
    """Mean motion [rad/s] of what needs Hill's frame."""
    if system.mean_motion is None:
        raise ScenarioError(field, given, "needs Hill's frame (system.kind = 'clohessy_wiltshire')")
    return system.mean_motion


class EllipticalNMTGoal(ScenarioPart):
    """End on a closed ellipse about the target that needs no thrust (eqs. 20-22). Hill's frame only."""

    kind: Literal["elliptical_nmt"] = unit("-", "Elliptical natural motion trajectory.")
    inner_semi_minor_m: NonNegative = unit("m", "Radial semi-axis of the inner ellipse; 0 for none.")
    outer_semi_minor_m: Positive = unit("m", "Radial semi-axis of the outer ellipse.")
    sides: Whole = unit("-", "Sides of the polygons that stand for the ellipses.", default=16, ge=4, le=64)
    cross_track_max_m: Positive | None = unit(
        "m", "Bound on |r_z| and on |v_z|/eta at the end; without it both must be 0.", default=None
    )

    def build(self, system: LinearSystem) -> ends.EllipticalNMT:
        """The goal."""
        from ..planning.goals import EllipticalNMT

        room = self.outer_semi_minor_m * float(np.cos(np.pi / self.sides))
        if self.inner_semi_minor_m >= room:
            rule = f"must be below {room:.6g} (how far the outer polygon of {self.sides} sides reaches)"
            raise ScenarioError("goal.inner_semi_minor_m", self.inner_semi_minor_m, rule)
        return EllipticalNMT(
            hill_rate(system, "goal.kind", self.kind),
            self.inner_semi_minor_m,
            self.outer_semi_minor_m,
            self.sides,
            self.cross_track_max_m,
        )


class LinearNMTGoal(ScenarioPart):
    """End on a cross-track oscillation through a point of the along-track axis. Hill's frame only."""

    kind: Literal["linear_nmt"] = unit("-", "Linear natural motion trajectory.")
    amplitude_max_m: Positive = unit("m", "Largest amplitude of the oscillation.")
    along_track_m: Number = unit("m", "Along-track position r_y.", default=0.0)

    def build(self, system: LinearSystem) -> ends.LinearNMT:
        """The goal."""
        from ..planning.goals import LinearNMT

        return LinearNMT(hill_rate(system, "goal.kind", self.kind), self.amplitude_max_m, self.along_track_m)


class StationaryGoal(ScenarioPart):
    """End at rest, at a state that keeps itself without input (A x = 0)."""

    kind: Literal["stationary"] = unit("-", "Hold point.")
    state: Vector = unit(
        "m, m/s (state order)",
        "State to end in, n numbers. In Hill's frame: on the along-track axis, at rest. "
        "For a point that needs holding, use kind box.",
    )

    def build(self, system: LinearSystem) -> ends.StationaryPoint:
        """The goal."""
        from ..planning.goals import StationaryPoint

        state = np.array(self.state, dtype=float)
        drift = float(np.abs(system.A @ state).max())
        if drift > 1e-9 * max(1.0, float(np.abs(state).max())) * max(1.0, float(np.abs(system.A).max())):
            rule = f"must keep itself without input (A x = 0, here {drift:.3g}); else use kind 'box'"
            raise ScenarioError("goal.state", list(self.state), rule)
        return StationaryPoint(state, system.mean_motion or USUAL_RATE)


class BoxGoal(ScenarioPart):
    """End anywhere in a box of states."""

    kind: Literal["box"] = unit("-", "Axis-aligned box.")
    center: Vector = unit("m, m/s (state order)", "Centre, n numbers.")
    half_widths: OpenWidthVector = unit(
        "m, m/s (state order)", "Half-width per state, n numbers >= 0; inf where any value will do."
    )

    def build(self, system: LinearSystem) -> ends.Box:
        """The goal."""
        from ..planning.goals import Box

        return Box(
            np.array(self.center, dtype=float), np.array(self.half_widths), system.mean_motion or USUAL_RATE
        )


Goal = Annotated[EllipticalNMTGoal | LinearNMTGoal | StationaryGoal | BoxGoal, Field(discriminator="kind")]


# -- what to avoid ----------------------------------------------------------------------------------


def _name() -> Any:
    return unit("-", "Its name in messages and figures.")


def _velocity() -> Any:
    return unit("m/s", "Constant velocity, d numbers; at rest without it.", default=None)


def _facets() -> Any:
    return unit(
        "-",
        "Facets of the polytope planned around: 6, 14, 18 or 26 (default) in space, any number in the plane "
        "(default 12). More are tighter and cost the planner more.",
        default=None,
        ge=3,
        le=64,
    )


class Body(ScenarioPart):
    """Base of unsafe sets, whose Python class `makes` has the names of the file without their units."""

    makes: ClassVar[Callable[..., Unsafe]]

    def build(self, path: str) -> Unsafe:
        """The unsafe set (of a keep-in set its outside)."""
        bare = {re.sub("_(m|m_s|m_s2)$", "", key): value for key, value in self if key != "kind"}
        return type(self).makes(**{PYTHON_NAMES.get(key, key): bare[key] for key in bare}, path=path)


PYTHON_NAMES = {"normals": "H", "offsets": "b"}


class BoxObstacle(Body):
    """An axis-aligned box, at rest or moving straight."""

    makes = obstacles.BoxObstacle
    kind: Literal["box"] = unit("-", "Axis-aligned box.")
    name: Name = _name()
    center_m: Vector = unit("m", "Centre at t = 0, d numbers.")
    half_widths_m: WidthVector = unit("m", "Half-width per axis, d numbers > 0.")
    velocity_m_s: Vector | None = _velocity()


class BallObstacle(Body):
    """A ball, at rest or moving straight; it is planned around as a circumscribed polytope."""

    makes = obstacles.BallObstacle
    kind: Literal["ball"] = unit("-", "Ball.")
    name: Name = _name()
    center_m: Vector = unit("m", "Centre at t = 0, d numbers.")
    radius_m: Positive = unit("m", "Radius.")
    velocity_m_s: Vector | None = _velocity()
    facets: Whole | None = _facets()


class PolytopeObstacle(Body):
    """The positions p with ``normals p <= offsets_m``, at rest or moving straight."""

    makes = obstacles.PolytopeObstacle
    kind: Literal["polytope"] = unit("-", "Convex polytope; may be unbounded (a wall is one row).")
    name: Name = _name()
    normals: Matrix = unit("-", "Outward facet normals, F rows of d numbers; any length but 0.")
    offsets_m: Vector = unit("m (for unit normals)", "Offsets at t = 0, F numbers.")
    velocity_m_s: Vector | None = _velocity()
    unbounded: Flag = unit(
        "-",
        "Must be true for a set without bounds (a wall), so that a forgotten row is noticed.",
        default=False,
    )


class SatelliteObstacle(Body):
    """Another spacecraft: an uncertain state carried forward by the same dynamics, with or without thrust.

    It obeys ``x' = A x + D w`` with the system's own A, D and bound on w; its own acceleration, if it has
    any, is added to that of its position.
    """

    makes = satellite.SatelliteObstacle
    kind: Literal["satellite"] = unit("-", "Another body that obeys the system's dynamics.")
    name: Name = _name()
    state: Vector = unit("m, m/s (state order)", "Estimated state at t = 0, n numbers.")
    state_half_widths: WidthVector = unit(
        "m, m/s (state order)", "Uncertainty of that state as a box, n numbers >= 0."
    )
    radius_m: Positive = unit("m", "Distance from its centre that counts as a collision.")
    thrust_accel_max_m_s2: NonNegative = unit(
        "m/s^2",
        "2-norm of the acceleration it may apply; 0 for free motion. Needs a system whose position obeys an "
        "equation of second order.",
        default=0.0,
    )
    facets: Whole | None = _facets()


Obstacle = Annotated[
    BoxObstacle | BallObstacle | PolytopeObstacle | SatelliteObstacle, Field(discriminator="kind")
]


class KeepInPolytope(Body):
    """The chaser must stay where ``normals p <= offsets_m``."""

    makes = keep_in.KeepInPolytope
    kind: Literal["polytope"] = unit("-", "Convex polytope to stay inside.")
    name: Name = _name()
    normals: Matrix = unit("-", "Outward facet normals, F rows of d numbers; any length but 0.")
    offsets_m: Vector = unit("m (for unit normals)", "Offsets, F numbers.")


class KeepInCone(ScenarioPart):
    """A line-of-sight cone to stay inside; planned with a polyhedral cone inside the true one."""

    kind: Literal["cone"] = unit("-", "Cone to stay inside.")
    name: Name = _name()
    apex_m: Vector = unit("m", "Apex, d numbers.")
    axis: Vector = unit("-", "Direction in which the cone opens, d numbers; any length but 0.")
    half_angle_deg: Real = unit("deg", "Angle between axis and surface.", ge=0.1, le=89)
    facets: Whole = unit(
        "-", "Facets of the cone inside (in space; two in the plane).", default=12, ge=3, le=64
    )
    length_m: Positive | None = unit(
        "m", "Height at which the cone is cut off; endless without it.", default=None
    )

    def build(self, path: str) -> Unsafe:
        """The set outside of which is unsafe."""
        cone, angle = keep_in.KeepInCone, math.radians(self.half_angle_deg)
        return cone(self.name, self.apex_m, self.axis, angle, self.facets, self.length_m, path=path)


KeepIn = Annotated[KeepInPolytope | KeepInCone, Field(discriminator="kind")]


# -- experimental controllers -----------------------------------------------------------------------


class SharedReference(ScenarioPart):
    """The safety controller's own reference."""

    kind: Literal["shared"] = unit("-", "Follow the safety controller's reference.")


class SetpointReference(ScenarioPart):
    """One fixed state."""

    kind: Literal["setpoint"] = unit("-", "Head for one state.")
    state: Vector = unit("m, m/s (state order)", "The state, n numbers.")


class NMTReference(ScenarioPart):
    """An elliptical natural motion trajectory. Hill's frame only."""

    kind: Literal["nmt"] = unit("-", "Follow an elliptical natural motion trajectory.")
    semi_minor_m: NonNegative = unit("m", "Radial semi-axis.")
    phase_rad: Number = unit("rad", "Phase at t = 0; 0 is ahead on the along-track axis.", default=0.0)
    cross_track_m: NonNegative = unit("m", "Cross-track amplitude.", default=0.0)
    cross_phase_rad: Number = unit("rad", "Cross-track phase relative to phase_rad.", default=0.0)


class UnawareReference(ScenarioPart):
    """A fuel-optimal plan to the same goal that knows nothing of obstacles and keep-in sets."""

    kind: Literal["unaware"] = unit("-", "Fuel-optimal plan that ignores obstacles.")


ControllerReference = Annotated[
    SharedReference | SetpointReference | NMTReference | UnawareReference, Field(discriminator="kind")
]


class Affine(ScenarioPart):
    """State feedback ``u = mu + K (ref - x)``, clipped at the thrust limits or not."""

    kind: Literal["affine", "saturated_affine"] = unit(
        "-",
        "`affine`: never clipped, so it is used only where it provably stays within the thrust limits. "
        "`saturated_affine`: clipped per axis, as a real thruster does.",
    )
    name: Name = unit("-", "Its name in tables and figures.")
    Q: DiagonalOrMatrix | None = unit("1/unit of the state^2", "LQR state weight, with R.", default=None)
    R: DiagonalOrMatrix | None = unit("1/unit of the input^2", "LQR input weight, with Q.", default=None)
    gain: Matrix | None = unit(
        "input/state", "The gain K itself, m rows of n, instead of Q and R.", default=None
    )
    reference: ControllerReference = unit(
        "-",
        "What it follows; the safety controller's reference without it.",
        default_factory=lambda: SharedReference(kind="shared"),
    )
    weight: Real = unit("-", "What a second of its use is worth to look_ahead.", default=1.0, gt=0, le=1e6)


class AnyThrust(ScenarioPart):
    """Anything within the thrust limits: covers a black box, a learned policy, a pilot."""

    kind: Literal["any_thrust"] = unit("-", "Unknown controller within the thrust limits.")
    name: Name = unit("-", "Its name in tables and figures.")
    weight: Real = unit("-", "What a second of its use is worth to look_ahead.", default=1.0, gt=0, le=1e6)


Experimental = Annotated[Affine | AnyThrust, Field(discriminator="kind")]
