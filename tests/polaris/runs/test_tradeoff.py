"""Trade-offs: points that are run folders, the front, resumed and killed, the command line, the figure."""

import csv
import itertools
import json
import shutil
from pathlib import Path

import pytest
from typer.testing import CliRunner

import polaris
from polaris.cli.app import app
from polaris.cli.compare import read_sweep
from polaris.cli.show.comparison import answered
from polaris.model.errors import PolarisError, ScenarioError
from polaris.runs import tradeoff as module
from polaris.runs.campaign.workers import InProcess, Interrupted, Workers
from polaris.runs.schedule import DATA_FILES
from polaris.runs.tradeoff_points import needed, non_dominated
from tests.leftovers import left_by_a_dead_process
from tests.polaris.tiny import TINY

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


def test_points_are_run_folders_of_their_price(folder, tmp_path):
    rows = folder.summary["points"]
    assert [(row["folder"], row["value"]) for row in rows] == list(zip(NAMES, [0, 3, None], strict=True))
    alone = polaris.run(TINY, tmp_path / "alone", overrides=[*SET, "schedule.delta_v_price=3"])
    assert contents(alone.path, DATA_FILES) == contents(folder.path / "price-3", DATA_FILES)
    opened = {row["folder"]: polaris.read_run(folder.path / row["folder"]) for row in rows}
    assert opened["price-0"].scenario.switching_rules().delta_v_price == 0
    assert opened["printed"].scenario.model.recoverable.recourse == "none"
    for row in rows:
        summary = opened[row["folder"]].summary
        assert row["share"] == row["weighted_share"] == summary["synthesis"]["experimental_share"]
        assert row["switches"] == summary["synthesis"]["switches"]
        assert row["delta_v_m_s"] == summary["polaris"]["delta_v_m_s"] <= row["delta_v_max_m_s"]
        assert row["delta_v_undisturbed_m_s"] == pytest.approx(row["delta_v_m_s"], rel=0.1)
        bound = summary["guarantee"]["goal"]["delta_v_max_m_s"]
        assert row["delta_v_most_m_s"] == bound > row["delta_v_max_m_s"]
        assert (row["goal_reached"], row["guarantee"], row["until_s"]) == (True, "proved", 20.0)
    free, dear, _ = rows
    assert free["share"] > dear["share"] and free["delta_v_m_s"] > dear["delta_v_m_s"]
    assert [row["non_dominated"] for row in rows] == [True, True, False]
    with (folder.path / "tradeoff.csv").open(encoding="utf-8", newline="") as file:
        read = list(csv.DictReader(file))
    assert read == [{key: "" if v is None else str(v) for key, v in row.items()} for row in rows]
    assert polaris.read_run(folder.path).plot_data() == rows
    scenario = polaris.load_scenario(TINY, [*SET, "experimental[0].weight=0.5"])
    run = polaris.RunFolder(opened["price-0"].path, scenario, opened["price-0"].kind)
    row = module.row_of(run, "half", module.PRICE, 0.0)
    assert row["weighted_share"] == row["share"] / 2 > 0


GOOD = {"weighted_share": 0.5, "delta_v_m_s": 1.0, "switches": 2, "goal_reached": True}
GOOD |= {"guarantee": "proved", "until_s": None}


@pytest.mark.parametrize(
    "worse",
    [
        *({"weighted_share": 0.4}, {"delta_v_m_s": 1.1}, {"switches": 3}),
        *({"goal_reached": "not_proven"}, {"guarantee": "none"}, {"until_s": 100.0}),
    ],
    ids=lambda worse: next(iter(worse)),
)
def test_front(worse):
    assert non_dominated([GOOD, GOOD | worse, GOOD]) == [True, False, True]
    change = {"delta_v_m_s": 0.9} if "delta_v_m_s" not in worse else {"switches": 1}
    assert non_dominated([GOOD, GOOD | worse | change]) == [True, True]


def again(path, prices=PRICES, overrides=SET, **options):
    return polaris.tradeoff(TINY, path, prices, overrides=overrides, **options)


def test_points_that_are_there_are_kept_and_others_computed(folder, copied, computed):
    before = contents(folder.path)
    assert contents(again(copied).path) == before and computed == []
    shutil.rmtree(copied / "price-3")
    leftover = left_by_a_dead_process(copied / "price-3")
    assert contents(again(copied).path) == before and computed == ["price-3"] and not leftover.exists()
    with pytest.raises(FileNotFoundError):  # a new price is asked for
        again(copied, [0, 3, 7])
    assert computed[1:] == ["price-7"] and contents(copied) == before


@pytest.mark.parametrize("name", ["sets.npz", "summary.json"])
def test_a_damaged_point_is_computed_again(name, folder, copied, computed):
    (copied / "price-0" / name).write_bytes(b"{}")
    assert contents(again(copied).path) == contents(folder.path) and computed == ["price-0"]


class Lost(InProcess):
    """Loses its worker."""

    def submit(self, fn, /, *args, **kwargs):
        raise OSError


