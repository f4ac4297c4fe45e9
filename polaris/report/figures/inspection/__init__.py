"""Figures of the inspection problem: figures 6 to 9 of the paper, from a run folder's files.

matplotlib is imported when the first figure is drawn.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ....inspection.flights.simulation import InspectionRun
from ...scene import inspection as data
from ..style import WIDTH, new_figure, printing, save
from .charts import draw_chart, draw_free_distance, draw_speed
from .fuel import draw_fuel, draw_fuel_thrust, draw_path
from .monte_carlo import draw_failures, draw_initial_conditions
from .paths import draw_passive, draw_paths

if TYPE_CHECKING:
    from ....inspection.flights.fuel_run import FuelRun
    from ....runs.monte_carlo import CampaignPicture


def draw_flight(run: InspectionRun, folder: Path) -> list[Path]:
    """Draw and write the figures of one flight, each as PDF and PNG; same flight, same bytes.

    Parameters
    ----------
    run : InspectionRun
    folder : Path
        Must exist.
    """
    alone = run.inspection.deputies == 1
    names = [name for name in FLIGHT_FIGURES if not (alone and name in ("separation", "deputy_sun"))]
    return _written(((name, _FIGURES[name](run)) for name in names), folder)


def draw_fuel_run(run: FuelRun, folder: Path) -> list[Path]:
    """Draw and write the figures of a flight into the fuel limit, each as PDF and PNG.

    Parameters
    ----------
    run : FuelRun
    folder : Path
        Must exist.
    """
    drawers = (("path", draw_path, 2.0), ("fuel", draw_fuel, 2.6), ("thrust", draw_fuel_thrust, 2.4))
    return _written(((name, _panel(draw, height)(run)) for name, draw, height in drawers), folder)


def draw_campaign(picture: CampaignPicture, folder: Path) -> list[Path]:
    """Draw and write the figures of a campaign, each as PDF and PNG.

    Parameters
    ----------
    picture : CampaignPicture
    folder : Path
        Must exist.
    """

    def figures() -> Iterable[tuple[str, Any]]:
        count = len(picture.studies)
        columns = min(count, 2)
        rows = -(-count // columns)
        wide = new_figure(0.7 + 2.0 * rows, WIDTH if columns == 1 else 1.35 * WIDTH)
        axes = wide.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
        draw_initial_conditions(axes.ravel(), picture)
        yield "initial_conditions", wide
        bars = new_figure(0.8 + 0.5 * count, 1.35 * WIDTH)
        draw_failures(bars.add_subplot(), picture)
        yield "failures", bars

    return _written(figures(), folder)


def _written(figures: Iterable[tuple[str, Any]], folder: Path) -> list[Path]:
    with printing():
        return [path for name, figure in figures for path in save(figure, folder, name)]


def _panel(draw: Callable[[Any, Any], None], height: float) -> Callable[[Any], Any]:
    """A figure of one panel."""

    def drawn(run: Any) -> Any:
        figure = new_figure(height)
        draw(figure.add_subplot(), run)
        return figure

    return drawn


def _charts(height: float, charts: Callable[[InspectionRun], list[data.Chart]]) -> Callable[[Any], Any]:
    """A figure of charts over each other."""

    def drawn(run: InspectionRun) -> Any:
        figure, found = new_figure(height), charts(run)
        axes = figure.subplots(len(found), 1, sharex=True, squeeze=False).ravel()
        for ax, chart in zip(axes, found, strict=True):
            draw_chart(ax, run, chart, named=ax is axes[0])
            ax.set_xlabel("Time (s)" if ax is axes[-1] else "")
        return figure

    return drawn


def _overview(run: InspectionRun) -> Any:
    figure = new_figure(7.2, 2 * WIDTH)
    axes = figure.subplots(3, 2).ravel()
    draw_speed(axes[0], run)
    draw_chart(axes[2], run, data.sun_chart(run, False))
    if run.inspection.deputies > 1:
        draw_chart(axes[1], run, data.distance_chart(run))
        draw_chart(axes[3], run, data.sun_chart(run, True))
    else:
        axes[1].set_axis_off()
        axes[3].set_axis_off()
    draw_passive(axes[4], run)
    for chart in data.thrust_charts(run.inspection, run.u):
        draw_chart(axes[5], run, chart, width=0.35, named=False)
    axes[5].set_ylabel("Thrust (N)")
    for letter, ax in zip("abcdef", axes, strict=True):
        if ax.axison:
            ax.text(-0.16, 1.02, f"({letter})", transform=ax.transAxes, ha="right", va="bottom", fontsize=8)
    return figure


def _passive(run: InspectionRun) -> Any:
    figure, deputy = new_figure(5.0), data.nearest_deputy(run)
    upper, lower = figure.subplots(2, 1, height_ratios=(1.4, 1))
    draw_passive(upper, run, deputy)
    draw_free_distance(lower, run, deputy)
    return figure


def _paths(run: InspectionRun) -> Any:
    figure = new_figure(3.3)
    figure.set_layout_engine(None)
    ax = figure.add_axes((0.02, 0.05, 0.88, 0.86), projection="3d", computed_zorder=False)
    draw_paths(ax, run)
    figure.legend(*ax.get_legend_handles_labels(), loc="upper left", ncols=3)
    return figure


_FIGURES: dict[str, Callable[[InspectionRun], Any]] = {
    "overview": _overview,
    "speed": _panel(draw_speed, 2.8),
    "velocity": _charts(3.9, data.velocity_charts),
    "separation": _charts(2.8, lambda run: [data.distance_chart(run)]),
    "sun": _charts(2.6, lambda run: [data.sun_chart(run, False)]),
    "deputy_sun": _charts(2.8, lambda run: [data.sun_chart(run, True)]),
    "passive": _passive,
    "thrust": _charts(3.9, lambda run: data.thrust_charts(run.inspection, run.u)),
    "delta_v": _charts(2.4, lambda run: [data.spent_chart(run)]),
    "paths_3d": _paths,
}

FLIGHT_FIGURES = tuple(_FIGURES)
"""Figures of a flight."""
