"""A controller of which nothing is known but what it answers: its reachable sets come from samples.

For every period of a step that the box flies, what it commands is fitted as an affine function of the error
with a band about it. Whether commands keep to their bands is what sampled flights are asked
(`polaris.simulation.sampled`); all else is proven of every admissible disturbance (docs/theory.md).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from reach.networks.loop import held_step
from reach.numerics.linear import discretize
from reach.sets.zonotope import Zonotope
from reach.tubes.flow import LinearFlow

from ..model.errors import ScenarioError
from ..model.system import Array, LinearSystem
from ..model.tolerances import ROUNDING
from ..planning.reference import Reference
from .controllers import AnyThrust, TubeSegment
from .neural import NEEDS_SAMPLES, check_exact, no_tube, reduced
from .tracking import Tracking

Ask = Callable[[float, Array, Array], Any]
"""Commands (R, m) at a time [s] for states (R, n), beside the state (n,) of the safe reference."""

SAMPLES = 400
"""Starts that shape the sets of a step; that these hold is asked of other flights."""

WIDER = 2.0
"""By how much the bands are wider than what the samples leave over."""

NARROW = 1e-7
"""Share of its size from which on a state varies enough for a command to be fitted to it."""
FARTHEST = 1e60
"""States beyond which nothing is computed."""


@dataclass(frozen=True, eq=False)
class FittedSegment(TubeSegment):
    """A tube of commands that were fitted to samples.

    Attributes
    ----------
    fit : ndarray, shape (q, m, n + 2)
        What is applied from node i on is within ``fit[i, :, n + 1]`` of ``fit[i, :, :n] e + fit[i, :, n]``, e
        the error there.
    """

    fit: Array | None = None

    def outside(self, errors: Array, inputs: Array) -> Array:
        """How far inputs (R, q, m) at errors (R, q, n) are off, in units of their bands, shape (R,)."""
        assert self.fit is not None
        n = errors.shape[-1]
        told = np.einsum("iab,rib->ria", self.fit[..., :n], errors) + self.fit[..., n]
        return np.asarray((np.abs(inputs - told) / self.fit[..., n + 1]).max(axis=(1, 2)))


@dataclass(frozen=True, eq=False)
class BlackBox:
    """``u = clip(ask(t, x, xi))``, asked at the start of every control period, its answer held.

    Parameters
    ----------
    name, system, reference, tracking
        As those of a `NeuralController`.
    ask : callable
        See `Ask`; what it answers depends on what it is asked alone (it has no memory from one period to the
        next, nor from one flight to another).
    wider : float
        Scale of the bands, see `WIDER`.
    seed : int
        Of the samples.

    Raises
    ------
    ScenarioError
        If feedback is not sampled, or estimates or thrusters have errors; on flying, if an answer is none.
    """

    name: str
    system: LinearSystem
    reference: Reference
    tracking: Tracking
    ask: Ask
    wider: float = WIDER
    seed: int = 0

    def __post_init__(self) -> None:
        if not self.tracking.feedback.sampled:
            raise ScenarioError("feedback.kind", "continuous", NEEDS_SAMPLES)
        check_exact(self.system)

    @property
    def anything(self) -> AnyThrust:
        """What is left of it where nobody asks: its thrust limits."""
        return AnyThrust(self.name, self.system, self.reference, self.tracking)

    def command(self, k: int, xi: Array, own: Array, x: Array, later: float = 0.0) -> Array:
        """Thrust command before clipping, shape (..., m), some seconds after the start of step k."""
        flat = x.reshape(-1, self.system.n)
        answer = self.ask(k * self.reference.delta + later, flat.copy(), xi.copy())
        shape = (len(flat), self.system.m)
        try:
            found = np.array(answer, dtype=float)
        except (TypeError, ValueError):
            found = np.zeros(0)
        if found.shape != shape or not np.all(np.isfinite(found)):
            rule = f"must answer finite numbers, one row of {shape[1]} for each of {shape[0]} states"
            raise ScenarioError(f"black box {self.name}", str(answer)[:60], rule)
        return found.reshape(*x.shape[:-1], self.system.m)

    @cached_property
    def flow(self) -> LinearFlow:
        """Open-loop motion of the error."""
        system = self.system
        return LinearFlow.continuous(system.A, system.D, system.w_max, self.tracking.flow.h)

    def fly(self, start: Zonotope, k: int) -> FittedSegment:
        """The reachable set over step k of all that commands within the bands, under any disturbance."""
        system, fit = self.system, self._fitted(start, k)
        n, rounding = system.n, self.reference.rounding[k]
        nodes, bows = [start], []
        for row in fit:
            e, K, c, r = nodes[-1], row[:, :n], row[:, n], row[:, n + 1]
            G = np.hstack([K @ e.G, np.diag(r)])
            after, bow = held_step(self.flow, system.B, e, Zonotope(K @ e.c + c - self.reference.nu[k], G))
            nodes.append(reduced(after))
            bows.append(bow + rounding)
            if not np.all(nodes[-1].extent < FARTHEST):
                return FittedSegment(*no_tube(start, self._q), "its sets grow beyond all bounds")
        end = reduced(nodes[-1].inflate(rounding))
        return FittedSegment(Zonotope.stack(nodes), np.array(bows), end, fit=fit)

    @property
    def _q(self) -> int:
        return self.tracking.feedback.nodes_per_cell

    def _fitted(self, start: Zonotope, k: int) -> Array:
        """Affine functions and bands about what is commanded from all over a set, its corners too."""
        system, rng, n = self.system, np.random.default_rng([self.seed, k]), self.system.n
        b = rng.uniform(-1, 1, (SAMPLES, start.order_count))
        b[::2] = np.sign(b[::2])
        tips = start.support_vector(np.vstack([np.eye(n), -np.eye(n)]))
        e = np.vstack([start.c + b @ start.G.T, tips])
        Ad, Bd = discretize(system.A, system.B, self.flow.h)
        Dd = discretize(system.A, system.D, self.flow.h)[1]
        w = rng.normal(size=(self._q, len(e), system.p))
        w[:, ::3] = w[:1, ::3]  # the same way all along
        w *= system.w_max / np.maximum(np.linalg.norm(w, axis=2, keepdims=True), 1e-300)
        fit = np.empty((self._q, system.m, n + 2))
        for i, xi in enumerate(self.reference.fine(self._q)[k, :-1]):
            u = np.clip(self.command(k, xi, xi, e + xi, i * self.flow.h), -system.u_max, system.u_max)
            middle = e.mean(axis=0)
            spread = np.abs(e - middle).max(axis=0)
            seen = spread > NARROW * (np.abs(xi) + np.abs(e).max(axis=0))
            scale = np.where(seen, spread, np.inf)
            base = np.hstack([(e - middle) / scale, np.ones((len(e), 1))])
            solved = np.linalg.lstsq(base, u, rcond=1e-9)[0]
            K = (solved[:n] / scale[:, None]).T
            left = np.abs(u - base @ solved).max(axis=0)
            book = ROUNDING * (system.u_max + np.abs(K) @ (np.abs(xi) + np.abs(e).max(axis=0)))
            fit[i] = np.column_stack([K, solved[n] - K @ middle, self.wider * left + book])
            e = e @ Ad.T + (u - self.reference.nu[k]) @ Bd.T + w[i] @ Dd.T
        return fit
