"""The tracking controller's gain: what has none is refused by name, and nothing else is hidden by that."""

import control
import numpy as np
import pytest

from polaris.model.errors import ScenarioError
from polaris.synthesis.lqr import solve_are

SADDLE, BOTH = np.diag([1.0, -1.0]), np.ones((2, 1))
CHAIN, PUSH = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]])


def test_gain_of_the_double_integrator_in_closed_form():
    P, gain = solve_are(CHAIN, PUSH, np.eye(2), np.eye(1))
    np.testing.assert_allclose(gain, [[1.0, np.sqrt(3)]])
    np.testing.assert_allclose(P, [[np.sqrt(3), 1.0], [1.0, np.sqrt(3)]])


@pytest.mark.parametrize(
    ("A", "B", "Q", "R"),
    [
        (SADDLE, PUSH, np.eye(2), np.eye(1)),  # not stabilisable
        (CHAIN, PUSH, np.zeros((2, 2)), np.eye(1)),  # Q sees nothing
        (SADDLE, BOTH, np.eye(2), np.zeros((1, 1))),
        (SADDLE, BOTH, np.eye(2), -np.eye(1)),
        (SADDLE, BOTH, np.array([[1.0, 2.0], [0.0, 1.0]]), np.eye(1)),
        (SADDLE * 1e200, BOTH, np.eye(2), np.eye(1)),
        (SADDLE, BOTH * 1e200, np.eye(2), np.eye(1)),
        (SADDLE, BOTH, np.eye(2) * 1e300, np.eye(1) * 1e-300),
    ],
)
def test_weights_or_systems_without_a_stabilising_solution_are_refused(A, B, Q, R):
    with np.errstate(all="ignore"), pytest.raises(ScenarioError, match="tracking.Q"):
        solve_are(A, B, Q, R)


def test_a_fault_in_the_library_is_not_taken_for_bad_weights(monkeypatch):
    def broken(*args, **options):
        raise RuntimeError("broken")

    monkeypatch.setattr(control, "care", broken)
    with pytest.raises(RuntimeError, match="broken"):
        solve_are(CHAIN, PUSH, np.eye(2), np.eye(1))
