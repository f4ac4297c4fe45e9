"""Undo the stamps of RTAEval's simulator."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..model.distances import UNKNOWN
from ..model.errors import ScenarioError
from ..model.system import Array
from .model import AgentTrace, Trace


def stamped_by_simulator(times: Array) -> bool:
    """Whether the first two rows carry the same time, and no others do."""
    gaps = np.diff(times)
    return len(times) >= 3 and gaps[0] == 0 and bool(np.all(gaps[1:] > 0))


def restamp(trace: Trace) -> Trace:
    """The trace with true times and modes, from the stamps RTAEval's simulator gives.

    There the first two rows both carry t = 0 and every later state is stamped one step early;
    ``mode_trace[i]`` moved state i-1 to state i. Here every state gets its own time and every mode is in
    force from its time on (N-1 modes for N states). Unsafe sets that carry such stamps are treated the same;
    others keep theirs.

    Raises
    ------
    ScenarioError
        If an agent does not carry such stamps.
    """
    for name, agent in trace.agents.items():
        if not stamped_by_simulator(agent.times):
            rule = "must be three rows or more, only the first two with the same time, to be restamped"
            raise ScenarioError(f"agents.{name}.state_trace", agent.times[:3].tolist(), rule)
    unsafe = {
        name: replace(item, times=_own(item.times)) if stamped_by_simulator(item.times) else item
        for name, item in trace.unsafe.items()
    }
    return replace(trace, agents={name: _agent(agent) for name, agent in trace.agents.items()}, unsafe=unsafe)


def _own(times: Array) -> Array:
    return np.asarray(np.r_[times[1:], 2 * times[-1] - times[-2]])


def _agent(agent: AgentTrace) -> AgentTrace:
    modes = np.r_[agent.modes, UNKNOWN][1 : len(agent.times)]
    return replace(agent, times=_own(agent.times), modes=modes)
