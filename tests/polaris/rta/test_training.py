"""Environments for training: what gymnasium asks of them, and a shield that no adversary gets through."""

from functools import cache

import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium")

from gymnasium.error import ResetNeeded  # noqa: E402
from gymnasium.utils.env_checker import check_env  # noqa: E402
from gymnasium.wrappers import Autoreset, ClipAction, TimeLimit  # noqa: E402

from benchmarks.policies import write_onnx  # noqa: E402
from benchmarks.training import folded, speed, train  # noqa: E402
from polaris.certificate.checker import verify_document  # noqa: E402
from polaris.model.errors import PolarisError, ScenarioError, SynthesisInfeasible  # noqa: E402
from polaris.rta.arena import compare_methods  # noqa: E402
from polaris.rta.decision_grid import DecisionGrid  # noqa: E402
from polaris.runs.certificate import certificate  # noqa: E402
from polaris.runs.training import (  # noqa: E402
    InspectionEnv,
    InspectionVectorEnv,
    Shield,
    SwitchingEnv,
    SwitchingVectorEnv,
    VectorShield,
)
from polaris.scenario.reading import write_toml  # noqa: E402
from polaris.scenario.scenario import bundled_files, load_scenario  # noqa: E402
from polaris.synthesis.controllers.neural import NeuralController  # noqa: E402
from polaris.synthesis.controllers.policy import Policy  # noqa: E402
from polaris.synthesis.schedule.synthesize import synthesize  # noqa: E402
from reach.networks.layers import Affine  # noqa: E402
from reach.networks.network import Network  # noqa: E402
from tests.kept import scheduled  # noqa: E402
from tests.polaris.random_scenarios import synthesised as random_schedule  # noqa: E402
from tests.polaris.tiny import TINY  # noqa: E402
from tests.polaris.tiny import synthesised as tiny  # noqa: E402
from tests.sizes import fewer  # noqa: E402

SAMPLED = {"feedback": {"period_s": 0.25}, "tracking.R": [60.0, 60.0]}
INSPECTED = {
    "initial": {"kind": "states", "states": [[0.0, -60.0, 0.0, 0.0, 0.0, 0.0]], "sun_angle_deg": 20.0},
    "flight.duration_s": 60.0,
}


@cache
def sampled():
    return synthesize(load_scenario(TINY, SAMPLED))


@cache
def inexact():
    """With errors of the estimates that S acts on as well, and of thrusters."""
    navigation, thrusters = {"state_error": [0.004, 0.004, 0.001, 0.001]}, {"magnitude_error": 0.02}
    return synthesize(load_scenario(TINY, SAMPLED | {"navigation": navigation, "thrusters": thrusters}))


@cache
def inspected():
    return load_scenario("inspection", INSPECTED)


MADE = {
    "sampled": lambda: SwitchingEnv(
        sampled(), half_widths=0.005, inputs=("state", "time", "reference_input")
    ),
    "chosen": lambda: SwitchingEnv(tiny()[1], period_s=1 / 3),
    "inspection": lambda: InspectionEnv(inspected()),
}


@pytest.mark.parametrize("shielded", [False, True])
@pytest.mark.parametrize("name", MADE)
def test_environments_pass_the_check_of_the_library(name, shielded):
    env = MADE[name]()
    if shielded:
        Shield(env)
    check_env(env, skip_render_check=True)


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(bundled_files()))
def test_every_bundled_scenario_passes_it_or_is_refused(name):
    scenario = load_scenario(name)
    kind = {"schedule": SwitchingEnv}.get(scenario.kind, InspectionEnv)
    if scenario.kind not in ("schedule", "inspection") or name == "infeasible":
        with pytest.raises((ScenarioError, SynthesisInfeasible)):
            kind(scenario)
        return
    if name == "cubesat":  # late faults beside an observer: no run-time method flies it
        with pytest.raises(ScenarioError, match="must be isolated at once with navigation.measurement"):
            SwitchingEnv(scheduled(name)[1])
        return
    env = InspectionEnv(scenario) if kind is InspectionEnv else SwitchingEnv(scheduled(name)[1])
    for keys in ({"intervened"}, {"intervened", "proven" if kind is InspectionEnv else "margin"}):
        check_env(env.unwrapped, skip_render_check=True)
        env.reset(seed=1)
        assert keys <= env.step(np.zeros(env.action_space.shape, dtype=np.float32))[4].keys()
        env = Shield(env, penalty=0.5)


