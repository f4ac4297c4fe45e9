"""Constants of a flight: an unknown acceleration that never changes, at its worst, and forged."""

from dataclasses import replace
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from scipy.linalg import expm

from polaris.certificate.assumptions import Assumptions
from polaris.certificate.checker import verify
from polaris.certificate.files.document import canonical
from polaris.model.craft import Craft
from polaris.model.errors import PolarisError
from polaris.model.estimates.observer import observing
from polaris.model.timing import Observer
from polaris.runs.certificate import certificate
from polaris.runs.schedule import write_run
from polaris.scenario.scenario import load_scenario
from polaris.simulation.delayed import flies
from polaris.simulation.disturbances import disturbances
from polaris.simulation.falsification.search import falsify
from polaris.synthesis.safety.attempts import perceive_unsafe
from polaris.synthesis.safety.passive import DriftRequirement, FreeFlight
from polaris.synthesis.schedule.synthesize import synthesize
from polaris.synthesis.sources.observer import MEASUREMENT
from polaris.synthesis.tracker.feedback import Feedback
from polaris.synthesis.tracker.tracking import Tracking
from tests.polaris.closed_loops import attack, held
from tests.polaris.forging import COARSE, Forger, Lie, make
from tests.polaris.random_scenarios import random_scenario
from tests.polaris.synthesis.safety.test_closed_loops import judge
from tests.polaris.synthesis.tracker.test_loop import bounds, rows_of, sizes, software, unit_flights
from tests.polaris.tiny import TINY
from tests.sizes import fewer

FEW = (5016, 5024, 5034)
"""Random scenes that are proved."""


def biased(seed, *more):
    """A random scene, half of whose disturbance is constant: of one component or of all."""
    with TemporaryDirectory() as folder:
        path = f"{folder}/scene.toml"
        with open(path, "w", encoding="utf-8") as file:
            file.write(random_scenario(seed))
        scenario, rng = load_scenario(path), np.random.default_rng(seed)
        system, unit = scenario.system(), "" if scenario.system().mean_motion is None else "_m_s2"
        size = max(system.w_max, 1e-3 * float(np.abs(system.B @ system.u_max).max())) / 2
        bias = size * rng.choice([0.3, 1.0], system.p) * (rng.random(system.p) < 0.7)
        bias[rng.integers(system.p)] = size
        given = [f"system.bias_max{unit}={bias.tolist()}", f"system.disturbance_max{unit}={system.w_max / 2}"]
        return load_scenario(path, [*given, "simulation.runs=1", *more])


def proved(seed, *more):
    """Scene and schedule, or None where it is refused."""
    try:
        scenario = biased(seed, "recoverable.recourse=none", *more)
        schedule = synthesize(scenario)
    except PolarisError:
        return None
    return (scenario, schedule) if schedule.guarantee == "proved" else None


def responses(problem, count):
    """States, from rest under S, by the constants at their bounds one by one, (count + 1, n, p)."""
    system, h = problem.system, problem.delta / problem.feedback.nodes_per_cell
    (Ad, Bd), Dd = held(system.A, system.B, h), held(system.A, system.D, h)[1] * system.bias
    out = [np.zeros_like(Dd)]
    for _ in range(count):
        out.append((Ad - Bd @ problem.gain) @ out[-1] + Dd)
    return np.array(out)


ALONE = {
    TINY: ["system.disturbance_max=0.0", "system.bias_max=[0.02,0.01]", "feedback.period_s=0.25"],
    "static": [
        "system.disturbance_max_m_s2=0.0",
        "system.bias_max_m_s2=[1e-6,3e-6,2e-6]",
        "feedback.period_s=2",
    ],
}
"""Scenes that constants alone disturb."""


