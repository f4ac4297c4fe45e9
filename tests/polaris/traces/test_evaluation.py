"""Metrics of traces against cases computed by hand."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from polaris.model.errors import ScenarioError
from polaris.model.hill import clohessy_wiltshire, free_flight
from polaris.model.scene.shapes import PolytopeShape
from polaris.traces import (
    AgentTrace,
    BallTrace,
    Heading,
    PointTrace,
    PolytopeTrace,
    RectangleTrace,
    Trace,
    evaluate_trace,
    parse_trace,
    restamp,
)
from polaris.traces.evaluation import weights
from polaris.traces.placement import MovingPolytope
from polaris.traces.settings import between, interpolate, rates
from tests.polaris.traces.traces import agent, entry, moving, trace

INF = float("inf")
CUBE = [[[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], [1, 1, 1, 1, 1, 1]]
SYSTEM = clohessy_wiltshire(0.0012, 1.0, 1.0)


def against(metrics, name="s", of="a"):
    return next(item for item in metrics.agents[of].unsafe if item.name == name)


def measured(flown, **sets):
    return evaluate_trace(Trace(flown.agents, sets))


def still(kind, *parts):
    """A set at rest, one row."""
    return kind(np.zeros(1), *(np.array([part], dtype=float) for part in parts))


# -- distance and straight time to collision ----------------------------------------------------------


@pytest.mark.parametrize(
    "item",
    [
        still(BallTrace, [0, 0, 0], 1),
        still(RectangleTrace, [0, 0, 0], [2, 2, 2]),
        PolytopeTrace(np.zeros(1), np.array([CUBE[0]]), np.array([CUBE[1]])),
        PolytopeTrace(np.zeros(1), 3.0 * np.array([CUBE[0]]), 3.0 * np.array([CUBE[1]])),
    ],
)
def test_head_on_at_every_kind_of_set(item):
    """From 11 m at 2 m/s: 10, 8, 6 m away, and 5, 4, 3 s."""
    metrics = against(measured(moving([11, 0, 0], [-2, 0, 0]), s=item))
    assert (metrics.distance.min, metrics.distance.mean, metrics.distance.max) == (6, 8, 10)
    assert (metrics.ttc.min, metrics.ttc.mean, metrics.ttc.max) == (3, 4, 5)
    assert (metrics.distance.at, metrics.ttc.at, metrics.ttc.share) == (2, 2, 1)


def test_point():
    """From (4, 3) along -x: 5 m away, and never met; from (4, 0): met after 2 s at 2 m/s."""
    metrics = against(measured(moving([4, 3], [-2, 0], [0.0]), s=still(PointTrace, [0, 0])))
    assert (metrics.distance.min, metrics.ttc.min) == (5, INF)
    metrics = against(measured(moving([4, 0], [-2, 0], [0.0]), s=still(PointTrace, [0, 0])))
    assert (metrics.distance.min, metrics.ttc.min) == (4, 2)


@pytest.mark.parametrize(
    "item, depth",
    [
        (still(BallTrace, [0, 0, 0], 2), -1.5),
        (still(RectangleTrace, [0, 0, 0], [4, 4, 4]), -1.5),
        (PolytopeTrace(np.zeros(1), np.array([CUBE[0]]), 2.0 * np.array([CUBE[1]])), -1.5),
    ],
)
def test_penetration_is_negative_and_no_time_away(item, depth):
    metrics = against(measured(moving([0.5, 0, 0], [1, 0, 0], [0.0]), s=item))
    assert metrics.distance.min == pytest.approx(depth, abs=1e-12)
    assert metrics.ttc.min == metrics.ttc.max == 0


def test_tangency_counts_and_a_miss_does_not():
    ball = still(BallTrace, [0, 0, 0], 1)
    touches = against(measured(moving([5, 1, 0], [-1, 0, 0], [0.0]), s=ball))
    misses = against(measured(moving([5, 1.001, 0], [-1, 0, 0], [0.0]), s=ball))
    assert touches.ttc.min == pytest.approx(5)
    assert misses.ttc.min == INF


@pytest.mark.parametrize("v", [[1, 0, 0], [0, 0, 0], [0, 3, 0]], ids=["away", "zero speed", "past"])
def test_no_collision_is_inf(v):
    metrics = against(measured(moving([5, 0, 0], v, [0.0, 1.0]), s=still(BallTrace, [0, 0, 0], 1)))
    assert metrics.ttc.min == metrics.ttc.mean == metrics.ttc.max == INF
    assert metrics.ttc.share == 0 and np.isnan(metrics.ttc.at)


def test_corner_of_a_box_is_euclidean():
    metrics = against(
        measured(moving([4, 5, 0], [0, 0, 0], [0.0]), s=still(RectangleTrace, [0, 0, 0], [2, 2, 2]))
    )
    assert metrics.distance.min == 5


def test_true_relative_velocity():
    """A ball that follows at 1 m/s an agent that flees at 0.5 m/s: 9 m, 18 s."""
    t = np.arange(3.0)
    ball = BallTrace(t, t[:, None] * [1.0, 0, 0], np.ones(3))
    metrics = against(measured(moving([10, 0, 0], [0.5, 0, 0]), s=ball))
    assert metrics.ttc.max == pytest.approx(18) and metrics.ttc.min == pytest.approx(16)
    polytope = PolytopeTrace(t, np.array([CUBE[0]]), np.array(CUBE[1]) + t[:, None] * np.array(CUBE[0])[:, 0])
    same = against(measured(moving([10, 0, 0], [0.5, 0, 0]), s=polytope))
    assert (same.ttc.min, same.ttc.max) == (pytest.approx(16), pytest.approx(18))
    assert (same.distance.min, same.distance.max) == (pytest.approx(8), pytest.approx(9))


def test_known_velocities_of_a_ball_are_used_instead_of_differences():
    """A ball on a circle, stamped every 10 s: differences of its centres are too short."""
    t, n, v = np.arange(0.0, 601.0, 10.0), 2 * np.pi / 600, 0.5
    centers = np.stack([np.sin(n * t), -np.cos(n * t), 0 * t], axis=1) * v / n
    rates = np.stack([np.cos(n * t), np.sin(n * t), 0 * t], axis=1) * v
    a = Trace({"a": AgentTrace(t, np.hstack([centers + [200.0, 0.0, 0.0], rates - [2.0, 0.0, 0.0]]))})

    def ttc(*velocities):
        ball = BallTrace(t, centers, np.ones(len(t)), *velocities)
        metrics = evaluate_trace(Trace(a.agents, {"s": ball}), velocity=(3, 4, 5))
        return metrics.agents["a"].unsafe[0].ttc

    known = ttc(rates)
    assert known.min == pytest.approx(199 / 2, rel=1e-9)
    assert known.max == pytest.approx(199 / 2, rel=1e-9)
    assert ttc().min < 199 / 2 - 0.01


def test_mean_is_over_time():
    """1 m away for 9 s, 3 m at the end of the tenth: the trapezoid, not a third of 1 + 1 + 3."""
    t = np.array([0.0, 9.0, 10.0])
    states = np.array([[2.0, 0, 0], [2, 0, 0], [4, 0, 0]])
    metrics = against(measured(Trace({"a": AgentTrace(t, states)}), s=still(BallTrace, [0, 0, 0], 1)))
    assert metrics.distance.mean == pytest.approx((9 * 1 + 1 * 2) / 10)


# -- motion between stamps ------------------------------------------------------------------------------


def test_sets_move_linearly_between_their_stamps():
    """Stamps 0 and 4 s; the agent is sampled every second, at rest 10 m away."""
    a = moving([10, 0, 0], [0, 0, 0], range(7))
    ball = BallTrace(np.array([0.0, 4.0]), np.array([[0.0, 0, 0], [4, 0, 0]]), np.array([1.0, 3.0]))
    metrics = against(measured(a, s=ball))
    # 9, 7.5, 6, 4.5, 3 m, and at rest after that
    assert (metrics.distance.max, metrics.distance.min, metrics.distance.at) == (9, 3, 4)
    assert metrics.distance.mean == pytest.approx((9 / 2 + 7.5 + 6 + 4.5 + 3 + 3 + 3 / 2) / 6)
    # sizes are those of the instant: 9 m at 1 m/s; and no motion after the last stamp
    assert (metrics.ttc.min, metrics.ttc.max) == (3, INF)


def test_growing_box_and_growing_polytope_are_the_same():
    a, t = moving([6, 5, 0], [-1, -1, 0], np.arange(0, 3, 0.25)), np.array([0.0, 2.0, 3.0])
    lengths = np.array([[2.0, 2, 2], [4, 6, 2], [4, 2, 2]])
    box = RectangleTrace(t, np.zeros((3, 3)), lengths)
    polytope = PolytopeTrace(t, np.array([CUBE[0]]), np.repeat(lengths / 2, 2, axis=1))
    one, other = against(measured(a, s=box)), against(measured(a, s=polytope))
    for quantity in ("distance", "ttc"):
        for part in ("min", "mean", "max"):
            assert getattr(getattr(one, quantity), part) == pytest.approx(
                getattr(getattr(other, quantity), part)
            )
    assert one.distance.max == pytest.approx(np.hypot(5, 4))


def test_polytope_that_turns_is_what_it_is_at_both_stamps():
    """A bar of 10 m x 2 m along x, at 2 s along y: in between as if along both."""
    H = np.array([[1.0, 0], [-1, 0], [0, 1], [0, -1]])
    turned = np.array([[0.0, 1], [0, -1], [-1, 0], [1, 0]])
    b = np.array([5.0, 5, 1, 1])
    bar = PolytopeTrace(np.array([0.0, 2.0]), np.array([H, turned]), np.array([b, b]))

    def at(p, t):
        states = np.array([p], dtype=float)
        metrics = measured(Trace({"a": AgentTrace(np.array([t]), states)}), s=bar)
        return against(metrics).distance.min

    assert (at([8, 0], 0.0), at([8, 0], 2.0)) == (pytest.approx(3), pytest.approx(7))
    assert at([8, 0], 1.0) == pytest.approx(3) and at([0, 8], 1.0) == pytest.approx(3)


def test_turning_polytope_that_moves_has_the_velocity_of_its_centre():
    """A square that turns by 90 degrees and moves at 1 m/s towards an agent 9 m away."""
    t, rows = np.arange(3.0), np.array([[1.0, 0], [-1, 0], [0, 1], [0, -1]])
    A = np.array([np.roll(rows, k, axis=0) @ np.eye(2) for k in (0, 0, 0)])
    A[1] = A[1] @ np.array([[0.0, 1], [-1, 0]])
    A[2] = A[2] @ np.array([[-1.0, 0], [0, -1]])
    b = 1.0 + np.einsum("kfd,kd->kf", A, t[:, None] * [1.0, 0])
    still_there = Trace({"a": AgentTrace(t, np.broadcast_to([10.0, 0], (3, 2)))})
    metrics = against(measured(still_there, s=PolytopeTrace(t, A, b)))
    assert (metrics.distance.max, metrics.distance.min) == (pytest.approx(9), pytest.approx(7))
    assert (metrics.ttc.max, metrics.ttc.min) == (pytest.approx(9), pytest.approx(7))


def test_sets_with_the_agents_stamps_are_paired_row_by_row():
    """Two rows at t = 0: the first of one belongs to the first of the other."""
    t = np.array([0.0, 0.0, 1.0])
    a = AgentTrace(t, np.array([[5.0, 0], [6, 0], [7, 0]]))
    ball = BallTrace(t, np.array([[0.0, 0], [1, 0], [2, 0]]), np.ones(3))
    metrics = against(evaluate_trace(Trace({"a": a}, {"s": ball})))
    assert (metrics.distance.min, metrics.distance.max) == (4, 4)


def test_interpolation_and_rates():
    stamps = np.array([0.0, 1.0, 1.0, 3.0])
    rows = between(stamps, np.array([-1.0, 0.5, 1.0, 2.0, 9.0]))
    assert interpolate(np.array([0.0, 1, 5, 7]), rows).tolist() == [0, 0.5, 5, 6, 7]
    assert rates(stamps, np.array([[0.0], [9], [1], [5]]))[:, 0].tolist() == [
        1,
        pytest.approx(4 / 3),
        pytest.approx(4 / 3),
        2,
    ]
    assert rates(np.zeros(3), np.zeros((3, 2))) is None
    assert weights(np.array([0.0, 1, 3])).tolist() == [1 / 6, 0.5, 1 / 3]
    assert weights(np.zeros(2)).tolist() == [0.5, 0.5]


# -- agents -----------------------------------------------------------------------------------------------


def pair(p, v, q, w, times=(0.0,), radius=0.0):
    one, other = moving(p, v, times).agents["a"], moving(q, w, times).agents["a"]
    metrics = evaluate_trace(Trace({"a": one, "b": other}), agent_radius=radius)
    return metrics.agents["a"].others[0], metrics.agents["b"].others[0]


def test_agents_head_on():
    """10 m apart, both at 1 m/s: 5 s; 12 m apart at 2 and 1 m/s: 4 s."""
    for one in pair([0, 0], [1, 0], [10, 0], [-1, 0]):
        assert (one.distance.min, one.ttc.min) == (10, 5)
    for one in pair([0, 0, 0], [0, 0, 2], [0, 0, 12], [0, 0, -1]):
        assert (one.distance.min, one.ttc.min) == (12, 4)


def test_agents_apart_in_three_axes():
    one, _ = pair([0, 0, 0], [0, 0, 0], [2, 3, 6], [0, 0, 0])
    assert (one.distance.min, one.ttc.min) == (7, INF)


def test_agents_of_some_size_meet_before_their_centres_do():
    one, _ = pair([0, 0], [1, 0], [10, 1], [-1, 0], radius=0.0)
    assert one.ttc.min == INF
    one, _ = pair([0, 0], [1, 0], [10, 0], [-1, 0], radius=2.0)
    assert one.ttc.min == 4


def test_agents_are_compared_while_both_are_there():
    one = AgentTrace(np.arange(5.0), np.zeros((5, 2)))
    other = AgentTrace(np.array([3.0, 7.0]), np.array([[4.0, 0], [8, 0]]))
    late = AgentTrace(np.array([8.0]), np.zeros((1, 2)))
    others = evaluate_trace(Trace({"a": one, "b": other, "c": late}), dims=2).agents["a"].others
    assert (others[0].distance.min, others[0].distance.max) == (4, 5)
    assert others[1].distance is None and others[1].ttc is None


# -- velocities -------------------------------------------------------------------------------------------


def test_velocity_by_differences_says_so():
    t = np.arange(3.0)
    a = AgentTrace(t, np.array([10.0, 8.0, 6.0])[:, None] * [1.0, 0, 0])
    metrics = measured(Trace({"a": a}), s=still(BallTrace, [0, 0, 0], 1))
    assert metrics.agents["a"].velocity == "differences of positions"
    assert (against(metrics).ttc.max, against(metrics).ttc.min) == (4.5, 2.5)


def test_velocity_entries_can_be_named():
    rows = np.array([[5.0, -1.0, 0.0, 0.0, -2.0], [4.0, -1, 0, 0, -2]])
    a = {"a": AgentTrace(np.array([0.0, 1.0]), rows)}
    sets = {"s": still(BallTrace, [0, -1], 1)}
    by_default = evaluate_trace(Trace(a, sets))
    assert against(by_default).ttc.max == 4
    named = evaluate_trace(Trace(a, sets), velocity=[4, 2])
    assert against(named).ttc.max == 2 and named.agents["a"].velocity == "states 4, 2"
    for wrong in ([1], [1, 5], [1, -1], "guess"):
        with pytest.raises(ScenarioError, match="--velocity"):
            evaluate_trace(Trace(a, sets), velocity=wrong)


def test_entries_that_are_no_velocity_are_not_taken_for_one():
    """(x, y, heading, speed) is not (position, velocity): the motion tells, and differences serve."""
    t = np.arange(5.0)
    states = np.column_stack([t * 0, 3 * t, np.full(5, np.pi / 2), np.full(5, 3.0)])
    flown = Trace({"a": AgentTrace(t, states)})
    metrics = measured(flown, s=still(BallTrace, [0, 50], 1))
    assert metrics.agents["a"].velocity.startswith("differences of positions (states 2, 3 do not change")
    assert against(metrics).ttc.min == pytest.approx(37 / 3)
    fine = measured(moving([0, 0], [0, 3]), s=still(BallTrace, [0, 50], 1))
    assert fine.notes == () and fine.agents["a"].velocity == "states 2, 3"
    sets = {"s": still(BallTrace, [0, 50], 1)}
    named = evaluate_trace(replace(flown, unsafe=sets), velocity=[2, 3])  # insisted on: done, and said
    assert any("does not change as a velocity of states 2, 3" in note for note in named.notes)
    headed = evaluate_trace(replace(flown, unsafe=sets), velocity=Heading(3, (2,)))
    assert headed.notes == () and against(headed).ttc.min == pytest.approx(37 / 3)
    for wrong in (Heading(3), Heading(4, (2,)), Heading(3, (-1,)), Heading(3, (2, 2))):
        with pytest.raises(ScenarioError, match="--heading"):
            evaluate_trace(replace(flown, unsafe=sets), velocity=wrong)


@pytest.mark.parametrize("d", [1, 2, 3])
def test_headings_at_random(d):
    """Random smooth flights told as angles and speed, and as vectors, have the same times to collision."""
    random = np.random.default_rng(d)
    t = np.linspace(0, 3, 61)
    for _ in range(20):
        v = np.cumsum(random.normal(size=(61, d)), axis=0) * 0.1 + random.normal(size=d)
        p = (
            random.normal(size=d) * 5
            + np.vstack([np.zeros(d), np.cumsum((v[1:] + v[:-1]) / 2, axis=0)]) * 0.05
        )
        speed = v[:, 0] if d == 1 else np.linalg.norm(v, axis=1)
        angles = [] if d == 1 else [np.arctan2(v[:, 1], v[:, 0])]
        angles += [np.arcsin(v[:, 2] / speed)] if d == 3 else []
        sets = {"s": still(BallTrace, np.zeros(d).tolist(), 1)}
        angular = Trace({"a": AgentTrace(t, np.column_stack([p, *angles, speed]))}, sets)
        vector = Trace({"a": AgentTrace(t, np.column_stack([p, v]))}, sets)
        one = against(evaluate_trace(angular, velocity=Heading(2 * d - 1, tuple(range(d, 2 * d - 1))))).ttc
        other = against(evaluate_trace(vector, velocity=list(range(d, 2 * d)))).ttc
        assert (one.min, one.share) == pytest.approx((other.min, other.share))


def test_one_sample_without_velocity():
    a = {"a": AgentTrace(np.zeros(1), np.array([[5.0, 0, 0]]), np.array([2]))}
    metrics = evaluate_trace(Trace(a, {"s": still(BallTrace, [0, 0, 0], 1)}))
    assert against(metrics).distance.min == 4 and against(metrics).ttc is None
    assert metrics.agents["a"].velocity.startswith("unknown")
    assert metrics.agents["a"].usage["untrusted"] == 1 and metrics.agents["a"].switches == 0


# -- free drift -------------------------------------------------------------------------------------------


def test_free_drift_is_that_of_hill():
    """A ball on the closed-form path of an unforced state, reached after 600 s."""
    x = np.array([0.0, 400.0, 0.0, 0.24, 0.0, 0.0])
    ahead = (free_flight(0.0012, 600.0) @ x)[:3]
    a = Trace({"a": AgentTrace(np.zeros(1), x[None])}, {"s": still(BallTrace, ahead, 1)})
    metrics = against(evaluate_trace(a, system=SYSTEM))
    speed = np.linalg.norm((free_flight(0.0012, 600.0) @ x)[3:])
    assert metrics.drift_ttc.min == pytest.approx(600 - 1 / speed, abs=0.05)
    assert metrics.ttc.min == INF
    behind = evaluate_trace(Trace(a.agents, {"s": still(BallTrace, [-500, 0, 0], 1)}), system=SYSTEM)
    assert against(behind).drift_ttc.min == INF


def test_free_drift_of_sets_that_change():
    """A ball that grows, and a cube that does, are met at the size of the instant."""
    t = np.array([0.0, 10.0])
    x = np.array([[20.0, 0, 0, -1.0, 0, 0]] * 2)
    ball = BallTrace(t, np.zeros((2, 3)), np.array([2.0, 5.0]))
    cube = PolytopeTrace(t, np.array([CUBE[0]]), np.array([[2.0] * 6, [5.0] * 6]))
    metrics = evaluate_trace(Trace({"a": AgentTrace(t, x)}, {"s": ball, "c": cube}), system=SYSTEM)
    for name in ("s", "c"):
        one = against(metrics, name)
        assert one.drift_ttc.max == pytest.approx(18, abs=0.1)
        assert one.drift_ttc.min == pytest.approx(15, abs=0.1)
    assert any("5235.99 s ahead" in note for note in metrics.notes)


def test_free_drift_needs_the_systems_states():
    with pytest.raises(ScenarioError, match=r"agents\.a\.state_trace\[0\]"):
        evaluate_trace(moving([1, 0], [0, 0]), system=SYSTEM)
    with pytest.raises(ScenarioError, match="--dims"):
        evaluate_trace(moving([1, 0, 0], [0, 0, 0]), dims=2, system=SYSTEM)


# -- usage and switches -----------------------------------------------------------------------------------


def usage(times, modes):
    a = AgentTrace(np.array(times, dtype=float), np.zeros((len(times), 1)), np.array(modes))
    metrics = evaluate_trace(Trace({"a": a})).agents["a"]
    return {name: share for name, share in metrics.usage.items() if share}, metrics.switches


def test_usage_is_by_time_and_switches_are_inside():
    assert usage([0, 9, 10], [2, 3, 3]) == ({"untrusted": 0.9, "safety": 0.1}, 1)
    assert usage([0, 1, 2], [3, 3, 3]) == ({"safety": 1}, 0)
    assert usage([0, 1, 2, 3, 4], [1, 1, 2, 2]) == ({"normal": 0.5, "untrusted": 0.5}, 1)
    assert usage([0, 1, 2, 3], [2, -1, 2]) == (
        {"untrusted": pytest.approx(2 / 3), "unknown": pytest.approx(1 / 3)},
        0,
    )
    assert usage([0, 1, 2, 3], [2, 7, 3]) == (
        {"untrusted": pytest.approx(1 / 3), "unknown": pytest.approx(1 / 3), "safety": pytest.approx(1 / 3)},
        1,
    )
    assert usage([5], [3]) == ({"safety": 1}, 0)


def test_running_times():
    a = AgentTrace(np.arange(2.0), np.zeros((2, 1)), running_times=np.array([0.1, 0.3, 0.2]))
    metrics = evaluate_trace(Trace({"a": a})).agents["a"]
    assert metrics.running_times == (pytest.approx(0.2), 0.3, 0.1)


# -- stamps -----------------------------------------------------------------------------------------------


def stamped():
    """Return the simulator's trace of x = 10 - t for 4 s at dt = 1, S from 2 s on; a set follows."""
    rows = [[0, 10.0, 0], [0, 9.0, 0], [1, 8.0, 0], [2, 7.0, 0], [3, 6.0, 0]]
    data = trace(
        {"a": agent(rows, [1, 2, 2, 3, 3])},
        s=entry("ball", *([row[0], [[row[1] - 5, 0], 1]] for row in rows)),
    )
    return parse_trace(data)


