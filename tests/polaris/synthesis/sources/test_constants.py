"""Constants of a flight: a bias, an error of a camera, errors of thrusters; at their worst, and forged."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy.linalg import expm

from polaris import Craft, Feedback, PolarisError, Tracking, falsify, load_scenario, synthesize, write_run
from polaris.certificate.assumptions import Assumptions
from polaris.certificate.checker import verify
from polaris.certificate.claims import spending as checked
from polaris.model.estimates.observer import observing
from polaris.model.thrusters import Thrusters
from polaris.model.timing import Observer
from polaris.simulation.delayed import flies
from polaris.simulation.disturbances import disturbances
from polaris.simulation.falsification.attacks import Attacker
from polaris.synthesis.controllers.controllers import AffineController
from polaris.synthesis.schedule.spending import Spell, together
from tests.kept import kept
from tests.polaris.closed_loops import Loop, attack, held
from tests.polaris.forging import COARSE, QUARTER, SETS, Forger, Lie, make
from tests.polaris.synthesis.safety.test_closed_loops import judge
from tests.polaris.synthesis.sources.test_error_sources import exact
from tests.polaris.tiny import TINY
from tests.sizes import fewer


def biased(scenario, seed):
    """Make half of the disturbance of a random scene constant: of one component or of all."""
    rng, system = np.random.default_rng(seed), scenario.system()
    unit = "" if system.mean_motion is None else "_m_s2"
    size = max(system.w_max, 1e-3 * float(np.abs(system.B @ system.u_max).max())) / 2
    bias = size * rng.choice([0.3, 1.0], system.p) * (rng.random(system.p) < 0.7)
    bias[rng.integers(system.p)] = size
    return [f"system.bias_max{unit}={bias.tolist()}", f"system.disturbance_max{unit}={system.w_max / 2}"]


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
    "static": ["system.disturbance_max_m_s2=0.0", "system.bias_max_m_s2=[1e-6,3e-6,2e-6]"],
}
"""Scenes that constants alone disturb."""


@pytest.mark.parametrize("scene", ALONE, ids=["tiny", "static"])
def test_rows_of_s_need_what_the_worst_constant_makes_and_no_more(scene):
    problem = load_scenario(scene, ALONE[scene]).problem()
    tracking = Tracking(problem.system, problem.gain, problem.feedback, problem.delta)
    rows = np.vstack([np.eye(problem.system.n), problem.gain])
    tightening = tracking.responses(rows, None)
    attained = np.abs(rows @ responses(problem, 3 * len(tightening))).sum(axis=-1)
    worst = np.maximum.accumulate(attained)
    assert np.all(worst[: len(tightening) - 1] <= tightening[:-1]) and np.all(worst[-1] <= tightening[-1])
    assert np.allclose(worst[: len(tightening) - 1], tightening[:-1], rtol=1e-6, atol=1e-15)
    assert np.all(tightening[-1] <= 1.002 * worst[-1])
    plain = replace(problem.system, w_max=float(np.linalg.norm(problem.system.bias)), bias_max=None)
    varying = replace(tracking, system=plain).responses(rows, None)[-1]
    assert np.all(tightening[-1] < varying)
    speeds = slice(problem.system.d, problem.system.n)
    assert np.all(tightening[-1, speeds] < 0.6 * varying[speeds])


@pytest.mark.parametrize("share", [0.0, 0.5, 0.8, 1.0])
def test_an_outage_beside_a_constant_error_covers_the_flight_of_that_error(share):
    """An oscillator with a slow observer: an estimate that is not corrected may turn, the error does not."""
    A, B, h, count = np.array([[0.0, 1.0], [-1.79, -0.05]]), np.array([[0.0], [1.0]]), 0.98, 12
    gain, L, M = np.array([[-0.484, 0.464]]), np.array([[1.904e-3], [-5.03e-5]]), np.array([[1.0, 0.0]])
    observer = Observer(M, np.ones(1), L, constant=np.array([share]) if share else None)
    system = observing(Craft(A, B, B, np.array([1e3]), 0.0, M), observer, h)
    tracking, n = Tracking(system, gain, Feedback(1), h), 2
    rows = tracking.pad(np.eye(2))
    claimed = tracking.tightening.from_rest(rows)[-1]
    claimed = claimed + tracking.difference_tightening(rows, [tracking._unmade(count)]).max(axis=(0, 2))
    whole = expm(np.block([[A, B], [np.zeros((1, 3))]]) * h)
    step, push_map = whole[:2, :2], whole[:2, 2:]
    F = np.block([[step - push_map @ gain, -push_map @ gain], [np.zeros((n, n)), (np.eye(n) - L @ M) @ step]])
    blind, E = np.vstack([F[:n], np.hstack([np.zeros((n, n)), step])]), np.vstack([np.zeros((n, 1)), L])
    z, worst = np.linalg.solve(np.eye(2 * n) - F, E), np.zeros(n)  # long under one constant error
    for _ in range(count):
        z = blind @ z
        y = z
        for _ in range(150):
            worst, y = np.maximum(worst, np.abs(y[:n, 0])), F @ y + E
    assert np.all(worst <= claimed)


@pytest.mark.parametrize("seed", [5016, 5003])
def test_proofs_under_constants_hold_at_their_worst(seed, tmp_path):
    """In 5003 entries of the storage of upkeep differ by 1e7."""
    assignments = [*biased(exact(seed), seed), "recoverable.recourse=none", "simulation.runs=1"]
    scenario = exact(seed).with_assignments(assignments)
    schedule = synthesize(scenario)
    if seed == 5016:
        worst = attack(schedule, 40, seed)
        judge(seed, worst)
        assert worst.tight > 0.6
        assert falsify(schedule, 200, seed).failure is None
    assert verify(write_run(tmp_path / "run", scenario, schedule).path).outcome == "VERIFIED"


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
        system, claimed = lie.certificate["system"], lie.schedule["guarantee"]
        system["disturbance_max"] = varying.hex()
        system.pop("bias_max")
        system |= {"bias_max": [x.hex() for x in constant]} if any(constant) else {}
        lie.scenario["system"] |= {"disturbance_max": varying, "bias_max": constant} if scenario else {}
        for sentences in (lie.certificate["assumptions"], claimed["assumptions"]):
            sentences[0] = Assumptions(varying, 0.5, constant).sentences()[0]
        lie.summary["guarantee"] = claimed
        return lie

    for varying, constant in ((0.005, [0.0, 0.015]), (0.005, []), (0.0, [0.005, 0.03]), (0.005, [0.03, 0.0])):
        lied(varying, constant, False).judge({"system"})
    lied(0.035, [0.0, 0.0], True).judge({*SETS, "passive", "upkeep"})


CAMERA = (
    *(f"navigation.measurement.matrix={np.eye(4)[:2].tolist()}", "navigation.measurement.error=[0.01,0.01]"),
    *("navigation.measurement.constant_share=0.8", "feedback.period_s=0.25", "system.disturbance_max=0.002"),
    "tracking.R=[20,20]",
)
"""Tiny scene whose estimates come from a camera with a constant error."""


def test_proofs_with_a_camera_with_a_constant_error_hold_at_their_worst(tmp_path):
    scenario = load_scenario(TINY, [*CAMERA, "simulation.runs=2"])
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
    lie.judge({*SETS, "upkeep"})


WRONG = ("thrusters.magnitude_error=0.08", "thrusters.mass_error=0.04", "feedback.period_s=0.25")
NEVER = "thrusters.errors_vary=never"
CARRIED = "thrusters.impulse_bit_N_s=0.002", "thrusters.remainder=carried"


def tiny(*more):
    """Schedule of the tiny scene with overrides."""
    return kept("-".join(["tiny", *more]), lambda: synthesize(load_scenario(TINY, more)))


def corners(system, count=64, seed=0):
    """Matrices of errors at the corners of their set: all, or `count` drawn ones, (c, m, m)."""
    errors, m, rng = system.on_time, system.m, np.random.default_rng(seed)
    signs = np.array(list(product((-1.0, 1.0), repeat=m * m))) if m < 3 else None
    signs = rng.choice([-1.0, 1.0], (count, m * m)) if signs is None else signs
    M = signs.reshape(-1, m, m)
    others = M * (1 - np.eye(m)) * errors.across / max(np.sqrt(m - 1), 1)
    return errors.along * M * np.eye(m) + others


def spent_in(schedule, M, start, push):
    """Fly the schedule under constant M (R, m, m); return what is spent [m/s], (R,)."""
    loop = Loop(schedule, 1)
    system, m, n = loop.system, loop.system.m, loop.system.n
    blocks = np.zeros((n + m + system.p, n + m + system.p))
    blocks[:n] = np.hstack([system.A, system.B, system.D])
    whole = expm(blocks * loop.dt)[:n]
    x, total = start, np.zeros(len(start))
    for i in range(loop.K * loop.per):
        k, j = divmod(i, loop.per)
        u = np.clip(loop.command(int(schedule.modes[k]), k, j, x), -system.u_max, system.u_max)
        applied = u + np.einsum("rab,rb->ra", M, u)
        total += np.abs(applied).sum(axis=1) * loop.dt / system.mass
        x = np.hstack([x, applied, push[i]]) @ whole.T
    return total


def worst_spent(schedule, rounds=4, seed=0):
    """Return the most that is spent: all corners, pushes against the signs of what was flown before."""
    system, theta = schedule.safety.problem.system, schedule.safety.problem.initial_set
    M, rng = corners(system, seed=seed), np.random.default_rng(seed)
    nodes = len(schedule.modes) * schedule.safety.tracking.feedback.nodes_per_cell
    delta_v = 0.0
    for number in range(rounds):
        start = theta.c + rng.choice([-1.0, 1.0], (len(M), theta.G.shape[1])) @ theta.G.T
        hold = int(np.exp(rng.uniform(0, np.log(nodes / 2))))
        push = rng.normal(size=(-(-nodes // hold), len(M), system.p))
        push *= system.w_max / np.linalg.norm(push, axis=2, keepdims=True)
        push = np.repeat(push, hold, axis=0)[:nodes] * (number > 0)
        delta_v = max(delta_v, float(spent_in(schedule, M, start, push).max()))
    return delta_v


def bound(schedule, constant):
    """Bound a schedule's delta-v [m/s] as it does itself, errors of thrusters being constant or not."""
    system = schedule.safety.tracking.system
    declared = system.thrusters.constant
    object.__setattr__(system.thrusters, "constant", constant)
    try:
        laws = [schedule.controllers[step.mode] for step in schedule.steps]
        each = zip(laws, schedule.steps, strict=True)
        spells = [Spell.from_tube(law, step.tube, step.k) for law, step in each]
        return schedule.tail.spending(spells, schedule.approach).schedule
    finally:
        object.__setattr__(system.thrusters, "constant", declared)


