"""Verdicts: proven, violated with an admissible trajectory, or unknown; never the wrong one."""

import warnings

import numpy as np
import pytest
from scipy import sparse
from scipy.linalg import block_diag

import reach
import reach.sets.bases
import reach.sets.polytope
from reach import Always, HPolytope, Interval, LinearSystem, Never, Unresolved, support_tube, verify
from reach.numerics.exponentials import Action, thin_expm

OSCILLATOR = LinearSystem([[0.0, 1.0], [-4.0, -0.4]], [[0.0], [1.0]], Interval([-0.1], [0.1]))
START = Interval([0.9, -0.1], [1.1, 0.1])


def between(lo, hi):
    return HPolytope([[1.0], [-1.0]], [hi, -lo])


def test_a_limit_above_all_motions_is_proven_and_one_below_is_broken_by_an_admissible_trajectory():
    row = np.array([[0.0, -1.0]])
    exact = support_tube(OSCILLATOR, START, 5.0, row, tolerance=1e-6).most[0]
    assert verify(OSCILLATOR, START, Always(HPolytope(row, [exact * 1.001])), 5.0)
    verdict = verify(OSCILLATOR, START, Always(HPolytope(row, [exact * 0.999])), 5.0)
    path = verdict.trajectory
    assert verdict.status == "violated" and verdict.margin < 0 and not verdict
    assert START.contains(path.states[0]) and np.all(np.abs(path.inputs) <= 0.1 + 1e-12)
    assert row[0] @ path.states[-1] > exact * 0.999 and path.times[-1] <= 5.0


def planar(lo, hi):
    return HPolytope([[1.0, 0.0], [-1.0, 0.0]], [hi, -lo])


FALLING, DOUBLING = LinearSystem([[-1.0]]), LinearSystem([[2.0]], discrete=True)
FLIPPING, HALVING = (LinearSystem([[rate]], discrete=True) for rate in (-1.0, 0.5))
COUNTING = LinearSystem([[1.0]], [[1.0]], Interval([0.1], [0.1]), discrete=True)
PUSHES = [Interval([1.0], [1.0]), Interval([-1.0], [-1.0])]
THERE_AND_BACK = LinearSystem([[0.0]], [[1.0]], PUSHES, breaks=[1.0])  # x = min(t, 2 - t)
TURN, LARGE = LinearSystem([[0.0, 1.0], [-1.0, 0.0]]), LinearSystem(sparse.identity(500, format="csr") * 0.1)
ZERO, ONE, LOW = Interval([0.0], [0.0]), Interval([1.0], [1.0]), HPolytope([[1.0]], [0.5])
EVERYTHING, NOTHING = HPolytope(np.zeros((0, 1)), np.zeros(0)), between(1.3, 1.2)
ONES, SUM = Interval(np.ones(500), np.ones(500)), HPolytope(np.ones((1, 500)), [600.0])
BELOW, LATE = between(-0.1, 0.05), HPolytope([[1.0]], [np.exp(-2.0) - 1e-6])
VERDICTS = {
    "a window after the violation": (FALLING, ONE, Always(LOW, during=(1.0, 3.0)), 3.0, "proven"),
    "a window that holds it": (FALLING, ONE, Always(LOW, during=(0.5, 3.0)), 3.0, "violated"),
    "an instant": (FALLING, ONE, Never(LATE, during=(2.0, 2.0)), 3.0, "proven"),
    "entered before the window": (THERE_AND_BACK, ZERO, Never(BELOW, (0.1, 1.5)), 2.0, "proven"),
    "touched": (COUNTING, ZERO, Never(between(0.1 + 0.1 + 0.1, 1.0), (3.0, 3.0)), 3, "proven"),
    "within a limit at the start": (OSCILLATOR, START, Always(planar(-9, 1.15), (0.0, 0.0)), 5.0, "proven"),
    "beyond one at the start": (OSCILLATOR, START, Always(planar(-9, 1.05), (0.0, 0.0)), 5.0, "violated"),
    "outside at the start": (OSCILLATOR, START, Never(planar(1.2, 1.3), (0.0, 0.0)), 5.0, "proven"),
    "inside at the start": (OSCILLATOR, START, Never(planar(1.0, 1.3), (0.0, 0.0)), 5.0, "violated"),
    "between the steps": (FLIPPING, ONE, Never(between(-0.5, 0.5)), 6, "proven"),
    "at a step": (HALVING, ONE, Never(between(0.49, 0.51)), 4, "violated"),
    "a window from between the steps": (HALVING, ONE, Never(between(0.24, 0.26), (2.3, 3)), 3, "proven"),
    "without inputs": (DOUBLING, ONE, Always(between(-3, 3)), 4, "violated"),
    "large": (LARGE, ONES, Always(SUM), 5.0, "violated"),
    "the whole space": (FALLING, ONE, Always(EVERYTHING), 1.0, "proven"),
    "out of the whole space": (FALLING, ONE, Never(EVERYTHING), 1.0, "violated"),
    "within nothing": (FALLING, ONE, Always(NOTHING), 1.0, "violated"),
    "out of nothing": (FALLING, ONE, Never(NOTHING), 1.0, "proven"),
}


