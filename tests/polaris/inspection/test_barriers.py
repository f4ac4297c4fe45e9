"""h1 to h6 and h9 to h11 against the paper's formulas, differentiated by complex steps."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from polaris.inspection.closest import ClosestApproach
from polaris.inspection.constraints.allowable_set import allowable
from polaris.inspection.constraints.barriers import Braking, Radial, SunCone
from polaris.inspection.constraints.families import Families
from polaris.inspection.constraints.motion import MotionBound, SampledData
from polaris.inspection.constraints.passive import PassiveSegments
from polaris.inspection.constraints.speeds import Speed, SpeedInSquares, Velocity, VelocitySide
from polaris.inspection.constraints.strengthening import FAMILIES, Strengthening
from polaris.inspection.filters.explicit import Centralized, Decentralized
from polaris.inspection.inspection import Inspection
from polaris.inspection.vectors import CENTRE, rounded_length
from polaris.model.errors import ScenarioError
from polaris.model.hill import cw_matrix
from polaris.rta.projection import SHORT
from tests.polaris.inspection import oracle

Q = Inspection()
N_, A_, DEPTH = Q.mean_motion, Q.a_max, Q.smoothing
HALF = Q.field_of_view / 2
BACK = Q.return_speed
BRAKING = Braking(A_, DEPTH, BACK)


TWICE = Braking(2 * A_, DEPTH, BACK)
FORMS = [
    ("h1", Radial(10.0, BRAKING), lambda z, sun: oracle.h_outside(z, 10.0, A_, DEPTH)),
    ("h2", Radial(10.0, TWICE), lambda z, sun: oracle.h_outside(z, 10.0, 2 * A_, DEPTH)),
    ("h3", Speed(0.2, 2 * N_), lambda z, sun: oracle.h_speed(z, 0.2, 2 * N_)),
    ("h4+1", SunCone(HALF, N_, BRAKING, 1.0), lambda z, sun: oracle.h_cone(z, sun, HALF, N_, A_, DEPTH)),
    ("h4-1", SunCone(HALF, N_, BRAKING, -1.0), lambda z, sun: oracle.h_cone(z, sun, HALF, N_, A_, DEPTH, -1)),
    ("h6", Radial(1000.0, BRAKING, -1.0), lambda z, sun: oracle.h_inside(z, 1000.0, A_, DEPTH)),
    ("h9", Velocity(0, 1.0), lambda z, sun: oracle.h_velocity(z, 0, 1.0)),
    ("h11", Velocity(2, 1.0), lambda z, sun: oracle.h_velocity(z, 2, 1.0)),
]
states = st.tuples(*[st.floats(-1500, 1500)] * 3, *[st.floats(-2, 2)] * 3).map(np.array)


def compare(barrier, formula, z, sun, n, tolerance=1e-9):
    value = barrier(z, sun)
    change = np.broadcast_to(value.change, np.shape(value.h))
    assert value.h == pytest.approx(formula(z, sun), rel=1e-9, abs=tolerance)
    expected = oracle.gradient(lambda at: formula(at, sun), z)
    np.testing.assert_allclose(value.gradient, expected, rtol=1e-7, atol=tolerance)
    # The sun turns at -n, so that the partial derivative with respect to time is -n d/d(sun).
    by_time = -n * oracle.slope(lambda at: formula(z, at), sun)
    assert float(change) == pytest.approx(by_time, rel=1e-7, abs=tolerance)


@pytest.mark.parametrize(("name", "barrier", "formula"), FORMS, ids=[f[0] for f in FORMS])
@given(z=states, sun=st.floats(-7, 7))
@settings(max_examples=100)
def test_value_gradient_and_change_are_those_of_the_formula(name, barrier, formula, z, sun):
    p, axis = z[:3], oracle.sun_direction(sun)
    assume(np.linalg.norm(p) > 1 and np.linalg.norm(z[3:]) > 1e-3)
    off_axis = np.linalg.norm(p - (p @ axis) * axis)
    along = -getattr(barrier, "side", 0) * (p @ axis) if name.startswith("h4") else 0.0
    if name.startswith("h4"):
        assume(off_axis > 1 and abs(np.cos(HALF) * off_axis - np.sin(HALF) * along) > 1e-3)
    compare(barrier, formula, z, sun, N_)


@pytest.mark.parametrize("name", ["h1", "h4+1", "h4-1", "h6"])
def test_deep_in_the_layer(name):
    """States a hair from the boundary, where the printed square root has no slope."""
    barrier, formula = next((b, f) for label, b, f in FORMS if label == name)
    rng = np.random.default_rng(3)
    for delta in (1e-3, 0.03, DEPTH * (1 - 1e-9), DEPTH * (1 + 1e-9), 0.3, -1e-3, -0.5):
        sun = rng.uniform(-3, 3)
        if name.startswith("h4"):
            axis = -barrier.side * oracle.sun_direction(sun)
            across = np.cross(axis, rng.standard_normal(3))
            across /= np.linalg.norm(across)
            along = 200.0
            p = along * axis + (delta + np.sin(HALF) * along) / np.cos(HALF) * across
        else:
            p = rng.standard_normal(3)
            p *= (barrier.radius + float(np.asarray(barrier.side)) * delta) / np.linalg.norm(p)
        z = np.r_[p, rng.uniform(-0.5, 0.5, 3)]
        compare(barrier, formula, z, sun, N_, tolerance=1e-7)


@given(st.floats(1e-6, 1e4), st.floats(1e-4, 1.0), st.floats(1e-3, 10.0))
@settings(max_examples=100)
def test_layer_never_exceeds_the_printed_speed(delta, a, depth):
    speed, slope = Braking(a, depth, BACK)(np.array(delta))
    assert 0 <= speed <= np.sqrt(2 * a * delta) * (1 + 1e-12)
    # Braking at the speed s takes the deceleration s s', at most a.
    assert speed * slope <= a * (1 + 1e-12)
    # It costs half the depth in distance, no more.
    assert speed >= np.sqrt(2 * a * max(delta - depth / 2, 0.0)) * (1 - 1e-12)


@given(st.floats(-200, 1e3), st.floats(1e-4, 1.0), st.floats(1e-2, 10.0), st.floats(1e-3, 1.0))
@settings(max_examples=100)
def test_layer_slope_and_bend(delta, a, depth, back):
    braking = Braking(a, depth, back)

    def exact(at):
        return oracle.braked(at, a, depth, back)

    speed, slope = braking(np.array(delta))
    assert slope == pytest.approx(oracle.slope(exact, delta), rel=1e-9, abs=1e-15)
    assert speed == pytest.approx(exact(delta), rel=1e-9, abs=1e-12)
    for further in (1e-3, 0.1, 1.0, 30.0):
        # The slope falls from here to there by no more than the bend times the way, and has a bound.
        later = braking(np.array(delta + further))[1]
        assert slope - later <= braking.bend(delta, delta + further) * further * (1 + 1e-9) + 1e-9
        between = braking(np.linspace(delta, delta + further, 41))[1]
        assert between.max() <= braking.steepest(delta, delta + further) * (1 + 1e-12)
        assert braking.steepest(delta, delta + further) <= np.sqrt(a / depth) * (1 + 1e-12)


@given(st.floats(0, 1e9), st.floats(1e-4, 1.0), st.floats(1e-2, 10.0), st.floats(1e-3, 1.0))
def test_the_way_back_is_never_asked_to_be_faster_than_its_limit(outside, a, depth, back):
    """The line went on without end: 65 m outside it asked for 53 m/s."""
    speed, slope = Braking(a, depth, back)(np.array(-outside))
    assert -back <= speed <= 0 <= slope
    further = Braking(a, depth, back)(np.array(-outside - 1.0))
    assert further[0] <= speed * (1 - 1e-12) and further[1] <= slope


def turned(vectors):
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def on_the_cone(barrier, sun, delta, direction, along):
    """Places `delta` [m] outside a sun's cone, `along` its axis, and the normals there."""
    axis = -barrier.side * np.stack([np.cos(sun), np.sin(sun), 0 * sun], axis=1)
    across = turned(np.cross(axis, direction))
    s, c = np.sin(barrier.half_angle), np.cos(barrier.half_angle)
    return along * axis + np.abs(delta[:, None] + s * along) / c * across, c * across - s * axis


