"""The checker's own mathematics: every enclosure contains what it must, every bound holds."""

import math
from contextlib import nullcontext, suppress
from copy import copy
from dataclasses import replace
from fractions import Fraction
from functools import cache
from itertools import combinations, product
from operator import mul
from types import SimpleNamespace

import flint
import numpy as np
import pytest
from flint import arb, arb_mat
from scipy.integrate import cumulative_trapezoid
from scipy.linalg import expm

from polaris.certificate.checker import verify_document
from polaris.certificate.claims.argument import Argument
from polaris.certificate.claims.coasting import prolonged
from polaris.certificate.claims.drift import Departures, Drifts
from polaris.certificate.claims.flights import enclose_step
from polaris.certificate.claims.mean_spending import MeanCommands
from polaris.certificate.claims.recovery import Recovery
from polaris.certificate.claims.storage import together
from polaris.certificate.files.document import Document, digest
from polaris.certificate.files.entries import Departure, DriftClaim
from polaris.certificate.kernel.arcs import Arc
from polaris.certificate.kernel.balls import (
    PRECISION,
    column,
    exponential_over,
    identity,
    lengths,
    magnitude,
    matrix,
    norms,
    require,
    row_sums,
    spans,
    sums,
    widths,
)
from polaris.certificate.kernel.motion import InputSet, Plant, RowIntersample
from polaris.certificate.kernel.periods import Period, Spell
from polaris.certificate.kernel.verdict import Imprecise, Record, Rejected, Undecided
from polaris.certificate.kernel.zonotopes import Directions, Merging, Zonotope, ball_cover, inner_radius
from polaris.certificate.model.craft.settling import Settling
from polaris.certificate.model.craft.tightening import SetIntersample, Tightening
from polaris.certificate.model.limits import Limits, NodeLimit
from polaris.runs.certificate import certificate, hexadecimal
from polaris.scenario.scenario import load_scenario
from polaris.simulation.simulate import simulate
from polaris.synthesis.schedule.synthesize import synthesize
from reach.numerics.linear import discretize
from tests.polaris.loops import loop_of_errors
from tests.polaris.tiny import TINY

ANY = ('experimental.0={kind="any_thrust",name="any"}', "tracking.Q=[1,1,1,1]", "tracking.R=[8,8]")
SCENES = {
    "clipped": ("tracking.R=[60,60]",),
    "clipped, given period": ("tracking.R=[60,60]", "feedback={period_s=0.1}", "recoverable.recourse=replan"),
    "any thrust": (*ANY, "horizon.step_s=0.25", "planner.thrust_reserve=0.5"),
}


@pytest.fixture(autouse=True)
def precision():
    with flint.ctx.workprec(128):
        yield


@cache
def scene(name):
    schedule = synthesize(load_scenario(TINY).with_assignments(list(SCENES[name])))
    return schedule, Argument(Document(certificate(schedule, "tiny")), Record())


def values(M):
    return np.array([[float(x.mid()) for x in row] for row in M.tolist()])


@pytest.mark.parametrize("name", SCENES)
def test_reachable_sets_contain_what_is_flown(name):
    schedule, argument = scene(name)
    path = argument.reference()
    sets, tubes = argument.tubes(path, Merging(12, 4, argument.craft.merge_rows))
    runs = simulate(schedule, 200, 3)
    q, K = argument.document.q, argument.K
    fullest = 0.0
    for k in range(K + 1):
        errors = runs.states[:, k * q] - values(path.starts[k])[:, 0]
        centre, half = values(sets[k].c)[:, 0], values(sets[k].size())[:, 0]
        assert np.all(np.abs(errors) <= half + 1e-9)
        fullest = max(fullest, float(np.max(np.abs(errors - centre) / half)))
    assert fullest > 0.3  # the sets are no idle bounds
    for k, i in product(range(K), range(1, q)):
        z = tubes[k].nodes[i - 1]
        errors = runs.states[:, k * q + i] - values(path.arcs[k].nodes[i])[:, 0]
        assert np.all(np.abs(errors - values(z.c)[:, 0]) <= [float(x) + 1e-9 for x in z.widths])


