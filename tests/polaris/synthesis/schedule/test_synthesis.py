"""Algorithm 2 on the bundled scenes and with every option; closed loops that try to break the claim."""

import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from polaris import SwitchingRules, load_scenario, simulate, synthesize
from polaris.model.errors import ScenarioError, SynthesisInfeasible
from polaris.simulation.integration import Integrator
from polaris.synthesis.safety.carried_rows import error_tube
from polaris.synthesis.safety.get_safety import get_recover, get_safety
from reach import Zonotope
from tests.kept import CHOSEN, printed, quick
from tests.polaris.conftest import small_controllers, small_problem, small_safety, synthesised
from tests.sizes import fewer


def distances(schedule, runs, scenario):
    system = schedule.safety.problem.system
    return np.min(
        [o.signed_distance(runs.times[None], runs.positions, system=system) for o in scenario.obstacles()]
    )


def facet_slack(schedule, runs):
    """Least distance [m] of any run to the timed polytopes themselves, at the nodes."""
    clearance = schedule.safety.clearance
    cells, q = len(runs.modes), clearance.q
    least = np.inf
    nodes = runs.positions[:, :-1].reshape(len(runs.positions), cells, q, -1)
    for unsafe in clearance.unsafe:
        gap = nodes @ unsafe.normals.T - unsafe.fine(q)[:cells, :-1]
        least = min(least, float(gap.max(axis=-1).min()))
    return least


