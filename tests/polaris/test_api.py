"""The two algorithms on bare mathematics: arrays, a ``control.StateSpace``, small and odd problems."""

import numpy as np
import pytest

import polaris
from polaris.model.errors import ScenarioError
from polaris.model.scene.obstacles import BallObstacle
from polaris.model.system import LinearSystem
from polaris.planning.goals import Box, StationaryPoint
from polaris.simulation.simulate import simulate
from polaris.synthesis.controllers.controllers import AnyThrust
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


def test_no_unsafe_sets_no_disturbance_no_width_and_one_step():
    system = LinearSystem(A, B, B, [1.0, 1.0], 0.0)
    point = Zonotope.point([0.0, 0, 0, 0])
    goal = Box(np.zeros(4), np.full(4, 0.1))
    safety = get_safety(system, point, (), 1, 0.5, [1.0] * 4, [4.0] * 2, goal=goal)
    anything = AnyThrust("any", system, safety.reference, safety.tracking)
    schedule = synthesize(None, safety, [anything], SwitchingRules())
    assert len(schedule.modes) == 1
    assert simulate(schedule, 5, 0).states.shape[0] == 5


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"K": 0}, "K"),
        ({"initial_set": Zonotope.box([0.0, 0.0], [1.0, 1.0])}, "initial_set"),
        ({"Q": [1.0, 1.0]}, "tracking.Q"),
        ({"R": [-1.0, 1.0]}, "tracking"),
        ({"recoverable": "cube"}, "recoverable"),
        ({"period": 0.1}, "feedback.period_s"),
        ({"bound": "guess"}, "tracking.bound"),
        ({"weight": [1.0, 0.0, 1.0, 1.0]}, "tracking.weight"),
        ({"thrust_reserve": 1.0}, "thrust_reserve"),
    ],
)
def test_malformed_arguments_name_the_field(change, field):
    arguments = {"initial_set": THETA, "unsafe": (ROCK,), "K": 40, "delta": 0.25}
    arguments |= {"Q": [1.0] * 4, "R": [4.0] * 2, **change}
    with pytest.raises(ScenarioError, match=field):
        get_safety(LinearSystem(A, B, B, [1.0, 1.0], 0.01), goal=GOAL, **arguments)


@pytest.mark.parametrize(
    ("matrices", "field"),
    [
        ({"A": np.zeros((2, 3)), "B": np.eye(2), "D": np.eye(2), "u_max": [1, 1]}, "system.A"),
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
    options = {"goal": goal, "u_max": [1.0, 1.0], "w_max": 0.01, "C": np.eye(4)[:2] @ P.T}
    safety = get_safety(loop, P @ THETA, (ROCK,), 40, 0.25, [1.0] * 4, [4.0] * 2, **options)
    positions = safety.reference.chi @ safety.tracking.system.position.T
    assert ROCK.signed_distance(0.0, positions).min() > 0
    assert np.allclose(positions[-1], [4.0, 0.0], atol=1e-5)
    schedule = synthesize(safety, experimental=[])
    assert any(
        one.startswith("position: C x = (x0, x2), states counted from 0") for one in schedule.assumptions
    )


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


def wrong_calls():
    """Calls of a first user who hands in one thing where another is meant."""
    scenario, schedule = synthesised()
    safety, rest = schedule.safety, (4, 0.25, [1.0] * 4, [1.0] * 2)
    system, problem = safety.problem.system, safety.problem
    other = AnyThrust("other", system, safety.reference, safety.tracking)

    def turned():
        return AnyThrust(system, "u", safety.reference, safety.tracking)

    return [
        lambda: polaris.get_safety("tiny.toml"),
        lambda: polaris.synthesize("static"),
        lambda: polaris.get_safety(A, THETA, (), *rest, goal=GOAL),
        lambda: get_safety(system, THETA, ROCK, *rest, goal=GOAL),
        lambda: polaris.synthesize(problem, safety, other),
        lambda: polaris.synthesize(problem, safety, ["hasty"]),
        lambda: polaris.synthesize(problem, safety, [lambda t, x: x]),
        lambda: polaris.synthesize(problem, safety, [turned()]),
        lambda: polaris.synthesize(scenario, schedule),
        lambda: polaris.simulate(scenario),
        lambda: polaris.simulate(safety),
        lambda: polaris.evaluate(schedule),
        lambda: polaris.compare(scenario),
        lambda: polaris.compare_methods(scenario),
        lambda: polaris.DecisionGrid.from_schedule(scenario),
        lambda: polaris.falsify(scenario),
        lambda: polaris.plot_schedule(scenario),
        lambda: polaris.plot_reference(schedule),
        lambda: polaris.make_cases("static"),
        lambda: polaris.make_cases(["static"], {"planner.gap": 0.1}),
        lambda: polaris.write_trace("t.json", schedule),
        lambda: polaris.write_run("nowhere", "tiny.toml", schedule),
        lambda: polaris.write_run("nowhere", schedule, scenario),
        lambda: LinearSystem(A, B, B, [1.0, 1.0], [0.01, 0.01]),
        lambda: LinearSystem(A, B, B, [1.0, 1.0], "0.01"),
        lambda: LinearSystem(A, B, B, ["1", "1"]),
    ]


def test_objects_of_the_wrong_kind_are_one_message(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for call in wrong_calls():
        with pytest.raises(ScenarioError, match=r"^(?=[^\n]*must be)(?=[^\n]*got )[^\n]*$"):
            call()
        assert list(tmp_path.iterdir()) == []


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
