"""The two algorithms on bare mathematics: arrays, a ``control.StateSpace``, small and odd problems."""

import numpy as np
import pytest

import polaris
from polaris.model.errors import NotCertified, ScenarioError, SynthesisInfeasible
from polaris.model.scene.obstacles import BallObstacle, BoxObstacle
from polaris.model.system import LinearSystem
from polaris.planning.goals import Box, StationaryPoint
from polaris.simulation.simulate import simulate
from polaris.synthesis.controllers.controllers import AffineController, AnyThrust
from polaris.synthesis.safety.get_safety import get_safety
from polaris.synthesis.schedule.rules import SwitchingRules
from polaris.synthesis.schedule.synthesize import synthesize
from reach.sets.zonotope import Zonotope
from tests.polaris.tiny import synthesised

A = np.block([[np.zeros((2, 2)), np.eye(2)], [np.zeros((2, 4))]])
B = np.vstack([np.zeros((2, 2)), np.eye(2)])
THETA = Zonotope.box([0, 0, 0, 0], [0.05, 0.05, 0.01, 0.01])
GOAL = StationaryPoint(np.array([4.0, 0, 0, 0]))
ROCK = BallObstacle("rock", [2.0, 0.1], 0.3)


def plane(**options):
    system = LinearSystem(A, B, B, [1.0, 1.0], 0.01)
    return get_safety(system, THETA, (ROCK,), 40, 0.25, [1.0] * 4, [4.0] * 2, goal=GOAL, **options)


def test_bare_arrays():
    safety = plane(extra_margin=0.2)
    other = AnyThrust("anything", safety.problem.system, safety.reference, safety.tracking)
    schedule = polaris.synthesize(None, safety, [other], SwitchingRules())
    assert schedule.guarantee == "proved"
    runs = simulate(schedule, 100, 0, tail=True)
    assert ROCK.signed_distance(runs.times[None], runs.positions).min() > 0
    assert safety.end.horizon == "infinite"


def test_state_space_of_python_control():
    import control

    loop = control.ss(A, B, np.eye(4), np.zeros((4, 2)))
    safety = get_safety(
        *(loop, THETA, (ROCK,), 40, 0.25, np.eye(4), 4 * np.eye(2)),
        **{"goal": GOAL, "u_max": [1.0, 1.0], "w_max": 0.01, "C": np.eye(4)[:2]},
    )
    assert np.allclose(safety.tracking.gain, plane().tracking.gain)
    sampled = control.ss(A, B, np.eye(4), np.zeros((4, 2)), 0.1)
    with pytest.raises(ScenarioError, match="continuous-time"):
        LinearSystem.from_statespace(sampled, [1.0, 1.0], C=np.eye(4)[:2])


def test_units_do_not_matter():
    """A scene in millimetres gives the same margins as in metres, and nearly the same plan and schedule.

    Nearly, because the planner books 1 mm here and a micrometre there, and U flies or not by less.
    """
    shares, results = [], []
    for scale in (1.0, 1e3):
        system = LinearSystem(A, B, B, [scale, scale], 0.01 * scale)
        theta = Zonotope(THETA.c, THETA.G * scale)
        rock = BallObstacle("rock", [2.0 * scale, 0.1 * scale], 0.3 * scale)
        goal = StationaryPoint(np.array([4.0 * scale, 0, 0, 0]))
        safety = get_safety(
            system, theta, (rock,), 40, 0.25, [1.0] * 4, [4.0] * 2, goal=goal, extra_margin=0.2 * scale
        )
        law = AffineController(
            "soft", system, 0.3 * safety.tracking.gain, safety.reference, safety.reference, safety.tracking
        )
        shares.append(synthesize(None, safety, [law], SwitchingRules()).share())
        results.append((safety.start_margin.value, safety.plan.delta_v / scale, safety.plan.margin / scale))
    assert results[0] == pytest.approx(results[1], rel=1e-2)
    assert shares[0] == pytest.approx(shares[1], abs=0.15)


def test_a_scene_of_millimetres_is_told_to_take_another_unit():
    small = 5e-5
    system = LinearSystem(A, B, B, [small, small], 0.01 * small)
    theta = Zonotope(THETA.c, THETA.G * small)
    rock = BallObstacle("rock", [2.0 * small, 0.1 * small], 0.3 * small)
    goal = StationaryPoint(np.array([4.0 * small, 0, 0, 0]))
    with pytest.raises((SynthesisInfeasible, NotCertified), match=r"another unit of length: .* 0.001 m"):
        get_safety(system, theta, (rock,), 40, 0.25, [1.0] * 4, [4.0] * 2, goal=goal)


def test_no_unsafe_sets_no_disturbance_no_width_and_one_step():
    system = LinearSystem(A, B, B, [1.0, 1.0], 0.0)
    point = Zonotope.point([0.0, 0, 0, 0])
    goal = Box(np.zeros(4), np.full(4, 0.1))
    safety = get_safety(system, point, (), 1, 0.5, [1.0] * 4, [4.0] * 2, goal=goal)
    schedule = synthesize(
        None, safety, [AnyThrust("any", system, safety.reference, safety.tracking)], SwitchingRules()
    )
    assert len(schedule.modes) == 1
    assert simulate(schedule, 5, 0).states.shape[0] == 5


