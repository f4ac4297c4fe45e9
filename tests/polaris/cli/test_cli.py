"""The command line: what it prints, where, and how it ends; and what importing the package costs."""

import json
import re
import signal
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

import polaris
from polaris.cli import app as cli
from polaris.cli import shell
from polaris.model.checks import counted
from polaris.model.errors import NotCertified, ScenarioError, SynthesisInfeasible
from polaris.planning.problem import Progress
from polaris.runs.stages import planner_line
from polaris.scenario.scenario import bundled_files, load_scenario
from polaris.scenario.scenario_warnings import scenario_warnings
from tests.polaris.forging import QUARTER
from tests.polaris.tiny import TINY, flown, synthesised

HEAVY = ("matplotlib", "control", "pulp", "highspy", "scipy.optimize", "numpy", "pydantic")


@pytest.fixture
def invoke(tmp_path, monkeypatch):
    """Run a command in an empty folder, with the synthesis taken from memory."""
    monkeypatch.chdir(tmp_path)
    schedule = synthesised()[1]
    monkeypatch.setattr("polaris.synthesis.safety.get_safety.get_safety", lambda problem: schedule.safety)
    monkeypatch.setattr("polaris.scenario.experimental.build_controllers", lambda *args: ())
    monkeypatch.setattr("polaris.synthesis.schedule.synthesize.synthesize", lambda *args, **options: schedule)
    monkeypatch.setattr("polaris.simulation.baselines.compare", lambda *args: flown())
    monkeypatch.setattr(
        "polaris.report.figures.draw_figures",
        lambda picture, folder, figures: [(folder / "scene.pdf").touch() or folder / "scene.pdf"],
    )
    return lambda *args: CliRunner().invoke(cli.app, list(map(str, args)))


def python(code):
    root = Path(polaris.__file__).resolve().parent.parent
    return subprocess.run([sys.executable, "-c", code], cwd=root, capture_output=True, text=True, timeout=60)


@pytest.mark.parametrize(
    "what", ["import polaris, reach", "import polaris.cli.app", "import polaris; polaris.__version__"]
)
def test_importing_loads_nothing_heavy(what):
    done = python(f"import sys\n{what}\nprint(sorted(set({HEAVY}) & set(sys.modules)))")
    assert (done.stdout.strip(), done.stderr) == ("[]", "")


def test_version_help_and_lists(invoke):
    assert invoke("--version").output.split() == ["polaris", polaris.__version__]
    assert all(word in invoke("--help").output for word in ("run", "check", "scenarios", "plot"))
    assert "static is valid: 6 states, 3 inputs," in invoke("check", "static").output
    listed = invoke("scenarios").output
    assert [line.split()[0] for line in listed.splitlines()] == list(bundled_files())
    assert counted(1, "input") == "1 input" and counted(2, "axis", "axes") == "2 axes"


def test_run_prints_a_table_and_where_the_folder_lies(invoke, tmp_path):
    done = invoke("run", TINY)
    assert done.exit_code == 0, done.output
    for text in ("S alone", "U alone", "Polaris", "minimum distance", "Guarantee: proved", "Assumptions:"):
        assert text in done.stdout
    assert str(tmp_path / "runs" / "tiny") in done.stdout
    assert (tmp_path / "runs" / "tiny" / "figures" / "scene.pdf").is_file()
    done = invoke("run", TINY, "--out", "here", "--json", "--no-figures")
    assert (done.exit_code, done.stderr) == (0, "") and not (tmp_path / "here" / "figures").exists()
    assert json.loads(done.stdout) == json.loads((tmp_path / "here" / "summary.json").read_text("utf-8"))


def test_python_runs_what_the_command_runs(invoke, tmp_path):
    """Files are the same but for times, overrides are noted in both, figures only where asked for."""
    assert invoke("run", TINY, "--out", "typed", "--set", "planner.gap=0.01", "-q").exit_code == 0
    written = polaris.run(TINY, "called", overrides=["planner.gap=0.01"])
    assert not (written.path / "figures").exists() and written.plot_data().modes.size
    assert invoke("plot", "called").exit_code == 0  # from the files alone
    for path in (path for path in (tmp_path / "typed").iterdir() if path.is_file()):
        if path.name not in ("summary.json", ".polaris.jsonl"):
            assert path.read_bytes() == (written.path / path.name).read_bytes(), path.name
    assert polaris.draw_run(polaris.read_run(written.path)) == [written.path / "figures" / "scene.pdf"]


