"""What print and page show of the inspection problem: free flights, and what is about the chief."""

from __future__ import annotations

import numpy as np

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
        Item("chief", (ball(q.separation),)),
        Item("keep", (Shape("line", rings),), f"{LOOKS['keep'].name}, {q.distance_max:g} m"),
    ]