def test_restamping_gives_every_state_its_own_time():
    restamped = restamp(stamped())
    assert restamped.agents["a"].times.tolist() == [0, 1, 2, 3, 4]
    assert restamped.agents["a"].modes.tolist() == [2, 2, 3, 3]
    assert restamped.unsafe["s"].times.tolist() == [0, 1, 2, 3, 4]
    measured = evaluate_trace(stamped(), restamp=True, dims=2)
    one = measured.agents["a"]
    assert (one.duration, one.usage["untrusted"], one.usage["safety"], one.switches) == (4, 0.5, 0.5, 1)
    assert one.usage["normal"] == 0 and measured.notes == ()
    assert (against(measured).distance.min, against(measured).distance.max) == (4, 4)


def test_stamps_of_the_simulator_are_pointed_out():
    metrics = evaluate_trace(stamped(), dims=2)
    assert any("--restamp" in note for note in metrics.notes)
    assert metrics.agents["a"].duration == 3


def test_restamping_what_needs_none_is_refused():
    for times in ([0.0, 1, 2], [0.0, 0.0], [0.0, 0, 1, 1]):
        a = AgentTrace(np.array(times), np.zeros((len(times), 1)))
        with pytest.raises(ScenarioError, match=r"agents\.a\.state_trace"):
            restamp(Trace({"a": a}))


