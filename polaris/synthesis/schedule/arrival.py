"""The goal as a claim: when every flight is proven to be near it (docs/theory.md, Proposition 14 (a))."""

from collections.abc import Sequence
from dataclasses import astuple, dataclass, field
from functools import cached_property

import numpy as np

from ...model.system import Array
from ...model.tolerances import ROUNDING
from ..safety.continuation import HandOver, PathRows
from ..safety.end_condition import in_hills_frame
from ..safety.get_safety import Safety
from ..safety.goal_rows import distance, goal_rows, velocity_times
from ..tracker.long_flight import Inputs
from ..tracker.storage import Weights
from ..tracker.tracking import Tracking
from .rules import CHECKED
from .spending import FlightSpending, Spell, commanded, tracked

GOAL_SHARE = 0.05  # share of the goal's size within which it counts as reached, where no length is given
SPARE = 0.02
"""Share by which claims are loosened where a craft is not ideal: a checker merges sets, and bounds what falls
with time, in its own way."""


@dataclass(frozen=True)
class GoalDistance:
    """Distance from the goal, S flying from T on.

    Lengths are the goal's own: each of its conditions is scaled so that the distance is in metres
    (`polaris.planning.goals.GoalConditions`). A velocity counts as the length that it makes in
    `velocity_time`.
    """

    reached: bool | str
    """True if every admissible flight meets the goal's conditions at `by`, within the tolerance less
    `CHECKED`; else ``"not_proven"``, or False if not even the middle of the tube ever meets them."""
    by: float | None  # when [s]
    distance: float  # bound on how far a flight may be from the goal then, or at its best if not proven [m]
    tolerance: float
    """Largest distance that counts as reached [m]: as given, else `GOAL_SHARE` of the goal's size, or the
    tightening by S at a goal, if that is more."""
    drift: float | None  # bound on the secular drift per orbit at that time [m]; None outside Hill's frame
    velocity_time: float | None
    """Time [s] in which a velocity makes the length that it counts as: tolerance by velocity tolerance, or
    the lesser of the goal's own (1 / rate) and a quarter of the horizon; None if the goal asks nothing of
    velocities alone."""
    node: int  # number of periods after T until then


@dataclass(frozen=True)
class Arrival(GoalDistance):
    """Proof of the goal, and bound on the spending until then."""

    delta_v: float  # velocity change until then, at most [m/s]


@dataclass(frozen=True)
class Spending:
    """Bounds on the velocity change of a flight."""

    schedule: float  # until T [m/s]
    goal: float  # until the node of `GoalDistance` [m/s]
    settled: float | None  # until the error at the hand-over has decayed [m/s]; None where no bound is given
    weights: Sequence[Weights | None]  # for each step, those of the tail included


@dataclass(frozen=True)
class Upkeep:
    """Cost of flying on under S after T, once the error at the hand-over has decayed."""

    settled: float  # from when on [s]
    delta_v: float  # velocity change until then, at most [m/s]
    rate: float  # velocity change per second from then on, at most [m/s^2]
    per_orbit: float | None  # the same per orbit [m/s]; None outside Hill's frame
    tank: float | None  # velocity change that there is propellant for [m/s], if it is known
    lasts: float | None  # until when the tank certainly lasts [s]; None if it is not known, or for ever

    def to_dict(self) -> dict[str, float | None]:
        """Return the claim of a run, by key."""
        names = "settled_s", "until_settled_m_s", "rate_m_s2", "per_orbit_m_s", "tank_m_s", "lasts_s"
        return dict(zip(names, astuple(self), strict=True))


def slack_factor(tracking: Tracking) -> float:
    """Share by which bounds are larger than found."""
    return ROUNDING if tracking.system.ideal else SPARE