@pytest.mark.parametrize("scene", ALONE, ids=["tiny", "static"])
def test_rows_of_s_need_what_the_worst_constant_makes_and_no_more(scene):
    problem = load_scenario(scene, ALONE[scene]).problem()
    tracking = Tracking(problem.system, problem.gain, problem.feedback, problem.delta)
    rows = np.vstack([np.eye(problem.system.n), problem.gain])
    tightening = tracking.responses(rows, None)
    flown = np.abs(rows @ responses(problem, 3 * len(tightening))).sum(axis=-1)
    worst = np.maximum.accumulate(flown)
    assert np.all(worst[: len(tightening) - 1] <= tightening[:-1]) and np.all(worst[-1] <= tightening[-1])
    assert np.allclose(worst[: len(tightening) - 1], tightening[:-1], rtol=1e-6, atol=1e-15)
    assert np.all(tightening[-1] <= 1.002 * worst[-1])
    plain = replace(problem.system, w_max=float(np.linalg.norm(problem.system.bias)), bias_max=None)
    varying = replace(tracking, system=plain).responses(rows, None)[-1]
    assert np.all(tightening[-1] < varying)
    speeds = slice(problem.system.d, problem.system.n)
    assert np.all(tightening[-1, speeds] < 0.6 * varying[speeds])


@pytest.mark.parametrize("delay", [0, 0.5, 1.4])
@pytest.mark.parametrize("share", [1.0, 0.7])
def test_a_constant_error_of_a_camera_adds_the_sum_of_its_responses(delay, share):
    soft, count = software("hill", "observer", delay), 100
    flown, pushes, q = unit_flights(soft, "observer", count)
    limits, noise = bounds(soft, "observer", w=0.0), sizes("observer", len(soft.A))
    loop = limits.closed.loop
    channels = [replace(c, constant=share * c.size) if c.name == MEASUREMENT else c for c in loop.channels]
    closed = replace(limits.closed, loop=replace(loop, channels=tuple(channels)))
    tightening = replace(limits, closed=closed).from_rest(rows_of(limits))
    each = flown[1:, pushes : pushes + q]
    worst = np.maximum.accumulate(np.tensordot(np.abs(np.cumsum(each, axis=0)), share * noise, (1, 0)))
    worst += np.cumsum(np.tensordot(np.abs(each), (1 - share) * noise, (1, 0)), axis=0)
    np.testing.assert_allclose(tightening[1 : count + 1], worst, rtol=1e-7, atol=1e-15)
    assert np.all(tightening[count] < 0.9 * limits.from_rest(rows_of(limits))[count])


@pytest.mark.parametrize("share", [0.0, 0.5, 0.8, 1.0])
def test_an_outage_beside_a_constant_error_covers_the_flight_of_that_error(share):
    """An oscillator with a slow observer: an estimate that is not corrected may turn, the error does not."""
    A, B, h, count = np.array([[0.0, 1.0], [-1.79, -0.05]]), np.array([[0.0], [1.0]]), 0.98, 12
    gain, L, M = np.array([[-0.484, 0.464]]), np.array([[1.904e-3], [-5.03e-5]]), np.array([[1.0, 0.0]])
    seen = Observer(M, np.ones(1), L, constant=np.array([share]) if share else None)
    system = observing(Craft(A, B, B, np.array([1e3]), 0.0, M), seen, h)
    tracking, n = Tracking(system, gain, Feedback(1), h), 2
    rows = tracking.whole(np.eye(2))
    claimed = tracking.tightening.from_rest(rows)[-1]
    claimed = claimed + tracking.difference_tightening(rows, [tracking._unmade(count)]).max(axis=(0, 2))
    whole = expm(np.block([[A, B], [np.zeros((1, 3))]]) * h)
    step, held = whole[:2, :2], whole[:2, 2:]
    F = np.block([[step - held @ gain, -held @ gain], [np.zeros((n, n)), (np.eye(n) - L @ M) @ step]])
    blind, E = np.vstack([F[:n], np.hstack([np.zeros((n, n)), step])]), np.vstack([np.zeros((n, 1)), L])
    z, worst = np.linalg.solve(np.eye(2 * n) - F, E), np.zeros(n)  # long under one constant error
    for _ in range(count):
        z = blind @ z
        y = z
        for _ in range(150):
            worst, y = np.maximum(worst, np.abs(y[:n, 0])), F @ y + E
    assert np.all(worst <= claimed)