def attack(name, n, seed, *more):
    """Fly one scenario's schedule, S alone with its tail; check every claim made of them."""
    scenario, schedule = synthesised(name, *more)
    safety = schedule.safety
    assert schedule.guarantee == "proved"
    runs_by_mode = {}
    for mode, count in ((0, n // 5), (None, n)):
        runs = runs_by_mode[mode] = simulate(schedule, count, seed, mode=mode, tail=safety.end.proven)
        assert distances(schedule, runs, scenario) > 0
        assert facet_slack(schedule, runs) > 0
        under_s = runs.flown[0] == 0
        assert runs.demanded[:, under_s].max() <= 1 + 1e-6, "S never saturates"
    q, K = safety.clearance.q, safety.problem.K
    nodes = safety.clearance.nodes[:K, :-1].reshape(K * q, -1)
    errors = runs_by_mode[None].states[:, : K * q] - nodes
    for k in np.flatnonzero(schedule.modes > 0):
        for node in (k * q, k * q + q // 2, (k + 1) * q - 1):
            assert safety.recoverable.contains(node, errors[:, node]).all()
        start = schedule.steps[k].tube.nodes[0]
        D = np.vstack([np.eye(start.dim), -np.eye(start.dim)])
        assert np.all(errors[:, k * q] @ D.T <= start.support(D) + 1e-6 * (1 + np.abs(start.support(D))))


SLOWER = "hold_point", "keep_out", "dynamic", "robot"
SCENES = [pytest.param(name, marks=[pytest.mark.slow] * (name in SLOWER)) for name in ("static", *SLOWER)]


@pytest.mark.parametrize("name", SCENES)
def test_no_run_breaks_the_claim(name):
    """120 of each scene; ten thousand in a campaign."""
    for seed in range(fewer(100, 1)):
        attack(name, 120, 1 + seed, *quick(name))
    _, schedule = printed(name, *quick(name))
    assert schedule.share() > 0.3
    assert schedule.share() == pytest.approx(sum(schedule.share(m + 1) for m in range(schedule.modes.max())))
    assert schedule.margins[schedule.modes > 0].min() >= 0


@pytest.mark.parametrize("name", ["static", pytest.param("dynamic", marks=pytest.mark.slow)])
def test_u_alone_collides_and_s_alone_does_not(name):
    scenario, schedule = printed(name, *quick(name))
    assert distances(schedule, simulate(schedule, 50, 0, mode=1), scenario) < 0
    assert distances(schedule, simulate(schedule, 50, 0, mode=0), scenario) > 0


@pytest.mark.parametrize(("name", "horizon"), [("static", "infinite"), ("dynamic", "one_period")])
def test_what_is_proven_after_t(name, horizon):
    assert printed(name, *quick(name))[1].safety.end.horizon == horizon


def test_infeasible_scenario_names_the_condition_and_what_to_relax():
    with pytest.raises(SynthesisInfeasible) as caught:
        synthesize(load_scenario("infeasible"))
    assert caught.value.exit_code == 3
    assert "input limits" in str(caught.value)


def test_recoverable_kinds_in_order_of_use():
    safety, laws, shares = small_safety(), [small_controllers()["coasting"]], []
    for kind in ("ball", "polytope"):
        sets = get_recover(kind, safety.clearance, safety.bounds)
        shares.append(synthesize(None, replace(safety, recoverable=sets), laws, SwitchingRules()).share())
    assert shares[0] < shares[1]


def pulses(modes):
    edges = np.flatnonzero(np.diff(np.concatenate([[-1], modes, [-1]])))
    return np.diff(edges)


@pytest.mark.parametrize(
    ("strategy", "dwell", "cap"), [("greedy", 1, 2), ("greedy", 5, None), ("look_ahead", 3, 2)]
)
def test_dwell_and_cap_are_kept(strategy, dwell, cap):
    safety, laws = small_safety(), [small_controllers()["coasting"]]
    if strategy == "greedy":  # a search for the best takes long there
        _, schedule = printed("static", CHOSEN)
        safety, laws = schedule.safety, schedule.controllers[1:]
    calls = []
    rules = SwitchingRules(strategy, dwell, cap, (1.0,))
    other = synthesize(None, safety, laws, rules, lambda *call: calls.append(call))
    assert cap is None or other.switches <= cap
    assert all(length >= dwell for length in pulses(other.modes)[:-1])
    if cap is None:  # nothing but the dwell keeps S from giving way
        assert other.switches > 2 and pulses(other.modes)[:-1].min() == dwell
    assert other.margins[other.modes > 0].min() >= 0 and other.share() > 0
    steps = [step for step, _ in calls]
    assert steps == sorted(set(steps)) and calls[-1] == (60, 60)


@pytest.mark.parametrize("name", ["coasting", "clipped"])
def test_cells_flown_at_once_are_the_cells_flown_step_by_step(name, monkeypatch):
    schedule = synthesize(None, small_safety(), [small_controllers()[name]], SwitchingRules())
    at_once = simulate(schedule, 12, 3, mode=1)
    monkeypatch.setattr(Integrator, "_unclipped", lambda self, *cell: None)
    stepwise = simulate(schedule, 12, 3, mode=1)
    for field in ("states", "inputs", "demanded", "delta_v"):
        one, other = getattr(at_once, field), getattr(stepwise, field)
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-12 * np.abs(other).max())


def test_mode_at_a_time():
    _, schedule = synthesised("static", CHOSEN)
    delta, switch = schedule.safety.problem.delta, int(np.flatnonzero(np.diff(schedule.modes))[0]) + 1
    assert schedule.mode_at(0.0) == schedule.modes[0]
    assert schedule.mode_at(switch * delta - 1e-3) == schedule.modes[switch - 1]
    assert schedule.mode_at(switch * delta) == schedule.modes[switch]
    assert [schedule.mode_at((k + 0.5) * delta) for k in range(60)] == schedule.modes.tolist()
    assert schedule.mode_at(schedule.times[-1]) == schedule.mode_at(1e9) == 0


def test_theta_outside_the_first_set_is_an_error_with_the_witness():
    problem = small_problem()
    wide = replace(problem, initial_set=Zonotope.box(problem.initial_set.c, [60, 60, 60, 0.2, 0.2, 0.2]))
    demand = r"the tracking feedback may demand .* of radial thrust at t"
    with pytest.raises(SynthesisInfeasible, match=demand):
        get_safety(wide)
    start = Zonotope(problem.initial_set.c, 3.0 * problem.initial_set.G)
    near = replace(problem, initial_set=start, recoverable="ball", extra_margin=0.0, thrust_reserve=0.0)
    with pytest.raises(SynthesisInfeasible, match="not inside the first recoverable set") as caught:
        get_safety(near)
    assert caught.value.shortfall > 0
    assert "debris" in str(caught.value) or " thrust at t = " in str(caught.value)


RULES = [("strategy", "best"), ("min_dwell", 0), ("max_switches", -1), ("beam", 0)]
RULES += [("delta_v_price", -1.0), ("switch_price", np.nan), ("delta_v_max", 0.0)]


@pytest.mark.parametrize(("key", "value"), RULES)
def test_malformed_rules(key, value):
    with pytest.raises(ScenarioError, match="schedule"):
        SwitchingRules(**{key: value})


def test_simulation_disturbs_on_the_bound_and_its_worst_case_nearly_reaches_the_tube():
    """Were the disturbance or the corners left out, every attack above would pass for nothing."""
    safety = small_safety(None, 1e-3)
    schedule = synthesize(None, safety, [], SwitchingRules())
    calm = simulate(schedule, 200, 0, initial="center", disturbance="none")
    assert np.abs(calm.states - calm.states[:1]).max() < 1e-9
    rows = -safety.clearance.unsafe[0].normals @ safety.tracking.system.position
    tube = error_tube(safety.tracking, safety.start, rows)
    runs = simulate(schedule, 400, 0, initial="corners", disturbance="worst")
    K, q = safety.problem.K, safety.clearance.q
    errors = runs.states[:, :-1] - safety.clearance.nodes[:K, :-1].reshape(K * q, -1)
    reached = (errors @ rows.T).max(axis=0)
    tightening = tube.tightening[np.minimum(np.arange(K * q), len(tube.tightening) - 1)]
    assert np.all(reached <= tightening)
    assert np.max(reached[-5 * q :] / tightening[-1]) > 0.9, "the worst case comes within 10 % of the bound"


OPTIONS = [("n", 0), ("n", 1.5), ("seed", -1), ("disturbance", "wurst"), ("initial", "junk")]
OPTIONS += [("mode", -1), ("mode", 9), ("substeps", 0)]


@pytest.mark.parametrize(("key", "value"), OPTIONS)
def test_malformed_simulation_options(key, value):
    schedule = synthesize(None, small_safety(), [], SwitchingRules())
    with pytest.raises(ScenarioError, match="runs" if key == "n" else key):
        simulate(schedule, **{key: value})


@pytest.mark.slow
@pytest.mark.skipif(
    "openblas" not in np.show_config("dicts")["Build Dependencies"]["blas"]["name"], reason="OpenBLAS"
)
def test_schedule_is_the_same_on_every_processor():
    """Rounding differs with the kernels that a processor gets; what is chosen by it must not."""
    program = (
        "from polaris import load_scenario, synthesize; s = synthesize(load_scenario('robot'));"
        "print(s.modes.tolist())"
    )
    command, outputs = [sys.executable, "-c", program], set()
    for kernels in ({}, {"OPENBLAS_CORETYPE": "Prescott"}, {"OPENBLAS_CORETYPE": "Haswell"}):
        outputs.add(subprocess.run(command, env=os.environ | kernels, capture_output=True, check=True).stdout)
    assert len(outputs) == 1
