"""Numbers, folders and the command of a comparison."""

import json

import numpy as np
import pytest
from scipy.stats import ttest_1samp
from typer.testing import CliRunner

from polaris.cli.app import app
from polaris.model.errors import ScenarioError
from polaris.report import write_report
from polaris.report.figures import draw_run
from polaris.report.tables import REMEDIES
from polaris.rta.arena import compare_methods
from polaris.rta.decision_grid import DecisionGrid
from polaris.rta.flight import Conditions, Flight, fly
from polaris.rta.method import Claim
from polaris.rta.method_result import DEFINITIONS, MethodResult, executed_modes, measure
from polaris.rta.methods import METHODS
from polaris.runs.comparison import write_comparison
from polaris.runs.run import read_run
from tests.polaris.rta.scenes import corridor, robot, scene
from tests.polaris.tiny import TINY, synthesised

FEW = ("safety", "experimental", "schedule", "monitor", "asif_implicit")


def test_filtered_inputs_count_as_us_only_where_they_are_the_desired_ones():
    def who(grid, modes, reasons):
        modes, reasons = np.array([modes]), np.array([reasons])
        N, inputs, zero = modes.shape[1], np.zeros((1, modes.shape[1], 2)), np.zeros(1)
        states, ones = np.zeros((1, N + 1, 4)), np.ones(reasons.shape[1])
        margins = np.zeros(reasons.shape)
        fields = inputs, inputs.max(axis=2), zero, modes, margins, reasons, zero, ones
        return executed_modes(grid, Flight(np.arange(N + 1.0), states, *fields)).tolist()

    assert who(scene("robot"), [-1, -1, 1, 0], [0, 1, 0, 0]) == [[1, -1, 1, 0]]
    grid = scene("robot", period=0.25, latency=0.1)  # five nodes per decision, two of them late
    assert (grid.nodes, grid.delay) == (5, 2)
    assert who(grid, [-1] * 10, [1, 0]) == [[-1] * 7 + [1] * 3]


def test_metrics_by_hand():
    grid = scene("robot")
    conditions = Conditions.draw(grid, 3, 0)
    flights = {key: fly(grid, METHODS[key](grid), conditions) for key in FEW}
    measured = {key: measure(grid, flight, conditions, key) for key, flight in flights.items()}
    flight, metrics = flights["schedule"], measured["schedule"]
    modes = np.repeat(grid.schedule.modes, grid.clearance.q)
    assert metrics.experimental_share[0] == pytest.approx(np.mean(modes > 0), abs=1e-12)
    assert metrics.switches[0] == np.count_nonzero(np.diff(modes))
    assert metrics.delta_v[0] == pytest.approx(np.abs(flight.inputs[0]).sum() * grid.h / grid.system.mass)
    assert metrics.mean_distance[0] >= metrics.min_distance[0]
    pilots = executed_modes(
        grid, flights["asif_implicit"]
    )  # a switch is a change to a filtered input, or back
    assert (pilots == -1).any() and (pilots == 1).any()
    changes = np.count_nonzero(np.diff(pilots, axis=1), axis=1)
    assert measured["asif_implicit"].switches.tolist() == changes.tolist() and changes.min() > 0
    assert np.allclose(flights["experimental"].deviation, 0, atol=1e-12)
    safe, metrics = flights["safety"], measured["safety"]
    desired = np.stack([grid.clipped(1, k, safe.states[:, k]) for k in range(grid.last)], axis=1)
    assert safe.deviation == pytest.approx(np.linalg.norm(safe.inputs - desired, axis=2).mean(axis=1))
    metrics.min_ttc[:] = [np.inf, 1.0, 2.0]  # of infinite times no difference is made
    one, other = (
        MethodResult(key, key, Claim("none", ""), metrics, safe.deviation, (1e-6, 2e-6), 0.5, {"a": 1})
        for key in ("one", "other")
    )
    assert one.summary()["min_ttc_s"] == {"mean": None, "low": None, "high": None, "worst": 1.0}
    rows = {row["metric"]: row for row in one.against(other)}
    assert rows["min_ttc_s"]["difference"] is None and rows["min_distance_m"]["difference"] == 0.0


