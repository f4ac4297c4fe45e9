"""Layouts of thrusters: errors and impulses of each, flown one by one, within the bounds of the inputs."""

import copy
import json

import numpy as np
import pytest

from polaris.certificate.checker import verify
from polaris.model.allocation import Allocation, Fault
from polaris.model.errors import ScenarioError, SynthesisInfeasible
from polaris.model.thrusters import Nozzles
from polaris.runs.run import run
from polaris.scenario.scenario import load_scenario
from polaris.simulation.allocating import thrusts_of
from polaris.simulation.fault_times import FaultTimes
from polaris.simulation.orbit.environment import Environment
from polaris.simulation.orbit.truth import fly_true
from polaris.simulation.simulate import simulate
from polaris.synthesis.schedule.spending import FlightSpending, Spell
from polaris.synthesis.schedule.synthesize import synthesize
from reach.numerics.linear import discretize
from tests.polaris.forging import CERTIFICATE, COARSE, Forger, make
from tests.polaris.synthesis.sources.test_faults import FIVE
from tests.polaris.synthesis.sources.test_pairs_of_sources import SOURCES, static
from tests.polaris.tiny import TINY

PERIOD = 2.0  # [s]

BIT = 1e-3  # [N s]


def drawn(seed, carried=False, faults=False):
    """Draw a layout, and the errors of magnitude, direction [rad] and mass that it was made with."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(int(rng.integers(10, 17)), 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    limits, faults = rng.uniform(0.02, 0.05, len(directions)), [Fault("stuck_off", 0.0)] * faults
    made = Allocation.from_directions(directions, limits, np.full(3, 0.05), faults)
    errors = rng.uniform(0, 0.1), np.deg2rad(rng.uniform(0, 5)), rng.uniform(0, 0.05)
    return rng, Nozzles.from_errors(made, *errors, BIT, carried, True), errors


def flown(rng, layout, errors, f):
    """Return inputs (R, m) by thrusts f (R, N), every nozzle as far off one input as its errors allow."""
    (magnitude, turned, lighter), d, runs = errors, layout.allocation.directions, len(f)
    axis, way = np.eye(3)[rng.integers(0, 3, runs)], rng.choice([-1.0, 1.0], runs)
    along = axis @ d.T
    aside = axis[:, None] - along[..., None] * d  # across each nozzle, towards the input
    aside /= np.maximum(np.linalg.norm(aside, axis=2, keepdims=True), 1e-12)
    strong = f * (1 + magnitude * way[:, None] * np.sign(along))
    angle = turned * rng.choice([0.5, 1.0], runs)[:, None, None] * way[:, None, None]
    force = np.einsum("rn,rnj->rj", strong, np.cos(angle) * d + np.sin(angle) * aside)
    return force / (1 + lighter * rng.choice([-1.0, 1.0], runs))[:, None]


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("faults", [False, True])
def test_errors_of_nozzles_lie_within_the_bound_of_the_inputs_and_reach_most_of_it(seed, faults):
    rng, layout, errors = drawn(seed, faults=faults)
    bounds, made, reached = layout.errors(PERIOD), layout.allocation, 0.0
    u = rng.uniform(-1, 1, (2000, 3)) * made.u_max * rng.choice([1.0, 0.0], (2000, 3), p=[0.7, 0.3])
    for mixes in made.mixes:
        f = np.maximum(u, 0) @ mixes[0] + np.maximum(-u, 0) @ mixes[1]
        np.testing.assert_allclose(f @ made.directions, u, atol=1e-12)
        off, bound = np.abs(flown(rng, layout, errors, f) - u), bounds.part(u)
        assert np.all(off <= bound + 1e-12)
        reached = max(reached, float(np.max(off / np.maximum(bound, 1e-9))))
        rounded = np.round(f * PERIOD / BIT) * BIT / PERIOD
        assert np.all(np.abs(flown(rng, layout, errors, rounded) - u) <= bounds.error(u) + 1e-12)
    assert reached > 0.75


@pytest.mark.parametrize("seed", range(3))
def test_what_thrusters_carry_stays_within_what_an_input_may_be_left(seed):
    rng, layout, errors = drawn(seed, carried=True)
    made, bounds, left, before = layout.allocation, layout.errors(PERIOD), 0.0, 0.0
    largest, asked, spent = 0.0, 0.0, 0.0
    held = rng.uniform(-1, 1, (60, 3)) * made.u_max
    for k in range(400):
        u = held[k % 60 if k < 200 else 0] * rng.choice([1.0, 0.02])
        f = thrusts_of(made, u)
        due = f * PERIOD + left
        whole = np.minimum(BIT * np.floor(due / BIT * (1 + 1e-12)) / PERIOD, made.limits)
        left = due - whole * PERIOD
        now = left @ made.directions
        largest = max(largest, float(np.abs(now).max()))
        applied = flown(rng, layout, errors, whole[None])[0]
        off = np.abs(applied - (u + (before - now) / PERIOD))
        assert np.all(off <= bounds.error(u) + 1e-12)
        before, asked, spent = now, asked + np.abs(u), spent + whole @ made.lengths
        assert spent <= asked @ layout.weights + 1e-9
    assert largest <= layout.max_carried * (1 + 1e-9) and largest > 0.2 * layout.max_carried


@pytest.mark.parametrize("seed", range(3))
def test_pulses_of_thrusters_move_a_state_no_further_than_the_pulses_of_inputs(seed):
    """A double integrator: within a period from where held inputs have it, velocity and position."""
    rng, layout, errors = drawn(seed)
    made, fired = layout.allocation, np.array(layout.fired)
    u = rng.uniform(-1, 1, (300, 3)) * made.u_max
    f, s = thrusts_of(made, u), np.linspace(0, 1, 201)[:, None, None]
    on = f / made.limits
    since = np.clip(s - (1 - on) / 2, 0.0, on) * made.limits - s * f  # impulse per period, beyond held thrust
    for speed in since:
        one = np.maximum(speed, 0), np.maximum(-speed, 0)
        moved = sum(abs(flown(rng, layout, errors, each)) for each in one)
        assert np.all(moved <= fired / 8 * (1 + 1e-9))


def test_a_thruster_without_a_direction_is_refused():
    with pytest.raises(ScenarioError, match="must not be zero"):
        Allocation.from_directions(
            np.vstack([np.eye(2), -np.eye(2), np.zeros((1, 2))]), np.ones(5), np.ones(2), ()
        )


def test_every_error_of_a_layout_flies_within_what_is_proven(tmp_path):
    """Errors, carried impulses and pulses of five thrusters: certified, and forgeries of them refused."""
    errors = ["thrusters.magnitude_error=0.02", "thrusters.mass_error=0.01"]
    impulses = [
        "thrusters.impulse_bit_N_s=0.002",
        'thrusters.remainder="carried"',
        'thrusters.pulse="centred"',
    ]
    forger = Forger(make([*FIVE, *errors, *impulses, COARSE], tmp_path), tmp_path)
    assert forger.judge({}).outcome == "VERIFIED"

    def changed(*path, share):
        data = copy.deepcopy(forger.honest)
        table, last = data["system"], path[-1]
        for key in path[:-1]:
            table = table[key]
        old = table[last]
        lower = [(float.fromhex(x) * share).hex() for x in old] if isinstance(old, list) else None
        table[last] = lower or (float.fromhex(old) * share).hex()
        return forger.judge({CERTIFICATE: json.dumps(data)})

    stated = {"thrusters": ["along", "mass", "bit"], "timing": ["carried_impulse", "pulse_thrust", "bit"]}
    for path in ((table, key) for table, keys in stated.items() for key in keys):
        assert changed(*path, share=0.99).outcome == "REJECTED", path
    assert changed("allocation", "limits", share=0.99).claim == "system"


@pytest.mark.parametrize("remainder", ["dropped", "carried"])
def test_jitter_of_a_layout_is_proven_and_no_less_of_it_accepted(remainder, tmp_path):
    """Held commands of five thrusters, for longer or shorter: of what they have left, too."""
    errors = ["thrusters.magnitude_error=0.02", "thrusters.mass_error=0.01", "timing.jitter_s=0.005"]
    impulses = ["thrusters.impulse_bit_N_s=0.002", f'thrusters.remainder="{remainder}"']
    scenario = load_scenario(TINY).with_assignments([*FIVE, *errors, *impulses])
    system, period = scenario.system(), scenario.problem().period
    exact, more, share = system.on_time, system.thrusters, 0.01 / period
    grown = (1 + share) * np.array(exact.shares) + share * np.eye(2)
    assert np.allclose(more.shares, grown, rtol=1e-8)
    left = 2 * share * system.timing.carried_impulse / period
    assert np.allclose(more.bit, (1 + share) * np.array(exact.bit) + left, rtol=1e-8)
    assert (left > 0) == (remainder == "carried")
    forger = Forger(make([*FIVE, *errors, *impulses, COARSE], tmp_path), tmp_path)
    assert forger.judge({}).outcome == "VERIFIED"
    data = copy.deepcopy(forger.honest)
    bits = [float.fromhex(x) for x in data["system"]["thrusters"]["bit"]]
    for less in ([0.99 * x for x in bits], exact.bit):
        data["system"]["thrusters"]["bit"] = [x.hex() for x in less]
        assert forger.judge({CERTIFICATE: json.dumps(data)}).claim == "system"


def test_runs_with_a_layout_fire_its_thrusters():
    """Impulses of a canted layout are multiples of the bit for each thruster, and cost what it pushes."""
    names = "layout", "magnitude", "carried bit", "pulses"
    scenario = static().with_assignments([text for name in names for text in SOURCES[name]])
    system = scenario.system()
    assert system.nozzles is not None and np.all(system.weights > 1.2)
    assert system.timing.carried_impulse == pytest.approx(2.8 * 0.005)
    assert np.all(np.array(system.timing.pulse_thrust) > 2.8 * 0.15)


@pytest.mark.slow
def test_flights_of_a_layout_keep_to_what_is_proven():
    names = "layout", "magnitude", "direction", "mass", "bit", "estimate"
    schedule = synthesize(static().with_assignments([text for name in names for text in SOURCES[name]]))
    runs = simulate(schedule, 200, 0, initial="corners")
    assert not np.any(runs.metrics().collided) and float(runs.delta_v.max()) <= schedule.delta_v[1]


@pytest.mark.slow
def test_thrusters_as_built_fail_too_in_the_nonlinear_motion(monkeypatch):
    names = "layout", "magnitude", "weak thruster, late"
    coarse = ["feedback.period_s=3.0", "recoverable.recourse=none"]
    given = [*coarse, *(text for name in names for text in SOURCES[name])]
    schedule = synthesize(static().with_assignments(given))
    env = Environment(schedule.safety.problem.system.mean_motion, 0.9)
    flown = fly_true(schedule, env, 24, substeps=1).runs
    monkeypatch.setattr(FaultTimes, "added", lambda self, u, step: 0 * u)
    sound = fly_true(schedule, env, 24, substeps=1).runs
    assert np.any(flown.states[12:] != sound.states[12:]) and not np.any(flown.metrics().collided)


@pytest.mark.parametrize("lengths", [(1e4, 1.0, 1e-4), (1.0, 1e-5, 1e4)])
def test_a_long_thruster_takes_none_from_the_mixes_of_short_ones(lengths):
    ways = np.diag(lengths)
    made = Allocation.from_directions(np.vstack([ways, -ways]), 1 / np.tile(lengths, 2), np.ones(3), [])
    np.testing.assert_allclose(made.mixes[0, 0] @ made.directions, np.eye(3), atol=1e-12)


def test_thrusters_whose_mixes_rounding_spoils_are_refused():
    around = np.linspace(0, 2 * np.pi, 7)[:-1] + 0.3
    flat = np.stack([np.cos(around), 1e-7 * np.sin(around)], axis=1)
    with pytest.raises(SynthesisInfeasible, match="barely"):
        Allocation.from_directions(flat, np.ones(6), np.ones(2), [])


def test_thrusters_spend_all_that_is_commanded_though_errors_take_a_part_of_it_back():
    """A loop that answers a steady error by twice as much: half of it is seen in what is applied."""
    unstable = [[0, 0, 1, 0], [0, 0, 0, 1], [0.3, 0, 0, 0], [0, 0.3, 0, 0]]
    corners = [[x, y] for x in (-1, 1) for y in (-1, 1)]
    scene = {"system.A": unstable, "system.disturbance_max": 0, "initial_set.half_widths": [1e-3] * 4}
    scene |= {"goal.state": [0] * 4, "tracking.Q": [1e-3] * 4, "tracking.R": [60, 60]}
    scene |= {"thrusters.directions": corners, "thrusters.thrust_max_N": 1, "thrusters.impulse_bit_N_s": 0.01}
    scene |= {"horizon.duration_s": 40, "feedback.period_s": 0.5}
    schedule = synthesize(load_scenario(TINY).with_assignments([f"{key}={x}" for key, x in scene.items()]))
    system, law = schedule.safety.problem.system, schedule.controllers[0]
    before, spells = schedule.steps[0].tube.states[0], []
    for k in range(schedule.safety.problem.K):
        spells.append(Spell.from_tube(law, law.propagate(before, k), k))
        before = spells[-1].tube.end
    count = sum(len(spell.most) for spell in spells)
    off, x, asked = system.thrusters.error(np.zeros(2)), np.zeros(4), 0.0
    Phi, Gamma = discretize(system.A, system.B, schedule.safety.tracking.flow.h)
    for _ in range(count):
        u = -law.gain @ x
        x, asked = Phi @ x + Gamma @ (u + off), asked + np.abs(u) @ system.weights
    assert asked <= FlightSpending(spells, count).thrust_bound(count)


def layout(seed):
    """Draw thrusters in the plane that push with 1 every way, and what goes wrong with them."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(6, 13))
    at = 2 * np.pi * (np.arange(count) + rng.uniform(-0.2, 0.2, count)) / count
    ways = np.stack([np.cos(at), np.sin(at)], axis=1) * 10.0 ** rng.uniform(-0.5, 0.5, (count, 1))
    limits = 10.0 ** rng.uniform(-0.5, 0.5, len(ways))
    faults = [Fault("stuck_off", 0.0)] * (seed % 3 == 2)
    limits *= 1.1 / Allocation.from_directions(ways, limits, np.full(2, 1e3), faults).u_max.min()
    limits = np.ceil(100 * limits / limits.min()) / 100 * limits.min()  # a whole number of bits in a period
    table = {"thrusters.directions": ways.tolist(), "thrusters.thrust_max_N": limits.tolist()}
    table |= {"thrusters.magnitude_error": 0.02, "thrusters.mass_error": 0.01 * (seed % 2)}
    table |= {"thrusters.impulse_bit_N_s": 1e-3 * float(limits.min())}
    table |= {"thrusters.pulse": '"centred"'} if seed % 4 > 1 else {"timing.jitter_s": 0.005}
    table |= {"thrusters.remainder": '"carried"'} if seed % 5 > 1 else {"timing.delay_s": 0.5}
    return [f"{key}={x}" for key, x in table.items()] + ['faults=[{kind="stuck_off"}]'] * len(faults)


@pytest.mark.parametrize("seed", [1, *(pytest.param(i, marks=pytest.mark.slow) for i in range(2, 14))])
def test_random_layouts_are_verified(seed, tmp_path):
    made = run(
        TINY, tmp_path / "run", overrides=["simulation.runs=2", "tracking.R=[60,60]", COARSE, *layout(seed)]
    )
    assert verify(made.path).outcome == "VERIFIED"
