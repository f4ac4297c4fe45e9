"""Figures for print: the scene with its modes, distance and thrust, timeline, containment margin.

matplotlib is imported when the first figure is drawn.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ...runs.picture import Picture
    from ...synthesis.get_safety import Safety
    from ...synthesis.schedule import Schedule

__all__ = ["NAMES", "draw_figures", "plot_reference", "plot_schedule"]

NAMES = ("scene", "scene_3d", "distance", "modes", "margin")
"""Figures of a run folder."""


def plot_reference(safety: Safety, ax: Any = None) -> Any:
    """Draw the safe reference among the unsafe sets, with the recoverable sets about it.

    Parameters
    ----------
    safety : Safety
        Result of `get_safety`.
    ax : matplotlib axes, optional
        A new figure's if not given.

    Returns
    -------
    matplotlib axes
    """
    from ...model.checks import of_kind
    from ...runs.picture import picture_of_safety
    from ...synthesis.get_safety import Safety

    of_kind("safety", safety, Safety, "polaris.get_safety")
    return _plot(picture_of_safety(safety), ax)


def plot_schedule(schedule: Schedule, ax: Any = None) -> Any:
    """Draw the paper's Figure 2: trajectory by mode, tube, reference, unsafe sets.

    Parameters
    ----------
    schedule : Schedule
        Result of `synthesize`.
    ax : matplotlib axes, optional
        A new figure's if not given.

    Returns
    -------
    matplotlib axes
    """
    from ...model.checks import of_kind
    from ...runs.picture import picture_of
    from ...synthesis.schedule import Schedule

    of_kind("schedule", schedule, Schedule, "polaris.synthesize")
    return _plot(picture_of(schedule), ax)


def _plot(picture: Picture, ax: Any) -> Any:
    from ..scene.scene import describe
    from .scene import draw_scene, scene_figure
    from .style import WIDTH, keep_ticks, style

    with style():
        if ax is not None:
            draw_scene(ax, describe(picture))
            keep_ticks([ax])
            return ax
        from matplotlib import pyplot

        shown = lambda height: pyplot.figure(figsize=(WIDTH, height), layout="constrained")  # noqa: E731
        return scene_figure(shown, picture)[1]


def draw_figures(picture: Picture, folder: Path) -> list[Path]:
    """Draw and write a run folder's figures, each as PDF and PNG; same picture, same bytes.

    Parameters
    ----------
    picture : Picture
        With a schedule and its flights.
    folder : Path
        Must exist.
    """
    from .style import new_figure, printing, save

    written: list[Path] = []
    with printing():
        for name in NAMES:
            if name == "scene_3d" and picture.system.d == 1:
                continue
            figure = _FIGURES[name](picture, new_figure)
            written += save(figure, folder, name)
    return written


def _scene(picture: Picture, new_figure: Any) -> Any:
    from .scene import scene_figure

    return scene_figure(new_figure, picture)[0]


def _scene_3d(picture: Picture, new_figure: Any) -> Any:
    from .scene3d import draw_scene_3d
    from .style import legend_rows

    space = picture.system.d == 3
    figure = new_figure(2.5 if space else 3.0)
    figure.set_layout_engine(None)
    # The axes draw their own labels outside of what matplotlib takes for their box.
    place = (-0.1, -0.07, 1.1, 1.08) if space else (-0.05, 0.03, 1.0, 0.93)
    ax = figure.add_axes(place, projection="3d", computed_zorder=False)
    draw_scene_3d(ax, picture)
    handles, _ = ax.get_legend_handles_labels()
    columns, names = legend_rows(handles, figure.get_figwidth(), 2)
    figure.legend(handles, names, loc="upper left", ncols=columns)
    return figure


def _distance(picture: Picture, new_figure: Any) -> Any:
    from .style import keep_ticks
    from .timelines import draw_distance, draw_input, mode_strip

    figure = new_figure(3.6)
    upper, lower = figure.subplots(2, 1, sharex=True)
    draw_distance(upper, picture)
    draw_input(lower, picture)
    mode_strip(lower, picture)
    keep_ticks(figure.axes)
    return figure


def _modes(picture: Picture, new_figure: Any) -> Any:
    from .style import keep_ticks
    from .timelines import draw_modes

    figure = new_figure(0.6 + 0.28 * len(picture.controllers))
    draw_modes(figure.add_subplot(), picture)
    keep_ticks(figure.axes)
    return figure


def _margin(picture: Picture, new_figure: Any) -> Any:
    from .style import keep_ticks
    from .timelines import draw_margin

    figure = new_figure(2.4)
    figure.set_figheight(2.1 + draw_margin(figure.add_subplot(), picture))
    keep_ticks(figure.axes)
    return figure


_FIGURES = dict(zip(NAMES, (_scene, _scene_3d, _distance, _modes, _margin), strict=True))
