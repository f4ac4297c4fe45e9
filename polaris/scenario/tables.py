"""The scenario file's models: one class per table, one field per key, units in the names.

These models know the rules of a single field. Rules that join several fields (shapes against the
system, steps that divide the horizon, the start inside an obstacle) are in `polaris.scenario.rules`.
States are written in the order of the system's state vector; in Hill's frame that is
``[r_x, r_y, r_z, v_x, v_y, v_z]`` in m and m/s (x radial, y along-track, z cross-track).
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Annotated, Literal

import numpy as np

from reach.sets.ellipsoid import ball_generators
from reach.sets.zonotope import Zonotope

from ..model.errors import ScenarioError
from ..model.hill import clohessy_wiltshire
from ..model.system import Array, LinearSystem
from ..model.thrusters import Thrusters as Errors
from . import fields as f
from .fields import ScenarioPart, unit
from .scene_tables import Experimental, Goal, KeepIn, Obstacle


class ClohessyWiltshire(ScenarioPart):
    """A chaser near a target on a circular orbit, in Hill's frame (Example 1, eq. 1)."""

    kind: Literal["clohessy_wiltshire"] = unit("-", "Clohessy-Wiltshire dynamics, six states.")
    mean_motion_rad_s: f.Real = unit("rad/s", gt=0, le=0.01)
    """Orbital rate eta of the target; 0.0012 in low Earth orbit."""
    mass_kg: f.Real = unit("kg", "Mass of the chaser.", ge=1e-3, le=1e7)
    thrust_max_N: f.PositivePerAxis = unit("N")
    """Thrust limit, one number for all axes or one each for x, y and z: |u_i| <= thrust_max_N[i]."""
    disturbance_max_m_s2: f.NonNegative = unit("m/s^2", default=0.0)
    """Bound on the 2-norm of the disturbance acceleration."""

    def build(self) -> LinearSystem:
        """The controlled system."""
        limit = _limits("system.thrust_max_N", self.thrust_max_N, 3)
        return clohessy_wiltshire(self.mean_motion_rad_s, self.mass_kg, limit, self.disturbance_max_m_s2)


class Linear(ScenarioPart):
    """Any system x' = A x + B u + D w."""

    kind: Literal["linear"] = unit("-", "State-space matrices given as arrays.")
    A: f.Matrix = unit("SI", "State matrix, n rows of n numbers.")
    B: f.Matrix = unit("SI", "Input matrix, n rows of m numbers.")
    D: f.Matrix = unit("SI", "Disturbance matrix, n rows of p numbers.")
    input_max: f.PositivePerAxis = unit("unit of the input")
    """Input limit, one number for all inputs or one each: |u_i| <= input_max[i]."""
    disturbance_max: f.NonNegative = unit("unit of the disturbance", default=0.0)
    """Bound on the 2-norm of the disturbance w."""
    position_states: tuple[f.Index, ...] | None = unit("-", default=None, min_length=1, max_length=3)
    """Which states (counted from 0) are the position [m], one to three of them. Without it and without C: the
    first half of the states."""
    C: f.Matrix | None = unit("-", default=None)
    """Position as a matrix, d rows of n numbers, where it is not a choice of states."""
    mass_kg: f.Real = unit("kg", default=1.0, ge=1e-3, le=1e7)
    """Mass that turns the integral of |u| into a velocity change; 1 where the input is an acceleration."""

    def build(self) -> LinearSystem:
        """The controlled system."""
        limit = _limits("system.input_max", self.input_max, len(self.B[0]))
        C = None if self.C is None else np.array(self.C)
        if self.position_states is not None:
            C = np.eye(len(self.A))[list(self.position_states)]
        A, B, D = (np.array(given) for given in (self.A, self.B, self.D))
        return LinearSystem(A, B, D, limit, self.disturbance_max, C, self.mass_kg)


def _limits(field: str, given: float | tuple[float, ...], count: int) -> Array:
    """Limits of all inputs, shape (count,), from one number for all or one each."""
    if isinstance(given, tuple):
        f.check_length(field, given, count)
    return np.broadcast_to(np.asarray(given, dtype=float), (count,)).copy()


