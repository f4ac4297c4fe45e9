"""Bounds on what S spends in long flights (Proposition 14 (d)) against a flight computer coded by hand."""

import numpy as np
import pytest

from polaris.synthesis.tracker.long_flight import Inputs
from tests.polaris.synthesis.schedule.test_hand_over import BEFORE, PARTS, Flight, tracking

LONG = 200  # periods in which all responses die out


def lasting(s):
    """The storage of a loop, and what a period costs."""
    bound, none = s.tightening.settled_bound(), np.zeros(s.system.n)
    return Inputs.from_loop(s.tightening.closed, s.system, (bound, bound), none, none).lasting()


def peaks(s):
    """Largest root mean square of commands per unit of each error, (errors, m); those of a period as one."""
    _, u = Flight(s, BEFORE, BEFORE + LONG).fly()
    p, m = s.system.p, s.system.m
    thrusts = PARTS * (p + 2 * m)
    pushes = u[:, :thrusts].reshape(len(u), PARTS, p + 2 * m, m).sum(axis=1)[:, : p + m]  # none by jitter
    each = np.concatenate([pushes, u[:, thrusts:]], axis=1)
    return np.abs(np.fft.rfft(each, 1 << 14, axis=0)).max(axis=0)


CASES = [{}, {"delay": 1.0}, {"carried": 0.01}, {"observer": True}, {"observer": True, "delay": 1.0}]


@pytest.mark.parametrize("case", CASES, ids=str)
def test_a_period_costs_no_more_than_with_every_error_at_its_own_worst_frequency(case):
    """Nor less than the square wave of one error, the worst for one command."""
    s = tracking(**case)
    system, p, m = s.system, s.system.p, s.system.m
    highest = peaks(s)
    noise = system.observer.noise if system.observer else np.array(system.timing.measured_error)
    sizes = np.concatenate([noise, np.full(m, system.timing.carried_impulse)])
    apart = sizes @ highest[p + m :] + system.w_max * highest[:p].max(axis=0)
    least = 8 / np.pi**2 * (sizes[:, None] * highest[p + m :]).max()
    assert least <= lasting(s)[1] <= 1.05 * apart.sum()


def test_errors_of_thrusters_follow_what_is_commanded_on_average():
    """A period costs less than the largest command in each period does, and more than without them."""
    exact, s = tracking(delay=1.0), tracking(delay=1.0, proportional=True)
    without, cost = lasting(exact)[1], lasting(s)[1]
    assert without < cost < s.system.spent(s.tightening.settled_bound()).sum()


@pytest.mark.parametrize("proportional", [False, True])
def test_the_first_state_counts_once(proportional):
    s = tracking(delay=1.0, proportional=proportional)
    closed, thrusters, rng = s.tightening.closed, s.system.thrusters, np.random.default_rng(0)
    K, F, made, (rows, cost) = closed.K, closed.F, closed.loop.made, lasting(s)
    start = rng.uniform(0.1, 0.2, s.loop.N)
    for _ in range(50):
        z, spent = start * rng.choice([-1.0, 1.0], s.loop.N), 0.0
        stored = float(np.sum((rows @ z) ** 2)) / 2
        for period in range(LONG):
            u = -K @ z
            spent += np.abs(u).sum()
            z = F @ z + made @ (thrusters.part(np.abs(u)) * rng.choice([-1.0, 1.0], 2))
            assert spent <= stored + (period + 1) * cost
