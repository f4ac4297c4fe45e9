"""Verdicts: proven, violated with an admissible trajectory, or unknown; never the wrong one."""

import numpy as np
import pytest
from scipy import sparse
from scipy.linalg import block_diag

from reach import (
    Always,
    HPolytope,
    Interval,
    LinearSystem,
    Never,
    ReachError,
    Unresolved,
    simulate,
    support_tube,
    verify,
    worst_case,
)

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


def test_a_region_that_only_a_slanted_direction_separates():
    square = HPolytope(np.vstack([np.eye(2), -np.eye(2)]), np.full(4, 0.1))
    assert verify(OSCILLATOR, START, Never(square), 2.0)
    verdict = verify(OSCILLATOR, START, Never(square), 12.0)
    assert verdict.status == "violated" and np.all(np.abs(verdict.trajectory.states[-1]) <= 0.1)


def test_only_the_window_counts():
    falling = LinearSystem([[-1.0]])
    one = Interval([1.0], [1.0])
    low = Always(HPolytope([[1.0]], [0.5]), during=(1.0, 3.0))
    assert verify(falling, one, low, 3.0)
    assert (
        verify(falling, one, Always(HPolytope([[1.0]], [0.5]), during=(0.5, 3.0)), 3.0).status == "violated"
    )
    at_end = Never(HPolytope([[1.0]], [np.exp(-2.0) - 1e-6]), during=(2.0, 2.0))
    assert verify(falling, one, at_end, 3.0)


def test_no_trajectory_from_outside_the_window_is_called_a_violation():
    # x = min(t, 2 - t): at least 0.1 within the window, below 0.05 before it
    there_and_back = LinearSystem(
        [[0.0]], [[1.0]], [Interval([1.0], [1.0]), Interval([-1.0], [-1.0])], breaks=[1.0]
    )
    spec = Never(between(-0.1, 0.05), during=(0.1, 1.5))
    assert verify(there_and_back, Interval([0.0], [0.0]), spec, 2.0).status != "violated"


def test_touching_a_region_is_no_violation():
    counting = LinearSystem([[1.0]], [[1.0]], Interval([0.1], [0.1]), discrete=True)
    spec = Never(between(0.1 + 0.1 + 0.1, 1.0), during=(3.0, 3.0))
    verdict = verify(counting, Interval([0.0], [0.0]), spec, 3)
    assert verdict.status != "violated"


def test_large_sparse_systems_book_the_rounding_of_what_grows():
    # the row avoids the growing motion but for rounding
    turned = np.array([[1.0, 2.0], [1.0, 3.0]]) @ np.diag([20.0, -1.0]) @ np.array([[3.0, -2.0], [-1.0, 1.0]])
    A = sparse.csr_matrix(block_diag(turned, -np.eye(448)))
    start = np.zeros(450)
    start[:2] = -5.0, -6.0
    row = np.zeros((1, 450))
    row[0, :2] = -1.0, 1.0
    tube = support_tube(LinearSystem(A), Interval(start, start), 2.2, row, step=0.05)
    exact = -np.exp(-tube.times)
    assert np.all(tube.upper[:, 0] >= exact) and np.all(tube.attained[:, 0] <= exact)


def test_systems_without_inputs_are_replayed_too():
    doubling = LinearSystem([[2.0]], discrete=True)
    assert verify(doubling, Interval([1.0], [1.0]), Always(between(-3, 3)), 4).status == "violated"
    large = LinearSystem(sparse.identity(500, format="csr") * 0.1)
    row = np.ones((1, 500))
    ones = Interval(np.ones(500), np.ones(500))
    assert verify(large, ones, Always(HPolytope(row, [600.0])), 5.0).status == "violated"


@pytest.mark.parametrize("during", [(-1.0, 2.0), (2.0, 1.0), (0.0, 9.0), (np.nan, 1.0)])
def test_windows_outside_the_horizon(during):
    with pytest.raises(ReachError, match="during"):
        verify(OSCILLATOR, START, Always(HPolytope(np.eye(2), [9, 9]), during), 5.0)


def test_region_of_another_dimension():
    with pytest.raises(ReachError, match="dimension 1"):
        verify(OSCILLATOR, START, Always(between(0, 1)), 5.0)


def test_the_start_alone():
    now = Always(HPolytope([[1.0, 0.0]], [1.15]), during=(0.0, 0.0))
    assert verify(OSCILLATOR, START, now, 5.0)
    late = Always(HPolytope([[1.0, 0.0]], [1.05]), during=(0.0, 0.0))
    verdict = verify(OSCILLATOR, START, late, 5.0)
    assert verdict.status == "violated" and len(verdict.trajectory.times) == 1
    assert verify(OSCILLATOR, START, Never(between_2d(1.2, 1.3), during=(0.0, 0.0)), 5.0)
    assert verify(OSCILLATOR, START, Never(between_2d(1.0, 1.3), during=(0.0, 0.0)), 5.0).status == "violated"


def between_2d(lo, hi):
    return HPolytope([[1.0, 0.0], [-1.0, 0.0]], [hi, -lo])


