"""Networks that read where other bodies are: what they may be told, tubes, runs and forgeries."""

import json
import tomllib
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("flint")

from polaris import DecisionGrid, evaluate, falsify, get_safety, load_scenario, run, simulate, synthesize
from polaris.certificate.checker import verify, verify_document
from polaris.certificate.files.document import Document, digest
from polaris.certificate.model.obstacle_boxes import ObstacleBoxes
from polaris.certificate.model.plants import plant_of
from polaris.model.scene.obstacles import BallObstacle, PolytopeObstacle
from polaris.model.scene.satellite import SatelliteObstacle, true_states
from polaris.model.tolerances import ROUNDING
from polaris.rta.flight import Conditions, fly
from polaris.rta.methods import METHODS
from polaris.runs.certificate import certificate
from polaris.runs.read_schedule import read_schedule
from polaris.scenario.reading import write_toml
from polaris.scenario.schedule import ScheduleScenario
from polaris.simulation.disturbances import adjoint_worst_case
from polaris.simulation.integration import Integrator
from polaris.synthesis.controllers.neural import NeuralController
from polaris.synthesis.controllers.policy import OF_BODY, Policy
from reach import Affine, Zonotope, discretize
from tests.polaris.forging import SETS
from tests.polaris.random_scenarios import random_scenario
from tests.polaris.synthesis.controllers.test_neural import (
    HASTY,
    SAMPLED,
    WRONG_BY,
    forged,
    law_of,
    random_network,
    tiny_safety,
)
from tests.polaris.tiny import TINY

VISITOR = {
    "kind": "satellite",
    "name": "visitor",
    "state": [9.0, -2.0, -0.1, 0.05],
    "state_half_widths": [0.1, 0.1, 0.01, 0.01],
    "radius_m": 0.4,
    "thrust_accel_max_m_s2": 0.004,
}
READS = (
    ("error", "relative_position:visitor"),
    ("position:trolley", "velocity:visitor", "state"),
    ("relative_velocity:wall", "position:visitor", "error", "time"),
    ("relative_velocity:visitor", "relative_position:visitor", "position:visitor"),
    ("velocity:trolley", "error", "relative_position:trolley"),
)


def bodies():
    """One that keeps its velocity, one that is uncertain and thrusts, and a wall that moves."""
    wall = PolytopeObstacle("wall", [[1.0, 0.0]], [-9.0], velocity=[0.02, 0.0], unbounded=True)
    fields = {
        key: value
        for key, value in VISITOR.items()
        if key not in ("kind", "thrust_accel_max_m_s2", "radius_m")
    }
    visitor = SatelliteObstacle(**fields, radius=0.4, thrust_accel_max=0.004)
    return BallObstacle("trolley", [7.0, 1.0], 0.5, velocity=[-0.05, 0.1]), visitor, wall


def random_controller(seed, errors=False):
    """A random network that reads bodies, about the safe reference of the tiny scene."""
    rng, safety, reads = np.random.default_rng(seed), tiny_safety(), READS[seed % len(READS)]
    system = replace(safety.problem.system, **WRONG_BY) if errors else safety.problem.system
    count = sum({"error": 4, "state": 4, "time": 1}.get(name, 2) for name in reads)
    network = random_network(rng, count, system.m, int(rng.integers(1, 4)))
    scale = rng.uniform(0.05, 0.4, count) * rng.choice([-1, 1], count)
    policy = Policy(network, reads, scale, rng.uniform(0.3, 3.0, system.m))
    arguments = system, policy, safety.reference, safety.reference, safety.tracking, bodies()
    return NeuralController("net", *arguments), rng


def test_boxes_hold_where_a_satellite_may_be_and_no_more():
    system, h, count = tiny_safety().problem.system, 0.25, 41
    visitor = bodies()[1]
    middle, half = visitor.state_boxes(system, h, count)
    times, reach = np.arange(count) * h, np.zeros((count, 4))
    drawn = true_states([visitor], system, times, 400, np.random.default_rng(0))["visitor"]
    assert np.all(np.abs(drawn - middle) <= half)
    # Both inputs act on the acceleration: at worst both along an axis, from a corner.
    push, widths = system.w_max + 0.004, np.asarray(VISITOR["state_half_widths"])
    reach[:, :2] = widths[:2] + times[:, None] * widths[2:] + push * times[:, None] ** 2 / 2
    reach[:, 2:] = widths[2:] + push * times[:, None]
    assert half == pytest.approx(reach, rel=1e-6)


