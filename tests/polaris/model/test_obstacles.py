"""Timed polytopes contain the true sets at every instant; distances and entry times are exact."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.optimize import minimize, nnls

from polaris.model.errors import ScenarioError
from polaris.model.hill import clohessy_wiltshire, free_flight
from polaris.model.scene.keep_in import KeepInCone, KeepInPolytope
from polaris.model.scene.obstacle import directions
from polaris.model.scene.obstacles import BallObstacle, BoxObstacle, PolytopeObstacle, perceive
from polaris.model.scene.satellite import SatelliteObstacle
from polaris.model.scene.shapes import PolytopeShape
from polaris.model.system import LinearSystem
from polaris.report.scene.geometry import boxed
from reach.numerics.linear import discretize
from reach.sets.zonotope import Zonotope

CW = clohessy_wiltshire(0.0012, 10.0, 0.1, w_max=1e-6)
PLANE = LinearSystem(
    np.kron([[0, 1], [0, 0]], np.eye(2)),
    np.kron([[0], [1]], np.eye(2)),
    np.kron([[0], [1]], np.eye(2)),
    [1, 1],
)
few = settings(max_examples=25, deadline=None)
seeds = st.integers(0, 2**32 - 1)


def random_system(rng: np.random.Generator) -> LinearSystem:
    """Anything from a lightly damped oscillator to an unstable coupled system."""
    kind = rng.integers(3)
    if kind == 0:
        return clohessy_wiltshire(10 ** rng.uniform(-4, -1.5), 10.0, 0.1, w_max=rng.choice([0.0, 1e-4]))
    if kind == 1:
        return LinearSystem(PLANE.A, PLANE.B, PLANE.D, PLANE.u_max, w_max=rng.choice([0.0, 1e-3]))
    n, d, p = int(rng.integers(1, 6)), int(rng.integers(1, 4)), int(rng.integers(1, 4))
    A = rng.normal(size=(n, n)) / np.sqrt(n)
    C = rng.normal(size=(d, n))
    return LinearSystem(A, np.ones((n, 1)), rng.normal(size=(n, p)), [1.0], w_max=0.01, C=C)


# -- soundness ------------------------------------------------------------------------------------


def worst_motion(system, rows, start, push, bound, total, steps, rng, kind):
    """Return states under an input ``x' = A x + push w`` within its bound, held between `steps` instants."""
    h = total / steps
    phi, input_map = discretize(system.A, push, h)
    end = rng.integers(1, steps + 1)
    row = rows[rng.integers(len(rows))]
    states = [start]
    flip = rng.integers(0, steps, size=2)
    fixed = rng.normal(size=push.shape[1])
    for i in range(steps):
        if kind == "aimed":  # what maximises one facet's support at one instant
            w = row @ expm(system.A * max(end - i - 0.5, 0.0) * h) @ push
        elif kind == "bang-bang":
            w = fixed * (-1) ** np.sum(i >= flip)
        else:
            w = rng.normal(size=push.shape[1])
        size = np.linalg.norm(w)
        w = w * (bound / size) if size > 0 else 0 * w
        states.append(phi @ states[-1] + input_map @ w)
    return np.array(states)


