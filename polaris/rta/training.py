"""Many flights of a switching scene for learning, each at its own decision, with or without the monitor."""

from __future__ import annotations

from dataclasses import dataclass, field, fields

import numpy as np
from numpy.typing import NDArray

from ..model.errors import ScenarioError
from ..model.system import Array
from ..synthesis.neural import stacked
from .decision_grid import DecisionGrid
from .flight import Conditions, Engine
from .method import FILTERED
from .methods.monitor import Monitor

POOL = 32
"""Fewest flights whose conditions are drawn at a time."""


@dataclass(frozen=True, eq=False)
class Step:
    """What one decision period brought to R flights.

    Attributes
    ----------
    reward : ndarray, shape (R,)
        See `TrainingFlights`.
    collided : ndarray of bool, shape (R,)
        Whether an unsafe set, as perceived, was entered at a node.
    ended : ndarray of bool, shape (R,)
        Whether the plan has come to its end.
    intervened : ndarray of bool, shape (R,)
        Whether S flew, not the policy.
    margin : ndarray, shape (R,)
        Of the monitor: least share of room left if the policy flies; nan without it.
    distance : ndarray, shape (R,)
        Least distance to an unsafe set at the nodes, by its farthest facet [m].
    delta_v : ndarray, shape (R,)
        Spent in the period [m/s].
    """

    reward: Array
    collided: NDArray[np.bool_]
    ended: NDArray[np.bool_]
    intervened: NDArray[np.bool_]
    margin: Array
    distance: Array
    delta_v: Array

    @classmethod
    def none(cls, runs: int) -> Step:
        """Of flights that did not move."""
        no, nan = np.zeros(runs, dtype=bool), np.full(runs, np.nan)
        return cls(np.zeros(runs), no, no.copy(), no.copy(), nan, np.full(runs, np.inf), np.zeros(runs))

    def put(self, chosen: NDArray[np.intp], part: Step) -> None:
        """Write what came of some of the flights."""
        for each in fields(self):
            getattr(self, each.name)[chosen] = getattr(part, each.name)


