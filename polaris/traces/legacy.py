"""The numbers RTAEval gives, defects included: for comparison with results obtained there.

Written from a description of what it computes; docs/traces.md lists the defects, and what the
description leaves open. Every deviation from the right number here is on purpose.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np

from ..runfiles import strict
from ..system import Array
from .model import SAFETY, UNTRUSTED, AgentTrace, BallTrace, PointTrace, RectangleTrace, Trace
from .motion import between, interpolate
from .placing import place
from .settings import DIFFERENCES, Velocity, find_velocity

NEVER = 1e20
"""What stands for no collision between agents there."""

Found = TypeVar("Found")


class Raises(str):
    """Stands where the framework ends with an exception; says which."""


@dataclass(frozen=True)
class LegacyMetrics:
    """Results per agent and method, in the order of values the methods return.

    Attributes
    ----------
    agents : dict
        Agent to method (``controllerUsage``, ``compute_dists``, ``compute_agent_dists``,
        ``compute_unsafe_TTC``, ``compute_agent_TTC``, ``running_times``) to what it returns, or to
        `Raises`.
    """

    agents: dict[str, dict[str, Any]]

    def summary(self) -> dict[str, Any]:
        """Plain data for strict JSON; nan is null."""
        out: dict[str, Any] = strict({"legacy_rtaeval": True, "agents": self.agents})
        return out


class _Stop(Exception):
    """The framework would raise here."""


def legacy_metrics(trace: Trace, d: int | None, velocity: Velocity) -> LegacyMetrics:
    """Measure a trace as RTAEval does; see `polaris.traces.evaluate_trace`."""

    def attempt(method: Callable[[], Found]) -> Found | Raises:
        try:
            with np.errstate(divide="ignore", invalid="ignore"):
                return method()
        except _Stop as stop:
            return Raises(f"raises: {stop}")

    agents: dict[str, dict[str, Any]] = {}
    for name, agent in trace.agents.items():
        one = _Agent(trace, name, agent, d or 1, velocity)
        agents[name] = {
            "controllerUsage": controller_usage(agent.modes.tolist()),
            "compute_dists": attempt(one.dists),
            "compute_agent_dists": attempt(one.agent_dists),
            "compute_unsafe_TTC": attempt(one.unsafe_ttc),
            "compute_agent_TTC": attempt(one.agent_ttc),
            "running_times": attempt(one.running_times),
        }
    return LegacyMetrics(agents)


def controller_usage(modes: list[int]) -> tuple[float, float, int]:
    """Shares of samples under UNTRUSTED and otherwise, and switches (defect 6).

    The mode before the run is UNTRUSTED. Whatever is not UNTRUSTED counts as safety, but only SAFETY
    itself is remembered as such: every sample of another mode is one more switch.
    """
    switches, last = 0, UNTRUSTED
    for mode in modes:
        switches += last != (UNTRUSTED if mode == UNTRUSTED else SAFETY)
        last = mode
    untrusted = modes.count(UNTRUSTED) / len(modes)
    return untrusted, 1 - untrusted, switches


class _Agent:
    """The methods, for one agent."""

    def __init__(self, trace: Trace, name: str, agent: AgentTrace, d: int, wanted: Velocity) -> None:
        self.trace, self.name, self.agent, self.d, self.wanted = trace, name, agent, d, wanted

    # -- distances --------------------------------------------------------------------------------

    def dists(self) -> tuple[float, float, dict[str, float]]:
        """(min, max, {set: mean}) over the sets that count."""
        return _joined(self._set_distances())

    def _set_distances(self) -> dict[str, Array]:
        if len(self.agent.times) < 2:
            raise _Stop("one sample")
        found = {
            name: self._distance(name)
            for name, item in self.trace.unsafe.items()
            if not isinstance(item, PointTrace)  # defect 8
        }
        if not found:
            raise _Stop("no unsafe sets")
        return found

    def _distance(self, name: str) -> Array:
        item, t, d = self.trace.unsafe[name], self.agent.times, self.d
        if not isinstance(item, (BallTrace, RectangleTrace)):
            true = place(item, t, d).signed_distance(self.agent.states[:, :d])
            return np.asarray(np.maximum(true, 0.0))  # defect 7
        p = self.agent.states[:, 1 : d + 1]  # defect 1: the rows have lost their time already
        if p.shape[1] < d:
            raise _Stop("fewer states than axes after the first")
        rows = between(item.times, t)
        off = p - interpolate(item.centers[:, :d], rows)
        if isinstance(item, BallTrace):
            return np.asarray(np.maximum(np.linalg.norm(off, axis=1) - interpolate(item.radii, rows), 0.0))
        gaps = np.maximum(np.abs(off) - interpolate(item.lengths[:, :d], rows) / 2, 0.0)
        return np.asarray(np.linalg.norm(gaps, axis=1))

    def agent_dists(self) -> tuple[float, float, dict[str, float]]:
        """(min, max, {agent: mean}), without z in three axes (defect 4)."""
        axes = min(self.d, 2)
        return _joined({name: np.linalg.norm(p[:, :axes], axis=1) for name, p, _ in self._others()})

    def _others(self) -> list[tuple[str, Array, AgentTrace]]:
        """Name, position relative to it, and trace of every other agent."""
        if len(self.agent.times) < 2:
            raise _Stop("one sample")
        found = []
        for name, other in self.trace.agents.items():
            if name != self.name:
                p = interpolate(other.states, between(other.times, self.agent.times))
                found.append((name, self.agent.states[:, : self.d] - p[:, : self.d], other))
        if not found:
            raise _Stop("no other agents")
        return found

    # -- times to collision -----------------------------------------------------------------------

    def _velocity(self, name: str, agent: AgentTrace) -> Array:
        v, source = find_velocity(name, agent, self.d, self.wanted)
        if v is None:
            raise _Stop("one sample")
        if source != DIFFERENCES and self.d > 1:
            raise _Stop("the states have no heading")  # defect 9
        return v

    def unsafe_ttc(self) -> tuple[dict[str, float], dict[str, float], dict[str, float]]:
        """({set: min}, {set: max}, {set: mean}) of distance over speed along the line to the centre.

        The line has no sign, and no width (defect 2). A polytope has no centre: it gets what the ball
        before it got (defect 3).
        """
        distances = self._set_distances()
        v, p = self._velocity(self.name, self.agent), self.agent.states[:, : self.d]
        found: dict[str, Array] = {}
        ball: Array | None = None
        for name, distance in distances.items():
            item = self.trace.unsafe[name]
            if isinstance(item, (BallTrace, RectangleTrace)):
                line = interpolate(item.centers[:, : self.d], between(item.times, self.agent.times)) - p
                along = np.abs(np.sum(v * line, axis=1)) / np.linalg.norm(line, axis=1)
                found[name] = np.where(np.any(v != 0, axis=1), distance / along, np.nan)
                ball = found[name] if isinstance(item, BallTrace) else ball
            elif ball is None:
                raise _Stop("a polytope has no center")
            else:
                found[name] = ball
        return _least(found), _most(found), _mean(found)

    def agent_ttc(self) -> tuple[dict[str, float], dict[str, float], dict[str, float]]:
        """({agent: min}, ...): the time at which all axes meet, if the axes' floats are equal (defect 5)."""
        found: dict[str, Array] = {}
        for name, p, other in self._others():
            w = interpolate(self._velocity(name, other), between(other.times, self.agent.times))
            per_axis = -p / (self._velocity(self.name, self.agent) - w)
            same = np.all(per_axis == per_axis[:, :1], axis=1) & (per_axis[:, 0] >= 0)
            found[name] = np.where(same, per_axis[:, 0], NEVER)
        return _least(found), _most(found), _mean(found)

    def running_times(self) -> tuple[float, float, float]:
        """(avg, max, min): not the order its documentation gives."""
        spent = self.agent.running_times
        if not len(spent):
            raise _Stop("no running times")
        return float(spent.mean()), float(spent.max()), float(spent.min())


def _least(found: dict[str, Array]) -> dict[str, float]:
    return {name: float(values.min()) for name, values in found.items()}


def _most(found: dict[str, Array]) -> dict[str, float]:
    return {name: float(values.max()) for name, values in found.items()}


def _mean(found: dict[str, Array]) -> dict[str, float]:
    return {name: float(values.mean()) for name, values in found.items()}


def _joined(found: dict[str, Array]) -> tuple[float, float, dict[str, float]]:
    return min(_least(found).values()), max(_most(found).values()), _mean(found)
