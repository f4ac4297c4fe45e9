"""Numbers, folders and the command of a comparison."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from polaris.cli.app import app
from polaris.model.errors import ScenarioError
from polaris.report.figures import draw_run
from polaris.rta.arena import compare_methods
from polaris.rta.decision_grid import DecisionGrid
from polaris.rta.flight import Conditions, Flight, fly
from polaris.rta.method import Claim
from polaris.rta.method_result import DEFINITIONS, MethodResult, flown, measure
from polaris.rta.methods import METHODS
from polaris.runs.comparison import write_comparison
from polaris.runs.run import read_run
from tests.polaris.rta.scenes import corridor, robot, scene
from tests.polaris.tiny import TINY, synthesised

BUFFERED = (
    "simplex_explicit",
    "simplex_implicit",
    "asif_explicit",
    "asif_implicit",
    "simulation",
    "reachability",
)
FEW = ("safety", "experimental", "schedule", "monitor", "asif_implicit")


def flight_of(modes, why, inputs=None):
    """A flight in which one input is applied per decision; nothing else matters."""
    modes, why = np.atleast_2d(modes), np.atleast_2d(why)
    R, N = modes.shape
    states = np.zeros((R, N + 1, 4))
    inputs = np.zeros((R, N, 2)) if inputs is None else inputs
    return Flight(
        np.arange(N + 1.0),
        states,
        inputs,
        np.abs(inputs).max(axis=2),
        np.zeros(R),
        modes,
        np.zeros(why.shape),
        why,
        np.zeros(R),
        np.ones(why.shape[1]),
    )


def outcome(metrics, deviation, key="one"):
    return MethodResult(key, key, Claim("none", ""), metrics, deviation, (1e-6, 2e-6), 0.5, {"a": 1})


def test_filtered_inputs_count_as_us_only_where_they_are_the_desired_ones():
    made = scene("robot")
    who = flown(made, flight_of([[-1, -1, 1, 0]], [[0, 1, 0, 0]]))
    assert who.tolist() == [[1, -1, 1, 0]]


def test_reasons_belong_to_the_decision_that_is_in_effect():
    made = scene("robot", period=0.25, latency=0.1)  # five nodes per decision, two of them late
    assert (made.nodes, made.delay) == (5, 2)
    modes = np.full(10, -1)
    who = flown(made, flight_of([modes], [[1, 0]]))
    assert who.tolist() == [[-1] * 7 + [1] * 3]


def test_switches_and_shares_by_hand():
    made = scene("robot")
    conditions = Conditions.draw(made, 1, 0)
    flight = fly(made, METHODS["schedule"](made), conditions)
    metrics = measure(made, flight, conditions, "schedule")
    modes = np.repeat(made.schedule.modes, made.clearance.q)
    assert metrics.experimental_share[0] == pytest.approx(np.mean(modes > 0), abs=1e-12)
    assert metrics.switches[0] == np.count_nonzero(np.diff(modes))
    assert metrics.delta_v[0] == pytest.approx(np.abs(flight.inputs[0]).sum() * made.h / made.system.mass)
    assert metrics.mean_distance[0] >= metrics.min_distance[0]


def test_changes_to_a_filtered_input_and_back_are_switches():
    made = scene("robot")
    conditions = Conditions.draw(made, 2, 0)
    flight = fly(made, METHODS["asif_implicit"](made), conditions)
    who = flown(made, flight)
    assert (who == -1).any() and (who == 1).any()
    metrics = measure(made, flight, conditions, "filter")
    assert metrics.switches.tolist() == np.count_nonzero(np.diff(who, axis=1), axis=1).tolist()
    assert metrics.switches.min() > 0


def test_deviation_is_that_from_what_u_wants():
    made = scene("robot")
    conditions = Conditions.draw(made, 2, 0)
    alone = fly(made, METHODS["experimental"](made), conditions)
    assert np.allclose(alone.deviation, 0, atol=1e-12)
    safe = fly(made, METHODS["safety"](made), conditions)
    wanted = np.stack([made.clipped(1, k, safe.states[:, k]) for k in range(made.last)], axis=1)
    assert safe.deviation == pytest.approx(np.linalg.norm(safe.inputs - wanted, axis=2).mean(axis=1))


def test_paired_differences_are_far_narrower_than_the_spread_of_runs():
    comparison = compare_methods(robot(), 12, 1, methods=("safety", "schedule"))
    rows = {row["metric"]: row for row in comparison.paired() if row["method"] == "safety"}
    safety, schedule = (comparison.results[key] for key in ("safety", "schedule"))
    differences = safety.columns["delta_v_m_s"] - schedule.columns["delta_v_m_s"]
    row = rows["delta_v_m_s"]
    assert row["difference"] == pytest.approx(differences.mean())
    from scipy.stats import ttest_1samp

    low, high = ttest_1samp(differences, 0.0).confidence_interval(0.95)
    assert (row["low"], row["high"]) == pytest.approx((low, high))


def test_no_difference_is_made_of_infinite_times():
    made = scene("robot")
    conditions = Conditions.draw(made, 3, 0)
    flight = fly(made, METHODS["safety"](made), conditions)
    metrics = measure(made, flight, conditions, "safety")
    metrics.min_ttc[:] = [np.inf, 1.0, 2.0]
    one = outcome(metrics, flight.deviation)
    summary = one.summary()["min_ttc_s"]
    assert summary == {"mean": None, "low": None, "high": None, "worst": 1.0}
    rows = {row["metric"]: row for row in one.against(outcome(metrics, flight.deviation, "other"))}
    assert rows["min_ttc_s"]["difference"] is None
    assert rows["min_distance_m"]["difference"] == 0.0


def test_violations_come_with_clopper_and_pearsons_interval():
    comparison = compare_methods(robot(), 10, 0, methods=("safety", "experimental"))
    safe, alone = (comparison.results[key].summary()["violations"] for key in ("safety", "experimental"))
    assert (safe["mean"], alone["mean"]) == (0, 10)
    assert safe["high"] == pytest.approx(10 * (1 - 0.025**0.1), rel=1e-6)
    assert alone["low"] == pytest.approx(10 * 0.025**0.1, rel=1e-6)


def test_batches_make_no_difference_to_what_is_joined(monkeypatch):
    monkeypatch.setattr("polaris.rta.arena.BATCH", 4)
    comparison = compare_methods(robot(), 10, 0, methods=("schedule",))
    assert len(comparison.results["schedule"].metrics.min_distance) == 10


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
    tuning |= {f"{key}.buffer": 0.1 for key in BUFFERED}
    keys = {name.split(".")[0] for name in tuning}
    comparison = compare_methods(schedule, 1, 0, methods=keys, tuning=tuning)
    table = write_comparison(tmp_path / "one", scenario, comparison).summary
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


def test_a_scene_that_a_method_does_not_admit_is_told():
    schedule = corridor()
    comparison = compare_methods(schedule, 2, 0, methods=("safety", "asif_explicit"))
    assert set(comparison.results) | set(comparison.refused) == {"safety", "asif_explicit"}
    far = compare_methods(DecisionGrid.from_schedule(schedule, half_widths=5.0), 2, 0, methods=("monitor",))
    assert far.results["monitor"].metrics.experimental_share.max() == 0.0  # S throughout, and safe
    assert not far.results["monitor"].metrics.collided.any()


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
    shown = folder.plot_data().shown
    for key in FEW:
        assert np.array_equal(shown[key].states, comparison.shown[key].states)
    lines = [json.loads(line) for line in (folder.path / "decisions.jsonl").read_text().splitlines()]
    assert len(lines) == len(FEW) * comparison.grid.decisions
    assert {line["reason"] for line in lines if line["method"] == "monitor"} <= {
        "U is recoverable",
        "U is not recoverable",
        "S keeps control: dwell or re-entry margin",
    }


@pytest.mark.slow
def test_figures_are_drawn_again_alike(tmp_path):
    scenario, schedule = synthesised()
    folder = write_comparison(
        tmp_path / "one", scenario, compare_methods(schedule, 4, 0, methods=FEW), draw=draw_run
    )
    before = {path.name: path.read_bytes() for path in (folder.path / "figures").glob("[!.]*")}
    draw_run(folder)
    assert before == {path.name: path.read_bytes() for path in (folder.path / "figures").glob("[!.]*")}
    assert {"paths.png", "tradeoffs.pdf"} <= set(before)


def test_command(tmp_path):
    runner, out = CliRunner(), tmp_path / "cmp"
    options = ["--runs", "3", "--methods", "safety,schedule,monitor", "--no-figures", "--out", str(out)]
    options += ["--tune", "monitor.dwell=4"]
    done = runner.invoke(app, ["compare", str(TINY), *options])
    assert done.exit_code == 0, done.output
    assert "violations" in done.output and "proved" in done.output
    words = done.output.split()
    assert {"switches", "deviation", "median", "offline"} <= set(words)
    assert not [word for word in words if len(word) > 1 and word.endswith("-")]
    again = runner.invoke(app, ["compare", str(TINY), *options, "--json"])
    assert again.exit_code == 0
    table = json.loads(again.stdout)
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
