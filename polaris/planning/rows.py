"""Linear rows of the planning model: states, cells and bounds as functions of the inputs.

The states are condensed out: every condition is a row over the inputs alone. The inputs are read as
shares ``z = nu / u_limit``-free of units (``nu_k,i = u_max_i z_k,i``), positions in units of `length`, rows
of the goal in units of `goal_length`, of which the solver's tolerance is a share.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from reach.numerics.linear import discretize, growth, powers

from ..model.system import Array
from ..model.tolerances import GOAL, SOLVER_BOOK_INPUT, SOLVER_BOOK_M, SOLVER_FEASIBILITY
from .problem import PlanProblem
from .reference import Reference

SEGMENTS = (1, 2, 4, 8, 16, 32)


Key = tuple[int, int]  # a disjunction: (unsafe set, cell), or (-1, group) for one of the goal's


@dataclass(frozen=True, eq=False)
class Disjunction:
    """The J alternatives of one disjunction, each R rows ``a z >= need + slope * s`` in units of length.

    Over the N input shares z and the margin variable s. Before the states are condensed out the rows read
    ``g x_at + h z_at >= need + free + slope * s``. Shapes: a (J, R, N); need, free (J, R); g (J, R, n);
    h (J, R, m).
    """

    a: Array
    at_least: Array
    slope: float
    at: int
    g: Array
    h: Array
    free: Array


class PlanRows:
    """Everything the planner knows about one problem, as rows over the N = K m input shares."""

    def __init__(self, problem: PlanProblem) -> None:
        self.problem = problem
        system, delta = problem.system, problem.delta
        self.Ad, self.Bd = discretize(system.A, system.B, delta)
        self.N = problem.K * system.m
        self.limit = (problem.u_limit / system.u_max).ravel() * (1 - SOLVER_BOOK_INPUT)
        self.price = np.tile(system.u_max * delta / system.mass, problem.K)
        self.length = max(1e-3, float(np.max(np.abs(system.position @ problem.x0), initial=0.0)) / 10)
        exact = GOAL / (2 * SOLVER_FEASIBILITY) * problem.goal.conditions.scale
        self.goal_length = min(self.length, exact)
        self.free = np.einsum("kij,j->ki", powers(self.Ad, problem.cells), problem.x0)
        self._impulse = powers(self.Ad, problem.K) @ (self.Bd * system.u_max)
        self._normals = [body.rows(system) for body in problem.unsafe]
        self._offsets = [problem.offsets(i) for i in range(len(problem.unsafe))]
        self._required = [problem.required(i) for i in range(len(problem.unsafe))]
        self.extra = [np.zeros((problem.cells, 1)) for _ in problem.unsafe]
        self.booking = [np.zeros(r.shape) for r in self._required]
        self._cache: dict[Key, Disjunction] = {}

    def state_rows(self, g: Array, k: int) -> Array:
        """Coefficients of ``g x_k``, k <= K, over the input shares, (..., N) for rows g of shape (..., n)."""
        K, m = self.problem.K, self.problem.system.m
        out = np.zeros((*g.shape[:-1], K, m))
        # u_j acts on x_k through Ad^(k-1-j) Bd
        out[..., :k, :] = np.einsum("...n,jnm->...jm", g, self._impulse[:k][::-1])
        return out.reshape(*g.shape[:-1], self.N)

    @cached_property
    def segments(self) -> int:
        """Cubic arcs per cell, so many that the remainder of each is small."""
        system, unsafe = self.problem.system, self.problem.unsafe
        measured = np.abs(np.vstack([system.position, *(u.rows(system) for u in unsafe if u.of_state)]))
        for q in SEGMENTS:
            if np.max(measured @ self._remainder(q)) <= max(20 * SOLVER_BOOK_M, 2e-5 * self.length):
                return q
        return SEGMENTS[-1]

    def _remainder(self, q: int) -> Array:
        """Rough bound per state, (n,), on the error of a cubic arc over delta / q; re-checked later."""
        system, h = self.problem.system, self.problem.delta / q
        A3 = np.linalg.matrix_power(system.A, 3)
        reach = np.max(np.abs(self.free), axis=0) * 1.5
        grow = growth(system.A, h)
        rate = np.abs(A3 @ system.A) @ (grow @ reach) + np.abs(A3 @ system.B) @ system.u_max
        return np.asarray(rate * h**4 / 384)

    @cached_property
    def control_points(self) -> tuple[Array, Array, Array]:
        """Bezier control points ``P x_k + Q u_k`` of the states in a cell, and their shares of the cell.

        Shapes (R, n, n), (R, n, m), (R,). The path lies in their hull, up to the remainder of a cubic arc.
        """
        system, q, h = self.problem.system, self.segments, self.problem.delta / self.segments
        A, B = system.A, system.B
        E, F = map(np.array, zip(*(discretize(system.A, system.B, h * i) for i in range(q + 1)), strict=True))
        maps = []
        for at, lead in ((E, h / 3 * A @ E), (F, h / 3 * (A @ F + B))):
            arcs = np.stack([at[:-1], at[:-1] + lead[:-1], at[1:] - lead[1:]], axis=1)
            maps.append(np.concatenate([arcs.reshape(-1, *at.shape[1:]), at[-1:]]))
        return maps[0], maps[1], np.array([(i // 3 + i % 3 / 3) / q for i in range(3 * q + 1)])

    def options(self, key: Key) -> Disjunction:
        """The facets of unsafe set i to stay beyond in cell k, with their present tightening.

        The key (-1, group) means the rows of one of the goal's disjunctions.
        """
        if key not in self._cache:
            self._cache[key] = self._options(key)
        stored, (i, k) = self._cache[key], key
        if i < 0:
            return stored
        slope = float(self.extra[i][k, 0]) / self.length
        at_least = stored.at_least + self._allowance(i, [k])[0].T / self.length
        return replace(stored, at_least=at_least, slope=slope)

    def _allowance(self, i: int, cells: Any) -> Array:
        """Tightening [m] of the rows of some cells of unsafe set i, shape (cells, R, F).

        Control points that no input moves are known exactly: only a re-check tightens them.
        """
        tightening = self.booking[i][cells][:, None]
        movable = self._moving_points[i] | (np.asarray(cells)[:, None, None] > 0)
        return np.asarray(tightening + np.where(movable, self._modelled[i], 0.0))

    def surplus(self, path: Reference) -> tuple[Array, ...]:
        """Slack [m] of a path, coasting included, at the rows of a cell without extra tightening.

        Shapes (cells, F), one per unsafe set. A facet with slack keeps all of its rows: `options` with
        the states known.
        """
        P, Q, share = self.control_points
        cells = self.problem.cells
        points = np.einsum("rin,kn->kri", P, path.chi[:cells]) + np.einsum("rim,km->kri", Q, path.nu[:cells])
        clearances = []
        for i, normals in enumerate(self._normals):
            b = self._offsets[i]
            offset = b[:, 0, None] * (1 - share[:, None]) + b[:, 1, None] * share[:, None]
            at_least = offset + self._required[i][:, None] + self._allowance(i, np.arange(cells))
            clearances.append(np.min(points @ normals.T - at_least, axis=1))
        return tuple(clearances)

    def _options(self, key: Key) -> Disjunction:
        problem, (i, k) = self.problem, key
        at = problem.K if i < 0 else min(k, problem.K)
        if i < 0:
            N, c = problem.goal.conditions.one_of[k]
            g, h, least = N[:, None], np.zeros((len(N), 1, problem.system.m)), c[:, None]
        else:
            P, Q, share = self.control_points
            normals, b = self._normals[i], self._offsets[i][k]
            g, h = np.einsum("fi,rin->frn", normals, P), np.einsum("fi,rim->frm", normals, Q)
            least = b[0][:, None] * (1 - share) + b[1][:, None] * share + self._required[i][k][:, None]
        if k >= problem.K:  # coasting: a condition on the last state
            g, h = g @ np.linalg.matrix_power(self.Ad, k - problem.K), h * 0.0
        unit = self.goal_length if i < 0 else self.length
        g, h, least = g / unit, h * problem.system.u_max / unit, least / unit
        a, free = self.state_rows(g, at), g @ self.free[at]
        if at < problem.K:
            m = problem.system.m
            a[..., at * m : (at + 1) * m] += h
        return Disjunction(a, least - free, 0.0, at, g, h, free)

    @cached_property
    def _modelled(self) -> list[Array]:
        """Tightening [m] of every facet of each unsafe set."""
        remainder = 2 * self._remainder(self.segments)
        return [SOLVER_BOOK_M + np.abs(normals) @ remainder for normals in self._normals]

    @cached_property
    def _moving_points(self) -> list[Any]:
        """Mask of the control points that an input moves along the facets of each unsafe set, (R, F)."""
        Q = self.control_points[1]
        return [np.any(np.einsum("fi,rim->rfm", normals, Q) != 0, axis=2) for normals in self._normals]

    def extreme(self, a: Array, budget: float = np.inf) -> Array:
        """Largest ``a z`` over the input limits and a velocity change of at most `budget`, per row."""
        gain, cost = np.abs(a) * self.limit, self.price * self.limit
        if np.sum(cost) <= budget:
            return np.asarray(np.sum(gain, axis=-1))
        order = np.argsort(-np.abs(a) / self.price, axis=-1)
        total = np.cumsum(cost[order], axis=-1)
        fraction = np.clip((budget - (total - cost[order])) / np.maximum(cost[order], 1e-300), 0.0, 1.0)
        return np.asarray(np.sum(np.take_along_axis(gain, order, axis=-1) * fraction, axis=-1))
