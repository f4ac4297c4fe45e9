"""Bounds on what S spends in long flights (Proposition 14 (d)) against a flight computer coded by hand."""

import numpy as np
import pytest

from polaris.synthesis.tracker.long_flight import LongFlight
from tests.polaris.test_hand_over import BEFORE, PARTS, Flight, tracking

LONG = 200  # periods in which all responses die out


def long_flight(s):
    """The long flight of a loop whose first state is known exactly."""
    return LongFlight(s, np.zeros(s.loop.N), s.system.u_max, np.zeros(s.system.m), s.system.u_max)


def peaks(s):
    """Largest root mean square of commands per unit of each error, (errors, m); those of a period as one."""
    _, u = Flight(s, BEFORE, BEFORE + LONG).fly()
    p, m = s.system.p, s.system.m
    pushes = u[:, : PARTS * (p + m)].reshape(len(u), PARTS, p + m, m).sum(axis=1)
    each = np.concatenate([pushes, u[:, PARTS * (p + m) :]], axis=1)
    return np.abs(np.fft.rfft(each, 1 << 14, axis=0)).max(axis=0)


CASES = [{}, {"delay": 1.0}, {"carried": 0.01}, {"observer": True}, {"observer": True, "delay": 1.0}]


@pytest.mark.parametrize("case", CASES, ids=str)
def test_no_frequency_of_any_error_makes_larger_commands(case):
    """Every error at its own worst frequency, all at once, comes close to the bound."""
    s = tracking(**case)
    system, p, m = s.system, s.system.p, s.system.m
    found = peaks(s)
    noise = system.observer.noise if system.observer else np.array(system.timing.measured)
    sizes = np.concatenate([noise, np.full(m, system.timing.carried)])
    reached = sizes @ found[p + m :] + system.w_max * found[:p].max(axis=0)
    bound = long_flight(s).mean()
    assert np.all(reached <= bound) and np.all(bound <= 1.3 * reached)


def test_errors_of_thrusters_follow_what_is_commanded_on_average():
    """The bound is the fixed point of what they add to the commands that cause them."""
    exact, s = tracking(delay=1.0), tracking(delay=1.0, proportional=True)
    p, m, errors = s.system.p, s.system.m, s.system.thrusters
    H, without, bound = peaks(s)[p : p + m].T, long_flight(exact).mean(), long_flight(s).mean()
    least = without
    for _ in range(200):
        least = without + H @ errors.error(least)
    assert np.all(least <= bound) and np.all(bound <= 1.2 * least)
    assert np.all(bound < s.tightening.settled())  # the largest command in each period


@pytest.mark.parametrize("proportional", [False, True])
def test_the_first_state_counts_once(proportional):
    s = tracking(delay=1.0, proportional=proportional)
    closed, thrusters, rng = s.tightening.closed, s.system.thrusters, np.random.default_rng(0)
    K, F, made = closed.K, closed.F, closed.loop.made
    start, worst = rng.uniform(0.01, 0.02, s.loop.N), np.zeros(2)
    once = LongFlight(s, start, s.system.u_max, np.zeros(2), s.system.u_max).once()
    for _ in range(50):
        z, total = start * rng.choice([-1.0, 1.0], s.loop.N), np.zeros(2)
        for _ in range(LONG):
            u = -K @ z
            total += np.abs(u)
            z = F @ z + made @ (thrusters.part(np.abs(u)) * rng.choice([-1.0, 1.0], 2))
        worst = np.maximum(worst, total)
    assert np.all(worst <= once) and np.all(worst > 0.3 * once)