def test_sets_with_stamps_of_their_own_keep_them():
    flown = stamped()
    other = BallTrace(np.array([0.0, 4.0]), np.zeros((2, 2)), np.ones(2))
    assert restamp(Trace(flown.agents, {"s": other})).unsafe["s"].times.tolist() == [0, 4]


# -- axes -------------------------------------------------------------------------------------------------


def test_axes_are_told_from_the_sets():
    states = np.array([[3.0, 4.0, 12.0, 9.0, 9.0]])
    a = {"a": AgentTrace(np.zeros(1), states)}
    for d, distance in ((1, 3), (2, 5), (3, 13)):
        metrics = evaluate_trace(Trace(a, {"s": still(PointTrace, [0] * d)}))
        assert (metrics.dims, against(metrics).distance.min) == (d, distance)


def test_fewer_axes_take_the_first_of_a_set():
    a = {"a": AgentTrace(np.zeros(1), np.array([[3.0, 4.0, 12.0]]))}
    sets = {"s": still(RectangleTrace, [0, 0, 0], [2, 2, 2]), "p": still(BallTrace, [0, 0, 5], 1)}
    metrics = evaluate_trace(Trace(a, sets), dims=2)
    assert against(metrics).distance.min == pytest.approx(np.hypot(2, 3))
    assert against(metrics, "p").distance.min == 4
    with pytest.raises(ScenarioError, match=r"unsafe\.c"):
        evaluate_trace(
            Trace(
                a,
                {"c": PolytopeTrace(np.zeros(1), np.array([CUBE[0]]), np.array([CUBE[1]]), where="unsafe.c")},
            ),
            dims=2,
        )


