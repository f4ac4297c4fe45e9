"""The scenario file's models of the scene: obstacles, keep-in sets, experimental controllers."""

from typing import Annotated, Literal

from reach.networks.onnx_file import OPERATORS

from ...model import keys as f
from ...model.scene import keep_in, obstacles, satellite, state_limits, turning
from .fields import BY_KIND, Described, ScenarioPart, unit


class BoxObstacleTable(Described, makes=obstacles.BoxObstacle, kind="box", says="Axis-aligned box."):
    """See `obstacles.BoxObstacle`."""


class BallObstacleTable(Described, makes=obstacles.BallObstacle, kind="ball", says="Ball."):
    """See `obstacles.BallObstacle`."""


WALL = "Convex polytope; may be unbounded (a wall is one row)."
BODY = "Another body that obeys the system's dynamics."
CHAIN = f"ONNX file, relative to the scenario; a chain of the operators {', '.join(OPERATORS)}."


class PolytopeObstacleTable(Described, makes=obstacles.PolytopeObstacle, kind="polytope", says=WALL):
    """See `obstacles.PolytopeObstacle`."""


class SatelliteObstacleTable(Described, makes=satellite.SatelliteObstacle, kind="satellite", says=BODY):
    """See `satellite.SatelliteObstacle`."""


class StateObstacleTable(
    Described, makes=state_limits.StateObstacle, kind="states", says="Positions and velocities."
):
    """See `state_limits.StateObstacle`."""


Obstacle = Annotated[
    BoxObstacleTable
    | BallObstacleTable
    | PolytopeObstacleTable
    | SatelliteObstacleTable
    | StateObstacleTable,
    *BY_KIND,
]


class KeepInPolytopeTable(
    Described, makes=keep_in.KeepInPolytope, kind="polytope", says="Convex polytope to stay inside."
):
    """See `keep_in.KeepInPolytope`."""


class KeepInConeTable(Described, makes=keep_in.KeepInCone, kind="cone", says="Cone to stay inside."):
    """See `keep_in.KeepInCone`."""


class KeepInStatesTable(
    Described, makes=state_limits.KeepInStates, kind="states", says="Positions and velocities to stay inside."
):
    """See `state_limits.KeepInStates`."""


class SpeedLimitTable(Described, makes=state_limits.SpeedLimit, kind="speed", says="Speed, by distance."):
    """See `state_limits.SpeedLimit`."""


class SpeedPolygonTable(
    Described, makes=state_limits.SpeedPolygon, kind="speed_polygon", says="Polygon of velocities."
):
    """See `state_limits.SpeedPolygon`."""


class TurningKeepInTable(Described, makes=turning.TurningKeepIn, kind="turning", says="Corridor that turns."):
    """See `turning.TurningKeepIn`."""


KeepIn = Annotated[
    KeepInPolytopeTable
    | KeepInConeTable
    | KeepInStatesTable
    | SpeedLimitTable
    | SpeedPolygonTable
    | TurningKeepInTable,
    *BY_KIND,
]


class SharedReference(ScenarioPart):
    """S's own reference."""

    kind: Literal["shared"] = unit("-", "Follow the safety controller's reference.")


class SetpointReference(ScenarioPart):
    """One fixed state."""

    kind: Literal["setpoint"] = unit("-", "Head for one state.")
    state: f.Vector = unit("m, m/s", "The state.")


class NMTReference(ScenarioPart):
    """An elliptical natural motion trajectory. Hill's frame only."""

    kind: Literal["nmt"] = unit("-", "Follow an elliptical natural motion trajectory.")
    semi_minor_m: f.NonNegative = unit("m", "Radial semi-axis.")
    phase_rad: f.Number = unit("rad", "Phase at t = 0; at 0 ahead on the along-track axis.", default=0.0)
    cross_track_m: f.NonNegative = unit("m", "Cross-track amplitude.", default=0.0)
    cross_phase_rad: f.Number = unit("rad", "Cross-track phase relative to phase_rad.", default=0.0)


class UnawareReference(ScenarioPart):
    """A fuel-optimal plan to the goal that ignores obstacles and keep-in sets."""

    kind: Literal["unaware"] = unit("-", "Fuel-optimal plan that ignores obstacles.")


