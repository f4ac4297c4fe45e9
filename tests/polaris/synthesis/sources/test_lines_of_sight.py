"""Errors of range and bearing: boxes that hold them, proofs, certificates, flights and attacks."""

import json
import tomllib
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm

from polaris.certificate.checker import verify, verify_document
from polaris.certificate.files.document import Document
from polaris.certificate.kernel.verdict import Rejected
from polaris.certificate.model.navigation import measured_errors
from polaris.model.errors import PolarisError, ScenarioError
from polaris.runs.certificate import certificate
from polaris.runs.run import run
from polaris.scenario.reading import write_toml
from polaris.scenario.scenario import load_scenario
from polaris.simulation.falsification.search import falsify
from polaris.simulation.integration import Integrator
from polaris.synthesis.schedule.arrival import Tail
from polaris.synthesis.schedule.synthesize import synthesize
from tests.kept import kept
from tests.polaris.forging import CERTIFICATE, Forger
from tests.polaris.random_scenarios import random_scenario
from tests.sizes import fewer

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


def sighted(name, *assignments):
    return kept(f"sighted-{name}", lambda: synthesize(scene(*assignments)))


def seen_from(p, off, turn, way):
    """Positions that a sensor at p (R, 3) measures: range off by `off`, direction turned towards `way`."""
    away = np.linalg.norm(p, axis=1, keepdims=True)
    along = p / away
    aside = way - np.sum(way * along, axis=1, keepdims=True) * along
    aside /= np.maximum(np.linalg.norm(aside, axis=1, keepdims=True), 1e-300)
    return (away + off[:, None]) * (np.cos(turn)[:, None] * along + np.sin(turn)[:, None] * aside)


@pytest.mark.parametrize("angle", [0.2, 5.0, 45.0])
def test_boxes_hold_errors_of_every_line_of_sight(angle):
    half, off, rng = np.array([30.0, 130.0, 20.0]), 0.05, np.random.default_rng(0)
    given = f"navigation={{range_error_m={off}, bearing_error_deg={angle}, within_m={half.tolist()}}}"
    bound = scene(given).system().navigation[:3]
    p = np.vstack([rng.uniform(-1, 1, (40000, 3)) * half, np.array(list(product(*[[-1, 1]] * 3))) * half])
    p = np.vstack([p, p[-8:], np.eye(3) * half])
    turn = np.deg2rad(angle) * np.where(rng.random(len(p)) < 0.5, 1, rng.random(len(p)))
    error = np.abs(seen_from(p, off * np.sign(rng.normal(size=len(p))), turn, rng.normal(size=p.shape)) - p)
    assert np.all(error <= bound) and np.all(error.max(axis=0) > 0.85 * bound)


