"""Hybrid tubes against simulated trajectories: none may leave, whatever it jumps through."""

from dataclasses import replace

import numpy as np
import pytest

from reach import (
    Always,
    HPolytope,
    HybridAutomaton,
    HybridOptions,
    HybridTrajectory,
    Interval,
    LinearSystem,
    Mode,
    Never,
    ReachError,
    Signal,
    Transition,
    Zonotope,
    falsify_hybrid,
    hybrid_tube,
    replay_hybrid,
    simulate_hybrid,
    support_tube,
    verify_hybrid,
)
from reach.sets.clipping import clip, hull_of, strips
from reach.tubes.flowpipes import input_response

SPIRAL = np.array([[-0.3, -2.0], [2.0, -0.3]])


def half(row, limit):
    return HPolytope([row], [limit])


def outside(tube, path, rng, looks=5):
    """Looks at a trajectory at random times; returns the ones at which no set of the tube holds it."""
    lost = []
    moments = [(v, k) for v in path.visits for k in range(len(v.times))]
    chosen = [moments[i] for i in rng.choice(len(moments), min(looks, len(moments)), replace=False)]
    chosen += [(v, k) for v in path.visits for k in (0, -1)]
    for visit, k in chosen:
        t, x = visit.times[k], visit.states[k]
        held = False
        for segment in tube.in_mode(visit.mode):
            k_, i_ = segment.steps
            span = segment.span(k_, i_)
            now = (span[:, 0] <= t + 1e-6) & (t - 1e-6 <= span[:, 1])
            sets, meets = segment.cut(k_[now], i_[now])
            # The simulation finds instants to a tolerance, and a set may be flat: room for both.
            sets = sets.inflate(np.full(sets.dim, 1e-9 * (1 + np.abs(x).max())))
            hulls = sets.interval_hull()
            near = meets & np.all((x >= hulls.lo) & (x <= hulls.hi), axis=-1)
            if any(sets[j].contains(x, slack=1e-6) for j in np.flatnonzero(near)):
                held = True
                break
        if not held:
            lost.append((visit.mode, t, x))
    return lost


def holds_all(automaton, initial, horizon, tube, runs=4, dt=0.01, jumps=12, seed=0):
    rng = np.random.default_rng(seed)
    assert tube.complete
    counts = []
    for x in initial.sample(rng, runs):
        path = simulate_hybrid(automaton, x, horizon, dt=dt, policy="random", rng=rng, jumps=jumps)
        assert not outside(tube, path, rng)
        counts.append(len(path.visits))
    return counts


def thermostat(U=None):
    """Two spirals about different points; the guard and the invariant share a face."""
    B = None if U is None else np.eye(2)
    left = LinearSystem(SPIRAL, B, U, c=[0.5, 0.0])
    right = LinearSystem(SPIRAL - np.eye(2) * 0.2, B, U, c=[-0.5, 1.0])
    return HybridAutomaton(
        [Mode("left", left, half([1, 0], 0.4)), Mode("right", right, half([-1, 0], 0.2))],
        [
            Transition("left", "right", guard=half([-1, 0], -0.4)),
            Transition("right", "left", guard=half([1, 0], -0.2), R=0.9 * np.eye(2), r=[0.0, 0.1]),
        ],
    )


BOX = Zonotope.box([-1.0, 0.5], [0.1, 0.15])


# -- soundness --------------------------------------------------------------------------------------


@pytest.mark.parametrize("clusters", [None, 1, 3])
@pytest.mark.parametrize("U", [None, Interval([-0.1, -0.05], [0.1, 0.05])])
def test_trajectories_stay_inside_through_guards_and_resets(clusters, U):
    automaton = thermostat(U)
    tube = hybrid_tube(automaton, BOX, 2.5, HybridOptions(step=0.05, clusters=clusters, order=6))
    counts = holds_all(automaton, BOX, 2.5, tube)
    assert max(counts) >= 2


def test_a_guard_that_is_not_urgent_may_be_passed():
    free = LinearSystem(np.zeros((2, 2)), c=[1.0, 0.0])
    band = HPolytope([[1.0, 0], [-1, 0]], [1.0, -0.5])
    automaton = HybridAutomaton(
        [Mode("go", free), Mode("turn", LinearSystem(np.zeros((2, 2)), c=[0.0, 1.0]))],
        [Transition("go", "turn", guard=band)],
    )
    start = Zonotope.box([0.0, 0.0], [0.1, 0.1])
    tube = hybrid_tube(automaton, start, 2.0, HybridOptions(step=0.1))
    holds_all(automaton, start, 2.0, tube)
    passing = automaton["go"]
    assert tube.support(passing.name, [1.0, 0.0])[0] >= 2.1  # nobody had to jump
    assert tube.support("turn", [1.0, 0.0])[0] == pytest.approx(1.0, abs=0.06)


