"""Rows ``d e^{A t}`` on regular grids, and how far their rounding can have grown."""

from typing import Any

import numpy as np
from scipy import sparse

from ..numerics.checks import Array
from ..numerics.exponentials import CANCELLED, Action, dense, exponential, flushed, scaled, thin_expm, times
from .systems import LinearSystem

SPARSE = 0.1  # share of entries below which products with A use its sparse form
DENSE = 300  # states up to which exponentials are formed
ROUNDING = 16 * np.finfo(float).eps
"""Relative rounding allowance per step and state, see `docs`; never the error of a method."""
SAMPLES = 8  # instants at which the growth of rounding in larger systems is looked at
WATCHED = 400  # states up to which the growth of rounding is bounded by exponentials over the whole horizon


def balance(A: Array) -> Array:
    """Powers of two s that make the rows and columns of ``A[i, j] s[j] / s[i]`` alike, shape (n,).

    Constants and integrals get a scale that leaves the norm of the others as it is.
    """
    size = abs(A)
    logs = np.zeros(size.shape[0])

    def sums(s: Array, share: Any = 1.0) -> tuple[Array, Array]:
        return np.asarray(size @ (s * share)).ravel() / s, np.asarray(size.T @ (share / s)).ravel() * s

    for _ in range(30):
        row, column = sums(np.exp2(logs))
        both = (row > 0) & (column > 0)
        change = np.zeros_like(logs)
        change[both] = np.log2(row[both] / column[both]) / 4
        logs = np.clip(logs + change, -60, 60)
        if np.max(np.abs(change), initial=0.0) < 0.25:
            break
    row, column = sums(np.exp2(logs))
    level = np.max(sums(np.exp2(logs), both)[0][both], initial=0.0)
    if level > 0:
        constant, integral = (row == 0) & (column > 0), (row > 0) & (column == 0)
        logs[constant] += np.log2(level / column[constant])
        logs[integral] += np.log2(row[integral] / level)
    return np.asarray(np.exp2(np.round(np.clip(logs, -60, 60))))


