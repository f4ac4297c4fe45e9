"""Recoverable balls, time-varying (section III-B, corrected)."""

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from reach.sets.zonotope import Zonotope

from ...model.errors import ScenarioError
from ...model.system import Array
from ...model.tolerances import ROUNDING
from ..tracker.error_bounds import ErrorBounds
from .recoverable import Margin, RecoverableSet, slack_share


@dataclass(frozen=True, eq=False)
class BallSets(RecoverableSet):
    """Balls ``norm(W e) <= r`` about the reference (eqs. 11 and 12 as docs/theory.md, Lemma 2, has them).

    The radius weighs the clearance at every later time by the share of the error left by then. The least
    radius is that of the constant ball, from the smallest clearance over all time.
    """

    bounds: ErrorBounds
    kind: ClassVar[str] = "ball"

    @cached_property
    def _tightenings(self) -> tuple[Array, Array]:
        """Tightening of rows per unit of the norm, and besides: disturbance, faults, round-off; (r,) each."""
        bounds, tracking, limits = self.bounds, self.clearance.tracking, self.clearance.limits
        if states := [body.name for body in self.clearance.unsafe if body.of_state]:
            rule = f"must be 'polytope', as {states[0]} limits velocities, which balls do not bound"
            raise ScenarioError("recoverable.kind", "ball", rule)
        rows, o = limits.rows[:, : tracking.system.n], limits.facets
        gamma, gain = np.full(len(rows), bounds.gamma_position), np.full(len(rows), bounds.gain_position)
        gamma[o:], gain[o:] = np.tile(bounds.gamma_input, 2), np.tile(bounds.gain_input, 2)
        constant = self.clearance.round_off(rows) + tracking.transient_tightening(rows)[-1]
        return gamma, gain * tracking.system.unbiased.w_max + constant

    @cached_property
    def _clearance(self) -> Array:
        """Clearance of every row in every period, shape (nodes, r)."""
        return np.asarray(self.clearance.limits.available.min(axis=0))

    @cached_property
    def allowed(self) -> Array:
        """Norm allowed with no time to decay, per period and row, shape (nodes, r)."""
        gamma, constant = self._tightenings
        return np.asarray((self._clearance - constant) / gamma * (1 - ROUNDING))

    def _decayed(self, count: int) -> Array:
        """Least factor by which an error shrinks from anywhere in one period to anywhere in a later one.

        In the first `count` of them: from period i to period j at least j - i - 1 periods pass.
        """
        elapsed = np.maximum(np.arange(count) - 1, 0) * self.clearance.tracking.flow.h
        return np.exp(np.minimum(self.bounds.beta * elapsed, np.log(1e12)))

    @cached_property
    def _radii(self) -> Array:
        """Radius for every period."""
        allowed = self.allowed.min(axis=1)
        count = len(allowed)
        decayed = self._decayed(count)
        later = (allowed[i:] * np.where(allowed[i:] > 0, decayed[: count - i], 1.0) for i in range(count))
        return np.array([each.min() for each in later])

    def tightest(self, first: int, sets: Zonotope, intersample: Array) -> Margin:
        """Margin of errors at nodes that follow one another from `first` on (`RecoverableSet.tightest`)."""
        W, last = self.bounds.W, len(self.allowed) - 1
        norms = (
            self.clearance.tracking.error(sets).norm_bound(W)
            + np.linalg.norm(intersample @ np.abs(W).T, axis=-1)
        ) * (1 + ROUNDING)
        # A node belongs to the period before it too, as far as that lies in the cell.
        periods = np.minimum(np.maximum(first + np.arange(len(norms)) - (len(norms) > 1), first), last)
        margins = [self._tightest(int(i), float(norm)) for i, norm in zip(periods, norms, strict=True)]
        return min(margins, key=lambda margin: margin.value)

    def _tightest(self, period: int, norm: float) -> Margin:
        """Tightest limit for errors up to a norm within a period."""
        gamma, constant = self._tightenings
        by_time = self.clearance.limits.tightening[0, period:]
        clearance = self._clearance[period:] + by_time
        size = norm / self._decayed(len(clearance))
        tightening = (gamma * size[:, None] + constant) * (1 + 2 * ROUNDING) + by_time
        share = np.where(np.isinf(clearance), np.inf, slack_share(tightening, clearance))
        j, row = (int(x) for x in np.unravel_index(int(np.argmin(share)), share.shape))
        time = float((period + j) * self.clearance.tracking.flow.h)
        name = self.clearance.limits.name((period + j) // self.clearance.q, row)
        return Margin(float(share[j, row]), name, time, float(tightening[j, row]), float(clearance[j, row]))

    def contains(self, node: int, errors: Array) -> NDArray[np.bool_]:
        """Return True for each error (runs, n) at a node that is recoverable."""
        radius = self._radii[min(node, len(self._radii) - 1)]
        return np.asarray(np.linalg.norm(errors @ self.bounds.W.T, axis=-1) <= radius)

    def radius(self, node: int) -> float:
        """Radius of the ball at a node, in the norm of the tracker (for comparison between kinds)."""
        W = self.clearance.tracking.W
        stretch = float(np.linalg.norm(self.bounds.W @ np.linalg.inv(W), 2))
        return max(float(self._radii[min(node, len(self._radii) - 1)]), 0.0) / stretch
