"""Run folders in which all files agree on a lie, or are no files at all: refused, without a crash."""

import json
import os
import random
from types import SimpleNamespace

import numpy as np
import pytest

from polaris.certificate.checker import verify, verify_document
from polaris.certificate.files.artefacts import SUMMARY
from polaris.certificate.files.document import canonical, digest
from polaris.certificate.files.entries import UnsafeSet
from polaris.certificate.files.inputs import _check_initial_set
from polaris.certificate.files.repeated import _check_reason
from polaris.certificate.files.structure import Items, Text, conform, number, strict_json
from polaris.certificate.kernel.verdict import EXIT_CODES, Rejected
from polaris.certificate.model.perception import RIGID, _check_obstacle, _row_support
from polaris.certificate.model.references import check_goal
from polaris.model.scene.obstacles import BallObstacle, BoxObstacle, PolytopeObstacle
from polaris.model.system import LinearSystem
from polaris.synthesis.safety.end_condition import prove_end
from polaris.synthesis.safety.recoverable import Margin
from tests.polaris.forging import CERTIFICATE, Forger, Lie, make

SCENARIO = "scenario.toml"


@pytest.fixture(scope="module")
def forger(tmp_path_factory):
    folder = tmp_path_factory.mktemp("joint")
    return Forger(make([], folder), folder)


@pytest.fixture
def lie(forger):
    return Lie(forger)


def refused(verdict, claim):
    assert (verdict.outcome, verdict.claim) == ("REJECTED", claim), verdict.text()


def test_a_set_at_rest_may_not_move_by_a_bit_so_that_nothing_is_assumed_of_it(lie):
    pillar = lie.certificate["unsafe_sets"][0]
    rows = pillar["offsets"][3][0]
    pillar["offsets"][3][0] = [np.nextafter(float.fromhex(x), np.inf).hex() for x in rows]
    claim = lie.schedule["guarantee"]
    claim["reason"] = claim["reason"].replace("(trolley)", "(pillar, trolley)")
    lie.guarantee()
    assert not any(line.startswith("sets at rest") for line in lie.certificate["assumptions"])
    refused(lie.verdict(), "unsafe_sets")


@pytest.mark.parametrize(
    ("reason", "claim"),
    [
        ("pillar at t = 13 s: needs 0.1, available 0.05", ""),
        ("pillar at t = 13 s: needs 0.1 kg, available 0.05 kg", "end"),
        ("but safe for ever, whatever happens", "end"),
        ("safe for ever, really at t = 13 s: needs 0.1, available 0.05", "end"),
        ("pillar at t = ever s: needs nothing of it", "end"),
    ],
)
def test_the_words_for_no_claim_after_the_end_are_those_of_a_limit(lie, reason, claim):
    step, K = lie.schedule["step_s"], len(lie.schedule["modes"])
    lie.certificate["horizon"] = "none"
    lie.schedule["guarantee"]["reason"] = f"not proven after T = {K * step:g} s: {reason}"
    lie.guarantee()
    verdict = lie.verdict()
    assert verdict.claim == claim and (verdict.outcome == "VERIFIED") == (not claim), verdict.text()


@pytest.mark.parametrize(("limit", "unit"), [("pillar", " m"), ("radial thrust", " N"), ("input 0", "")])
def test_the_words_for_no_claim_after_the_end_have_units_and_are_understood(limit, unit):
    start = Margin(-1.0, limit, 13.0, 0.25, 0.125)
    end = prove_end(SimpleNamespace(delta=1.0), None, 10, 5, (), start)
    text = f"{limit} at t = 13 s: needs 0.25{unit}, available 0.125{unit}"
    assert end.reason == f"not proven after T = 10 s, though S flies on: {text}"
    unsafe, inputs = [SimpleNamespace(name="pillar")], ["radial thrust", "input 0"]
    scene = {"unsafe": unsafe, "input_names": inputs, "mean_motion": None, "moves": lambda item: False}
    _check_reason(SimpleNamespace(horizon="none", claim_end=10.0, **scene), end.reason)


@pytest.mark.parametrize(("eta", "how"), [(None, "on a closed orbit"), (1e-3, "at rest")])
def test_the_words_for_how_the_reference_ends_fit_the_system(eta, how):
    reason = f"the reference ends {how}, and all unsafe sets are static"
    document = SimpleNamespace(horizon="infinite", claim_end=None, unsafe=[], mean_motion=eta)
    with pytest.raises(Rejected, match="how in the reason"):
        _check_reason(document, reason)
    spec = {"kind": "linear_nmt", "amplitude_max_m": 1e9}
    with pytest.raises(Rejected, match="Hill"):
        check_goal(spec, SimpleNamespace(mean_motion=None), [0.0] * 6, "goal", "the reference")


