"""A trajectory of a hybrid automaton, integrated again and checked to be admissible."""

from __future__ import annotations

import numpy as np

from ..numerics.checks import checked
from ..numerics.errors import ReachError
from .automaton import HybridAutomaton
from .simulation import REPLAYED, HybridTrajectory, inside, longest_stay


@checked
def replay_hybrid(automaton: HybridAutomaton, trajectory: HybridTrajectory, rtol: float = 1e-10) -> float:
    """Integrate a trajectory again, independently, and check that it is admissible.

    Every visit is integrated from the state in which the last one ended, with the same input and
    duration; inputs, guards, windows, dwell times, invariants and resets are checked on the way. That
    it begins in the initial set is not.

    Returns
    -------
    float
        Largest difference between the states, relative to the largest of each coordinate; inf if
        some step is not admissible.
    """
    from scipy.integrate import solve_ivp  # slow to import

    if not 0 < rtol < 1:
        raise ReachError(f"rtol must lie between 0 and 1, got {rtol!r}")
    rtol = max(rtol, 1e-13)
    worst, x = 0.0, trajectory.visits[0].states[0]
    if trajectory.visits[0].mode != automaton.start:
        return float("inf")
    for visit, after in zip(trajectory.visits, (*trajectory.visits[1:], None), strict=True):
        mode, begun = automaton[visit.mode], visit.times[0]
        force = np.asarray(mode.system.B @ visit.input).ravel() + mode.system.c
        length = visit.times[-1] - begun
        size = np.abs(visit.states).max(axis=0)
        scale = np.where(size > 0, size, size.max() or 1.0)
        states = np.repeat(x[None], len(visit.times), axis=0)
        if length > 0:
            solved = solve_ivp(
                lambda s, y, A=mode.system.A, f=force: A @ y + f,
                (0.0, length),
                x,
                method="LSODA" if np.abs(mode.system.A).max() * length > 100 else "DOP853",
                t_eval=np.clip(visit.times - begun, 0, length),
                rtol=rtol,
                atol=rtol * float(scale.min()),
            )
            states = solved.y.T
        worst = max(worst, float(np.max(np.abs(states - visit.states) / scale)))
        slack = 1e-9 * (1 + abs(visit.times[-1]))
        ok = all(bool(U.contains(visit.input)) for U in mode.system.U)
        ok = ok and bool(np.all(inside(mode.invariant, states, size, REPLAYED)))
        ok = ok and length <= longest_stay(automaton, visit.mode, begun) + slack
        t, x = visit.transition, states[-1]
        if t is not None and after is not None:
            ok = ok and (t.source, t.target) == (visit.mode, after.mode)
            ok = ok and bool(inside(t.guard, x[None], size, REPLAYED)[0])
            for limits, value in ((t.window, visit.times[-1]), (t.dwell, length)):
                if limits is not None:
                    ok = ok and limits[0] - slack <= value <= limits[1] + slack
            w = np.zeros(len(t.r)) if visit.uncertain is None else visit.uncertain
            ok = ok and (not np.any(w) if t.uncertain is None else bool(t.uncertain.contains(w)))
            x = t.R @ x + t.r + w
        if not ok:
            return float("inf")
    return worst
