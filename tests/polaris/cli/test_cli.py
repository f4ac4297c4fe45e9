"""The command line: what it prints, where, and how it ends; and what importing the package costs."""

import contextlib
import json
import re
import signal
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

import polaris
from polaris.cli import app as cli
from polaris.cli import shell
from polaris.model.checks import counted
from polaris.model.errors import NotCertified, ScenarioError, SynthesisInfeasible
from polaris.planning.problem import Progress
from polaris.report.figures import FIGURES, draw_figures
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


# -- importing --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "what", ["import polaris, reach", "import polaris.cli.app", "import polaris; polaris.__version__"]
)
def test_importing_loads_nothing_heavy(what):
    done = python(f"import sys\n{what}\nprint(sorted(set({HEAVY}) & set(sys.modules)))")
    assert (done.stdout.strip(), done.stderr) == ("[]", "")


# -- commands ---------------------------------------------------------------------------------------


def test_version_and_help(invoke):
    assert invoke("--version").output.split() == ["polaris", polaris.__version__]
    text = invoke("--help").output
    assert all(word in text for word in ("run", "check", "scenarios", "plot"))


def test_run_prints_a_table_and_where_the_folder_lies(invoke, tmp_path):
    done = invoke("run", TINY)
    assert done.exit_code == 0, done.output
    for text in ("S alone", "U alone", "Polaris", "minimum distance", "Guarantee: proved", "Assumptions:"):
        assert text in done.stdout
    assert str(tmp_path / "runs" / "tiny") in done.stdout
    assert (tmp_path / "runs" / "tiny" / "figures" / "scene.pdf").is_file()


def test_json_is_the_summary_and_nothing_else(invoke, tmp_path):
    done = invoke("run", TINY, "--out", "here", "--json")
    assert (done.exit_code, done.stderr) == (0, "")

    def refuse(name):
        raise AssertionError(f"{name} is not strict JSON")

    data = json.loads(done.stdout, parse_constant=refuse)
    assert data == json.loads((tmp_path / "here" / "summary.json").read_text(encoding="utf-8"))


def test_quiet_prints_nothing(invoke):
    done = invoke("run", TINY, "--quiet")
    assert (done.exit_code, done.output) == (0, "")


def test_figures_can_wait(invoke, tmp_path, monkeypatch):
    monkeypatch.setattr("polaris.report.figures.draw_figures", draw_figures)
    monkeypatch.setattr("polaris.report.figures.FIGURES", {"modes": FIGURES["modes"]})
    done = invoke("run", TINY, "--out", "here", "--no-figures")
    assert done.exit_code == 0 and not (tmp_path / "here" / "figures").exists()
    assert "draw the figures: polaris plot" in " ".join(done.stdout.split())
    assert invoke("plot", "here").exit_code == 0
    assert (tmp_path / "here" / "figures" / "modes.pdf").is_file()


def test_python_runs_what_the_command_runs(invoke, tmp_path):
    """Files are the same but for times, overrides are noted in both, figures only where asked for."""
    assert invoke("run", TINY, "--out", "typed", "--set", "planner.gap=0.01", "-q").exit_code == 0
    written = polaris.run(TINY, "called", overrides=["planner.gap=0.01"])
    assert not (written.path / "figures").exists() and written.plot_data().modes.size
    for path in (path for path in (tmp_path / "typed").iterdir() if path.is_file()):
        if path.name not in ("summary.json", ".polaris.jsonl"):
            assert path.read_bytes() == (written.path / path.name).read_bytes(), path.name
    assert polaris.draw_run(polaris.read_run(written.path)) == [written.path / "figures" / "scene.pdf"]


def test_overrides_reach_the_scenario_and_are_noted(invoke, tmp_path):
    done = invoke(
        "run",
        TINY,
        "--out",
        "here",
        "--set",
        "planner.gap=0.01",
        "--solver",
        "gurobi",
        "--recoverable",
        "ball",
        "-q",
    )
    assert done.exit_code == 0, done.output
    copy = tmp_path / "here" / "scenario.toml"
    assert "#   planner.gap=0.01\n#   planner.solver=gurobi\n#   recoverable.kind=ball\n" in copy.read_text(
        "utf-8"
    )
    scenario = load_scenario(copy)
    assert (scenario.model.planner.gap, scenario.model.planner.solver, scenario.model.recoverable.kind) == (
        0.01,
        "gurobi",
        "ball",
    )


