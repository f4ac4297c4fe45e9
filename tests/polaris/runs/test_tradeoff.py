"""Trade-offs: points that are run folders, the front, resumed and killed, the command line, the figure."""

import csv
import itertools
import json
import os
import pickle
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from matplotlib.text import Text
from typer.testing import CliRunner

import polaris
from polaris.cli.app import app
from polaris.cli.compare import _sweep
from polaris.cli.show.comparison import _row, answered
from polaris.model.errors import PolarisError, ScenarioError
from polaris.report.figures.comparison import _front, _sensitivity
from polaris.report.figures.style import printing
from polaris.runs import tradeoff as module
from polaris.runs.campaign.workers import InProcess, Interrupted, Workers, local
from polaris.runs.schedule import DATA_FILES
from polaris.runs.tradeoff_points import needed, non_dominated
from polaris.scenario.scenario import load_scenario
from polaris.scenario.tables.errors import Chaser, ThrustersTable, TimingTable
from polaris.scenario.tables.faults import Loss, NavigationLost
from polaris.scenario.tables.navigation import EstimateTable, MeasurementTable, Phase
from tests.leftovers import left_by_a_dead_process
from tests.polaris.tiny import TINY

ROOT = Path(__file__).parents[3]
SET = ["recoverable.recourse=replan", "system.input_max=2.0", "simulation.runs=2"]
PRICES = [3, 0]
NAMES = ["price-0", "price-3", "printed"]
TABLES = ["tradeoff.csv", "scenario.toml"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("tradeoff") / "one"
    return polaris.tradeoff(TINY, place, PRICES, overrides=SET, draw=polaris.draw_run)


@pytest.fixture
def copied(folder, tmp_path):
    """A copy of the folder that a test may spoil."""
    return Path(shutil.copytree(folder.path, tmp_path / "one"))


@pytest.fixture
def computed(folder, monkeypatch):
    """Names of the points that are computed, which are copied from those that are known."""
    names = []

    def run(scenario, place, **_):
        names.append(place.name)
        shutil.rmtree(place, ignore_errors=True)
        shutil.copytree(folder.path / place.name, place)

    monkeypatch.setattr(module, "run", run)
    return names


def contents(path, names=(*TABLES, *(f"{name}/{file}" for name in NAMES for file in DATA_FILES))):
    return {name: (path / name).read_bytes() for name in names}


# -- points and front ---------------------------------------------------------------------------------


def test_points_are_run_folders_of_their_price(folder, tmp_path):
    rows = folder.summary["points"]
    assert [(row["folder"], row["value"]) for row in rows] == list(zip(NAMES, [0, 3, None], strict=True))
    alone = polaris.run(TINY, tmp_path / "alone", overrides=[*SET, "schedule.delta_v_price=3"])
    assert contents(alone.path, DATA_FILES) == contents(folder.path / "price-3", DATA_FILES)
    opened = {row["folder"]: polaris.read_run(folder.path / row["folder"]) for row in rows}
    assert opened["price-0"].scenario.switching_rules().delta_v_price == 0
    assert opened["printed"].scenario.model.recoverable.recourse == "none"
    for row in rows:
        kept = opened[row["folder"]].summary
        assert row["share"] == row["weighted_share"] == kept["synthesis"]["experimental_share"]
        assert row["switches"] == kept["synthesis"]["switches"]
        assert row["delta_v_m_s"] == kept["polaris"]["delta_v_m_s"] <= row["delta_v_max_m_s"]
        assert row["delta_v_undisturbed_m_s"] == pytest.approx(row["delta_v_m_s"], rel=0.1)
        assert (
            row["delta_v_most_m_s"] == kept["guarantee"]["goal"]["delta_v_max_m_s"] > row["delta_v_max_m_s"]
        )
        assert (row["goal_reached"], row["guarantee"], row["until_s"]) == (True, "proved", 20.0)


def test_a_price_buys_less_velocity_change_and_the_printed_schedule_is_outdone(folder):
    free, dear, printed = folder.summary["points"]
    assert free["share"] > dear["share"] and free["delta_v_m_s"] > dear["delta_v_m_s"]
    assert [row["non_dominated"] for row in (free, dear, printed)] == [True, True, False]


def test_the_table_says_the_same(folder):
    with (folder.path / "tradeoff.csv").open(encoding="utf-8", newline="") as file:
        read = list(csv.DictReader(file))
    texts = [{key: "" if v is None else str(v) for key, v in row.items()} for row in folder.summary["points"]]
    assert read == texts and polaris.read_run(folder.path).plot_data() == folder.summary["points"]


GOOD = {"weighted_share": 0.5, "delta_v_m_s": 1.0, "switches": 2, "goal_reached": True}
GOOD |= {"guarantee": "proved", "until_s": None}


@pytest.mark.parametrize(
    "worse",
    [
        {"weighted_share": 0.4},
        {"delta_v_m_s": 1.1},
        {"switches": 3},
        {"goal_reached": "not_proven"},
        {"guarantee": "none"},
        {"until_s": 100.0},
    ],
    ids=lambda worse: next(iter(worse)),
)
def test_front(worse):
    assert non_dominated([GOOD, GOOD | worse, GOOD]) == [True, False, True]
    better = {"delta_v_m_s": 0.9} if "delta_v_m_s" not in worse else {"switches": 1}
    assert non_dominated([GOOD, GOOD | worse | better]) == [True, True]


def test_weights_count(folder, tmp_path):
    path = shutil.copytree(folder.path / "price-0", tmp_path / "half")
    text = (path / "scenario.toml").read_text(encoding="utf-8")
    scenario = polaris.load_scenario(TINY, [*SET, "experimental[0].weight=0.5"])
    assert "weight = 1.0" in text
    run = polaris.RunFolder(path, scenario, polaris.read_run(folder.path / "price-0").kind)
    row = module.row_of(run, "half", module.PRICE, 0.0)
    assert row["weighted_share"] == row["share"] / 2 > 0


# -- resumed, killed, interrupted ----------------------------------------------------------------------


def again(path, prices=PRICES, overrides=SET, **how):
    return polaris.tradeoff(TINY, path, prices, overrides=overrides, **how)


def test_points_that_are_there_are_kept_and_others_computed(folder, copied, computed):
    before = contents(folder.path)
    assert contents(again(copied).path) == before and computed == []
    shutil.rmtree(copied / "price-3")
    left = left_by_a_dead_process(copied / "price-3")
    assert contents(again(copied).path) == before and computed == ["price-3"] and not left.exists()
    with pytest.raises(FileNotFoundError):  # a new price is asked for
        again(copied, [0, 3, 7])
    assert computed[1:] == ["price-7"] and contents(copied) == before


SLOW = [pytest.param(name, marks=pytest.mark.slow) for name in ("certificate.json", "trajectories.npz")]


@pytest.mark.parametrize("name", ["sets.npz", "summary.json", *SLOW])
def test_a_damaged_point_is_computed_again(name, folder, copied, computed):
    (copied / "price-0" / name).write_bytes(b"{}")
    assert contents(again(copied).path) == contents(folder.path) and computed == ["price-0"]


def test_points_of_other_scenarios_and_versions_are_computed_again(copied, computed, monkeypatch):
    again(copied, overrides=[*SET, "simulation.seed=1"])
    assert computed == NAMES
    computed.clear()
    monkeypatch.setattr(module, "versions", lambda: {"polaris": "another"})
    again(copied)
    assert computed == NAMES


def test_an_interrupted_one_goes_on_from_there(folder, computed, tmp_path, monkeypatch):
    run, counted = module.run, []

    def interrupted(scenario, place, **_):
        if place.name == "price-3":
            raise KeyboardInterrupt
        run(scenario, place)

    with monkeypatch.context() as patched:
        patched.setattr(module, "run", interrupted)
        with pytest.raises(Interrupted, match="goes on from there"):
            again(tmp_path / "one")
    stages = polaris.Stages()
    stages.note = lambda text, done=0, total=None: counted.append((done, total))
    again(tmp_path / "one", stages=stages)
    assert computed == NAMES and counted[:3] == [(1, 3), (2, 3), (3, 3)]
    assert contents(tmp_path / "one") == contents(folder.path)


KILLED = """
import os, shutil, signal, sys
from polaris.runs import schedule, tradeoff
known, out, tiny, *overrides = sys.argv[1:]
run = tradeoff.run
def copying(scenario, place, **_):
    if place.name == "price-0":
        shutil.copytree(f"{known}/price-0", place)
    else:
        run(scenario, place)
tradeoff.run = copying
schedule.write_certificate = lambda *args: os.kill(os.getpid(), signal.SIGKILL)
tradeoff.tradeoff(tiny, out, [0, 3], overrides=overrides)
"""


@pytest.mark.slow
def test_a_killed_one_goes_on_from_there(folder, computed, tmp_path):
    command = [sys.executable, "-c", KILLED, str(folder.path), str(tmp_path / "one"), str(TINY), *SET]
    done = subprocess.run(command, env={**os.environ, "PYTHONPATH": str(ROOT)}, timeout=120, check=False)
    left = sorted(path.name for path in (tmp_path / "one").iterdir())
    assert done.returncode == -9 and left[0].startswith(".polaris") and left[2:] == ["price-0"], left
    assert left[1].startswith(".price-3.new-"), "half written"
    assert contents(again(tmp_path / "one").path) == contents(folder.path)
    assert computed == ["price-3", "printed"]
    assert not list((tmp_path / "one").glob(".p*.new-*"))


class Lost(InProcess):
    """Loses its worker."""

    def submit(self, fn, /, *args, **kwargs):
        raise OSError


def test_a_lost_worker_is_told(tmp_path):
    with pytest.raises(PolarisError, match="a worker was lost.*goes on from there"):
        again(tmp_path / "one", executor=Workers(Lost, lambda: 1, lost=(OSError,)))


@pytest.mark.slow
def test_a_pool_gives_the_same_and_tells_why_there_is_no_schedule(monkeypatch, tmp_path):
    monkeypatch.setattr("polaris.runs.build_plot_data.SLICES", 240)  # as in new processes (see `few_slices`)
    assert contents(again(tmp_path / "one", executor=local(2)).path) == contents(again(tmp_path / "in").path)
    with pytest.raises(PolarisError, match=r"(price-\d|printed): .*feasible") as raised:
        again(tmp_path / "two", overrides=[*SET[:1], "system.input_max=0.05"], executor=local(2))
    assert raised.value.exit_code == 3


# -- other fields than the price ------------------------------------------------------------------------

KEY, FEW = "system.input_max", ["simulation.runs=2"]


@pytest.fixture(scope="module")
def swept(tmp_path_factory):
    place = tmp_path_factory.mktemp("sweep") / "one"
    return polaris.tradeoff(TINY, place, {KEY: [2, 0.05, 1]}, share=0.2, overrides=FEW, draw=polaris.draw_run)


def test_a_value_without_a_schedule_is_a_result_and_the_rest_is_as_run_alone(swept, tmp_path):
    rows = swept.summary["points"]
    assert [(row["field"], row["value"]) for row in rows] == [(KEY, 0.05), (KEY, 1), (KEY, 2)]
    assert rows[0]["guarantee"] == "infeasible" and "tracker" in rows[0]["reason"] and not rows[0]["share"]
    alone = polaris.run(TINY, tmp_path / "alone", overrides=[*FEW, f"{KEY}=2"])
    assert contents(alone.path, DATA_FILES) == contents(swept.path / f"{KEY}-2", DATA_FILES)
    assert rows[1]["share"] < 0.2 < rows[2]["share"] and rows[2]["reason"] is None
    (asked,) = swept.summary["needed"]
    assert (asked["bound"], asked["last_proven"], asked["next"]) == ("at least", 2, 1)
    assert 1 < asked["interpolated"] < 2
    assert (swept.path / "figures" / "tradeoff.png").is_file()


def test_what_is_infeasible_is_not_asked_again(swept, tmp_path, monkeypatch):
    copied = Path(shutil.copytree(swept.path, tmp_path / "one"))
    monkeypatch.setattr(module, "run", lambda scenario, place, **_: 1 / 0)
    again = polaris.tradeoff(TINY, copied, {KEY: [0.05, 1, 2]}, share=0.2, overrides=FEW)
    assert again.summary["points"] == swept.summary["points"]
    with pytest.raises(ZeroDivisionError):  # another scenario
        polaris.tradeoff(TINY, copied, {KEY: [0.05]}, overrides=["system.disturbance_max=0.01"])


@pytest.mark.filterwarnings("error:constrained_layout")
def test_figures_of_fields_are_laid_out_with_infeasible_values_and_without(swept):
    rows = swept.summary["points"]
    other = [row | {"field": "other", "value": 0.1 * row["value"]} for row in rows[1:]]
    for points, fields in (([*rows, *other], 2), (other, 1)):
        with printing():
            figure = _sensitivity(points)
            figure.draw_without_rendering()
        assert [ax.get_xlabel() for ax in figure.axes[:fields]] == [KEY, "other"][-fields:]
        assert all(ax.get_position().height > 0.2 for ax in figure.axes)


def test_how_far_a_value_may_go():
    def row(value, share):
        return {
            "field": "f",
            "value": value,
            "share": share,
            "guarantee": "proved" if share else "infeasible",
        }

    falling = [row(4, None), row(1, 0.95), row(2, 0.93), row(3, 0.85)]
    answer = needed(falling, "f", 0.9)
    assert (answer["bound"], answer["last_proven"], answer["next"]) == ("at most", 2, 3)
    assert answer["interpolated"] == pytest.approx(2 + 0.03 / 0.08) and "about 2.375" in answered(answer)
    beyond = needed(falling, "f", 0.8)
    assert (beyond["last_proven"], beyond["interpolated"]) == (3, None)
    assert "infeasible at 4" in answered(beyond)
    assert needed(falling, "f", 0.99)["last_proven"] is None
    assert "no further value" in answered(needed(falling[1:], "f", 0.8))


# -- what is refused ------------------------------------------------------------------------------------


@pytest.mark.parametrize("prices", [[], [-0.1], [0.1, 0.2, 0.1], [0.0, -0.0], [float("nan")], ["x"]], ids=str)
def test_prices_that_make_no_sense(prices, tmp_path):
    with pytest.raises(ScenarioError, match="prices"):
        polaris.tradeoff(TINY, tmp_path / "one", prices, overrides=SET)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("text", ["schedule.delta_v_price=1", "recoverable.recourse=none"])
def test_overrides_that_are_its_own(text, tmp_path):
    with pytest.raises(ScenarioError, match="must be left out"):
        polaris.tradeoff(TINY, tmp_path / "one", [0], overrides=[*SET[:1], text])


def test_folders_of_others_are_left_alone(folder, copied, tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes").write_text("mine", encoding="utf-8")
    for place, word in ((copied / "price-0", "give another folder"), (tmp_path / "mine", "other contents")):
        with pytest.raises(ScenarioError, match=word):
            again(place)
    assert contents(copied) == contents(folder.path)
    with pytest.raises(ScenarioError, match="of a trade-off"):
        polaris.write_report(copied)


# -- command line ---------------------------------------------------------------------------------------


def invoke(*args):
    given = [str(TINY), "--workers", "1", "--set", SET[0], *map(str, args)]
    return CliRunner().invoke(app, ["tradeoff", *given])


def test_command(copied, computed):
    given = ["--out", copied, "--prices", "0,3", *itertools.chain(*(("--set", text) for text in SET[1:]))]
    done = invoke(*given)
    assert done.exit_code == 0, done.output
    lines = [line.split()[:3] for line in done.stdout.splitlines()]
    assert ["*", "price-0", "83.3%"] in lines and ["*", "price-3", "41.7%"] in lines
    assert ["printed", "41.7%", "2"] in lines and (copied / "figures" / "tradeoff.pdf").is_file()
    printed = invoke(*given, "--json", "--no-figures")
    assert json.loads(printed.stdout) == json.loads((copied / "tradeoff.json").read_text(encoding="utf-8"))
    assert not (copied / "figures").exists()
    assert (invoke(*given, "-q").output, computed) == ("", [])


def test_a_proven_bound_is_rounded_up_and_one_from_samples_is_not_shown(folder):
    point = folder.summary["points"][0] | {"delta_v_most_m_s": 1.00001}
    assert _row(point)[5] == "1.001"
    assert _row(point | {"guarantee": "statistical"})[5:8:2] == ("statistical", "statistical")


@pytest.mark.parametrize(
    ("given", "code"),
    [(["--prices", "0,,1"], 2), (["--prices=-1"], 2), (["--set", "system.input_max=0.05"], 3)],
    ids=str,
)
def test_exit_codes(given, code, tmp_path):
    done = invoke("--out", tmp_path / "one", "-q", *given)
    assert (done.exit_code, done.stderr[:6], done.stderr.count("\n")) == (code, "error:", 1), done.output
    assert not (tmp_path / "one").exists(), "nothing is left of what came to nothing"


def test_sweeps_on_the_command_line(swept, tmp_path):
    copied = Path(shutil.copytree(swept.path, tmp_path / "one"))
    given = [
        str(TINY),
        "--out",
        str(copied),
        "--no-figures",
        "--workers",
        "1",
        "--share",
        "0.2",
        "--set",
        *FEW,
    ]
    done = CliRunner().invoke(app, ["tradeoff", *given, "--sweep", f"{KEY}=0.05,1,2"])
    assert done.exit_code == 0, done.output
    assert f"{KEY}-0.05  infeasible" in done.stdout and f"{KEY}: at least 2 for 20 %" in done.stdout
    for wrong in (f"{KEY}", f"{KEY}=a", f"{KEY}=1:2", f"{KEY}=2:1:3", f"{KEY}=1,1", "system.nothing=1"):
        done = CliRunner().invoke(app, ["tradeoff", *given, "--sweep", wrong])
        assert (done.exit_code, done.stderr[:6]) == (2, "error:"), wrong
    assert _sweep(f"{KEY}=0.01:1:3") == (KEY, [0.01, 0.1, 1.0])


# -- figure ---------------------------------------------------------------------------------------------


def test_figure_is_redrawn_from_the_files_alone(folder, copied):
    figures = copied / "figures"
    shutil.rmtree(figures)
    assert polaris.draw_run(polaris.read_run(copied)) == [figures / "tradeoff.pdf", figures / "tradeoff.png"]
    assert (figures / "tradeoff.png").read_bytes() == (folder.path / "figures" / "tradeoff.png").read_bytes()


def test_labels_lie_beside_one_another_and_say_price_and_switches(folder):
    row, rows = folder.summary["points"][0], []
    for i in range(9):
        place = {"weighted_share": 0.9 + 1e-3 * (i % 3), "delta_v_m_s": 1 + 1e-3 * i, "switches": i}
        rows.append(row | {"value": i / 10} | place)
    rows += [row | {"value": price, "weighted_share": 0.5} for price in (1, 2, 3, None)]
    with printing():
        figure = _front(rows)
        figure.draw_without_rendering()
        boxes = [
            Text.get_window_extent(text) for text in figure.axes[0].texts
        ]  # without the line to its point
        whole = figure.bbox
    texts = {text.get_text() for text in figure.axes[0].texts}
    assert len(boxes) == 10 and texts > {"price 0.1, 1 switch", "price 1 to 3, printed, 2 switches"}
    assert not any(one.overlaps(other) for one, other in itertools.combinations(boxes, 2))
    assert all(whole.x0 <= box.x0 and box.x1 <= whole.x1 and whole.y0 <= box.y0 for box in boxes)


def test_every_error_source_can_be_swept():
    """Each number of its tables is a key of its own, and another value another problem."""
    tables = {
        "navigation": (EstimateTable, ["state_error"]),
        "navigation.measurement": (MeasurementTable, ["matrix", "error", "initial"]),
        "navigation.measurement.initial": (EstimateTable, ["state_error"]),
        "navigation.phases[0]": (Phase, ["state_error"]),
        "thrusters": (
            ThrustersTable,
            ["remainder", "pulse", "resolution", "directions", "thrust_max_N", "allocation", "errors_vary"],
        ),
        "timing": (TimingTable, []),
        "chaser": (Chaser, []),
        "faults[0]": (Loss, ["kind"]),
        "faults[1]": (NavigationLost, ["kind"]),
    }
    more = {
        "navigation": ["navigation.within_m=2500"],
        "navigation.measurement": ["navigation.measurement={position_error_m=0.05, within_m=2500}"],
        "navigation.measurement.initial": [
            "navigation.measurement={position_error_m=0.05, initial={velocity_error_m_s=0.05}}"
        ],
        "navigation.phases[0]": ["navigation.phases=[{from_s=600, position_error_m=0.1, within_m=2500}]"],
        "thrusters": ["thrusters.remainder=carried", "thrusters.pulse=centred"],
        "faults[0]": ["faults=[{kind='loss', share=0.1, isolation_s=2}]"],
        "faults[1]": [
            "faults=[{kind='loss', share=0.1, isolation_s=2}, {kind='navigation_lost', lasts_s=2}]"
        ],
    }
    for table, (kind, others) in tables.items():
        sampled = ["feedback.period_s=2", *more.get(table, [])]
        scenario = load_scenario("static", sampled)
        base = pickle.dumps(scenario.problem())
        for name in set(kind.model_fields) - set(others):
            seconds = name in ("from_s", "isolation_s", "lasts_s")
            value = 30 if seconds else {"missed_periods": 1, "within_m": 3000}.get(name, 0.02)
            ((field, number),) = module._named({f"{table}.{name}": [value]}).values()
            text = f"{field}={repr(number).removesuffix('.0')}"
            assert pickle.dumps(scenario.with_assignments([text]).problem()) != base, text
