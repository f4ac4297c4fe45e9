"""What the numbers of a trace mean: axes of position, where velocities come from."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..errors import ScenarioError
from ..system import Array
from .model import AgentTrace, Trace
from .motion import rates

Velocity = str | Sequence[int] | None

DIFFERENCES = "differences of positions"


def find_dims(trace: Trace, dims: int | None) -> int | None:
    """Axes of position: as given, else as the unsafe sets have, else half of 4 or 6 states.

    Returns
    -------
    int or None
        None if there is nothing to measure distances to.

    Raises
    ------
    ScenarioError
        If it cannot be told, or an agent has fewer states.
    """
    found = dims if dims is not None else _told(trace)
    if found is None:
        return None
    if found not in (1, 2, 3):
        raise ScenarioError("--dims", found, "must be 1, 2 or 3")
    for name, agent in trace.agents.items():
        if agent.n < found:
            place = f"agents.{name}.state_trace[0]"
            raise ScenarioError(
                place, f"{agent.n} states", f"must begin with {found} axes of position (--dims)"
            )
    return found


def _told(trace: Trace) -> int | None:
    axes = {item.d for item in trace.unsafe.values()}
    if len(axes) > 1:
        given = {name: item.d for name, item in trace.unsafe.items()}
        raise ScenarioError("unsafe", given, "sets must have the same axes, or say which count (--dims)")
    if axes:
        return axes.pop()
    halves = {agent.n: agent.n // 2 for agent in trace.agents.values()}
    if len(halves) == 1 and set(halves) <= {4, 6}:
        return next(iter(halves.values()))
    if len(trace.agents) == 1:
        return None
    counts = {name: agent.n for name, agent in trace.agents.items()}
    raise ScenarioError("agents", counts, "do not tell how many of the states are the position; say --dims")


def find_velocity(name: str, agent: AgentTrace, d: int, wanted: Velocity) -> tuple[Array | None, str]:
    """Velocities (N, d) [m/s], None if they cannot be known, and where they come from.

    By default the entries after the position where there are as many of them, in 2 or 3 axes (4 or 6
    states); else `motion.rates` of the positions.

    Raises
    ------
    ScenarioError
        If entries are named that the states do not have, or not d of them.
    """
    if wanted is None and d in (2, 3) and agent.n == 2 * d:
        wanted = range(d, 2 * d)
    if wanted is None or isinstance(wanted, str):
        if wanted not in (None, "differences"):
            raise ScenarioError("--velocity", wanted, "must be 'differences' or the entries of the states")
        found = rates(agent.times, agent.states[:, :d])
        return found, DIFFERENCES if found is not None else "unknown (one instant only)"
    entries = list(wanted)
    if len(entries) != d or any(not 0 <= entry < agent.n for entry in entries):
        rule = f"must be {d} entries of the {agent.n} states of agents.{name}, counted from 0"
        raise ScenarioError("--velocity", entries, rule)
    return agent.states[:, entries], f"states {', '.join(map(str, entries))}"


def doubtful(agent: AgentTrace, d: int, velocity: Array) -> bool:
    """Whether velocities taken from the states are far from how the positions change."""
    moved = rates(agent.times, agent.states[:, :d])
    if moved is None:
        return False
    apart = np.linalg.norm(moved - velocity, axis=1)
    size = np.linalg.norm(moved, axis=1) + np.linalg.norm(velocity, axis=1)
    return bool(np.median(apart) > 0.2 * np.median(size))