def test_axes_that_cannot_be_told():
    two = AgentTrace(np.zeros(1), np.zeros((1, 3)))
    with pytest.raises(ScenarioError, match="--dims"):
        evaluate_trace(Trace({"a": two, "b": two}))
    with pytest.raises(ScenarioError, match="--dims"):
        evaluate_trace(Trace({"a": two}, {"s": still(PointTrace, [0, 0]), "r": still(PointTrace, [0])}))
    with pytest.raises(ScenarioError, match=r"agents\.a"):
        evaluate_trace(
            Trace({"a": AgentTrace(np.zeros(1), np.zeros((1, 1)))}, {"s": still(PointTrace, [0, 0])})
        )
    for wrong in (0, 4):
        with pytest.raises(ScenarioError, match="--dims"):
            evaluate_trace(Trace({"a": two}), dims=wrong)


def test_nothing_to_be_far_from():
    """No sets and no other agent: usage alone."""
    metrics = evaluate_trace(parse_trace(trace({"a": agent([[0, 1.0], [1, 2.0]])})))
    assert metrics.dims is None and metrics.agents["a"].unsafe == metrics.agents["a"].others == ()
    assert metrics.agents["a"].usage["untrusted"] == 1


def test_empty_polytopes_are_refused_by_row():
    A = np.array([[[1.0], [-1.0]]])
    a = {"a": AgentTrace(np.arange(2.0), np.zeros((2, 1)))}
    for b, row in (([[-1.0, -1], [1, 1]], 0), ([[1.0, 1], [-1, -1]], 1)):
        with pytest.raises(ScenarioError, match=rf"state_trace\[{row}\]"):
            evaluate_trace(Trace(a, {"s": PolytopeTrace(np.arange(2.0), A, np.array(b))}))


