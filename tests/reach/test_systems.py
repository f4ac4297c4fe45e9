"""Descriptions of linear systems: what is taken, and one clear error for what is not."""

import numpy as np
import pytest
from scipy import sparse

from reach import HPolytope, Interval, LinearSystem, ReachError, Zonotope

A = np.array([[0.0, 1.0], [-1.0, 0.0]])
U = Interval([-1.0], [1.0])


def test_what_is_left_out_is_nothing():
    system = LinearSystem(A)
    assert (system.dim, system.inputs, system.U) == (2, 0, ())
    assert np.array_equal(system.c, [0.0, 0.0])
    assert LinearSystem(A, U=Interval([-1.0, 0.0], [1.0, 0.0])).inputs == 2
    assert LinearSystem(sparse.identity(9), U=Interval(np.zeros(9), np.ones(9))).sparse


@pytest.mark.parametrize("make", [np.asarray, sparse.csr_matrix])
@pytest.mark.parametrize("discrete", [False, True])
def test_holding_inputs_appends_them_as_states(make, discrete):
    system = LinearSystem(make(A), [[0.0], [2.0]], U, [1.0, 0.0], discrete=discrete)
    held = system.holding_inputs()
    assert held.sparse == system.sparse
    matrix = held.A.toarray() if held.sparse else held.A
    last = [0.0, 0.0, float(discrete)]
    assert np.array_equal(matrix, [[0.0, 1.0, 0.0], [-1.0, 0.0, 2.0], last])
    assert np.array_equal(held.c, [1.0, 0.0, 0.0])
    assert held.U == ()


BAD = {
    "A is not square": ({"A": np.ones((2, 3))}, r"A must be square.*\(2, 3\)"),
    "A is empty": ({"A": np.zeros((0, 0))}, "A must be square"),
    "A is a vector": ({"A": [1.0, 2.0]}, "A must be a matrix"),
    "A has nan": ({"A": [[np.nan]]}, "A has entries"),
    "A is words": ({"A": [["a"]]}, "A must be numbers"),
    "sparse A has inf": ({"A": sparse.csr_matrix([[np.inf]])}, "A has entries"),
    "B has other rows": ({"A": A, "B": [[1.0]], "U": U}, "B must have 2 rows"),
    "B has nan": ({"A": A, "B": [[1.0], [np.nan]], "U": U}, "B has entries"),
    "B without U": ({"A": A, "B": [[0.0], [1.0]]}, "B is given without U"),
    "U of another dimension": (
        {"A": A, "B": [[0.0], [1.0]], "U": Interval([0.0] * 2, [1.0] * 2)},
        "dimension 1",
    ),
    "U is no set": ({"A": A, "B": [[0.0], [1.0]], "U": 3.0}, "U must be a convex set, got float"),
    "U is a stack": (
        {"A": A, "B": [[0.0], [1.0]], "U": Zonotope(np.zeros((4, 1)), np.zeros((4, 1, 1)))},
        "stack",
    ),
    "c of another length": ({"A": A, "c": [1.0]}, "c must be 2"),
    "c has nan": ({"A": A, "c": [1.0, np.nan]}, "c must be 2"),
    "c is words": ({"A": A, "c": ["a", "b"]}, "c must be numbers"),
    "two sets without a break": ({"A": A, "B": [[0.0], [1.0]], "U": (U, U)}, "need 1 breaks"),
    "breaks without sets": ({"A": A, "breaks": [1.0]}, "0 input sets need 0 breaks"),
    "breaks that fall": ({"A": A, "B": [[0.0], [1.0]], "U": (U, U, U), "breaks": [2.0, 1.0]}, "increasing"),
    "a break at zero": ({"A": A, "B": [[0.0], [1.0]], "U": (U, U), "breaks": [0.0]}, "positive"),
    "a break that is nan": ({"A": A, "B": [[0.0], [1.0]], "U": (U, U), "breaks": [np.nan]}, "increasing"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_descriptions_get_one_clear_error(name):
    arguments, message = BAD[name]
    with pytest.raises(ReachError, match=message):
        LinearSystem(**arguments)


def test_only_one_set_can_be_held():
    with pytest.raises(ReachError, match="got 2"):
        LinearSystem(A, [[0.0], [1.0]], (U, U), breaks=[1.0]).holding_inputs()
    with pytest.raises(ReachError, match="got 0"):
        LinearSystem(A).holding_inputs()


@pytest.mark.parametrize(
    ("body", "message"),
    [(HPolytope([[1.0], [-1.0]], [-1.0, -1.0]), "empty"), (HPolytope([[1.0]], [1.0]), "bounded")],
)
def test_input_sets_that_cannot_be_bounded_are_refused_by_tubes(body, message):
    from reach import support_tube, zonotope_tube

    system = LinearSystem(A, [[0.0], [1.0]], body)
    start = Interval([0.0, 0.0], [1.0, 1.0])
    with pytest.raises(ReachError, match=message):
        support_tube(system, start, 1.0, np.eye(2), step=0.1)
    with pytest.raises(ReachError, match=message):
        zonotope_tube(system, start, 1.0, step=0.1)
