"""Between samples: the worst admissible inputs against every bound on the curvature."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import differential_evolution

from polaris.inspection.closest import ClosestApproach
from polaris.inspection.constraints.allowable_set import allowable
from polaris.inspection.constraints.barriers import Braking, Radial, SunCone
from polaris.inspection.constraints.families import Families
from polaris.inspection.constraints.motion import SampledData
from polaris.inspection.constraints.passive import PassiveSegments
from polaris.inspection.constraints.speeds import SpeedInSquares, VelocitySide
from polaris.inspection.constraints.strengthening import FAMILIES, Strengthening
from polaris.inspection.filters.explicit import Centralized, Decentralized
from polaris.inspection.inspection import Inspection
from polaris.model.errors import ScenarioError
from polaris.model.hill import cw_matrix
from polaris.rta.projection import SHORT
from tests.sizes import fewer

PERIODS = (0.1, 0.5, 1.0, 3.0, 10.0)
GRID = 41


def held(n, t):
    """``z(t) = Phi z + Gamma a`` for a constant acceleration a, at each of the times."""
    block = np.zeros((9, 9))
    block[:6, :6] = cw_matrix(n)
    block[3:6, 6:] = np.eye(3)
    moved = np.stack([expm(block * s) for s in t])
    return moved[:, :6, :6], moved[:, :6, 6:]


class Attack:
    """States near the boundary of one barrier, and admissible inputs that only just satisfy its row."""

    def __init__(self, barrier, n, period, thrust, share=0.5):
        self.barrier, self.n, self.thrust = barrier, n, thrust  # thrust: acceleration per axis [m/s^2]
        self.data = SampledData(period, share)
        self.times = np.linspace(0, period, GRID)
        self.maps = held(n, self.times)

    def rows(self, z, sun):
        value = self.barrier(z, sun)
        drift = z @ cw_matrix(self.n).T
        limit = np.full(z.shape[:-1], np.sqrt(3) * self.thrust)
        motion = self.data.motion(z, drift, self.n, limit)
        self.motion = motion
        M = np.broadcast_to(self.barrier.curvature(z, sun, motion), value.h.shape)
        if value.h.shape != z.shape[:-1]:
            drift = np.repeat(drift, value.h.shape[-1] // z.shape[-2], axis=-2)
        natural = np.einsum("...i,...i->...", value.gradient, drift) + value.change
        D, share = self.data.period, self.data.share
        return value.h, value.gradient[..., 3:], -natural - share * value.h / D + M * D / 2, M

    def just_enough(self, G, tightening, one, two):
        """Inputs between two given ones, moved to equality ``G a = need`` within the box; nan if none."""
        limit = np.sign(G) * self.thrust
        low = np.where(((G * one).sum(-1) <= tightening)[..., None], one, -limit)
        high = np.where(((G * two).sum(-1) >= tightening)[..., None], two, limit)
        a, b = (G * low).sum(-1), (G * high).sum(-1)
        with np.errstate(all="ignore"):
            part = np.clip((tightening - a) / (b - a), 0, 1)
        part = np.where(np.isfinite(part), part, 0.0)
        out = low + part[..., None] * (high - low)
        out = np.where((tightening > b)[..., None], np.nan, out)
        return np.where((tightening < a)[..., None], one, out)

    def fly(self, z, acceleration):
        """States at the times, shape (GRID, ...)."""
        Phi, Gamma = self.maps
        return np.einsum("tij,...j->t...i", Phi, z) + np.einsum("tij,...j->t...i", Gamma, acceleration)

    def shortfall(self, z, sun, one, two):
        """Return the largest fall of h below ``(1 - share t / D) h`` (0 for dropped rows), and who flew."""
        h, G, tightening, M = self.rows(z, sun)
        a = self.just_enough(G, tightening, one, two)
        flown = np.isfinite(a).all(-1) & (h >= 0) & ~np.isposinf(M)
        path = self.fly(z, np.nan_to_num(a))
        values = self.values(path, sun, z)
        part = (self.times / self.data.period).reshape(-1, *[1] * h.ndim)
        promised = np.where(self.dropped(z, M), 0.0, (1 - self.data.share * part) * h)
        return np.where(flown, promised - values, -np.inf).max(axis=0), flown

    def dropped(self, z, M):
        """Rows that promise no more than that h does not become negative."""
        return np.isneginf(M)

    def values(self, path, sun, z):
        t = self.times.reshape(-1, *[1] * np.ndim(sun))
        return self.barrier(path, sun - self.n * t).h


class SpeedAttack(Attack):
    def dropped(self, z, M):
        """Those that fade: the limit is out of reach within the period."""
        limit = self.barrier.docking_speed + self.barrier.slope * np.linalg.norm(z[..., :3], axis=-1)
        return self.motion.speed * (1 + self.barrier.slope * self.data.period) <= limit

    def values(self, path, sun, z):
        """The squares that the bound is about, with the factor of the sample."""
        b = self.barrier
        limit, speed = (
            b.docking_speed + b.slope * np.linalg.norm(path[..., :3], axis=-1),
            np.linalg.norm(path[..., 3:], axis=-1),
        )
        w = (limit + speed)[0]
        return (limit - speed) * (limit + speed) / w


class VelocityAttack(Attack):
    def values(self, path, sun, z):
        """Both sides."""
        along = path[..., 3 + self.barrier.axis]
        w = self.barrier.limit + np.abs(z[..., 3 + self.barrier.axis])
        other = np.where(np.abs(along) <= self.barrier.limit, np.inf, self.barrier.limit - np.abs(along))
        side = np.copysign(1.0, z[..., 3 + self.barrier.axis])
        return np.minimum((self.barrier.limit - side * along) * w, other)


def near_the_boundary(kind, barrier, rng, K, a):
    """States with h from 0 to a few tenths, some of them as fast as the braking allows."""
    sun = rng.uniform(-np.pi, np.pi, K)
    delta = 10 ** rng.uniform(-3, 2, K)
    v = rng.standard_normal((K, 3)) * 10 ** rng.uniform(-2, 0, (K, 1))
    way = rng.standard_normal((K, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    if kind in ("outside", "inside"):
        side = 1.0 if kind == "outside" else -1.0
        p = (barrier.radius + side * np.minimum(delta, barrier.radius - 1 if side < 0 else np.inf))[
            :, None
        ] * way
        normal = side * way
    elif kind == "cone":
        axis = -barrier.side * np.stack([np.cos(sun), np.sin(sun), 0 * sun], axis=1)
        across = np.cross(axis, way)
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        along = rng.uniform(5, 900, (K, 1))
        s, c = np.sin(barrier.half_angle), np.cos(barrier.half_angle)
        p = along * axis + (delta[:, None] + s * along) / c * across
        normal = c * across - s * axis
    else:
        p = way * 10 ** rng.uniform(1, 3, (K, 1))
        normal = way
    z = np.concatenate([p, v], axis=1)
    if kind in ("outside", "inside", "cone"):
        # Set the approach so that h is just what is wanted.
        want = rng.choice([0.0, 1e-3, 0.05, 0.3], K)
        h = barrier(z, sun).h
        z[:, 3:] += (want - h)[:, None] * normal
    elif kind == "speed":
        limit = barrier.docking_speed + barrier.slope * np.linalg.norm(p, axis=1)
        factor = limit * (1 - rng.choice([0.0, 1e-3, 0.05, 0.3], K)) / np.linalg.norm(v, axis=1)
        z[:, 3:] *= factor[:, None]
    elif kind == "velocity":
        part = rng.choice([-1, 1], K) * (1 - rng.choice([0.0, 1e-3, 0.1, 0.9], K))
        z[:, 3 + barrier.axis] = barrier.limit * part
    return z, sun


def attacks(kind, n, period, thrust, share=0.5):
    a = 0.8 * thrust
    braking = Braking(a, 0.1, 0.2)
    if kind == "outside":
        return Attack(Radial(10.0, braking), n, period, thrust, share)
    if kind == "inside":
        return Attack(Radial(1000.0, braking, -1.0), n, period, thrust, share)
    if kind == "cone":
        return Attack(SunCone(np.pi / 6, n, braking), n, period, thrust, share)
    if kind == "speed":
        return SpeedAttack(SpeedInSquares(0.2, 2 * n), n, period, thrust, share)
    return VelocityAttack(VelocitySide(0, 1.0), n, period, thrust, share)


KINDS = ("outside", "inside", "cone", "speed", "velocity")


@pytest.mark.parametrize("kind", KINDS)
def test_no_input_that_satisfies_a_row_breaks_its_promise(kind):
    rng = np.random.default_rng(42)
    flown = 0
    for period in PERIODS:
        for n in (1e-4, 1.027e-3, 1e-2):
            for thrust in (0.01, 1 / 12, 0.3):
                attack = attacks(kind, n, period, thrust, rng.choice([0.1, 0.5, 1.0]))
                K = 150
                z, sun = near_the_boundary(kind, attack.barrier, rng, K, 0.8 * thrust)
                one, two = rng.choice([-thrust, thrust], (2, K, 3)) * rng.choice([0.3, 1.0], (2, K, 1))
                worst, flew = attack.shortfall(z, sun, one, two)
                assert worst.max() <= 1e-10, (period, n, thrust)
                flown += flew.sum()
    assert flown > 1000


def outside_and_near(kind, barrier, rng, K):
    """States from deep outside to just inside the boundary, at any speed."""
    sun = rng.uniform(-np.pi, np.pi, K)
    delta = rng.choice([-1.0, 1.0], K, p=[0.8, 0.2]) * 10 ** rng.uniform(-3, 2.3, K)
    way, v = rng.standard_normal((2, K, 3))
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    if kind == "cone":
        axis = -barrier.side * np.stack([np.cos(sun), np.sin(sun), 0 * sun], axis=1)
        across = np.cross(axis, way)
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        along = rng.uniform(5, 900, (K, 1))
        s, c = np.sin(barrier.half_angle), np.cos(barrier.half_angle)
        p = along * axis + np.abs(delta[:, None] + s * along) / c * across
    else:
        side = 1.0 if kind == "outside" else -1.0
        p = np.abs(barrier.radius + side * delta)[:, None] * way
    return np.concatenate([p, v * 10 ** rng.uniform(-3, 0.5, (K, 1))], axis=1), sun


@pytest.mark.parametrize("kind", ["outside", "inside", "cone"])
@pytest.mark.parametrize("factor", [1.0, 0.3])
def test_curvature_bounds_hold_from_outside_too(kind, factor):
    """``h(t) >= h + t dh/dt - M t^2 / 2`` for any admissible input held; a part of M is found out."""
    rng = np.random.default_rng(7)
    found_out, bounded = 0, 0
    for period in PERIODS:
        attack = attacks(kind, 1.027e-3, period, 1 / 12)
        K = 300
        z, sun = outside_and_near(kind, attack.barrier, rng, K)
        h, G, _, M = attack.rows(z, sun)
        value = attack.barrier(z, sun)
        a = rng.choice([-1 / 12, 0.0, 1 / 12], (K, 3))
        rate = np.einsum("ki,ki->k", value.gradient, z @ cw_matrix(attack.n).T) + value.change
        rate = rate + (G * a).sum(axis=1)
        t = attack.times[:, None]
        path = attack.barrier(attack.fly(z, a), sun - attack.n * t).h
        some = np.isfinite(M)
        bounded += (some & (h < 0)).sum()
        short = path - (h + t * rate - factor * np.where(some, M, 0.0) * t**2 / 2)
        found_out += (short[:, some] < -1e-9).any(axis=0).sum()
        if factor == 1.0:
            assert short[:, some].min() >= -1e-9, period
            assert path[:, np.isneginf(M)].min(initial=0.0) >= -1e-12
    assert bounded > 500
    assert (found_out > 0) == (factor < 1)


def test_the_attack_finds_what_the_curvature_is_for(monkeypatch):
    """Without M the same attack succeeds: the tests above can fail."""
    for kind in KINDS:
        rng = np.random.default_rng(1)
        attack = attacks(kind, 1.027e-3, 1.0, 1 / 12)
        monkeypatch.setattr(
            type(attack.barrier), "curvature", lambda barrier, z, sun, motion: 0.0 * z[..., 0]
        )
        z, sun = near_the_boundary(kind, attack.barrier, rng, 300, 0.066)
        one, two = rng.choice([-1 / 12, 1 / 12], (2, 300, 3))
        assert attack.shortfall(z, sun, one, two)[0].max() > 1e-6, kind


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("period", [0.3, 1.0, 4.0])
def test_optimised_attacks_fail_too(kind, period):
    """Differential evolution over state, sun angle and input for the largest shortfall."""
    thrust = 1 / 12
    attack = attacks(kind, 1.027e-3, period, thrust)
    high = 200.0 if kind != "inside" else 1000.0

    def objective(y):
        y = y.T
        p, v = y[:, :3] * high, y[:, 3:6]
        z = np.concatenate([p, v], axis=1)
        worst, flew = attack.shortfall(
            z,
            np.pi * y[:, 6],
            thrust * np.clip(2 * y[:, 7:10], -1, 1),
            thrust * np.clip(2 * y[:, 10:], -1, 1),
        )
        h, _, _, _ = attack.rows(z, np.pi * y[:, 6])
        return np.where(flew, -worst, 1.0 + np.maximum(-h, 0.0))

    optimum = differential_evolution(
        objective,
        [(-1, 1)] * 13,
        maxiter=fewer(150, 60),
        popsize=20,
        seed=3,
        vectorized=True,
        updating="deferred",
    )
    assert optimum.fun >= -1e-10


# --- passively safe manoeuvres -----------------------------------------------------------------------


def flights(rng, K, n, radius):
    """Coasting that comes near: a place at some time of the flight, carried back to its start."""
    near = rng.standard_normal((K, 3))
    near *= (radius + 10 ** rng.uniform(-3, 2, (K, 1))) / np.linalg.norm(near, axis=1, keepdims=True)
    v = rng.standard_normal((K, 3)) * 10 ** rng.uniform(-2, 0, (K, 1))
    v -= (v * near).sum(-1, keepdims=True) * near / (near**2).sum(-1, keepdims=True)
    z = np.concatenate([near, v], axis=1)
    back = rng.uniform(0, 500, K)
    return np.stack([expm(-cw_matrix(n) * t) @ one for t, one in zip(back, z, strict=True)])


@pytest.mark.parametrize("period", [0.2, 1.0, 3.0])
def test_passive_rows_keep_every_flight_of_the_period_clear(period):
    n, thrust, radius, K = 1.027e-3, 1 / 12, 10.0, 40
    rng = np.random.default_rng(5)
    approach = ClosestApproach(n, 500.0)
    barrier = PassiveSegments(np.full(K, radius), approach)
    attack = Attack(barrier, n, period, thrust)
    z = flights(rng, K, n, radius)
    h, G, tightening, _ = attack.rows(z, 0.0)
    h, tightening = (part.reshape(K, -1) for part in (h, tightening))
    G = G.reshape(K, -1, 3)
    safe = (h >= 0).all(axis=1)
    assert safe.sum() > 5
    tried = 0
    for k in np.flatnonzero(safe):
        options = rng.uniform(-1, 1, (400, 3)) * thrust
        options[:200] = np.sign(options[:200]) * thrust
        allowed = (G[k] @ options.T >= tightening[k][:, None]).all(axis=0)
        slack = (G[k] @ options.T - tightening[k][:, None]).min(axis=0)
        # Those that only just satisfy the rows, and mixtures with inputs that do not.
        if not allowed.any():
            continue
        best = options[allowed][np.argsort(slack[allowed])[:5]]
        for good in best:
            for bad in options[~allowed][:5]:
                low, high = 0.0, 1.0
                for _ in range(40):
                    mid = (low + high) / 2
                    if (G[k] @ (good + mid * (bad - good)) >= tightening[k]).all():
                        low = mid
                    else:
                        high = mid
                best = np.vstack([best, good + low * (bad - good)])
        path = attack.fly(np.repeat(z[k][None], len(best), axis=0), best)
        assert approach(path).distance.min() >= radius - 1e-6
        alone = PassiveSegments(np.full(len(best), radius), approach)
        after = alone(path[-1]).h.reshape(len(best), -1, 2).min(axis=2)
        before = h[k].reshape(-1, 2).min(axis=1)
        # Stretch by stretch what was promised is there for the next sample, whose directions are its own.
        assert (after - 0.5 * before).min() >= -1e-9
        tried += len(best)
    assert tried > 100


@pytest.mark.parametrize("n", [1e-5, 1.027e-3, 8e-3])
def test_a_flight_stays_within_its_bow_of_the_chords(n):
    T = min(500.0, np.pi / n)
    approach = ClosestApproach(n, T)
    rng = np.random.default_rng(2)
    K = 300
    z = np.concatenate([rng.uniform(-500, 500, (K, 3)), rng.uniform(-1, 1, (K, 3))], axis=1)
    barrier = PassiveSegments(np.zeros(K), approach)
    per_amplitude = barrier._reach[2]
    intersample = per_amplitude * barrier._amplitude(z)[0]
    ends = (z @ approach.positions).reshape(K, -1, 3)
    for part in np.linspace(0, 1, 9):
        at = approach.times[:-1] + part * np.diff(approach.times)
        maps = held(n, at)[0][:, :3]
        place = np.einsum("tij,kj->kti", maps, z)
        chord = ends[:, :-1] * (1 - part) + ends[:, 1:] * part
        assert (np.linalg.norm(place - chord, axis=2) <= intersample[:, None]).all()


def test_h_of_the_stretches_is_below_the_true_clearance():
    approach = ClosestApproach(1.027e-3, 500.0)
    rng = np.random.default_rng(8)
    z = flights(rng, 500, 1.027e-3, 10.0)
    h = PassiveSegments(np.full(500, 10.0), approach)(z).h.reshape(500, -1).min(axis=1)
    true = approach(z).distance - 10.0
    assert (h <= true).all() and np.median(true - h) < 0.5


# --- all together --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("period", "make"),
    [
        (0.5, Centralized),
        (1.0, Centralized),
        (2.0, Centralized),
        (1.0, lambda families: Decentralized(families, "half")),
        (1.0, lambda families: Decentralized(families, "consensus")),
    ],
)
def test_filtered_flights_stay_allowable_between_samples(period, make):
    """As long as a program has a solution, phi >= 0 at every instant, whatever is desired."""
    q = Inspection(deputies=3)
    families = Families(q, sampled=SampledData(period))
    filtering = make(families)
    rng = np.random.default_rng(0)
    x = rng.uniform(-1, 1, (3000, 3, 6)) * [150, 150, 150, 0.3, 0.3, 0.3]
    sun = rng.uniform(-np.pi, np.pi, 3000)
    good = (families(x, sun).h >= 0).all(axis=1)
    for values in allowable(q, x, sun).values():
        good &= (values >= 0).all(axis=1)
    x, sun = x[good][:25], sun[good][:25]
    assert len(x) == 25
    moves = [q.discretize(period * part) for part in (0.25, 0.5, 0.75, 1.0)]
    decided = 0
    for k in range(15):
        now = sun - q.mean_motion * k * period
        desired = -np.sign(x[..., :3]) * q.thrust_max if k % 4 else rng.uniform(-1, 1, (len(x), 3, 3))
        answer = filtering.batch(x, now, desired)
        assert np.isfinite(answer.u).all() and np.abs(answer.u).max() <= q.thrust_max
        kept = (answer.status < SHORT).all(axis=1)
        decided += kept.sum()
        for part, (Phi, Gamma) in zip((0.25, 0.5, 0.75, 1.0), moves, strict=True):
            after = x @ Phi.T + answer.u @ Gamma.T
            phi = allowable(q, after, now - q.mean_motion * period * part)
            for name, values in phi.items():
                assert values[kept].min(initial=np.inf) >= -1e-9, (k, name)
        x, sun = after[kept], sun[kept]
        assert families(x, sun - q.mean_motion * (k + 1) * period).h.min(initial=np.inf) >= -1e-9
    assert decided > 100


def test_rows_without_a_bound_are_flagged_not_dropped():
    """Directions that may turn at once: no input will do, and the answer says so."""
    q = Inspection(deputies=2)
    families = Families(q, sampled=SampledData(1.0))
    x = np.zeros((3, 2, 6))
    x[:, 1, :3] = [[100.0, 50.0, 20.0], [0.05, 0.0, 0.0], [0.0, 0.0, 0.0]]
    x[:, 1, 3:] = [0.1, 0.0, 0.0]
    with np.errstate(all="raise", under="ignore"):
        rows = families(x, np.zeros(3))
        assert not np.isnan(rows.bound).any() and np.isfinite(rows.h).all()
        assert (rows.bound == np.inf).any(axis=1).all()
        for filtering in (
            Centralized(families),
            Decentralized(families),
            Decentralized(families, "half"),
            Decentralized(families, "consensus"),
        ):
            for runs in (slice(None), slice(0, 1)):
                answer = filtering.batch(x[runs], np.zeros(3)[runs], np.zeros((3, 2, 3))[runs])
                assert (answer.status >= SHORT).any(axis=1).all()
                assert np.isfinite(answer.u).all() and (np.abs(answer.u) <= q.thrust_max).all()


def test_rows_below_zero_ask_for_recovery():
    """h < 0: within the period h grows at least as fast as the strengthening function asks."""
    recovery = Strengthening((0.05, 0.0, 0.0), 0.0, 2.0, 0.01)
    q = Inspection(deputies=1)
    families = Families(q, dict.fromkeys(Families(q).alpha, recovery), sampled=SampledData(1.0))
    x = np.array([[[9.9, 0.0, 0.0, 0.05, 0.0, 0.0]]])
    rows = families(x, np.array([np.pi]))
    row = families.labels.index("h1[0]")
    assert rows.h[0, row] < 0
    answer = Centralized(Families(q, families.alpha, without=("passive", "speed"), sampled=SampledData(1.0)))
    u = answer.batch(x, np.array([np.pi]), np.zeros((1, 1, 3)))
    Phi, Gamma = q.discretize(1.0)
    later = families(x @ Phi.T + u.u @ Gamma.T, np.array([np.pi])).h[0, row]
    if u.status.max() < SHORT:
        assert later >= rows.h[0, row] + 0.01


@pytest.mark.parametrize("n", [1e-4, 1.027e-3, 1e-2])
def test_periods_without_a_bound_on_the_motion_are_refused(n):
    limit = 1 / (3 * n)  # where 2 n D + 3 n^2 D^2 = 1
    assert 2 * n * limit + 3 * (n * limit) ** 2 == pytest.approx(1)
    with pytest.raises(ScenarioError, match="period: got .*must be below"):
        SampledData(limit * 1.001).growth(n)
    assert SampledData(limit * 0.9).growth(n) > 1
    q = replace(Inspection(), passive_time=100.0)
    with pytest.raises(ScenarioError, match="period"):
        Families(q, sampled=SampledData(1 / (3 * q.mean_motion)))


@pytest.mark.parametrize(
    ("field", "given"),
    [("period", 0.0), ("period", -1.0), ("period", np.nan), ("period", np.inf), ("period", "1")]
    + [("share", 0.0), ("share", 1.1), ("share", np.nan), ("share", "half"), ("share", None)],
)
def test_bad_sampling_is_refused(field, given):
    with pytest.raises(ScenarioError, match=f"^{field}: got"):
        SampledData(**{"period": 1.0, field: given})


@pytest.mark.parametrize("period", PERIODS)
def test_motion_bounds_hold_over_the_period(period):
    rng = np.random.default_rng(9)
    for n in (1e-5, 1.027e-3, 1e-2):
        z = np.concatenate([rng.uniform(-1e3, 1e3, (200, 3)), rng.uniform(-2, 2, (200, 3))], axis=1)
        a = rng.choice([-1.0, 1.0], (200, 3)) / 12
        A = cw_matrix(n)
        motion = SampledData(period).motion(z, z @ A.T, n, np.full(200, np.sqrt(3) / 12))
        Phi, Gamma = held(n, np.linspace(0, period, 21))
        path = np.einsum("tij,kj->tki", Phi, z) + np.einsum("tij,kj->tki", Gamma, a)
        rate = path @ A.T
        rate[..., 3:] += a
        for bound, actual in (
            (motion.speed, path[..., 3:]),
            (motion.acceleration, rate[..., 3:]),
            (motion.jerk, (rate @ A.T)[..., 3:]),
        ):
            assert (np.linalg.norm(actual, axis=-1) <= bound * (1 + 1e-12)).all()


@pytest.mark.parametrize("period", [0.5, 3.0])
def test_filters_ask_for_what_the_attacks_here_only_just_satisfy(period):
    """With a strengthening so steep that the share of h decides, the rows of all families are `Attack`'s."""
    q, data, rng = Inspection(deputies=1), SampledData(period), np.random.default_rng(6)
    families = Families(q, {name: Strengthening((1e3, 0.0, 0.0)) for name in FAMILIES}, sampled=data)
    z = np.concatenate([rng.normal(size=(60, 1, 3)) * 60, rng.normal(size=(60, 1, 3)) * 0.4], axis=2)
    sun, start, finite = rng.uniform(-3, 3, 60), 0, 0
    rows = families(z, sun)
    for group in families.groups:
        attack = Attack(group.barrier, q.mean_motion, period, q.thrust_max / q.mass, data.share)
        h, _, tightening, M = attack.rows(families.stack(z)[..., group.at, :], sun[:, None])
        own = slice(start, start := start + h.shape[-1])
        inside = h > 0
        finite += np.isfinite(M[inside]).sum()
        np.testing.assert_allclose(rows.bound[:, own][inside], tightening[inside], rtol=1e-9, atol=1e-12)
    assert start == len(families.labels) and finite > 20
