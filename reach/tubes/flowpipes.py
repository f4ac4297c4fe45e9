"""Tubes of many start sets at once: rows are carried once and applied to a stack of zonotopes."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import expm

from ..numerics.checks import Array, per_row
from ..numerics.errors import ReachError
from ..numerics.exponentials import dense, times
from ..numerics.linear import powers
from ..sets.zonotope import Zonotope
from ..short_repr import short_repr
from .adjoint import Adjoint, augmented
from .rows import ROUNDING
from .stepping import MAX_STEPS, substeps
from .systems import LinearSystem

BLOCK = 32  # steps carried together
ENTRIES = 1_000_000  # numbers handled at once where a stack is worked through in parts
HALVINGS = 16  # a step is halved at most this often to meet a tolerance


@short_repr
@dataclass(frozen=True, eq=False)
class Flowpipes:
    """Sets that hold ``x(t)`` over time steps, for every one of N start sets.

    Start i is followed from its own time `offset[i]` on: at node k it is at local time
    ``offset[i] + times[k]``.

    Attributes
    ----------
    times : ndarray, shape (K+1,)
    offset : ndarray, shape (N,)
    start : Zonotope, batch (N,)
        Start sets at local time 0 (with a last coordinate that is constantly 1 if there is a drift).
    maps : ndarray, shape (K+1, M, n, d)
        ``x(t_k) = maps[k] x(0)`` but for the inputs; M is N, or 1 if the offsets are alike.
    intersample : ndarray, shape (K, N, n)
        Between two nodes the state leaves the set that joins them by no more, rounding included.
    low, high : ndarray, shape (K, n)
        Bounds on the response to the inputs over every step.
    """

    times: Array
    offset: Array
    start: Zonotope
    maps: Array
    intersample: Array
    low: Array
    high: Array

    @property
    def shape(self) -> tuple[int, int]:
        """Steps and start sets, (K, N)."""
        return self.intersample.shape[0], self.intersample.shape[1]

    def support(self, directions: Array) -> Array:
        """Bounds on ``d x(t)`` over every step, shape (K, N, r) for rows (r, n)."""
        D = np.asarray(directions, dtype=float)
        middle, spread = images(D @ self.maps, self.start)
        nodes = middle + spread
        middle, half = (self.low + self.high) / 2, (self.high - self.low) / 2
        extra = (middle @ D.T + half @ np.abs(D).T)[:, None]
        return np.asarray(np.maximum(nodes[1:], nodes[:-1]) + self.intersample @ np.abs(D).T + extra)

    def sets(self, k: NDArray[np.intp], i: NDArray[np.intp]) -> Zonotope:
        """Zonotopes over chosen steps of chosen starts, batch (len(k),)."""
        j = i if self.maps.shape[1] > 1 else np.zeros_like(i)
        c, G = self.start.c[i], self.start.G[i]
        before, after = self.maps[k, j], self.maps[k + 1, j]
        a = Zonotope((before @ c[..., None])[..., 0], before @ G)
        b = Zonotope((after @ c[..., None])[..., 0], after @ G)
        middle, half = (self.low[k] + self.high[k]) / 2, (self.high[k] - self.low[k]) / 2
        return (a.hull(b) + middle).inflate(self.intersample[k, i] + half)


class Propagator:
    """A system with its drift in the state, made ready for many flowpipes: one input set at most."""

    def __init__(self, system: LinearSystem) -> None:
        self.system, n = system, system.dim
        extended, _ = augmented(system, Zonotope.point(np.zeros(n)))
        self.dim = extended.dim
        self.adjoint = Adjoint(extended, Zonotope.point(np.zeros(self.dim)))
        self.rows = self.adjoint.rows

    def lifted(self, start: Zonotope) -> Zonotope:
        """Start sets with a last coordinate that is constantly 1, if there is a drift."""
        if self.dim == start.dim:
            return start
        lifted: Zonotope = np.eye(self.dim, start.dim) @ start + np.eye(self.dim)[-1]
        return lifted


def flowpipes(
    propagator: Propagator,
    start: Zonotope,
    horizon: float,
    *,
    step: float,
    tolerance: ArrayLike | None = None,
    offset: Array | None = None,
    going: Callable[[Flowpipes], NDArray[np.bool_]] | None = None,
) -> Flowpipes:
    """Follow a stack of start sets over a horizon, in steps of a length at most.

    Steps are halved (`HALVINGS` times at most) until the intersample bound meets a tolerance (n,). With an
    `offset` (N,) each start is followed from that local time on, without the inputs (see `input_response`).
    `going` says of every block which starts (N,) go on.
    """
    if horizon / step > MAX_STEPS:
        raise ReachError(f"more than {MAX_STEPS:,} steps: horizon {horizon:g}, step {step:g}")
    stepper = _Stepper(propagator, start, offset, step, horizon)
    limit = None if tolerance is None else per_row("tolerance", tolerance, propagator.system.dim)
    blocks: list[Flowpipes] = []
    h, elapsed = step, 0.0
    while elapsed < horizon or not blocks:
        duration = horizon - elapsed
        length, count = (duration, 1) if h >= duration * (1 - 1e-12) else (h, int(min(BLOCK, duration // h)))
        block = stepper.block(elapsed, length, count)
        error = 0.0 if limit is None else float((block.intersample / limit).max())
        if not np.all(np.isfinite(block.intersample)):
            error = np.inf
        if error > 1 and h > step * 2.0**-HALVINGS:
            h = min(h, length) / 2
            continue
        if error == np.inf:
            raise ReachError(f"the step {step:g} is too long: the bounds are beyond floating point")
        stepper.accept()
        blocks.append(block)
        elapsed = horizon if length == duration else elapsed + count * length
        if going is not None and not np.any(going(block)):
            break
        if error < 0.2 and h < step:
            h *= 2
    return _joined(blocks)


def _joined(blocks: list[Flowpipes]) -> Flowpipes:
    first = blocks[0]

    def joined(name: str, after: int) -> Any:
        return np.concatenate([getattr(first, name), *(getattr(b, name)[after:] for b in blocks[1:])])

    steps = {name: joined(name, 0) for name in ("intersample", "low", "high")}
    return replace(first, times=joined("times", 1), maps=joined("maps", 1), **steps)


class _Stepper:
    """Blocks of flowpipes, one after the other."""

    def __init__(
        self, propagator: Propagator, start: Zonotope, offset: Array | None, step: float, horizon: float
    ) -> None:
        n, d, rows = propagator.system.dim, propagator.dim, propagator.rows
        self.n, self.propagator, self.start, s = n, propagator, propagator.lifted(start), rows.scale
        self.x = Zonotope(self.start.c / s, self.start.G / s[:, None])
        self.extent = self.x.extent
        self.offset = np.zeros(len(start)) if offset is None else np.asarray(offset, dtype=float)
        late = float(self.offset.max(initial=0.0))
        self.M = len(start) if np.ptp(self.offset) else 1
        self.forced = propagator.adjoint.input_pieces > 0 and late == 0
        self.rows = np.eye(n, d) * s
        if late > 0:
            self.rows = (self.rows @ expm(dense(rows.A) * self.offset[: self.M, None, None])).reshape(-1, d)
        elif self.forced:
            self.rows = np.vstack([self.rows, -self.rows])
        self.sum, self.work = np.zeros(2 * n), d + rows.norm * late
        # What a product gets wrong is carried on: it is weighed by the sizes that states grow to.
        longest = horizon + late
        lags = rows.lags(min(step, longest), longest) if longest > 0 else []
        if self.forced:
            propagator.adjoint.watch(lags)
        self.weights = rows.weights(lags, rows.weights(lags, self.extent.T)).T

    def block(self, begin: float, h: float, count: int) -> Flowpipes:
        """Steps that follow the accepted ones, not yet accepted themselves."""
        n, M, adjoint, rows = self.n, self.M, self.propagator.adjoint, self.propagator.rows
        A, parts = rows.A, substeps(adjoint, h)
        f = h / parts
        forcing = adjoint.block(self.rows, f, count * parts) if self.forced else None
        all_rows = rows.carry(self.rows, f, count * parts) if forcing is None else forcing.rows
        R = all_rows[:, : M * n].reshape(count * parts + 1, M, n, -1)
        R2 = times(times(R, A), A)
        R4 = np.abs(times(times(R2, A), A)[:-1])
        middle, spread = images(R2, self.x)
        p2 = np.abs(middle) + spread
        curve = np.maximum(p2[1:], p2[:-1])
        sizes = rows.closing(f, self.extent.T).T if f > 0 else self.extent
        curve = curve + f**2 / 8 * (R4 @ sizes[..., None])[..., 0]
        intersample = h**2 / 8 * curve.reshape(count, parts, *curve.shape[1:]).max(axis=1)
        coarse = R[::parts]
        work = self.work + count * (parts + h * rows.norm)
        rounding = ROUNDING * work * (np.abs(coarse) @ self.weights[..., None])[..., 0]
        intersample = intersample + np.maximum(rounding[1:], rounding[:-1])
        low = high = np.zeros((count, n))
        added = self.sum
        if forcing is not None:
            sums = np.vstack([np.zeros((1, 2 * n)), np.cumsum(forcing.upper[:, 0], axis=0)]) + self.sum
            bend = parts**2 * forcing.bend[:, 0].reshape(count, parts, 2 * n).max(axis=1)
            ends = np.maximum(sums[parts::parts], sums[:-1:parts]) + bend
            ends = ends + ROUNDING * work * (begin + h * count) * forcing.size[1].max(axis=0)
            low, high, added = -ends[:, n:], ends[:, :n], sums[-1]
        self._next = all_rows[-1], added, work
        nodes = np.asarray(begin + h * np.arange(count + 1), dtype=float)
        maps = np.asarray(coarse / rows.scale, dtype=float)
        return Flowpipes(nodes, self.offset, self.start, maps, intersample, low, high)

    def accept(self) -> None:
        """Go on from the end of the last block."""
        self.rows, self.sum, self.work = self._next


def images(rows: Array, sets: Zonotope) -> tuple[Array, Array]:
    """Values of rows (m, M, r, d) at the centres of N sets and half-widths around, (m, N, r); M is N or 1."""
    (m, M, r, d), N, g = rows.shape, len(sets), sets.order_count
    middle, spread = np.empty((m, N, r)), np.empty((m, N, r))
    columns = np.concatenate([sets.c[..., None], sets.G], axis=-1)  # (N, d, 1 + g)
    flat = np.ascontiguousarray(np.moveaxis(columns, 1, 0)).reshape(d, -1)
    size = max(ENTRIES // max(N * r * (g + 1), 1), 1)
    for k in range(0, m, size):
        part = rows[k : k + size]
        if M == 1:
            products = np.moveaxis((part.reshape(-1, d) @ flat).reshape(-1, r, N, g + 1), 2, 1)
        else:
            products = part @ columns
        middle[k : k + size], spread[k : k + size] = products[..., 0], np.abs(products[..., 1:]).sum(axis=-1)
    return middle, spread


def input_response(system: LinearSystem, time: float, step: float) -> Zonotope:
    """Zonotope around the centred response to the inputs, two generators per step: mean and first moment.

    ``|moment| <= h^2/4``; what is left is of third order and enclosed by a box.
    """
    n = system.dim
    U = system.U[0]
    if not isinstance(U, Zonotope):
        hull, c = U.interval_hull(), U.center
        U = Zonotope.box(np.zeros(U.dim), np.maximum(hull.hi - c, c - hull.lo))
    A, B = dense(system.A), dense(system.B)
    count = max(int(np.ceil(time / step * (1 - 1e-12))), 1)
    h = time / count
    BU = B @ U.G
    half, whole = expm(A * h / 2), expm(A * h)
    diagonal = np.diag(np.diag(A))
    growth = expm((np.abs(A) - np.abs(diagonal) + np.maximum(diagonal, 0)) * h)
    first = np.hstack([h * half @ BU, h**2 / 4 * (A @ half @ BU)])
    remainder = h**3 / 24 * (growth @ (np.abs(A @ A) @ np.abs(BU).sum(axis=1)))
    maps = powers(whole, count - 1)
    G = np.moveaxis(maps @ first, 0, 1).reshape(n, -1)
    box = np.abs(maps).sum(axis=0) @ remainder
    box = box + ROUNDING * (n + count) * np.abs(G).sum(axis=1)
    return Zonotope(np.zeros(n), np.hstack([G, np.diag(box)]))
