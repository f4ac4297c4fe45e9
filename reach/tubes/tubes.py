"""Tubes of linear systems: bounds along chosen directions, or zonotopes, over all of a time interval."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..numerics.checks import Array, as_directions, as_frame, as_numbers, checked, per_row, require_single
from ..numerics.errors import ReachError
from ..sets.convex import ConvexSet
from ..sets.zonotope import Zonotope
from ..short_repr import short_repr
from .adjoint import augmented, is_symmetric
from .bounds import EffortBudget
from .ltv import LTVSystem
from .rows import ROUNDING
from .stepping import Steps, row_bounds, warn_if_wide
from .systems import LinearSystem


@short_repr
@dataclass(frozen=True, eq=False)
class SupportTube:
    """Bounds on ``d x(t)`` for rows d, at nodes and over every interval between them.

    Attributes
    ----------
    times : ndarray, shape (K+1,)
        Nodes, from 0 to the horizon; of an `LTVSystem` from its `begin` on.
    directions : ndarray, shape (r, n)
    upper : ndarray, shape (K+1, r)
        ``d x(t_k) <= upper[k]`` for every initial state and every input.
    attained : ndarray, shape (K+1, r)
        Some initial state and input reach at least this, so the exact support lies between the two.
    interval : ndarray, shape (K, r)
        ``d x(t) <= interval[k]`` for every t in ``[times[k], times[k+1]]``.
    intersample : ndarray, shape (K, r)
        Between two nodes the support exceeds the line that joins ``upper`` by no more than
        ``4 s (1 - s) intersample``, s in [0, 1] running from one node to the next.
    """

    times: Array
    directions: Array
    upper: Array
    attained: Array
    interval: Array
    intersample: Array

    def at(self, t: ArrayLike) -> Array:
        """Upper bounds at given times, shape (len(t), r).

        Raises
        ------
        ReachError
            If a time lies outside the tube's.
        """
        k, s = locate(self.times, t)
        s = s[:, None]
        return np.asarray(
            (1 - s) * self.upper[k] + s * self.upper[k + 1] + 4 * s * (1 - s) * self.intersample[k]
        )

    @property
    def most(self) -> Array:
        """Upper bound over the whole horizon, shape (r,)."""
        return np.asarray(np.maximum(self.interval.max(axis=0), self.upper[-1]))

    @property
    def reached(self) -> Array:
        """Largest value of a trajectory at a node, shape (r,): ``reached <= exact <= most``."""
        return np.asarray(self.attained.max(axis=0))


@checked
def support_tube(
    system: LinearSystem | LTVSystem,
    initial: ConvexSet,
    horizon: float,
    directions: ArrayLike,
    *,
    step: float | None = None,
    tolerance: float | ArrayLike | None = None,
    limit: ArrayLike | None = None,
    max_effort: float = np.inf,
) -> SupportTube:
    """Bound chosen directions over the reachable sets, continuously in time.

    Parameters
    ----------
    system : LinearSystem or LTVSystem
        Dense or sparse; continuous or discrete. One that varies in time needs a step, and effort that
        grows with the square of the number of steps.
    initial : ConvexSet
    horizon : float
        For a discrete system the number of steps.
    directions : array_like, shape (r, n)
    step : float, optional
        Length of every step (shortened so that it divides the horizon). Where much turns in one
        step, it is carried in up to 16 parts that are not shown.
    tolerance : float or array_like of shape (r,), optional
        Instead of a step: how far the bounds may lie above what is attained. Steps are then chosen
        by it, and differ (not of inputs that are known or change their set). Default: a hundredth of
        the largest value met.
    limit : array_like, shape (r,), optional
        With a tolerance: a bound between nodes that stays below this is tight enough.
    max_effort : float, optional
        Most numbers computed, steps times directions times states, before it gives up.

    Raises
    ------
    ReachError
        If a number is not finite, shapes do not fit, or the bounds on derivatives do not hold.
    Unresolved
        If the tolerance cannot be met, or not with the effort allowed, or a bound is beyond floating point.
    """
    steps = Steps(step, tolerance, limit, effort=EffortBudget(max_effort))
    return tube_of(system, initial, horizon, directions, steps)


def tube_of(
    system: LinearSystem | LTVSystem, initial: ConvexSet, horizon: float, directions: ArrayLike, steps: Steps
) -> SupportTube:
    """Compute a `support_tube` with effort that may be shared with others."""
    D = as_directions(directions, system.dim)
    run = row_bounds(system, initial, D, horizon, steps)
    above, below, between, coarse = run.above, run.below, run.between, run.coarse()
    if steps.step is not None and not system.discrete:
        warn_if_wide(between.max(axis=0), below.max(axis=0), np.abs(above).max(axis=0))
    upper, attained = above[:: run.parts], below[:: run.parts]
    return SupportTube(coarse.times, D, upper, attained, between, coarse.intersample + coarse.bend)


@short_repr
@dataclass(frozen=True, eq=False)
class ZonotopeTube:
    """Zonotopes that hold ``x(t)`` at nodes and over every interval between them.

    Attributes
    ----------
    times : ndarray, shape (K+1,)
        Nodes, from 0 to the horizon; of an `LTVSystem` from its `begin` on.
    nodes : Zonotope, batch (K+1,)
        ``x(t_k)`` lies in ``nodes[k]`` for every initial state and every input. The generators of
        the initial set come first, in its order; then one per axis of the frame, for the inputs.
    intersample : ndarray, shape (K, n)
        Between two nodes the state leaves the set that joins them by no more than
        ``4 s (1 - s) intersample`` along the axes of the frame, s in [0, 1] from one node to the next.
    frame : ndarray, shape (n, n)
        Columns: the axes.
    """

    times: Array
    nodes: Zonotope
    intersample: Array
    frame: Array

    @property
    def intervals(self) -> Zonotope:
        """``x(t)`` lies in ``intervals[k]`` for every t in ``[times[k], times[k+1]]``; batch (K,).

        One zonotope around two is larger than their hull, by as much as generators change within a
        step; `support` is tighter by an order of the step.
        """
        n = self.nodes.dim
        g = self.nodes.order_count - n
        before, after = self.nodes[:-1], self.nodes[1:]
        first = Zonotope(before.c, before.G[..., :g]).hull(Zonotope(after.c, after.G[..., :g]))
        widths = np.maximum(self._widths[:-1], self._widths[1:]) + self.intersample
        return first + Zonotope(np.zeros_like(before.c), self.frame * widths[:, None, :])

    def at(self, t: ArrayLike) -> Zonotope:
        """Zonotopes that hold the state at given times, batch (len(t),)."""
        k, s = locate(self.times, t)
        s = s[:, None]
        before, after = self.nodes[k], self.nodes[k + 1]
        c = (1 - s) * before.c + s * after.c
        G = (1 - s)[..., None] * before.G + s[..., None] * after.G
        extra = self.frame * (4 * s * (1 - s) * self.intersample[k])[:, None, :]
        n = self.nodes.dim
        return Zonotope(c, np.concatenate([G[..., :-n], G[..., -n:] + extra], axis=-1))

    def support(self, directions: ArrayLike) -> Array:
        """Bounds on ``d x(t)`` over every interval for rows d, shape (K, r) for rows (r, n)."""
        D = np.atleast_2d(as_numbers("directions", directions))
        nodes = self.nodes.support(D)
        return np.asarray(np.maximum(nodes[1:], nodes[:-1]) + self.intersample @ np.abs(D @ self.frame).T)

    @property
    def _widths(self) -> Array:
        """Half-widths along the frame of the part that belongs to the inputs, shape (K+1, n)."""
        generators = self.nodes.G[..., -self.nodes.dim :]
        return np.asarray(np.linalg.norm(generators, axis=-2) / np.linalg.norm(self.frame, axis=0))


@checked
def zonotope_tube(
    system: LinearSystem | LTVSystem,
    initial: ConvexSet,
    horizon: float,
    *,
    step: float | None = None,
    tolerance: ArrayLike | None = None,
    frame: ArrayLike | None = None,
) -> ZonotopeTube:
    """Enclose the reachable sets by zonotopes, continuously in time and without wrapping.

    The image of the initial set is exact at the nodes; the response to the inputs is enclosed by a
    parallelotope whose half-widths are its supports along the axes of the frame, each summed over
    the whole past (Le Guernic and Girard 2010), so no set is ever enclosed twice.

    Parameters
    ----------
    system : LinearSystem or LTVSystem
    initial : ConvexSet
        A zonotope; of any other set the interval hull is taken.
    horizon : float
        For a discrete system the number of steps.
    step : float, optional
    tolerance : float or array_like of shape (n,), optional
        As for `reach.support_tube`, along the axes of the frame.
    frame : array_like, shape (n, n), optional
        Columns: axes along which the response to the inputs is bounded tightly. Default: the
        coordinate axes.

    Raises
    ------
    ReachError
        If the frame is singular or shapes do not fit.
    Unresolved
        If the tolerance cannot be met or a bound is beyond floating point.
    """
    F, n = as_frame(frame, system.dim), system.dim
    require_single("the initial set", initial)
    start = initial if isinstance(initial, Zonotope) else initial.interval_hull()
    rows = inverse = np.asarray(np.linalg.inv(F))
    if tolerance is not None:
        tolerance = per_row("tolerance", tolerance, n)
    if isinstance(system, LTVSystem) or len(system.U) > 1 or not all(is_symmetric(U) for U in system.U):
        rows = np.vstack([inverse, -inverse])
        tolerance = None if tolerance is None else np.tile(tolerance, 2)
    run = row_bounds(system, start, rows, horizon, Steps(step, tolerance, keep=True)).coarse()
    assert run.rows is not None
    if step is not None and not system.discrete:
        nodes = run.above.max(axis=0)
        warn_if_wide(nodes + (run.intersample + run.bend).max(axis=0, initial=0.0), nodes, np.abs(nodes))
    start = start.to_zonotope()
    image = run.rows[:, :n] @ (start if isinstance(system, LTVSystem) else augmented(system, start)[1])
    # The second half of the rows is the first half with the sign turned, or left out if alike.
    high, low = (run.upper[:, rows] + run.rounding[:, rows] for rows in (slice(n), slice(-n, None)))
    intersample = np.maximum(run.intersample[:, :n], run.intersample[:, -n:]) + np.maximum(
        run.bend[:, :n], run.bend[:, -n:]
    )
    return along_frame(run.times, image, (low - run.driven[:, :n], high + run.driven[:, :n]), intersample, F)


def along_frame(
    times: Array, image: Zonotope, inputs: tuple[Array, Array], intersample: Array, F: Array
) -> ZonotopeTube:
    """A tube from the image of the initial set along the axes F, batch (K+1,), and bounds on the inputs."""
    low, high = inputs
    middle, widths = (high - low) / 2, (high + low) / 2
    size = np.abs(image.c + middle) + image.half_widths + widths
    # The inverse of F is one to rounding only.
    widths = widths + ROUNDING * len(F) * size @ (np.abs(np.linalg.inv(F)) @ np.abs(F)).T
    G = np.concatenate([F @ image.G, F * widths[:, None, :]], axis=-1)
    return ZonotopeTube(times, Zonotope((image.c + middle) @ F.T, G), intersample, F)


@checked
def locate(times: Array, t: ArrayLike) -> tuple[NDArray[np.intp], Array]:
    """Interval of every time and its place in it from 0 to 1; `ReachError` if one lies outside the nodes."""
    t = np.atleast_1d(as_numbers("t", t))
    if t.ndim != 1:
        raise ReachError(f"times must be a number or a vector of them, got shape {t.shape}")
    if not np.all((t >= times[0]) & (t <= times[-1])):
        raise ReachError(f"times must lie in [{times[0]:g}, {times[-1]:g}]")
    k = np.clip(np.searchsorted(times, t, side="right") - 1, 0, len(times) - 2)
    return k, (t - times[k]) / (times[k + 1] - times[k])
