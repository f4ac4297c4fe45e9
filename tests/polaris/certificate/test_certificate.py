"""Certificates: they verify, unsound ones do not, and the checker stands alone."""

import ast
import json
import subprocess
import sys
from functools import cache
from pathlib import Path

import pytest
from typer.testing import CliRunner

from polaris.certificate import checker
from polaris.certificate.__main__ import main
from polaris.certificate.checker import verify, verify_document
from polaris.certificate.files.document import digest
from polaris.cli.app import app
from polaris.runs.certificate import certificate
from polaris.runs.schedule import write_run
from polaris.scenario.scenario import load_scenario
from polaris.simulation.baselines import compare
from polaris.synthesis.schedule.synthesize import synthesize
from tests.kept import quick
from tests.paper.printed_ball import take_printed_balls
from tests.polaris.conftest import synthesised as bundled
from tests.polaris.tiny import TINY, flown, synthesised

PACKAGE = Path(checker.__file__).parent
MODULES = sorted(str(path.relative_to(PACKAGE).with_suffix("")) for path in PACKAGE.rglob("*.py"))


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return write_run(tmp_path_factory.mktemp("runs") / "tiny", *synthesised(), flown()).path


@cache
def variant(*assignments):
    """Certificate of a variant of the tiny scene."""
    scenario = load_scenario(TINY).with_assignments(list(assignments))
    return certificate(synthesize(scenario), scenario.name)


@pytest.mark.parametrize(
    "name",
    [
        "static",
        *(
            pytest.param(each, marks=pytest.mark.slow)
            for each in ("robot", "dynamic", "keep_out", "hold_point")
        ),
    ],
)
def test_bundled_scenarios_verify(name, tmp_path):
    scenario, schedule = bundled(name, *(quick(name) if name == "static" else ()))
    verdict = verify(write_run(tmp_path / name, scenario, schedule, compare(schedule, 2, 0)).path)
    assert verdict.outcome == "VERIFIED", verdict.text()
    claims = {claim for claim, _ in verdict.checked}
    assert {"separation", "recoverable", "end", "unsafe_sets", "goal"} <= claims


@pytest.mark.slow
def test_a_scene_verifies_whose_sets_are_merged_otherwise_by_both_programs(tmp_path):
    phases = "navigation.phases=[{from_s=600.0,position_error_m=0.02,velocity_error_m_s=0.001}]"
    errors = (phases, "timing.missed_periods=2", "chaser.radius_m=0.5")
    scenario, schedule = bundled("static", "feedback.period_s=2.0", "recoverable.recourse=none", *errors)
    run = write_run(tmp_path / "merged", scenario, schedule, compare(schedule, 2, 0))
    assert verify(run.path).outcome == "VERIFIED"


@pytest.mark.parametrize("feedback", ["{}", pytest.param("{period_s=0.05}", marks=pytest.mark.slow)])
def test_anything_within_the_thrust_limits_verifies(feedback):
    data = variant(
        *('experimental.0={kind="any_thrust",name="any"}', "tracking.Q=[1,1,1,1]", "tracking.R=[8,8]"),
        *("horizon.step_s=0.25", "planner.thrust_reserve=0.5", f"feedback={feedback}"),
    )
    assert 1 in data["modes"]
    assert verify_document(data).outcome == "VERIFIED"


def test_the_printed_ball_is_rejected_because_the_thrusters_saturate(monkeypatch):
    take_printed_balls(monkeypatch)
    data = variant("recoverable.kind=ball", "tracking.R=[1.5,1.5]")
    assert 1 in data["modes"]
    verdict = verify_document(data)
    assert (verdict.outcome, verdict.claim) == ("REJECTED", "recoverable")
    assert "input" in verdict.witness and verdict.excess > 0.1