def test_a_step_of_u_leaves_room_for_what_a_fault_adds_until_it_is_isolated():
    argument = copy(scene("clipped")[1])
    for size, fits in ((1e-9, True), (100.0, False)):
        argument.upsets = [column([arb(0)] * 4), column([arb(size)] * 4)]
        with nullcontext() if fits else pytest.raises(Rejected, match="separation"):
            argument.tubes(argument.reference(), Merging(12, 4, argument.craft.merge_rows))


def test_exponentials_over_an_interval_contain_all_of_them():
    X = np.random.default_rng(1).normal(size=(4, 4))
    over = exponential_over(matrix(X.tolist()), arb(0.3))
    for s in np.linspace(0, 0.3, 31):
        exact = expm(X * s)
        assert all(over[i, j].overlaps(arb(float(exact[i, j]), 1e-14)) for i in range(4) for j in range(4))
        assert all(float(over[i, j].rad()) < 3.0 for i in range(4) for j in range(4))


def test_gains_over_a_part_of_a_period_are_that_part_of_the_gain_and_a_bend():
    rng, fine = np.random.default_rng(3), np.linspace(0, 0.4, 801)
    lagging = 0.0
    for _ in range(8):
        A, B, row = rng.normal(size=(3, 3)), rng.normal(size=(3, 1)), rng.normal(size=3)
        BB, R = matrix(B.tolist()), matrix([row.tolist()])
        plant = Plant(matrix(A.tolist()), BB, BB, R, [arb(1)], arb(0.5), arb(0.4))
        motion = plant.open
        X = values(motion.A)
        rates = 0.5 * np.abs([row @ expm(X * s) @ B[:, 0] for s in fine])
        done = cumulative_trapezoid(rates, fine, initial=0)
        for push in (plant.disturbance, InputSet.in_box(BB, [arb(0.5)])):
            curvature, gain = motion.push_curvature(R, push), motion.push_gain(R, push)
            bound = fine / 0.4 * float(gain[0]) + float(curvature[0])
            assert np.all(done <= bound * (1 + 1e-6))
            lagging = max(lagging, float(np.max(done - fine / 0.4 * float(gain[0]))))
    assert lagging > 1e-3  # without the bend it would be no bound


@pytest.mark.parametrize("name", ["clipped", "clipped, given period"])
def test_any_slopes_give_sets_that_contain_what_is_flown(name):
    schedule, _ = scene(name)
    data, rng = certificate(schedule, "tiny"), np.random.default_rng(6)
    stored = data["slopes"]
    assert any(stored) and not all(stored)
    for change in (lambda rows: None, lambda rows: hexadecimal(rng.random(np.shape(rows)))):
        data["slopes"] = [None if rows is None else change(rows) for rows in stored]
        data["digest"] = digest(data)
        argument = Argument(Document(data), Record())
        for laws in argument.document.facets:  # far wider sets need not be separate
            laws.clear()
        argument.document.unsafe.clear()
        path = argument.reference()
        sets, _ = argument.tubes(path, Merging(12, 4, argument.craft.merge_rows))
        runs, q = simulate(schedule, 100, 3), argument.document.q
        for k, z in enumerate(sets):
            errors = runs.states[:, k * q] - values(path.starts[k])[:, 0]
            rows = np.vstack([np.eye(argument.n), -np.eye(argument.n)])
            bounds = [float(x) for x in z.support(matrix(rows.tolist()))]
            assert np.all(errors @ rows.T <= np.array(bounds) + 1e-9)