def test_matrices_are_those_of_their_bounds():
    errors, ways = Thrusters(0.1, 0.05, constant=True), np.random.default_rng(0).normal(size=(200, 3, 3))
    M = errors.matrices(ways)
    assert np.all(np.abs(np.einsum("rii->ri", M)) <= 0.1)
    assert np.allclose(np.linalg.norm(M * (1 - np.eye(3)), axis=-1), 0.05)


def test_constants_are_drawn_at_their_bounds_and_once_a_flight():
    quick = "recoverable.recourse=none", "schedule.bound_programs=0"
    assignments = *ALONE[TINY], *WRONG[:2], "thrusters.impulse_bit_N_s=0.002", NEVER, *quick
    schedule, (start, runs) = tiny(*assignments), (np.zeros((40, 4)), 40)
    flight = flies(schedule.safety.problem.system)(schedule, schedule.modes, 1)
    w, _ = disturbances(flight, runs, np.random.default_rng(0), "mixed")
    shares = slice(flight.columns[2].start + 2, flight.columns[2].stop)
    assert np.all(np.abs(w[0, :, flight.constant]).max(axis=0) == [0.02, 0.01])
    assert shares.stop - shares.start == 4 and np.all(np.ptp(w[0, :, shares], axis=0) > 1)
    states = flight.run(start, w).states
    for part in (flight.constant, shares):
        later, other = w.copy(), w.copy()
        later[1:, :, part] *= -1
        other[:, :, part] *= -1
        assert np.array_equal(flight.run(start, later).states, states)
        assert not np.array_equal(flight.run(start, other).states, states)


