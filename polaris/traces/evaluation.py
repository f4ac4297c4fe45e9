"""Metrics of a trace: distances, times to collision, usage, switches, running times."""

from __future__ import annotations

import numpy as np

from ..model.checks import non_negative
from ..model.distances import UNKNOWN, count_switches, mode_shares
from ..model.shapes import Ball
from ..model.system import Array, LinearSystem
from .drifting import Drift
from .model import MODE_NAMES, AgentTrace, Trace
from .motion import between, interpolate
from .placing import place
from .results import AgentMetrics, Separation, Spread, TraceMetrics
from .settings import Velocity, doubtful, find_dims, find_velocity, stamped_by_simulator
from .settings import restamp as restamped


def evaluate_trace(
    trace: Trace,
    *,
    dims: int | None = None,
    velocity: Velocity = None,
    restamp: bool = False,
    system: LinearSystem | None = None,
    agent_radius: float = 0.0,
) -> TraceMetrics:
    """Measure every agent of a trace, at its own stamps.

    Parameters
    ----------
    trace : Trace
        From `read_trace` or `to_trace`.
    dims : int, optional
        Axes of position, 1 to 3; default as the unsafe sets have, else half of 4 or 6 states.
    velocity : sequence of int, Heading or "differences", optional
        Entries of the states (from 0) that are the velocity, or its direction and size, or differences of
        positions over time. Default: the entries after the position where there are just as many and the
        position changes as they say, else differences.
    restamp : bool
        Undo the stamps of RTAEval's simulator first.
    system : LinearSystem, optional
        For times to collision along free drift; its position must be the first entries of the states.
    agent_radius : float
        Agents count as having met within this distance [m].

    Raises
    ------
    ScenarioError
        If the options do not fit the trace, or a set is empty.
    """
    non_negative("--agent-radius", agent_radius, "m")
    trace = restamped(trace) if restamp else trace
    d = find_dims(trace, dims)
    drift = None if system is None else Drift(trace, system, d)
    notes = [f"passed over: {place}" for place in trace.ignored]
    agents = {}
    for name, agent in trace.agents.items():
        if stamped_by_simulator(agent.times):
            notes.append(
                f"{name}: the first two rows carry the same time, as RTAEval's simulator stamps them;"
                " --restamp gives every state its own"
            )
        agents[name] = _measure(trace, name, d, velocity, drift, agent_radius, notes)
    if drift is not None:
        notes.append(drift.note)
    return TraceMetrics(d, agents, tuple(notes))


def _measure(
    trace: Trace,
    name: str,
    d: int | None,
    wanted: Velocity,
    drift: Drift | None,
    radius: float,
    notes: list[str],
) -> AgentMetrics:
    agent = trace.agents[name]
    source = "not needed"
    unsafe: tuple[Separation, ...] = ()
    others: tuple[Separation, ...] = ()
    if d is not None:
        v, source = find_velocity(name, agent, d, wanted)
        if v is not None and wanted not in (None, "differences") and doubtful(agent, d, v):
            notes.append(f"{name}: its position does not change as a velocity of {source} would have it")
        unsafe = _against_sets(trace, agent, d, v, drift)
        others = tuple(
            _against_agent(agent, v, other, trace.agents[other], d, wanted, radius)
            for other in trace.agents
            if other != name
        )
    spent = agent.running_times
    return AgentMetrics(
        len(agent.times),
        float(agent.times[-1] - agent.times[0]),
        source,
        unsafe,
        others,
        _usage(agent),
        int(count_switches(agent.known_modes, agent.times)),
        (float(spent.mean()), float(spent.max()), float(spent.min())) if len(spent) else None,
    )


def _usage(agent: AgentTrace) -> dict[str, float]:
    shares = mode_shares(agent.times, agent.known_modes)
    names = {number: name.lower() for number, name in MODE_NAMES.items()} | {UNKNOWN: "unknown"}
    return {name: float(shares.get(number, 0.0)) for number, name in names.items()}


def _against_sets(
    trace: Trace, agent: AgentTrace, d: int, v: Array | None, drift: Drift | None
) -> tuple[Separation, ...]:
    t, p = agent.times, agent.states[:, :d]
    out = []
    for name, item in trace.unsafe.items():
        placed = place(item, t, d)
        ttc = None if v is None else Spread.of(placed.entry_time(p, v), t)
        drifting = None
        if drift is not None:
            chosen, values = drift.entry_times(agent, placed)
            drifting = Spread.of(values, t[chosen])
        distance = Spread.of(placed.signed_distance(p), t)
        out.append(Separation(name, item.set_type, distance, ttc, drifting))
    return tuple(out)


def _against_agent(
    agent: AgentTrace,
    v: Array | None,
    name: str,
    other: AgentTrace,
    d: int,
    wanted: Velocity,
    radius: float,
) -> Separation:
    """Against another agent, where it is interpolated linearly, at times when both are there."""
    t = agent.times
    both = (t >= other.times[0]) & (t <= other.times[-1])
    if not both.any():
        return Separation(name, "agent", None, None)
    left, right, share = between(other.times, t)
    rows = left[both], right[both], share[both]
    apart = agent.states[both, :d] - interpolate(other.states[:, :d], rows)
    distance = Spread.of(np.linalg.norm(apart, axis=1), t[both])
    w, _ = find_velocity(name, other, d, wanted)
    if v is None or w is None:
        return Separation(name, "agent", distance, None)
    relative = v[both] - interpolate(w, rows)
    return Separation(name, "agent", distance, Spread.of(Ball(radius).entry_time(apart, relative), t[both]))
