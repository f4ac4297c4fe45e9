"""What pictures of the inspection problem show: charts over time, free flights, what is about the chief."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...inspection.constraints.allowable_set import allowable
from ...inspection.flights.simulation import InspectionRun
from ...inspection.inspection import Inspection
from ...model.hill import free_flight
from ...model.system import Array
from .geometry import Shape, ball, gapped
from .items import Item
from .palette import LOOKS

AXES = ("Radial", "Along-track", "Cross-track")
ORDER = [1, 0, 2]
"""Hill's coordinates in the order of the axes of a scene: along-track, radial, cross-track."""

SHOWN_FLIGHTS = 16
"""Free flights that are drawn."""

FINE = 101
"""Instants of a free flight that are drawn."""


@dataclass(frozen=True, eq=False)
class Chart:
    """Lines (N, n) over time, one per deputy or pair, between limits.

    Of each limit, whether what is above it is unsafe (else what is below); the note says what lies beyond.
    `pairs`, `log` and `held` say whether the lines are those of pairs, the axis logarithmic, and each value
    held until the next; the width is in points.
    """

    label: str
    lines: Array
    span: tuple[float, float]
    limits: tuple[tuple[float, bool], ...] = ()
    note: str = ""
    ticks: tuple[float, ...] = ()
    pairs: bool = False
    log: bool = False
    held: bool = False
    width: float = 0.9


def velocity_charts(run: InspectionRun) -> list[Chart]:
    """Components of the velocity of every deputy between their limits."""
    most, charts = run.inspection.speed_max, []
    for k, name in enumerate(AXES):
        values = run.x[..., 3 + k]
        top = 1.25 * max(most, float(np.abs(values).max()))
        limits = ((most, True), (-most, False))
        charts.append(Chart(f"{name}\n(m/s)", values, (-top, top), limits, width=0.8))
    return charts


def thrust_charts(q: Inspection, u: Array) -> list[Chart]:
    """Components of the thrust (N, deputies, 3) of every deputy between their limits."""
    most = q.thrust_max
    span, limits = (-1.25 * most, 1.25 * most), ((most, True), (-most, False))
    return [
        Chart(f"{name}\n(N)", u[..., k], span, limits, held=True, width=0.5) for k, name in enumerate(AXES)
    ]


def distance_chart(run: InspectionRun) -> Chart:
    """Distance of every pair, logarithmically, and the least that is allowed."""
    least = 2 * run.inspection.deputy_radius
    values = allowable(run.inspection, run.x, run.sun)["phi2"] + least
    span = min(0.6 * least, 0.8 * float(values.min())), 1.6 * float(values.max())
    label = "Distance of deputies (m)"
    return Chart(label, values, span, ((least, False),), "collision", pairs=True, log=True)


def sun_chart(run: InspectionRun, pairs: bool) -> Chart:
    """Angle between the sun and each sensor, pointed at the chief, or the line of two deputies."""
    half = float(np.degrees(run.inspection.field_of_view / 2))
    values = np.degrees(allowable(run.inspection, run.x, run.sun)["phi5" if pairs else "phi4"]) + half
    label = "Deputy to sun (degrees)" if pairs else "Chief to sun (degrees)"
    top, ticks = (93.0, range(0, 91, 30)) if pairs else (185.0, range(0, 181, 30))
    note = "sun in the field of view"
    return Chart(label, values, (0.0, top), ((half, False),), note, tuple(ticks), pairs)


def spent_chart(run: InspectionRun) -> Chart:
    """Velocity change that each deputy has spent."""
    top = 1.05 * max(float(run.delta_v.max()), 1e-9)
    return Chart("Velocity change (m/s)", run.delta_v, (0.0, top), width=1.2)


def free_flights(run: InspectionRun, deputy: int) -> tuple[Array, Array, Array]:
    """Instants, times of flight, and positions of free flights of shape (instants, times, 3)."""
    q = run.inspection
    chosen = np.unique(np.linspace(0, len(run.t) - 1, SHOWN_FLIGHTS + 2).astype(int)[1:-1])
    after = np.linspace(0, q.passive_time, FINE)
    Phi = free_flight(q.mean_motion, after)[:, :3]
    return run.t[chosen], after, np.einsum("tij,kj->kti", Phi, run.x[chosen, deputy])


def nearest_deputy(run: InspectionRun) -> int:
    """The deputy whose free flights come nearest to the chief, of those that are drawn."""
    least = [np.linalg.norm(free_flights(run, i)[2], axis=2).min() for i in range(run.inspection.deputies)]
    return int(np.argmin(least))


def surroundings(q: Inspection) -> list[Item]:
    """The chief's sphere, and three circles of the sphere to stay within, in the axes of a scene."""
    angle = np.linspace(0, 2 * np.pi, 73)
    ring = q.distance_max * np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
    rings = gapped((np.roll(ring, turn, axis=1) for turn in range(3)), 3)
    return [
        Item("chief", LOOKS["chief"].name, (ball(q.separation),)),
        Item("keep", f"{LOOKS['keep'].name}, {q.distance_max:g} m", (Shape("line", rings),)),
    ]
