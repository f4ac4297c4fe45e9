"""Figures for print: the scene with its modes, distance and thrust, timeline, containment margin."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from ...model.checks import of_kind
from ...runs.build_plot_data import safety_plot_data, schedule_plot_data
from ...runs.files.folder import RunFolder
from ...runs.plot_data import PlotData
from ...synthesis.safety.get_safety import Safety
from ...synthesis.schedule.schedule import Schedule
from ..scene.scene import describe
from .scene import draw_scene, scene_figure
from .style import WIDTH, keep_ticks, save_all, style
from .timelines import distance_figure, margin_figure, modes_figure

__all__ = ["FIGURES", "draw_figures", "draw_run", "plot_reference", "plot_schedule"]


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
    of_kind("safety", safety, Safety, "polaris.get_safety")
    return _plot(safety_plot_data(safety), ax)


def plot_schedule(schedule: Schedule, ax: Any = None) -> Any:
    """Draw the paper's Figure 2: trajectory by mode, tube, reference, unsafe sets.

    Parameters
    ----------
    schedule : Schedule
        Result of `synthesize`.
    ax
        As for `plot_reference`, which returns the axes too.
    """
    of_kind("schedule", schedule, Schedule, "polaris.synthesize")
    return _plot(schedule_plot_data(schedule), ax)


def _plot(picture: PlotData, ax: Any) -> Any:
    with style():
        if ax is not None:
            draw_scene(ax, describe(picture))
            keep_ticks([ax])
            return ax
        from matplotlib import pyplot  # it may look for a screen

        def new(height: float) -> Any:
            return pyplot.figure(figsize=(WIDTH, height), layout="constrained")

        return scene_figure(picture, new).axes[0]


def draw_run(folder: RunFolder) -> list[Path]:
    """Draw the figures of a run folder from its files alone; older ones stay until all are drawn.

    Parameters
    ----------
    folder : RunFolder
        Of any kind, as from `polaris.read_run`.

    Returns
    -------
    list of Path
        PDF and PNG files in its folder ``figures``.

    Raises
    ------
    ScenarioError
        If a file is missing or damaged, or the place cannot be written to.
    """
    from ...runs.files.atomic import adding
    from . import comparison, flight, inspection

    by_kind: dict[str, Mapping[str, Figure]] = {
        "schedule": FIGURES,
        "inspection": flight.FIGURES,
        "fuel_limit": inspection.FUEL_FIGURES,
        "monte_carlo": inspection.FIGURES,
        "comparison": comparison.FIGURES,
        "tradeoff": comparison.TRADEOFF,
    }
    picture = folder.plot_data()
    if folder.kind.name == "mission":
        return [path for leg in picture.legs for path in draw_run(leg)]
    with adding(folder.path, "figures") as staging:
        names = [path.name for path in draw_figures(picture, staging, by_kind[folder.kind.name])]
    return [folder.path / "figures" / name for name in names]


Figure = Callable[[Any], Any]
"""Draws one figure of what a run folder shows; nothing if there is nothing to be seen."""

FIGURES: Mapping[str, Figure] = {  # figures of a schedule, by name
    "scene": scene_figure,
    "distance": distance_figure,
    "modes": modes_figure,
    "margin": margin_figure,
}


def draw_figures(picture: Any, folder: Path, figures: Mapping[str, Figure] = FIGURES) -> list[Path]:
    """Draw and write figures into a folder, each as PDF and PNG; same picture, same bytes."""
    drawn = ((name, draw(picture)) for name, draw in figures.items())
    return save_all(((name, figure) for name, figure in drawn if figure is not None), folder)
