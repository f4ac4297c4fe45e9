"""Filters with a backup for all time: the way back from outside, late calls, lost states, refusals."""

from functools import partial
from inspect import signature

import numpy as np
import pytest

from polaris.inspection.backup.all_time import AllTime
from polaris.inspection.backup.brake import Brake
from polaris.inspection.backup.planner import BackupPlanner
from polaris.inspection.backup.tube import Uncertainty
from polaris.inspection.constraints.allowable_set import allowable
from polaris.inspection.constraints.families import Families
from polaris.inspection.constraints.motion import SampledData
from polaris.inspection.constraints.strengthening import PRESETS
from polaris.inspection.filters.asif import ActiveSetFilter
from polaris.inspection.filters.assured import Explicit, Implicit
from polaris.inspection.filters.build import OPTIONS, build_filter
from polaris.inspection.filters.explicit import Centralized, Decentralized, make_filter
from polaris.inspection.filters.member import Member
from polaris.inspection.filters.simplex import SimplexExplicit
from polaris.inspection.inspection import Inspection
from polaris.model import compiled
from polaris.model.errors import ScenarioError
from tests.polaris.inspection.test_always import KINDS, Q, drawn, make
from tests.sizes import fewer

ONE, TWO = Inspection(deputies=1), Inspection(deputies=2)
ANGLE = np.pi / 6 - 5 / 300
FROM = {
    "cone": ([[-300 * np.cos(ANGLE), 300 * np.sin(ANGLE), 0, 0, 0, 0]], "phi4"),
    "zone": ([[0, 0, 1005, 0, 0, 0]], "phi6"),
    "speed": ([[0, -300, 200, 0, 0.75, 0.85]], "phi3"),
    "pair": ([[0, -300, 300, 0, 0, 0.25], [0, -300, 309.5, 0, 0, 0.2]], "phi2"),
    "free flight": ([[0, -60, 20, -0.0606, 0.2348, -0.0782]], None),
}


def plain(q, period=1.0):
    return Centralized(Families(q, "linear", sampled=SampledData(period)))


def back(f, q, x, desired, limit):
    """States and answers until a plan is proven, and for ten periods more."""
    x, steps, proven = np.array(x, dtype=float), [], 0
    Phi, Gamma = q.discretize(1.0)
    for k in range(limit):
        answer = f.filter(float(k), x, desired)
        steps.append((x, answer))
        x = x @ Phi.T + answer.u @ Gamma.T
        proven = 0 if answer.unproven else proven + 1
        if proven == 10:
            return steps
    raise AssertionError(f"not proven after {limit} s: {answer.fallback}")


@pytest.mark.parametrize(("kind", "name"), list(zip([*KINDS, "explicit"], FROM, strict=True)))
def test_every_kind_comes_back_from_outside_and_is_proven_then(kind, name):
    """5 m inside the sun's cone they braked and stayed, 600 of 600 periods unproven."""
    x, violated = FROM[name]
    q = (ONE, TWO)[len(x) - 1]
    if violated:
        assert allowable(q, np.array(x, dtype=float), 0.0)[violated].min() < 0
    steps = back(make(kind, q), q, x, np.zeros((len(x), 3)), 300)
    last = allowable(q, steps[-1][0], q.sun_angle(len(steps) - 1.0))
    assert min(values.min(initial=np.inf) for values in last.values()) >= 0
    assert steps[0][1].unproven and "no plan is known" in steps[0][1].fallback
    unproven = [answer.unproven for _, answer in steps]
    assert unproven == sorted(unproven, reverse=True)  # once proven, for good


@pytest.mark.parametrize("kind", KINDS)
def test_where_no_plan_is_proven_the_answer_is_the_plain_filters(kind, monkeypatch):
    monkeypatch.setattr(compiled, "is_enabled", lambda: False)
    rng, count = np.random.default_rng(4), 0
    for _ in range(fewer(20, 12)):
        x = rng.uniform(-1, 1, (2, 6)) * np.repeat([900.0, 0.8], 3)
        f, desired = make(kind, TWO), rng.uniform(-1.5, 1.5, (2, 3))
        answer = f.filter(0.0, x, desired)
        if answer.unproven:
            count += 1
            barrier = ActiveSetFilter(plain(TWO, 1.0 if kind == "explicit" else 1.004))
            expected = barrier.filter(0.0, x, desired)
            assert np.array_equal(answer.u, expected.u) and answer.missed == expected.missed
            batch = f.recovery.filtering.batch(x[None], np.zeros(1), desired[None])
            assert np.array_equal(batch.u[0], answer.u) or expected.status == "backup"
    assert count > fewer(5, 3)