def test_discrete_systems_are_asked_at_their_steps():
    flipping = LinearSystem([[-1.0]], discrete=True)
    one = Interval([1.0], [1.0])
    assert verify(flipping, one, Never(between(-0.5, 0.5)), 6)
    halving = LinearSystem([[0.5]], discrete=True)
    assert verify(halving, one, Never(between(0.49, 0.51)), 4).status == "violated"
    assert verify(halving, one, Never(between(0.24, 0.26), during=(2.3, 3)), 3)
    with pytest.raises(ReachError, match="whole number of steps"):
        verify(halving, one, Never(between(0.24, 0.26), during=(2.3, 2.6)), 3)


def test_replays_of_fast_systems_are_exact():
    fast = LinearSystem([[0.0, 1e6], [-1e6, 0.0]])
    T = 10 / 3
    end = simulate(fast, [1.0, 0.0], np.linspace(0, T, 1001), np.zeros((1000, 0))).states[-1]
    assert end == pytest.approx([np.cos(1e6 * T), -np.sin(1e6 * T)], abs=2e-8)


# -- what does not work out is said, not computed on ----------------------------------------------


def test_a_limit_touched_to_the_last_bit_is_unknown_not_an_error():
    turn = LinearSystem([[0.0, 1.0], [-1.0, 0.0]])
    verdict = verify(turn, Interval([1.0, 0.0], [1.0, 0.0]), Always(HPolytope([[1.0, 0.0]], [1.0])), 10.0)
    assert verdict.status == "unknown" and "of the limit" in verdict.reason
    huge = Always(HPolytope([[1.0, 0.0]], [1e-9]))
    assert verify(turn, Interval([-1e9, 0.0], [0.0, 0.0]), huge, 1e-20).status in ("unknown", "violated")


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


def test_growth_beyond_numbers_is_unknown():
    grow = LinearSystem([[1e3]])
    verdict = verify(grow, Interval([1.0], [1.0]), Always(HPolytope([[-1.0]], [0.0])), 1e3)
    assert verdict.status == "unknown" and "rounding" in verdict.reason


def test_an_unseen_part_that_overflows_gives_no_nan():
    A = np.array([[-1.0, 0.0], [1e-3, 400.0]])
    for kept in (A, sparse.csr_matrix(A)):
        tube = support_tube(
            LinearSystem(kept), Interval([1.0, 0.0], [1.0, 0.0]), 1.0, [[1.0, 0.0]], step=0.01
        )
        assert np.all(np.isfinite(tube.upper)) and np.all(tube.upper[-1] >= np.exp(-1.0))
        try:
            tube = support_tube(
                LinearSystem(kept * 2), Interval([1.0, 0.0], [1.0, 0.0]), 1.0, [[0.0, 1.0]], step=0.01
            )
        except Unresolved:
            continue
        assert np.all(np.isfinite(tube.upper)) and np.all(np.isfinite(tube.interval))


def test_stiff_sparse_systems_refuse_long_steps_at_once():
    A = sparse.diags([np.full(999, 1e9), np.full(1000, -2e9), np.full(999, 1e9)], [-1, 0, 1])
    with pytest.raises(Unresolved, match="too long for a sparse system"):
        support_tube(
            LinearSystem(A), Interval(-np.ones(1000), np.ones(1000)), 1.0, np.eye(1000)[:1], step=0.5
        )


@pytest.mark.parametrize("step", [1.0, 5.0])
def test_useless_bounds_are_refused(step):
    fast = LinearSystem([[0.0, 4e10], [-4e10, 0.0]])
    with pytest.raises(Unresolved, match="too long"):
        support_tube(fast, Interval([-1, -1], [1, 1]), 10.0, [[1.0, 0.0]], step=step)


def test_regions_that_are_nothing_or_everything():
    system, start = LinearSystem([[-1.0]]), Interval([1.0], [2.0])
    everything = HPolytope(np.zeros((0, 1)), np.zeros(0))
    assert verify(system, start, Always(everything), 1.0)
    verdict = verify(system, start, Never(everything), 1.0)
    assert verdict.status == "violated" and verdict.trajectory.states.shape == (1, 1)
    nothing = HPolytope([[1.0], [-1.0]], [1.2, -1.3])
    assert verify(system, start, Never(nothing), 1.0).reason == "the region is empty"
    assert verify(system, start, Always(nothing), 1.0).status == "violated"


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
        ({"spec": Always(HPolytope([[1.0]], [1.0]), during=(0.5, np.nan))}, "two times"),
        ({"initial": [0.0]}, "convex set"),
        ({"horizon": -1.0}, "horizon"),
        ({"horizon": "long"}, "horizon"),
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
    with pytest.raises(ReachError, match=message):
        verify(**(good | arguments))


def test_a_specification_needs_a_polytope_and_two_times():
    with pytest.raises(ReachError, match="to_polytope"):
        Always(Interval([0.0], [1.0]))
    with pytest.raises(ReachError, match="two times"):
        Never(HPolytope([[1.0]], [1.0]), during=0.5)


def test_directions_of_worst_cases_are_checked():
    for bad in ([1.0, 2.0], [np.nan], "up"):
        with pytest.raises(ReachError, match="direction"):
            worst_case(LinearSystem([[-1.0]]), Interval([0.0], [1.0]), 1.0, bad)
