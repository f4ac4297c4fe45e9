"""Thrusters that push only: the inputs that they make, whichever has failed, and by which thrusts."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import product

import numpy as np
from scipy.optimize import linprog, minimize

from .errors import ScenarioError, SynthesisInfeasible
from .system import Array

MOST_INPUTS = 6  # most inputs: their signs have two combinations for each
MOST_THRUSTERS = 100
ROUNDED = 1e-9  # share by which the box is smaller than what is found: rounding of a linear program
LEAST = 1e-7  # share of the largest push of a mix below which a thruster takes no part in it
MIXES = "least_thrust_mixes"
PAIRS = "pseudo_inverse"
PROGRAM = "linear_program"
NEAREST = "nearest"
KINDS = (MIXES, PAIRS, PROGRAM, NEAREST)
"""Kinds of allocation; the last two solve a program for each command, and mixes only bound what they find."""

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
    failed. `PAIRS` makes it by twice the positive part of the pseudo-inverse times u: no thruster is asked
    for more than by the mixes.
    `PROGRAM` makes it by thrusts within the limits of the least sum, each times the length of its direction,
    `NEAREST` by those of the least 2-norm: neither is more than that of the mixes.
    """

    directions: Array  # (N, m)
    limits: Array  # (N,) [N]
    u_max: Array  # (m,): every input within these is made in every case (docs/theory.md, Proposition 5 (c))
    mixes: Array
    """Thrusts per unit of each input, forwards and backwards, (cases, 2, m, N): without a fault, then with
    each fault of each thruster."""
    kind: str = MIXES  # one of `KINDS`

    @classmethod
    def from_directions(
        cls, directions: Array, limits: Array, target: Array, faults: Sequence[Fault], kind: str = MIXES
    ) -> "Allocation":
        """Find the largest box of the shape of `target` (m,), no larger than it, and the least thrust for it.

        Raises
        ------
        ScenarioError
            If shapes do not fit.
        SynthesisInfeasible
            If there is none: the thrusters that are left do not push every way.
        """
        count, m = directions.shape
        if m != len(target) or m > MOST_INPUTS or count > MOST_THRUSTERS:
            rule = f"must have {len(target)} numbers per thruster, for at most {MOST_INPUTS} inputs and "
            rule += f"{MOST_THRUSTERS} thrusters"
            raise ScenarioError("thrusters.directions", directions.shape, rule)
        if not np.all(np.any(directions, axis=1)):
            raise ScenarioError("thrusters.directions", directions.tolist(), "must not be zero")
        fault_cases, share = cases(limits, faults), 1.0
        scaled = (directions / target).tobytes()
        for case, capacity in fault_cases:
            reach = _mixes(scaled, capacity.tobytes(), 0.0)[0]
            if not reach > ROUNDED:
                raise SynthesisInfeasible(
                    f"the thrusters do not span every direction of the inputs {case}.",
                    relax="add thrusters (thrusters.directions), or take the fault out.",
                )
            share = min(share, reach * (1 - ROUNDED))
        if kind == PAIRS:
            mixes = np.array([_mix_pairs(directions, capacity, case) for case, capacity in fault_cases])
        else:
            rough = np.array([_mixes(scaled, capacity.tobytes(), share)[1] for _, capacity in fault_cases])
            mixes = np.array([_exact(directions, mix / (share * target[:, None])) for mix in rough])
        errors = np.abs(mixes @ directions - np.array([1.0, -1.0])[:, None, None] * np.eye(m)).max(axis=1)
        if np.max(target @ errors / target) > OFF:
            raise SynthesisInfeasible(
                "the thrusters barely span every direction of the inputs, or are too unequal.",
                relax="turn thrusters (thrusters.directions) so that more of their push is along each input.",
            )
        demand, capacity = (share * target) @ mixes.max(axis=1), np.array([top for _, top in fault_cases])
        fits = np.min(capacity[demand > 0] / demand[demand > 0], initial=2.0)
        u_max = min(float(fits) * (1 - ROUNDED), 1.0) * share * target
        return cls(directions, limits, u_max, mixes, kind)

    @property
    def solves(self) -> bool:
        """Return True if a program is solved for each command."""
        return self.kind in (PROGRAM, NEAREST)

    @cached_property
    def signs(self) -> Array:
        """Return all signs that inputs may have, (2^m, m): 0 forwards, 1 backwards."""
        return np.array(list(product((0, 1), repeat=len(self.u_max))))

    @cached_property
    def asked(self) -> Array:
        """Return the sets of thrusters that may be asked at once, (sets, N): 1 for each in one, else 0."""
        each = self.mixes[:, self.signs, np.arange(len(self.u_max))] > 0
        return np.unique(each.any(axis=2).reshape(-1, len(self.limits)), axis=0).astype(float)

    @cached_property
    def lengths(self) -> Array:
        """Return the length of each thruster's direction, (N,)."""
        return np.asarray(np.linalg.norm(self.directions, axis=1))

    def at_once(self, each: Array) -> Array:
        """Return the largest sums of numbers of thrusters (N, ...) over those asked at once, shape (...).

        What a program asks lies on one side of a plane: of opposite thrusters one side alone.
        """
        if not self.solves:
            return np.asarray(np.tensordot(self.asked, each, 1).max(axis=0))
        sides: dict[tuple[float, ...], Array] = {}
        for (way, side), number in zip(map(line, self.directions), each, strict=True):
            sides.setdefault(way, np.zeros((2, *number.shape)))[side] += number
        return np.asarray(sum(pair.max(axis=0) for pair in sides.values()))

    @cached_property
    def sizes(self) -> Array:
        """Return the objective of the program at the mix of each unit input, (2, m)."""
        each = self.mixes @ self.lengths if self.kind == PROGRAM else np.linalg.norm(self.mixes, axis=-1)
        return np.asarray(each.max(axis=0) * (1 + 1e-12))

    def multipliers(self, each: Array) -> Array:
        """Choose lambda of `shares` by signs of the inputs and columns of `each` (N, k), (2^m, k, m)."""
        if not self.solves:
            return np.zeros((0, each.shape[1], len(self.u_max)))
        choose = _program_bound if self.kind == PROGRAM else _norm_bound
        corners = [(1.0 - 2.0 * s, self.sizes[s, np.arange(len(s))]) for s in self.signs]
        return np.array([[choose(self, column, *corner) for column in each.T] for corner in corners])

    def shares(self, each: Array, multipliers: Array) -> Array:
        """Bound sums over thrusters of thrusts times `each` (N, k) per unit of each input, (k, m).

        Of a program it is ``sum_t f_t each_t <= lambda u + rest size(f)``, whatever lambda is, and its
        thrusts have no larger size than mixes (docs/theory.md, Proposition 5 (d)).
        """
        if not self.solves:
            return np.asarray(np.max(self.mixes @ each, axis=(0, 1)).T)
        excess = np.maximum(each.T - multipliers @ self.directions.T, 0.0)
        rest = (excess / self.lengths).max(axis=2) if self.kind == PROGRAM else np.linalg.norm(excess, axis=2)
        sizes, ways = self.sizes[self.signs, np.arange(len(self.u_max))], 1.0 - 2.0 * self.signs
        shares = multipliers * ways[:, None] + rest[..., None] * sizes[:, None]
        return np.asarray(np.maximum(shares, 0.0).max(axis=0))


