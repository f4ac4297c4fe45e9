"""Errors of the inspection paper as printed: the printed form fails, ours holds (theory notes 14-16)."""

from __future__ import annotations

import numpy as np
import pytest

from polaris.inspection.constraints.allowable_set import allowable
from polaris.inspection.constraints.barriers import Braking, SunCone
from polaris.inspection.constraints.families import Families
from polaris.inspection.inspection import Inspection
from polaris.model.hill import cw_matrix

Q = Inspection(deputies=1)
n = Q.mean_motion


def printed_projection(p, axis, half_angle):
    """Eqs. 33 and 34."""
    s, c = np.sin(half_angle), np.cos(half_angle)
    along = p @ axis
    perp = p - along * axis
    length = np.linalg.norm(perp)
    return p + s * c * (length * axis + along * perp / length) - c**2 * perp - s**2 * along * axis


def test_note_14_eq_19_without_the_norm_lets_deputies_leave():
    """``r_max - p_i`` read component by component holds 270 m beyond r_max."""
    x = np.array([[900.0, 900.0, 0.0, 0.0, 0.0, 0.0]])
    assert (Q.distance_max - x[0, :3] >= 0).all()
    assert allowable(Q, x, 0.0)["phi6"][0] == pytest.approx(1000 - 900 * np.sqrt(2))


def test_note_14_eq_34_is_undefined_on_the_axis():
    axis = np.array([-1.0, 0.0, 0.0])
    with np.errstate(invalid="ignore"):
        assert np.isnan(printed_projection(200 * axis, axis, np.pi / 6)).all()
    cone = SunCone(np.pi / 6, n, Braking(Q.a_max, 0.1, Q.return_speed))
    on, beside = (cone(np.r_[200 * axis + [0, off, 0], 0.1, 0.2, 0.0], 0.0) for off in (0.0, 1e-9))
    assert np.isfinite(on.gradient).all() and on.h == pytest.approx(beside.h, abs=1e-6)
    # Elsewhere it is the printed projection: its distance is the signed distance used here.
    p = np.array([-300.0, 250.0, 40.0])
    gap = np.linalg.norm(p - printed_projection(p, axis, np.pi / 6))
    assert cone._geometry(p, 0.0)[0] == pytest.approx(gap)


@pytest.mark.parametrize("place", [[9.0, 0, 0], [1000.1, 0, 0]])
def test_note_14_roots_of_negative_numbers_outside(place):
    """Eqs. 29 and 36 have no value outside, and an infinite slope at the boundary."""
    r = np.linalg.norm(place)
    with np.errstate(invalid="ignore"):
        printed = np.sqrt(2 * Q.a_max * np.array([r - Q.separation, Q.distance_max - r]))
    assert np.isnan(printed).any()
    families = Families(Q)
    rows = families(np.r_[place, 0, 0, 0][None, None], np.zeros(1))
    assert np.isfinite(rows.h).all() and np.isfinite(rows.bound).all()
    names = [label.split("[")[0] for label in families.labels]
    assert rows.h[0, names.index("h1" if r < 100 else "h6")] < 0


def test_note_16_the_printed_cone_turns_the_wrong_way():
    """A deputy that turns with the cone keeps its distance from it; by the printed v_c it would not."""
    half = Q.field_of_view / 2
    sun = 0.6
    axis = -np.array([np.cos(sun), np.sin(sun), 0.0])
    p = 400 * axis + 350 * np.cross([0, 0, 1.0], axis)
    spin = np.array([0.0, 0.0, -n])
    v = np.cross(spin, p)  # rigidly with the sun

    def distance(t):
        """Distance from the cone at a time, position and cone both turned."""
        angle = -n * t
        c, s = np.cos(angle), np.sin(angle)
        turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
        moved = p + t * v + t**2 / 2 * np.cross(spin, v)
        return np.linalg.norm(moved - printed_projection(moved, turn @ axis, half))

    true_rate = (distance(1.0) - distance(-1.0)) / 2
    p_c = printed_projection(p, axis, half)
    gap = (p - p_c) / np.linalg.norm(p - p_c)
    assert true_rate == pytest.approx(0.0, abs=1e-6)
    as_printed = gap @ (v - np.cross([0, 0, n], p_c))
    assert abs(as_printed) > 0.5  # half a metre per second of error
    assert gap @ (v - np.cross([0, 0, -n], p_c)) == pytest.approx(0.0, abs=1e-12)
    cone = SunCone(half, n, Braking(Q.a_max, Q.smoothing, Q.return_speed))
    np.testing.assert_allclose(cone._geometry(p, sun)[1], gap, atol=1e-12)
    # Being one with the cone, the barrier's explicit change with time cancels the motion's part.
    evaluation = cone(np.r_[p, v], sun)
    moving = np.r_[v, np.cross(spin, v)]
    assert evaluation.gradient @ moving + evaluation.change == pytest.approx(0.0, abs=1e-12)