STAND_IN = [("thrusters.directions=[[1,0],[-1,0],[0,1],[0,-1]]", "thrusters.thrust_max_N=1.0")]
STAND_IN += [('faults=[{kind="loss",share=0.1}]',)]


@pytest.mark.parametrize("more", STAND_IN, ids=["layout", "fault"])
def test_errors_of_thrusters_that_stand_in_for_others_count_as_ones_that_vary(more):
    always, never = (load_scenario(TINY, [*WRONG, *more, *last]) for last in ([], [NEVER]))
    assert never.problem().system.thrusters == always.problem().system.thrusters


@pytest.mark.parametrize("extra", [(), CARRIED[:1], CARRIED], ids=["held", "bit", "carried"])
def test_constants_spend_less_than_errors_that_vary(extra):
    schedule = tiny(*WRONG, *extra, NEVER)
    proven = schedule.delta_v[1]
    assert worst_spent(schedule) <= proven < bound(schedule, False)
    attacker = Attacker.from_schedule(schedule, False, np.random.default_rng(1))
    delta_v = float(attacker.spending(20).fly(attacker.flight).delta_v.max())
    assert 0.6 * proven < delta_v <= proven * (1 + 1e-9)


@pytest.mark.slow
def test_random_scenes_spend_no_more_than_is_proven_under_any_constant(tmp_path):
    saved = []
    for seed in range(5000, fewer(5060, 5020)):
        scenario = exact(seed)
        is_orbital = scenario.system().mean_motion is not None and scenario.system().m == 3
        assignments = [*WRONG[:2], NEVER, "recoverable.recourse=none", "planner.time_limit_s=1e6"]
        assignments += [*CARRIED] * (seed % 2) + ["thrusters.misalignment_deg=2"] * is_orbital
        try:
            scenario = scenario.with_assignments(assignments)
            schedule = synthesize(scenario)
        except PolarisError:
            continue
        linear = all(isinstance(law, AffineController) for law in schedule.controllers)
        if schedule.guarantee != "proved" or not linear:
            continue
        assert worst_spent(schedule, seed=seed) <= schedule.delta_v[1], seed
        assert falsify(schedule, 100, seed).failure is None, seed
        verdict = verify(write_run(tmp_path / str(seed), scenario, schedule).path)
        assert verdict.outcome == "VERIFIED", (seed, verdict.text())
        assert schedule.delta_v[1] == bound(schedule, True), seed
        saved.append(schedule.delta_v[1] / bound(schedule, False))
    assert len(saved) >= fewer(9, 4) and max(saved) <= 1 and np.mean(saved) < 0.99


