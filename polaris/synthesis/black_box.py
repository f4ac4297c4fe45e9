"""A controller of which nothing is known but what it answers: its reachable sets come from samples.

In every step that the box flies, each node's error is fitted as an affine function of the error at the start
of the step, with a box for what is left over. Whether flights keep to that is what sampled flights are asked
(`polaris.simulation.sampled`); all else, between the nodes and after them, is proven (docs/theory.md).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from reach.numerics.linear import discretize
from reach.sets.zonotope import Zonotope
from reach.tubes.flow import LinearFlow

from ..model.errors import ScenarioError
from ..model.system import Array, LinearSystem
from ..model.tolerances import ROUNDING
from ..planning.reference import Reference
from .controllers import ORDER, TubeSegment
from .neural import check_exact
from .tracking import Tracking

Ask = Callable[[float, Array, Array], Any]
"""Commands (R, m) at a time [s] for states (R, n), beside the state (n,) of the safe reference."""

SAMPLES = 400
"""Starts that shape the sets of a step; that these hold is asked of other flights."""

WIDER = 1.1
"""By how much the boxes are wider than what the samples leave over."""


@dataclass(frozen=True, eq=False)
class FittedSegment(TubeSegment):
    """A tube fitted to samples.

    Attributes
    ----------
    fit : ndarray, shape (q, n, n + 2)
        Errors at the nodes after the first are within ``fit[i, :, n + 1]`` of
        ``fit[i, :, :n] e + fit[i, :, n]``, e that at the start.
    """

    fit: Array | None = None

    def outside(self, errors: Array) -> Array:
        """How far errors at the nodes (R, q+1, n) are from the fit, in units of its boxes, shape (R,)."""
        assert self.fit is not None
        n = errors.shape[-1]
        told = np.einsum("iab,rb->ria", self.fit[..., :n], errors[:, 0]) + self.fit[..., n]
        return np.asarray((np.abs(errors[:, 1:] - told) / self.fit[..., n + 1]).max(axis=(1, 2)))


@dataclass(frozen=True, eq=False)
class BlackBox:
    """``u = clip(ask(t, x, xi))``, asked at the start of every control period, its answer held.

    Parameters
    ----------
    name : str
        Name in tables and figures.
    system : LinearSystem
        What it controls.
    reference : Reference
        The safe reference.
    tracking : Tracking
        The safety tracker, whose feedback must be sampled.
    ask : callable
        See `Ask`; what it answers depends on what it is asked alone (it has no memory from one period to the
        next, nor from one flight to another).
    wider : float
        Scale of the boxes, see `WIDER`.
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
            rule = "must be sampled where a black box flies: it is asked once a control period"
            raise ScenarioError("feedback.kind", "continuous", rule)
        check_exact(self.system)

    def along(self, reference: Reference, tracking: Tracking) -> BlackBox:
        """The same beside another safe reference."""
        return replace(self, reference=reference, tracking=tracking)

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
        """What samples say of the reachable set over step k; between the nodes it is proven."""
        system, n, xi = self.system, self.system.n, self.reference.fine(self._q)[k]
        errors = self._sampled(start, k) - xi
        known = errors[:, 0] - start.c
        scale = np.maximum(np.abs(known).max(axis=0), 1e-300)
        base = np.hstack([known / scale, np.ones((len(known), 1))])
        fit = np.empty((self._q, n, n + 2))
        for i, node in enumerate(errors.swapaxes(0, 1)[1:]):
            solved = np.linalg.lstsq(base, node, rcond=1e-10)[0]
            fit[i, :, :n] = (solved[:n] / scale[:, None]).T
            fit[i, :, n] = solved[n] - fit[i, :, :n] @ start.c
            left = np.abs(node - base @ solved).max(axis=0)
            fit[i, :, n + 1] = self.wider * left + ROUNDING * (np.abs(xi[i + 1]).max() + np.abs(node).max())
        nodes = [start]
        for M, c, r in zip(fit[..., :n], fit[..., n], fit[..., n + 1], strict=True):
            nodes.append((M @ start + c).inflate(r))
        stack = Zonotope.stack(nodes)
        # x'' = e^{A s} A (A e + B (u - nu)); the disturbance counts at both ends and between them.
        spread = system.u_max + np.abs(self.reference.nu[k])
        turned = (system.A @ system.A) @ stack[:-1]
        bend = np.abs(turned.c) + turned.half_widths + np.abs(system.A @ system.B) @ spread
        bow = self.flow.h**2 / 8 * bend @ self.flow.growth.T + 2 * self.flow.period_box
        end = nodes[-1].inflate(self.reference.rounding[k]).reduce(ORDER)
        return FittedSegment(stack, bow + self.reference.rounding[k], end, fit=fit)

    @property
    def _q(self) -> int:
        return self.tracking.feedback.nodes_per_cell

    def _sampled(self, start: Zonotope, k: int) -> Array:
        """States at the nodes of step k from all over a set, its corners too, shape (R, q+1, n)."""
        system, rng = self.system, np.random.default_rng([self.seed, k])
        b = rng.uniform(-1, 1, (SAMPLES, start.order_count))
        b[::2] = np.sign(b[::2])
        tips = start.support_vector(np.vstack([np.eye(system.n), -np.eye(system.n)]))
        xi = self.reference.fine(self._q)[k]
        path = [xi[0] + np.vstack([start.c + b @ start.G.T, tips])]
        Ad, Bd = discretize(system.A, system.B, self.flow.h)
        Dd = discretize(system.A, system.D, self.flow.h)[1]
        w = rng.normal(size=(self._q, len(path[0]), system.p))
        w[:, ::3] = w[:1, ::3]  # the same way all along
        w *= system.w_max / np.maximum(np.linalg.norm(w, axis=2, keepdims=True), 1e-300)
        for i in range(self._q):
            raw = self.command(k, xi[i], xi[i], path[-1], i * self.flow.h)
            u = np.clip(raw, -system.u_max, system.u_max)
            path.append(path[-1] @ Ad.T + u @ Bd.T + w[i] @ Dd.T)
        return np.stack(path, axis=1)