def test_overrides_reach_the_scenario_and_are_noted(invoke, tmp_path):
    options = "--out here --set planner.gap=0.01 --solver gurobi --recoverable ball -q"
    done = invoke("run", TINY, *options.split())
    assert done.exit_code == 0, done.output
    copy = tmp_path / "here" / "scenario.toml"
    notes = "#   planner.gap=0.01\n#   planner.solver=gurobi\n#   recoverable.kind=ball\n"
    assert notes in copy.read_text("utf-8")
    model = load_scenario(copy).model
    assert (model.planner.gap, model.planner.solver, model.recoverable.kind) == (0.01, "gurobi", "ball")


@pytest.mark.parametrize("name", ["static", "inspection"])
def test_check_takes_overrides(invoke, name):
    assert invoke("check", name, "--set", "title=Another").exit_code == 0
    is_one_message(invoke("check", name, "--set", "nonsense=1"), 2, "nonsense", "unknown key")


@pytest.mark.parametrize(
    "setting, told",
    [
        ("system.thrust_max_N=200", "mN"),
        ("horizon={ duration_s = 540000, step_s = 30 }", "18000 steps"),
        ("system.mean_motion_rad_s=0.0066", "faster than any orbit"),
        ("system.disturbance_max_m_s2=3", "in one step, and full thrust"),
        ("system.disturbance_max_m_s2=0", "obey the model exactly"),
        ("system.thrust_max_N=10", "m, not km"),
        ("initial_set.half_widths=[0.003,0.003,0.003,0.01,0.01,0.01]", "initial_set: its velocities are"),
        ("initial_set.half_widths=[0.003,0.003,0.003,0,0,0]", "initial_set: the position is known to"),
        ("initial_set.center=[0,400,0,50,0,0]", "initial_set: 50 m/s covers"),
        ("obstacles[0].half_widths_m=[0.025,0.025,0.025]", "obstacles.*: it is 0.025 m in size"),
    ],
)
def test_slips_of_units_and_scale_are_noted(setting, told):
    no_period = "feedback={}"  # with the period of the file there would be too many
    done = CliRunner().invoke(cli.app, ["check", "static", "--set", setting, "--set", no_period])
    assert done.exit_code == 0 and re.search(f"^note: .*{told}", done.stdout, re.M), done.output