System = Annotated[ClohessyWiltshire | Linear, *f.BY_KIND]


class Orbit(ScenarioPart):
    """The target's real orbit: near a circle of the system's mean motion, perturbed by J2 and drag.

    What is declared here bounds the difference between Hill's linear equations and the nonlinear motion;
    `polaris model-error` works it out, and the system's disturbance bound must cover it. The target must stay
    within the deviations from the circle for as long as a guarantee is to hold.
    """

    inclination_max_deg: f.Real = unit("deg", default=90.0, ge=0, le=90)
    """Largest angle between the plane of the orbit and that of the equator, at any time; a retrograde orbit
    counts from its own side. 90 covers every orbit."""
    radius_deviation_max_m: f.NonNegative = unit("m")
    """How far the target's distance from the Earth's centre may be off that of the circle."""
    radial_rate_max_m_s: f.NonNegative = unit("m/s", "Largest rate at which that distance changes.")
    rate_deviation_max: f.Real = unit("-", ge=0, le=0.1)
    """How far the frame's rate about the orbit normal may be off, as a share of it."""
    density_kg_m3: f.NonNegative = unit(
        "kg/m^3", "Density of the air at the radius of the circle; 0 for none."
    )
    scale_height_m: f.Positive = unit("m")
    """Height over which the density falls by a factor of e, the smallest that may occur."""
    ballistic_coefficient_m2_kg: f.NonNegative = unit("m^2/kg")
    """Drag coefficient times area over mass of the target."""
    ballistic_difference_max_m2_kg: f.NonNegative = unit("m^2/kg")
    """How far any other craft's may be off the target's."""
    other_acceleration_max_m_s2: f.NonNegative = unit("m/s^2", default=0.0)
    """Bound on everything else that accelerates the chaser relative to the target: errors of thrust,
    radiation pressure, plumes, higher harmonics."""


class Navigation(ScenarioPart):
    """How well the state is known: bounds on the errors of the estimate that every controller acts on.

    Within the bounds the errors may be any at any time. In Hill's frame positions and velocities have bounds,
    in other systems states.
    """

    position_error_m: f.NonNegativePerAxis = unit("m", "Per axis, or one number for all.", default=0.0)
    velocity_error_m_s: f.NonNegativePerAxis = unit("m/s", "Per axis, or one number for all.", default=0.0)
    state_error: f.WidthVector | None = unit("SI (state order)", "n numbers >= 0.", default=None)

    def build(self, system: LinearSystem) -> Array:
        """Bounds on the error of every state, shape (n,)."""
        if system.mean_motion is None:
            if np.any(self.position_error_m) or np.any(self.velocity_error_m_s):
                rule = "needs Hill's frame (system.kind = 'clohessy_wiltshire'); give state_error"
                raise ScenarioError("navigation.position_error_m", self.position_error_m, rule)
            given = (0.0,) * system.n if self.state_error is None else self.state_error
            f.check_length("navigation.state_error", given, system.n)
            return np.array(given)
        if self.state_error is not None:
            rule = "is for other systems; in Hill's frame give position_error_m and velocity_error_m_s"
            raise ScenarioError("navigation.state_error", self.state_error, rule)
        named = ("position_error_m", self.position_error_m), ("velocity_error_m_s", self.velocity_error_m_s)
        return np.concatenate([_limits(f"navigation.{name}", value, 3) for name, value in named])