def special_places():
    axis = -oracle.sun_direction(0.7)
    across = np.cross(axis, [0.0, 0.0, 1.0])
    at_rest = np.zeros(3)
    slow, fast = np.array([0.1, -0.2, 0.05]), np.array([1.0, 1.0, -1.0])
    for velocity in (at_rest, slow, fast):
        yield "centre", np.r_[0.0, 0.0, 0.0, velocity]
        yield "almost the centre", np.r_[1e-12, 0.0, -1e-13, velocity]
        yield "axis", np.r_[300 * axis, velocity]
        yield "axis, rounded", np.r_[300 * axis + 1e-14 * across, velocity]
        yield "far behind the cone", np.r_[-900 * axis, velocity]
        yield "inside the cone", np.r_[200 * axis + 20 * across, velocity]
        yield "on the cone", np.r_[200 * axis + 200 * np.tan(HALF) * across, velocity]
        yield "r_max", np.r_[1000.0, 0.0, 0.0, velocity]
        yield "beyond r_max", np.r_[0.0, -5000.0, 0.0, velocity]
        yield "inside the chief", np.r_[0.0, 2.0, 1.0, velocity]
        yield "on the chief", np.r_[0.0, 0.0, 10.0, velocity]
        yield "edge of the rounding", np.r_[0.0, CENTRE, 0.0, velocity]