def test_motion_leaves_its_chord_by_no_more_than_its_bow():
    rng = np.random.default_rng(4)
    A, B = rng.normal(size=(4, 4)), rng.normal(size=(4, 2))
    plant = Plant(
        *map(matrix, (A.tolist(), B.tolist(), B.tolist())), matrix([[1, 0, 0, 0]]), [], arb(0), arb(0.2)
    )
    K, rows = rng.normal(size=(2, 4)), rng.normal(size=(5, 4))
    closed = matrix((A - B @ K).tolist())
    start = Zonotope(column(rng.normal(size=4).tolist()), matrix((0.1 * rng.normal(size=(4, 3))).tolist()))
    along, rate = RowIntersample(plant.open, matrix(rows.tolist())), start.image(closed)
    boxed, bound = (
        np.array([float(x) for x in intersample(rate)])
        for intersample in (along.intersample, along.tight_intersample)
    )
    assert np.all(bound <= boxed) and np.any(bound < 0.9 * boxed), "a set is less than its box"
    furthest = np.zeros(5)
    for b in rng.choice([-1.0, 1.0], (20, 3)):
        x = values(start.c)[:, 0] + values(start.G) @ b
        rate, fine = (A - B @ K) @ x, np.linspace(0, 0.2, 101)
        # x' = e^{A s} A_c x(0).
        block = np.block([[A, rate[:, None]], [np.zeros((1, 5))]])
        path = np.array([x + expm(block * s)[:4, 4] for s in fine])
        chord = path[0] + (path[-1] - path[0]) * (fine / 0.2)[:, None]
        furthest = np.maximum(furthest, np.abs((path - chord) @ rows.T).max(axis=0))
    assert np.all(furthest <= bound) and np.any(furthest > 0.3 * bound)


def test_between_nodes_s_flies_below_the_chords_of_what_it_needs_at_nodes():
    """From a set without a push, and from rest under a constant one: both peak within periods."""
    A, B, K, h, push = np.array([[0.0, 1.0], [-1.0, -2.0]]), np.array([[0.0], [1.0]]), [[1.5, 1.8]], 0.4, 0.3
    b, rows = matrix(B.tolist()), np.vstack([np.eye(2), -np.eye(2), K, np.negative(K)])
    plant = Plant(matrix(A.tolist()), b, b, matrix([[1, 0]]), [arb(1)], arb(push), arb(h))
    start = Zonotope(column([0.3, -0.2]), matrix([[0.5, 0.1], [0.2, -0.4]]))
    loop = loop_of_errors(plant, matrix(K))
    tightenings = Tightening(loop, Settling.for_craft(loop, start.size(), 1), matrix(rows.tolist()))
    intersamples, c, G = SetIntersample(tightenings, start), values(start.c)[:, 0], values(start.G)
    of_set = [sums(start.support(tightenings.carried[lag]), intersamples.next_to(lag)) for lag in range(9)]
    of_set, of_push = (
        np.array([[float(x) for x in each] for each in tube]) for tube in (of_set, tightenings.disturbed[:9])
    )
    transition, forced, beyond = np.eye(2), np.zeros(2), 0.0
    for lag in range(8):
        for s in np.linspace(0, h, 21):
            Ad, Bd = discretize(A, B, s)
            M, share = rows @ (Ad - Bd @ K), s / h
            reached = M @ transition @ c + np.abs(M @ transition @ G).sum(axis=1)
            assert np.all(reached <= (1 - share) * of_set[lag] + share * of_set[lag + 1] + 1e-12)
            beyond = max(beyond, np.max(reached / np.maximum(of_set[lag], of_set[lag + 1])))
            reached = M @ forced + rows @ Bd[:, 0] * push
            assert np.all(reached <= (1 - share) * of_push[lag] + share * of_push[lag + 1] + 1e-12)
        transition, forced = (Ad - Bd @ K) @ transition, (Ad - Bd @ K) @ forced + Bd[:, 0] * push
    assert beyond > 0.9


@pytest.mark.parametrize("start", [[0.3, -0.2], [0.8, -1.0], [-1.0, 3.0]])
def test_both_periods_beside_a_node_count(start):
    """Intersample bounds of some sets shrink from period to period, those of others grow at first."""
    A, B, K = (matrix(M) for M in ([[0.0, 1.0], [-1.0, -0.2]], [[0.0], [1.0]], [[1.5, 0.8]]))
    plant = Plant(A, B, B, matrix([[1, 0]]), [arb(1)], arb(0.0), arb(0.4))
    errors = Zonotope(column(start), matrix([[0.01, 0.0], [0.0, 0.01]]))
    loop = loop_of_errors(plant, K)
    tightenings = Tightening(loop, Settling.for_craft(loop, errors.size(), 1), matrix([[1, 0], [0, 1]]))
    tube = SetIntersample(tightenings, errors)
    bound = np.array(
        [
            [float(x) for x in tightenings.intersample.tight_intersample(errors.image(rates))]
            for rates in tightenings.rates[0].carried[:9]
        ]
    )
    larger = np.maximum(bound, bound[[0, *range(8)]])
    assert np.array([[float(x) for x in tube.next_to(lag)] for lag in range(9)]) == pytest.approx(larger)
    assert np.any(np.diff(bound, axis=0) < 0) and np.any(np.diff(bound, axis=0) > 0)