def test_a_run_notes_slips_on_standard_error(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert not any(scenario_warnings(load_scenario(name)) for name in polaris.bundled_scenarios())
    slip = [str(TINY), "--set", "system.disturbance_max=0", "--set", QUARTER, "--no-figures"]
    assert "note: disturbance: zero" in CliRunner().invoke(cli.app, ["run", *slip, "--json"]).stderr
    assert CliRunner().invoke(cli.app, ["run", *slip, "--quiet"]).stderr == ""


def commands():
    """Every command of the application, by its name."""
    return typer.main.get_command(cli.app).commands


@pytest.mark.parametrize("name", commands())
def test_help_shows_every_word_of_itself(name, monkeypatch):
    """Units and tables in brackets too, which markup would take for styles."""
    monkeypatch.setenv("COLUMNS", "400")
    output = " ".join(CliRunner().invoke(cli.app, [name, "--help"]).output.split())
    for parameter in commands()[name].params:
        help = " ".join((getattr(parameter, "help", None) or "").split())
        plain = help.replace("`", "").replace("*", "")
        assert plain in output.replace("`", ""), f"{name} {parameter.name}"


@pytest.mark.parametrize(
    "typed, expected",
    [
        ("polaris run sta", "static"),
        ("polaris check in", "inspection"),
        ("polaris run ./", "./own.toml"),
        ("polaris ver", "verify"),
        ("polaris run static --no", "--no-figures"),
    ],
)
def test_a_shell_can_complete(typed, expected, tmp_path, monkeypatch):
    (tmp_path / "own.toml").touch()
    monkeypatch.chdir(tmp_path)
    words = {"_POLARIS_COMPLETE": "complete_bash", "COMP_WORDS": typed, "COMP_CWORD": str(typed.count(" "))}
    done = CliRunner().invoke(cli.app, [], env=words, prog_name="polaris")
    assert expected in done.stdout.split()


def test_hints_name_packages_that_exist():
    """Hints name a dependency, the distribution, or a copy of it, and extras that exist."""
    root = Path(polaris.__file__).resolve().parents[1]
    project = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    extras = project["optional-dependencies"]
    needed = [*project["dependencies"], *(one for extra in extras.values() for one in extra)]
    allowed = {re.split(r"[<>=\[]", package)[0] for package in needed} | {".", project["name"]}
    code = [page for package in ("polaris", "reach") for page in (root / package).rglob("*.py")]
    pages = [*code, root / "README.md", *(root / "docs").glob("*.md")]
    hints = [
        hint for page in pages for hint in re.findall(r"pip install ([^\n`#]+)", page.read_text("utf-8"))
    ]
    assert hints
    for hint in hints:
        hint = hint.replace("{DISTRIBUTION}", project["name"]).replace("[{extra}]", "").split('"')[0]
        for word in re.findall(r"[\w.\[\]-]+", hint):
            package, extra = re.fullmatch(r"(.+?)(?:\[(\w+)\])?", word).groups()
            assert package in allowed and (extra is None or extra in extras), hint


def is_one_message(done, code, *words):
    assert done.exit_code == code, done.output
    # stages that took longer than a second have said so before
    lines = [line for line in done.stderr.splitlines() if not re.fullmatch(r"[a-z ]+: [\d.]+ s", line)]
    assert len(lines) == 1 and lines[0].startswith("error: ")
    assert "Traceback" not in done.output and done.stdout == ""
    assert all(word in lines[0] for word in words)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("run", "nope"), ("nope",)),
        (("run", "./nope.toml"), ("nope.toml", "no such file")),
        (("run", TINY, "--set", "planner.gap=7"), ("planner.gap", "7", "< 1")),
        (("run", TINY, "--set", "nonsense"), ("--set", "key=value")),
        (("run", TINY, "--out", "."), ("--out", "current folder")),
        (("run", TINY, "--out", "full"), ("--out", "other contents")),
        (("run", TINY, "--out", "full/file"), ("--out", "is a file")),
        (("run", TINY, "--out", "full/file/deeper"), ("--out", "not a")),
        (("plot", "full"), ("run folder", "scenario.toml")),
        (("plot", "nope"), ("no such folder",)),
    ],
)
def test_bad_input_is_one_message_and_exit_code_2(invoke, tmp_path, arguments, words):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "file").write_text("precious", encoding="utf-8")
    is_one_message(invoke(*arguments), 2, *words)
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["file", "full"]


def test_no_output_takes_the_place_of_an_input(invoke, tmp_path):
    (tmp_path / "mine.toml").write_bytes(TINY.read_bytes())
    assert invoke("run", TINY, "--out", "here", "-q", "--no-figures").exit_code == 0
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    for arguments, words in (
        (("report", "here", "--out", "here/scenario.toml"), (".html",)),
        (("report", "here", "--out", "mine.toml"), ("mine.toml", ".html")),
        (("export", "here", "mine.toml"), ("mine.toml", ".json")),
        (("export", "here", "here/schedule.json"), ("part of the results",)),
        (("falsify", "here", "--runs", "1", "--out", "here/gains.json"), ("part of the results",)),
        (("report", "mine.toml"), ("mine.toml", "is a file")),
        (("report", "nope"), ("run folder", "'nope'", "no such folder")),
        (("verify", "nope"), ("'nope'", "no such file or folder")),
    ):
        is_one_message(invoke(*arguments), 2, *words)
        assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (ScenarioError("field", 1, "rule"), 2),
        (SynthesisInfeasible("the goal is out of reach.", 1.0, "a longer horizon."), 3),
        (NotCertified("no plan within planner.time_limit_s"), 4),
        (RuntimeError("broken\nin two lines"), 1),
        (MemoryError(), 1),
        (KeyboardInterrupt(), 130),
    ],
)
def test_errors_end_with_their_exit_code_and_no_folder(invoke, tmp_path, monkeypatch, error, code):
    def fail(problem):
        raise error

    monkeypatch.setattr("polaris.synthesis.safety.get_safety.get_safety", fail)
    is_one_message(invoke("run", TINY), code)
    assert list(tmp_path.iterdir()) == []


