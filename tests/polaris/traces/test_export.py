"""Runs as traces: what they say is what the run folder's summary says."""

from functools import cache

import numpy as np
import pytest

import polaris
from polaris.model.errors import ScenarioError
from polaris.model.hill import clohessy_wiltshire, elliptical_nmt
from polaris.model.scene.distances import UNKNOWN, ray_ttc, signed_distances
from polaris.model.scene.free_drift import drift_ttc
from polaris.model.scene.keep_in import KeepInCone, KeepInPolytope
from polaris.model.scene.obstacles import BallObstacle, BoxObstacle, PolytopeObstacle
from polaris.model.scene.satellite import SatelliteObstacle, true_states
from polaris.model.scene.state_limits import KeepInStates, SpeedLimit
from polaris.runs.schedule import write_run
from polaris.simulation.baselines import compare
from polaris.traces import (
    AgentTrace,
    Trace,
    evaluate_legacy,
    evaluate_trace,
    export_run,
    parse_trace,
    read_trace,
    to_trace,
    write_trace,
)
from polaris.traces.placement import place
from polaris.traces.reading import trace_data
from tests.polaris.tiny import synthesised

SYSTEM = clohessy_wiltshire(0.0012, 10.0, 0.2)
T = np.arange(0.0, 301.0, 10.0)
STATES = elliptical_nmt(0.0012, 100.0, 0.0012 * T)
MODES = np.repeat([0, 1, 2], 10)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Makes the run folder of a bundled scenario, with one run of each controller."""

    @cache
    def make(name):
        out = tmp_path_factory.mktemp(name) / "run"
        if name != "tiny":
            return polaris.run(name, out, overrides=["simulation.runs=1"])
        scenario, schedule = synthesised()
        return write_run(out, scenario, schedule, compare(schedule, 1, 0))

    return make


@pytest.mark.parametrize("controller", ["safety", "experimental", "polaris"])
@pytest.mark.parametrize(
    "name", ["tiny", *(pytest.param(name, marks=pytest.mark.slow) for name in ("static", "dynamic"))]
)
def test_exported_run_agrees_with_the_summary(name, controller, folder, tmp_path):
    run = folder(name)
    summary, system = run.summary[controller], run.scenario.system()
    exported = export_run(run.path, controller).trace
    assert read_trace(write_trace(tmp_path / "t.json", exported)).same_as(exported)
    agent = exported.agents["chaser"]
    obstacles = run.scenario.obstacles()
    if name == "dynamic":  # the summary knows where the visitor really was
        assert exported.unsafe["visitor"].set_type == "polytope"
        truth = true_states(obstacles, system, agent.times, 1, np.random.default_rng(0))
        modes = np.where(agent.modes == 3, 0, 1)
        cover = evaluate_trace(exported).agents["chaser"].unsafe[0].distance
        satellites = {key: item[0] for key, item in truth.items()}
        exported = to_trace(agent.times, agent.states, modes, obstacles, system, satellites=satellites).trace
        assert cover.min <= summary["min_distance_m"] + 1e-6  # over-approximated
    metrics = evaluate_trace(exported, system=system).agents["chaser"]
    assert metrics.usage["untrusted"] == pytest.approx(summary["experimental_share"])
    assert metrics.usage["unknown"] == metrics.usage["normal"] == 0
    assert metrics.switches == summary["switches"]
    least = min(item.distance.min for item in metrics.unsafe)
    relative = [agent.states[:, : system.d] - item.centers for item in exported.unsafe.values()]
    step = max(np.linalg.norm(np.diff(position, axis=0), axis=1).max() for position in relative)
    assert summary["min_distance_m"] - 1e-9 <= least <= summary["min_distance_m"] + step / 2
    ttc = np.inf if summary["min_ttc_s"] is None else summary["min_ttc_s"]
    assert min(item.ttc.min for item in metrics.unsafe) == pytest.approx(ttc, rel=1e-6)
    if name != "dynamic":  # another satellite drifts, a set of a trace keeps its velocity
        steps = len(run.json("schedule.json")["modes"])  # the summary asks at their starts
        stride = (len(agent.times) - 1) // steps
        starts = AgentTrace(agent.times[::stride], agent.states[::stride])
        at_starts = evaluate_trace(Trace({"chaser": starts}, exported.unsafe), system=system)
        drift = np.inf if summary["min_ttc_free_drift_s"] is None else summary["min_ttc_free_drift_s"]
        drift_least = min(item.drift_ttc.min for item in at_starts.agents["chaser"].unsafe)
        assert drift_least == pytest.approx(drift, rel=1e-3, abs=0.05)
        assert min(item.drift_ttc.min for item in metrics.unsafe) <= drift + 0.1


def test_runs_are_chosen_by_name(folder, tmp_path):
    run = folder("tiny")
    nominal = export_run(run.path, "safety", "nominal").trace
    centre = run.scenario.initial_set().c
    assert nominal.agents["chaser"].states[0] == pytest.approx(centre)
    assert not nominal.same_as(export_run(run.path, "safety").trace)
    for folder, *wrong, match in (
        (run.path, "safety", "run 7", "--run"),
        (run.path, "nobody", "nominal", "--controller"),
        (tmp_path, "run folder"),
        (tmp_path / "none", "no such folder"),
    ):
        with pytest.raises(ScenarioError, match=match):
            export_run(folder, *wrong)


def test_true_sets_are_themselves():
    """Boxes, balls and polytopes, at rest and moving: the distances of a trace are the true ones."""
    H = np.vstack([np.eye(3), -np.eye(3), [[1, 1, 1]]])
    obstacles = [
        BoxObstacle("box", [50, 50, 0], [10, 20, 30], [0.1, 0, 0.2]),
        BallObstacle("ball", [-50, 100, 10], 15, [0, -0.3, 0]),
        PolytopeObstacle("polytope", H, [5, 6, 7, 8, 9, 10, 11], [0.2, 0.1, 0]),
        PolytopeObstacle("wall", [[1, 0, 0]], [-150], unbounded=True),
    ]
    exported = to_trace(T, STATES, MODES, obstacles, SYSTEM)
    assert exported.notes == () and exported.trace.agents["chaser"].modes.tolist() == [3] * 10 + [2] * 21
    unknown = to_trace(T, STATES, np.full(30, UNKNOWN), [], SYSTEM).trace.agents["chaser"]
    assert set(unknown.modes.tolist()) == {UNKNOWN}
    kinds = [item.set_type for item in exported.trace.unsafe.values()]
    assert kinds == ["rectangle", "ball", "polytope", "polytope"]
    metrics = evaluate_trace(exported.trace).agents["chaser"]
    distances = signed_distances(obstacles, T, STATES[:, :3])
    times = ray_ttc(obstacles, T, STATES[:, :3], STATES[:, 3:])
    for item, distance, ttc in zip(metrics.unsafe, distances, times, strict=True):
        assert item.distance.min == pytest.approx(distance.min(), rel=1e-9)
        assert item.distance.max == pytest.approx(distance.max(), rel=1e-9)
        assert item.ttc.min == pytest.approx(ttc.min(), rel=1e-6)


def test_keep_in_sets_go_facet_by_facet():
    corridor = KeepInPolytope("corridor", np.vstack([np.eye(3), -np.eye(3)]), [300.0] * 6)
    cone = KeepInCone("cone", [0, -900, 0], [0, 1, 0], 0.7)
    exported = to_trace(T, STATES, MODES, [corridor, cone], SYSTEM)
    assert list(exported.trace.unsafe)[:2] == ["corridor[0]", "corridor[1]"]
    assert len(exported.trace.unsafe) == 6 + 12 and len(exported.notes) == 2
    metrics = evaluate_trace(exported.trace).agents["chaser"].unsafe
    truth = signed_distances([corridor, cone], T, STATES[:, :3]).min(axis=1)
    assert min(item.distance.min for item in metrics[:6]) == pytest.approx(truth[0])
    leaving = min(item.distance.min for item in metrics[6:])
    assert 0.9 * truth[1] < leaving <= truth[1]


def test_a_set_is_exported_with_the_time_in_which_it_holds(tmp_path):
    """The set itself at all stamps, and its times: the evaluation measures what runs are measured against."""
    sides = np.vstack([np.eye(3), -np.eye(3)])
    sets = [
        KeepInPolytope("first", sides, [210.0] * 6, ends=150.0),
        KeepInPolytope("later", sides, [198.0] * 6, begins=150.0),
    ]
    exported = to_trace(T, STATES, MODES, sets, SYSTEM)
    read = read_trace(write_trace(tmp_path / "a.json", exported.trace))
    assert read.same_as(exported.trace) and not read.ignored
    spans = {key: item.span for key, item in read.unsafe.items()}
    assert spans["first[2]"] == (-np.inf, 150.0) and spans["later[5]"] == (150.0, np.inf)
    assert all(np.allclose(item.b, item.b[0]) for item in read.unsafe.values()), "at rest"
    data = trace_data(exported.trace)["unsafe"]
    assert data["first[0]"]["until_s"] == 150.0 and "from_s" not in data["first[0]"]
    evaluated = evaluate_trace(read, system=SYSTEM)
    metrics = evaluated.agents["chaser"].unsafe
    assert evaluated.notes[:2] == ("first holds from -inf to 150 s", "later holds from 150 to inf s")
    distances = signed_distances(sets, T, STATES[:, :3])
    rays = ray_ttc(sets, T, STATES[:, :3], STATES[:, 3:])
    drifts = drift_ttc(sets, SYSTEM, T, STATES, 2 * np.pi / 0.0012)
    for k, parts in enumerate((metrics[:6], metrics[6:])):
        assert min(item.distance.min for item in parts) == pytest.approx(distances[k].min())
        assert max(item.distance.max for item in parts) < 500
        assert min(item.ttc.min for item in parts) == pytest.approx(rays[k].min(), rel=1e-6)
        assert min(item.drift_ttc.min for item in parts) == pytest.approx(drifts[k].min(), abs=1.0)
    assert distances[1].min() > 0 and min(item.ttc.min for item in metrics[6:]) > 1
    short = to_trace(T[:10], STATES[:10], MODES[:10], sets, SYSTEM).trace
    assert evaluate_trace(short).agents["chaser"].unsafe[-1].distance is None, "it never holds in the trace"
    legacy = evaluate_legacy(read)["chaser"]["compute_dists"]
    assert np.isfinite(legacy[1]), "RTAEval knows no times of sets"
    for wrong in ({"from_s": None}, {"until_s": "x"}, {"from_s": 2.0, "until_s": 1.0}):
        data["first[0]"] = trace_data(exported.trace)["unsafe"]["first[0]"] | wrong
        with pytest.raises(ScenarioError, match=r"unsafe\.first\[0\]\.(from|until)_s"):
            parse_trace({"agents": trace_data(exported.trace)["agents"], "unsafe": data})


def test_satellite_is_covered_known_or_nominal():
    visitor = SatelliteObstacle("visitor", elliptical_nmt(0.0012, 150.0, 0.1), [2] * 3 + [0.01] * 3, 20.0)
    truth = visitor.nominal(T, SYSTEM) + [1, 0, 0, 0, 0, 0]
    options = {"cover": {}, "nominal": {"satellites": {"visitor": None}}}
    options["known"] = {"satellites": {"visitor": truth}}
    exports = {key: to_trace(T, STATES, MODES, [visitor], SYSTEM, **extra) for key, extra in options.items()}
    assert [len(item.notes) for item in exports.values()] == [1, 1, 0]
    measured = {key: evaluate_trace(item.trace).agents["chaser"] for key, item in exports.items()}
    least = {key: item.unsafe[0].distance.min for key, item in measured.items()}
    assert least["cover"] < least["nominal"] - 2
    for key, satellites in (("known", {"visitor": truth}), ("nominal", None)):
        true = signed_distances([visitor], T, STATES[:, :3], SYSTEM, satellites)
        assert least[key] == pytest.approx(true.min())
    short = to_trace(T[:4], STATES[:4], MODES[:3], [visitor], SYSTEM)
    drifting = evaluate_trace(short.trace, system=SYSTEM).agents["chaser"].unsafe[0].drift_ttc
    assert drifting is not None and drifting.min >= 0
    item, fine = exports["cover"].trace.unsafe["visitor"], np.linspace(0, T[-1], 301)  # between stamps too
    for states in true_states([visitor], SYSTEM, fine, 20, np.random.default_rng(0))["visitor"]:
        for direction in ([20.0, 0, 0], [0, -20.0, 0], [0, 12.0, 16.0]):
            assert place(item, fine, 3).signed_distance(states[:, :3] + direction).max() <= 1e-9
    ends = visitor.timed_polytopes(SYSTEM, 10.0, 30)[0].offsets  # of every cell: at its start and end
    first, last, stamps = ends[1:, 0], ends[:-1, 1], item.b[1:-1]
    assert np.any(first > last) and np.any(first < last) and np.array_equal(stamps, np.maximum(first, last))


def test_arrays_that_do_not_fit():
    ball = BallObstacle("ball", [0, 0, 0], 1)
    cases = [
        ((T[:-1], STATES, MODES, [ball], SYSTEM), "state_trace"),
        ((T, STATES[:, :5], MODES, [ball], SYSTEM), "states"),
        ((T, STATES, MODES[:-1], [ball], SYSTEM), "modes"),
        ((T, STATES, MODES * 1.0, [ball], SYSTEM), "modes"),
        ((T[::-1], STATES, MODES, [ball], SYSTEM), "state_trace"),
        ((T, STATES, MODES, [ball, ball], SYSTEM), "name"),
        ((T + 5, STATES, MODES, [SatelliteObstacle("s", STATES[0], [0] * 6, 1)], SYSTEM), "times"),
    ]
    for arguments, match in cases:
        with pytest.raises(ScenarioError, match=match):
            to_trace(*arguments)


def test_limits_on_the_state_are_margins_of_the_agent(tmp_path):
    """The true limit counts, null stands for times at which it does not hold; what is no list is refused."""
    late = KeepInStates("late", [[0, 0, 0, 1, 0, 0]], [1.0], begins=100.0)
    limits = [SpeedLimit("fast", 0.5, 1e-3), late, BallObstacle("ball", [0.0, 0.0, 0.0], 2.0)]
    exported = to_trace(T, STATES, MODES, limits, SYSTEM)
    assert list(exported.trace.unsafe) == ["ball"] and "clearance to it" in exported.notes[0]
    path = write_trace(tmp_path / "a.json", exported.trace)
    read = read_trace(path)
    assert read.same_as(exported.trace) and not read.ignored
    measured = {one.name: one for one in evaluate_trace(read).agents["chaser"].unsafe}
    speed, far = np.linalg.norm(STATES[:, 3:], axis=1), np.linalg.norm(STATES[:, :3], axis=1)
    assert measured["fast"].distance.min == pytest.approx(float(np.min(0.5 + 1e-3 * far - speed)) * 100)
    assert measured["late"].kind == "limit on states" and measured["late"].distance.at >= 100
    assert measured["late"].distance.share == pytest.approx(2 / 3, abs=0.05) and measured["late"].ttc is None
    for wrong in (1.0, *({"fast": rows} for rows in (2.0, [1.0], ["x"] * len(T), [float("nan")] * len(T)))):
        data = trace_data(exported.trace)
        data["agents"]["chaser"]["margin_trace"] = wrong
        with pytest.raises(ScenarioError, match=r"agents\.chaser\.margin_trace"):
            parse_trace(data)
