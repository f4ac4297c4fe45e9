"""Writing traces: strict JSON in RTAEval's form, beside and renamed into place."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from ..model.checks import of_kind
from ..model.distances import UNKNOWN
from ..model.errors import ScenarioError
from ..runs.atomic import check_file, replacing_file
from .model import AgentTrace, AnySet, BallTrace, PointTrace, RectangleTrace, Trace
from .reading import uncollected


def trace_data(trace: Trace) -> dict[str, Any]:
    """The trace as plain lists and numbers, as RTAEval lays it out.

    Agents' rows are flat, ``[t, s0, s1, ...]``; those of sets nested, ``[t, def]``; modes are whole
    numbers, null where unknown. ``running_times`` is there only if the agent has any, ``velocity_trace``
    only if a ball's velocities are known.
    """
    return {
        "agents": {name: _agent(agent) for name, agent in trace.agents.items()},
        "unsafe": {name: _set(item) for name, item in trace.unsafe.items()},
    }


def write_trace(path: str | Path, trace: Trace) -> Path:
    """Write a trace, replacing an older file once everything is written.

    Parameters
    ----------
    path : path
        The JSON file; its folder must be there.
    trace : Trace

    Returns
    -------
    Path
        The file. Numbers are written in the shortest form that reads back exactly.

    Raises
    ------
    ScenarioError
        If `path` is a folder, or cannot be written.
    """
    of_kind("trace", trace, Trace, "polaris.read_trace")
    target = Path(path)
    check_file(target, "trace", (".json",))
    try:
        with uncollected():
            text = json.dumps(trace_data(trace), allow_nan=False, ensure_ascii=False) + "\n"
        data = text.encode("utf-8")
    except ValueError as error:
        raise ScenarioError("trace", str(path), f"cannot be written: {error}") from error
    with replacing_file(target, "trace") as beside:
        beside.write_bytes(data)
    return target


def _agent(agent: AgentTrace) -> dict[str, Any]:
    out: dict[str, Any] = {
        "state_trace": np.column_stack([agent.times, agent.states]).tolist(),
        "mode_trace": [None if mode == UNKNOWN else mode for mode in agent.modes.tolist()],
    }
    if len(agent.running_times):
        out["running_times"] = agent.running_times.tolist()
    return out


def _set(item: AnySet) -> dict[str, Any]:
    out: dict[str, Any] = {"set_type": item.set_type, "state_trace": _set_rows(item)}
    if isinstance(item, BallTrace) and item.velocities is not None:
        out["velocity_trace"] = item.velocities.tolist()
    return out


def _set_rows(item: AnySet) -> list[Any]:
    times = item.times.tolist()
    if isinstance(item, PointTrace):
        return [[t, c] for t, c in zip(times, item.centers.tolist(), strict=True)]
    if isinstance(item, BallTrace):
        rows = zip(times, item.centers.tolist(), item.radii.tolist(), strict=True)
        return [[t, [c, r]] for t, c, r in rows]
    if isinstance(item, RectangleTrace):
        boxes = zip(times, item.centers.tolist(), item.lengths.tolist(), strict=True)
        return [[t, [c, *lengths]] for t, c, lengths in boxes]
    A = item.A.tolist() * (len(times) if len(item.A) == 1 else 1)
    return [[t, [rows, b]] for t, rows, b in zip(times, A, item.b.tolist(), strict=True)]
