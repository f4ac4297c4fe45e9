"""h1 to h6 and h9 to h11 against the paper's formulas, differentiated by complex steps."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from polaris.inspection.constraints.allowable_set import allowable
from polaris.inspection.constraints.barriers import Braking, Radial, SunCone
from polaris.inspection.constraints.families import Families
from polaris.inspection.constraints.speeds import Speed, Velocity
from polaris.inspection.inspection import Inspection
from polaris.inspection.vectors import CENTRE, rounded_length
from tests.polaris.inspection import oracle

Q = Inspection()
N_, A_, DEPTH = Q.mean_motion, Q.a_max, Q.smoothing
HALF = Q.field_of_view / 2
BACK = Q.return_speed
BRAKING = Braking(A_, DEPTH, BACK)


def forms():
    """Name, barrier, and the paper's formula as a function of state and sun angle."""
    yield ("h1", Radial(10.0, BRAKING), lambda z, sun: oracle.h_outside(z, 10.0, A_, DEPTH))
    yield (
        "h2",
        Radial(10.0, Braking(2 * A_, DEPTH, BACK)),
        lambda z, sun: oracle.h_outside(z, 10.0, 2 * A_, DEPTH),
    )
    yield "h3", Speed(0.2, 2 * N_), lambda z, sun: oracle.h_speed(z, 0.2, 2 * N_)
    for side in (1.0, -1.0):
        yield (
            f"h4{side:+.0f}",
            SunCone(HALF, N_, BRAKING, side),
            lambda z, sun, side=side: oracle.h_cone(z, sun, HALF, N_, A_, DEPTH, side),
        )
    yield ("h6", Radial(1000.0, BRAKING, -1.0), lambda z, sun: oracle.h_inside(z, 1000.0, A_, DEPTH))
    for axis in range(3):
        yield (f"h{9 + axis}", Velocity(axis, 1.0), lambda z, sun, axis=axis: oracle.h_velocity(z, axis, 1.0))


FORMS = list(forms())
coordinate = st.floats(-1500, 1500)
component = st.floats(-2, 2)
states = st.tuples(*[coordinate] * 3, *[component] * 3).map(np.array)
angles = st.floats(-7, 7)


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
@given(z=states, sun=angles)
@settings(max_examples=100)
def test_value_gradient_and_change_are_those_of_the_formula(name, barrier, formula, z, sun):
    p, axis = z[:3], oracle.sun_direction(sun)
    assume(np.linalg.norm(p) > 1 and np.linalg.norm(z[3:]) > 1e-3)
    off_axis = np.linalg.norm(p - (p @ axis) * axis)
    along = -getattr(barrier, "side", 0) * (p @ axis) if name.startswith("h4") else 0.0
    if name.startswith("h4"):
        assume(off_axis > 1 and abs(np.cos(HALF) * off_axis - np.sin(HALF) * along) > 1e-3)
    compare(barrier, formula, z, sun, N_)


@pytest.mark.parametrize(("name", "barrier", "formula"), FORMS, ids=[f[0] for f in FORMS])
def test_thousands_of_states_near_and_far(name, barrier, formula):
    rng = np.random.default_rng(7)
    scale = 10 ** rng.uniform(0, 3.2, (250, 1))
    p = rng.standard_normal((250, 3))
    p = np.maximum(scale, 0.5) * p / np.linalg.norm(p, axis=1, keepdims=True)
    z = np.concatenate([p, rng.standard_normal((250, 3)) * 10 ** rng.uniform(-3, 0.5, (250, 1))], axis=1)
    sun = rng.uniform(-np.pi, np.pi, 250)
    for state, angle in zip(z, sun, strict=True):
        axis = oracle.sun_direction(angle)
        off_axis = np.linalg.norm(state[:3] - (state[:3] @ axis) * axis)
        if name.startswith("h4") and off_axis < 2 * CENTRE:
            continue
        compare(barrier, formula, state, angle, N_)


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


def along_the_motion(barrier, z, sun, u):
    """dh/dt by the chain rule and by finite differences of the barrier itself."""
    value = barrier(z, sun)
    rate = oracle.motion(z, N_) + np.r_[0, 0, 0, u]
    chain = value.gradient @ rate + float(np.asarray(value.change))
    step = 1e-3
    ends = [float(barrier(z + sign * step * rate, sun - sign * N_ * step).h) for sign in (1, -1)]
    return chain, (ends[0] - ends[1]) / (2 * step)


