"""Hybrid tubes against simulated trajectories: none may leave, whatever it jumps through."""

from dataclasses import replace

import numpy as np
import pytest

import reach
from reach import Always, HybridAutomaton, HybridOptions, LinearSystem, Mode, Transition, hybrid_tube
from reach.sets.clipping import clip, strips
from reach.tubes.flowpipes import input_response

SPIRAL = np.array([[-0.3, -2.0], [2.0, -0.3]])


def half(row, limit):
    return reach.HPolytope([row], [limit])


def is_held(tube, visit, k):
    """Return True if a set of the tube holds a state of a trajectory at its time."""
    t, x = visit.times[k], visit.states[k]
    for segment in tube.in_mode(visit.mode):
        k_, i_ = segment.steps
        span = segment.span(k_, i_)
        active = (span[:, 0] <= t + 1e-6) & (t - 1e-6 <= span[:, 1])
        sets, meets = segment.cut(k_[active], i_[active])
        # The simulation finds instants to a tolerance, and a set may be flat: room for both.
        sets = sets.inflate(np.full(sets.dim, 1e-9 * (1 + np.abs(x).max())))
        hulls = sets.interval_hull()
        near = meets & np.all((x >= hulls.lo) & (x <= hulls.hi), axis=-1)
        if any(sets[j].contains(x, slack=1e-6) for j in np.flatnonzero(near)):
            return True
    return False


def holds_all(automaton, initial, horizon, tube, runs=4, dt=0.01, jumps=12, seed=0):
    rng = np.random.default_rng(seed)
    assert tube.complete
    counts = []
    for x in initial.sample(rng, runs):
        path = reach.simulate_hybrid(automaton, x, horizon, dt=dt, policy="random", rng=rng, jumps=jumps)
        moments = [(visit, k) for visit in path.visits for k in range(len(visit.times))]
        chosen = [moments[i] for i in rng.choice(len(moments), min(5, len(moments)), replace=False)]
        chosen += [(visit, k) for visit in path.visits for k in (0, -1)]
        assert all(is_held(tube, visit, k) for visit, k in chosen)
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


BOX = reach.Zonotope.box([-1.0, 0.5], [0.1, 0.15])


@pytest.mark.parametrize("clusters", [None, 1, 3])
@pytest.mark.parametrize("U", [None, reach.Interval([-0.1, -0.05], [0.1, 0.05])])
def test_trajectories_stay_inside_through_guards_and_resets(clusters, U):
    automaton = thermostat(U)
    tube = hybrid_tube(automaton, BOX, 2.5, HybridOptions(step=0.05, clusters=clusters, order=6))
    counts = holds_all(automaton, BOX, 2.5, tube)
    assert max(counts) >= 2


def test_a_guard_that_is_not_urgent_may_be_passed():
    free = LinearSystem(np.zeros((2, 2)), c=[1.0, 0.0])
    band = reach.HPolytope([[1.0, 0], [-1, 0]], [1.0, -0.5])
    automaton = HybridAutomaton(
        [Mode("go", free), Mode("turn", LinearSystem(np.zeros((2, 2)), c=[0.0, 1.0]))],
        [Transition("go", "turn", guard=band)],
    )
    start = reach.Zonotope.box([0.0, 0.0], [0.1, 0.1])
    tube = hybrid_tube(automaton, start, 2.0, HybridOptions(step=0.1))
    holds_all(automaton, start, 2.0, tube)
    passing = automaton["go"]
    assert tube.support(passing.name, [1.0, 0.0])[0] >= 2.1  # nobody had to jump
    assert tube.support("turn", [1.0, 0.0])[0] == pytest.approx(1.0, abs=0.06)


@pytest.mark.parametrize("width", [0.0, 0.3])
@pytest.mark.parametrize("U", [None, reach.Interval([-0.2], [0.1])])
def test_windows_and_dwell_times_with_uncertain_resets(width, U):
    B = None if U is None else np.array([[0.0], [1.0]])
    shear, noise = [[1, 0.2], [0, 1]], reach.Interval([0, 0], [0.1, 0])
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