@pytest.mark.parametrize("width", [0.0, 0.3])
@pytest.mark.parametrize("U", [None, Interval([-0.2], [0.1])])
def test_windows_and_dwell_times_with_uncertain_resets(width, U):
    B = None if U is None else np.array([[0.0], [1.0]])
    shear, noise = [[1, 0.2], [0, 1]], Interval([0, 0], [0.1, 0])
    automaton = HybridAutomaton(
        [Mode("a", LinearSystem(SPIRAL, B, U)), Mode("b", LinearSystem(-0.5 * np.eye(2), B, U, c=[1.0, 0]))],
        [
            Transition("a", "b", window=(0.4, 0.4 + width), urgent=True),
            Transition("b", "a", dwell=(0.5, 0.5 + width), R=shear, uncertain=noise, urgent=True),
            Transition("a", "b", dwell=(1.0, 1.0), window=(0.6, 9.0)),
        ],
    )
    tube = hybrid_tube(automaton, BOX, 2.0, HybridOptions(step=0.05, order=8))
    counts = holds_all(automaton, BOX, 2.0, tube)
    assert min(counts) >= 3


def test_a_bouncing_ball_with_uncertain_gravity():
    fall = LinearSystem([[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], Interval([-9.9], [-9.7]))
    automaton = HybridAutomaton(
        [Mode("fall", fall, half([-1, 0], 0.0))],
        [Transition("fall", "fall", guard=HPolytope([[1, 0], [0, 1]], [0, 0]), R=[[1, 0], [0, -0.75]])],
    )
    start = Zonotope.box([1.0, 0.0], [0.05, 0.05])
    tube = hybrid_tube(automaton, start, 1.4, HybridOptions(step=0.02, clusters=4, order=5))
    counts = holds_all(automaton, start, 1.4, tube)
    assert max(counts) >= 3
    assert tube.support("fall", [1.0, 0.0])[0] < 1.1


@pytest.mark.parametrize("seed", range(4))
def test_random_automata(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 4))
    modes, transitions = [], []
    for name in "pqr":
        A = rng.normal(size=(n, n)) - 1.5 * np.eye(n)
        modes.append(Mode(name, LinearSystem(A, np.eye(n), Interval.ball(rng.normal(size=n), 0.05))))
    for source, target in (("p", "q"), ("q", "r"), ("p", "r")):
        normal = rng.normal(size=n)
        guard = half(normal, float(rng.normal() * 0.3))
        transitions.append(
            Transition(source, target, guard=guard, R=np.eye(n) + 0.2 * rng.normal(size=(n, n)))
        )
    automaton = HybridAutomaton(modes, transitions)
    start = Zonotope(rng.normal(size=n), 0.1 * rng.normal(size=(n, n + 1)))
    tube = hybrid_tube(automaton, start, 1.0, HybridOptions(step=0.05, clusters=4, order=5))
    holds_all(automaton, start, 1.0, tube, runs=7, seed=seed)


def test_the_state_at_a_time_is_held_and_not_by_much():
    automaton = thermostat()
    tube = hybrid_tube(automaton, BOX, 1.0, HybridOptions(step=0.01))
    rng = np.random.default_rng(3)
    ends = []
    for x in BOX.sample(rng, 60):
        path = simulate_hybrid(automaton, x, 1.0, dt=0.01)
        ends.append(path.visits[-1].states[-1])
    D = np.vstack([np.eye(2), -np.eye(2)])
    bound = np.max([sets.support(D).max(axis=0) for _, sets in tube.at(1.0)], axis=0)
    reached = (np.array(ends) @ D.T).max(axis=0)
    assert np.all(bound >= reached - 1e-9)
    assert np.all(bound <= reached + 0.05)


def test_the_response_to_inputs_is_enclosed_and_tight():
    system = LinearSystem(SPIRAL, [[1.0], [0.5]], Interval([-1.0], [1.0]))
    D = np.random.default_rng(0).normal(size=(10, 2))
    exact = support_tube(system, Zonotope.point([0.0, 0.0]), 1.0, D, tolerance=1e-6)
    bound = input_response(system, 1.0, 0.01).support(D)
    assert np.all(bound >= exact.attained[-1])
    assert np.all(bound <= 1.01 * exact.upper[-1])


