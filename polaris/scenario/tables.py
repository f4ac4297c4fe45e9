"""The scenario file's models: one class per table, one field per key, units in the names.

These models know the rules of a single field. Rules that join several fields (shapes against the
system, steps that divide the horizon, the start inside an obstacle) are in `polaris.scenario.rules`.
States are written in the order of the system's state vector; in Hill's frame that is
``[r_x, r_y, r_z, v_x, v_y, v_z]`` in m and m/s (x radial, y along-track, z cross-track).
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from .fields import (
    MAX_STEPS,
    DiagonalOrMatrix,
    Matrix,
    Name,
    NonNegative,
    Positive,
    PositivePerAxis,
    Real,
    ScenarioPart,
    Text,
    Vector,
    VersionOne,
    Whole,
    WidthVector,
    unit,
    word_or_vector,
)
from .orbit import Orbit
from .scene_tables import Experimental, Goal, KeepIn, Obstacle

# -- the system -------------------------------------------------------------------------------------


class ClohessyWiltshire(ScenarioPart):
    """A chaser near a target on a circular orbit, in Hill's frame (Example 1, eq. 1)."""

    kind: Literal["clohessy_wiltshire"] = unit("-", "Clohessy-Wiltshire dynamics, six states.")
    mean_motion_rad_s: Real = unit(
        "rad/s", "Orbital rate eta of the target; 0.0012 in low Earth orbit.", gt=0, le=0.01
    )
    mass_kg: Real = unit("kg", "Mass of the chaser.", ge=1e-3, le=1e7)
    thrust_max_N: PositivePerAxis = unit(
        "N", "Thrust limit, one number for all axes or one each for x, y and z: |u_i| <= thrust_max_N[i]."
    )
    disturbance_max_m_s2: NonNegative = unit(
        "m/s^2", "Bound on the 2-norm of the disturbance acceleration.", default=0.0
    )


class Linear(ScenarioPart):
    """Any system x' = A x + B u + D w."""

    kind: Literal["linear"] = unit("-", "State-space matrices given as arrays.")
    A: Matrix = unit("SI", "State matrix, n rows of n numbers.")
    B: Matrix = unit("SI", "Input matrix, n rows of m numbers.")
    D: Matrix = unit("SI", "Disturbance matrix, n rows of p numbers.")
    input_max: PositivePerAxis = unit(
        "unit of the input", "Input limit, one number for all inputs or one each: |u_i| <= input_max[i]."
    )
    disturbance_max: NonNegative = unit(
        "unit of the disturbance", "Bound on the 2-norm of the disturbance w.", default=0.0
    )
    position_states: tuple[Annotated[Whole, Field(ge=0, le=99)], ...] | None = unit(
        "-",
        "Which states (counted from 0) are the position [m], one to three of them. "
        "Without it and without C: the first half of the states.",
        default=None,
        min_length=1,
        max_length=3,
    )
    C: Matrix | None = unit(
        "-", "Position as a matrix, d rows of n numbers, where it is not a choice of states.", default=None
    )
    mass_kg: Real = unit(
        "kg",
        "Mass that turns the integral of |u| into a velocity change; 1 where the input is an acceleration.",
        default=1.0,
        ge=1e-3,
        le=1e7,
    )


System = Annotated[ClohessyWiltshire | Linear, Field(discriminator="kind")]


# -- where it starts --------------------------------------------------------------------------------


class InitialBox(ScenarioPart):
    """An axis-aligned box of states."""

    kind: Literal["box"] = unit("-", "Axis-aligned box.")
    center: Vector = unit("m, m/s (state order)", "Centre, n numbers; the reference starts here.")
    half_widths: WidthVector = unit("m, m/s (state order)", "Half-width per state, n numbers >= 0.")


class InitialBall(ScenarioPart):
    """Positions in one ball, the other states in another: no norm mixes m and m/s.

    It is used through an enclosing zonotope, so what is proven holds for a slightly larger set.
    """

    kind: Literal["ball"] = unit("-", "Product of a ball of positions and a ball of velocities.")
    center: Vector = unit("m, m/s (state order)", "Centre, n numbers; the reference starts here.")
    position_radius_m: NonNegative = unit("m", "2-norm radius of the position about its centre.")
    velocity_radius_m_s: NonNegative = unit(
        "m/s", "2-norm radius of all other states (the velocity, in a mechanical system)."
    )


