"""Many flights of a switching scene for learning, each at its own decision, with or without the monitor."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..model.errors import ScenarioError
from ..model.system import Array
from ..synthesis.controllers.policy import Senses, stacked
from .decision_grid import DecisionGrid
from .flight import Conditions, Engine
from .method import FILTERED
from .methods.monitor import REENTRY, Monitor

POOL = 32  # fewest flights whose conditions are drawn at a time
FLAGS = ("collided", "ended", "intervened")
FIELDS = (*FLAGS, "reward", "distance_m", "delta_v_m_s")
"""Values of every flight after a period, see `TrainingFlights.advance`."""


@dataclass(eq=False)
class TrainingFlights:
    """R flights of one scene. A policy commands an input, held for a decision period.

    It reads the numbers that a `polaris.synthesis.controllers.policy.Policy` reads, in the same order:
    what was trained can be flown as a controller of ``kind = "neural"``. It is paid, per period,
    ``period / T * (1 / (1 + d / length) - effort * mean(|u| / u_max))`` for a distance d [m] at the period's
    end to the reference of the first experimental controller (the safe one if that has none), and one less
    where it collides: at most 1 per flight.

    It has the states `x` (R, n), and `k` (R,), the decisions made.
    """

    failed = "collided"  # flag of flights that have lost safety, as `advance` returns it
    grid: DecisionGrid  # without latency
    runs: int
    inputs: tuple[str, ...] = ("error",)  # as those of `Policy`
    input_scale: Array | None = None  # (r,); by default every number is about 1 along the safe reference
    length: float | None = None  # [m]; by default a tenth of the reference's way, or of 1 m
    effort: float = 0.05  # price of full thrust
    monitor: Monitor | None = field(default=None, init=False)  # who decides who flies; None: the policy does

    def __post_init__(self) -> None:
        grid, n = self.grid, self.grid.system.n
        if grid.delay:
            raise ScenarioError("latency", grid.latency, "must be 0 for training")
        unsafe = grid.schedule.safety.problem.unsafe
        self.senses = Senses.from_inputs(grid.system, tuple(self.inputs), unsafe, "inputs")
        self._bodies = self.senses.state_boxes(grid.period, grid.decisions + 1)
        self._shares = np.zeros((self.runs, self._bodies[0].shape[1]))  # share of what is not known of them
        self.engine, self.target = Engine(grid), grid.own_references.get(1, grid.xi)
        law = grid.controllers[min(1, len(grid.controllers) - 1)]
        self._nu = getattr(law, "own", grid.clearance.reference).nu
        nodes = np.arange(grid.decisions) * grid.nodes
        ends = self.target[nodes[[0, -1]]] @ grid.system.position.T
        self._length = self.length or 0.1 * (float(np.linalg.norm(ends[1] - ends[0])) or 1.0)
        half = np.abs(grid.schedule.safety.problem.initial_set.G).sum(axis=1)
        sizes = np.abs(self._read(np.arange(len(nodes)), grid.xi[nodes] + half, 0.0)).max(axis=0)
        self.scale = 1 / np.where(sizes > 0, sizes, 1.0)
        if self.input_scale is not None:
            if np.shape(self.input_scale) != self.scale.shape:
                rule = f"must have {self.scale.size} numbers"
                raise ScenarioError("input_scale", np.size(self.input_scale), rule)
            self.scale = np.array(self.input_scale, dtype=float)
        self.k, self.x = np.zeros(self.runs, dtype=int), np.zeros((self.runs, n))
        self.limit, self.reads = grid.system.u_max, self.scale.size
        self._active, self._queue = np.zeros(self.runs, dtype=int), list[Conditions]()
        self._w = np.zeros((0, self.runs, 0))
        self._errors = np.zeros((grid.decisions + 1, self.runs, n))
        self._owed = np.zeros((self.runs, grid.system.m))  # what is left of impulses [N s]

    def shield(self, reentry: float = REENTRY) -> None:
        """Let the online monitor decide, which assumes nothing of the policy but the thrust limits.

        Raises `NotCertified` if the initial set is not inside the first recoverable set.
        """
        self.monitor = Monitor(self.grid, "thrust_limits", reentry=reentry)
        self.monitor.modes = (1,)  # whoever it is: the policy

    def restart(self, chosen: NDArray[np.bool_], rng: np.random.Generator, fresh: bool = False) -> None:
        """Begin some flights (R,) anew; starts, disturbances and errors are those of `Conditions.draw`.

        They are drawn many at a time and used one by one; `fresh` throws away what is left.
        """
        self._queue = [] if fresh else self._queue
        for run in np.flatnonzero(chosen):
            if not self._queue:
                drawn = Conditions.draw(self.grid, max(self.runs, POOL), int(rng.integers(2**31)))
                self._queue = [drawn.only(one) for one in range(len(drawn.x0))]
                self._w = self._w if self._w.size else np.repeat(0 * drawn.w[:, :1], self.runs, axis=1)
            conditions = self._queue.pop()
            self._owed[run], self.x[run], self._w[:, run] = 0.0, conditions.x0[0], conditions.w[:, 0]
            self._errors[:-1, run] = conditions.errors[:, 0]
            self._shares[run] = rng.uniform(-1, 1, self._shares.shape[1])
        self.k[chosen] = self._active[chosen] = 0

    def observe(self) -> Array:
        """Return the inputs of policies, from the states as measured, shape (R, r)."""
        estimates = self.x + self._errors[self.k, np.arange(self.runs)]
        return self._read(self.k, estimates, self._shares) * self.scale

    def _read(self, k: NDArray[np.int_], x: Array, share: Array | float) -> Array:
        grid = self.grid
        step = np.minimum(k * grid.nodes // grid.clearance.q, len(self._nu) - 1)
        t, bodies = (step * grid.tracking.delta)[:, None], self._bodies[0][k] + share * self._bodies[1][k]
        parts = self.senses.parts(self.target[k * grid.nodes], x, t, self._nu[step], bodies)
        return stacked(tuple(self.inputs), parts)

    def advance(self, u: Array, moving: NDArray[np.bool_] | None = None) -> dict[str, NDArray[Any]]:
        """Fly a decision period with inputs (R, m), clipped to the limits; some flights may stand still.

        Where an input is not finite, S flies under the monitor, and nothing thrusts without it.

        Returns
        -------
        dict of str to ndarray, shape (R,)
            ``reward``; ``collided`` (at a node, with an unsafe set as perceived); ``ended`` (the plan);
            ``intervened`` (S flew); ``margin`` of the monitor, if there is one (least share left);
            ``distance_m`` (least at the nodes, by the farthest facet of a set); ``delta_v_m_s`` (spent).
        """
        moving = np.ones(self.runs, dtype=bool) if moving is None else moving
        names = FIELDS if self.monitor is None else (*FIELDS, "margin")
        out = {name: np.zeros(self.runs, dtype=bool if name in FLAGS else float) for name in names}
        for k in np.unique(self.k[moving]).tolist():
            chosen = np.flatnonzero(moving & (self.k == k))
            for name, values in self._advanced(k, chosen, u[chosen]).items():
                out[name][chosen] = values
        return out

    def _advanced(self, k: int, chosen: NDArray[np.intp], u: Array) -> dict[str, NDArray[Any]]:
        """The flights that are all at decision k."""
        grid, finite, x = self.grid, np.asarray(np.isfinite(u).all(axis=1)), self.x[chosen]
        columns: dict[str, NDArray[Any]] = {}
        mode = np.full(len(chosen), FILTERED)
        if self.monitor is not None:
            e = x + self._errors[k, chosen] - grid.xi[k * grid.nodes]
            judged, columns["margin"] = self.monitor.judge(k, e, self._active[chosen])
            mode = np.where((judged > 0) & finite, FILTERED, 0)
        u = np.where(finite[:, None], u, 0.0)
        distance, impulse = np.full(len(chosen), np.inf), np.zeros(len(chosen))
        rows, offsets, _ = grid.facets
        self.engine.rest = self._owed[chosen] if grid.system.timing.carried_impulse else None
        for node in range(k * grid.nodes, (k + 1) * grid.nodes):
            x, _, _, thrust = self.engine.step(node, mode, u, x, self._w[node, chosen])
            impulse += thrust * self.engine.dt
            clearance = x @ rows.T - offsets[node + 1]
            distance = np.minimum(distance, grid.nearest(clearance))
        self.x[chosen], self.k[chosen], self._active[chosen] = x, k + 1, mode != 0
        if self.engine.rest is not None:
            self._owed[chosen] = self.engine.rest
        offset = (x - self.target[(k + 1) * grid.nodes]) @ grid.system.position.T
        near = 1 / (1 + np.linalg.norm(offset, axis=1) / self._length)
        value = near - self.effort * impulse / (grid.period * grid.system.u_max.sum())
        return columns | {
            "reward": value / grid.decisions - (distance < 0),
            "collided": np.asarray(distance < 0),
            "ended": np.full(len(chosen), k + 1 == grid.decisions),
            "intervened": np.asarray(mode == 0),
            "distance_m": distance,
            "delta_v_m_s": impulse / grid.system.mass,
        }