@dataclass(eq=False)
class TrainingFlights:
    """R flights of one scene. A policy commands an input, held for a decision period.

    What it reads are the same numbers as a `polaris.synthesis.neural.Policy` reads, and in the same order, so
    that what was trained can be flown as a controller of ``kind = "neural"``. It is paid, per period,
    ``period / T * (1 / (1 + d / length) - effort * mean(|u| / u_max))`` for a distance d [m] at the end of the
    period to the reference of the first experimental controller (to the safe one if that has none), and one
    less in the period in which it collides. A whole flight is worth 1 at most.

    Parameters
    ----------
    grid : DecisionGrid
        Of which latency there must be none.
    runs : int
    inputs : tuple of str
        As those of `Policy`.
    input_scale : ndarray, shape (r,), optional
        By default such that every number is about 1 along the safe reference.
    length : float, optional
        [m]; by default a tenth of the way from the reference's start to its end, or of 1 m.
    effort : float
    monitor : Monitor, optional
        Decides who flies; without it always the policy does.
    """

    grid: DecisionGrid
    runs: int
    inputs: tuple[str, ...] = ("error",)
    input_scale: Array | None = None
    length: float | None = None
    effort: float = 0.05
    monitor: Monitor | None = None
    k: NDArray[np.int_] = field(init=False)

    def __post_init__(self) -> None:
        grid, R, n = self.grid, self.runs, self.grid.system.n
        if grid.delay:
            raise ScenarioError("latency", grid.latency, "must be 0 for training")
        sizes = {"error": n, "state": n, "time": 1, "reference_input": grid.system.m}
        if not set(self.inputs) <= sizes.keys() or len(set(self.inputs)) < max(len(self.inputs), 1):
            rule = f"must name each at most once, of {', '.join(sizes)}"
            raise ScenarioError("inputs", list(self.inputs), rule)
        self.engine, self.target = Engine(grid), grid.own.get(1, grid.xi)
        law = grid.controllers[min(1, len(grid.controllers) - 1)]
        self._nu = getattr(law, "own", grid.clearance.reference).nu
        nodes = np.arange(grid.decisions) * grid.nodes
        path = self.target[nodes] @ grid.system.position.T
        if self.length is None:
            self.length = 0.1 * (float(np.linalg.norm(path[-1] - path[0])) or 1.0)
        count = sum(sizes[name] for name in self.inputs)
        if self.input_scale is None:
            half = np.abs(grid.schedule.safety.problem.initial_set.G).sum(axis=1)
            most = np.abs(self._read(np.arange(len(nodes)), grid.xi[nodes] + half, 1.0)).max(axis=0)
            self.input_scale = 1 / np.where(most > 0, most, 1.0)
        elif np.shape(self.input_scale) != (count,):
            raise ScenarioError("input_scale", np.size(self.input_scale), f"must have {count} numbers")
        self.k, self.flown = np.zeros(R, dtype=int), np.zeros(R, dtype=int)
        self.x = np.zeros((R, n))
        self._w = np.zeros((0, R, 0))
        self._errors, self._left = np.zeros((grid.decisions + 1, R, n)), 0

    def restart(self, chosen: NDArray[np.bool_], rng: np.random.Generator, fresh: bool = False) -> None:
        """Begin some flights (R,) anew; starts, disturbances and errors are those of `Conditions.draw`.

        They are drawn many at a time and used one by one; `fresh` throws away what is left.
        """
        self._left = 0 if fresh else self._left
        for run in np.flatnonzero(chosen):
            if not self._left:
                self._left = max(self.runs, POOL)
                self._drawn = Conditions.draw(self.grid, self._left, int(rng.integers(2**31)))
                if not self._w.size:
                    self._w = np.zeros((len(self._drawn.w), self.runs, self._drawn.w.shape[2]))
            self._left -= 1
            self.x[run], self._w[:, run] = self._drawn.x0[self._left], self._drawn.w[:, self._left]
            self._errors[:-1, run] = self._drawn.errors[:, self._left]
        self.k[chosen] = self.flown[chosen] = 0

    @property
    def estimate(self) -> Array:
        """States as measured, shape (R, n)."""
        return np.asarray(self.x + self._errors[self.k, np.arange(self.runs)])

    def observe(self) -> Array:
        """What policies read, shape (R, r)."""
        return self._read(self.k, self.estimate, self.input_scale)

    def _read(self, k: NDArray[np.int_], x: Array, scale: Array | float | None) -> Array:
        grid = self.grid
        step = np.minimum(k * grid.nodes // grid.clearance.q, len(self._nu) - 1)
        parts = {
            "error": self.target[k * grid.nodes] - x,
            "state": x,
            "time": (step * grid.tracking.delta)[:, None],
            "reference_input": self._nu[step],
        }
        return stacked(self.inputs, parts) * scale

    def advance(self, u: Array, moving: NDArray[np.bool_] | None = None) -> Step:
        """Fly a decision period with inputs (R, m), clipped to the limits; some flights may stand still.

        Where an input is not finite, S flies under the monitor, and nothing thrusts without it.
        """
        out = Step.none(self.runs)
        moving = np.ones(self.runs, dtype=bool) if moving is None else moving
        for k in np.unique(self.k[moving]).tolist():
            chosen = np.flatnonzero(moving & (self.k == k))
            out.put(chosen, self._advanced(k, chosen, u[chosen]))
        return out

    def _advanced(self, k: int, chosen: NDArray[np.intp], u: Array) -> Step:
        """The flights that are all at decision k."""
        grid, finite = self.grid, np.isfinite(u).all(axis=1)
        x, mode = self.x[chosen], np.full(len(chosen), FILTERED)
        margin = np.full(len(chosen), np.nan)
        if self.monitor is not None:
            e = x + self._errors[k, chosen] - grid.xi[k * grid.nodes]
            found, margin = self.monitor.judge(k, e, self.flown[chosen])
            mode = np.where((found > 0) & finite, FILTERED, 0)
        u = np.where(finite[:, None], u, 0.0)
        distance, spent, used = np.full(len(chosen), np.inf), np.zeros(len(chosen)), np.zeros(len(chosen))
        normals, offsets, _ = grid.facets
        for node in range(k * grid.nodes, (k + 1) * grid.nodes):
            x, _, _, effort = self.engine.step(node, mode, u, x, self._w[node, chosen])
            spent += effort * self.engine.dt
            room = x @ (normals @ grid.system.position).T - offsets[node + 1]
            distance = np.minimum(distance, grid.nearest(room))
        used = spent / (grid.period * grid.system.u_max.sum())
        self.x[chosen], self.k[chosen], self.flown[chosen] = x, k + 1, mode != 0
        off = (x - self.target[(k + 1) * grid.nodes]) @ grid.system.position.T
        near = 1 / (1 + np.linalg.norm(off, axis=1) / self.length) - self.effort * used
        collided = distance < 0
        ended = np.full(len(chosen), k + 1 == grid.decisions)
        reward = near / grid.decisions - collided
        return Step(reward, collided, ended, mode == 0, margin, distance, spent / grid.system.mass)