def test_a_rigid_body_is_where_it_is_but_for_the_clock():
    system = tiny_safety().problem.system
    late = replace(system, timing=replace(system.timing, clock=0.5))
    middle, half = bodies()[0].state_boxes(late, 2.0, 3)
    assert middle == pytest.approx(
        np.array([[7, 1, -0.05, 0.1], [6.9, 1.2, -0.05, 0.1], [6.8, 1.4, -0.05, 0.1]])
    )
    assert half == pytest.approx(np.tile([0.025, 0.05, 0, 0], (3, 1)), abs=1e-7)


@pytest.mark.parametrize("seed", range(len(READS)))
def test_the_checker_finds_the_same_places(seed):
    law = random_controller(seed)[0]
    document = Document(certificate(synthesize(tiny_safety(), experimental=[law]), "tiny"))
    checked = ObstacleBoxes.from_document(document, document.laws[1], plant_of(document))
    middle, half = law.obstacle_motion
    for k, i in ((0, 0), (3, 2), (11, 4)):
        for j, body in enumerate(law.senses.bodies):
            centre, radii = checked._box(body.name, k * document.q + i)
            for a, b, c, r in zip(centre, radii, middle[k, i, 4 * j :], half[k, i, 4 * j :], strict=False):
                assert a + b <= c + r and a - b >= c - r
                assert float(b.mid()) >= 0.98 * r - 1e-7


@pytest.mark.parametrize(
    ("seed", "errors"), [*((seed, False) for seed in range(5)), *((seed, True) for seed in range(5))]
)
def test_tube_holds_what_flies_whatever_it_is_told(seed, errors):
    law, rng = random_controller(seed, errors)
    system, k, q, h = law.system, seed % 11, law.feedback.nodes_per_cell, law.tracking.flow.h
    size = 0.002 if errors else 0.15  # small sets leave most to the errors
    start = Zonotope(0.1 * rng.normal(size=4), size * rng.normal(size=(4, 6)))
    tube, safe = law.propagate(start, k), law.reference.fine(q)[k]
    assert not tube.refused
    rows = np.vstack([np.eye(4), -np.eye(4), rng.normal(size=(12, 4))])
    e = start.c + rng.choice([-1.0, 1.0], (400, 6)) @ start.G.T
    Ad, Bd = discretize(system.A, np.hstack([system.B, system.D]), h)
    middle, spread = law.commanded(tube.nodes, tube.intersample, k)
    for i in range(q):
        readings = (
            law.obstacle_motion[0][k, i]
            + rng.choice([-1.0, 1.0], (400, law.sight.shape[1])) * law.obstacle_motion[1][k, i]
        )
        x = safe[i] + e
        estimate = x + rng.choice([-1.0, 1.0], x.shape) * system.navigation
        u = np.clip(law.command(k, safe[i], safe[i], estimate, i * h, readings), -system.u_max, system.u_max)
        assert np.all(np.abs(u - middle[i]) <= spread[i] + ROUNDING)
        u = u + rng.choice([-1.0, 1.0], u.shape) * system.thrusters.error(u)
        w = rng.normal(size=u.shape)
        w *= system.w_max / np.linalg.norm(w, axis=1, keepdims=True)
        e = x @ Ad.T + np.hstack([u, w]) @ Bd.T - safe[i + 1]
        assert np.all(e @ rows.T <= tube.nodes[i + 1].support(rows) + ROUNDING)


def scene(
    folder, seed=1, inputs=("error", "relative_position:visitor", "velocity:trolley"), size=0.05, **more
):
    """A scenario file beside a network that tracks, and gives way to other bodies at random."""
    from benchmarks.policies import write_onnx
    from reach.networks.onnx_file import read_onnx

    data, rng = load_scenario(TINY, SAMPLED).to_dict(), np.random.default_rng(seed)
    data["obstacles"] = [*data["obstacles"], VISITOR]
    layers = [layer for layer in read_onnx(HASTY).layers if isinstance(layer, Affine)]
    width = 2 * (len(inputs) - 1)
    layers[0] = Affine(
        np.hstack([layers[0].W, size * rng.normal(size=(len(layers[0].W), width))]), layers[0].b
    )
    write_onnx(folder / "net.onnx", [*(layer.W for layer in layers), *(layer.b for layer in layers)])
    table = {
        "kind": "neural",
        "name": "net",
        "path": "net.onnx",
        "output_scale_N": 1.0,
        "inputs": list(inputs),
    }
    data["experimental"] = [table | {"reference": {"kind": "unaware"}}]
    data |= more
    (folder / "scene.toml").write_text(write_toml(data), encoding="utf-8")
    return folder / "scene.toml"


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    pytest.importorskip("onnx")
    folder = tmp_path_factory.mktemp("bodies")
    return run(scene(folder), folder / "run")