@pytest.mark.parametrize("name", VERDICTS)
def test_verdicts(name):
    *question, status = VERDICTS[name]
    verdict = verify(*question)
    assert verdict.status in (status, "unknown" if "touched" in name or "before" in name else status)
    assert (verdict.trajectory is not None) == (status == "violated")


def test_replays_of_fast_systems_are_exact():
    fast = LinearSystem([[0.0, 1e6], [-1e6, 0.0]])
    T = 10 / 3
    end = reach.simulate(fast, [1.0, 0.0], np.linspace(0, T, 1001), np.zeros((1000, 0))).states[-1]
    assert end == pytest.approx([np.cos(1e6 * T), -np.sin(1e6 * T)], abs=2e-8)


def test_a_limit_touched_to_the_last_bit_is_unknown_not_an_error():
    start = Interval([1.0, 0.0], [1.0, 0.0])
    assert "of the limit" in verify(TURN, start, Always(HPolytope([[1.0, 0.0]], [1.0])), 10.0).reason
    huge = Always(HPolytope([[1.0, 0.0]], [1e-9]))
    assert verify(TURN, Interval([-1e9, 0.0], [0.0, 0.0]), huge, 1e-20).status in ("unknown", "violated")


def test_effort_that_runs_out_is_unknown_and_counted(monkeypatch):
    rng = np.random.default_rng(0)
    stiff = LinearSystem(rng.normal(size=(60, 60)) * 40, np.eye(60), Interval(-np.ones(60), np.ones(60)))
    spec = Always(HPolytope(np.eye(60)[:1], [1e9]))
    verdict = verify(stiff, Interval(-np.ones(60), np.ones(60)), spec, 1000.0, max_effort=1e5)
    assert verdict.status == "unknown" and "max_effort" in verdict.reason
    never = Never(HPolytope(np.eye(60)[:2], [-1e300, -1e300]))
    verdict = verify(stiff, Interval(-np.ones(60), np.ones(60)), never, 1000.0, max_effort=1e5)
    assert verdict.status == "unknown"


def test_a_clock_that_jumps_changes_no_verdict(monkeypatch):
    """An hour at every look: what is decided is decided, what is not ends by its count."""
    looks = iter(range(10**9))
    monkeypatch.setattr("reach.verification.verify.perf_counter", lambda: 3600.0 * next(looks))
    turn = LinearSystem([[0.0, 1.0], [-1.0, 0.0]], np.eye(2), Interval([-0.01, -0.01], [0.01, 0.01]))
    start = Interval([0.9, -0.1], [1.1, 0.1])
    verdict = verify(turn, start, Never(HPolytope(-np.eye(2), [-1.5, -1.5])), 6.0)
    assert verdict.status == "proven" and verdict.seconds >= 3600.0
    with pytest.raises(Unresolved, match="max_effort"):
        support_tube(turn, start, 6.0, np.eye(2), max_effort=100.0)


