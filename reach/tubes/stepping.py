"""Stepping over time: blocks of steps, of one length or as long as a tolerance allows."""

import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field
from fractions import Fraction
from math import lcm

import numpy as np
from numpy.typing import ArrayLike

from ..numerics.checks import Array, per_row, require_positive
from ..numerics.errors import ReachError, ReachWarning, Unresolved
from ..sets.convex import ConvexSet
from .adjoint import Adjoint, Block, Overflow, augmented
from .bounds import EffortBudget, RowBounds, collect
from .known_input import known_response
from .ltv import LTVSystem, Sweep
from .rows import ROUNDING
from .systems import LinearSystem

MAX_STEPS = 2_000_000
BLOCK = 64  # steps that are carried together when their length may change
ENTRIES = 50_000  # entries of all rows that are carried together when it does not
GRID = 10_000  # most steps that a first grid takes to have every change of the input on a node
SHARE = 0.01  # tolerance if none is given, as a share of the largest support
CELLS = 256  # least steps in which it is looked at how large a known motion becomes
AHEAD = 64  # instants, and halvings of the first of them, at which it is looked at what a row will come to
PARTS = 16  # parts that a step of the user may be carried in whatever that costs
CHEAP = 1_000_000  # entries of all rows of a run up to which a step is carried in as many parts as it needs
WIDE = 10.0  # bounds between nodes that exceed what is attained by this factor are warned of
USELESS = 1e9
"""Bounds between nodes may exceed the size of the bounded value by this; more is an error, not a bound."""
FINEST = 2.0**-40  # shortest step of the automatic choice, as a share of the horizon


@dataclass(frozen=True, eq=False)
class Steps:
    """Steps through a horizon, see `reach.support_tube`."""

    step: float | None = None
    tolerance: ArrayLike | None = None
    limit: ArrayLike | None = None
    keep: bool = False
    effort: EffortBudget = field(default_factory=EffortBudget)


def row_bounds(
    system: LinearSystem | LTVSystem, initial: ConvexSet, D: Array, horizon: float, steps: Steps
) -> RowBounds:
    """Carry rows D of a system over the horizon."""
    step, tolerance = steps.step, steps.tolerance
    require_positive("horizon", horizon)
    if step is not None and tolerance is not None:
        raise ReachError("give a step or a tolerance, not both")
    if step is not None:
        require_positive("step", step)
    if isinstance(system, LTVSystem):
        if step is None:
            raise ReachError("a system that varies in time needs a step")
        return Sweep(system, initial, horizon, step).run(D, steps.effort)
    extended, start = augmented(system, initial)
    D = np.hstack([D, np.zeros((len(D), extended.dim - system.dim))])
    adjoint = Adjoint(extended, start)
    if system.discrete:
        if horizon != round(horizon) or step not in (None, 1):
            detail = f"got horizon {horizon!r} and step {step!r}"
            raise ReachError(f"a discrete system takes a whole number of steps of 1, {detail}")
        step = 1.0
    if step is not None:
        return _regular(adjoint, D, horizon, step, substeps(adjoint, step, horizon, len(D)), steps)
    goal = None if tolerance is None else per_row("tolerance", tolerance, len(D))
    if goal is not None and not np.all((goal > 0) & np.isfinite(goal)):
        raise ReachError(f"the tolerance must be finite and > 0, got {tolerance!r}")
    ceiling = np.full(len(D), -np.inf) if steps.limit is None else per_row("limit", steps.limit, len(D))
    if adjoint.input_pieces > 1 or system.nominal is not None:
        return _halved(adjoint, D, horizon, goal, ceiling, steps)
    blocks = _adaptive(adjoint, D, horizon, goal, ceiling, steps.effort)
    return collect(adjoint, D, horizon, blocks, steps.keep)


def substeps(adjoint: Adjoint, step: float, horizon: float = 0.0, rows: int = 1) -> int:
    """Parts (a power of two, up to `PARTS`, more while the run stays `CHEAP`) in which little turns."""
    if adjoint.system.discrete or not step > 0:
        return 1
    limit = np.log2(PARTS)
    if horizon > 0:
        limit = max(limit, np.floor(np.log2(CHEAP / max(rows * adjoint.system.dim * horizon / step, 1.0))))
    return int(2 ** np.clip(np.ceil(np.log2(max(2 * step * adjoint.rows.norm, 1.0))), 0, limit))


