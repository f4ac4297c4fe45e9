"""Is the start clear of every obstacle, and is a hold point? Asked of the true sets, before any planning."""

from __future__ import annotations

import math
from itertools import product
from typing import Any

import numpy as np

from reach.sets.zonotope import Zonotope

from ..model.errors import ScenarioError
from ..model.system import Array, LinearSystem
from . import scene_tables as scene
from . import tables as models

_TOUCH_M = 1e-9
"""Depth [m] from which an overlap counts: touching is left to the planner, which books its margins."""


def check_start_and_goal(model: models.ScenarioModel, system: LinearSystem, theta: Zonotope) -> None:
    """Refuse a start or a hold point that is unsafe as it stands.

    Raises
    ------
    ScenarioError
        If the initial set reaches into an obstacle or out of a
        keep-in set at t = 0, or a hold point lies in an obstacle at its arrival or out of a keep-in set.
    """
    place = system.position @ theta
    for i, obstacle in enumerate(model.obstacles):
        path = f"obstacles[{i}]"
        spread = obstacle_spread(obstacle, system)
        _need_clear(model, place, path, obstacle, spread)
    for i, keep_in in enumerate(model.keep_in):
        path = f"keep_in[{i}]"
        _need_inside(model, place, path, keep_in)
    if isinstance(model.goal, scene.StationaryGoal):
        _check_hold_point(model, system, system.position @ np.array(model.goal.state))


# -- sets -------------------------------------------------------------------------------------------


def halfspaces(spec: Any, time: float = 0.0) -> tuple[Array, Array]:
    """Unit normals (F, d) and offsets [m] (F,) of a box or polytope at a time [s]."""
    velocity = getattr(spec, "velocity_m_s", None)
    if isinstance(spec, scene.BoxObstacle):
        center, half = np.array(spec.center_m), np.array(spec.half_widths_m)
        H = np.vstack([np.eye(len(center)), -np.eye(len(center))])
        b = np.r_[center + half, half - center]
    else:
        H, b = np.array(spec.normals, dtype=float), np.array(spec.offsets_m, dtype=float)
        length = np.linalg.norm(H, axis=1)
        H, b = H / length[:, None], b / length
    return H, b if velocity is None else b + time * (H @ np.array(velocity))


def obstacle_spread(spec: scene.Obstacle, system: LinearSystem) -> tuple[Array, Array, float] | None:
    """A ball (or a box of balls) at t = 0: centre, generators of the box, radius. None for polytopes."""
    if isinstance(spec, scene.BallObstacle):
        return np.array(spec.center_m), np.zeros((system.d, 0)), spec.radius_m
    if isinstance(spec, scene.SatelliteObstacle):
        C = system.position
        return C @ np.array(spec.state), C @ np.diag(spec.state_half_widths), spec.radius_m
    return None


def distance_between(place: Zonotope, center: Array, generators: Array) -> float:
    """Smallest distance [m] between two zonotopes of positions."""
    from scipy.optimize import lsq_linear

    gap, spans = place.c - center, np.hstack([place.G, -generators])
    spans = spans[:, np.any(spans != 0, axis=0)]
    if spans.shape[1] == 0:
        return float(np.linalg.norm(gap))
    solved = lsq_linear(spans, -gap, bounds=(-1, 1), tol=1e-12)
    return float(np.linalg.norm(spans @ solved.x + gap))


def depth_in_halfspaces(place: Zonotope, H: Array, b: Array) -> float:
    """Largest depth [m] to which some point of a zonotope lies inside ``H p <= b``; negative if none does."""
    from scipy.optimize import linprog

    g = place.order_count
    if g == 0:
        return float(np.min(b - H @ place.c))
    rows = np.hstack([H @ place.G, np.ones((len(H), 1))])
    cost = np.r_[np.zeros(g), -1.0]
    solved = linprog(cost, rows, b - H @ place.c, bounds=[(-1, 1)] * g + [(None, None)])
    return float(-solved.fun) if solved.status == 0 else -math.inf


# -- rules ------------------------------------------------------------------------------------------


