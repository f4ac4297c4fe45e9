"""Delay, missed periods, jitter, clocks (Proposition 7, Lemma 6): in proofs, certificates and flights."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from polaris.certificate.checker import verify
from polaris.certificate.files.document import read
from polaris.model.errors import PolarisError, ScenarioError, SynthesisInfeasible
from polaris.model.estimates.prediction import predicting, prediction_error
from polaris.model.scene.obstacles import BallObstacle
from polaris.model.scene.satellite import SatelliteObstacle
from polaris.model.thrusters import Thrusters
from polaris.model.timing import Timing
from polaris.runs.certificate import certificate
from polaris.runs.run import run
from polaris.scenario.reading import write_toml
from polaris.scenario.scenario import load_scenario
from polaris.simulation.delayed import Predicting
from polaris.simulation.disturbances import disturbances
from polaris.simulation.falsification.search import falsify
from polaris.simulation.simulate import flown_modes, initial_states
from polaris.synthesis.schedule.synthesize import synthesize
from reach.numerics.linear import discretize
from tests.kept import kept
from tests.polaris.closed_loops import attack
from tests.polaris.forging import CERTIFICATE, Forger, make
from tests.polaris.synthesis.safety.test_closed_loops import judge
from tests.polaris.synthesis.sources.test_error_sources import exact
from tests.polaris.tiny import TINY
from tests.sizes import fewer

SAMPLED = ("feedback.period_s=0.25", "tracking.R=[60,60]")
ERRORS = (
    "navigation.state_error=[0.005, 0.005, 0.002, 0.002]",
    "thrusters.impulse_bit_N_s=0.001",
    "timing.delay_s=0.5",
    "timing.missed_periods=1",
    "timing.jitter_s=0.001",
    "timing.clock_error_s=0.2",
)


def late():
    """The tiny scene with all of it."""
    scenario = load_scenario(TINY).with_assignments([*SAMPLED, *ERRORS])
    return scenario, kept("late", lambda: synthesize(scenario))


def fly_delayed(schedule, n, seed, substeps=4):
    """Runs with predictions worked out on board, and by which shares of their bounds these are off."""
    rng = np.random.default_rng(seed)
    flight = Predicting(schedule, flown_modes(schedule, False), substeps)
    flight.prepare(n, rng)
    x0 = initial_states(schedule, n, rng, "mixed")
    return flight.run(x0, disturbances(flight, n, rng, "mixed")[0]), flight.error_share


def systems():
    """Systems of several kinds with errors."""
    for name, more in (("static", ["navigation.velocity_error_m_s=0.002"]), (TINY, [ERRORS[0]])):
        yield load_scenario(name).with_assignments([*more, "thrusters.magnitude_error=0.05"]).system()


def test_the_error_of_a_prediction_is_what_the_worst_of_everything_reaches():
    """Every state's bound is reached by the worst of estimate, disturbance and thrust, up to little."""
    for system in systems():
        worst = system.thrusters.error(system.u_max)
        for tau in (0.5, 20.0):
            bound, steps = prediction_error(system, system.navigation, worst, tau), 400
            step, x = tau / steps, np.eye(system.n)
            reached = np.abs(expm(system.A * tau)) @ system.navigation
            x = x @ expm(system.A * step / 2)
            for _ in range(steps):
                reached += step * system.w_max * np.linalg.norm(x @ system.D, axis=1)
                reached += step * np.abs(x @ system.B) @ worst
                x = x @ expm(system.A * step)
            assert np.all(reached <= bound * (1 + 1e-6)) and np.all(reached >= 0.999 * bound)