def test_flights_measure_along_their_true_line_of_sight():
    schedule, rng = sighted("ranged", RANGED), np.random.default_rng(1)
    flight = Integrator(schedule, schedule.modes, 1)
    for step, off, angle in ((3, 0.05, 0.2), (60, 0.02, 0.2)):
        bound = flight.estimate_bounds[step, 0]
        x = schedule.safety.reference.chi[step // 5] + rng.uniform(-1, 1, (2000, 6)) * [5, 5, 5, 0, 0, 0]
        error = flight.turned(step, x, bound * rng.uniform(-1, 1, (2000, 6)), bound)
        p, seen = x[:, :3], x[:, :3] + error[:, :3]
        sizes = np.linalg.norm(p, axis=1), np.linalg.norm(seen, axis=1)
        turned = np.arccos(np.clip(np.sum(p * seen, axis=1) / sizes[0] / sizes[1], -1, 1))
        assert off * 0.99 < np.abs(sizes[1] - sizes[0]).max() <= off * (1 + 1e-9)
        assert np.deg2rad(angle) * 0.99 < turned.max() <= np.deg2rad(angle) * (1 + 1e-3)
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
    schedule = sighted(name, *more)
    assert schedule.share() > 0.3
    assert verify_document(certificate(schedule, "approach")).outcome == "VERIFIED"
    assert falsify(schedule, 40, 1).failure is None


@pytest.mark.parametrize("seed", range(4))
def test_adversaries_that_turn_measurements_violate_nothing(seed):
    """Worst errors along the true line of sight, by signs of the adjoint, in a simulation of its own."""
    schedule, rng, R = sighted("ranged", RANGED), np.random.default_rng(seed), 300
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
            off, angle, speed = (0.05, 0.2, 0.002) if i < 40 else (0.02, 0.2, 0.001)
            wanted = -adjoint[i + 1] @ gamma @ law.gain
            along = np.sum(wanted[:, :3] * x[:, :3], axis=1)
            turn = np.full(R, np.deg2rad(angle))
            known = np.hstack([seen_from(x[:, :3], off * np.sign(along), turn, wanted[:, :3]), x[:, 3:]])
            known[:, 3:] += speed * np.sign(wanted[:, 3:])
            u = np.clip(law.own.nu[k] + (path[k][k, i % q] - known) @ law.gain.T, -system.u_max, system.u_max)
            pushed = adjoint[i + 1] @ delta
            w = system.w_max * pushed / np.maximum(np.linalg.norm(pushed, axis=1, keepdims=True), 1e-300)
            before, x = x, x @ phi.T + u @ gamma.T + w @ delta.T
            for p in (before[:, :3], (before[:, :3] + x[:, :3]) / 2, x[:, :3]):
                assert np.all(np.max(np.abs(p - [3.0, 90.0, 0.0]), axis=1) > 4.0)
                assert np.all(np.max(np.abs(p), axis=1) > 10.0)
                assert np.all(np.abs(p) <= [30.0, 130.0 if i < 40 else 105.0, 30.0])


def test_forged_lines_of_sight_are_refused(tmp_path):
    """Neither smaller errors than those of the scenario, nor a line of sight along another axis."""
    made = run(APPROACH, tmp_path / "run", overrides=[RANGED])
    assert verify(made.path).outcome == "VERIFIED"
    forger = Forger(made.path, tmp_path)
    data, scenario = forger.tree(CERTIFICATE)["system"], forger.tree("scenario.toml")

    def judged(change):
        lies = data | {key: change(rows) for key, rows in data.items() if key in ("error_by_step",)}
        lies["estimate_error"] = change([data["estimate_error"]])[0]
        lies["timing"] = (
            data["timing"] | {"measured_error": lies["estimate_error"]} if "timing" in data else {}
        )
        lies = {key: value for key, value in lies.items() if value != {}}
        return forger.judge({CERTIFICATE: json.dumps(forger.honest | {"system": lies})})

    smaller = judged(lambda rows: [[(float.fromhex(x) * 0.99).hex() for x in row] for row in rows])
    turned = judged(lambda rows: [[row[1], row[0], *row[2:]] for row in rows])
    for verdict in (smaller, turned):
        assert verdict.outcome == "REJECTED" and verdict.claim in ("system", "assumptions")
    for change in (lambda x: [0.99 * y for y in x], lambda x: [x[1], x[0], *x[2:]]):
        document = Document(forger.honest)
        document.measured_error = change(document.measured_error or document.estimate)
        document.estimate = change(document.estimate)
        with pytest.raises(Rejected, match="is not the scenario's"):
            measured_errors(document, scenario)
    for key, value in (
        ("bearing_error_deg", 0.21),
        ("range_error_m", 0.06),
        ("within_m", [30.0, 129.0, 30.0]),
    ):
        other = scenario | {"navigation": scenario["navigation"] | {key: value}}
        verdict = forger.judge({"scenario.toml": write_toml(other)})
        assert verdict.outcome == "REJECTED" and verdict.claim in ("system", "unsafe_sets"), key
    without = {key: value for key, value in scenario["navigation"].items() if key != "within_m"}
    assert (
        forger.judge({"scenario.toml": write_toml(scenario | {"navigation": without})}).outcome != "VERIFIED"
    )


@pytest.mark.parametrize(
    ("given", "field"),
    [
        ("navigation={bearing_error_deg=0.2}", "navigation.range_error_m, bearing_error_deg"),
        ("navigation={bearing_error_deg=50, within_m=100.0}", "navigation.bearing_error_deg"),
        ("navigation={within_m=100.0, measurement={position_error_m=0.1}}", "navigation.measurement"),
        ("navigation={measurement={within_m=100.0}}", "navigation.measurement.position_error_m"),
        (
            "navigation={measurement={range_error_m=0.1, within_m=100.0, constant_share=0.5}}",
            "navigation.measurement.constant_share",
        ),
    ],
)
def test_bad_lines_of_sight_are_refused_by_name(given, field):
    with pytest.raises(ScenarioError) as error:
        scene(given).problem()
    assert error.value.field == field


SENSED = {
    "position": "{measurement={position_error_m=0.1%s}}",
    "range and bearing": "{measurement={range_error_m=0.05, bearing_error_deg=0.1, within_m=150.0%s}}",
    "filter": "{position_error_m=0.1, velocity_error_m_s=0.003}",
    "filter by range and bearing": "{range_error_m=0.05, bearing_error_deg=0.1, within_m=150.0}",
    "phases": "{range_error_m=0.05, bearing_error_deg=0.1, within_m=150.0, velocity_error_m_s=0.003,"
    " phases=[{from_s=160.0, range_error_m=0.02, within_m=110.0, velocity_error_m_s=0.002}]}",
}
FIRST = ", initial={position_error_m=0.3, velocity_error_m_s=0.01}"
OPTIONS = {
    "missed": "timing.missed_periods=1",
    "latency": "timing.delay_s=3.0",
    "outage": 'faults=[{kind="navigation_lost", lasts_s=8.0}]',
    "thrusters": "thrusters={magnitude_error=0.05, misalignment_deg=2, mass_error=0.03}",
}


@pytest.mark.parametrize("thrusters", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_all_options_of_sensors_go_together(thrusters):
    every = product(SENSED, ["", FIRST], *[[False, True]] * 3, [thrusters])
    for sensed, first, *given in every:
        if first and "%s" not in SENSED[sensed]:
            continue
        names = [name for name, chosen in zip(OPTIONS, given, strict=True) if chosen]
        table = SENSED[sensed].replace("%s", first)
        problem = scene(f"navigation={table}", *(OPTIONS[name] for name in names)).problem()
        assert np.any(problem.system.navigation > 0), (sensed, first, names)


MISSED = "navigation={position_error_m=0.02, velocity_error_m_s=0.001}", "timing.missed_periods=2"


def test_upkeep_counts_what_is_commanded_where_periods_may_be_missed(monkeypatch):
    """Errors of thrusters that no measurement shows: of the periods before, S having settled long ago."""
    schedule = sighted("missed", *MISSED, OPTIONS["thrusters"], "timing.delay_s=2.0")
    assert verify_document(certificate(schedule, "approach")).outcome == "VERIFIED"
    upkeep, u_max = schedule.upkeep, schedule.safety.problem.system.u_max
    monkeypatch.setattr(Tail, "commanded_before", lambda self, nodes: u_max)
    assert replace(schedule).upkeep.per_orbit > 5 * upkeep.per_orbit


@pytest.mark.slow
def test_runs_of_random_spacecraft_that_see_range_and_bearing_are_confirmed(tmp_path):
    """Proven where S has room for it; then the checker confirms it, and no attack refutes it."""
    proven = 0
    for seed in range(fewer(400, 40)):
        document = tomllib.loads(random_scenario(seed))
        if document["system"]["kind"] != "clohessy_wiltshire":
            continue
        path = tmp_path / f"{seed}.toml"
        path.write_text(write_toml(document), encoding="utf-8")
        scenario, half = load_scenario(path), load_scenario(path).initial_set().half_widths
        away = 3 * float(np.abs(scenario.initial_set().c[:3]).max())
        seen = {"range_error_m": 0.03 * float(half[:3].min()), "within_m": away}
        seen |= {"bearing_error_deg": float(np.rad2deg(0.02 * half[:3].min() / away))}
        given = {f"navigation.{key}": value for key, value in seen.items()}
        given |= {"navigation.velocity_error_m_s": 0.03 * float(half[3:].min()), "planner.time_limit_s": 1e6}
        try:
            schedule = synthesize(scenario.with_overrides({"recoverable.kind": "polytope"} | given))
        except PolarisError:
            continue
        proven += 1
        assert verify_document(certificate(schedule, document["name"])).outcome == "VERIFIED", seed
        assert falsify(schedule, 20, seed).failure is None, seed
    assert proven >= 2