def test_an_orbit_followed_beyond_the_tail_keeps_its_precision(monkeypatch):
    argument = scene("clipped")[1]
    path, document = argument.reference(), argument.document
    monkeypatch.setattr(document, "horizon", "infinite")
    forgetting = SimpleNamespace(periods=document.cells * document.q)
    assert len(prolonged(document, path, forgetting)[0].arcs) == document.steps + document.cells
    flint.ctx.prec = 24
    with pytest.raises(Imprecise, match="before errors at T have decayed"):
        prolonged(document, path, forgetting)


def test_where_precision_is_lost_more_bits_are_taken(monkeypatch):
    """The powers of a loop that swings and hardly decays: their radii grow like those of absolute values."""
    A, B, rest = matrix([[0, 1], [-1, -1 / 32]]), matrix([[0], [1]]), matrix([[0, 0]])

    def settling():
        plant = Plant(A, B, B, matrix([[1, 0]]), [arb(1)], arb(0), arb(0.25))
        return Settling.for_craft(loop_of_errors(plant, rest), column([1, 1]), 4)

    with pytest.raises(Imprecise, match="precision is lost"):
        settling()
    flint.ctx.prec = 2048
    assert 3000 < settling().periods < 4000
    flint.ctx.prec = PRECISION

    def of(motion, extent, multiple, *more):
        if flint.ctx.prec <= 2 * PRECISION:
            raise Imprecise("recoverable", "too few bits")
        return Settling.for_craft(motion, extent, multiple, *more)

    monkeypatch.setattr("polaris.certificate.claims.continuation.Settling", SimpleNamespace(for_craft=of))
    verdict = verify_document(certificate(scene("clipped")[0], "tiny"))
    bits = int(verdict.trusted[-1].split("arithmetic, ")[1].split()[0])
    assert verdict.outcome == "VERIFIED" and bits > 2 * PRECISION, verdict.text()
    assert len({claim for claim, _ in verdict.checked}) == len(verdict.checked), "nothing is told twice"


@pytest.mark.parametrize("p", [1, 2, 3, 5])
def test_covers_contain_the_ball_and_are_tight(p):
    G = values(ball_cover(p, arb(2)))
    directions = np.random.default_rng(0).normal(size=(2000, p))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    support = np.abs(directions @ G).sum(axis=1)
    assert support.min() >= 2 * (1 - 1e-12)
    if p <= 3:
        assert support.max() <= 2 * 1.12
        assert float(inner_radius(matrix(G.tolist()))) == pytest.approx(2)


def test_sums_and_lengths_from_above_are_above_and_close():
    rng = np.random.default_rng(3)
    M = rng.normal(size=(7, 90)) * 10.0 ** rng.uniform(-9, 3, size=(7, 90))
    balls = matrix([[arb(x, 1e-5 * abs(x)) for x in row] for row in M.tolist()])
    sizes = matrix(rng.uniform(0, 9, size=(90, 2)).tolist())
    upper = magnitude(balls)
    pairs = [
        *zip(row_sums(upper), widths(balls), strict=True),
        *zip((upper * sizes).entries(), spans(balls, sizes).entries(), strict=True),
        *zip(norms(upper), lengths(balls), strict=True),
    ]
    assert all(exact.lower() <= bound <= exact.upper() * (1 + arb(1e-6)) for exact, bound in pairs)
    assert all(bound.is_exact() for _, bound in pairs)
    assert lengths(matrix([[arb(10) ** -400, 0.0]]))[0] > arb(10) ** -400
    (around,) = norms(arb_mat(1, 2, [arb(0, 1e-20), arb(0, 1e-20)]))
    assert around.is_finite() and around < 1e-19


