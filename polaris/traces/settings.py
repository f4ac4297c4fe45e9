"""Meaning of a trace's numbers: axes, velocities, values between stamps, stamps of a simulator."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..model.errors import ScenarioError
from ..model.scene.distances import UNKNOWN
from ..model.system import Array
from .model import AgentTrace, Trace


@dataclass(frozen=True)
class Heading:
    """A velocity given by its size and its direction: entries of the states, from 0.

    There is one angle less than there are axes: heading, from x towards y, and pitch, from there towards z.
    """

    speed: int  # [m/s], signed in one axis
    angles: tuple[int, ...] = ()  # [rad]


Velocity = str | Sequence[int] | Heading | None

DIFFERENCES = "differences of positions"


def find_dims(trace: Trace, dims: int | None) -> int | None:
    """Axes of position: as given, as the unsafe sets have, or half of 4 or 6 states; None if unused."""
    d = dims if dims is not None else _axes_count(trace)
    if d is None:
        return None
    if d not in (1, 2, 3):
        raise ScenarioError("--dims", d, "must be 1, 2 or 3")
    for name, agent in trace.agents.items():
        if agent.n < d:
            place = f"agents.{name}.state_trace[0]"
            rule = f"must begin with {d} axes of position (--dims)"
            raise ScenarioError(place, f"{agent.n} states", rule)
    return d


def _axes_count(trace: Trace) -> int | None:
    axes = {name: item.d for name, item in trace.unsafe.items()}
    if len(set(axes.values())) > 1:
        raise ScenarioError("unsafe", axes, "must have the same number of axes; or give --dims")
    if axes:
        return next(iter(axes.values()))
    counts = {name: agent.n for name, agent in trace.agents.items()}
    if set(counts.values()) in ({4}, {6}):
        return next(iter(counts.values())) // 2
    if len(counts) == 1:
        return None
    raise ScenarioError("agents", counts, "leave the number of position axes open; give --dims")


def find_velocity(name: str, agent: AgentTrace, d: int, selection: Velocity) -> tuple[Array | None, str]:
    """Velocities (N, d) [m/s], None if they cannot be known, and where they come from.

    By default the entries after the position where there are as many and it changes so; else `rates`.
    """
    if isinstance(selection, Heading):
        return _by_heading(name, agent, d, selection)
    if isinstance(selection, str) and selection != "differences":
        raise ScenarioError("--velocity", selection, "must be 'differences' or the entries of the states")
    refused = ""
    if selection is None and agent.n == 2 * d:
        source = f"states {', '.join(map(str, range(d, 2 * d)))}"
        if not doubtful(agent, d, agent.states[:, d:]):
            return agent.states[:, d:], source
        refused = f" ({source} do not change its position as a velocity would)"
    if selection is None or isinstance(selection, str):
        velocity = rates(agent.times, agent.states[:, :d])
        return velocity, DIFFERENCES + refused if velocity is not None else "unknown (one instant only)"
    entries = list(selection)
    if len(entries) != d or any(not 0 <= entry < agent.n for entry in entries):
        rule = f"must be {d} entries of the {agent.n} states of agents.{name}, counted from 0"
        raise ScenarioError("--velocity", entries, rule)
    return agent.states[:, entries], f"states {', '.join(map(str, entries))}"


def _by_heading(name: str, agent: AgentTrace, d: int, heading: Heading) -> tuple[Array, str]:
    entries = [*heading.angles, heading.speed]
    if len(entries) != d or any(not 0 <= entry < agent.n for entry in entries):
        flags = ("no --heading", "a --heading", "--heading with pitch")[d - 1]
        rule = f"must be entries of the {agent.n} states of agents.{name}, from 0; {d} axes need {flags}"
        raise ScenarioError("--speed, --heading", entries, rule)
    speed, angles = agent.states[:, [heading.speed]], agent.states[:, list(heading.angles)]
    if d == 1:
        return speed, f"speed in state {heading.speed}"
    level = np.column_stack([np.cos(angles[:, 0]), np.sin(angles[:, 0])])
    if d == 3:
        level = np.column_stack([level * np.cos(angles[:, 1:]), np.sin(angles[:, 1])])
    indices = ", ".join(map(str, heading.angles))
    return speed * level, f"speed in state {heading.speed}, direction in {indices}"


def guess_heading(agent: AgentTrace, d: int) -> Heading | None:
    """Angles and speed as the entries after the position, if the position changes as they say."""
    if agent.n != 2 * d:
        return None
    guess = Heading(2 * d - 1, tuple(range(d, 2 * d - 1)))
    return None if doubtful(agent, d, _by_heading("", agent, d, guess)[0]) else guess


def doubtful(agent: AgentTrace, d: int, velocity: Array) -> bool:
    """Return True if velocities taken from the states are far from how the positions change."""
    derived = rates(agent.times, agent.states[:, :d])
    if derived is None:
        return False
    error = np.linalg.norm(derived - velocity, axis=1)
    size = np.linalg.norm(derived, axis=1) + np.linalg.norm(velocity, axis=1)
    return bool(np.median(error) > 0.2 * np.median(size))


def parse_velocity(velocity: str | None, heading: str | None, speed: int | None) -> Velocity:
    """Return the velocity that ``--velocity``, ``--heading`` and ``--speed`` choose together."""
    if heading is None and speed is None:
        return velocity if velocity in (None, "differences") else _entries("--velocity", velocity)
    if velocity is not None or speed is None:
        raise ScenarioError("--heading", heading, "must be given with --speed, and without --velocity")
    return Heading(speed, () if heading is None else tuple(_entries("--heading", heading)))


def _entries(option: str, text: str) -> list[int]:
    """Entries of the states out of a text like ``3,4,5``."""
    try:
        return [int(part) for part in text.split(",")]
    except ValueError as error:
        rule = "must be whole numbers with commas between" + ", or 'differences'" * (option == "--velocity")
        raise ScenarioError(option, text, rule) from error


def stamped_by_simulator(times: Array) -> bool:
    """Return True if the first two rows carry the same time, and no others do."""
    gaps = np.diff(times)
    return len(times) >= 3 and gaps[0] == 0 and bool(np.all(gaps[1:] > 0))


def restamp(trace: Trace) -> Trace:
    """The trace with true times and modes, from the stamps RTAEval's simulator gives.

    There the first two rows both carry t = 0 and every later state is stamped one step early;
    ``mode_trace[i]`` moved state i-1 to state i. Here every state gets its own time and every mode is in
    force from its time on (N-1 modes for N states). Unsafe sets that carry such stamps are treated the same;
    others keep theirs.

    Raises `ScenarioError` if an agent does not carry such stamps.
    """
    for name, agent in trace.agents.items():
        if not stamped_by_simulator(agent.times):
            rule = "must be three rows or more, only the first two with the same time, to be restamped"
            raise ScenarioError(f"agents.{name}.state_trace", agent.times[:3].tolist(), rule)
    unsafe = {
        name: replace(item, times=_next(item.times)) if stamped_by_simulator(item.times) else item
        for name, item in trace.unsafe.items()
    }
    agents = {
        name: replace(item, times=_next(item.times), modes=np.r_[item.modes, UNKNOWN][1 : len(item.times)])
        for name, item in trace.agents.items()
    }
    return replace(trace, agents=agents, unsafe=unsafe)


def _next(times: Array) -> Array:
    return np.append(times[1:], 2 * times[-1] - times[-2])


def between(stamps: Array, t: Array) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    """Rows on either side of every time and the share of the way, each (N,); at rest before and after all.

    Of rows with the same stamp the last counts, unless both have the same stamps throughout.
    """
    if np.array_equal(stamps, t):
        rows = np.arange(len(t))
        return rows, rows, np.zeros(len(t))
    left = np.clip(np.searchsorted(stamps, t, side="right") - 1, 0, len(stamps) - 1)
    right = np.minimum(left + 1, len(stamps) - 1)
    gap = stamps[right] - stamps[left]
    share = np.divide(t - stamps[left], gap, out=np.zeros(len(t)), where=gap > 0)
    share = np.clip(share, 0.0, 1.0)
    return left, np.where(share > 0, right, left), share


def interpolate(values: Array, rows: tuple[NDArray[np.int64], NDArray[np.int64], Array]) -> Array:
    """Linear between stamps; values (M, ...), `rows` from `between`, result (N, ...)."""
    left, right, share = rows
    share = share.reshape(-1, *[1] * (values.ndim - 1))
    return np.asarray(values[left] * (1 - share) + values[right] * share)


def rates(stamps: Array, values: Array) -> Array | None:
    """Rates (M, k) of values at their stamps by second-order differences; None for one instant only.

    Of rows with the same stamp the last is used, and all of them get its rate.
    """
    last = np.r_[np.diff(stamps) > 0, True]
    if last.sum() < 2:
        return None
    slopes = np.gradient(values[last], stamps[last], axis=0)
    return np.asarray(slopes[np.cumsum(np.r_[False, last[:-1]])])
