"""Figures over time: diagrams of a timeline, which controller flies, and how much clearance is left."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.patches import Patch
from numpy.typing import ArrayLike

from ...model.scene.distances import stretches
from ...model.system import Array
from ...runs.plot_data import PlotData
from ..scene import palette
from ..scene.items import Actor, drawn_pilots
from ..scene.palette import BLACK, GREEN, GREY, RED, mode_colour, shades, tint
from ..scene.timelines import Instant, Limit, Panel, Series, schedule_timeline
from ..sentences import set_of_limit
from .cuts import mark_cuts
from .labels import name
from .style import GOAL_DASHES, keep_ticks, legend_above, new_figure, shortened

DASHES: dict[str, Any] = {
    **{"solid": "-", "dash": (0, (4, 1.2)), "dot": (0, (1.2, 1))},
    **{"dashdot": (0, (4, 1, 1, 1)), "longdash": (0, (7, 1.2))},
}
FAR = 3.0  # a line of a pilot that is not shown at first is cut above so many times the range of the others
PAD = 0.07  # margin above and below what is drawn, as a share of its range
SAFE, UNSAFE = tint(GREEN, 0.14), tint(RED, 0.16)

MOST_NAMED = 10  # most lines that a legend names
LEAST_BAR = 0.012  # height of the bar of a smaller margin, which would look as if nothing were left


def timeline_figure(
    panels: Sequence[Panel], controllers: Sequence[Actor], marks: Sequence[Instant] = (), height: float = 1.25
) -> Any:
    """Draw diagrams over each other, each of a height [in], and marks at instants."""
    figure = new_figure(0.8 + height * len(panels))
    axes = figure.subplots(len(panels), 1, sharex=True, squeeze=False).ravel()
    labelled: set[str] = set()
    for ax, panel in zip(axes, panels, strict=True):
        draw_panel(ax, panel, controllers, labelled)
        ax.set_xlabel("Time (s)" if ax is axes[-1] else "")
        for one in marks:  # after T a line is not seen
            colour = RED if one.panel else GREEN
            ax.axvline(one.t, color=colour, lw=0.7 if one.panel else 1.2, ls=GOAL_DASHES)
            if one.panel == panel.key or not one.panel and ax is axes[-1]:
                name(ax, one.text, [(one.t, y) for y in ax.get_ylim()], colour)
    keep_ticks(axes)
    return figure


def draw_panel(ax: Any, panel: Panel, controllers: Sequence[Actor], labelled: set[str] | None = None) -> None:
    """Draw one diagram of the first runs; its legend has the lines that have not been `labelled` above."""
    actors, labelled = {one.key: one for one in controllers}, set() if labelled is None else labelled
    # Inputs of pilots that are not shown at first would hide those that are.
    series = panel.series
    lines = [
        each for each in series if each.controller is None or actors[each.controller].on or not each.step
    ]
    heavy = [one for one in controllers if one.on] if not all(one.on for one in controllers) else []
    end = max(float(one.times[-1]) for one in [controller.flights for controller in controllers] or lines)
    low, high = _range(panel, lines, actors)
    handles: dict[str, Any] = {}
    for order, line in enumerate(lines):
        source = line if line.controller is None else actors[line.controller]
        label = source.name if isinstance(source, Series) else source.short
        step: Any = {"step": "post"} if line.step else {}
        if line.fill or line.band is not None and np.all(np.isfinite(line.band)):
            ends = line.band if line.band is not None else (np.minimum(0, line.values), line.values)
            ax.fill_between(line.times, *ends, color=tint(source.colour, 0.22), lw=0, zorder=2, **step)
        look: Any = {"drawstyle": "steps-post"} if line.step else {}
        look |= {"color": source.colour, "ls": DASHES[source.dash], "zorder": 3 + 0.01 * order}
        look["lw"] = 1.6 if line.controller and source in heavy else 1.0
        values = first_run(line)
        (handles[label],) = ax.plot(line.times, values, label=label, **look)
        if np.any(values > high):
            at, text = int(np.argmax(values > high)), f"{label}: {values[-1]:.3g} {panel.unit} at the end"
            name(ax, text, [[line.times[at], high]], source.colour)
    if panel.log:
        ax.set_yscale("log")
    ax.set(xlim=(0, end), ylim=(low, high), xlabel="Time (s)", ylabel=f"{panel.label} ({panel.unit})")
    for limit in panel.limits:
        _draw_limit(ax, limit, (low, high), end)
    for points, text in panel.names:
        name(ax, shortened(text, 1.3), points, GREY, beside=True)
    ax.grid(True)
    mark_cuts(ax)
    unique = [one for label, one in handles.items() if label and label not in labelled]
    labelled.update(handles)
    if len(unique) <= MOST_NAMED and (len(controllers) > 1 or not all(line.controller for line in lines)):
        legend_above(ax, unique, 5)


def first_run(line: Series) -> Array:
    """Return the values (N,) of a line, or of the first run of its pilot."""
    return line.values if line.values.ndim == 1 else line.values[0]


def _range(panel: Panel, lines: Sequence[Series], actors: Mapping[str, Actor]) -> tuple[float, float]:
    """Return the ends of the axis: all that is drawn, but for lines that would make the others flat."""
    limits = [limit.y for limit in panel.limits]

    def ends(some: Sequence[Series]) -> Array:
        bands = [np.ravel(one.band) for one in some if one.band is not None]
        values = np.concatenate([limits, *map(first_run, some), *bands])
        values = values[np.isfinite(values)]
        return np.array([values.min(initial=np.inf), values.max(initial=-np.inf)])

    low, high = ends(lines)
    visible = ends([one for one in lines if one.controller is None or actors[one.controller].on])
    if 0 < FAR * np.ptp(visible) < high - min(visible):
        high = visible[1]
    if panel.log:
        return 0.6 * low, 1.6 * high
    pad = PAD * (high - low) or 1e-9 + abs(high)
    return low - pad, high + pad


def _draw_limit(ax: Any, limit: Limit, view: tuple[float, float], end: float) -> None:
    """Draw a limit with its name, and shade the region beyond it."""
    colour = RED if limit.unsafe else GREY
    ax.axhline(limit.y, color=colour, lw=0.7, zorder=0.6)
    beyond = {"below": view[0], "above": view[1]}.get(limit.unsafe, limit.y)
    if limit.unsafe:
        ax.axhspan(limit.y, beyond, color=UNSAFE, lw=0, zorder=0.5)
    if limit.text:
        name(ax, limit.text, [(0, limit.y), (end, limit.y), (end, beyond), (0, beyond)], colour)


def distance_figure(picture: PlotData) -> Any:
    """Draw the distance to the nearest unsafe set, the velocity change so far, and the inputs."""
    timeline = schedule_timeline(picture, drawn_pilots(picture), picture.delta_v_max is not None)
    figure = timeline_figure(timeline.panels, timeline.controllers, timeline.marks)
    lower = figure.axes[-1]
    for mode in np.unique(picture.modes):  # along the foot, which controller flies
        look = {"transform": lower.get_xaxis_transform(), "zorder": 5}
        _bars(lower, picture, picture.modes == mode, (0, 0.035), mode_colour(int(mode)), **look)
    return figure


def modes_figure(picture: PlotData) -> Any:
    """Draw one row per controller: when it flies, and its share of the time."""
    rows = len(picture.controllers)
    figure = new_figure(0.6 + 0.28 * rows)
    ax = figure.add_subplot()
    for mode in range(rows):
        row, flags = rows - 1 - mode, picture.modes == mode
        ax.broken_barh([(0, picture.duration)], (row - 0.3, 0.6), facecolor="#F2F2F2", lw=0)
        _bars(ax, picture, flags, (row - 0.3, 0.6), mode_colour(mode))
        _write(ax, 1.01, row, f"{np.mean(flags):.0%}", va="center")
    ax.set(xlim=(0, picture.duration), ylim=(-0.6, rows - 0.4), xlabel="Time (s)")
    ax.set_yticks(range(rows), [picture.mode_name(mode) for mode in range(rows)][::-1])
    ax.tick_params(axis="y", length=0)
    ax.spines["left"].set_visible(False)
    keep_ticks(figure.axes)
    return figure


def margin_figure(picture: PlotData) -> Any:
    """The containment margin of every step, and below it the constraint that limits it."""
    figure = new_figure(2.4)
    ax, modes, delta = figure.add_subplot(), picture.modes, picture.reference.delta
    floor = -0.3 if np.any(picture.margins < 0) else -0.03
    margins = np.clip(np.nan_to_num(picture.margins, neginf=floor), floor, 1.0)
    margins[(margins >= 0) & (margins < LEAST_BAR)] = LEAST_BAR
    start = np.arange(len(modes)) * delta
    handles: list[Any] = []
    for mode in np.unique(modes):
        chosen, colour = modes == mode, mode_colour(int(mode))
        ax.bar(start[chosen], margins[chosen], width=delta, align="edge", color=colour, lw=0.2, ec="white")
        handles.append(Patch(facecolor=colour, label=picture.mode_name(int(mode))))
    ax.axhline(0, color=BLACK, lw=0.6)
    names = np.array([set_of_limit(name) for name in picture.limits])
    place, height = floor - 0.17, 0.12
    for is_input, ends in ((True, palette.INPUT_SHADES), (False, palette.SET_SHADES)):
        group = [one for one in dict.fromkeys(names) if (one in picture.system.input_names) == is_input]
        for one, shade in zip(group, shades(ends, len(group)), strict=True):
            _bars(ax, picture, names == one, (place, height), shade)
            handles.append(Patch(facecolor=shade, label=one))
    _write(ax, -0.015, place + height / 2, "limit", ha="right", va="center")
    label = "Margin (share of clearance)"
    ax.set(xlim=(0, picture.duration), ylim=(place - 0.03, 1.0), xlabel="Time (s)", ylabel=label)
    ax.set_yticks([0, 0.25, 0.5, 0.75, 1.0])
    ax.grid(True, axis="y")
    figure.set_figheight(2.1 + legend_above(ax, handles, 3))
    keep_ticks(figure.axes)
    return figure


def _bars(
    ax: Any, picture: PlotData, flags: ArrayLike, rows: tuple[float, float], colour: Any, **look: Any
) -> None:
    """Bars over the steps (K,) that are flagged."""
    delta = picture.reference.delta
    spans = [(a * delta, (b - a) * delta) for a, b in stretches(flags)]
    ax.broken_barh(spans, rows, facecolor=colour, lw=0, **look)


def _write(ax: Any, x: float, y: float, text: str, **look: Any) -> None:
    """Write at a share of the width, and a value."""
    ax.text(x, y, text, fontsize=7, transform=ax.get_yaxis_transform(), **look)