@settings(max_examples=60, deadline=None)
@given(seed=seeds, kind=st.sampled_from(["aimed", "bang-bang", "random"]), corner=st.booleans())
def test_satellite_is_inside_its_polytope_at_every_instant(seed, kind, corner):
    rng = np.random.default_rng(seed)
    system = random_system(rng)
    fast = max(1e-3, float(np.max(np.abs(np.linalg.eigvals(system.A)))))
    delta, cells, per = rng.uniform(0.05, 1.5) / fast, int(rng.integers(1, 6)), 24
    x0 = rng.normal(size=system.n) * 10 ** rng.uniform(-2, 3)
    half = np.abs(rng.normal(size=system.n)) * rng.choice([0.0, 0.1, 10.0], size=system.n)
    second = 2 * system.d == system.n  # nothing else has an acceleration to add to (test_satellites.py)
    thrust = float(rng.choice([0.0, 0.01, 1.0])) if second else 0.0
    radius = float(rng.uniform(0.1, 10))
    sat = SatelliteObstacle("s", x0, half, radius, thrust)
    (tp,) = sat.timed_polytopes(system, delta, cells)
    rows = tp.normals @ system.position
    offsets = tp.fine(per)
    for _ in range(4):
        draw = rng.choice([-1.0, 1.0], size=system.n) if corner else rng.uniform(-1, 1, size=system.n)
        share = 1.0 if kind != "random" else rng.uniform(0, 1)
        arguments = delta * cells, per * cells, rng, kind
        x = worst_motion(system, rows, x0 + half * draw, system.D, share * system.w_max, *arguments)
        if thrust:
            E = system.acceleration_input
            x = x + worst_motion(system, rows, np.zeros(system.n), E, share * thrust, *arguments)
        reach = x @ rows.T + radius
        by_cell = np.stack([reach[k * per : (k + 1) * per + 1] for k in range(cells)])
        assert np.all(by_cell <= offsets)


@pytest.mark.parametrize("thrust", [0.0, 1e-5])
def test_satellite_polytope_is_tight(thrust):
    """The exact support (fine quadrature) comes within 1 % of the size, and 4 mm, of the offsets."""
    sat = SatelliteObstacle("s", [100, 300, 20, 0.1, -0.24, 0.02], [5, 5, 5, 0.005, 0.005, 0.005], 20, thrust)
    delta, cells, per = 20.0, 20, 20
    (tp,) = sat.timed_polytopes(CW, delta, cells)
    t = np.linspace(0, delta * cells, cells * per + 1)
    rows = tp.normals @ CW.position @ free_flight(CW.mean_motion, t)
    rate = np.linalg.norm(rows @ CW.D, axis=-1) * (thrust + CW.w_max)
    growth = np.vstack([0 * rate[:1], np.cumsum((rate[1:] + rate[:-1]) / 2 * (t[1] - t[0]), axis=0)])
    support = rows @ sat.state + np.abs(rows) @ sat.state_half_widths + growth + sat.radius
    by_cell = np.stack([support[k * per : (k + 1) * per + 1] for k in range(cells)])
    slack = tp.fine(per) - by_cell
    assert slack.min() >= 0
    assert slack.min(axis=1).max() < 0.004  # touches somewhere in every cell, along every facet
    bulge = delta**2 / 8 * (2 * CW.mean_motion * 0.5 + thrust + 1e-5)
    assert slack.max() < 0.004 + 2 * bulge


@pytest.mark.parametrize("thrust", [0.0, 5e-5])
def test_the_place_of_a_satellite_grows_uncertain_as_the_reference_says(thrust):
    """By about half of the accelerations times t squared, and by more after a tenth of an orbit."""
    sat = SatelliteObstacle("s", [100, 300, 20, 0.1, -0.24, 0.02], np.zeros(6), 20, thrust)
    system = clohessy_wiltshire(0.0012, 10.0, 0.1, w_max=3e-5)
    (tp,) = sat.timed_polytopes(system, 10.0, 180)
    opposite = np.argmin(tp.normals @ tp.normals.T, axis=1)
    half = ((tp.offsets + tp.offsets[..., opposite]) / 2)[:, 1].max(axis=1) - sat.radius
    t = 10.0 * np.arange(1, 181)
    share = half / ((thrust + system.w_max) * t**2 / 2)
    tenth = int(0.1 * 2 * np.pi / system.mean_motion / 10.0)
    assert share[tenth - 1] == pytest.approx(1.0, rel=0.1) and share[-1] > 1.5


def test_satellite_on_a_straight_line_is_exact():
    sat = SatelliteObstacle("s", [1, 2, 3, 4], [0, 0, 0, 0], 5.0)
    (tp,) = sat.timed_polytopes(PLANE, 2.0, 3)
    t = np.array([[0, 2], [2, 4], [4, 6]])[..., None]
    expected = tp.normals @ [1, 2] + t * (tp.normals @ [3, 4]) + 5
    np.testing.assert_allclose(tp.offsets, expected, atol=1e-6)
    assert np.all(tp.offsets >= expected)
    assert not tp.static