@dataclass(frozen=True, eq=False)
class Nearness:
    """Distance of flights under S from the goal of its problem, and the tolerance to reach it."""

    safety: Safety
    faults: bool = False  # True if a fault that is isolated late may occur, where any is declared

    @cached_property
    def rows(self) -> tuple[Array, Array]:
        """Rows of the goal, and their sides."""
        return goal_rows(self.safety.problem)

    @cached_property
    def goal_rows(self) -> PathRows:
        """Rows of the goal along the path."""
        return PathRows(self.safety.clearance, self.rows[0], self.faults, between=False)

    @cached_property
    def commands(self) -> PathRows:
        """S's commands along the path."""
        return PathRows(self.safety.clearance, self.safety.tracking.commands, self.faults)

    @cached_property
    def tolerance(self) -> float:
        """Largest distance that counts as reached [m]: as given, or see `Arrival`."""
        problem, tracking, rows = self.safety.problem, self.safety.tracking, self.rows[0]
        if problem.goal_tolerance is not None:
            return problem.goal_tolerance
        tightening = (
            self.goal_rows.table.settled_tightening
            + self.safety.clearance.scheduled(rows, between=False)[-1, -1]
        )
        tightening = tightening + np.abs(rows) @ tracking.system.state_offset_at_nodes
        hold = (
            float(np.max(tightening, initial=0.0)) * (1 + slack_factor(tracking)) * (1 + GOAL_SHARE)
        )  # the jump apart
        return max(GOAL_SHARE * problem.goal.conditions.scale, hold)

    def distance(self, states: Array, tightening: Array, size: float = ROUNDING) -> Array:
        """Return the distance of flights about states (nodes, n) under tightenings of the rows [m]."""
        rows, sides = self.rows
        rounded = size * (np.abs(states) @ np.abs(rows).T + np.abs(sides))
        excess = states @ rows.T - sides + tightening + rounded
        return distance(self.safety.problem.goal.conditions, excess)


