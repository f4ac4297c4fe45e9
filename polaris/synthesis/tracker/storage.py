"""Bound on the spending of a flight under linear laws, by one storage function per period.

See docs/theory.md, Proposition 14 (c). Any weights give a bound. They are chosen by *relaxed flights*, in
which every number is a vector. The worst of these is found by ascent, and spends nearly as much as the best
weights allow: the relaxation of A. Grothendieck (Bol. Soc. Mat. Sao Paulo 8, 1953), whose dual bounds it.
"""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from reach.sets.zonotope import Zonotope

from ...model.system import Array
from .long_flight import FLOOR, Inputs, Storage

VECTOR = 6  # entries of the vectors in relaxed flights
ASCENTS, STILL = 24, 4e-4  # most ascents, and the share by which one spends more that ends them
FEW, TURNS = 64, 30  # generators of a start whose weights are looked for as those of values are, and how long
LEAST = 1e-3  # least weight of a group of values, as a share of its mean: delays hide what enters last
LOOSER, FACTORS, MARGIN, CLIPPED = 1.02, 40, 1.004, 1.02
"""By how much weights rise until there is a storage, how often at most, and once more for a checker, or
where commands are clipped: it finds their slopes from sets of its own."""


@dataclass(frozen=True, eq=False)
class LinearStep:
    """Periods of a step under a linear law, as a loop about the middle of the tube.

    Attributes
    ----------
    inputs : tuple of Inputs
        One for each period.
    middle : ndarray, shape (q, m) or (q, 2 m)
        Command in the middle of the tube [N].
    """

    inputs: tuple[Inputs, ...]
    middle: Array

    def first_periods(self, periods: int) -> "LinearStep":
        """Return the first periods."""
        return LinearStep(self.inputs[:periods], self.middle[:periods])


@dataclass(frozen=True, eq=False)
class Weights:
    """Weights in the periods of one step.

    Attributes
    ----------
    r : ndarray, shape (m,)
        Of commands, beyond the size of that in the middle [N].
    b : ndarray, shape (groups,)
        Of groups of values.
    """

    r: Array
    b: Array

    def __mul__(self, factor: float) -> "Weights":
        return Weights(self.r * factor, self.b * factor)


def storage(steps: Sequence[LinearStep], weights: Sequence[Weights]) -> Iterator[Storage | None]:
    """Yield the storage at the start of each step, the last step first, until it is None.

    The spending from the start of a step until the end is at most its cost, and ``z' P z / 2 + p z``.
    """
    after: Storage | None = Storage.from_matrix(np.zeros_like(steps[-1].inputs[0].F))
    for step, weight in zip(reversed(steps), reversed(weights), strict=True):
        for inputs, middle in zip(reversed(step.inputs), step.middle[::-1], strict=True):
            if after is not None:
                r = weight.r + np.abs(middle)
                after = inputs.before(after, r, weight.b[inputs.group], middle)
        yield after


def largest(after: Storage, start: Zonotope) -> float:
    """Bound the storage, its cost included, over a set about its centre [N]."""
    M, p = start.G.T @ after.P @ start.G, start.G.T @ after.p
    least = np.abs(M).sum() / 2 + np.abs(p).sum()
    if 0 < len(p) <= FEW:
        places = np.arange(len(p))[:, None] + 1.0
        v = np.cos(places * (1 + np.arange(VECTOR)) + places**2)  # any directions
        for _ in range(TURNS):
            products = M @ v
            products[:, 0] += p
            size = np.linalg.norm(products, axis=1)
            v = products / np.maximum(size[:, None], 1e-300)
        for factor in LOOSER ** np.arange(1, TURNS):
            with suppress(np.linalg.LinAlgError):
                half = np.linalg.solve(np.linalg.cholesky(np.diag(size * factor) - M), p)
                least = min(least, (size.sum() * factor + half @ half) / 2)
    return float(after.cost + least)


def bound(steps: Sequence[LinearStep], weights: Sequence[Weights], start: Zonotope) -> float:
    """Bound the total spending of all periods from loop states in a set about its centre [N]; or infinity."""
    *_, first = storage(steps, weights)
    return np.inf if first is None else largest(first, start)


def weights(steps: Sequence[LinearStep], start: Zonotope, clipped: bool = False) -> list[Weights]:
    """Return weights for each step, with which the bound is nearly the least; none if there is no bound.

    Some commands may be `clipped`.
    """
    worst = RelaxedFlight(steps, start).ascend()
    for number in range(1, FACTORS):
        raised = [each * LOOSER**number for each in worst]
        *_, first = storage(steps, raised)
        if first is not None:
            return [each * (CLIPPED if clipped else MARGIN) for each in raised]
    return []


