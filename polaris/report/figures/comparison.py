"""Figures of a comparison: where every method flew, and what was gained and lost."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.lines import Line2D

from ...rta.arena import Shown
from ...runs.comparison import ComparisonPicture
from ...runs.picture import Picture
from ..scene.items import under_mode
from ..scene.palette import BLUE, GREEN, GREY, ORANGE, RED
from ..scene.scene import describe
from .scene import draw_unsafe
from .style import DOTS, new_figure, printing, save_all, shortened
from .view import View

MODES = ((1, ORANGE, "U's input"), (-1, GREY, "filtered input"), (0, BLUE, "S"))

PANELS: tuple[tuple[str, str, bool], ...] = (
    ("min_distance_m", "Least distance\n(m)", False),
    ("experimental_share", "Share of time\nunder U", False),
    ("delta_v_m_s", "Delta-v\n(m/s)", False),
    ("deviation", "Deviation from\nU's input", False),
    ("decision_median_us", "Decision\n(µs)", True),
)
"""Metric, label, and whether its axis is logarithmic."""


def draw_comparison(found: ComparisonPicture, out: Path) -> list[Path]:
    """Draw ``paths`` (every method's run that came closest) and ``tradeoffs`` (metrics with intervals)."""

    def figures() -> Iterable[tuple[str, Any]]:
        methods = [method for method in found.table["methods"] if method["available"]]
        yield "tradeoffs", _tradeoffs(methods)
        picture = found.run.picture()
        if picture.system.d > 1:
            yield "paths", _paths(picture, methods, found.shown)

    return save_all(figures(), out)


def tradeoffs_png(methods: Sequence[Mapping[str, Any]]) -> bytes:
    """The figure ``tradeoffs`` as a picture for a page."""
    file = BytesIO()
    with printing():
        chosen = [method for method in methods if method.get("available", True)]
        _tradeoffs(chosen).savefig(file, format="png", dpi=180, metadata={"Software": "polaris"})
    return file.getvalue()


def _tradeoffs(methods: Sequence[Mapping[str, Any]]) -> Any:
    panels = [panel for panel in PANELS if any(method["metrics"].get(panel[0]) for method in methods)]
    figure = new_figure(0.6 + 0.22 * len(methods), 7.2)
    y = -np.arange(len(methods))
    if not panels:
        return figure
    axes = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    for ax, (metric, label, logarithmic) in zip(axes, panels, strict=True):
        for place, method in zip(y, methods, strict=True):
            colour = GREEN if method["guarantee"] == "proved" else RED
            told = method["metrics"].get(metric)
            told = told if isinstance(told, dict) else {"mean": told}
            mean, low, high, worst = (told.get(name) for name in ("mean", "low", "high", "worst"))
            if mean is None:
                continue
            if low is not None and high is not None:
                ax.plot([low, high], [place, place], color=colour, lw=1.4)
            ax.plot(mean, place, "o", ms=3.2, color=colour)
            if worst is not None:
                ax.plot(worst, place, "|", ms=6, mew=1.0, color=colour)
        if logarithmic:
            ax.set_xscale("log")
        elif metric == "min_distance_m":
            ax.axvline(0, color=RED, lw=0.6, ls=":")
        else:
            ax.set_xlim(left=0)
        ax.set_xlabel(label)
        ax.grid(True, axis="x")
        ax.tick_params(axis="y", length=0)
    axes[0].set_yticks(y, [shortened(str(method["name"]), 1.9) for method in methods])
    return figure


def _paths(picture: Picture, methods: Sequence[Mapping[str, Any]], shown: Mapping[str, Shown]) -> Any:
    view, alone = View(describe(picture), mute=True), replace(picture, tube=None, slices=None)
    columns = 3 if view.aspect < 0.8 else 4
    rows = -(-len(methods) // columns)
    width = 7.2
    figure = new_figure(rows * (width / columns * view.aspect + 0.28) + 0.5, width)
    grid = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    flat, frame = picture.frame.flat, picture.frame
    for ax in grid.flat[len(methods) :]:
        ax.set_axis_off()
    for ax, method in zip(grid.flat, methods, strict=False):
        ax.set_aspect("equal")
        ax.set(xlim=view.span[0], ylim=view.span[1])
        one = shown.get(method["key"])
        # The distance tells whether a set is passed or entered, which a plane need not show.
        told = "" if one is None else f": {float(one.nearest[0].min()):.3g} m"
        name = shortened(str(method["name"]), width / columns - 0.9) + told
        ax.set_title(name, fontsize=7, color=GREEN if method["guarantee"] == "proved" else RED)
        ax.tick_params(labelsize=6)
        ax.plot(*picture.path()[0][:, flat].T, color=GREY, lw=0.6, ls=DOTS, zorder=2)
        own: Any = {} if one is None else {"polaris": one}
        draw_unsafe(ax, describe(replace(alone, flights=own)), view)
        if one is not None:
            flown = (one.states[0] @ picture.system.position.T)[:, flat]
            for mode, colour, _ in MODES:
                chosen = one.modes[0] > 0 if mode > 0 else one.modes[0] == mode
                if chosen.any():
                    ax.plot(*under_mode(flown, chosen).T, color=colour, lw=1.1, zorder=4)
    figure.supxlabel(frame.labels[0], fontsize=7)
    figure.supylabel(frame.labels[1], fontsize=7)
    handles = [Line2D([], [], color=colour, lw=1.4, label=name) for _, colour, name in MODES]
    figure.legend(handles=handles, loc="outside upper center", ncols=3, fontsize=7)
    return figure
