"""Metrics of a trace: distances, times to collision, usage, switches, running times."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, overload

import numpy as np

from ..checks import non_negative
from ..errors import ScenarioError
from ..metrics import UNKNOWN, count_switches, mode_shares
from ..runfiles import strict
from ..shapes import Ball
from ..system import Array, LinearSystem
from .drifting import Drift
from .legacy import LegacyMetrics, legacy_metrics
from .model import MODE_NAMES, AgentTrace, Trace
from .motion import between, interpolate, weights
from .placing import place
from .restamping import restamp as restamped
from .restamping import stamped_by_simulator
from .settings import DIFFERENCES, Velocity, doubtful, find_dims, find_velocity


@dataclass(frozen=True)
class Spread:
    """A quantity over the samples of a trace.

    Attributes
    ----------
    min, mean, max : float
        The mean is over time (trapezoidal); inf as soon as one value is.
    at : float
        When the least value was reached first [s]; nan if it is inf throughout.
    share : float
        Share of the time with a finite value.
    """

    min: float
    mean: float
    max: float
    at: float
    share: float

    @classmethod
    def of(cls, values: Array, t: Array) -> Spread:
        """Of values (N,) at times t (N,), inf among them."""
        finite, weight = np.isfinite(values), weights(t)
        mean = float(np.sum(values * weight)) if finite.all() else np.inf
        when = float(t[np.argmin(values)]) if finite.any() else np.nan
        share = float(np.sum(weight[finite]))
        return cls(float(values.min()), mean, float(values.max()), when, min(share, 1.0))


@dataclass(frozen=True)
class Separation:
    """One agent against one unsafe set, or another agent.

    Attributes
    ----------
    name, kind : str
        Of the set; the kind of another agent is ``agent``.
    distance : Spread or None
        Signed distance [m], negative inside; None if the two were never there at the same time.
    ttc : Spread or None
        Time to collision [s] along a straight ray; None if a velocity is not known.
    drift_ttc : Spread or None
        The same along free drift; None if no system is given.
    """

    name: str
    kind: str
    distance: Spread | None
    ttc: Spread | None
    drift_ttc: Spread | None = None


@dataclass(frozen=True)
class AgentMetrics:
    """Metrics of one agent.

    Attributes
    ----------
    samples : int
        Rows of its trace.
    duration : float
        From the first stamp to the last [s].
    velocity : str
        Where its velocity comes from.
    unsafe, others : tuple of Separation
        Against every unsafe set, and every other agent.
    usage : dict
        Share of time per mode: normal, untrusted, safety, unknown.
    switches : int
        Changes of a known mode inside the run.
    running_times : tuple of float, or None
        Mean, largest and smallest wall time of a decision [s].
    """

    samples: int
    duration: float
    velocity: str
    unsafe: tuple[Separation, ...]
    others: tuple[Separation, ...]
    usage: dict[str, float]
    switches: int
    running_times: tuple[float, float, float] | None


@dataclass(frozen=True)
class TraceMetrics:
    """Metrics of a trace.

    Attributes
    ----------
    dims : int or None
        Axes of position.
    agents : dict of str to AgentMetrics
    notes : tuple of str
        What a reader of the numbers should know.
    """

    dims: int | None
    agents: dict[str, AgentMetrics]
    notes: tuple[str, ...]

    def summary(self) -> dict[str, Any]:
        """All numbers as plain data for strict JSON; times to collision that are inf are null."""
        agents = {name: _plain(agent) for name, agent in self.agents.items()}
        out: dict[str, Any] = strict({"dims": self.dims, "agents": agents, "notes": list(self.notes)})
        return out


def _plain(agent: AgentMetrics) -> dict[str, Any]:
    spent = agent.running_times
    return {
        "samples": agent.samples,
        "duration_s": agent.duration,
        "velocity": agent.velocity,
        "unsafe": {item.name: _separation(item) for item in agent.unsafe},
        "agents": {item.name: _separation(item) for item in agent.others},
        "usage": agent.usage,
        "switches": agent.switches,
        "running_time_s": None if spent is None else dict(zip(("mean", "max", "min"), spent, strict=True)),
    }


def _separation(item: Separation) -> dict[str, Any]:
    spreads = {"distance_m": item.distance, "ttc_s": item.ttc, "drift_ttc_s": item.drift_ttc}
    return {"kind": item.kind} | {key: None if of is None else vars(of) for key, of in spreads.items()}


@overload
def evaluate_trace(
    trace: Trace,
    *,
    dims: int | None = ...,
    velocity: Velocity = ...,
    restamp: bool = ...,
    system: LinearSystem | None = ...,
    agent_radius: float = ...,
    legacy_rtaeval: Literal[False] = ...,
) -> TraceMetrics: ...


@overload
def evaluate_trace(
    trace: Trace,
    *,
    dims: int | None = ...,
    velocity: Velocity = ...,
    restamp: bool = ...,
    system: LinearSystem | None = ...,
    agent_radius: float = ...,
    legacy_rtaeval: Literal[True],
) -> LegacyMetrics: ...


def evaluate_trace(
    trace: Trace,
    *,
    dims: int | None = None,
    velocity: Velocity = None,
    restamp: bool = False,
    system: LinearSystem | None = None,
    agent_radius: float = 0.0,
    legacy_rtaeval: bool = False,
) -> TraceMetrics | LegacyMetrics:
    """Measure every agent of a trace, at its own stamps.

    Parameters
    ----------
    trace : Trace
        From `read_trace` or `to_trace`.
    dims : int, optional
        Axes of position, 1 to 3; default as the unsafe sets have, else half of 4 or 6 states.
    velocity : sequence of int or "differences", optional
        Entries of the states (from 0) that are the velocity, or differences of positions over time. Default:
        the entries after the position where there are just as many (4 or 6 states), else differences.
    restamp : bool
        Undo the stamps of RTAEval's simulator first.
    system : LinearSystem, optional
        For times to collision along free drift; its position must be the first entries of the states.
    agent_radius : float
        Agents count as having met within this distance [m].
    legacy_rtaeval : bool
        Give the numbers that RTAEval gives, defects included.

    Raises
    ------
    ScenarioError
        If the options do not fit the trace, or a set is empty.
    """
    if legacy_rtaeval:
        if restamp or system is not None:
            rule = "cannot be combined with --restamp or --mean-motion: RTAEval does neither"
            raise ScenarioError("--legacy", True, rule)
        return legacy_metrics(trace, find_dims(trace, dims), velocity)
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
        if v is not None and source != DIFFERENCES and doubtful(agent, d, v):
            notes.append(
                f"{name}: {source} do not change its position as a velocity would;"
                " --velocity says which entries do, or takes differences"
            )
        unsafe = _against_sets(trace, agent, d, v, drift)
        others = tuple(
            _against_agent(agent, v, other, trace.agents[other], d, wanted, radius, trace)
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
        int(count_switches(_modes(agent), agent.times)) if len(_modes(agent)) else 0,
        (float(spent.mean()), float(spent.max()), float(spent.min())) if len(spent) else None,
    )


def _modes(agent: AgentTrace) -> Any:
    return agent.known_modes


def _usage(agent: AgentTrace) -> dict[str, float]:
    shares = mode_shares(agent.times, _modes(agent))
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
    trace: Trace,
) -> Separation:
    """Against another agent, where it is interpolated linearly, at times when both are there."""
    t = agent.times
    both = (t >= other.times[0]) & (t <= other.times[-1])
    if not both.any():
        return Separation(name, "agent", None, None)
    rows = tuple(part[both] for part in between(other.times, t))
    left, right, share = rows
    apart = agent.states[both, :d] - interpolate(other.states[:, :d], (left, right, share))
    distance = Spread.of(np.linalg.norm(apart, axis=1), t[both])
    w, _ = find_velocity(name, other, d, wanted)
    if v is None or w is None:
        return Separation(name, "agent", distance, None)
    relative = v[both] - interpolate(w, (left, right, share))
    return Separation(name, "agent", distance, Spread.of(Ball(radius).entry_time(apart, relative), t[both]))