@dataclass(frozen=True, eq=False)
class Tail(Nearness):
    """S from T on, along the coasting tail."""

    starts: Sequence[HandOver] = ()  # sets that each hold all errors as S takes over for good, one at T last
    spells: list[Spell] = field(default_factory=list)  # steps that S has flown, as far as they are asked for

    @property
    def T(self) -> int:
        """Node at T."""
        return self.safety.problem.K * self.safety.clearance.q

    def steps_until(self, nodes: int) -> list[Spell]:
        """Return the steps of at least so many periods."""
        s, clearance = self.safety.controller, self.safety.clearance
        while len(self.spells) * clearance.q < nodes:
            before = self.spells[-1].tube.end if self.spells else clearance.after_jump(self.starts[-1].states)
            k = self.safety.problem.K + len(self.spells)
            self.spells.append(Spell.from_tube(s, s.propagate(before, k), k))
        return self.spells

    def tightenings(self, along: PathRows, nodes: int) -> Array:
        """Return the tightenings of rows at so many nodes from T on, shape (nodes, r).

        The disturbance is followed along every row from the hand-over on: the set at T encloses what it has
        done until then by generators, which no row sees quite so small. Where errors grow with commands, the
        sets that S flies may tighten less than those of any hand-over, within the settling horizon.
        """
        tracking, rows = self.safety.tracking, along.rows
        bounds = [along.tightenings(start, self.T, self.T + nodes)[0] for start in self.starts]
        tightening: Array = np.min(bounds, axis=0)
        tightening = tightening + SPARE * np.abs(tightening) * (not tracking.system.ideal)
        near = min(nodes - 1, tracking.settling)
        if tracking.feedback_bound is None:
            return tightening
        offset = np.abs(rows) @ tracking.system.state_offset_at_nodes
        parts = [spell.tube.nodes.support(rows)[:-1] for spell in self.steps_until(near)]
        supports = np.concatenate([tightening[:0], *parts])[:near]
        supports = supports * (1 + ROUNDING) + SPARE * np.abs(supports) + offset
        return np.concatenate([np.minimum(tightening[:near], supports), tightening[near:]])

    def correcting(self, nodes: int) -> float:
        """Bound S's velocity change over so many periods after T, each for itself [m/s]."""
        tracking, system = self.safety.tracking, self.safety.problem.system
        delta_v = FlightSpending(self.steps_until(nodes), nodes).summed(nodes) if nodes else 0.0
        delta_v *= tracking.flow.h / system.mass
        return min(tracked(self.commands, self.starts, self.T, self.T + nodes), delta_v) * (
            1 + slack_factor(tracking)
        )

    def spending(self, before: Sequence[Spell], approach: GoalDistance) -> Spending:
        """Bound the velocity change of the whole flight, from its steps `before` T."""
        tracking, system, T = self.safety.tracking, self.safety.problem.system, self.T
        nodes = [approach.node] * (approach.reached is True)
        nodes += [self.settling] * (self.max_commands is not None)
        last = max(nodes, default=0)
        flight = FlightSpending([*before, *self.steps_until(last)], T + last)
        scale = tracking.flow.h / system.mass
        until = flight.thrust_bound(T) * scale * (1 + ROUNDING)

        def at(node: int) -> float:
            sum_bound = until * (1 + slack_factor(tracking)) + self.correcting(node)
            if node not in nodes:
                return sum_bound * (1 + ROUNDING)
            joint_bound = flight.thrust_bound(T + node) * scale * (1 + slack_factor(tracking))
            return min(sum_bound, joint_bound) * (1 + ROUNDING)

        settled = None if self.max_commands is None else at(self.settling)
        return Spending(until, at(approach.node), settled, flight.weights)

    def drift(self, x: Array, node: int) -> float | None:
        """Bound the along-track drift per orbit, ``6 pi |2 x + v_y / eta|``, at a node after T [m]."""
        system = self.safety.problem.system
        if not in_hills_frame(system) or system.mean_motion is None:
            return None
        row = np.array([[2.0, 0.0, 0.0, 0.0, 1 / system.mean_motion, 0.0]])
        both = PathRows(self.safety.clearance, np.vstack([row, -row]), faults=False, between=False)
        size = ROUNDING * (np.abs(both.rows) @ np.abs(x))
        largest = np.max(both.rows @ x + size + self.tightenings(both, node + 1)[-1])
        return float(6 * np.pi * largest * (1 + ROUNDING))

    def approach(self) -> GoalDistance:
        """Return the proven distance to the goal over the nodes from T to the end of the coasting tail."""
        problem, tracking, reference = self.safety.problem, self.safety.tracking, self.safety.reference
        seconds = velocity_times(problem, self.rows[0])
        cells = reference.fine(tracking.feedback.nodes_per_cell)[problem.K :]
        states = np.concatenate([reference.chi[problem.K][None], *(cell[1:] for cell in cells)])
        distances = self.distance(states, self.tightenings(self.goal_rows, len(states)))
        within = np.flatnonzero(distances * (1 + CHECKED) <= self.tolerance)
        node = int(within[0]) if len(within) else int(np.argmin(distances))
        middle = self.goal_rows.table.carried[: len(states)] @ tracking.loop_state(self.starts[-1].states).c
        middle = np.pad(middle, ((0, len(states) - len(middle)), (0, 0)))  # all that the loop remembers
        near = bool(np.min(self.distance(states, middle, 0.0)) <= self.tolerance)
        return GoalDistance(
            reached=True if len(within) else "not_proven" if near else False,
            by=problem.K * problem.delta + node * tracking.flow.h if len(within) else None,
            distance=float(distances[node]),
            tolerance=self.tolerance,
            drift=self.drift(states[node], node),
            velocity_time=float(seconds.max()) if np.any(seconds > 0) else None,
            node=node,
        )

    def long_flight(self, nodes: int, most: Array) -> tuple[float, float]:
        """Bound S's thrust from so many nodes after T on, on average and once besides [N]."""
        tracking, system, clearance = self.safety.tracking, self.safety.problem.system, self.safety.clearance
        alone, rounding = float(system.spending(most).sum()), self.safety.reference.rounding.max(axis=0)
        limits = most, self.commanded_before(nodes)
        closed = tracking.tightening.closed
        storage = Inputs.from_loop(closed, system, limits, tracking.step_errors[-1], rounding).storage()
        if storage is None:
            return alone, 0.0
        rows, cost = storage
        states = PathRows(clearance, np.vstack([rows, -rows]), self.faults)
        tightenings = [
            states.tightenings(start, self.T + nodes - 1, self.T + nodes)[1, -1] for start in self.starts
        ]
        size = np.min(tightenings, axis=0).reshape(2, -1).max(axis=0)
        mean = cost + float(np.sum(system.weights * system.on_time.bit))
        mean, once = (system.longest * bound for bound in (mean, float(size @ size) / 2))
        return (mean, once) if mean < alone else (alone, 0.0)

    def commanded_before(self, nodes: int) -> Array:
        """Bound S's commands from so many nodes after T on, and those before that errors remember, (m,)."""
        tracking = self.safety.tracking
        lag, u_max = tracking.lag, self.safety.problem.system.u_max
        if lag >= nodes:
            return u_max
        first = self.T + nodes - lag - 1
        bound = commanded(self.commands, self.starts, first, self.T + nodes).max(axis=(0, 1))
        return np.asarray(np.minimum(bound, u_max))

    def estimate(self, nodes: int) -> Array:
        """Bound the errors of estimates at every node from so many after T on, by state, shape (n,)."""
        tracking, rows = self.safety.tracking, self.safety.tracking.estimate_error_rows
        both = PathRows(self.safety.clearance, np.vstack([rows, -rows]), self.faults, between=False)
        bounds = [both.tightenings(start, self.T + nodes - 1, self.T + nodes)[1, -1] for start in self.starts]
        return np.asarray(
            np.min(bounds, axis=0).reshape(2, -1).max(axis=0)
            + tracking.unremembered(self.commanded_before(nodes))
        )

    @property
    def settling(self) -> int:
        """Number of periods after T until the error at the hand-over has decayed."""
        return self.safety.tracking.settling + 2

    @cached_property
    def max_commands(self) -> Array | None:
        """Bound on S's commands from then on (m,) [N].

        None if S need not track a coasting reference, or is not proven to keep within its thrust.
        """
        end = self.T + self.settling
        if self.safety.reference.cells * self.safety.clearance.q < end:
            return None
        bound = commanded(self.commands, self.starts, self.T, end)[1, -1]
        return bound if np.all(bound <= self.safety.problem.system.u_max) else None

    def upkeep(self, spending: Spending) -> Upkeep | None:
        """Bound S's velocity change for all time (Proposition 14 (d)); None where `max_commands` is None."""
        problem, tracking, system = self.safety.problem, self.safety.tracking, self.safety.problem.system
        tops, nodes, delta_v = self.max_commands, self.settling, spending.schedule
        if tops is None or spending.settled is None:
            return None
        thrust = self.long_flight(nodes, tops)
        rate, once = (part / system.mass * (1 + slack_factor(tracking)) for part in thrust)
        settled, h = (self.T + nodes) * tracking.flow.h, tracking.flow.h
        extra = float(system.spending(tops).sum()) / system.mass * h * bool(system.timing.pulse_thrust)
        extra = extra * (1 + slack_factor(tracking)) + once * h  # a pulse ends before its period does
        until = spending.settled + extra
        before = system.carried_impulse / system.mass
        orbit = None if system.mean_motion is None else rate * 2 * np.pi / system.mean_motion + extra + before
        tank, lasts = problem.tank, None
        if tank is not None and rate > 0:
            usable = tank / (1 + CHECKED)
            early = problem.K * problem.delta if usable >= delta_v else 0.0
            lasts = settled + (usable - until) / rate if usable >= until else early
        return Upkeep(settled, until, rate, orbit, tank, lasts)