@pytest.fixture(scope="module")
def schedule(made):
    return read_schedule(made)


def test_a_run_verifies_flies_and_holds_under_attack(made, schedule):
    verdict = verify(made.path)
    assert verdict.outcome == "VERIFIED", verdict.text()
    assert made.summary["synthesis"]["experimental_share"] > 0.3
    assert made.summary["polaris"]["collided"] is False
    assert falsify(schedule, 400).failure is None


def test_attacks_steer_what_is_read_by_the_gradient(schedule):
    """The readings that the adjoint chooses move a state further than any drawn at random."""
    flight, rng = Integrator(schedule, np.ones(len(schedule.modes), dtype=int), 1), np.random.default_rng(0)
    rows, target, read = np.vstack([np.eye(4), -np.eye(4)]), flight.steps // 2, flight.columns[-1]
    w = adjoint_worst_case(flight, rows, np.full(8, target))[0]
    only, start = 0 * w, np.repeat(schedule.safety.problem.initial_set.c[None], 8, axis=0)
    only[..., read] = w[..., read]
    assert np.any(only[:target]) and not np.any(only[target:])
    worst = np.sum(rows * flight.run(start, only).states[:, target], axis=1)
    for _ in range(10):
        only[..., read] = rng.choice([-1.0, 1.0], only[..., read].shape)
        assert np.all(worst > np.sum(rows * flight.run(start, only).states[:, target], axis=1))


def test_run_time_methods_fly_a_network_that_reads_bodies(schedule):
    grid = DecisionGrid.from_schedule(schedule, 0.5, 0.0, None)
    runs = fly(grid, METHODS["experimental"].on(grid), Conditions.draw(grid, 6, 0))
    assert np.ptp(runs.inputs[:, 0], axis=0).max() > 0, "told different things at once"


def test_flights_read_the_truth_and_are_judged_by_it(schedule):
    runs = simulate(schedule, 8, 3)
    law, q, k = schedule.controllers[1], schedule.safety.tracking.feedback.nodes_per_cell, None
    k = schedule.modes.tolist().index(1)
    truth, h = runs.bodies["visitor"], law.tracking.flow.h
    for i in range(q):
        readings = law.senses.body_motion(k + i * h, {"visitor": truth[:, k * q + i]}, 8)
        assert readings[:, :4] == pytest.approx(truth[:, k * q + i])
        assert np.all(np.abs(readings - law.obstacle_motion[0][k, i]) <= law.obstacle_motion[1][k, i])
        target, x = law.own.fine(q)[k, i], runs.states[:, k * q + i]
        u = np.clip(law.command(k, target, target, x, i * h, readings), -law.system.u_max, law.system.u_max)
        assert runs.inputs[:, k * q + i] == pytest.approx(u, abs=1e-12)
    far = replace(runs, bodies={"visitor": truth + [100.0, 0.0, 0.0, 0.0]})
    assert np.all(evaluate(far).closest_set != 2)
    assert evaluate(far).min_distance.min() >= evaluate(runs).min_distance.min()


def body(place, **changes):
    """Return a change of a body that the network reads."""
    return lambda data: law_of(data)["obstacles"][place].update(changes)


def reads(name):
    """Return a change of what the network reads."""
    return lambda data: law_of(data)["inputs"].__setitem__(1, name)


def moved(data):
    law_of(data)["obstacles"][0]["state"][0] = (9.5).hex()


OTHER = {
    "moved": moved,
    "surer": body(0, state_half_widths=[(0.0).hex()] * 4),
    "weaker": body(0, thrust_accel_max_m_s2=(0.0).hex()),
    "at rest": body(1, velocity_m_s=None),
    "another": reads("relative_position:trolley"),
    "absolute": reads("position:visitor"),
}
WRONG_ALONE = {
    "unknown": lambda data: law_of(data)["obstacles"].pop(0),
    "twice": lambda data: law_of(data)["obstacles"].append(law_of(data)["obstacles"][0]),
    "ghost": reads("relative_position:ghost"),
    "negative": body(0, thrust_accel_max_m_s2=(-0.004).hex()),
    "both": body(0, center_m=[(0.0).hex()] * 2),
    "half": body(0, state_half_widths=None),
}


