"""Figures over time: distance and thrust, which controller flies, and how much room is left."""

import re
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.patches import Patch
from numpy.typing import ArrayLike

from ...model.scene.distances import stretches
from ...model.system import Array
from ...runs.picture import Picture
from ..scene import palette
from ..scene.items import drawn_pilots
from ..scene.palette import BLACK, GREEN, GREY, RED, mode_colour, shades, tint
from .cuts import mark_cuts
from .labels import name
from .style import GOAL_DASHES, keep_ticks, legend_above, new_figure, step_edges

INPUT_DASHES: tuple[Any, ...] = ("-", (0, (4, 1.2)), (0, (1.2, 1)))

FLOWN: dict[str, tuple[Any, float, float]] = {"polaris": ("-", 1.6, 3.1), "safety": ((0, (4, 1.2)), 1.0, 3.2)}
"""Dashes, width and order of those that flew."""
FAR = 3.0  # a velocity change above so many times that of the others leaves the panel
ALONE = ((0, (3, 1, 1, 1)), 1.0, 3.0)  # the same of experimental controllers on their own


def distance_figure(picture: Picture) -> Any:
    """Distance to the nearest unsafe set, the velocity change so far, and the input."""
    figure = new_figure(4.8)
    upper, middle, lower = figure.subplots(3, 1, sharex=True, height_ratios=(3, 2, 3))
    _distance(upper, picture)
    _spent(middle, picture)
    _input(lower, picture)
    for mode in np.unique(picture.modes):  # along the foot, which controller flies
        look = {"transform": lower.get_xaxis_transform(), "zorder": 5}
        _bars(lower, picture, picture.modes == mode, (0, 0.035), mode_colour(int(mode)), **look)
    keep_ticks(figure.axes)
    return figure


def _distance(ax: Any, picture: Picture) -> None:
    """Least distance over runs, band up to the largest."""
    handles, lowest, highest = [], 0.0, 0.0
    for one in drawn_pilots(picture):
        (dashes, width, order), flights, colour = FLOWN.get(one.key, ALONE), one.flights, one.colour
        if not np.all(np.isfinite(flights.nearest)):
            continue
        least, _, most = flights.nearest
        ax.fill_between(flights.times, least, most, color=tint(colour, 0.25), lw=0, zorder=order - 1)
        look = {"color": colour, "ls": dashes, "lw": width, "label": one.short}
        handles += ax.plot(flights.times, least, zorder=order, **look)
        lowest, highest = min(lowest, float(least.min())), max(highest, float(most.max()))
    pad = 0.06 * (highest - lowest) + 1e-9
    bottom = lowest - 2 * pad
    _beyond(ax, 0.0, bottom)
    name(ax, "unsafe", _across(picture, (bottom, 0.0)), RED)
    ax.set(xlim=(0, picture.duration), ylim=(bottom, highest + pad), ylabel="Distance (m)")
    ax.grid(True)
    legend_above(ax, handles, 3)


def _spent(ax: Any, picture: Picture) -> None:
    """Velocity change of the first runs as it adds up, what is proven of it, and when the goal is reached."""
    if picture.delta_v_max is not None:
        ax.axhline(picture.delta_v_max, color=GREY, lw=0.7)
        name(ax, "proven bound until the goal", _across(picture, 2 * (picture.delta_v_max,)), GREY)
    spent = {one.key: picture.velocity_change(one.flights)[0] for one in drawn_pilots(picture)}
    shown = [float(spent[key][-1]) for key in FLOWN if key in spent]
    top = 1.15 * max([picture.delta_v_max or 0.0, *shown])
    for one in drawn_pilots(picture):
        (dashes, width, order), line = FLOWN.get(one.key, ALONE), spent[one.key]
        ax.plot(one.flights.times, line, zorder=order, color=one.colour, ls=dashes, lw=width)
        if line[-1] > FAR * top > 0:  # else nothing of the others would be seen
            at = int(np.argmax(line > top))
            name(
                ax, f"{one.short}: {line[-1]:.3g} m/s at the end", [[one.flights.times[at], top]], one.colour
            )
        else:
            top = max(top, 1.05 * float(line[-1]))
    if picture.reached is not None:  # at T or later: a line there is seen only if it is at T
        ax.axvline(picture.reached, color=GREEN, lw=1.2, ls=GOAL_DASHES)
    look = {"color": GREEN, "fontsize": 7, "ha": "right", "va": "bottom"}
    ax.text(1.0, 1.01, picture.arrival, transform=ax.transAxes, **look)
    ax.set(xlim=(0, picture.duration), ylim=(0, top or None), ylabel="Velocity\nchange (m/s)")
    ax.grid(True)
    mark_cuts(ax)


