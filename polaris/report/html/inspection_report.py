"""The page of the inspection problem: a flight, a fuel limit, or a campaign (tables alone)."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from markupsafe import Markup

from ...inspection.constraints.allowable_set import allowable
from ...inspection.constraints.constraint import PASSIVE
from ...inspection.flights.fuel_run import FuelRun
from ...inspection.inspection import Inspection
from ...model.checks import counted
from ...model.system import Array
from ...runs.files.folder import RunFolder
from ...runs.inspections.inspection import MEANING
from ..scene import palette
from ..scene.geometry import Shape, gapped
from ..scene.items import Item
from ..scene.unsafe import AXES, ORDER, surroundings
from .page import Cell, Measure, Page, badge, macros, number_cell, reading, table, text_cell
from .scene import layer, plain
from .timelines import WHO, input_panels, kept, limit, modes_present, panel, pilot

LIMITS = (
    "That the next program of the filter has a solution, unless it says so above.",
    "Anything if an assumption fails: another motion, later commands, larger errors of thrust or estimates.",
    "Anything beyond this flight: simulated flights illustrate, they prove nothing.",
)

ELSEWHERE = {
    *("schema_version", "scenario", "kind", "title", "guarantee", "definitions", "seconds", "versions"),
    *("created", "constraints", "barriers", "studies"),
}
"""Keys of a summary that the table of its values leaves out."""


def inspection_page(folder: RunFolder) -> Page:
    """The report of a run folder of the inspection problem."""
    summary, kind = folder.summary, folder.scenario.kind
    claim = summary["guarantee"]
    kinds = macros("run.html")
    lead = Markup(kinds.lead(summary["scenario"], badge(claim["kind"]), summary.get("safe")))
    data: dict[str, Any] = {}
    parts = [("numbers", "Metrics", _values(summary))]
    if kind == "inspection":
        data = flight_data(folder)
        parts.insert(0, ("constraints", "Constraints", _constraints(summary)))
    elif kind == "fuel_limit":
        data = fuel_data(folder.picture())
    else:
        parts.insert(0, ("studies", "Studies", _studies(summary)))
    told = Markup(kinds.other_guarantee(claim, badge(claim["kind"]), LIMITS))
    parts.append(("guarantee", "What is claimed", told))
    return Page(str(summary["title"]), lead, (*parts, reading(summary)), data, summary)


def _share(value: Any, bad: bool = False) -> Cell:
    return Cell(Measure.of("_share").text(value), value, bad=bad)


def _constraints(summary: Mapping[str, Any]) -> Markup:
    rows = [
        [
            Cell(str(row["constraint"])),
            text_cell(MEANING.get(row["constraint"], (row["meaning"], ""))[0]),
            replace(number_cell(row["least"], unit=row["unit"]), bad=(row["least"] or 0) < 0),
            number_cell(row["time_s"], unit="s"),
            text_cell(", ".join(map(str, row["deputies"]))),
            _share(row["violated_share"], bad=bool(row["violated_share"])),
        ]
        for row in summary["constraints"]
    ]
    heads = ["constraint", "meaning", "least", "at", "deputies", "share of instants violated"]
    caption = "Least value of every constraint over the flight; negative is a violation"
    return table(caption, heads, rows, sort=True)


def _values(summary: Mapping[str, Any]) -> Markup:
    """Every value of a summary that is not shown elsewhere."""
    rows = []
    for key, value in summary.items():
        if key in ELSEWHERE:
            continue
        for title, name, one in _flat(Measure.of(key).title, key, value):
            unit = "s" if key.endswith("_seconds") else Measure.of(name).unit
            rows.append([Cell(title), number_cell(one, key, unit="" if unit == "%" else unit)])
    return table("Values of summary.json", ["", "value"], rows)


def _flat(title: str, key: str, value: Any) -> Iterator[tuple[str, str, Any]]:
    """Title, key and value of everything in a value of a summary, however deep."""
    if not isinstance(value, Mapping):
        yield title, key, "none" if value in ([], ()) else value
        return
    for name, one in value.items():
        yield from _flat(f"{title}, {name.replace('_', ' ')}", name, one)


def _studies(summary: Mapping[str, Any]) -> Markup:
    kinds = sorted({kind for study in summary["studies"] for kind in study["failures"]})
    rows = []
    for study in summary["studies"]:
        shares = (study[key] for key in ("success_share", "success_share_lower_95", "interventions_share"))
        counts = (int(study["failures"].get(kind, 0)) for kind in kinds)
        rows.append(
            [
                Cell(str(study["name"])),
                number_cell(study["successes"]),
                *map(_share, shares),
                number_cell(study["delta_v_mean_m_s"], unit="m/s"),
                *(Cell(str(count), count, bad=count > 0) for count in counts),
            ]
        )
    heads = ["study", "safe runs", "share", "at least, 95 %", "interventions", "velocity change", *kinds]
    return table(f"{counted(summary['runs'], 'run')} each", heads, rows, sort=True)


LOOK = {"dash": "solid", "on": True}
THRUSTS = tuple(f"Thrust, {name.lower()}" for name in AXES)


def flight_data(folder: RunFolder) -> dict[str, Any]:
    """Return the plot data of a flight of several deputies."""
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
        pilots.append(own | {"colour": palette.deputy_colour(i)} | LOOK)
        drawn.append((f"deputy{i}", u[None, :, i], None))
    reach, angle = 0.9 * float(np.abs(run.x[..., :3]).max()), run.sun[chosen]
    ends = reach * np.stack([np.sin(angle), np.cos(angle), np.zeros_like(angle)], axis=1)
    rays = tuple(Shape("line", np.stack([np.zeros(3), end])) for end in ends)
    return {
        "scene": _scene(q, run.x[..., :3], [Item("sun", rays, times=t)]),
        "end": plain(t[-1]),
        "open": plain(_closest(t, margins)),
        "modes": modes_present(run.status, palette.ANSWERS.__getitem__),
        "modes_title": "Answers of the filter",
        "by": "pilot",
        "pilots": pilots,
        "panels": [*_margin_panels(t, margins), *input_panels(THRUSTS, "N", [q.thrust_max] * 3, drawn)],
    }


def fuel_data(run: FuelRun) -> dict[str, Any]:
    """Return the plot data of a flight into the fuel limit."""
    q = run.inspection
    latched = float(run.t[-1]) if run.latched_at is None else run.latched_at
    backup = (run.t[:-1] >= latched).astype(int)
    chosen = kept(len(run.t), backup)
    t, held = run.t[chosen], np.minimum(chosen, len(run.u) - 1)
    left = {"t": plain(t), "y": plain(q.delta_v_max - run.delta_v[chosen])}
    series = [{"pilot": None, "name": "left", "colour": palette.BLACK} | left]
    fuel = panel("fuel", "Velocity change that is left", "m/s", [limit(0.0, "fuel limit", "below")], series)
    flights = Shape("line", gapped((one.x[::4, ORDER] for one in run.predictions), 3))
    predicted = [Item("predicted", (flights,))] if run.predictions else []
    own = pilot("deputy0", "deputy", ["flight"], t, run.x[None, chosen][..., ORDER], backup[None, held[:-1]])
    thrust = [("deputy0", run.u[None, held], None)]
    return {
        "scene": _scene(q, run.x[:, :3], predicted),
        "end": plain(t[-1]),
        "open": plain(latched),
        "modes": modes_present((0, 1), palette.BACKUP_MODES.__getitem__),
        "modes_title": WHO,
        "by": "mode",
        "pilots": [own | {"colour": palette.BLUE} | LOOK],
        "panels": [fuel, *input_panels(THRUSTS, "N", [q.thrust_max] * 3, thrust)],
    }


def _closest(t: Array, margins: Mapping[str, Array]) -> float:
    """Return the time at which a deputy is closest to a limit on a distance [s]."""
    known = {name: found for name, found in margins.items() if found.shape[1]}
    own = [found.min(axis=1) for name, found in known.items() if MEANING.get(name, ("", ""))[1] == "m"]
    return float(t[np.argmin(np.min(own, axis=0))] if own else 0.0) or float(t[-1])


def _margin_panels(t: Array, found: Mapping[str, Array]) -> list[dict[str, Any]]:
    """One panel per unit, one line per constraint: the least over deputies or pairs."""
    panels = []
    for unit in dict.fromkeys(unit for _, unit in MEANING.values()):
        series: list[dict[str, Any]] = []
        for name, (meaning, own) in MEANING.items():
            if own == unit and name in found and found[name].shape[1]:
                line = {"t": plain(t), "y": plain(found[name].min(axis=1))}
                line["colour"] = palette.MARGIN_COLOURS[len(series) % len(palette.MARGIN_COLOURS)]
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