class Thrusters(ScenarioPart):
    """How far what is applied may be from what is commanded, at any time, in any direction that fits."""

    magnitude_error: f.Real = unit(
        "-", "Share by which thrust may be too large or small.", default=0.0, ge=0, lt=0.5
    )
    misalignment_deg: f.Real = unit("deg", default=0.0, ge=0, le=45)
    """Angle by which the direction of the thrust may be off. Hill's frame only."""
    mass_error: f.Real = unit("-", default=0.0, ge=0, lt=0.5)
    """Share by which the mass may be more or less than `system.mass_kg`, propellant spent included."""
    impulse_bit_N_s: f.NonNegative = unit("N s", default=0.0)
    """Smallest impulse: that of a period is a multiple of it, the nearest to what is commanded. Needs sampled
    feedback. The thrust counts as constant over the period."""

    def build(self, system: LinearSystem, period: float | None) -> Errors:
        """Bounds on the errors of the inputs."""
        if self.misalignment_deg > 0 and (system.mean_motion is None or system.m != 3):
            rule = "needs Hill's frame (system.kind = 'clohessy_wiltshire')"
            raise ScenarioError("thrusters.misalignment_deg", self.misalignment_deg, rule)
        if self.impulse_bit_N_s > 0 and period is None:
            rule = "needs sampled feedback (feedback.kind = 'sampled')"
            raise ScenarioError("thrusters.impulse_bit_N_s", self.impulse_bit_N_s, rule)
        bit = 0.0 if period is None else self.impulse_bit_N_s / (2 * period)
        turned = float(np.deg2rad(self.misalignment_deg))
        return Errors.of(self.magnitude_error, turned, self.mass_error, bit, system.m)


class Chaser(ScenarioPart):
    """What is controlled has a size: it is added to every unsafe set."""

    radius_m: f.NonNegative = unit("m")
    """Radius of a ball, about the point that is navigated, that contains all of the chaser in any attitude.
    All distances that are reported are those of its surface. Facets of boxes and polytopes move out by it."""


class _Initial(ScenarioPart):
    """Base of initial sets."""

    kind: str
    center: f.Vector = unit("m, m/s (state order)", "Centre, n numbers; the reference starts here.")

    @abstractmethod
    def build(self, system: LinearSystem) -> Zonotope:
        """The set Theta, as a zonotope that encloses it."""


class InitialBox(_Initial):
    """An axis-aligned box of states."""

    kind: Literal["box"] = unit("-", "Axis-aligned box.")
    half_widths: f.WidthVector = unit("m, m/s (state order)", "Half-width per state, n numbers >= 0.")

    def build(self, system: LinearSystem) -> Zonotope:
        """The box."""
        return Zonotope.box(np.array(self.center, dtype=float), self.half_widths)


class InitialBall(_Initial):
    """Positions in one ball, the other states in another: no norm mixes m and m/s.

    It is used through an enclosing zonotope, so what is proven holds for a slightly larger set.
    """

    kind: Literal["ball"] = unit("-", "Product of a ball of positions and a ball of velocities.")
    position_radius_m: f.NonNegative = unit("m", "2-norm radius of the position about its centre.")
    velocity_radius_m_s: f.NonNegative = unit("m/s")
    """2-norm radius of all other states (the velocity, in a mechanical system)."""

    def build(self, system: LinearSystem) -> Zonotope:
        """A zonotope around the product of the balls."""
        C = system.position
        if not (np.all((C == 0) | (C == 1)) and np.all(C.sum(axis=1) == 1) and np.all(C.sum(axis=0) <= 1)):
            rule = "a ball needs a position that is a choice of states; use a box or a zonotope"
            raise ScenarioError("initial_set.kind", self.kind, rule)
        place = C.argmax(axis=1).tolist()
        rest = [i for i in range(system.n) if i not in place]
        balls = ((place, self.position_radius_m), (rest, self.velocity_radius_m_s))
        blocks = [np.eye(system.n)[:, part] @ ball_generators(len(part), r) for part, r in balls if part]
        return Zonotope(np.array(self.center, dtype=float), np.hstack(blocks))


class InitialZonotope(_Initial):
    """The set ``center + sum_i b_i generators[i]`` with every ``|b_i| <= 1``."""

    kind: Literal["zonotope"] = unit("-", "Zonotope.")
    generators: f.Matrix = unit("m, m/s (state order)", "One list of n numbers per generator.")

    def build(self, system: LinearSystem) -> Zonotope:
        """The zonotope."""
        return Zonotope(np.array(self.center, dtype=float), np.array(self.generators, dtype=float).T)


InitialSet = Annotated[InitialBox | InitialBall | InitialZonotope, *f.BY_KIND]


class Horizon(ScenarioPart):
    """How long, and in what steps."""

    duration_s: f.Positive = unit("s", "Time T covered by the reference and the schedule.")
    step_s: f.Positive = unit(
        "s",
        f"Step delta of the plan and of the schedule. Must divide duration_s; at most {f.MAX_STEPS} steps.",
    )


