"""Algorithm 2 on the bundled scenes and with every option; closed loops that try to break the claim."""

import os
import subprocess
import sys

import numpy as np
import pytest

from polaris.model.errors import ScenarioError, SynthesisInfeasible
from polaris.scenario.scenario import load_scenario
from polaris.simulation.simulate import simulate
from polaris.synthesis.controllers.controllers import AffineController
from polaris.synthesis.safety.get_safety import get_recover, get_safety
from polaris.synthesis.schedule.rules import SwitchingRules
from polaris.synthesis.schedule.synthesize import synthesize
from tests.kept import CHOSEN, printed, quick
from tests.polaris.conftest import small_controllers, small_problem, small_safety, synthesised
from tests.polaris.tiny import TINY
from tests.sizes import fewer

FEASIBLE = ["static", "dynamic", "keep_out", "hold_point", "robot"]


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
    flown = {}
    for mode, count in ((0, n // 5), (None, n)):
        runs = flown[mode] = simulate(schedule, count, seed, mode=mode, tail=safety.end.proven)
        assert distances(schedule, runs, scenario) > 0
        assert facet_slack(schedule, runs) > 0
        under_s = runs.flown[0] == 0
        assert runs.demanded[:, under_s].max() <= 1 + 1e-6, "S never saturates"
    q, K = safety.clearance.q, safety.problem.K
    nodes = safety.clearance.nodes[:K, :-1].reshape(K * q, -1)
    errors = flown[None].states[:, : K * q] - nodes
    for k in np.flatnonzero(schedule.modes > 0):
        for node in (k * q, k * q + q // 2, (k + 1) * q - 1):
            assert safety.recoverable.contains(node, errors[:, node]).all()
        start = schedule.steps[k].tube.nodes[0]
        D = np.vstack([np.eye(start.dim), -np.eye(start.dim)])
        assert np.all(errors[:, k * q] @ D.T <= start.support(D) + 1e-6 * (1 + np.abs(start.support(D))))


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(n, marks=[pytest.mark.slow] * (n in ("hold_point", "keep_out", "dynamic", "robot")))
        for n in FEASIBLE
    ],
)
def test_no_run_breaks_the_claim(name):
    attack(name, 120, 1, *quick(name))


@pytest.mark.slow
@pytest.mark.parametrize("name", FEASIBLE)
def test_many_runs_do_not_break_the_claim(name):
    """2,000 of each scene; ten thousand in a campaign."""
    for seed in range(fewer(20, 4)):
        attack(name, 500, 100 + seed)


@pytest.mark.parametrize("name", ["static", pytest.param("dynamic", marks=pytest.mark.slow)])
def test_u_alone_collides_and_s_alone_does_not(name):
    scenario, schedule = printed(name, *quick(name))
    assert distances(schedule, simulate(schedule, 50, 0, mode=1), scenario) < 0
    assert distances(schedule, simulate(schedule, 50, 0, mode=0), scenario) > 0


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(n, marks=[pytest.mark.slow] * (n in ("hold_point", "keep_out", "dynamic", "robot")))
        for n in FEASIBLE
    ],
)
def test_schedule_uses_the_experimental_controllers_for_a_real_part_of_the_time(name):
    _, schedule = printed(name, *quick(name))
    assert schedule.share() > 0.3
    assert schedule.share() == pytest.approx(
        sum(schedule.share(m) for m in range(1, len(schedule.controllers)))
    )
    assert schedule.margins[schedule.modes > 0].min() >= 0


@pytest.mark.parametrize(
    ("name", "horizon"),
    [
        ("static", "infinite"),
        ("dynamic", "one_period"),
        pytest.param("hold_point", "infinite", marks=pytest.mark.slow),
    ],
)
def test_what_is_proven_after_t(name, horizon):
    assert printed(name, *quick(name))[1].safety.end.horizon == horizon


def test_infeasible_scenario_names_the_condition_and_what_to_relax():
    with pytest.raises(SynthesisInfeasible) as caught:
        synthesize(load_scenario("infeasible"))
    assert caught.value.exit_code == 3
    assert "input limits" in str(caught.value)


def test_recoverable_kinds_in_order_of_use():
    shares = {}
    for kind in ("ball", "polytope"):
        safety = small_safety()
        sets = get_recover(kind, safety.clearance, safety.bounds)
        from dataclasses import replace

        schedule = synthesize(
            None, replace(safety, recoverable=sets), [small_controllers()["coasting"]], SwitchingRules()
        )
        shares[kind] = schedule.share()
    assert shares["polytope"] > shares["ball"]