def _need_clear(
    model: models.ScenarioModel,
    place: Zonotope,
    path: str,
    spec: scene.Obstacle,
    spread: tuple[Array, Array, float] | None,
) -> None:
    """The start outside one obstacle: first its centre, then all of it."""
    center = Zonotope.point(place.c)

    def depth(start: Zonotope) -> float:
        if spread is None:
            H, b = halfspaces(spec)
            apart = float(np.max(-start.support(-H) - b))  # one facet has the whole start beyond it
            return -apart if apart > 0 else depth_in_halfspaces(start, H, b)
        middle, generators, radius = spread
        sizes = np.linalg.norm(start.half_widths) + np.linalg.norm(generators, axis=0).sum()
        apart = float(np.linalg.norm(start.c - middle) - sizes - radius)
        return -apart if apart > 0 else radius - distance_between(start, middle, generators)

    if (inside := depth(center)) > _TOUCH_M:
        rule = f"must start outside {path} ({spec.name}), is {inside:.4g} m inside"
        raise ScenarioError("initial_set.center", list(model.initial_set.center), rule)
    if (inside := depth(place)) > _TOUCH_M:
        rule = (
            f"must keep all of the initial set outside {path} ({spec.name}), reaches {inside:.4g} m into it"
        )
        raise ScenarioError(*_size_of(model), rule)


def _size_of(model: models.ScenarioModel) -> tuple[str, Any]:
    """The field that gives the initial set its size, and its value."""
    spec = model.initial_set
    if isinstance(spec, models.InitialBox):
        return "initial_set.half_widths", list(spec.half_widths)
    if isinstance(spec, models.InitialBall):
        return "initial_set.position_radius_m", spec.position_radius_m
    return "initial_set.generators", [list(row) for row in spec.generators]


def cone_depth(spec: scene.KeepInCone, points: Array) -> Array:
    """How far inside a cone [m] each point (k, d) lies; negative outside (from the surface's plane)."""
    axis = np.array(spec.axis) / np.linalg.norm(spec.axis)
    angle = math.radians(spec.half_angle_deg)
    rel = points - np.array(spec.apex_m)
    height = rel @ axis
    across = np.linalg.norm(rel - height[:, None] * axis, axis=1)
    depth = height * math.sin(angle) - across * math.cos(angle)
    return np.asarray(depth if spec.length_m is None else np.minimum(depth, spec.length_m - height))


def _inside(spec: scene.KeepIn, place: Zonotope) -> float:
    """Smallest depth [m] inside a keep-in set over a set of positions."""
    if isinstance(spec, scene.KeepInPolytope):
        H, b = halfspaces(spec)
        return float(np.min(b - place.support(H)))
    used = place.G[:, np.any(place.G != 0, axis=0)]
    count = used.shape[1]
    if count <= 13:  # the cone is convex: a set lies inside when its corners do
        signs = np.array(list(product((-1.0, 1.0), repeat=count))).reshape(2**count, count)
    else:  # too many corners; some points of the set still refuse a start that is clearly outside
        signs = np.vstack([np.eye(count), -np.eye(count)])
    return float(cone_depth(spec, place.c + signs @ used.T).min())


def _need_inside(model: models.ScenarioModel, place: Zonotope, path: str, spec: scene.KeepIn) -> None:
    """The start inside one keep-in set: first its centre, then all of it."""
    if (depth := _inside(spec, Zonotope.point(place.c))) < -_TOUCH_M:
        rule = f"must start inside {path} ({spec.name}), is {-depth:.4g} m outside"
        raise ScenarioError("initial_set.center", list(model.initial_set.center), rule)
    if (depth := _inside(spec, place)) < -_TOUCH_M:
        rule = (
            f"must keep all of the initial set inside {path} ({spec.name}), reaches {-depth:.4g} m out of it"
        )
        raise ScenarioError(*_size_of(model), rule)


def _check_hold_point(model: models.ScenarioModel, system: LinearSystem, point: Array) -> None:
    """A hold point outside every obstacle when the chaser arrives, and inside every keep-in set."""
    given = list(model.goal.state) if isinstance(model.goal, scene.StationaryGoal) else []
    end = model.horizon.duration_s
    spot = Zonotope.point(point)
    for i, obstacle in enumerate(model.obstacles):
        if isinstance(obstacle, scene.SatelliteObstacle):
            continue  # its place at the end is uncertain; the planner decides
        if isinstance(obstacle, scene.BallObstacle):
            velocity = obstacle.velocity_m_s or (0.0,) * system.d
            center = np.array(obstacle.center_m) + end * np.array(velocity)
            depth = obstacle.radius_m - float(np.linalg.norm(point - center))
        else:
            depth = depth_in_halfspaces(spot, *halfspaces(obstacle, end))
        if depth > _TOUCH_M:
            rule = f"must lie outside obstacles[{i}] ({obstacle.name}) at the end, is {depth:.4g} m inside"
            raise ScenarioError("goal.state", given, rule)
    for i, keep_in in enumerate(model.keep_in):
        if (depth := _inside(keep_in, spot)) < -_TOUCH_M:
            rule = f"must lie inside keep_in[{i}] ({keep_in.name}), is {-depth:.4g} m outside"
            raise ScenarioError("goal.state", given, rule)
