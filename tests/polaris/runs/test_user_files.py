"""Files of the user: no verb deletes or overwrites one that Polaris did not write as it is."""

import json
import shutil
from importlib import import_module

import pytest
from typer.testing import CliRunner

from polaris.cli.app import app
from polaris.model.errors import PolarisError, ScenarioError
from polaris.report import write_report
from polaris.report.figures import draw_run
from polaris.runs.campaign import make_cases
from polaris.runs.files.atomic import replacing
from polaris.runs.files.ownership import MANIFEST
from polaris.runs.run import read_run
from polaris.runs.schedule import write_run
from tests.polaris.runs.campaign.scene import run as run_campaign
from tests.polaris.runs.test_replacing import contents, write
from tests.polaris.tiny import TINY, flown, synthesised


def polaris(*words):
    return CliRunner().invoke(app, [str(word) for word in words])


def make(target, draw=None):
    """Write the run folder of the small scene."""
    return write_run(target, *synthesised(), flown(), draw=draw)


def put(path, text="mine"):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")


@pytest.fixture
def idle(monkeypatch):
    """No verb gets to its work."""
    import_module("polaris.runs.case")  # imported later, it would keep what stands here now

    def work(*args, **more):
        raise AssertionError("the work had begun")

    for name in (
        "polaris.runs.case.synthesize",  # first: else it is imported as the next one replaces it, for good
        "polaris.runs.case.CommandTarget.schedule",
        "polaris.synthesis.safety.get_safety.get_safety",
        "polaris.synthesis.schedule.synthesize.synthesize",
        "polaris.inspection.flights.simulation.fly_one",
        "polaris.runs.campaign.drive.work_through",
        "polaris.runs.campaign.drive.replay_run",
        "polaris.runs.tradeoff.work_through",
        "polaris.traces.export.export_run",
        "polaris.report.report_page",
    ):
        monkeypatch.setattr(name, work)


@pytest.mark.parametrize(
    "line",
    [
        f"falsify {TINY} --out no/such/folder/file.json",
        "campaign-replay c --case 0 --batch 0 --run 0 --out no/such/folder/file.csv",
        "export run no/such/folder/file.json",
        "report run --out no/such/folder/file.json",
        f"run {TINY} --out file/in/a/file",
        "run inspection --out file/in/a/file",
        f"compare {TINY} --out file/in/a/file",
    ],
    ids=lambda line: line.split()[0],
)
def test_unwritable_files_are_found_before_the_work(tmp_path, monkeypatch, idle, line):
    """Every command that writes a file asks first."""
    monkeypatch.setattr("polaris.runs.campaign.folder.read_campaign", lambda path: None)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_bytes(b"")
    done = polaris(*line.split())
    assert done.exit_code == 2 and "error: " in done.stderr, done.output
    assert "work had begun" not in done.output


VERBS = {
    "run": (["run", TINY], "gains.json"),
    "run inspection": (["run", "inspection"], "flight.npz"),
    "campaign": (["campaign", TINY, "--runs", "2"], "manifest.json"),
    "campaign --fresh": (["campaign", TINY, "--runs", "2", "--fresh"], "manifest.json"),
    "campaign inspection": (["campaign", "inspection-monte-carlo", "--runs", "2"], "manifest.json"),
    "compare": (["compare", TINY], "comparison.json"),
    "tradeoff": (["tradeoff", TINY, "--sweep", "schedule.delta_v_max_m_s=9"], "tradeoff.json"),
}
"""Every verb that writes a folder, and a file that it writes."""


def foreign(target, name):
    for file in (name, "manifest.json", "summary.json", "scenario.toml", "index.html"):
        put(target / file, json.dumps({"name": "another application", "runs": 3}))
    return "other contents"


def edited_list(target, name):
    write(target, {name: b"{}"})
    text = (target / MANIFEST).read_text(encoding="utf-8")
    put(target / MANIFEST, text.replace(name, "notes.txt"))
    put(target / "notes.txt")
    return MANIFEST


def edited_file(target, name):
    write(target, {name: b"{}"})
    put(target / name, "edited by the user")
    return f"{name} in it was changed since Polaris wrote it"


def linked_file(target, name):
    write(target, {name: b"{}"})
    put(target.parent / "precious")
    (target / name).unlink()
    (target / name).symlink_to(target.parent / "precious")
    return f"{name} in it is a symbolic link"


def folder_in_the_way(target, name):
    write(target, {name: b"{}"})
    (target / name).unlink()
    put(target / name / "data.txt")
    return f"{name} in it was changed"


def file_in_the_way(target, name):
    write(target, {"manifest.json" if name == "manifest.json" else "older.json": b"{}"})
    put(target / ("summary.json" if name == "manifest.json" else name))
    return "in it is not Polaris's"


@pytest.mark.parametrize(
    "way", [foreign, edited_list, edited_file, linked_file, folder_in_the_way, file_in_the_way]
)
@pytest.mark.parametrize("verb", VERBS)
def test_what_is_in_the_way_is_named_and_kept(tmp_path, idle, verb, way):
    words, name = VERBS[verb]
    target = tmp_path / "out"
    blocking = way(target, name)
    before = contents(tmp_path)
    done = polaris(*words, "--out", target, "-q")
    assert done.exit_code == 2 and blocking in done.stderr, done.output
    assert contents(tmp_path) == before