# -- clipping ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(6))
def test_clipping_keeps_every_point_of_the_intersection(seed):
    rng = np.random.default_rng(seed)
    n, g, m = int(rng.integers(1, 4)), int(rng.integers(1, 7)), 5
    Z = Zonotope(rng.normal(size=(m, n)), rng.normal(size=(m, n, g)) * 10.0 ** rng.uniform(-3, 0, g))
    rows = rng.normal(size=(2, n))
    H, low, high = strips([HPolytope(rows, rng.normal(size=2)), HPolytope(-rows[:1], [rng.normal()])], n)
    assert len(H) == min(n, 2)
    cut, meets = clip(Z, H, low, high)
    for i in range(m):
        x = Z[i].sample(rng, 400)
        x = x[np.all((x @ H.T <= high) & (x @ H.T >= low), axis=1)][:15]
        assert meets[i] or len(x) == 0
        if len(x):
            assert np.all(cut[i].contains(x, slack=1e-7))


def test_clipping_a_flat_set_by_an_equation_is_exact():
    Z = Zonotope([[0.0, 0.0]], [[[1.0, 0.0], [1.0, 0.1]]])  # x = a, y = a + 0.1 b
    face = HPolytope([[1.0, 0.0], [-1.0, 0.0]], [0.3, -0.3])
    cut, meets = clip(Z, *strips([face], 2))
    hull = cut[0].interval_hull()
    assert meets[0]
    assert np.allclose([hull.lo, hull.hi], [[0.3, 0.2], [0.3, 0.4]], atol=1e-9)
    _, meets = clip(Z, *strips([half([0, 1], -1.2)], 2))
    assert not meets[0]


def test_the_hull_of_a_stack_holds_all_of_it():
    rng = np.random.default_rng(1)
    Z = Zonotope(rng.normal(size=(6, 3)), 0.1 * rng.normal(size=(6, 3, 4)))
    hull = hull_of(Z)
    assert all(np.all(hull.contains(Z[i].sample(rng, 30))) for i in range(6))


# -- degenerate cases -------------------------------------------------------------------------------


def test_a_guard_that_is_never_reached_leaves_one_segment():
    automaton = HybridAutomaton(
        [Mode("a", LinearSystem(-np.eye(2))), Mode("b", LinearSystem(np.eye(2)))],
        [Transition("a", "b", guard=half([-1, 0], -5.0))],
    )
    tube = hybrid_tube(automaton, BOX, 3.0, HybridOptions(step=0.1))
    assert [s.mode.name for s in tube.segments] == ["a"]
    assert tube.complete
    assert np.all(tube.support("b", np.eye(2)) == -np.inf)


def test_a_guard_that_holds_at_the_start():
    automaton = HybridAutomaton(
        [Mode("a", LinearSystem(-np.eye(2))), Mode("b", LinearSystem(SPIRAL))],
        [Transition("a", "b", guard=half([1, 0], 0.0))],
    )
    tube = hybrid_tube(automaton, BOX, 1.0, HybridOptions(step=0.1))
    assert tube.in_mode("b")[0].entered[:, 0].min() == 0.0
    holds_all(automaton, BOX, 1.0, tube)


def test_a_window_at_time_zero_of_no_width():
    automaton = HybridAutomaton(
        [Mode("a", LinearSystem(-np.eye(2))), Mode("b", LinearSystem(SPIRAL))],
        [Transition("a", "b", window=(0, 0), urgent=True)],
    )
    tube = hybrid_tube(automaton, BOX, 1.0, HybridOptions(step=0.1))
    assert np.all(tube.in_mode("b")[0].entered == 0.0)
    start = tube.in_mode("b")[0].flowpipes.start
    assert np.allclose(start[0].interval_hull().hi, BOX.interval_hull().hi, atol=1e-12)
    holds_all(automaton, BOX, 1.0, tube)


def test_a_start_outside_the_invariant_is_an_empty_tube():
    automaton = HybridAutomaton([Mode("a", LinearSystem(-np.eye(2)), half([1, 0], -5.0))])
    tube = hybrid_tube(automaton, BOX, 1.0, HybridOptions(step=0.1))
    assert tube.segments == ()
    assert tube.complete


