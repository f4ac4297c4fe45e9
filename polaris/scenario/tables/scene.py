"""The scenario file's models of the scene: obstacles, keep-in sets, experimental controllers."""

from typing import Annotated, Literal

from ...model import keys as f
from ...model.scene import keep_in, obstacles, satellite, state_limits, turning
from .fields import BY_KIND, Described, ScenarioPart, unit


class BoxObstacle(Described, makes=obstacles.BoxObstacle, kind="box", says="Axis-aligned box."):
    """See `obstacles.BoxObstacle`."""


class BallObstacle(Described, makes=obstacles.BallObstacle, kind="ball", says="Ball."):
    """See `obstacles.BallObstacle`."""


WALL = "Convex polytope; may be unbounded (a wall is one row)."
BODY = "Another body that obeys the system's dynamics."


class PolytopeObstacle(Described, makes=obstacles.PolytopeObstacle, kind="polytope", says=WALL):
    """See `obstacles.PolytopeObstacle`."""


class SatelliteObstacle(Described, makes=satellite.SatelliteObstacle, kind="satellite", says=BODY):
    """See `satellite.SatelliteObstacle`."""


class StateObstacle(
    Described, makes=state_limits.StateObstacle, kind="states", says="Positions and velocities."
):
    """See `state_limits.StateObstacle`."""


Obstacle = Annotated[
    BoxObstacle | BallObstacle | PolytopeObstacle | SatelliteObstacle | StateObstacle, *BY_KIND
]


class KeepInPolytope(
    Described, makes=keep_in.KeepInPolytope, kind="polytope", says="Convex polytope to stay inside."
):
    """See `keep_in.KeepInPolytope`."""


class KeepInCone(Described, makes=keep_in.KeepInCone, kind="cone", says="Cone to stay inside."):
    """See `keep_in.KeepInCone`."""


class KeepInStates(
    Described, makes=state_limits.KeepInStates, kind="states", says="Positions and velocities to stay inside."
):
    """See `state_limits.KeepInStates`."""


class SpeedLimit(Described, makes=state_limits.SpeedLimit, kind="speed", says="Speed, by distance."):
    """See `state_limits.SpeedLimit`."""


class SpeedPolygon(
    Described, makes=state_limits.SpeedPolygon, kind="speed_polygon", says="Polygon of velocities."
):
    """See `state_limits.SpeedPolygon`."""


class TurningKeepIn(Described, makes=turning.TurningKeepIn, kind="turning", says="Corridor that turns."):
    """See `turning.TurningKeepIn`."""


KeepIn = Annotated[
    KeepInPolytope | KeepInCone | KeepInStates | SpeedLimit | SpeedPolygon | TurningKeepIn, *BY_KIND
]


class SharedReference(ScenarioPart):
    """The safety controller's own reference."""

    kind: Literal["shared"] = unit("-", "Follow the safety controller's reference.")


class SetpointReference(ScenarioPart):
    """One fixed state."""

    kind: Literal["setpoint"] = unit("-", "Head for one state.")
    state: f.Vector = unit("m, m/s (state order)", "The state, n numbers.")


class NMTReference(ScenarioPart):
    """An elliptical natural motion trajectory. Hill's frame only."""

    kind: Literal["nmt"] = unit("-", "Follow an elliptical natural motion trajectory.")
    semi_minor_m: f.NonNegative = unit("m", "Radial semi-axis.")
    phase_rad: f.Number = unit("rad", "Phase at t = 0; 0 is ahead on the along-track axis.", default=0.0)
    cross_track_m: f.NonNegative = unit("m", "Cross-track amplitude.", default=0.0)
    cross_phase_rad: f.Number = unit("rad", "Cross-track phase relative to phase_rad.", default=0.0)


class UnawareReference(ScenarioPart):
    """A fuel-optimal plan to the same goal that knows nothing of obstacles and keep-in sets."""

    kind: Literal["unaware"] = unit("-", "Fuel-optimal plan that ignores obstacles.")


ControllerReference = Annotated[
    SharedReference | SetpointReference | NMTReference | UnawareReference, *BY_KIND
]


