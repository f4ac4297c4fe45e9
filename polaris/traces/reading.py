"""Traces as files of strict JSON in RTAEval's form: one clear message for whatever is wrong with one."""

import gc
import json
from collections.abc import Iterator
from contextlib import contextmanager
from enum import Enum
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from reach.numerics.files import read_regular

from ..model.checks import of_kind
from ..model.errors import ScenarioError, quoted
from ..model.files import parse_json
from ..model.scene.distances import UNKNOWN
from ..model.system import Array
from ..runs.files.atomic import check_file, replacing_file
from ..runs.files.tables import strict
from .model import MODE_NAMES, AgentTrace, AnySet, BallTrace, Modes, PointTrace, RectangleTrace, Trace
from .rows import SPAN, Odd, numbers, rows_of, set_trace, table

MODE_NUMBERS = {name: number for number, name in MODE_NAMES.items()} | {"UNKNOWN": UNKNOWN}
MODE_RULE = "must be 1 NORMAL, 2 UNTRUSTED, 3 SAFETY (as a number, a name or {value: number}), or null"


def read_trace(path: str | Path) -> Trace:
    """Read a trace from a JSON file, in RTAEval's form.

    Parameters
    ----------
    path : path
        Strict JSON in UTF-8: NaN, infinities and keys that occur twice are refused, nothing is evaluated.

    Raises
    ------
    ScenarioError
        If it cannot be read or is malformed; the message names the place, as in
        ``agents.chaser.state_trace[3]``.
    """
    with uncollected():
        return _trace(_parsed(path))


@contextmanager
def uncollected() -> Iterator[None]:
    """Pause the garbage collector while millions of small lists are made: several times as fast."""
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def _parsed(path: str | Path) -> Any:
    """Read a file as plain data."""
    try:
        text = read_regular(path).decode("utf-8-sig")
        return parse_json(text, parse_constant=_no_constant, object_pairs_hook=_unique)
    except OSError as error:
        raise ScenarioError("trace", str(path), f"cannot be read: {error.strerror or error}") from error
    except Odd as error:
        raise ScenarioError("trace", str(path), str(error)) from error
    except ValueError as error:
        raise ScenarioError("trace", str(path), f"must be JSON in UTF-8 ({error})") from error


def parse_trace(data: Any) -> Trace:
    """Make a trace of RTAEval's own objects in memory: dictionaries, lists, tuples, arrays, Enum members.

    Raises
    ------
    ScenarioError
        As `read_trace`.
    """
    return _trace(strict(data, float))


def _no_constant(name: str) -> NoReturn:
    raise Odd(f"must be strict JSON, which has no {name}; leave out what is not a number")


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    out = dict(pairs)
    if len(out) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for key in keys if keys.count(key) > 1)
        raise Odd(f"holds the key {quoted(twice)} twice in one object")
    return out


def _object(place: str, value: Any, rule: str = "must be an object") -> dict[str, Any]:
    if not isinstance(value, dict):
        raise ScenarioError(place, value, rule)
    return value


def _trace(data: Any) -> Trace:
    root = _object("trace", data, "must be an object with the keys agents and unsafe")
    agents = _object("agents", root.get("agents"))
    unsafe = _object("unsafe", root.get("unsafe"), "must be an object, {} without unsafe sets")
    parts = (
        {name: _agent(f"agents.{name}", _object(f"agents.{name}", item)) for name, item in agents.items()},
        {name: set_trace(f"unsafe.{name}", _object(f"unsafe.{name}", item)) for name, item in unsafe.items()},
    )
    ignored = [key for key in root if key not in ("agents", "unsafe")]
    for key, items in (("agents", agents), ("unsafe", unsafe)):
        for name, item in items.items():
            keys = KEYS["ball" if key == "unsafe" and item.get("set_type") == "ball" else key]
            ignored += [f"{key}.{name}.{entry}" for entry in item if entry not in keys]
    return Trace(*parts, tuple(ignored))


KEYS = {
    "agents": ("state_trace", "mode_trace", "running_times", "margin_trace"),
    "unsafe": ("set_type", "state_trace", *SPAN),
    "ball": ("set_type", "state_trace", "velocity_trace", *SPAN),
}


def _agent(prefix: str, item: dict[str, Any]) -> AgentTrace:
    place = f"{prefix}.state_trace"
    rows = rows_of(prefix, item, "[t, s0, s1, ...]")
    values = table(place, rows, _agent_row)
    running, durations = item.get("running_times") or [], np.empty(0)
    if not isinstance(running, list):
        raise ScenarioError(f"{prefix}.running_times", running, "must be a list of numbers [s]")
    if running:
        durations = numbers(f"{prefix}.running_times", [[value] for value in running], running)[:, 0]
    limits = _object(f"{prefix}.margin_trace", item.get("margin_trace", {}))
    margins = [_margins(f"{prefix}.margin_trace.{name}", margin) for name, margin in limits.items()]
    if any(len(each) != len(rows) for each in margins):
        rule = f"must hold {len(rows)} numbers for each limit"
        raise ScenarioError(f"{prefix}.margin_trace", list(limits), rule)
    optional = durations, tuple(limits), np.array(margins)
    return AgentTrace(values[:, 0], values[:, 1:], _modes(prefix, item, len(rows)), *optional, where=prefix)


