"""Time to collision along free drift: when unforced motion first enters an obstacle."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import expm

from reach.numerics.linear import growth, powers

from ..checks import positive
from ..errors import ScenarioError
from ..system import Array, LinearSystem
from ..tolerances import ROUNDING
from .obstacle import Obstacle
from .shapes import Shape, in_parts

CHUNK = 2_000_000  # numbers held at once
MOST_HALVINGS = 12  # most halvings of a coarse interval


def drift_ttc(
    obstacles: Sequence[Obstacle],
    system: LinearSystem,
    t: ArrayLike,
    x: ArrayLike,
    horizon: float,
    states: Mapping[str, ArrayLike] | None = None,
    tolerance: float = 1e-3,
) -> Array:
    """Seconds (O, ...) until the chaser, its thrusters off, enters each obstacle; 0 inside, inf if never.

    An obstacle counts while it holds (`Obstacle.span`): s seconds after time t, it is entered only if it
    holds at t + s. Other satellites drift too; rigid obstacles keep their velocity. Coarse intervals in which
    the distance cannot reach zero (it changes no faster than the path is long, and the path's curvature is
    bounded) are dropped; the others are halved until the path is straight to within `tolerance` [m], and then
    clipped as straight rays. No pass is missed, however brief, if it goes deeper than that. Times (...) [s]
    are those of the states (..., n); `states` are true ones of other satellites, by name, by default nominal.
    """
    positive("horizon", horizon, "s")
    positive("tolerance", tolerance, "m")
    x = np.asarray(x, dtype=float)
    if x.ndim == 0 or x.shape[-1] != system.n:
        raise ScenarioError("x", x.shape, f"its last axis must be the {system.n} states of the system")
    for name, values in (("t", np.asarray(t, dtype=float)), ("x", x)):
        if not np.all(np.isfinite(values)):
            raise ScenarioError(name, "nan or inf", "must be finite numbers")
    search = DriftSearch(system, horizon, tolerance)
    out = np.empty((len(obstacles), *np.broadcast_shapes(np.shape(t), x.shape[:-1])))
    for o, obstacle in enumerate(obstacles):
        motion = obstacle.relative_drift(t, x, system, None if states is None else states.get(obstacle.name))
        out[o] = search.entry_times(obstacle.shape, obstacle.span, t, *motion)
    return out


class DriftSearch:
    """Coarse grid over the horizon, and its refinement."""

    def __init__(self, system: LinearSystem, horizon: float, tolerance: float) -> None:
        fastest = float(np.max(np.abs(np.linalg.eigvals(system.A))))
        self.count = int(np.clip(np.ceil(horizon * fastest / 0.25), 32, 4096))
        self.h, self.horizon = horizon / self.count, horizon * (1 + ROUNDING)
        self.tolerance = tolerance
        self.A, self.C = system.A, system.position
        self.coarse = powers(expm(system.A * self.h), self.count)
        self.curvature = np.abs(self.C @ system.A @ system.A) @ growth(system.A, self.h)

    def entry_times(
        self, shape: Shape, span: tuple[float, float], t: ArrayLike, y: Array, c: Array, v: Array
    ) -> Array:
        """Seconds s after times t until ``C e^{A s} y - c - v s`` is in a shape in its span; inf if never."""
        t = np.asarray(t, dtype=float)
        wait = np.asarray(np.maximum(span[0] - t, 0.0))
        if np.any(wait):
            carried = expm(self.A * wait[..., None, None])
            y, c = np.einsum("...ij,...j->...i", carried, y), c + v * wait[..., None]
        width = len(self.coarse) * 8 * len(self.A)
        s = wait + in_parts(lambda *parts: self._chunk(shape, *parts), width, y, c, v, most=CHUNK)
        return np.where((s <= self.horizon) & (t + s < span[1]), s, np.inf)

    def _chunk(self, shape: Shape, y: Array, c: Array, v: Array) -> Array:
        s = self.h * np.arange(self.count + 1)
        states = np.einsum("kij,Nj->Nki", self.coarse, y)
        p = states @ self.C.T - c[:, None] - v[:, None] * s[:, None]
        distance = shape.signed_distance(p)
        entry = np.where(distance <= 0, s, np.inf).min(axis=1)
        intersample = self.h**2 / 8 * np.linalg.norm(np.abs(states[:, :-1]) @ self.curvature.T, axis=-1)
        path = np.linalg.norm(np.diff(p, axis=1), axis=-1)
        open_ = (distance[:, :-1] + distance[:, 1:] - path) / 2 - intersample <= 0
        point, interval = np.nonzero(open_ & (s[:-1] < entry[:, None]))
        if len(point) == 0:
            return np.asarray(entry)
        ends = np.stack([p[point, interval], p[point, interval + 1]])
        gaps = np.stack([distance[point, interval], distance[point, interval + 1]])
        sag, start, h = intersample[point, interval], s[interval], self.h
        halvings = int(np.clip(np.ceil(np.log2(max(sag.max() / self.tolerance, 1.0)) / 2), 0, MOST_HALVINGS))
        fine = powers(expm(self.A * self.h / 2**halvings), 2**halvings)
        cell, offset = interval, np.zeros(len(interval), dtype=int)
        for level in range(1, halvings + 1):
            h, sag = h / 2, sag / 4
            half = offset + 2 ** (halvings - level)
            state = np.einsum("Nij,Nj->Ni", fine[half], states[point, cell])
            middle = state @ self.C.T - c[point] - v[point] * (start + h)[:, None]
            gap = shape.signed_distance(middle)
            np.minimum.at(entry, point[gap <= 0], (start + h)[gap <= 0])
            ends = np.concatenate([np.stack([ends[0], middle]), np.stack([middle, ends[1]])], axis=1)
            gaps = np.concatenate([np.stack([gaps[0], gap]), np.stack([gap, gaps[1]])], axis=1)
            start, offset = np.concatenate([start, start + h]), np.concatenate([offset, half])
            point, cell, sag = np.tile(point, 2), np.tile(cell, 2), np.tile(sag, 2)
            path = np.linalg.norm(ends[1] - ends[0], axis=-1)
            kept = ((gaps[0] + gaps[1] - path) / 2 - sag <= 0) & (start < entry[point])
            ends, gaps, start, offset = ends[:, kept], gaps[:, kept], start[kept], offset[kept]
            point, cell, sag = point[kept], cell[kept], sag[kept]
        time = shape.entry_time(ends[0], (ends[1] - ends[0]) / h)
        inside = time <= h * (1 + 1e-9)
        np.minimum.at(entry, point[inside], (start + time)[inside])
        return np.asarray(entry)
