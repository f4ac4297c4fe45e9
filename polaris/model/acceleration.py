"""How accelerations of a position enter the state of a linear system, in exact arithmetic."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .errors import ScenarioError

Array = NDArray[np.float64]


def acceleration_input(state: Array, position: Array) -> Array:
    """How an acceleration [m/s^2] of the position enters the state: E with ``C E = 0``, ``C A E = I``.

    Shape (n, d). Decided in exact arithmetic, and the same for the motion of the position whichever
    solution E is.

    Raises
    ------
    ScenarioError
        If the position does not obey an equation of second order, ``p'' = f(p, p') + a``: its rate is
        no free part of the state (first order), or its acceleration depends on more than position
        and rate (third order and higher).
    """
    from flint import fmpq_mat

    A, C, given = _exact(state), _exact(position), position.tolist()
    known = fmpq_mat(C.tolist() + (C * A).tolist())
    gram, reaction = known * known.transpose(), C * A * A
    if gram.det() == 0:
        rule = "has no acceleration: the rate of the position, C A x, is no free part of the state"
        raise ScenarioError("system.C", given, rule)
    inverse = known.transpose() * gram.inv()  # its last d columns are the least E
    if reaction * inverse * known != reaction:
        rule = "has an acceleration that depends on more states than the position and its rate"
        raise ScenarioError("system.C", given, rule)
    try:
        E = [[int(x.p) / int(x.q) for x in row[len(given) :]] for row in inverse.tolist()]
    except OverflowError as error:
        rule = "has a rate too small to compute with: an acceleration would move states without bound"
        raise ScenarioError("system.C", given, rule) from error
    return np.array(E)


def _exact(M: Array) -> Any:
    """A matrix of rationals: whether a position has an acceleration must not depend on rounding."""
    from flint import fmpq, fmpq_mat

    return fmpq_mat([[fmpq(*x.as_integer_ratio()) for x in row] for row in M.tolist()])


ZERO = 1e-12  # share of the terms of an entry of C A below which it counts as zero


def velocities(A: Array, C: Array) -> Array:
    """Return the rate of the position [m/s] that a unit of each velocity makes, shape (d, n).

    Velocities are the states in ``C A`` that are no part of the position; of all others the rate is 0.
    """
    moves = (np.abs(C @ A) > ZERO * (np.abs(C) @ np.abs(A))) & ~np.any(C != 0, axis=0)
    return np.where(moves, C @ A, 0.0)


def speeds(A: Array, C: Array) -> Array:
    """Return the speed of the position [m/s] that a unit of each velocity makes, 0 of other states, (n,)."""
    return np.asarray(np.linalg.norm(velocities(A, C), axis=0))
