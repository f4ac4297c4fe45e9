"""Rules for every verb of the command line: overrides, the order of errors, and its real outputs."""

import json
import subprocess
import sys

import pytest
import typer
from typer.testing import CliRunner

from polaris.cli import app as cli
from tests.polaris.forging import COARSE
from tests.polaris.tiny import TINY

VERBS = typer.main.get_command(cli.app).commands
SCENARIOS = {"NAME_OR_FILE", "NAME_OR_FILE...", "RUN_OR_SCENARIO"}
"""What help calls an argument that may name a scenario."""


def options(verb):
    return {word for parameter in VERBS[verb].params for word in parameter.opts}


def taking(option):
    return {verb for verb in VERBS if option in options(verb)}


@pytest.fixture
def refuse(tmp_path, monkeypatch):
    """Run a verb in an empty folder where no work may begin and no extra is installed; its one message."""
    monkeypatch.chdir(tmp_path)

    def work(*args, **more):
        raise AssertionError("work has begun")

    for place in ("synthesis.safety.get_safety", "synthesis.schedule.synthesize", "simulation.sampled"):
        monkeypatch.setattr(f"polaris.{place}.get_safety", work)
    for missing in ("pyarrow", "distributed", "gurobipy", "numba"):
        monkeypatch.setitem(sys.modules, missing, None)

    def run(*arguments):
        done = CliRunner().invoke(cli.app, list(map(str, arguments)))
        lines = [line for line in done.stderr.splitlines() if line.startswith(("error: ", "Error: ", "│"))]
        assert done.exit_code == 2 and done.stdout == "", done.output
        assert not list(tmp_path.iterdir())
        return " ".join(" ".join(lines).split()) or done.stderr

    return run


def test_every_verb_that_takes_a_scenario_takes_overrides():
    metavars = {verb: {getattr(each, "metavar", "") for each in one.params} for verb, one in VERBS.items()}
    accepting = {verb for verb, words in metavars.items() if words & SCENARIOS}
    assert {"run", "check", "model-error", "falsify", "campaign", "compare", "tradeoff"} <= accepting
    assert accepting == taking("--set")


@pytest.mark.parametrize("verb", sorted(taking("--set")))
def test_an_override_reaches_the_scenario(verb, refuse):
    assert "nonsense" in refuse(verb, "static", "--set", "nonsense=1")


BOX = ("--set", "experimental=[{kind='black_box', name='box'}]", "--set", "feedback={period_s=1}")
FLYING = ("run", "model-error", "falsify", "campaign", "compare", "tradeoff")
"""Verbs that fly a scenario's controllers."""


@pytest.mark.parametrize("verb", FLYING)
def test_a_black_box_is_asked_for_before_any_work(verb, refuse):
    scenario = "static" if verb == "model-error" else TINY
    sweep = SWEEP if verb == "tradeoff" else ()
    assert "--black-box NAME=COMMAND" in refuse(verb, scenario, *BOX, *sweep)


@pytest.mark.parametrize("verb", sorted(taking("--black-box") - {"campaign-replay"}))
def test_a_black_box_that_the_scenario_does_not_have_is_refused_before_any_work(verb, refuse):
    sweep = SWEEP if verb == "tradeoff" else ()
    assert "black box: got 'other'" in refuse(verb, TINY, "--black-box", "other=cat", *sweep)
    assert "NAME=COMMAND" in refuse(verb, TINY, "--black-box", "cat")


GRID = ("--grid", "nonsense=1")
SWEEP = ("--sweep", "planner.gap=0.1")
WRONG = [
    (("campaign", TINY, *GRID), "nonsense"),
    (("campaign", TINY, "--grid", "planner.gap"), "--grid"),
    (("campaign", TINY, *GRID, "--scheduler", "tcp://nowhere:1"), "nonsense"),
    (("campaign", TINY, "--mode", "nobody"), "--mode"),
    (("campaign", TINY, "--out", "."), "--out"),
    (("campaign", TINY, "--out", ".", "--scheduler", "tcp://nowhere:1"), "--out"),
    (("campaign-replay", "nowhere"), "must have --case"),
    (("run", TINY, "--out", ".", "--solver", "gurobi"), "--out"),
    (("compare", TINY, "--methods", "magic"), "'magic'"),
    (("compare", TINY, "--tune", "monitor.gain=2"), "monitor.gain"),
    (("compare", TINY, "--tune", "monitor.reentry=2"), "monitor.reentry"),
    (("compare", TINY, "--tune", "asif_implicit.slope=1.5"), "asif_implicit.slope"),
    (("compare", TINY, "--tune", "reachability.buffer=-1"), "reachability.buffer"),
    (("compare", TINY, "--period", "0.3"), "period: got 0.3"),
    (("compare", TINY, "--latency", "2"), "latency: got 2"),
    (("compare", TINY, "--estimate-error", "1,2"), "half_widths"),
    (("compare", TINY, "--out", "."), "--out"),
    (("compare", "cubesat"), "isolated at once with navigation.measurement"),
    (("tradeoff", TINY, "--prices", "cheap"), "--prices"),
    (("tradeoff", TINY, "--sweep", "nonsense=1"), "nonsense"),
    (("tradeoff", TINY, "--share", "2"), "share"),
    (("tradeoff", TINY, *SWEEP, "--out", "."), "--out"),
    (("falsify", TINY, "--out", "case.txt"), ".json"),
    (("evaluate", "nowhere.json", "--velocity", "fast"), "--velocity"),
]


