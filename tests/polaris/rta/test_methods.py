"""Every method on the same scenes: what is proven holds under worst cases, and the tests can fail."""

import re
from pathlib import Path
from textwrap import dedent

import numpy as np
import pytest

from polaris.model.errors import ScenarioError
from polaris.rta.arena import tunable
from polaris.rta.flight import Conditions, fly
from polaris.rta.method import FILTERED
from polaris.rta.method_result import measure
from polaris.rta.methods import METHODS
from polaris.rta.methods.asif_explicit import ExplicitASIF
from polaris.rta.methods.asif_implicit import ImplicitASIF
from polaris.rta.methods.monitor import Monitor
from tests.polaris.rta.scenes import COMPILED, MADE, scene

BUFFERED = [key for key, one in METHODS.items() if any(option.name == "buffer" for option in one.options)]
PROVED = ("safety", "schedule", "monitor", "monitor_declared", "simplex_explicit", "asif_implicit", *COMPILED)
SETTINGS = {
    "chosen": {},
    "given": {"feedback": 0.1, "period": 0.5},
    "anything": {"unknown": True, "feedback": 0.1, "period": 0.1},
    "late": {"feedback": 0.125, "period": 0.25, "latency": 0.125},
    "whole period late, estimated": {"period": 0.25, "latency": 0.25, "half": 0.01},
    "slow": {"period": 0.5, "half": (0.02, 0.02, 0.005, 0.005)},
    "robot": {"name": "robot"},
    "robot late, estimated": {"name": "robot", "period": 0.25, "latency": 0.05, "half": 0.005},
}

DEFAULT = ("anything", "whole period late, estimated")


def flights(setting, keys, runs=12, seed=3):
    grid = scene(**SETTINGS[setting])
    conditions = Conditions.draw(grid, runs, seed)
    for key in keys:
        method = METHODS[key](grid)
        flight = fly(grid, method, conditions)
        yield key, method, flight, measure(grid, flight, conditions, method.name)


@pytest.mark.parametrize(
    "setting", [pytest.param(one, marks=[pytest.mark.slow] * (one not in DEFAULT)) for one in SETTINGS]
)
def test_what_is_proved_keeps_clear_and_within_the_thrust_limits(setting):
    for key, method, _, metrics in flights(setting, PROVED):
        assert method.claim.kind == "proved", key
        assert not metrics.collided.any(), key
        assert metrics.min_distance.min() > 0, key
        # S must never be asked for more than there is: that is what recoverable means.
        ratios = metrics.max_thrust_ratio_safety
        assert np.nanmax(np.append(ratios, 0.0)) <= 1 + 1e-9, key


@pytest.mark.parametrize("setting", ["chosen", pytest.param("robot", marks=pytest.mark.slow)])
def test_u_alone_does_collide(setting):
    (_, method, _, metrics), *_ = flights(setting, ["experimental"])
    assert method.claim.kind == "none"
    assert metrics.collided.all() and metrics.min_distance.max() < 0


def test_a_buffer_removes_what_look_ahead_hits():
    """The one thing that it lacks on this scene, and no proof: S may not take over for all that."""
    grid, hits = scene("robot"), []
    conditions = Conditions.draw(grid, 12, 3)
    for buffer in (0.0, 0.1):
        method = METHODS["simplex_implicit"](grid, buffer=buffer)
        hits.append(measure(grid, fly(grid, method, conditions), conditions, "rival").collided.sum())
    assert hits[0] > 0 == hits[1]


SLOW = "reachability", "simulation"


