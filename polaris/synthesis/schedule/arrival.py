"""The goal as a claim: when every flight is proven to be near it (docs/theory.md, Proposition 14 (a))."""

from dataclasses import astuple, dataclass

import numpy as np

from reach.sets.zonotope import Zonotope

from ...model.system import Array
from ...model.tolerances import ROUNDING
from ..safety.carried_rows import CarriedRows
from ..safety.demand import command_noise
from ..safety.end_condition import in_hills_frame
from ..safety.get_safety import Safety
from ..safety.goal_rows import distance, goal_rows, velocity_times
from ..tracker.tracking import Tracking
from .rules import CHECKED
from .spending import Spell, spent

GOAL_SHARE = 0.05  # share of the goal's size within which it counts as reached, where no length is given
SPARE = 0.02
"""Share by which claims are loosened where errors of thrusters grow with commands: a checker merges sets, and
bounds what falls with time, in its own way."""


@dataclass(frozen=True)
class Arrival:
    """What is proven of the goal, S flying from T on.

    Lengths are the goal's own: each of its conditions is scaled so that what is missing is in metres
    (`polaris.planning.goals.GoalConditions`). A velocity counts as the length that it makes in
    `velocity_time`.
    """

    reached: bool | str
    """True if every admissible flight meets the goal's conditions at `by`, within the tolerance less
    `CHECKED`; else ``"not_proven"``, or False if not even the middle of the tube ever meets them."""
    by: float | None  # when [s]
    distance: float  # bound on how far a flight may be from the goal then, or at its best if not proven [m]
    tolerance: float
    """What counts as reached [m]: as given, else `GOAL_SHARE` of the goal's size, or what S needs to hold a
    goal, if that is more."""
    drift: float | None  # bound on the secular drift per orbit at that time [m]; None outside Hill's frame
    delta_v: float  # velocity change until then, at most [m/s]
    velocity_time: float | None = None
    """Time [s] in which a velocity makes the length that it counts as: tolerance by velocity tolerance, or
    the lesser of the goal's own (1 / rate) and a quarter of the horizon; None if the goal asks nothing of
    velocities alone."""


@dataclass(frozen=True)
class Upkeep:
    """What S spends for as long as it flies on after T, once it has forgotten what it took over."""

    settled: float  # from when on [s]
    spent: float  # velocity change until then, at most [m/s]
    rate: float  # velocity change per second from then on, at most [m/s^2]
    per_orbit: float | None  # the same per orbit [m/s]; None outside Hill's frame
    tank: float | None  # velocity change that there is propellant for [m/s], if it is known
    lasts: float | None  # until when the tank certainly lasts [s]; None if it is not known, or for ever

    def told(self) -> dict[str, float | None]:
        """What a run claims of it."""
        names = "settled_s", "until_settled_m_s", "rate_m_s2", "per_orbit_m_s", "tank_m_s", "lasts_s"
        return dict(zip(names, astuple(self), strict=True))


Held = tuple[tuple[Zonotope, int], ...]
"""Sets that each hold all errors, where S takes over for good and at T, with how many nodes it is until T."""


class After:
    """S along the tail from the errors at T on, step by step as far as it is asked for."""

    def __init__(self, safety: Safety, final: Zonotope) -> None:
        self.safety, self.reached, self.spells = safety, safety.clearance.after_jump(final), list[Spell]()

    def until(self, nodes: int) -> list[Spell]:
        """The steps of at least so many periods."""
        s, q = self.safety.controller, self.safety.clearance.q
        while len(self.spells) * q < nodes:
            k = self.safety.problem.K + len(self.spells)
            tube = s.fly(self.reached, k)
            self.spells.append(Spell.of(s, tube, k))
            self.reached = tube.end
        return self.spells

    def along(self, rows: Array, nodes: int) -> Array:
        """What errors need along rows at the nodes for as long as S remembers, inf later, (nodes, r)."""
        found = np.full((nodes, len(rows)), np.inf)
        near = min(nodes - 1, self.safety.tracking.memory)
        parts = [spell.tube.nodes[:-1] for spell in self.until(near)]
        tops = [z.c @ rows.T + np.abs(rows @ z.G).sum(axis=-1) for z in parts]
        found[:near] = np.concatenate([np.zeros((0, len(rows))), *tops])[:near] * (1 + ROUNDING)
        return found