@pytest.mark.parametrize("seed", range(4))
def test_random_automata(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 4))
    modes, transitions = [], []
    for name in "pqr":
        A = rng.normal(size=(n, n)) - 1.5 * np.eye(n)
        modes.append(Mode(name, LinearSystem(A, np.eye(n), reach.Interval.ball(rng.normal(size=n), 0.05))))
    for source, target in (("p", "q"), ("q", "r"), ("p", "r")):
        normal = rng.normal(size=n)
        guard = half(normal, float(rng.normal() * 0.3))
        transitions.append(
            Transition(source, target, guard=guard, R=np.eye(n) + 0.2 * rng.normal(size=(n, n)))
        )
    automaton = HybridAutomaton(modes, transitions)
    start = reach.Zonotope(rng.normal(size=n), 0.1 * rng.normal(size=(n, n + 1)))
    tube = hybrid_tube(automaton, start, 1.0, HybridOptions(step=0.05, clusters=4, order=5))
    holds_all(automaton, start, 1.0, tube, runs=7, seed=seed)


def test_the_state_at_a_time_is_held_and_not_by_much():
    automaton = thermostat()
    tube = hybrid_tube(automaton, BOX, 1.0, HybridOptions(step=0.01))
    rng = np.random.default_rng(3)
    ends = []
    for x in BOX.sample(rng, 60):
        path = reach.simulate_hybrid(automaton, x, 1.0, dt=0.01)
        ends.append(path.visits[-1].states[-1])
    D = np.vstack([np.eye(2), -np.eye(2)])
    bound = np.max([sets.support(D).max(axis=0) for _, sets in tube.at(1.0)], axis=0)
    reached = (np.array(ends) @ D.T).max(axis=0)
    assert np.all(bound >= reached - 1e-9) and np.all(bound <= reached + 0.05)


@pytest.mark.parametrize("seed", range(6))
def test_clipping_keeps_every_point_of_the_intersection(seed):
    rng = np.random.default_rng(seed)
    n, g, m = int(rng.integers(1, 4)), int(rng.integers(1, 7)), 5
    Z = reach.Zonotope(rng.normal(size=(m, n)), rng.normal(size=(m, n, g)) * 10.0 ** rng.uniform(-3, 0, g))
    rows = rng.normal(size=(2, n))
    H, low, high = strips(
        [reach.HPolytope(rows, rng.normal(size=2)), reach.HPolytope(-rows[:1], [rng.normal()])], n
    )
    assert len(H) == min(n, 2)
    cut, meets = clip(Z, H, low, high)
    for i in range(m):
        x = Z[i].sample(rng, 400)
        x = x[np.all((x @ H.T <= high) & (x @ H.T >= low), axis=1)][:15]
        assert meets[i] or len(x) == 0
        if len(x):
            assert np.all(cut[i].contains(x, slack=1e-7))


def test_the_response_to_inputs_is_enclosed_and_tight():
    system = LinearSystem(SPIRAL, [[1.0], [0.5]], reach.Interval([-1.0], [1.0]))
    D = np.random.default_rng(0).normal(size=(10, 2))
    exact = reach.support_tube(system, reach.Zonotope.point([0.0, 0.0]), 1.0, D, tolerance=1e-6)
    bound = input_response(system, 1.0, 0.01).support(D)
    assert np.all(bound >= exact.attained[-1]) and np.all(bound <= 1.01 * exact.upper[-1])


def test_clipping_a_flat_set_by_an_equation_is_exact():
    Z = reach.Zonotope([[0.0, 0.0]], [[[1.0, 0.0], [1.0, 0.1]]])  # x = a, y = a + 0.1 b
    face = reach.HPolytope([[1.0, 0.0], [-1.0, 0.0]], [0.3, -0.3])
    cut, meets = clip(Z, *strips([face], 2))
    hull = cut[0].interval_hull()
    assert meets[0] and np.allclose([hull.lo, hull.hi], [[0.3, 0.2], [0.3, 0.4]], atol=1e-9)
    _, meets = clip(Z, *strips([half([0, 1], -1.2)], 2))
    assert not meets[0]


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


