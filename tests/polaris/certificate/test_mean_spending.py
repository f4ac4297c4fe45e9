"""Mean of what S spends for ever (Proposition 14 (d)), against flights that add up what a unit error does."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("flint")
from flint import arb, arb_mat, ctx

from polaris.certificate.claims.mean_spending import MeanCommands
from polaris.certificate.kernel.balls import (
    PRECISION,
    above,
    column,
    diagonal,
    identity,
    largest,
    magnitude,
    matrix,
    sums,
)
from polaris.certificate.model.craft.tightening import Tightening
from polaris.model.thrusters import Thrusters
from polaris.synthesis.tracker.long_flight import Inputs
from tests.polaris.synthesis.schedule.test_hand_over import (
    BEFORE,
    CASES,
    PARTS,
    Flight,
    checker_tightenings,
    tracking,
)

REMEMBERED, PERIODS = 80, 240


@pytest.fixture(autouse=True)
def precision():
    """Work with as many bits as the checker does."""
    with ctx.workprec(PRECISION):
        yield


class Flown:
    """Flights from rest: what errors of a unit in one period do to commands, added up."""

    def __init__(self, s):
        self.system, self.p, self.m = s.system, s.system.p, s.system.m
        system, self.thrusts = self.system, PARTS * (self.p + 2 * self.m)
        self.answers = Flight(s, BEFORE, BEFORE + REMEMBERED).fly()[1]
        if system.observer is not None:
            offset = system.state_offset - system.carry_offset
            noise = system.observer.noise + np.abs(system.observer.measures) @ offset
        elif system.timing.missed:
            noise = system.estimate_bound(system.u_max)
        else:
            noise = np.array(system.timing.measured_error) + system.state_offset - system.carry_offset
        carried = np.full(self.m, system.timing.carried_impulse)
        self.sampled = np.concatenate([noise, carried])

    def fly(self, ways, middle=0.0):
        """Commands under errors as large as may be, of given directions by period and error.

        Besides a middle (periods, m) that is commanded and flown.
        """
        system, p, m = self.system, self.p, self.m
        pushes = ways[:, : self.thrusts].reshape(-1, PARTS, p + 2 * m)
        length = np.linalg.norm(pushes[:, :, :p], axis=2, keepdims=True)
        commands = np.zeros((len(ways) + REMEMBERED, m))
        for k, (way, push) in enumerate(zip(ways, pushes, strict=True)):
            value = np.sign(way[self.thrusts :]) * self.sampled
            commands[k : k + REMEMBERED] += np.einsum("tri,r->ti", self.answers[:, self.thrusts :], value)
            u = commands[k] + np.broadcast_to(middle, ways.shape[:1] + (m,))[k]
            sizes = np.concatenate([np.zeros(p), system.thrusters.error(np.abs(u)), system.shifted])
            each = np.sign(push) * sizes
            each[:, :p] = system.w_max * push[:, :p] / np.maximum(length[k], 1e-12)
            value = each.ravel()
            commands[k : k + REMEMBERED] += np.einsum("tri,r->ti", self.answers[:, : self.thrusts], value)
        return commands[: len(ways)]

    def towards(self, signs):
        """Directions of errors in which commands go farthest along signs (periods, m)."""
        later = np.vstack([signs, np.zeros((REMEMBERED, self.m))])
        windows = np.array([later[k : k + REMEMBERED] for k in range(len(signs))])
        return np.einsum("tri,kti->kr", self.answers, windows)


def loop(s):
    """Return what the checker makes of a tracker, its tightenings and the most of commands."""
    tightenings = checker_tightenings(s, None)
    craft, lagged = tightenings.craft, tightenings.craft.lag_error(tightenings.craft.plant.u_max)
    tops = [x.upper() for x in sums(tightenings.peak, craft.noise(lagged))]
    noise_map = craft.gain * craft.carry * diagonal(craft.missed(lagged))
    return MeanCommands(craft, craft.plant.thruster_error(tops), noise_map), tightenings, tops


def bounds(s):
    """Return what a period costs, what is spent once, and the weights and most of commands."""
    commands, tightenings, tops = loop(s)
    one = identity(commands.F.nrows())
    both = Tightening(tightenings.craft, tightenings.settling, above(one, -one)).peak
    box = column([largest(pair) for pair in zip(both[: one.nrows()], both[one.nrows() :], strict=True)])
    storage = commands.storage()
    once = sum((x * x for x in (magnitude(storage.rows) * box).entries()), arb(0)) / 2
    weights, limits = (np.array([float(x) for x in each]) for each in (commands.spends, tops))
    return float(storage.cost), float(once), weights, limits


EACH = pytest.mark.parametrize("case", CASES, ids=lambda case: "-".join(case) or "estimate")


@EACH
def test_no_flight_spends_more_on_average_in_any_periods(case):
    """The worst of them, which fly as far as errors can, spend 0.4 of the mean or more."""
    s, rng = tracking(**case), np.random.default_rng(0)
    flights, (cost, once, weights, tops) = Flown(s), bounds(s)
    assert once > 0
    count, ratios = flights.answers.shape[1], []
    for axis in (*range(s.system.m), None):
        wave = np.sign(np.cos(rng.uniform(0.02, 1) * np.arange(PERIODS)))[:, None] * rng.normal(size=count)
        for ways in (rng.normal(size=(PERIODS, count)), wave):
            for _ in range(3):  # each time towards where it went
                u = flights.fly(ways)
                costs = np.abs(u) @ weights
                beyond = np.cumsum(np.append(0.0, costs - cost))
                assert np.all(beyond - np.minimum.accumulate(beyond) <= once), "some periods"
                assert np.all(np.abs(u) <= tops)
                ratios.append(costs.mean() / cost)
                ways = flights.towards(np.sign(u) * (1 if axis is None else np.arange(s.system.m) == axis))
    assert max(ratios) > 0.4


@EACH
def test_synthesis_and_checker_find_a_storage_that_costs_as_much(case):
    s = tracking(**case)
    commands, _, tops = loop(s)
    limits = np.array([float(x) for x in tops])
    within, rounding = (limits, s.system.u_max), np.zeros(s.system.n)
    inputs = Inputs.from_loop(s.tightening.closed, s.system, within, s.step_errors[-1], rounding)
    _, cost = inputs.storage()
    assert 0.97 * cost < float(commands.storage().cost) <= cost
    assert replace(inputs, F=1.05 * np.eye(len(inputs.F))).storage() is None, "it would run away"
    flights = np.random.default_rng(0).uniform(-1, 1, (4, 300, len(inputs.group)))
    for values in flights:  # whatever enters, the storage pays: all values at their bounds, thrusters exact
        z, total = np.zeros(len(inputs.F)), 0.0
        for each in np.sign(values):
            each[inputs.count :] = 0
            size = inputs.grouped(each)[inputs.group]
            each = np.divide(each, size, out=np.zeros_like(each), where=size > 0)
            total += inputs.spends @ np.abs(-inputs.K @ z + inputs.feed @ each)
            z = inputs.F @ z + inputs.enter @ each
        assert total <= 300 * cost


@pytest.mark.parametrize("seed", range(3))
def test_squares_of_errors_and_what_is_spent_hold_for_layouts_and_without(seed):
    """Of any commands, in both programs: a table of shares that is not symmetric, or errors by direction."""
    rng, s = np.random.default_rng(seed), tracking()
    shares, weights = rng.uniform(0, 0.2, (2, 2)), rng.uniform(1, 2, 2)
    thrusters = Thrusters(0.1, 0.05) if seed == 0 else Thrusters(shares=tuple(map(tuple, shares.tolist())))
    nozzles = None if seed == 0 else SimpleNamespace(weights=weights)
    timing = replace(s.system.timing, on_time=thrusters)
    system = replace(s.system, thrusters=thrusters, nozzles=nozzles, timing=timing)
    zero = np.zeros(4)
    inputs = Inputs.from_loop(s.tightening.closed, system, (system.u_max, system.u_max), zero, zero)
    craft = checker_tightenings(s, None).craft
    errors = {"along": 0.1, "across": 0.05} if seed == 0 else {"shares": matrix(shares.tolist()).tolist()}
    errors |= {} if seed == 0 else {"weights": tuple(map(arb, weights.tolist()))}
    craft = replace(craft, plant=replace(craft.plant, on_time=None, **errors))
    commands = MeanCommands(craft, [arb(0)] * 2, arb_mat(2, 0))
    u = rng.normal(size=(100, 2))
    error, counted = thrusters.part(np.abs(u)), (np.abs(u) + thrusters.part(np.abs(u))) @ system.weights
    squares = np.array([[float(x) for x in row] for row in commands.squares.tolist()])
    assert np.allclose(squares, inputs.squares) and np.all(error**2 <= u**2 @ squares.T * (1 + 1e-9))
    assert np.allclose([float(x) for x in commands.spends], inputs.spends)
    assert np.all(counted <= np.abs(u) @ inputs.spends * (1 + 1e-9))
    assert counted.max() > 0.9 * (np.abs(u) @ inputs.spends).max()
