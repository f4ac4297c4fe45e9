"""Is the start clear of every obstacle, and is a hold point? Asked of the true sets, before any planning."""

from __future__ import annotations

import math
from collections.abc import Iterable
from itertools import product
from typing import Any

import numpy as np

from reach.sets.zonotope import Zonotope

from ..model.errors import ScenarioError
from ..model.keep_in import KeepIn, Outside
from ..model.obstacle import Obstacle
from ..model.satellite import SatelliteObstacle
from ..model.shapes import Ball, Polytope
from ..model.system import Array, LinearSystem
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
    if isinstance(spec, models.InitialBox):
        return "initial_set.half_widths", list(spec.half_widths)
    if isinstance(spec, models.InitialBall):
        return "initial_set.position_radius_m", spec.position_radius_m
    return "initial_set.generators", [list(row) for row in spec.generators]


def unsafe_depth(item: Obstacle, place: Zonotope, time: float, system: LinearSystem) -> float:
    """Largest depth [m] to which some point of a set of positions is unsafe; negative if none is.

    Exact for boxes, polytopes, balls and their outsides; of another shape the corners of the set are asked,
    which is exact where the shape is the outside of a convex set.
    """
    centre, shape = item.centre(time, system), item.shape
    if isinstance(shape, Ball):
        known = np.zeros(system.n) if not isinstance(item, SatelliteObstacle) else item.state_half_widths
        return shape.radius - _distance(place, centre, system.position @ np.diag(np.asarray(known)))
    if isinstance(shape, Polytope):
        return _depth_in_halfspaces(place, shape.H, shape.b + shape.H @ centre)
    if isinstance(shape, Outside):
        return float(np.max(place.support(shape.inner.H) - shape.inner.b - shape.inner.H @ centre))
    return -float(shape.signed_distance(_corners(place) - centre).min())


def _corners(place: Zonotope) -> Array:
    """Corners of a set, shape (k, d); where they are too many, the ends of its generators."""
    used = place.G[:, np.any(place.G != 0, axis=0)]
    count = used.shape[1]
    if count <= 13:
        signs = np.array(list(product((-1.0, 1.0), repeat=count))).reshape(2**count, count)
    else:
        signs = np.vstack([np.eye(count), -np.eye(count)])
    return place.c + signs @ used.T


def _distance(place: Zonotope, centre: Array, generators: Array) -> float:
    """Smallest distance [m] between two zonotopes of positions."""
    from scipy.optimize import lsq_linear

    gap, spans = place.c - centre, np.hstack([place.G, -generators])
    spans = spans[:, np.any(spans != 0, axis=0)]
    if spans.shape[1] == 0:
        return float(np.linalg.norm(gap))
    solved = lsq_linear(spans, -gap, bounds=(-1, 1), tol=1e-12)
    return float(np.linalg.norm(spans @ solved.x + gap))


def _depth_in_halfspaces(place: Zonotope, H: Array, b: Array) -> float:
    """Largest depth [m] to which some point of a zonotope lies inside ``H p <= b``; negative if none does."""
    from scipy.optimize import linprog

    apart = float(np.max(-place.support(-H) - b))  # one facet has all of it beyond
    if apart > 0:
        return -apart
    g = place.order_count
    if g == 0:
        return float(np.min(b - H @ place.c))
    rows = np.hstack([H @ place.G, np.ones((len(H), 1))])
    solved = linprog(np.r_[np.zeros(g), -1.0], rows, b - H @ place.c, bounds=[(-1, 1)] * g + [(None, None)])
    return float(-solved.fun) if solved.status == 0 else -math.inf
