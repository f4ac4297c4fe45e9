"""Errors of range and bearing: boxes that hold them, proofs, certificates, flights and attacks."""

from itertools import product
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm

from polaris import ScenarioError, falsify, load_scenario, run, synthesize
from polaris.certificate.checker import verify, verify_document
from polaris.certificate.files.document import Document
from polaris.certificate.kernel.verdict import Rejected
from polaris.certificate.model.navigation import measured_errors
from polaris.runs.certificate import certificate
from polaris.scenario.reading import write_toml
from polaris.simulation.integration import Integrator
from tests.kept import kept
from tests.polaris.corruptions import scaled
from tests.polaris.forging import Forger

APPROACH = Path(__file__).parents[2] / "data" / "approach.toml"
RANGED = (
    "navigation={range_error_m=0.05, bearing_error_deg=0.2, within_m=[30.0, 130.0, 30.0],"
    " velocity_error_m_s=0.002, phases=[{from_s=160.0, range_error_m=0.02, bearing_error_deg=0.2,"
    " within_m=[30.0, 105.0, 30.0], velocity_error_m_s=0.001}]}"
)
CAMERA = (
    "navigation={measurement={range_error_m=0.05, bearing_error_deg=0.1, within_m=[30.0, 130.0, 30.0],"
    " initial={position_error_m=0.3, velocity_error_m_s=0.01}}}"
)


def scene(*assignments):
    return load_scenario(APPROACH).with_assignments(list(assignments))


def sensed(name, *assignments):
    return kept(f"sensed-{name}", lambda: synthesize(scene(*assignments)))


def seen_from(p, shift, turn, way):
    """Positions that a sensor at p (R, 3) measures: range off by `shift`, direction turned towards `way`."""
    ranges = np.linalg.norm(p, axis=1, keepdims=True)
    along = p / ranges
    aside = way - np.sum(way * along, axis=1, keepdims=True) * along
    aside /= np.maximum(np.linalg.norm(aside, axis=1, keepdims=True), 1e-300)
    return (ranges + shift[:, None]) * (np.cos(turn)[:, None] * along + np.sin(turn)[:, None] * aside)


@pytest.mark.parametrize("angle", [0.2, 45.0])
def test_boxes_hold_errors_of_every_line_of_sight(angle):
    half, shift, rng = np.array([30.0, 130.0, 20.0]), 0.05, np.random.default_rng(0)
    assignment = f"navigation={{range_error_m={shift}, bearing_error_deg={angle}, within_m={half.tolist()}}}"
    bound = scene(assignment).system().navigation[:3]
    p = np.vstack([rng.uniform(-1, 1, (40000, 3)) * half, np.array(list(product(*[[-1, 1]] * 3))) * half])
    p = np.vstack([p, p[-8:], np.eye(3) * half])
    turn = np.deg2rad(angle) * np.where(rng.random(len(p)) < 0.5, 1, rng.random(len(p)))
    error = np.abs(seen_from(p, shift * np.sign(rng.normal(size=len(p))), turn, rng.normal(size=p.shape)) - p)
    assert np.all(error <= bound) and np.all(error.max(axis=0) > 0.85 * bound)


