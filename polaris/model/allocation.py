"""Thrusters that push only: the box of inputs that they can make, whichever one of them has failed."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import numpy as np

from reach.numerics.programs import maximise

from .errors import ScenarioError, SynthesisInfeasible
from .system import Array

MOST_INPUTS = 6  # most inputs: the box has two corners for each
ROUNDED = 1e-9  # share by which the box is smaller than what is found: rounding of a linear program


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
    """What N thrusters ``0 <= f <= limits`` with ``u = directions' f`` can make of m inputs."""

    directions: Array  # (N, m)
    limits: Array  # (N,) [N]
    u_max: Array  # (m,): every input within these is made in every case (docs/theory.md, Proposition 5 (c))
    corners: Array
    """Thrusts (cases, 2^m, N) that reach at least to each corner of the box: without a fault, or of each
    fault in turn with each thruster."""

    @classmethod
    def of(cls, directions: Array, limits: Array, wanted: Array, faults: Sequence[Fault]) -> "Allocation":
        """The largest box of the shape of `wanted` (m,), and no larger, that is made in every case.

        Raises
        ------
        ScenarioError
            If shapes do not fit.
        SynthesisInfeasible
            If there is none: the thrusters that are left do not push every way.
        """
        count, m = directions.shape
        if m != len(wanted) or m > MOST_INPUTS:
            rule = f"must have {len(wanted)} numbers per thruster, for at most {MOST_INPUTS} inputs"
            raise ScenarioError("thrusters.directions", directions.shape, rule)
        share, corners = 1.0, []
        for what, capacity in cases(limits, faults):
            found = []
            for signs in product((1.0, -1.0), repeat=m):
                given = directions, capacity, np.array(signs) * wanted
                reach, f = _towards(*(np.asarray(part, dtype=float).tobytes() for part in given))
                if not reach > ROUNDED:
                    way = ", ".join(f"{x:g}" for x in signs)
                    raise SynthesisInfeasible(
                        f"no thrust is left towards [{way}] of the inputs {what}.",
                        relax="add thrusters (thrusters.directions), or take the fault out.",
                    )
                share = min(share, reach * (1 - ROUNDED))
                found.append(f)
            corners.append(found)
        return cls(directions, limits, share * wanted, np.array(corners))


def axis_pairs(limits: Array) -> tuple[Array, Array]:
    """Directions and limits of one thruster either way along every input."""
    eye = np.eye(len(limits))
    return np.vstack([eye, -eye]), np.concatenate([limits, limits])


def cases(limits: Array, faults: Sequence[Fault]) -> list[tuple[str, Array]]:
    """Limits without a fault if none is declared, else with each fault of each thruster, in words."""
    found = [("with all thrusters", limits)] if not faults else []
    for fault in faults:
        for j in range(len(limits)):
            capacity = np.where(np.arange(len(limits)) == j, fault.left * limits, limits)
            found.append((f"with thruster {j} under the fault {fault.name}", capacity))
    return found


@lru_cache(maxsize=1024)
def _towards(*given: bytes) -> tuple[float, Array]:
    """Return how many times a corner is reached, at most twice, and the thrusts; arrays by their entries."""
    flat, capacity, corner = (np.frombuffer(part) for part in given)
    directions, count, eye = flat.reshape(-1, len(corner)), len(capacity), np.eye(len(capacity))
    aim = np.hstack([-(np.sign(corner)[:, None] * directions.T), np.abs(corner)[:, None]])
    rows = np.vstack([aim, np.eye(count + 1), np.hstack([-eye, np.zeros((count, 1))])])
    limits = np.concatenate([np.zeros(len(corner)), capacity, [2.0], np.zeros(count)])
    best = maximise(np.eye(count + 1)[-1], rows, limits)
    f = np.clip(np.nan_to_num(best.point[:-1]), 0.0, capacity)
    return float(np.min(np.sign(corner) * (directions.T @ f) / np.abs(corner))), f