class InitialZonotope(ScenarioPart):
    """The set ``center + sum_i b_i generators[i]`` with every ``|b_i| <= 1``."""

    kind: Literal["zonotope"] = unit("-", "Zonotope.")
    center: Vector = unit("m, m/s (state order)", "Centre, n numbers; the reference starts here.")
    generators: Matrix = unit("m, m/s (state order)", "One list of n numbers per generator.")


InitialSet = Annotated[InitialBox | InitialBall | InitialZonotope, Field(discriminator="kind")]


# -- time and feedback ------------------------------------------------------------------------------


class Horizon(ScenarioPart):
    """How long, and in what steps."""

    duration_s: Positive = unit("s", "Time T covered by the reference and the schedule.")
    step_s: Positive = unit(
        "s", f"Step delta of the plan and of the schedule. Must divide duration_s; at most {MAX_STEPS} steps."
    )


class ContinuousFeedback(ScenarioPart):
    """Feedback acts at every instant."""

    kind: Literal["continuous"] = unit("-", "Idealised continuous feedback.")


class SampledFeedback(ScenarioPart):
    """The flight computer's reality: the state is read and the input set once per control period."""

    kind: Literal["sampled"] = unit("-", "Zero-order hold.")
    period_s: Positive = unit("s", "Control period. Must divide step_s.")


Feedback = Annotated[ContinuousFeedback | SampledFeedback, Field(discriminator="kind")]


class Tracking(ScenarioPart):
    """The tracking controller of section III-A and the bound on its error."""

    Q: DiagonalOrMatrix = unit(
        "1/unit of the state^2",
        "LQR state weight: its diagonal (n numbers) or the full matrix. Positive semidefinite.",
    )
    R: DiagonalOrMatrix = unit(
        "1/unit of the input^2",
        "LQR input weight: its diagonal (m numbers) or the full matrix. Positive definite.",
    )
    bound: Literal["envelope", "lyapunov"] = unit(
        "-",
        "How the norm of the tracking error is bounded (Lemma 1): an envelope of the matrix exponential "
        "(tighter), or a Lyapunov function.",
        default="envelope",
    )
    weight: word_or_vector(Literal["auto", "identity"]) = unit(  # type: ignore[valid-type]
        "-",
        "Weighted norm of that bound: chosen for the closed loop, none (m and m/s in one norm, loose), or "
        "the diagonal of W, n numbers > 0.",
        default="auto",
    )


class Recoverable(ScenarioPart):
    """From where the safety controller still saves the day (Definition 1)."""

    kind: Literal["polytope", "ball", "time_varying_ball", "paper_ball"] = unit(
        "-",
        "`polytope`: facets of the plan carried back in time, exact for them. `time_varying_ball`: eq. 12 "
        "with the clearance still ahead. `ball`: eqs. 11-12 in the weighted norm, thrust limits included. "
        "`paper_ball`: as printed, without thrust limits; UNSOUND, for comparison only, never a guarantee.",
        default="polytope",
    )
    recourse: Literal["in_view", "none"] = unit(
        "-",
        "`in_view`: the safe reference may be planned along the path of an experimental controller, so that "
        "the safety controller acts only where it must. `none`: the one of the printed Algorithm 1.",
        default="in_view",
    )


class Planner(ScenarioPart):
    """The mixed-integer program behind the reference (section III-C)."""

    objective: Literal["margin_then_fuel", "distance", "fuel"] = unit(
        "-",
        "`margin_then_fuel`: reach extra_margin_m where there is room, then least fuel. `fuel`: least fuel. "
        "`distance`: eq. 19, largest clearance at any price.",
        default="margin_then_fuel",
    )
    extra_margin_m: NonNegative = unit(
        "m", "Clearance wanted beyond the tracking error; room for the experimental controller.", default=0.0
    )
    thrust_reserve: Real = unit(
        "-",
        "Share of the thrust limits the reference leaves to the tracker beyond what the initial set needs; "
        "room for the experimental controller, as extra_margin_m is.",
        default=0.2,
        ge=0,
        lt=1,
    )
    solver: Literal["facets", "highs", "gurobi"] = unit(
        "-",
        "Who chooses the side on which to pass: `facets`, the planner's own branch and bound, whose linear "
        "programs HiGHS solves; or `highs` or `gurobi` on the same program with binary variables "
        "(gurobi needs the extra of that name).",
        default="facets",
    )
    max_linear_programs: Whole = unit(
        "-", "Most linear programs that `facets` solves, in all stages.", default=10_000, ge=1, le=10**9
    )
    max_nodes: Whole = unit(
        "-",
        "Most branch-and-bound nodes of `highs` or `gurobi`, in all stages.",
        default=100_000,
        ge=1,
        le=10**9,
    )
    time_limit_s: Real = unit(
        "s",
        "Wall time for each plan, the last resort: what it cuts short depends on the machine, and the run "
        "says so.",
        default=600.0,
        gt=0,
        le=1e6,
    )
    gap: Real = unit("-", "Relative optimality gap at which the search stops.", default=1e-3, ge=0, lt=1)


