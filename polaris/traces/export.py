"""Runs as traces: from bare arrays, run folders and comparison folders."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from reach.short_repr import short_repr

from ..model.checks import one_of
from ..model.errors import ScenarioError
from ..model.scene.keep_in import KeepInPolytope
from ..model.scene.obstacle import Obstacle, RigidObstacle
from ..model.scene.obstacles import BallObstacle, BoxObstacle
from ..model.scene.satellite import SatelliteObstacle
from ..model.scene.state_limits import StateLimit
from ..model.system import Array, LinearSystem
from ..model.tolerances import TIME
from .model import SAFETY, UNTRUSTED, AgentTrace, AnySet, BallTrace, PolytopeTrace, RectangleTrace, Trace


@short_repr
@dataclass(frozen=True, eq=False)
class Export:
    """A run as a trace."""

    trace: Trace
    notes: tuple[str, ...]  # what is not represented as it is, and on which side it errs


def to_trace(
    times: ArrayLike,
    states: ArrayLike,
    modes: ArrayLike,
    obstacles: Sequence[Obstacle],
    system: LinearSystem,
    *,
    name: str = "chaser",
    running_times: ArrayLike = (),
    satellites: Mapping[str, ArrayLike | None] | None = None,
) -> Export:
    """One run as a trace with its unsafe sets, all stamped alike.

    Parameters
    ----------
    times : array_like, shape (N+1,)
        [s]
    states : array_like, shape (N+1, n)
        Their first entries must be the position.
    modes : array_like of int, shape (N,) or (N+1,)
        Mode of Polaris from every time on to the next: 0 is S, 1 and above are experimental, below 0 unknown.
        Given N, the last is repeated for the last state.
    obstacles : sequence of Obstacle
        Boxes, balls and polytopes become what they are; another satellite its timed polytope; a keep-in
        set one unbounded polytope per facet, called ``name[f]``, with the time in which it holds; limits on
        the whole state are margins of the agent.
    system : LinearSystem
    name : str
        Of the agent.
    running_times : array_like, optional
        Wall time of each decision [s].
    satellites : mapping, optional
        True states (N+1, n) of other satellites, by name, or None for where they are nominally. They become
        balls about these instead.

    Raises
    ------
    ScenarioError
        On shapes that do not fit, or states that do not begin with the position.
    """
    limits = [one for one in obstacles if isinstance(one, StateLimit)]
    agent = _agent(name, system, np.asarray(times, dtype=float), states, modes, running_times)
    if limits:
        clearances = np.array([one.signed_distance(agent.times, agent.states, system) for one in limits])
        agent = replace(agent, limits=tuple(one.name for one in limits), margins=clearances)
    unsafe: dict[str, AnySet] = {}
    notes: list[str] = []
    for obstacle in obstacles:
        sets, note = _sets(obstacle, agent.times, system, satellites or {})
        notes += [note] if note else []
        for key, item in sets.items():
            if key in unsafe:
                raise ScenarioError(f"{obstacle.path}.name", key, "must differ from the names of other sets")
            unsafe[key] = replace(item, span=obstacle.span)
    return Export(Trace({name: agent}, unsafe), tuple(notes))


def _agent(
    name: str, system: LinearSystem, t: Array, states: ArrayLike, modes: ArrayLike, running_times: ArrayLike
) -> AgentTrace:
    if not np.array_equal(system.position, np.eye(system.d, system.n)):
        position = system.position.tolist()
        raise ScenarioError("system.C", position, "must choose the first states as position")
    mode_array, count = np.asarray(modes), np.size(t)
    if mode_array.ndim != 1 or not np.issubdtype(mode_array.dtype, np.integer):
        raise ScenarioError("modes", mode_array.shape, "must be a list of whole numbers")
    if len(mode_array) not in (count - 1, count):
        raise ScenarioError("modes", mode_array.shape, f"must be {count - 1}, one per step, or {count}")
    mode_array = np.pad(mode_array, (0, count - len(mode_array)), mode="edge")
    trace_modes = np.select([mode_array > 0, mode_array == 0], [UNTRUSTED, SAFETY], mode_array)
    x, durations = np.asarray(states, dtype=float), np.asarray(running_times, dtype=float)
    agent = AgentTrace(t, x, trace_modes, durations, where=f"agents.{name}")
    if agent.n != system.n:
        rule = f"must have {system.n} columns, as the system has states"
        raise ScenarioError("states", agent.states.shape, rule)
    return agent


def _sets(
    obstacle: Obstacle, t: Array, system: LinearSystem, satellites: Mapping[str, ArrayLike | None]
) -> tuple[dict[str, AnySet], str | None]:
    """Sets of a trace for one obstacle, and notes on them."""
    name = obstacle.name
    if isinstance(obstacle, StateLimit):
        note = f"{name}: limit on the whole state, as the chaser's clearance to it (1 m/s counts as 100 m)"
        return {}, note
    if isinstance(obstacle, SatelliteObstacle) and name in satellites:
        states, radii = satellites[name], np.full(len(t), obstacle.radius)
        centre, velocity = obstacle.motion(t, system, states)
        ball = BallTrace(t, centre, radii, velocity)
        note = f"{name}: another satellite, as a ball about where it is nominally"
        return {name: ball}, note if states is None else None
    if isinstance(obstacle, BallObstacle):
        return {name: BallTrace(t, obstacle.centre(t), np.full(len(t), obstacle.radius))}, None
    if isinstance(obstacle, BoxObstacle):
        centers, lengths = obstacle.centre(t), 2 * np.asarray(obstacle.half_widths)
        return {name: RectangleTrace(t, centers, np.broadcast_to(lengths, centers.shape))}, None
    if isinstance(obstacle, RigidObstacle):
        cover, positions = obstacle.cover, obstacle.centre(t)
        note = f"{name}: as the polytope around it (over-approximated)"
        traced = PolytopeTrace(t, cover.H[None], cover.b + positions @ cover.H.T)
        return {name: traced}, None if cover is obstacle.shape else note
    if isinstance(obstacle, KeepInPolytope):  # the set itself at all times: the trace says when it holds
        obstacle = replace(obstacle, begins=-np.inf, ends=np.inf)
    sets = _covers(obstacle, t, system)
    if isinstance(obstacle, SatelliteObstacle):
        return sets, f"{name}: another satellite, as the polytope it is certain to be in (over-approximated)"
    if len(sets) == 1:
        return sets, None
    return sets, (
        f"{name}: a keep-in set, as one set beyond each of its {len(sets)} facets; a cone is cut by its"
        " facets (over-approximated), and depth is measured facet by facet"
    )


def _covers(obstacle: Obstacle, t: Array, system: LinearSystem) -> dict[str, AnySet]:
    """Timed polytopes at even times from 0 s; at the border of two cells the larger offset counts."""
    gaps = np.diff(t)
    if t[0] != 0 or len(gaps) == 0 or np.ptp(gaps) > TIME * t[-1]:
        rule = f"must begin at 0 and be evenly spaced for {obstacle.name}"
        raise ScenarioError("times", t[:3].tolist(), rule)
    out: dict[str, AnySet] = {}
    for part in obstacle.timed_polytopes(system, float(t[-1] / len(gaps)), len(gaps)):
        first, last = part.offsets[:, 0], part.offsets[:, 1]
        offsets = np.vstack([first[:1], np.maximum(first[1:], last[:-1]), last[-1:]])
        out[part.name] = PolytopeTrace(t, part.normals[None], offsets)
    return out


def export_run(
    folder: str | Path, controller: str | None = None, label: str = "closest", *, nominal: bool = False
) -> Export:
    """One flight of a run folder or a comparison folder, as a trace.

    Parameters
    ----------
    folder : path
        A folder that ``polaris run`` or ``polaris compare`` wrote.
    controller : str, optional
        Whose flight. In a run folder: ``polaris`` (default), ``safety``, ``experimental`` (the preferred
        one), ``experimental_2``, ... In a comparison: ``schedule`` (default), ``monitor``,
        ``asif_implicit``, ...; while an input is filtered, the mode is unknown.
    label : str
        Flight to export: ``closest``, ``nominal`` (not in a comparison), ``run 0``, ...
    nominal : bool
        Take other satellites for balls about where they are nominally.

    Raises
    ------
    ScenarioError
        If the folder is none, is damaged, or has no such flight.
    """
    from ..runs.files.arrays import read_flights
    from ..runs.files.folder import readable
    from ..runs.run import read_run

    run = read_run(folder)
    option = "--method" if run.kind.name == "comparison" else "--controller"
    if option == "--method":
        flights: Mapping[str, Any] = run.plot_data().shown
    else:
        with readable(run.path):
            flights = read_flights(run.path / "trajectories.npz")
    controller = controller or ("schedule" if option == "--method" else "polaris")
    one_of(option, controller, flights)
    flight = flights[controller]
    one_of("--run", label, flight.labels)
    row = flight.labels.index(label)
    if option == "--method":
        modes = flight.modes[row]
    else:
        modes = np.repeat(flight.modes, (len(flight.times) - 1) // len(flight.modes))
    obstacles, system = run.scenario.obstacles(), run.scenario.system()
    others = dict.fromkeys(item.name for item in obstacles) if nominal else None
    return to_trace(flight.times, flight.states[row], modes, obstacles, system, satellites=others)