def test_check_and_scenarios(invoke):
    done = invoke("check", "static")
    assert done.exit_code == 0 and "static is valid: 6 states" in done.output
    listed = invoke("scenarios").output
    assert [line.split()[0] for line in listed.splitlines()] == list(bundled_files())


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
    ],
)
def test_slips_of_units_and_scale_are_noted(setting, told):
    held = "feedback={}"  # with the period of the file there would be too many
    done = CliRunner().invoke(cli.app, ["check", "static", "--set", setting, "--set", held])
    assert done.exit_code == 0 and re.search(f"^note: .*{told}", done.stdout, re.M), done.output


METRES = re.compile(r"_m$|^(center|half_widths|state|state_half_widths)$")


def scaled(table, by, n):
    """A table with every length multiplied, of states (position first) the first half."""
    if isinstance(table, list):
        return [scaled(item, by, n) for item in table]
    if not isinstance(table, dict):
        return table
    out = {}
    for key, value in table.items():
        if METRES.search(key):
            half = len(value) // 2 if isinstance(value, list) and not key.endswith("_m") else None
            value = np.array(value, dtype=float)
            value[... if half is None else slice(half)] *= by
            out[key] = value.tolist()
        else:
            out[key] = scaled(value, by, n)
    return out


@pytest.mark.parametrize("name", ["static", "dynamic", "keep_out", "hold_point"])
def test_lengths_in_another_unit_are_noted(name):
    """All of them, those of the initial set, with and without its velocities, and those of each obstacle."""
    scenario = load_scenario(name)
    data, n = scenario.to_dict(), scenario.system().n
    tables = ("initial_set", "goal", "obstacles", "keep_in", "planner", "orbit")
    slips = {
        f"all by {by:g}": {key: scaled(data[key], by, n) for key in tables if key in data}
        for by in (1e-3, 1e3)
    }
    theta = data["initial_set"]
    if theta["kind"] == "box":
        slips["initial set"] = {"initial_set": scaled(theta, 1e-3, n)}
        both = {key: (np.array(theta[key]) * 1e-3).tolist() for key in ("center", "half_widths")}
        slips["initial set, with velocities"] = {"initial_set": theta | both}
    for i, table in enumerate(data["obstacles"]):
        slips[f"obstacle {i}"] = {f"obstacles[{i}]": scaled(table, 1e-3, n)}
    rate, mass = data["system"]["mean_motion_rad_s"], data["system"]["mass_kg"]
    slips["degrees"] = {"system.mean_motion_rad_s": float(np.degrees(rate)), "orbit": None}
    slips["grams"] = {"system.mass_kg": 1e3 * mass}
    silent = []
    for slip, values in slips.items():
        with contextlib.suppress(ScenarioError):  # refused altogether
            silent += [] if scenario_warnings(scenario.with_overrides(values)) else [slip]
    assert not silent


def test_no_bundled_scenario_looks_like_a_slip():
    for name in polaris.bundled_scenarios():
        assert scenario_warnings(load_scenario(name)) == []