def arrival(safety: Safety, held: Held, taken: float) -> Arrival:
    """What is proven of the goal at the nodes from T on, under S, until the end of the coasting tail.

    `taken` bounds the velocity change [m/s] until T.
    """
    problem, tracking, reference = safety.problem, safety.tracking, safety.reference
    goal, K, h = problem.goal.conditions, problem.K, tracking.flow.h
    rows, sides = goal_rows(problem)
    seconds = velocity_times(problem, rows)
    cells = reference.fine(tracking.feedback.nodes_per_cell)[K:]
    states = np.concatenate([reference.chi[K][None], *(cell[1:] for cell in cells)])
    after = After(safety, held[-1][0])
    need, centre = _needs(safety, held, rows, len(states), after)
    beyond = states @ rows.T - sides
    size = ROUNDING * (np.abs(states) @ np.abs(rows).T + np.abs(sides))
    most = distance(goal, beyond + need + size)
    tolerance = tolerated(safety, rows)
    within = np.flatnonzero(most * (1 + CHECKED) <= tolerance)
    best = int(within[0]) if len(within) else int(np.argmin(most))
    near = bool(np.min(distance(goal, beyond + centre)) <= tolerance)
    return Arrival(
        reached=True if len(within) else "not_proven" if near else False,
        by=K * problem.delta + best * h if len(within) else None,
        distance=float(most[best]),
        tolerance=tolerance,
        drift=_drift(safety, held, states[best], best, after),
        delta_v=(taken * (1 + spare(tracking)) + _correcting(safety, held, best, after)) * (1 + ROUNDING),
        velocity_time=float(seconds.max()) if np.any(seconds > 0) else None,
    )


def tolerated(safety: Safety, rows: Array, failing: bool = False) -> float:
    """What counts as reached [m], by the rows: as given, or see `Arrival`; if `failing`, with a fault."""
    problem, tracking = safety.problem, safety.tracking
    if problem.goal_tolerance is not None:
        return problem.goal_tolerance
    settled = tracking.settled(rows)
    need = settled + safety.clearance.scheduled(rows)[-1, -1]
    need = need + np.abs(rows) @ tracking.system.displaced_at_nodes + tracking.upset(rows)[-1] * failing
    hold = float(np.max(need, initial=0.0)) * (1 + spare(tracking)) * (1 + GOAL_SHARE)  # the jump apart
    return max(GOAL_SHARE * problem.goal.conditions.scale, hold)


def _needs(
    safety: Safety, held: Held, rows: Array, nodes: int, after: After | None = None
) -> tuple[Array, Array]:
    """What errors need along rows at so many nodes from T on, and what their middle does, shapes (nodes, r).

    The disturbance is followed along every row from the hand-over on: the set at T encloses what it has done
    until then by generators, which no row sees quite so small. Where errors grow with commands, those of
    S `after` T may need less than those that any hand-over allows.
    """
    tracking = safety.tracking
    carried, handed = tracking.whole(rows) @ tracking.whole_transitions, tracking.handed(rows)[-1]
    last = len(carried) - 1
    pushed, left = tracking.responses(rows, tracking.profile), _left(tracking, rows)
    found, centre = [], np.zeros((nodes, len(rows)))
    for z, since in held:
        z = tracking.whole_state(z)
        lag = since + np.arange(nodes)
        near, gone, far = np.minimum(lag, last), (lag > last)[:, None], (lag > tracking.long)[:, None]
        here = carried[min(since, last) :]
        centre = np.where(gone, 0.0, (here @ z.c)[near - min(since, last)])
        spread = np.abs(here @ z.G).sum(axis=-1)[near - min(since, last)]
        others = z.extent[tracking.system.n :]
        once = left * float(tracking.error(z).norm_bound(tracking.W)) + handed @ others + pushed[-1]
        forgotten = np.where(far, long_after(tracking, rows, z), once)
        found.append(np.where(gone, forgotten, centre + spread + pushed[near]))
    away = np.abs(rows) @ tracking.system.displaced_at_nodes
    need = np.min(found, axis=0) + safety.clearance.tail_need(rows, nodes) + away
    need = need + spare(tracking) * np.abs(need)
    if after is not None and tracking.profile is not None:
        flown = after.along(rows, nodes)
        need = np.minimum(need, flown + spare(tracking) * np.abs(flown) + away)
    return need, centre