def pulses(modes):
    edges = np.flatnonzero(np.diff(np.concatenate([[-1], modes, [-1]])))
    return np.diff(edges)


@pytest.mark.parametrize(
    ("strategy", "dwell", "cap"),
    [
        ("greedy", 1, 2),
        *(pytest.param("greedy", *rules, marks=pytest.mark.slow) for rules in ((3, 2), (2, None))),
        ("greedy", 5, None),
        pytest.param("look_ahead", 1, 2, marks=pytest.mark.slow),
        ("look_ahead", 3, 2),
    ],
)
def test_dwell_and_cap_are_kept(strategy, dwell, cap):
    safety, laws = small_safety(), [small_controllers()["coasting"]]
    if strategy == "greedy":  # a search for the best takes long there
        _, schedule = printed("static", CHOSEN)
        safety, laws = schedule.safety, schedule.controllers[1:]
    other = synthesize(None, safety, laws, SwitchingRules(strategy, dwell, cap, (1.0,)))
    assert cap is None or other.switches <= cap
    assert all(length >= dwell for length in pulses(other.modes)[:-1])
    if cap is None:  # nothing but the dwell keeps S from giving way
        assert other.switches > 2 and pulses(other.modes)[:-1].min() == dwell
    assert other.margins[other.modes > 0].min() >= 0
    assert other.share() > 0


def test_no_switch_allowed_means_s_throughout_unless_u_lasts():
    scenario, schedule = printed("static", CHOSEN)
    never = synthesize(scenario, schedule.safety, schedule.controllers[1:], SwitchingRules(max_switches=0))
    assert not never.modes.any(), "one switch is always held back for the return to S"


@pytest.mark.parametrize("strategy", ["greedy", "look_ahead"])
def test_progress_goes_through_the_steps_once(strategy):
    calls = []
    synthesize(
        None,
        small_safety(),
        [small_controllers()["coasting"]],
        SwitchingRules(strategy, beam=2),
        lambda *call: calls.append(call),
    )
    steps = [step for step, _ in calls]
    assert steps == sorted(set(steps)) and calls[-1] == (60, 60)


def test_mode_at_a_time():
    _, schedule = synthesised("static", CHOSEN)
    delta, switch = schedule.safety.problem.delta, int(np.flatnonzero(np.diff(schedule.modes))[0]) + 1
    assert schedule.mode_at(0.0) == schedule.modes[0]
    assert schedule.mode_at(switch * delta - 1e-3) == schedule.modes[switch - 1]
    assert schedule.mode_at(switch * delta) == schedule.modes[switch]
    assert [schedule.mode_at((k + 0.5) * delta) for k in range(60)] == schedule.modes.tolist()
    assert schedule.mode_at(schedule.times[-1]) == schedule.mode_at(1e9) == 0


def test_preference_decides_between_several_controllers():
    safety, laws = small_safety(), small_controllers()
    first = synthesize(None, safety, [laws["shared"], laws["any"]], SwitchingRules())
    second = synthesize(None, safety, [laws["any"], laws["shared"]], SwitchingRules())
    assert first.share(1) == 1.0
    assert second.share() == 1.0
    assert second.controllers[1].name == "any"


def test_unclipped_law_that_may_exceed_the_limits_is_refused():
    safety = small_safety()
    hard = AffineController(
        "hard",
        safety.problem.system,
        50 * safety.tracking.gain,
        safety.reference,
        safety.reference,
        safety.tracking,
    )
    assert synthesize(None, safety, [hard], SwitchingRules()).share() == 0


def test_theta_outside_the_first_set_is_an_error_with_the_witness():
    from dataclasses import replace

    from reach.sets.zonotope import Zonotope

    problem = small_problem()
    wide = replace(problem, initial_set=Zonotope.box(problem.initial_set.c, [60, 60, 60, 0.2, 0.2, 0.2]))
    with pytest.raises(
        SynthesisInfeasible, match=r"the tracking feedback may demand .* of radial thrust at t"
    ):
        get_safety(wide)
    start = Zonotope(problem.initial_set.c, 3.0 * problem.initial_set.G)
    near = replace(problem, initial_set=start, recoverable="ball", extra_margin=0.0, thrust_reserve=0.0)
    with pytest.raises(SynthesisInfeasible, match="not inside the first recoverable set") as caught:
        get_safety(near)
    assert caught.value.shortfall > 0
    assert "debris" in str(caught.value) or " thrust at t = " in str(caught.value)


