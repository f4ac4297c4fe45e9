"""Errors of thrusters that never vary in a flight: the velocity change that saves, flown, and forged."""

from itertools import product

import numpy as np
import pytest
from scipy.linalg import expm

from polaris.certificate.checker import verify
from polaris.certificate.claims import spending as checked
from polaris.certificate.files.document import canonical
from polaris.model.errors import PolarisError
from polaris.model.thrusters import Thrusters
from polaris.rta.decision_grid import DecisionGrid
from polaris.rta.flight import Conditions, fly
from polaris.rta.methods import METHODS
from polaris.runs.certificate import certificate
from polaris.runs.schedule import write_run
from polaris.scenario.scenario import load_scenario
from polaris.simulation.delayed import flies
from polaris.simulation.disturbances import disturbances
from polaris.simulation.falsification.attacks import Attacker
from polaris.simulation.falsification.search import falsify
from polaris.simulation.integration import columns
from polaris.synthesis.controllers.controllers import AffineController
from polaris.synthesis.schedule.spending import FlightSpending, Spell, together
from polaris.synthesis.schedule.synthesize import synthesize
from tests.kept import kept
from tests.polaris.closed_loops import Loop
from tests.polaris.forging import QUARTER, Forger, Lie, make
from tests.polaris.random_scenarios import random_scenario
from tests.polaris.tiny import TINY
from tests.sizes import fewer