@pytest.mark.parametrize("name", OTHER)
def test_a_certificate_of_other_bodies_is_refused(name, made, tmp_path):
    verdict = forged(made.path, tmp_path / "forged", OTHER[name])
    assert verdict.outcome == "REJECTED" and verdict.claim in ("controllers", "format"), verdict.text()


@pytest.mark.parametrize("name", WRONG_ALONE)
def test_a_certificate_that_lies_alone_is_whole_about_bodies(name, made):
    data = json.loads((made.path / "certificate.json").read_text(encoding="utf-8"))
    WRONG_ALONE[name](data)
    verdict = verify_document(data | {"digest": digest(data)})
    assert (verdict.outcome, verdict.claim) == ("REJECTED", "format"), verdict.text()


def test_bodies_that_are_altered_in_certificate_and_scenario_alike_are_refused(made, tmp_path):
    """Then the unsafe set is another; where that is altered too, what the network does is."""
    scenario = tomllib.loads((made.path / "scenario.toml").read_text(encoding="utf-8"))
    scenario["obstacles"][-1]["state"][0] += 0.5
    verdict = forged(
        made.path, tmp_path / "forged", moved, [("scenario.toml", write_toml(scenario).encode())]
    )
    assert verdict.outcome == "REJECTED" and verdict.claim == "unsafe_sets", verdict.text()


def test_tubes_that_forget_where_bodies_may_be_are_rejected(tmp_path, monkeypatch):
    pytest.importorskip("onnx")
    whereabouts = SatelliteObstacle.state_boxes

    def wrong(self, system, h, count):
        middle, half = whereabouts(self, system, h, count)
        return middle, 0 * half

    monkeypatch.setattr(SatelliteObstacle, "state_boxes", wrong)
    verdict = verify(run(scene(tmp_path, size=0.2), tmp_path / "run").path)
    assert verdict.outcome == "REJECTED" and verdict.claim in SETS


def random_scene(seed, folder):
    """A random scene whose network tracks, and gives way to all that moves, at random."""
    from benchmarks.policies import write_onnx

    data, rng = tomllib.loads(random_scenario(seed)), np.random.default_rng(seed)
    data["feedback"] = {"period_s": data["horizon"]["step_s"] / 3}
    data["recoverable"] = {"kind": "polytope", "recourse": "none"}
    data.pop("timing", None)
    data.get("schedule", {}).pop("delta_v_max_m_s", None)
    moves = [o["name"] for o in data["obstacles"] if o["kind"] == "satellite" or o.get("velocity_m_s")]
    inputs = ["error", *(f"{rng.choice(OF_BODY)}:{name}" for name in moves)]
    data["experimental"] = [{"kind": "any_thrust", "name": "net"}]
    safety = get_safety(ScheduleScenario.from_dict(data))
    system, chi = safety.problem.system, safety.reference.chi
    gain, size = safety.tracking.gain / system.u_max[:, None], 1e-9 + np.abs(chi).max(axis=0)
    rates = [np.abs(chi @ rows.T).max() for rows in (system.position, system.velocity)]
    scales = [np.full(system.d, 1e-9 + rates["velocity" in name]) for name in inputs[1:]]
    W = [np.hstack([gain * size * 0.5, *(0.05 * rng.normal(size=(system.m, system.d)) for _ in scales)])]
    W += [np.eye(system.m)] * 2
    write_onnx(folder / "net.onnx", [*W, *(np.zeros(system.m) for _ in W)])
    table = {"kind": "neural", "name": "net", "path": str(folder / "net.onnx"), "inputs": inputs}
    scale = (1 / np.concatenate([size, *scales])).tolist()
    data["experimental"] = [table | {"input_scale": scale, "output_scale_N": system.u_max.tolist()}]
    return ScheduleScenario.from_dict(data), moves


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 11, 25, 53])
def test_random_scenes(seed, tmp_path):
    pytest.importorskip("onnx")
    scenario, moves = random_scene(seed, tmp_path)
    schedule = synthesize(scenario)
    assert moves and 1 in schedule.modes
    verdict = verify_document(certificate(schedule, scenario.name))
    assert verdict.outcome == "VERIFIED", verdict.text()
    assert falsify(schedule, 300, seed).failure is None