class RelaxedFlight:
    """Flight in which loop states, commands and values are vectors; 1 is the first unit vector."""

    def __init__(self, steps: Sequence[LinearStep], start: Zonotope) -> None:
        self.steps, self.G = steps, start.G
        self.periods = [
            (place, inputs, middle)
            for place, step in enumerate(steps)
            for inputs, middle in zip(step.inputs, step.middle, strict=True)
        ]
        self.rng = np.random.default_rng(0)
        self.first = self._unit(start.G.shape[1])
        self.values = [self._unit(len(inputs.group)) for _, inputs, _ in self.periods]

    def _unit(self, count: int) -> Array:
        vectors = self.rng.normal(size=(count, VECTOR))
        return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))

    def ascend(self) -> list[Weights]:
        """Return the weights of the flight that spends most: sizes of its spending's gradients by values."""
        previous, weights = -np.inf, list[Weights]()
        for _ in range(ASCENTS):
            commands = self.commands()
            sizes = [np.linalg.norm(u, axis=1) for u in commands]
            total = sum(float(p[1].spends @ size) for p, size in zip(self.periods, sizes, strict=True))
            weights = self._turn(commands, sizes)
            if total <= previous * (1 + STILL):
                break
            previous = total
        return weights

    def commands(self) -> list[Array]:
        """Return the commands (m, VECTOR) of every period [N]."""
        z, commands = self.G @ self.first, []
        for (_, inputs, middle), v in zip(self.periods, self.values, strict=True):
            u = inputs.feed @ v - inputs.K @ z
            u[:, 0] += middle
            commands.append(u)
            z = inputs.F @ z + inputs.enter @ (v * self._errors(inputs, np.linalg.norm(u, axis=1))[:, None])
        return commands

    @staticmethod
    def _errors(inputs: Inputs, size: Array) -> Array:
        """Return the largest sizes of values (k,) under commands of some size (m,)."""
        parts = (len(inputs.group) - inputs.count) // (2 * inputs.craft.m)
        growing = np.sqrt(inputs.squares @ size**2)
        return np.concatenate([np.ones(inputs.count), np.tile(inputs.bits, parts), np.tile(growing, parts)])

    def _turn(self, commands: list[Array], sizes: list[Array]) -> list[Weights]:
        """Turn all values towards where the flight spends more, and return the weights that this gives."""
        later = np.zeros((len(self.G), VECTOR))
        sums: list[list[tuple[Array, Array, Array]]] = [[] for _ in self.steps]
        for i in range(len(self.periods) - 1, -1, -1):
            place, inputs, middle = self.periods[i]
            m = inputs.craft.m
            size = np.maximum(sizes[i], FLOOR * np.resize(inputs.craft.u_max, len(inputs.K)))
            errors = self._errors(inputs, size)
            errors = np.maximum(
                errors, FLOOR * np.resize(size[-m:], len(errors))
            )  # those of none cost nothing
            entered = inputs.enter.T @ later
            shares = np.linalg.norm(entered[inputs.count :], axis=1) / errors[inputs.count :]
            growing = shares[len(shares) // 2 :].reshape(-1, m).sum(axis=0)
            answer = (inputs.spends / size + growing @ inputs.squares)[:, None] * commands[i]
            products = entered + inputs.feed.T @ answer
            groups = np.asarray(np.bincount(inputs.group, (products**2).sum(axis=1)), dtype=float)
            self.values[i] = products / np.maximum(np.sqrt(groups)[inputs.group][:, None], 1e-300)
            first = np.unique(inputs.group, return_index=True)[1]
            sums[place].append((size - np.abs(middle), groups, errors[first] ** 2))
            later = inputs.F.T @ later - inputs.K.T @ answer
        products = self.G.T @ later
        self.first = products / np.maximum(np.linalg.norm(products, axis=1, keepdims=True), 1e-300)
        each = [[np.mean(part, axis=0) for part in zip(*step, strict=True)] for step in sums]
        limits = [FLOOR * np.resize(x.inputs[0].craft.u_max, x.middle.shape[1]) for x in self.steps]
        values = [np.sqrt(products / size) for _, products, size in each]
        least, inputs = LEAST * np.mean(values, axis=0) + 1e-300, self.steps[0].inputs[0]
        fixed = slice(inputs.group[inputs.count - 1] + 1)  # a checker's values need not be 0 where these are
        least[fixed] = np.maximum(least[fixed], FLOOR * np.mean(values, axis=0)[fixed].max(initial=0.0))
        return [
            Weights(np.maximum(r, limit), np.maximum(b, least))
            for (r, *_), b, limit in zip(each, values, limits, strict=True)
        ]