def test_too_many_jumps_make_the_tube_incomplete_and_prove_nothing():
    automaton = HybridAutomaton(
        [Mode("a", LinearSystem(-np.eye(2)))], [Transition("a", "a", dwell=(0.1, 0.1), urgent=True)]
    )
    tube = hybrid_tube(automaton, BOX, 1.0, HybridOptions(step=0.1, jumps=3))
    assert not tube.complete
    safe = {"a": [Always(half([1, 0], 5.0))]}
    assert (
        verify_hybrid(automaton, BOX, safe, 1.0, HybridOptions(step=0.1, jumps=3), dt=0.1, runs=0).status
        == "unknown"
    )
    assert (
        verify_hybrid(automaton, BOX, safe, 1.0, HybridOptions(step=0.1), dt=0.1, runs=0).status == "proven"
    )


def test_fast_and_slow_motion_by_a_tolerance():
    automaton = HybridAutomaton([Mode("a", LinearSystem(np.diag([-50.0, -0.1])))])
    tube = hybrid_tube(automaton, BOX, 20.0, HybridOptions(step=2.0, tolerance=1e-3))
    (segment,) = tube.segments
    assert np.all(segment.flowpipes.intersample <= 1e-3)
    lengths = np.diff(segment.flowpipes.times)
    assert lengths.max() > 20 * lengths.min()
    holds_all(automaton, BOX, 20.0, tube)


# -- verification -----------------------------------------------------------------------------------


def test_proven_violated_and_unknown():
    automaton = thermostat()
    safe = {"right": [Never(half([-1, 0], -3.0))], "left": [Always(half([0, 1], 2.0))]}
    assert verify_hybrid(automaton, BOX, safe, 2.0, HybridOptions(step=0.05), dt=0.01)
    unsafe = {"right": [Never(half([0, 1], -0.3))]}
    verdict = verify_hybrid(automaton, BOX, unsafe, 2.0, HybridOptions(step=0.05), dt=0.01)
    assert verdict.status == "violated"
    last = verdict.trajectory.visits[-1]
    assert last.mode == "right"
    assert last.states[-1, 1] < -0.3
    assert replay_hybrid(automaton, verdict.trajectory) < 1e-6


@pytest.mark.parametrize("level", np.linspace(-0.6, 0.6, 5))
def test_never_a_wrong_safe(level):
    automaton = thermostat(Interval([-0.05, -0.05], [0.05, 0.05]))
    asked = {"right": [Never(half([0, 1], level))], "left": [Always(half([0, 1], -level))]}
    verdict = verify_hybrid(automaton, BOX, asked, 2.0, HybridOptions(step=0.1), dt=0.02, runs=5)
    rng = np.random.default_rng(7)
    broken = falsify_hybrid(automaton, BOX, asked, 2.0, dt=0.02, runs=30, rng=rng)
    assert verdict.status in ("proven", "violated", "unknown")
    assert not (verdict.status == "proven" and broken is not None)


def test_a_specification_may_hold_for_a_time_only():
    automaton = HybridAutomaton([Mode("a", LinearSystem(-np.eye(2)))])
    late = {"a": [Always(half([-1, 0], 0.2), during=(2.0, 3.0))]}
    whole = {"a": [Always(half([-1, 0], 0.2))]}
    assert verify_hybrid(automaton, BOX, late, 3.0, HybridOptions(step=0.1), dt=0.1).status == "proven"
    assert verify_hybrid(automaton, BOX, whole, 3.0, HybridOptions(step=0.1), dt=0.1).status == "violated"


def test_what_the_invariant_says_need_not_be_proved_again():
    inside = HPolytope([[1.0, 0.0], [0.0, 1.0]], [-0.5, 1.0])
    automaton = HybridAutomaton([Mode("a", LinearSystem(np.zeros((2, 2)), c=[1.0, 0.0]), inside)])
    assert verify_hybrid(
        automaton, BOX, {"a": [Always(half([1, 0], -0.5))]}, 3.0, HybridOptions(step=0.1), dt=0.1
    )


def test_a_replay_refuses_what_is_not_admissible():
    automaton = thermostat()
    path = simulate_hybrid(automaton, BOX.c, 2.0, dt=0.01)
    assert replay_hybrid(automaton, path) < 1e-6
    first = path.visits[0]
    early = replace(first, times=first.times[:-20], states=first.states[:-20])  # jumps before the guard
    assert replay_hybrid(automaton, HybridTrajectory((early, *path.visits[1:]))) == np.inf
    moved = replace(first, states=first.states + 0.01 * np.arange(len(first.times))[:, None])
    assert replay_hybrid(automaton, HybridTrajectory((moved,))) > 1e-3