def axis_pairs(limits: Array) -> tuple[Array, Array]:
    """Directions and limits of one thruster either way along every input."""
    eye = np.eye(len(limits))
    return np.vstack([eye, -eye]), np.concatenate([limits, limits])


def cases(limits: Array, faults: Sequence[Fault]) -> list[tuple[str, Array]]:
    """Limits without a fault, and with each fault of each thruster, in words."""
    capacities = [("with all thrusters", limits)]
    for fault in faults:
        for j in range(len(limits)):
            capacity = np.where(np.arange(len(limits)) == j, fault.left * limits, limits)
            capacities.append((f"with thruster {j} under the fault {fault.name}", capacity))
    return capacities


def line(direction: Array) -> tuple[tuple[float, ...], int]:
    """Return a direction with its first number above 0, and 1 if it was turned round for that, else 0."""
    flipped = int(next((x for x in direction.tolist() if x), 0.0) < 0)
    return tuple((x if not flipped else -x) + 0.0 for x in direction.tolist()), flipped


def _mix_pairs(directions: Array, capacity: Array, case: str) -> Array:
    """Return thrusts that make a unit of each input by twice the pseudo-inverse's positive part, (2, m, N).

    Thrusters without any thrust are out, and for each of them one that is opposite to it.
    """
    sides: dict[tuple[float, ...], tuple[list[int], list[int]]] = {}
    for j, direction in enumerate(directions):
        way, side = line(direction)
        sides.setdefault(way, ([], []))[side].append(j)
    mixes, pairs = np.zeros((2, directions.shape[1], len(directions))), list[tuple[Array, list[list[int]]]]()
    for way, pair in sides.items():
        if len(pair[0]) != len(pair[1]):
            rule = "must hold pairs of opposite directions with thrusters.allocation = 'pseudo_inverse'"
            raise ScenarioError("thrusters.directions", list(way), rule)
        working = [[j for j in side if capacity[j] > 0] for side in pair]
        count = min(map(len, working))
        pairs += [(np.array(way), [side[:count] for side in working])] * (count > 0)
    M = sum(
        (2.0 * len(pair[0]) * np.outer(way, way) for way, pair in pairs), 0.0 * np.eye(directions.shape[1])
    )
    if np.linalg.matrix_rank(M) < len(M):
        raise SynthesisInfeasible(
            f"pairs of opposite thrusters do not span every direction of the inputs {case}.",
            relax="add thrusters (thrusters.directions), take the fault out, or choose another allocation.",
        )
    for along, members in pairs:
        unit = 2 * np.linalg.solve(M, along)
        for indices, sign in zip(members, (1, -1), strict=True):
            mixes[:, :, indices] = np.maximum([sign * unit, -sign * unit], 0.0)[:, :, None]
    return mixes