def _left(tracking: Tracking, rows: Array) -> Array:
    """Return the rest of a unit of error along rows beyond the memory, shape (r,)."""
    return np.asarray(np.linalg.norm(rows @ tracking.W_inverse, axis=1) * tracking.decay[-1])


def long_after(tracking: Tracking, rows: Array, taken: Zonotope) -> Array:
    """Bound rows of errors `Tracking.long` after S took over a set of them, faults apart, shape (r,)."""
    once = float(tracking.error(taken).norm_bound(tracking.W))
    once *= 1.0 if tracking.profile is None else tracking.decay[-1]
    return np.asarray(_left(tracking, rows) * once + tracking.settled(rows))


def spare(tracking: Tracking) -> float:
    """Share by which bounds are larger than found."""
    return ROUNDING if tracking.profile is None else SPARE


def _commanded(safety: Safety, held: Held, nodes: int) -> Array:
    """Bound on S's feedback at so many nodes after T, faults apart, shape (nodes + 1, m)."""
    tracking, K = safety.tracking, safety.problem.K
    table, ages = CarriedRows(tracking, tracking.commands, failing=False), np.arange(nodes + 1)
    need = np.min([table.tube(z).at(since + ages) for z, since in held], axis=0)
    need = need + safety.clearance.tail_need(table.rows, nodes + 1)
    return np.asarray(need.reshape(nodes + 1, 2, -1).max(axis=1) + command_noise(tracking, K + 1, K)[K])


def _correcting(safety: Safety, held: Held, nodes: int, after: After) -> float:
    """Bound on S's velocity change over so many periods after T [m/s]; the reference coasts."""
    tracking, system = safety.tracking, safety.problem.system
    at = system.spent(np.minimum(_commanded(safety, held, nodes), system.u_max)).sum(axis=1)
    apart = float(np.maximum(at[:-1], at[1:]).sum()) * (1 + spare(tracking))
    flown = spent(after.until(nodes), nodes) * (1 + spare(tracking))
    return min(apart, flown) * tracking.flow.h / system.mass


def upkeep(safety: Safety, held: Held, taken: float) -> Upkeep | None:
    """Bound S's velocity change for all time, from that until T (Proposition 14 (d)).

    None if S need not track a coasting reference, or is not proven to keep within its thrust.
    """
    problem, tracking, system = safety.problem, safety.tracking, safety.problem.system
    nodes = tracking.memory + 2
    if safety.reference.cells * safety.clearance.q < problem.K * safety.clearance.q + nodes:
        return None
    most = _commanded(safety, held, nodes)[-1]
    if not np.all(most <= system.u_max):
        return None
    T = problem.K * problem.delta
    rate = float(system.spent(most).sum()) / system.mass * (1 + spare(tracking))
    settled = T + nodes * tracking.flow.h
    ahead = rate * tracking.flow.h * bool(system.timing.fired)  # a pulse ends before its period does
    until = taken * (1 + spare(tracking)) + _correcting(safety, held, nodes, After(safety, held[-1][0]))
    until = until * (1 + ROUNDING) + ahead
    before = system.thrusters.made(system.m * system.timing.carried) / system.mass  # left from before
    orbit = None if system.mean_motion is None else rate * 2 * np.pi / system.mean_motion + ahead + before
    tank, lasts = problem.tank, None
    if tank is not None and rate > 0:
        usable = tank / (1 + CHECKED)
        lasts = settled + (usable - until) / rate if usable >= until else T if usable >= taken else 0.0
    return Upkeep(settled, until, rate, orbit, tank, lasts)


def _drift(safety: Safety, held: Held, x: Array, node: int, after: After) -> float | None:
    """Bound on the along-track drift per orbit, ``6 pi |2 x + v_y / eta|``, at a node after T [m]."""
    system = safety.problem.system
    if not in_hills_frame(system) or system.mean_motion is None:
        return None
    row = np.array([[2.0, 0.0, 0.0, 0.0, 1 / system.mean_motion, 0.0]])
    both = np.vstack([row, -row])
    need = _needs(safety, held, both, node + 1, after)[0][-1]
    size = ROUNDING * (np.abs(both) @ np.abs(x))
    return float(6 * np.pi * np.max(both @ x + size + need) * (1 + ROUNDING))
