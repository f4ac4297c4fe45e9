"""The gallery of published missions: files, page and benchmark agree; runs give what the page says."""

import json
import re
import tomllib

import numpy as np
import pytest

import polaris
from benchmarks import missions
from polaris.certificate.checker import verify
from polaris.simulation.simulate import simulate
from tests.test_docs import DOCS

FILES = {path.stem: tomllib.loads(path.read_text()) for path in sorted(missions.FOLDER.glob("*.toml"))}
NAMES = [name for name, data in FILES.items() if "kind" not in data]
CHAINS = [name for name, data in FILES.items() if data.get("kind") == "mission"]
TEXT = missions.PAGE.read_text(encoding="utf-8")


def cells(name):
    """Cells of a row of the page by their heads."""
    parts = [cell.strip() for cell in missions.page_rows()[name].strip("|").split("|")]
    return dict(zip(missions.HEADS, parts, strict=True))


def numbers(text):
    return [float(digits) for digits in re.findall(r"-?\d+(?:\.\d+)?", text)]


def test_every_file_has_a_figure_a_row_a_section_and_a_picture():
    assert sorted(missions.PUBLISHED) == sorted(missions.page_rows()) == NAMES
    for name in NAMES:
        section = TEXT.split(f"\n## {name}\n")[1].split("\n## ")[0]
        assert f"(figures/mission-{name}.png)" in section and "**Source.**" in section
        assert "| Given | Our choice |" in section
        assert re.search(r"\*\*[Pp]ublished\*\*", section)
        assert (DOCS / "figures" / f"mission-{name}.png").stat().st_size > 10_000
    assert missions.table(missions.page_rows()) in TEXT
    assert sorted(NAMES + CHAINS) == sorted(FILES)
    assert all(f"`polaris run scenarios/missions/{name}.toml`" in TEXT for name in CHAINS)


def test_what_the_page_must_show():
    """All are proved and verified within a minute; two cannot be flown by U alone; SROC is cheap."""
    rows = {name: cells(name) for name in NAMES}
    for row in rows.values():
        assert row["Checker"] == "VERIFIED" and re.match("for all time|until", row["Proven safe"])
        assert float(row["Synthesis [CPU-s]"]) <= 60
        assert row["under the schedule"] == "none" or float(row["under the schedule"]) > 0
    alone = {name: row["Least distance [m], U alone"] for name, row in rows.items()}
    enter = {name: int(re.search(r"(\d+) of 100 runs enter", cell)[1]) for name, cell in alone.items()}
    assert len([name for name in NAMES if numbers(alone[name])[0] < 0]) >= 2
    assert enter["afrl-docking"] == 100
    assert numbers(rows["afrl-docking"]["U flies"])[0] >= 25
    assert float(rows["afrl-docking"]["proven at most"]) <= 40
    assert float(rows["sroc-leg1"]["proven at most"]) <= 0.45
    assert numbers(rows["adras-j"]["U flies"])[0] >= 90


def test_the_disturbance_of_the_eccentric_orbit_covers_400_m(capsys):
    from typer.testing import CliRunner

    from polaris.cli import app as cli

    arguments = ["model-error", str(missions.FOLDER / "adras-j.toml"), "--within", "400"]
    done = CliRunner().invoke(cli.app, arguments)
    assert done.exit_code == 0 and "covers it" in done.stdout


def test_the_first_leg_of_sroc_costs_what_the_page_says():
    schedule = polaris.synthesize(polaris.load_scenario(missions.FOLDER / "sroc-leg1.toml"))
    row, delta_v = cells("sroc-leg1"), simulate(schedule, 20, 0).delta_v
    assert schedule.guarantee == "proved"
    assert delta_v.mean() == pytest.approx(float(row["Ours, mean [m/s]"]), rel=0.03)
    assert delta_v.max() <= schedule.arrival.delta_v <= 1.02 * float(row["proven at most"])
    assert 100 * schedule.share() == pytest.approx(numbers(row["U flies"])[0], abs=0.1)


def test_docking_keeps_the_limit_of_speed_that_its_primary_controller_breaks():
    """By the published formula; shares and 2-norms are what the page says."""
    schedule = polaris.synthesize(polaris.load_scenario(missions.FOLDER / "afrl-docking.toml"))
    excess, delta_v = {}, {}
    for mode in (None, 1):
        runs = simulate(schedule, 10, 0, mode=mode, disturbance="mixed")
        far, speed = (np.linalg.norm(part, axis=-1) for part in np.split(runs.states, 2, axis=-1))
        excess[mode] = speed - (0.2 + 4 * 0.001027 * far)
        assert np.array_equal(runs.metrics().collided, np.full(10, mode == 1))
        delta_v[mode] = np.linalg.norm(runs.inputs, axis=-1).sum(axis=1).max() * 5.0 / 12.0
    assert excess[None].max() < 0 and (excess[1].max(axis=1) > 29).all()
    section = TEXT.split("\n## afrl-docking\n")[1].split("\n## ")[0]
    spoken = re.search(r"Ours in that norm: ([\d.]+) m/s .* and ([\d.]+) m/s for U alone", section, re.DOTALL)
    assert [delta_v[None], delta_v[1]] == pytest.approx([float(x) for x in spoken.groups()], rel=5e-3)
    ends = np.minimum(50.0 * np.arange(61), 2240.0)
    share = np.diff(ends)[np.asarray(schedule.modes) > 0].sum() / 2240.0
    assert float(re.search(r"Until 2240 s its share is\s+([\d.]+) %", section)[1]) == pytest.approx(
        100 * share, abs=0.05
    )


def test_rendezvous_drifts_clear_of_the_target_wherever_thrust_stops_after_the_first_step():
    schedule = polaris.synthesize(polaris.load_scenario(missions.FOLDER / "arch-rendezvous.toml"))
    passive = schedule.passive
    assert schedule.guarantee == "proved" and schedule.share() == 1.0
    assert np.array_equal(passive.clear, np.arange(60) > 0)
    assert passive.flight.abort.horizon == 300 * 60
    assert passive.least == pytest.approx(0.8, abs=0.02)


@pytest.mark.slow
def test_the_chain_of_sroc_is_verified_within_its_published_cost_and_drifts_clear_of_the_target(tmp_path):
    polaris.run(polaris.load_scenario(missions.FOLDER / "sroc.toml"), tmp_path / "run")
    assert verify(tmp_path / "run").outcome == "VERIFIED"
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())["mission"]
    section = TEXT.split("\n## sroc\n")[1]
    proven = float(re.search(r"at most\s+\*\*([\d.]+) m/s\*\*", section)[1])
    assert summary["delta_v_max_m_s"] <= proven <= 1.02 * summary["delta_v_max_m_s"] and proven <= 1.31
    inspection = next(leg for leg in summary["legs"] if leg["name"] == "inspection")
    assert inspection["drift_s"] >= 2 * np.pi / 0.0011313 - 12.0


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_rows_are_what_a_run_gives(name, tmp_path):
    result = missions.run(name, tmp_path)
    parts = [cell.strip() for cell in result.row.strip("|").split("|")]
    printed = cells(name)
    for head, real in zip(missions.HEADS, parts, strict=True):
        if head not in ("Synthesis [CPU-s]", "Mission"):
            assert numbers(real) == pytest.approx(numbers(printed[head]), rel=0.03, abs=0.06), head
            assert re.sub(r"[-\d.]+", "", real) == re.sub(r"[-\d.]+", "", printed[head])