SPECIAL = list(special_places())


@pytest.mark.parametrize(("place", "z"), SPECIAL, ids=[s[0] for s in SPECIAL])
def test_defined_and_continuous_at_special_places(place, z):
    """Along lines through the place: no jump larger than a Lipschitz constant allows."""
    rng = np.random.default_rng(11)
    speed = np.linalg.norm(z[3:])
    for name, barrier, _ in FORMS:
        with np.errstate(all="raise", under="ignore"):
            value = barrier(z, 0.7)
        assert np.isfinite(value.h) and np.isfinite(value.gradient).all() and np.isfinite(value.change)
        steps = np.linspace(-2e-3, 2e-3, 401)
        for _ in range(4):
            direction = rng.standard_normal(6) * [1, 1, 1, 0.01, 0.01, 0.01]
            direction /= np.linalg.norm(direction)
            values = barrier(z + steps[:, None] * direction, 0.7).h
            # The slope of the braking, the turning of a direction near a centre, and of the speed.
            bound = np.sqrt(A_ * 2 / DEPTH) + 3 * (speed + 0.01 + N_ * 6000) / CENTRE + 2
            assert np.abs(np.diff(values)).max() <= bound * (steps[1] - steps[0]), name


@given(st.tuples(*[st.floats(-2, 2)] * 3).map(np.array), st.floats(1e-6, 1.0))
def test_rounded_length_is_never_too_small(vector, least):
    rounded, direction = rounded_length(vector, least)
    length = np.linalg.norm(vector)
    assert length <= rounded * (1 + 1e-15) and rounded <= max(length, least) + least / 2
    assert np.linalg.norm(direction) <= 1 + 1e-12
    if length >= least:
        assert rounded == pytest.approx(length, rel=1e-15)


@given(st.integers(0, 10**6))
@settings(max_examples=100)
def test_allowable_is_the_papers(seed):
    rng = np.random.default_rng(seed)
    x = rng.uniform(-1, 1, (5, 6)) * np.r_[[10 ** rng.uniform(0, 3)] * 3, 1.5, 1.5, 1.5]
    sun = rng.uniform(-7, 7)
    limits = allowable(Q, x, sun)
    for name, values in oracle.phi(Q, x, sun).items():
        np.testing.assert_allclose(limits[name], values, rtol=1e-9, atol=1e-7, err_msg=name)


INSIDE = {"h1": "phi1", "h2": "phi2", "h3": "phi3", "h4": "phi4", "h5": "phi5", "h6": "phi6"}


@given(st.integers(0, 10**6))
@settings(max_examples=60)
def test_keeping_h_keeps_phi(seed):
    """The boundary cannot be crossed if h >= 0: where phi <= 0, h >= 0 means phi does not decrease."""
    rng = np.random.default_rng(seed)
    q = Inspection(deputies=2)
    families = Families(q)
    x = rng.uniform(-1, 1, (200, 2, 6)) * np.r_[[10 ** rng.uniform(1, 3)] * 3, 1.0, 1.0, 1.0]
    sun = rng.uniform(-np.pi, np.pi, 200)
    h = families(x, sun).h
    later = 1e-2
    drifted = x + later * (x @ q.system.A.T)
    phi, phi_later = allowable(q, x, sun), allowable(q, drifted, sun - q.mean_motion * later)
    # The way back across a cone is one of the signed distance: on it the angle may turn a little further in.
    cones = next(group for group in families.groups if isinstance(group.barrier, SunCone))
    places = [(x, sun), (drifted, sun - q.mean_motion * later)]
    signed = [cones.barrier._geometry(families.stack(at)[:, cones.at, :3], s[:, None])[0] for at, s in places]
    names = np.array([label.split("[")[0].rstrip("+-") for label in families.labels])
    for name, of in INSIDE.items():
        h_rows = h[:, names == name]
        outside = phi[of] < 0
        if name == "h3":
            assert not (outside & (h_rows >= 1e-6)).any()
            continue
        change = phi_later[of] - phi[of]
        if name in ("h4", "h5"):
            selected = names[cones.rows] == name
            change, outside = (signed[1] - signed[0])[:, selected], signed[0][:, selected] < 0
        assert (change[outside & (h_rows >= 0)] > 0).all(), name
    for name in ("h9", "h10", "h11"):
        assert not ((phi["phi" + name[1:]] < 0) & (h[:, names == name] >= 0)).any()