def test_they_are_registered_under_names():
    env = gymnasium.make("polaris.runs.training:polaris/Switching-v0", scenario=sampled())
    assert env.reset(seed=1)[0] in env.observation_space
    env = gymnasium.make_vec("polaris/Switching-v0", num_envs=3, scenario=sampled())
    assert env.reset(seed=1)[0].shape == (3, 4)
    env = VectorShield(gymnasium.make_vec("polaris/Inspection-v0", 2, scenario=inspected()))
    assert env.reset(seed=1)[0].shape == (2, 9)
    assert env.step(np.ones((2, 3), dtype=np.float32))[4]["proven"].all()


def flown(env, seed, steps):
    """Observations, rewards, ends and interventions of random actions."""
    rng, rows = np.random.default_rng(seed), []
    observed, _ = env.reset(seed=seed)
    for _ in range(steps):
        actions = rng.uniform(-1, 1, env.action_space.shape).astype(np.float32)
        observed, reward, over, ended, info = env.step(actions)
        rows.append(np.c_[observed, reward, over, ended, info["intervened"]])
    return np.array(rows)


def test_one_seed_fixes_all_episodes_and_another_gives_others():
    one, same = (flown(VectorShield(SwitchingVectorEnv(sampled(), 4)), 3, 60) for _ in range(2))
    assert np.array_equal(one, same)
    env = VectorShield(SwitchingVectorEnv(sampled(), 4))
    assert not np.array_equal(one, flown(env, 4, 60))
    assert np.array_equal(one, flown(env, 3, 60)), "what was flown before leaves no trace"
    assert len(np.unique(one[0, :, 0])) == 4, "and episodes differ"


def test_an_episode_begins_with_reset():
    env = SwitchingEnv(sampled())
    with pytest.raises(ResetNeeded):
        env.step(np.zeros(2))
    env.reset(seed=0)
    Shield(env)  # whatever was flown without it need not be recoverable
    with pytest.raises(ResetNeeded):
        env.step(np.zeros(2))
    env = Shield(Autoreset(SwitchingEnv(sampled())), penalty=2.0)
    env.reset(seed=0)
    over = False
    while not over:
        _, _, over, ended, _ = env.step(np.zeros(2))
        over |= ended
    assert env.step(np.zeros(2))[1:3] == (0.0, False), "a step that only begins anew costs nothing"


@pytest.mark.parametrize(
    ("make", "field"),
    [
        (lambda: SwitchingEnv(inspected()), "scenario"),
        (lambda: InspectionEnv(load_scenario(TINY)), "scenario"),
        (lambda: SwitchingEnv(sampled(), inputs=("error", "error")), "inputs"),
        (lambda: SwitchingEnv(sampled(), inputs=("sun",)), "inputs"),
        (lambda: SwitchingEnv(sampled(), input_scale=np.ones(3)), "input_scale"),
        (lambda: SwitchingEnv(DecisionGrid.from_schedule(sampled(), 0.5, 0.25)), "latency"),
    ],
)
def test_what_does_not_fit_is_told(make, field):
    with pytest.raises(ScenarioError) as raised:
        make()
    assert raised.value.field == field


def test_observations_are_what_a_network_reads_in_flight():
    """A network that hands its inputs on commands what the environment shows, up to its scales."""
    reads, schedule = ("error", "state", "time", "reference_input"), sampled()
    reads += ("relative_position:trolley", "velocity:trolley")
    env = SwitchingEnv(schedule, inputs=reads, input_scale=np.arange(1.0, 16.0))
    observed, _ = env.reset(seed=5)
    W, problem = np.eye(15)[[0, 2, 5, 8, 9, 10, 11, 14, 12, 13]], schedule.safety.problem
    law, flights, q = schedule.controllers[1], env.many.flights, schedule.safety.clearance.q
    for row in range(0, 10, 2):
        network = Network((Affine(W[row : row + 2], np.zeros(2)),))
        policy = Policy(network, reads, np.arange(1.0, 16.0), np.ones(2))
        arguments = problem.system, policy, law.reference, law.own, schedule.safety.tracking, problem.unsafe
        env.reset(seed=5)
        for k in range(30):
            node, (cell, place) = k, divmod(k, q)
            controller = NeuralController("same", *arguments)
            reference, later = flights.grid.own_references[1][node], place * schedule.safety.tracking.flow.h
            command = controller.command(cell, flights.grid.xi[node], reference, flights.x[0], later)
            # What is told of a body that nothing is uncertain of is off by what rounding is booked with.
            assert command == pytest.approx(W[row : row + 2] @ flights.observe()[0], abs=1e-6)
            env.step(np.zeros(2))


