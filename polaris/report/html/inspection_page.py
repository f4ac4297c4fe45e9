"""What the report of an inspection flight draws: deputies about the chief, constraint margins, thrust."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ...inspection.constraints.allowable_set import allowable
from ...inspection.constraints.catalogue import PASSIVE
from ...inspection.flights.fuel_run import FuelRun
from ...inspection.flights.simulation import InspectionRun
from ...inspection.inspection import Inspection
from ...model.system import Array
from ...runs.folder import RunFolder
from ...runs.inspection import MEANING
from ..scene.geometry import Shape, gapped
from ..scene.inspection import AXES, ORDER, surroundings, thrust_charts
from ..scene.items import Item
from ..scene.palette import ANSWERS, BACKUP_MODES, BLACK, BLUE, LOOKS, MARGIN_COLOURS, deputy_colour
from .numbers import plain
from .scene import layer
from .timelines import WHO, Panel, Pilot, input_panel, kept, limit, panel


def flight_data(folder: RunFolder) -> dict[str, Any]:
    """What the page's script draws of a flight of several deputies.

    Raises
    ------
    ScenarioError
        If a file is missing or damaged.
    """
    run = folder.picture()
    q = run.inspection
    chosen = kept(len(run.t), run.status.T)
    t, held = run.t[chosen], np.minimum(chosen, len(run.u) - 1)
    margins = allowable(q, run.x[chosen], run.sun[chosen])
    families = folder.scenario.families()
    h = families(run.x[chosen], run.sun[chosen]).h
    for name, family in PASSIVE.items():
        columns = [k for k, one in enumerate(families.family) if one == family]
        if columns:
            margins[name] = h[:, columns]
    pilots = [
        _pilot(f"deputy{i}", f"deputy {i}", deputy_colour(i), t, run.x[chosen, i], run.status[held[:-1], i])
        for i in range(q.deputies)
    ]
    return {
        "scene": _scene(q, run.x[..., :3], _sun(run, chosen)),
        "end": plain(run.t[-1]),
        "open": plain(_closest(t, margins)),
        "modes": _modes(ANSWERS, run.status),
        "modes_title": "Answers of the filter",
        "by": "pilot",
        "pilots": pilots,
        "panels": [*_margins(t, margins), *_thrusts(q, run.u[held])],
    }


def fuel_data(run: FuelRun) -> dict[str, Any]:
    """What the page's script draws of a flight into the fuel limit."""
    q, end = run.inspection, float(run.t[-1])
    latched = end if run.latched_at is None else run.latched_at
    backup = (run.t[:-1] >= latched).astype(int)
    chosen = kept(len(run.t), backup)
    t, held = run.t[chosen], np.minimum(chosen, len(run.u) - 1)
    left = {"t": plain(t), "y": plain(q.delta_v_max - run.delta_v[chosen])}
    series = [{"pilot": None, "name": "left", "colour": BLACK} | left]
    limits = [limit(0.0, "fuel limit", "below")]
    fuel = panel("fuel", "Velocity change that is left", "m/s", limits, series)
    drawn = []
    if run.predictions:
        flights = Shape("line", gapped((one.x[::4, ORDER] for one in run.predictions), 3))
        drawn = [Item("predicted", LOOKS["predicted"].name, (flights,))]
    return {
        "scene": _scene(q, run.x[:, :3], drawn),
        "end": plain(end),
        "open": plain(latched),
        "modes": _modes(BACKUP_MODES, (0, 1)),
        "modes_title": WHO,
        "by": "mode",
        "pilots": [_pilot("deputy0", "deputy", BLUE, t, run.x[chosen], backup[held[:-1]])],
        "panels": [fuel, *_thrusts(q, run.u[held][:, None])],
    }


def _closest(t: Array, margins: Mapping[str, Array]) -> float:
    """When a deputy has least room of all to a limit of a distance [s]."""
    own = [
        found.min(axis=1)
        for name, found in margins.items()
        if found.shape[1] and MEANING.get(name, ("", ""))[1] == "m"
    ]
    return float(t[np.argmin(np.min(own, axis=0))] if own else 0.0) or float(t[-1])


def _margins(t: Array, found: Mapping[str, Array]) -> list[Panel]:
    """One panel per unit, one line per constraint: the least over deputies or pairs."""
    panels = []
    for unit in dict.fromkeys(unit for _, unit in MEANING.values()):
        series: list[dict[str, Any]] = []
        for name, (meaning, own) in MEANING.items():
            if own == unit and name in found and found[name].shape[1]:
                line = {"t": plain(t), "y": plain(found[name].min(axis=1))}
                line["colour"] = MARGIN_COLOURS[len(series) % len(MARGIN_COLOURS)]
                series.append({"pilot": None, "name": name, "meaning": meaning} | line)
        if series:
            title, limits = "Least margin over all deputies", [limit(0.0, "violated", "below")]
            panels.append(panel(f"margin-{unit}", title, unit, limits, series))
    return panels


def _thrusts(q: Inspection, u: Array) -> list[Panel]:
    """Thrust of every deputy along each axis, u of shape (N, deputies, 3) [N]."""
    panels = []
    for axis, (name, chart) in enumerate(zip(AXES, thrust_charts(q, u), strict=True)):
        lines = enumerate(chart.lines.T)
        series = [{"pilot": f"deputy{i}", "step": True, "runs": plain(line[None])} for i, line in lines]
        panels.append(input_panel(axis, f"Thrust, {name.lower()}", "N", q.thrust_max, series, "g"))
    return panels


def _pilot(key: str, name: str, colour: str, t: Array, x: Array, modes: NDArray[np.int_]) -> Pilot:
    """One deputy with states (N, 6); `modes` say what flew it from each sample on."""
    run = {"p": plain(x[:, ORDER].T), "modes": plain(modes)}
    told = {"key": key, "name": name, "labels": ["flight"], "t": plain(t), "runs": [run]}
    return told | {"colour": colour, "dash": "solid", "on": True}


def _modes(table: Mapping[int, tuple[str, str]], present: ArrayLike) -> list[dict[str, Any]]:
    known = set(np.unique(present).tolist())
    return [
        {"mode": mode, "name": name, "colour": colour}
        for mode, (name, colour) in table.items()
        if mode in known
    ]


def _scene(q: Inspection, paths: Array, more: list[Item]) -> dict[str, Any]:
    edge = 1.08 * max(float(np.abs(paths).max()), 2 * q.separation)
    return {
        "space": 3,
        "equal": True,
        "axes": [f"{AXES[k]} (m)" for k in ORDER],
        "range": [plain([-edge, edge])] * 3,
        "layers": [layer(item) for item in (*surroundings(q), *more)],
    }


def _sun(run: InspectionRun, chosen: Any) -> list[Item]:
    """Where the sun stands: a line from the chief towards it."""
    reach = 0.9 * float(np.abs(run.x[..., :3]).max())
    angle = run.sun[chosen]
    ends = reach * np.stack([np.sin(angle), np.cos(angle), np.zeros_like(angle)], axis=1)
    shapes = tuple(Shape("line", np.stack([np.zeros(3), end])) for end in ends)
    return [Item("sun", LOOKS["sun"].name, shapes, run.t[chosen])]