def test_a_number_on_the_edge_is_neither_confirmed_nor_refuted():
    require("claim", arb(0), "exactly on it")
    with pytest.raises(Undecided):
        require("claim", arb(0, 1e-30), "about it")
    with pytest.raises(Rejected) as caught:
        require("claim", arb(-2), "beyond it")
    assert (caught.value.claim, caught.value.excess) == ("claim", 2.0)


def test_a_jump_of_the_reference_takes_its_part_of_a_claimed_share():
    """Half of the room goes to the jump: an error of nothing leaves half of it, not all."""
    row = matrix([[1.0]])
    tightenings = SimpleNamespace(
        carried=[row] * 3,
        boxed=lambda size, lag: size.entries(),
        settling=SimpleNamespace(periods=2),
        tightening_after_settling=lambda size: [arb(0)],
    )
    path = SimpleNamespace(planned=0, plant=SimpleNamespace(q=1), jump=column([0.5]))
    limits = Limits(row, [[[NodeLimit(0, arb(1), "wall", arb(1))]] * 2]).less_jump(tightenings, path)
    recovery = Recovery(SimpleNamespace(), limits, tightenings)
    (target,) = limits.at_node(0, first=True)
    recovery._leaves(0.5, target, arb(0), "the start")
    with pytest.raises(Rejected) as error:
        recovery._leaves(0.6, target, arb(0), "the start")
    assert error.value.claim == "margins"


@pytest.mark.parametrize("steady", [False, True])
def test_a_period_counts_every_push_at_its_end_and_on_the_way(steady):
    """A constant push e moves a mass by e t^2 / 2, which is below the chord to what is booked at the end."""
    h, e, one = 0.5, 0.2, identity(2)
    plant = Plant(matrix([[0.0, 1], [0, -1]]), matrix([[0.0], [1]]), one, one, [arb(1)], arb(0), arb(h))
    zero, pushes = arb_mat(2, 1), [*plant.push([arb(e / 4)]), *plant.push([arb(3 * e / 4)])]
    inputs = [] if steady else pushes
    period = Period(one, zero, Directions(arb_mat(2, 2)), zero, [], [], inputs[:1], inputs[1:], [])
    along = RowIntersample(plant.open, one, [plant.disturbance, *(pushes if steady else [])])
    first, last = period.extra(along, Zonotope(zero, arb_mat(2, 0)))
    for t in np.linspace(0, h, 11):
        for motion, a, b in zip((e * (t + math.expm1(-t)), -e * math.expm1(-t)), first, last, strict=True):
            assert float(a) * (1 - t / h) + float(b) * t / h >= motion * (1 - 1e-12)


def test_thrust_may_stop_where_pulses_or_jitter_displace_the_craft():
    """Of a craft at rest the parallelotope of departures must hold the displacement alone."""
    zero, one = arb_mat(2, 1), identity(2)
    plant = Plant(matrix([[0.0, 1], [0, 0]]), matrix([[0.0], [1]]), one, one, [arb(1)], arb(0), arb(0.5))
    base, rest = Arc.from_state(plant, zero, arb_mat(1, 1)), Zonotope(zero, arb_mat(2, 0))
    group = Departure(1, [0.0, 0.0], [[1.0, 0.0], [0.0, 1.0]], [])
    for state_offset, inside in (([0.9, 0.0], True), ([1.1, 0.0], False), ([0.0, 1.1], False)):
        departures = Departures(plant, 0, [group], state_offset)
        with nullcontext() if inside else pytest.raises(Rejected, match="where thrust may stop"):
            departures.check(0, base, rest, rest, rest, [arb(0), arb(0)])


RUN_ON = np.array([[0.0, 1.0], [0.0, 0.0]])  # free motion along a line
TURN = np.array([[0.0, 1.0], [-1.0, 0.0]])


