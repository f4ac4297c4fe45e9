"""Single trajectories: simulation under piecewise constant inputs, and those that reach furthest."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse
from scipy.linalg import expm
from scipy.sparse.linalg import expm_multiply

from ..numerics.checks import Array, as_array, checked, require_single
from ..numerics.errors import ReachError
from ..numerics.exponentials import bordered, dense, times
from ..sets.convex import ConvexSet
from ..short_repr import short_repr
from .known_input import known_response
from .stepping import Steps, row_bounds
from .systems import LinearSystem

DENSE_MOST = 400  # states up to which a simulation forms exponentials
STEPS = 256  # steps of a worst case if no tolerance is given


@short_repr
@dataclass(frozen=True, eq=False)
class Trajectory:
    """One motion of a system.

    Attributes
    ----------
    times : ndarray, shape (m+1,)
    states : ndarray, shape (m+1, n)
        Exact but for rounding.
    inputs : ndarray, shape (m, inputs)
        Held from each time to the next, on top of a nominal input if there is one.
    """

    times: Array
    states: Array
    inputs: Array


@checked
def simulate(system: LinearSystem, x0: ArrayLike, instants: ArrayLike, inputs: ArrayLike) -> Trajectory:
    """Run a system under inputs that are held between given instants.

    Parameters
    ----------
    system : LinearSystem
    x0 : array_like, shape (n,)
    instants : array_like, shape (m+1,)
        Increasing; whole numbers for a discrete system.
    inputs : array_like, shape (m, inputs)
        Need not lie in U.

    Raises
    ------
    ReachError
        If shapes do not fit or the instants do not increase.
    """
    x0, t = as_array("the initial state", x0, system.dim), np.asarray(instants, dtype=float)
    if t.ndim != 1 or len(t) < 2 or not np.all(np.diff(t) > 0):
        raise ReachError("instants must be at least two increasing times")
    u = as_array("inputs", inputs, len(t) - 1, system.inputs)
    states = np.empty((len(t), system.dim))
    states[0] = x0
    advance = _discrete if system.discrete else _sparse if system.dim > DENSE_MOST else _dense
    advance(system, states, t, u)
    if system.nominal is not None:
        states += known_response(system, np.zeros((1, system.dim)), t, np.diff(t)).states
    return Trajectory(t, states, u)


def _discrete(system: LinearSystem, states: Array, t: Array, u: Array) -> None:
    if not np.all(np.diff(t) == 1):
        raise ReachError("the instants of a discrete system must be successive whole numbers")
    for k, force in enumerate(times(u, system.B.T) + system.c):
        states[k + 1] = system.A @ states[k] + force


def _dense(system: LinearSystem, states: Array, t: Array, u: Array) -> None:
    block = bordered(dense(system.A), np.hstack([dense(system.B), system.c[:, None]]))
    drive, lengths = np.hstack([u, np.ones((len(u), 1))]), np.diff(t)
    # Steps that differ by the rounding of their ends only share the exponential of their mean.
    groups = np.unique([float(f"{h:.9g}") for h in lengths], return_inverse=True)[1]
    means = np.bincount(groups, lengths) / np.bincount(groups)
    maps = [expm(block * h)[: system.dim] for h in means]
    for k, group in enumerate(groups):
        states[k + 1] = maps[group] @ np.concatenate([states[k], drive[k]])


def _sparse(system: LinearSystem, states: Array, t: Array, u: Array) -> None:
    A, force = sparse.csr_matrix(system.A), times(u, system.B.T) + system.c
    k = 0
    for f, run in groupby(range(len(force)), key=lambda i: force[i].tobytes()):
        count = len(list(run))
        block = bordered(A, np.frombuffer(f)[:, None])
        for i in range(k, k + count):
            step = block * (t[i + 1] - t[i])
            states[i + 1] = expm_multiply(step, np.r_[states[i], 1.0], traceA=step.diagonal().sum())[:-1]
        k += count


@checked
def worst_case(
    system: LinearSystem,
    initial: ConvexSet,
    horizon: float,
    direction: ArrayLike,
    *,
    step: float | None = None,
    tolerance: float | None = None,
) -> Trajectory:
    """An admissible trajectory whose end lies as far in a direction as any, but for a small rest.

    The initial state is the furthest point of the initial set along ``d e^{A t}``, the input that
    of U along ``d e^{A (t - s)} B``, held over each step (the maximum principle).

    Parameters
    ----------
    system : LinearSystem
    initial : ConvexSet
    horizon : float
        Time of the end, may be 0.
    direction : array_like, shape (n,)
    step : float, optional
        Over which an input is held. Default: a 256th of the horizon.
    tolerance : float, optional
        Instead of a step: most that ``d x(horizon)`` may lie below the exact support.

    Raises
    ------
    ReachError
        If a number is not finite or shapes do not fit.
    Unresolved
        If the tolerance cannot be met.
    """
    d = as_array("the direction", np.ravel(direction), system.dim)[None]
    require_single("the initial set", initial)
    if horizon == 0:
        return Trajectory(np.zeros(1), initial.support_vector(d), np.zeros((0, system.inputs)))
    if step is None and tolerance is None and not system.discrete:
        step = horizon / STEPS
    run = row_bounds(system, initial, d, horizon, Steps(step, tolerance, [np.inf], keep=True)).coarse()
    assert run.rows is not None
    rows = run.rows[:, 0, : system.dim]
    x0 = initial.support_vector(rows[-1])
    instants = (run.times[-1] - run.times)[::-1]
    instants[0] = 0.0
    if not system.U:
        instants = instants if system.discrete else instants[[0, -1]]
        return simulate(system, x0, instants, np.zeros((len(instants) - 1, system.inputs)))
    instants, middle = (instants, rows[:-1][::-1]) if system.discrete else _grid(system, instants, rows[::-1])
    piece = np.searchsorted(system.breaks, (instants[:-1] + instants[1:]) / 2, side="right")
    u = np.empty((len(middle), system.inputs))
    for i, U in enumerate(system.U):
        u[piece == i] = U.support_vector(times(middle[piece == i], system.B))
    return simulate(system, x0, instants, u)


def _grid(system: LinearSystem, ends: Array, rows: Array) -> tuple[Array, Array]:
    """Instants between which inputs are held, none across a change of its set; rows in their middle."""
    instants = np.union1d(ends, system.breaks[system.breaks < ends[-1]])
    s, k = (instants[:-1] + instants[1:]) / 2, np.searchsorted(ends, instants[:-1], side="right") - 1
    share = ((s - ends[k]) / (ends[k + 1] - ends[k]))[:, None]
    return instants, (1 - share) * rows[k] + share * rows[k + 1]
