"""Linear rows of the planning model: states, cells and bounds as functions of the inputs.

The states are condensed out: every condition is a row over the inputs alone. The inputs are read as
shares ``z = nu / u_limit``-free of units (``nu_k,i = u_max_i z_k,i``), positions in units of `length`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from reach.linear import discretize, growth, powers

from ..system import Array
from ..tolerances import SOLVER_BOOK_INPUT, SOLVER_BOOK_M
from .problem import PlanProblem

SEGMENTS = (1, 2, 4, 8, 16, 32)


@dataclass(frozen=True, eq=False)
class CellRows:
    """Rows ``a z >= need + slope * s`` (in units of length) that keep one cell beyond one facet.

    Attributes
    ----------
    a : ndarray, shape (R, N)
        Coefficients of the input shares.
    need : ndarray, shape (R,)
        Right-hand sides without extra margin.
    slope : float
        How much one unit of the margin variable adds.
    """

    a: Array
    need: Array
    slope: float


class Rows:
    """Everything the planner knows about one problem, as rows over the N = K m input shares."""

    def __init__(self, problem: PlanProblem) -> None:
        self.problem = problem
        system, delta = problem.system, problem.delta
        self.Ad, self.Bd = discretize(system.A, system.B, delta)
        self.N = problem.K * system.m
        self.limit = (problem.u_limit / system.u_max).ravel() * (1 - SOLVER_BOOK_INPUT)
        self.price = np.tile(system.u_max * delta / system.mass, problem.K)
        self.length = max(1e-3, float(np.max(np.abs(system.position @ problem.x0), initial=0.0)) / 10)
        self.free = np.einsum("kij,j->ki", powers(self.Ad, problem.cells), problem.x0)
        impulse = powers(self.Ad, problem.cells) @ (self.Bd * system.u_max)
        self._impulse = impulse
        self._offsets = [problem.offsets(i) for i in range(len(problem.unsafe))]
        self._required = [problem.required(i) for i in range(len(problem.unsafe))]
        self.extra = [np.zeros((problem.cells, 1)) for _ in problem.unsafe]
        self.booking = [np.full(r.shape, SOLVER_BOOK_M) for r in self._required]
        self._cache: dict[tuple[int, int, int], CellRows] = {}

    def state_rows(self, g: Array, k: int) -> Array:
        """Coefficients of ``g x_k`` over the input shares, shape (R, N), for rows g of shape (R, n)."""
        K, m = self.problem.K, self.problem.system.m
        out = np.zeros((len(g), K, m))
        last = min(k, K)
        if last:
            # u_j acts on x_k through Ad^(k-1-j) Bd
            out[:, :last] = np.einsum("rn,jnm->rjm", g, self._impulse[k - last : k][::-1])
        return out.reshape(len(g), self.N)

    def trajectory(self, z: Array) -> tuple[Array, Array]:
        """States (cells+1, n) and inputs (cells, m, zero in the tail) of input shares z (N,)."""
        problem = self.problem
        nu = np.zeros((problem.cells, problem.system.m))
        nu[: problem.K] = z.reshape(problem.K, -1) * problem.system.u_max
        chi = np.empty((problem.cells + 1, problem.system.n))
        chi[0] = problem.x0
        for k in range(problem.cells):
            chi[k + 1] = self.Ad @ chi[k] + self.Bd @ nu[k]
        return chi, nu

    @cached_property
    def segments(self) -> int:
        """Cubic arcs per cell, so many that the remainder of each is small."""
        for q in SEGMENTS:
            if np.max(self._remainder(q)) <= max(20 * SOLVER_BOOK_M, 2e-5 * self.length):
                return q
        return SEGMENTS[-1]

    def _remainder(self, q: int) -> Array:
        """Rough bound [m] per axis on what a cubic arc over delta / q leaves out; re-checked later."""
        system, h = self.problem.system, self.problem.delta / q
        CA3 = system.position @ np.linalg.matrix_power(system.A, 3)
        reach = np.max(np.abs(self.free), axis=0) * 1.5
        grow = growth(system.A, h)
        rate = np.abs(CA3 @ system.A) @ (grow @ reach) + np.abs(CA3 @ system.B) @ system.u_max
        return np.asarray(rate * h**4 / 384)

    @cached_property
    def control_points(self) -> tuple[Array, Array, Array]:
        """Bezier control points ``P x_k + Q u_k`` of the path in a cell, and their shares of the cell.

        Shapes (R, d, n), (R, d, m), (R,). The path lies in their hull, up to the remainder of a cubic arc.
        """
        system, q = self.problem.system, self.segments
        h = self.problem.delta / q
        C, CA, CB = system.position, system.velocity, system.position @ system.B
        P, Q, share = [], [], []
        for j in range(q):
            (E0, F0), (E1, F1) = (discretize(system.A, system.B, h * i) for i in (j, j + 1))
            start, end = (C @ E0, C @ F0), (C @ E1, C @ F1)
            lead = (start[0] + h / 3 * CA @ E0, start[1] + h / 3 * (CA @ F0 + CB))
            trail = (end[0] - h / 3 * CA @ E1, end[1] - h / 3 * (CA @ F1 + CB))
            arc = [start, lead, trail, end] if j == q - 1 else [start, lead, trail]
            P += [p for p, _ in arc]
            Q += [u for _, u in arc]
            share += [(j + i / 3) / q for i in range(len(arc))]
        return np.array(P), np.array(Q), np.array(share)

    def cell(self, i: int, k: int, f: int) -> CellRows:
        """Rows that keep cell k beyond facet f of unsafe set i, with what is booked at present."""
        key = (i, k, f)
        if key not in self._cache:
            problem = self.problem
            P, Q, share = self.control_points
            normal = problem.unsafe[i].normals[f]
            g, h = np.einsum("d,rdn->rn", normal, P), np.einsum("d,rdm->rm", normal, Q)
            a = self.state_rows(g, k)
            if k < problem.K:
                m = problem.system.m
                a[:, k * m : (k + 1) * m] += h * problem.system.u_max
            b = self._offsets[i][k, 0, f] * (1 - share) + self._offsets[i][k, 1, f] * share
            need = b + self._required[i][k, f] - g @ self.free[k]
            self._cache[key] = CellRows(a / self.length, need / self.length, 0.0)
        rows = self._cache[key]
        booked = self.booking[i][k, f] + float(np.abs(self.problem.unsafe[i].normals[f]) @ self._book)
        return CellRows(rows.a, rows.need + booked / self.length, float(self.extra[i][k, 0]) / self.length)

    @cached_property
    def _book(self) -> Array:
        return 2 * self._remainder(self.segments)

    def local(self, i: int, k: int, f: int) -> tuple[Array, Array, Array]:
        """The rows of `cell` over the state and the input at the cell's start, before condensing.

        Returns ``g`` (R, n), ``h`` (R, m) over the input shares, and ``need`` (R,), in units of length:
        ``g x_k + h z_k >= need + slope s``. Tail cells refer to the last state instead, with h = 0.
        """
        problem, (P, Q, _) = self.problem, self.control_points
        normal = problem.unsafe[i].normals[f]
        g, h = np.einsum("d,rdn->rn", normal, P), np.einsum("d,rdm->rm", normal, Q) * problem.system.u_max
        need = self.cell(i, k, f).need + g @ self.free[k] / self.length
        if k >= problem.K:
            g, h = g @ np.linalg.matrix_power(self.Ad, k - problem.K), h * 0.0
        return g / self.length, h / self.length, need

    def extreme(self, a: Array, budget: float = np.inf) -> Array:
        """Largest ``a z`` over the input limits and a velocity change of at most `budget`, per row."""
        gain, cost = np.abs(a) * self.limit, self.price * self.limit
        if np.sum(cost) <= budget:
            return np.asarray(np.sum(gain, axis=1))
        order = np.argsort(-np.abs(a) / self.price, axis=1)
        spent = np.cumsum(cost[order], axis=1)
        taken = np.clip((budget - (spent - cost[order])) / np.maximum(cost[order], 1e-300), 0.0, 1.0)
        return np.asarray(np.sum(np.take_along_axis(gain, order, axis=1) * taken, axis=1))