@pytest.mark.parametrize("fired", [False, True])
@pytest.mark.parametrize("share", [0.005, 0.1, 0.5])
def test_commands_out_of_time_are_other_commands_on_time_and_an_impulse_that_is_shifted(share, fired):
    """Fly late and early commands beside those that stand for them, as much of the impulse being made."""
    rng, h, count, parts = np.random.default_rng(3), 2.0, 8, 200
    jitter, step = share * h, h / parts
    for system in systems():
        u = system.u_max * rng.choice([-1, -0.4, 0, 1], (count, system.m))
        top, errors = system.u_max * (1.5 if fired else 1), system.thrusters
        timing = Timing(jitter=jitter, pulse_thrust=tuple(top) if fired else ())
        late = predicting(system, timing, h)
        assert late.without_delay.thrusters == late.on_time == errors
        begins = np.arange(count + 1) * h
        shifts = jitter * rng.choice([-1, 1, 0], count + 1)
        shifts[[0, -2, -1]] = 0.0
        t = (np.arange(count * parts) + 0.5) * step
        if fired:  # each begins as soon as the last one is over
            on = np.abs(u) / top * h
            begin, real = begins[:-1, None] + (h - on) / 2, []
            for k in range(count):
                first = np.maximum(begin[k] + shifts[k], real[-1] + on[k - 1] if k else -np.inf)
                real.append(first)
            assert np.all(np.abs(np.array(real) - begin) <= jitter * (1 + 1e-9))
            force = np.sign(u) * top * (1 + errors.along * rng.choice([-1, 1], (count, 1)))
            edges = np.arange(count * parts + 1) * step
            done = [
                np.sum(
                    np.clip((edges[:, None, None] - at) / np.maximum(on, 1e-12), 0, 1) * on * force, axis=1
                )
                for at in (np.array(real), begin)
            ]
            commanded = np.diff(done[1], axis=0) / step
        else:
            wrong = rng.uniform(-1, 1, (count * parts, system.m))
            at = np.clip(np.searchsorted(begins[1:-1] + shifts[1:-1], t, side="right"), 0, count - 1)
            thrust = u[at] + wrong * errors.error(u[at])
            edges = np.arange(count * parts + 1) * step
            total = np.vstack([0 * u[:1], np.cumsum(thrust * step, axis=0)])
            ends = np.concatenate([[0], begins[1:-1] + shifts[1:-1], [count * h]])
            warped = np.interp(edges, begins, ends)
            done = [total, np.array([np.interp(warped, edges, each) for each in total.T]).T]
            commanded = np.diff(done[1], axis=0) / step
            nominal = np.repeat(u, parts, axis=0)
            deviation, limit = np.abs(commanded - nominal), late.thrusters.error(nominal)
            assert np.all(deviation <= limit * (1 + 1e-6) + 1e-9) and np.any(deviation >= 0.6 * limit.max())
        delta = done[0] - done[1]
        assert np.all(np.abs(delta) <= late.shifted * (1 + 1e-9))
        assert fired or np.abs(delta).max() >= 0.5 * late.shifted.min()
        A, B, x, y = system.A, system.B, np.zeros(system.n), np.zeros(system.n)
        carry, push = expm(A * step), discretize(A, np.eye(system.n), step)[1]
        applied, middle = np.diff(done[0], axis=0) / step, (delta[1:] + delta[:-1]) / 2
        scale = gap = 0.0
        for i in range(count * parts):
            x = carry @ x + push @ B @ applied[i]
            y = carry @ y + push @ (B @ commanded[i] + A @ B @ middle[i])
            scale = max(scale, np.abs(x).max())
            gap = max(gap, np.abs(x - y - B @ delta[i + 1]).max())
        assert gap <= 1e-4 * scale
        offset = late.state_offset_at_nodes
        assert np.all(np.abs(B) @ np.abs(delta).max(axis=0) <= offset * (1 + 1e-9))
        assert np.allclose(late.impulse_rates, A @ B * late.shifted)


def test_without_timing_everything_is_as_without_the_table():
    plain = load_scenario(TINY)
    zero = plain.with_assignments(["timing.delay_s=0.0", "timing.missed_periods=0", "timing.clock_error_s=0"])
    assert certificate(synthesize(plain), "tiny") == certificate(synthesize(zero), "tiny")
    assert zero.system().timing == Timing() and zero.system().without_delay is zero.system()


def test_delays_flown_for_real_stay_within_the_bounds_and_use_them():
    scenario, schedule = late()
    runs, shares = fly_delayed(schedule, 60, 1, substeps=10)
    system = scenario.system()
    assert np.all(shares <= 1) and shares.max() > 0.7
    assert np.any(
        shares * system.navigation > system.timing.measured_error
    )  # without delay the bound would not hold
    assert not runs.metrics().collided.any() and runs.states.shape[0] == 60
    assert falsify(schedule, 200, 1).failure is None
    judge(0, attack(schedule, 40, 0))