@pytest.mark.parametrize("period", [0.2, 1.0, 2.0, 5.0])
def test_without_a_state_a_plan_is_proven_only_while_it_is_surely_within_its_tube(period):
    """Held without feedback it left the tube after 36, 42 and 100 s at 1, 2 and 5 s, called proven."""
    f = make("implicit", ONE, period)
    x, (Phi, Gamma) = (f.brake.resting @ np.array([0.0, -960, 0]))[None], ONE.discretize(period)
    unproven, no_state = [], np.full((1, 6), np.nan)
    for k in range(round(80 / period)):
        plan = f.plan
        answer = f.filter(k * period, x if k < 3 else no_state, np.zeros((1, 3)))
        if not answer.unproven and plan is not None:
            assert (off_plan(x - plan.plan[0]) <= plan.tube[0, 0]).all()
        unproven.append(answer.unproven)
        x = x @ Phi.T + answer.u @ Gamma.T
    memory = round(60 / period) + 3  # periods until a minute has passed since the state was known
    assert not any(unproven[: memory - 1]) and all(unproven[memory + 1 :])
    recovered = f.filter(k * period + period, x, np.zeros((1, 3)))
    assert not recovered.unproven  # it is known again


def off_plan(error):
    return np.linalg.norm(error.reshape(2, 3), axis=1)