@pytest.mark.parametrize(
    ("A", "h", "i", "ends", "offset"),
    [
        (TURN, 0.4, 1, [[1.0, 0.2], [1.0, 0.2]], [0.0, 0.0]),  # bent by the motion
        (RUN_ON, 0.4, 1, [[0.0, 0.0], [0.0, 1.0]], [0.0, 0.0]),  # bent as the chord is left meanwhile
        (RUN_ON, 0.1, 9, [[0.3, 0.0], [0.3, 0.0]], [0.0, 0.1]),  # a velocity offset grows on the way back
        (TURN + RUN_ON, 0.3, 2, [[1.0, 0.2], [0.7, -0.4]], [0.02, 0.01]),
    ],
)
def test_departures_hold_where_thrust_stops_within_a_period(A, h, i, ends, offset):
    """The flattest box along the chord that passes holds all free motion back to the start of the step."""
    one, ends, offset = identity(2), np.array(ends), np.array(offset)
    plant = Plant(matrix(A.tolist()), one, one, one, [arb(1)] * 2, arb(0), arb(h), q=i + 1)
    base = SimpleNamespace(nodes=[arb_mat(2, 1)] * (i + 2))
    sets = [Zonotope(column(x.tolist()), arb_mat(2, 0)) for x in (ends[0], ends[1] - ends[0], ends[1])]
    first, last = (expm(-A * h * (i + k)) @ ends[k] for k in (0, 1))
    along = (last - first) / np.linalg.norm(last - first) if np.any(last != first) else np.array([0.0, 1.0])
    across, center = np.array([-along[1], along[0]]), (first + last) / 2
    needed = max(
        abs(
            across
            @ (expm(-A * (i + part) * h) @ (ends[0] + (ends[1] - ends[0]) * part + offset * sign) - center)
        )
        for part in np.linspace(0, 1, 41)
        for sign in product((-1, 1), repeat=2)
    )

    def passes(half):
        group = Departure(i + 1, center.tolist(), [(9 * along).tolist(), (half * across).tolist()], [])
        with suppress(Rejected, Undecided):
            Departures(plant, 0, [group], offset.tolist()).check(i, base, *sets, [arb(0)] * 2)
            return True
        return False

    assert needed > 1e-3 and not passes(0.99 * needed) and passes(3 * needed)


def test_drifts_are_no_nearer_than_their_clearance():
    """Free motion from corners of a box, under constants at their bounds, past a wall that moves."""
    rng, share = np.random.default_rng(3), []
    for trial in range(40):
        size = trial % 2  # every other trial is an oscillation alone
        A = rng.normal(size=(2, 2)) if size else 2 * TURN
        G, normal = rng.normal(size=(2, 1)), rng.normal(size=(1, 2))
        delta, cells, parts, one = 0.5, 3, 2, identity(2)
        plant = Plant(matrix(A.tolist()), one, one, one, [arb(1)] * 2, arb(0), arb(delta))
        plant = replace(plant, bias=[InputSet.in_box(matrix(G.tolist()), [arb(0.2 * size)])])
        center, axes = rng.normal(size=2), 0.1 * size * rng.normal(size=(2, 2))
        offset = size * rng.normal(size=cells + 2) - 50
        wall = SimpleNamespace(name="wall", normals=normal, keep_in=False)
        wall.rows = lambda C, facets, row=normal: matrix(row.tolist())
        wall.start, wall.end = ([[float(x)] for x in each] for each in (offset[:-1], offset[1:]))
        group = Departure(1, center.tolist(), axes.tolist(), [[[cells * parts, 0]]])
        claim = DriftClaim((cells - 1) * delta, False, parts, [[group]])
        document = SimpleNamespace(A=A.tolist(), delta=delta, steps=1, unsafe=[wall], drift=claim)
        (clearance,) = (float(x) for x in Drifts(document, plant)._clear(0, group))
        nearest = np.inf
        for t in np.linspace(0, cells * delta, 121):
            joined = expm(np.block([[A, G], [np.zeros((1, 3))]]) * t)
            at = np.interp(t, np.arange(cells + 2) * delta, offset)
            for a, b, sign in product((-1, 1), repeat=3):
                x = joined @ [*(center + a * axes[0] + b * axes[1]), 0.2 * size * sign]
                nearest = min(nearest, (normal @ x[:2])[0] - at)
        share.append(nearest - clearance)
    assert min(share) >= -1e-9 and np.median(share) < 0.5