class ContinuousFeedback(ScenarioPart):
    """Feedback acts at every instant."""

    kind: Literal["continuous"] = unit("-", "Idealised continuous feedback.")


class SampledFeedback(ScenarioPart):
    """The flight computer's reality: the state is read and the input set once per control period."""

    kind: Literal["sampled"] = unit("-", "Zero-order hold.")
    period_s: f.Positive = unit("s", "Control period. Must divide step_s.")


Feedback = Annotated[ContinuousFeedback | SampledFeedback, *f.BY_KIND]


class Tracking(ScenarioPart):
    """The tracking controller of section III-A and the bound on its error."""

    Q: f.DiagonalOrMatrix = unit("1/unit of the state^2")
    """LQR state weight: its diagonal (n numbers) or the full matrix. Positive semidefinite."""
    R: f.DiagonalOrMatrix = unit("1/unit of the input^2")
    """LQR input weight: its diagonal (m numbers) or the full matrix. Positive definite."""
    bound: Literal["envelope", "lyapunov"] = unit("-", default="envelope")
    """How the norm of the tracking error is bounded (Lemma 1): an envelope of the matrix exponential
    (tighter), or a Lyapunov function."""
    thrust_share: f.Real = unit("-", default=1.0, gt=0, le=1)
    """Share of the thrust limits that the safety controller uses at most, its reference included. Errors of
    thrusters are proportional to what is commanded: less of it can be worth more."""
    weight: f.WordOrWeights = unit("-", default="auto")
    """Weighted norm of that bound: chosen for the closed loop, none (m and m/s in one norm, loose), or the
    diagonal of W, n numbers > 0."""


class Recoverable(ScenarioPart):
    """From where the safety controller still saves the day (Definition 1)."""

    kind: Literal["polytope", "ball", "time_varying_ball", "paper_ball"] = unit("-", default="polytope")
    """`polytope`: facets of the plan carried back in time, exact for them. `time_varying_ball`: eq. 12 with
    the clearance still ahead. `ball`: eqs. 11-12 in the weighted norm, thrust limits included. `paper_ball`:
    as printed, without thrust limits; UNSOUND, for comparison only, never a guarantee."""
    recourse: Literal["in_view", "none"] = unit("-", default="in_view")
    """`in_view`: the safe reference may be planned along the path of an experimental controller, so that the
    safety controller acts only where it must. `none`: the one of the printed Algorithm 1."""


class Planner(ScenarioPart):
    """The mixed-integer program behind the reference (section III-C)."""

    objective: Literal["margin_then_fuel", "distance", "fuel"] = unit("-", default="margin_then_fuel")
    """`margin_then_fuel`: reach extra_margin_m where there is room, then least fuel. `fuel`: least fuel.
    `distance`: eq. 19, largest clearance at any price."""
    extra_margin_m: f.NonNegative = unit("m", default=0.0)
    """Clearance wanted beyond the tracking error; room for the experimental controller."""
    thrust_reserve: f.Real = unit("-", default=0.2, ge=0, lt=1)
    """Share of the thrust limits the reference leaves to the tracker beyond what the initial set needs; room
    for the experimental controller, as extra_margin_m is."""
    solver: Literal["facets", "highs", "gurobi"] = unit("-", default="facets")
    """Who chooses the side on which to pass: `facets`, the planner's own branch and bound, whose linear
    programs HiGHS solves; or `highs` or `gurobi` on the same program with binary variables (gurobi needs the
    extra of that name)."""
    max_linear_programs: f.Whole = unit("-", default=10_000, ge=1, le=10**9)
    """Most linear programs that `facets` solves, in all stages."""
    max_nodes: f.Whole = unit("-", default=100_000, ge=1, le=10**9)
    """Most branch-and-bound nodes of `highs` or `gurobi`, in all stages."""
    time_limit_s: f.Real = unit("s", default=600.0, gt=0, le=1e6)
    """Wall time for each plan, the last resort: what it cuts short depends on the machine, and the run says
    so."""
    gap: f.Real = unit("-", "Relative optimality gap at which the search stops.", default=1e-3, ge=0, lt=1)


