"""Thrusters that push only: the inputs that they make, whichever has failed, and what each does wrong."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import product

import numpy as np
from scipy.optimize import linprog

from .errors import ScenarioError, SynthesisInfeasible
from .system import Array
from .thrusters import Thrusters

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
        """Find the largest box of the shape of `wanted` (m,), no larger than it, and the least thrust for it.

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
        rough = np.array([_mixes(scaled, capacity.tobytes(), share)[1] for _, capacity in every])
        mixes = np.array([_exact(directions, mix / (share * wanted[:, None])) for mix in rough])
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


@dataclass(frozen=True, eq=False)
class Nozzles:
    """Errors of thrusters one by one, and how impulses are made by each, for the inputs that they make.

    What a thruster makes of its command f lies within ``f (along |d| + across side)`` of ``f d``, d being its
    direction and `side` the length of what it has in the other inputs.
    """

    allocation: Allocation
    along: float  # share by which thrust may be off along a nozzle
    across: float  # share that it may have to its side
    mass: float  # share by which the mass may be off
    bit: float = 0.0  # impulse of which every thruster makes multiples [N s]
    carried: bool = False  # whether it carries what is left
    pulsed: bool = False

    @classmethod
    def of(
        cls, allocation: Allocation, magnitude: float, turned: float, mass: float, bit: float, *kinds: bool
    ) -> "Nozzles":
        """From errors of magnitude, of direction [rad] and of the mass, and how impulses are made."""
        along = magnitude + (1 - magnitude) * 2 * float(np.sin(turned / 2)) ** 2
        return cls(allocation, along, float(np.sin(turned)) * (1 + magnitude), mass, bit, *kinds)

    @cached_property
    def error(self) -> Array:
        """Bound on the error in each input of a unit of thrust, the mass being exact, (N, m)."""
        d = self.allocation.directions
        side = np.sqrt(np.maximum(np.sum(d**2, axis=1, keepdims=True) - d**2, 0.0))
        return np.asarray(self.along * np.abs(d) + self.across * side)

    @cached_property
    def largest(self) -> Array:
        """The most that a unit of thrust makes in each input, errors included, (N, m)."""
        return np.asarray((np.abs(self.allocation.directions) + self.error) / (1 - self.mass))

    def errors(self, period: float) -> Thrusters:
        """Bound errors of the inputs, renewed every `period` [s], by inputs (docs/theory.md, Prop. 5 (d))."""
        T = self.allocation.shares(self.error)
        T = (T + self.mass * np.eye(len(T))) / (1 - self.mass)
        wrong = self.largest - np.abs(self.allocation.directions) if self.carried else self.largest / 2
        bit = self.bit / period * self.allocation.at_once(wrong) * (1 + 1e-9)
        shares = tuple(map(tuple, (T * (1 + 1e-9)).tolist())) if np.any(T) else ()
        return Thrusters(0.0, 0.0, tuple(bit.tolist()) if np.any(bit) else 0.0, shares)

    @cached_property
    def weights(self) -> Array:
        """Return the most thrust, of all thrusters together, that a unit of each input takes, (m,)."""
        return np.asarray(np.max(self.allocation.mixes @ self.allocation.lengths, axis=(0, 1)) * (1 + 1e-9))

    @property
    def left(self) -> float:
        """Most of an input's impulse that may be left in all thrusters [N s]."""
        d = self.allocation.directions
        return self.bit * self.carried * max(float(np.maximum(s * d, 0).sum(axis=0).max()) for s in (1, -1))

    @property
    def fired(self) -> tuple[float, ...]:
        """Bound on what pulses of thrusters asked at once make in every input [N]; none if they are held."""
        if not self.pulsed:
            return ()
        return tuple(self.allocation.at_once(self.largest * self.allocation.limits[:, None]).tolist())


def axis_pairs(limits: Array) -> tuple[Array, Array]:
    """Directions and limits of one thruster either way along every input."""
    eye = np.eye(len(limits))
    return np.vstack([eye, -eye]), np.concatenate([limits, limits])


def cases(limits: Array, faults: Sequence[Fault]) -> list[tuple[str, Array]]:
    """Limits without a fault, and with each fault of each thruster, in words."""
    every = [("with all thrusters", limits)]
    for fault in faults:
        for j in range(len(limits)):
            capacity = np.where(np.arange(len(limits)) == j, fault.left * limits, limits)
            every.append((f"with thruster {j} under the fault {fault.name}", capacity))
    return every


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
    exact = np.where(size > LEAST * size.max(axis=-1, keepdims=True), mixes, 0.0)
    for sign, mix in zip((1.0, -1.0), exact, strict=True):
        for unit, f in zip(sign * np.eye(len(mix)), mix, strict=True):
            some = np.flatnonzero(f)
            f[some] += np.linalg.pinv(directions[some].T) @ (unit - directions.T @ f)
    return np.maximum(exact, 0.0)
