"""Plans of a backup that are proven before they are needed: the plainest, and what mends one that is not."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...model.checks import of_kind
from ...model.system import Array
from ..vectors import length
from .all_time import AllTime

ATTEMPTS = 4  # most plans that are tried from one state
ROOM = 0.5
"""Distance beyond need [m] by which a deputy is moved in that could not be held where it would stop."""


class Proven(NamedTuple):
    """A plan (L+1, N, 6) from the time t [s] on, the tube about it (L+1, N, 2) and its margins.

    Bounds (M,) of all constraints along it, for all time: negative where they are not proven.
    """

    plan: Array
    tube: Array
    margins: Array
    t: float

    @property
    def good(self) -> bool:
        """True if everything holds for all time."""
        return bool((self.margins >= 0).all())


class BackupPlanner:
    """Finds plans that brake and hold and are safe for all time; see `Brake` and `AllTime`.

    Parameters
    ----------
    check : AllTime
    mixed : bool
        True if new plans must be safe whoever goes on with the old ones instead.
    """

    def __init__(self, check: AllTime, mixed: bool = False) -> None:
        of_kind("check", check, AllTime)
        self.check, self.brake, self.mixed = check, check.brake, mixed

    def find(
        self,
        t: float,
        x: Array,
        u: Array | None = None,
        prior: Proven | None = None,
        keeps: NDArray[np.bool_] | None = None,
        before: Array | None = None,
    ) -> Proven:
        """Find the first plan that is proven from states (N, 6) at t [s], or the one that misses least.

        With a period of the thrust u (N, 3) before it, if given. Those who `keeps` (N,) says go on with the
        plan `prior`. For the thrust `before` see `Tube.around`.
        """
        brake = self.brake
        Phi, Gamma = brake.motion
        start = x if u is None else x @ Phi.T + u @ Gamma.T
        toward, shift = np.zeros((len(x), 3)), np.zeros((len(x), 3))
        best = None
        for _ in range(ATTEMPTS):
            plan = brake.plan(start, toward, shift)
            if u is not None:
                plan = np.concatenate([x[None], plan])
            old = None
            if prior is not None and (self.mixed or (keeps is not None and keeps.any())):
                plan = brake.extended(plan, len(prior.plan))
                old = self.extended(prior, len(plan))
            tube = brake.around(plan, before)
            if old is not None and keeps is not None:
                plan[:, keeps], tube[:, keeps] = old[0][:, keeps], old[1][:, keeps]
            proven = Proven(plan, tube, self.check(t, plan, tube, old if self.mixed else None), t)
            if best is None or proven.margins.min() > best.margins.min():
                best = proven
            if best.good or not self._mend(t, proven, start, toward, shift, keeps):
                break
        assert best is not None
        return best

    def extended(self, prior: Proven, count: int) -> tuple[Array, Array]:
        """A plan and its tube with at least `count` samples."""
        more = max(count - len(prior.tube), 0)
        return self.brake.extended(prior.plan, count), np.concatenate([prior.tube, *[prior.tube[-1:]] * more])

    def _mend(
        self,
        t: float,
        proven: Proven,
        start: Array,
        toward: Array,
        shift: Array,
        keeps: NDArray[np.bool_] | None,
    ) -> bool:
        """Change the concerned deputies' order or holding places; False if nothing new helps."""
        before = toward.copy(), shift.copy()
        brake, check = self.brake, self.check
        D = brake.period if len(proven.plan) > 1 else 0.0
        for row in np.flatnonzero(proven.margins < 0)[::-1]:
            name, i, j = check.labels[row].split("[")[0], check.first[row], check.second[row]
            if name in ("phi9", "phi10"):
                shift[i] += self._inwards(proven.plan[-1, i], float(proven.tube[-1, i, 1]))
            elif name in ("phi1", "phi2", "phi4", "phi5+", "phi5-", "phi6"):
                z = start[i, :3] - (start[j, :3] if j >= 0 else 0.0)
                outward = check.direction(name, z, t + D)
                toward[i] = -outward
                if j >= 0:
                    toward[j] = outward
        if keeps is not None:
            toward[keeps], shift[keeps] = 0.0, 0.0
        return not (np.array_equal(toward, before[0]) and np.array_equal(shift, before[1]))

    def _inwards(self, state: Array, slip: float) -> Array:
        """Return the shift (3,) [m] inwards with which a deputy that is held keeps its velocity limits."""
        q = self.check.inspection
        limit = (q.speed_max - slip) / q.mean_motion - ROOM
        p = state[:3] * (1.0, 1.0, 0.0)
        distance = float(length(p))
        return np.asarray(-p / distance * max(distance - limit, 0.0)) if distance > 0 else np.zeros(3)