class Affine(ScenarioPart):
    """State feedback ``u = mu + K (ref - x)``, clipped at the thrust limits or not."""

    kind: Literal["affine", "saturated_affine"] = unit("-")
    """`affine`: never clipped, so it is used only where it provably stays within the thrust limits.
    `saturated_affine`: clipped per axis, as a real thruster does."""
    name: f.Name = unit("-", "Its name in tables and figures.")
    Q: f.DiagonalOrMatrix | None = unit("1/unit of the state^2", "LQR state weight, with R.", default=None)
    R: f.DiagonalOrMatrix | None = unit("1/unit of the input^2", "LQR input weight, with Q.", default=None)
    gain: f.Matrix | None = unit("input/state", default=None)
    """The gain K itself, m rows of n, instead of Q and R."""
    reference: ControllerReference = unit("-", default_factory=lambda: SharedReference(kind="shared"))
    """What it follows; the safety controller's reference without it."""
    weight: f.Real = unit("-", "What a second of its use is worth to look_ahead.", default=1.0, gt=0, le=1e6)


class AnyThrust(ScenarioPart):
    """Anything within the thrust limits: covers a black box, a learned policy, a pilot."""

    kind: Literal["any_thrust"] = unit("-", "Unknown controller within the thrust limits.")
    name: f.Name = unit("-", "Its name in tables and figures.")
    weight: f.Real = unit("-", "What a second of its use is worth to look_ahead.", default=1.0, gt=0, le=1e6)


class Neural(ScenarioPart):
    """A feed-forward network that is evaluated once a control period, clipped at the thrust limits.

    Each number that it reads is multiplied by its entry of `input_scale`, its outputs by `output_scale_N`;
    what it reads is taken at the start of the period, the time at that of the step. Of an obstacle it is told
    any state that the declared motion allows then, relative to its own estimate.
    """

    kind: Literal["neural"] = unit("-", "Neural network from an ONNX file.")
    name: f.Name = unit("-", "Its name in tables and figures.")
    path: f.Text = unit("-", min_length=6, max_length=1000, pattern=r"\.onnx$")
    """The ONNX file, from the folder of the scenario; a run folder holds a copy, beside its scenario."""
    inputs: tuple[f.Input, ...] = unit("-", default=("error",), min_length=1, max_length=100)
    """What it reads, in this order: `error` (reference - x, n numbers), `state` (n), `time` (start of the
    step [s], 1), `reference_input` (m); of an obstacle NAME `position:NAME` (d [m]) and
    `velocity:NAME` (d [m/s]), and `relative_position:NAME` and `relative_velocity:NAME`, the same less the
    chaser's own."""
    input_scale: f.Vector | None = unit("-", default=None)
    """What each number that it reads is multiplied by; 1 without it."""
    output_scale_N: f.PositivePerAxis = unit(
        "N (unit of the input)", "Thrust at an output of 1; one number or m."
    )
    precision: Literal["real", "float32", "float64"] = unit("-", default="real")
    """Arithmetic in which it is evaluated on board. `real`: rounding on board is not covered. `float32`,
    `float64`: its sets hold what any runtime computes in it, whatever the order of summation."""
    reference: ControllerReference = unit("-", default_factory=lambda: SharedReference(kind="shared"))
    """What `error` and `reference_input` are about; the safety controller's reference without it."""
    weight: f.Real = unit("-", "What a second of its use is worth to look_ahead.", default=1.0, gt=0, le=1e6)


class BlackBox(ScenarioPart):
    """A controller that is asked for its commands once a control period: its sets come from samples.

    To be given when it is run: `polaris run --black-box NAME=COMMAND`, or a callable from Python.
    Where it flies the guarantee is `statistical`.
    """

    kind: Literal["black_box"] = unit("-", "Unknown controller that can be asked.")
    name: f.Name = unit("-", "Its name in tables and figures.")
    probability: f.Real = unit("-", default=0.01, ge=1e-5, le=0.5)
    """With which a flight may leave the bands of all black boxes; the least one given counts."""
    confidence: f.Real = unit("-", default=0.999, ge=0.5, le=1 - 1e-9)
    """Of the statement that it is no more; the highest one given counts."""
    memory: bool = unit("-", default=False)
    """Whether its answers depend on what it was asked earlier in a flight. A question at time 0 begins new
    flights, one for each row; a callable with a `reset` is taken to have memory."""
    weight: f.Real = unit("-", "What a second of its use is worth to look_ahead.", default=1.0, gt=0, le=1e6)


Experimental = Annotated[Affine | AnyThrust | Neural | BlackBox, *BY_KIND]
