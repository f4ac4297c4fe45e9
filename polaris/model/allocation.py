"""Thrusters that push only: the box of inputs that they make, whichever one of them has failed, and how."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import product

import numpy as np
from scipy.optimize import linprog

from .errors import ScenarioError, SynthesisInfeasible
from .system import Array

MOST_INPUTS = 6  # most inputs: their signs have two combinations for each
MOST_THRUSTERS = 100
ROUNDED = 1e-9  # share by which the box is smaller than what is found: rounding of a linear program
LEAST = 1e-7  # share of the largest push of a mix below which a thruster takes no part in it
OFF = 1e-12  # share of an input that mixes are off it; where thrusters barely push a way they are further


@dataclass(frozen=True)
class Fault:
    """One thruster, any, at any time, gives no more than a share of its thrust from then on.

    That is known after at most `isolation` [s]. Of none less is `left` while navigation is lost for as long.
    """

    name: str
    left: float
    isolation: float = 0.0


@dataclass(frozen=True, eq=False)
class Allocation:
    """Mixing table of N thrusters ``0 <= f <= limits`` for m inputs ``u = directions' f``.

    An input u is made by ``f = sum_i |u_i| mixes[case, sign of u_i, i]``, the case being which thruster has
    failed. What a thruster is asked for is thus known, whatever the other inputs are.
    """

    directions: Array  # (N, m)
    limits: Array  # (N,) [N]
    u_max: Array  # (m,): every input within these is made in every case (docs/theory.md, Proposition 5 (c))
    mixes: Array
    """Thrusts per unit of each input, forwards and backwards, (cases, 2, m, N): without a fault, then with
    each fault of each thruster."""

    @classmethod
    def of(cls, directions: Array, limits: Array, wanted: Array, faults: Sequence[Fault]) -> "Allocation":
        """The largest box of the shape of `wanted` (m,), and no larger, and the least thrust that makes it.

        Raises
        ------
        ScenarioError
            If shapes do not fit.
        SynthesisInfeasible
            If there is none: the thrusters that are left do not push every way.
        """
        count, m = directions.shape
        if m != len(wanted) or m > MOST_INPUTS or count > MOST_THRUSTERS:
            rule = f"must have {len(wanted)} numbers per thruster, for at most {MOST_INPUTS} inputs and "
            rule += f"{MOST_THRUSTERS} thrusters"
            raise ScenarioError("thrusters.directions", directions.shape, rule)
        every, share = cases(limits, faults), 1.0
        scaled = (directions / wanted).tobytes()
        for what, capacity in every:
            reach = _mixes(scaled, capacity.tobytes(), 0.0)[0]
            if not reach > ROUNDED:
                raise SynthesisInfeasible(
                    f"the thrusters do not push every way {what}.",
                    relax="add thrusters (thrusters.directions), or take the fault out.",
                )
            share = min(share, reach * (1 - ROUNDED))
        found = np.array([_mixes(scaled, capacity.tobytes(), share)[1] for _, capacity in every])
        mixes = np.array([_exact(directions, mix / (share * wanted[:, None])) for mix in found])
        off = np.abs(mixes @ directions - np.array([1.0, -1.0])[:, None, None] * np.eye(m)).max(axis=1)
        if np.max(wanted @ off / wanted) > OFF:
            raise SynthesisInfeasible(
                "the thrusters barely push every way, or are too unequal: rounding spoils what they make.",
                relax="turn thrusters (thrusters.directions) so that more of their push is along each input.",
            )
        asked, capacity = (share * wanted) @ mixes.max(axis=1), np.array([top for _, top in every])
        fits = np.min(capacity[asked > 0] / asked[asked > 0], initial=2.0)
        u_max = min(float(fits) * (1 - ROUNDED), 1.0) * share * wanted
        return cls(directions, limits, u_max, mixes)

    def thrusts(self, u: Array) -> Array:
        """Return the thrusts that make inputs (..., m) without a fault, shape (..., N)."""
        return np.asarray(np.maximum(u, 0) @ self.mixes[0, 0] + np.maximum(-u, 0) @ self.mixes[0, 1])

    @cached_property
    def asked(self) -> Array:
        """Return the sets of thrusters that may be asked at once, (sets, N): 1 for each in one, else 0."""
        signs = np.array(list(product((0, 1), repeat=len(self.u_max))))
        each = self.mixes[:, signs, np.arange(len(self.u_max))] > 0
        return np.unique(each.any(axis=2).reshape(-1, len(self.limits)), axis=0).astype(float)

    @cached_property
    def lengths(self) -> Array:
        """Return the length of each thruster's direction, (N,)."""
        return np.asarray(np.linalg.norm(self.directions, axis=1))

    def at_once(self, each: Array) -> Array:
        """Return the largest sums of numbers of thrusters (N, ...) over those asked at once, shape (...)."""
        return np.asarray(np.tensordot(self.asked, each, 1).max(axis=0))

    def shares(self, each: Array) -> Array:
        """Bound sums over thrusters of their thrusts times `each` (N, m) by inputs: (m, m) per unit of u."""
        return np.asarray(np.max(self.mixes @ each, axis=(0, 1)).T)


