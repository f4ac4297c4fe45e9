"""Thrusters that push only and may fail: inputs that they make, errors of each, and forgeries of them."""

from itertools import product

import numpy as np
import pytest
from scipy.optimize import linprog

from polaris import ScenarioError, SynthesisInfeasible, load_scenario, run
from polaris.certificate.checker import verify
from polaris.model.allocation import Allocation, Fault, axis_pairs, cases
from polaris.model.thrusters import Nozzles
from polaris.simulation.allocating import thrusts_of
from tests.polaris.corruptions import scaled
from tests.polaris.forging import COARSE, Forger, make
from tests.polaris.tiny import TINY

FIVE_WAYS = [[np.cos(a), np.sin(a)] for a in np.arange(5) * 2 * np.pi / 5]
"""Five thrusters round a body in the plane."""


FIVE = (
    f"thrusters.directions={[[float(x) for x in row] for row in FIVE_WAYS]}",
    "thrusters.thrust_max_N=1.5",
)


def largest_by_mixes(directions, capacity, widths):
    """Return how many times a box is made by a fixed mix for each input and sign, tops found with them."""
    (N, m), corners = directions.shape, np.array(list(product((0, 1), repeat=len(widths))))
    makes = np.kron(np.eye(2 * m), directions.T)
    sides = np.array([sign * unit for sign in (1, -1) for unit in np.eye(m) * widths])
    within = np.zeros((len(corners) * N, 2 * m * N))
    for i, signs in enumerate(corners):
        for a, sign in enumerate(signs):
            within[i * N : (i + 1) * N, (sign * m + a) * N : (sign * m + a + 1) * N] = np.eye(N)
    tops = np.tile(capacity, len(corners))[:, None]
    answer = linprog(  # of the least share of thrust for the whole box
        np.append(np.zeros(2 * m * N), 1.0),
        A_ub=np.hstack([within, -tops]),
        b_ub=np.zeros(len(within)),
        A_eq=np.hstack([makes, np.zeros((len(makes), 1))]),
        b_eq=sides.ravel(),
    )
    return 1 / answer.x[-1]


@pytest.mark.parametrize("seed", range(2))
def test_every_input_in_the_box_is_made_whichever_thruster_has_failed(seed):
    rng = np.random.default_rng(seed)
    m, count = int(rng.integers(1, 4)), int(rng.integers(9, 13))
    directions, limits = rng.normal(size=(count, m)), rng.uniform(0.5, 2, count)
    faults = [Fault("stuck_off", 0.0), Fault("loss", 0.4)][seed % 2 :]
    allocation = Allocation.from_directions(directions, limits, widths := rng.uniform(0.5, 1, m) * 5, faults)
    share = 1.0  # of what is asked
    for _, capacity in cases(limits, faults):
        box = list(zip(np.zeros(count), capacity, strict=True))
        for _ in range(2):
            u = allocation.u_max * rng.choice([-1, 1, rng.uniform(-1, 1)], m)
            assert linprog(np.ones(count), A_eq=directions.T, b_eq=u * (1 - 1e-9), bounds=box).status == 0
        share = min(share, largest_by_mixes(directions, capacity, widths))
    assert allocation.u_max == pytest.approx(share * widths, rel=1e-6)


def test_a_loss_of_axis_pairs_takes_its_share_and_one_that_is_off_takes_all():
    limits = np.array([1.0, 2.0, 3.0])
    allocation = Allocation.from_directions(*axis_pairs(limits), limits, [Fault("loss", 0.75)])
    assert allocation.u_max == pytest.approx(0.75 * limits)
    with pytest.raises(SynthesisInfeasible, match="thruster 0 under the fault stuck_off"):
        Allocation.from_directions(*axis_pairs(limits), limits, [Fault("stuck_off", 0.0)])


FAULT_LIES = {
    "stronger": lambda system: system.update(input_max=scaled(system["input_max"], 1.01)),
    "a push": lambda system: system["allocation"]["limits"].__setitem__(0, (9.0).hex()),
    "turned": lambda system: system["allocation"]["directions"].__setitem__(0, [(0.0).hex(), (1.0).hex()]),
    "another mix": lambda system: exchange(system["allocation"]["mixes"][0]),
    "a mix of another case": lambda system: exchange(system["allocation"]["mixes"][1:3]),
    "fewer": lambda system: system["allocation"]["mixes"].pop(),
    "pairs": lambda system: system["allocation"].update(layout=False),
}


