"""Reference trajectories: D2C of section III-C, exact between the waypoints."""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import accumulate

import numpy as np

from reach.numerics.linear import discretize, growth
from reach.short_repr import short_repr

from ..model.system import Array, LinearSystem
from ..model.tolerances import REFERENCE


@lru_cache(maxsize=256)
def _step_maps(system: LinearSystem, delta: float, q: int) -> tuple[Array, Array]:
    """Return maps of states and held inputs over j of q parts of a step, (q+1, n, n) and (q+1, n, m)."""
    Ad, Bd = zip(*(discretize(system.A, system.B, delta * j / q) for j in range(q + 1)), strict=True)
    return np.array(Ad), np.array(Bd)


@short_repr
@dataclass(frozen=True, eq=False)
class Reference:
    """A trajectory that obeys the undisturbed dynamics, with piecewise constant input (D2C).

    Parameters
    ----------
    system : LinearSystem
        Whose dynamics it obeys.
    delta : float
        Step [s] over which the input is constant.
    chi : ndarray, shape (K+1, n)
        States at the waypoints ``k * delta``.
    nu : ndarray, shape (K, m)
        Input over ``[k * delta, (k+1) * delta)``.
    """

    system: LinearSystem
    delta: float
    chi: Array
    nu: Array

    @classmethod
    def propagate(cls, system: LinearSystem, delta: float, x0: Array, nu: Array) -> "Reference":
        """Build from an initial state and inputs by exact zero-order-hold discretization (eq. 13)."""
        Ad, Bd = (part[1] for part in _step_maps(system, delta, 1))
        chi = [*accumulate((Bd @ u for u in nu), lambda x, v: Ad @ x + v, initial=np.asarray(x0, float))]
        return cls(system, delta, np.array(chi), np.array(nu, dtype=float))

    @property
    def cells(self) -> int:
        """Number K of steps."""
        return len(self.nu)

    @cached_property
    def rounding(self) -> Array:
        """Bound on the round-off of the states within every step, elementwise, shape (K, n)."""
        Ad, Bd = (np.abs(part[1]) for part in _step_maps(self.system, self.delta, 1))
        size = np.abs(self.chi[:-1]) @ Ad.T + np.abs(self.nu) @ Bd.T
        return np.asarray(REFERENCE * (size + np.abs(self.chi[:-1]) + np.abs(self.chi[1:])))

    def fine(self, q: int) -> Array:
        """States at q equal parts of every cell, both ends included, shape (K, q+1, n).

        The last point of a cell is recomputed from its first, not copied from the next, so the
        array shows every cell as one exact arc.
        """
        Ad, Bd = _step_maps(self.system, self.delta, q)
        arcs = np.einsum("qij,kj->kqi", Ad, self.chi[:-1])
        return np.asarray(arcs + np.einsum("qij,kj->kqi", Bd, self.nu))

    def rates(self, nodes: Array) -> Array:
        """Elementwise bound on ``|x'|`` over each of the q parts between the nodes of `fine`, (K, q, n)."""
        A = self.system.A
        rate = nodes[:, :-1] @ A.T + (self.nu @ self.system.B.T)[:, None, :]
        return np.asarray(np.abs(rate) @ growth(A, self.delta / (nodes.shape[1] - 1)).T)

    def extend(self, cells: int) -> "Reference":
        """Return the trajectory followed by `cells` steps with zero input (coasting)."""
        tail = Reference.propagate(self.system, self.delta, self.chi[-1], np.zeros((cells, self.system.m)))
        chi, nu = np.vstack([self.chi, tail.chi[1:]]), np.vstack([self.nu, tail.nu])
        return Reference(self.system, self.delta, chi, nu)