@pytest.mark.parametrize(
    ("kind", "period", "tau"), [*((kind, 1.0, 5e-2) for kind in KINDS), ("implicit", 2.0, 1e-2)]
)
def test_states_lost_under_jitter_do_not_end_the_proof(kind, period, tau):
    """Each deputy is within the tube about its plan at instants between the samples, too."""
    q, rng = TWO, np.random.default_rng(3)
    f = make(kind, q, period, unknown=Uncertainty(jitter=tau))
    x = np.array([[0, -300.0, -400, 0, 0, 0], [50.0, -300, 300, 0.1, 0, 0]])
    lost, late, count = np.zeros(2, dtype=bool), 0.0, 0
    for k in range(round(40 / period)):
        t, desired = k * period + late, np.full((2, 3), (-1.0) ** (k * period // 3))
        lost = (k > 2) & np.where(lost, rng.random(2) < np.exp(-period / 4), rng.random(2) < 0.3)
        answer = f.filter(t, np.where(lost[:, None], np.nan, x), desired)
        assert not answer.unproven, (k, answer.fallback)
        count += lost.sum()
        late = 0.49 * tau * rng.choice([-1, 1])
        hold = (k + 1) * period + late - t
        assert f.plan is not None
        for part in (0.25, 0.5, 0.75, 1.0):
            Phi, Gamma = q.discretize(part * hold)
            at = x @ Phi.T + answer.u @ Gamma.T
            phi = allowable(q, at, q.sun_angle(t + part * hold))
            assert min(values.min(initial=np.inf) for values in phi.values()) >= 0
        Phi, Gamma = q.discretize(f.plan.t - t)
        due = x @ Phi.T + answer.u @ Gamma.T - f.plan.plan[0]
        assert all((off_plan(due[i]) <= f.plan.tube[0, i] + 1e-9).all() for i in range(2))
        x = at
    assert count > 20 / period


@pytest.mark.parametrize("broken", ["late", "untimed", "no motion known", "off its plan"])
def test_a_lost_state_follows_from_the_last_one_only_while_everything_is_as_assumed(broken):
    x, t = np.array([[0, -300.0, -400, 0, 0, 0], [0, -300, 300, 0.1, 0, 0]]), 2.0
    f = make("implicit", TWO, unknown=Uncertainty(disturbance=1e-6 * (broken == "no motion known")))
    mask, (Phi, Gamma) = np.where([[False], [True]], np.nan, 1.0), TWO.discretize(1.0)
    for k in range(2):
        x = x @ Phi.T + f.filter(float(k), x, np.zeros((2, 3))).u @ Gamma.T
    if broken == "untimed":
        f.filter(np.nan, x, np.zeros((2, 3)))
        t = 3.0
    x = x + (0.1 if broken == "off its plan" else 0.0)
    for instant in (t + (0.01 if broken == "late" else 0.0), t + 1, t + 2):
        assert f.filter(instant, x * mask, np.zeros((2, 3))).unproven


def test_a_member_knows_where_it_is_without_a_state():
    """It flew on without feedback, and was unproven as soon as its error grew."""
    x = np.array([[0, -300.0, -400, 0, 0, 0], [50.0, -300, 300, 0.1, 0, 0]])
    members = [Member(i, make("implicit", TWO, mixed=True), 0.0, x) for i in range(2)]
    Phi, Gamma = TWO.discretize(1.0)
    for k in range(75):
        estimates = x if k < 5 else np.full((2, 6), np.nan)
        sent = [one.message(estimates[i], np.full(3, (-1.0) ** k)) for i, one in enumerate(members)]
        plans = [one._plan for one in members]
        u = [one.decide(float(k), sent) for one in members]
        assert [one.unproven for one in members] == [k > 64] * 2
        for i, plan in enumerate(plans):
            assert k < 5 or k > 64 or (off_plan(x[i] - plan.plan[0]) <= plan.tube[0, 0] + 1e-9).all()
        x = x @ Phi.T + np.array(u) @ Gamma.T


@pytest.mark.parametrize("kind", KINDS)
def test_what_begins_with_a_state_that_was_never_known_is_not_proven(kind):
    """From the second call on it was: beside a chief that is no obstacle zeros are a place to hold."""
    left_out = ("chief_separation", "passive", "sun", "deputy_separation", "deputy_passive", "deputy_sun")
    f = build_filter(kind, TWO, without=left_out)
    states = np.array([[0, -300, -400, 0, 0, 0], [0, -300, 300, 0, 0, 0.0]])
    partial = np.where([[False], [True]], np.nan, states)
    assert all(f.filter(float(k), partial, np.zeros((2, 3))).unproven for k in range(70))
    assert not f.filter(70.0, states, np.zeros((2, 3))).unproven


@pytest.mark.parametrize("kind", KINDS)
def test_a_call_at_an_unknown_time_is_not_proven(kind):
    """It was, however often: the sun may be anywhere by then, and how long thrust was held is not known."""
    f, x = build_filter(kind, ONE), np.array([[0, -300.0, 400, 0, 0, 0]])
    flags = [f.filter(t, x, np.zeros((1, 3))).unproven for t in (0.0, 1.0, np.nan, np.nan, np.inf, "5", 6.0)]
    assert flags == [False, False, True, True, True, True, False]


def test_later_than_declared_drops_the_plan():
    x, sun = (values[0] for values in drawn(1))
    for jitter, late, has_plan in ((0, 1e-3, 0), (2e-3, 1.9e-3, 1), (2e-3, 2.1e-3, 0), (5e-3, -4.5e-3, 1)):
        f = make("implicit", sun=sun, unknown=Uncertainty(jitter=jitter))
        answer, (Phi, Gamma) = f.filter(0.0, x, np.zeros((5, 3))), Q.discretize(1.0 + late)
        call = f._receiver.receive(1.0 + late, x @ Phi.T + answer.u @ Gamma.T, None)
        assert not answer.unproven and (f._kept(call, [])[1] is not None) == has_plan


WRONG = {
    "a name": lambda p: Explicit(p, "centralized"),
    "more deputies": lambda p: Explicit(p, plain(Inspection(deputies=3))),
    "longer period": lambda p: Explicit(p, plain(TWO, 2.0)),
    "shorter period": lambda p: Implicit(p, plain(TWO, 0.5)),
    "other problem": lambda p: SimplexExplicit(p, Families(Inspection(deputies=2, mass=11.0))),
    "no families": lambda p: SimplexExplicit(p, "linear"),
    "no planner": lambda p: Implicit(p.check),
    "no check": lambda p: BackupPlanner(p.brake),
    "no brake": lambda p: AllTime(TWO),
    "no filter": lambda p: ActiveSetFilter(plain(TWO).families),
    "no families of one": lambda p: Centralized(TWO),
    "no families of two": lambda p: Decentralized(TWO),
    "no rule": lambda p: Member(0, p, 0.0, np.zeros((2, 6))),
    "wrong shape": lambda p: Member(0, Implicit(BackupPlanner(p.check, mixed=True)), 0.0, np.zeros((3, 6))),
    "two periods": lambda p: build_filter("explicit", TWO, 2.0, brake=p.brake),
    "two bounds": lambda p: build_filter("implicit", TWO, uncertainty=Uncertainty(1.0), brake=p.brake),
    "one of all": lambda p: build_filter("decentralized", TWO, sharing="centralized"),
    "all of one": lambda p: build_filter("centralized", TWO, sharing="half"),
    "no plans": lambda p: build_filter("centralized", TWO, mixed=True),
    "other brake": lambda p: build_filter("centralized", ONE, brake=p.brake),
    "a letter": lambda p: build_filter("explicit", TWO, without="sun"),
    "no alpha": lambda p: build_filter("explicit", TWO, strengthening={}),
    "alpha of none": lambda p: build_filter("explicit", TWO, strengthening=PRESETS["linear"] | {"sn": 1}),
    "no thrusters": lambda p: Brake(TWO, 1.0, Uncertainty(thrusters=0.1)),
    "many looks": lambda p: build_filter("simplex_explicit", TWO, looks=10**6),
    "four axes": lambda p: Brake(TWO, 1.0, Uncertainty(position=(1, 2, 3, 4))),
    "too much jitter": lambda p: Brake(TWO, 1.0, Uncertainty(jitter=0.6)),
    "too uncertain": lambda p: Brake(TWO, 1.0, Uncertainty(position=100.0)),
    "a negative period": lambda p: Brake(TWO, -1.0),
    "a negative bound": lambda p: Uncertainty(velocity=-0.1),
}


@pytest.mark.parametrize("make_one", WRONG.values(), ids=WRONG)
def test_what_cannot_work_is_refused_when_it_is_made(make_one):
    with pytest.raises(ScenarioError, match="must|needs"):
        make_one(BackupPlanner(AllTime(Brake(TWO))))


NAMED = [name for name in signature(build_filter).parameters if name not in ("kind", "inspection", "options")]
ILL = ["x", object(), np.nan, {"a": 1}, 10**400, np.array([[1.0], [2.0]])]


@pytest.mark.parametrize("kind", [*OPTIONS])
def test_every_option_is_checked_and_named(kind):
    """An unknown option, one too many and some of another type ended in a bare TypeError."""
    for name in (*NAMED, *OPTIONS[kind]):
        for value in ILL:
            with pytest.raises(ScenarioError, match=rf"^{name}[:.]"):
                build_filter(kind, TWO, **{name: value})
    of_others = {name for names in OPTIONS.values() for name in names} - {*OPTIONS[kind]}
    for name in (*of_others, "planner", "filtering", "families", "recovery", "perod"):
        with pytest.raises(ScenarioError, match=f"^{name}: .*no option of '{kind}'.* period, "):
            build_filter(kind, TWO, **{name: 1.0})
    cls = type(build_filter(kind, TWO, brake=Brake(TWO)))
    declared = {*signature(cls).parameters} - {"planner", "filtering", "families", "recovery", "sun_start"}
    assert declared == {*OPTIONS[kind]}


@pytest.mark.parametrize("sharing", ["centralized", "coasting", "consensus"])
@pytest.mark.parametrize("loops", [True, False])
def test_shapes_are_checked_at_the_door(sharing, loops, monkeypatch):
    """Handed two deputies or four, a filter for three read out of bounds, or passed everything."""
    monkeypatch.setattr(compiled, "is_enabled", lambda: loops)
    f, codes = make_filter(Families(Inspection(deputies=3), "linear", sampled=SampledData(1.0)), sharing), []
    p = [[0, -300, 300.0], [0, -300, -300], [200, 0, 300], [-200, 300, 0]]
    x = np.hstack([p, np.zeros((4, 3))])
    ask = partial(f.batch, sun=np.zeros(1))
    for count, inputs in ((2, 2), (4, 4), (3, 2), (3, 4)):
        with pytest.raises(ScenarioError, match="must have shape"):
            ask(x[None, :count], desired=np.ones((1, inputs, 3)))
    with pytest.raises(ScenarioError, match="must have shape"):
        ask(x[:3], desired=np.ones((3, 3)))
    for states in (
        np.full((1, 3, 6), np.nan),
        np.where(np.arange(18).reshape(1, 3, 6) == 7, np.nan, x[None, :3]),
    ):
        answer = ask(states, desired=np.ones((1, 3, 3)))
        codes.append(answer.status.tolist())
        assert np.isnan(answer.u).any()  # no answer, and said so
    assert codes[0] == [[3, 3, 3]] and 3 in codes[1][0]