def test_a_campaign_keeps_files_of_the_user_fresh_or_resumed(tmp_path):
    out, cases = tmp_path / "k", make_cases([str(TINY)])
    run_campaign(cases, 4, out, batch=2)
    user_files = ["notes.txt", "runs/mine.csv", "failed/why.txt", "failures.csv", "scenario.toml"]
    user_files += ["runs/case-0000-batch-99999.parquet", "runs/case-0000-batch-00002.parquet"]
    for name in user_files:
        put(out / name)
    run_campaign(cases, 4, out, batch=2, seed=1, fresh=True)
    assert all((out / name).read_text() == "mine" for name in user_files)
    folder = run_campaign(cases, 6, out, batch=2, seed=1)  # it needs the name of the last one
    assert folder.summary["runs"] == 6
    assert (out / "case-0000-batch-00002.parquet.kept").read_text() == "mine"
    assert all((out / name).read_text() == "mine" for name in user_files[:-1])
    target = tmp_path / "run"
    make(target)
    before = contents(target)
    for fresh in (False, True):
        with pytest.raises(ScenarioError, match="run folder"):
            run_campaign(cases, 4, target, batch=2, fresh=fresh)
    with pytest.raises(ScenarioError, match="holds a campaign"):
        make(out)
    (out / "runs").rename(out / "elsewhere")
    (out / "runs").symlink_to("elsewhere")
    with pytest.raises(PolarisError, match="symbolic link"):
        run_campaign(cases, 8, out, batch=2, seed=1)
    assert contents(target) == before


def drawing(picture, folder, figures):
    """Draw next to nothing."""
    (folder / "scene.png").write_bytes(b"drawn")
    return [folder / "scene.png"]


def test_figures_are_not_drawn_through_a_link_or_over_a_picture_of_the_user(tmp_path, monkeypatch):
    monkeypatch.setattr("polaris.report.figures.draw_figures", drawing)
    folder, pictures = tmp_path / "e", tmp_path / "pictures"
    make(folder)
    for name in ("cat.png", "scene.png", "album/x.jpg"):
        put(pictures / name)
    (folder / "figures").symlink_to("../pictures")
    before = contents(tmp_path)
    done = polaris("plot", folder, "-q")
    assert done.exit_code == 2 and "figures" in done.stderr and "symbolic link" in done.stderr
    assert contents(tmp_path) == before
    (folder / "figures").unlink()
    put(folder / "figures" / "scene.png")
    put(folder / "figures" / "mine.png")
    done = polaris("plot", folder, "-q")
    assert done.exit_code == 2 and "figures/scene.png in it is not Polaris's" in done.stderr
    assert {path.name for path in (folder / "figures").iterdir()} == {"scene.png", "mine.png"}
    (folder / "figures" / "scene.png").unlink()
    assert polaris("plot", folder, "-q").exit_code == polaris("plot", folder, "-q").exit_code == 0
    make(folder)
    assert {path.name for path in (folder / "figures").iterdir()} == {"mine.png"}


def test_figures_of_the_run_in_a_comparison_are_listed_with_it(tmp_path, monkeypatch):
    monkeypatch.setattr("polaris.report.figures.draw_figures", drawing)
    with replacing(tmp_path / "c") as staging:
        make(staging / "run")
    draw_run(read_run(tmp_path / "c" / "run"))
    assert [path.parent.name for path in (tmp_path / "c").rglob(MANIFEST)] == ["c"]
    write(tmp_path / "c", {"comparison.json": b"{}"})
    assert set(contents(tmp_path / "c")) == {"comparison.json", MANIFEST}


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """A run folder and a campaign."""
    place = tmp_path_factory.mktemp("results")
    make(place / "run")
    run_campaign(make_cases([str(TINY)]), 2, place / "campaign", batch=2)
    return place


FILES = {
    "report": (["report", "RUN", "--out"], "thesis.html", "run/report.html"),
    "export": (["export", "RUN"], "thesis.json", "campaign/summary.json"),
    "falsify": (["falsify", TINY, "--runs", "1", "--out"], "thesis.json", "run/schedule.json"),
    "campaign-replay": (["campaign-replay", "CAMPAIGN", "--worst", "1", "--out"], "t.npz", "run/sets.npz"),
}
"""Every verb that writes a file to a place of the user's choice, such a file, and one of a result."""


@pytest.mark.parametrize("verb", FILES)
def test_a_file_that_is_there_is_replaced_only_by_force(results, tmp_path, verb):
    words, name, result = FILES[verb]
    shutil.copytree(results, tmp_path, dirs_exist_ok=True)
    words = [{"RUN": tmp_path / "run", "CAMPAIGN": tmp_path / "campaign"}.get(word, word) for word in words]
    put(tmp_path / name)
    put(tmp_path / "other")
    if verb == "report":
        write_report(tmp_path / "run")
    before = contents(tmp_path)
    done = polaris(*words, tmp_path / name)
    assert done.exit_code == 2 and name in done.stderr and "--force" in done.stderr, done.output
    for flags in ([], ["--force"]):  # a result would be lost
        done = polaris(*words, tmp_path / result, *flags)
        assert done.exit_code == 2 and "part of the results" in done.stderr, done.output
    assert contents(tmp_path) == before
    assert polaris(*words, tmp_path / name, "--force").exit_code == 0
    after = contents(tmp_path)
    assert {path for path in before if before[path] != after.get(path)} <= {name} and set(after) == set(
        before
    )
    assert (after[name] != b"mine") == (verb != "falsify"), "falsify found nothing to save"
