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
from polaris.model.errors import ScenarioError
from polaris.model.thrusters import Thrusters
from polaris.model.tolerances import ROUNDING
from polaris.planning.reference import Reference
from polaris.rta.decision_grid import DecisionGrid
from polaris.rta.methods.monitor import Monitor
from polaris.runs.files.controllers import layer_item
from polaris.runs.read_schedule import read_schedule
from polaris.runs.run import read_run, run
from polaris.scenario.reading import write_toml
from polaris.scenario.scenario import load_scenario, scenario_folder
from polaris.simulation.falsification.search import falsify
from polaris.simulation.simulate import simulate
from polaris.synthesis.controllers.neural import NeuralController
from polaris.synthesis.controllers.policy import Policy
from polaris.synthesis.safety.get_safety import get_safety
from polaris.synthesis.schedule.synthesize import synthesize
from reach.networks.layers import Activation, Affine, Diagonal
from reach.networks.network import Network
from reach.numerics.linear import discretize
from reach.sets.zonotope import Zonotope
from tests.polaris.forging import SETS, repeat
from tests.polaris.tiny import TINY
from tests.reach.single_precision import ORDERS, evaluated
from tests.sizes import fewer

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
    own = safety.reference
    if seed % 2:
        moved = own.chi[0] + rng.normal(size=4) * 0.3
        own = Reference.propagate(system, own.delta, moved, own.nu + 0.05 * rng.normal(size=own.nu.shape))
    return NeuralController("net", system, policy, safety.reference, own, safety.tracking), rng


# -- the tube ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("seed", "errors"), [*((seed, False) for seed in range(12)), *((seed, True) for seed in range(4))]
)
def test_tube_holds_what_flies_from_corners_at_and_between_nodes(seed, errors):
    controller, rng = random_controller(seed, errors)
    system, k, parts = controller.system, seed % 11, 5
    q, h = controller.feedback.nodes_per_cell, controller.tracking.flow.h
    start = Zonotope(0.1 * rng.normal(size=4), 0.15 * rng.normal(size=(4, 6)))
    tube = controller.propagate(start, k)
    assert not tube.refused
    rows = np.vstack([np.eye(4), -np.eye(4), rng.normal(size=(12, 4))])
    signs = np.concatenate([rng.choice([-1.0, 1.0], (300, 6)), rng.uniform(-1, 1, (100, 6))])
    e = start.c + signs @ start.G.T
    Ad, Bd = discretize(system.A, np.hstack([system.B, system.D]), h / parts)
    safe, own = controller.reference.fine(q * parts)[k], controller.own.fine(q * parts)[k]
    support = tube.nodes.support(rows)
    # Disturbances at their worst: constant, turning, or with the state.
    way = rng.normal(size=(len(e), system.D.shape[1]))
    for i in range(q * parts):
        x = safe[i] + e
        if i % parts == 0:
            seen = x + rng.choice([-1.0, 1.0], x.shape) * system.navigation
            u = np.clip(controller.command(k, safe[i], own[i], seen), -system.u_max, system.u_max)
            u = u + rng.choice([-1.0, 1.0], u.shape) * system.thrusters.error(u)
            way = rng.normal(size=way.shape) if seed % 3 == 0 else way
        w = system.w_max * way / np.linalg.norm(way, axis=1, keepdims=True)
        x = x @ Ad.T + np.hstack([u, w]) @ Bd.T
        e = x - safe[i + 1]
        node, inside = divmod(i + 1, parts)
        bound = support[node]
        if inside:
            bound = np.maximum(support[node], support[node + 1]) + tube.intersample[node] @ np.abs(rows).T
        assert np.all(e @ rows.T <= bound + ROUNDING), (i, np.max(e @ rows.T - bound))
    assert np.all(e @ rows.T <= tube.end.support(rows) + ROUNDING)