def test_flights_measure_along_their_true_line_of_sight():
    schedule, rng = sensed("ranged", RANGED), np.random.default_rng(1)
    flight = Integrator(schedule, schedule.modes, 1)
    for step, shift, angle in ((3, 0.05, 0.2), (60, 0.02, 0.2)):
        bound = flight.estimate_bounds[step, 0]
        x = schedule.safety.reference.chi[step // 5] + rng.uniform(-1, 1, (2000, 6)) * [5, 5, 5, 0, 0, 0]
        error = flight.sensed(step, x, bound * rng.uniform(-1, 1, (2000, 6)), bound)
        p, measured = x[:, :3], x[:, :3] + error[:, :3]
        sizes = np.linalg.norm(p, axis=1), np.linalg.norm(measured, axis=1)
        turns = np.arccos(np.clip(np.sum(p * measured, axis=1) / sizes[0] / sizes[1], -1, 1))
        assert shift * 0.99 < np.abs(sizes[1] - sizes[0]).max() <= shift * (1 + 1e-9)
        assert np.deg2rad(angle) * 0.99 < turns.max() <= np.deg2rad(angle) * (1 + 1e-3)
        assert np.all(np.abs(error) <= bound * (1 + 1e-9))


MOUNTED = "navigation.measurement.position_error_m=0.05", "navigation.measurement.constant_share=0.8"
OUTAGE = "timing.missed_periods=1", 'faults=[{kind="navigation_lost", lasts_s=8.0}]'


@pytest.mark.parametrize(
    "name, more",
    [
        ("ranged", [RANGED]),
        ("camera", [CAMERA, "timing.delay_s=2.0"]),
        ("mounted", [CAMERA, *MOUNTED, "timing.delay_s=2.0"]),
        ("outage", [CAMERA, *OUTAGE, "timing.delay_s=2.0"]),
    ],
)
def test_schedules_are_proven_verified_and_not_refuted(name, more):
    schedule = sensed(name, *more)
    assert schedule.share() > 0.3
    assert verify_document(certificate(schedule, "approach")).outcome == "VERIFIED"
    assert falsify(schedule, 40, 1).failure is None


@pytest.mark.parametrize("seed", range(2))
def test_adversaries_that_turn_measurements_violate_nothing(seed):
    schedule, rng, R = sensed("ranged", RANGED), np.random.default_rng(seed), 300
    safety = schedule.safety
    system, h, q = safety.problem.system, 4.0, 5
    A, B, D = system.A, system.B, system.D
    block = expm(np.block([[A, np.hstack([B, D])], [np.zeros((6, 12))]]) * h)
    phi, gamma, delta = block[:6, :6], block[:6, 6:9], block[:6, 9:]
    laws = [schedule.controllers[mode] for mode in schedule.modes]
    path = [law.own.fine(q) for law in laws]
    N = len(laws) * q
    for _ in range(3):
        row, at = np.pad(rng.normal(size=(R, 3)), ((0, 0), (0, 3))), rng.integers(1, N + 1, R)
        adjoint, ways = np.zeros((N + 1, R, 6)), np.zeros((R, 6))
        for i in range(N, -1, -1):
            ways[at == i] = row[at == i]
            adjoint[i] = ways
            gain = laws[max(i - 1, 0) // q].gain
            ways = ways @ (phi - gamma @ gain)
        theta = safety.problem.initial_set
        x = theta.c + np.sign(adjoint[0] @ theta.G) @ theta.G.T
        for i in range(N):
            k, law = i // q, laws[i // q]
            shift, angle, speed = (0.05, 0.2, 0.002) if i < 40 else (0.02, 0.2, 0.001)
            direction = -adjoint[i + 1] @ gamma @ law.gain
            along = np.sum(direction[:, :3] * x[:, :3], axis=1)
            turn = np.full(R, np.deg2rad(angle))
            guess = np.hstack([seen_from(x[:, :3], shift * np.sign(along), turn, direction[:, :3]), x[:, 3:]])
            guess[:, 3:] += speed * np.sign(direction[:, 3:])
            u = np.clip(law.own.nu[k] + (path[k][k, i % q] - guess) @ law.gain.T, -system.u_max, system.u_max)
            push = adjoint[i + 1] @ delta
            w = system.w_max * push / np.maximum(np.linalg.norm(push, axis=1, keepdims=True), 1e-300)
            before, x = x, x @ phi.T + u @ gamma.T + w @ delta.T
            for p in (before[:, :3], (before[:, :3] + x[:, :3]) / 2, x[:, :3]):
                assert np.all(np.max(np.abs(p - [3.0, 90.0, 0.0]), axis=1) > 4.0)
                assert np.all(np.max(np.abs(p), axis=1) > 10.0)
                assert np.all(np.abs(p) <= [30.0, 130.0 if i < 40 else 105.0, 30.0])


def test_forged_lines_of_sight_are_refused(tmp_path):
    folder = run(APPROACH, tmp_path / "run", overrides=[RANGED])
    assert verify(folder.path).outcome == "VERIFIED"
    forger = Forger(folder.path, tmp_path)
    system, scenario = forger.honest["system"], forger.tree("scenario.toml")
    swapped = lambda rows: [[row[1], row[0], *row[2:]] for row in rows]  # noqa: E731
    for change in (lambda rows: scaled(rows, 0.99), swapped):
        (estimate,) = change([system["estimate_error"]])
        lie = {"estimate_error": estimate, "error_by_step": change(system["error_by_step"])}
        verdict = forger.forged(lambda data, lie=lie: data["system"].update(lie))
        assert verdict.outcome == "REJECTED" and verdict.claim in ("system", "assumptions")
        document = Document(forger.honest)
        document.measured_error = document.estimate = [float.fromhex(x) for x in estimate]
        with pytest.raises(Rejected, match="is not the scenario's"):
            measured_errors(document, scenario)
    for lie in ({"bearing_error_deg": 0.21}, {"range_error_m": 0.06}, {"within_m": [30.0, 129.0, 30.0]}):
        other = scenario | {"navigation": scenario["navigation"] | lie}
        verdict = forger.judge({"scenario.toml": write_toml(other)})
        assert verdict.outcome == "REJECTED" and verdict.claim in ("system", "unsafe_sets"), lie
    del scenario["navigation"]["within_m"]
    assert forger.judge({"scenario.toml": write_toml(scenario)}).outcome != "VERIFIED"


MEASURED = "navigation.measurement"
BAD = [
    ("{bearing_error_deg=0.2}", "navigation.range_error_m, bearing_error_deg"),
    ("{bearing_error_deg=50, within_m=100.0}", "navigation.bearing_error_deg"),
    ("{within_m=100.0, measurement={position_error_m=0.1}}", MEASURED),
    ("{measurement={within_m=100.0}}", f"{MEASURED}.position_error_m"),
    ("{measurement={range_error_m=0.1, within_m=9.0, constant_share=0.5}}", f"{MEASURED}.constant_share"),
]


@pytest.mark.parametrize(("given", "field"), BAD)
def test_bad_lines_of_sight_are_refused_by_name(given, field):
    with pytest.raises(ScenarioError) as error:
        scene(f"navigation={given}").problem()
    assert error.value.field == field
