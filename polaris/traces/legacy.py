"""The numbers RTAEval gives, defects (docs/traces.md) included: every deviation is meant."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from ..model.system import Array
from .model import SAFETY, UNTRUSTED, AgentTrace, AnySet, BallTrace, PointTrace, PolytopeTrace, Trace
from .placement import MovingPolytope, place, unit_rows
from .settings import DIFFERENCES, Heading, Velocity, find_dims, find_velocity, guess_heading

NEVER = 1e20  # what stands for no collision between agents there

Each = tuple[dict[str, float], dict[str, float], dict[str, float]]
"""Least, largest and mean values by name of what is measured to."""

Legacy = dict[str, dict[str, Any]]


class Raises(str):
    """Stands where the framework ends with an exception; says which."""


class _Stop(Exception):
    """The framework would raise here."""


def evaluate_legacy(trace: Trace, *, dims: int | None = None, velocity: Velocity = None) -> Legacy:
    """Measure a trace as RTAEval does.

    Parameters
    ----------
    trace : Trace
    dims, velocity
        As of `polaris.traces.evaluate_trace`; by default the velocity is angles and speed after the position,
        if the position changes as they say.

    Returns
    -------
    dict
        What it returns, values in its order, or `Raises`, by agent and method (``controllerUsage``,
        ``compute_dists``, ``compute_agent_dists``, ``compute_unsafe_TTC``, ``compute_agent_TTC``,
        ``running_times``).

    Raises
    ------
    ScenarioError
        If the options do not fit the trace, or a set is empty.
    """
    d = find_dims(trace, dims)

    def attempt(method: Callable[[], Any]) -> Any:
        try:
            with np.errstate(divide="ignore", invalid="ignore"):
                return method()
        except _Stop as stop:
            return Raises(f"raises: {stop}")

    agents: Legacy = {}
    for name, agent in trace.agents.items():
        metrics = _Agent(trace, name, agent, d or 1, velocity)
        agents[name] = {
            "controllerUsage": attempt(metrics.usage),
            "compute_dists": attempt(metrics.dists),
            "compute_agent_dists": attempt(metrics.agent_dists),
            "compute_unsafe_TTC": attempt(metrics.unsafe_ttc),
            "compute_agent_TTC": attempt(metrics.agent_ttc),
            "running_times": attempt(metrics.running_times),
        }
    return agents


class _Agent:
    """The methods, for one agent. Rows of others belong to its own by their place, whatever their stamps."""

    def __init__(self, trace: Trace, name: str, agent: AgentTrace, d: int, selection: Velocity) -> None:
        self.trace, self.name, self.agent, self.d, self.selection = trace, name, agent, d, selection

    def _paired(self, times: Array, *values: Array) -> list[Array]:
        """The first rows of others, as many as the agent has; one row alone is repeated."""
        N = len(self.agent.times)
        if 1 < len(times) < N:
            raise _Stop("fewer rows than the agent's")
        return [np.broadcast_to(one, (N, *one.shape[1:])) if len(one) == 1 else one[:N] for one in values]

    def usage(self) -> tuple[float, float, int]:
        """Shares of samples under UNTRUSTED and otherwise, and switches (defect 6).

        The mode before the run is UNTRUSTED; any other counts as SAFETY, so that a third one always switches.
        """
        modes, switches, last = self.agent.modes.tolist(), 0, UNTRUSTED
        if len(modes) < 2:
            raise _Stop("one sample")
        for mode in modes:
            switches += mode != last
            last = UNTRUSTED if mode == UNTRUSTED else SAFETY
        untrusted = modes.count(UNTRUSTED)
        return untrusted / len(modes), (len(modes) - untrusted) / len(modes), switches

    def dists(self) -> tuple[float, float, dict[str, float]]:
        """(min, max, {set: mean}) over the sets."""
        if any(isinstance(item, PointTrace) for item in self.trace.unsafe.values()):
            raise _Stop("a point gets no distances")  # defect 8
        return _joined({name: self._distance(item)[0] for name, item in self.trace.unsafe.items()})

    def _distance(self, item: AnySet) -> tuple[Array, Array]:
        """Distances (N,), and lines (N, d) to the centre or, for a polytope, to its nearest point."""
        if isinstance(item, PolytopeTrace):
            return self._polytope(item)
        assert not isinstance(item, PointTrace)  # both callers have ruled it out
        sizes = item.radii if isinstance(item, BallTrace) else item.lengths
        centers, sizes = self._paired(item.times, item.centers, sizes)
        p = self.agent.states[:, 1 : item.d + 1]  # defect 1: the rows have lost their time already
        if p.shape[1] < item.d:
            raise _Stop("fewer states than axes after the first")
        offset = p - centers
        if isinstance(item, BallTrace):
            distance = np.maximum(np.linalg.norm(offset, axis=1) - sizes, 0.0)
        else:
            distance = np.linalg.norm(np.maximum(np.abs(offset) - sizes / 2, 0.0), axis=1)
        return np.asarray(distance), centers[:, : self.d] - self.agent.states[:, : self.d]

    def _polytope(self, item: PolytopeTrace) -> tuple[Array, Array]:
        if self.d == 1:
            raise _Stop("polytopes need two axes or three")
        A, b = self._paired(item.times, item.A, item.b)
        paired = replace(item, times=self.agent.times, A=A, b=b)
        p = self.agent.states[:, : self.d]
        distance = np.maximum(place(paired, self.agent.times, self.d).signed_distance(p), 0.0)  # defect 7
        lines = MovingPolytope(*unit_rows(paired.A, paired.b)).to_nearest(p)
        return np.asarray(distance), lines

    def agent_dists(self) -> tuple[float, float, dict[str, float]]:
        """(min, max, {agent: mean}), without z in three axes (defect 4)."""
        axes = min(self.d, 2)
        return _joined({name: np.linalg.norm(p[:, :axes], axis=1) for name, p, _ in self._others()})

    def _others(self) -> list[tuple[str, Array, AgentTrace]]:
        """Name, position relative to the agent's, and trace of every other agent."""
        others = []
        for name, other in self.trace.agents.items():
            if name != self.name:
                (states,) = self._paired(other.times, other.states)
                others.append((name, states[:, : self.d] - self.agent.states[:, : self.d], other))
        return others

    def _velocity(self, name: str, agent: AgentTrace) -> Array:
        selection = guess_heading(agent, self.d) if self.selection is None else self.selection
        if selection is None:
            raise _Stop("the states have no heading")  # defect 9
        v, source = find_velocity(name, agent, self.d, selection)
        if v is None:
            raise _Stop("one sample")
        if source != DIFFERENCES and not isinstance(selection, Heading) and self.d > 1:
            raise _Stop("the states have no heading")
        return v

    def unsafe_ttc(self) -> Each:
        """({set: min}, ...) of distance over speed along the line to the centre, without sign (defect 2).

        A polytope gets the last distance of the ball or box before it, a point its line (defects 3, 8).
        """
        v = self._velocity(self.name, self.agent)
        times: dict[str, Array] = {}
        distance: Array | float | None = None
        line: Array | None = None
        for name, item in self.trace.unsafe.items():
            if isinstance(item, PolytopeTrace):
                if self.d == 2:
                    raise _Stop("a polytope's line has no third axis")
                _, line = self._distance(item)
            elif not isinstance(item, PointTrace):
                distance, line = self._distance(item)
            if distance is None or line is None:
                raise _Stop("no distance before it")
            speed = np.abs(np.sum(v * line, axis=1)) / np.linalg.norm(line, axis=1)
            times[name] = distance / speed
            distance, line = float(np.atleast_1d(distance)[-1]), np.broadcast_to(line[-1], line.shape)
        return _each(times)

    def agent_ttc(self) -> Each:
        """({agent: min}, ...): when the first axes meet, if the others do then as floats (defect 5)."""
        times: dict[str, Array] = {}
        v = self._velocity(self.name, self.agent)
        for name, p, other in self._others():
            (w,) = self._paired(other.times, self._velocity(name, other))
            t = p[:, 0] / -(w - v)[:, 0]
            meet = np.all(np.isfinite(t)[:, None] & (p[:, 1:] == -(w - v)[:, 1:] * t[:, None]), axis=1)
            times[name] = np.where(meet & np.isfinite(t) & ~(t < 0), t, NEVER)
        meetings = {name: values[values != NEVER] for name, values in times.items()}
        mean = {name: float(values.mean()) if len(values) else NEVER for name, values in meetings.items()}
        return *_each(times)[:2], mean

    def running_times(self) -> tuple[float, float, float]:
        """(avg, max, min): not the order its documentation gives."""
        times = self.agent.running_times
        if not len(times):
            raise _Stop("no running times")
        return float(times.mean()), float(times.max()), float(times.min())


def _each(columns: dict[str, Array]) -> Each:
    """Python's ``min`` and ``max``, for which every comparison with nan is false, and means."""
    smallest = {name: min(values.tolist()) for name, values in columns.items()}
    largest = {name: max(values.tolist()) for name, values in columns.items()}
    return smallest, largest, {name: float(values.mean()) for name, values in columns.items()}


def _joined(columns: dict[str, Array]) -> tuple[float, float, dict[str, float]]:
    if not columns:
        raise _Stop("nothing to measure to")
    smallest, largest, mean = _each(columns)
    return min(smallest.values()), max(largest.values()), mean