def test_tube_of_a_small_network_is_no_looser_than_it_has_to_be():
    """A network that is affine on the whole set is followed like an affine law."""
    controller, rng = random_controller(0)
    linear = Network((Affine(0.2 * rng.normal(size=(2, 4)), np.zeros(2)), Activation("clip", -5.0, 5.0)))
    controller = replace(controller, policy=Policy(linear, ("error",), np.ones(4), np.full(2, 0.1)))
    start = Zonotope.box(np.zeros(4), np.full(4, 0.05))
    flown, q = controller.propagate(start, 0), controller.feedback.nodes_per_cell
    Ad, Bd = discretize(controller.system.A, controller.system.B, controller.tracking.flow.h)
    gain, moved = 0.1 * linear.layers[0].W, start
    for _ in range(q):
        moved = (Ad - Bd @ gain) @ moved + controller.loop.flow.period_zonotope
    centred = flown.nodes[-1].half_widths
    assert np.all(centred <= moved.half_widths * 1.03)
    assert np.all(centred >= moved.half_widths * (1 - 1e-9))


def test_commands_lie_in_what_is_said_of_them():
    for seed in range(4):
        controller, rng = random_controller(seed)
        start = Zonotope(np.zeros(4), 0.1 * rng.normal(size=(4, 5)))
        tube = controller.propagate(start, 3)
        middle, spread = controller.commanded(tube.nodes - controller.offset[3], tube.intersample, 3)
        x = controller.reference.fine(4)[3, 0] + rng.choice([-1.0, 1.0], (200, 5)) @ start.G.T
        own = controller.own.fine(4)[3, 0]
        limit = controller.system.u_max
        u = np.clip(controller.command(3, x, own, x), -limit, limit)
        assert np.all(np.abs(u - middle[0]) <= spread[0] + ROUNDING)


# -- the checker's own networks ---------------------------------------------------------------------


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
        checked, known = checked_policy(controller), policy.stack(PARTS)
        G = 0.1 * rng.normal(size=(4, 5))
        d = CheckedZonotope(arb_mat(4, 1), matrix(G.tolist()))
        seen = checked.reads * diagonal([error] * 4)
        enclosed = checked.command(d, matrix([[x] for x in known]), seen)
        for signs in rng.choice([-1.0, 1.0], (60, 5)):
            e = G @ signs
            read = e + rng.choice([-error, error], 4)
            reads = known + policy.stack(
                {"error": -read, "state": read, "time": np.zeros(1), "reference_input": np.zeros(2)}
            )
            u = np.clip(policy.network(reads) * policy.output_scale, -limit, limit)
            left = enclosed.K * matrix([[x] for x in e]) + enclosed.c
            for i in range(2):
                clearance = sum((abs(v) for v in enclosed.V.tolist()[i]), arb(0))
                assert abs(u[i] - left[i, 0]) <= clearance + 1e-12
                assert abs(u[i]) <= enclosed.most[i] + 1e-12


def test_the_checker_books_single_precision_and_no_more_than_synthesis_does():
    """A point in: what is open is rounding alone."""
    left = 0
    for seed in range(12):
        rounded = in_precision(random_controller(seed)[0], "float32")
        policy, limit = rounded.policy, rounded.system.u_max
        known, d = policy.stack(PARTS), CheckedZonotope(arb_mat(4, 1), arb_mat(4, 0))
        given = d, matrix([[x] for x in known]), arb_mat(len(known), 0)
        checked = checked_policy(rounded).command(*given)
        point = Zonotope.point(np.zeros(4))
        hull = rounded.loop.command(point, known)
        clearance = [float(sum((abs(v) for v in row), arb(0)).mid()) for row in checked.V.tolist()]
        middle = np.array([float(x.mid()) for x in checked.c.entries()])
        assert np.all(np.array(clearance) <= hull.half_widths) and np.abs(middle - hull.c).max() < 1e-12
        read = np.concatenate([PARTS[name] for name in policy.inputs])
        for order in ORDERS:
            out = evaluated(policy.network, read, np.float32, order, policy.input_scale)
            u = np.clip((out.astype(np.float32) * policy.output_scale.astype(np.float32)), -limit, limit)
            assert np.all(np.abs(u - middle) <= clearance)
            left += np.any(np.abs(u - middle) > 1e-12)
    assert left > 40