@pytest.mark.parametrize(("name", "barrier", "formula"), FORMS, ids=[f[0] for f in FORMS])
@given(z=states, sun=angles, u=st.tuples(*[st.floats(-0.1, 0.1)] * 3))
@settings(max_examples=60)
def test_rate_along_the_motion_includes_the_turning_sun(name, barrier, formula, z, sun, u):
    axis = oracle.sun_direction(sun)
    assume(np.linalg.norm(z[:3]) > 5 and np.linalg.norm(z[3:]) > 0.01)
    assume(np.linalg.norm(z[:3] - (z[:3] @ axis) * axis) > 5)
    chain, finite = along_the_motion(barrier, z, sun, u)
    assert chain == pytest.approx(finite, abs=2e-4, rel=2e-3)


# --- the braking layer -------------------------------------------------------------------------------


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


def test_layer_is_smooth_where_it_joins():
    a, depth = 0.05, 0.1
    braking = Braking(a, depth, BACK)
    below, above = (braking(np.array(depth * (1 + side * 1e-12))) for side in (-1, 1))
    np.testing.assert_allclose(below, above, rtol=1e-9)
    outside, inside = (braking(np.array(side * 1e-13)) for side in (-1, 1))
    np.testing.assert_allclose(outside[1], inside[1], rtol=1e-9)
    assert braking(np.array(0.0))[0] == 0.0


# --- special places ----------------------------------------------------------------------------------


def special_places():
    axis = -oracle.sun_direction(0.7)
    across = np.cross(axis, [0.0, 0.0, 1.0])
    rest = np.zeros(3)
    slow, fast = np.array([0.1, -0.2, 0.05]), np.array([1.0, 1.0, -1.0])
    for velocity in (rest, slow, fast):
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


def test_many_deputies_in_special_places_give_finite_rows():
    """Deputies on top of each other, at the chief, on the axis: one call, finite rows, no warning."""
    q = Inspection(deputies=6)
    axis = -oracle.sun_direction(0.7)
    x = np.zeros((6, 6))
    x[1, :3] = 100 * axis
    x[2, :3] = 100 * axis  # overlaps with the one before
    x[3] = [50.0, 20.0, 0.0, 0.1, 0.0, 0.0]
    x[4] = x[3]  # the same state
    x[5, :3] = [0.0, 0.0, 1000.0]
    with np.errstate(all="raise", under="ignore"):
        rows = Families(q)(x[None], np.array([0.7]))
    assert np.isfinite(rows.h).all() and np.isfinite(rows.G).all() and np.isfinite(rows.bound).all()


@given(st.tuples(*[st.floats(-2, 2)] * 3).map(np.array), st.floats(1e-6, 1.0))
def test_rounded_length_is_never_too_small(vector, least):
    rounded, direction = rounded_length(vector, least)
    length = np.linalg.norm(vector)
    assert length <= rounded * (1 + 1e-15) and rounded <= max(length, least) + least / 2
    assert np.linalg.norm(direction) <= 1 + 1e-12
    if length >= least:
        assert rounded == pytest.approx(length, rel=1e-15)


# --- the allowable set -------------------------------------------------------------------------------


@given(st.integers(0, 10**6))
@settings(max_examples=100)
def test_allowable_is_the_papers(seed):
    rng = np.random.default_rng(seed)
    x = rng.uniform(-1, 1, (5, 6)) * np.r_[[10 ** rng.uniform(0, 3)] * 3, 1.5, 1.5, 1.5]
    sun = rng.uniform(-7, 7)
    limits = allowable(Q, x, sun)
    for name, values in oracle.phi(Q, x, sun).items():
        np.testing.assert_allclose(limits[name], values, rtol=1e-9, atol=1e-7, err_msg=name)


def test_both_orders_of_a_pair_count():
    """Deputy 0 sees the sun behind deputy 1, or the other way round: phi5 is negative either way."""
    q = Inspection(deputies=2)
    sun = 0.4
    direction = oracle.sun_direction(sun)
    for sign in (1, -1):
        x = np.zeros((2, 6))
        x[0, :3], x[1, :3] = 200 * sign * direction, -100 * sign * direction + [0, 0, 50]
        assert allowable(q, x, sun)["phi5"][0] < 0


