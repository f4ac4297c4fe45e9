"""How much extra margin to ask for where: no more than the start and the goal leave room for."""

from __future__ import annotations

import numpy as np

from .search import Candidate, Levels, PathSearch


def set_targets(search: PathSearch, base: Candidate) -> float | None:
    """Fill in the extra margin wanted per cell, ``rows.extra * s``.

    Parameters
    ----------
    search : PathSearch
    base : Candidate
        The cheapest path without unsafe sets.

    Returns
    -------
    float or None
        Top of the margin variable s; None if some cell cannot be kept clear by any path to the goal.
    """
    problem, extras = search.rows.problem, search.rows.extra
    surplus, want = search.look(base).surplus, problem.extra_margin
    if problem.objective == "distance":
        for extra in extras:
            extra[: problem.K] = 1.0
        # the first cell starts at a known place, which bounds the distance whatever the plan
        reach = [max(float(np.max(s[0])), _room(search, i, 0, np.inf)) for i, s in enumerate(surplus)]
        cap = max(min(reach, default=0.0), 0.0)
        return min(cap, want) if want > 0 else cap
    want = want if problem.objective == "margin_then_fuel" else 0.0
    for i, extra in enumerate(extras):
        extra[: problem.K] = want
        for cells in (range(problem.K), range(problem.K - 1, -1, -1)):
            for k in cells:
                if np.max(surplus[i][k]) >= want:
                    break
                room = _room(search, i, k, want)
                if room < 0:
                    return None
                extra[k] = min(extra[k, 0], room)
                if room >= want:
                    break
    return 1.0 if want > 0 else 0.0


def _room(search: PathSearch, i: int, k: int, want: float) -> float:
    """Largest extra clearance [m] any path to the goal can have in one cell, at most `want`."""
    best, extra = -np.inf, search.rows.extra[i]
    old, extra[k] = extra[k, 0], 1.0
    search.set_prices(Levels(-1e6, min(want, 1e6)), margin=1e3, fuel=1e-6)
    for f in range(len(search.rows.problem.unsafe[i].normals)):
        path = search.solve({(i, k): f})
        best = best if path is None else max(best, path.level)
        if best >= want * (1 - 1e-9):
            break
    extra[k] = old
    return best * (1 - 1e-6) if best > 0 else best