# -- the rest --------------------------------------------------------------------------------------


class Schedule(ScenarioPart):
    """How the switching schedule is chosen (Algorithm 2 and beyond)."""

    strategy: Literal["greedy", "look_ahead"] = unit(
        "-",
        "`greedy`: Algorithm 2, use an experimental controller whenever it is safe now. `look_ahead`: most "
        "use over the whole horizon, by weight.",
        default="greedy",
    )
    min_dwell_steps: Whole = unit(
        "steps", "Fewest steps between two switches.", default=1, ge=1, le=MAX_STEPS
    )
    max_switches: Whole | None = unit("-", "Most switches in the run; no cap without it.", default=None, ge=0)
    delta_v_price: NonNegative = unit(
        "-",
        "Share of the horizon under an experimental controller that is given up for a velocity change as "
        "large as the safety controller's alone.",
        default=0.06,
    )
    switch_price: NonNegative = unit(
        "-",
        "Share of the horizon under an experimental controller that is given up for one switch less.",
        default=0.005,
    )
    delta_v_max_m_s: Positive | None = unit(
        "m/s",
        "Budget of velocity change: schedules that are proven to keep it come first. None without it.",
        default=None,
    )
    beam: Whole = unit(
        "-",
        "Schedules that `look_ahead` keeps at every step for each number of switches and controller. More "
        "find better ones, in as much more time.",
        default=1,
        ge=1,
        le=1000,
    )


class Simulation(ScenarioPart):
    """Closed-loop runs behind the metrics and figures. They illustrate; they prove nothing."""

    runs: Whole = unit("-", "Runs per controller.", default=100, ge=1, le=1_000_000)
    seed: Whole = unit(
        "-", "Seed; the same seed and scenario give the same results.", default=0, ge=0, le=2**63 - 1
    )


class ScenarioModel(ScenarioPart):
    """A whole scenario file."""

    schema_version: VersionOne = unit("-", "Version of this format.")
    name: Name = unit("-", "Short name; the run folder is called after it.")
    title: Text = unit("-", "One line for figures and tables.", min_length=1, max_length=200)
    description: Text = unit("-", "What the scenario shows.", default="", max_length=5000)
    system: System = unit("-", "The controlled system.")
    orbit: Orbit | None = unit(
        "-",
        "What the linear model of a spacecraft leaves out; needed by `polaris model-error`.",
        default=None,
    )
    initial_set: InitialSet = unit("-", "All states it may start in (Theta).")
    horizon: Horizon = unit("-", "Time covered and its steps.")
    feedback: Feedback = unit(
        "-",
        "When the controllers act; continuous feedback without it.",
        default_factory=lambda: ContinuousFeedback(kind="continuous"),
    )
    tracking: Tracking = unit("-", "The safety controller's tracking part.")
    recoverable: Recoverable = unit("-", "Which recoverable sets.", default_factory=Recoverable)
    planner: Planner = unit("-", "How the reference is planned.", default_factory=Planner)
    goal: Goal = unit("-", "Where the reference must end.")
    obstacles: tuple[Obstacle, ...] = unit("-", "Sets to stay out of.", default=(), max_length=64)
    keep_in: tuple[KeepIn, ...] = unit("-", "Sets to stay inside.", default=(), max_length=16)
    experimental: tuple[Experimental, ...] = unit(
        "-", "Experimental controllers in order of preference.", min_length=1, max_length=8
    )
    schedule: Schedule = unit("-", "How the switching schedule is chosen.", default_factory=Schedule)
    simulation: Simulation = unit("-", "Closed-loop runs.", default_factory=Simulation)

    def scene_parts(self) -> list[tuple[str, Obstacle | KeepIn]]:
        """Obstacles and keep-in sets with their paths in the file."""
        outside = [(f"obstacles[{i}]", part) for i, part in enumerate(self.obstacles)]
        return [*outside, *((f"keep_in[{i}]", part) for i, part in enumerate(self.keep_in))]
