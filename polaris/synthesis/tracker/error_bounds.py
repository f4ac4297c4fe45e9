"""Lemma 1, corrected: exponential bounds on the tracking error in a weighted norm."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from reach.numerics.linear import powers
from reach.short_repr import short_repr

from ...model.checks import one_of
from ...model.errors import ScenarioError
from ...model.system import Array
from ...model.tolerances import ROUNDING
from .tracking import Tracking


@short_repr
@dataclass(frozen=True, eq=False)
class ErrorBounds:
    """ISS bounds on the error ``e = x - xi`` (docs/theory.md, Lemma 1), w being all that disturbs it.

    Each bound reads ``gamma exp(-beta t) norm(W e(0), 2) + gain w_max``, for all t >= 0.

    Attributes
    ----------
    W : ndarray, shape (n, n)
        Weight of the norm.
    beta : float
        Decay rate [1/s], ``0 < beta < |max Re eig(A - B Lambda)|``.
    gamma, gain : float
        Of ``norm(W e(t), 2)``.
    gamma_position, gain_position : float
        Of the error of position, ``norm(C e(t), 2)`` [m].
    gamma_input, gain_input : ndarray, shape (m,)
        Of S's feedback on each input, ``|Lambda_i e(t)|`` [N].
    method : str
        ``lyapunov`` or ``envelope``.
    """

    W: Array
    beta: float
    gamma: float
    gain: float
    gamma_position: float
    gain_position: float
    gamma_input: Array
    gain_input: Array
    method: str

    def radius(self, e0: float, t: ArrayLike, w_max: float) -> Array:
        """Bound on ``norm(W e(t))`` at times t [s]."""
        return np.asarray(self.gamma * np.exp(-self.beta * np.asarray(t)) * e0 + self.gain * w_max)


def get_err_bounds(
    tracking: Tracking, method: str = "envelope", weight: ArrayLike | str = "auto"
) -> ErrorBounds:
    """Compute the constants of Lemma 1; `ScenarioError` if the method is unknown or the weight is singular.

    The method ``lyapunov`` takes every constant from one contraction norm; ``envelope`` from the norms of the
    transition itself, bounded between the nodes and beyond the last one. The norm's weight, (n,) or (n, n),
    is given, the contraction norm's (``auto``), or none (``identity``: raw units, as printed).
    """
    one_of("tracking.bound", method, ("envelope", "lyapunov"))
    plain = tracking.system.as_ideal().unbiased
    tracking = tracking if plain is tracking.system else replace(tracking, system=plain)
    flow, system = tracking.flow, tracking.system
    W = _weight(tracking, weight)
    inverse = np.asarray(np.linalg.inv(W), dtype=float)
    contraction, factor = flow.lyapunov
    slowest = -np.log(np.max(np.abs(np.linalg.eigvals(flow.phi)))) / flow.h
    beta = float(min(-np.log(factor) / flow.h * (1 - ROUNDING), 0.8 * slowest))
    rows = {"W": W, "C": system.position} | {f"u{i}": tracking.gain[i : i + 1] for i in range(system.m)}
    # Errors measured in W start out in the contraction norm enlarged by `into`.
    into = float(np.linalg.norm(contraction @ inverse, 2))
    bounds = {}
    for name, R in rows.items():
        out = float(np.linalg.norm(R @ tracking.W_inverse, 2))
        if method == "lyapunov":
            # norm(V e(t)) <= factor^floor(t/h) (1 + what happens within a period)
            within = 1 + tracking.curvature(contraction).sum()
            gamma = out * within / factor * into
            gain = out * within * tracking.disturbance_radius / max(system.w_max, np.finfo(float).tiny)
        else:
            gamma = _envelope(tracking, R, inverse, beta, into)
            gain = _gain(tracking, R)
        bounds[name] = gamma * (1 + ROUNDING), gain * (1 + ROUNDING) if system.w_max > 0 else 0.0
    inputs = np.array([bounds[f"u{i}"] for i in range(system.m)])
    return ErrorBounds(W, beta, *bounds["W"], *bounds["C"], inputs[:, 0], inputs[:, 1], method)


def _weight(tracking: Tracking, weight: ArrayLike | str) -> Array:
    if isinstance(weight, str):
        if weight not in ("auto", "identity"):
            raise ScenarioError("tracking.weight", weight, "must be 'auto', 'identity' or numbers")
        return tracking.W if weight == "auto" else np.eye(tracking.system.n)
    W = np.asarray(weight, dtype=float)
    W = np.diag(W) if W.ndim == 1 else W
    n = tracking.system.n
    if W.shape != (n, n) or not np.all(np.isfinite(W)) or np.linalg.matrix_rank(W) < n:
        raise ScenarioError(
            "tracking.weight",
            np.asarray(weight).tolist(),
            f"must be {n} non-zero numbers or an invertible {n} x {n} matrix, of sizes that can be inverted",
        )
    return W


def _envelope(tracking: Tracking, R: Array, inverse: Array, beta: float, into: float) -> float:
    """``sup_t exp(beta t) norm(R M(t) W^-1)``: nodes, the chord between them, and the tail."""
    flow = tracking.flow
    count = tracking.settling + 1
    while True:
        stack = R @ powers(flow.phi, count) @ inverse
        nodes = np.linalg.norm(stack, 2, axis=(-2, -1))
        decay = flow.norms(count)
        curvature = np.linalg.norm(
            np.abs(R @ flow.A_x) @ flow.growth @ np.abs(flow.A_c @ tracking.W_inverse), 2
        )
        between = np.maximum(nodes[:-1], nodes[1:]) + flow.h**2 / 8 * curvature * into * decay[:-1]
        peak = float(np.max(between * np.exp(beta * flow.h * np.arange(1, count + 1))))
        # Beyond the last node the contraction takes over: its factor beats exp(-beta h).
        out = np.linalg.norm(R @ tracking.W_inverse, 2) + flow.h**2 / 8 * curvature
        tail = float(out * into * decay[-1] * np.exp(beta * flow.h * (count + 1)))
        # beta is at most 0.8 of the slowest rate, so the tail falls below the peak: a few doublings.
        if tail <= peak or count > 2000:
            return max(peak, tail)
        count *= 2


def _gain(tracking: Tracking, R: Array) -> float:
    """``int_0^inf norm(R e^{A_x s} phi^l D, 2) ds``, an upper bound by trapezoid and tail."""
    flow, w_max = tracking.flow, max(tracking.system.w_max, np.finfo(float).tiny)
    images = R @ tracking.transitions
    from scipy.linalg import expm

    left = np.linalg.norm(images @ flow.D, 2, axis=(-2, -1))
    right = np.linalg.norm(images @ np.asarray(expm(flow.A_x * flow.h)) @ flow.D, 2, axis=(-2, -1))
    curvature = np.linalg.norm(
        np.abs(images @ (flow.A_x @ flow.A_x)) @ flow.growth @ np.abs(flow.D), 2, axis=(-2, -1)
    )
    period = flow.h / 2 * (left + right) + flow.h**3 / 12 * curvature
    factor = flow.lyapunov[1]
    out = float(np.linalg.norm(R @ tracking.W_inverse, 2))
    tail = out * tracking.decay[-1] * tracking.period_gain / w_max / (1 - factor)
    within = np.linalg.norm(np.abs(R @ flow.A_x) @ flow.growth @ np.abs(flow.A_c @ tracking.W_inverse), 2)
    intersample = flow.h**2 / 8 * within * tracking.disturbance_radius / w_max
    return float(period.sum() + period[0] + tail + intersample)
