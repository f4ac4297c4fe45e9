"""Tubes of linear systems whose matrices vary in time.

Over a step of length h, A(t) is compared with the chord of mean M and slope S. The transition is

    P = e^{h M} + h^3/12 e^{h M/2} (S M - M S) e^{h M/2}

but for a rest of third order, bounded elementwise by the bounds on the derivatives. Times the box around the
state it is one more input, carried on by the product of all later transitions: nothing is enclosed twice.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from ..numerics.checks import Array, as_array, as_factor, as_numbers, check_fields, require_single
from ..numerics.errors import ReachError
from ..numerics.exponentials import exponential
from ..sets.convex import ConvexSet
from .adjoint import attained_support, driven_support, extent
from .bounds import EffortBudget, RowBounds
from .rows import ROUNDING

Bound = ArrayLike | Callable[[float, float], ArrayLike] | None

CONSISTENT = 1e-6
"""Share by which values may break a bound on their derivatives before this is said (rounding)."""
MAX_STEPS = 20_000


@dataclass(frozen=True, eq=False)
class Varying:
    """A matrix or vector as a function of time, with elementwise bounds on its derivatives.

    Parameters
    ----------
    value : callable
        ``value(t)`` is the matrix at time t.
    slope : array_like or callable, optional
        Bound on the absolute value of the first derivative: for all times, or ``slope(a, b)`` over
        the interval from a to b.
    bend : array_like or callable, optional
        Bound on the second derivative likewise. With it tubes are of second order in the step, with
        the first alone of first order.

    Raises
    ------
    ReachError
        If neither bound is given.
    """

    value: Callable[[float], ArrayLike]
    slope: Bound = None
    bend: Bound = None

    def __post_init__(self) -> None:
        check_fields(self)
        if self.slope is None and self.bend is None:
            raise ReachError("a matrix that varies needs a bound on its first or second derivative")


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
    begin : float
        Time at which the state is in its initial set, and at which tubes begin.

    Raises
    ------
    ReachError
        If a shape does not fit or a number is not finite.
    """

    A: Any
    B: Any = None
    U: Any = None
    c: Any = None
    begin: float = 0.0
    discrete: ClassVar[bool] = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "begin", as_factor(self.begin, "begin"))
        A = self.A.value(self.begin) if isinstance(self.A, Varying) else self.A
        A = as_numbers("A", A)
        if A.ndim != 2 or A.shape[0] != A.shape[1] or len(A) == 0:
            raise ReachError(f"A must be square, got shape {A.shape}")
        n = len(A)
        if self.U is None and self.B is not None and np.size(self.B):
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


@dataclass(frozen=True, eq=False)
class SampledMatrices:
    """A varying matrix over K steps of length h, compared with the chord between two nodes."""

    nodes: Array  # values, (K+1, p, q)
    chord: Array  # slope of the chord, (K, p, q)
    off: Array  # largest distance from the chord, (K, p, q)
    area: Array  # integral of that distance over the step, (K, p, q)
    rate: Array  # largest absolute value of the derivative, (K, p, q)
    swing: Array  # largest distance of the derivative from the slope of the chord, (K, p, q)

    @property
    def middle(self) -> Array:
        """Mean of the values at both ends of every step, shape (K, p, q)."""
        return np.asarray((self.nodes[1:] + self.nodes[:-1]) / 2)

    @property
    def most(self) -> Array:
        """Largest absolute value in every step, shape (K, p, q)."""
        return np.maximum(np.abs(self.nodes[1:]), np.abs(self.nodes[:-1])) + self.off