def test_differences_are_paired_and_violations_have_clopper_and_pearsons_interval(monkeypatch):
    monkeypatch.setattr("polaris.rta.arena.BATCH", 4)  # which are joined
    comparison = compare_methods(robot(), 10, 1, methods=("safety", "schedule", "experimental"))
    rows = {row["metric"]: row for row in comparison.paired() if row["method"] == "safety"}
    safety, schedule, alone = (comparison.results[key] for key in ("safety", "schedule", "experimental"))
    differences = safety.columns["delta_v_m_s"] - schedule.columns["delta_v_m_s"]
    row = rows["delta_v_m_s"]
    assert row["difference"] == pytest.approx(differences.mean())
    low, high = ttest_1samp(differences, 0.0).confidence_interval(0.95)
    assert (row["low"], row["high"]) == pytest.approx((low, high)) and len(differences) == 10
    safe, alone = (one.summary()["violations"] for one in (safety, alone))
    assert (safe["mean"], alone["mean"]) == (0, 10)
    assert safe["high"] == pytest.approx(10 * (1 - 0.025**0.1), rel=1e-6)
    assert alone["low"] == pytest.approx(10 * 0.025**0.1, rel=1e-6)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"methods": ("magic",)}, "methods: got 'magic'"),
        ({"runs": 0}, "runs: got 0"),
        ({"period": 0.3}, "period: got 0.3"),
        ({"period": 0.07}, "period: got 0.07"),
        ({"latency": 1.0}, "latency: got 1.0"),
        ({"latency": -0.1}, "latency: got -0.1"),
        ({"half_widths": -1.0}, "half_widths"),
        ({"half_widths": float("nan")}, "half_widths"),
        ({"half_widths": [0.1, 0.1, 0.1]}, "half_widths"),
    ],
)
def test_wrong_options_are_refused(options, told):
    grid = {name: options[name] for name in options if name not in ("methods", "runs")}
    options = {name: value for name, value in options.items() if name not in grid}
    with pytest.raises(ScenarioError, match="must") as caught:
        compare_methods(DecisionGrid.from_schedule(robot(), **grid), **options)
    assert told in str(caught.value)


@pytest.mark.slow
def test_methods_are_tuned_and_the_folder_says_how(tmp_path):
    scenario, schedule = synthesised()
    tuning = {"monitor.reentry": 0.3, "monitor.dwell": 7.0, "asif_explicit.alpha": 0.3,
              "asif_implicit.slope": 0.5, "simulation.horizon": 2.0, "reachability.horizon": 3.0}  # fmt: skip
    buffered = [key for key, one in METHODS.items() if any(option.name == "buffer" for option in one.options)]
    tuning |= {f"{key}.buffer": 0.1 for key in buffered}
    keys = {name.split(".")[0] for name in tuning}
    comparison = compare_methods(schedule, 1, 0, methods=keys, tuning=tuning)
    table = write_comparison(tmp_path / "one", scenario, comparison, draw=draw_run).summary
    assert {"paths.png", "tradeoffs.pdf"} <= {path.name for path in (tmp_path / "one" / "figures").iterdir()}
    settings = {
        f"{one['key']}.{name}": value for one in table["methods"] for name, value in one["settings"].items()
    }
    assert settings == tuning
    for key, options in ((key, one.options) for key, one in METHODS.items() if one.options):
        defaults = compare_methods(schedule, 1, 0, methods=(key,)).results[key].settings
        assert set(defaults) == {option.name for option in options}
        assert all(defaults[option.name] != tuning.get(f"{key}.{option.name}") for option in options)
    for wrong in ({"monitor.alpha": 1.0}, {"nothing": 1.0}, {"schedule.dwell": 2}, {"monitor.dwell": 1.5}):
        with pytest.raises(ScenarioError, match="tuning|dwell"):
            compare_methods(schedule, 1, 0, tuning=wrong)