# -- facets that differ from sample to sample ----------------------------------------------------------------


@st.composite
def polytopes(draw):
    """A few polytopes about points near the origin, with positions."""
    d, seed = draw(st.integers(1, 3)), draw(st.integers(0, 10**6))
    rng = np.random.default_rng(seed)
    F, N = draw(st.integers(1, 7)), 4
    H = rng.normal(size=(N, F, d))
    H /= np.linalg.norm(H, axis=-1, keepdims=True)
    return H, rng.uniform(0.1, 2, (N, F)), rng.normal(size=(N, d)) * 3, rng.normal(size=(N, d))


@settings(max_examples=20)
@given(polytopes())
def test_facets_agree_with_fixed_polytopes(case):
    H, b, p, v = case
    distance, entry_time = MovingPolytope(H, b).signed_distance(p), MovingPolytope(H, b).entry_time(p, v)
    for i in range(len(p)):
        one = PolytopeShape(H[i], b[i])
        assert distance[i] == pytest.approx(float(one.signed_distance(p[i])), abs=1e-7)
        assert entry_time[i] == pytest.approx(float(one.entry_time(p[i], v[i])), rel=1e-6, abs=1e-9)
        both = MovingPolytope(H[i : i + 1], np.repeat(b[i : i + 1], 2, axis=0))
        shared = both.signed_distance(np.repeat(p[i : i + 1], 2, axis=0))
        assert shared == pytest.approx([distance[i]] * 2, abs=1e-9)
    H, b, p, v = (np.concatenate([part] * 300) for part in case)  # more samples than are held at once
    assert np.array_equal(MovingPolytope(H, b).entry_time(p, v), np.tile(entry_time, 300))


def test_facet_distance_against_a_solver():
    H = np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1], [-1, -1, -1] / np.sqrt(3)])
    b, p = np.array([1.0, 1, 1, 1]), np.array([3.0, 2.5, -4.0])
    nearest = minimize(
        lambda q: np.sum((q - p) ** 2), np.zeros(3), constraints={"type": "ineq", "fun": lambda q: b - H @ q}
    )
    assert MovingPolytope(H[None], b[None]).signed_distance(p[None])[0] == pytest.approx(
        np.sqrt(nearest.fun), rel=1e-5
    )
