"""Storages of whole flights (Proposition 14 (c)) against flights coded by hand, and in both programs."""

import numpy as np
import pytest

pytest.importorskip("flint")
from flint import arb, arb_mat, ctx

from polaris.certificate.claims import storage as checked
from polaris.certificate.claims.mean_spending import MeanCommands, WeightedPeriod
from polaris.certificate.kernel.balls import PRECISION, column, diagonal, matrix
from polaris.certificate.kernel.verdict import Undecided
from polaris.certificate.kernel.zonotopes import Zonotope as Enclosed
from polaris.synthesis.schedule.spending import FlightSpending
from polaris.synthesis.tracker import storage
from polaris.synthesis.tracker.long_flight import Inputs, Storage
from polaris.synthesis.tracker.storage import LinearStep
from reach import Zonotope
from tests.polaris.certificate.test_mean_spending import PERIODS, Flown
from tests.polaris.random_scenarios import synthesised
from tests.polaris.synthesis.schedule.test_hand_over import CASES, checker_tightenings, tracking

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
    s = tracking(**case)
    flights, rng, u = Flown(s), np.random.default_rng(0), middles(s.system.m)
    whole = steps(s)
    weights = storage.weights(whole, nowhere(s))
    bound = storage.bound(whole, weights, nowhere(s))
    spends, count, reached = whole[0].inputs[0].spends, flights.answers.shape[1], 0.0
    ways = rng.normal(size=(PERIODS, count))
    for _ in range(8):  # each time towards where it went
        total = flights.fly(ways, u) + u
        reached = max(reached, float(np.sum(np.abs(total) @ spends)))
        ways = flights.towards(np.sign(total))
    assert np.sum(np.abs(u) @ spends) < reached <= bound
    assert reached > 0.55 * bound


@pytest.mark.parametrize("seed", range(4))
def test_a_storage_is_bounded_over_a_set_by_little_more_than_it_reaches(seed):
    rng = np.random.default_rng(seed)
    half, G = rng.normal(size=(4, 4)), rng.normal(size=(4, 7))
    after = Storage(half @ half.T, rng.normal(size=4), 1.5)
    corners = np.array(np.meshgrid(*[[-1, 1]] * 7)).reshape(7, -1)
    y = G @ corners
    reached = float((after.cost + np.einsum("ik,ij,jk->k", y, after.P, y) / 2 + after.p @ y).max())
    bound = storage.largest(after, Zonotope(np.zeros(4), G))
    checker_storage = checked.Storage(matrix(after.P.tolist()), column(after.p.tolist()), arb(after.cost))
    derived = checker_storage.largest(Enclosed(arb_mat(4, 1), matrix(G.tolist())))
    assert reached <= bound <= 1.15 * reached and float(derived) == pytest.approx(bound, rel=1e-3)
    assert reached <= float(derived.upper())


def numbers(M):
    """Return the middles of a matrix of the checker."""
    return np.array([[float(x) for x in row] for row in M.tolist()])


@pytest.mark.parametrize("case", CASES, ids=lambda case: "-".join(case) or "estimate")
def test_synthesis_and_checker_store_alike(case):
    s = tracking(**case)
    whole = steps(s)[-3:]
    chosen = storage.weights(whole, nowhere(s))
    *_, store = storage.storage(whole, chosen)
    craft = checker_tightenings(s, None).craft
    bands = diagonal([arb(x) for x in s.worst_noise])
    loop = MeanCommands(craft, craft.plant.thruster_error(craft.plant.u_max), bands)
    after = checked.Storage(arb_mat(s.loop.N, s.loop.N), arb_mat(s.loop.N, 1), arb(0))
    for step, weights in zip(reversed(whole), reversed(chosen), strict=True):
        columns = checked.by_value(loop, weights.b.tolist())
        for c in step.middle[::-1]:
            period = WeightedPeriod(loop, (weights.r + np.abs(c)).tolist(), columns)
            after = after.before(period, column(c.tolist()))
    assert float(after.cost) == pytest.approx(store.cost, rel=5e-3)
    P, p, rng = numbers(after.P), numbers(after.p)[:, 0], np.random.default_rng(0)
    for y in rng.normal(size=(50, s.loop.N)):
        y = y * np.sqrt(2 * store.cost / (y @ store.P @ y))  # as much in the state as beside it
        ours, theirs = (each @ y + y @ M @ y / 2 for each, M in ((store.p, store.P), (p, P)))
        assert -0.4 * store.cost <= theirs - ours <= 1e-3 * store.cost  # its rests within periods are smaller
    jump = np.full(s.loop.N, 1e-3)
    shifted = after.jumped(column(jump.tolist()))
    Q, q = numbers(shifted.P), numbers(shifted.p)[:, 0]
    for _ in range(100):
        y, offset = rng.normal(size=s.loop.N), rng.choice([-1, 1], s.loop.N) * jump
        z, bound = y + offset, float(shifted.cost) + y @ Q @ y / 2 + q @ y
        assert float(after.cost) + z @ P @ z / 2 + p @ z <= bound * (1 + 1e-12)
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
    assert flight.thrust_bound(flight.periods) <= flight.summed(flight.periods) * (1 + 1e-9)