def test_free_drift_is_bounded_by_the_worst_constant():
    """Two hours in a low orbit, against signs that change at will: only across the track much is won."""
    problem = load_scenario("static", ALONE["static"]).problem()
    sets = perceive_unsafe(problem, 260)
    flight, steps = FreeFlight(DriftRequirement(7200.0), problem.system, sets, problem.delta), 7200
    pushed = flight._rows[2]
    (Ad, _), Dd = (
        held(problem.system.A, problem.system.B, 1.0),
        held(problem.system.A, problem.system.D, 1.0)[1],
    )
    moved = [0 * Dd]
    for _ in range(steps):
        moved.append(Ad @ moved[-1] + Dd * problem.system.bias)
    rows = np.vstack([item.normals for item in sets]) @ problem.system.position
    flown = np.abs(rows @ np.array(moved)).sum(axis=-1)
    part = problem.delta / flight.parts
    ends = np.ceil(np.arange(steps + 1) / part - 1e-9).astype(int) - 1
    worst = np.zeros((int(steps / part), len(rows)))
    np.maximum.at(worst, ends[1:], flown[1:])
    since = np.arange(len(worst))[:, None] - np.arange(flight.parts + 1)  # thrust stops up to a step later
    worst, claimed = worst[np.maximum(since, 0)].max(axis=1), pushed[: len(worst)]
    assert np.all(worst <= claimed) and np.all(claimed[-1] <= 1.02 * worst[-1])
    varying = replace(flight, system=problem.system.unbiased)._rows[2][: len(worst)]
    assert np.all(claimed[-1] < 0.98 * varying[-1])


def test_a_bias_of_zero_changes_nothing():
    plain, zero = (load_scenario(TINY, more) for more in ([], ["system.bias_max=[0.0,0.0]"]))
    first, second = (certificate(synthesize(each), "tiny") for each in (plain, zero))
    assert canonical(first) == canonical(second)


@pytest.mark.parametrize("seed", [FEW[0], *(pytest.param(seed, marks=pytest.mark.slow) for seed in FEW[1:])])
def test_proofs_under_constants_hold_at_their_worst(seed, tmp_path):
    scenario, schedule = proved(seed)
    worst = attack(schedule, 40, seed)
    judge(seed, worst)
    assert worst.tight > 0.6
    assert falsify(schedule, 200, seed).failure is None
    assert verify(write_run(tmp_path / "run", scenario, schedule).path).outcome == "VERIFIED"


def test_upkeep_of_a_loop_whose_states_differ_in_scale_is_confirmed(tmp_path):
    """Entries of its storage differ by 1e7; the checker used to take its storage for one that runs away."""
    scenario, schedule = proved(5003)
    assert verify(write_run(tmp_path / "run", scenario, schedule).path).outcome == "VERIFIED"


@pytest.mark.slow
def test_random_scenes_under_constants_are_confirmed_and_hold(tmp_path):
    """Drift and abort included; falsified, attacked and checked."""
    count, seeds = 0, range(5000, fewer(5060, 5018))
    for seed in seeds:
        known = proved(seed, f"abort.drift_s={0.5 * biased(seed).model.horizon.duration_s}")
        if known is None:
            continue
        scenario, schedule = known
        judge(seed, attack(schedule, 20, seed))
        assert falsify(schedule, 100, seed).failure is None, seed
        verdict = verify(write_run(tmp_path / str(seed), scenario, schedule).path)
        assert verdict.outcome == "VERIFIED", (seed, verdict.text())
        count += 1
    assert count >= len(seeds) / 3


