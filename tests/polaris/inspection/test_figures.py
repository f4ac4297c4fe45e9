"""Figures of the inspection problem: drawn from files alone, the same bytes, nothing outside the page."""

import numpy as np
import pytest
from typer.testing import CliRunner

from polaris.cli import app as cli
from polaris.report.figures import draw_figures, inspection
from polaris.report.figures import flight as figures
from polaris.report.figures.inspection import failures, initial_conditions
from polaris.report.figures.style import style
from polaris.runs.inspections.fuel_limit import fly_fuel
from polaris.runs.inspections.inspection import fly_flight
from polaris.runs.inspections.monte_carlo import CampaignData
from polaris.scenario.scenario import load_scenario


def invoke(*args):
    return CliRunner().invoke(cli.app, list(map(str, args)))


@pytest.fixture(scope="module")
def run():
    return fly_flight(load_scenario("inspection").with_assignments(["flight.duration_s=30"])).run


def inside(figure):
    """Every label, tick and legend lies on the page."""
    figure.draw_without_rendering()
    page = figure.bbox
    for ax in figure.axes:
        box = ax.get_tightbbox()
        if box is not None and ax.axison:
            assert box.x0 >= page.x0 - 1 and box.x1 <= page.x1 + 1, (box, page)
            assert box.y0 >= page.y0 - 1 and box.y1 <= page.y1 + 1, (box, page)


@pytest.mark.parametrize("name", ["speed", "separation", "sun", "deputy_sun", "velocity", "delta_v"])
def test_figure_fits_its_page_and_shows_the_data(run, name):
    with style():
        figure = figures.FIGURES[name](run)
        inside(figure)
    if name == "separation":
        lines = [line for line in figure.axes[0].get_lines() if len(line.get_xdata()) == len(run.t)]
        i, j = run.inspection.pairs[3]
        assert len(lines) == len(run.inspection.pairs)
        assert np.allclose(lines[3].get_ydata(), np.linalg.norm(run.x[:, i, :3] - run.x[:, j, :3], axis=1))


@pytest.mark.slow
def test_fuel_figures_are_drawn_with_and_without_a_switch(tmp_path):
    for delta_v, duration, switched in ((0.0, 40, False), (19.0, 200, True)):
        scenario = load_scenario("fuel-limit").with_assignments(
            [f"flight.duration_s={duration}", f"fuel.spent_m_s={delta_v}", "fuel.predictions=3"]
        )
        run = fly_fuel(scenario)
        assert (run.latched_at is not None) == switched
        names = {path.name for path in draw_figures(run, tmp_path, inspection.FUEL_FIGURES)}
        assert names == {f"{name}.{kind}" for name in ("path", "fuel", "thrust") for kind in ("pdf", "png")}


@pytest.mark.parametrize("studies", [1, 3, 4])
def test_campaign_shows_successes_and_failures(studies):
    x = np.random.default_rng(0).uniform(-900, 900, (6, 3, 6))
    success, failed = np.ones((studies, 6), dtype=bool), np.zeros((studies, 6, 3), dtype=bool)
    success[0, 2], failed[0, 2, 1] = False, True
    counts = np.eye(studies, 1, dtype=int)
    names = tuple(f"study-{k}" for k in range(studies))
    picture = CampaignData(x, names, success, failed, ("phi5",), counts)
    with style():
        figure = initial_conditions(picture)
        red = figure.axes[0].collections[1].get_offsets()
        assert np.allclose(red, x[2, 1, [1, 0]]) and "83.33% of 6" in figure.axes[0].get_title()
        inside(figure)
        bars = failures(picture)
        assert [patch.get_width() for patch in bars.axes[0].patches] == counts[:, 0].tolist()
        inside(bars)


@pytest.mark.slow
def test_plot_redraws_the_same_bytes_from_the_files_alone(tmp_path, monkeypatch):
    monkeypatch.setattr(figures, "FIGURES", {name: figures.FIGURES[name] for name in ("speed", "sun")})
    assert invoke("run", "inspection", "--set", "flight.duration_s=5", "--out", tmp_path / "a").exit_code == 0
    folder = tmp_path / "a" / "figures"
    before = {path.name: path.read_bytes() for path in folder.glob("[!.]*")}
    assert sorted(before) == ["speed.pdf", "speed.png", "sun.pdf", "sun.png"]
    for path in folder.iterdir():
        path.unlink()
    done = invoke("plot", tmp_path / "a")
    assert done.exit_code == 0 and "sun.png" in done.stdout
    assert {path.name: path.read_bytes() for path in folder.glob("[!.]*")} == before


@pytest.mark.slow
def test_every_figure_of_a_flight_is_drawn(run, tmp_path):
    drawn = {path.name for path in draw_figures(run, tmp_path, figures.FIGURES)}
    assert drawn == {f"{name}.{kind}" for name in figures.FIGURES for kind in ("pdf", "png")}
