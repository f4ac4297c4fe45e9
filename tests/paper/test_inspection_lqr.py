"""Theory, item 15: Dunlap eq. 40 with the whole error integrated has no stabilising gain."""

import control
import numpy as np
import pytest

from polaris.inspection.backup.tracker import BackupTracker, augmented
from polaris.inspection.inspection import Inspection

PROBLEM = Inspection(deputies=1)


def hautus_rank(A, B, eigenvalue):
    scale = np.diag([1.0] * 3 + [1e-3] * 3 + [1e3] * (len(A) - 6))  # units in which all entries are alike
    A, B = np.linalg.inv(scale) @ A @ scale * 1e3, np.linalg.inv(scale) @ B * 1e3
    return np.linalg.matrix_rank(np.hstack([A - eigenvalue * np.eye(len(A)), B]))


def whole(A, B):
    """Eq. 40 as it reads: all six errors are integrated, not the three positions alone."""
    larger = np.zeros((12, 12))
    larger[:6, :6], larger[6:, :6] = A[:6, :6], np.eye(6)
    return larger, np.vstack([B[:6], np.zeros((6, 3))])


def test_item_15_integral_of_the_whole_error_is_uncontrollable_at_zero():
    A, B = whole(*augmented(PROBLEM))
    assert A.shape == (12, 12)
    assert hautus_rank(A, B, 0.0) == 9
    # A left null vector, written down: integral of velocity error minus position error is constant.
    left = np.zeros((3, 12))
    left[:, :3], left[:, 9:] = -np.eye(3), np.eye(3)
    assert not (left @ A).any()
    assert not (left @ B).any()


def test_item_15_riccati_equation_of_the_whole_error_has_no_stabilising_solution():
    A, B = whole(*augmented(PROBLEM))
    try:
        gain = np.asarray(control.lqr(A, B, np.eye(12), np.eye(3))[0])
    except (np.linalg.LinAlgError, control.ControlArgument, ValueError):
        return  # which of them, the linear algebra library and the processor decide
    assert np.linalg.eigvals(A - B @ gain).real.max() > -1e-9


def test_item_15_integral_of_the_position_error_is_controllable_and_the_loop_is_stable():
    A, B = augmented(PROBLEM)
    assert hautus_rank(A, B, 0.0) == len(A) == 9
    tracker = BackupTracker(PROBLEM)
    assert np.linalg.eigvals(A - B @ tracker.gain).real.max() < -1e-3


@pytest.mark.parametrize("y", [-300.0, 40.0])
def test_eq_41_leaves_no_position_error_to_integrate(y):
    x = np.array([100.0, y, 20.0, 0.3, -0.1, 0.2])
    n = PROBLEM.mean_motion
    printed = np.array([x[0], x[1], x[2], n * x[1] / 2, -2 * n * x[0], x[5]])
    assert not (x - printed)[:3].any()
    # Ours has a reference of its own, and it moves freely.
    tracker = BackupTracker(PROBLEM)
    memory = tracker.start(x[None])
    after = tracker.thrust(x[None], memory)[1]
    assert np.abs(x[:3] - memory[0, :3]).max() > 0.1
    np.testing.assert_allclose(after[0, :6], PROBLEM.discretize(1.0)[0] @ memory[0, :6], rtol=1e-12)