def warn_if_wide(bounds: Array, attained: Array, sizes: Array) -> None:
    """Say so where bounds between nodes are far above attained values at nodes, each (r,)."""
    level = np.maximum(np.abs(attained), sizes)
    ratio = float(np.max(np.divide(bounds - attained, level, out=np.zeros_like(level), where=level > 0)))
    if ratio > WIDE:
        warnings.warn(
            f"bounds between nodes exceed what is attained by a factor of up to {ratio:.2g}: the step is "
            "long for a system this stiff; take a shorter one, or a tolerance instead",
            ReachWarning,
            stacklevel=4,
        )


def _regular(adjoint: Adjoint, D: Array, horizon: float, step: float, parts: int, steps: Steps) -> RowBounds:
    """Steps of one length, each carried in some parts."""
    if horizon / step > MAX_STEPS:
        raise Unresolved(f"more than {MAX_STEPS:,} steps: horizon {horizon:g}, step {step:g}")
    count = max(int(np.ceil(horizon / step * (1 - 1e-12))), 1) * parts
    size = int(np.clip(ENTRIES // D.size, BLOCK, count))
    h = horizon / count
    response, sizes = None, np.zeros(adjoint.system.dim)
    if adjoint.system.nominal is not None:
        # The sizes that it brings states to are looked at in many places, however few the nodes are.
        factor = 1 if adjoint.system.discrete else -(-CELLS // count)
        nodes, lengths = np.linspace(0, horizon, factor * count + 1), np.full(factor * count, h / factor)
        sizes = np.abs(known_response(adjoint.system, D[:1], nodes, lengths).states).max(axis=0)
        response = known_response(adjoint.system, D, nodes[::factor], np.full(count, h))
    adjoint.watch(adjoint.rows.lags(h, horizon), sizes)

    def blocks() -> Iterator[tuple[float, Block]]:
        rows = D * adjoint.rows.scale
        for k in range(0, count, size):
            steps.effort.spend(min(size, count - k) * rows.size)
            block = adjoint.block(rows, h, min(size, count - k))
            yield h, block
            rows = block.rows[-1]

    run = collect(adjoint, D, horizon, blocks(), steps.keep, parts, response)
    if not np.all((run.intersample + run.bend).max(axis=0) <= USELESS / ROUNDING * run.rounding.max(axis=0)):
        raise Unresolved(f"the step {step:g} is too long: its intersample bound is useless; shorten it")
    return run


def _halved(
    adjoint: Adjoint, D: Array, horizon: float, goal: Array | None, ceiling: Array, steps: Steps
) -> RowBounds:
    """Steps of one length, halved until nodes and intersample bounds each meet half of the tolerance."""
    system = adjoint.system
    changes = system.breaks if system.nominal is None else np.r_[system.breaks, system.nominal.jumps]
    fractions = [Fraction(t / horizon).limit_denominator(GRID) for t in changes if 0 < t < horizon]
    grid = lcm(*(share.denominator for share in fractions))
    count = grid if grid <= GRID else AHEAD
    count *= 2 ** int(np.ceil(np.log2(max(horizon * adjoint.rows.norm / count, 1.0))))
    while True:
        run = _regular(adjoint, D, horizon, horizon / count, 1, steps)
        above = run.above
        allowed = (SHARE * np.abs(above).max(axis=0) if goal is None else goal) / 2
        slack = np.maximum(allowed, ceiling - np.maximum(above[1:], above[:-1]))
        if np.all(above - run.below <= allowed) and np.all(run.intersample + run.bend <= slack):
            return run
        if grid <= GRID and np.any(2 * run.rounding > allowed):
            raise Unresolved(f"the tolerance {2 * allowed} is below the rounding of the bounds")
        count *= 2


def _adaptive(
    adjoint: Adjoint, D: Array, horizon: float, goal: Array | None, ceiling: Array, effort: EffortBudget
) -> Iterator[tuple[float, Block]]:
    """Blocks whose steps are a half, a quarter, ... of the horizon, as short as the tolerance asks.

    Half of it is for the integral of the inputs, in proportion to time but never less than a twentieth of
    what is left on one block; half for the intersample bound. Without a goal it is `SHARE` of the largest
    value met so far.
    """
    rows = D * adjoint.rows.scale
    level = int(np.clip(np.ceil(np.log2(max(horizon * adjoint.rows.norm, 1.0))), 0, 40))
    adjoint.watch(adjoint.rows.lags(horizon * 2.0**-level, horizon))
    progress, patience, steps = 0.0, 0, 0
    reached, losses, sums, largest = np.zeros((4, len(D)))
    foreseen = _foreseen(adjoint, rows, horizon) if goal is None else largest
    while progress < 1:
        h = 2.0**-level
        # A block ends at a multiple of its full length, so that longer steps may follow.
        count = BLOCK - int(progress / h) % BLOCK if h * BLOCK < 1 else int((1 - progress) / h)
        if steps + count > MAX_STEPS:
            raise Unresolved(f"the tolerance needs more than {MAX_STEPS:,} steps")
        effort.spend(count * rows.size)
        try:
            block = adjoint.block(rows, h * horizon, count)
        except Overflow:
            if h <= FINEST:
                raise
            level += 3
            continue
        if goal is None:
            start, increment = adjoint.sizes(block.rows, h * horizon)
            largest = np.maximum(foreseen, start + sums + increment)
        tolerance = _allowed(adjoint, block, horizon, goal, largest)
        gain = block.upper.sum(axis=1)
        with np.errstate(invalid="ignore"):
            loss = (block.upper - block.lower).sum(axis=(0, 1))
            bend = block.intersample + block.bend.sum(axis=1)
            node = block.first + reached + np.vstack([np.zeros(len(D)), np.cumsum(gain, axis=0)])
            slack = np.maximum(tolerance / 2, ceiling - np.maximum(node[1:], node[:-1]))
            share = (tolerance / 2 - losses) * np.maximum(count * h / (1 - progress), 0.05)
            error = max(_largest_ratio(bend, slack), _largest_ratio(loss, share))
        if error > 1 and h > FINEST:
            level += 1 + (error > 16) + (error > 256)
            patience = 4  # blocks before a longer step is tried again
            continue
        if error > 1:
            raise Unresolved(f"no step is short enough for the tolerance {tolerance}")
        yield h * horizon, block
        if goal is None:
            foreseen, sums = largest, sums + increment
        progress, reached, losses = progress + count * h, reached + gain.sum(axis=0), losses + loss
        rows, patience, steps = block.rows[-1], patience - 1, steps + count
        easy = error < 0.01 or (error < 0.1 and patience <= 0)
        if easy and level > 0 and (progress * 2.0 ** (level - 1)).is_integer():
            level -= 1


def _allowed(adjoint: Adjoint, block: Block, horizon: float, goal: Array | None, largest: Array) -> Array:
    """The goal, or else a share of the largest values met, but no finer than the rounding allowance."""
    share = ROUNDING * adjoint.system.dim
    if goal is None:
        floor = share * (block.size[0] + horizon * block.size[1]).max(axis=0)
        return np.asarray(np.maximum(SHARE * largest, floor))
    if np.any(goal < share * block.size[0, 0]):
        raise Unresolved(f"the tolerance {goal} is below the rounding of the bounds")
    return goal


def _foreseen(adjoint: Adjoint, rows: Array, horizon: float) -> Array:
    """Rough later values of rows, (r,), from rates at a few instants: for the default tolerance alone."""
    early = [horizon / AHEAD * 2.0**-i for i in range(AHEAD // 2, 0, -1)]
    try:
        with np.errstate(over="ignore", invalid="ignore"):
            probes = [adjoint.rows.carry(rows, t, 1)[1] for t in early] if adjoint.rows.action is None else []
            path = np.array([rows, *probes, *adjoint.rows.carry(rows, horizon / AHEAD, AHEAD)[1:]])
            times = np.r_[0.0, early if probes else [], horizon / AHEAD * np.arange(1, AHEAD + 1)]
            start, rate = adjoint.values(path)
            value = start.max(axis=0) + np.diff(times) @ np.minimum(rate[1:], rate[:-1])
    except Unresolved:
        return np.zeros(len(rows))
    return np.where(np.isfinite(value), value, 0.0)


def _largest_ratio(values: Array, allowed: Array) -> float:
    """Largest ratio, none where the value is zero."""
    ratio = np.divide(values, allowed, out=np.full_like(values, np.inf), where=np.not_equal(allowed, 0))
    return float(np.nan_to_num(np.max(np.where(values == 0, 0.0, ratio)), nan=np.inf, posinf=np.inf))
