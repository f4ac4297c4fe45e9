"""Errors of the inspection paper as printed: the printed form fails, ours holds (theory notes 14-16)."""

import numpy as np
import pytest

from polaris.inspection.backup.tracker import BackupTracker, augmented
from polaris.inspection.constraints.allowable_set import allowable
from polaris.inspection.constraints.barriers import Braking, SunCone
from polaris.inspection.constraints.families import Families
from polaris.inspection.inspection import Inspection

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
    on, near = (cone(np.r_[200 * axis + [0, offset, 0], 0.1, 0.2, 0.0], 0.0) for offset in (0.0, 1e-9))
    assert np.isfinite(on.gradient).all() and on.h == pytest.approx(near.h, abs=1e-6)
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
    half, sun = Q.field_of_view / 2, 0.6
    axis = -np.array([np.cos(sun), np.sin(sun), 0.0])
    p = 400 * axis + 350 * np.cross([0, 0, 1.0], axis)
    spin = np.array([0.0, 0.0, -n])
    v = np.cross(spin, p)  # rigidly with the sun
    p_c = printed_projection(p, axis, half)
    gap = (p - p_c) / np.linalg.norm(p - p_c)
    assert abs(gap @ (v - np.cross(-spin, p_c))) > 0.5  # as printed: half a metre per second of error
    assert gap @ (v - np.cross(spin, p_c)) == pytest.approx(0.0, abs=1e-12)
    cone = SunCone(half, n, Braking(Q.a_max, Q.smoothing, Q.return_speed))
    np.testing.assert_allclose(cone._geometry(p, sun)[1], gap, atol=1e-12)
    # Being one with the cone, the barrier's explicit change with time cancels the motion's part.
    evaluation = cone(np.r_[p, v], sun)
    moving = np.r_[v, np.cross(spin, v)]
    assert evaluation.gradient @ moving + evaluation.change == pytest.approx(0.0, abs=1e-12)


def hautus_rank(A, B):
    """Rank at the eigenvalue 0: as large as A is, if it can be controlled."""
    scale = np.diag([1.0] * 3 + [1e-3] * 3 + [1e3] * (len(A) - 6))  # units in which all entries are alike
    A, B = np.linalg.inv(scale) @ A @ scale * 1e3, np.linalg.inv(scale) @ B * 1e3
    return np.linalg.matrix_rank(np.hstack([A, B]))


def test_item_15_integral_of_the_whole_error_is_uncontrollable_at_zero():
    """Eq. 40 as it reads integrates all six errors; ours the three positions alone."""
    A, B = augmented(Q)
    assert hautus_rank(A, B) == len(A) == 9
    assert np.linalg.eigvals(A - B @ BackupTracker(Q).gain).real.max() < -1e-3
    A = np.block([[A[:6, :6], np.zeros((6, 6))], [np.eye(6), np.zeros((6, 6))]])
    B = np.vstack([B[:6], np.zeros((6, 3))])
    assert hautus_rank(A, B) == 9 < len(A)
    # A left null vector, written down: integral of velocity error minus position error is constant.
    null_rows = np.hstack([-np.eye(3), np.zeros((3, 6)), np.eye(3)])
    assert not (null_rows @ A).any() and not (null_rows @ B).any()
