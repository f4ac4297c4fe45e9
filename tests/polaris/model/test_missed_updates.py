"""An observer that misses periods: no pattern, outage or history of commands leads beyond its bounds."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from polaris.model.craft import Craft
from polaris.model.errors import ScenarioError
from polaris.model.estimates.observer import design, observing
from polaris.model.estimates.prediction import predicting
from polaris.model.hill import clohessy_wiltshire
from polaris.model.thrusters import Thrusters
from polaris.model.timing import Timing, Transient
from polaris.synthesis.tracker.feedback import Feedback
from polaris.synthesis.tracker.lqr import lqr_gain
from polaris.synthesis.tracker.tracking import Tracking

PARTS = 4  # of a period, over each of which what pushes is constant


def random_observer(seed, along=0.05, initial=False):
    """Return a random craft whose observer may miss some periods, with its period and their number."""
    rng = np.random.default_rng(seed)
    h, missed = float(rng.choice([1.0, 2.0, 5.0])), int(rng.integers(1, 4))
    if seed % 2:
        plain = clohessy_wiltshire(
            float(rng.uniform(8e-4, 1.2e-3)), 10.0, np.full(3, 0.2), 10 ** rng.uniform(-6, -4)
        )
    else:
        A = np.array([[0.0, 1.0], [-rng.uniform(0, 0.02), -rng.uniform(0, 0.1)]])
        B = np.array([[0.0], [0.1]])
        plain = Craft(A, B, B, np.array([0.3]), 10 ** rng.uniform(-4, -2), np.eye(1, 2))
    craft = replace(Craft.from_system(plain), thrusters=Thrusters(along, 0.3 * along, 0.0))
    half = craft.n // 2
    noise = rng.uniform(0.02, 0.2, half)
    observer = design(craft, np.eye(half, craft.n), noise, h, missed, boxed=True)
    if initial:
        first = np.r_[rng.uniform(0.5, 4, half) * noise, rng.uniform(0, 0.5, half) * noise / h]
        observer = replace(observer, initial=first, horizon=(8, 5))
    return observing(craft, observer, h), h, missed


def test_an_observer_may_forget_within_fewer_periods_than_may_be_missed():
    plain = Craft(np.diag([1.0], 1), np.array([[0.0], [1.0]]), np.array([[0.0], [1.0]]), np.ones(1), 1e-2)
    craft = replace(plain, thrusters=Thrusters(0.05))
    observer = design(craft, np.eye(2), np.full(2, 1e-3), 1.0, 12, boxed=True)
    assert observing(craft, observer, 1.0).observer.followed > 0


def patterns(rng, missed, periods, count):
    """Yield numbers of periods between updates, the last one first, that come to so many periods."""
    for i in range(count):
        if i <= missed:
            gaps = np.full(periods, i + 1)
        else:
            gaps = rng.choice(missed + 1, periods, p=rng.dirichlet(np.full(missed + 1, 0.5))) + 1
        yield gaps[: int(np.searchsorted(np.cumsum(gaps), periods - missed)) + 1]


def reached(craft, h, gaps, errors, first=None):
    """Return the largest errors (n,) after updates, thrusters being off by errors (age, m) in a period."""
    observer, n = craft.observer, craft.n
    gains = (observer.gain, *observer.after)
    whole = expm(np.block([[craft.A, np.eye(n)], [np.zeros((n, 2 * n))]]) * h / PARTS)
    part, input_map = whole[:n, :n], whole[:n, n:]
    transition, total, age = np.eye(n), np.zeros(n), 0
    for gap in gaps:
        L, rest = gains[gap - 1], observer.rests[gap - 1]
        total = total + np.abs(transition @ L) @ observer.noise
        transition = transition @ rest
        for _ in range(gap):
            for _ in range(PARTS):
                total = total + np.linalg.norm(transition @ input_map @ craft.D, axis=1) * craft.w_max
                total = total + np.abs(transition @ input_map @ craft.B) @ errors[min(age, len(errors) - 1)]
                transition = transition @ part
            age += 1
    return total if first is None else total + np.abs(transition) @ first


@pytest.mark.parametrize("seed", range(8))
def test_errors_grow_with_commands_of_every_age_no_more_than_is_stated(seed):
    craft, h, missed = random_observer(seed)
    rng, observer, part = np.random.default_rng(seed), craft.observer, craft.thrusters.part
    full, ages, worst = part(craft.u_max), observer.ages, 0.0
    assert len(ages) > 2
    for trial in range(6):
        count = ages[-1] + int(rng.integers(0, 60))
        share = np.minimum(rng.uniform(0.01, 0.3) + (np.arange(count) >= rng.integers(0, count)), 1.0)
        if trial % 3 == 0:
            share = rng.random(count) ** 2
        errors = part(share[:, None] * craft.u_max)
        recent = [part(share[:age].max() * craft.u_max) for age in ages[1:]]
        bound = craft.navigation - sum(
            fall @ (full - each) for fall, each in zip(observer.fallen, recent, strict=True)
        )
        for gaps in patterns(rng, missed, count, 12):
            sizes = reached(craft, h, gaps, np.vstack([errors, full]))
            assert np.all(sizes <= bound)
            worst = max(worst, float(np.max(sizes / bound)))
    assert worst > 0.5


@pytest.mark.parametrize("seed", range(8))
def test_first_errors_are_forgotten_as_is_stated_in_every_step(seed):
    craft, h, missed = random_observer(seed, initial=True)
    rng, (steps, periods), worst = np.random.default_rng(seed), craft.observer.horizon, 0.0
    full = craft.thrusters.part(craft.u_max)[None]
    for node in range(0, steps * periods, 3):
        for gaps in patterns(rng, missed, node + missed, 8):
            gaps = gaps[np.cumsum(gaps) <= node]
            at = int(gaps.sum())
            errors = reached(craft, h, gaps, full, craft.observer.initial)
            bounds = craft.error_by_step[at // periods : min(at + missed, steps * periods - 1) // periods + 1]
            assert np.all(errors <= bounds)
            worst = max(worst, float(np.max(errors / bounds)))
    assert worst > 0.5


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("late", [0, 1])
def test_flights_with_an_outage_keep_to_what_limits_are_tightened_by(seed, late):
    """S from rest, every measurement and disturbance at its worst, by patterns before, in and after it."""
    plain, h, missed = random_observer(seed, along=0.0)
    rng, worst = np.random.default_rng(seed), 0.0
    lasts = h * float(rng.integers(1, 9))
    craft = predicting(plain, Timing(delay=late * h, missed=missed), h)
    fault = Transient("navigation_lost", lasts, np.zeros((0, craft.m)), 1.0, np.zeros((craft.m, craft.n)))
    craft, n, p = replace(craft, transients=(fault,)), craft.n, craft.p
    gain = lqr_gain(craft, np.eye(n), 1e4 * np.eye(craft.m))
    tracking = Tracking(craft, gain, Feedback(1), h, 0.9)
    bound = tracking.disturbance(np.vstack([np.eye(n), -np.eye(n)]))[:, :n]
    inputs = np.hstack([craft.B, craft.D * craft.w_max])
    block = expm(np.block([[craft.A, inputs], [np.zeros((craft.m + p, n + craft.m + p))]]) * h)
    step, input_map, push_map = block[:n, :n], block[:n, n : n + craft.m], block[:n, n + craft.m :]
    observer, past, duration = craft.observer, 60, 40
    gains, r, nodes = (observer.gain, *observer.after), len(observer.noise), past + duration
    for _ in range(10):
        first, share = past + int(rng.integers(0, 8)), float(rng.choice([0.2, 0.5, 0.9]))
        outage = range(first, first + round(lasts / h))
        x, since = np.zeros((n, nodes, r + p)), 0
        error, pushes, estimates = 0 * x, [], []
        for i in range(nodes):
            estimates.append(error)
            pushes.append(np.zeros_like(x))
            pushes[-1][:, i, r:] = push_map
            if i >= past:
                predicted = x + _carried(step, estimates[i - late], pushes[i - late : i])
                x = np.tensordot(step, x, 1) - np.tensordot(input_map @ gain, predicted, 1) + pushes[-1]
                errors = np.abs(x[..., :r]).sum(axis=(1, 2)) + np.linalg.norm(x[..., r:], axis=2).sum(axis=1)
                at = bound[min(i + 1 - past, len(bound) - 1)]
                assert np.all(errors <= at)
                worst = max(worst, float(np.max(errors / at)))
            error = np.tensordot(step, error, 1) - pushes[-1]
            if i + 1 in outage or (since < missed and rng.random() < share):
                since += 1
                continue
            L, since = gains[min(since, missed)], 0
            error = error - np.tensordot(L @ observer.measures, error, 1)
            error[:, i, :r] += L * observer.noise
    assert worst > 0.05


def _carried(step, error, pushes):
    """Return errors of a prediction from an estimate, which knows of no push since."""
    for push in pushes:
        error = np.tensordot(step, error, 1) - push
    return error


def test_an_observer_that_never_forgets_is_refused():
    craft, h, _ = random_observer(0)
    observer = replace(craft.observer, gain=0 * craft.observer.gain)
    with pytest.raises(ScenarioError):
        observing(replace(craft, estimate_error=None), observer, h)