def test_what_errors_do_within_a_period_is_answered_in_the_next():
    """Over a whole turn an oscillator forgets a constant push, but not one with the sign of cos t."""
    h, k, e = 2 * math.pi, 0.5, 0.01
    A, one = matrix([[0.0, 1], [-1, 0]]), identity(2)
    plant = Plant(A, matrix([[0.0], [1]]), one, one, [arb(1)], arb(0), arb(h))
    plant = replace(plant, bits=[e], q=2)
    craft = loop_of_errors(plant, matrix([[0.0, k]]))
    spell = Spell(arb(0), arb_mat(1, 1), [arb(0)], -craft.commands, [arb(0)])
    law, start = SimpleNamespace(kind="affine"), Zonotope(arb_mat(2, 1), arb_mat(2, 0))
    controller = SimpleNamespace(craft=craft, plant=plant, law=law)
    flight = SimpleNamespace(controller=controller, start=start, spells=[spell, spell])
    loop = MeanCommands(craft, [arb(e)], arb_mat(1, 1))
    answers = [abs(float(x.mid())) + 1e-9 for x in (craft.commands * loop.enter).entries()]
    each = [1.2 * sum(answers[i] for i in group) for group in loop.groups]
    bound = together([flight], [[sum(answers), *each, 1.0, 1.0]], 2)
    assert float(bound) >= (2 * e + k * 4 * e) * h


def test_a_gain_that_bends_upwards_is_more_than_its_trapezoid():
    one = identity(2)
    plant = Plant(matrix([[0.0, 1], [-1, 0]]), matrix([[0.0], [1]]), one, one, [arb(1)], arb(0), arb(1))
    (gain,) = plant.open.push_gain(matrix([[0.0, 1]]), InputSet.in_box(plant.B, [arb(1)]))
    assert math.sin(1) <= float(gain) <= 1.1 * math.sin(1)


def test_nearly_parallel_generators_are_merged_with_each_other():
    """The merged set contains the original, and loses much less than boxes around generators would."""
    rng = np.random.default_rng(5)
    for turn in (1e-3, 1e-2, 5e-2):
        channels, sizes, signs = rng.normal(size=(4, 1, 6)), rng.uniform(0.1, 1, (1, 30, 1)), [-1, 1]
        rotated = channels + turn * rng.normal(size=(4, 30, 6))
        G = (rotated * sizes * rng.choice(signs, (4, 30, 1))).reshape(-1, 6)[rng.permutation(120)].T
        full = Zonotope(arb_mat(6, 1), matrix(G.tolist()))
        small = full.reduced(6 + 40)
        rows = rng.normal(size=(500, 6))
        every = matrix([*rows.tolist(), *np.eye(6).tolist()])
        assert small.G.ncols() <= 6 + 40
        exact, merged = full.spread(every), small.spread(every)
        assert all(a <= b.upper() for a, b in zip(exact, merged, strict=True))
        # Girard's rule: a box replaces the generators whose 1-norm exceeds their largest entry least
        ranked = np.argsort(np.abs(G).max(axis=0) - np.abs(G).sum(axis=0))
        kept, rest = G[:, ranked[:40]], G[:, ranked[40:]]
        boxed = np.abs(rows @ kept).sum(axis=1) + np.abs(rows) @ np.abs(rest).sum(axis=1)
        truth, supports = np.abs(rows @ G).sum(axis=1), np.array([float(x) for x in merged[:500]])
        assert (supports - truth).mean() <= max(10 * turn, 0.02) * (boxed - truth).mean()


@pytest.mark.parametrize("seed", range(6))
def test_sets_merged_with_a_view_to_rows_contain_the_set(seed):
    rng = np.random.default_rng(seed)
    n, g, k = rng.integers(1, 9), rng.integers(1, 60), rng.integers(1, 12)
    G = rng.normal(size=(n, g)) * np.logspace(0, -12, g) * rng.integers(0, 2, (n, g))
    full = Zonotope(column(rng.normal(size=n).tolist()), matrix(G.tolist()))
    view = matrix((rng.normal(size=(k, n)) * rng.integers(0, 2, (k, n))).tolist())
    small = full.reduced(int(n + rng.integers(0, g + 1)), view)
    rows = matrix([*rng.normal(size=(100, n)).tolist(), *np.eye(n).tolist()])
    wide = (abs(a - b) for a, b in zip((rows * full.c).entries(), (rows * small.c).entries(), strict=True))
    pairs = zip(full.spread(rows), wide, small.spread(rows), strict=True)
    assert all((a + shift).lower() <= b.upper() for a, shift, b in pairs)
    assert small.G.ncols() <= max(g, n) + n