def test_a_lost_worker_is_told(tmp_path):
    with pytest.raises(PolarisError, match="a worker was lost.*goes on from there"):
        again(tmp_path / "one", executor=Workers(Lost, lambda: 1, losses=(OSError,)))


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
    (needed,) = swept.summary["needed"]
    assert (needed["bound"], needed["last_proven"], needed["next"]) == ("at least", 2, 1)
    assert 1 < needed["interpolated"] < 2
    assert (swept.path / "figures" / "tradeoff.png").is_file()


def test_what_is_infeasible_is_not_asked_again(swept, tmp_path, monkeypatch):
    copied = Path(shutil.copytree(swept.path, tmp_path / "one"))
    monkeypatch.setattr(module, "run", lambda scenario, place, **_: 1 / 0)
    resumed = polaris.tradeoff(TINY, copied, {KEY: [0.05, 1, 2]}, share=0.2, overrides=FEW)
    assert resumed.summary["points"] == swept.summary["points"]
    with pytest.raises(ZeroDivisionError):  # another scenario
        polaris.tradeoff(TINY, copied, {KEY: [0.05]}, overrides=["system.disturbance_max=0.01"])


def test_how_far_a_value_may_go():
    shares = {4: None, 1: 0.95, 2: 0.93, 3: 0.85}
    falling = [
        {"field": "f", "value": at, "share": x, "guarantee": "proved" if x else "infeasible"}
        for at, x in shares.items()
    ]
    answer = needed(falling, "f", 0.9)
    assert (answer["bound"], answer["last_proven"], answer["next"]) == ("at most", 2, 3)
    assert answer["interpolated"] == pytest.approx(2 + 0.03 / 0.08) and "about 2.375" in answered(answer)
    beyond = needed(falling, "f", 0.8)
    assert (beyond["last_proven"], beyond["interpolated"]) == (3, None)
    assert "infeasible at 4" in answered(beyond)
    assert needed(falling, "f", 0.99)["last_proven"] is None
    assert "no further value" in answered(needed(falling[1:], "f", 0.8))


@pytest.mark.parametrize("prices", [[], [-0.1], [0.0, -0.0], [float("nan")], ["x"]], ids=str)
def test_prices_that_make_no_sense(prices, tmp_path):
    with pytest.raises(ScenarioError, match="prices"):
        polaris.tradeoff(TINY, tmp_path / "one", prices, overrides=SET)
    for text in ("schedule.delta_v_price=1", "recoverable.recourse=none"):
        with pytest.raises(ScenarioError, match="must be left out"):
            polaris.tradeoff(TINY, tmp_path / "one", [0], overrides=[*SET[:1], text])
    assert not list(tmp_path.iterdir())


def test_folders_of_others_are_left_alone(folder, copied, tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "notes").write_text("mine", encoding="utf-8")
    for place, word in ((copied / "price-0", "give another folder"), (tmp_path / "mine", "other contents")):
        with pytest.raises(ScenarioError, match=word):
            again(place)
    assert contents(copied) == contents(folder.path)
    with pytest.raises(ScenarioError, match="of a trade-off"):
        polaris.write_report(copied)


def invoke(*args):
    arguments = [str(TINY), "--workers", "1", "--set", SET[0], *map(str, args)]
    return CliRunner().invoke(app, ["tradeoff", *arguments])


def test_command(folder, copied, computed):
    arguments = ["--out", copied, "--prices", "0,3", *itertools.chain(*(("--set", text) for text in SET[1:]))]
    done = invoke(*arguments)
    assert done.exit_code == 0, done.output
    lines = [line.split()[:3] for line in done.stdout.splitlines()]
    assert ["*", "price-0", "83.3%"] in lines and ["*", "price-3", "41.7%"] in lines
    assert ["printed", "41.7%", "2"] in lines
    figures = [path / "figures" / "tradeoff.png" for path in (copied, folder.path)]
    assert figures[0].read_bytes() == figures[1].read_bytes(), "drawn again from the files alone"
    printed = invoke(*arguments, "--json", "--no-figures")
    assert json.loads(printed.stdout) == json.loads((copied / "tradeoff.json").read_text(encoding="utf-8"))
    assert not (copied / "figures").exists()
    assert (invoke(*arguments, "-q").output, computed) == ("", [])


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
    arguments = [TINY, "--out", copied, "--no-figures", "--workers", 1, "--share", 0.2, "--set", *FEW]
    arguments = ["tradeoff", *map(str, arguments)]
    done = CliRunner().invoke(app, [*arguments, "--sweep", f"{KEY}=0.05,1,2"])
    assert done.exit_code == 0, done.output
    assert f"{KEY}-0.05  infeasible" in done.stdout and f"{KEY}: at least 2 for 20 %" in done.stdout
    for wrong in (f"{KEY}", f"{KEY}=a", f"{KEY}=1:2", f"{KEY}=2:1:3", f"{KEY}=1,1", "system.nothing=1"):
        done = CliRunner().invoke(app, [*arguments, "--sweep", wrong])
        assert (done.exit_code, done.stderr[:6]) == (2, "error:"), wrong
    assert read_sweep(f"{KEY}=0.01:1:3") == (KEY, [0.01, 0.1, 1.0])
