"""Traces that are written are read back exactly."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from polaris.model.errors import ScenarioError
from polaris.traces import (
    AgentTrace,
    BallTrace,
    PointTrace,
    PolytopeTrace,
    RectangleTrace,
    Trace,
    parse_trace,
    read_trace,
    trace_data,
    write_trace,
)

NUMBERS = st.floats(-1e300, 1e300, allow_nan=False)
SIZES = st.floats(0, 1e300)
NAMES = st.text(st.characters(exclude_categories=["Cs"]), max_size=5)


def table(draw, rows, columns, numbers=NUMBERS):
    values = draw(st.lists(numbers, min_size=rows * columns, max_size=rows * columns))
    return np.array(values).reshape(rows, columns)


@st.composite
def stamps(draw):
    return np.sort(draw(st.lists(NUMBERS, min_size=1, max_size=4)))


@st.composite
def agents(draw):
    t = draw(stamps())
    count = len(t) - draw(st.integers(0, 1 if len(t) > 1 else 0))
    modes = draw(st.lists(st.integers(-(2**63), 2**63 - 1), min_size=count, max_size=count))
    run_times = draw(st.lists(SIZES, max_size=3))
    return AgentTrace(
        t, table(draw, len(t), draw(st.integers(1, 7))), np.array(modes, dtype=np.int64), np.array(run_times)
    )


@st.composite
def sets(draw):
    t, d = draw(stamps()), draw(st.integers(1, 3))
    M = len(t)
    kind = draw(st.sampled_from([PointTrace, BallTrace, RectangleTrace, PolytopeTrace]))
    if kind is PolytopeTrace:
        F = draw(st.integers(1, 4))
        A = table(draw, 1 if draw(st.booleans()) else M, F * d, st.floats(0.5, 2)).reshape(-1, F, d)
        return PolytopeTrace(t, A, table(draw, M, F))
    centers = table(draw, M, d)
    if kind is PointTrace:
        return PointTrace(t, centers)
    if kind is BallTrace:
        velocities = table(draw, M, d) if draw(st.booleans()) else None
        return BallTrace(t, centers, table(draw, M, 1, SIZES)[:, 0], velocities)
    return RectangleTrace(t, centers, table(draw, M, d, SIZES))


TRACES = st.builds(
    Trace,
    st.dictionaries(NAMES, agents(), min_size=1, max_size=3),
    st.dictionaries(NAMES, sets(), max_size=3),
)


@settings(max_examples=30)
@given(TRACES)
def test_written_and_read_is_the_same(tmp_path_factory, trace):
    path = write_trace(tmp_path_factory.getbasetemp() / "round.json", trace, force=True)
    back = read_trace(path)
    assert back.same_as(trace) and trace.same_as(back)
    assert parse_trace(trace_data(trace)).same_as(trace)


def test_same_as_sees_differences():
    t, ones = np.arange(2.0), np.ones((2, 3))
    one = Trace({"a": AgentTrace(t, ones)}, {"b": BallTrace(t, 0 * ones, np.ones(2))})
    sets = [BallTrace(t, 0 * ones, np.array([1, 2.0])), BallTrace(t, 0 * ones, np.ones(2), 0 * ones)]
    others = [Trace(one.agents, {"b": item}) for item in (*sets, PointTrace(t, 0 * ones))]
    others += [Trace({"b": one.agents["a"]}, one.unsafe), Trace(one.agents)]
    others += [Trace({"a": AgentTrace(t, ones + 2e-16 * (ones.cumsum() > 5).reshape(2, 3))}, one.unsafe)]
    assert not any(one.same_as(other) for other in others)


def test_form_is_that_of_rtaeval(tmp_path):
    """Flat rows of agents, nested rows of sets, full lengths, modes as numbers."""
    t = np.array([0.0, 1.0])
    trace = Trace(
        {"a": AgentTrace(t, np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([2, 3]))},
        {
            "p": PointTrace(t[:1], np.array([[1.0, 2.0]])),
            "b": BallTrace(t[:1], np.array([[1.0, 2.0]]), np.array([3.0])),
            "r": RectangleTrace(t[:1], np.array([[1.0, 2.0]]), np.array([[3.0, 4.0]])),
            "h": PolytopeTrace(t, np.array([[[1.0, 0.0]]]), np.array([[5.0], [6.0]])),
        },
    )
    data = json.loads(write_trace(tmp_path / "t.json", trace).read_text(encoding="utf-8"))
    assert data == {
        "agents": {"a": {"state_trace": [[0, 1, 2], [1, 3, 4]], "mode_trace": [2, 3]}},
        "unsafe": {
            "p": {"set_type": "point", "state_trace": [[0, [1, 2]]]},
            "b": {"set_type": "ball", "state_trace": [[0, [[1, 2], 3]]]},
            "r": {"set_type": "rectangle", "state_trace": [[0, [[1, 2], 3, 4]]]},
            "h": {"set_type": "polytope", "state_trace": [[0, [[[1, 0]], [5]]], [1, [[[1, 0]], [6]]]]},
        },
    }


def test_old_file_stays_whole_if_writing_fails(tmp_path):
    path = tmp_path / "t.json"
    path.write_text("old", encoding="utf-8")
    invalid = Trace({"\ud800": AgentTrace(np.zeros(1), np.zeros((1, 1)))})
    with pytest.raises(ScenarioError, match="cannot be written"):
        write_trace(path, invalid, force=True)
    assert path.read_text(encoding="utf-8") == "old"
    assert [item.name for item in tmp_path.iterdir()] == ["t.json"]
    for place in (tmp_path, tmp_path / "none" / "t.json"):
        with pytest.raises(ScenarioError, match="trace"):
            write_trace(place, Trace({"a": AgentTrace(np.zeros(1), np.zeros((1, 1)))}))