@pytest.mark.slow
def test_a_longer_delay_needs_more_and_what_is_too_long_is_named():
    scenario = load_scenario(TINY).with_assignments([*SAMPLED, ERRORS[0]])
    bounds = [
        scenario.with_assignments([f"timing.delay_s={tau}", f"timing.missed_periods={missed}"]).system()
        for tau, missed in ((0.0, 0), (0.25, 0), (0.0, 1), (0.25, 2))
    ]
    errors = [system.navigation for system in bounds]
    assert np.all(errors[0] <= errors[1]) and np.all(errors[1] <= errors[3]) and np.any(errors[1] < errors[3])
    assert np.array_equal(errors[1], errors[2])
    assert all(np.array_equal(system.without_delay.navigation, errors[0]) for system in bounds)
    with pytest.raises(SynthesisInfeasible, match=r"of that for delay, missed periods and jitter"):
        synthesize(scenario.with_assignments(["timing.delay_s=20.0"]))


@pytest.mark.parametrize(
    ("assignments", "field"),
    [
        (["timing.delay_s=-1"], "timing.delay_s"),
        (["timing.jitter_s=0.1"], "timing.jitter_s"),
        ([*SAMPLED, "timing.jitter_s=0.2"], "timing.jitter_s"),
        ([*SAMPLED, "timing.missed_periods=0.5"], "timing.missed_periods"),
        (["system.A=[[0,0,1,0],[0,0,0,1],[0,0,9,0],[0,0,0,9]]", "timing.delay_s=1000"], "timing.delay_s"),
    ],
)
def test_bad_tables_are_refused_by_name(assignments, field):
    with pytest.raises(ScenarioError) as error:
        load_scenario(TINY).with_assignments(assignments)
    assert error.value.field.startswith(field)


def test_where_clocks_are_not_covered_they_are_refused():
    other = SatelliteObstacle("other", [0, 9, 0, 0, 0, 0], [0] * 6, 1.0)
    with pytest.raises(ScenarioError, match="clock_error"):
        other.blurred(0.1, 0.0)
    assert other.blurred(0.0, 0.5).radius == 1.5
    moving = BallObstacle("ball", [0, 0, 0], 1.0, velocity=[0.3, 0, 0.4])
    assert moving.blurred(2.0, 0.1).radius == pytest.approx(2.1) and moving.blurred(0.0, 0.0) is moving
    assert BallObstacle("ball", [0, 0, 0], 1.0).blurred(2.0, 0.0).radius == 1.0


@pytest.mark.slow
def test_proofs_of_random_scenes_hold_with_all_of_it():
    scenes, seeds = 0, range(5000, fewer(5060, 5025))
    for seed in seeds:
        scenario = exact(seed)
        period, step = scenario.problem().period, scenario.problem().delta
        more = ["thrusters.magnitude_error=0.01", f"timing.delay_s={(period or step / 8) * 2}"]
        more += ["timing.missed_periods=1", f"timing.jitter_s={period / 500}"] if period else []
        try:
            schedule = synthesize(scenario.with_assignments(more))
        except PolarisError:
            continue
        scenes += 1
        judge(seed, attack(schedule, 100, seed))
        if period:
            assert np.all(fly_delayed(schedule, 20, seed)[1] <= 1), seed
    assert scenes >= 0.3 * len(seeds)


@pytest.mark.slow
def test_the_smallest_errors_are_confirmed(tmp_path):
    """Errors below one unit of round-off are booked, and an honest run is not refused for them."""
    tiny = ["thrusters.magnitude_error=1e-17"]
    few = ["simulation.runs=2", "recoverable.recourse=none", *SAMPLED]
    assert verify(run(TINY, tmp_path / "run", overrides=[*few, *tiny]).path).outcome == "VERIFIED"