@pytest.mark.parametrize("center", [0.0, 1.0, 1e9])
def test_polytopes_are_no_smaller_and_no_more_turned_than_by_rounding(center):
    scene = SimpleNamespace(C=[[1.0, 0.0]], cells=1, delta=1.0)
    ends = [center + 2.0, 2.0 - center]
    spec = {"name": "far", "kind": "box", "center_m": [center], "half_widths_m": [2.0]}
    _check_obstacle(scene, UnsafeSet("far", False, [[1.0], [-1.0]], [ends], [ends]), spec)
    smaller = [[b - 5e-10 * (center + 2.0) for b in ends]]
    with pytest.raises(Rejected):
        _check_obstacle(scene, UnsafeSet("far", False, [[1.0], [-1.0]], smaller, smaller), spec)
    spec = {"normals": [[0.0, 2.0]], "offsets_m": [3.0]}
    assert _row_support([1e-16, 1.0], spec, 0, "wall") == 1.5
    for turn in (5e-10, -2e-12):
        with pytest.raises(Rejected, match="turned"):
            _row_support([turn, 1.0], spec, 0, "wall")


def test_initial_sets_are_balls_of_chosen_states_and_within_hills_frame():
    spec = {"kind": "ball", "center": [0.0, 0.0], "position_radius_m": 1.0, "velocity_radius_m_s": 1.0}
    document = SimpleNamespace(center=[0.0, 0.0], generators=[[1.0, 0.0], [0.0, 1.0]], C=[[1.0, 0.0]])
    document.mean_motion = None
    _check_initial_set(document, spec)
    document.C = [[1.0, 0.5]]
    with pytest.raises(Rejected, match="choice"):
        _check_initial_set(document, spec)
    document = SimpleNamespace(mean_motion=1e-3, center=[8e4, 8e4, 0.0, 0.0, 0.0, 0.0], generators=[])
    with pytest.raises(Rejected, match="Hill"):
        _check_initial_set(document, {"center": document.center})


@pytest.mark.parametrize("name", ["hasty", "s"])
def test_the_safety_controller_has_its_own_name(lie, name):
    """Or every step would seem to be flown by the same controller."""
    for controllers in (lie.certificate["controllers"], lie.schedule["controllers"]):
        controllers[0]["name"] = name
    lie.summary["safety"]["controller"] = name
    for step in lie.schedule["steps"]:
        if step["mode"] == 0:
            step["controller"] = name
    modes = lie.schedule["modes"]
    names = [item["name"] for item in lie.certificate["controllers"]]
    lie.schedule["share"] = {law: modes.count(i) / len(modes) for i, law in enumerate(names)}
    refused(lie.verdict(), "controllers")


@pytest.mark.parametrize("place", [[0, 9], [0, 0]])
def test_coordinates_of_the_position_are_independent(lie, place):
    lie.scenario["system"]["position_states"] = place
    rows = [[float(i == j) for j in range(4)] for i in place]
    lie.certificate["system"]["C"] = [[x.hex() for x in row] for row in rows]
    lie.guarantee()
    refused(lie.verdict(), "system")


EXAMPLES = {
    "box": (BoxObstacle("far", [1.0, 2.0], [2.0, 0.5]), {"half_widths_m": [2.0, 0.5]}),
    "ball": (BallObstacle("far", [1.0, 2.0], 2.0), {"radius_m": 2.0}),
    "polytope": (
        PolytopeObstacle("far", [[3, 4], [-1, 0], [0, -1]], [9, 1, 1]),
        {"normals": [[3.0, 4.0], [-1.0, 0.0], [0.0, -1.0]], "offsets_m": [9.0, 1.0, 1.0]},
    ),
}
"""An obstacle of every kind that keeps its shape, and what the scenario says of it."""


@pytest.mark.parametrize("kind", RIGID)
def test_an_obstacle_of_any_kind_is_inflated_by_the_radius_of_the_chaser(kind):
    scene, (obstacle, fields) = SimpleNamespace(C=[[1.0, 0.0], [0.0, 1.0]], delta=1.0), EXAMPLES[kind]
    spec = {"name": "far", "kind": kind} | fields
    spec |= {"center_m": [1.0, 2.0]} if kind != "polytope" else {}
    system = LinearSystem(np.zeros((2, 2)), np.eye(2), np.eye(2), np.ones(2), C=np.eye(2))
    (inflated,) = obstacle.inflated(0.5).timed_polytopes(system, 1.0, 1)
    ends = [inflated.offsets[:, place].tolist() for place in (0, 1)]
    item = UnsafeSet("far", False, inflated.normals.tolist(), *ends)
    _check_obstacle(scene, item, spec, 0.5)
    with pytest.raises(Rejected, match="far, facet"):
        _check_obstacle(scene, item, spec, 0.5 + 1e-6)


@pytest.mark.parametrize("text", ["1", "0.02", "0x1", " +0X1.0P0 ", "0x10p-4", "0x1p-5000"])
def test_a_number_has_one_text(text):
    with pytest.raises(ValueError):
        number(text)
    assert number((-0.0).hex()) == 0.0 and number((5e-324).hex()) == 5e-324
    assert strict_json(b'{"a":1}') == {"a": 1}
    for coding in ("utf-16", "utf-32", "utf-8-sig"):
        with pytest.raises(ValueError):
            strict_json('{"a":1}'.encode(coding))


