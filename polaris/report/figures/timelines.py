"""Figures over time: distance and thrust, which controller flies, and how much room is left."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from ...runs.picture import Picture
from ..scene.geometry import stretches
from ..scene.palette import (
    BLACK,
    GREY,
    INPUT_SHADES,
    RED,
    SET_SHADES,
    input_labels,
    mode_colour,
    shades,
    tint,
)
from .style import legend_above, step_edges

INPUT_DASHES: tuple[Any, ...] = ("-", (0, (4, 1.2)), (0, (1.2, 1)))


def draw_distance(ax: Any, picture: Picture) -> None:
    """Draw the distance to the nearest unsafe set over time: least over runs, band up to the largest."""
    from matplotlib.lines import Line2D

    shown = (
        ("polaris", "Polaris", BLACK, "-", 3.1),
        ("safety", "S alone", mode_colour(0), (0, (4, 1.2)), 3.2),
        ("experimental", "U alone", mode_colour(1), (0, (3, 1, 1, 1)), 3.0),
    )
    handles, lowest, highest = [], 0.0, 0.0
    for key, text, colour, dashes, order in shown:
        flights = picture.flights.get(key)
        if flights is None or not np.all(np.isfinite(flights.nearest)):
            continue
        least, _, most = flights.nearest
        ax.fill_between(flights.times, least, most, color=tint(colour, 0.25), lw=0, zorder=order - 1)
        width = 1.6 if key == "polaris" else 1.0
        ax.plot(flights.times, least, color=colour, ls=dashes, lw=width, zorder=order)
        handles.append(Line2D([], [], color=colour, ls=dashes, lw=width, label=text))
        lowest, highest = min(lowest, float(least.min())), max(highest, float(most.max()))
    pad = 0.06 * (highest - lowest) + 1e-9
    bottom = lowest - 2 * pad
    ax.axhspan(bottom, 0, color=tint(RED, 0.16), lw=0, zorder=0.5)
    ax.axhline(0, color=RED, lw=0.7, zorder=0.6)
    ax.text(
        0.99, 0.0, "unsafe", color=RED, fontsize=7, ha="right", va="top", transform=ax.get_yaxis_transform()
    )
    ax.set(xlim=(0, picture.duration), ylim=(bottom, highest + pad), ylabel="Distance (m)")
    ax.grid(True)
    legend_above(ax, handles, 3)


def draw_input(ax: Any, picture: Picture) -> None:
    """Draw the input under Polaris: nominal run, band over all runs, limits shaded."""
    from matplotlib.lines import Line2D

    flights = picture.flights["polaris"]
    limit = picture.system.u_max
    label, names = input_labels(picture.system)
    same = bool(np.all(limit == limit[0]))
    scale = np.ones_like(limit) if same else limit
    top = float(limit[0]) if same else 1.0
    handles = []
    colours = shades((BLACK, "#8C8C8C"), len(names))
    for axis, (name, colour) in enumerate(zip(names, colours, strict=True)):
        dashes = INPUT_DASHES[axis % 3]
        low, high = (step_edges(bound[:, axis]) / scale[axis] for bound in flights.input_range)
        ax.fill_between(flights.times, low, high, step="post", color=tint(GREY, 0.25), lw=0, zorder=2)
        nominal = step_edges(flights.inputs[0][:, axis]) / scale[axis]
        ax.step(flights.times, nominal, where="post", color=colour, ls=dashes, lw=1.0, zorder=3)
        handles.append(Line2D([], [], color=colour, ls=dashes, lw=1.0, label=name))
    for side in (-1, 1):
        ax.axhspan(side * top, side * 1.2 * top, color=tint(RED, 0.16), lw=0, zorder=0.5)
        ax.axhline(side * top, color=RED, lw=0.7, zorder=0.6)
    ax.set(
        xlim=(0, picture.duration),
        ylim=(-1.2 * top, 1.2 * top),
        xlabel="Time (s)",
        ylabel=label if same else f"{label.split(' (')[0]} / limit",
    )
    ax.grid(True)
    legend_above(ax, handles, 3)


def draw_modes(ax: Any, picture: Picture) -> None:
    """Draw one row per controller: when it flies, and its share of the time."""
    delta, modes = picture.reference.delta, picture.modes
    rows = len(picture.controllers)
    for mode in range(rows):
        spans = [(start * delta, (stop - start) * delta) for start, stop in stretches(modes == mode)]
        row = rows - 1 - mode
        ax.broken_barh([(0, picture.duration)], (row - 0.3, 0.6), facecolor="#F2F2F2", lw=0)
        ax.broken_barh(spans, (row - 0.3, 0.6), facecolor=mode_colour(mode), lw=0)
        ax.text(
            1.01,
            row,
            f"{np.mean(modes == mode):.0%}",
            fontsize=7,
            va="center",
            transform=ax.get_yaxis_transform(),
        )
    ax.set(xlim=(0, picture.duration), ylim=(-0.6, rows - 0.4), xlabel="Time (s)")
    names = [picture.mode_name(mode) for mode in range(rows)]
    ax.set_yticks(range(rows), names[::-1])
    ax.tick_params(axis="y", length=0)
    ax.spines["left"].set_visible(False)


def draw_margin(ax: Any, picture: Picture) -> float:
    """Draw the containment margin of every step, and below it what limits it; height of the legend [in]."""
    from matplotlib.patches import Patch

    modes, delta = picture.modes, picture.reference.delta
    floor = -0.3 if np.any(picture.margins < 0) else -0.03
    margins = np.clip(np.nan_to_num(picture.margins, neginf=floor), floor, 1.0)
    start = np.arange(len(modes)) * delta
    handles: list[Any] = []
    for mode in np.unique(modes):
        chosen = modes == mode
        colour = mode_colour(int(mode))
        ax.bar(start[chosen], margins[chosen], width=delta, align="edge", color=colour, lw=0.2, ec="white")
        handles.append(Patch(facecolor=colour, label=picture.mode_name(int(mode))))
    ax.axhline(0, color=BLACK, lw=0.6)
    names = [limit_group(name) for name in picture.limits]
    place, height = floor - 0.17, 0.12
    thrust, sets = (
        [name for name in dict.fromkeys(names) if (name in picture.system.input_names) == wanted]
        for wanted in (True, False)
    )
    told = dict(zip(thrust, shades(INPUT_SHADES, len(thrust)), strict=True))
    told |= dict(zip(sets, shades(SET_SHADES, len(sets)), strict=True))
    for name, shade in told.items():
        chosen = np.array([other == name for other in names])
        spans = [(a * delta, (b - a) * delta) for a, b in stretches(chosen)]
        ax.broken_barh(spans, (place, height), facecolor=shade, lw=0)
        handles.append(Patch(facecolor=shade, label=name))
    ax.text(
        -0.015,
        place + height / 2,
        "limit",
        fontsize=7,
        ha="right",
        va="center",
        transform=ax.get_yaxis_transform(),
    )
    ax.set(
        xlim=(0, picture.duration),
        ylim=(place - 0.03, 1.0),
        xlabel="Time (s)",
        ylabel="Margin (share of room left)",
    )
    ax.set_yticks([0, 0.25, 0.5, 0.75, 1.0])
    ax.grid(True, axis="y")
    return legend_above(ax, handles, 3)


def mode_strip(ax: Any, picture: Picture) -> None:
    """Mark along the foot of the axes which controller flies."""
    delta = picture.reference.delta
    for mode in np.unique(picture.modes):
        spans = [(a * delta, (b - a) * delta) for a, b in stretches(picture.modes == mode)]
        ax.broken_barh(
            spans,
            (0, 0.035),
            facecolor=mode_colour(int(mode)),
            lw=0,
            transform=ax.get_xaxis_transform(),
            zorder=5,
        )


def limit_group(name: str) -> str:
    """Name of a limit without the number of a keep-in set's facet."""
    return re.sub(r"\[\d+\]$", "", name)
