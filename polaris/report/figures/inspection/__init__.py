"""Figures of the inspection problem: figures 6 to 9 of the paper, from a run folder's files.

matplotlib is imported when the first figure is drawn.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ....inspection.flights.simulation import InspectionRun

if TYPE_CHECKING:
    from ....inspection.flights.fuel_run import FuelRun
    from ....runs.monte_carlo import CampaignPicture

FLIGHT_FIGURES = (
    "overview",
    "speed",
    "velocity",
    "separation",
    "sun",
    "deputy_sun",
    "passive",
    "thrust",
    "delta_v",
    "paths_3d",
)
"""Figures of a flight."""


def draw_flight(run: InspectionRun, folder: Path) -> list[Path]:
    """Draw and write the figures of one flight, each as PDF and PNG; same flight, same bytes.

    Parameters
    ----------
    run : InspectionRun
    folder : Path
        Must exist.
    """
    from ..style import printing, save

    alone = run.inspection.deputies == 1
    written: list[Path] = []
    with printing():
        for name in FLIGHT_FIGURES:
            if not (alone and name in ("separation", "deputy_sun")):
                written += save(_FIGURES[name](run), folder, name)
    return written


def draw_fuel_run(run: FuelRun, folder: Path) -> list[Path]:
    """Draw and write the figures of a flight into the fuel limit, each as PDF and PNG.

    Parameters
    ----------
    run : FuelRun
    folder : Path
        Must exist.
    """
    from ..style import new_figure, printing, save
    from .fuel import draw_fuel, draw_fuel_thrust, draw_path

    written: list[Path] = []
    with printing():
        for name, draw, height in (
            ("path", draw_path, 2.0),
            ("fuel", draw_fuel, 2.6),
            ("thrust", draw_fuel_thrust, 2.4),
        ):
            figure = new_figure(height)
            draw(figure.add_subplot(), run)
            written += save(figure, folder, name)
    return written


def draw_campaign(picture: CampaignPicture, folder: Path) -> list[Path]:
    """Draw and write the figures of a campaign, each as PDF and PNG.

    Parameters
    ----------
    picture : CampaignPicture
    folder : Path
        Must exist.
    """
    from ..style import WIDTH, new_figure, printing, save
    from .monte_carlo import draw_failures, draw_initial_conditions

    count = len(picture.studies)
    columns = min(count, 2)
    rows = -(-count // columns)
    with printing():
        wide = new_figure(0.7 + 2.0 * rows, WIDTH if columns == 1 else 1.35 * WIDTH)
        axes = wide.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
        draw_initial_conditions(axes.ravel(), picture)
        bars = new_figure(0.8 + 0.5 * count, 1.35 * WIDTH)
        draw_failures(bars.add_subplot(), picture)
        return [*save(wide, folder, "initial_conditions"), *save(bars, folder, "failures")]


def _overview(run: InspectionRun) -> Any:
    from ..style import WIDTH, new_figure
    from .limits import draw_deputy_sun, draw_separation, draw_speed, draw_sun
    from .paths import draw_passive
    from .thrust import draw_all_thrust

    alone = run.inspection.deputies == 1
    figure = new_figure(7.2, 2 * WIDTH)
    axes = figure.subplots(3, 2)
    drawers: list[tuple[Any, Callable[..., None]]] = [
        (axes[0, 0], draw_speed),
        (axes[0, 1], draw_separation),
        (axes[1, 0], draw_sun),
        (axes[1, 1], draw_deputy_sun),
        (axes[2, 0], draw_passive),
        (axes[2, 1], draw_all_thrust),
    ]
    for letter, (ax, draw) in zip("abcdef", drawers, strict=True):
        if alone and draw in (draw_separation, draw_deputy_sun):
            ax.set_axis_off()
            continue
        draw(ax, run)
        ax.text(-0.16, 1.02, f"({letter})", transform=ax.transAxes, ha="right", va="bottom", fontsize=8)
    return figure


def _single(module: str, name: str, height: float) -> Callable[[InspectionRun], Any]:
    def draw(run: InspectionRun) -> Any:
        from importlib import import_module

        from ..style import new_figure

        figure = new_figure(height)
        getattr(import_module(f"{__name__}.{module}"), name)(figure.add_subplot(), run)
        return figure

    return draw


def _three(module: str, name: str) -> Callable[[InspectionRun], Any]:
    def draw(run: InspectionRun) -> Any:
        from importlib import import_module

        from ..style import new_figure

        figure = new_figure(3.9)
        getattr(import_module(f"{__name__}.{module}"), name)(figure.subplots(3, 1, sharex=True), run)
        return figure

    return draw


def _passive(run: InspectionRun) -> Any:
    from ..style import new_figure
    from .paths import draw_free_distance, draw_passive, nearest_deputy

    deputy = nearest_deputy(run)
    figure = new_figure(5.0)
    upper, lower = figure.subplots(2, 1, height_ratios=(1.4, 1))
    draw_passive(upper, run, deputy)
    draw_free_distance(lower, run, deputy)
    return figure


def _paths(run: InspectionRun) -> Any:
    from ..style import new_figure
    from .paths import draw_paths

    figure = new_figure(3.3)
    figure.set_layout_engine(None)
    ax = figure.add_axes((0.02, 0.05, 0.88, 0.86), projection="3d", computed_zorder=False)
    draw_paths(ax, run)
    figure.legend(*ax.get_legend_handles_labels(), loc="upper left", ncols=3)
    return figure


_FIGURES: dict[str, Callable[[InspectionRun], Any]] = {
    "overview": _overview,
    "speed": _single("limits", "draw_speed", 2.8),
    "velocity": _three("limits", "draw_velocity"),
    "separation": _single("limits", "draw_separation", 2.8),
    "sun": _single("limits", "draw_sun", 2.6),
    "deputy_sun": _single("limits", "draw_deputy_sun", 2.8),
    "passive": _passive,
    "thrust": _three("thrust", "draw_thrust"),
    "delta_v": _single("thrust", "draw_delta_v", 2.4),
    "paths_3d": _paths,
}