@pytest.mark.parametrize("x", [[2.0**126, 1.0, 1.0], [1.0, 2.0**126, 1.0], [1.0, 1.0, 2.0**126]])
def test_the_checker_refuses_numbers_that_round_to_infinity(x):
    """Inputs, weights and what activations make are each within the format, whatever follows."""
    own, (read, weight, bent) = Rounding.from_precision("float32"), [[arb(size)] for size in x]

    def book(read, weight, bent):
        own.read(read), own.summed([arb(1)], weight, [arb(1)], 1), own.bent(Layer("relu"), bent)

    book(read, weight, bent)
    with pytest.raises(Rejected, match="overflow"):
        book(*([2 * size[0]] for size in (read, weight, bent)))


# -- runs -------------------------------------------------------------------------------------------


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


@pytest.fixture(scope="module")
def alone(made, tmp_path_factory):
    """A copy of its folder, and what the checker says of it."""
    folder = read_run(shutil.copytree(made, tmp_path_factory.mktemp("alone") / "run"))
    return folder, verify(folder.path)


def test_a_run_of_a_network_verifies_and_stands_alone(alone):
    folder, verdict = alone
    assert verdict.outcome == "VERIFIED", verdict.text()
    assert any("layers of 1 networks" in text for _, text in verdict.checked)
    assert folder.summary["synthesis"]["experimental_share"] > 0.3
    assert folder.summary["polaris"]["collided"] is False
    (controller,) = folder.scenario.controllers(get_safety(folder.scenario.problem()))
    assert isinstance(controller, NeuralController)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(fewer(6, 3)))
def test_runs_of_other_networks_verify(seed, tmp_path):
    pytest.importorskip("onnx")
    from benchmarks.policies import write_onnx
    from reach.networks.onnx_file import read_onnx

    rng = np.random.default_rng(seed)
    affine = [layer for layer in read_onnx(HASTY).layers if isinstance(layer, Affine)]
    weights = [layer.W * rng.uniform(0.9, 1.1, layer.W.shape) for layer in affine]
    write_onnx(tmp_path / "other.onnx", [*weights, *(layer.b for layer in affine)])
    folder = run(scene(tmp_path, tmp_path / "other.onnx", name=f"net{seed}"), tmp_path / "run")
    verdict = verify(folder.path)
    assert verdict.outcome == "VERIFIED", verdict.text()
    assert 1 in folder.json("schedule.json")["modes"]


ERRORS = {
    "navigation": {"state_error": [0.004, 0.004, 0.001, 0.001]},
    "thrusters": {"magnitude_error": 0.02, "impulse_bit_N_s": 0.002},
}


@pytest.mark.slow
def test_a_run_with_errors_verifies_and_holds_under_attack(tmp_path):
    pytest.importorskip("onnx")
    folder = run(scene(tmp_path, errors=ERRORS), tmp_path / "run")
    verdict = verify(folder.path)
    assert verdict.outcome == "VERIFIED", verdict.text()
    assert folder.summary["synthesis"]["experimental_share"] > 0.3
    assert falsify(read_schedule(folder), 400).failure is None


def arithmetic(lines):
    return [line for line in lines if line.startswith("network ")]


@pytest.mark.slow
def test_a_run_says_in_which_arithmetic_its_network_is_evaluated(made, alone, tmp_path):
    known = read_run(made).summary["guarantee"]["assumptions"]
    assert (
        arithmetic(known) == [f"network net: {ARITHMETIC['real']}"]
        and "real arithmetic" in ARITHMETIC["real"]
    )
    assert arithmetic(alone[1].trusted) == arithmetic(known)
    single = run(scene(tmp_path, precision="float32"), tmp_path / "run")
    verdict = verify(single.path)
    assert verdict.outcome == "VERIFIED", verdict.text()
    assert arithmetic(verdict.trusted) == [f"network net: {ARITHMETIC['float32']}"]
    for words in ("single precision (float32)", "sums are in any order", "4.8e-07"):
        assert words in ARITHMETIC["float32"]
    assert falsify(read_schedule(single), 200).failure is None


