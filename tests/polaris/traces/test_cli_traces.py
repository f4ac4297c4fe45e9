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
from polaris.traces import evaluate_trace, read_trace
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
    assert invoke("evaluate", path, "--quiet").output == ""
    assert "differences of positions" in invoke("evaluate", path, "--velocity", "differences").stdout
    headed = invoke("evaluate", path, "--heading", "3,4", "--speed", 5, "--agent-radius", 1).stdout
    assert "speed in state 5, direction in 3, 4" in headed
    done = invoke("evaluate", path)
    assert done.exit_code == 0, done.output
    assert re.search(r"debris \(ball\) +distance \[m\] +4 +6 +8 +4", done.stdout)
    assert re.search(r"TTC, straight \[s\] +4 +6 +8 +4 +100.0%", done.stdout)
    assert "velocity: states 3, 4, 5" in done.stdout
    assert "share of time: untrusted 100.0%; switches: 0" in done.stdout


def test_names_are_whole_in_a_narrow_terminal(tmp_path, monkeypatch):
    monkeypatch.setenv("COLUMNS", "60")
    sets = {f"line_of_sight[{f}]": entry("point", [0, [0, 0, f]]) for f in range(24)}
    saved = save(tmp_path, trace({"a": agent([[0, 5, 0, 0, 1, 0, 0], [1, 6, 0, 0, 1, 0, 0]])}, **sets))
    lines = invoke("evaluate", saved, "--mean-motion", "0.0012").stdout.splitlines()
    shown = [line.split()[0] for line in lines if line.startswith("line")]
    assert shown == list(sets) and all("…" not in line for line in lines)


def test_evaluate_as_json_is_strict(path):
    def strict(name):
        raise AssertionError(name)

    done = invoke("evaluate", path, "--json", "--mean-motion", "0.0012")
    data = json.loads(done.stdout, parse_constant=strict)
    debris = data["agents"]["chaser"]["unsafe"]["debris"]
    assert debris["distance_m"] == {"min": 4, "mean": 6, "max": 8, "at": 4, "share": 1}
    assert debris["drift_ttc_s"]["min"] == pytest.approx(4, abs=0.1)
    assert data["agents"]["chaser"]["usage"]["untrusted"] == 1
    file = save(path.parent, trace({"a": agent([[0, 5, 0, 0, 1, 0, 0]])}, s=entry("point", [0, [0, 0, 0]])))
    printed = json.loads(invoke("evaluate", file, "--json").stdout, parse_constant=strict)
    nothing = dict.fromkeys(("min", "mean", "max", "at")) | {"share": 0}
    assert printed["agents"]["a"]["unsafe"]["s"]["ttc_s"] == nothing


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
        (["--heading", "3,4"], "--heading"),
        (["--heading", "x", "--speed", "5"], "--heading"),
        (["--velocity", "3,4,5", "--speed", "5"], "--heading"),
        (["--speed", "6", "--heading", "3,4"], "--speed"),
        (["--mean-motion", "0"], "--mean-motion"),
        (["--agent-radius", "-1"], "--agent-radius"),
        (["--restamp"], "agents.chaser.state_trace"),
        (["--legacy", "--mean-motion", "0.001"], "--legacy"),
        (["--legacy", "--agent-radius", "1"], "--legacy"),
        (["--dims", "2", "--mean-motion", "0.001"], "--dims"),
    ],
)
def test_options_that_do_not_fit_end_with_one_message(path, arguments, told):
    done = invoke("evaluate", path, *arguments)
    assert (done.exit_code, done.stdout) == (2, "")
    assert done.stderr.startswith("error: ") and told in done.stderr and done.stderr.count("\n") == 1


def test_agents_and_running_times_are_shown(tmp_path):
    rows = [[0, 0.0, 0, 1, 0], [1, 1.0, 0, 1, 0]]
    late = agent([[5, 9.0, 0, 0, 0]])
    agents = {"a": agent(rows, running_times=[0.5, 0.25]), "b": late, "c": agent(rows), "[bold]a[/x]": late}
    done = invoke("evaluate", save(tmp_path, trace(agents)))
    assert "[bold]a[/x]" in done.stdout
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


def test_export_of_no_run_folder_or_no_such_run(run, tmp_path):
    damaged, path = shutil.copytree(run.path, tmp_path / "damaged"), tmp_path / "t.json"
    (damaged / "trajectories.npz").write_bytes(b"x")
    for folder, target, *arguments in (
        (run.path, path, "--run", "run 77"),
        (run.path, path, "--controller", "nobody"),
        (run.path, tmp_path),
        (tmp_path, path),
        (damaged, path),
    ):
        done = invoke("export", folder, target, *arguments)
        assert done.exit_code == 2 and done.stderr.count("\n") == 1 and not path.exists()
    assert "damaged" in done.stderr


@pytest.fixture(scope="module")
def compared(tmp_path_factory):
    scenario, schedule = synthesised()
    comparison = compare_methods(schedule, 4, 0, methods=("experimental", "schedule", "asif_implicit"))
    out = tmp_path_factory.mktemp("compared") / "tiny"
    return write_comparison(out, scenario, comparison)


@pytest.mark.parametrize("method", ["experimental", "schedule", "asif_implicit"])
def test_export_of_a_method_has_its_least_distance(compared, tmp_path, method):
    """The run shown as closest, against the envelope of all runs that comparison.npz keeps."""
    path, flights = tmp_path / "t.json", compared.plot_data().shown[method]
    done = invoke("export", compared.path, path, "--method", method, "--run", "closest")
    assert done.exit_code == 0 and f"run 'closest' of {method}, {len(flights.times)} samples" in done.stdout
    metrics = evaluate_trace(read_trace(path)).agents["chaser"]
    least = min(item.distance.min for item in metrics.unsafe)
    step = np.abs(np.diff(flights.nearest[0])).max()
    assert least == pytest.approx(flights.nearest[0].min(), abs=step)
    shares = np.bincount(flights.modes[0] + 1, minlength=3) / flights.modes.shape[1]
    usage = [metrics.usage[mode] for mode in ("unknown", "safety", "untrusted")]
    assert usage == pytest.approx([shares[0], shares[1], shares[2:].sum()])
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


def run_page(folder, slow):
    """Run the blocks of the page, the slow ones or the others, as the tests of the other pages do."""
    shell, namespace, printed, ran = Shell(folder), {"__name__": "traces"}, None, 0
    for block in blocks(PAGE):
        if block.check.startswith("file "):
            shell.write(block)
        elif block.kind == "console":
            if (block.check == "slow") == slow:
                shell.check(block)
                ran += 1
        elif block.kind == "python" and not slow:
            with contextlib.redirect_stdout(io.StringIO()) as out:
                exec(compile("\n" * (block.line - 1) + block.body, str(PAGE), "exec"), namespace)
            printed = out.getvalue()
            ran += 1
        elif not slow:
            assert block.kind == "text", f"{block.page}:{block.line}: nothing runs this block"
            assert_shown(block.body, printed, f"{block.page}:{block.line}", numbers=True)
    assert ran


def test_page_does_what_it_shows(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run_page(tmp_path, slow=False)
    tests = (Path(__file__).parent / "test_legacy.py").read_text(encoding="utf-8")
    numbers = re.findall(r"^\| (\d+) \|", PAGE.read_text(encoding="utf-8"), re.M)  # of defects
    assert numbers == [str(i) for i in range(1, 11)] and all(f"def test_{n}_" in tests for n in numbers)


@pytest.mark.slow
def test_slow_commands_of_the_page(tmp_path):
    run_page(tmp_path, slow=True)
