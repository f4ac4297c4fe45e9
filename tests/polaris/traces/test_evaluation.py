"""Metrics of traces against cases computed by hand."""

import numpy as np
import pytest

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
from polaris.traces.placement import MovingPolytope
from tests.polaris.traces.traces import agent, entry, moving, trace

INF = float("inf")
CUBE = [[[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], [1, 1, 1, 1, 1, 1]]
SYSTEM = clohessy_wiltshire(0.0012, 1.0, 1.0)


def against(metrics, name="s", of="a"):
    return next(item for item in metrics.agents[of].unsafe if item.name == name)


def measured(trace, **sets):
    return evaluate_trace(Trace(trace.agents, sets))


def still(kind, *parts):
    """A set at rest, one row."""
    return kind(np.zeros(1), *(np.array([part], dtype=float) for part in parts))


SETS = [
    still(BallTrace, [0, 0, 0], 1),
    still(RectangleTrace, [0, 0, 0], [2, 2, 2]),
    PolytopeTrace(np.zeros(1), 3.0 * np.array([CUBE[0]]), 3.0 * np.array([CUBE[1]])),
]


@pytest.mark.parametrize("item", SETS)
@pytest.mark.parametrize(
    "p, v, distances, times",
    [
        ([11, 0, 0], [-2, 0, 0], (6, 8, 10), (3, 4, 5)),
        ([0.5, 0, 0], [0.1, 0, 0], (-0.5, -0.4, -0.3), (0, 0, 0)),  # inside
        ([5, 0, 0], [1, 0, 0], (4, 5, 6), (INF, INF, INF)),
        ([5, 0, 0], [0, 0, 0], (4, 4, 4), (INF, INF, INF)),
        ([5, 1.001, 0], [-1, 0, 0], None, (INF, INF, INF)),
    ],
)
def test_distances_and_straight_times_at_every_kind_of_set(item, p, v, distances, times):
    metrics = against(measured(moving(p, v), s=item))
    if distances is not None:
        actual = (metrics.distance.min, metrics.distance.mean, metrics.distance.max)
        assert actual == pytest.approx(distances, abs=1e-12)
    assert (metrics.ttc.min, metrics.ttc.mean, metrics.ttc.max) == pytest.approx(times, abs=1e-12)
    assert metrics.ttc.share == (times[0] < INF) and np.isnan(metrics.ttc.at) == (times[0] == INF)


def test_a_point_is_met_head_on_alone_and_means_are_over_time():
    for p, distance, time in (([4, 3], 5, INF), ([4, 0], 4, 2)):
        metrics = against(measured(moving(p, [-2, 0], [0.0]), s=still(PointTrace, [0, 0])))
        assert (metrics.distance.min, metrics.ttc.min) == (distance, time)
    states = np.array([[2.0, 0, 0], [2, 0, 0], [4, 0, 0]])
    trace = Trace({"a": AgentTrace(np.array([0.0, 9.0, 10.0]), states)})
    metrics = measured(trace, s=SETS[0])
    assert against(metrics).distance.mean == pytest.approx((9 * 1 + 1 * 2) / 10)
    assert metrics.agents["a"].velocity == "differences of positions"
    states = np.array([[11.0, 0, 0, 0, 0, 0], [11.0, 0, 0, -2, 0, 0], [9.0, 0, 0, -2, 0, 0]])
    trace = Trace({"a": AgentTrace(np.array([0.0, 9.0, 10.0]), states)}, {"s": SETS[0]})
    assert against(evaluate_trace(trace, velocity=(3, 4, 5))).ttc.share == pytest.approx(0.55)


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

    with_rates = ttc(rates)
    assert (with_rates.min, with_rates.max) == pytest.approx((199 / 2, 199 / 2), rel=1e-9)
    assert ttc().min < 199 / 2 - 0.01


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


def test_polytope_that_turns_is_what_it_is_at_both_stamps():
    """A bar of 10 m x 2 m along x, at 2 s along y: in between as if along both."""
    H = np.array([[1.0, 0], [-1, 0], [0, 1], [0, -1]])
    rotated = np.array([[0.0, 1], [0, -1], [-1, 0], [1, 0]])
    b = np.array([5.0, 5, 1, 1])
    bar = PolytopeTrace(np.array([0.0, 2.0]), np.array([H, rotated]), np.array([b, b]))

    def at(p, t):
        states = np.array([p], dtype=float)
        metrics = measured(Trace({"a": AgentTrace(np.array([t]), states)}), s=bar)
        return against(metrics).distance.min

    assert (at([8, 0], 0.0), at([8, 0], 2.0)) == (pytest.approx(3), pytest.approx(7))
    assert at([8, 0], 1.0) == pytest.approx(3) and at([0, 8], 1.0) == pytest.approx(3)


def test_sets_with_the_agents_stamps_are_paired_row_by_row():
    """Two rows at t = 0: the first of one belongs to the first of the other."""
    t = np.array([0.0, 0.0, 1.0])
    a = AgentTrace(t, np.array([[5.0, 0], [6, 0], [7, 0]]))
    ball = BallTrace(t, np.array([[0.0, 0], [1, 0], [2, 0]]), np.ones(3))
    metrics = against(evaluate_trace(Trace({"a": a}, {"s": ball})))
    assert (metrics.distance.min, metrics.distance.max) == (4, 4)


@pytest.mark.parametrize(
    "p, v, q, w, radius, distance, time",
    [
        ([0, 0], [1, 0], [10, 0], [-1, 0], 0.0, 10, 5),
        ([0, 0], [1, 0], [10, 0], [-1, 0], 2.0, 10, 4),
        ([0, 0], [1, 0], [10, 1], [-1, 0], 0.0, np.sqrt(101), INF),
        ([0, 0, 0], [0, 0, 2], [0, 0, 12], [0, 0, -1], 0.0, 12, 4),
        ([0, 0, 0], [0, 0, 0], [2, 3, 6], [0, 0, 0], 0.0, 7, INF),
    ],
)
def test_agents_meet_agents(p, v, q, w, radius, distance, time):
    one, other = moving(p, v, (0.0,)).agents["a"], moving(q, w, (0.0,)).agents["a"]
    metrics = evaluate_trace(Trace({"a": one, "b": other}), agent_radius=radius).agents
    for each in (metrics["a"].others[0], metrics["b"].others[0]):
        assert (each.distance.min, each.ttc.min) == (pytest.approx(distance), time)


def test_velocity_entries_can_be_named():
    rows = np.array([[5.0, -1.0, 0.0, 0.0, -2.0], [4.0, -1, 0, 0, -2]])
    a = {"a": AgentTrace(np.array([0.0, 1.0]), rows)}
    sets = {"s": still(BallTrace, [0, -1], 1)}
    by_default = evaluate_trace(Trace(a, sets))
    assert against(by_default).ttc.max == 4
    chosen = evaluate_trace(Trace(a, sets), velocity=[4, 2])
    assert against(chosen).ttc.max == 2 and chosen.agents["a"].velocity == "states 4, 2"
    for wrong in ([1], [1, 5], [1, -1], "guess"):
        with pytest.raises(ScenarioError, match="--velocity"):
            evaluate_trace(Trace(a, sets), velocity=wrong)
    for wrong in (Heading(3), Heading(5, (2,)), Heading(3, (-1,)), Heading(3, (2, 2))):
        with pytest.raises(ScenarioError, match="--heading"):
            evaluate_trace(Trace(a, sets), velocity=wrong)
    with pytest.raises(ScenarioError, match=r"agents\.a\.state_trace\[0\]"):
        evaluate_trace(Trace(a, sets), system=SYSTEM)
    with pytest.raises(ScenarioError, match="--dims"):
        evaluate_trace(moving([1, 0, 0], [0, 0, 0]), dims=2, system=SYSTEM)
    # (x, y, heading, speed) is no velocity by itself: the motion tells, and differences serve.
    t = np.arange(5.0)
    trace = Trace({"a": AgentTrace(t, np.column_stack([t * 0, 3 * t, np.full(5, np.pi / 2), t * 0 + 3.0]))})
    headed = measured(trace, s=still(BallTrace, [0, 50], 1))
    assert headed.agents["a"].velocity.startswith("differences of positions (states 2, 3 do not change")
    assert against(headed).ttc.min == pytest.approx(37 / 3)
    chosen = evaluate_trace(Trace(trace.agents, sets), velocity=[2, 3])  # insisted on: done, and said
    assert any("does not change as a velocity of states 2, 3" in note for note in chosen.notes)


@pytest.mark.parametrize("d", [1, 2, 3])
def test_headings_at_random(d):
    """Random smooth flights told as angles and speed, and as vectors, have the same times to collision."""
    random = np.random.default_rng(d)
    t = np.linspace(0, 3, 61)
    for _ in range(20):
        v = np.cumsum(random.normal(size=(61, d)), axis=0) * 0.1 + random.normal(size=d)
        p = (
            np.vstack([np.zeros(d), np.cumsum((v[1:] + v[:-1]) / 2, axis=0)]) * 0.05
            + random.normal(size=d) * 5
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


def test_free_drift_is_that_of_hill():
    """A ball on the closed-form path of an unforced state, reached after 600 s."""
    x = np.array([0.0, 400.0, 0.0, 0.24, 0.0, 0.0])
    target = (free_flight(0.0012, 600.0) @ x)[:3]
    a = Trace({"a": AgentTrace(np.zeros(1), x[None])}, {"s": still(BallTrace, target, 1)})
    metrics = against(evaluate_trace(a, system=SYSTEM))
    speed = np.linalg.norm((free_flight(0.0012, 600.0) @ x)[3:])
    assert metrics.drift_ttc.min == pytest.approx(600 - 1 / speed, abs=0.05)
    assert metrics.ttc.min == INF
    behind = evaluate_trace(Trace(a.agents, {"s": still(BallTrace, [-500, 0, 0], 1)}), system=SYSTEM)
    assert against(behind).drift_ttc.min == INF


THIRD = pytest.approx(1 / 3)


@pytest.mark.parametrize(
    "times, modes, shares, switches",
    [
        ([0, 9, 10], [2, 3, 3], {"untrusted": 0.9, "safety": 0.1}, 1),
        ([0, 1, 2], [3, 3, 3], {"safety": 1}, 0),
        ([0, 1, 2, 3, 4], [1, 1, 2, 2], {"normal": 0.5, "untrusted": 0.5}, 1),
        ([0, 1, 2, 3], [2, -1, 2], {"untrusted": pytest.approx(2 / 3), "unknown": THIRD}, 0),
        ([0, 1, 2, 3], [2, 7, 3], {"untrusted": THIRD, "unknown": THIRD, "safety": THIRD}, 1),
        ([5], [3], {"safety": 1}, 0),
    ],
)
def test_usage_is_by_time_and_switches_are_inside(times, modes, shares, switches):
    a = AgentTrace(np.array(times, dtype=float), np.zeros((len(times), 1)), np.array(modes))
    metrics = evaluate_trace(Trace({"a": a}))
    agent = metrics.agents["a"]
    assert {name: share for name, share in agent.usage.items() if share} == shares
    assert agent.switches == switches and metrics.dims is None  # nothing to be far from
    assert agent.unsafe == agent.others == ()


def stamped():
    """Return the simulator's trace of x = 10 - t for 4 s at dt = 1, S from 2 s on; a set follows."""
    rows = [[0, 10.0, 0], [0, 9.0, 0], [1, 8.0, 0], [2, 7.0, 0], [3, 6.0, 0]]
    data = trace(
        {"a": agent(rows, [1, 2, 2, 3, 3])},
        s=entry("ball", *([row[0], [[row[1] - 5, 0], 1]] for row in rows)),
    )
    return parse_trace(data)


def test_restamping_gives_every_state_its_own_time():
    trace, still_there = stamped(), BallTrace(np.array([0.0, 4.0]), np.zeros((2, 2)), np.ones(2))
    restamped = restamp(Trace(trace.agents, {**trace.unsafe, "own": still_there}))
    assert restamped.agents["a"].times.tolist() == [0, 1, 2, 3, 4]
    assert restamped.agents["a"].modes.tolist() == [2, 2, 3, 3]
    assert [restamped.unsafe[name].times.tolist() for name in ("s", "own")] == [[0, 1, 2, 3, 4], [0, 4]]
    measured = evaluate_trace(trace, restamp=True, dims=2)
    one = measured.agents["a"]
    assert (one.duration, one.usage["untrusted"], one.usage["safety"], one.switches) == (4, 0.5, 0.5, 1)
    assert one.usage["normal"] == 0 and measured.notes == ()
    assert (against(measured).distance.min, against(measured).distance.max) == (4, 4)
    as_stamped = evaluate_trace(trace, dims=2)
    assert any("--restamp" in note for note in as_stamped.notes) and as_stamped.agents["a"].duration == 3


def test_restamping_what_needs_none_is_refused():
    for times in ([0.0, 1, 2], [0.0, 0.0], [0.0, 0, 1, 1]):
        a = AgentTrace(np.array(times), np.zeros((len(times), 1)))
        with pytest.raises(ScenarioError, match=r"agents\.a\.state_trace"):
            restamp(Trace({"a": a}))


def test_axes_are_told_from_the_sets():
    states = np.array([[3.0, 4.0, 12.0, 9.0, 9.0]])
    a = {"a": AgentTrace(np.zeros(1), states)}
    for d, distance in ((1, 3), (2, 5), (3, 13)):
        metrics = evaluate_trace(Trace(a, {"s": still(PointTrace, [0] * d)}))
        assert (metrics.dims, against(metrics).distance.min) == (d, distance)
    sets = {"s": still(RectangleTrace, [0, 0, 0], [2, 2, 2]), "p": still(BallTrace, [0, 0, 5], 1)}
    flat = evaluate_trace(Trace(a, sets), dims=2)  # the first axes of a set
    assert against(flat).distance.min == pytest.approx(np.hypot(2, 3))
    assert against(flat, "p").distance.min == 4


def test_axes_that_cannot_be_told():
    one, sets = AgentTrace(np.zeros(1), np.zeros((1, 3))), {"s": still(PointTrace, [0, 0])}
    cube = PolytopeTrace(np.zeros(1), np.array([CUBE[0]]), np.array([CUBE[1]]), where="unsafe.c")
    for case, dims, rule in (
        (Trace({"a": one, "b": one}), None, "--dims"),
        (Trace({"a": one}, {**sets, "r": still(PointTrace, [0])}), None, "--dims"),
        (Trace({"a": AgentTrace(np.zeros(1), np.zeros((1, 1)))}, sets), None, r"agents\.a"),
        (Trace({"a": one}), 0, "--dims"),
        (Trace({"a": one}), 4, "--dims"),
        (Trace({"a": one}, {"c": cube}), 2, r"unsafe\.c"),
    ):
        with pytest.raises(ScenarioError, match=rule):
            evaluate_trace(case, dims=dims)


def test_empty_polytopes_are_refused_by_row():
    A = np.array([[[1.0], [-1.0]]])
    a = {"a": AgentTrace(np.arange(2.0), np.zeros((2, 1)))}
    for b, row in (([[-1.0, -1], [1, 1]], 0), ([[1.0, 1], [-1, -1]], 1)):
        with pytest.raises(ScenarioError, match=rf"state_trace\[{row}\]"):
            evaluate_trace(Trace(a, {"s": PolytopeTrace(np.arange(2.0), A, np.array(b))}))


@pytest.mark.parametrize("d", [1, 2, 3])
@pytest.mark.parametrize("F", [1, 4, 7])
def test_facets_agree_with_fixed_polytopes(d, F):
    rng, N = np.random.default_rng(10 * d + F), 12
    H = rng.normal(size=(N, F, d))
    H /= np.linalg.norm(H, axis=-1, keepdims=True)
    b, p, v = rng.uniform(0.1, 2, (N, F)), rng.normal(size=(N, d)) * 3, rng.normal(size=(N, d))
    distance, entry_time = MovingPolytope(H, b).signed_distance(p), MovingPolytope(H, b).entry_time(p, v)
    for i in range(len(p)):
        one = PolytopeShape(H[i], b[i])
        assert distance[i] == pytest.approx(float(one.signed_distance(p[i])), abs=1e-7)
        assert entry_time[i] == pytest.approx(float(one.entry_time(p[i], v[i])), rel=1e-6, abs=1e-9)
        both = MovingPolytope(H[i : i + 1], np.repeat(b[i : i + 1], 2, axis=0))
        shared = both.signed_distance(np.repeat(p[i : i + 1], 2, axis=0))
        assert shared == pytest.approx([distance[i]] * 2, abs=1e-9)
    H, b, p, v = (np.concatenate([part] * 300) for part in (H, b, p, v))  # more samples than are held at once
    assert np.array_equal(MovingPolytope(H, b).entry_time(p, v), np.tile(entry_time, 300))