def test_an_unseen_part_that_overflows_gives_no_nan():
    A = np.array([[-1.0, 0.0], [1e-3, 400.0]])
    start = Interval([1.0, 0.0], [1.0, 0.0])
    for matrix in (A, sparse.csr_matrix(A)):
        tube = support_tube(LinearSystem(matrix), start, 1.0, [[1.0, 0.0]], step=0.01)
        assert np.all(np.isfinite(tube.upper)) and np.all(tube.upper[-1] >= np.exp(-1.0))
        try:
            tube = support_tube(LinearSystem(matrix * 2), start, 1.0, [[0.0, 1.0]], step=0.01)
        except Unresolved:
            continue
        assert np.all(np.isfinite(tube.upper)) and np.all(np.isfinite(tube.interval))


def test_stiff_sparse_systems_refuse_long_steps_at_once():
    A = sparse.diags([np.full(999, 1e9), np.full(1000, -2e9), np.full(999, 1e9)], [-1, 0, 1])
    start = Interval(-np.ones(1000), np.ones(1000))
    with pytest.raises(Unresolved, match="too long for a sparse system"):
        support_tube(LinearSystem(A), start, 1.0, np.eye(1000)[:1], step=0.5)


def test_input_sets_that_share_no_grid_are_decided():
    sets = [Interval([-1.0], [1.0]), Interval([0.0], [3.0])]
    system = LinearSystem([[-1.0]], [[1.0]], sets, breaks=[np.sqrt(0.5)])
    b = np.sqrt(0.5)
    top = (1 - np.exp(-b)) * np.exp(b - 1) + 3 * (1 - np.exp(b - 1))
    start = Interval([0.0], [0.0])
    assert verify(system, start, Always(HPolytope([[1.0]], [top * 1.01])), 1.0)
    verdict = verify(system, start, Always(HPolytope([[1.0]], [top * 0.99])), 1.0)
    assert verdict.status == "violated"
    path = verdict.trajectory
    for t, u in zip((path.times[:-1] + path.times[1:]) / 2, path.inputs, strict=True):
        assert u in sets[int(t > b)]


@pytest.mark.parametrize(
    "arguments, message",
    [
        ({"spec": HPolytope([[1.0]], [1.0])}, "Always or Never"),
        ({"spec": Always(HPolytope(np.eye(2), [9, 9]))}, "dimension 2"),
        ({"spec": Always(HPolytope([[1.0]], [1.0]), during=(-1.0, 2.0))}, "during"),
        ({"spec": Always(HPolytope([[1.0]], [1.0]), during=(0.0, 9.0))}, "during"),
        ({"initial": [0.0]}, "convex set"),
        ({"system": HALVING, "spec": Never(LOW, (0.3, 0.6))}, "whole number of steps"),
        ({"horizon": np.inf}, "horizon"),
    ],
)
def test_wrong_arguments_get_one_clear_error(arguments, message):
    good = {
        "system": LinearSystem([[-1.0]]),
        "initial": Interval([0.0], [1.0]),
        "spec": Always(HPolytope([[1.0]], [2.0])),
        "horizon": 1.0,
    }
    assert verify(**good)
    with pytest.raises(reach.ReachError, match=message):
        verify(**(good | arguments))


def test_large_sparse_systems_book_the_rounding_of_what_grows():
    # the row avoids the growing motion but for rounding
    block = np.array([[1.0, 2.0], [1.0, 3.0]]) @ np.diag([20.0, -1.0]) @ np.array([[3.0, -2.0], [-1.0, 1.0]])
    A = sparse.csr_matrix(block_diag(block, -np.eye(448)))
    start = np.zeros(450)
    start[:2] = -5.0, -6.0
    row = np.zeros((1, 450))
    row[0, :2] = -1.0, 1.0
    tube = support_tube(LinearSystem(A), Interval(start, start), 2.2, row, step=0.05)
    exact = -np.exp(-tube.times)
    assert np.all(tube.upper[:, 0] >= exact) and np.all(tube.attained[:, 0] <= exact)