@pytest.mark.parametrize("family", ["chief_separation", "keep_in", "speed", "sun", "velocity"])
@pytest.mark.parametrize(
    "q",
    [
        Inspection(deputies=1),
        Inspection(deputies=1, mean_motion=3e-3, passive_time=100.0, thrust_max=2.5, speed_max=2.0),
        Inspection(deputies=1, docking_speed=0.5, thrust_max=0.2),
    ],
    ids=["table 1", "low orbit, fast", "weak"],
)
def test_thrust_can_keep_each_constraint_where_it_is_zero(family, q):
    """On h = 0, within r_max and the speed limits, some admissible input gives dh/dt >= 0."""
    rng = np.random.default_rng(21)
    K = 4000
    families = Families(q)
    sun = rng.uniform(-np.pi, np.pi, K)
    direction = rng.standard_normal((K, 3)) * rng.choice([0.0, 1.0], (K, 3), p=[0.3, 0.7])
    direction[~direction.any(axis=1)] = [1.0, 0.0, 0.0]
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    v = q.speed_max * rng.choice([-1.0, 1.0, 0.3], (K, 3))
    distance = 10 ** rng.uniform(1, np.log10(q.distance_max), K)
    if family == "keep_in":
        distance = q.distance_max - 10 ** rng.uniform(-3, 1.5, K)
    if family == "chief_separation":
        distance = q.separation + 10 ** rng.uniform(-3, 1.5, K)
    if family == "sun":
        half = q.field_of_view / 2
        axis = -np.stack([np.cos(sun), np.sin(sun), 0 * sun], axis=1)
        across = np.cross(axis, direction)
        across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
        along = rng.uniform(q.separation, 0.8 * q.distance_max, (K, 1))
        delta = 10 ** rng.uniform(-3, 1.5, (K, 1))
        direction = along * axis + (delta + np.sin(half) * along) / np.cos(half) * across
        distance = np.linalg.norm(direction, axis=1)
        direction /= distance[:, None]
    z = np.concatenate([direction * distance[:, None], v], axis=1)
    tested = 0
    for row in (m for m, name in enumerate(families.family) if name == family):
        x = z.copy()
        for _ in range(8 if family != "velocity" else 0):  # to the boundary, along the gradient in v
            rows = families(x[:, None], sun)
            G = rows.G[:, row] * q.mass
            x[:, 3:] -= (rows.h[:, row] / np.maximum((G * G).sum(1), 1e-12))[:, None] * G
        rows = families(x[:, None], sun)
        limit = q.docking_speed + q.nu_1 * np.linalg.norm(x[:, :3], axis=1)
        ok = (np.abs(x[:, 3:]) <= q.speed_max * (1 + 1e-9)).all(axis=1)
        if family in ("speed", "keep_in"):
            ok &= np.linalg.norm(x[:, 3:], axis=1) <= limit * (1 + 1e-9)
        ok &= (distance <= q.distance_max) & (np.abs(rows.h[:, row]) < 1e-9)
        alpha = families.alpha[family](rows.h[:, row])
        growth = q.thrust_max * np.abs(rows.G[:, row]).sum(1) - rows.bound[:, row] - alpha
        assert growth[ok].min() >= -1e-9
        tested += ok.sum()
    assert tested > 100


PERIODS = (0.1, 0.5, 1.0, 3.0, 10.0)
GRID = 41