def test_too_many_jumps_make_the_tube_incomplete_and_prove_nothing():
    automaton = HybridAutomaton(
        [Mode("a", LinearSystem(-np.eye(2)))], [Transition("a", "a", dwell=(0.1, 0.1), urgent=True)]
    )
    tube = hybrid_tube(automaton, BOX, 1.0, HybridOptions(step=0.1, jumps=3))
    assert not tube.complete
    safe = {"a": [Always(half([1, 0], 5.0))]}
    for jumps, status in (({"jumps": 3}, "unknown"), ({}, "proven")):
        options = HybridOptions(step=0.1, **jumps)
        assert reach.verify_hybrid(automaton, BOX, safe, 1.0, options, dt=0.1, runs=0).status == status


def test_fast_and_slow_motion_by_a_tolerance():
    automaton = HybridAutomaton([Mode("a", LinearSystem(np.diag([-50.0, -0.1])))])
    tube = hybrid_tube(automaton, BOX, 20.0, HybridOptions(step=2.0, tolerance=1e-3))
    (segment,) = tube.segments
    assert np.all(segment.flowpipes.intersample <= 1e-3)
    lengths = np.diff(segment.flowpipes.times)
    assert lengths.max() > 20 * lengths.min()
    holds_all(automaton, BOX, 20.0, tube)


def test_proven_violated_and_unknown():
    automaton = thermostat()
    safe = {"right": [reach.Never(half([-1, 0], -3.0))], "left": [Always(half([0, 1], 2.0))]}
    assert reach.verify_hybrid(automaton, BOX, safe, 2.0, HybridOptions(step=0.05), dt=0.01)
    unsafe = {"right": [reach.Never(half([0, 1], -0.3))]}
    verdict = reach.verify_hybrid(automaton, BOX, unsafe, 2.0, HybridOptions(step=0.05), dt=0.01)
    last = verdict.trajectory.visits[-1]
    assert verdict.status == "violated" and last.mode == "right" and last.states[-1, 1] < -0.3
    assert reach.replay_hybrid(automaton, verdict.trajectory) < 1e-6


@pytest.mark.parametrize("level", np.linspace(-0.6, 0.6, 5))
def test_never_a_wrong_safe(level):
    automaton = thermostat(reach.Interval([-0.05, -0.05], [0.05, 0.05]))
    specs = {"right": [reach.Never(half([0, 1], level))], "left": [Always(half([0, 1], -level))]}
    verdict = reach.verify_hybrid(automaton, BOX, specs, 2.0, HybridOptions(step=0.1), dt=0.02, runs=5)
    rng = np.random.default_rng(7)
    broken = reach.falsify_hybrid(automaton, BOX, specs, 2.0, dt=0.02, runs=30, rng=rng)
    assert verdict.status in ("proven", "violated", "unknown")
    assert not (verdict.status == "proven" and broken is not None)


def test_a_specification_may_hold_for_a_time_only_or_by_the_invariant():
    falling = HybridAutomaton([Mode("a", LinearSystem(-np.eye(2)))])
    inside = reach.HPolytope([[1.0, 0.0], [0.0, 1.0]], [-0.5, 1.0])
    drifting = HybridAutomaton([Mode("a", LinearSystem(np.zeros((2, 2)), c=[1.0, 0.0]), inside)])
    for automaton, always, status in (
        (falling, Always(half([-1, 0], 0.2), during=(2.0, 3.0)), "proven"),
        (falling, Always(half([-1, 0], 0.2)), "violated"),
        (drifting, Always(half([1, 0], -0.5)), "proven"),
    ):
        options = HybridOptions(step=0.1)
        assert reach.verify_hybrid(automaton, BOX, {"a": [always]}, 3.0, options, dt=0.1).status == status