def test_one_state_one_input():
    system = LinearSystem([[-0.1]], [[1.0]], [[1.0]], [1.0], 0.01, C=[[1.0]])
    wall = BoxObstacle("wall", [3.0], [0.5])
    goal = Box(np.array([1.0]), np.array([0.2]))
    safety = get_safety(system, Zonotope.box([0.0], [0.1]), (wall,), 20, 0.25, [1.0], [1.0], goal=goal)
    schedule = synthesize(None, safety, [], SwitchingRules())
    assert schedule.share() == 0
    assert simulate(schedule, 20, 0).positions.max() < 2.5


def test_missing_arguments_are_named():
    with pytest.raises(TypeError, match="goal"):
        get_safety(LinearSystem(A, B, B, [1.0, 1.0]), THETA, (), 4, 0.25, [1.0] * 4, [1.0] * 2)


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"K": 0}, "K"),
        ({"delta": -1.0}, "delta"),
        ({"initial_set": Zonotope.box([0.0, 0.0], [1.0, 1.0])}, "initial_set"),
        ({"Q": [1.0, 1.0]}, "tracking.Q"),
        ({"R": [-1.0, 1.0]}, "tracking"),
        ({"recoverable": "cube"}, "recoverable"),
        ({"period": 0.1}, "feedback.period_s"),
        ({"bound": "guess"}, "tracking.bound"),
        ({"weight": "heavy"}, "tracking.weight"),
        ({"weight": [1.0, 0.0, 1.0, 1.0]}, "tracking.weight"),
        ({"thrust_reserve": 1.0}, "thrust_reserve"),
    ],
)
def test_malformed_arguments_name_the_field(change, field):
    arguments = {
        "initial_set": THETA,
        "unsafe": (ROCK,),
        "K": 40,
        "delta": 0.25,
        "Q": [1.0] * 4,
        "R": [4.0] * 2,
    }
    with pytest.raises(ScenarioError, match=field):
        get_safety(LinearSystem(A, B, B, [1.0, 1.0], 0.01), goal=GOAL, **{**arguments, **change})


@pytest.mark.parametrize(
    ("matrices", "field"),
    [
        ({"A": np.zeros((2, 3)), "B": np.eye(2), "D": np.eye(2), "u_max": [1, 1]}, "system.A"),
        ({"A": np.eye(2) * np.nan, "B": np.eye(2), "D": np.eye(2), "u_max": [1, 1]}, "system.A"),
        ({"A": np.eye(2), "B": np.eye(3), "D": np.eye(2), "u_max": [1, 1]}, "system.B"),
        ({"A": np.eye(2), "B": np.eye(2), "D": np.eye(2), "u_max": [1, -1]}, "system.u_max"),
        ({"A": np.eye(2), "B": np.eye(2), "D": np.eye(2), "u_max": [1, 1], "w_max": np.inf}, "system.w_max"),
        ({"A": np.eye(2), "B": np.eye(2), "D": np.eye(2), "u_max": [1, 1], "C": np.eye(3)}, "system.C"),
    ],
)
def test_malformed_systems_name_the_field(matrices, field):
    with pytest.raises(ScenarioError, match=field):
        LinearSystem(**matrices)


def test_state_space_position_is_what_c_says():
    """States in another order, and velocities measured: C says which are the position."""
    import control

    order = [0, 2, 1, 3]  # x, v_x, y, v_y
    P = np.eye(4)[order]
    loop = control.ss(P @ A @ P.T, P @ B, np.eye(4)[2:] @ P.T, np.ones((2, 2)))
    goal = StationaryPoint(P @ np.array([4.0, 0, 0, 0]))
    given = {"goal": goal, "u_max": [1.0, 1.0], "w_max": 0.01, "C": np.eye(4)[:2] @ P.T}
    safety = get_safety(loop, P @ THETA, (ROCK,), 40, 0.25, [1.0] * 4, [4.0] * 2, **given)
    positions = safety.reference.chi @ safety.tracking.system.position.T
    assert ROCK.signed_distance(0.0, positions).min() > 0
    assert np.allclose(positions[-1], [4.0, 0.0], atol=1e-5)
    schedule = synthesize(safety, experimental=[])
    assert (
        "position: C x = (x0, x2), states counted from 0; unsafe sets (keep-out zones, outsides of keep-in"
        " zones) are sets of it" in schedule.assumptions
    )


@pytest.mark.parametrize("kind", ["ball", "polytope"])
def test_every_kind_of_recoverable_set_without_unsafe_sets(kind):
    system = LinearSystem(A, B, B, [1.0, 1.0], 0.01)
    safety = get_safety(system, THETA, (), 20, 0.5, [1.0] * 4, [4.0] * 2, goal=GOAL, recoverable=kind)
    assert safety.start_margin.inside
    assert synthesize(safety, experimental=[]).guarantee == "proved"