def sample(name: str, M: Any, shape: tuple[int, ...], times: Array) -> SampledMatrices:
    """Evaluate a constant or varying matrix, vectors as one column; its bounds must hold at the nodes."""
    column = (*shape, 1)[:2]
    h, count = np.diff(times), len(times)
    if not isinstance(M, Varying):
        value = as_array(name, M, *shape).reshape(column)
        zero = np.zeros((count - 1, *column))
        return SampledMatrices(np.tile(value, (count, 1, 1)), zero, zero, zero, zero, zero)
    with np.errstate(all="ignore"):  # what is not finite is refused with its name and time
        values = [M.value(float(t)) for t in times]
    pairs = zip(values, times, strict=True)
    nodes = np.stack([as_array(f"{name}({t:g})", value, *shape).reshape(column) for value, t in pairs])
    step = h[:, None, None]
    chord = np.diff(nodes, axis=0) / step
    slope = _bound(f"slope of {name}", M.slope, shape, times).reshape(count - 1, *column)
    bend = _bound(f"bend of {name}", M.bend, shape, times).reshape(count - 1, *column)
    noise = 16 * np.finfo(float).eps * np.abs(nodes).max(axis=0)
    _consistent(f"slope of {name}", np.abs(chord) - noise / step, slope)
    if count > 2:
        # The second difference is a mean of the second derivative over two steps.
        second = np.abs(np.diff(chord, axis=0)) - 4 * noise / step[:-1]
        _consistent(f"bend of {name}", second / step[:-1], np.maximum(bend[1:], bend[:-1]))
    return SampledMatrices(
        nodes,
        chord,
        np.minimum(step / 2 * slope, step**2 / 8 * bend),
        np.minimum(step**2 / 3 * slope, step**3 / 12 * bend),
        np.minimum(slope, np.abs(chord) + step / 2 * bend),
        np.minimum(slope + np.abs(chord), step / 2 * bend),
    )


def _bound(name: str, bound: Bound, shape: tuple[int, ...], times: Array) -> Array:
    if bound is None:
        return np.full((len(times) - 1, *shape), np.inf)
    over = bound if callable(bound) else lambda a, b: bound
    bounds = [as_numbers(name, over(float(a), float(b))) for a, b in zip(times[:-1], times[1:], strict=True)]
    for values in bounds:
        if values.shape != shape or not np.all(values >= 0):
            raise ReachError(f"the {name} must be >= 0 and of shape {shape}, got {values!r}")
    return np.stack(bounds)


def _consistent(name: str, observed: Array, bound: Array) -> None:
    if np.any(observed > bound * (1 + CONSISTENT)):
        k, i, j = np.unravel_index(np.argmax(observed - bound * (1 + CONSISTENT)), observed.shape)
        detail = f"values change by {observed[k, i, j]:g} in entry ({i}, {j}) of step {k}"
        raise ReachError(f"the bound on the {name} is too small: {detail}, the bound is {bound[k, i, j]:g}")


