"""Tubes of linear systems whose matrices vary in time.

Over a step of length h the matrix A(t) is compared with the chord between its values at both ends,
with mean M and slope S. The transition over the step is

    P = e^{h M} + h^3/12 e^{h M/2} (S M - M S) e^{h M/2}

but for a rest of third order, bounded elementwise by a matrix that follows from the bounds on the
derivatives. The rest, times the box around the state, is one more input, carried on with the others:
each by the product of all later transitions, so that nothing is enclosed twice. The cost therefore
grows with the square of the number of steps.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..numerics.checks import (
    Array,
    as_directions,
    as_frame,
    as_numbers,
    checked,
    require_positive,
    require_single,
)
from ..numerics.errors import ReachError
from ..numerics.exponentials import exponential
from ..sets.convex import ConvexSet
from ..sets.zonotope import Zonotope
from .adjoint import attained_support, extent
from .rows import ROUNDING
from .stepping import warn_if_wide
from .tubes import SupportTube, ZonotopeTube, along_frame
from .varying import Varying, sample

MAX_STEPS = 20_000


@dataclass(frozen=True, eq=False)
class LTVSystem:
    """``x' = A(t) x + B(t) u + c(t)`` with an unknown input ``u(t)`` in U at every instant.

    Parameters
    ----------
    A : Varying or array_like, shape (n, n)
    B : Varying or array_like, shape (n, m), optional
        Input map; the identity if only U is given.
    U : ConvexSet of dimension m, optional
    c : Varying or array_like, shape (n,), optional

    Raises
    ------
    ReachError
        If a shape does not fit or a number is not finite.
    """

    A: Any
    B: Any = None
    U: Any = None
    c: Any = None

    def __post_init__(self) -> None:
        A = self.A.value(0.0) if isinstance(self.A, Varying) else self.A
        A = as_numbers("A", A)
        if A.ndim != 2 or A.shape[0] != A.shape[1] or len(A) == 0:
            raise ReachError(f"A must be square, got shape {A.shape}")
        n = len(A)
        if self.U is None and self.B is not None:
            raise ReachError("B is given without U, the set of its input")
        if self.U is not None:
            require_single("U", self.U)
        B = np.eye(n, n if self.U is not None else 0) if self.B is None else self.B
        object.__setattr__(self, "B", B)
        object.__setattr__(self, "c", np.zeros(n) if self.c is None else self.c)
        object.__setattr__(self, "_n", n)

    @property
    def dim(self) -> int:
        """Number n of states."""
        return int(self._n)  # type: ignore[attr-defined]

    @property
    def inputs(self) -> int:
        """Number m of inputs."""
        return 0 if self.U is None else int(self.U.dim)


@checked
def ltv_support_tube(
    system: LTVSystem,
    initial: ConvexSet,
    horizon: float,
    directions: ArrayLike,
    *,
    step: float,
    begin: float = 0.0,
) -> SupportTube:
    """Bound chosen directions over the reachable sets, continuously in time.

    Parameters
    ----------
    system : LTVSystem
    initial : ConvexSet
        Of the state at the time `begin`.
    horizon : float
    directions : array_like, shape (r, n)
    step : float
        Length of every step (shortened so that it divides the horizon).
    begin : float

    Returns
    -------
    SupportTube
        With times from `begin` to ``begin + horizon``.

    Raises
    ------
    ReachError
        If shapes do not fit, numbers are not finite, or the bounds on derivatives do not hold.
    """
    D, n = as_directions(directions, system.dim), system.dim
    r = len(D)
    sweep = _Sweep(system, initial, horizon, step, begin)
    rows = np.vstack([D, np.eye(n), -np.eye(n)])
    run = sweep.run(rows, slice(r, r + n), slice(r + n, None), np.eye(n))
    upper, bow = (run.first + run.upper)[:, :r], run.bow[:, :r]
    attained = run.lower[:, :r]
    interval = np.maximum(upper[1:], upper[:-1]) + bow
    warn_if_wide(interval.max(axis=0), attained.max(axis=0), np.abs(upper).max(axis=0))
    return SupportTube(sweep.times, D, upper, attained, interval, bow)


@checked
def ltv_zonotope_tube(
    system: LTVSystem,
    initial: ConvexSet,
    horizon: float,
    *,
    step: float,
    begin: float = 0.0,
    frame: ArrayLike | None = None,
) -> ZonotopeTube:
    """Enclose the reachable sets by zonotopes, continuously in time and without wrapping.

    Parameters
    ----------
    system : LTVSystem
    initial : ConvexSet
        A zonotope; of any other set the interval hull is taken.
    horizon : float
    step : float
        Length of every step (shortened so that it divides the horizon).
    begin : float
    frame : array_like, shape (n, n), optional
        Columns: axes along which the response to the inputs is bounded tightly. Default: the
        coordinate axes.

    Raises
    ------
    ReachError
        As for `reach.ltv_support_tube`.
    """
    n = system.dim
    F = as_frame(frame, n)
    require_single("the initial set", initial)
    start = initial if isinstance(initial, Zonotope) else initial.interval_hull().to_zonotope()
    sweep = _Sweep(system, start, horizon, step, begin)
    inverse = np.linalg.inv(F)
    run = sweep.run(np.vstack([inverse, -inverse]), slice(n), slice(n, None), F)
    nodes = run.first + run.upper
    warn_if_wide(nodes.max(axis=0) + run.bow.max(axis=0), nodes.max(axis=0), np.abs(nodes).max(axis=0))
    bow = np.maximum(run.bow[:, :n], run.bow[:, n:])
    inputs = run.upper[:, n:], run.upper[:, :n]
    return along_frame(sweep.times, inverse @ (run.maps @ start), inputs, bow, F)


@dataclass(frozen=True, eq=False)
class _Run:
    """Bounds at the nodes, (K+1, r): of the initial set moved on, of the rest, and attained by both."""

    first: Array
    upper: Array
    lower: Array
    bow: Array
    maps: Array


class _Sweep:
    """Steps of a varying system: transitions, what inputs add, and boxes around all rests."""

    def __init__(
        self, system: LTVSystem, initial: ConvexSet, horizon: float, step: float, begin: float
    ) -> None:
        n, m = system.dim, system.inputs
        require_single("the initial set", initial, n)
        require_positive("horizon", horizon)
        require_positive("step", step)
        if not np.isfinite(begin) or horizon / step > MAX_STEPS:
            given = f"got {begin!r}, {horizon / step}"
            raise ReachError(f"at most {MAX_STEPS:,} steps from a finite begin, {given}")
        count = max(int(np.ceil(horizon / step * (1 - 1e-12))), 1)
        self.initial, self.U, self.n, self.m = initial, system.U, n, m
        self.times = begin + np.linspace(0, horizon, count + 1)
        self.h = h = horizon / count
        A, B = sample("A", system.A, (n, n), self.times), sample("B", system.B, (n, m), self.times)
        c = sample("c", system.c, (n,), self.times)
        self.x0 = extent("the initial set", initial)
        u = np.r_[extent("an input set", system.U) if m else np.zeros(0), 1.0]
        G = np.concatenate([B.nodes, c.nodes], axis=-1)

        def force(name: str) -> Array:
            """Bound on ``[B c] (u, 1)``, or on what it changes by, over every step, shape (K, n, 1)."""
            both = np.concatenate([getattr(B, name), getattr(c, name)], axis=-1)
            return np.asarray(np.abs(both) @ u)[..., None]

        # Transitions and the elementwise bound on what they miss, see the docstring of the module.
        M, S = A.middle, A.chord
        half = exponential(M, h / 2)
        C1 = S @ M - M @ S
        C2 = C1 @ M - M @ C1
        C3 = np.abs(C2 @ M - M @ C2)
        self.P = half @ half + h**3 / 12 * (half @ C1 @ half)
        D = h / 2 * np.abs(S) + A.off
        W, Y = (exponential(_growing(M, more), h) for more in (0.0, D))
        missed = W @ (h**5 / 480 * C3 + A.area + h**2 / 2 * (D @ W @ D)) @ Y
        # Inputs: the trapezoid of V(s) = Phi(t_k+1, s) G(s), G = [B c], whose V'' bounds its rest.
        first, force_most, rate, most = np.abs(G[:-1]) @ u, force("most"), force("rate"), A.most
        curved = A.rate @ force_most + 2 * most @ rate + most @ most @ force_most
        driven = Y @ force_most
        rest = Y @ (h**3 / 12 * curved + force("area")) + h / 2 * missed @ first[..., None]
        self.missed, self.rest = missed + ROUNDING * n * W, (rest + ROUNDING * n * h * driven)[..., 0]
        self.early, self.late = self.P @ G[:-1], G[1:]
        # Between the nodes: y'' = (A^2 + A') y, and the input's share by its Lipschitz constant.
        self.curve = M @ M + S
        self.more = np.abs(M) @ D + D @ np.abs(M) + D @ D + A.swing
        self.more = self.more @ Y + h * np.abs(self.curve) @ most @ Y
        slide = most @ driven + Y @ (most @ force_most + rate) / 2
        self.local = h**2 / 4 * slide[..., 0]

    def _support(self, along: Array, attained: bool = False) -> Array:
        """``sup of b u + c`` for rows ``[b c]``, or what some u attains."""
        value, rows = along[..., -1], along[..., :-1]
        if not self.m:
            return np.asarray(value)
        support = self.U.support(rows)
        return np.asarray(value + (attained_support(self.U, rows, support) if attained else support))

    def run(self, rows: Array, plus: slice, minus: slice, F: Array) -> _Run:
        """Bounds forward; `plus` and `minus` are the rows inv(F) and their opposites, which bound x."""
        K, n, h = len(self.P), self.n, self.h
        first, upper, lower = (np.zeros((K + 1, len(rows))) for _ in range(3))
        bow, maps, later = np.empty((K, len(rows))), np.empty((K + 1, n, n)), np.empty((K, n, n))
        boxes = np.empty((K, n))
        maps[0], first[0], size, absolute = np.eye(n), self.initial.support(rows), self.x0, np.abs(rows)
        moved, upper[0] = np.zeros(n), ROUNDING * n * (absolute @ size)
        lower[0] = attained_support(self.initial, rows, first[0]) - upper[0]
        for k in range(K):
            boxes[k] = self.missed[k] @ size + self.rest[k]
            curved = rows @ self.curve[k]
            along = curved @ maps[k]
            known = np.maximum(self.initial.support(along), self.initial.support(-along))
            bend = known + np.abs(curved) @ moved + absolute @ (self.more[k] @ size)
            bow[k] = h**2 / 8 * bend + absolute @ self.local[k]
            later[:k] = self.P[k] @ later[:k]
            later[k] = np.eye(n)
            maps[k + 1] = self.P[k] @ maps[k]
            first[k + 1] = self.initial.support(rows @ maps[k + 1])
            R = rows @ later[: k + 1]
            start, end = R @ self.early[: k + 1], R @ self.late[: k + 1]
            value, middle = self._support(start) + self._support(end), self._support((start + end) / 2, True)
            error = (np.abs(R) @ boxes[: k + 1, :, None]).sum(axis=0)[:, 0]
            upper[k + 1] = h / 2 * value.sum(axis=0) + error
            lower[k + 1] = h * middle.sum(axis=0) - error
            lower[k + 1] += attained_support(self.initial, rows @ maps[k + 1], first[k + 1])
            moved = np.abs(F) @ np.maximum(np.abs(upper[k + 1, plus]), np.abs(upper[k + 1, minus]))
            ends_x = first[k + 1] + upper[k + 1]
            size = np.abs(F) @ np.maximum(np.abs(ends_x[plus]), np.abs(ends_x[minus]))
        return _Run(first, upper, lower, bow, maps)


def _growing(M: Array, more: Array | float) -> Array:
    """Nonnegative matrices whose exponentials bound those of M, and of anything within `more` of it."""
    eye = np.eye(M.shape[-1], dtype=bool)
    return np.asarray(np.where(eye, np.maximum(M + more, 0.0), np.abs(M) + more))