def counted(monkeypatch):
    """Return a list that grows by one with every linear program solved."""
    solved, original = [], reach.sets.polytope.maximise

    def count(*arguments):
        solved.append(1)
        return original(*arguments)

    for module in (reach.sets.polytope, reach.sets.bases):
        monkeypatch.setattr(module, "maximise", count)
    return solved


@pytest.mark.parametrize("steps", [20, 200])
def test_a_polytope_as_input_or_initial_set_takes_a_few_programs(monkeypatch, steps):
    rng = np.random.default_rng(1)
    A, B = rng.normal(size=(4, 4)) - 2 * np.eye(4), rng.normal(size=(4, 2))
    U, X = Interval([-1.0, -0.5], [1.0, 0.5]), Interval(-np.ones(4), np.ones(4))
    by_box = support_tube(LinearSystem(A, B, U), X, 1.0, np.eye(4), step=1 / steps)
    solved = counted(monkeypatch)
    tube = support_tube(LinearSystem(A, B, U.to_polytope()), X.to_polytope(), 1.0, np.eye(4), step=1 / steps)
    assert len(solved) < 40
    assert np.all(tube.upper >= by_box.attained - 1e-9) and np.allclose(tube.upper, by_box.upper, rtol=1e-3)
    assert np.all(tube.attained <= by_box.upper + 1e-9)


def test_a_filled_matrix_in_a_sparse_container_is_handled_as_dense():
    rng = np.random.default_rng(0)
    filled = sparse.csr_matrix(rng.normal(size=(60, 60)) * (rng.random((60, 60)) < 0.5))
    assert not LinearSystem(filled).sparse and LinearSystem(sparse.identity(60)).sparse
    some = sparse.random(400, 400, 0.05, random_state=0).tocsr() - 2 * sparse.identity(400)
    assert LinearSystem(some).sparse and thin_expm(some, 1.0, Action(some)) is None


@pytest.mark.parametrize("rate", [1.0, 100.0])
@pytest.mark.parametrize("n", [2, 4, 8, 30])
def test_from_rest_the_default_tolerance_is_no_trouble(n, rate):
    """A chain from rest: the first state is nothing in the first steps, and little ever after."""
    A, B = rate * (np.diag(np.ones(n - 1), 1) - np.eye(n)), np.eye(n)[:, -1:]
    system, rest = LinearSystem(A, B, Interval([-1.0], [1.0])), reach.Zonotope.point(np.zeros(n))
    tube = support_tube(system, rest, 10.0, np.eye(n))
    assert np.all(tube.most >= tube.reached)
    assert np.all(tube.most < 1.1 * np.maximum(tube.reached, 1e-9 / rate))
    assert reach.zonotope_tube(system, rest, 10.0).nodes.half_widths.max() < 11.0
    row = np.eye(n)[:1]
    assert verify(system, rest, Always(HPolytope(row, [10.0])), 10.0)
    assert verify(system, rest, Never(HPolytope(np.vstack([row, -row]), [20.0, -15.0])), 10.0)


def test_long_steps_of_stiff_systems_are_cut_or_warned_of():
    for stiff in (1e3, 1e4):
        system = LinearSystem([[-stiff, stiff / 2], [0.0, -1.0]], [[0.0], [1.0]], Interval([-1.0], [1.0]))
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            tube = support_tube(system, Interval([-1.0, -1.0], [1.0, 1.0]), 1.0, np.eye(2), step=0.1)
        assert np.all(tube.most < 1.5)
    system = LinearSystem(np.diag([-1e8, -1.0]) + np.diag([5e7], 1), [[0.0], [1.0]], Interval([-1.0], [1.0]))
    with pytest.warns(reach.ReachWarning, match="factor of up to"):
        support_tube(system, Interval([-1.0, -1.0], [1.0, 1.0]), 1.0, np.eye(2), step=0.1)