@pytest.mark.parametrize("arguments, reason", WRONG)
def test_wrong_arguments_come_before_work_and_before_missing_packages(arguments, reason, refuse):
    message = refuse(*arguments)
    assert reason in message and "pip install" not in message and "package" not in message


SPACE = ("--set", "obstacles[0].center_m=[0, 3000, 0]", "--set", "recoverable.recourse=none")
LIGHT = ("--set", "simulation.runs=2", "--set", "schedule.bound_programs=0", "--set", COARSE)
JSON = {
    "run": ("run", TINY, "--no-figures", "--out", "run", *LIGHT),
    "model-error": ("model-error", "static", *SPACE, "--set", "horizon.step_s=60"),
    "falsify": ("falsify", TINY, "--runs", "20", *LIGHT),
    "campaign": ("campaign", TINY, "--runs", "2", "--workers", "1", "--out", "campaign", *LIGHT),
    "campaign-replay": ("campaign-replay", "campaign", "--worst", "1"),
    "compare": (
        "compare",
        TINY,
        *("--runs", "1", "--methods", "safety,schedule", "--no-figures", "--out", "cmp"),
        *LIGHT,
    ),
    "tradeoff": ("tradeoff", TINY, *SWEEP, "--workers", "1", "--no-figures", *LIGHT),
    "evaluate": ("evaluate", "trace.json"),
}
OTHERS = {"export": ("export", "run", "trace.json"), "plot": ("plot", "figures"), "report": ("report", "run")}
"""Verbs without ``--json`` that may be asked to be quiet."""

WALK = """
import json, os, sys
from polaris.cli.app import app
for name, arguments in json.load(sys.stdin):
    sys.stdout.flush()
    for stream, ending in ((1, "out"), (2, "err")):
        file = os.open(f"{name}.{ending}", os.O_WRONLY | os.O_CREAT)
        os.dup2(file, stream)
        os.close(file)
    try:
        app(arguments, standalone_mode=False)
    except BaseException as error:
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
"""


@pytest.fixture(scope="module")
def walked(tmp_path_factory):
    """Every verb with ``--json``, then quietly, in one process; what reached its real outputs, by verb."""
    place = tmp_path_factory.mktemp("walk")
    calls = [("run --json", (*JSON["run"], "--json")), ("export --quiet", (*OTHERS["export"], "--quiet"))]
    calls += [(f"{verb} --json", (*call, "--json")) for verb, call in JSON.items() if verb != "run"]
    quiet = {verb: call for verb, call in (JSON | OTHERS).items() if "--quiet" in options(verb)}
    quiet["plot"] = ("plot", "cmp/run")
    calls += [(f"{verb} --quiet", (*call, "--quiet")) for verb, call in quiet.items() if verb != "export"]
    text = json.dumps([[name, list(map(str, call))] for name, call in calls])
    walk = [sys.executable, "-c", WALK]
    done = subprocess.run(walk, input=text, cwd=place, capture_output=True, text=True, timeout=600)
    assert (done.returncode, done.stdout) == (0, ""), done.stderr
    return {
        name: tuple((place / f"{name}.{ending}").read_text(encoding="utf-8") for ending in ("out", "err"))
        for name, _ in calls
    }


def test_the_walk_has_every_verb():
    assert set(JSON) == taking("--json")
    assert set(JSON) | set(OTHERS) >= taking("--quiet")


@pytest.mark.parametrize("verb", JSON)
def test_json_on_the_real_standard_output_is_json_and_nothing_else(verb, walked):
    out, err = walked[f"{verb} --json"]
    assert isinstance(json.loads(out), dict), out[:200]
    assert "Error" not in err and "error:" not in err


@pytest.mark.parametrize("verb", sorted(taking("--quiet")))
def test_quiet_is_quiet(verb, walked):
    assert walked[f"{verb} --quiet"] == ("", "")
