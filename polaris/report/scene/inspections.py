"""Flights of the inspection problem as plain data: the scene about the chief, and diagrams over time."""

from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...inspection.constraints.allowable_set import allowable
from ...inspection.constraints.constraint import PASSIVE
from ...inspection.constraints.families import Families
from ...inspection.flights.fuel_run import FuelRun
from ...inspection.flights.simulation import InspectionRun
from ...inspection.inspection import Inspection
from ...model.system import Array
from ...runs.inspections.inspection import MEANING
from ...simulation.baselines import FlightEnvelope
from . import palette
from .geometry import DrawnShape, gapped
from .items import Actor, Item, View
from .timelines import Instant, Limit, Panel, Series, Timeline, input_panels, modes_present, step_edges
from .unsafe import AXES, ORDER, surroundings

MOST_INSTANTS = 400  # most instants at which margins and the direction of the sun are shown
THRUSTS = tuple(f"Thrust, {name.lower()}" for name in AXES)
AFTER = 500.0  # time [s] for which a predicted flight is shown after its last thrust: nothing more is spent


def flight_view(run: InspectionRun) -> View:
    """Return the deputies' surroundings, and the direction of the sun."""
    chosen = _instants(run)
    reach, angle = 0.9 * float(np.abs(run.x[..., :3]).max()), run.sun[chosen]
    ends = reach * np.stack([np.sin(angle), np.cos(angle), np.zeros_like(angle)], axis=1)
    rays = tuple(DrawnShape("line", np.stack([np.zeros(3), end])) for end in ends)
    return _view(run.inspection, run.x[..., :3], [Item("sun", rays, times=run.t[chosen])])


def flight_timeline(run: InspectionRun, families: Families) -> Timeline:
    """Describe a flight of several deputies over time: margins of all constraints, and thrust."""
    q, chosen = run.inspection, _instants(run)
    t, x, sun = run.t[chosen], run.x[chosen], run.sun[chosen]
    margins = allowable(q, x, sun)
    h = families(x, sun).h
    for name, family in PASSIVE.items():
        columns = [k for k, one in enumerate(families.family) if one == family]
        if columns:
            margins[name] = h[:, columns]
    return Timeline(
        deputies(run),
        [*_margin_panels(t, margins), *thrust_panels(run)],
        modes_present(run.status, palette.ANSWERS.__getitem__),
        _closest(t, margins),
        "Answers of the filter",
    )


def deputies(run: InspectionRun) -> list[Actor]:
    """Return all deputies with their paths."""
    count, t, x, u, status = run.inspection.deputies, run.t, run.x, run.u, run.status
    return [_pilot(i, f"deputy {i}", t, x[:, i], u[:, i], status[:, i]) for i in range(count)]


def fuel_view(run: FuelRun) -> View:
    """Return the surroundings of a deputy, and the backup flights as they were predicted."""
    flights = DrawnShape("line", gapped((one.x[::4, ORDER] for one in run.predictions), 3))
    return _view(run.inspection, run.x[:, :3], [Item("predicted", (flights,))] if run.predictions else [])


def fuel_timeline(run: FuelRun) -> Timeline:
    """Describe a flight into the fuel limit over time: the velocity change spent, and thrust."""
    q, end = run.inspection, float(run.t[-1])
    latched = end if run.latched_at is None else run.latched_at
    backup = (run.t[:-1] >= latched).astype(int)
    thrust = Series(run.t, step_edges(run.u)[None], "deputy0")
    fuel = Limit(q.delta_v_max, "fuel limit", "above")
    delta_v = [Series(run.t, run.delta_v[None], "deputy0")]
    spent = Panel("fuel", "Delta-v so far", "Delta-v", "m/s", [fuel], delta_v)
    return Timeline(
        [_pilot(0, "deputy", run.t, run.x, run.u, backup)],
        [spent, *input_panels(THRUSTS, "N", [q.thrust_max] * 3, [thrust])],
        modes_present((0, 1), palette.BACKUP_MODES.__getitem__),
        latched,
        by="mode",
        marks=[] if run.latched_at is None else [Instant(run.latched_at, "backup takes over")],
    )


def predicted_fuel(run: FuelRun) -> list[Series]:
    """Return the velocity change that each predicted backup flight would spend."""
    look, series = palette.LOOKS["predicted"], []
    for one in run.predictions:
        times, values = np.append(one.t, one.t[-1] + AFTER), np.append(one.delta_v, one.delta_v[-1])
        series.append(Series(times, values, name=look.legend, colour=look.colour))
    return series


