"""The part of space that a scene shows, and the sets and the goal in it."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.optimize import linprog

from ...model.scene.keep_in import KeepIn
from ...model.scene.obstacle import Obstacle
from ...model.scene.satellite import SatelliteObstacle
from ...model.scene.shapes import BallShape
from ...model.system import Array
from ...planning.goals import EllipticalNMT, Goal, LinearNMT
from ...runs.plot_data import ApproachData, PlotData, directions
from .geometry import DrawnShape, ball_points, boxed, flat_outline

NEAR = 0.35  # how far a flight may stray beyond the safe path, in widths of it, and still widen the view


@dataclass(frozen=True, eq=False)
class Space:
    """The part of space a scene shows, from `low` to `high` (d,) [m] in the system's coordinates."""

    picture: PlotData
    low: Array
    high: Array

    @classmethod
    def from_paths(cls, picture: PlotData, paths: Sequence[Array] | None = None) -> "Space":
        """Space for the safe path and the reference, bodies near them, and paths (N, d) [m] near them."""
        flat = picture.frame.flat
        start = picture.initial_positions
        reach = np.abs(start.G).sum(axis=-1)
        points = np.vstack([*picture.path(), picture.safe_path()[1], start.c - reach, start.c + reach])
        size = float(np.max(np.ptp(points[:, flat], axis=0)))
        flights = map(picture.positions, picture.flights.values())
        for path in flights if paths is None else paths:
            beyond = np.maximum(points.min(axis=0) - path, path - points.max(axis=0))[:, flat]
            if np.all(beyond < NEAR * size):
                points = np.vstack([points, path])
        low, high = points.min(axis=0), points.max(axis=0)
        reach = 0.3 * float(np.max((high - low)[flat]))
        point_sets = [points]
        for obstacle in picture.obstacles:
            if isinstance(obstacle, KeepIn):
                continue
            near = picture.approach(obstacle)
            if obstacle.drawn.bounded:
                outline = cls(picture, low, high).corners(obstacle, near.time)
            else:
                outline = _within(obstacle, picture, near, reach)
            point_sets.append(np.clip(outline, low - reach, high + reach))
        for one in picture.printed_slices() if len(flat) == 2 else ():
            outline = np.tile(one.place, (len(one.outline), 1))
            outline[:, flat] = one.outline
            point_sets.append(np.clip(outline, low - reach, high + reach))
        points = np.vstack(point_sets)
        low, high = points.min(axis=0), points.max(axis=0)
        pad = 0.05 * float(np.max((high - low)[flat])) + 1e-9 * (1 + float(np.abs(points).max()))
        low, high = low - pad, high + pad
        # No figure is more than 2.2 times as wide as it is high, or higher than wide; none is quite flat.
        size, middle = high - low, (high + low) / 2
        if len(flat) == 2:
            x, y = flat
            size[x] = max(size[x], size[y])
            size[y] = max(size[y], size[x] / 2.2)
            size = np.maximum(size, 0.35 * size[x])
        return cls(picture, middle - size / 2, middle + size / 2)

    def wider(self, share: float) -> "Space":
        """Return the space with more room on every side of the plane, as a share of its size."""
        margin = np.zeros(len(self.low))
        flat = self.picture.frame.flat
        margin[flat] = share * (self.high - self.low)[flat]
        return Space(self.picture, self.low - margin, self.high + margin)

    def corners(self, obstacle: Obstacle, t: float) -> Array:
        """Corners (V, d) of the true set at t (of a keep-in set the inside), cut to this space."""
        system = self.picture.system
        centre = np.asarray(obstacle.centre(t, system))
        shape = obstacle.drawn
        if isinstance(shape, BallShape):
            return centre + ball_points(shape.radius, system.d)
        if shape.bounded:
            return shape.vertices() + centre
        cut = boxed(shape.H, shape.b + shape.H @ centre, self.low, self.high)
        return cut.vertices() if cut.depth > 0 else np.zeros((0, system.d))

    def outline(self, obstacle: Obstacle, t: float, axes: Sequence[int]) -> Array:
        """Outline (V, 2) of the true set seen along the other axes; V is 0 if nothing is there."""
        if isinstance(obstacle.drawn, BallShape):
            centre = np.asarray(obstacle.centre(t, self.picture.system))
            return np.asarray(centre[list(axes)] + obstacle.drawn.radius * directions(64))
        return flat_outline(self.corners(obstacle, t)[:, list(axes)])

    def cover(self, obstacle: Obstacle, t: float) -> Array | None:
        """Corners (V, d) within which another satellite is known to be at t, its radius included."""
        if not isinstance(obstacle, SatelliteObstacle):
            return None
        return np.asarray(obstacle.outline(t, self.picture.system))

    def goal(self) -> list[DrawnShape]:
        """The goal's positions as far as it limits them: lines, points, or an ``area``."""
        goal = self.picture.goal
        if isinstance(goal, EllipticalNMT):
            angle = np.linspace(0, 2 * np.pi, 121)
            ring = np.stack([np.sin(angle), 2 * np.cos(angle), np.zeros_like(angle)], axis=1)
            rims = [b for b in (goal.inner_semi_minor, goal.outer_semi_minor) if b > 0]
            return [DrawnShape("line", b * ring) for b in rims]
        if isinstance(goal, LinearNMT):
            amplitude = goal.amplitude_max
            ends = np.array([[0.0, goal.along_track, z] for z in (-amplitude, amplitude)])
            return [DrawnShape("line", ends)]
        return self._allowed(goal)

    def _allowed(self, goal: Goal) -> list[DrawnShape]:
        """Outermost positions that the conditions of a goal allow; none if they allow all."""
        C, conditions, eye = self.picture.system.position, goal.conditions, np.eye(len(self.low))

        def outermost(ray: Array, G: Array = conditions.G, g: Array = conditions.g) -> Array | None:
            state = linprog(-ray @ C, G, g, conditions.E, conditions.e, bounds=(None, None)).x
            return None if state is None else C @ state

        free = np.array([outermost(ray) is None or outermost(-ray) is None for ray in eye])
        if np.all(free):
            return []
        G = np.vstack([conditions.G, eye[free] @ C, -eye[free] @ C])
        g = np.concatenate([conditions.g, self.high[free], -self.low[free]])
        rays = np.array(list(product((-1.0, 0.0, 1.0), repeat=len(C))))
        corners = np.array([outermost(ray, G, g) for ray in rays])
        size = np.ptp(corners, axis=0)
        flat = size <= 1e-9 * np.max(self.high - self.low)
        if np.all(flat):
            return [DrawnShape("points", corners[:1])]
        thin = 2e-3 * float(np.max(self.high - self.low)) * flat  # to be seen at all
        return [DrawnShape("area", np.vstack([corners - thin, corners + thin]))]


def _within(obstacle: Obstacle, picture: PlotData, near: ApproachData, depth: float) -> Array:
    """A point within an unbounded set, past where the path comes closest to it; none if it is far."""
    if near.distance > depth:
        return np.zeros((0, picture.system.d))
    probes = near.place + 1e-3 * depth * np.vstack([np.eye(picture.system.d), -np.eye(picture.system.d)])
    ahead, behind = np.split(obstacle.signed_distance(near.time, probes, picture.system), 2)
    outward = (ahead - behind) / max(float(np.linalg.norm(ahead - behind)), 1e-300)
    return np.asarray((near.place - (near.distance + 0.5 * depth) * outward)[None])


def moves(obstacle: Obstacle, picture: PlotData) -> bool:
    """Return True if an obstacle changes place within the horizon."""
    times = np.linspace(0, picture.duration, 5)
    return bool(np.ptp(obstacle.centre(times, picture.system), axis=0).max() > 0)