def test_reward_pays_for_being_near_and_for_idle_thrusters():
    def objective(action, **options):
        env = SwitchingEnv(sampled(), **options)
        env.reset(seed=0)
        return env.step(np.array(action, dtype=np.float32))

    idle, busy, free = objective([0, 0])[1], objective([1, 1])[1], objective([1, 1], effort=0.0)[1]
    assert 0 < busy < free <= 1 / 48 and idle <= 1 / 48
    assert free - busy == pytest.approx(0.05 / 48)
    assert objective([1, 1])[4]["delta_v_m_s"] == pytest.approx(0.5)
    # The seed fixes start and disturbance: one action is as good as ten times it, which the limits clip.
    assert objective([10, 10])[1] == busy


def towards(flights):
    """Full thrust towards the nearest facet, of shape (R, m): bang-bang into what is near."""
    grid, k = flights.grid, flights.k
    rows, offsets, _ = grid.facets
    clearance = flights.x @ rows.T - offsets[k * grid.nodes]
    starts = np.r_[grid.facets[2], len(rows)]
    best = [clearance[:, i:j].argmax(axis=1) + i for i, j in zip(starts, starts[1:], strict=False)]
    farthest = np.stack(best, axis=1)
    nearest = farthest[
        np.arange(len(clearance)), np.take_along_axis(clearance, farthest, axis=1).argmin(axis=1)
    ]
    push = rows @ np.linalg.matrix_power(grid.system.A, 1) @ grid.system.B
    push = np.where(np.abs(push) > 1e-12 * np.abs(push).max(initial=1e-300), push, 0)
    return -np.sign(push[nearest])


def recoverable(flights):
    """Largest share of the room that any present state needs, which must not exceed 1."""
    grid, recovery = flights.grid, flights.monitor.recovery
    nothing = recovery.demand(np.zeros((grid.system.n, 1)))
    worst = 0.0
    for k in np.unique(flights.k):
        e = flights.x[flights.k == k] - grid.xi[k * grid.nodes]
        size = np.linalg.norm(e @ grid.tracking.W.T, axis=1)
        worst = max(worst, float(recovery.share(int(k) * grid.nodes, e, size, nothing).max()))
    return worst


def attacked(scene, steps, seed, **options):
    """Episodes under adversaries, shielded: collisions, interventions, periods, and the least room."""
    runs = 16
    env = VectorShield(SwitchingVectorEnv(scene, runs, **options))
    flights, rng = env.unwrapped.flights, np.random.default_rng(seed)
    env.reset(seed=seed)
    collided = intervened = periods = 0
    worst, drawn = 0.0, np.zeros(0)
    for i in range(-(-steps // runs)):
        if i % 7 == 0:
            drawn = rng.choice([-1.0, 1.0], (runs, env.single_action_space.shape[0]))
        choice = np.arange(runs) % 3
        action = np.stack([towards(flights), drawn, 0 * drawn])[choice, np.arange(runs)]
        action = np.where(rng.random(runs)[:, None] < 0.02, np.nan, action)
        *_, over, _, info = env.step(action)
        collided += int(over.sum())
        intervened += int(info["intervened"].sum())
        periods += int(info["_intervened"].sum())
        if "half_widths" not in options:
            worst = max(worst, recoverable(flights))
    return collided, intervened, periods, worst


SCENES = {
    "sampled": (sampled, {}),
    "estimated": (sampled, {"half_widths": 0.01}),
    "chosen": (lambda: tiny()[1], {"period_s": 1 / 9}),
    "inexact": (inexact, {}),
}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=[pytest.mark.slow] * (name == "inexact")) for name in SCENES]
)
def test_adversaries_do_not_get_through(name):
    make, options = SCENES[name]
    collided, intervened, periods, worst = attacked(make(), 2000, 1, **options)
    assert collided == 0 and worst <= 1 + 1e-9
    assert 0.05 * periods < intervened < 0.98 * periods
    env = SwitchingVectorEnv(make(), 16, **options)  # the same bang-bang without the shield
    env.reset(seed=0)
    assert sum(int(env.step(towards(env.flights))[2].sum()) for _ in range(125)) > 3


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(20, fewer(40, 26)))
def test_random_scenes_are_held_too(seed, tmp_path):
    try:
        _, schedule = random_schedule(seed, tmp_path)
        collided, _, _, worst = attacked(schedule, 600, seed)
    except PolarisError as error:
        assert seed in (20, 24, 27, 29, 30, 33, 35, 37, 39), error  # no monitor holds them from the start
        pytest.skip(str(error))
    assert collided == 0 and worst <= 1 + 1e-9


def test_other_wrappers_do_not_loosen_it_and_a_penalty_is_taken_off():
    base = SwitchingEnv(sampled())
    env = TimeLimit(ClipAction(Shield(ClipAction(base), penalty=2.0)), 40)
    assert env.reset(seed=0)[0] in env.observation_space
    count = 0
    for _ in range(40):
        _, reward, over, _, info = env.step(towards(base.many.flights)[0].astype(np.float32))
        assert not over and (reward < -1.9) == info["intervened"]
        count += info["intervened"]
        assert (info["margin"] >= 0) or info["intervened"]
    assert 0 < count < 40
    with pytest.raises(TypeError):
        Shield(base, trust="declared")  # a policy obeys no declared law