@few
@given(
    seed=seeds, d=st.integers(1, 3), kind=st.sampled_from(["box", "ball", "polytope"]), moving=st.booleans()
)
def test_rigid_sets_are_inside_their_polytopes(seed, d, kind, moving):
    rng = np.random.default_rng(seed)
    system = LinearSystem(np.zeros((d, d)), np.eye(d), np.eye(d), np.ones(d), C=np.eye(d))
    centre, v = rng.normal(size=d) * 100, rng.normal(size=d) if moving else None
    size = rng.uniform(0.1, 50, size=d)
    if kind == "box":
        obstacle = BoxObstacle("o", centre, size, v)
        local = np.sign(rng.normal(size=(64, d))) * size  # corners
    elif kind == "ball":
        obstacle = BallObstacle("o", centre, size[0], v)
        way = rng.normal(size=(64, d))
        local = size[0] * way / np.linalg.norm(way, axis=1, keepdims=True)
    else:
        H = np.vstack([rng.normal(size=(6, d)), np.eye(d), -np.eye(d)])
        b = rng.uniform(0.5, 5, size=len(H))
        obstacle = PolytopeObstacle("o", H, b + H @ centre, v)
        local = PolytopeShape(
            H / np.linalg.norm(H, axis=1)[:, None], b / np.linalg.norm(H, axis=1)
        ).vertices()
    (tp,) = perceive([obstacle], system, 3.0, 4)
    assert tp.static == (not moving)
    offsets = tp.fine(6)
    for k in range(4):
        for i in range(7):
            t = 3.0 * (k + i / 6)
            p = centre + local + t * (0 if v is None else v)
            slack = 1e-12 * (np.abs(p) @ np.abs(tp.normals).T) if kind == "polytope" else 0.0
            assert np.all(p @ tp.normals.T <= offsets[k, i] + slack)
            np.testing.assert_array_less(obstacle.signed_distance(t, p), 1e-9)
    if kind == "ball":
        assert np.all(tp.offsets[0, 0] - tp.normals @ centre <= size[0] * (1 + 1e-6) + 1e-6)
    else:  # not vacuous: whatever is clear of the true set is clear of the polytope
        p = centre + rng.normal(size=(200, d)) * size.max()
        clear = obstacle.signed_distance(0.0, p) > 1e-5
        assert np.all(np.any(p[clear] @ tp.normals.T > offsets[0, 0], axis=1))


@pytest.mark.parametrize(
    ("d", "facets", "worst"), [(2, None, 1.036), (3, None, 1.14), (3, 6, 1.74), (1, None, 1.0)]
)
def test_ball_cover_is_circumscribed_and_close(d, facets, worst):
    ball = BallObstacle("b", np.zeros(d), 2.0, facets=facets)
    reach = np.linalg.norm(ball.cover.vertices(), axis=1) / 2
    assert 1 <= reach.max() <= worst
    assert len(ball.cover.H) == {1: 2, 2: 12, 3: facets or 26}[d]
    np.testing.assert_allclose(np.linalg.norm(directions(d, facets), axis=1), 1)


