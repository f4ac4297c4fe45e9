"""The closest approach is the infimum over continuous time: against dense sampling and minimisation."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize_scalar

from polaris.inspection.closest import TOLERANCE, ClosestApproach, circle_map, map_norms
from polaris.inspection.constraints.passive import Passive
from polaris.model.hill import cw_matrix, free_flight
from tests.polaris.inspection import oracle

N_ORBIT = 1.027e-3
DENSE = 1501


def infimum(z, n, T):
    """Dense sampling, then a bounded search in the neighbourhood of the least few samples."""
    t = np.linspace(0, T, DENSE)
    d = np.sqrt((oracle.free_flight(z, n, t) ** 2).sum(axis=0))

    def distance(at):
        return np.sqrt((oracle.free_flight(z, n, at) ** 2).sum())

    low = np.flatnonzero((d <= np.r_[d[1:], np.inf]) & (d <= np.r_[np.inf, d[:-1]]))
    least, options = [d.min()], {"method": "bounded", "options": {"xatol": 1e-9}}
    for k in low[np.argsort(d[low])][:3]:
        ends = t[max(k - 1, 0)], t[min(k + 1, DENSE - 1)]
        least.append(minimize_scalar(distance, bounds=ends, **options).fun)
    return min(least)


def circular(rng, n, K):
    """Relative orbits of constant distance, slightly disturbed: flat, or with two minima close together."""
    r, phase = 10 ** rng.uniform(0, 3, K), rng.uniform(0, 2 * np.pi, K)
    s, c = np.sin(phase), np.cos(phase)
    z = np.stack([r / 2 * s, r * c, np.sqrt(0.75) * r * s], axis=1)
    v = n * np.stack([r / 2 * c, -r * s, np.sqrt(0.75) * r * c], axis=1)
    relative = 10.0 ** rng.uniform(-9, -2, (K, 1))
    return np.concatenate([z, v], axis=1) * (1 + relative * rng.standard_normal((K, 6)))


def flights(kind, rng, n, T, K):
    p = rng.standard_normal((K, 3)) * 10 ** rng.uniform(-1, 3, (K, 1))
    v = rng.standard_normal((K, 3)) * 10 ** rng.uniform(-5, 0.5, (K, 1))
    size = np.linalg.norm(p, axis=1, keepdims=True)
    if kind == "circular":
        return circular(rng, n, K)
    if kind == "slow":
        v = n * size * rng.standard_normal((K, 3)) * 10 ** rng.uniform(-3, 1, (K, 1))
    if kind == "tangential":
        v = np.cross(rng.standard_normal((K, 3)), p) * n * 10 ** rng.uniform(-1, 1, (K, 1))
    if kind == "along-track":  # stationary, or nearly
        p[:, [0, 2]] *= 1e-9
        v *= 1e-6
    if kind == "through the centre":
        t = rng.uniform(0, T, K)
        at = np.concatenate([rng.standard_normal((K, 3)) * 1e-4, v], axis=1)
        return np.einsum("kij,kj->ki", np.linalg.inv(free_flight(n, t)), at)
    return np.concatenate([p, v], axis=1)


KINDS = ("any", "slow", "tangential", "circular", "along-track", "through the centre")


@pytest.mark.parametrize("kind", KINDS)
def test_never_above_the_infimum(kind):
    rng = np.random.default_rng(KINDS.index(kind))
    for n in (1e-5, 1e-4, N_ORBIT, 1e-2):
        for T in (1.0, 19.0, 100.0, 500.0, np.pi / n):
            T = min(T, np.pi / n)
            z = flights(kind, rng, n, T, 8)
            nearest = ClosestApproach(n, T)(z)
            expected = np.array([infimum(one, n, T) for one in z])
            assert (nearest.distance <= expected + TOLERANCE).all(), (n, T)
            # and it is reached: the place is on the flight
            place = np.array([oracle.free_flight(a, n, t) for a, t in zip(z, nearest.when, strict=True)])
            size = np.abs(z).max(axis=1, initial=1.0) / min(n, 1e-3)
            assert (np.abs(place - nearest.place).max(axis=1) <= 1e-13 * size + 1e-9).all()
            np.testing.assert_allclose(np.linalg.norm(nearest.place, axis=1), nearest.distance, rtol=1e-12)
            assert (nearest.when >= 0).all() and (nearest.when <= T).all()


@given(st.integers(0, 10**6), st.floats(0.5, 300.0))
@settings(max_examples=60)
def test_beyond_is_a_lower_bound_and_never_below_its_limit(seed, beyond):
    rng = np.random.default_rng(seed)
    n, T = 10 ** rng.uniform(-4.5, -2), 10 ** rng.uniform(0, 2.4)
    approach = ClosestApproach(n, min(T, np.pi / n))
    z = flights(KINDS[seed % len(KINDS)], rng, n, approach.duration, 40)
    exact, some = approach(z).distance, approach(z, beyond).distance
    assert (some <= exact + TOLERANCE).all()
    near = exact <= beyond
    np.testing.assert_allclose(some[near], exact[near], rtol=1e-9, atol=1e-9)
    assert (some[~near] > beyond).all()


@pytest.mark.parametrize("n", [1e-5, N_ORBIT, 1e-2])
@pytest.mark.parametrize("fraction", [1e-3, 0.5, 1.0])
def test_speed_gain_bounds_the_speed_at_all_times(n, fraction):
    T = fraction * np.pi / n
    approach = ClosestApproach(n, T)
    per_metre, per_speed = map_norms(free_flight(n, np.linspace(0, T, 5000))[:, 3:])
    assert per_metre.max() <= approach.speed_gain[0] and per_speed.max() <= approach.speed_gain[1]


@pytest.mark.parametrize("n", [1e-5, N_ORBIT, 1e-2])
def test_amplitude_is_constant_and_bounds_every_derivative(n):
    rng = np.random.default_rng(6)
    z = np.concatenate([rng.uniform(-1e3, 1e3, (50, 3)), rng.uniform(-2, 2, (50, 3))], axis=1)
    amplitude = np.linalg.norm(z @ circle_map(n).T, axis=1)
    A = cw_matrix(n)
    for t in np.linspace(0, np.pi / n, 40):
        later = z @ free_flight(n, t).T
        np.testing.assert_allclose(np.linalg.norm(later @ circle_map(n).T, axis=1), amplitude, rtol=1e-9)
        derivative = later
        for order in (2, 3, 4):
            derivative = derivative @ A.T
            assert (np.linalg.norm(derivative[:, 3:], axis=1) <= n**order * amplitude * (1 + 1e-9)).all()


@given(st.integers(0, 10**6))
@settings(max_examples=40)
def test_gradient_of_the_infimum(seed):
    """Envelope theorem: the gradient is that of the distance at the time found; checked by differences."""
    rng = np.random.default_rng(seed)
    z = np.r_[rng.uniform(-300, 300, 3), rng.uniform(-1, 1, 3)]
    approach = ClosestApproach(N_ORBIT, 500.0)
    passive = Passive(10.0, approach)
    value = passive(z)
    assert value.h == passive.value(z) == pytest.approx(infimum(z, N_ORBIT, 500.0) - 10.0, abs=1e-6)
    at = approach(z).when

    def distance(state):
        return oracle.norm(oracle.free_flight(state, N_ORBIT, at))

    np.testing.assert_allclose(value.gradient, oracle.gradient(distance, z), rtol=1e-9, atol=1e-9)
    scale = np.r_[1.0, 1.0, 1.0, 1e-3, 1e-3, 1e-3]
    for _ in range(3):
        step = rng.standard_normal(6) * scale * 1e-4
        forward, backward = passive(z + step).h, passive(z - step).h
        # One-sided slopes bracket it where two minima compete; else all three agree.
        linear = value.gradient @ step
        assert min(forward - value.h, value.h - backward) - 1e-6 <= linear + 2e-6
        assert forward - value.h <= linear + 2e-6  # an infimum lies below each of its tangents