def axis_pairs(limits: Array) -> tuple[Array, Array]:
    """Directions and limits of one thruster either way along every input."""
    eye = np.eye(len(limits))
    return np.vstack([eye, -eye]), np.concatenate([limits, limits])


def cases(limits: Array, faults: Sequence[Fault]) -> list[tuple[str, Array]]:
    """Limits without a fault, and with each fault of each thruster, in words."""
    found = [("with all thrusters", limits)]
    for fault in faults:
        for j in range(len(limits)):
            capacity = np.where(np.arange(len(limits)) == j, fault.left * limits, limits)
            found.append((f"with thruster {j} under the fault {fault.name}", capacity))
    return found


@lru_cache(maxsize=1024)
def _mixes(scaled: bytes, capacity: bytes, share: float) -> tuple[float, Array]:
    """Return how many times a box is made, at most twice, and mixes (2, m, N) that make it by least thrust.

    Directions are per unit of the box, and arrays given by their entries. The share of the box is searched
    where 0 is given; the mixes are those of this share.
    """
    limits = np.frombuffer(capacity)
    N = len(limits)
    D = np.frombuffer(scaled).reshape(N, -1)
    m, eye = D.shape[1], np.eye(N)
    count = 2 * m * N  # thrusts by sign, input and thruster; then the larger ones of both signs; the share
    makes = np.hstack([np.kron(np.eye(2 * m), D.T), np.zeros((2 * m * m, m * N)), np.zeros((2 * m * m, 1))])
    makes[:, -1] = -np.kron([1.0, -1.0], np.eye(m).ravel())
    larger = np.hstack([np.eye(count), -np.tile(np.eye(m * N), (2, 1)), np.zeros((count, 1))])
    within = np.hstack([np.zeros((N, count)), np.tile(eye, m), np.zeros((N, 1))])
    cost = np.zeros(makes.shape[1])
    cost[:count] = share > 0
    cost[-1] = -1.0 * (share == 0)
    solved = linprog(
        cost,
        A_ub=np.vstack([larger, within]),
        b_ub=np.concatenate([np.zeros(count), limits]),
        A_eq=makes,
        b_eq=np.zeros(len(makes)),
        bounds=[(0, None)] * (len(cost) - 1) + [(share or 0.0, share or 2.0)],
        method="highs",
    )
    if solved.status != 0:
        return 0.0, np.zeros((2, m, N))
    return float(solved.x[-1]), solved.x[:count].reshape(2, m, N)


def _exact(directions: Array, mixes: Array) -> Array:
    """Return mixes (2, m, N) that make a unit of their input to rounding, with no more thrusters."""
    size = mixes * np.linalg.norm(directions, axis=1)
    found = np.where(size > LEAST * size.max(axis=-1, keepdims=True), mixes, 0.0)
    for sign, mix in zip((1.0, -1.0), found, strict=True):
        for unit, f in zip(sign * np.eye(len(mix)), mix, strict=True):
            some = np.flatnonzero(f)
            f[some] += np.linalg.pinv(directions[some].T) @ (unit - directions.T @ f)
    return np.maximum(found, 0.0)