class ExponentialRows:
    """Rows ``d e^{A t}`` on regular grids, in coordinates in which A is balanced.

    Carried through a dense, a thin or no exponential (its action). `work` are roundings per unit of time.
    """

    def __init__(self, system: LinearSystem) -> None:
        self.discrete = system.discrete
        self.scale = s = np.ones(system.dim) if system.discrete else balance(system.A)
        A = sparse.csr_matrix(scaled(scaled(system.A, 1 / s).T, s).T)
        thin = system.sparse or A.nnz < SPARSE * A.shape[0] ** 2
        self.A = A if thin else A.toarray()
        self.norm = float(np.max(np.asarray(abs(A).sum(axis=1)), initial=0.0))
        large = system.sparse and system.dim > DENSE and not self.discrete
        self.action = Action(self.A.T) if large else None
        self.work = self.norm * (CANCELLED if self.action else 1.0)
        sums = np.asarray(abs(A).sum(axis=1)).ravel() + A.diagonal() - np.abs(A.diagonal())
        # The logarithmic norm of largest entries, up to rounding.
        self.contracts = not system.discrete and float(np.max(sums, initial=0.0)) <= 1e-12 * self.norm
        self._maps: dict[float, Any] = {}
        self._closings: dict[float, Any] = {}

    def map(self, h: float) -> Any:
        """``e^{A h}`` (``A^h`` if discrete), from its half where known; None if sparse A fills up."""
        if h not in self._maps:
            # Squaring what is close to the identity loses its digits, and no series needs it.
            long = self.discrete or self.norm * h > 0.5
            half = self._maps.get(h / 2) if long else None
            with np.errstate(over="ignore", invalid="ignore"):
                if self.action is not None:
                    self._maps[h] = thin_expm(self.A, h, self.action, half)
                elif half is not None:
                    self._maps[h] = flushed(half @ half)
                elif self.discrete:
                    self._maps[h] = np.linalg.matrix_power(dense(self.A), int(h))
                else:
                    self._maps[h] = self._exponential(self.A, h)
        return self._maps[h]

    def _exponential(self, A: Any, h: float) -> Any:
        return exponential(A if A.shape[0] > DENSE else dense(A), h)

    def carry(self, rows: Array, h: float, count: int) -> Array:
        """``rows e^{A h l}`` for l = 0..count, shape (count+1, r, n); rows of shape (r, n)."""
        if self.action is not None and self.map(h) is None:
            return self.action(rows, h, count)
        out = np.empty((count + 1, *rows.shape))
        out[0] = rows
        if self.discrete:
            for i in range(count):
                out[i + 1] = times(out[i], self.A)
            return out
        filled = stride = 1  # rows that are known, and the steps of the longest map that is
        while filled <= count:
            if stride < filled and self.map(2 * stride * h) is not None:
                stride *= 2
            added = min(stride, count + 1 - filled)
            previous = out[filled - stride : filled - stride + added]
            out[filled : filled + added] = flushed(times(previous, self.map(h * stride)))
            filled += added
        return out

    def closing(self, h: float, vectors: Array) -> Array:
        """Bound on ``sup_s |e^{A s}| v`` over [0, h], elementwise, for v >= 0 (n,) or (n, q).

        ``|e^{A s}| <= e^{M s}``, M being |A| off the diagonal, the positive part on it; inf if it overflows.
        """
        with np.errstate(over="ignore", invalid="ignore"):
            if h not in self._closings:
                diagonal = self.A.diagonal()
                correction = np.maximum(diagonal, 0) - np.abs(diagonal)
                dense = isinstance(self.A, np.ndarray)
                M = abs(self.A) + (np.diag(correction) if dense else sparse.diags(correction, format="csr"))
                self._closings[h] = Action(M) if self.action is not None else self._exponential(M, h)
            growth = self._closings[h]
            out = growth @ vectors if self.action is None else growth(vectors.T, h, 1)[-1].T
        return np.where(np.isnan(out), np.inf, out)

    def lags(self, h: float, horizon: float) -> list[float]:
        """Powers of two of a step, up to the horizon; none where exponentials are not to be formed."""
        if self.action is not None or self.A.shape[0] > WATCHED:
            return []
        return [h * 2.0**i for i in range(int(np.log2(horizon / h)) + 1)]

    def weights(self, lags: list[float], sizes: Array) -> Array:
        """Sizes (n, q) that states of given sizes grow to after any of some lags, less growth at one rate."""
        if not lags and self.contracts:  # the largest of all states bounds each of them ever after
            return np.broadcast_to(sizes.max(axis=0), sizes.shape).copy()
        with np.errstate(over="ignore", invalid="ignore"):
            lagged = np.array([sizes, *(np.asarray(abs(self.map(t)) @ sizes) for t in lags)])
            first, last = (np.maximum(g.max(axis=0), 1e-300) for g in (sizes, lagged[-1]))
            rate = np.clip(np.nan_to_num(np.log(last / first)), 0, 600) / max(lags, default=1.0)
            return np.asarray(np.max(lagged * np.exp(-np.outer([0.0, *lags], rate))[:, None], axis=0))

    def amplification(
        self, rows: Array, lags: list[float], weights: Array, horizon: float
    ) -> tuple[Array, Array]:
        """Numbers a and b with ``norm(e e^{A t}) <= norm(e) exp(a + b t)``, each (q, r).

        For perturbations e of the states that a row depends on, in q norms ``sum |e_i| w_i``; measured at the
        lags, with a factor 2 for times between (a product over lags would be out of all proportion).
        """
        r, q = len(rows), weights.shape[1]
        if not lags:
            growth = np.log(self._sampled_growth(weights, horizon))
            return np.repeat(growth[:, None], r, axis=1), np.zeros((q, r))
        logs, peaks = np.empty((len(lags), q, r)), np.abs(rows)
        for t in lags:
            peaks = np.maximum(peaks, np.abs(rows) @ abs(self.map(t)))
        for i, t in enumerate(lags):
            growth = np.asarray(abs(self.map(t)) @ weights)
            ratio = np.divide(growth, weights, out=np.where(growth > 0, np.inf, 1.0), where=weights > 0)
            factors = np.where(peaks[None] > 0, ratio.T[:, None], 0.0).max(axis=2)
            logs[i] = np.log(np.maximum(factors, 1e-300))
        # To the end it goes on as between the last two lags.
        slope = np.maximum(logs[-1] - logs[-2], 0) / (lags[-1] - lags[-2]) if len(lags) > 1 else 0.0
        logs = np.concatenate([logs, [logs[-1] + slope * (horizon - lags[-1])]])
        lag = np.asarray([*lags, horizon])[:, None, None]
        rates = np.concatenate([np.zeros((1, q, r)), logs / lag])
        excess = np.maximum(logs - rates[:, None] * lag, 0).max(axis=1) + np.log(2)
        # Any of these rates will do. Of those that bound the growth to the end well, take the fastest
        # decay, or else the fastest growth: it counts nothing twice of rows that grow by themselves.
        total = excess + np.maximum(rates, 0) * horizon
        speed = np.where(rates < 0, 1e9 - rates, rates)
        choice = np.where(total <= total.min(axis=0) + 1, speed, -np.inf).argmax(axis=0)[None]
        return np.take_along_axis(excess, choice, 0)[0], np.take_along_axis(rates, choice, 0)[0]

    def _sampled_growth(self, weights: Array, horizon: float) -> Array:
        """Factors (q,) by which states grow, from motions of random signs, times 10 for those missed."""
        if self.contracts:
            return np.full(weights.shape[1], 2.0)
        signs = np.random.default_rng(0).choice([-1.0, 1.0], weights.shape)
        start = (weights * signs).T
        with np.errstate(over="ignore", invalid="ignore"):
            if self.discrete:
                path = np.stack([start] * (int(horizon) + 1))
                for i in range(int(horizon)):
                    path[i + 1] = path[i] @ self.A.T
            else:
                path = self._sampled_path(start, horizon)
            peak, first = np.abs(path).max(axis=(0, 2)), weights.max(axis=0)
        ratio = np.divide(peak, first, out=np.ones_like(first), where=first > 0)
        return np.asarray(10 * np.clip(np.nan_to_num(ratio, nan=1e299, posinf=1e299), 1.0, 1e299))

    def _sampled_path(self, start: Array, horizon: float) -> Array:
        """Sizes of states moved on from rows of `start`, shape (m, q, n): at times, or the most of all."""
        m = int(np.clip(np.ceil(np.log2(max(self.norm * horizon / 4, 8.0))), 3, 20))
        if self.action is None or self.map(horizon / 2**m) is None:
            return Action(self.A)(start, horizon / SAMPLES, SAMPLES)
        while m > 3 and self.map(horizon / 2 ** (m - 1)) is not None:
            m -= 1
        x, peak = start.T, np.abs(start.T)
        for _ in range(2**m):
            x = self.map(horizon / 2**m) @ x
            peak = np.maximum(peak, np.abs(x))
        return np.stack([start, peak.T])
