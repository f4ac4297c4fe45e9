"""Storages of whole flights (Proposition 14 (c)) against flights coded by hand, and in both programs."""

from itertools import product

import numpy as np
import pytest
from scipy.linalg import block_diag

pytest.importorskip("flint")
from flint import arb, arb_mat, ctx

from polaris.certificate.claims import storage as checked
from polaris.certificate.claims.mean_spending import MeanCommands, TurnedCommands, WeightedPeriod
from polaris.certificate.kernel.balls import PRECISION, column, diagonal, matrix
from polaris.certificate.kernel.verdict import Undecided
from polaris.certificate.kernel.zonotopes import Zonotope as Enclosed
from polaris.synthesis.schedule.spending import FlightSpending
from polaris.synthesis.tracker import storage
from polaris.synthesis.tracker.long_flight import Inputs, Storage, carried_across
from polaris.synthesis.tracker.storage import LinearStep, Weights
from reach.sets.zonotope import Zonotope
from tests.polaris.certificate.test_mean_spending import PERIODS, Flown
from tests.polaris.random_scenarios import synthesised
from tests.polaris.synthesis.schedule.test_hand_over import CASES, H, checker_tightenings, tracking

STEP = 12  # periods that have one set of weights


@pytest.fixture(autouse=True)
def precision():
    """Work with as many bits as the checker does."""
    before, ctx.prec = ctx.prec, PRECISION
    yield
    ctx.prec = before


def middles(m):
    """Commands in the middle: none, small ones that change their sign, and large ones."""
    t = np.arange(PERIODS)
    wave = np.sin(0.15 * t)[:, None] * np.linspace(0.02, 0.05, m)
    return np.where(t[:, None] < 60, 0.0, np.where(t[:, None] < 160, wave, 0.4))


def steps(s):
    """S in many periods, about its middle."""
    within, zero = (s.system.u_max, s.system.u_max), np.zeros(s.system.n)
    law = s.tightening.closed
    inputs = Inputs.from_loop(law, s.system, within, zero, zero, s.worst_noise)
    u = middles(s.system.m)
    return [LinearStep((inputs,) * STEP, u[i : i + STEP]) for i in range(0, PERIODS, STEP)]


def nowhere(s):
    """The loop state in the middle alone."""
    return Zonotope(np.zeros(s.loop.N), np.zeros((s.loop.N, 0)))


@pytest.mark.parametrize("case", CASES, ids=lambda case: "-".join(case) or "estimate")
def test_no_flight_spends_more_whatever_it_is_meant_to_command(case):
    """The worst of them spend most of the bound: of errors about a middle that is flown besides."""
    s = tracking(**case)
    flown, rng, u = Flown(s), np.random.default_rng(0), middles(s.system.m)
    whole = steps(s)
    weights = storage.weights(whole, nowhere(s))
    bound = storage.bound(whole, weights, nowhere(s))
    spends, count, reached = whole[0].inputs[0].spends, flown.answers.shape[1], 0.0
    ways = rng.normal(size=(PERIODS, count))
    for _ in range(8):  # each time towards where it went
        total = flown.fly(ways, u) + u
        reached = max(reached, float(np.sum(np.abs(total) @ spends)))
        ways = flown.towards(np.sign(total))
    assert np.sum(np.abs(u) @ spends) < reached <= bound
    assert reached > 0.55 * bound


MATRIX = {}, {"delay": 1.0}, {"carried": 0.0399}, {"carried": 0.0399, "delay": 1.5, "observer": True}
"""Loops with one matrix of errors in a whole flight; 0.004 N are its share of what is carried."""


def constant(case):
    """S with thrusters whose errors are one matrix, and the inputs of its loop but for that."""
    s = tracking(proportional=True, **case)
    for errors in (s.system.thrusters, s.system.on_time):
        object.__setattr__(errors, "constant", True)
    return s, steps(s)[0].inputs[0]


def about_middles(s, inputs):
    """S in many periods about its middle, with the matrix in the loop state, and where that begins."""
    u, bounds = middles(s.system.m), s.system.matrix
    inside = [inputs.about(s.loop, c) for c in u]
    both = np.hstack([u, 0 * u])
    parts = [slice(i, i + STEP) for i in range(0, PERIODS, STEP)]
    G = block_diag(carried_across(s.loop, s.system), np.diag(bounds[np.nonzero(bounds)]))
    return [LinearStep(tuple(inside[p]), both[p]) for p in parts], Zonotope(np.zeros(len(G)), G)


