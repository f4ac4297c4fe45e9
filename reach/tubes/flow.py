"""Linear closed loops from node to node: exact at the nodes, bounded between them.

Nodes are the instants at which a held input is renewed, or a fine grid of a motion without one.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy.linalg import expm, matrix_balance, solve_continuous_lyapunov, solve_discrete_lyapunov

from ..numerics.checks import Array, checked
from ..numerics.errors import ReachError
from ..numerics.linear import discretize, growth, powers, require_square
from ..sets.ellipsoid import ball_generators
from ..sets.zonotope import Zonotope
from ..short_repr import short_repr


@short_repr
@dataclass(frozen=True, eq=False)
class LinearFlow:
    """Motion of ``e' = A e + B u + D w + E v`` under the feedback ``u = -K e``, node by node.

    Over one period of length h from a node, ``e(s) = M(s) e(0) + int_0^s e^{A_x (s-r)} D w(r) dr``
    with ``M'' (s) = A_x e^{A_x s} A_c``, where ``A_c = A - B K`` and

    * `sampled` (u held over the period): ``A_x = A``, ``M(s) = e^{A s} - int_0^s e^{A r} dr B K``;
    * `continuous` (K = 0, or fed back at every instant): ``A_x = A_c``, ``M(s) = e^{A_c s}``.

    Parameters
    ----------
    A_x, A_c : ndarray, shape (n, n)
    D : ndarray, shape (n, p)
        Disturbance map; the disturbance obeys ``norm(w, 2) <= w_max``.
    w_max : float
    h : float
        Length of a period [s].
    phi : ndarray, shape (n, n)
        Transition ``M(h)`` from node to node.
    E : ndarray, shape (n, g), or None
        Map of a second disturbance, measurable too, whose parts obey ``|v_j| <= 1`` one by one. What is
        called the disturbance below is both together.
    """

    A_x: Array
    A_c: Array
    D: Array
    w_max: float
    h: float
    phi: Array
    E: Array | None = None

    @classmethod
    @checked
    def continuous(cls, A_c: Array, D: Array, w_max: float, h: float, E: Array | None = None) -> LinearFlow:
        """Motion of the matrix A_c: free, or under continuous feedback."""
        require_square("A_c", A_c)
        return cls(A_c, A_c, D, w_max, h, np.asarray(expm(A_c * h)), E)

    @classmethod
    @checked
    def sampled(
        cls, A: Array, B: Array, K: Array, D: Array, w_max: float, h: float, E: Array | None = None
    ) -> LinearFlow:
        """Zero-order-hold feedback ``u = -K e(t_j)`` renewed every h."""
        Ah, Bh = discretize(A, B, h)
        if K.shape != B.shape[::-1]:
            raise ReachError(f"K must have shape {B.shape[::-1]}, got {K.shape}")
        return cls(A, A - B @ K, D, w_max, h, Ah - Bh @ K, E)

    def __post_init__(self) -> None:
        require_square("A_c", self.A_c)
        if self.D.ndim != 2 or len(self.D) != len(self.A_c):
            raise ReachError(f"D must have {len(self.A_c)} rows, got shape {self.D.shape}")
        if not (self.h > 0 and self.w_max >= 0 and np.isfinite(self.h) and np.isfinite(self.w_max)):
            raise ReachError(f"h must be > 0 and w_max >= 0, both finite, got {self.h!r} and {self.w_max!r}")

    @cached_property
    def growth(self) -> Array:
        """Elementwise bound on ``|e^{A_x s}|`` for s in [0, h]."""
        return growth(self.A_x, self.h)

    @cached_property
    def period_box(self) -> Array:
        """Elementwise bound on the response to the disturbance within one period, shape (n,)."""
        reached = discretize(np.abs(self.A_x), np.abs(self.D), self.h)[1]
        # |D| w is bounded row by row by the 2-norm of the row times w_max; the sum over columns of
        # the integral is an upper bound either way.
        box = np.asarray(reached.sum(axis=1) * self.w_max)
        if self.E is None:
            return box
        return np.asarray(box + discretize(np.abs(self.A_x), np.abs(self.E), self.h)[1].sum(axis=1))

    @checked
    def input_map(self, B: Array) -> Array:
        """``int_0^h e^{A_x s} ds B``: the effect of an input held over one period, shape (n, m)."""
        return self._integral @ B

    @checked
    def input_zonotope(self, B: Array, inputs: Array, size: Array) -> Zonotope:
        """Zonotope enclosing ``{int_0^h e^{A_x s} B v(s) ds}`` for measurable v in a set about zero.

        The mean of v lies in the set, as it is convex; the rest is bounded by ``h^2/3 sup |B v|``
        times the Lipschitz constant of ``e^{A_x s}`` (docs/theory.md, Proposition 9 (c)).

        Parameters
        ----------
        B : ndarray, shape (n, m)
        inputs : ndarray, shape (m, g)
            Generators of a zonotope that encloses the set of inputs.
        size : ndarray, shape (n,)
            Elementwise bound on ``|B v|`` over the set of inputs.
        """
        rest = self.h**2 / 3 * (np.abs(self.A_x) @ self.growth) @ size
        return Zonotope(np.zeros(len(rest)), np.hstack([self.input_map(B) @ inputs, np.diag(rest)]))

    @cached_property
    def _integral(self) -> Array:
        return discretize(self.A_x, np.eye(len(self.phi)), self.h)[1]

    @checked
    def intersample(self, nodes: Zonotope) -> Array:
        """Bound ``(h^2/8) sup |M''(s) e|`` on ``|e(t) - chord|`` after each node, shape (..., n)."""
        return np.asarray(self.h**2 / 8 * ((self.A_x @ self.A_c) @ nodes).extent @ self.growth.T)

    @property
    def lyapunov(self) -> tuple[Array, float]:
        """A matrix W and the contraction factor ``norm(W phi W^-1, 2) < 1`` per period.

        W is the square root of the solution of the discrete Lyapunov equation, whose right-hand
        side weighs the states by the size they reach, so that units do not matter.

        Raises
        ------
        ReachError
            If phi is not a contraction in any norm (an unstable closed loop).
        """
        return self._contraction[:2]

    @cached_property
    def _contraction(self) -> tuple[Array, float, float]:
        """`lyapunov`, and the relative round-off of ``norm(W M W^-1, 2)``, by the scaled root's condition."""
        radius = float(np.max(np.abs(np.linalg.eigvals(self.phi))))
        if not radius < 1:
            detail = f"spectral radius {radius:.6g} per period of {self.h:g}"
            raise ReachError(f"the closed loop is not stable: {detail}")
        rate = -np.log(radius) / self.h
        scale = state_scale(self.A_c)
        # Asking for half the slowest rate keeps the norm well conditioned.
        aim = float(np.exp(-0.5 * rate * self.h))
        inverse = np.diag(1 / scale)
        normal = inverse @ self.phi @ np.diag(scale) / aim
        P = solve_discrete_lyapunov(normal.T, np.eye(len(scale)) * (1 - aim**2))
        P = (P + P.T) / 2
        values, vectors = np.linalg.eigh(P)
        if values.min() <= 0:
            raise ReachError("the Lyapunov equation has no positive definite solution to working precision")
        root = (vectors * np.sqrt(values)) @ vectors.T
        # Judged on the scaled states: scaling columns only adds a rounding to each entry.
        condition = float(np.linalg.cond(root))
        if condition > 1e6:
            raise ReachError("the Lyapunov norm is too ill-conditioned to bound anything with")
        W = root @ inverse
        slack = 10 * len(W) * np.finfo(float).eps * condition**2
        factor = float(np.linalg.norm(W @ self.phi @ np.linalg.inv(W), 2)) * (1 + slack)
        if not factor < 1:
            raise ReachError("the Lyapunov norm found does not contract to working precision")
        return np.asarray(W), factor, slack

    @checked
    def norms(self, count: int) -> Array:
        """``norm(W phi^l W^-1, 2)`` for l = 0..count, shape (count+1,); never increasing."""
        if count < 0:
            raise ReachError(f"count must be at least 0, got {count}")
        W, _, slack = self._contraction
        stack = W @ powers(self.phi, count) @ np.linalg.inv(W)
        return np.asarray(np.linalg.norm(stack, 2, axis=(-2, -1)) * (1 + slack))

    @checked
    def disturbance_support(self, rows: Array, count: int) -> Array:
        """``sum_{l<L} sup_w rows phi^l int_0^h e^{A_x s} D w ds`` for L = 0..count, shape (count+1, r).

        Each period's integral: the trapezoid plus ``h^3/12 sup |second derivative|`` (Proposition 9 (b)).
        """
        if rows.ndim != 2 or rows.shape[1] != len(self.phi):
            raise ReachError(f"rows must have shape (r, {len(self.phi)}), got {rows.shape}")
        images = rows @ powers(self.phi, count)  # (count+1, r, n)
        period = self.w_max * self._along(images[:-1], self.D, 2)
        if self.E is not None:
            period = period + self._along(images[:-1], self.E, 1)
        return np.vstack([np.zeros((1, len(rows))), np.cumsum(period, axis=0)])

    @checked
    def input_gains(self, rows: Array, B: Array, count: int) -> Array:
        """``int_0^h |row phi^l e^{A_x s} B_j| ds`` for l = 0..count-1, bounded above, shape (count, r, m).

        What a measurable input with ``|v_j| <= 1`` adds along each row l periods later.
        """
        images = rows @ powers(self.phi, count - 1)
        return np.stack([self._along(images, column[:, None], 1) for column in B.T], axis=-1)

    def _along(self, rows: Array, M: Array, order: int) -> Array:
        """Bound on ``int_0^h norm(row e^{A_x s} M) ds``, for a norm of an order."""
        end = np.asarray(expm(self.A_x * self.h)) @ M
        at_start, at_end = (np.linalg.norm(rows @ part, order, axis=-1) for part in (M, end))
        # |v'' | <= |row A_x^2| e^{|A_x| h} |M|, elementwise
        second = np.abs(rows @ (self.A_x @ self.A_x)) @ self.growth @ np.abs(M)
        curvature = np.linalg.norm(second, order, axis=-1)
        return np.asarray(self.h / 2 * (at_start + at_end) + self.h**3 / 12 * curvature)

    @cached_property
    def period_zonotope(self) -> Zonotope:
        """Zonotope enclosing ``{int_0^h e^{A_x s} (D w(s) + E v(s)) ds}`` (the disturbance of one period)."""
        ball = ball_generators(self.D.shape[1], self.w_max)
        zonotope = self.input_zonotope(self.D, ball, np.linalg.norm(self.D, axis=1) * self.w_max)
        if self.E is None:
            return zonotope
        return zonotope + self.input_zonotope(self.E, np.eye(self.E.shape[1]), np.abs(self.E).sum(axis=1))

    @checked
    def disturbance_nodes(self, count: int, order: float = 30.0, together: int = 1) -> Zonotope:
        """Zonotopes around the response to the disturbance at nodes 0..count from rest, each reduced once.

        What up to `together` periods add is merged before, which widens the sets far less.
        """
        n = len(self.phi)
        blocks = powers(self.phi, max(count - 1, 0)) @ self.period_zonotope.G
        parts = [Zonotope.point(np.zeros(n))]
        for i in range(1, count + 1):
            parts.append(Zonotope(np.zeros(n), merged(blocks[:i], together)).reduce(order))
        return Zonotope.stack(parts)