def test_a_reference_past_an_obstacle_without_any_room_to_spare_is_found():
    """The planner's bounds on what lies between waypoints are tighter than those of the proof."""
    more = "planner.extra_margin_m=0", "tracking.R=[60,60]", "system.disturbance_max=0.004"
    scenario = load_scenario(TINY).with_assignments([*more, "feedback={period_s=1.0}"])
    assert synthesize(scenario).guarantee == "proved"


def test_same_input_same_schedule():
    problem = small_problem()
    a, b = get_safety(problem), get_safety(problem)
    assert np.array_equal(a.reference.chi, b.reference.chi)
    assert np.array_equal(a.clearance.distances, b.clearance.distances)


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"strategy": "best"}, "strategy"),
        ({"min_dwell": 0}, "dwell"),
        ({"max_switches": -1}, "switches"),
        ({"beam": 0}, "beam"),
    ],
)
def test_malformed_rules(options, field):
    with pytest.raises(ScenarioError, match=field):
        SwitchingRules(**options)


def test_simulation_disturbs_on_the_bound_and_its_worst_case_nearly_reaches_the_tube():
    """Were the disturbance or the corners left out, every attack above would pass for nothing."""
    from polaris.synthesis.safety.carried_rows import error_tube

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
    late = tightening[-1]
    assert np.max(reached[-5 * q :] / late) > 0.9, "the worst case comes within 10 % of the bound"


@pytest.mark.parametrize("name", ["shared", "coasting", "clipped"])
def test_cells_flown_at_once_are_the_cells_flown_step_by_step(name, monkeypatch):
    """Cells that nothing clips are flown by products over the whole cell, the rest step by step."""
    from polaris.simulation import integration

    safety, law = small_safety(), small_controllers()[name]
    schedule = synthesize(None, safety, [law], SwitchingRules())
    whole, true = [], integration.Integrator._unclipped

    def watched(self, *cell):
        cell_flown = true(self, *cell)
        whole.append(cell_flown is not None)
        return cell_flown

    monkeypatch.setattr(integration.Integrator, "_unclipped", watched)
    quick = simulate(schedule, 12, 3, mode=1)
    monkeypatch.setattr(integration.Integrator, "_unclipped", lambda self, *cell: None)
    slow = simulate(schedule, 12, 3, mode=1)
    assert any(whole) and all(whole) == (name != "clipped")
    for field in ("states", "inputs", "demanded", "delta_v"):
        expected = getattr(slow, field)
        np.testing.assert_allclose(
            getattr(quick, field), expected, rtol=0, atol=1e-12 * np.abs(expected).max()
        )


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"n": 0}, "runs"),
        ({"n": 1.5}, "runs"),
        ({"seed": -1}, "seed"),
        ({"disturbance": "wurst"}, "disturbance"),
        ({"initial": "junk"}, "initial"),
        ({"mode": -1}, "mode"),
        ({"mode": 9}, "mode"),
        ({"substeps": 0}, "substeps"),
    ],
)
def test_malformed_simulation_options(options, field):
    schedule = synthesize(None, small_safety(), [], SwitchingRules())
    with pytest.raises(ScenarioError, match=field):
        simulate(schedule, **options)


def test_controllers_of_another_reference_are_refused():
    from dataclasses import replace

    safety = small_safety()
    other = get_safety(replace(small_problem(), extra_margin=5.0))
    stranger = AffineController(
        "stranger",
        other.problem.system,
        other.tracking.gain,
        other.reference,
        other.reference,
        other.tracking,
    )
    with pytest.raises(ScenarioError, match="reference of this Safety"):
        synthesize(safety, experimental=[stranger])


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
    outputs = set()
    for kernels in ({}, {"OPENBLAS_CORETYPE": "Prescott"}, {"OPENBLAS_CORETYPE": "Haswell"}):
        environment = {**os.environ, **kernels}
        outputs.add(
            subprocess.run(
                [sys.executable, "-c", program], env=environment, capture_output=True, check=True
            ).stdout
        )
    assert len(outputs) == 1