def held(n, t):
    """``z(t) = Phi z + Gamma a`` for a constant acceleration a, at each of the times."""
    block = np.zeros((9, 9))
    block[:6, :6] = cw_matrix(n)
    block[3:6, 6:] = np.eye(3)
    powers = np.stack([expm(block * s) for s in t])
    return powers[:, :6, :6], powers[:, :6, 6:]


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
        admissible = np.isfinite(a).all(-1) & (h >= 0) & ~np.isposinf(M)
        path = self.fly(z, np.nan_to_num(a))
        values = self.values(path, sun, z)
        part = (self.times / self.data.period).reshape(-1, *[1] * h.ndim)
        promised = np.where(self.dropped(z, M), 0.0, (1 - self.data.share * part) * h)
        return np.where(admissible, promised - values, -np.inf).max(axis=0), admissible

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
        limit = b.docking_speed + b.slope * np.linalg.norm(path[..., :3], axis=-1)
        speed = np.linalg.norm(path[..., 3:], axis=-1)
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


def near_the_boundary(kind, barrier, rng, K):
    """States with h from 0 to a few tenths, some of them as fast as the braking allows."""
    sun, delta = rng.uniform(-np.pi, np.pi, K), 10 ** rng.uniform(-3, 2, K)
    v = rng.standard_normal((K, 3)) * 10 ** rng.uniform(-2, 0, (K, 1))
    direction = turned(rng.standard_normal((K, 3)))
    p, less = direction * 10 ** rng.uniform(1, 3, (K, 1)), rng.choice([0.0, 1e-3, 0.05, 0.3], K)
    if kind == "speed":
        limit = barrier.docking_speed + barrier.slope * np.linalg.norm(p, axis=1)
        return np.concatenate([p, turned(v) * (limit * (1 - less))[:, None]], axis=1), sun
    z = np.concatenate([p, v], axis=1)
    if kind == "velocity":
        less = rng.choice([0.0, 1e-3, 0.1, 0.9], K)
        z[:, 3 + barrier.axis] = barrier.limit * rng.choice([-1, 1], K) * (1 - less)
        return z, sun
    if kind == "cone":
        z[:, :3], normal = on_the_cone(barrier, sun, delta, direction, rng.uniform(5, 900, (K, 1)))
    else:
        normal = direction if kind == "outside" else -direction
        z[:, :3] = barrier.radius * direction + delta[:, None] * normal
    z[:, 3:] += (less - barrier(z, sun).h)[:, None] * normal  # so that h is just what is wanted
    return z, sun


def attacks(kind, n, period, thrust, share=0.5):
    braking = Braking(0.8 * thrust, 0.1, 0.2)
    attack_type, barrier = {
        "outside": (Attack, Radial(10.0, braking)),
        "inside": (Attack, Radial(1000.0, braking, -1.0)),
        "cone": (Attack, SunCone(np.pi / 6, n, braking)),
        "speed": (SpeedAttack, SpeedInSquares(0.2, 2 * n)),
        "velocity": (VelocityAttack, VelocitySide(0, 1.0)),
    }[kind]
    return attack_type(barrier, n, period, thrust, share)


KINDS = ("outside", "inside", "cone", "speed", "velocity")


@pytest.mark.parametrize("kind", KINDS)
def test_no_input_that_satisfies_a_row_breaks_its_promise(kind):
    rng = np.random.default_rng(42)
    count = 0
    for period in PERIODS:
        for n in (1e-4, 1.027e-3, 1e-2):
            for thrust in (0.01, 1 / 12, 0.3):
                attack = attacks(kind, n, period, thrust, rng.choice([0.1, 0.5, 1.0]))
                K = 150
                z, sun = near_the_boundary(kind, attack.barrier, rng, K)
                one, two = rng.choice([-thrust, thrust], (2, K, 3)) * rng.choice([0.3, 1.0], (2, K, 1))
                worst, tested = attack.shortfall(z, sun, one, two)
                assert worst.max() <= 1e-10, (period, n, thrust)
                count += tested.sum()
    assert count > 1000