def _program_bound(allocation: Allocation, each: Array, ways: Array, sizes: Array) -> Array:
    """Return lambda (m,) with the least bound of `each` (N,) at the corner of the box with signs `ways`."""
    m, lasts = len(ways), np.append(np.zeros(len(ways)), allocation.u_max @ sizes)
    cost = lasts + np.append(ways * allocation.u_max, 0.0)
    rows = np.hstack([-np.diag(ways), -sizes[:, None]])  # no entry of the bound is negative
    solved = linprog(
        cost / cost[-1],
        A_ub=np.vstack([-np.hstack([allocation.directions, allocation.lengths[:, None]]), rows]),
        b_ub=np.append(-each, np.zeros(m)),
        bounds=[(None, None)] * m + [(0, None)],
        method="highs",
    )
    return np.asarray(solved.x[:m]) if solved.status == 0 else np.zeros(m)


def _norm_bound(allocation: Allocation, each: Array, ways: Array, sizes: Array) -> Array:
    """Return lambda (m,) with a low bound of `each` (N,) at that corner, by some steps of a descent."""
    D, total, push = allocation.directions, float(allocation.u_max @ sizes), ways * allocation.u_max
    scale = float(np.abs(each).max() / allocation.lengths.max()) or 1.0

    def bound(x: Array) -> tuple[float, Array]:
        excess = np.maximum(each / scale - D @ x, 0.0)
        size = max(float(np.linalg.norm(excess)), 1e-300)
        return float(push @ x) / total + size, push / total - excess @ D / size

    return np.asarray(minimize(bound, np.zeros(len(ways)), jac=True, method="L-BFGS-B").x * scale)


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
            indices = np.flatnonzero(f)
            f[indices] += np.linalg.pinv(directions[indices].T) @ (unit - directions.T @ f)
    return np.maximum(exact, 0.0)