def _input(ax: Any, picture: Picture) -> None:
    """Input under Polaris: nominal run, band over all runs, limits shaded."""
    flights, limit = picture.flights["polaris"], picture.system.u_max
    assert flights.input_range is not None  # known of controllers
    label, names = palette.input_labels(picture.system)
    same = bool(np.all(limit == limit[0]))
    scale, top = (np.ones_like(limit), float(limit[0])) if same else (limit, 1.0)
    handles = []
    for axis, (title, colour) in enumerate(zip(names, shades((BLACK, "#8C8C8C"), len(names)), strict=True)):
        low, high = (step_edges(bound[:, axis]) / scale[axis] for bound in flights.input_range)
        ax.fill_between(flights.times, low, high, step="post", color=tint(GREY, 0.25), lw=0, zorder=2)
        nominal = step_edges(flights.inputs[0][:, axis]) / scale[axis]
        look = {"color": colour, "ls": INPUT_DASHES[axis % 3], "lw": 1.0, "label": title, "zorder": 3}
        handles += ax.plot(flights.times, nominal, drawstyle="steps-post", **look)
    for side in (-top, top):
        _beyond(ax, side, 1.2 * side)
    label = label if same else f"{label.split(' (')[0]} / limit"
    ax.set(xlim=(0, picture.duration), ylim=(-1.2 * top, 1.2 * top), xlabel="Time (s)", ylabel=label)
    ax.grid(True)
    legend_above(ax, handles, 3)


def modes_figure(picture: Picture) -> Any:
    """One row per controller: when it flies, and its share of the time."""
    rows = len(picture.controllers)
    figure = new_figure(0.6 + 0.28 * rows)
    ax = figure.add_subplot()
    for mode in range(rows):
        row, flags = rows - 1 - mode, picture.modes == mode
        ax.broken_barh([(0, picture.duration)], (row - 0.3, 0.6), facecolor="#F2F2F2", lw=0)
        _bars(ax, picture, flags, (row - 0.3, 0.6), mode_colour(mode))
        _beside(ax, 1.01, row, f"{np.mean(flags):.0%}", va="center")
    ax.set(xlim=(0, picture.duration), ylim=(-0.6, rows - 0.4), xlabel="Time (s)")
    ax.set_yticks(range(rows), [picture.mode_name(mode) for mode in range(rows)][::-1])
    ax.tick_params(axis="y", length=0)
    ax.spines["left"].set_visible(False)
    keep_ticks(figure.axes)
    return figure


def margin_figure(picture: Picture) -> Any:
    """The containment margin of every step, and below it what limits it."""
    figure = new_figure(2.4)
    ax, modes, delta = figure.add_subplot(), picture.modes, picture.reference.delta
    floor = -0.3 if np.any(picture.margins < 0) else -0.03
    margins = np.clip(np.nan_to_num(picture.margins, neginf=floor), floor, 1.0)
    start = np.arange(len(modes)) * delta
    handles: list[Any] = []
    for mode in np.unique(modes):
        chosen, colour = modes == mode, mode_colour(int(mode))
        ax.bar(start[chosen], margins[chosen], width=delta, align="edge", color=colour, lw=0.2, ec="white")
        handles.append(Patch(facecolor=colour, label=picture.mode_name(int(mode))))
    ax.axhline(0, color=BLACK, lw=0.6)
    names = np.array([limit_group(name) for name in picture.limits])
    place, height = floor - 0.17, 0.12
    for wanted, ends in ((True, palette.INPUT_SHADES), (False, palette.SET_SHADES)):
        own = [one for one in dict.fromkeys(names) if (one in picture.system.input_names) == wanted]
        for one, shade in zip(own, shades(ends, len(own)), strict=True):
            _bars(ax, picture, names == one, (place, height), shade)
            handles.append(Patch(facecolor=shade, label=one))
    _beside(ax, -0.015, place + height / 2, "limit", ha="right", va="center")
    label = "Margin (share of room left)"
    ax.set(xlim=(0, picture.duration), ylim=(place - 0.03, 1.0), xlabel="Time (s)", ylabel=label)
    ax.set_yticks([0, 0.25, 0.5, 0.75, 1.0])
    ax.grid(True, axis="y")
    figure.set_figheight(2.1 + legend_above(ax, handles, 3))
    keep_ticks(figure.axes)
    return figure


def _bars(
    ax: Any, picture: Picture, flags: ArrayLike, rows: tuple[float, float], colour: Any, **look: Any
) -> None:
    """Bars over the steps (K,) that are flagged."""
    delta = picture.reference.delta
    spans = [(a * delta, (b - a) * delta) for a, b in stretches(flags)]
    ax.broken_barh(spans, rows, facecolor=colour, lw=0, **look)


def _beside(ax: Any, x: float, y: float, text: str, **look: Any) -> None:
    """Write at a share of the width, and a value."""
    ax.text(x, y, text, fontsize=7, transform=ax.get_yaxis_transform(), **look)


def _across(picture: Picture, ends: Sequence[float]) -> Array:
    """Points at these values, from the start to the horizon."""
    return np.array([(t, end) for end in ends for t in np.linspace(0, picture.duration, 25)])


def _beyond(ax: Any, value: float, end: float) -> None:
    """A limit, and what lies beyond it."""
    ax.axhspan(value, end, color=tint(RED, 0.16), lw=0, zorder=0.5)
    ax.axhline(value, color=RED, lw=0.7, zorder=0.6)


def limit_group(name: str) -> str:
    """Name of a limit without the number of a keep-in set's facet."""
    return re.sub(r"\[\d+\]$", "", name)