class Sweep:
    """Steps of a varying system: transitions, effects of inputs, and boxes around all rests."""

    def __init__(self, system: LTVSystem, initial: ConvexSet, horizon: float, step: float) -> None:
        n, m = system.dim, system.inputs
        require_single("the initial set", initial, n)
        if horizon / step > MAX_STEPS:
            raise ReachError(f"a system that varies takes at most {MAX_STEPS:,} steps, got {horizon / step}")
        count = max(int(np.ceil(horizon / step * (1 - 1e-12))), 1)
        self.initial, self.U, self.n = initial, system.U, n
        self.times = system.begin + np.linspace(0, horizon, count + 1)
        self.h = h = horizon / count
        A, B = sample("A", system.A, (n, n), self.times), sample("B", system.B, (n, m), self.times)
        c = sample("c", system.c, (n,), self.times)
        self.x0 = extent("the initial set", initial)
        u = np.r_[extent("an input set", system.U) if m else np.zeros(0), 1.0]
        G = np.concatenate([B.nodes, c.nodes], axis=-1)

        def force(name: str) -> Array:
            """Bound on ``[B c] (u, 1)``, or on its change, over every step, shape (K, n, 1)."""
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
        W, Y = (exponential(_growing(M, radius), h) for radius in (0.0, D))
        defect = W @ (h**5 / 480 * C3 + A.area + h**2 / 2 * (D @ W @ D)) @ Y
        # Inputs: the trapezoid of V(s) = Phi(t_k+1, s) G(s), G = [B c], whose V'' bounds its rest.
        first, force_most, rate, size = np.abs(G[:-1]) @ u, force("most"), force("rate"), A.most
        curved = A.rate @ force_most + 2 * size @ rate + size @ size @ force_most
        driven = Y @ force_most
        remainder = Y @ (h**3 / 12 * curved + force("area")) + h / 2 * defect @ first[..., None]
        self.missed, self.rest = defect + ROUNDING * n * W, (remainder + ROUNDING * n * h * driven)[..., 0]
        self.early, self.late = self.P @ G[:-1], G[1:]
        # Between the nodes: y'' = (A^2 + A') y, and the input's share by its Lipschitz constant.
        self.curve = M @ M + S
        self.more = np.abs(M) @ D + D @ np.abs(M) + D @ D + A.swing
        self.more = self.more @ Y + h * np.abs(self.curve) @ size @ Y
        slide = size @ driven + Y @ (size @ force_most + rate) / 2
        self.local = h**2 / 4 * slide[..., 0]

    def run(self, D: Array, effort: EffortBudget) -> RowBounds:
        """Bounds along rows D, which are kept; rows along the axes and against them bound the states."""
        K, n, h, r = len(self.P), self.n, self.h, len(D)
        axes = np.vstack([np.eye(n), -np.eye(n)])
        rows = D if np.array_equal(D, axes) else np.vstack([D, axes])
        first, upper, lower, attained = (np.zeros((K + 1, len(rows))) for _ in range(4))
        intersample, maps, later = np.empty((K, len(rows))), np.empty((K + 1, n, n)), np.empty((K, n, n))
        boxes = np.empty((K, n))
        maps[0], first[0], size, absolute = np.eye(n), self.initial.support(rows), self.x0, np.abs(rows)
        attained[0] = attained_support(self.initial, rows, first[0])
        upper[0] = ROUNDING * n * (absolute @ size)
        driven, lower[0] = np.zeros(n), -upper[0]

        def largest(bounds: Array) -> Array:
            """Elementwise bound on a value with bounds along the axes and against them."""
            return np.maximum(np.abs(bounds[-2 * n : -n]), np.abs(bounds[-n:]))

        for k in range(K):
            effort.spend((k + 1) * rows.size)
            boxes[k] = self.missed[k] @ size + self.rest[k]
            curved = rows @ self.curve[k]
            along = curved @ maps[k]
            free = np.maximum(self.initial.support(along), self.initial.support(-along))
            bend = free + np.abs(curved) @ driven + absolute @ (self.more[k] @ size)
            intersample[k] = h**2 / 8 * bend + absolute @ self.local[k]
            later[:k] = self.P[k] @ later[:k]
            later[k] = np.eye(n)
            maps[k + 1] = self.P[k] @ maps[k]
            carried = rows @ maps[k + 1]
            first[k + 1] = self.initial.support(carried)
            attained[k + 1] = attained_support(self.initial, carried, first[k + 1])
            R = rows @ later[: k + 1]
            start, end = R @ self.early[: k + 1], R @ self.late[: k + 1]
            value = driven_support(self.U, start) + driven_support(self.U, end)
            middle = driven_support(self.U, (start + end) / 2, attained=True)
            error = (np.abs(R) @ boxes[: k + 1, :, None]).sum(axis=0)[:, 0]
            upper[k + 1] = h / 2 * value.sum(axis=0) + error
            lower[k + 1] = h * middle.sum(axis=0) - error
            driven, size = largest(upper[k + 1]), largest(first[k + 1] + upper[k + 1])
        first, attained, upper, lower, intersample = (
            part[:, :r] for part in (first, attained, upper, lower, intersample)
        )
        zeros, straight = np.zeros((K + 1, r)), np.zeros((K, r))
        return RowBounds(
            self.times, first, attained, upper, lower, intersample, straight, zeros, zeros, zeros, D @ maps
        )


def _growing(M: Array, radius: Array | float) -> Array:
    """Nonnegative matrices whose exponentials bound those of M, and of anything within `radius` of it."""
    eye = np.eye(M.shape[-1], dtype=bool)
    return np.asarray(np.where(eye, np.maximum(M + radius, 0.0), np.abs(M) + radius))
