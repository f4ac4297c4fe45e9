"""Errors of the paper's planner and its Lemma 3 as printed: the printed form fails, ours holds."""

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import linprog

from polaris.model.hill import clohessy_wiltshire
from polaris.model.scene.timed_polytope import TimedPolytope
from polaris.planning.goals import EllipticalNMT, ellipse_polygon
from polaris.planning.problem import PlanProblem
from polaris.planning.recheck import recheck
from polaris.planning.rows import PlanRows
from polaris.planning.solve import plan

ETA = 0.0012
CW = clohessy_wiltshire(ETA, 10.0, 1.0)
NORMALS = np.vstack([np.eye(3), -np.eye(3)])


def box(center, half, K):
    center, half = np.asarray(center, float), np.broadcast_to(np.asarray(half, float), (3,))
    return TimedPolytope("box", NORMALS, np.tile(NORMALS @ center + np.r_[half, half], (K, 2, 1)))


def problem(body, **options):
    start, margins = np.array([0, -1000, 0, 0, 0, 0.0]), (np.full((40, 6), 10.0),)
    goal = EllipticalNMT(ETA, 100.0, 250.0)
    return PlanProblem(CW, start, 40, 75.0, (body,), margins, np.full((40, 3), 0.9), goal, **options)


def test_note_8_second_row_of_eq_23_admits_the_inside_of_the_set():
    """``-H y - (b + 2 eps) <= 0`` lets the second waypoint lie as deep as twice the facet's offset."""
    h, b, eps = np.array([1.0, 0, 0]), 100.0, 5.0
    first, inside = np.array([120.0, 0, 0]), np.array([0.0, 0, 0])  # the centre of a box of half-width 100
    assert -h @ first + (b + 2 * eps) <= 0
    assert -h @ inside - (b + 2 * eps) <= 0  # as printed: accepted
    assert not -h @ inside + (b + 2 * eps) <= 0  # the sign of the first row: refused
    # ours: both ends, and all between, keep the margin
    task = problem(box((-250, -600, 0), 120, 40), extra_margin=20.0)
    answer = plan(task)
    for k in range(task.K):
        normal = NORMALS[answer.facets[0, k]]
        offset = task.unsafe[0].offsets[k, 0, answer.facets[0, k]]
        assert normal @ answer.chi[k, :3] - offset >= 10 and normal @ answer.chi[k + 1, :3] - offset >= 10


def test_note_9_waypoints_and_chord_are_safe_but_the_path_is_not():
    """Under thrust the path bows away from the chord by ``a delta^2 / 8``."""
    delta = 75.0
    block = np.zeros((9, 9))
    block[:6, :6], block[:6, 6:] = CW.A, CW.B
    u = np.array([1.0, 0, 0])
    start = np.array([0, -1000, 0, -0.1 * delta / 2, 0, 0.0])
    t = np.linspace(0, delta, 201)
    path = np.array([(expm(block * s) @ np.r_[start, u])[:3] for s in t])
    intersample = np.max(path[0, 0] + (path[-1, 0] - path[0, 0]) * t / delta - path[:, 0])
    assert intersample > 60.0  # metres
    body = box((-(intersample / 2 + 100), path[:, 1].mean(), 0), (100, 400, 100), 1)
    facet = body.offsets[0, 0, 0]
    assert path[0, 0] > facet and path[-1, 0] > facet  # eq. 23 without error bound: accepted
    assert path[:, 0].min() < facet  # and yet inside
    goal = EllipticalNMT(ETA, 100.0, 250.0)
    task = PlanProblem(CW, start, 1, delta, (body,), (np.zeros((1, 6)),), np.ones((1, 3)), goal)
    certified = recheck(task, u[None]).surplus[0][0, 0]
    true = path[:, 0].min() - facet
    assert certified <= true + 1e-9 and certified == pytest.approx(true, abs=0.5)


def printed_outer_polygon(b_max, N):
    """Eq. 20 as printed."""
    angle = 2 * np.pi * np.arange(N + 1) / N
    q = np.stack([b_max * np.cos(angle), 2 * b_max * np.sin(angle)], axis=1)
    alpha = np.stack([q[:-1, 1] - q[1:, 1], q[:-1, 0] - q[1:, 0]], axis=1)
    return alpha, np.sum(alpha * q[:-1], axis=1)


def test_note_10_printed_outer_polygon_is_empty_for_15_sides():
    alpha, gamma = printed_outer_polygon(250.0, 15)
    assert linprog(np.zeros(2), A_ub=alpha, b_ub=gamma, bounds=(None, None)).status == 2


@pytest.mark.parametrize("sides", [4, 8, 15, 16])
def test_note_10_outward_normals_give_polygons_in_and_about_the_ellipse(sides):
    psi = np.linspace(0, 2 * np.pi, 3001)
    ellipse = np.stack([np.sin(psi), 2 * np.cos(psi)], axis=1)
    inner, inner_b = ellipse_polygon(100.0, sides, circumscribed=True)
    assert np.all(inner @ (100.0 * ellipse.T) <= inner_b[:, None] + 1e-9)  # the ellipse is inside it
    outer, outer_b = ellipse_polygon(250.0, sides, circumscribed=False)
    inside = np.max(outer @ (250.0 * ellipse.T * 1.0001) - outer_b[:, None], axis=0)
    assert np.all(inside > 0)  # nothing on or beyond the ellipse is inside it
    assert np.all(outer_b > 0)  # the centre is, so it is not empty


def test_note_11_one_big_m_hides_a_violation_of_a_metre():
    """A binary of 1 - 1e-5, which solvers call integer, relaxes the row by M * 1e-5."""
    printed_m, tolerance = 1e5, 1e-5
    assert printed_m * tolerance >= 1.0 - 1e-9
    # ours: M per row from what the thrusters can do, always less, and no M in the answer:
    # the facets are fixed, the program is solved again and the path re-checked
    task = problem(box((-250, -600, 0), 120, 40), extra_margin=20.0)
    rows, worst = PlanRows(task), 0.0
    for facets in (rows.options((0, k)) for k in range(40)):
        least = facets.at_least + rows.extreme(facets.a, budget=1.0)
        worst = max(worst, float(np.max(least)) * rows.length)
    assert worst <= printed_m / 5 and plan(task).extra.min() >= 20.0 * (1 - 1e-6)


def test_note_13_distance_alone_goes_far_and_costs_much():
    body = box((-250, -600, 0), 60, 40)
    far = plan(problem(body, objective="distance"))
    default = plan(problem(body, extra_margin=20.0))
    assert default.margin >= 20.0 * (1 - 1e-6)
    assert far.margin > 4 * default.margin and far.delta_v > 2 * default.delta_v