def test_forged_timing_is_refused(tmp_path):
    """Neither a smaller delay, nor smaller bounds than it gives, nor a displacement that shrinks sets."""
    forger = Forger(make([*SAMPLED, *ERRORS], tmp_path), tmp_path)
    assert forger.judge({}).outcome == "VERIFIED"
    data, names = forger.tree(CERTIFICATE), forger.honest["assumptions"]

    def judged(words=names, timing=(), **system):
        system = data["system"] | system
        system["timing"] = system["timing"] | dict(timing)
        return forger.judge({CERTIFICATE: json.dumps(data | {"system": system, "assumptions": words})})

    sooner = [w.replace("effect 0.5 s", "effect 0.25 s") for w in names]
    fewer = [float.fromhex(x) * 0.999 for x in data["system"]["estimate_error"]]
    less = data["system"]["thrusters"] | {"bit": data["system"]["timing"]["bit"]}
    for verdict, claim in (
        (judged(timing={"delay": (0.25).hex()}), "assumptions"),
        (judged(sooner, timing={"delay": (0.25).hex()}), "system"),
        (judged(estimate_error=[x.hex() for x in fewer]), "system"),
        (judged(thrusters=less), "system"),
        (judged(timing={"state_offset": [(0.0).hex()] * 4}), "system"),
        (judged(timing={"state_offset": [(-0.5).hex()] * 4}), "system"),
        (judged(timing={"missed": 0}), "assumptions"),
        (judged(timing={"longer": (-1.0).hex()}), "format"),  # what nothing is derived from is not said
    ):
        assert (verdict.outcome, verdict.claim) == ("REJECTED", claim)
    certificate = read(forger.run / CERTIFICATE)
    sooner, top = forger.tree("summary.json"), [float.fromhex(x) for x in data["system"]["input_max"]]
    duration, bit = (
        float.fromhex(data["sampling"]["step"]) * certificate.steps,
        float.fromhex(data["system"]["timing"]["bit"]),
    )
    for thrust, outcome in ((sum(top) + bit * len(top), "VERIFIED"), (sum(top) * 1.1, "REJECTED")):
        delta_v = {"delta_v_m_s": thrust * duration, "delta_v_max_m_s": thrust * duration}
        sooner["experimental"].update(delta_v)  # what is applied, not what is commanded
        assert forger.judge({"summary.json": json.dumps(sooner)}).outcome == outcome
    for key, value in (("delay_s", 0.75), ("jitter_s", 0.01), ("missed_periods", 2), ("clock_error_s", 1.0)):
        scenario = forger.tree("scenario.toml")
        scenario["timing"][key] = value
        assert forger.judge({"scenario.toml": write_toml(scenario)}).outcome == "REJECTED"


def test_errors_that_are_not_measured_yet_count_for_what_is_commanded():
    """Fly predictions with the worst errors of thrusters: they need what is booked, or a little less."""
    options = ["thrusters.magnitude_error=0.05", "timing.delay_s=0.5", ERRORS[0], "recoverable.recourse=none"]
    tracking = synthesize(load_scenario(TINY).with_assignments([*SAMPLED, *options])).safety.tracking
    system, feedback_bound = tracking.system, tracking.feedback_bound
    ((hidden, _),) = system.timing.by_lag
    assert hidden == 2
    Ad, Bd = discretize(system.A, system.B, tracking.flow.h)
    part, rows, last = system.thrusters.part, np.eye(system.n), tracking.settling
    calm = replace(tracking, system=replace(system, thrusters=Thrusters(bit=system.thrusters.bit)))
    last = min(last, calm.settling)
    bound = tracking.responses(rows, feedback_bound)[: last + 1] - calm.responses(rows, None)[: last + 1]
    others = np.abs(tracking.loop_transitions[: last + 1, : system.n, system.n :])
    bound += others @ (tracking.remembered - calm.remembered)
    reached = np.zeros((last + 1, system.n))
    for first in range(-hidden, last):
        sent = (
            system.u_max
            if first < 0
            else np.minimum(feedback_bound[min(first, len(feedback_bound) - 1)], system.u_max)
        )
        size = part(sent)
        e, wrong = np.zeros((system.n, system.m)), np.zeros((system.n, system.m))
        for node in range(-hidden, last):
            push = Bd * (size if node == first else 0.0)
            if node >= 0:  # before, what errors do is part of where S takes over
                e = Ad @ e - Bd @ tracking.gain @ (e - wrong) + push
                reached[node + 1] += np.abs(e).sum(axis=1)
            measured = np.linalg.matrix_power(Ad, hidden) @ Bd * (size if node - hidden == first else 0.0)
            wrong = Ad @ wrong + push - measured
    assert np.all(reached <= bound * (1 + 1e-9)) and np.all(reached[-1] > 0.7 * bound[-1])
