"""The commands evaluate and export, and the page about traces, as a user meets them."""

import contextlib
import io
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from polaris.cli import app as cli
from polaris.rta.arena import compare_methods
from polaris.runs.comparison import write_comparison
from polaris.runs.schedule import write_run
from polaris.traces import AgentTrace, BallTrace, Trace, evaluate_trace, read_trace, write_trace
from tests.polaris.tiny import flown, synthesised
from tests.polaris.traces.traces import agent, entry, save, trace
from tests.test_docs import DOCS, Shell, assert_shown, blocks

PAGE = DOCS / "traces.md"


def invoke(*args):
    return CliRunner().invoke(cli.app, list(map(str, args)), env={"COLUMNS": "100"})


@pytest.fixture
def path(tmp_path):
    return save(tmp_path, trace(debris=entry("ball", [0, [[0, 0, 0], 2]])))


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    scenario, schedule = synthesised()
    return write_run(tmp_path_factory.mktemp("run") / "tiny", scenario, schedule, flown())


def test_evaluate_prints_a_table(path):
    done = invoke("evaluate", path)
    assert done.exit_code == 0, done.output
    assert re.search(r"debris \(ball\) +distance \[m\] +4 +6 +8 +4", done.stdout)
    assert re.search(r"TTC, straight \[s\] +4 +6 +8 +4 +100.0%", done.stdout)
    assert "velocity: states 3, 4, 5" in done.stdout
    assert "share of time: untrusted 100.0%; switches: 0" in done.stdout


def test_evaluate_as_json_is_strict(path):
    def strict(name):
        raise AssertionError(name)

    done = invoke("evaluate", path, "--json", "--mean-motion", "0.0012")
    data = json.loads(done.stdout, parse_constant=strict)
    debris = data["agents"]["chaser"]["unsafe"]["debris"]
    assert debris["distance_m"] == {"min": 4, "mean": 6, "max": 8, "at": 4, "share": 1}
    assert debris["drift_ttc_s"]["min"] == pytest.approx(4, abs=0.1)
    assert data["agents"]["chaser"]["usage"]["untrusted"] == 1
    away = save(path.parent, trace({"a": agent([[0, 5, 0, 0, 1, 0, 0]])}, s=entry("point", [0, [0, 0, 0]])))
    printed = json.loads(invoke("evaluate", away, "--json").stdout, parse_constant=strict)
    assert printed["agents"]["a"]["unsafe"]["s"]["ttc_s"] == {
        "min": None,
        "mean": None,
        "max": None,
        "at": None,
        "share": 0,
    }


def test_evaluate_with_every_option(path):
    assert invoke("evaluate", path, "--quiet").output == ""
    assert "2 axes" in invoke("evaluate", path, "--dims", 2).stdout
    assert "differences of positions" in invoke("evaluate", path, "--velocity", "differences").stdout
    assert "velocity: states 5, 4, 3" in invoke("evaluate", path, "--velocity", "5,4,3").stdout
    assert "on course" in invoke("evaluate", path, "--agent-radius", 1).stdout
    headed = invoke("evaluate", path, "--heading", "3,4", "--speed", 5).stdout
    assert "speed in state 5, direction in 3, 4" in headed


def test_legacy_prints_what_rtaeval_would(path):
    done = invoke("evaluate", path, "--legacy")
    assert done.exit_code == 0 and "defects included" in done.stdout
    assert re.search(r"compute_dists +min, max, mean per set +0, 0, \{debris: 0\}", done.stdout)
    data = json.loads(invoke("evaluate", path, "--legacy", "--json").stdout)
    assert data["legacy_rtaeval"] and data["agents"]["chaser"]["controllerUsage"] == [1, 0, 0]


