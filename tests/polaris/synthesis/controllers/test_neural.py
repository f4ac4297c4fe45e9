"""A network as U: its tube against flights, its run against forgery, its files against mistakes."""

import json
import shutil
import tomllib
import tracemalloc
from dataclasses import replace
from functools import cache
from hashlib import sha256

import numpy as np
import pytest

pytest.importorskip("flint")

from flint import arb, arb_mat

from polaris import DecisionGrid, Monitor, Policy, Reference, ScenarioError, falsify, get_safety, simulate
from polaris.certificate.assumptions import ARITHMETIC
from polaris.certificate.checker import verify, verify_document
from polaris.certificate.files.document import canonical, digest
from polaris.certificate.files.entries import Law, Layer
from polaris.certificate.kernel.balls import diagonal, matrix
from polaris.certificate.kernel.verdict import Rejected
from polaris.certificate.kernel.zonotopes import Zonotope as CheckedZonotope
from polaris.certificate.model.networks import Policy as CheckedPolicy
from polaris.certificate.model.networks import Rounding, band, value
from polaris.certificate.model.obstacle_boxes import ObstacleBoxes
from polaris.certificate.model.onnx_file import read_layers
from polaris.model.thrusters import Thrusters
from polaris.model.tolerances import ROUNDING
from polaris.runs.files.controllers import layer_item
from polaris.runs.read_schedule import read_schedule
from polaris.runs.run import read_run, run
from polaris.scenario.reading import write_toml
from polaris.scenario.scenario import load_scenario, scenario_folder
from polaris.synthesis.controllers.neural import NeuralController
from reach import Activation, Affine, Diagonal, Network, Zonotope, discretize
from tests.polaris.forging import repeat
from tests.polaris.tiny import TINY
from tests.reach.single_precision import ORDERS, evaluated

HASTY = scenario_folder() / "policies" / "hasty.onnx"
SAMPLED = {"feedback": {"period_s": 0.25}, "tracking.R": [60.0, 60.0], "simulation.runs": 3}
KINDS = {
    "relu": Activation("relu", 0.1),
    "tanh": Activation("tanh"),
    "sigmoid": Activation("sigmoid"),
    "clip": Activation("clip", -0.4, 0.7),
    "steep": Activation("relu", 2.5),
}
READS = (("error",), ("state", "time"), ("reference_input", "error", "time"), ("error", "state"), ("time",))


def random_network(rng, inputs, outputs, depth=2, width=12):
    sizes = [inputs, *(int(rng.integers(2, width + 1)) for _ in range(depth)), outputs]
    layers = []
    for before, after in zip(sizes, sizes[1:], strict=False):
        layers += [
            Affine(rng.normal(size=(after, before)) / np.sqrt(before), 0.3 * rng.normal(size=after)),
            KINDS[str(rng.choice(list(KINDS)))],
        ]
    return Network(tuple(layers[:-1]))


@cache
def tiny_safety():
    return get_safety(load_scenario(TINY, SAMPLED))


WRONG_BY = {"estimate_error": [0.02, 0.01, 0.005, 0.01], "thrusters": Thrusters(0.05, 0.03, 0.01)}
"""Errors of estimates and thrusters."""


def random_controller(seed, errors=False):
    rng, safety = np.random.default_rng(seed), tiny_safety()
    system, reads = safety.problem.system, READS[seed % len(READS)]
    system = replace(system, **WRONG_BY) if errors else system
    count = sum({"error": 4, "state": 4, "time": 1, "reference_input": 2}[name] for name in reads)
    scale = rng.uniform(0.2, 1.5, count) * rng.choice([-1, 1], count)
    network = random_network(rng, count, system.m, int(rng.integers(1, 4)))
    policy = Policy(network, reads, scale, rng.uniform(0.3, 3.0, system.m))
    path = safety.reference
    if seed % 2:
        start = path.chi[0] + rng.normal(size=4) * 0.3
        path = Reference.propagate(system, path.delta, start, path.nu + 0.05 * rng.normal(size=path.nu.shape))
    return NeuralController("net", system, policy, safety.reference, path, safety.tracking), rng