def test_merged_sets_contain_the_set_in_exact_arithmetic():
    """Along normals of facets, where rounded shares of a sum would leave out a few last digits."""
    rng = np.random.default_rng(0)

    def exact(M):
        pairs = [[x.mid().man_exp() for x in row] for row in M.tolist()]
        return [[int(man) * Fraction(2) ** int(exp) for man, exp in row] for row in pairs]

    for g in rng.integers(5, 12, 60):
        parallel = rng.normal(size=(3, 3))[:, rng.integers(0, 3, g)] * rng.choice([-1, 1, 3, 0.1], g)
        full = Zonotope(arb_mat(3, 1), matrix(parallel.tolist()))
        small = full.reduced(6)
        truth, outer = (list(zip(*exact(z.G), strict=True)) for z in (full, small))
        for (a, b, c), (d, e, f) in combinations(outer, 2):
            normal = b * f - c * e, c * d - a * f, a * e - b * d
            whole, merged = (
                sum(abs(sum(map(mul, normal, each))) for each in columns) for columns in (truth, outer)
            )
            assert whole <= merged


def test_merged_generators_are_rounded_upwards_at_any_precision():
    """With 12 bits the sum of what is merged is rounded, and not down."""
    flint.ctx.prec = 12
    rng = np.random.default_rng(2)
    for _ in range(20):
        G = rng.integers(1, 2**12, (2, 6)) / 2.0**12
        merged = Zonotope(arb_mat(2, 1), matrix(G.tolist())).reduced(2)
        assert merged.G.ncols() == 2
        for i, row in enumerate(G):
            assert merged.G[i, i].mid() >= arb(float(row.sum()))  # a sum of few bits, exact in doubles


def test_a_facet_leaves_room_at_both_ends_of_every_part_of_a_drift_in_which_it_is_named():
    """A drift leaves one side of a wall just as it enters the other."""
    walls = SimpleNamespace(name="wall", start=[[0.0, -3.0]], end=[[0.0, -3.0]])
    unknown = matrix([[0.0]]), [arb(0)] * 2
    drifts = SimpleNamespace(
        document=SimpleNamespace(unsafe=[walls]),
        _claim=SimpleNamespace(parts=2),
        _bookings=lambda item, facet: (matrix([[-1.0 if facet == 0 else 1.0]]), *unknown),
    )
    sizes = [column([arb(0)])] * 2
    for middle, clear in ((1.0, True), (-1.0, False), (4.0, False)):
        states = [matrix([[x]]) for x in (2.0, middle, -4.0)]
        with nullcontext() if clear else pytest.raises(Rejected, match="the drift from step 0 to wall"):
            Drifts._clearances(drifts, 0, 0, [0, 1], states, sizes)


def test_a_departure_leaves_the_chord_of_its_flight_and_that_of_the_path_below_it():
    argument, calls = scene("clipped, given period")[1], []
    path = argument.reference()
    k = argument.document.modes.index(1)
    controller, start = argument.controllers[1], Zonotope(arb_mat(4, 1), arb_mat(4, 0))
    spy = SimpleNamespace(
        check=lambda i, base, d, image, end, intersample: calls.append((base, d, intersample))
    )
    enclose_step(controller, start, k, path, None, Merging(12, 4, argument.craft.merge_rows), spy)
    base, d, intersample = calls[0]
    own = controller.period(d, base, k, 0)[0].extra(controller.craft.intersample(controller.craft.unit)[0], d)
    below = [each[0] for each in base.intersamples(identity(4))]
    assert len(calls) == argument.document.q and any(x > 0 for x in below)
    least = [float(max(a, b) + more) for a, b, more in zip(*own, below, strict=True)]
    assert all(float(x) >= y * (1 - 1e-12) for x, y in zip(intersample, least, strict=True))
