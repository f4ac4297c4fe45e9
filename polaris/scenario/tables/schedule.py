"""The scenario file's models: one class per table, one field per key, units in the names.

These models know the rules of a single field. Rules that join several fields (shapes against the
system, steps that divide the horizon, the start inside an obstacle) are in `polaris.scenario.rules`.
States are written in the order of the system's state vector; in Hill's frame that is
``[r_x, r_y, r_z, v_x, v_y, v_z]`` in m and m/s (x radial, y along-track, z cross-track).
"""

from abc import abstractmethod
from dataclasses import replace
from typing import Annotated, Literal

import numpy as np

from reach.sets.ellipsoid import ball_generators
from reach.sets.zonotope import Zonotope

from ...model import keys as f
from ...model.errors import ScenarioError
from ...model.hill import clohessy_wiltshire
from ...model.system import LinearSystem
from .errors import AbortTable, Chaser, Tank, ThrustersTable, TimingTable
from .faults import Fault
from .fields import BY_KIND, Head, ScenarioPart, per_axis, unit
from .goals import Goal
from .methods import PlannerTable, RecoverableTable, ScheduleTable, TrackingTable
from .navigation import Navigation
from .orbit import Orbit
from .scene import Experimental, KeepIn, Obstacle


class ClohessyWiltshire(ScenarioPart):
    """A chaser near a target on a circular orbit, in Hill's frame (eq. 1)."""

    kind: Literal["clohessy_wiltshire"] = unit("-", "Clohessy-Wiltshire dynamics, six states.")
    mean_motion_rad_s: f.Real = unit("rad/s", gt=0, le=0.01)
    """Orbital rate eta of the target."""
    mass_kg: f.Real = unit("kg", "Mass of the chaser.", ge=1e-3, le=1e7)
    thrust_max_N: f.PositivePerAxis = unit("N")
    """Thrust limit along each axis."""
    disturbance_max_m_s2: f.NonNegative = unit("m/s^2", default=0.0)
    """Bound on the 2-norm of the disturbance, arbitrary in time."""
    bias_max_m_s2: f.WidthVector | None = unit("m/s^2", default=None, min_length=3, max_length=3)
    """Bounds per axis on an additional acceleration, constant in a flight, such as differential drag."""

    def build(self) -> LinearSystem:
        """Return the controlled system."""
        limit = per_axis("system.thrust_max_N", self.thrust_max_N, 3)
        plain = clohessy_wiltshire(self.mean_motion_rad_s, self.mass_kg, limit, self.disturbance_max_m_s2)
        return replace(plain, bias_max=None if (bias := self.bias_max_m_s2) is None else np.array(bias))


class Linear(ScenarioPart):
    """Any system x' = A x + B u + D w."""

    kind: Literal["linear"] = unit("-", "State-space matrices given as arrays.")
    A: f.Matrix = unit("SI", "Matrix of n rows.")
    B: f.Matrix = unit("SI", "Matrix of n rows.")
    D: f.Matrix = unit("SI", "Matrix of n rows.")
    input_max: f.PositivePerAxis = unit("input")
    """Limit of each input."""
    disturbance_max: f.NonNegative = unit("of w", default=0.0)
    """Bound on the 2-norm of w."""
    bias_max: f.WidthVector | None = unit("of w", default=None)
    """Bounds on a constant added to w, one per column of D."""
    position_states: tuple[f.Index, ...] | None = unit("-", default=None, min_length=1, max_length=3)
    """States that are the position [m], counted from 0; by default the first half."""
    C: f.Matrix | None = unit("-", default=None)
    """Position matrix, d by n, instead of position_states."""
    mass_kg: f.Real = unit("kg", default=1.0, ge=1e-3, le=1e7)
    """Delta-v is the integral of |u| over this mass; 1 if inputs are accelerations."""

    def build(self) -> LinearSystem:
        """Return the controlled system."""
        limit = per_axis("system.input_max", self.input_max, len(self.B[0]))
        C = None if self.C is None else np.array(self.C)
        if self.position_states is not None:
            C = np.eye(len(self.A))[list(self.position_states)]
        A, B, D = (np.array(matrix) for matrix in (self.A, self.B, self.D))
        arguments = A, B, D, limit, self.disturbance_max, C, self.mass_kg
        return LinearSystem(*arguments, bias_max=None if self.bias_max is None else np.array(self.bias_max))


System = Annotated[ClohessyWiltshire | Linear, *BY_KIND]


class _Initial(ScenarioPart):
    """Base of initial sets."""

    kind: str
    center: f.Vector = unit("m, m/s", "Centre, n numbers, where the reference starts.")

    @abstractmethod
    def build(self, system: LinearSystem) -> Zonotope:
        """Return the set Theta, as a zonotope that encloses it."""


class InitialBox(_Initial):
    """An axis-aligned box of states."""

    kind: Literal["box"] = unit("-", "Axis-aligned box.")
    half_widths: f.WidthVector = unit("m, m/s", "Half-widths.")

    def build(self, system: LinearSystem) -> Zonotope:
        """Return the box."""
        return Zonotope.box(np.array(self.center, dtype=float), self.half_widths)