@pytest.mark.parametrize(
    "key", [pytest.param(key, marks=[pytest.mark.slow] * (key in SLOW)) for key in BUFFERED]
)
def test_a_keep_clear_buffer_keeps_rivals_further_away(key):
    """From boxes, walls and balls alike; what is proven stays proven."""
    grid = scene("robot")
    conditions = Conditions.draw(grid, 12, 3)
    least, shares, kind = [], [], "proved" if key in PROVED else "none"
    for buffer in (0.0, 0.08):
        method = METHODS[key](grid, buffer=buffer)
        assert method.settings["buffer"] == buffer and method.claim.kind == kind
        metrics = measure(method.grid, fly(method.grid, method, conditions), conditions, key)
        least.append(metrics.min_distance.min())
        shares.append(metrics.experimental_share.mean())
        assert key not in PROVED or not metrics.collided.any()
    assert least[1] > least[0] + 0.02 and shares[1] < shares[0]


def test_same_conditions_give_the_same_flights_whatever_flies_beside():
    grid = scene("robot", period=0.25, half=0.005)
    conditions = Conditions.draw(grid, 2, 5)
    for key, make in MADE.items():
        both, alone = (fly(grid, make(grid), each) for each in (conditions, conditions.only(1)))
        assert np.allclose(both.states[1], alone.states[0], atol=1e-7), key
    assert not np.array_equal(conditions.w, Conditions.draw(grid, 2, 6).w)


def test_monitor_uses_u_more_than_the_schedule_and_far_more_than_the_explicit_simplex():
    keys, share = ["schedule", "monitor", "simplex_explicit", "simplex_implicit"], {}
    for key, _, flight, metrics in flights("robot", keys):
        share[key], under_s = metrics.experimental_share.mean(), flight.modes == 0
        if "simplex" in key:  # which latches
            assert (np.diff(under_s.astype(int), axis=1) >= 0).all() and under_s.any() and not under_s.all()
    assert share["monitor"] > share["schedule"] > 2 * share["simplex_explicit"] > 0


def test_filters_answer_within_the_limits_and_change_as_little_as_they_can():
    for key, method, flight, _ in flights("robot", ["asif_explicit", "asif_implicit"]):
        grid = scene("robot")
        limit = grid.system.u_max
        assert (np.abs(flight.inputs) <= limit * (1 + 1e-12)).all(), key
        passed = (np.repeat(flight.why, grid.nodes, axis=1) == 0) & (flight.modes == FILTERED)
        assert passed.any(), key
        run, node = (int(one) for one in np.argwhere(passed)[0])
        desired = grid.clipped(1, node, flight.states[run, node])
        assert flight.inputs[run, node] == pytest.approx(desired, abs=1e-8), key
        assert method.reasons[0] == "desired input"


