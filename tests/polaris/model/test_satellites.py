"""Other bodies under thrust (Lemma 16): their acceleration is one of position, in m/s^2, whatever D is."""

import tomllib
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from polaris.model.errors import ScenarioError, SynthesisInfeasible
from polaris.model.hill import clohessy_wiltshire
from polaris.model.scene.satellite import SatelliteObstacle, true_states
from polaris.model.system import LinearSystem
from polaris.runs.schedule import write_run
from polaris.scenario.scenario import Scenario
from polaris.simulation.baselines import compare
from polaris.synthesis.safety.carried_rows import error_tube
from polaris.synthesis.safety.get_safety import get_safety
from polaris.synthesis.schedule.synthesize import synthesize

seeds = st.integers(0, 2**32 - 1)

SCENE = """
schema_version = 1
name = "trolley"
title = "A cart, and a trolley that starts and stops as it likes"
[system]
kind = "linear"
A = [[0, 0, 1, 0], [0, 0, 0, 1], [0, 0, 0, 0], [0, 0, 0, 0]]
B = [[0, 0], [0, 0], [1, 0], [0, 1]]
D = [[0, 0], [0, 0], [0.02, 0], [0, 0.02]]
input_max = 1.0
disturbance_max = 0.2
position_states = [0, 1]
[initial_set]
kind = "box"
center = [0.0, 0.0, 0.0, 0.0]
half_widths = [0.05, 0.05, 0.01, 0.01]
[horizon]
duration_s = 15.0
step_s = 0.5
[feedback]
period_s = 0.1
[tracking]
Q = [1.0, 1.0, 1.0, 1.0]
R = [8.0, 8.0]
[goal]
kind = "stationary"
state = [12.0, 9.0, 0.0, 0.0]
[[obstacles]]
kind = "satellite"
name = "trolley"
state = [5.6, 2.2, 0.0, 0.0]
state_half_widths = [0.0, 0.0, 0.0, 0.0]
radius_m = 0.5
thrust_accel_max_m_s2 = 0.01
[[experimental]]
kind = "any_thrust"
name = "any"
"""


def scene(**changes):
    """The scene as data, with other values of the system or the other body."""
    data = tomllib.loads(SCENE)
    for key, value in changes.items():
        part = data["obstacles"][0] if key in data["obstacles"][0] else data["system"]
        part[key] = value
    return data


def second_order(rng):
    """A random system whose position obeys an equation of second order, and the true acceleration input."""
    if rng.integers(4) == 0:
        eta = 10 ** rng.uniform(-4, -1.5)
        return clohessy_wiltshire(eta, 10.0, 0.1, w_max=1e-4), np.eye(6)[:, 3:]
    d, extra = int(rng.integers(1, 4)), int(rng.integers(0, 3))
    n, one, none = 2 * d + extra, np.eye(d), np.zeros((d, d))
    A = np.zeros((n, n))
    A[:d, d : 2 * d] = one * 2.0 ** rng.integers(-8, 9)  # velocities in other units than m/s
    A[d : 2 * d, : 2 * d] = rng.integers(-8, 9, size=(d, 2 * d)) / 16
    A[2 * d :] = rng.normal(size=(extra, n)) / 4  # what the position does not feel
    C, E = np.hstack([one, none, np.zeros((d, extra))]), np.zeros((n, d))
    E[d : 2 * d] = one / A[0, d]
    order = rng.permutation(n)
    A, C, E = A[np.ix_(order, order)], C[:, order], E[order]
    if extra == 0 and rng.integers(2):  # any other coordinates of the state
        T = rng.normal(size=(n, n)) + 2 * np.eye(n)
        A, C, E = T @ A @ np.linalg.inv(T), C @ np.linalg.inv(T), T @ E
    D = rng.normal(size=(n, int(rng.integers(1, 4)))) * rng.choice([0.0, 0.02, 1.0, 50.0])
    return LinearSystem(A, np.ones((n, 1)), D, [1.0], w_max=float(rng.choice([0.0, 0.01])), C=C), E


def worst_support(system, E, sat, row, h, steps):
    """Return the support that the body attains along a row at multiples of h: bang-bang thrust, held over h.

    Its motions are real ones, so it is never more than the exact support.
    """
    phi = expm(system.A * h)
    n = system.n
    free = [row]
    for _ in range(steps):
        free.append(free[-1] @ phi)
    free = np.array(free)
    total = free @ sat.state + np.abs(free) @ sat.state_half_widths + sat.radius
    for M, bound in ((E, sat.thrust_accel_max), (system.D, system.w_max)):
        block = np.zeros((n + M.shape[1],) * 2)
        block[:n] = np.hstack([system.A, M])
        push = free[:-1] @ expm(block * h)[:n, n:]
        total[1:] += bound * np.cumsum(np.linalg.norm(push, axis=1))
    return total


