"""Flights over time as plain data, which the printed figures and the page draw alike."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from reach.numerics.linear import growth

from ...model.scene.distances import UNKNOWN, signed_distances, stretches
from ...model.scene.keep_in import FAR
from ...model.scene.obstacles import perceive
from ...model.scene.state_limits import RATE, SpeedLimit, SpeedPolygon, StateLimit
from ...model.system import Array
from ...model.tolerances import ROUNDING
from ...runs.plot_data import PlotData, TubeData
from ...simulation.baselines import FlightEnvelope
from ...synthesis.safety.recoverable import directed
from .items import Actor
from .palette import GREEN, RED, input_labels, mode_colour

WHO = "Who flies"
ROUND_OFF = 1e-9  # inputs below this share of the limit are 0 but for rounding


class Limit(NamedTuple):
    """A limit of a diagram; `unsafe` is the side of it that is shaded: ``above``, ``below`` or none."""

    y: float
    text: str = ""
    unsafe: str = ""


class Instant(NamedTuple):
    """A time [s] marked in all diagrams; its text stands in the last one, or in red in that of a key."""

    t: float
    text: str
    panel: str = ""


@dataclass(frozen=True, eq=False)
class Series:
    """A line over times (N,) [s]: values (N,), or (r, N) of the runs of a pilot, by its key.

    A `step` is held until the next sample; a `band` (2, N) has the least and the largest over all runs.
    """

    times: Array
    values: Array
    controller: str | None = None
    name: str = ""
    meaning: str = ""
    colour: str = ""
    dash: str = "solid"
    step: bool = False
    fill: bool = False
    band: Array | None = None


@dataclass(frozen=True, eq=False)
class Panel:
    """One diagram; `label` is its title on the axis of a printed figure, where it is `log`arithmic or not.

    Print writes `names` at points (N, 2) in it.
    """

    key: str
    title: str
    label: str
    unit: str
    limits: Sequence[Limit]
    series: Sequence[Series]
    log: bool = False
    names: Sequence[tuple[Array, str]] = ()


@dataclass(frozen=True, eq=False)
class Timeline:
    """Pilots and diagrams with one time axis; the page opens at `opened` [s].

    `modes` are those that occur, with their names and colours. A page colours its scene `by` ``mode`` or by
    ``controller``.
    """

    controllers: Sequence[Actor]
    panels: Sequence[Panel]
    modes: Sequence[tuple[int, str, str]]
    opened: float
    modes_title: str = WHO
    by: str = "pilot"
    marks: Sequence[Instant] = ()


def modes_present(present: ArrayLike, styles: Callable[[int], tuple[str, str]]) -> list[tuple[int, str, str]]:
    """Return number, name and colour of every mode that occurs."""
    return [(mode, *styles(mode)) for mode in np.unique(present).tolist()]


def schedule_timeline(
    picture: PlotData,
    controllers: Sequence[Actor],
    proved: bool,
    by: str = "mode",
    opened: float | None = None,
) -> Timeline:
    """Describe the flights of a schedule and its pilots over time.

    If `proved`, the proven distance is shown. The page opens at `opened` [s], or at the closest approach.
    """

    def named(mode: int) -> tuple[str, str]:
        if mode == UNKNOWN:
            return "filtered input, or not known", "#9A9A9A"
        valid = 0 <= mode < len(picture.controllers)
        return picture.mode_name(mode) if valid else f"controller {mode}", mode_colour(mode)

    runs = {one.key: one.flights for one in controllers}
    delta_v = [Series(each.times, picture.velocity_change(each), key) for key, each in runs.items()]
    bound = picture.delta_v_max if proved else None
    text = f"proven until the goal: at most {directed(bound, '.4g', up=True)}" if bound else ""
    limits = [Limit(bound, text)] if bound else []
    label, names = input_labels(picture.system)
    quantity, _, unit = label.rstrip(")").partition(" (")
    titles = [f"{quantity}, {name}" if quantity != "Input" else f"Input: {name}" for name in names]
    inputs = []
    for key, each in runs.items():
        band = None if each.input_range is None else step_edges(each.input_range, 1)
        inputs.append(Series(each.times, step_edges(each.inputs, 1), key, step=True, band=band))
    panels = [
        *([_distances(picture, runs, proved)] if picture.obstacles else []),
        *(_limit_panel(i, one, picture, runs, proved) for i, one in enumerate(picture.state_limits)),
        Panel("spent", "Delta-v so far", "Delta-v", "m/s", limits, delta_v),
        *input_panels(titles, unit, picture.system.u_max, inputs),
    ]
    present = np.concatenate([picture.modes, *(np.ravel(each.modes) for each in runs.values())])
    return Timeline(
        controllers,
        panels,
        modes_present(present, named),
        picture.closest if opened is None else opened,
        by=by,
        marks=_changes(picture, proved),
    )


def _changes(picture: PlotData, proved: bool) -> list[Instant]:
    """Return when the goal is reached, and sets begin or cease to hold: of several at one time the last."""
    changes = {0.0: Instant(picture.reached, picture.arrival)} if proved and picture.reached else {}
    for key in ("ends", "begins"):
        for one in picture.obstacles:
            if 0 < (t := getattr(one, key, 0.0)) < picture.duration:
                changes[t] = Instant(t, f"{one.name} {key}", "distance")
    return list(changes.values())


def step_edges(values: Array, axis: int = 0) -> Array:
    """Repeat the last value along an axis, so that steps reach the end of the last one."""
    return np.concatenate([values, np.take(values, [-1], axis)], axis)


def input_panels(titles: Sequence[str], unit: str, most: ArrayLike, inputs: Sequence[Series]) -> list[Panel]:
    """Return one diagram per input, between its limits, of series whose values end in an axis of inputs."""
    panels = []
    for axis, (title, end) in enumerate(zip(titles, np.asarray(most).tolist(), strict=True)):
        limits = [Limit(-end, "", "below"), Limit(end, f"limit {end:.4g}", "above")]
        label = title.partition(", ")[2].capitalize() or title
        series = [_of_axis(one, axis, end) for one in inputs]
        panels.append(Panel(f"input{axis}", title, label, unit, limits, series))
    return panels


def _of_axis(one: Series, axis: int, limit: float) -> Series:
    """Return a series of one input; values that are 0 but for rounding are 0."""
    values, band = one.values[..., axis], None if one.band is None else one.band[..., axis]
    values = np.where(np.abs(values) < ROUND_OFF * limit, 0.0, values)
    return Series(one.times, values, one.controller, dash=one.dash, step=True, band=band)


def _distances(picture: PlotData, runs: dict[str, FlightEnvelope], proved: bool) -> Panel:
    """Describe distances to the nearest unsafe set; other satellites are where they are nominally."""
    series, names = [], list[tuple[Array, str]]()
    for key, each in runs.items():
        positions = each.states @ picture.system.position.T
        by_set = signed_distances(picture.obstacles, each.times, positions, picture.system)
        names = names or _nearest(picture, each.times, by_set[:, 0])
        series.append(Series(each.times, by_set.min(axis=0), key, band=each.nearest[[0, 2]]))
    if proved and (bound := proven_distance(picture)) is not None:
        series.append(_proven(picture, bound, "least that is proven"))
    title = "Distance to the nearest keep-out zone"
    return Panel("distance", title, "Distance", "m", [Limit(0.0, "unsafe", "below")], series, names=names)


def _nearest(picture: PlotData, times: Array, distances: Array) -> list[tuple[Array, str]]:
    """Return the longest stretch of a flight on which each set is nearest; distances (sets, N) [m]."""
    nearest, names = distances.argmin(axis=0), []
    for i in np.unique(nearest):
        a, b = max(stretches(nearest == i), key=lambda span: span[1] - span[0])
        middle = slice(a + (b - a) // 4, b - (b - a) // 4)
        line = np.column_stack([times[middle], distances[i, middle]])
        names.append((line, f"nearest: {picture.obstacles[i].name}"))
    return names


def _limit_panel(
    index: int, limit: StateLimit, picture: PlotData, runs: dict[str, FlightEnvelope], proved: bool
) -> Panel:
    """Describe a limit on the whole state: speeds and their limit, or how far states are from the limit.

    What is proven may be far from what was flown: rows of states stand for the limit, and the reachable set
    for the flight.
    """
    system, of_speed, top, slope = picture.system, False, 0.0, 0.0
    if isinstance(limit, SpeedLimit | SpeedPolygon):
        of_speed, top, slope = True, float(np.min(limit.top)), getattr(limit, "per_distance", 0.0)

    def shown(slack: Array, distance: Array) -> Array:
        return np.where(slack < FAR**2, top + slope * distance - slack * RATE if of_speed else slack, np.nan)

    series = []
    for key, each in runs.items():
        distance = np.linalg.norm(each.states @ system.position.T, axis=-1)
        slack = limit.signed_distance(each.times, each.states, system)
        series.append(Series(each.times, shown(slack, distance), key))
    if slope:
        key, each = next(iter(runs.items()))
        far = np.linalg.norm(each.states[0] @ system.position.T, axis=-1)
        name = f"limit at the distance of {key}, run {each.labels[0]}"
        series.append(Series(each.times, top + slope * far, name=name, colour=RED, dash="dash"))
    if proved and (bound := proven_distance(picture, limit)) is not None and picture.tube is not None:
        reach = np.abs(picture.tube.centre) + np.abs(picture.tube.generators).sum(axis=-1)
        between = _intersample(picture, picture.tube, system.position)
        distance = np.linalg.norm(np.maximum(reach[:, :-1], reach[:, 1:]) + between, axis=-1)
        legend = f"{'most' if of_speed else 'least'} that is proven"
        series.append(_proven(picture, shown(bound, distance), legend))
    word, unit, side = ("Speed", "m/s", "above") if of_speed else ("Room", "m", "below")
    title = f"{word}, limit {limit.name}" + (f", 1 m/s as {1 / RATE:g} m" if not of_speed else "")
    limits = [] if slope else [Limit(float(top), "limit" if of_speed else "unsafe", side)]
    return Panel(f"limit{index}", title, f"{word}\n{limit.name}", unit, limits, series)


def _proven(picture: PlotData, bound: Array, name: str) -> Series:
    """Return the line of the proven bound in every control period, (K, q)."""
    (K, q), delta = bound.shape, picture.reference.delta
    times = np.append((np.arange(K)[:, None] + np.arange(q) / q).ravel(), K) * delta
    values = np.append(bound.ravel(), bound[-1, -1])
    return Series(times, values, name=name, colour=GREEN, step=True, fill=True)


def proven_distance(picture: PlotData, limit: StateLimit | None = None) -> Array | None:
    """Least distance (K, q) [m] from all unsafe sets, or to a limit, that a proved schedule promises.

    The tube lies in the hull of its ends, up to its intersample bound and that of the reference; offsets
    run linearly, so the gap to a facet is least at an end. Negative gaps rest on S taking over: no more
    than 0 is promised. What the true position is displaced by is in the tube, and in the sets that are
    perceived: it counts once.
    """
    system, M = picture.system, picture.system.position
    tube, obstacles = picture.tube, picture.obstacles
    if limit is not None:
        tube, obstacles, M = picture.state_tube, (limit,), np.eye(system.n)
    unsafe = perceive(obstacles, system, picture.reference.delta, picture.planned)
    if tube is None or not unsafe:
        return None
    q, intersample = tube.intersample.shape[1], _intersample(picture, tube, M)
    gaps, at_nodes = [], system.state_offset_at_nodes
    offset_parts = np.stack([at_nodes, system.state_offset - at_nodes])
    for timed in unsafe:
        rows, offsets = timed.normals, timed.fine(q)
        reach = np.abs(np.einsum("fd,kqdg->kqfg", rows, tube.generators)).sum(axis=-1)
        size = np.abs(tube.centre).sum(axis=-1, keepdims=True) + np.abs(offsets)
        gap = tube.centre @ rows.T - reach - offsets - ROUNDING * size
        shift = np.abs(rows @ M) @ offset_parts[0] + np.abs(rows) @ np.abs(M) @ offset_parts[1]
        between = np.minimum(gap[:, :-1], gap[:, 1:]) - intersample @ np.abs(rows).T
        gaps.append((between if timed.of_state else between + shift).max(axis=-1))
    return np.asarray(np.maximum(np.min(gaps, axis=0), 0.0))


def _intersample(picture: PlotData, tube: TubeData, M: Array) -> Array:
    """Bound how far M x is from the hull of the ends of a period, in the tube and about the reference."""
    q, system, reference = tube.intersample.shape[1], picture.system, picture.reference
    inputs = (reference.nu[: picture.planned] @ system.B.T)[:, None, :]
    rate = reference.fine(q)[: picture.planned, :-1] @ system.A.T + inputs
    rate_max = np.abs(rate) @ growth(system.A, reference.delta / q).T
    return np.asarray(tube.intersample + (reference.delta / q) ** 2 / 8 * rate_max @ np.abs(M @ system.A).T)