def cancelling(folder):
    """A file of a network that adds and takes away a large number, which single precision does not forget."""
    from tests.reach.test_onnx import model, node

    gain = np.array([[0.5, 0.0, 1.0, 0.0], [0.0, 0.5, 0.0, 1.0]])
    weights = {"W": gain.T, "b": np.full(2, 1e4), "c": np.full(2, -1e4)}
    nodes = [node("Gemm", "x W b", "h"), node("Relu", "h", "r"), node("Add", "r c", "y")]
    path = folder / "cancelling.onnx"
    path.write_bytes(model(nodes, weights, inputs=4).SerializeToString())
    return path


def test_a_run_that_forgets_the_rounding_of_its_network_is_rejected(tmp_path, monkeypatch):
    pytest.importorskip("onnx")
    path = scene(tmp_path, cancelling(tmp_path), precision="float32")
    honest = run(path, tmp_path / "honest")
    assert verify(honest.path).outcome == "VERIFIED", verify(honest.path).text()
    assert honest.summary["synthesis"]["experimental_share"] > 0.1

    def claims_real(data):
        del law_of(data)["precision"]
        line = f"network net: {ARITHMETIC['float32']}"
        data["assumptions"][data["assumptions"].index(line)] = f"network net: {ARITHMETIC['real']}"

    verdict = forged(honest.path, tmp_path / "claimed", claims_real)
    assert verdict.outcome == "REJECTED" and verdict.claim == "controllers", verdict.text()
    assert "precision" in verdict.text()
    loop = NeuralController.loop.func
    exact = property(lambda law: replace(loop(law), network=Network(loop(law).network.layers)))
    monkeypatch.setattr(NeuralController, "loop", exact)
    verdict = verify(run(path, tmp_path / "forgetful").path)
    assert verdict.outcome == "REJECTED" and verdict.claim in SETS, verdict.text()


@pytest.mark.slow
@pytest.mark.parametrize("forgotten", ["navigation", "thrusters"])
def test_tubes_of_a_network_that_forget_an_error_are_rejected(forgotten, tmp_path, monkeypatch):
    pytest.importorskip("onnx")
    path = scene(tmp_path, errors={forgotten: ERRORS[forgotten]})
    fly = NeuralController.propagate
    ideal = lambda law, start, k: fly(replace(law, system=law.system.as_ideal()), start, k)  # noqa: E731
    monkeypatch.setattr(NeuralController, "propagate", ideal)
    verdict = verify(run(path, tmp_path / "run").path)
    assert verdict.outcome == "REJECTED" and verdict.claim in SETS, verdict.text()


def test_a_network_in_another_folder_is_copied_and_found_from_anywhere(tmp_path, monkeypatch):
    pytest.importorskip("onnx")
    (tmp_path / "policies").mkdir()
    shutil.copyfile(HASTY, tmp_path / "policies" / HASTY.name)
    path = scene(tmp_path)
    (tmp_path / HASTY.name).unlink()
    text = path.read_text(encoding="utf-8").replace("hasty.onnx", "policies/hasty.onnx")
    path.write_text("# kept\n" + text, encoding="utf-8")
    scenario = load_scenario(path)
    assert scenario.files() == [tmp_path / "policies" / HASTY.name]
    copied = tomllib.loads(scenario.copy_text())
    assert copied["experimental"][0].pop("path") == "hasty.onnx"
    original = scenario.to_dict()
    assert original["experimental"][0].pop("path") == "policies/hasty.onnx"
    assert copied == original
    monkeypatch.chdir(tmp_path.parent)
    again = type(scenario).from_dict(tomllib.loads(scenario.text_elsewhere()))
    assert again.files() == scenario.files()
    before = scenario.text_elsewhere()
    (tmp_path / "policies" / HASTY.name).write_bytes(HASTY.read_bytes() + b"\x12\x00")
    assert scenario.text_elsewhere() != before