@few
@given(
    seed=seeds, d=st.integers(2, 3), angle=st.floats(0.01, 1.5), cut=st.booleans(), facets=st.integers(3, 20)
)
def test_cone_polytope_is_inscribed_and_touches(seed, d, angle, cut, facets):
    rng = np.random.default_rng(seed)
    apex, axis = rng.normal(size=d) * 10, rng.normal(size=d)
    cone = KeepInCone("c", apex, axis, angle, facets, length=50.0 if cut else None)
    system = LinearSystem(np.zeros((d, d)), np.eye(d), np.eye(d), np.ones(d), C=np.eye(d))
    sets = perceive([cone], system, 1.0, 3)
    assert all(s.keep_in and s.static and len(s.normals) == 1 and s.cells == 3 for s in sets)
    assert len(sets) == (facets if d == 3 else 2) + cut
    inside, middle = cone.inside, cone.inside.middle
    corners = (inside if cut else boxed(inside.H, inside.b, middle - 100.0, middle + 100.0)).vertices()
    p = corners.mean(axis=0) + (corners - corners.mean(axis=0)) * 0.999
    p = np.vstack([p, rng.dirichlet(np.ones(len(corners)), size=200) @ corners])
    safe = np.all([p @ s.normals[0] > s.offsets[0, 0, 0] for s in sets], axis=0)
    assert safe.sum() > 100
    assert np.all(cone.signed_distance(0.0, p[safe]) > 0)  # certainly safe means inside the true cone
    if cut:  # the edges of the inscribed cone lie on the true one
        np.testing.assert_allclose(cone.signed_distance(0.0, corners), 0, atol=1e-6 * np.ptp(corners))


def test_keep_in_polytope_is_one_unsafe_halfspace_per_facet():
    walls = KeepInPolytope("corridor", [[2.0, 0], [-1, 0]], [10.0, 3])
    first, second = perceive([walls], PLANE, 1.0, 2)
    assert (first.name, second.name) == ("corridor[0]", "corridor[1]")
    np.testing.assert_allclose(first.normals, [[-1, 0]])
    np.testing.assert_allclose(first.offsets, -5 * np.ones((2, 2, 1)))
    p = np.array([[4.0, 100], [5, 0], [6, 0], [-2, 0]])
    np.testing.assert_allclose(walls.signed_distance(0.0, p), [1, 0, -1, 1])
    np.testing.assert_allclose(walls.entry_time(0.0, p, [[1, 0], [1, 0], [-1, 0], [0, 1]]), [1, 0, 0, np.inf])


# -- distances ------------------------------------------------------------------------------------


def projected_distance(H, b, p):
    """Distance from p to ``H x <= b`` by least-distance programming (Lawson and Hanson, ch. 23)."""
    E = np.vstack([-H.T, H @ p - b])
    f = np.r_[np.zeros(len(p)), 1.0]
    r = E @ nnls(E, f, maxiter=1000)[0] - f
    return float(np.linalg.norm(r[:-1] / r[-1]))


@few
@given(
    seed=seeds, d=st.integers(1, 3), rows=st.integers(1, 12), bounded=st.booleans(), far=st.floats(0.1, 100)
)
def test_polytope_distance_is_the_euclidean_projection(seed, d, rows, bounded, far):
    rng = np.random.default_rng(seed)
    H = rng.normal(size=(rows, d))
    H = np.vstack([H, np.eye(d), -np.eye(d)]) if bounded else H
    b = rng.uniform(0.1, 3, size=len(H))
    obstacle = PolytopeObstacle("o", H, b, unbounded=True)
    p = rng.normal(size=(20, d)) * far
    distances = obstacle.signed_distance(0.0, p)
    for point, value in zip(p, distances, strict=True):
        gap = H @ point - b
        if np.all(gap <= 0):
            expected = np.max(gap / np.linalg.norm(H, axis=1))
        else:
            expected = projected_distance(H, b, point)
        assert value == pytest.approx(expected, rel=1e-7, abs=1e-9)


@pytest.mark.parametrize("d", [2, 3])
def test_polytope_distance_agrees_with_box_and_cover(d):
    rng = np.random.default_rng(d)
    box = BoxObstacle("b", np.arange(d), np.arange(d) + 1.0)
    same = PolytopeObstacle("p", box.shape.H, box.shape.b + box.shape.H @ np.arange(d))
    p = rng.normal(size=(50, 40, d)) * 4
    np.testing.assert_allclose(box.signed_distance(0.0, p), same.signed_distance(0.0, p), atol=1e-12)
    # 26 facets: several meet at a corner
    cover = BallObstacle("s", np.zeros(d), 1.0).cover
    some = p[0]
    expected = [projected_distance(cover.H, cover.b, q) for q in some]
    distances = cover.signed_distance(some)
    np.testing.assert_allclose(distances[distances > 0], np.array(expected)[distances > 0], rtol=1e-8)


