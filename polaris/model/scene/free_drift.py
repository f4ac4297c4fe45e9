"""Time to collision along free drift: when unforced motion first enters an obstacle."""

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import expm

from reach.numerics.linear import growth, powers

from ..checks import positive
from ..errors import ScenarioError
from ..system import Array, LinearSystem
from .shapes import Shape

CHUNK = 2_000_000  # numbers held at once
MOST_HALVINGS = 12  # most halvings of a coarse interval


class Drifting(Protocol):
    """Interface of an obstacle during free drift; every `polaris.Obstacle` has it."""

    @property
    def name(self) -> str:
        """Name of the obstacle in `states`."""

    @property
    def shape(self) -> Shape:
        """The true set, relative to its origin."""

    def relative_drift(
        self, t: ArrayLike, x: Array, system: LinearSystem, state: ArrayLike | None = None
    ) -> tuple[Array, Array, Array]:
        """See `polaris.Obstacle.relative_drift`."""


def drift_ttc(
    obstacles: Sequence[Drifting],
    system: LinearSystem,
    t: ArrayLike,
    x: ArrayLike,
    horizon: float,
    states: Mapping[str, ArrayLike] | None = None,
    tolerance: float = 1e-3,
) -> Array:
    """Seconds (O, ...) until the chaser, its thrusters off, enters each obstacle; 0 inside, inf if never.

    Other satellites drift too; rigid obstacles keep their velocity. Coarse intervals in which the distance
    cannot reach zero (it changes no faster than the path is long, and the path's curvature is bounded)
    are dropped; the others are halved until the path is straight to within `tolerance` [m], and then clipped
    as straight rays. No pass is missed, however brief, if it goes deeper than that. Times (...) [s] are those
    of the states (..., n); `states` are true ones of other satellites, by name, by default their nominal
    ones.
    """
    positive("horizon", horizon, "s")
    positive("tolerance", tolerance, "m")
    x = np.asarray(x, dtype=float)
    if x.ndim == 0 or x.shape[-1] != system.n:
        raise ScenarioError("x", x.shape, f"its last axis must be the {system.n} states of the system")
    for name, values in (("t", np.asarray(t, dtype=float)), ("x", x)):
        if not np.all(np.isfinite(values)):
            raise ScenarioError(name, "nan or inf", "must be finite numbers")
    shape = np.broadcast_shapes(np.shape(t), x.shape[:-1])
    search = _Search(system, horizon, tolerance)
    out = np.empty((len(obstacles), *shape))
    for o, obstacle in enumerate(obstacles):
        state = None if states is None else states.get(obstacle.name)
        y, c, v = obstacle.relative_drift(t, x, system, state)
        flat = [np.broadcast_to(a, (*shape, a.shape[-1])).reshape(-1, a.shape[-1]) for a in (y, c, v)]
        out[o] = search.first_entry(obstacle.shape, *flat).reshape(shape)
    return out


class _Search:
    """Coarse grid over the horizon, and its refinement."""

    def __init__(self, system: LinearSystem, horizon: float, tolerance: float) -> None:
        fastest = float(np.max(np.abs(np.linalg.eigvals(system.A))))
        self.count = int(np.clip(np.ceil(horizon * fastest / 0.25), 32, 4096))
        self.h = horizon / self.count
        self.tolerance = tolerance
        self.A, self.C = system.A, system.position
        self.coarse = powers(expm(system.A * self.h), self.count)
        self.curvature = np.abs(self.C @ system.A @ system.A) @ growth(system.A, self.h)

    def first_entry(self, shape: Shape, y: Array, c: Array, v: Array) -> Array:
        """Entry time [s] of ``C e^{A s} y - c - v s`` into the shape, shape (N,)."""
        step = max(1, CHUNK // (self.coarse.shape[0] * 8 * y.shape[1]))
        parts = [slice(i, i + step) for i in range(0, len(y), step)]
        times = [self._chunk(shape, y[part], c[part], v[part]) for part in parts]
        return np.concatenate(times) if times else np.empty(0)

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