@pytest.mark.parametrize("value", ["01", {}, {"0": 1, "1": 1}, None])
def test_lists_are_lists(value):
    with pytest.raises(Rejected, match="is no list"):
        conform(value, Items(Text()), "format", "certificate")


def enormous(path):
    with path.open("wb") as file:
        file.truncate(20 * 2**30)  # nothing is written: it takes no room


@pytest.mark.parametrize(
    "start", ["# c\rdescription = 1\n", "\ufeff", "# \x00\n", ".".join(["a"] * 5000) + " = 1\n"]
)
def test_a_scenario_reads_one_way(lie, start):
    text = (lie.forger.run / SCENARIO).read_text(encoding="utf-8")
    refused(lie.verdict(scenario_toml=start + text), "artefacts")


ENDLESS = [lambda path: path.symlink_to("/dev/zero"), lambda path: path.symlink_to("nowhere")]
ENDLESS += [os.mkfifo, os.mkdir, enormous] if hasattr(os, "mkfifo") else []


@pytest.mark.parametrize("make_it", ENDLESS, ids=range(len(ENDLESS)))
@pytest.mark.parametrize("name", [CERTIFICATE, SCENARIO, "sets.npz", SUMMARY])
def test_files_without_an_end_are_not_read(forger, tmp_path, name, make_it):
    folder = tmp_path / "run"
    folder.mkdir()
    for path in forger.run.iterdir():
        if path.name != name and path.is_file():
            (folder / path.name).symlink_to(path)
    make_it(folder / name)
    verdict = verify(folder)
    assert verdict.outcome != "VERIFIED" and verdict.claim == "artefacts", verdict.text()


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("sampling", "nodes_per_step"), 100_000),
        (("initial_set", "generators"), [[(0.0).hex()] * 4] * 1001),
        (("system", "A"), [[(0.0).hex()] * 33] * 33),
    ],
)
def test_work_without_an_end_is_not_begun(lie, path, value):
    lie.certificate[path[0]][path[1]] = value
    if path[0] == "sampling":  # as many steps as it takes
        for name in ("states", "inputs"):
            lie.certificate["reference"][name] += [lie.certificate["reference"][name][-1]] * 20
    lie.certificate["digest"] = digest(lie.certificate)
    assert verify_document(lie.certificate).outcome == "UNKNOWN"


PIECES = (b"null", b"true", b"1e400", b"-1", b"[]", b"{}", b'""', b"\xff", b"9" * 5000, b"[" * 3000, b"nan")


def garbled(data, rng):
    """Some bytes changed, left out, put in or doubled."""
    data = bytearray(data)
    for _ in range(rng.choice([1, 1, 2, 5])):
        i, kind = rng.randrange(len(data) + 1), rng.randrange(6)
        if kind == 0 and i < len(data):
            data[i] ^= 1 << rng.randrange(8)
        elif kind == 1:
            del data[i : i + rng.randrange(1, 9)]
        elif kind == 2:
            data[i:i] = rng.randbytes(3)
        elif kind == 3:
            data[i:i] = data[i // 2 : i // 2 + rng.randrange(1, 60)]
        elif kind == 4:
            data[i : i + rng.randrange(6)] = rng.choice(PIECES)
        elif rng.random() < 0.2:
            del data[i:]
    return bytes(data)


def fuzz(forger, seed, count):
    """Outcomes of garbled files, hashes right where the certificate can be read."""
    rng, outcomes = random.Random(seed), []
    names = [CERTIFICATE, SCENARIO, "schedule.json", "gains.json", "summary.json", "schedule.csv"]
    for _ in range(count):
        name = rng.choice(names)
        honest = (forger.run / name).read_bytes()
        text = garbled(honest, rng).decode("utf-8", errors="replace")
        if text.encode() == honest:
            continue
        if name == CERTIFICATE:
            try:
                text = canonical(json.loads(text))
            except (ValueError, RecursionError):
                text = json.dumps({})
        outcomes.append(forger.judge({name: text}).outcome)
    return outcomes


@pytest.mark.parametrize(("seed", "count"), [(0, 12), pytest.param(1, 150, marks=pytest.mark.slow)])
def test_garbage_never_ends_in_a_traceback(forger, seed, count):
    outcomes = fuzz(forger, seed, count)
    assert set(outcomes) <= set(EXIT_CODES) and outcomes.count("REJECTED") >= 6


@pytest.mark.parametrize("name", ["safety", "polaris", None])
def test_a_scene_without_unsafe_sets_and_names_that_results_compare_are_refused(lie, name):
    if name:
        lie.scenario["experimental"][0]["name"] = name
    else:
        del lie.scenario["obstacles"]
        lie.certificate |= {"unsafe_sets": [], "facets": [[]] * len(lie.certificate["facets"])}
        lie.guarantee()
    refused(lie.verdict(), "scenario")