WRONG = ("thrusters.magnitude_error=0.08", "thrusters.mass_error=0.04", "feedback.period_s=0.25")
NEVER = "thrusters.errors_vary=never"
CARRIED = "thrusters.impulse_bit_N_s=0.002", "thrusters.remainder=carried"
QUIET = (
    *("system.disturbance_max=0.0", "initial_set.half_widths=[1e-6,1e-6,1e-6,1e-6]"),
    "recoverable.recourse=none",
)


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
    """Fly the schedule under constant M (R, m, m); return what is spent [m/s], (R,).

    Starts are (R, n), pushes (nodes, R, p) are held over periods. By code of its own, exact between nodes.
    """
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
    spent = 0.0
    for number in range(rounds):
        start = theta.c + rng.choice([-1.0, 1.0], (len(M), theta.G.shape[1])) @ theta.G.T
        hold = int(np.exp(rng.uniform(0, np.log(nodes / 2))))
        push = rng.normal(size=(-(-nodes // hold), len(M), system.p))
        push *= system.w_max / np.linalg.norm(push, axis=2, keepdims=True)
        push = np.repeat(push, hold, axis=0)[:nodes] * (number > 0)
        spent = max(spent, float(spent_in(schedule, M, start, push).max()))
    return spent


def bound(schedule, constant):
    """Bound on what a schedule spends [m/s], errors of thrusters being constant or not."""
    system = schedule.safety.tracking.system
    errors, kept_ = system.thrusters, system.thrusters.constant
    object.__setattr__(errors, "constant", constant)
    try:
        spells = [
            Spell.from_tube(schedule.controllers[step.mode], step.tube, step.k) for step in schedule.steps
        ]
        count = len(spells) * schedule.safety.clearance.q
        return (
            FlightSpending(spells, count).thrust_bound(count) * schedule.safety.tracking.flow.h / system.mass
        )
    finally:
        object.__setattr__(errors, "constant", kept_)


def test_known_commands_with_the_worst_constant_spend_what_is_proven_to_a_few_per_cent():
    """Nothing but constant shares is uncertain: to first order the bound is the worst corner's."""
    schedule = tiny(*WRONG, *QUIET, NEVER)
    spent, proven = worst_spent(schedule, 1), bound(schedule, True)
    assert spent <= proven <= 1.15 * spent
    assert proven < 0.95 * bound(schedule, False)


@pytest.mark.parametrize("extra", [(), CARRIED[:1], CARRIED], ids=["held", "bit", "carried"])
def test_constants_spend_less_than_errors_that_vary(extra):
    schedule = tiny(*WRONG, *extra, NEVER)
    proven = schedule.delta_v[1]
    assert worst_spent(schedule) <= proven < bound(schedule, False)
    attacker = Attacker.from_schedule(schedule, False, np.random.default_rng(1))
    flown = float(attacker.spending(20).fly(attacker.flight).delta_v.max())
    assert 0.6 * proven < flown <= proven * (1 + 1e-9)


@pytest.mark.slow
def test_random_scenes_spend_no_more_than_is_proven_under_any_constant(tmp_path):
    """At every corner of the errors; confirmed by the checker, and not falsified."""
    count, saved = 0, []
    for seed in range(5000, fewer(5060, 5030)):
        path = tmp_path / f"{seed}.toml"
        path.write_text(random_scenario(seed), encoding="utf-8")
        given = [WRONG[0], WRONG[1], NEVER, "recoverable.recourse=none", "planner.time_limit_s=1e6"]
        given += CARRIED if seed % 2 else ()
        try:
            scenario = load_scenario(path, given)
            turned = scenario.system().mean_motion is not None and scenario.system().m == 3
            scenario = load_scenario(path, [*given, "thrusters.misalignment_deg=2"]) if turned else scenario
            schedule = synthesize(scenario)
        except PolarisError:
            continue
        linear = all(isinstance(law, AffineController) for law in schedule.controllers)
        if schedule.guarantee != "proved" or not linear:
            continue
        spent = worst_spent(schedule, seed=seed)
        assert spent <= schedule.delta_v[1], seed
        assert falsify(schedule, 100, seed).failure is None, seed
        verdict = verify(write_run(tmp_path / str(seed), scenario, schedule).path)
        assert verdict.outcome == "VERIFIED", (seed, verdict.text())
        saved.append(schedule.delta_v[1] / bound(schedule, False))
        count += 1
    assert count >= 9 and max(saved) <= 1 and np.mean(saved) < 0.99


def test_what_is_constant_is_drawn_once_a_flight():
    schedule = tiny(*WRONG, "thrusters.impulse_bit_N_s=0.002", NEVER)
    flight = flies(schedule.safety.problem.system)(schedule, schedule.modes, 1)
    w, _ = disturbances(flight, 40, np.random.default_rng(0), "mixed")
    m, errors = flight.system.m, flight.columns[2]
    shares = w[..., errors.start + m : errors.stop]
    assert shares.shape[-1] == m * m
    x0 = np.repeat(schedule.safety.problem.initial_set.c[None], 40, axis=0)
    later = w.copy()
    later[1:, :, errors.start + m : errors.stop] *= -1  # what later steps say of it does not count
    assert np.array_equal(flight.run(x0, w).states, flight.run(x0, later).states)
    later[:1, :, errors.start + m : errors.stop] *= -1
    assert not np.array_equal(flight.run(x0, w).states, flight.run(x0, later).states)
    M = flight.thrusters.matrices(shares[0].reshape(-1, m, m))
    u = np.random.default_rng(1).normal(size=(500, 1, m))
    assert np.all(np.abs(np.einsum("rab,urb->ura", M, u)) <= flight.thrusters.part(u) * (1 + 1e-12))


def test_run_time_methods_fly_them_beside_jitter():
    """Errors that stand for jitter vary: of their flights the columns of the matrix are not read."""
    grid = DecisionGrid.from_schedule(
        tiny(WRONG[0], "feedback.period_s=0.25", "timing.jitter_s=0.005", NEVER)
    )
    conditions = Conditions.draw(grid, 3, 0)
    m, errors = grid.system.m, columns(grid.system)[2]
    assert errors.stop - errors.start == m + m**2
    states = []
    for part in (slice(0), slice(errors.start + m, errors.stop), slice(errors.start, errors.start + m)):
        conditions.w[..., part] *= -1
        states.append(fly(grid, METHODS["schedule"].on(grid), conditions).states)
    assert np.array_equal(states[0], states[1]) and not np.array_equal(states[1], states[2])


def test_matrices_are_those_of_their_bounds():
    errors, ways = Thrusters(0.1, 0.05, constant=True), np.random.default_rng(0).normal(size=(200, 3, 3))
    M = errors.matrices(ways)
    own = np.einsum("rii->ri", M)
    others = np.linalg.norm(M * (1 - np.eye(3)), axis=-1)
    assert np.all(np.abs(own) <= 0.1) and np.allclose(others, 0.05)
    assert np.array_equal(errors.matrices(0 * ways), 0 * ways)


def test_exact_thrusters_do_not_vary_either():
    plain, never = (certificate(synthesize(load_scenario(TINY, x)), "tiny") for x in ([], [NEVER]))
    assert canonical(plain) == canonical(never)


@pytest.mark.parametrize(
    "more",
    [
        ("thrusters.directions=[[1,0],[-1,0],[0,1],[0,-1]]", "thrusters.thrust_max_N=1.0"),
        ('faults=[{kind="loss",share=0.1}]',),
    ],
    ids=["layout", "fault"],
)
def test_errors_of_thrusters_that_stand_in_for_others_count_as_ones_that_vary(more):
    always, never = (load_scenario(TINY, [*WRONG, *more, *last]) for last in ([], [NEVER]))
    assert never.problem().system.thrusters == always.problem().system.thrusters


@pytest.mark.parametrize("more", [(), CARRIED], ids=["held", "carried"])
def test_synthesis_and_checker_store_alike(more, tmp_path, monkeypatch):
    """Of the whole flight, whose laws are all linear; with one matrix in the state of either loop."""
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


# -- forged -----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def forger(tmp_path_factory):
    folder = tmp_path_factory.mktemp("constant_thrusters")
    given = QUARTER, "thrusters.magnitude_error=0.05", "tracking.R=[20,20]", NEVER
    return Forger(make(given, folder), folder)


def test_forged_constants_of_thrusters_are_refused(forger):
    assert forger.judge({}).outcome == "VERIFIED"
    words = ", by one constant matrix in a flight"

    def varying(lie):
        """Say in certificate and guarantee that errors vary."""
        del lie.certificate["system"]["thrusters"]["constant"]
        for lines in (lie.certificate["assumptions"], lie.schedule["guarantee"]["assumptions"]):
            assert any(words in line for line in lines)
            lines[:] = [line.replace(words, "") for line in lines]
        lie.summary["guarantee"] = lie.schedule["guarantee"]
        return lie

    varying(Lie(forger)).judge({"system"})  # the scenario says never
    lie = Lie(forger)
    lie.scenario["thrusters"]["errors_vary"] = "always"
    lie.judge({"system"})  # constants that nobody declared
    lie = Lie(forger)
    del lie.certificate["system"]["thrusters"]["constant"]
    lie.judge({"assumptions"})