def test_a_replay_refuses_what_is_not_admissible():
    automaton = thermostat()
    path = reach.simulate_hybrid(automaton, BOX.c, 2.0, dt=0.01)
    assert reach.replay_hybrid(automaton, path) < 1e-6
    first = path.visits[0]
    early = replace(first, times=first.times[:-20], states=first.states[:-20])  # jumps before the guard
    assert reach.replay_hybrid(automaton, reach.HybridTrajectory((early, *path.visits[1:]))) == np.inf
    shifted = replace(first, states=first.states + 0.01 * np.arange(len(first.times))[:, None])
    assert reach.replay_hybrid(automaton, reach.HybridTrajectory((shifted,))) > 1e-3


def test_a_trajectory_without_a_way_out_ends():
    automaton = HybridAutomaton([Mode("a", LinearSystem(np.zeros((2, 2)), c=[1.0, 0.0]), half([1, 0], 0.0))])
    path = reach.simulate_hybrid(automaton, [-1.0, 0.0], 5.0, dt=0.1)
    assert path.deadlock and path.visits[-1].times[-1] == pytest.approx(1.0, abs=1e-6)
    tube = hybrid_tube(automaton, reach.Zonotope.point([-1.0, 0.0]), 5.0, HybridOptions(step=0.1))
    assert tube.support("a", [1.0, 0.0])[0] < 0.2


PLAIN = LinearSystem(-np.eye(2))
ONE = [Mode("a", PLAIN)]
STILL = HybridAutomaton(ONE)


def leaving(**options):
    return HybridAutomaton(ONE, [Transition("a", "a", **options)])


def tube_of(initial=BOX, horizon=1.0, **options):
    return hybrid_tube(STILL, initial, horizon, HybridOptions(**{"step": 0.1} | options))


def flown(x=(0, 0), **options):
    return reach.simulate_hybrid(STILL, list(x), 1.0, dt=0.1, **options)


def asked(mode, region):
    return reach.verify_hybrid(STILL, BOX, {mode: [Always(region)]}, 1, HybridOptions(step=1), dt=1)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: HybridAutomaton([]), "needs a mode"),
        (lambda: HybridAutomaton([*ONE, *ONE]), "different names"),
        (lambda: HybridAutomaton(ONE, start="b"), "no mode 'b'"),
        (lambda: HybridAutomaton(ONE, [Transition("a", "b", window=(0, 1))]), "no mode 'b'"),
        (lambda: STILL["b"], "no mode 'b'"),
        (lambda: Transition("a", "a"), "needs a guard, a window or a dwell time"),
        (lambda: Transition("a", "a", dwell=(0, np.nan)), "two times"),
        (lambda: Transition("a", "a", guard=half([1, 0], 0), urgent=True), "urgent"),
        (lambda: Mode("a", LinearSystem(np.eye(2), discrete=True)), "continuous time"),
        (lambda: Mode("a", PLAIN, half([1, 0, 0], 0)), "dimension 2, got 3"),
        (
            lambda: Mode("a", LinearSystem([[0.0]], [[1.0]], nominal=reach.Signal([0], [[1]]))),
            "no nominal input",
        ),
        (lambda: leaving(guard=half([1.0], 0)), "dimension 2, got 1"),
        (lambda: leaving(window=(0, 1), R=np.eye(3)), "shape"),
        (lambda: leaving(window=(0, 1), r=[np.inf, 0]), "finite"),
        (lambda: tube_of(horizon=-1.0), "horizon"),
        (lambda: tube_of(step=0.0), "step"),
        (lambda: tube_of(step={"b": 0.1}), "no step"),
        (lambda: tube_of(tolerance=-1.0), "tolerance"),
        (lambda: tube_of(reach.Zonotope.point([0.0])), "2, got 1"),
        (lambda: tube_of().at(2.0), "time must lie"),
        (lambda: flown([0.0]), "shape"),
        (lambda: flown(policy="x"), "policy"),
        (lambda: flown(policy="random"), "generator"),
        (lambda: asked("b", half([1, 0], 0)), "no mode 'b'"),
        (lambda: asked("a", half([1], 0)), "dimension 1"),
    ],
)
def test_bad_input_is_one_clear_error(build, message):
    with pytest.raises(reach.ReachError, match=message):
        build()