def spent_with(s, inputs, M, ways, left):
    """Fly under a matrix M with values by `ways` (PERIODS, k) and impulses `left`; return what is spent [N].

    Also where values would spend more. With a carried bit what is made is not less than a flight may make.
    """
    u, own, carried = middles(s.system.m), np.diag(np.diag(M)), s.system.timing.carried_impulse > 0
    number = inputs.held + (inputs.enter.shape[1] - inputs.held) // 2  # errors that grow are flown by hand
    scale = np.ones(number)
    scale[inputs.held :] = np.resize(inputs.bits, number - inputs.held)
    enter, answers, B = inputs.enter[:, :number] * scale, inputs.own[:, :number] * scale, s.loop.made
    group = np.concatenate([inputs.group[: inputs.held], inputs.group[inputs.held : number]])
    size = np.zeros((PERIODS, group[-1] + 1))
    np.add.at(size.T, group, ways.T**2)
    v = ways / np.sqrt(np.maximum(size, 1e-300))[:, group]
    y, commanded, total = np.zeros(len(inputs.F)), np.zeros_like(u), 0.0
    for i in range(PERIODS):
        commanded[i] = u[i] - inputs.K @ y + answers @ v[i]
        made = M @ commanded[i] + (M - own) @ (left[i] - left[i + 1]) / H
        y = inputs.F @ y + enter @ v[i] + B @ made
        across = np.abs(M - own) @ np.abs(commanded[i])
        total += (
            (np.abs((1 + np.diag(M)) * commanded[i]) + across).sum()
            if carried
            else np.abs(commanded[i] + M @ commanded[i]).sum()
        )
    later, better = np.zeros(len(inputs.F)), np.zeros_like(ways)
    for i in reversed(range(PERIODS)):
        more = (np.eye(len(M)) + M).T @ np.sign(commanded[i] + M @ commanded[i])
        if carried:
            more = (1 + np.diag(M) + np.abs(M - own).sum(axis=0)) * np.sign(commanded[i])
        more = more + M.T @ B.T @ later
        better[i] = enter.T @ later + answers.T @ more
        later = inputs.F.T @ later - inputs.K.T @ more
    return total, better


@pytest.mark.parametrize("case", MATRIX, ids=lambda case: "-".join(case) or "held")
def test_no_flight_with_one_matrix_spends_more(case):
    """At every corner of the matrix, commands in the middle being known; sequences would spend more."""
    (s, inputs), rng = constant(case), np.random.default_rng(0)
    whole, start = about_middles(s, inputs)
    bound = storage.bound(whole, storage.weights(whole, start), start)
    m, count, reached = s.system.m, inputs.held + (inputs.enter.shape[1] - inputs.held) // 2, 0.0
    for signs in product((-1, 1), repeat=m * m):
        M = np.reshape(signs, (m, m)) * s.system.matrix
        ways, left = (
            rng.normal(size=(PERIODS, count)),
            rng.choice([-1, 1], (PERIODS + 1, m)) * s.system.timing.carried_impulse,
        )
        for _ in range(4):
            total, ways = spent_with(s, inputs, M, ways, left)
            reached = max(reached, total)
    assert 0.55 * bound < reached <= bound
    varying = steps(s)
    saved = 1 - bound / storage.bound(varying, storage.weights(varying, nowhere(s)), nowhere(s))
    assert saved > (0.0 if "carried" in case else 0.12)


@pytest.mark.parametrize("case", MATRIX, ids=lambda case: "-".join(case) or "held")
def test_both_programs_hold_the_matrix_alike(case):
    s, inputs = constant(case)
    craft = checker_tightenings(s, None).craft
    loop = MeanCommands(
        craft, craft.plant.thruster_error(craft.plant.u_max), diagonal([arb(x) for x in s.worst_noise])
    )
    for c in middles(s.system.m)[[0, 100, -1]]:
        ours, theirs = inputs.about(s.loop, c), TurnedCommands(craft, loop, column(c.tolist()))
        for name in ("F", "K", "own", "squares"):
            entries = [[float(x) for x in row] for row in getattr(theirs, name).tolist()]
            assert np.allclose(getattr(ours, name), entries, rtol=1e-9, atol=1e-12), name
        assert np.allclose(ours.spends, [float(x) for x in theirs.spends], rtol=1e-9)
        entries = np.array([[float(x) for x in row] for row in theirs.enter.tolist()])
        assert np.all(np.abs(entries) <= np.abs(ours.enter) * (1 + 1e-9) + 1e-12)  # rests are smaller
        assert [len(ours.group), ours.held] == [theirs.enter.ncols(), theirs.held]
        assert sum(map(len, theirs.groups)) == ours.held == 1 + max(map(max, theirs.groups))
    known = carried_across(s.loop, s.system)
    entries = [[float(x) for x in row] for row in checked.carried_across(craft).tolist()]
    assert np.allclose(known, np.array(entries).reshape(known.shape), rtol=1e-9)


def test_any_weights_are_sound_and_those_chosen_hardly_to_be_bettered():
    s = tracking(delay=1.0, carried=0.01, proportional=True)
    whole, rng = steps(s), np.random.default_rng(0)
    chosen = storage.weights(whole, nowhere(s))
    least, bounds = storage.bound(whole, chosen, nowhere(s)), []
    for _ in range(30):
        r, b = (np.exp(rng.normal(0, 0.3, len(part))) for part in (chosen[0].r, chosen[0].b))
        bounds.append(storage.bound(whole, [Weights(w.r * r, w.b * b) for w in chosen], nowhere(s)))
    assert min(bounds) > 0.97 * least and np.any(np.isfinite(bounds))
    assert (
        storage.bound(whole, [w * 0.5 for w in chosen], nowhere(s)) == np.inf
    )  # too small ones bound nothing