@pytest.mark.parametrize(
    "arguments, told",
    [
        (["--velocity", "x"], "--velocity"),
        (["--velocity", "1"], "--velocity"),
        (["--velocity", ""], "--velocity"),
        (["--heading", "3,4"], "--heading"),
        (["--heading", "x", "--speed", "5"], "--heading"),
        (["--velocity", "3,4,5", "--speed", "5"], "--heading"),
        (["--speed", "5"], "--heading"),
        (["--speed", "6", "--heading", "3,4"], "--speed"),
        (["--mean-motion", "0"], "--mean-motion"),
        (["--mean-motion", "nan"], "--mean-motion"),
        (["--agent-radius", "-1"], "--agent-radius"),
        (["--agent-radius", "inf"], "--agent-radius"),
        (["--restamp"], "agents.chaser.state_trace"),
        (["--legacy", "--restamp"], "--legacy"),
        (["--legacy", "--mean-motion", "0.001"], "--legacy"),
        (["--legacy", "--agent-radius", "1"], "--legacy"),
        (["--dims", "2", "--mean-motion", "0.001"], "--dims"),
    ],
)
def test_options_that_do_not_fit_end_with_one_message(path, arguments, told):
    done = invoke("evaluate", path, *arguments)
    assert (done.exit_code, done.stdout) == (2, "")
    assert done.stderr.startswith("error: ") and told in done.stderr and done.stderr.count("\n") == 1


def test_malformed_files_end_with_one_message(tmp_path):
    for text in ("{", '{"agents": {}, "unsafe": {}}', '{"agents": {"a": NaN}}'):
        done = invoke("evaluate", save(tmp_path, text))
        assert done.exit_code == 2 and done.stderr.count("\n") == 1, done.output
    assert invoke("evaluate", tmp_path / "none.json").exit_code == 2


def test_names_are_printed_as_they_are(tmp_path):
    path = save(
        tmp_path,
        trace(
            {"[bold]a[/x]": agent([[0, 5.0, 0, 0, 1, 0, 0]])}, **{"[red]s": entry("point", [0, [0, 0, 0]])}
        ),
    )
    done = invoke("evaluate", path)
    assert done.exit_code == 0 and "[bold]a[/x]" in done.stdout and "[red]s" in done.stdout


def test_agents_and_running_times_are_shown(tmp_path):
    rows = [[0, 0.0, 0, 1, 0], [1, 1.0, 0, 1, 0]]
    late = agent([[5, 9.0, 0, 0, 0]])
    path = save(tmp_path, trace({"a": agent(rows, running_times=[0.5, 0.25]), "b": late, "c": agent(rows)}))
    done = invoke("evaluate", path)
    assert "never there at the same time" in done.stdout
    assert "decision: mean 0.375 s, max 0.5 s, min 0.25 s" in done.stdout
    assert re.search(r"c \(agent\) +distance \[m\] +0 ", done.stdout)


def test_export_writes_what_evaluate_reads(run, tmp_path):
    path = tmp_path / "t.json"
    done = invoke("export", run.path, path)
    assert done.exit_code == 0 and "run 'closest' of polaris" in done.stdout
    summary = run.summary["polaris"]
    metrics = evaluate_trace(read_trace(path)).agents["chaser"]
    assert metrics.usage["untrusted"] == pytest.approx(summary["experimental_share"])
    assert metrics.switches == summary["switches"]
    least = min(item.distance.min for item in metrics.unsafe)
    assert summary["min_distance_m"] <= least + 1e-9
    words = ["--controller", "safety", "--run", "nominal", "--quiet", "--force"]
    done = invoke("export", run.path, path, *words)
    assert (done.exit_code, done.output) == (0, "")
    assert evaluate_trace(read_trace(path)).agents["chaser"].usage["safety"] == 1


@pytest.mark.parametrize("arguments", [["--run", "run 77"], ["--controller", "nobody"]])
def test_export_of_no_such_run(run, tmp_path, arguments):
    done = invoke("export", run.path, tmp_path / "t.json", *arguments)
    assert done.exit_code == 2 and not list(tmp_path.iterdir())


def test_export_of_no_run_folder(run, tmp_path):
    assert invoke("export", tmp_path, tmp_path / "t.json").exit_code == 2
    damaged = tmp_path / "damaged"
    shutil.copytree(run.path, damaged)
    (damaged / "trajectories.npz").write_bytes(b"x")
    done = invoke("export", damaged, tmp_path / "t.json")
    assert done.exit_code == 2 and "damaged" in done.stderr
    assert invoke("export", run.path, tmp_path).exit_code == 2


@pytest.fixture(scope="module")
def compared(tmp_path_factory):
    scenario, schedule = synthesised()
    comparison = compare_methods(schedule, 4, 0, methods=("experimental", "schedule", "asif_implicit"))
    out = tmp_path_factory.mktemp("compared") / "tiny"
    return write_comparison(out, scenario, comparison)