ControllerReference = Annotated[
    SharedReference | SetpointReference | NMTReference | UnawareReference, *BY_KIND
]


class AffineTable(ScenarioPart):
    """State feedback ``u = mu + K (ref - x)``, clipped at the thrust limits or not."""

    kind: Literal["affine", "saturated_affine"] = unit("-")
    """`affine`: unclipped, used only where it provably keeps the thrust limits. `saturated_affine`: clipped
    per axis."""
    name: f.Name = unit("-", "Name.")
    Q: f.DiagonalOrMatrix | None = unit("1/state^2", "LQR weight, with R.", default=None)
    R: f.DiagonalOrMatrix | None = unit("1/input^2", "LQR weight, with Q.", default=None)
    gain: f.Matrix | None = unit("input/state", default=None)
    """Gain K, m by n, instead of Q and R."""
    reference: ControllerReference = unit("-", default_factory=lambda: SharedReference(kind="shared"))
    """Followed trajectory; by default S's reference."""
    weight: f.Real = unit("-", "Weight of a second of its use in look_ahead.", default=1.0, gt=0, le=1e6)


class AnyThrustTable(ScenarioPart):
    """Any thrust within the limits: covers black boxes, learned policies, pilots."""

    kind: Literal["any_thrust"] = unit("-", "Unknown controller within the thrust limits.")
    name: f.Name = unit("-", "Name.")
    weight: f.Real = unit("-", "Weight of a second of its use in look_ahead.", default=1.0, gt=0, le=1e6)


class Neural(ScenarioPart):
    """A feed-forward network, evaluated at the start of every control period and clipped at the limits.

    An obstacle's state may be any that its declared motion allows, relative to the chaser's estimate.
    """

    kind: Literal["neural"] = unit("-", "Neural network from an ONNX file.")
    name: f.Name = unit("-", "Name.")
    path: f.Text = unit("-", CHAIN, min_length=6, max_length=1000, pattern=r"\.onnx$")
    inputs: tuple[f.Input, ...] = unit("-", default=("error",), min_length=1, max_length=100)
    """Inputs in order: `error` (n numbers, reference minus x), `state` (n), `time` (start of the step [s]),
    `reference_input` (m); of an obstacle `position:NAME`, `velocity:NAME`, or relative to the chaser
    `relative_position:NAME`, `relative_velocity:NAME` (d each)."""
    input_scale: f.Vector | None = unit("-", default=None)
    """Factor of each number of the inputs; by default 1."""
    output_scale_N: f.PositivePerAxis = unit("N", "Thrust, or input, at an output of 1.")
    precision: Literal["real", "float32", "float64"] = unit("-", default="real")
    """Arithmetic on board. `real`: its rounding is not covered. `float32`, `float64`: any runtime is covered,
    in any order of summation."""
    reference: ControllerReference = unit("-", default_factory=lambda: SharedReference(kind="shared"))
    """Reference of `error` and `reference_input`; by default S's."""
    weight: f.Real = unit("-", "Weight of a second of its use in look_ahead.", default=1.0, gt=0, le=1e6)


class BlackBoxTable(ScenarioPart):
    """A program that is asked for commands once a control period; its sets rest on samples.

    Give it with `polaris run --black-box NAME=COMMAND`, or as a callable. The guarantee is `statistical`.
    """

    kind: Literal["black_box"] = unit("-", "Unknown controller that can be asked.")
    name: f.Name = unit("-", "Name.")
    probability: f.Real = unit("-", default=0.01, ge=1e-5, le=0.5)
    """Largest probability that a flight leaves the bands of the black boxes; the least given counts."""
    confidence: f.Real = unit("-", default=0.999, ge=0.5, le=1 - 1e-9)
    """Confidence of that statement; the highest given counts."""
    memory: bool = unit("-", default=False)
    """True if answers depend on earlier questions of a flight. A question at time 0 begins new flights, one
    per row; callables with a `reset` have memory."""
    weight: f.Real = unit("-", "Weight of a second of its use in look_ahead.", default=1.0, gt=0, le=1e6)


Experimental = Annotated[AffineTable | AnyThrustTable | Neural | BlackBoxTable, *BY_KIND]
