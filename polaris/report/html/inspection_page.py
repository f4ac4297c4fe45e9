"""What the report of an inspection flight draws: deputies about the chief, constraint margins, thrust."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from ...inspection.constraints.allowable_set import allowable
from ...inspection.constraints.catalogue import PASSIVE
from ...inspection.flights.fuel_run import FuelRun
from ...inspection.inspection import Inspection
from ...model.system import Array
from ...runs.folder import RunFolder
from ...runs.inspection_summary import MEANING
from ..scene.geometry import Shape, gapped
from ..scene.inspection import AXES, ORDER, surroundings
from ..scene.items import Item
from ..scene.palette import ANSWERS, BACKUP_MODES, BLACK, BLUE, LOOKS, MARGIN_COLOURS, deputy_colour
from .scene import layer, plain
from .timelines import input_panels, kept, limit, modes_present, page_data, panel, pilot

LOOK = {"dash": "solid", "on": True}
THRUSTS = tuple(f"Thrust, {name.lower()}" for name in AXES)


def flight_data(folder: RunFolder) -> dict[str, Any]:
    """What the page's script draws of a flight of several deputies."""
    run = folder.picture()
    q, families = run.inspection, folder.scenario.families()
    chosen = kept(len(run.t), run.status.T)
    t, held = run.t[chosen], np.minimum(chosen, len(run.u) - 1)
    x, status, u = run.x[chosen], run.status[held[:-1]], run.u[held]
    margins = allowable(q, x, run.sun[chosen])
    h = families(x, run.sun[chosen]).h
    for name, family in PASSIVE.items():
        columns = [k for k, one in enumerate(families.family) if one == family]
        if columns:
            margins[name] = h[:, columns]
    pilots, drawn = [], []
    for i in range(q.deputies):
        own = pilot(f"deputy{i}", f"deputy {i}", ["flight"], t, x[None, :, i, ORDER], status[None, :, i])
        pilots.append(own | {"colour": deputy_colour(i)} | LOOK)
        drawn.append((f"deputy{i}", u[None, :, i], None))
    reach, angle = 0.9 * float(np.abs(run.x[..., :3]).max()), run.sun[chosen]
    ends = reach * np.stack([np.sin(angle), np.cos(angle), np.zeros_like(angle)], axis=1)
    rays = tuple(Shape("line", np.stack([np.zeros(3), end])) for end in ends)
    return page_data(
        _scene(q, run.x[..., :3], [Item("sun", LOOKS["sun"].name, rays, t)]),
        pilots,
        [*_margins(t, margins), *input_panels(THRUSTS, "N", [q.thrust_max] * 3, drawn)],
        modes=modes_present(run.status, ANSWERS.__getitem__),
        modes_title="Answers of the filter",
        by="pilot",
        opened=_closest(t, margins),
    )


def fuel_data(run: FuelRun) -> dict[str, Any]:
    """What the page's script draws of a flight into the fuel limit."""
    q = run.inspection
    latched = float(run.t[-1]) if run.latched_at is None else run.latched_at
    backup = (run.t[:-1] >= latched).astype(int)
    chosen = kept(len(run.t), backup)
    t, held = run.t[chosen], np.minimum(chosen, len(run.u) - 1)
    left = {"t": plain(t), "y": plain(q.delta_v_max - run.delta_v[chosen])}
    series = [{"pilot": None, "name": "left", "colour": BLACK} | left]
    fuel = panel("fuel", "Velocity change that is left", "m/s", [limit(0.0, "fuel limit", "below")], series)
    flights = Shape("line", gapped((one.x[::4, ORDER] for one in run.predictions), 3))
    predicted = [Item("predicted", LOOKS["predicted"].name, (flights,))] if run.predictions else []
    own = pilot("deputy0", "deputy", ["flight"], t, run.x[None, chosen][..., ORDER], backup[None, held[:-1]])
    return page_data(
        _scene(q, run.x[:, :3], predicted),
        [own | {"colour": BLUE} | LOOK],
        [fuel, *input_panels(THRUSTS, "N", [q.thrust_max] * 3, [("deputy0", run.u[None, held], None)])],
        modes=modes_present((0, 1), BACKUP_MODES.__getitem__),
        by="mode",
        opened=latched,
    )


def _closest(t: Array, margins: Mapping[str, Array]) -> float:
    """When a deputy has least room of all to a limit of a distance [s]."""
    own = [
        found.min(axis=1)
        for name, found in margins.items()
        if found.shape[1] and MEANING.get(name, ("", ""))[1] == "m"
    ]
    return float(t[np.argmin(np.min(own, axis=0))] if own else 0.0) or float(t[-1])


def _margins(t: Array, found: Mapping[str, Array]) -> list[dict[str, Any]]:
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


def _scene(q: Inspection, paths: Array, more: Sequence[Item]) -> dict[str, Any]:
    edge = 1.08 * max(float(np.abs(paths).max()), 2 * q.separation)
    return {
        "space": 3,
        "equal": True,
        "axes": [f"{AXES[k]} (m)" for k in ORDER],
        "range": [plain([-edge, edge])] * 3,
        "layers": [layer(item) for item in (*surroundings(q), *more)],
    }
