"""Values that no filter may stumble over, and conditions on every answer."""

import numpy as np
from hypothesis import strategies as st

from tests.polaris.rta import oddities

ODD = [np.nan, np.inf, -np.inf, 0.0, -0.0, 1e308, -1e308, 1e-308, 1e7, -1e6, 1.0]


def numbers(size):
    return st.floats(-size, size) | st.sampled_from(ODD)


def tables(rows, columns, size):
    row = st.lists(numbers(size), min_size=columns, max_size=columns)
    return st.lists(row, min_size=rows, max_size=rows).map(np.array)


def calls(deputies, most=4):
    """Sequences of (time step, states, desired inputs)."""
    call = st.tuples(
        st.sampled_from([1.0, 0.0, 0.5, 30.0, 1e5, -10.0]),
        tables(deputies, 6, 1000.0),
        st.none() | tables(deputies, 3, 3.0),
    )
    return st.lists(call, min_size=1, max_size=most)


def answers(filtering, sequence, planned=False):
    """Ask one after another; what every answer must satisfy. Where there are plans, they go on unseen."""
    q = filtering.inspection
    t, decisions = 0.0, []
    for step, x, u in sequence:
        t += step
        decision = filtering.filter(t, x, u)
        assert decision.u.shape == (q.deputies, 3) and np.isfinite(decision.u).all()
        assert (np.abs(decision.u) <= q.thrust_max).all()
        assert decision.intervened.shape == (q.deputies,)
        assert decision.status in {"desired", "filtered", "short", "backup", "coast"}
        valid = np.isfinite(x).all(axis=1) & (np.abs(x) <= 1e6).all(axis=1)
        assert decision.on_backup[~valid].all() if planned else not decision.u[~valid].any()
        if not valid.all() or u is None or not np.isfinite(u).all():
            assert decision.fallback
        finite = np.zeros(q.deputies, dtype=bool) if u is None else np.isfinite(u).all(axis=1)
        assert decision.intervened[~finite | ~valid].all()
        if u is not None:
            same = ~decision.intervened
            np.testing.assert_array_equal(decision.u[same], u[same])
        decisions.append(decision)
    return decisions


class Unreadable:
    """A time whose conversion raises what no one expects."""

    def __float__(self):
        raise RuntimeError("needs a gradient")


ODD_TIMES = [
    np.nan,
    np.inf,
    -np.inf,
    None,
    "now",
    "3.0",
    10**400,
    1j,
    [1.0, 2.0],
    Unreadable(),
    oddities.NeedsGradient(),
]
"""No time at all; whatever is handed over, a filter answers."""


def odd_times(filtering, x, u):
    """Times that are none, stand still, run backwards and jump: answered, and each is told."""

    def ask(t):
        decision = filtering.filter(t, x, u)
        assert np.isfinite(decision.u).all() and (np.abs(decision.u) <= filtering.inspection.thrust_max).all()
        return decision.fallback or ""

    def told(t):
        """Return the sentences about the clock."""
        return [part for part in ask(t).split("; ") if part.startswith(("the time", "called after"))]

    for first in (np.nan, None):
        assert told(first) == ["the time is not a finite number: taken for 0 s"]
    assert told(5.0) in (["called after 5 s: the last answer was for 1 s"], [])  # where a period is known
    assert told(6.0) == [] and told(6.0) == ["the time stands still"] and told(7.0) == []
    for k, odd in enumerate(ODD_TIMES):
        assert told(odd) == [f"the time is not a finite number: taken for {8 + k} s"]
    assert told(8.0 + len(ODD_TIMES)) == []
    assert told(3.5) == [f"the time runs backwards by {4.5 + len(ODD_TIMES):g} s"]
    assert told(4.5) == [] and told(1e9) == [f"the time jumps by {1e9 - 4.5:g} s"]
    assert told(-1e300)[0].startswith("the time runs backwards")
    assert told(1e300)[0].startswith("the time jumps")


SHAPES = [np.zeros((1, 6)), np.zeros(6), np.zeros((3, 3)), np.zeros(3), [["a"] * 6] * 2]


def malformed(filtering):
    """Whatever a primary controller or navigation hands over, there is an answer that says so."""
    q = filtering.inspection
    good, t = np.array([[100.0, 0, 0, 0, 0, 0], [0.0, -120, 0, 0, 0, 0]]), 0.0
    odd = [value for name, value in oddities.unreadable(2).items() if name != "too many"] + SHAPES
    for value in odd:
        for x, u in ((good, value), (value, np.zeros((2, 3)))):
            if x is None:
                continue
            decision = filtering.filter(t, x, u)
            t += 1.0
            assert np.isfinite(decision.u).all() and (np.abs(decision.u) <= q.thrust_max).all()
            assert decision.fallback and decision.intervened.all()
            if x is not good:
                assert decision.fallback.startswith("the states are malformed: ")
                assert "state not known: deputy 0, 1" in decision.fallback
            elif u is not None:
                assert decision.fallback.startswith("the desired input is malformed: ")