@pytest.mark.parametrize("method", ["experimental", "schedule", "asif_implicit"])
def test_export_of_a_method_has_its_least_distance(compared, tmp_path, method):
    """The run shown as closest, against the envelope of all runs that comparison.npz keeps."""
    path, shown = tmp_path / "t.json", compared.plot_data().shown[method]
    done = invoke("export", compared.path, path, "--method", method, "--run", "closest")
    assert done.exit_code == 0 and f"run 'closest' of {method}, {len(shown.times)} samples" in done.stdout
    metrics = evaluate_trace(read_trace(path)).agents["chaser"]
    least = min(item.distance.min for item in metrics.unsafe)
    step = np.abs(np.diff(shown.nearest[0])).max()
    assert least == pytest.approx(shown.nearest[0].min(), abs=step)
    flown = np.bincount(shown.modes[0] + 1, minlength=3) / shown.modes.shape[1]
    usage = [metrics.usage[mode] for mode in ("unknown", "safety", "untrusted")]
    assert usage == pytest.approx([flown[0], flown[1], flown[2:].sum()])
    assert (usage[0] > 0) == (method == "asif_implicit")  # only that one changes inputs


def test_export_of_a_comparison_takes_its_own_options(compared, run, tmp_path):
    path = tmp_path / "t.json"
    assert "of schedule" in invoke("export", compared.path, path).stdout
    path.unlink()
    for folder, arguments, word in (
        (compared.path, ["--method", "nobody"], "--method"),
        (compared.path, ["--method", "schedule", "--run", "run 77"], "--run"),
        (compared.path, ["--controller", "polaris"], "--controller"),
        (run.path, ["--method", "schedule"], "comparison folder"),
    ):
        done = invoke("export", folder, path, *arguments)
        assert done.exit_code == 2 and word in done.stderr and done.stderr.count("\n") == 1
        assert not path.exists()


@pytest.mark.slow
def test_a_million_rows_take_seconds(tmp_path):
    N = 10**6
    t = np.arange(N) * 0.1
    states = np.cumsum(np.random.default_rng(0).normal(size=(N, 6)), axis=0)
    flight = Trace({"a": AgentTrace(t, states)}, {"b": BallTrace(t, states[:, :3] + 5, np.ones(N))})
    back = read_trace(write_trace(tmp_path / "t.json", flight))
    assert back.same_as(flight)
    assert evaluate_trace(back).agents["a"].unsafe[0].distance.max == pytest.approx(np.sqrt(75) - 1)


# -- the page -----------------------------------------------------------------------------------------


def run_page(folder, slow):
    """Run the blocks of the page, the slow ones or the others, as the tests of the other pages do."""
    shell, namespace, printed = Shell(folder), {"__name__": "traces"}, None
    ran = 0
    for block in blocks(PAGE):
        where = f"{block.page}:{block.line}"
        if block.check.startswith("file "):
            (folder / block.check.removeprefix("file ")).write_text(block.body, encoding="utf-8")
        elif block.kind == "console":
            if (block.check == "slow") == slow:
                shell.check(block)
                ran += 1
        elif slow:
            continue
        elif block.kind == "python":
            with contextlib.redirect_stdout(io.StringIO()) as out:
                exec(compile("\n" * (block.line - 1) + block.body, str(PAGE), "exec"), namespace)
            printed = out.getvalue()
            ran += 1
        elif block.kind == "text":
            assert_shown(block.body, printed, where, numbers=True)
        else:
            raise AssertionError(f"{where}: nothing runs this block")
    assert ran


def test_page_does_what_it_shows(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run_page(tmp_path, slow=False)


@pytest.mark.slow
def test_slow_commands_of_the_page(tmp_path):
    run_page(tmp_path, slow=True)


def test_every_defect_of_the_page_has_a_test():
    tests = (Path(__file__).parent / "test_legacy.py").read_text(encoding="utf-8")
    numbers = re.findall(r"^\| (\d+) \|", PAGE.read_text(encoding="utf-8"), re.M)
    assert numbers == [str(i) for i in range(1, 11)]
    for number in numbers:
        assert f"def test_{number}_" in tests