class Schedule(ScenarioPart):
    """How the switching schedule is chosen (Algorithm 2 and beyond)."""

    strategy: Literal["greedy", "look_ahead"] = unit("-", default="greedy")
    """`greedy`: Algorithm 2, use an experimental controller whenever it is safe now. `look_ahead`: most use
    over the whole horizon, by weight."""
    min_dwell_steps: f.Whole = unit("steps", default=1, ge=1, le=f.MAX_STEPS)
    """Fewest steps between two switches."""
    max_switches: f.Whole | None = unit(
        "-", "Most switches in the run; no cap without it.", default=None, ge=0
    )
    delta_v_price: f.NonNegative = unit("-", default=0.06)
    """Share of the horizon under an experimental controller that is given up for a velocity change as large
    as the safety controller's alone."""
    switch_price: f.NonNegative = unit("-", default=0.005)
    """Share of the horizon under an experimental controller that is given up for one switch less."""
    delta_v_max_m_s: f.Positive | None = unit("m/s", default=None)
    """Budget of velocity change until the goal, or until the end if the goal is not proven reached. What is
    returned is proven to keep it; where no such schedule is found, exit code 4, and how little was. None
    without it."""
    beam: f.Whole = unit("-", default=1, ge=1, le=1000)
    """Schedules that `look_ahead` keeps at every step for each number of switches and controller. More find
    better ones, in as much more time."""
    bound_programs: f.Whole = unit("-", default=400, ge=0, le=10**9)
    """Linear programs, about, spent on a proven bound on the time under experimental controllers over all
    schedules; 0 for none."""


class Simulation(ScenarioPart):
    """Closed-loop runs behind the metrics and figures. They illustrate; they prove nothing."""

    runs: f.Whole = unit("-", "Runs per controller.", default=100, ge=1, le=1_000_000)
    seed: f.Seed = unit("-", "Seed; the same seed and scenario give the same results.", default=0)


class ScenarioModel(f.Head):
    """A whole scenario file."""

    system: System = unit("-", "The controlled system.")
    orbit: Orbit | None = unit("-", default=None)
    """What the linear model of a spacecraft leaves out; needed by `polaris model-error`."""
    navigation: Navigation | None = unit(
        "-", "How well it knows its state; exactly without it.", default=None
    )
    thrusters: Thrusters | None = unit("-", "Errors of the thrusters; none without it.", default=None)
    chaser: Chaser | None = unit("-", "The chaser's own size; a point without it.", default=None)
    initial_set: InitialSet = unit("-", "All states it may start in (Theta).")
    horizon: Horizon = unit("-", "Time covered and its steps.")
    feedback: Feedback = unit("-", default_factory=lambda: ContinuousFeedback(kind="continuous"))
    """When the controllers act; continuous feedback without it."""
    tracking: Tracking = unit("-", "The safety controller's tracking part.")
    recoverable: Recoverable = unit("-", "Which recoverable sets.", default_factory=Recoverable)
    planner: Planner = unit("-", "How the reference is planned.", default_factory=Planner)
    goal: Goal = unit("-", "Where the reference must end.")
    obstacles: tuple[Obstacle, ...] = unit("-", "Sets to stay out of.", default=(), max_length=64)
    keep_in: tuple[KeepIn, ...] = unit("-", "Sets to stay inside.", default=(), max_length=16)
    experimental: tuple[Experimental, ...] = unit("-", min_length=1, max_length=8)
    """Experimental controllers in order of preference."""
    schedule: Schedule = unit("-", "How the switching schedule is chosen.", default_factory=Schedule)
    simulation: Simulation = unit("-", "Closed-loop runs.", default_factory=Simulation)

    def scene_parts(self) -> list[tuple[str, Obstacle | KeepIn]]:
        """Obstacles and keep-in sets with their paths in the file."""
        outside = [(f"obstacles[{i}]", part) for i, part in enumerate(self.obstacles)]
        return [*outside, *((f"keep_in[{i}]", part) for i, part in enumerate(self.keep_in))]

    def controllers(self) -> list[tuple[str, Experimental]]:
        """Experimental controllers with their paths in the file."""
        return [(f"experimental[{i}]", part) for i, part in enumerate(self.experimental)]
