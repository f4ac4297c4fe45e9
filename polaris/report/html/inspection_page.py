"""What the report of an inspection flight draws: deputies about the chief, constraint margins, thrust."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from ...inspection.constraints.allowable_set import allowable
from ...inspection.constraints.catalogue import PASSIVE
from ...inspection.flights.fuel_run import FuelRun
from ...inspection.flights.simulation import InspectionRun
from ...inspection.inspection import Inspection
from ...model.system import Array
from ...runs.folder import RunFolder
from ...runs.inspection_summary import MEANING
from ..figures.inspection.common import colour
from ..figures.style import BLACK, BLUE, GREEN, GREY, ORANGE, PURPLE, RED, SKY, VERMILION
from . import layers, timelines
from .layers import Layer
from .numbers import plain
from .solids import Surface, ball

AXES = ["Along-track (m)", "Radial (m)", "Cross-track (m)"]
ORDER = [1, 0, 2]
"""Hill's coordinates in the order of the axes."""

ANSWERS = [
    {"mode": 0, "name": "wanted thrust applied", "colour": "#BFD7E6"},
    {"mode": 1, "name": "filtered", "colour": ORANGE},
    {"mode": 2, "name": "no answer satisfies all: violated least", "colour": PURPLE},
    {"mode": 3, "name": "failed: no thrust", "colour": RED},
    {"mode": 4, "name": "backup", "colour": GREEN},
    {"mode": 5, "name": "backup, not proven", "colour": RED},
]
LINES = (BLACK, BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY)


def flight_data(folder: RunFolder) -> dict[str, Any]:
    """What the page's script draws of a flight of several deputies.

    Raises
    ------
    ScenarioError
        If a file is missing or damaged.
    """
    run = folder.picture()
    q = run.inspection
    chosen = timelines.kept(len(run.t), run.status.T)
    t, held = run.t[chosen], np.minimum(chosen, len(run.u) - 1)
    margins = allowable(q, run.x[chosen], run.sun[chosen])
    families = folder.scenario.families()
    h = families(run.x[chosen], run.sun[chosen]).h
    for name, family in PASSIVE.items():
        columns = [k for k, one in enumerate(families.family) if one == family]
        if columns:
            margins[name] = h[:, columns]
    pilots = [
        timelines.pilot(
            f"deputy{i}",
            f"deputy {i}",
            ["flight"],
            t,
            run.x[chosen][None, :, i, ORDER],
            run.status[held[:-1], i][None],
            colour=colour(i),
            dash="solid",
            on=True,
        )
        for i in range(q.deputies)
    ]
    return {
        "scene": _scene(q, [run.x[:, i] for i in range(q.deputies)], _sun(run, chosen)),
        "end": plain(run.t[-1]),
        "open": plain(_closest(t, margins)),
        "modes": [one for one in ANSWERS if one["mode"] in run.status],
        "modes_title": "Answers of the filter",
        "by": "pilot",
        "pilots": pilots,
        "panels": [*_margins(t, margins), *_thrusts(q, run.u[held])],
    }