def outside_and_near(kind, barrier, rng, K):
    """States from deep outside to just inside the boundary, at any speed."""
    sun = rng.uniform(-np.pi, np.pi, K)
    delta = rng.choice([-1.0, 1.0], K, p=[0.8, 0.2]) * 10 ** rng.uniform(-3, 2.3, K)
    direction, v = turned(rng.standard_normal((K, 3))), rng.standard_normal((K, 3))
    if kind == "cone":
        p = on_the_cone(barrier, sun, delta, direction, rng.uniform(5, 900, (K, 1)))[0]
    else:
        p = np.abs(barrier.radius + (delta if kind == "outside" else -delta))[:, None] * direction
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
        finite = np.isfinite(M)
        bounded += (finite & (h < 0)).sum()
        short = path - (h + t * rate - factor * np.where(finite, M, 0.0) * t**2 / 2)
        found_out += (short[:, finite] < -1e-9).any(axis=0).sum()
        if factor == 1.0:
            assert short[:, finite].min() >= -1e-9, period
            assert path[:, np.isneginf(M)].min(initial=0.0) >= -1e-12
    assert bounded > 500 and (found_out > 0) == (factor < 1)


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_curvature_of_straight_flight_is_its_centripetal_part(side):
    """Past a sphere, without any force, distances still accelerate by ``v_t^2 / r``: M covers that alone."""
    rng = np.random.default_rng(3)
    tight = 0
    for _ in range(200):
        D, v, depth = 10 ** rng.uniform(-1, 1), 10 ** rng.uniform(-1, 0.5), 10 ** rng.uniform(-2, 1)
        barrier = Radial(100.0, Braking(10 ** rng.uniform(-1, 1), depth, 1e3), side)
        toward, across = np.linalg.qr(rng.standard_normal((3, 2)))[0].T
        velocity = v * (across - side * 10 ** rng.uniform(-3, 0.3) * toward)
        start = np.concatenate([(100 + side * depth * 10 ** rng.uniform(-1, 1)) * toward, velocity])
        M = barrier.curvature(start, 0.0, MotionBound(D, np.linalg.norm(velocity), 0.0, 0.0, 0.0, 0.0))
        t = np.linspace(0, D, 401)
        z = np.concatenate([start[:3] + t[:, None] * start[3:], np.tile(start[3:], (401, 1))], axis=1)
        worst = -np.min(np.diff(barrier(z).h, 2)) / t[1] ** 2
        assert worst <= M * (1 + 1e-6) + 1e-9 or (np.isneginf(M) and barrier(z).h.min() >= 0)
        tight += worst > 0.7 * M > 0
    assert tight > 10


def flights(rng, K, n, radius):
    """Coasting that comes near: a place at some time of the flight, carried back to its start."""
    near = rng.standard_normal((K, 3))
    near *= (radius + 10 ** rng.uniform(-3, 2, (K, 1))) / np.linalg.norm(near, axis=1, keepdims=True)
    v = rng.standard_normal((K, 3)) * 10 ** rng.uniform(-2, 0, (K, 1))
    v -= (v * near).sum(-1, keepdims=True) * near / (near**2).sum(-1, keepdims=True)
    z = np.concatenate([near, v], axis=1)
    times = rng.uniform(0, 500, K)
    return np.stack([expm(-cw_matrix(n) * t) @ one for t, one in zip(times, z, strict=True)])


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
        for inner in best:
            for outer in options[~allowed][:5]:
                low, high = 0.0, 1.0
                for _ in range(40):
                    mid = (low + high) / 2
                    if (G[k] @ (inner + mid * (outer - inner)) >= tightening[k]).all():
                        low = mid
                    else:
                        high = mid
                best = np.vstack([best, inner + low * (outer - inner)])
        path = attack.fly(np.repeat(z[k][None], len(best), axis=0), best)
        assert approach(path).distance.min() >= radius - 1e-6
        alone = PassiveSegments(np.full(len(best), radius), approach)
        after = alone(path[-1]).h.reshape(len(best), -1, 2).min(axis=2)
        before = h[k].reshape(-1, 2).min(axis=1)
        # Stretch by stretch what was promised is there for the next sample, whose directions are its own.
        assert (after - 0.5 * before).min() >= -1e-9
        tried += len(best)
    assert tried > 100


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
        angle = sun - q.mean_motion * k * period
        desired = -np.sign(x[..., :3]) * q.thrust_max if k % 4 else rng.uniform(-1, 1, (len(x), 3, 3))
        answer = filtering.batch(x, angle, desired)
        assert np.isfinite(answer.u).all() and np.abs(answer.u).max() <= q.thrust_max
        solved = (answer.status < SHORT).all(axis=1)
        decided += solved.sum()
        for part, (Phi, Gamma) in zip((0.25, 0.5, 0.75, 1.0), moves, strict=True):
            after = x @ Phi.T + answer.u @ Gamma.T
            phi = allowable(q, after, angle - q.mean_motion * period * part)
            for name, values in phi.items():
                assert values[solved].min(initial=np.inf) >= -1e-9, (k, name)
        x, sun = after[solved], sun[solved]
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
        columns = slice(start, start := start + h.shape[-1])
        inside = h > 0
        finite += np.isfinite(M[inside]).sum()
        np.testing.assert_allclose(rows.bound[:, columns][inside], tightening[inside], rtol=1e-9, atol=1e-12)
    assert start == len(families.labels) and finite > 20