def test_dwell_keeps_s_in_control():
    grid = scene("robot")
    conditions = Conditions.draw(grid, 8, 1)
    quick, slow = (fly(grid, Monitor(grid, dwell=dwell, reentry=0.0), conditions).modes for dwell in (1, 20))
    for modes in slow:
        edges = np.flatnonzero(np.diff(np.concatenate([[1], modes[:-1]])))  # of stretches under S
        assert min(edges[1::2] - edges[: len(edges) // 2 * 2 : 2], default=20) >= 20
    assert np.abs(np.diff(slow)).sum() < np.abs(np.diff(quick)).sum()


def test_a_gentle_implicit_filter_is_as_safe_and_bends_inputs_earlier():
    grid, firsts = scene("robot", half=0.005), []
    conditions = Conditions.draw(grid, 8, 2)
    for method in (ImplicitASIF(grid), ImplicitASIF(grid, slope=0.05)):
        flight = fly(grid, method, conditions)
        metrics = measure(grid, flight, conditions, method.name)
        assert not metrics.collided.any()
        assert np.nanmax(np.append(metrics.max_thrust_ratio_safety, 0.0)) <= 1 + 1e-9
        firsts.append((flight.why != 0).argmax(axis=1))  # the first decision that is not the desired input
    assert (firsts[1] <= firsts[0]).all() and (firsts[1] < firsts[0]).any()


@pytest.mark.parametrize("buffer", [0.0, 0.5])
def test_the_implicit_filter_is_bound_by_a_tight_limit_at_its_own_time_alone(buffer, monkeypatch):
    """Limits beyond the near ones, bounded quickly by the tightest of all times, decide as if worked out."""
    grid = scene("corridor", feedback=0.1, period=0.5)  # with a buffer of 0.5 m it is closed at the crate
    conditions, reasons = Conditions.draw(grid, 6, 4), []
    for near in (10**9, 1):
        monkeypatch.setattr("polaris.rta.recovery.NEAR", near)
        method = ImplicitASIF(grid, buffer=buffer)
        reasons.append(fly(grid, method, conditions).why)
    assert method.prospect.demand.near < len(method.prospect.demand.tall)
    assert np.array_equal(*reasons) and (reasons[0] != 2).any()


@pytest.mark.parametrize(
    ("method", "wrong"),
    [
        (Monitor, {"trust": "blind"}),
        (Monitor, {"dwell": 0}),
        *((Monitor, {"reentry": reentry}) for reentry in (-0.1, 1.0, np.nan)),
        (ExplicitASIF, {"alpha": -1.0}),
        *((ImplicitASIF, {"slope": slope}) for slope in (0.0, 1.5, np.nan)),
        *((METHODS[key], {"buffer": -0.1}) for key in BUFFERED),
    ],
)
def test_options_are_checked(method, wrong):
    with pytest.raises(ScenarioError, match=next(iter(wrong))):
        method(scene("robot"), **wrong)


def test_u_is_not_trusted_unless_that_is_asked_for():
    grid = scene("robot")
    default = Monitor(grid)
    assert (default.key, default.trust) == ("monitor", "thrust_limits")
    assert {mode for mode, _ in default.prospects} == {0}
    trusting = METHODS["monitor_declared"](grid)
    assert (trusting.key, trusting.trust) == ("monitor_declared", "declared")
    assert {mode for mode, _ in trusting.prospects} > {0}
    assert "nothing but its thrust limits" in METHODS["monitor"](grid).claim.reach


def test_no_limit_is_left_out_however_late_it_is():
    """All limits worked out one by one: none needs a larger share of its room than is told."""
    recovery = Monitor(scene("robot")).recovery
    system, W = recovery.grid.system, recovery.grid.tracking.W
    demand, late = recovery.demand(np.zeros((system.n, 1))), 0
    errors = np.random.default_rng(0).normal(size=(40, system.n)) * np.geomspace(0.01, 1, 40)[:, None]
    size = np.linalg.norm(errors @ W.T, axis=1)
    tightening = np.column_stack([errors, size]) @ recovery.matrix.T + recovery.tightening
    for node in range(0, recovery.grid.last, 20):
        limits = recovery.window(node)
        shares = np.where(
            limits > 0, tightening / np.where(limits > 0, limits, 1.0), np.where(tightening > 0, np.inf, 0.0)
        )
        share, near = recovery.share(node, errors, size, demand), shares[:, : demand.near].max(axis=1)
        assert np.all(np.minimum(shares.max(axis=1), 1e3) <= share * (1 + 1e-9))
        late += np.count_nonzero(shares.max(axis=1) > near * (1 + 1e-6))
    assert late > 0


def test_the_recipe_for_a_method_makes_one():
    """The class in ``CONTRIBUTING.md`` registers, is tuned and flies; it is taken out again."""
    text = (Path(__file__).parents[3] / "CONTRIBUTING.md").read_text(encoding="utf-8")
    recipe = re.search(r"^## Add a run-time method$.*?^ *```python\n(.*?)^ *```$", text, re.M | re.S)
    registered = dict(METHODS)
    try:
        exec(dedent(recipe[1]), {"__name__": "polaris.rta.methods.early"})
        assert set(METHODS) - set(registered) == {"early"} and "early.share" in tunable()
        grid = scene(**SETTINGS["chosen"])
        flight = fly(grid, METHODS["early"].on(grid, share=0.25), Conditions.draw(grid, 2, 0))
        assert np.mean(flight.modes > 0) == pytest.approx(0.25, abs=1 / grid.decisions)
        assert (np.diff(flight.modes) <= 0).all()
    finally:
        METHODS.clear()
        METHODS.update(registered)