def test_cone_distance_against_a_solver():
    rng = np.random.default_rng(3)
    axis = np.array([1.0, 2, -1]) / np.sqrt(6)
    cone = KeepInCone("c", [1, 1, 1], axis * 7, 0.4, length=10.0)
    slope = np.tan(0.4)
    rules = [
        {"type": "ineq", "fun": lambda x: 10 - axis @ x},
        {
            "type": "ineq",
            "fun": lambda x: slope * (axis @ x) - np.sqrt(np.sum((x - axis * (axis @ x)) ** 2) + 1e-18),
        },
    ]
    for _ in range(12):
        q = rng.normal(size=3) * 8
        value = cone.signed_distance(0.0, q + 1)
        if value < 0:  # the solver stalls near the tip from some starts: the best of several counts
            answers = [
                minimize(
                    lambda x, q=q: np.sum((x - q) ** 2), start, constraints=rules, options={"ftol": 1e-14}
                )
                for start in (5 * axis, 9 * axis + 0.1, axis, 0.1 * axis + 0.01 * q)
            ]
            best = min(one.fun for one in answers if min(rule["fun"](one.x) for rule in rules) > -1e-6)
            assert -value == pytest.approx(np.sqrt(best), rel=1e-4, abs=1e-4)
    on_axis = np.array([1.0, 1, 1]) + np.outer([-2.0, 0, 5, 9.9, 12], axis)
    expected = [-2, 0, 5 * np.sin(0.4), 0.1, -2]
    np.testing.assert_allclose(cone.signed_distance(0.0, on_axis), expected, atol=1e-12)


def test_hand_computed_distances_broadcast_over_runs_and_times():
    ball = BallObstacle("b", [0, 0], 2.0, velocity=[1.0, 0])
    t, p = np.array([0.0, 1, 2]), np.array([[[3.0, 0]], [[0, 2]], [[2, 0]]])
    expected = [[1, 0, -1], [0, np.sqrt(5) - 2, np.sqrt(8) - 2], [0, -1, -2]]
    np.testing.assert_allclose(ball.signed_distance(t, p), expected, atol=1e-12)
    box = BoxObstacle("x", [0, 0], [1, 2])
    np.testing.assert_allclose(
        box.signed_distance(0.0, [[4, 6], [3, 0], [0, 0], [0.5, 1.9], [1, 2]]),
        [5, 2, -1, -0.1, 0],
        atol=1e-12,
    )


def test_satellite_distance_is_about_its_nominal_or_true_state():
    sat = SatelliteObstacle("s", [100, 0, 0, 0, -0.24, 0], np.zeros(6), 10)
    t = np.array([0.0, 500, 2000])
    centre = (free_flight(0.0012, t) @ sat.state)[:, :3]
    np.testing.assert_allclose(sat.signed_distance(t, centre + [25, 0, 0], CW), 15, atol=1e-6)
    true = np.array([0.0, 0, 30, 0, 0, 0])
    assert sat.signed_distance(7.0, [0, 0, 0], CW, state=true) == pytest.approx(20)
    with pytest.raises(ScenarioError, match="system"):
        sat.signed_distance(0.0, [0, 0, 0])


# -- rays -----------------------------------------------------------------------------------------

SQUARE = {"H": [[1, 0], [-1, 0], [0, 1], [0, -1]], "b": [1, 1, 1, 1]}
ROUND, BOX, POLY = (
    BallObstacle("o", [0, 0], 1.0),
    BoxObstacle("o", [0, 0], [1, 1]),
    PolytopeObstacle("o", **SQUARE),
)