def merged(blocks: Array, most: int) -> Array:
    """Generators (n, g) of a set that holds the sum of those of periods (L, n, g), up to `most` as one.

    What a period adds hardly turns from one to the next: with a mean direction c of several generators,
    ``sum_l g_l b_l`` is ``c sum_l b_l`` up to ``sum_l |g_l - c|``, which a box takes, rounding included.
    """
    if most == 1:
        return np.hstack(list(blocks))
    sums, residual = [], np.zeros(blocks.shape[1])
    for first in range(0, len(blocks), most):
        part = blocks[first : first + most]
        sums.append(part.sum(axis=0))
        residual = residual + np.abs(part - sums[-1] / len(part)).sum(axis=(0, 2))
    return np.hstack([*sums, np.diag(residual + 1e-13 * np.abs(blocks).sum(axis=(0, 2)))])


@checked
def state_scale(A_c: Array) -> Array:
    """Positive sizes of the states that make ``A_c`` balanced, shape (n,): a diagonal similarity.

    Raises
    ------
    ReachError
        If the closed loop is not stable.
    """
    require_square("A_c", A_c)
    if (slowest := np.max(np.linalg.eigvals(A_c).real)) >= 0:
        raise ReachError(f"the closed loop is not stable: largest real part of an eigenvalue {slowest:.6g}")
    return _balanced(A_c.tobytes(), len(A_c)).copy()


@lru_cache(maxsize=256)
def _balanced(entries: bytes, n: int) -> Array:
    """Return `state_scale` of a stable matrix, given by its entries; each is balanced once."""
    A_c = np.frombuffer(entries).reshape(n, n)
    # Covariance under unit white noise in the balanced coordinates, iterated to a fixed point. It starts
    # from rows and columns of like norms: in far-fetched units the equation is singular to rounding.
    scale = np.asarray(matrix_balance(A_c, permute=False, separate=True)[1][0])
    for _ in range(50):
        normal = A_c * scale[None, :] / scale[:, None]
        P = solve_continuous_lyapunov(normal, -np.eye(len(A_c)))
        step = np.sqrt(np.sqrt(np.maximum(np.diag(P) / np.diag(P).min(), 1e-12)))
        scale = scale * step / step.min()
        if np.max(np.abs(step / step.min() - 1)) < 1e-6:
            break
    return np.asarray(scale / scale.min())