class InitialBall(_Initial):
    """A ball of positions and a ball of the other states, used through an enclosing zonotope."""

    kind: Literal["ball"] = unit("-", "Product of a ball of positions and a ball of velocities.")
    position_radius_m: f.NonNegative = unit("m", "Radius of the position.")
    velocity_radius_m_s: f.NonNegative = unit("m/s")
    """Radius of the velocity."""

    def build(self, system: LinearSystem) -> Zonotope:
        """Return a zonotope around the product of the balls."""
        C = system.position
        if not (np.all((C == 0) | (C == 1)) and np.all(C.sum(axis=1) == 1) and np.all(C.sum(axis=0) <= 1)):
            rule = "must be 'box' or 'zonotope', as the position is not a choice of states"
            raise ScenarioError("initial_set.kind", self.kind, rule)
        place = C.argmax(axis=1).tolist()
        others = [i for i in range(system.n) if i not in place]
        balls = ((place, self.position_radius_m), (others, self.velocity_radius_m_s))
        blocks = [np.eye(system.n)[:, part] @ ball_generators(len(part), r) for part, r in balls if part]
        return Zonotope(np.array(self.center, dtype=float), np.hstack(blocks))


class InitialZonotope(_Initial):
    """The set ``center + sum_i b_i generators[i]`` with every ``|b_i| <= 1``."""

    kind: Literal["zonotope"] = unit("-", "Zonotope.")
    generators: f.Matrix = unit("m, m/s", "One list of n numbers per generator.")

    def build(self, system: LinearSystem) -> Zonotope:
        """Return the zonotope."""
        return Zonotope(np.array(self.center, dtype=float), np.array(self.generators, dtype=float).T)


InitialSet = Annotated[InitialBox | InitialBall | InitialZonotope, *BY_KIND]


class Horizon(ScenarioPart):
    """Length and steps of the schedule."""

    duration_s: f.Positive = unit("s", "Time T.")
    step_s: f.Positive = unit("s", "Step delta, which divides duration_s.")


class FeedbackTable(ScenarioPart):
    """Clock of the flight computer: every period the state is read, and the input set and held."""

    GONE = {"kind": "is gone, as all feedback is sampled: write period_s alone, or leave out the table"}

    period_s: f.Positive | None = unit("s", default=None)
    """Control period, which divides step_s; by default about a quarter of the fastest closed-loop time
    constant."""


class SimulationTable(ScenarioPart):
    """Simulated closed-loop runs of metrics and figures. They prove nothing."""

    runs: f.Whole = unit("-", "Runs per controller.", default=100, ge=1, le=1_000_000)
    seed: f.Seed = unit("-", "Seed.", default=0)


class ScenarioModel(Head):
    """A whole scenario file."""

    system: System = unit("-", "The system.")
    orbit: Orbit | None = unit("-", default=None)
    """Bounds on the target's real orbit, for `polaris model-error`."""
    navigation: Navigation | None = unit("-", "Errors of the state estimate; none by default.", default=None)
    thrusters: ThrustersTable | None = unit("-", "Errors of the thrusters; none by default.", default=None)
    timing: TimingTable | None = unit("-", "Delay of commands; none by default.", default=None)
    faults: tuple[Fault, ...] = unit("-", "Faults to survive.", default=(), max_length=8)
    chaser: Chaser | None = unit("-", "Size of the chaser; a point by default.", default=None)
    tank: Tank | None = unit("-", "Propellant; not counted by default.", default=None)
    abort: AbortTable | None = unit("-", "Passive and powered aborts.", default=None)
    initial_set: InitialSet = unit("-")
    """All possible initial states (Theta)."""
    horizon: Horizon = unit("-", "Time covered and its steps.")
    feedback: FeedbackTable = unit("-", "Control period.", default_factory=FeedbackTable)
    tracking: TrackingTable = unit("-", "Tracking feedback of the safety controller.")
    recoverable: RecoverableTable = unit("-", "Recoverable sets.", default_factory=RecoverableTable)
    planner: PlannerTable = unit("-", "Planner of the reference.", default_factory=PlannerTable)
    goal: Goal = unit("-", "Goal of the reference.")
    obstacles: tuple[Obstacle, ...] = unit("-", "Sets to stay out of.", default=(), max_length=64)
    keep_in: tuple[KeepIn, ...] = unit("-", "Sets to stay inside.", default=(), max_length=16)
    experimental: tuple[Experimental, ...] = unit("-", min_length=1, max_length=8)
    """Experimental controllers in order of preference."""
    schedule: ScheduleTable = unit("-", "Choice of the switching schedule.", default_factory=ScheduleTable)
    simulation: SimulationTable = unit("-", "Closed-loop runs.", default_factory=SimulationTable)

    def scene_parts(self) -> list[tuple[str, Obstacle | KeepIn]]:
        """Obstacles and keep-in sets with their paths in the file."""
        keep_out = [(f"obstacles[{i}]", part) for i, part in enumerate(self.obstacles)]
        return [*keep_out, *((f"keep_in[{i}]", part) for i, part in enumerate(self.keep_in))]

    def controllers(self) -> list[tuple[str, Experimental]]:
        """Experimental controllers with their paths in the file."""
        return [(f"experimental[{i}]", part) for i, part in enumerate(self.experimental)]