@pytest.mark.parametrize("obstacle", [ROUND, BOX, POLY])
@pytest.mark.parametrize(
    ("p", "v", "expected"),
    [
        ([-5, 0], [2, 0], 2.0),  # head-on
        ([-5, 0], [-2, 0], np.inf),  # moving away
        ([-5, 1], [1, 0], None),  # tangent: ball at 5, square along its face from 4
        ([-5, 1.001], [1, 0], np.inf),  # a miss
        ([-5, 0], [0, 0], np.inf),  # zero speed outside
        ([0.5, 0], [0, 0], 0.0),  # inside
        ([0.5, 0], [9, 0], 0.0),
        ([1, 0], [1, 0], 0.0),  # on the boundary, leaving
        ([-5, 0], [1e-200, 0], None),
    ],
)
def test_hand_computed_entry_times(obstacle, p, v, expected):
    if expected is None:
        expected = 4e200 if v[0] < 1 else (5.0 if obstacle is ROUND else 4.0)
    tolerance = {"rel": 1e-9} if obstacle is not ROUND else {"rel": 1e-4}
    assert obstacle.entry_time(0.0, p, v) == pytest.approx(expected, **tolerance)


def test_both_velocities_count():
    chased = BallObstacle("o", [10, 0], 1.0, velocity=[1, 0])
    assert chased.entry_time(0.0, [0, 0], [1, 0]) == np.inf
    assert chased.entry_time(0.0, [0, 0], [4, 0]) == pytest.approx(3.0)
    assert chased.entry_time(5.0, [0, 0], [4, 0]) == pytest.approx(14 / 3)


@few
@given(seed=seeds, kind=st.sampled_from(["box", "ball", "polytope", "satellite", "cone", "corridor"]))
def test_entry_time_agrees_with_dense_sampling(seed, kind):
    rng = np.random.default_rng(seed)
    H = np.vstack([rng.normal(size=(5, 3)), np.eye(3), -np.eye(3)])
    obstacle = {
        "box": lambda: BoxObstacle("o", rng.normal(size=3), rng.uniform(0.2, 2, 3), rng.normal(size=3) * 0.1),
        "ball": lambda: BallObstacle("o", rng.normal(size=3), 1.5),
        "polytope": lambda: PolytopeObstacle("o", H, rng.uniform(0.3, 2, len(H))),
        "satellite": lambda: SatelliteObstacle("o", np.r_[rng.normal(size=3), 0.1, 0, 0], np.zeros(6), 1.5),
        "cone": lambda: KeepInCone(
            "o", rng.normal(size=3) - [3, 0, 0], [1, 0, 0], rng.uniform(0.2, 1.4), length=9
        ),
        "corridor": lambda: KeepInPolytope("o", H[:7], rng.uniform(1, 4, 7)),
    }[kind]()
    p = rng.normal(size=(12, 3)) * 3
    v = rng.normal(size=(12, 3)) - 0.4 * p
    times = obstacle.entry_time(0.0, p, v, CW)
    s = np.linspace(0, 12, 1201)
    centre, velocity = obstacle.motion(0.0, CW)
    relative = p[:, None] - centre + s[:, None] * (v[:, None] - velocity)
    distance = obstacle.shape.signed_distance(relative)
    for i in range(len(p)):
        hits = np.flatnonzero(distance[i] <= 0)
        if len(hits):
            assert s[max(hits[0] - 1, 0)] - 1e-9 <= times[i] <= s[hits[0]] + 1e-9
        elif times[i] < 12:  # a hit between two samples: the point claimed must be on the boundary
            touch = relative[i, 0] + times[i] * (relative[i, 1] - relative[i, 0]) / s[1]
            assert abs(obstacle.shape.signed_distance(touch)) < 1e-6


# -- refusals -------------------------------------------------------------------------------------

SIX = np.zeros(6)


