"""Flights of a mission from end to end: where one leg is left the next one begins, from the same states."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..model.system import Array
from ..synthesis.controllers.controllers import construct_s
from ..synthesis.schedule.schedule import Schedule
from .delayed import Predicting, flies
from .disturbances import adjoint_worst_case
from .run_metrics import Runs, evaluate
from .simulate import flown_modes


@dataclass(frozen=True, eq=False)
class MissionFlights:
    """Flights of all legs; the first one starts in the middle, and nothing disturbs it."""

    times: Array  # of the mission [s], (N,); an instant of hand-over stands twice, once for each leg
    states: Array  # (R, N, n)
    legs: Array  # number of the leg at every instant, (N,)
    modes: Array  # that fly from every instant on, (N,); 0 is S
    spent: Array  # velocity change as commanded, by flight and leg [m/s], (R, legs)
    nearest: Array  # least distance to an unsafe set, by leg [m]
    used: Array  # largest share of the next leg's start set that a flight uses at a joint, (legs - 1,)

    def summary(self) -> dict[str, Any]:
        """Return statistics of the flights, which prove nothing."""
        return {
            "runs": len(self.states),
            "delta_v_m_s": self.spent.mean(axis=0).tolist(),
            "delta_v_largest_m_s": float(self.spent.sum(axis=1).max()),
            "least_distance_m": self.nearest.tolist(),
            "share_of_start_set": self.used.tolist(),
        }


def fly_on(schedules: Sequence[Schedule], leaves: Sequence[float], runs: int, seed: int) -> MissionFlights:
    """Fly legs from end to end, a nominal flight first, others under the worst disturbance towards a joint.

    Parameters
    ----------
    schedules, leaves
        Of the legs, and when each is left, by its own clock [s].
    runs, seed : int
        Number of flights besides the nominal one; same seed, same flights.
    """
    rng, parts, clock, x = np.random.default_rng(seed), list[tuple[Array, ...]](), 0.0, None
    for i, (schedule, until) in enumerate(zip(schedules, leaves, strict=True)):
        problem, tracking = schedule.safety.problem, schedule.safety.tracking
        node = round(until / tracking.flow.h)
        flights = attack(schedule, node, runs, rng, x, nominal=True)
        x, start = flights.states[:, node], problem.initial_set
        if i:
            parts[-1] = *parts[-1][:-1], np.array(used_share(flights.states[:, 0], start.c, start.G))
        modes = np.append(np.repeat(flights.modes, schedule.safety.clearance.q), 0)
        delta_v = np.abs(flights.inputs[:, :node]).sum(axis=(1, 2)) * tracking.flow.h / problem.system.mass
        samples = clock + flights.times, flights.states.swapaxes(0, 1), np.full(len(flights.times), i), modes
        nearest = evaluate(flights).min_distance.min()
        parts.append((*(each[: node + 1] for each in samples), delta_v, nearest, np.array(0.0)))
        clock += until
    columns = list(zip(*parts, strict=True))
    times, states, legs, by = (np.concatenate(column) for column in columns[:4])
    each, nearest, used = (np.array(column) for column in columns[4:])
    return MissionFlights(times, states.swapaxes(0, 1), legs, by, each.T, nearest, used[:-1])


def attack(
    schedule: Schedule,
    node: int,
    runs: int,
    rng: np.random.Generator,
    x: Array | None = None,
    nominal: bool = False,
) -> Runs:
    """Fly a leg until a node so that its state lies as far out there as it can, along one coordinate each.

    From states x, or from the corners of the start set that count most; with a `nominal` flight before them.
    """
    schedule = _long_enough(schedule, node)
    problem, n = schedule.safety.problem, schedule.safety.problem.system.n
    modes = flown_modes(schedule, True)[: -(-node // schedule.safety.clearance.q)]
    flight = flies(problem.system)(schedule, modes, 1)
    if isinstance(flight, Predicting):
        flight.prepare(runs + nominal, rng)
    rows = np.vstack([np.eye(n), -np.eye(n)])[(rng.integers(2 * n) + np.arange(runs)) % (2 * n)]
    w, _, adjoint = adjoint_worst_case(flight, rows, np.full(runs, node))
    starts = problem.initial_set.support_vector(adjoint)
    if nominal:
        starts = np.vstack([problem.initial_set.c, starts])
        w = np.concatenate([np.zeros_like(w[:, :1]), w], axis=1)
    return flight.run(starts if x is None else x, w)


def used_share(x: Array, center: Array, generators: Array) -> float:
    """Return the largest share that states (R, n) use of a box."""
    half_widths = np.maximum(np.abs(generators).sum(axis=1), 1e-300)
    return float(np.max(np.abs(x - center) / half_widths))


def _long_enough(schedule: Schedule, node: int) -> Schedule:
    """Return the same schedule, S's reference coasting on until a node at least."""
    safety = schedule.safety
    missing = -(-node // safety.clearance.q) - safety.reference.cells
    if missing <= 0:
        return schedule
    s = construct_s(safety.tracking, safety.reference.extend(missing))
    safety = replace(safety, reference=s.own, controller=s)
    return replace(schedule, safety=safety, controllers=(s, *schedule.controllers[1:]))