def test_a_trajectory_without_a_way_out_ends():
    automaton = HybridAutomaton([Mode("a", LinearSystem(np.zeros((2, 2)), c=[1.0, 0.0]), half([1, 0], 0.0))])
    path = simulate_hybrid(automaton, [-1.0, 0.0], 5.0, dt=0.1)
    assert path.deadlock
    assert path.visits[-1].times[-1] == pytest.approx(1.0, abs=1e-6)
    tube = hybrid_tube(automaton, Zonotope.point([-1.0, 0.0]), 5.0, HybridOptions(step=0.1))
    assert tube.support("a", [1.0, 0.0])[0] < 0.2


# -- bad input --------------------------------------------------------------------------------------

PLAIN = LinearSystem(-np.eye(2))
ONE = [Mode("a", PLAIN)]


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: HybridAutomaton([]), "needs a mode"),
        (lambda: HybridAutomaton([*ONE, *ONE]), "different names"),
        (lambda: HybridAutomaton(ONE, start="b"), "no mode 'b'"),
        (lambda: HybridAutomaton(ONE, [Transition("a", "b", window=(0, 1))]), "no mode 'b'"),
        (lambda: HybridAutomaton(ONE)["b"], "no mode 'b'"),
        (lambda: Transition("a", "a"), "needs a guard, a window or a dwell time"),
        (lambda: Transition("a", "a", window=(2, 1)), "two times"),
        (lambda: Transition("a", "a", dwell=(0, np.nan)), "two times"),
        (lambda: Transition("a", "a", guard=half([1, 0], 0), urgent=True), "urgent"),
        (lambda: Mode("a", LinearSystem(np.eye(2), discrete=True)), "continuous time"),
        (lambda: Mode("a", PLAIN, half([1, 0, 0], 0)), "dimension 2, got 3"),
        (lambda: Mode("a", LinearSystem([[0.0]], [[1.0]], nominal=Signal([0], [[1]]))), "no nominal input"),
        (lambda: HybridAutomaton(ONE, [Transition("a", "a", guard=half([1.0], 0))]), "dimension 2, got 1"),
        (lambda: HybridAutomaton(ONE, [Transition("a", "a", window=(0, 1), R=np.eye(3))]), "shape"),
        (lambda: HybridAutomaton(ONE, [Transition("a", "a", window=(0, 1), r=[np.inf, 0])]), "finite"),
        (lambda: hybrid_tube(HybridAutomaton(ONE), BOX, -1.0, HybridOptions(step=0.1)), "horizon"),
        (lambda: hybrid_tube(HybridAutomaton(ONE), BOX, 1.0, HybridOptions(step=0.0)), "step"),
        (lambda: hybrid_tube(HybridAutomaton(ONE), BOX, 1.0, HybridOptions(step={"b": 0.1})), "no step"),
        (
            lambda: hybrid_tube(HybridAutomaton(ONE), BOX, 1.0, HybridOptions(step=0.1, tolerance=-1.0)),
            "tolerance",
        ),
        (
            lambda: hybrid_tube(HybridAutomaton(ONE), Zonotope.point([0.0]), 1.0, HybridOptions(step=0.1)),
            "2, got 1",
        ),
        (
            lambda: hybrid_tube(HybridAutomaton(ONE), BOX, 1.0, HybridOptions(step=0.1)).at(2.0),
            "time must lie",
        ),
        (lambda: simulate_hybrid(HybridAutomaton(ONE), [0.0], 1.0, dt=0.1), "shape"),
        (lambda: simulate_hybrid(HybridAutomaton(ONE), [0, 0], 1.0, dt=0.1, policy="x"), "policy"),
        (lambda: simulate_hybrid(HybridAutomaton(ONE), [0, 0], 1.0, dt=0.1, policy="random"), "generator"),
        (
            lambda: verify_hybrid(
                HybridAutomaton(ONE), BOX, {"b": [Always(half([1, 0], 0))]}, 1, HybridOptions(step=1), dt=1
            ),
            "no mode 'b'",
        ),
        (
            lambda: verify_hybrid(
                HybridAutomaton(ONE), BOX, {"a": [Always(half([1], 0))]}, 1, HybridOptions(step=1), dt=1
            ),
            "dimension 1",
        ),
    ],
)
def test_bad_input_is_one_clear_error(build, message):
    with pytest.raises(ReachError, match=message):
        build()