def forged(made, folder, change, files=()):
    """Verdict on a copy whose certificate was changed, hashes and digest made to fit."""
    shutil.copytree(made, folder)
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


def _weight(data):
    law_of(data)["layers"][2]["W"][0][0] = (0.123).hex()


def _bias(data):
    law_of(data)["layers"][0]["b"][1] = (0.5).hex()


def _activation(data):
    law_of(data)["layers"][1]["kind"] = "sigmoid"


def _fewer(data):
    law_of(data)["layers"][1:3] = []


def _scale(data):
    law_of(data)["output_scale"] = [(0.5).hex()] * 2


def _reads(data):
    law_of(data)["inputs"] = ["state"]


def _any_thrust(data):
    data["controllers"][1] = {"name": "net", "kind": "any_thrust"}
    data["assumptions"] = [line for line in data["assumptions"] if not line.startswith("network ")]


FORGERIES = (_weight, _bias, _activation, _fewer, _scale, _reads, _any_thrust)


@pytest.mark.parametrize("change", FORGERIES, ids=lambda change: change.__name__)
def test_a_certificate_of_another_network_is_refused(change, made, tmp_path):
    verdict = forged(made, tmp_path / "forged", change)
    assert verdict.outcome == "REJECTED" and verdict.claim in ("controllers", "format"), verdict.text()


def test_a_file_of_another_network_is_refused(made, tmp_path):
    other = (scenario_folder() / "policies" / "fuel_saver.onnx").read_bytes()
    verdict = forged(made, tmp_path / "forged", lambda data: None, [("hasty.onnx", other)])
    assert verdict.outcome != "VERIFIED" and verdict.claim == "controllers"
    verdict = forged(made, tmp_path / "cut", lambda data: None, [("hasty.onnx", other[:-7])])
    assert verdict.outcome != "VERIFIED" and verdict.claim == "controllers"
    (made.parent / "bare").mkdir()
    shutil.copytree(made, made.parent / "bare" / "run")
    (made.parent / "bare" / "run" / "hasty.onnx").unlink()
    assert verify(made.parent / "bare" / "run").claim == "artefacts"
    with pytest.raises(ScenarioError):
        read_run(made.parent / "bare" / "run")


def test_a_network_without_the_package_that_reads_it_is_not_decided(made, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "onnx", None)
    verdict = verify(made)
    assert verdict.outcome == "UNKNOWN" and "needs the package onnx" in verdict.text()


def test_a_stronger_network_does_not_keep_within_the_claims(made, tmp_path):
    """File, layers and hash agree; the tube that they lead to is another."""
    scenario = (made / "scenario.toml").read_text(encoding="utf-8")
    assert "output_scale_N = 1.0" in scenario
    weaker = scenario.replace("output_scale_N = 1.0", "output_scale_N = 0.2").encode()

    def change(data):
        law_of(data)["output_scale"] = [(0.2).hex()] * 2

    verdict = forged(made, tmp_path / "forged", change, [("scenario.toml", weaker)])
    assert verdict.outcome == "REJECTED", verdict.text()


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


# -- who else flies it ------------------------------------------------------------------------------


