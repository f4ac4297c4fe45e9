"""Tables of the online monitor: recoverable sets as rows that all decisions share, and clearance per step."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from reach.numerics.linear import discretize

from ..certificate.code.text import FREE, Tables
from ..certificate.files.document import Document
from ..model.errors import NotCertified, ScenarioError
from ..model.system import Array
from ..rta.decision_grid import DecisionGrid
from ..rta.methods.monitor import Monitor
from ..rta.permission import Permission
from ..synthesis.schedule.schedule import Schedule
from .rounding import UNIT, gap_error

SHRINKS = 12  # halvings of the errors for which U may fly, until limits beyond the settling horizon are met
SAME = 1e-15  # largest difference of rows that count as one
MORE = 1.1  # of what is needed far ahead, where no decision looks: the checker may need more than synthesis
NEAR = 1e-9  # of clearances, by which they are stored too low: rounding of the synthesis


def with_monitor(tables: Tables, document: Document, schedule: Schedule, precision: str) -> Tables:
    """Return the tables of a precision with those of the online monitor.

    Raises
    ------
    ScenarioError
        If the scene has what the monitor on board does not model, or its initial set is not recoverable.
    """
    grid = DecisionGrid.from_schedule(schedule)
    late = (
        document.pulse_thrust,
        document.late,
        document.carried_impulse,
        document.transients,
        np.any(document.state_offset),
    )
    if document.observer or (document.error_by_step and document.timing.get("delay")) or any(late):
        rule = "must be off with an observer, late phases, pulses, carried impulses, jitter and late faults"
        raise ScenarioError("monitor", True, rule)
    if grid.system.error_by_step is not None:  # the largest of all, at all times
        tracking = replace(grid.tracking, system=replace(grid.system, error_by_step=None))
        grid = replace(grid, tracking=tracking, clearance=replace(grid.clearance, tracking=tracking))
    try:
        prospect = Monitor(grid).prospects[0, 0]
    except NotCertified as error:
        raise ScenarioError("monitor", True, f"must be off: {error}") from error
    gain, limit = np.array(document.laws[0].gain), np.array(document.u_max)
    with np.errstate(divide="ignore"):
        box = np.minimum((2 * limit[:, None] / np.abs(gain)).min(axis=0), 1e6)
    noise = gap_error(document, tables, precision)
    for _ in range(SHRINKS):
        count = _lags(prospect, box + noise)
        if count:
            break
        box = box / 2
    else:
        raise ScenarioError("monitor", True, "must be off: later limits have no slack")
    return _laid_out(tables, document, prospect, precision, box, noise, count)


def _size(prospect: Permission, box: Array) -> float:
    """Bound on ``norm(W e)`` at every stage of a decision on errors in a box."""
    stages = (slice(first, last) for first, last in prospect._norms)
    ends = (
        np.abs(prospect.stack[:, one]).T @ box + np.abs(prospect.base[:, one]).max(axis=0) for one in stages
    )
    return float(max(np.linalg.norm(each) for each in ends)) + prospect.radius


def _tightenings(prospect: Permission, box: Array) -> Array:
    """Return the tightening of every row so many nodes after the decision, shape (lags, r)."""
    recovery, n = prospect.recovery, prospect.grid.system.n
    size, facets = _size(prospect, box), len(recovery.intersample)
    tall = prospect.demand.tall
    later = (tall[:, n] * size + tall[:, n + 1]).reshape(-1, len(recovery.rows))
    first = np.full(len(recovery.rows), -FREE)  # S commands nothing before the next node
    estimate_error = np.abs(recovery.rows[:facets, :n]) @ prospect.grid.half_widths
    first[:facets] = recovery.intersample + recovery._curvature * (size + recovery._radius) + estimate_error
    return np.vstack([first, later])


def _lags(prospect: Permission, box: Array) -> int:
    """Number of nodes after which errors in a box meet all limits whatever they are; 0 if none is enough."""
    recovery, grid, n = prospect.recovery, prospect.grid, prospect.grid.system.n
    end = np.abs(prospect.end.M) @ box + np.abs(prospect.end.offset).max(axis=0)
    carried = prospect.demand.tall[:, :n].reshape(recovery.lags, -1, n)
    tightening = np.abs(carried) @ end + _tightenings(prospect, box)[1:]
    limits = np.minimum.accumulate(recovery.limits[::-1], axis=0)[::-1]
    step_start = np.arange(recovery.lags) // grid.clearance.q * grid.clearance.q  # all of a step at once
    satisfied = (tightening * MORE <= limits[step_start]).all(axis=1)
    beyond = min(recovery.far(node) for node in range(1, grid.last + 1))
    last = int(np.flatnonzero(~satisfied).max(initial=0)) + 1
    return 0 if last >= recovery.lags or _size(prospect, box) > beyond else last + 1


def _laid_out(
    tables: Tables,
    document: Document,
    prospect: Permission,
    precision: str,
    box: Array,
    noise: Array,
    lags: int,
) -> Tables:
    """Return the tables for errors up to `box`, rounded by up to `noise`, and so many nodes a decision."""
    grid, recovery, u = prospect.grid, prospect.recovery, float(UNIT[precision])
    n, q, facets = grid.system.n, grid.clearance.q, len(recovery.intersample)
    gain = np.array(document.laws[0].gain)
    Phi, force = discretize(np.array(document.A), np.array(document.B), grid.h)
    rows, kind, sign = _kinds(-recovery.rows[:, :n], facets)
    kinds = int(max(kind[:facets], default=-1)) + 1
    draft = replace(
        tables,
        rows=rows.tolist(),
        facets=kinds,
        held=Phi.tolist(),
        force=force.tolist(),
        loop=(Phi - force @ gain).tolist(),
        apart=box.tolist(),
    ).rounded(precision)
    smallest, largest = (_tightenings(prospect, share * box + noise)[:lags] for share in (0, 1))
    loss = _rounding(draft, (Phi, force, Phi - force @ gain, rows), np.array(document.inputs), noise, lags, u)
    base, full = np.full((2, lags, len(rows)), -FREE)
    for lag in range(lags):
        np.maximum.at(base[lag], kind, smallest[lag])
        np.maximum.at(full[lag], kind, largest[lag])
    sized = np.maximum(full - base, 0.0)
    base = np.where(base > -FREE, base + loss + 16 * u * (np.abs(base) + sized), -FREE)
    cells = (grid.last + lags - 2) // q + 1
    clearance = _clearances(grid, kind, sign, cells, u, document.horizon == "infinite")
    return replace(draft, booked=base.tolist(), sized=sized.tolist(), clearance=clearance.tolist()).rounded(
        precision
    )


def _kinds(rows: Array, facets: int) -> tuple[Array, NDArray[np.intp], Array]:
    """Rows of each kind, equal or opposite ones being of a kind, facets apart; kind and sign of every row."""
    distinct, kinds, signs, first = list[Array](), [], [], 0
    for i, row in enumerate(rows):
        first = len(distinct) if i == facets else first
        others = ((j, s) for j in range(first, len(distinct)) for s in (1, -1))
        matches = [(j, s) for j, s in others if np.abs(distinct[j] - s * row).max() <= SAME]
        j, s = matches[0] if matches else (len(distinct), 1)
        distinct += [] if matches else [row]
        kinds.append(j)
        signs.append(s)
    return np.array(distinct) + 0.0, np.array(kinds), np.array(signs)


def _rounding(
    tables: Tables, exact: tuple[Array, Array, Array, Array], feeds: Array, noise: Array, count: int, u: float
) -> Array:
    """Bound on the rounding error of a value along a row, and of its sum with a tightening, (count, r)."""
    (Phi, force, loop, rows), (n, m) = exact, np.array(tables.force).shape
    box, feed = np.array(tables.apart), np.abs(feeds).max(axis=0)
    stored = (np.array(one) for one in (tables.held, tables.force, tables.loop, tables.rows))
    slack = 64 * 2.0**-53
    diffs = [
        np.abs(one - other) + slack * np.maximum(1, np.abs(other).max(axis=1, keepdims=True))
        for one, other in zip(stored, exact, strict=True)
    ]
    sums = u * (n + m + 4)
    first = np.abs(Phi) @ box + np.abs(force) @ feed
    initial = np.abs(Phi) @ noise + sums * first + diffs[0] @ box + diffs[1] @ feed + np.abs(force) @ feed * u
    powers, (start, added) = [np.eye(n)], (first + initial, list[Array]())
    sizes, totals = [box], [np.abs(rows) @ noise]
    for _ in range(1, count):
        spread = np.abs(np.array(powers))  # of later periods, the newest last
        sizes.append(spread[-1] @ start + sum(map(np.matmul, spread[-2::-1], added)))
        weights = np.abs(rows @ np.array(powers))
        totals.append(weights[-1] @ initial + sum(map(np.matmul, weights[-2::-1], added)))
        added.append((sums * np.abs(loop) + diffs[2]) @ sizes[-1])
        powers.append(powers[-1] @ loop)
    value = np.array(sizes) @ np.abs(rows).T
    return np.asarray(1.05 * (np.array(totals) + np.array(sizes) @ diffs[3].T + sums * value) + 8 * u * value)


def _clearances(
    grid: DecisionGrid, kind: NDArray[np.intp], sign: Array, cells: int, u: float, repeats: bool
) -> Array:
    """Clearance along and against each row at the start of cells, its change by period, (cells, r, 4)."""
    (begin, end), q = grid.clearance.limits.available, grid.clearance.q
    planned, cell_count = grid.clearance.planned, grid.clearance.cells
    clearance = np.full((cells, kind.max() + 1, 4), 0.0)
    clearance[..., ::2] = FREE
    for cell in range(cells):
        if cell >= cell_count and not (repeats and cell_count > planned):
            break
        source = cell if cell < cell_count else planned + (cell - planned) % (cell_count - planned)
        span = slice(source * q, source * q + q)
        nodes = np.vstack([begin[span], np.full((1, begin.shape[1]), np.inf)])
        nodes[1:] = np.minimum(nodes[1:], end[span])
        for j, s in set(zip(kind.tolist(), sign.tolist(), strict=True)):
            along = nodes[:, (kind == j) & (sign == s)].min(axis=1)
            places = np.flatnonzero(np.isfinite(along))
            if len(places):
                along, side = along[places], 0 if s > 0 else 2
                slope = (along[-1] - along[0]) / max(places[-1] - places[0], 1)
                large = np.abs(along).max() + np.abs(slope) * q
                first = (along - slope * places).min() - (NEAR + 8 * u) * large
                clearance[cell, j, side : side + 2] = first, slope
    return clearance
