"""Claim about the time after T, S tracking a natural motion that coasts (docs/theory.md, Proposition 12)."""

from dataclasses import dataclass

import numpy as np

from ...model.hill import cw_matrix
from ...model.scene.timed_polytope import TimedPolytope
from ...model.system import Array, LinearSystem
from ...model.tolerances import REFERENCE
from ...planning.reference import Reference
from ..tracker.tracking import Tracking
from .recoverable import Margin

CLOSED = 1e-5
"""Largest residual of the closing condition, relative to the size of the state, that is snapped to
the exact natural motion (and counted as a jump of the reference)."""


@dataclass(frozen=True)
class EndCondition:
    """The claim about the time after T.

    Attributes
    ----------
    horizon : {"infinite", "one_period", "none"}
        For how long after T the system stays safe under S: for ever, for one further period
        (orbit, or settling time of the loop), or nothing is proven.
    until : float
        Last instant covered [s]; infinite, T + one period, or T.
    reason : str
        Why the claim holds, or why it does not.
    """

    horizon: str
    until: float
    reason: str

    @property
    def proven(self) -> bool:
        """Return True if anything is proven after T."""
        return self.horizon != "none"


def tail_length(tracking: Tracking) -> int:
    """Cells of one further period: the orbit's in Hill's frame, else the settling horizon of the loop."""
    settle = int(np.ceil((tracking.settling + 1) / tracking.feedback.nodes_per_cell)) + 1
    eta = tracking.system.mean_motion
    if eta is None or not in_hills_frame(tracking.system):
        return settle
    return max(int(np.ceil(2 * np.pi / eta / tracking.delta)), settle)


def coast(planned: Reference, tail: int) -> tuple[Reference, Array]:
    """Return the reference followed by its coasting tail, started from the exact natural motion next to it.

    And ``|x_T - x*|`` elementwise (n,), the step that the snap makes; zero where nothing was snapped.
    """
    last = planned.chi[-1]
    closed, _ = natural_motion(planned, last)
    small = np.abs(closed - last) <= CLOSED * max(1.0, float(np.max(np.abs(last))))
    start = closed if np.all(small) else last
    tail_chi = Reference.propagate(planned.system, planned.delta, start, np.zeros((tail, planned.system.m)))
    chi = np.vstack([planned.chi[:-1], tail_chi.chi])
    nu = np.vstack([planned.nu, tail_chi.nu])
    rounding = REFERENCE * np.max(np.abs(chi[planned.cells :]), axis=0)
    return Reference(planned.system, planned.delta, chi, nu), np.abs(start - last) + rounding


def natural_motion(planned: Reference, x: Array) -> tuple[Array, str]:
    """Return the nearest state whose unforced motion closes (Hill's frame) or rests (any other system)."""
    system = planned.system
    if in_hills_frame(system):
        closed = x.copy()
        closed[4] = -system.A[3, 4] * x[0]  # v_y = -2 eta r_x
        return closed, "on a closed orbit"
    # Nearest point of the null space of A: the states at rest.
    _, values, rows = np.linalg.svd(system.A)
    null = rows[values <= 1e-12 * max(values.max(), 1.0)]
    return np.asarray(null.T @ (null @ x)), "at rest"


def in_hills_frame(system: LinearSystem) -> bool:
    """Return True if the free motion is Clohessy-Wiltshire's (not merely said to be)."""
    eta = system.mean_motion
    return eta is not None and system.n == 6 and np.array_equal(system.A, cw_matrix(eta))


def _stays(system: LinearSystem, x: Array) -> bool:
    """Return True if the natural motion from x repeats for ever: by the closed form, or as A x is zero.

    A state that rests only to rounding drifts, however slowly; no tightening covers that drift.
    """
    return in_hills_frame(system) or not np.any(system.A @ x)


def prove_end(
    tracking: Tracking,
    reference: Reference,
    planned: int,
    tail: int,
    sets: tuple[TimedPolytope, ...],
    start: Margin,
) -> EndCondition:
    """Decide the proof after T from the margin `start` of Theta, every limit of the tail included."""
    T, delta = planned * tracking.delta, tracking.delta
    until = (planned + tail) * delta
    if not start.inside:
        return EndCondition("none", T, f"not proven after T = {T:g} s, though S flies on: {start}")
    closed, word = natural_motion(reference, reference.chi[planned])
    exact = np.allclose(closed, reference.chi[planned], rtol=0, atol=1e-12 * max(1.0, np.max(np.abs(closed))))
    if not exact or not _stays(reference.system, closed):
        return EndCondition("one_period", until, "the reference does not end on a natural motion trajectory")
    late = ((one, one.offsets[planned:] != one.offsets[-1, -1]) for one in sets)
    moving = [one.name for one, changes in late if not one.static or changes.any()]
    if moving:
        reason = f"unsafe sets that move ({', '.join(moving)}) are covered until {until:g} s only"
        return EndCondition("one_period", until, reason)
    if tracking.settling + 1 > tail * tracking.feedback.nodes_per_cell:
        return EndCondition("one_period", until, "one period is shorter than the loop's settling horizon")
    return EndCondition("infinite", np.inf, f"the reference ends {word}, and all unsafe sets are static")