@pytest.mark.parametrize(
    ("build", "field"),
    [
        (lambda: BoxObstacle("o", [0, 0], [1, 0]), "obstacles['o'].half_widths"),
        (lambda: BoxObstacle("o", [0, np.nan], [1, 1]), "obstacles['o'].center"),
        (lambda: BoxObstacle("o", [0, 0], [1, 1, 1]), "obstacles['o'].half_widths"),
        (lambda: BoxObstacle("o", [0, 0, 0, 0], [1, 1, 1, 1]), "obstacles['o'].center"),
        (lambda: BoxObstacle("o", [[0, 0]], [1, 1]), "obstacles['o'].center"),
        (lambda: BoxObstacle("o", "here", [1, 1]), "obstacles['o'].center"),
        (lambda: BoxObstacle("o", [0, 0], [1, 1], velocity=[1]), "obstacles['o'].velocity"),
        (lambda: BoxObstacle("o", [0, 0], [1, 1], velocity=[1, np.inf]), "obstacles['o'].velocity"),
        (lambda: BallObstacle("o", [0, 0], -1.0), "obstacles['o'].radius"),
        (lambda: BallObstacle("o", [0, 0], 0.0), "obstacles['o'].radius"),
        (lambda: BallObstacle("o", [0, 0], float("nan")), "obstacles['o'].radius"),
        (lambda: BallObstacle("o", [0, 0], "wide"), "obstacles['o'].radius"),
        (lambda: BallObstacle("o", [0, 0], 1.0, facets=2), "obstacles['o'].facets"),
        (lambda: BallObstacle("o", [0, 0, 0], 1.0, facets=7), "obstacles['o'].facets"),
        (lambda: PolytopeObstacle("o", [[1, 0], [0, 1]], [1, 1]), "obstacles['o'].H"),
        (lambda: PolytopeObstacle("o", [[1, 0], [-1, 0]], [1, 1]), "obstacles['o'].H"),
        (lambda: PolytopeObstacle("o", [[1.0], [-1]], [1, -2]), "obstacles['o'].b"),
        (lambda: PolytopeObstacle("o", [[1.0], [-1]], [1, -1]), "obstacles['o'].b"),
        (lambda: PolytopeObstacle("o", [[1, 0], [0, 0]], [1, 1]), "obstacles['o'].H"),
        (lambda: PolytopeObstacle("o", [[1, 0]], [1, 1]), "obstacles['o'].b"),
        (lambda: PolytopeObstacle("o", np.ones((101, 2)), np.ones(101)), "obstacles['o'].H"),
        (lambda: SatelliteObstacle("o", SIX, -np.ones(6), 1), "obstacles['o'].state_half_widths"),
        (lambda: SatelliteObstacle("o", SIX, np.ones(3), 1), "obstacles['o'].state_half_widths"),
        (lambda: SatelliteObstacle("o", SIX, SIX, -1), "obstacles['o'].radius"),
        (lambda: SatelliteObstacle("o", SIX, SIX, 1, -1e-3), "obstacles['o'].thrust_accel_max"),
        (lambda: SatelliteObstacle("o", SIX * np.nan, SIX, 1), "obstacles['o'].state"),
        (lambda: KeepInCone("o", [0, 0, 0], [0, 0, 0], 0.5), "keep_in['o'].axis"),
        (lambda: KeepInCone("o", [0, 0, 0], [1, 0, 0], 0.0), "keep_in['o'].half_angle_rad"),
        (lambda: KeepInCone("o", [0, 0, 0], [1, 0, 0], np.pi / 2), "keep_in['o'].half_angle_rad"),
        (lambda: KeepInCone("o", [0, 0, 0], [1, 0, 0], 0.5, facets=2), "keep_in['o'].facets"),
        (lambda: KeepInCone("o", [0, 0, 0], [1, 0, 0], 0.5, length=0), "keep_in['o'].length"),
        (lambda: KeepInCone("o", [0], [1], 0.5), "keep_in['o'].apex"),
        (lambda: KeepInPolytope("o", [[1, 0], [-1, 0]], [-1, 0]), "keep_in['o'].b"),
        (lambda: perceive([BOX], CW, 1.0, 3), "obstacles['o']"),
        (lambda: perceive([BOX], PLANE, 0.0, 3), "delta"),
        (lambda: perceive([BOX], PLANE, 1.0, 0), "cells"),
        (lambda: perceive([BOX], PLANE, 1.0, 2.5), "cells"),
        (lambda: perceive([BOX, ROUND], PLANE, 1.0, 3), "obstacles['o'].name"),
        (lambda: perceive([SatelliteObstacle("o", SIX, SIX, 1)], PLANE, 1.0, 3), "obstacles['o'].state"),
        (lambda: BOX.signed_distance(0.0, [1, 2, 3]), "p"),
        (lambda: BOX.signed_distance(0.0, [1, np.nan]), "p"),
    ],
)
def test_bad_input_is_refused_with_one_message(build, field):
    with pytest.raises(ScenarioError) as caught:
        build()
    assert caught.value.field == field
    assert "\n" not in str(caught.value)
    assert caught.value.rule


