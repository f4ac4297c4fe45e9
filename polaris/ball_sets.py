"""Recoverable balls, constant and time-varying (section III-B, corrected)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from reach.zonotope import Zonotope

from .clearance import Clearance
from .error_bounds import ErrorBounds
from .recoverable import Margin, grow_bow
from .system import Array
from .tolerances import ROUNDING


@dataclass(frozen=True, eq=False)
class BallSets:
    """Balls ``norm(W e) <= r`` about the reference (eqs. 11 and 12; theory items 2, 5, 6, 7).

    `ball` has one radius, from the smallest room over all time; `time_varying_ball` weighs the
    room at every later time by what is left of the error by then; `paper_ball` is eq. 12 as
    printed, without the thrust limits: it is not sound and carries no guarantee.
    """

    clearance: Clearance
    bounds: ErrorBounds
    kind: str

    @property
    def guarantee(self) -> str:
        """``proved`` for the two sound kinds."""
        return "none" if self.kind == "paper_ball" else "proved"

    @cached_property
    def limits(self) -> tuple[Array, list[str]]:
        """Norm allowed with no time to decay, per period and limit, shape (cells * q, l); names."""
        c, b, w = self.clearance, self.bounds, self.clearance.tracking.system.w_max
        room = np.minimum(c.room[:, :-1], c.room[:, 1:]).reshape(c.cells * c.q, len(c.unsafe))
        allowed = [(room - b.gain_position * w) / b.gamma_position]
        names = [u.name for u in c.unsafe]
        if self.kind != "paper_ball":
            thrust = np.repeat(np.minimum(*c.thrust), c.q, axis=0)
            allowed.append((thrust - b.gain_input * w) / b.gamma_input)
            names += c.tracking.system.input_names
        return np.hstack(allowed) * (1 - ROUNDING), names

    @cached_property
    def _radii(self) -> tuple[Array, NDArray[np.int_], NDArray[np.int_]]:
        """Radius for every period, and which period and limit set it."""
        allowed, _ = self.limits
        count, least = len(allowed), allowed.min(axis=1)
        if self.kind == "time_varying_ball":
            # From anywhere in period i to anywhere in period j at least j - i - 1 periods pass.
            gone = np.maximum(np.arange(count) - 1, 0) * self.clearance.tracking.flow.h
            decayed = np.exp(np.minimum(self.bounds.beta * gone, np.log(1e12)))
            radii, when = np.empty(count), np.empty(count, int)
            for i in range(count):
                later = least[i:] * np.where(least[i:] > 0, decayed[: count - i], 1.0)
                j = int(np.argmin(later))
                radii[i], when[i] = later[j], i + j
        else:
            when = np.full(count, np.argmin(least))
            radii = least[when]
        return radii, when, allowed.argmin(axis=1)[when]

    def _margins(self, k: int, norms: Array) -> Margin:
        radii, when, which = self._radii
        first = k * self.clearance.q
        own = radii[np.minimum(first + np.arange(len(norms)), len(radii) - 1)]
        before = radii[np.maximum(first + np.arange(len(norms)) - 1, first)]
        room = np.minimum(own, before) if len(norms) > 1 else own
        value = np.where(room > 0, 1 - norms / np.where(room > 0, room, 1), -np.inf)
        i = int(np.argmin(value))
        at = min(first + i, len(radii) - 1)
        time = float(when[at] * self.clearance.tracking.flow.h)
        return Margin(float(value[i]), self.limits[1][which[at]], time, float(norms[i]), float(room[i]))

    def margin(self, k: int, nodes: Zonotope, bow: Array) -> Margin:
        """Margin of a flight over cell k."""
        extra = np.linalg.norm(grow_bow(bow) @ np.abs(self.bounds.W).T, axis=-1)
        return self._margins(k, (nodes.norm_bound(self.bounds.W) + extra) * (1 + ROUNDING))

    def margin_at(self, k: int, start: Zonotope) -> Margin:
        """Margin of one set at the start of cell k."""
        return self._margins(k, np.atleast_1d(start.norm_bound(self.bounds.W)) * (1 + ROUNDING))

    def contains(self, node: int, errors: Array) -> NDArray[np.bool_]:
        """Whether each error (runs, n) at a node is recoverable."""
        radius = self._radii[0][min(node, len(self._radii[0]) - 1)]
        return np.asarray(np.linalg.norm(errors @ self.bounds.W.T, axis=-1) <= radius)

    def radius(self, node: int) -> float:
        """Radius of the ball at a node, in the norm of the tracker (for comparison between kinds)."""
        W = self.clearance.tracking.W
        stretch = float(np.linalg.norm(self.bounds.W @ np.linalg.inv(W), 2))
        return max(float(self._radii[0][min(node, len(self._radii[0]) - 1)]), 0.0) / stretch