def test_an_input_that_is_no_number_is_none(wrong=np.nan):
    """S flies, and nothing thrusts where there is no S; the limits are those of any that is too large."""
    env = SwitchingVectorEnv(sampled(), num_envs=3)
    actions = np.ones((3, 2)) * [[wrong, np.inf], [1e300, 1.0], [1.0, 1.0]]
    env.reset(seed=0)
    delta_v = env.step(actions)[4]["delta_v_m_s"]
    assert delta_v[0] == 0.0 and delta_v[1] == delta_v[2] > 0
    env = VectorShield(env)
    env.reset(seed=0)
    while env.step(np.zeros((3, 2)))[4]["intervened"].any():
        pass
    assert env.step(actions)[4]["intervened"].tolist() == [True, False, False]


def test_what_is_trained_is_exported_proven_and_flown(tmp_path):
    """From the first episode to the arena, in a small scene."""
    pytest.importorskip("onnx")
    env = VectorShield(SwitchingVectorEnv(sampled(), 32), penalty=0.01)
    mean, collisions = train(env, 8)
    write_onnx(tmp_path / "trained.onnx", folded(env, mean))
    scene = load_scenario(TINY, SAMPLED).to_dict()
    network = {"kind": "neural", "name": "trained", "path": "trained.onnx", "output_scale_N": 1.0}
    scene["experimental"] = [network | {"reference": scene["experimental"][0]["reference"]}]
    (tmp_path / "scene.toml").write_text(write_toml(scene), encoding="utf-8")
    scenario = load_scenario(tmp_path / "scene.toml")
    schedule = synthesize(scenario)
    assert collisions == 0 and schedule.guarantee == "proved" and schedule.share() > 0.2
    verdict = verify_document(certificate(schedule, scenario.name))
    assert verdict.outcome == "VERIFIED", verdict.text()
    results = compare_methods(schedule, 6, methods=["experimental", "schedule", "monitor"]).results
    assert all(results[key].claim.kind == "proved" for key in ("schedule", "monitor"))
    assert not any(results[key].metrics.collided.any() for key in ("schedule", "monitor"))
    assert results["schedule"].metrics.experimental_share.mean() == pytest.approx(schedule.share())


@pytest.mark.parametrize("proven", [True, False])
def test_inspections_flown_together_are_those_flown_alone(proven):
    """Each begins anew on its own; the one batch of the barrier filter keeps them as well."""
    short = load_scenario("inspection", INSPECTED | {"flight.duration_s": 8.0})
    rng = np.random.default_rng(0)
    actions = rng.choice([-1.0, 1.0], (20, 3, 3)).astype(np.float32)
    actions[4, 1] = np.nan
    many = VectorShield(InspectionVectorEnv(short, 3), proven=proven)
    together = [many.reset(seed=0), *(many.step(action) for action in actions)]
    for run in range(3):
        one = Shield(InspectionEnv(short), proven=proven)
        observed, over = one.reset(seed=0)[0], False
        for action, step in zip(actions[:, run], together[1:], strict=True):
            if over:  # a step that only begins anew
                (observed, _), over = one.reset(), False
                assert not step[4]["_least"][run] and step[1][run] == 0
            else:
                observed, reward, failed, over, info = one.step(action)
                assert not failed and info["least"] >= 0 and info["proven"] == proven
                assert (reward, over) == pytest.approx((step[1][run], step[3][run]), abs=1e-12)
                assert info["status"] == step[4]["status"][run]
                assert np.isfinite(action).all() or info["intervened"] == 1
            np.testing.assert_allclose(observed, step[0][run], atol=1e-6)
    assert sum(step[3].sum() for step in together[1:]) == 6
    assert speed(many, 1) > 0


def test_a_flight_that_begins_anew_leaves_the_estimates_of_others():
    errors = {"position_error_m": 0.05, "velocity_error_m_s": 0.002}
    flights = InspectionVectorEnv(load_scenario("inspection", INSPECTED | {"navigation": errors}), 2).flights
    rng, bound = np.random.default_rng(0), np.repeat([0.05, 0.002], 3)
    flights.restart(np.ones(2, dtype=bool), rng, fresh=True)
    before = flights.seen.copy()
    np.testing.assert_allclose(np.abs(before - flights.x), np.broadcast_to(bound, before.shape), rtol=1e-6)
    flights.restart(np.array([True, False]), rng)
    assert np.array_equal(flights.seen[1], before[1]) and not np.array_equal(flights.seen[0], before[0])
