"""References made with a controller in view: paths whose inputs are those of its own law, step by step."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from reach.numerics.linear import discretize

from ..model.system import Array, LinearSystem
from .reference import Reference
from .rows import Key, PlanRows
from .search import Candidate, CheckedPath, PathSearch

MOST = 10.0
"""Largest departure from a law, in shares of full thrust; a path within the limits needs at most two."""


@dataclass(frozen=True, eq=False)
class Followed:
    """A law as the planner sees it: the constant input ``F x_k + f_k`` over step k."""

    F: Array  # (m, n)
    f: Array  # (K, m)

    @classmethod
    def from_law(cls, system: LinearSystem, transition: Array, reference: Reference) -> "Followed":
        """The constant inputs that come closest to a law about its own reference.

        About it the error moves by `transition` (n, n) in a step; a constant input that moves it likewise is
        found by least squares, velocities weighed by the step.
        """
        Ad, Bd = discretize(system.A, system.B, reference.delta)
        weight = np.ones(system.n)
        weight[np.abs(system.position).sum(axis=0) == 0] = reference.delta
        F = np.linalg.pinv(weight[:, None] * Bd) @ (weight[:, None] * (transition - Ad))
        return cls(F, reference.nu - reference.chi[: reference.cells] @ F.T)


class FollowingSearch(PathSearch):
    """A path search whose inputs follow a law, but for departures at a price: `set_prices_of_departure`."""

    def __init__(self, rows: PlanRows, deadline: float, law: Followed) -> None:
        super().__init__(rows, deadline, 2 * rows.N)
        N, K, m = rows.N, rows.problem.K, rows.problem.system.m
        law_rows, free = np.zeros((K, m, N)), np.zeros((K, m))
        for k in range(K):
            law_rows[k] = rows.state_rows(law.F, k)
            free[k] = law.F @ rows.free[k] + law.f[k]
        u_max = rows.problem.system.u_max
        self._map = np.eye(N) - (law_rows / u_max[:, None]).reshape(N, N)
        self._free = (free / u_max).ravel()
        eye = np.eye(N)
        self.lp.add(np.hstack([self._map, -self._map, np.zeros((N, 2)), -eye, eye]), self._free, self._free)
        self.base = self.lp.rows
        self.guide: CheckedPath | None = None

    def set_prices_of_departure(self, prices: Array) -> None:
        """Price of a departure by full thrust [m/s], shape (K,): 0 where free, infinite where forbidden."""
        costs = np.tile(np.repeat(prices, self.rows.problem.system.m), 2)
        first, allowed = 2 * self.rows.N + 2, np.isfinite(costs)
        self.lp.price(first, np.where(allowed, costs, 0.0))
        self.lp.limit(first, np.zeros(len(costs)), np.where(allowed, MOST, 0.0))

    def departures(self, path: Candidate) -> Array:
        """Largest departure from the law in every step, in shares of full thrust, shape (K,)."""
        parts = np.abs(self._map @ path.z - self._free)
        return np.asarray(parts.reshape(self.rows.problem.K, -1).max(axis=1))

    def best(self, start: Mapping[Key, int]) -> Candidate | None:
        """A path that keeps every clearance, on the guide's side of everything; None if none is found."""
        path = self.dive(start)
        return path if path is not None and path.short == 0 else None

    def improved(self, path: Candidate | None) -> Candidate | None:
        """Improve the path: choose anew the facets with most clearance, whatever the guide, while it pays."""
        if path is None:
            return None
        guide, self.guide = self.guide, None
        path = self.improve(path, rounds=2)
        self.guide = guide
        return path

    def pick(self, key: Key, checked: CheckedPath) -> int:
        """The alternative with most clearance, on the guide if there is one."""
        return super().pick(key, checked if self.guide is None or key[0] < 0 else self.guide)