@settings(max_examples=50, deadline=None)
@given(seed=seeds)
def test_the_worst_motion_never_leaves_the_polytope_and_touches_it(seed):
    rng = np.random.default_rng(seed)
    system, E = second_order(rng)
    fast = max(1e-3, float(np.max(np.abs(np.linalg.eigvals(system.A)))))
    delta, cells, per = rng.uniform(0.05, 1.0) / fast, int(rng.integers(1, 5)), 60
    thrust = 10 ** rng.uniform(-3, 2)
    reach = 0.5 * thrust * (cells * delta) ** 2
    x0, half = (rng.normal(size=system.n) * reach * rng.choice([0.0, 1.0]) for _ in range(2))
    sat = SatelliteObstacle("s", x0, np.abs(half), reach * 10 ** rng.uniform(-1, 1), thrust)
    (polytope,) = sat.timed_polytopes(system, delta, cells)
    offsets = polytope.fine(per)
    for f in rng.permutation(len(polytope.normals))[:4]:
        row = polytope.normals[f] @ system.position
        support = worst_support(system, E, sat, row, delta / per, cells * per)
        by_cell = np.stack([support[k * per : (k + 1) * per + 1] for k in range(cells)])
        slack = offsets[..., f] - by_cell
        assert slack.min() >= 0
        assert slack.min(axis=1).max() <= 0.03 * np.abs(by_cell).max() + 2e-3, "as tight as a chord can be"


def test_a_declared_acceleration_is_one_of_position_whatever_d_is():
    """The other body reaches a t^2 / 2, and what the disturbance adds through D."""
    scenario = Scenario.from_dict(scene())
    (sat,), system = scenario.obstacles(), scenario.system()
    (polytope,) = sat.timed_polytopes(system, 0.5, 30)
    exact = polytope.normals @ [5.6, 2.2] + 0.5 + (0.01 + 0.02 * 0.2) * 15.0**2 / 2
    assert np.all(polytope.offsets[-1, 1] >= exact)
    np.testing.assert_allclose(polytope.offsets[-1, 1], exact, rtol=2e-3)


def test_a_scene_in_which_the_other_body_can_bar_the_way_is_refused():
    with pytest.raises(SynthesisInfeasible, match="trolley"):
        synthesize(Scenario.from_dict(scene(thrust_accel_max_m_s2=0.2)))


def test_simulated_bodies_use_what_is_declared_and_no_more():
    scenario = Scenario.from_dict(scene())
    times = np.arange(151) * 0.1
    states = true_states(scenario.obstacles(), scenario.system(), times, 40, np.random.default_rng(0))
    distances = np.linalg.norm(states["trolley"][:, -1, :2] - [5.6, 2.2], axis=1)
    reach = 0.014 * 15.0**2 / 2
    assert distances.max() == pytest.approx(reach) and np.median(distances) > reach / 2


def test_free_bodies_need_no_acceleration_and_a_still_disturbance_moves_none():
    system = LinearSystem(np.zeros((1, 1)), np.ones((1, 1)), np.ones((1, 1)), [1.0], w_max=0.5)
    sat = SatelliteObstacle("s", [1.0], [0.0], 1.0)
    states = true_states([sat], system, np.arange(11.0), 20, np.random.default_rng(0))["s"]
    assert np.abs(states[:, -1, 0] - 1.0).max() == pytest.approx(5.0)
    undisturbed = scene(D=[[0.0]] * 4)
    (sat,), system = Scenario.from_dict(undisturbed).obstacles(), Scenario.from_dict(undisturbed).system()
    drifted = true_states([sat], system, np.arange(16.0), 20, np.random.default_rng(0))["trolley"]
    assert np.linalg.norm(drifted[:, -1, :2] - [5.6, 2.2], axis=1).max() == pytest.approx(0.01 * 15**2 / 2)


# -- where it has no meaning ----------------------------------------------------------------------------