def test_folder_holds_what_was_found(tmp_path):
    scenario, schedule = synthesised()
    comparison = compare_methods(schedule, 4, 0, methods=FEW)
    folder = write_comparison(tmp_path / "one", scenario, comparison)
    table = read_run(tmp_path / "one").summary
    assert [method["key"] for method in table["methods"]] == [key for key in METHODS if key in FEW]
    for method in table["methods"]:
        summary = comparison.results[method["key"]].summary()
        assert method["metrics"]["min_distance_m"] == summary["min_distance_m"]
        assert set(method["metrics"]) <= set(DEFINITIONS)
    plotted = folder.plot_data().shown
    for key in FEW:
        assert np.array_equal(plotted[key].states, comparison.shown[key].states)
    lines = [json.loads(line) for line in (folder.path / "decisions.jsonl").read_text().splitlines()]
    assert len(lines) == len(FEW) * comparison.grid.decisions
    reasons = {line["reason"] for line in lines if line["method"] == "monitor"}
    dwell = "S keeps control: dwell or re-entry margin"
    assert reasons <= {"U is recoverable", "U is not recoverable", dwell}
    far = DecisionGrid.from_schedule(corridor(), half_widths=5.0)
    (far,) = compare_methods(far, 2, 0, methods=("monitor",)).results.values()
    assert far.metrics.experimental_share.max() == 0.0  # S throughout, and safe
    assert not far.metrics.collided.any()


def test_command(tmp_path):
    runner, out = CliRunner(), tmp_path / "cmp"
    options = ["--runs", "3", "--methods", "safety,schedule,monitor", "--no-figures", "--out", str(out)]
    options += ["--tune", "monitor.dwell=4"]
    done = runner.invoke(app, ["compare", str(TINY), *options])
    assert done.exit_code == 0, done.output
    assert "violations" in done.output and "proved" in done.output
    words = done.output.split()
    assert {"switches", "deviation", "decision", "median", "offline"} <= set(words)
    assert "warning" not in words and "in N for a spacecraft" in done.output
    assert not [word for word in words if len(word) > 1 and word.endswith("-")]
    repeated = runner.invoke(app, ["compare", str(TINY), *options, "--json"])
    assert repeated.exit_code == 0
    table = json.loads(repeated.stdout)
    assert table["protocol"]["runs"] == 3 and len(table["methods"]) == 3
    assert table["methods"][2]["settings"] == {"reentry": 0.1, "dwell": 4.0}
    for arguments, rule in (
        (["compare", "inspection"], "must be a scenario of the kind 'schedule'"),
        (["compare", str(TINY), "--methods", "nonsense"], "must be one of"),
        (["compare", "robot", "--estimate-error", "much"], "must be numbers"),
        (["compare", str(TINY), "--tune", "monitor.dwell"], "must be METHOD.OPTION=NUMBER"),
        (["compare", str(TINY), "--tune", "monitor.gain=2"], "must be one of 'monitor.reentry'"),
        (["compare", "nowhere"], "nowhere"),
    ):
        failed = runner.invoke(app, [*arguments, "--out", str(tmp_path / "other")])
        assert failed.exit_code == 2 and rule in failed.output, failed.output
        assert not (tmp_path / "other").exists()


def test_methods_that_withhold_u_are_named_with_a_reason_and_a_remedy(tmp_path):
    """With estimates 5 m off nothing is recoverable at any decision; the schedule looks at no estimate."""
    out, keys = tmp_path / "cmp", ("safety", "schedule", "monitor", "asif_implicit")
    options = ["--methods", ",".join(keys), "--runs", "2", "--estimate-error", "5", "--no-figures"]
    done = CliRunner().invoke(app, ["compare", str(TINY), *options, "--out", str(out)])
    assert done.exit_code == 0, done.output
    warnings = [line for line in done.output.splitlines() if line.startswith("warning: ")]
    assert [line.split(": ")[1] for line in warnings] == ["Polaris online monitor", "Implicit ASIF"]
    count = 2 * sum('"asif_implicit"' in line for line in (out / "decisions.jsonl").read_text().splitlines())
    reason = f"U flies 0 % of the time; most decisions ({count} of {count}): no input is recoverable: S; try "
    assert reason in warnings[1] and "smaller estimate errors" in warnings[1]
    html = write_report(out).read_text(encoding="utf-8")
    assert html.count(reason) == 1 and html.count("U flies 0 % of the time") == 2
    assert set(REMEDIES) <= {reason for one in METHODS.values() for reason in one.reasons}