def diagrams(run: InspectionRun) -> dict[str, list[Panel]]:
    """Return the diagrams of all deputies by name; those of pairs if there are several deputies."""
    q, values = run.inspection, allowable(run.inspection, run.x, run.sun)
    speed = [Limit(-q.speed_max, "", "below"), Limit(q.speed_max, "", "above")]
    half = float(np.degrees(q.field_of_view / 2))
    sun = [Limit(half, "sun in the field of view", "below")]

    def panel(title: str, unit: str, limits: list[Limit], series: list[Series], log: bool = False) -> Panel:
        return Panel(title, title, title, unit, limits, series, log)

    velocities = [_of_deputies(run, run.x[..., 3 + k]) for k in range(3)]
    panels = {
        "velocity": [panel(name, "m/s", speed, v) for name, v in zip(AXES, velocities, strict=True)],
        "sun": [panel("Chief to sun", "degrees", sun, _of_deputies(run, np.degrees(values["phi4"]) + half))],
        "thrust": thrust_panels(run),
        "delta_v": [panel("Delta-v", "m/s", [], _of_deputies(run, run.delta_v))],
    }
    if q.deputies > 1:
        minimum, distances = q.deputy_separation, _of_pairs(run, values["phi2"] + q.deputy_separation)
        collision = [Limit(minimum, "collision", "below")]
        panels["separation"] = [panel("Distance of deputies", "m", collision, distances, log=True)]
        sun_angles = _of_pairs(run, np.degrees(values["phi5"]) + half)
        panels["deputy_sun"] = [panel("Deputy to sun", "degrees", sun, sun_angles)]
    return panels


def thrust_panels(run: InspectionRun) -> list[Panel]:
    """Return one diagram per component of the thrust of all deputies, between its limits."""
    return input_panels(THRUSTS, "N", [run.inspection.thrust_max] * 3, _of_deputies(run, step_edges(run.u)))


def _of_deputies(run: InspectionRun, values: Array) -> list[Series]:
    """Return the series of values (N, deputies, ...)."""
    return [Series(run.t, values[None, :, i], f"deputy{i}") for i in range(run.inspection.deputies)]


def _of_pairs(run: InspectionRun, values: Array) -> list[Series]:
    """Return the series of values (N, pairs), coloured by the first deputy and dashed by the second."""
    series = []
    for (i, j), line in zip(run.inspection.pairs.tolist(), values.T, strict=True):
        dash = palette.METHOD_DASHES[j % len(palette.METHOD_DASHES)]
        series.append(Series(run.t, line, name=f"{i} and {j}", colour=palette.deputy_colour(i), dash=dash))
    return series


def _margin_panels(t: Array, margins: Mapping[str, Array]) -> list[Panel]:
    """Return one diagram per unit, with a line per constraint: the least over deputies or pairs."""
    panels = []
    for unit in dict.fromkeys(unit for _, unit in MEANING.values()):
        names = [name for name in MEANING if MEANING[name][1] == unit and np.size(margins.get(name, ()))]
        series = [
            Series(t, margins[name].min(axis=1), name=name, meaning=MEANING[name][0], colour=colour)
            for name, colour in zip(names, cycle(palette.MARGIN_COLOURS))
        ]
        if series:
            title, limits = "Least margin over all deputies", [Limit(0.0, "violated", "below")]
            panels.append(Panel(f"margin-{unit}", title, "Margin", unit, limits, series))
    return panels


def _closest(t: Array, margins: Mapping[str, Array]) -> float:
    """Return the time at which a deputy is closest to a limit on a distance [s]."""
    nonempty = {name: rows for name, rows in margins.items() if rows.shape[1]}
    minima = [rows.min(axis=1) for name, rows in nonempty.items() if MEANING.get(name, ("", ""))[1] == "m"]
    return float(t[np.argmin(np.min(minima, axis=0))] if minima else 0.0) or float(t[-1])


def _instants(run: InspectionRun) -> NDArray[np.intp]:
    """Return the samples at which margins and the direction of the sun are shown."""
    return np.unique(np.linspace(0, len(run.t) - 1, min(MOST_INSTANTS, len(run.t))).astype(np.intp))


def _pilot(i: int, name: str, t: Array, x: Array, u: Array, modes: NDArray[np.integer[Any]]) -> Actor:
    unknown = np.full((3, len(t)), np.nan)
    flights = FlightEnvelope(name, ("flight",), t, x[None], u[None], modes[None].astype(int), unknown)
    return Actor(f"deputy{i}", name, name, palette.deputy_colour(i), "solid", flights)


def _view(q: Inspection, paths: Array, more: Sequence[Item]) -> View:
    edge = np.full(3, 1.08 * max(float(np.abs(paths).max()), 2 * q.separation))
    labels = tuple(f"{AXES[k]} (m)" for k in ORDER)
    return View(ORDER, labels, -edge, edge, (*surroundings(q), *more))