def test_rounding_of_a_storage_is_booked_in_the_units_of_every_state():
    """States of 1e-13 and 0.8 side by side: neither grows by more than its own share."""
    P = arb_mat([[arb(1e-13, 1e-28), arb(1e-8, 1e-24)], [arb(1e-8, 1e-24), arb(0.8, 1e-16)]])
    rounded = checked._rounded(P, column([0.0, 0.0]), arb(0))
    assert all(1 < float(rounded.P[i, i] / P[i, i]) < 1 + 1e-6 for i in range(2))


@pytest.mark.parametrize("seed", range(4))
def test_a_storage_is_bounded_over_a_set_by_little_more_than_it_reaches(seed):
    rng = np.random.default_rng(seed)
    half, G = rng.normal(size=(4, 4)), rng.normal(size=(4, 7))
    after = Storage(half @ half.T, rng.normal(size=4), 1.5)
    corners = np.array(np.meshgrid(*[[-1, 1]] * 7)).reshape(7, -1)
    y = G @ corners
    reached = float((after.cost + np.einsum("ik,ij,jk->k", y, after.P, y) / 2 + after.p @ y).max())
    bound = storage.largest(after, Zonotope(np.zeros(4), G))
    again = checked.Storage(matrix(after.P.tolist()), column(after.p.tolist()), arb(after.cost))
    derived = again.largest(Enclosed(arb_mat(4, 1), matrix(G.tolist())))
    assert reached <= bound <= 1.15 * reached and float(derived) == pytest.approx(bound, rel=1e-3)
    assert reached <= float(derived.upper())


@pytest.mark.parametrize("case", CASES, ids=lambda case: "-".join(case) or "estimate")
def test_synthesis_and_checker_store_alike(case):
    """Under the same weights, and a jump of the reference costs what it may."""
    s = tracking(**case)
    whole = steps(s)[-3:]
    chosen = storage.weights(whole, nowhere(s))
    *_, store = storage.storage(whole, chosen)
    craft = checker_tightenings(s, None).craft
    bands = diagonal([arb(x) for x in s.worst_noise])
    loop = MeanCommands(craft, craft.plant.thruster_error(craft.plant.u_max), bands)
    after = checked.Storage(arb_mat(s.loop.N, s.loop.N), arb_mat(s.loop.N, 1), arb(0))
    for step, weights in zip(reversed(whole), reversed(chosen), strict=True):
        columns = checked._columns(loop, weights.b.tolist())
        for c in step.middle[::-1]:
            period = WeightedPeriod(loop, (weights.r + np.abs(c)).tolist(), columns)
            after = after.before(period, column(c.tolist()))
    assert float(after.cost) == pytest.approx(store.cost, rel=5e-3)
    P = np.array([[float(x) for x in row] for row in after.P.tolist()])
    p, rng = np.array([float(x) for x in after.p.entries()]), np.random.default_rng(0)
    for y in rng.normal(size=(50, s.loop.N)):
        y = y * np.sqrt(2 * store.cost / (y @ store.P @ y))  # as much in the state as beside it
        ours, theirs = (each @ y + y @ M @ y / 2 for each, M in ((store.p, store.P), (p, P)))
        assert -0.4 * store.cost <= theirs - ours <= 1e-3 * store.cost  # its rests within periods are smaller
    jump = np.full(s.loop.N, 1e-3)
    moved = after.jumped(column(jump.tolist()))
    for _ in range(100):
        y, off = rng.normal(size=s.loop.N), rng.choice([-1, 1], s.loop.N) * jump
        values = [
            float(each.cost)
            + z @ np.array([[float(x) for x in row] for row in each.P.tolist()]) @ z / 2
            + np.array([float(x) for x in each.p.entries()]) @ z
            for each, z in ((after, y + off), (moved, y))
        ]
        assert values[0] <= values[1] * (1 + 1e-12)
    small = WeightedPeriod(loop, weights.r.tolist(), [x * 1e-3 for x in columns])
    with pytest.raises(Undecided, match="too small"):
        after.before(small, column([0.0] * s.system.m))


def test_all_laws_of_a_flight_are_looked_at_at_once(tmp_path):
    """Seed 5034: two of three controllers are affine, one clips, and one does anything."""
    _, schedule = synthesised(5034, tmp_path)
    q = schedule.safety.clearance.q
    flight = FlightSpending(schedule._spells, len(schedule.steps) * q)
    modes = [spell.commands is not None for spell in flight.spells]
    assert any(step.tube.slopes is not None for step in schedule.steps)
    assert [len(run) for run in flight.runs] == [
        len(list(run)) for run in np.split(np.arange(len(modes)), np.flatnonzero(np.diff(modes)) + 1)
    ]
    for k, spell in enumerate(flight.spells):
        if spell.linear is not None:
            assert np.all(np.abs(spell.linear.middle) <= spell.commands * (1 + 1e-9)), k
    assert flight.thrust_bound(flight.periods) <= flight.apart(flight.periods) * (1 + 1e-9)
