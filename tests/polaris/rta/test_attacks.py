"""Attacks on what is claimed to be proved: U, the disturbance and the estimate conspire against one limit.

Node by node, and finer, U thrusts and the disturbance pushes along the adjoint of a chosen limit at a chosen
lag, and the estimate is displaced away from it by its whole bound. Negative controls show that the attack
finds what a method without its limits lets through.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from polaris.model.errors import NotCertified
from polaris.model.scene.obstacles import BoxObstacle
from polaris.model.system import LinearSystem
from polaris.model.tolerances import ROUNDING
from polaris.planning.goals import Box
from polaris.planning.reference import Reference
from polaris.rta.decision_grid import DecisionGrid
from polaris.rta.flight import Engine
from polaris.rta.method import FILTERED, Observation
from polaris.rta.methods import METHODS
from polaris.rta.methods.monitor import Monitor
from polaris.rta.permission import ErrorMotion
from polaris.rta.recovery import Recovery
from polaris.synthesis.controllers.controllers import AffineController, AnyThrust
from polaris.synthesis.safety.continuation import Continuation
from polaris.synthesis.safety.get_safety import get_safety
from polaris.synthesis.safety.problem import Problem
from polaris.synthesis.schedule.synthesize import synthesize
from polaris.synthesis.tracker.lqr import lqr_gain
from reach.numerics.linear import discretize
from reach.sets.zonotope import Zonotope

SUB = 8
"""Parts of the period between two nodes in which the attack integrates."""


@cache
def line(order=2, feedback=None, any_thrust=True, jump=False, goal=3.6, weight=4.0):
    """Motion along a line towards a wall at 4 m, of first (CB != 0) or second order."""
    K, delta = 20, 0.5
    A = np.array([[-0.05]]) if order == 1 else np.array([[0.0, 1.0], [0.0, 0.0]])
    B = np.eye(order)[:, -1:]
    system = LinearSystem(A, B, B, [0.5], 0.02, C=np.eye(1, order))
    start = Zonotope.box(np.zeros(order), [0.1, 0.03][:order])
    wall, end = (
        BoxObstacle("wall", [4.5], [0.5]),
        Box([goal if order == 2 else 3.0, 0.0][:order], [0.3, 0.05][:order]),
    )
    Q, R = np.ones(order), [weight]
    problem = Problem(system, start, (wall,), K, delta, Q, R, end, period=feedback, thrust_reserve=0.2)
    safety = get_safety(problem)
    if any_thrust:
        laws = [AnyThrust("anything", system, safety.reference, safety.tracking)]
    else:
        chi = np.zeros((K + 1, order))
        chi[:, 0] = 0.3 * delta * np.arange(K + 1)
        chi[:, 1:] = 0.0 if jump else 0.3  # with a jump the waypoints do not join
        u_path = Reference(system, delta, chi, np.zeros((K, 1)))
        gain = lqr_gain(system, Q, R)
        laws = [AffineController("own", system, gain, safety.reference, u_path, safety.tracking, True)]
    return synthesize(safety, experimental=laws)


def attack(scene, method, runs=24, seed=0):
    """Least distance to an unsafe set, at SUB parts of every period, largest demand of S, share of U."""
    system, rng, c = scene.system, np.random.default_rng(seed), scene.nodes
    recovery = Recovery(scene)
    row = recovery.rows[np.arange(runs) % len(recovery.rows)]
    lag = np.minimum(*rng.integers(0, recovery.lags, (2, runs)))
    carried = scene.tracking.transitions
    theta = scene.schedule.safety.problem.initial_set
    push = np.einsum("ri,rij->rj", row, carried[lag])
    x = theta.c + np.where(push @ theta.G < 0, -1.0, 1.0) @ theta.G.T
    flying, u, since = np.zeros(runs, dtype=int), np.zeros((runs, system.m)), np.zeros(runs, dtype=int)
    Ad, Bd = discretize(system.A, system.B, scene.h / SUB)
    Dd = discretize(system.A, system.D, scene.h / SUB)[1]
    safe = scene.clearance.reference.fine(scene.clearance.q * SUB)
    walls = np.concatenate([unsafe.fine(scene.clearance.q * SUB) for unsafe in scene.unsafe], axis=-1)
    least, demand, u_steps = np.inf, 0.0, 0
    method.start(runs)
    for k in range(scene.decisions):
        u_command = np.sign(push @ system.B) * system.u_max
        error = -np.where(push < 0, -1.0, 1.0) * scene.half_widths
        choice = method.decide(Observation(k, x + error, u_command, flying))
        for i in range(c + 1):
            if i == scene.delay:
                flying, u = choice.mode, u if choice.u is None else choice.u
            if i == c:
                break
            cell, place = divmod(k * c + i, scene.clearance.q)
            since = np.where(flying == 0, since + 1, 0)
            push = np.einsum("ri,rij->rj", row, carried[np.maximum(lag - since, 0)])
            inputs = None
            for part in range(SUB):
                at = place * SUB + part
                if inputs is None:
                    inputs = scene.controllers[0].command(cell, safe[cell, at], safe[cell, at], x)
                    ratio = (np.abs(inputs) / system.u_max).max(axis=1)[flying == 0]
                    demand = max(demand, float(ratio.max(initial=0.0)))
                bang = np.where((flying == FILTERED)[:, None], u, np.sign(push @ system.B) * system.u_max)
                applied = np.clip(np.where((flying == 0)[:, None], inputs, bang), -system.u_max, system.u_max)
                w = push @ system.D
                w *= system.w_max / np.maximum(np.linalg.norm(w, axis=1, keepdims=True), 1e-300)
                x = x @ Ad.T + applied @ Bd.T + w @ Dd.T
                clearance = x @ scene.facets[0].T - walls[cell, at + 1]
                least = min(least, float(scene.nearest(clearance).min()))
            u_steps += int((flying != 0).sum())
    return least, demand, u_steps / (runs * scene.last)


SCENES = {
    "second order": ({}, 0.25, 0.0, 0.0),
    "second order, sampled, late, estimated": ({"feedback": 0.25}, 0.5, 0.25, 0.01),
    "first order": ({"order": 1}, 0.25, 0.0, 0.0),
    "first order, whole period late, estimated": ({"order": 1}, 0.25, 0.25, 0.01),
}

PROVED = "monitor", "simplex_explicit", "asif_implicit"


@pytest.mark.parametrize("setting", SCENES)
@pytest.mark.parametrize("key", PROVED)
def test_no_conspiracy_leads_into_a_set_or_asks_s_for_too_much(setting, key):
    settings, *options = SCENES[setting]
    scene = DecisionGrid.from_schedule(line(**settings), *options)
    least, demand, share = attack(scene, METHODS[key](scene))
    assert least > 0
    assert demand <= 1
    assert share > 0 or key == "simplex_explicit"


@pytest.mark.parametrize("order", [1, 2])
def test_the_attack_breaks_a_monitor_without_its_limits(order):
    scene = DecisionGrid.from_schedule(line(order=order), 0.25)
    monitor = Monitor(scene)
    monitor.recovery.reciprocals[:] = 0.0
    monitor.recovery.far_shares[:] = 0.0
    for prospect in monitor.prospects.values():
        prospect.inner_limits[:] = 0.0
        object.__setattr__(prospect.demand, "base", 0.0)
        object.__setattr__(prospect.demand, "slope", 0.0)
    assert attack(scene, monitor)[0] < 0


def test_a_reference_of_u_that_jumps_is_predicted_and_its_clip_seen():
    scene = DecisionGrid.from_schedule(line(any_thrust=False, jump=True, goal=3.0), 0.25)
    monitor, engine, rng = Monitor(scene, "declared"), Engine(scene), np.random.default_rng(0)
    prospect, compared = monitor.prospects[1, 0], 0
    none = np.zeros((20, 1))
    for k in range(scene.decisions - 1):
        node, after = k * scene.nodes, (k + 1) * scene.nodes
        x = scene.own_references[1][node] + rng.uniform(-1, 1, (20, 2)) * [0.05, 0.02]
        e, demand = x - scene.xi[node], np.zeros(20)
        for i in range(node, after):
            x, _, ratio, _ = engine.step(i, np.ones(20, dtype=int), none, x, none)
            demand = np.maximum(demand, ratio)
        linear = demand <= 1
        _, holds = prospect.share(k, e)
        assert not (holds & ~linear).any()
        wrong = np.abs(x - scene.xi[after] - e @ prospect.end.M.T - prospect.end.offset[node])[linear]
        assert (wrong < 1e-3 * np.abs(prospect.end.G).sum(axis=1)).all()
        compared += len(wrong)
    assert compared > 100
    # What the later cell's value at a border would have given.
    leg = ErrorMotion.declared(monitor.recovery, 1)
    assert np.abs(leg.zeta[1:, 0] - leg.zeta[:-1, 1]).max() > 0.1


@pytest.mark.parametrize(
    ("made", "jump"), [({"order": 1, "weight": 0.5, "feedback": 0.25}, [0.0]), ({"goal": 3.0}, [0.02, 0.0])]
)
def test_no_margin_of_the_monitor_exceeds_the_share_of_the_whole_room_that_is_left(made, jump):
    """A jump of the reference counts against the whole clearance, and so do later limits."""
    scene = DecisionGrid.from_schedule(line(**made), 0.25)
    clearance, n = replace(scene.clearance, jump=np.array(jump)), len(jump)
    recovery, sets = Recovery(replace(scene, clearance=clearance)), Continuation(clearance)
    rng, tightest, behind = np.random.default_rng(0), np.inf, 0
    for cell in range(clearance.planned):
        node = cell * clearance.q
        for _ in range(20):
            start = Zonotope.box(rng.uniform(-0.1, 0.2, n) / 2 ** np.arange(n), rng.uniform(0.0, 0.01, n))
            size = np.linalg.norm(scene.tracking.W @ start.c) + recovery.size(start.G)
            share = float(recovery.share(node, start.c, size, recovery.demand(start.G)))
            margin = sets.margin_at(cell, start)
            assert 1 - share <= margin.value + 3 * ROUNDING  # which both book, in their own ways
            tightest = min(tightest, margin.value - (1 - share))
            behind += margin.time >= clearance.planned * scene.tracking.delta
    assert tightest < 0.05  # and it does not throw away much
    assert behind > 5 or not any(jump)


def test_limits_beyond_the_settling_horizon_leave_room_for_the_path_of_u():
    scene = DecisionGrid.from_schedule(line(order=1, weight=0.5, feedback=0.25), 0.25)
    recovery, tracking, node = Recovery(scene), scene.tracking, scene.last - 1
    o = len(recovery.intersample)
    assert 0 < tracking.settling < scene.last and recovery.far(0) > 0
    tightening = tracking.disturbance(recovery.rows)[-1][:o] + recovery.intersample
    tight = Recovery(replace(scene, clearance=replace(scene.clearance)))
    tight.grid.clearance.limits.available[0, node, :o] = tightening * 0.999
    assert tight.far(0) < 0 < tight.sets.radius(0)  # S alone would get by, not U there


@pytest.mark.parametrize("key", PROVED)
def test_a_start_that_is_not_recoverable_is_refused_and_no_number_flown_by_s(key):
    scene = DecisionGrid.from_schedule(line(), 0.25)
    method = METHODS[key](scene)
    assert method.claim.kind == "proved"
    for runs, wrong in ((1, np.nan), (2, np.inf), (2, -np.inf)):
        method.start(runs)
        observed = Observation(0, np.full((runs, 2), wrong), np.zeros((runs, 1)), np.zeros(runs, dtype=int))
        with np.errstate(invalid="ignore"):
            assert (method.decide(observed).mode == 0).all()
    safety = scene.schedule.safety
    wide = replace(safety, start=Zonotope(safety.start.c, 20 * safety.start.G))
    with pytest.raises(NotCertified, match="first recoverable set"):
        METHODS[key](DecisionGrid.from_schedule(replace(scene.schedule, safety=wide), 0.25))
