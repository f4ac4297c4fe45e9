"""Metrics of a trace: distances, times to collision, usage, switches, running times."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reach.short_repr import short_repr

from ..model.checks import non_negative
from ..model.errors import ScenarioError
from ..model.scene.distances import UNKNOWN, count_switches, mode_shares
from ..model.scene.free_drift import DriftSearch
from ..model.scene.obstacle import is_holding
from ..model.scene.shapes import BallShape
from ..model.system import Array, LinearSystem
from ..runs.files.tables import strict
from ..simulation.run_metrics import drift_horizon
from .model import MODE_NAMES, AgentTrace, Trace
from .placement import PlacedParts, place
from .settings import Velocity, between, doubtful, find_dims, find_velocity, interpolate, stamped_by_simulator
from .settings import restamp as restamped

LIMIT = "limit on states"  # kind of a limit on the whole state, to which a trace has the clearance


def weights(t: Array) -> Array:
    """Weight of every sample in a mean over time (trapezoidal), shape (N,); they add up to 1."""
    gaps = np.diff(t)
    total = np.r_[gaps, 0.0] + np.r_[0.0, gaps]
    return np.asarray(total / total.sum() if total.sum() > 0 else np.full(len(t), 1 / len(t)))


@dataclass(frozen=True)
class Spread:
    """A quantity over the samples of a trace."""

    min: float
    mean: float  # over time (trapezoidal); inf as soon as one value is
    max: float
    at: float  # when the least value was reached first [s]; nan if it is inf throughout
    share: float  # of the time with a finite value

    @classmethod
    def from_samples(cls, values: Array, t: Array) -> "Spread":
        """Return the spread of values (N,) at times t (N,) [s], inf among them."""
        finite, weight = np.isfinite(values), weights(t)
        mean = float(np.sum(values * weight)) if finite.all() else np.inf
        time = float(t[np.argmin(values)]) if finite.any() else np.nan
        share = float(np.sum(weight[finite]))
        return cls(float(values.min()), mean, float(values.max()), time, min(share, 1.0))


@short_repr
@dataclass(frozen=True)
class Separation:
    """One agent against an unsafe set, another agent (of kind ``agent``) or a limit on the whole state."""

    name: str
    kind: str
    distance: Spread | None  # signed [m], negative inside, while both are there; None if they never are
    ttc: Spread | None  # time to collision [s] along a straight ray; None if a velocity is not known
    drift_ttc: Spread | None = None  # the same along free drift; None if no system is given

    def _plain(self) -> dict[str, Any]:
        spreads = {"distance_m": self.distance, "ttc_s": self.ttc, "drift_ttc_s": self.drift_ttc}
        return {"kind": self.kind} | {key: None if of is None else vars(of) for key, of in spreads.items()}


@short_repr
@dataclass(frozen=True)
class AgentMetrics:
    """Metrics of one agent."""

    samples: int  # rows of its trace
    duration: float  # from the first stamp to the last [s]
    velocity: str  # where its velocity comes from
    unsafe: tuple[Separation, ...]
    others: tuple[Separation, ...]  # against every other agent
    usage: dict[str, float]  # share of time per mode: normal, untrusted, safety, unknown
    switches: int  # changes of a known mode inside the run
    running_times: tuple[float, float, float] | None  # mean, largest and smallest wall time of a decision [s]

    def _plain(self) -> dict[str, Any]:
        times = self.running_times
        return {
            "samples": self.samples,
            "duration_s": self.duration,
            "velocity": self.velocity,
            "unsafe": {item.name: item._plain() for item in self.unsafe},
            "agents": {item.name: item._plain() for item in self.others},
            "usage": self.usage,
            "switches": self.switches,
            "running_time_s": times and dict(zip(("mean", "max", "min"), times, strict=True)),
        }


@short_repr
@dataclass(frozen=True)
class TraceMetrics:
    """Metrics of a trace.

    Attributes
    ----------
    dims : int or None
        Axes of position.
    agents : dict of str to AgentMetrics
    notes : tuple of str
        Remarks for readers of the numbers.
    """

    dims: int | None
    agents: dict[str, AgentMetrics]
    notes: tuple[str, ...]

    def summary(self) -> dict[str, Any]:
        """All numbers as plain data for strict JSON; times to collision that are inf are null."""
        agents = {name: agent._plain() for name, agent in self.agents.items()}
        out: dict[str, Any] = strict({"dims": self.dims, "agents": agents, "notes": list(self.notes)})
        return out


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
    drift = None if system is None else FreeDrift(trace, system, d)
    notes = [f"passed over: {place}" for place in trace.ignored]
    spans = dict.fromkeys((name.partition("[")[0], *item.span) for name, item in trace.unsafe.items())
    notes += [f"{name} holds from {a:g} to {b:g} s" for name, a, b in spans if a > -np.inf or b < np.inf]
    measurement = _Measurement(trace, d, velocity, drift, agent_radius, notes)
    agents = {name: measurement.agent(name) for name in trace.agents}
    if drift is not None:
        samples = f"from at most {MOST_SAMPLES} samples of each agent"
        notes.append(f"free drift looks {drift.horizon:.6g} s ahead, {samples}")
    return TraceMetrics(d, agents, tuple(notes))


@dataclass(frozen=True, eq=False)
class _Measurement:
    """One trace, and how it is measured: see `evaluate_trace`."""

    trace: Trace
    d: int | None
    selection: Velocity
    drift: "FreeDrift | None"
    radius: float
    notes: list[str]

    def agent(self, name: str) -> AgentMetrics:
        agent, source = self.trace.agents[name], "not needed"
        if stamped_by_simulator(agent.times):
            self.notes.append(
                f"{name}: the first two rows carry the same time, as RTAEval's simulator stamps them;"
                " --restamp gives every state its own"
            )
        unsafe = others = tuple[Separation, ...]()
        if self.d is not None:
            v, source = find_velocity(name, agent, self.d, self.selection)
            if v is not None and self.selection not in (None, "differences") and doubtful(agent, self.d, v):
                detail = f"its position does not change as a velocity of {source} would have it"
                self.notes.append(f"{name}: {detail}")
            unsafe = tuple(self.against_set(agent, self.d, v, other) for other in self.trace.unsafe)
            other_names = [other for other in self.trace.agents if other != name]
            others = tuple(self.against_agent(agent, self.d, v, other) for other in other_names)
        margins = zip(agent.limits, agent.margins, strict=True)
        spreads = ((limit, Spread.from_samples(row, agent.times)) for limit, row in margins)
        unsafe += tuple(Separation(limit, LIMIT, spread, None) for limit, spread in spreads)
        shares = mode_shares(agent.times, agent.known_modes)
        modes = {number: mode_name.lower() for number, mode_name in MODE_NAMES.items()} | {UNKNOWN: "unknown"}
        times = agent.running_times
        return AgentMetrics(
            len(agent.times),
            float(agent.times[-1] - agent.times[0]),
            source,
            unsafe,
            others,
            {mode_name: float(shares.get(number, 0.0)) for number, mode_name in modes.items()},
            int(count_switches(agent.known_modes, agent.times)),
            (float(times.mean()), float(times.max()), float(times.min())) if len(times) else None,
        )

    def against_set(self, agent: AgentTrace, d: int, v: Array | None, name: str) -> Separation:
        t, p, item = agent.times, agent.states[:, :d], self.trace.unsafe[name]
        placed, holds, distance = place(item, t, d), is_holding(item.span, t), None
        if holds.any():
            distance = Spread.from_samples(placed.signed_distance(p)[holds], t[holds])
        ttc = None if v is None else Spread.from_samples(placed.entry_time(p, v), t)
        drifting = None
        if self.drift is not None:
            chosen, values = self.drift.entry_times(agent, placed)
            drifting = Spread.from_samples(values, t[chosen])
        return Separation(name, item.set_type, distance, ttc, drifting)

    def against_agent(self, agent: AgentTrace, d: int, v: Array | None, name: str) -> Separation:
        """Against another agent, interpolated linearly, at times when both are there."""
        t, other = agent.times, self.trace.agents[name]
        present = (t >= other.times[0]) & (t <= other.times[-1])
        if not present.any():
            return Separation(name, "agent", None, None)
        left, right, share = between(other.times, t)
        rows = left[present], right[present], share[present]
        offset = agent.states[present, :d] - interpolate(other.states[:, :d], rows)
        distance, ttc = Spread.from_samples(np.linalg.norm(offset, axis=1), t[present]), None
        w, _ = find_velocity(name, other, d, self.selection)
        if v is not None and w is not None:
            relative = v[present] - interpolate(w, rows)
            ttc = Spread.from_samples(BallShape(self.radius).entry_time(offset, relative), t[present])
        return Separation(name, "agent", distance, ttc)


MOST_SAMPLES = 200  # samples of one agent from which free drift is followed
TOLERANCE = 0.05  # passes less deep [m] than this may be missed


class FreeDrift:
    """Free drift of the agents of a trace under one system, whose states theirs must be."""

    def __init__(self, trace: Trace, system: LinearSystem, d: int | None) -> None:
        for name, agent in trace.agents.items():
            if agent.n != system.n:
                place = f"agents.{name}.state_trace[0]"
                rule = f"must be the {system.n} states of the system that drifts (--mean-motion)"
                raise ScenarioError(place, f"{agent.n} states", rule)
        if d is not None and not np.array_equal(system.position, np.eye(d, system.n)):
            axes = f"{d} axes of position"
            raise ScenarioError("--dims", axes, "must be the first states of the system that drifts")
        longest = max(float(np.ptp(agent.times)) for agent in trace.agents.values())
        self.horizon = drift_horizon(system, longest)
        if not self.horizon > 0:
            raise ScenarioError("system", longest, "must have a trace of some duration")
        self.search = DriftSearch(system, self.horizon, TOLERANCE)

    def entry_times(self, agent: AgentTrace, placed: PlacedParts) -> tuple[NDArray[np.int64], Array]:
        """Samples chosen, evenly over the rows, and seconds from each until drift enters; inf if never."""
        count = len(agent.times)
        chosen = np.unique(np.linspace(0, count - 1, min(count, MOST_SAMPLES)).round().astype(np.int64))
        times: list[Array] = []
        for part in placed.parts:
            for rows in [chosen] if part.rigid else np.split(chosen, len(chosen)):
                motion = agent.states[rows], part.centre[rows], part.velocity[rows]
                shape, t = part.shape(int(rows[0])), agent.times[rows]
                times.append(self.search.entry_times(shape, placed.span, t, *motion))
        return chosen, np.concatenate(times).reshape(-1, len(chosen)).min(axis=0)
