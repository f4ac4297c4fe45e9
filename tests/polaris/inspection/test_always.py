"""Filters that always have a proven answer: what they claim holds, whoever flies and whatever is measured."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings

from benchmarks import harsh
from benchmarks.harsh import Harsh
from polaris.inspection.backup.all_time import AllTime
from polaris.inspection.backup.brake import Brake
from polaris.inspection.backup.planner import BackupPlanner
from polaris.inspection.backup.tube import Uncertainty
from polaris.inspection.constraints.allowable_set import allowable
from polaris.inspection.constraints.families import Families
from polaris.inspection.constraints.motion import SampledData
from polaris.inspection.filters.assured import Explicit, Implicit
from polaris.inspection.filters.build import build_filter
from polaris.inspection.filters.explicit import Centralized, Decentralized
from polaris.inspection.filters.member import Member
from polaris.inspection.filters.simplex import SimplexExplicit, SimplexImplicit
from polaris.inspection.flights.sampling import InitialConditions
from polaris.inspection.inspection import Inspection
from polaris.model.errors import ScenarioError
from polaris.model.hill import free_flight
from polaris.model.thrusters import Thrusters
from polaris.rta.one_call import Decision
from tests.polaris.inspection.garbage import answers, calls, malformed, odd_times
from tests.sizes import fewer

Q = Inspection()
TWO = Inspection(deputies=2)
ERRORS = Thrusters.from_errors(0.002, np.deg2rad(0.1), 0.001, 0.0005, 3)
BAD = Uncertainty(0.05, 0.002, 1e-5, ERRORS)
KINDS = ("explicit", "implicit", "simplex_explicit", "simplex_implicit")


@cache
def drawn(count):
    """States and sun angles of the paper's Monte Carlo."""
    return InitialConditions(Families(Q, "linear", exact=True), seed=3).first(count)


def make(kind, q=Q, period=1.0, sun=0.0, unknown=None, sharing="centralized", mixed=False):
    planner = BackupPlanner(AllTime(Brake(q, period, unknown), sun), mixed)
    if kind in ("implicit", "simplex_implicit"):
        return (Implicit if kind == "implicit" else SimplexImplicit)(planner)
    if kind == "simplex_explicit":
        return SimplexExplicit(planner, Families(q, "linear"))
    families = Families(q, "linear", sampled=SampledData(period))
    if sharing == "centralized":
        return Explicit(planner, Centralized(families))
    return Explicit(planner, Decentralized(families, sharing))


def navigation(unknown, mode):
    """Errors at the edge of their bounds: `bias` for ever, `flip` each period, or turned against safety."""
    signs = np.random.default_rng(0).choice([-1.0, 1.0], (5, 6))

    def seen(k, x):
        if mode == "against":  # farther from the neighbour, and slower, than is true
            return x + unknown.estimate * np.sign(
                np.hstack([x[:, :3] - np.roll(x[:, :3], -1, axis=0), -x[:, 3:]])
            )
        return x + unknown.estimate * signs * (-1.0 if mode == "flip" else 1.0) ** k

    return seen


def fly(f, x, sun, primary, seconds, unknown=None, estimate=None):
    """Least value of every constraint, also between samples; answers that are not proven; statuses."""
    q, unknown, statuses = f.inspection, unknown or Uncertainty(), []

    def decide(t, at):
        desired = primary(t, at)
        decision = f.filter(t, at if estimate is None else estimate(round(t / f.period), at), desired)
        statuses.append(decision.status)
        direction = desired / np.maximum(np.linalg.norm(desired, axis=1, keepdims=True), 1e-9)
        missed = unknown.thrusters.error(decision.u) * np.sign(desired)
        return decision, decision.u + missed + unknown.disturbance * q.mass * direction

    return *harsh.fly(q, f.period, x, sun, seconds, decide)[:2], statuses


@pytest.mark.parametrize("period", [0.2, 1.0, 2.0])
def test_plans_end_at_rest_within_the_thrust_and_are_flown_exactly(period):
    brake = Brake(Q, period)
    Phi, Gamma = brake.motion
    for x in drawn(10)[0]:
        toward = x[:, :3] / np.linalg.norm(x[:, :3], axis=1, keepdims=True)
        for plan in (brake.plan(x), brake.plan(x, toward, shift=-20 * toward)):
            u = brake.thrusts(plan)
            assert np.abs(u).max() <= 1.02  # a guess, which the check decides on
            np.testing.assert_allclose(plan[1:], plan[:-1] @ Phi.T + u @ Gamma.T, atol=1e-6)
            np.testing.assert_allclose(plan[-1] @ brake.to_rest.T, 0.0, atol=1e-12)
        shifts = brake.plan(x, shift=-20 * toward)[-1] - brake.extended(brake.plan(x), len(plan))[-1]
        assert (np.linalg.norm(shifts[:, :3], axis=1) > 15).all()