def exchange(mixes):
    """Let the first be as the second."""
    mixes[0][:] = mixes[1]


def test_forged_faults_are_refused(tmp_path):
    forger = Forger(make([*FIVE, 'faults=[{kind="stuck_off"}]'], tmp_path), tmp_path)
    assert forger.judge({}).outcome == "VERIFIED"
    premise = "faults: at most one thruster fails"
    assert any(line.startswith(premise) for line in forger.honest["assumptions"])
    for name, change in FAULT_LIES.items():
        verdict = forger.forged(lambda data, change=change: change(data["system"]))
        assert (verdict.outcome, verdict.claim) == ("REJECTED", "system"), name
    assert forger.forged(lambda data: data["system"].pop("allocation")).claim == "assumptions"
    assert forger.forged(lambda data: data["system"]["allocation"]["mixes"].clear()).claim == "format"


PERIOD = 2.0  # [s]

BIT = 1e-3  # [N s]


def drawn(seed, carried=False, faults=False):
    """Draw a layout, and the errors of magnitude, direction [rad] and mass that it was made with."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(int(rng.integers(10, 17)), 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    limits, faults = rng.uniform(0.02, 0.05, len(directions)), [Fault("stuck_off", 0.0)] * faults
    allocation = Allocation.from_directions(directions, limits, np.full(3, 0.05), faults)
    errors = rng.uniform(0, 0.1), np.deg2rad(rng.uniform(0, 5)), rng.uniform(0, 0.05)
    return rng, Nozzles.from_errors(allocation, *errors, BIT, carried, True), errors


def flown(rng, layout, errors, f):
    """Return inputs (R, m) by thrusts f (R, N), every nozzle as far off one input as its errors allow."""
    (magnitude, tilt, lighter), d, runs = errors, layout.allocation.directions, len(f)
    axis, signs = np.eye(3)[rng.integers(0, 3, runs)], rng.choice([-1.0, 1.0], runs)
    along = axis @ d.T
    aside = axis[:, None] - along[..., None] * d  # across each nozzle, towards the input
    aside /= np.maximum(np.linalg.norm(aside, axis=2, keepdims=True), 1e-12)
    strong = f * (1 + magnitude * signs[:, None] * np.sign(along))
    angle = tilt * rng.choice([0.5, 1.0], runs)[:, None, None] * signs[:, None, None]
    force = np.einsum("rn,rnj->rj", strong, np.cos(angle) * d + np.sin(angle) * aside)
    return force / (1 + lighter * rng.choice([-1.0, 1.0], runs))[:, None]


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("faults", [False, True])
def test_errors_of_nozzles_lie_within_the_bound_of_the_inputs_and_reach_most_of_it(seed, faults):
    rng, layout, errors = drawn(seed, faults=faults)
    bounds, allocation, reached = layout.errors(PERIOD), layout.allocation, 0.0
    u = rng.uniform(-1, 1, (2000, 3)) * allocation.u_max * rng.choice([1.0, 0.0], (2000, 3), p=[0.7, 0.3])
    for mixes in allocation.mixes:
        f = np.maximum(u, 0) @ mixes[0] + np.maximum(-u, 0) @ mixes[1]
        np.testing.assert_allclose(f @ allocation.directions, u, atol=1e-12)
        deviation, bound = np.abs(flown(rng, layout, errors, f) - u), bounds.part(u)
        assert np.all(deviation <= bound + 1e-12)
        reached = max(reached, float(np.max(deviation / np.maximum(bound, 1e-9))))
        rounded = np.round(f * PERIOD / BIT) * BIT / PERIOD
        assert np.all(np.abs(flown(rng, layout, errors, rounded) - u) <= bounds.error(u) + 1e-12)
    assert reached > 0.75


@pytest.mark.parametrize("seed", range(2))
def test_what_thrusters_carry_stays_within_what_an_input_may_be_left(seed):
    rng, layout, errors = drawn(seed, carried=True)
    allocation, bounds, remainders, before = layout.allocation, layout.errors(PERIOD), 0.0, 0.0
    largest, commanded, expended = 0.0, 0.0, 0.0
    commands = rng.uniform(-1, 1, (60, 3)) * allocation.u_max
    for k in range(400):
        u = commands[k % 60 if k < 200 else 0] * rng.choice([1.0, 0.02])
        f = thrusts_of(allocation, u)
        due = f * PERIOD + remainders
        whole = np.minimum(BIT * np.floor(due / BIT * (1 + 1e-12)) / PERIOD, allocation.limits)
        remainders = due - whole * PERIOD
        carried = remainders @ allocation.directions
        largest = max(largest, float(np.abs(carried).max()))
        applied = flown(rng, layout, errors, whole[None])[0]
        deviation = np.abs(applied - (u + (before - carried) / PERIOD))
        assert np.all(deviation <= bounds.error(u) + 1e-12)
        before, commanded, expended = carried, commanded + np.abs(u), expended + whole @ allocation.lengths
        assert expended <= commanded @ layout.weights + 1e-9
    assert largest <= layout.max_carried * (1 + 1e-9) and largest > 0.2 * layout.max_carried


@pytest.mark.parametrize("seed", range(2))
def test_pulses_of_thrusters_move_a_state_no_further_than_the_pulses_of_inputs(seed):
    """A double integrator: within a period from where held inputs have it, velocity and position."""
    rng, layout, errors = drawn(seed)
    allocation, fired, s = layout.allocation, np.array(layout.fired), np.linspace(0, 1, 201)[:, None, None]
    f = thrusts_of(allocation, rng.uniform(-1, 1, (300, 3)) * allocation.u_max)
    on = f / allocation.limits
    for speed in np.clip(s - (1 - on) / 2, 0.0, on) * allocation.limits - s * f:
        one = np.maximum(speed, 0), np.maximum(-speed, 0)
        shift = sum(abs(flown(rng, layout, errors, each)) for each in one)
        assert np.all(shift <= fired / 8 * (1 + 1e-9))


MADE = ["thrusters.magnitude_error=0.02", "thrusters.mass_error=0.01", "thrusters.impulse_bit_N_s=0.002"]
STATED = [("thrusters", "along"), ("thrusters", "mass"), ("thrusters", "bit"), ("allocation", "limits")]
STATED += [("timing", "carried_impulse"), ("timing", "pulse_thrust"), ("timing", "bit")]


def test_every_error_of_a_layout_flies_within_what_is_proven(tmp_path):
    impulses = ['thrusters.remainder="carried"', 'thrusters.pulse="centred"']
    forger = Forger(make([*FIVE, *MADE, *impulses, COARSE], tmp_path), tmp_path)
    assert forger.judge({}).outcome == "VERIFIED"
    for table, key in STATED:
        less = {key: scaled(forger.honest["system"][table][key], 0.99)}
        verdict = forger.forged(lambda data, table=table, less=less: data["system"][table].update(less))
        assert verdict.outcome == "REJECTED", (table, key)
    with pytest.raises(ScenarioError, match="must not be zero"):
        ways = np.vstack([np.eye(2), -np.eye(2), np.zeros((1, 2))])
        Allocation.from_directions(ways, np.ones(5), np.ones(2), ())
    flat = np.array([[np.cos(a), 1e-7 * np.sin(a)] for a in 0.3 + np.pi / 3 * np.arange(6)])
    with pytest.raises(SynthesisInfeasible, match="barely"):
        Allocation.from_directions(flat, np.ones(6), np.ones(2), [])


@pytest.mark.parametrize("remainder", ["dropped", "carried"])
def test_jitter_of_a_layout_is_proven_and_no_less_of_it_accepted(remainder, tmp_path):
    assignments = [*FIVE, *MADE, f'thrusters.remainder="{remainder}"', "timing.jitter_s=0.005"]
    scenario = load_scenario(TINY).with_assignments(assignments)
    system, period = scenario.system(), scenario.problem().period
    exact, jittered, share = system.on_time, system.thrusters, 0.01 / period
    expected = (1 + share) * np.array(exact.shares) + share * np.eye(2)
    assert np.allclose(jittered.shares, expected, rtol=1e-8)
    carried = 2 * share * system.timing.carried_impulse / period
    assert np.allclose(jittered.bit, (1 + share) * np.array(exact.bit) + carried, rtol=1e-8)
    assert (carried > 0) == (remainder == "carried")
    forger = Forger(make([*assignments, COARSE], tmp_path), tmp_path)
    assert forger.judge({}).outcome == "VERIFIED"
    for less in (scaled(forger.honest["system"]["thrusters"]["bit"], 0.99), [x.hex() for x in exact.bit]):
        verdict = forger.forged(lambda data, less=less: data["system"]["thrusters"].update(bit=less))
        assert verdict.claim == "system"


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


@pytest.mark.parametrize("seed", [1, *(pytest.param(i, marks=pytest.mark.slow) for i in (2, 3, 5, 6))])
def test_random_layouts_are_verified(seed, tmp_path):
    assignments = ["simulation.runs=2", "tracking.R=[60,60]", COARSE, *layout(seed)]
    assert verify(run(TINY, tmp_path / "run", overrides=assignments).path).outcome == "VERIFIED"


SIXTEEN = [[float(np.cos(a)), float(np.sin(a))] for a in np.arange(16) * np.pi / 8]
"""Sixteen nozzles round a body in the plane."""

CRAFT = (
    *(f"thrusters.directions={SIXTEEN}", "thrusters.thrust_max_N=0.5", "thrusters.impulse_bit_N_s=0.001"),
    *("thrusters.remainder=carried", "thrusters.pulse=centred", "feedback={period_s=0.25}"),
    'faults=[{kind="stuck_off",isolation_s=0.25},{kind="stuck_on",isolation_s=0.25}]',
)
"""The tiny scene with pulses, and valves that stick, shut or open, for a period."""


def exchanged(case):
    """Return a forgery: the mixes of two nozzles swapped in a case."""

    def swapped(system):
        mixes = [mix for way in system["allocation"]["mixes"][case] for mix in way]
        other = next(j for j in range(1, len(mixes[0])) if any(mix[0] != mix[j] for mix in mixes))
        for mix in mixes:
            mix[0], mix[other] = mix[other], mix[0]

    return swapped


def bounded(share):
    """Return a forgery: the thrust of the first nozzle, so many times what it is."""

    def changed(system):
        limits = system["allocation"]["limits"]
        limits[0] = scaled(limits[0], share)

    return changed


NOZZLE_LIES = {
    "mixes exchanged": exchanged(0),
    "mixes exchanged after a fault": exchanged(-1),
    "bound raised": bounded(1.01),
    "bound lowered": bounded(0.99),
    "valve left out": lambda system: system["allocation"]["mixes"].pop(1),
    "opening left out": lambda system: system["transients"].pop(),  # that of a valve that is stuck open
    "thruster left out": lambda system: system["transients"][-1]["pushes"].pop(0),
}


def check_forgeries(folder, scratch):
    """Verify an honest folder, and let every forgery of its certificate be refused."""
    forger = Forger(folder, scratch)
    assert forger.judge({}).outcome == "VERIFIED"
    for name, forge in NOZZLE_LIES.items():
        verdict = forger.forged(lambda data, forge=forge: forge(data["system"]))
        assert verdict.outcome == "REJECTED", name
        assert verdict.claim in ("system", "assumptions", "faults"), (name, verdict.text())


def test_forged_nozzles_of_a_small_craft_are_refused(tmp_path):
    check_forgeries(make(CRAFT, tmp_path), tmp_path)


@pytest.mark.slow
def test_cubesat_is_proved_flies_u_for_most_of_the_time_and_its_nozzles_cannot_be_forged(tmp_path):
    folder = run("cubesat", tmp_path / "run", overrides=["simulation.runs=2", "schedule.bound_programs=0"])
    claim, synthesis = folder.summary["guarantee"], folder.summary["polaris"]
    assert (claim["kind"], claim["horizon"], claim["goal"]["reached"]) == ("proved", "infinite", True)
    assert synthesis["experimental_share"] >= 0.7
    check_forgeries(folder.path, tmp_path)