def _margins(place: str, items: Any) -> Array:
    """Return clearance to a limit [m] row by row: null, while it does not hold, is inf."""
    if not isinstance(items, list):
        raise ScenarioError(place, items, "must be a list of numbers [m], null while the limit does not hold")
    active = [i for i, value in enumerate(items) if value is not None]
    margins = np.full(len(items), np.inf)
    if active:
        margins[active] = numbers(place, [[items[i]] for i in active], [items[i] for i in active])[:, 0]
    return margins


def _agent_row(row: Any) -> list[Any]:
    if not isinstance(row, list) or len(row) < 2:
        raise Odd("must be a row [t, s0, s1, ...] or [t, [s0, s1, ...]]")
    if len(row) == 2 and isinstance(row[1], list):
        return [row[0], *row[1]]
    return row


def _modes(prefix: str, item: dict[str, Any], count: int) -> Modes:
    place = f"{prefix}.mode_trace"
    if "mode_trace" in item and item["mode_trace"] is None:
        return np.full(count, UNKNOWN)
    rule = "must be a list of modes, one per row of state_trace, or null if none is known"
    modes = item.get("mode_trace")
    if not isinstance(modes, list) or len(modes) not in (count, count - 1):
        summary = modes if not isinstance(modes, list) else f"{len(modes)} modes"
        raise ScenarioError(place, summary, f"{rule} ({count}, or {count - 1} without the last)")
    values = modes if set(map(type, modes)) <= {int} else [_mode(place, i, v) for i, v in enumerate(modes)]
    try:
        return np.array(values, dtype=np.int64)
    except OverflowError as error:
        i = next(i for i, value in enumerate(values) if not -(2**63) <= value < 2**63)
        raise ScenarioError(f"{place}[{i}]", modes[i], MODE_RULE) from error


def _mode(place: str, i: int, mode: Any) -> int:
    value = mode
    if isinstance(value, dict):
        value = value.get("value", value.get("name", mode))
    if isinstance(value, Enum):
        value = value.value
    if value is None:
        return UNKNOWN
    if isinstance(value, str):
        value = MODE_NUMBERS.get(value.rpartition(".")[2].upper())
    if isinstance(value, bool) or not isinstance(value, int):
        raise ScenarioError(f"{place}[{i}]", mode, MODE_RULE)
    return value


def trace_data(trace: Trace) -> dict[str, Any]:
    """The trace as plain lists and numbers, as RTAEval lays it out.

    Agents' rows are flat, ``[t, s0, s1, ...]``; those of sets nested, ``[t, def]``; modes are whole
    numbers, null where unknown. ``running_times`` and ``margin_trace`` are there only if the agent has any,
    ``velocity_trace`` only if a ball's velocities are known, ``from_s`` and ``until_s`` only if finite.
    """
    return {
        "agents": {name: _agent_data(agent) for name, agent in trace.agents.items()},
        "unsafe": {name: _set_data(item) for name, item in trace.unsafe.items()},
    }


def write_trace(path: str | Path, trace: Trace, *, force: bool = False) -> Path:
    """Write a trace: whole, or not at all.

    Parameters
    ----------
    path : path
        The JSON file; its folder must be there.
    trace : Trace
    force : bool
        True if a file that is there is replaced.

    Returns
    -------
    Path
        The file. Numbers are written in the shortest form that reads back exactly.

    Raises
    ------
    ScenarioError
        If `path` is a folder, is there already, is part of a result, or cannot be written.
    """
    of_kind("trace", trace, Trace, "polaris.read_trace")
    target = check_file(path, "trace", (".json",), force)
    try:
        with uncollected():
            text = json.dumps(trace_data(trace), allow_nan=False, ensure_ascii=False) + "\n"
        data = text.encode("utf-8")
    except ValueError as error:
        raise ScenarioError("trace", str(path), f"cannot be written: {error}") from error
    with replacing_file(target, "trace", force) as partial:
        partial.write_bytes(data)
    return target


def _agent_data(agent: AgentTrace) -> dict[str, Any]:
    out: dict[str, Any] = {
        "state_trace": np.column_stack([agent.times, agent.states]).tolist(),
        "mode_trace": [None if mode == UNKNOWN else mode for mode in agent.modes.tolist()],
    }
    if len(agent.running_times):
        out["running_times"] = agent.running_times.tolist()
    if agent.limits:
        rows = ([x if np.isfinite(x) else None for x in row] for row in agent.margins.tolist())
        out["margin_trace"] = dict(zip(agent.limits, rows, strict=True))
    return out


def _set_data(item: AnySet) -> dict[str, Any]:
    out: dict[str, Any] = {"set_type": item.set_type, "state_trace": _set_rows(item)}
    out |= {key: limit for key, limit in zip(SPAN, item.span, strict=True) if np.isfinite(limit)}
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