def controllable_at_zero(A, B):
    return np.linalg.matrix_rank(np.hstack([A, B]), tol=1e-12)


def test_note_15_integrating_the_velocity_error_too_is_uncontrollable():
    """Eq. 40 with z the integral of all of e: rank 9 of 12 at the eigenvalue 0; of the position: 9 of 9."""
    A = cw_matrix(n)
    B = np.vstack([np.zeros((3, 3)), np.eye(3) / Q.mass])
    everything = np.block([[A, np.zeros((6, 6))], [np.eye(6), np.zeros((6, 6))]])
    assert controllable_at_zero(everything, np.vstack([B, np.zeros((6, 3))])) == 9
    position = np.block([[A, np.zeros((6, 3))], [np.eye(3, 6), np.zeros((3, 3))]])
    assert controllable_at_zero(position, np.vstack([B, np.zeros((3, 3))])) == 9 == len(position)


def most(rows, row):
    """Largest growth that an admissible input gives a row, less what is asked for."""
    return Q.thrust_max * np.abs(rows.G[0, row]).sum() - rows.bound[0, row]


@pytest.mark.parametrize("acceleration", ["printed", "ours"])
def test_eq_28_leaves_out_the_turn_inside_the_keep_in_sphere(acceleration):
    """Going round at r_max pushes outwards by v_t^2 / r: with eq. 28's a_max, thrust cannot keep h6 = 0."""
    a = Q.a_max if acceleration == "printed" else Q.a_inside
    speed = np.sqrt(2 * a * 1.0)  # one metre from r_max, at the printed limit
    x = np.array([Q.distance_max - 1.0, 0, 0, speed, Q.speed_max, Q.speed_max])
    natural = 3 * n**2 * x[0] + 2 * n * x[4] + (x[4] ** 2 + x[5] ** 2) / x[0]
    braking = Q.thrust_max / Q.mass - natural  # the most that p and v allow
    needed = a  # s s' = a on the printed curve
    assert (braking >= needed) == (acceleration == "ours")


def test_centralized_rows_at_the_worst_place_can_be_met():
    families = Families(Q)
    row = families.labels.index("h6[0]")
    for delta in (0.01, 0.05, 0.1, 0.3, 1.0, 5.0):
        x = np.array([Q.distance_max - delta, 0, 0, 0.0, Q.speed_max, Q.speed_max])
        x[3] = min(families(x[None, None], np.zeros(1)).h[0, row], Q.speed_max)  # now h6 = 0
        rows = families(x[None, None], np.zeros(1))
        alpha = families.alpha["keep_in"](rows.h[0, row])
        assert rows.h[0, row] == pytest.approx(0.0, abs=1e-9) or x[3] == Q.speed_max
        # without the preset's bias and push
        assert most(rows, row) - alpha >= 0


def test_eq_29_as_printed_has_an_infinite_slope_at_the_boundary():
    """Held for any time at all, an input that meets the printed condition overshoots; ours has a slope."""
    delta = 1e-12
    assert np.sqrt(Q.a_max / (2 * delta)) > 1e4  # [1/s]
    braking = Braking(Q.a_max, Q.smoothing, Q.return_speed)
    assert braking(np.array(delta))[1] == pytest.approx(np.sqrt(Q.a_max / Q.smoothing))