def test_a_claim_for_ever_needs_a_motion_that_repeats():
    from polaris.model.hill import cw_matrix

    with pytest.raises(ScenarioError, match="mean_motion"):
        LinearSystem(np.eye(6), np.eye(6), np.eye(6), np.ones(6), mean_motion=-0.001)
    # Clohessy-Wiltshire given as a plain matrix: rest off the along-track axis is no rest.
    slow = cw_matrix(2e-7)
    force = np.vstack([np.zeros((3, 3)), np.eye(3)])
    system = LinearSystem(slow, force, force, [0.1] * 3, 0.0)
    theta = Zonotope.point([100.0, 0, 0, 0, 0, 0])
    goal = Box(np.array([100.0, 0, 0, 0, 0, 0]), np.full(6, 1.0))
    weights = [1.0] * 3 + [100.0] * 3, [1e3] * 3
    safety = get_safety(system, theta, (), 10, 10.0, *weights, goal=goal)
    assert safety.end.horizon != "infinite"


# -- objects of the wrong kind ----------------------------------------------------------------------


def wrong_calls():
    """Calls of a first user who hands in one thing where another is meant."""
    scenario, schedule = synthesised()
    safety = schedule.safety
    other = AnyThrust("other", safety.problem.system, safety.reference, safety.tracking)
    return {
        "a path to get_safety": lambda: polaris.get_safety("tiny.toml"),
        "a name to synthesize": lambda: polaris.synthesize("static"),
        "matrices to get_safety": lambda: polaris.get_safety(
            A, THETA, (), 4, 0.25, [1.0] * 4, [1.0] * 2, goal=GOAL
        ),
        "one obstacle": lambda: get_safety(
            safety.problem.system, THETA, ROCK, 4, 0.25, [1.0] * 4, [1.0] * 2, goal=GOAL
        ),
        "one controller": lambda: polaris.synthesize(safety.problem, safety, other),
        "names of controllers": lambda: polaris.synthesize(safety.problem, safety, ["hasty"]),
        "a function for U": lambda: polaris.synthesize(safety.problem, safety, [lambda t, x: x]),
        "arguments in another order": lambda: polaris.synthesize(
            safety.problem, safety, [AnyThrust(safety.problem.system, "u", safety.reference, safety.tracking)]
        ),
        "a schedule for a Safety": lambda: polaris.synthesize(scenario, schedule),
        "a scenario to simulate": lambda: polaris.simulate(scenario),
        "a Safety to simulate": lambda: polaris.simulate(safety),
        "a schedule to evaluate": lambda: polaris.evaluate(schedule),
        "a scenario to compare": lambda: polaris.compare(scenario),
        "a scenario to compare_methods": lambda: polaris.compare_methods(scenario),
        "a scenario to DecisionGrid.of": lambda: polaris.DecisionGrid.from_schedule(scenario),
        "a scenario to falsify": lambda: polaris.falsify(scenario),
        "a scenario to plot_schedule": lambda: polaris.plot_schedule(scenario),
        "a schedule to plot_reference": lambda: polaris.plot_reference(schedule),
        "one name to make_cases": lambda: polaris.make_cases("static"),
        "one value of a grid": lambda: polaris.make_cases(["static"], {"planner.gap": 0.1}),
        "a schedule to write_trace": lambda: polaris.write_trace("t.json", schedule),
        "a path to write_run": lambda: polaris.write_run("nowhere", "tiny.toml", schedule),
        "write_run in another order": lambda: polaris.write_run("nowhere", schedule, scenario),
        "disturbance as a list": lambda: LinearSystem(A, B, B, [1.0, 1.0], [0.01, 0.01]),
        "disturbance in quotes": lambda: LinearSystem(A, B, B, [1.0, 1.0], "0.01"),
        "limits in quotes": lambda: LinearSystem(A, B, B, ["1", "1"]),
    }


@pytest.mark.parametrize("case", wrong_calls())
def test_objects_of_the_wrong_kind_are_one_message(case, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ScenarioError) as caught:
        wrong_calls()[case]()
    assert "got " in str(caught.value) and "must be" in str(caught.value)
    assert "\n" not in str(caught.value) and list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("outputs", [np.eye(4)[:2], np.eye(4)[2:], np.eye(4)])
def test_the_outputs_of_a_state_space_are_no_position(outputs):
    """With C = velocity a wall would be a speed limit, and a flight would be proven through it."""
    import control

    loop = control.ss(A, B, outputs, 0)
    with pytest.raises(TypeError, match="also needs C; C maps the state to the position"):
        get_safety(loop, THETA, (ROCK,), 4, 0.25, np.eye(4), np.eye(2), goal=GOAL, u_max=[1.0, 1.0])
    with pytest.raises(ScenarioError, match="which states are the position"):
        LinearSystem.from_statespace(loop, [1.0, 1.0], C=None)
    assert LinearSystem.from_statespace(loop, [1.0, 1.0], C=np.eye(4)[:2]).d == 2