NO_MEANING = {
    "first order": ({"A": np.zeros((2, 2)), "position_states": [0, 1]}, "free part of the state"),
    "a rate that is another position": (
        {"A": [[0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1], [0, 0, 0, 0]], "position_states": [0, 1]},
        "free part of the state",
    ),
    "third order": (
        {"A": np.kron(np.eye(3, k=1), np.eye(2)), "position_states": [0, 1]},
        "more states than the position and its rate",
    ),
    "one axis of coupled ones": (
        {"A": [[0, 0, 1, 0], [0, 0, 0, 1], [0, 0, 0, 1], [0, 0, -1, 0]], "position_states": [0]},
        "more states than the position and its rate",
    ),
}


def without_meaning(name, thrust):
    change, rule = NO_MEANING[name]
    n, d = len(change["A"]), len(change["position_states"])
    data = scene(**{key: np.array(value).tolist() for key, value in change.items()})
    data["system"] |= {"B": np.eye(n)[:, n - 2 :].tolist(), "D": np.eye(n)[:, n - 1 :].tolist()}
    data["initial_set"] |= {"center": [0.0] * n, "half_widths": [0.01] * n}
    data["tracking"] = {"Q": [1.0] * n, "R": [8.0] * 2}
    data["goal"] = {"kind": "box", "center": [0.0] * n, "half_widths": [1e3] * n}
    other = {"state": [9.0] * d + [0.0] * (n - d), "state_half_widths": [0.0] * n}
    data["obstacles"][0] |= {**other, "thrust_accel_max_m_s2": thrust}
    return data, rule


@pytest.mark.parametrize("name", NO_MEANING)
def test_thrust_of_others_is_refused_where_the_position_has_no_acceleration(name):
    data, rule = without_meaning(name, 0.01)
    with pytest.raises(ScenarioError, match=rf"obstacles\[0\].thrust_accel_max_m_s2: got 0.01; .*{rule}"):
        Scenario.from_dict(data)
    free = Scenario.from_dict(without_meaning(name, 0.0)[0])
    assert free.obstacles()[0].timed_polytopes(free.system(), 0.5, 3)
    with pytest.raises(ScenarioError, match=rule):
        SatelliteObstacle("s", free.obstacles()[0].state, [0.0] * free.system().n, 1.0, 0.01).timed_polytopes(
            free.system(), 0.5, 3
        )


# -- the checker ----------------------------------------------------------------------------------------


def checked(system, sat, delta, cells, thrust):
    """Return the checker's words on a satellite's polytope if its scenario declares this thrust."""
    pytest.importorskip("flint")
    import flint

    from polaris.certificate.files.entries import UnsafeSet
    from polaris.certificate.kernel.balls import PRECISION
    from polaris.certificate.kernel.verdict import Rejected
    from polaris.certificate.model.satellites import Satellite

    (timed,) = sat.timed_polytopes(system, delta, cells)
    document = SimpleNamespace(  # what it reads of a certificate here
        **{name: getattr(system, name).tolist() for name in "ABCD"},
        **{"u_max": system.u_max.tolist(), "w_max": system.w_max, "delta": delta, "q": 1, "cells": cells},
        **{
            "estimate": [],
            "shares": [0.0] * 3,
            "bits": [],
            "prompt_bits": [],
            "timing": {},
            "carried_impulse": 0.0,
        },
        **{
            "same_shares": False,
            "transients": [],
            "mass": system.mass,
            "mean_motion": system.mean_motion,
            "bias": [],
        },
        system_kind="linear" if system.mean_motion is None else "clohessy_wiltshire",
        pulse_place="",
        observer=None,
        allocation=None,
    )
    offsets = timed.offsets.swapaxes(0, 1).tolist()
    item = UnsafeSet("s", False, timed.normals.tolist(), *offsets)
    spec = {"state": list(sat.state), "state_half_widths": list(sat.state_half_widths)}
    spec |= {"radius_m": sat.radius, "thrust_accel_max_m_s2": thrust}
    before, flint.ctx.prec = flint.ctx.prec, PRECISION
    try:
        Satellite(document, item, spec).check()
    except Rejected as error:
        return str(error)
    finally:
        flint.ctx.prec = before
    return "holds"


@settings(max_examples=8, deadline=None)
@given(seed=seeds)
def test_writer_and_checker_agree_on_random_systems(seed):
    rng = np.random.default_rng(seed)
    system, _ = second_order(rng)
    delta = float(rng.uniform(0.05, 0.5) / max(1e-3, np.max(np.abs(np.linalg.eigvals(system.A)))))
    x0, half = rng.normal(size=system.n), np.abs(rng.normal(size=system.n)) * rng.choice([0.0, 0.1])
    sat = SatelliteObstacle("s", x0, half, 0.5, 0.5 / delta**2)
    assert checked(system, sat, delta, 2, sat.thrust_accel_max) == "holds"
    if system.d == 1:  # a no is for certain only where the finest division fails, too
        assert "s, facet" in checked(system, sat, delta, 2, 1.1 * sat.thrust_accel_max)