def fuel_data(run: FuelRun) -> dict[str, Any]:
    """What the page's script draws of a flight into the fuel limit."""
    q = run.inspection
    backup = np.zeros(len(run.u), dtype=int)
    if run.latched_at is not None:
        backup[run.t[:-1] >= run.latched_at] = 1
    chosen = timelines.kept(len(run.t), backup)
    held = np.minimum(chosen, len(run.u) - 1)
    left = {"t": plain(run.t[chosen]), "y": plain(q.delta_v_max - run.delta_v[chosen])}
    fuel = {
        "key": "fuel",
        "title": "Velocity change that is left",
        "unit": "m/s",
        "limits": [timelines.limit(0.0, "fuel limit", "below")],
        "series": [{"pilot": None, "name": "left", "colour": BLACK} | left],
    }
    flights = np.vstack(
        [part for one in run.predictions for part in (one.x[::4, :3], np.full((1, 3), np.nan))]
    )
    drawn = [layers.line("backup flights as predicted", flights[:, ORDER], "predicted", SKY, 1.5)]
    who = backup[held[:-1]][None]
    style: Mapping[str, Any] = {"colour": BLUE, "dash": "solid", "on": True}
    return {
        "scene": _scene(q, [run.x], drawn if run.predictions else []),
        "end": plain(run.t[-1]),
        "open": plain(run.t[-1] if run.latched_at is None else run.latched_at),
        "modes": [
            {"mode": 0, "name": "primary controller", "colour": ORANGE},
            {"mode": 1, "name": "backup controller", "colour": BLUE},
        ],
        "modes_title": timelines.WHO,
        "by": "mode",
        "pilots": [
            timelines.pilot(
                "deputy0", "deputy", ["flight"], run.t[chosen], run.x[chosen][None][..., ORDER], who, **style
            )
        ],
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


def _margins(t: Array, found: Mapping[str, Array]) -> list[timelines.Panel]:
    """One panel per unit, one line per constraint: the least over deputies or pairs."""
    panels = []
    for unit in dict.fromkeys(unit for _, unit in MEANING.values()):
        series: list[dict[str, Any]] = []
        for name, (meaning, own) in MEANING.items():
            if own == unit and name in found and found[name].shape[1]:
                line = {"t": plain(t), "y": plain(found[name].min(axis=1)), "colour": LINES[len(series) % 7]}
                series.append({"pilot": None, "name": name, "meaning": meaning} | line)
        if series:
            panels.append(
                {
                    "key": f"margin-{unit}",
                    "title": "Least margin over all deputies",
                    "unit": unit,
                    "limits": [timelines.limit(0.0, "violated", "below")],
                    "series": series,
                }
            )
    return panels


def _thrusts(q: Inspection, u: Array) -> list[timelines.Panel]:
    """Thrust of every deputy along each axis, u of shape (N, deputies, 3) [N]."""
    most = q.thrust_max
    return [
        {
            "key": f"input{axis}",
            "title": f"Thrust, {name}",
            "unit": "N",
            "limits": [
                timelines.limit(-most, "", "below"),
                timelines.limit(most, f"limit {most:g}", "above"),
            ],
            "series": [
                {"pilot": f"deputy{i}", "step": True, "runs": plain(u[None, :, i, axis])}
                for i in range(u.shape[1])
            ],
        }
        for axis, name in enumerate(("radial", "along-track", "cross-track"))
    ]


def _scene(q: Inspection, paths: list[Array], more: list[Layer]) -> dict[str, Any]:
    chief = ball(q.separation)
    angle = np.linspace(0, 2 * np.pi, 73)
    ring = q.distance_max * np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
    gap = np.full((1, 3), np.nan)
    rings = np.vstack([part for turn in range(3) for part in (np.roll(ring, turn, axis=1), gap)])
    far = max(float(np.abs(path[:, :3]).max()) for path in paths)
    edge = 1.08 * max(far, 2 * q.separation)
    named = {"label": "chief"}
    found = [
        layers.mesh("chief: keep-out sphere", Surface(chief.points, chief.faces), "unsafe", RED, 0.6) | named,
        layers.line(f"keep-in sphere, {q.distance_max:g} m", rings, "keep", GREY, 1),
        *more,
    ]
    return {"space": 3, "equal": True, "axes": AXES, "range": [plain([-edge, edge])] * 3, "layers": found}


def _sun(run: InspectionRun, chosen: Any) -> list[Layer]:
    """Where the sun stands: a line from the chief towards it."""
    reach = 0.9 * float(np.abs(run.x[..., :3]).max())
    angle = run.sun[chosen]
    ends = reach * np.stack([np.sin(angle), np.cos(angle), np.zeros_like(angle)], axis=1)
    start = np.zeros(3)
    frames = [{"p": plain(np.stack([start, end]).T)} for end in ends]
    line = layers.line("towards the sun", np.zeros((2, 3)), "sun", ORANGE, 3, "dash")
    return [layers.framed(line, run.t[chosen], frames)]