@pytest.mark.parametrize(
    ("seed", "errors"), [*((seed, False) for seed in range(6)), *((seed, True) for seed in range(4))]
)
def test_tube_holds_what_flies_from_corners_at_and_between_nodes(seed, errors):
    controller, rng = random_controller(seed, errors)
    system, k, parts = controller.system, seed % 11, 5
    q, h = controller.feedback.nodes_per_cell, controller.tracking.flow.h
    size = 0.002 if errors else 0.15  # small sets leave most to the errors
    start = Zonotope(0.1 * rng.normal(size=4), size * rng.normal(size=(4, 6)))
    tube = controller.propagate(start, k)
    assert not tube.refused
    rows = np.vstack([np.eye(4), -np.eye(4), rng.normal(size=(12, 4))])
    signs = np.concatenate([rng.choice([-1.0, 1.0], (300, 6)), rng.uniform(-1, 1, (100, 6))])
    e = start.c + signs @ start.G.T
    Ad, Bd = discretize(system.A, np.hstack([system.B, system.D]), h / parts)
    safe, targets = controller.reference.fine(q * parts)[k], controller.own.fine(q * parts)[k]
    support, zeta = tube.nodes.support(rows), controller.offset[k]
    middle, spread = controller.commanded(tube.nodes - zeta[: len(tube.nodes.c)], tube.intersample, k)
    # Disturbances at their worst: constant, turning, or with the state.
    direction = rng.normal(size=(len(e), system.D.shape[1]))
    for i in range(q * parts):
        x = safe[i] + e
        if i % parts == 0:
            estimate = x + rng.choice([-1.0, 1.0], x.shape) * system.navigation
            u = np.clip(controller.command(k, safe[i], targets[i], estimate), -system.u_max, system.u_max)
            assert np.all(np.abs(u - middle[i // parts]) <= spread[i // parts] + ROUNDING)
            u = u + rng.choice([-1.0, 1.0], u.shape) * system.thrusters.error(u)
            direction = rng.normal(size=direction.shape) if seed % 3 == 0 else direction
        w = system.w_max * direction / np.linalg.norm(direction, axis=1, keepdims=True)
        x = x @ Ad.T + np.hstack([u, w]) @ Bd.T
        e = x - safe[i + 1]
        node, inside = divmod(i + 1, parts)
        bound = support[node]
        if inside:
            bound = np.maximum(support[node], support[node + 1]) + tube.intersample[node] @ np.abs(rows).T
        assert np.all(e @ rows.T <= bound + ROUNDING), (i, np.max(e @ rows.T - bound))
    assert np.all(e @ rows.T <= tube.end.support(rows) + ROUNDING)


def test_numbers_beyond_floating_point_refuse_a_step():
    start = Zonotope.box(np.zeros(4), np.full(4, 1e308))
    assert random_controller(0)[0].propagate(start, 0).refused


@pytest.mark.parametrize("kind", KINDS)
def test_bands_of_the_checker_hold_the_activation(kind):
    rng, layer = np.random.default_rng(1), Layer(**layer_item(KINDS[kind]))
    for width in (0.0, 1e-12, 0.1, 2.0, 40.0):
        for _ in range(20):
            lo = 3 * rng.normal()
            slope, middle, radius = band(layer, arb(lo), arb(lo) + width)
            for y in (lo, *(lo + width * rng.uniform(0, 1, 8))):
                assert abs(value(layer, arb(y)) - slope * arb(y) - middle) <= radius + 1e-12


def checked_policy(controller):
    """The checker's own account of a network, in a system that stands still."""
    policy, limit = controller.policy, controller.system.u_max
    law = Law(
        *("net", "neural", None, None, None, list(policy.inputs)),
        *(policy.input_scale.tolist(), policy.output_scale.tolist(), layers_of(policy.network)),
        precision=policy.network.precision,
    )
    plant = {"A": arb_mat(4, 4), "B": arb_mat(4, 2), "u_max": list(map(arb, limit))}
    plant = type("Plant", (), plant)
    return CheckedPolicy(law, plant, ObstacleBoxes(plant, {}, arb(0), {}))


PARTS = {"error": np.zeros(4), "state": np.full(4, 0.3), "time": np.array([2.0])}
PARTS |= {"reference_input": np.array([0.1, -0.2])}


def layers_of(network):
    items = [layer_item(layer) for layer in network.layers]
    return [
        Layer(**{k: v.tolist() if hasattr(v, "tolist") else v for k, v in item.items()}) for item in items
    ]


def in_precision(controller, precision):
    """A controller whose network has an elementwise layer as well, evaluated in a precision."""
    layers = controller.policy.network.layers
    size = layers[0].shape[0]
    more = Diagonal(np.linspace(0.5, 1.5, size), np.full(size, 0.1))
    network = Network((layers[0], more, *layers[1:]), precision)
    return replace(controller, policy=replace(controller.policy, network=network))


@pytest.mark.parametrize("error", [0.0, 0.03])
def test_the_checker_encloses_what_a_network_commands(error):
    for seed in range(6):
        controller, rng = random_controller(seed)
        controller = in_precision(controller, "real")
        policy, limit = controller.policy, controller.system.u_max
        checked, inputs = checked_policy(controller), policy.stack(PARTS)
        G = 0.1 * rng.normal(size=(4, 5))
        d = CheckedZonotope(arb_mat(4, 1), matrix(G.tolist()))
        read_errors = checked.reads * diagonal([error] * 4)
        enclosed = checked.command(d, matrix([[x] for x in inputs]), read_errors)
        for signs in rng.choice([-1.0, 1.0], (60, 5)):
            e = G @ signs
            read = e + rng.choice([-error, error], 4)
            reads = inputs + policy.stack(
                {"error": -read, "state": read, "time": np.zeros(1), "reference_input": np.zeros(2)}
            )
            u = np.clip(policy.network(reads) * policy.output_scale, -limit, limit)
            affine_part = enclosed.K * matrix([[x] for x in e]) + enclosed.c
            for i in range(2):
                clearance = sum((abs(v) for v in enclosed.V.tolist()[i]), arb(0))
                assert abs(u[i] - affine_part[i, 0]) <= clearance + 1e-12
                assert abs(u[i]) <= enclosed.size[i] + 1e-12


def test_the_checker_books_single_precision_and_no_more_than_synthesis_does():
    deviations = 0
    for seed in range(12):
        rounded = in_precision(random_controller(seed)[0], "float32")
        policy, limit = rounded.policy, rounded.system.u_max
        inputs, d = policy.stack(PARTS), CheckedZonotope(arb_mat(4, 1), arb_mat(4, 0))
        arguments = d, matrix([[x] for x in inputs]), arb_mat(len(inputs), 0)
        checked = checked_policy(rounded).command(*arguments)
        point = Zonotope.point(np.zeros(4))
        hull = rounded.loop.command(point, inputs)
        clearance = [float(sum((abs(v) for v in row), arb(0)).mid()) for row in checked.V.tolist()]
        middle = np.array([float(x.mid()) for x in checked.c.entries()])
        assert np.all(np.array(clearance) <= hull.half_widths) and np.abs(middle - hull.c).max() < 1e-12
        read = np.concatenate([PARTS[name] for name in policy.inputs])
        for order in ORDERS:
            out = evaluated(policy.network, read, np.float32, order, policy.input_scale)
            u = np.clip((out.astype(np.float32) * policy.output_scale.astype(np.float32)), -limit, limit)
            assert np.all(np.abs(u - middle) <= clearance)
            deviations += np.any(np.abs(u - middle) > 1e-12)
    assert deviations > 40


@pytest.mark.parametrize("x", [[2.0**126, 1.0, 1.0], [1.0, 2.0**126, 1.0], [1.0, 1.0, 2.0**126]])
def test_the_checker_refuses_numbers_that_round_to_infinity(x):
    model, (read, weight, output) = Rounding.from_precision("float32"), [[arb(size)] for size in x]

    def book(read, weight, output):
        model.read(read), model.summed([arb(1)], weight, [arb(1)], 1), model.bent(Layer("relu"), output)

    book(read, weight, output)
    with pytest.raises(Rejected, match="overflow"):
        book(*([2 * size[0]] for size in (read, weight, output)))


def scene(folder, file=HASTY, feedback=None, errors=None, **more):
    """A scenario file in a folder that flies a network beside it."""
    table = {"kind": "neural", "name": "net", "path": file.name, "output_scale_N": 1.0}
    table |= {"reference": {"kind": "unaware"}, **more}
    if file.parent != folder:
        shutil.copyfile(file, folder / file.name)
    data = load_scenario(TINY, SAMPLED).to_dict() | {"experimental": [table]}
    data["feedback"] = feedback or data["feedback"]
    data |= errors or {}
    (folder / "scene.toml").write_text(write_toml(data), encoding="utf-8")
    return folder / "scene.toml"


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    pytest.importorskip("onnx")
    folder = tmp_path_factory.mktemp("neural")
    return run(scene(folder), folder / "run").path


def test_a_run_of_a_network_verifies_and_stands_alone(made, tmp_path):
    folder = read_run(shutil.copytree(made, tmp_path / "run"))
    verdict = verify(folder.path)
    assert verdict.outcome == "VERIFIED", verdict.text()
    assert any("layers of 1 networks" in text for _, text in verdict.checked)
    assert folder.summary["synthesis"]["experimental_share"] > 0.3
    assert folder.summary["polaris"]["collided"] is False
    (controller,) = folder.scenario.controllers(get_safety(folder.scenario.problem()))
    assert isinstance(controller, NeuralController)
    assumptions = folder.summary["guarantee"]["assumptions"]
    assert arithmetic(assumptions) == arithmetic(verdict.trusted) == [f"network net: {ARITHMETIC['real']}"]


def arithmetic(lines):
    return [line for line in lines if line.startswith("network ")]


def claims_real(data):
    del law_of(data)["precision"]
    line = f"network net: {ARITHMETIC['float32']}"
    data["assumptions"][data["assumptions"].index(line)] = f"network net: {ARITHMETIC['real']}"


def test_a_run_says_in_which_arithmetic_its_network_is_evaluated(tmp_path):
    pytest.importorskip("onnx")
    single = run(scene(tmp_path, precision="float32"), tmp_path / "run")
    verdict = verify(single.path)
    assert verdict.outcome == "VERIFIED", verdict.text()
    assert arithmetic(verdict.trusted) == [f"network net: {ARITHMETIC['float32']}"]
    for words in ("single precision (float32)", "sums are in any order", "4.8e-07"):
        assert words in ARITHMETIC["float32"]
    verdict = forged(single.path, tmp_path / "claimed", claims_real)
    assert verdict.outcome == "REJECTED" and verdict.claim == "controllers", verdict.text()
    assert "precision" in verdict.text()


ERRORS = {
    "navigation": {"state_error": [0.02, 0.02, 0.006, 0.006]},
    "thrusters": {"magnitude_error": 0.03, "impulse_bit_N_s": 0.003},
}


@pytest.mark.slow
@pytest.mark.parametrize("forgotten", ERRORS)
def test_a_run_with_errors_verifies_and_one_that_forgets_them_does_not(forgotten, tmp_path, monkeypatch):
    pytest.importorskip("onnx")
    errors = {forgotten: ERRORS[forgotten]}
    (tmp_path / "honest").mkdir()
    folder = run(scene(tmp_path / "honest", errors=errors), tmp_path / "run")
    assert verify(folder.path).outcome == "VERIFIED" and 1 in folder.json("schedule.json")["modes"]
    assert falsify(read_schedule(folder), 100).failure is None
    fly = NeuralController.propagate
    ideal = lambda law, start, k: fly(replace(law, system=law.system.as_ideal()), start, k)  # noqa: E731
    monkeypatch.setattr(NeuralController, "propagate", ideal)
    verdict = verify(run(scene(tmp_path, errors=errors), tmp_path / "forgetful").path)
    assert verdict.outcome == "REJECTED" and verdict.claim in ("goal", "margins", "recoverable", "separation")


def test_a_network_in_another_folder_is_copied_and_found_from_anywhere(tmp_path, monkeypatch):
    pytest.importorskip("onnx")
    path, file = scene(tmp_path), tmp_path / "policies" / HASTY.name
    file.parent.mkdir()
    (tmp_path / HASTY.name).rename(file)
    text = path.read_text(encoding="utf-8").replace("hasty.onnx", "policies/hasty.onnx")
    path.write_text("# kept\n" + text, encoding="utf-8")
    scenario = load_scenario(path)
    assert scenario.files() == [file]
    copied, original = tomllib.loads(scenario.copy_text()), scenario.to_dict()
    assert copied["experimental"][0].pop("path") == "hasty.onnx"
    assert original["experimental"][0].pop("path") == "policies/hasty.onnx" and copied == original
    monkeypatch.chdir(tmp_path.parent)
    before = scenario.text_elsewhere()
    assert type(scenario).from_dict(tomllib.loads(before)).files() == scenario.files()
    file.write_bytes(HASTY.read_bytes() + b"\x12\x00")
    assert scenario.text_elsewhere() != before


def forged(run_folder, folder, change, files=()):
    """Verdict on a copy whose certificate was changed, hashes and digest made to fit."""
    shutil.copytree(run_folder, folder)
    for name, contents in files:
        (folder / name).write_bytes(contents)
    data = json.loads((folder / "certificate.json").read_text(encoding="utf-8"))
    change(data)
    gains = json.loads((folder / "gains.json").read_text(encoding="utf-8"))
    repeat(data, gains)
    (folder / "gains.json").write_text(json.dumps(gains), encoding="utf-8")
    for name in data["artefacts"]:
        data["artefacts"][name] = sha256((folder / name).read_bytes()).hexdigest()
    data["digest"] = digest(data)
    (folder / "certificate.json").write_text(canonical(data), encoding="utf-8")
    return verify(folder)


def law_of(data):
    return data["controllers"][1]


def any_thrust(data):
    data["controllers"][1] = {"name": "net", "kind": "any_thrust"}
    data["assumptions"] = [line for line in data["assumptions"] if not line.startswith("network ")]


FORGERIES = {
    "weight": lambda data: law_of(data)["layers"][2]["W"][0].__setitem__(0, (0.123).hex()),
    "bias": lambda data: law_of(data)["layers"][0]["b"].__setitem__(1, (0.5).hex()),
    "activation": lambda data: law_of(data)["layers"][1].update(kind="sigmoid"),
    "fewer": lambda data: law_of(data)["layers"].__delitem__(slice(1, 3)),
    "scale": lambda data: law_of(data).update(output_scale=[(0.5).hex()] * 2),
    "reads": lambda data: law_of(data).update(inputs=["state"]),
    "any thrust": any_thrust,
}


@pytest.mark.parametrize("name", FORGERIES)
def test_a_certificate_of_another_network_is_refused(name, made, tmp_path):
    verdict = forged(made, tmp_path / "forged", FORGERIES[name])
    assert verdict.outcome == "REJECTED" and verdict.claim in ("controllers", "format"), verdict.text()


def test_a_file_of_another_network_is_refused(made, tmp_path):
    other = (scenario_folder() / "policies" / "fuel_saver.onnx").read_bytes()
    for name, content in (("forged", other), ("cut", other[:-7])):
        verdict = forged(made, tmp_path / name, lambda data: None, [("hasty.onnx", content)])
        assert verdict.outcome != "VERIFIED" and verdict.claim == "controllers"
    bare = shutil.copytree(made, tmp_path / "bare")
    (bare / "hasty.onnx").unlink()
    assert verify(bare).claim == "artefacts"
    with pytest.raises(ScenarioError):
        read_run(bare)


def test_a_network_without_the_package_that_reads_it_is_not_decided(made, tmp_path, monkeypatch):
    path = scene(tmp_path)
    monkeypatch.setitem(__import__("sys").modules, "onnx", None)
    verdict = verify(made)
    assert verdict.outcome == "UNKNOWN" and "needs the package onnx" in verdict.text()
    with pytest.raises(ScenarioError, match="needs the package onnx"):
        load_scenario(path)


def test_the_checker_reads_files_as_the_package_does(tmp_path):
    pytest.importorskip("onnx")
    from reach.networks.onnx_file import read_onnx
    from tests.reach.test_onnx import CHAINS, WEIGHTS, WRONG, saved

    for nodes, more in CHAINS.values():
        path = saved(tmp_path, nodes, WEIGHTS | more)
        assert read_layers(path.read_bytes(), 3) == layers_of(read_onnx(path)), nodes
    for nodes, more, _ in WRONG.values():
        with pytest.raises(Exception):  # noqa: B017 - `check_file` takes all alike
            read_layers(saved(tmp_path, nodes, WEIGHTS | more).read_bytes(), 3)


def test_the_checker_reads_elementwise_operators_at_the_cost_of_their_file():
    pytest.importorskip("onnx")
    from tests.reach.test_onnx import chain

    data = chain(["Add", "Mul", "Sub", "Div"] * 75).SerializeToString()
    tracemalloc.start()
    layers = read_layers(data, 4)
    assert tracemalloc.get_traced_memory()[1] < 50e6  # a dense matrix of this width is 134 MB as doubles
    tracemalloc.stop()
    assert len(layers) == 301 and layers[1] == Layer("diagonal", scale=[1.0], b=[1.5])
    with pytest.raises(ValueError, match="1000 layers"):
        read_layers(chain(["Relu"] * 1001, 4).SerializeToString(), 4)


def test_a_network_too_wide_to_follow_is_not_decided(made):
    data = json.loads((made / "certificate.json").read_text(encoding="utf-8"))
    zero, width = (0.0).hex(), 4000
    wide = {"kind": "affine", "W": [[zero] * 4] * width, "b": [zero] * width}
    back = {"kind": "affine", "W": [[zero] * width] * 2, "b": [zero] * 2}
    law_of(data)["layers"] = [wide, {"kind": "tanh", "low": zero, "high": zero}, back]
    data["digest"] = digest(data)
    verdict = verify_document(data)
    assert verdict.outcome == "UNKNOWN" and "too long to follow" in verdict.text()


def test_simulation_flies_it_and_the_monitor_trusts_its_thrust_limits_only(made):
    schedule = read_schedule(read_run(made))
    runs, q = simulate(schedule, n=6, seed=1), schedule.safety.tracking.feedback.nodes_per_cell
    law, k = schedule.controllers[1], schedule.modes.tolist().index(1)
    rows, limit = np.vstack([np.eye(4), -np.eye(4)]), law.system.u_max
    x, safe = runs.states[:, k * q], schedule.safety.reference.fine(q)[:, 0]
    u = np.clip(law.command(k, safe[k], law.own.fine(q)[k, 0], x), -limit, limit)
    assert runs.inputs[:, k * q] == pytest.approx(u, abs=1e-12)
    for step in schedule.steps:
        e = runs.states[:, step.k * q] - safe[step.k]
        assert np.all(e @ rows.T <= step.tube.nodes.support(rows)[0] + ROUNDING)
    monitor = Monitor(DecisionGrid.from_schedule(schedule), trust="declared")
    assert {mode for mode, _ in monitor.prospects} == {0}


WRONG = {
    "too few inputs": ({"inputs": ["time"]}, "experimental[0].inputs"),
    "an input twice": ({"inputs": ["error", "error"]}, "experimental[0].inputs"),
    "an input that is none": ({"inputs": ["weather"]}, "experimental[0].inputs[0]"),
    "no such body": ({"inputs": ["error", "position:sun"]}, "experimental[0].inputs"),
    "no such input of a body": ({"inputs": ["error", "distance:pillar"]}, "experimental[0].inputs[1]"),
    "scales": ({"input_scale": [1.0, 2.0]}, "experimental[0].input_scale"),
    "a scale of outputs": ({"output_scale_N": [1.0, 1.0, 1.0]}, "experimental[0].output_scale_N"),
    "no file": ({"path": "nowhere.onnx"}, "experimental[0].path"),
    "no ONNX file": ({"path": "text.onnx"}, "experimental[0].path"),
    "another ending": ({"path": "hasty.pickle"}, "experimental[0].path"),
    "a network of another size": ({"path": "fuel_saver.onnx"}, "experimental[0].inputs"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_does_not_fit_is_one_error(name, tmp_path):
    pytest.importorskip("onnx")
    changes, field = WRONG[name]
    (tmp_path / "text.onnx").write_text("no network", encoding="utf-8")
    shutil.copyfile(scenario_folder() / "policies" / "fuel_saver.onnx", tmp_path / "fuel_saver.onnx")
    with pytest.raises(ScenarioError) as raised:
        load_scenario(scene(tmp_path, **changes))
    assert raised.value.field == field
    assert "\n" not in str(raised.value)


def test_a_network_of_other_outputs_is_named(tmp_path):
    pytest.importorskip("onnx")
    from tests.reach.test_onnx import node, saved

    file = saved(tmp_path, [node("MatMul", "x W", "y")], {"W": np.eye(4)[:, :3]}, inputs=4, outputs=3)
    with pytest.raises(ScenarioError) as raised:
        load_scenario(scene(tmp_path, file))
    assert (raised.value.field, raised.value.given) == ("experimental[0].path", "policy.onnx")
    assert raised.value.rule == "must have 2 outputs, one per input of the system, but has 3"