def test_a_proved_run_is_verified_and_none_made_with_d_is(monkeypatch, tmp_path):
    pytest.importorskip("flint")
    from polaris.certificate.checker import verify

    scenario = Scenario.from_dict(scene()).set("recoverable.recourse", "none")
    bound = scenario.obstacles()[0].thrust_accel_max + scenario.system().w_max
    verdicts = []
    for made_with_d in (False, True):
        if made_with_d:
            monkeypatch.setattr(SatelliteObstacle, "pushes", lambda self, system: ((system.D, bound),))
        schedule = synthesize(scenario)
        assert schedule.guarantee == "proved"
        few = compare(schedule, 2, 0)
        verdicts.append(verify(write_run(tmp_path / "run", scenario, schedule, few).path))
    assert verdicts[0].outcome == "VERIFIED", verdicts[0].text()
    assert (verdicts[1].outcome, verdicts[1].claim) == ("REJECTED", "unsafe_sets")


@pytest.mark.parametrize("name", NO_MEANING)
def test_the_checker_refuses_thrust_of_others_where_it_has_no_meaning(name):
    free = Scenario.from_dict(without_meaning(name, 0.0)[0])
    (sat,), system = free.obstacles(), free.system()
    assert checked(system, sat, 0.5, 3, 0.0) == "holds"
    assert "has thrust, but" in checked(system, sat, 0.5, 3, 0.01)


# -- units ----------------------------------------------------------------------------------------------


def in_other_units(data, state, inputs, disturbance):
    """Return a scene with states, inputs and disturbances in other units (numbers times these)."""
    S, system = np.array(state), data["system"]
    A, B, D = (np.array(system[key], dtype=float) for key in "ABD")
    system["A"] = (S[:, None] * A / S).tolist()
    system["B"] = (S[:, None] * B / inputs).tolist()
    system["D"] = (S[:, None] * D / disturbance).tolist()
    system["input_max"] *= inputs
    system["disturbance_max"] *= disturbance
    system["mass_kg"] = inputs
    data["initial_set"]["half_widths"] = (S * data["initial_set"]["half_widths"]).tolist()
    data["goal"]["state"] = (S * data["goal"]["state"]).tolist()
    data["tracking"]["Q"] = (data["tracking"]["Q"] / S**2).tolist()
    data["tracking"]["R"] = (np.array(data["tracking"]["R"]) / inputs**2).tolist()
    other = data["obstacles"][0]
    other["state"] = (S * other["state"]).tolist()
    other["state_half_widths"] = (S * other["state_half_widths"]).tolist()
    return data


@pytest.mark.parametrize(
    ("state", "inputs", "disturbance"),
    [([1, 1, 1024, 1024], 1, 1), ([1, 1, 1, 1], 1024, 1), ([1, 1, 1, 1], 1, 1 / 64), ([1, 1, 8, 8], 64, 512)],
    ids=["velocity", "input", "disturbance", "all"],
)
def test_nothing_depends_on_the_units_of_velocities_inputs_and_disturbances(state, inputs, disturbance):
    """Whatever is declared in m or m/s^2 stays the same number, and so does everything proven with it."""
    plain = scene(state_half_widths=[0.1, 0.05, 0.01, 0.02], state=[5.6, 2.2, 0.01, -0.02])
    other = in_other_units(tomllib.loads(Scenario.from_dict(plain).to_toml()), state, inputs, disturbance)
    one, two = (get_safety(Scenario.from_dict(data)) for data in (plain, other))
    for a, b in zip(one.clearance.unsafe, two.clearance.unsafe, strict=True):
        np.testing.assert_allclose(a.offsets, b.offsets, rtol=1e-9)
    assert two.plan.delta_v == pytest.approx(one.plan.delta_v, rel=1e-3)
    np.testing.assert_allclose(two.tracking.gain * state / inputs, one.tracking.gain, rtol=1e-6)
    C = one.problem.system.position
    tubes = [
        error_tube(safety.tracking, safety.start, np.vstack([C, -C])).tightening for safety in (one, two)
    ]
    count = min(map(len, tubes)) - 1  # the last is for all later time, and each has its own norm for it
    np.testing.assert_allclose(tubes[1][:count], tubes[0][:count], rtol=0.02)
