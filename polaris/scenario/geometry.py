"""Is the start clear of every obstacle, and is a hold point? Asked of the true sets, before any planning."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from reach.sets.zonotope import Zonotope

from ..model.errors import ScenarioError
from ..model.keep_in import KeepIn
from ..model.obstacle import Obstacle
from ..model.satellite import SatelliteObstacle
from ..model.system import LinearSystem
from . import scene_tables as scene
from . import tables as models

_TOUCH_M = 1e-9
"""Depth [m] from which an overlap counts: touching is left to the planner, which books its margins."""


def check_start_and_goal(
    model: models.ScenarioModel, unsafe: Iterable[Obstacle], system: LinearSystem, theta: Zonotope
) -> None:
    """Refuse a start or a hold point that is unsafe as it stands.

    Raises
    ------
    ScenarioError
        If the initial set reaches into an obstacle or out of a keep-in set at t = 0, or a hold point lies in
        an obstacle at its arrival or out of a keep-in set.
    """
    place, end = system.position @ theta, model.horizon.duration_s
    for item in unsafe:
        kept = isinstance(item, KeepIn)
        side, into, wrong = ("inside", "out of it", "outside") if kept else ("outside", "into it", "inside")
        named = f"{side} {item.path} ({item.name})"
        if (depth := unsafe_depth(item, Zonotope.point(place.c), 0.0, system)) > _TOUCH_M:
            rule = f"must start {named}, is {depth:.4g} m {wrong}"
            raise ScenarioError("initial_set.center", list(model.initial_set.center), rule)
        if (depth := unsafe_depth(item, place, 0.0, system)) > _TOUCH_M:
            rule = f"must keep all of the initial set {named}, reaches {depth:.4g} m {into}"
            raise ScenarioError(*_size_of(model), rule)
        # Where another satellite is at the end is uncertain; the planner decides.
        if isinstance(model.goal, scene.StationaryGoal) and not isinstance(item, SatelliteObstacle):
            spot = Zonotope.point(system.position @ np.array(model.goal.state))
            if (depth := unsafe_depth(item, spot, end, system)) > _TOUCH_M:
                rule = f"must lie {named}{'' if kept else ' at the end'}, is {depth:.4g} m {wrong}"
                raise ScenarioError("goal.state", list(model.goal.state), rule)


def _size_of(model: models.ScenarioModel) -> tuple[str, Any]:
    """The field that gives the initial set its size, and its value."""
    spec = model.initial_set
    field = next(key for key in ("half_widths", "position_radius_m", "generators") if hasattr(spec, key))
    return f"initial_set.{field}", np.array(getattr(spec, field)).tolist()


def unsafe_depth(item: Obstacle, place: Zonotope, time: float, system: LinearSystem) -> float:
    """Largest depth [m] to which some point of a set of positions is unsafe; negative if none is."""
    spans = place.G
    if isinstance(item, SatelliteObstacle):  # it may be anywhere in its own box
        spans = np.hstack([spans, system.position @ np.diag(np.asarray(item.state_half_widths))])
    return item.shape.overlap(Zonotope(place.c - item.centre(time, system), spans))