def test_what_is_constant_is_drawn_once_a_flight():
    schedule = synthesize(load_scenario(TINY, ALONE[TINY]))
    flight = flies(schedule.safety.problem.system)(schedule, schedule.modes, 1)
    w, _ = disturbances(flight, 40, np.random.default_rng(0), "mixed")
    bias = w[..., flight.constant]
    assert np.array_equal(bias, np.broadcast_to(bias[:1], bias.shape)) and not np.any(w[..., :2])
    assert np.all(np.abs(bias[0]).max(axis=0) == [0.02, 0.01]) and len(np.unique(bias[0], axis=0)) > 10
    w[1:, :, flight.constant] *= -1  # what later steps say of it does not count
    x0 = np.repeat(schedule.safety.problem.initial_set.c[None], 40, axis=0)
    assert np.array_equal(flight.run(x0, w).states, flight.run(x0, np.abs(w) * np.sign(w[:1])).states)


# -- forged -----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def forger(tmp_path_factory):
    folder = tmp_path_factory.mktemp("constants")
    bias = "system.disturbance_max=0.005", "system.bias_max=[0.0,0.03]"
    return Forger(make([COARSE, *bias, "abort.drift_s=6.0"], folder), folder)


def test_forged_constants_are_refused(forger):
    assert forger.judge({}).outcome == "VERIFIED"

    def lied(varying, constant, scenario):
        """Other bounds in all files that hold them, in the scenario, too, if asked."""
        lie = Lie(forger)
        system = lie.certificate["system"]
        system["disturbance_max"] = varying.hex()
        system.pop("bias_max")
        system |= {"bias_max": [x.hex() for x in constant]} if any(constant) else {}
        lie.scenario["system"] |= {"disturbance_max": varying, "bias_max": constant} if scenario else {}
        claimed = lie.schedule["guarantee"]
        for sentences in (lie.certificate["assumptions"], claimed["assumptions"]):
            sentences[0] = Assumptions(varying, 0.5, constant).sentences()[0]
        lie.summary["guarantee"] = claimed
        return lie

    for varying, constant in ((0.005, [0.0, 0.015]), (0.005, []), (0.0, [0.005, 0.03]), (0.005, [0.03, 0.0])):
        lied(varying, constant, False).judge({"system"})
    lied(0.035, [0.0, 0.0], True).judge({"margins", "recoverable", "separation", "passive", "goal", "upkeep"})


CAMERA = (
    *(f"navigation.measurement.matrix={np.eye(4)[:2].tolist()}", "navigation.measurement.error=[0.01,0.01]"),
    *("navigation.measurement.constant_share=0.8", "feedback.period_s=0.25", "system.disturbance_max=0.002"),
    "tracking.R=[20,20]",
)
"""Tiny scene whose estimates come from a camera with a constant error."""


@pytest.mark.parametrize("delay", [0.0, pytest.param(0.3, marks=pytest.mark.slow)])
def test_proofs_with_a_camera_with_a_constant_error_hold_at_their_worst(delay, tmp_path):
    scenario = load_scenario(TINY, [*CAMERA, f"timing.delay_s={delay}", "simulation.runs=2"])
    schedule = synthesize(scenario)
    assert schedule.guarantee == "proved" and schedule.share() > 0
    worst = attack(schedule, 24, 0)
    judge(0, worst)
    assert worst.tight > 0.5
    assert falsify(schedule, 150, 0).failure is None
    folder = write_run(tmp_path / "run", scenario, schedule).path
    assert verify(folder).outcome == "VERIFIED"
    lie = Lie(Forger(folder, tmp_path))
    lie.certificate["system"]["observer"]["constant"] = [(0.01).hex()] * 2
    lie.judge({"assumptions"})
    for lines in (lie.certificate["assumptions"], lie.schedule["guarantee"]["assumptions"]):
        lines[:] = [line.replace("[0.008, 0.008] is", "[0.01, 0.01] is") for line in lines]
    lie.summary["guarantee"] = lie.schedule["guarantee"]
    lie.judge({"system"})
    del lie.scenario["navigation"]["measurement"]["constant_share"]
    lie.judge({"system"})
    del lie.certificate["system"]["observer"]["constant"]
    for lines in (lie.certificate["assumptions"], lie.schedule["guarantee"]["assumptions"]):
        lines[:] = [line.replace(", of which [0.01, 0.01] is constant in a flight", "") for line in lines]
    lie.judge({"margins", "recoverable", "separation", "goal", "upkeep"})