UNKNOWN = {
    "all": BAD,
    "velocity": Uncertainty(velocity=(0.01, 0.002, 0.0)),
    "disturbance": Uncertainty(disturbance=1e-4),
    "magnitude": Uncertainty(thrusters=Thrusters.from_errors(0.05, 0, 0, 0, 3)),
    "misalignment": Uncertainty(thrusters=Thrusters.from_errors(0, np.deg2rad(1), 0, 0, 3)),
    "mass": Uncertainty(thrusters=Thrusters.from_errors(0, 0, 0.03, 0, 3)),
    "bit": Uncertainty(thrusters=Thrusters.from_errors(0, 0, 0, 0.01, 3)),
}


@pytest.mark.parametrize(("name", "period"), [*((name, 2.0) for name in UNKNOWN), ("all", 1.0)])
def test_no_errors_leave_the_tube_and_the_worst_come_near_its_wall(period, name):
    """Signs of every error such that one output is largest at some time: the adjoint's."""
    unknown = UNKNOWN[name]
    brake = Brake(Q, period, unknown)
    Phi, Gamma = brake.motion
    A, K, bound = Phi + Gamma @ brake.gain, brake.gain, unknown.estimate
    x = np.array([[300.0, 200.0, 400.0, 0.9, 0.9, -0.9]])
    plan = brake.plan(x, shift=np.array([[30.0, 0.0, 0.0]]))
    plan = brake.extended(plan, len(plan) + round(60 / period))
    wall, thrusts, shares = brake.around(plan)[:, 0], brake.thrusts(plan)[:, 0], []
    for axis, end in [(axis, end) for axis in range(6) for end in (round(10 / period), len(thrusts))]:
        rows = [np.eye(6)[axis]]
        for _ in range(end - 1):
            rows.append(rows[-1] @ A)
        rows, e = rows[::-1], -bound * np.sign(rows[-1] @ Phi)
        for k in range(end):
            noise = bound * np.sign(rows[k] @ Gamma @ K) if k else -e
            u = thrusts[k] + K @ (e + noise)
            assert np.abs(u - thrusts[k]).max() <= brake.tube.feedback + 1e-12
            direction = rows[k] @ Gamma
            w = unknown.disturbance * Q.mass * direction / np.linalg.norm(direction)
            e = Phi @ e + Gamma @ (K @ (e + noise) + unknown.thrusters.error(u) * np.sign(direction) + w)
            for at in wall[k : k + 2]:
                assert np.linalg.norm(e[:3]) <= at[0] and np.linalg.norm(e[3:]) <= at[1]
        shares.append(abs(e[axis]) / wall[end, axis // 3])
    assert max(shares) > 0.24  # three axes at once, and what is between samples, are in the tube


@pytest.mark.parametrize("period", [0.2, 2.0])
def test_bounds_are_below_what_is_flown_and_not_far_below(period):
    """Along plans and while held for a revolution, at many instants within each period."""
    states, suns = drawn(6)
    brake = Brake(Q, period)
    exact = Families(Q, "linear", exact=True)
    gaps = []
    for x, sun in zip(states, suns, strict=True):
        check = AllTime(brake, sun)
        proven = BackupPlanner(check).find(0.0, x)
        plan = proven.plan
        u, D = brake.thrusts(plan), period
        parts = [Q.discretize(D * s) for s in (0.25, 0.5, 0.75, 1.0)]
        at = np.concatenate([plan[:1], *(plan[:-1] @ Phi.T + u @ Gamma.T for Phi, Gamma in parts)])
        t = np.concatenate([[0.0], *(D * (np.arange(len(u)) + s) for s in (0.25, 0.5, 0.75, 1.0))])
        angle = Q.mean_motion * np.linspace(0, 2 * np.pi / Q.mean_motion, 60)
        rest = plan[-1]
        c, s, o = np.cos(angle), np.sin(angle), 0 * angle
        turns = np.array([[c, s, o], [-s, c, o], [o, o, o + 1]]).transpose(2, 1, 0)
        hovering = np.concatenate([rest[:, :3] @ turns, rest[:, 3:] @ turns], axis=2)
        x_all = np.concatenate([at, hovering])
        t_all = np.concatenate([t, D * len(u) + angle / Q.mean_motion])
        sun_all = Q.sun_angle(t_all, sun)
        phi = allowable(Q, x_all, sun_all)
        h = exact(x_all, sun_all).h
        bound = dict(zip(check.labels, proven.margins, strict=True))
        for name in ("phi1", "phi2", "phi3", "phi6", "phi9", "phi10", "phi11"):
            values, labels = phi[name].min(axis=0), [key for key in check.labels if key.split("[")[0] == name]
            for key, value in zip(labels, values, strict=True):
                assert bound[key] <= value + 1e-9, key
                gaps.append((value - bound[key]) / max(1.0, abs(value)))
        for k, label in enumerate(exact.labels):
            if label[:3] in ("h7[", "h8["):
                assert bound["phi" + label[1:]] <= h[:, k].min() + 1e-6, label
        for name, keys in (("phi4", ("phi4",)), ("phi5", ("phi5+", "phi5-"))):
            least = min(bound[key] for key in bound if key.split("[")[0] in keys)
            assert least < 0 or phi[name].min() >= 0
    assert np.median(gaps) < 0.02


def test_every_margin_counts_the_tube():
    """Wider by 5 m and 0.1 m/s, as much of every distance and speed is lost; of pairs, twice as much."""
    (x, *_), (sun, *_) = drawn(1)
    check = AllTime(Brake(Q), sun)
    proven = BackupPlanner(check).find(0.0, x)
    less = proven.margins - check(0.0, proven.plan, proven.tube + [5.0, 0.1])
    kinds = np.array([label.split("[")[0].rstrip("+-") for label in check.labels])
    expected = {"phi1": 5.0, "phi2": 10.0, "phi4": 5.0, "phi5": 10.0, "phi6": 5.0, "phi7": 5.0, "phi8": 10.0}
    for name, least in expected.items() | {("phi3", 0.1), ("phi9", 0.01), ("phi10", 0.01), ("phi11", 0.01)}:
        assert less[kinds == name].min() >= least - 1e-6, name


def test_held_in_free_flight_a_deputy_keeps_its_share_of_the_distance():
    """After a quarter of an orbit what was held on the axis across the plane is at the chief."""
    quarter = np.pi / 2 / Q.mean_motion
    for duration in (500.0, quarter - 0.3, quarter, quarter + 0.7, 1.4 * quarter):
        brake = Brake(replace(Q, passive_time=duration))
        plane, across = brake.drifting
        drifts = free_flight(Q.mean_motion, np.linspace(0, duration, 20001))[:, :3] @ brake.resting
        assert 0 <= across <= np.abs(drifts[:, 2, 2]).min() + 1e-9
        least = np.linalg.svd(drifts[:, :2, :2], compute_uv=False).min()
        assert 0 <= plane <= least + 1e-9 and (duration > 500 or plane >= 0.8 * least)


@pytest.mark.parametrize("distance", [900.0, 9000.0])
def test_where_the_zone_is_left_out_no_plan_beyond_it_is_proven(distance):
    """The error of holding grows with the distance, and the tube counts it up to r_max only."""
    q = Inspection(deputies=1)
    brake = Brake(q, 1.0, Uncertainty(jitter=0.0))
    x = np.array([[0.6 * distance, 0.8 * distance, 0.0, 0.0, 0.0, 0.0]])
    x[:, 3:] = x[:, :3] @ brake.spin.T
    check = AllTime(brake, 0.3, without=("keep_in", "velocity", "speed", "sun"))
    proven = BackupPlanner(check).find(0.0, x)
    assert proven.good == (distance < q.distance_max)
    plan, (Phi, Gamma), astray = proven.plan, brake.motion, 0.0
    for _ in range(200):
        x = x @ Phi.T + brake.follow(x, plan) @ Gamma.T
        plan = brake.extended(plan, 3)[1:]
        astray = max(astray, float(np.linalg.norm((x - plan[0])[0, :3])))
    assert (astray <= brake.tube.widest[0]) == proven.good


@pytest.mark.slow
@pytest.mark.parametrize(
    ("period", "exact", "with_errors"), [(0.2, 392, 348), (1.0, 391, 317), (2.0, 391, 279)]
)
def test_nearly_all_drawn_states_are_proven_as_the_page_says(period, exact, with_errors):
    """The table of docs/inspection-assured.md."""
    states, suns = drawn(400)
    errors = Thrusters.from_errors(0.005, np.deg2rad(0.1), 0.005, 0.0005 / (2 * period), 3)
    for unknown, count in ((None, exact), (Uncertainty(0.05, 0.002, 1e-5, errors), with_errors)):
        brake = Brake(Q, period, unknown)
        planners = [BackupPlanner(AllTime(brake, sun)) for sun in suns]
        good = [planner.find(0.0, x).good for planner, x in zip(planners, states, strict=True)]
        assert abs(sum(good) - count) <= 1  # one may lie at the edge of rounding
    page = Path("docs/inspection-assured.md").read_text(encoding="utf-8")
    assert f"| {period:g} s | {exact} | {with_errors} |" in page


@pytest.mark.parametrize(
    ("kind", "sharing"), [*((kind, "centralized") for kind in KINDS), ("explicit", "consensus")]
)
def test_harsh_primaries_find_no_period_without_a_proven_answer(kind, sharing):
    states, suns = drawn(3)
    f = make(kind, period=2.0, sun=suns[2], sharing=sharing)
    duration = 120.0 if sharing == "centralized" else 30.0
    least, unproven, statuses = fly(f, states[2], suns[2], Harsh(Q, "mixed", suns[2], 30.0), duration)
    assert unproven == 0 and least >= 0 and set(statuses) & {"filtered", "backup"}


@pytest.mark.parametrize("mode", ["bias", "flip", "against"])
def test_estimates_at_the_edge_of_their_bound(mode):
    planned = ((x, s, BackupPlanner(AllTime(Brake(Q, 1.0, BAD), s))) for x, s in zip(*drawn(8), strict=True))
    x, sun = next((x, s) for x, s, planner in planned if planner.find(0.0, x).good)
    f = make("explicit", sun=sun, unknown=BAD)
    least, unproven, statuses = fly(f, x, sun, Harsh(Q, "mixed", sun, 10.0), 40.0, BAD, navigation(BAD, mode))
    assert unproven == 0 and least >= 0


class Group:
    """Members of a group as one filter: each decides on its own, on the messages that are not `lost` to it.

    `lost(k)` says who (rows) does not hear whom (columns), shape (N, N).
    """

    def __init__(self, members, lost):
        self.members, self.lost, self.rule = members, lost, members[0].rule
        self.inspection, self.period = self.rule.inspection, self.rule.period
        self.calls, self.moved, self.mixes = 0, np.zeros(len(members)), 0

    def filter(self, t, x, desired):
        sent = [one.message(x[i], desired[i]) for i, one in enumerate(self.members)]
        lost = self.lost(self.calls) & ~np.eye(len(sent), dtype=bool)
        u = [
            one.decide(t, [None if lost[i, j] else sent[j] for j in range(len(sent))])
            for i, one in enumerate(self.members)
        ]
        self.calls += 1
        moving = np.array([one.moved for one in self.members])
        self.moved, self.mixes = self.moved + moving, self.mixes + (moving.any() and not moving.all())
        unproven = any(one.unproven for one in self.members)
        return Decision(np.array(u), moving, (), {}, "", on_backup=~moving, unproven=unproven)


def group(kind, lost, k, period=1.0, unknown=None):
    states, suns = drawn(k + 1)
    x, sun = states[k], suns[k]
    rules = [make(kind, period=period, sun=sun, unknown=unknown, sharing="consensus", mixed=True) for _ in x]
    return Group([Member(i, rule, 0.0, x) for i, rule in enumerate(rules)], lost), x, sun


def test_a_group_that_loses_messages_is_safe():
    rng = np.random.default_rng(0)
    f, x, sun = group("explicit", lambda k: rng.random((5, 5)) < 0.05, 2, 2.0)
    least, unproven, _ = fly(f, x, sun, Harsh(Q, "mixed", sun, 10.0), 40.0)
    assert least >= 0 and unproven == 0
    assert f.mixes > 3 and (f.moved > 3).all()  # some went on with what others left


def test_deputies_that_remember_different_things_answer_the_same_or_not_at_all():
    """Who missed earlier messages has no estimate of a state that is none, the others have."""
    f, x, sun = group("explicit", None, 1, 2.0)
    Phi, Gamma = Q.discretize(2.0)
    aim, members = Harsh(Q, "mixed", sun, 10.0), f.members
    for k in range(6):
        estimates, desired = x.copy(), aim(2.0 * k, x)
        estimates[2] = 1e30 if k == 5 else x[2]
        sent = [one.message(*each) for one, *each in zip(members, estimates, desired, strict=True)]
        deaf = [None if j == 1 and k < 5 else each for j, each in enumerate(sent)]
        u = [one.decide(2.0 * k, sent if i else deaf) for i, one in enumerate(members)]
        x = x @ Phi.T + np.array(u) @ Gamma.T
        plans = [one.rule.plan.plan for one in members if one.moved]
        assert len(plans) == (0 if k == 5 else 4)
        assert all(np.array_equal(plan, plans[0]) for plan in plans)
    assert not any(one.unproven for one in members)  # the plan of the third is flown exactly


def test_messages_of_the_period_before_are_lost():
    f, x, _ = group("implicit", None, 2, 2.0)
    Phi, Gamma = Q.discretize(2.0)
    old = [one.message(x[i], np.zeros(3)) for i, one in enumerate(f.members)]
    x = x @ Phi.T + np.array([one.decide(0.0, old) for one in f.members]) @ Gamma.T
    sent = [one.message(x[i], np.zeros(3)) for i, one in enumerate(f.members)]
    f.members[0].decide(2.0, [sent[0], old[1], *sent[2:]])
    f.members[1].decide(2.0 + 1e-9, sent)  # by its clock
    assert [one.moved for one in f.members[:2]] == [False, True]


@pytest.mark.parametrize("how", ["late", "no number", "not known"])
def test_who_broke_an_assumption_says_so_until_it_has_a_new_plan(how):
    """A plan that was held too long is not the one that was proven, though the deputy may be near it."""
    f, x, _ = group("implicit", None, 5, 2.0, BAD if how == "not known" else None)
    one, Phi, Gamma = f.members[0], *Q.discretize(2.0)

    def go(t, radio):
        nonlocal x
        sent = [each.message(x[i], np.zeros(3)) for i, each in enumerate(f.members)]
        u = [
            each.decide(t, sent if radio or i else [sent[0], *[None] * 4]) for i, each in enumerate(f.members)
        ]
        x = x @ Phi.T + np.array(u) @ Gamma.T
        return one.unproven

    assert not go(0.0, radio=False)
    measured = np.full(6, np.nan) if how == "not known" else x[0]
    t = {"late": 3.0, "no number": np.nan, "not known": 2.0}[how]
    one.decide(t, [one.message(measured, np.zeros(3)), *[None] * 4])
    assert one.unproven
    x[0] = one.message(x[0], x[0, :3]).plan[0, 0]  # on its plan again
    for each in f.members:  # the others' clocks and plans have gone on, too
        each._due = one._due
    assert go(one._due, radio=False) and not go(one._due, radio=True) and one.moved


OTHERS = {
    "without": {"without": ("deputy_separation", "deputy_passive")},
    "sun": {"sun_start": 0.3},
    "kind": {"kind": "explicit"},
    "alpha": {"strengthening": "afrl"},
    "problem": {"inspection": replace(TWO, deputy_radius=4.0)},
    "jitter": {"uncertainty": Uncertainty(jitter=0.001)},
}


@pytest.mark.parametrize("name", OTHERS)
def test_a_group_whose_deputies_have_different_rules_moves_nowhere_and_says_so(name):
    """One that left out pairs flew at the other, and both said that all was proven: phi8 came to -9 m."""
    x = np.array([[0, -300, 300.0, 0, 0, 0], [0, -300, 340.0, 0, 0, 0]])
    common = {"kind": "implicit", "inspection": TWO, "period": 1.0, "mixed": True}
    rules = [build_filter(**common | changed) for changed in (OTHERS[name], {})]
    members, (Phi, Gamma) = [Member(i, rule, 0.0, x) for i, rule in enumerate(rules)], TWO.discretize(1.0)
    for k in range(20):
        desired = np.array([[0, 0, 1.0], [0, 0, -1.0]])
        sent = [one.message(x[i], desired[i]) for i, one in enumerate(members)]
        u = [one.decide(float(k), sent) for one in members]
        assert all(one.unproven and not one.moved for one in members)
        x = x @ Phi.T + np.array(u) @ Gamma.T
    assert 39.9 < x[1, 2] - x[0, 2] < 40.1


def test_without_mixed_plans_there_is_no_group():
    x, simplex = drawn(1)[0][0], SimplexImplicit(BackupPlanner(AllTime(Brake(Q)), mixed=True))
    for words, rule in (("mixed", make("explicit")), ("equal answers to equal messages", simplex)):
        with pytest.raises(ScenarioError, match=words):
            Member(0, rule, 0.0, x)
    with pytest.raises(ScenarioError, match="must have a proven plan"):
        Member(0, make("explicit", mixed=True), 0.0, np.repeat(x[:1], 5, axis=0))


def test_plans_that_cross_old_ones_are_not_proven_where_these_may_be_flown_on():
    """Two deputies that change places one after another: new plans are safe, new beside old are not."""
    f = make("explicit", TWO, mixed=True)
    rest = np.array([[300.0, 0.0, 300.0], [300.0, 60.0, 300.0]])
    old, new = (
        np.hstack([p, p @ f.brake.spin.T]) for p in (rest, rest + [[0.0, 40.0, 0.0], [0.0, 40.0, 0.0]])
    )
    plans = [np.stack([states] * 3) for states in (old, new)]
    tubes = [f.brake.around(plan) for plan in plans]
    names = f.check.labels.index("phi2[0,1]")
    alone, mixed = f.check(0.0, plans[1], tubes[1]), f.check(0.0, plans[1], tubes[1], (plans[0], tubes[0]))
    assert alone[names] > 40 and mixed[names] < 10.1  # 20 m between a new place and an old one
    np.testing.assert_array_equal(np.delete(alone, names)[:18], np.delete(mixed, names)[:18])


def test_broken_assumptions_are_told():
    states, suns = drawn(1)
    x, sun = states[0].copy(), suns[0]
    f = make("implicit", sun=sun)
    assert not f.filter(0.0, x, np.zeros((5, 3))).unproven
    x[2, 0] += 0.5  # nothing can have moved it
    answer = f.filter(1.0, x, np.zeros((5, 3)))
    assert "farther from its plan" in answer.fallback
    late = f.filter(9.0, x, None)
    assert "called after" in late.fallback and late.status == "backup"


def test_latching_and_handing_back():
    states, suns = drawn(3)
    f = SimplexImplicit(BackupPlanner(AllTime(Brake(Q, 2.0), suns[2])), dwell=10.0)
    aim = Harsh(Q, "mixed", suns[2], 40.0)
    fly(f, states[2], suns[2], lambda t, x: aim(t, x) if t % 120 < 60 else -5 * x[:, 3:], 240.0)
    for i in range(5):
        entries = [entry for entry in f.log if entry.deputy == i]
        assert [entry.to for entry in entries] == (["backup", "desired"] * len(entries))[: len(entries)]
        for back, on in zip(entries[::2], entries[1::2], strict=False):
            assert on.t - back.t >= 10.0 and "would be" in back.reason
    assert {entry.to for entry in f.log} == {"backup", "desired"}


@pytest.mark.parametrize("kind", KINDS)
@given(sequence=calls(2))
@settings(max_examples=4, deadline=None, suppress_health_check=list(HealthCheck))
def test_garbage_is_answered(kind, sequence):
    answers(make(kind, TWO), sequence, planned=True)


@pytest.mark.parametrize("kind", KINDS)
def test_malformed_calls_and_odd_times(kind):
    malformed(make(kind, TWO))
    x = np.array([[200.0, 0, 0, 0, -0.2, 0], [-150.0, 90, 30, 0.1, 0.15, 0]])
    odd_times(make(kind, TWO), x, np.zeros((2, 3)))


def test_the_command_of_the_long_flights(capsys, monkeypatch):
    monkeypatch.setattr(harsh, "PERIODS", (2.0, 1.0))
    harsh.main(["--flights", "4", "--seconds", "20", "--kind", "simplex_implicit", "--errors"])
    lines = capsys.readouterr().out.splitlines()
    flights = [line.split()[1:3] for line in lines[:4]]
    assert flights == [["deputy", "2"], ["cone", "2"], ["far", "2"], ["deputy", "1"]]
    assert lines[-1] == "4 flights of 20 s: 0 violated, 0 periods not proven"


@pytest.mark.slow
@pytest.mark.parametrize("arguments", [[], ["--errors"], ["--kind", "implicit"]])
def test_long_flights_with_harsh_primaries(arguments, capsys):
    harsh.main(["--flights", str(fewer(33, 15)), "--seconds", str(fewer(600, 100)), *arguments])
    assert capsys.readouterr().out.endswith(": 0 violated, 0 periods not proven\n")