def test_no_guarantee_is_not_verified_even_if_nothing_else_fails():
    for version, guarantee, expected in (
        (7, "none", ("REJECTED", "guarantee", 5)),
        (6, "proved", ("UNKNOWN", "format", 6)),
        (8, "proved", ("UNKNOWN", "format", 6)),
    ):
        data = variant() | {"guarantee": guarantee, "schema_version": version}
        verdict = verify_document(data | {"digest": digest(data)})
        assert (verdict.outcome, verdict.claim, verdict.exit_code) == expected


def test_it_carries_the_hash_of_every_artefact_and_exact_floats(run):
    data = json.loads((run / "certificate.json").read_text())
    files = {path.name for path in run.iterdir()} - {"certificate.json", "summary.json", ".polaris.jsonl"}
    assert set(data["artefacts"]) == files
    nu = synthesised()[1].safety.reference.nu.tolist()
    assert [[float.fromhex(x) for x in row] for row in data["reference"]["inputs"]] == nu


def test_standing_alone_it_says_what_it_was_not_compared_with(run, tmp_path):
    copy = tmp_path / "certificate.json"
    copy.write_bytes((run / "certificate.json").read_bytes())
    verdict = verify(copy)
    assert verdict.outcome == "VERIFIED"
    assert any("no other file" in line for line in verdict.trusted)
    assert verify(tmp_path).claim == "artefacts", "a run folder is never taken for a certificate alone"


def test_polaris_verify(run, tmp_path):
    result = CliRunner().invoke(app, ["verify", str(run)])
    assert result.exit_code == 0, result.output
    assert "VERIFIED" in result.output and "perception" in result.output
    altered = tmp_path / "bad.json"
    altered.write_text((run / "certificate.json").read_text().replace('"steps":12', '"steps":13'))
    result = CliRunner().invoke(app, ["verify", str(altered)])
    assert result.exit_code == 5 and "digest" in result.output
    assert CliRunner().invoke(app, ["verify", str(tmp_path / "none")]).exit_code == 2


@pytest.mark.parametrize("text", ["", "[]", "{", "null", '"x"', "[" * 100_000, "\udcff"])
def test_what_is_no_certificate_is_rejected(text, tmp_path, capsys):
    path = tmp_path / "x.json"
    path.write_bytes(text.encode("utf-8", "surrogateescape"))
    assert main([str(path)]) == 5
    assert "format" in capsys.readouterr().out
    assert main([]) == main(["--help"]) == 2
    assert "usage" in capsys.readouterr().err


BLOCKED = """
import sys
class Block:
    def find_spec(self, name, path=None, target=None):
        top, own = name.split(".")[0], name.startswith("polaris.certificate") or name == "polaris"
        own = own and name != "polaris.runs.certificate"
        allowed = own or top == "flint" or top in sys.stdlib_module_names
        if not allowed or name in {refused}:
            raise ModuleNotFoundError("blocked " + name, name=name)
sys.meta_path.insert(0, Block())
from polaris.certificate.__main__ import main
sys.exit(main([sys.argv[1]]))
"""


def blocked(path, *refused):
    """Run the checker where nothing else can be imported."""
    script = BLOCKED.replace("{refused}", repr(set(refused) or {""}))
    return subprocess.run([sys.executable, "-c", script, str(path)], capture_output=True, text=True)


def test_the_checker_runs_where_nothing_else_can_be_imported(run):
    done = blocked(run)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines()[-1].startswith("VERIFIED")
    done = blocked(run, "flint")
    assert done.returncode == 2
    assert "python-flint" in done.stderr and "Traceback" not in done.stderr


@pytest.mark.parametrize("module", MODULES)
def test_a_module_of_the_checker_imports_its_own_kind_only(module):
    allowed = {"flint", *sys.stdlib_module_names} | ({"onnx"} if module == "model/onnx_file" else set())
    for node in ast.walk(ast.parse((PACKAGE / f"{module}.py").read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            assert all(alias.name.split(".")[0] in allowed for alias in node.names)
        if isinstance(node, ast.ImportFrom):
            relative = 1 <= node.level <= 1 + module.count("/")
            assert relative or (node.level == 0 and node.module.split(".")[0] in allowed), ast.unparse(node)