def test_infeasible_and_out_of_time_for_real(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    weak = CliRunner().invoke(cli.app, ["run", str(TINY), "--set", "system.input_max=0.045", "--json"])
    is_one_message(weak, 3, "To make it feasible")
    late = CliRunner().invoke(cli.app, ["run", str(TINY), "--set", "planner.time_limit_s=1e-9", "--json"])
    is_one_message(late, 4)
    assert list(tmp_path.iterdir()) == []


def test_a_clock_that_struck_is_told_whatever_is_asked(tmp_path, monkeypatch):
    """On standard error, quiet or not, in summary.json, and in what Python returns."""
    from polaris.model.errors import ClockWarning
    from polaris.planning.effort import SearchEffort
    from polaris.synthesis.schedule.synthesize import synthesize

    options = ["--no-figures", "--set", "simulation.runs=2", "--set", QUARTER]
    CliRunner().invoke(cli.app, ["run", str(TINY), "--out", str(tmp_path / "in time"), "-q", *options])
    summary = json.loads((tmp_path / "in time" / "summary.json").read_text(encoding="utf-8"))
    planner = summary["synthesis"]["planner"]
    assert planner["cut_by_clock"] == [] and planner["status"] == "optimal"
    assert [(stage["name"], stage["status"]) for stage in planner["stages"]][-1] == ("fuel", "optimal")
    assert all("HiGHS" in stage["by"] for stage in planner["stages"])

    # not in the plan of the unaware reference, which is not used then
    struck = property(lambda self: ("fuel",) if self.search.rows.problem.unsafe else ())
    monkeypatch.setattr(SearchEffort, "cut_by_clock", struck)
    out = tmp_path / "late"
    for quiet in ("-q", "--json"):
        done = CliRunner().invoke(cli.app, ["run", str(TINY), "--out", str(out), quiet, *options])
        lines = [line for line in done.stderr.splitlines() if line.startswith("warning: ")]
        assert done.exit_code == 0 and len(lines) == 1
        assert "planner.time_limit_s" in lines[0] and "fuel" in lines[0]
        summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
        assert summary["synthesis"]["planner"]["cut_by_clock"] == ["fuel"]
    with pytest.warns(ClockWarning):
        assert synthesize(load_scenario(TINY, [QUARTER])).safety.cut_by_clock == ("fuel",)


def test_a_reference_that_the_clock_cut_short_is_not_used(monkeypatch):
    """The unaware reference is the cheapest plan; half-way to it is something else each time."""
    from polaris.model.errors import ClockWarning, OutOfTime
    from polaris.planning.effort import SearchEffort
    from polaris.synthesis.safety.get_safety import get_safety

    scenario = load_scenario("static")
    safety = get_safety(scenario)
    monkeypatch.setattr(SearchEffort, "cut_by_clock", property(lambda self: ("fuel",)))
    with pytest.warns(ClockWarning), pytest.raises(OutOfTime, match="time_limit_s"):
        scenario.controllers(safety)


@pytest.mark.parametrize("error", [KeyboardInterrupt(), pytest.param(RuntimeError(), marks=pytest.mark.slow)])
def test_a_run_that_fails_late_leaves_the_old_folder_whole(invoke, tmp_path, monkeypatch, error):
    invoke("run", TINY, "--out", "here", "-q")
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}

    def fail(*args):
        raise error

    monkeypatch.setattr("polaris.report.figures.draw_figures", fail)
    assert invoke("run", TINY, "--out", "here", "-q").exit_code != 0
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


def test_slow_stages_are_told_on_standard_error(capsys, monkeypatch):
    from polaris.cli import console

    stages = console.ShownStages()
    monkeypatch.setattr(console, "PATIENCE", 0.0)
    with stages.stage("plan"):
        stages.planner(Progress("fuel", 1.0, 0.31, 0.30, 0.033))
    captured = capsys.readouterr()
    assert captured.out == "" and captured.err.startswith("plan: ")
    line = planner_line(Progress("fuel", 1.0, 0.31, 0.30, 0.033))
    assert line == "plan: fuel, best 0.31, bound 0.3, gap 3.30%"
    assert planner_line(Progress("path search", 1.0)) == "plan: path search"


def test_termination_leaves_through_the_same_door():
    with pytest.raises(SystemExit) as leaving:
        shell._terminated(signal.SIGTERM, None)
    assert leaving.value.code == 143
