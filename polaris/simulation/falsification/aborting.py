"""Attacks on powered abort: S takes over in some step and flies along the branch to the orbit."""

import numpy as np

from ...synthesis.schedule.schedule import Schedule
from ..run_metrics import Runs
from .attacks import Attack, Attacker
from .violations import Failure


def aborted(
    schedule: Schedule, step: int, count: int, rng: np.random.Generator
) -> tuple[Attacker, Attack, Runs]:
    """Flights that are aborted at the start of a step, under the worst that is known against their limits."""
    faults = bool(schedule.safety.problem.system.transients) and rng.random() < 0.5
    attacker = Attacker.from_schedule(schedule.aborted(step), True, rng, faults)
    attack = attacker.failed(count) if faults else attacker.worst(count)
    return attacker, attack, attack.fly(attacker.flight)


def exceeded(schedule: Schedule, step: int, runs: Runs) -> tuple[Failure, int]:
    """Return the claim of arrival that flights aborted in a step exceed most, and the run that does.

    Velocity change counts with what is commanded. A margin that is not negative is no violation.
    """
    powered = schedule.powered
    assert powered is not None
    way = powered.ways[step]
    assert way.branch is not None
    safety, goal = runs.schedule.safety, powered.branches[way.branch].goal
    q, h, system = safety.clearance.q, safety.tracking.flow.h, safety.problem.system
    distance = goal.distance(runs.states[:, way.cell * q], np.zeros(1), 0.0)
    commands = np.abs(runs.inputs[:, step * q : way.cell * q]).sum(axis=1)
    delta_v = commands @ system.weights * h / system.mass
    parts = {"orbit": goal.tolerance - distance, "velocity change": way.delta_v - delta_v}
    limit = min(parts, key=lambda name: float(parts[name].min()))
    run = int(np.argmin(parts[limit]))
    return Failure("abort", limit, way.cell * safety.problem.delta, float(parts[limit][run]), 0.0), run