def test_angles_at_the_chief_and_of_overlapping_deputies_are_defined():
    q = Inspection(deputies=2)
    margins = allowable(q, np.zeros((2, 6)), 0.3)
    assert all(np.isfinite(values).all() for values in margins.values())


INSIDE = {"h1": "phi1", "h2": "phi2", "h3": "phi3", "h4": "phi4", "h5": "phi5", "h6": "phi6"}


@given(st.integers(0, 10**6))
@settings(max_examples=60)
def test_keeping_h_keeps_phi(seed):
    """The boundary cannot be crossed if h >= 0: on phi = 0, h >= 0 means phi does not decrease.

    h >= 0 and phi < 0 together mean: outside, and on the way back faster than the layer asks. A safe set is
    therefore {h >= 0 and phi >= 0}, which is what initial conditions are drawn from.
    """
    rng = np.random.default_rng(seed)
    q = Inspection(deputies=2)
    families = Families(q)
    x = rng.uniform(-1, 1, (200, 2, 6)) * np.r_[[10 ** rng.uniform(1, 3)] * 3, 1.0, 1.0, 1.0]
    sun = rng.uniform(-np.pi, np.pi, 200)
    h = families(x, sun).h
    later = 1e-2
    drifted = x + later * (x @ q.system.A.T)
    now, then = allowable(q, x, sun), allowable(q, drifted, sun - q.mean_motion * later)
    # The way back across a cone is one of the signed distance: on it the angle may turn a little further in.
    cones = next(group for group in families.groups if isinstance(group.barrier, SunCone))
    places = [(x, sun), (drifted, sun - q.mean_motion * later)]
    signed = [cones.barrier._geometry(families.stack(at)[:, cones.at, :3], s[:, None])[0] for at, s in places]
    names = np.array([label.split("[")[0].rstrip("+-") for label in families.labels])
    for name, of in INSIDE.items():
        held = h[:, names == name]
        outside = now[of] < 0
        if name == "h3":
            assert not (outside & (held >= 1e-6)).any()
            continue
        back = then[of] - now[of]
        if name in ("h4", "h5"):
            held = h[:, names == name]
            apart = names[cones.rows] == name
            back, outside = (signed[1] - signed[0])[:, apart], signed[0][:, apart] < 0
        assert (back[outside & (held >= 0)] > 0).all(), name
    for name in ("h9", "h10", "h11"):
        assert not ((now["phi" + name[1:]] < 0) & (h[:, names == name] >= 0)).any()


# --- control invariance of each constraint alone -------------------------------------------------------


def admissible(rng, K, q):
    """States with r <= r_max and speeds at or below their limits, many of them right at them."""
    way = rng.standard_normal((K, 3)) * rng.choice([0.0, 1.0], (K, 3), p=[0.3, 0.7])
    way[~way.any(axis=1)] = [1.0, 0.0, 0.0]
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    v = q.speed_max * rng.choice([-1.0, 1.0, 0.3], (K, 3))
    return way, v


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
    way, v = admissible(rng, K, q)
    distance = 10 ** rng.uniform(1, np.log10(q.distance_max), K)
    if family == "keep_in":
        distance = q.distance_max - 10 ** rng.uniform(-3, 1.5, K)
    if family == "chief_separation":
        distance = q.separation + 10 ** rng.uniform(-3, 1.5, K)
    if family == "sun":
        half = q.field_of_view / 2
        axis = -np.stack([np.cos(sun), np.sin(sun), 0 * sun], axis=1)
        across = np.cross(axis, way)
        across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-9)
        along = rng.uniform(q.separation, 0.8 * q.distance_max, (K, 1))
        delta = 10 ** rng.uniform(-3, 1.5, (K, 1))
        way = along * axis + (delta + np.sin(half) * along) / np.cos(half) * across
        distance = np.linalg.norm(way, axis=1)
        way /= distance[:, None]
    z = np.concatenate([way * distance[:, None], v], axis=1)
    chosen = [m for m, name in enumerate(families.family) if name == family]
    seen = 0
    for row in chosen:
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
        seen += ok.sum()
    assert seen > 100