def test_a_run_notes_slips_on_standard_error(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    slip = [str(TINY), "--set", "system.disturbance_max=0", "--set", QUARTER, "--no-figures"]
    assert "note: disturbance: zero" in CliRunner().invoke(cli.app, ["run", *slip, "--json"]).stderr
    assert CliRunner().invoke(cli.app, ["run", *slip, "--quiet"]).stderr == ""


def test_one_is_not_many():
    assert counted(1, "input") == "1 input" and counted(0, "input") == "0 inputs"
    assert counted(2, "axis", "axes") == "2 axes"
    system = "system={ kind = 'linear', A = [[0, 1], [0, 0]], B = [[0], [1]], D = [[0], [1]], input_max = 1,"
    one = system + " disturbance_max = 0, position_states = [0] }"
    rest = [
        "initial_set={ kind = 'box', center = [0, 0], half_widths = [0.1, 0.1] }",
        "obstacles=[{ kind = 'box', name = 'o', center_m = [5], half_widths_m = [1] }]",
    ]
    rest += [
        "goal={ kind = 'stationary', state = [1, 0] }",
        "tracking={ Q = [1, 1], R = [1] }",
        "experimental=[{ kind = 'any_thrust', name = 'u' }]",
        "keep_in=[]",
    ]
    settings = [part for text in (one, *rest) for part in ("--set", text)]
    assert "2 states, 1 input," in CliRunner().invoke(cli.app, ["check", "robot", *settings]).stdout


def commands():
    """Every command of the application, by its name."""
    return typer.main.get_command(cli.app).commands


@pytest.mark.parametrize("name", commands())
def test_help_shows_every_word_of_itself(name, monkeypatch):
    """Units and tables in brackets too, which markup would take for styles."""
    monkeypatch.setenv("COLUMNS", "400")
    shown = " ".join(CliRunner().invoke(cli.app, [name, "--help"]).output.split())
    for parameter in commands()[name].params:
        help = " ".join((getattr(parameter, "help", None) or "").split())
        plain = help.replace("`", "").replace("*", "")
        assert plain in shown.replace("`", ""), f"{name} {parameter.name}"


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
    known = {re.split(r"[<>=\[]", package)[0] for package in needed} | {".", project["name"]}
    code = [page for package in ("polaris", "reach") for page in (root / package).rglob("*.py")]
    pages = [*code, root / "README.md", *(root / "docs").glob("*.md")]
    hints = [hint for page in pages for hint in re.findall(r"pip install ([^\n`]+)", page.read_text("utf-8"))]
    assert hints
    for hint in hints:
        hint = hint.replace("{DISTRIBUTION}", project["name"]).replace("[{extra}]", "").split('"')[0]
        for word in re.findall(r"[\w.\[\]-]+", hint.split("#")[0]):
            package, extra = re.fullmatch(r"(.+?)(?:\[(\w+)\])?", word).groups()
            assert package in known and (extra is None or extra in extras), hint


def test_plot_redraws_the_same_bytes_from_the_files_alone(invoke, tmp_path, monkeypatch):
    monkeypatch.setattr("polaris.report.figures.draw_figures", draw_figures)
    chosen = {name: FIGURES[name] for name in ("modes", "margin")}
    monkeypatch.setattr("polaris.report.figures.FIGURES", chosen)
    invoke("run", TINY, "--out", "here", "-q")
    figures = tmp_path / "here" / "figures"
    before = {path.name: path.read_bytes() for path in figures.glob("[!.]*")}
    for path in figures.iterdir():
        path.unlink()
    done = invoke("plot", "here")
    assert done.exit_code == 0 and "margin.png" in done.output
    assert {path.name: path.read_bytes() for path in figures.glob("[!.]*")} == before


# -- how it ends ------------------------------------------------------------------------------------


def is_one_message(done, code, *words):
    assert done.exit_code == code, done.output
    # stages that took longer than a second have said so before
    lines = [
        line for line in done.stderr.strip().splitlines() if not re.fullmatch(r"[a-z ]+: [\d.]+ s", line)
    ]
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
        (("run", TINY, "--set", "planner.gpa=1"), ("planner.gpa",)),
        (("run", TINY, "--out", "."), ("--out", "current folder")),
        (("run", TINY, "--out", "full"), ("--out", "other contents")),
        (("run", TINY, "--out", "full/file"), ("--out", "is a file")),
        (("run", TINY, "--out", "full/file/deeper"), ("--out", "not a")),
        (("run", TINY, "--out", "a\0b"), ("--out",)),
        (("check", "nope"), ("nope",)),
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


def test_wrong_options_are_exit_code_2(invoke):
    assert invoke("run", TINY, "--solver", "abacus").exit_code == 2
    assert invoke("run").exit_code == 2


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
        assert json.loads((out / "summary.json").read_text(encoding="utf-8"))["synthesis"]["planner"][
            "cut_by_clock"
        ] == ["fuel"]
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


@pytest.mark.parametrize(
    "error",
    [
        pytest.param(RuntimeError("no ink"), marks=pytest.mark.slow),
        KeyboardInterrupt(),
        pytest.param(SystemExit(143), marks=pytest.mark.slow),
    ],
)
def test_a_run_that_fails_late_leaves_the_old_folder_whole(invoke, tmp_path, monkeypatch, error):
    invoke("run", TINY, "--out", "here", "-q")
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}

    def fail(*args):
        raise error

    monkeypatch.setattr("polaris.report.figures.draw_figures", fail)
    assert invoke("run", TINY, "--out", "here", "-q").exit_code != 0
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


def test_termination_leaves_through_the_same_door():
    with pytest.raises(SystemExit) as leaving:
        shell._terminated(signal.SIGTERM, None)
    assert leaving.value.code == 143


def test_slow_stages_are_told_on_standard_error(capsys):
    from polaris.cli import console

    stages = console.ShownStages()
    patience, console.PATIENCE = console.PATIENCE, 0.0
    try:
        with stages.stage("plan"):
            stages.planner(Progress("fuel", 1.0, 0.31, 0.30, 0.033))
    finally:
        console.PATIENCE = patience
    shown = capsys.readouterr()
    assert shown.out == "" and shown.err.startswith("plan: ")
    line = planner_line(Progress("fuel", 1.0, 0.31, 0.30, 0.033))
    assert line == "plan: fuel, best 0.31, bound 0.3, gap 3.30%"
    assert planner_line(Progress("path search", 1.0)) == "plan: path search"