@pytest.mark.parametrize("more", [(), CARRIED], ids=["held", "carried"])
def test_synthesis_and_checker_store_alike(more, tmp_path, monkeypatch):
    scenario = load_scenario(TINY, [*WRONG, *more, NEVER, "recoverable.recourse=none", "simulation.runs=2"])
    schedule, bounds, derived = synthesize(scenario), [], checked.together

    def noted(flights, weights, count, jump=None):
        bounds.append((count, float(derived(flights, weights, count, jump))))
        return derived(flights, weights, count, jump)

    monkeypatch.setattr(checked, "together", noted)
    assert verify(write_run(tmp_path / "run", scenario, schedule).path).outcome == "VERIFIED"
    steps = [spell.linear for spell in schedule._spells]
    assert all(step.inputs[0].matrix for step in steps)
    count = sum(len(step.middle) for step in steps)
    system, weights = schedule.safety.tracking.system, schedule.spending.weights[: len(steps)]
    bounded = together(system, steps, weights, schedule._spells[0].start) * schedule.safety.tracking.flow.h
    assert any(periods == count and 0.98 < bound / bounded < 1 for periods, bound in bounds)


@pytest.fixture(scope="module")
def thruster_forger(tmp_path_factory):
    folder = tmp_path_factory.mktemp("constant_thrusters")
    assignments = QUARTER, "thrusters.magnitude_error=0.05", "tracking.R=[20,20]", NEVER
    return Forger(make(assignments, folder), folder)


def test_forged_constants_of_thrusters_are_refused(thruster_forger):
    assert thruster_forger.judge({}).outcome == "VERIFIED"
    words = ", by one constant matrix in a flight"
    lie = Lie(thruster_forger)
    del lie.certificate["system"]["thrusters"]["constant"]
    lie.judge({"assumptions"})
    for lines in (lie.certificate["assumptions"], lie.schedule["guarantee"]["assumptions"]):
        assert any(words in line for line in lines)
        lines[:] = [line.replace(words, "") for line in lines]
    lie.summary["guarantee"] = lie.schedule["guarantee"]
    lie.judge({"system"})  # errors that vary, where the scenario says never
    lie = Lie(thruster_forger)
    lie.scenario["thrusters"]["errors_vary"] = "always"
    lie.judge({"system"})  # constants that nobody declared