def test_an_exploding_satellite_is_refused():
    wild = LinearSystem(np.eye(2) * 50, np.eye(2), np.eye(2), [1, 1], C=np.eye(2))
    with pytest.raises(ScenarioError, match="stay finite"):
        perceive([SatelliteObstacle("o", [1, 1], [0, 0], 1)], wild, 10.0, 10)


def test_outlines():
    np.testing.assert_allclose(BOX.cover.vertices(), [[-1, -1], [1, -1], [1, 1], [-1, 1]], atol=1e-12)
    wall = PolytopeObstacle("o", [[1, 0]], [3], unbounded=True)
    with pytest.raises(ScenarioError, match="must be bounded"):
        wall.cover.vertices()
    corners = boxed(wall.cover.H, wall.cover.b, np.full(2, -100.0), np.full(2, 100.0)).vertices()
    assert corners.shape == (4, 2)
    assert corners[:, 0].max() == pytest.approx(3)
    sat = SatelliteObstacle("s", [100, 0, 0, 0, -0.24, 0], np.ones(6) * 0.01, 10)
    assert sat.outline(0.0, CW).max(axis=0) == pytest.approx([110.01, 10.01, 10.01], rel=0.02)
    assert np.ptp(sat.outline(600.0, CW), axis=0).min() > 20


# -- facets through the origin --------------------------------------------------------------------


@pytest.mark.parametrize("kind", [PolytopeObstacle, KeepInPolytope])
@pytest.mark.parametrize("rows", [1, 2, 3])
@pytest.mark.parametrize("d", [1, 2, 3])
def test_facets_through_the_origin_are_those_of_a_set_that_is_moved(kind, rows, d):
    """Half-spaces, wedges and corners of any orientation, all offsets 0: distances, rays, depths."""
    rng = np.random.default_rng(10 * d + rows)
    move = rng.normal(size=d)
    H = rng.normal(size=(rows, d)) if d > 1 else np.full((rows, 1), -2.0)
    H[H @ np.ones(d) > 0] *= -1  # they leave (1, 1, 1) inside
    more = {"unbounded": True} if kind is PolytopeObstacle else {}
    at, shifted = kind("wall", H, np.zeros(rows), **more), kind("wall", H, H @ move, **more)
    p, v = rng.normal(size=(200, d)) * 10, rng.normal(size=(200, d))
    assert at.signed_distance(0.0, p) == pytest.approx(shifted.signed_distance(0.0, p + move), abs=1e-9)
    assert at.entry_time(0.0, p, v) == pytest.approx(shifted.entry_time(0.0, p + move, v), abs=1e-6)
    place = Zonotope(p[0], rng.normal(size=(d, 2)))
    assert at.shape.overlap(place) == pytest.approx(shifted.shape.overlap(place + move), abs=1e-9)


@pytest.mark.parametrize("b", [[0.0, 0.0], [0.0, -1e-13], [0.0, -1.0]])
def test_what_is_flat_or_empty_at_the_origin_is_refused(b):
    with pytest.raises(ScenarioError, match="interior"):
        PolytopeObstacle("flat", [[0, 0, 1], [0, 0, -1]], b, unbounded=True)