def test_simulation_flies_it_and_the_monitor_trusts_its_thrust_limits_only(made):
    scenario = read_run(made).scenario
    schedule = synthesize(scenario)
    flown = simulate(schedule, n=6, seed=1)
    assert flown.states.shape[0] >= 6
    law, q = schedule.controllers[1], schedule.safety.tracking.feedback.nodes_per_cell
    k = schedule.modes.tolist().index(1)
    x, safe = flown.states[:, k * q], schedule.safety.reference.fine(q)[k, 0]
    limit = law.system.u_max
    u = np.clip(law.command(k, safe, law.own.fine(q)[k, 0], x), -limit, limit)
    assert flown.inputs[:, k * q] == pytest.approx(u, abs=1e-12)
    for step in schedule.steps:
        e = flown.states[:, step.k * q] - schedule.safety.reference.fine(q)[step.k, 0]
        rows = np.vstack([np.eye(4), -np.eye(4)])
        assert np.all(e @ rows.T <= step.tube.nodes.support(rows)[0] + ROUNDING)
    monitor = Monitor(DecisionGrid.from_schedule(schedule), trust="declared")
    assert {mode for mode, _ in monitor.prospects} == {0}


# -- what is refused --------------------------------------------------------------------------------

WRONG = {
    "too few inputs": ({"inputs": ["time"]}, "experimental[0].inputs"),
    "an input twice": ({"inputs": ["error", "error"]}, "experimental[0].inputs"),
    "an input that is none": ({"inputs": ["weather"]}, "experimental[0].inputs[0]"),
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


def test_a_missing_package_is_one_error(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "onnx", None)
    with pytest.raises(ScenarioError, match="needs the package onnx"):
        load_scenario(scene(tmp_path))


def test_numbers_beyond_floating_point_refuse_a_step():
    controller, _ = random_controller(0)
    start = Zonotope.box(np.zeros(4), np.full(4, 1e308))
    assert controller.propagate(start, 0).refused


def test_the_slope_of_an_affine_network_is_the_network():
    controller, rng = random_controller(0)
    W = rng.normal(size=(2, 4))
    policy = Policy(Network((Affine(W, np.zeros(2)),)), ("error",), np.full(4, 0.5), np.array([0.1, 0.3]))
    slope = replace(controller, policy=policy).slope
    assert slope.clips and slope.gain == pytest.approx(np.array([[0.1], [0.3]]) * W * 0.5)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["static", "dynamic"])
def test_an_imitation_gets_nearly_the_share_of_the_law_that_it_imitates(name, tmp_path):
    pytest.importorskip("onnx")
    sampled = {"feedback": {"period_s": 2.0}, "recoverable.recourse": "none"}
    law = load_scenario(name, sampled)
    data, file = law.to_dict(), scenario_folder() / "policies" / "fuel_saver.onnx"
    table = {"kind": "neural", "name": "net", "path": str(file), "output_scale_N": 0.2}
    table |= {"input_scale": [1 / 60] * 3 + [1.0] * 3, "reference": {"kind": "unaware"}}
    net = type(law).from_dict(data | {"experimental": [table]})
    assert synthesize(net).share() >= 0.95 * synthesize(law).share()


@pytest.mark.slow
def test_a_flight_under_two_layers_of_64_stays_narrow():
    """The tube of 60 steps of 15 periods."""
    file = scenario_folder() / "policies" / "shortcut.onnx"
    pytest.importorskip("onnx")
    from reach.networks.loop import NetworkLoop
    from reach.networks.onnx_file import read_onnx

    A, B = np.eye(4, k=2), np.eye(4)[:, 2:]
    limited = Network((*read_onnx(file).layers, Activation("clip", -1.0, 1.0)))
    loop = NetworkLoop(A, B, B, 0.02, 0.125, limited, -np.eye(4))
    tube = loop.tube(Zonotope.box(np.zeros(4), [0.05, 0.05, 0.01, 0.01]), 900)
    assert tube.nodes[-1].half_widths.max() < 1.0


@pytest.mark.slow
def test_a_reference_planned_with_a_network_in_view_gives_it_more_time(made, tmp_path):
    folder = run(scene(tmp_path), tmp_path / "run", overrides=["recoverable.recourse=replan"])
    verdict = verify(folder.path)
    assert verdict.outcome == "VERIFIED", verdict.text()
    alone = read_run(made).summary["synthesis"]["experimental_share"]
    assert folder.summary["synthesis"]["experimental_share"] > alone
