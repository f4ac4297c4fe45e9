"""Mean of S's commands for ever (Proposition 14 (d)), against flights that add up what a unit error does."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("flint")
from flint import arb

from polaris.certificate.claims.mean_commands import MeanCommands
from polaris.certificate.kernel.balls import above, column, identity, largest, matrix, sums
from polaris.certificate.model.craft.needs import Needs

from .test_hand_over import BEFORE, CASES, PARTS, Flight, checker_needs, tracking

REMEMBERED, PERIODS = 80, 240


class Flown:
    """Flights from rest: what errors of a unit in one period do to commands, added up."""

    def __init__(self, s, only=None):
        self.only, self.system, self.p, self.m = only, s.system, s.system.p, s.system.m
        system, thrusts = self.system, PARTS * (self.p + 2 * self.m)
        self.answers = Flight(s, BEFORE, BEFORE + REMEMBERED).fly()[1]
        if system.observer is not None:
            off = system.displaced - system.carried_away
            noise = system.observer.noise + np.abs(system.observer.measures) @ off
        elif system.timing.missed:
            noise = system.estimate_off(system.u_max)
        else:
            noise = np.array(system.timing.measured) + system.displaced - system.carried_away
        left = np.full(self.m, system.timing.carried)
        self.sampled = np.concatenate([noise * self.has("noise"), left * self.has("carried")])
        self.thrusts = thrusts

    def has(self, kind):
        """Return 1 if errors of a kind are flown, else 0."""
        return int(self.only in (None, kind))

    def fly(self, ways):
        """Commands under errors as large as may be, of given directions by period and error."""
        system, p, m = self.system, self.p, self.m
        pushes = ways[:, : self.thrusts].reshape(-1, PARTS, p + 2 * m)
        length = np.linalg.norm(pushes[:, :, :p], axis=2, keepdims=True)
        commands = np.zeros((len(ways) + REMEMBERED, m))
        for k, (way, push) in enumerate(zip(ways, pushes, strict=True)):
            value = np.sign(way[self.thrusts :]) * self.sampled
            commands[k : k + REMEMBERED] += np.einsum("tri,r->ti", self.answers[:, self.thrusts :], value)
            made = system.thrusters.error(np.abs(commands[k])) * self.has("thrusters")
            shifted = system.shifted * self.has("jitter")
            each = np.sign(push) * np.concatenate([np.zeros(p), made, shifted])
            each[:, :p] = system.w_max * self.has("disturbance") * push[:, :p] / np.maximum(length[k], 1e-12)
            value = each.ravel()
            commands[k : k + REMEMBERED] += np.einsum("tri,r->ti", self.answers[:, : self.thrusts], value)
        return commands[: len(ways)]

    def towards(self, signs):
        """Directions of errors in which commands go farthest along signs (periods, m)."""
        later = np.vstack([signs, np.zeros((REMEMBERED, self.m))])
        ahead = np.array([later[k : k + REMEMBERED] for k in range(len(signs))])
        return np.einsum("tri,kti->kr", self.answers, ahead)


def bounds(s, only=None):
    """Return U, L and the most that is commanded in any period, as the checker finds them."""
    needs = checker_needs(s, None)
    craft, off = needs.craft, needs.craft.lagged(needs.craft.plant.u_max)
    tops = [x.upper() for x in sums(needs.peak, craft.noise(off))]
    one = identity(craft.F.nrows())
    both = Needs(craft, needs.memory, above(one, -one)).peak
    box = column([largest(pair) for pair in zip(both[: one.nrows()], both[one.nrows() :], strict=True)])
    if only is not None:
        left = {} if only == "thrusters" else {"along": 0.0, "across": 0.0, "bits": ()}
        craft = replace(
            craft,
            plant=replace(craft.plant, **left),
            steady=craft.steady[:1] if only == "disturbance" else [],
            samples=craft.samples if only == "carried" else [],
            off=craft.off if only == "noise" else [arb(0)] * len(craft.off),
        )
    found = MeanCommands(craft, needs.memory, box, off).bounds(tops)
    return [np.array([float(x) for x in each]) for each in (*found, tops)]


def shares(s, only=None):
    """Fly as far as errors can, check the bounds in any periods, and return shares of the mean by input."""
    flown, (U, L, tops), rng = Flown(s, only), bounds(s, only), np.random.default_rng(0)
    assert np.all(tops > U) and np.all(L > 0)
    count, found = flown.answers.shape[1], []
    for axis in range(s.system.m):
        wave = np.sign(np.cos(rng.uniform(0.02, 1) * np.arange(PERIODS)))[:, None] * rng.normal(size=count)
        for ways in (rng.normal(size=(PERIODS, count)), wave):
            for _ in range(4):  # each time towards where it went
                u = flown.fly(ways)
                beyond = np.cumsum(np.vstack([0 * U, np.abs(u) - U]), axis=0)
                assert np.all(beyond - np.minimum.accumulate(beyond) <= L), "some periods"
                assert np.all(np.abs(u) <= tops)
                found.append(np.abs(u).mean(axis=0) / U)
                ways = flown.towards(np.sign(u) * (np.arange(s.system.m) == axis))
    return np.max(found, axis=0)


@pytest.mark.parametrize("case", CASES, ids=lambda case: "-".join(case) or "estimate")
def test_no_flight_commands_more_in_the_mean_in_any_periods(case):
    """Of several errors each counts at its own worst frequency, at which the others are less."""
    assert shares(tracking(**case)).max() > 0.3


@pytest.mark.parametrize("only", ["noise", "disturbance", "carried", "thrusters"])
def test_each_error_alone_comes_close_to_its_share(only):
    found = shares(tracking(delay=1.5, carried=0.02, proportional=only == "thrusters"), only)
    assert found.min() > 0.6


@pytest.mark.parametrize("case", [{}, {"delay": 2.0}])
def test_one_error_of_estimates_counts_with_the_peak_of_its_response(case):
    """And a square wave of that frequency comes within 60 % of it."""
    needs = checker_needs(tracking(**case), None)
    only = [arb(0.01), *[arb(0)] * 3]
    craft = replace(
        needs.craft, steady=[], off=only, plant=replace(needs.craft.plant, along=0.0, across=0.0, bits=())
    )
    box, none = column([arb(0)] * craft.F.nrows()), [arb(0)] * 4
    means = MeanCommands(craft, needs.memory, box, none)  # all periods
    U, L = (np.array([float(x) for x in each]) for each in means.bounds([arb(1), arb(1)]))
    K, F, held, noise = (
        np.array([[float(x.mid()) for x in row] for row in M.tolist()])
        for M in (craft.commands, craft.F, craft.held, craft.gain * craft.carry * matrix([[x] for x in only]))
    )
    z, u = np.zeros((len(F), 1)), [noise]
    while len(u) < 1000:
        z = F @ z + held @ u[-1] if len(u) == 1 else F @ z
        u.append(-K @ z)
    response = np.array(u)[:, :, 0]
    spectrum = np.abs(np.fft.rfft(response, 1 << 14, axis=0))
    assert np.all(L == 0) and np.all(spectrum.max(axis=0) <= U) and np.all(spectrum.max(axis=0) * 1.2 >= U)
    for axis, power in enumerate(spectrum.T):
        wave = np.sign(np.cos(2 * np.pi * power.argmax() / (1 << 14) * np.arange(4000) + 0.1))
        mean = np.abs(np.convolve(response[:, axis], wave)[:4000]).mean()
        assert 0.6 * U[axis] < mean <= U[axis]
