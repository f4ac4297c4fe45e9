"""Switching filters with a proven answer: the desired thrust passes as it is, or a plan is flown."""

from abc import abstractmethod

import numpy as np

from ...model.checks import non_negative, number, whole
from ...model.errors import ScenarioError
from ...model.system import Array
from ...rta.filter_input import FilterInput
from ...rta.one_call import Switch
from ..backup.planner import BackupPlanner
from ..constraints.families import Families
from .assured import Assured, Some, concerned
from .explicit import Centralized, Decentralized

LOOKS = 100  # most instants of a period at which barriers are evaluated; more only takes longer


class _Latching(Assured):
    """A deputy whose wanted thrust is not passed is on backup until it would have been for some time."""

    def __init__(
        self, planner: BackupPlanner, dwell: float, recovery: Centralized | Decentralized | None = None
    ) -> None:
        super().__init__(planner, recovery)
        self.dwell = non_negative("dwell", dwell, "s")
        self.latched = np.zeros(self.inspection.deputies, dtype=bool)
        self._clear_since = np.full(self.inspection.deputies, np.nan)

    @abstractmethod
    def _troubled(self, call: FilterInput, u: Array, spare: bool) -> tuple[Some, str]:
        """Deputies (N,) that a period of thrust (N, 3) takes to their margin, or their release; the cause."""

    def _proposal(self, call: FilterInput, valid: Some, backup: Array) -> tuple[Array, Some]:
        proposed = np.where(valid[:, None], call.u, backup)
        clear = self.latched & valid
        if clear.any():
            clear &= ~self._troubled(call, proposed, spare=True)[0]
        if not call.steady:
            self._clear_since[:] = np.nan  # nothing has lasted across a break of the clock
        since = np.where(np.isnan(self._clear_since), call.t, self._clear_since)
        self._clear_since = np.where(clear, since, np.nan)
        self._switch(clear & (call.t - since >= self.dwell), call.t, "desired", f"clear for {self.dwell:g} s")
        while (group := valid & ~self.latched).any():
            troubled, reason = self._troubled(call, np.where(group[:, None], proposed, backup), spare=False)
            if not troubled.any():
                break
            self._switch(troubled & group if (troubled & group).any() else group, call.t, "backup", reason)
        return proposed, group

    def _refused(self, call: FilterInput, deputies: Some, reason: str) -> None:
        self._switch(deputies, call.t, "backup", reason)

    def _switch(self, deputies: Some, t: float, to: str, reason: str) -> None:
        self.latched[deputies] = to == "backup"
        self._clear_since[deputies] = np.nan
        self.log += [Switch(t, int(i), to, reason) for i in np.flatnonzero(deputies)]


class SimplexExplicit(_Latching):
    """Passes the wanted thrust while barriers stay at their margin, and a plan after it is proven.

    Parameters
    ----------
    planner : BackupPlanner
    families : Families
        The constraints h1 to h11.
    margin, release : float
        Least value of every h, in its unit, for passing and for handing back.
    dwell : float
        For so long all must have been at `release` before a deputy is handed back [s].
    looks : int
        Instants in the coming period at which h is evaluated, evenly spaced, its end among them.
    recovery : Centralized or Decentralized, optional
        As of `Assured`.
    """

    def __init__(
        self,
        planner: BackupPlanner,
        families: Families,
        margin: float = 0.0,
        release: float = 0.05,
        dwell: float = 30.0,
        looks: int = 2,
        recovery: Centralized | Decentralized | None = None,
    ) -> None:
        super().__init__(planner, dwell, recovery)
        if number("release", release) < number("margin", margin):
            raise ScenarioError("release", release, "must be at least the margin")
        self._check_families(families)
        self.families, self._least = families, (margin, release)
        if whole("looks", looks, 1) > LOOKS:
            raise ScenarioError("looks", looks, f"must be at most {LOOKS}")
        self._parts = self.period * np.arange(1, looks + 1) / looks
        self._moves = [self.inspection.discretize(float(part)) for part in self._parts]

    def _troubled(self, call: FilterInput, u: Array, spare: bool) -> tuple[Some, str]:
        rows = self.families
        states = np.stack([call.x @ Phi.T + u @ Gamma.T for Phi, Gamma in self._moves])
        h = rows(states, self.inspection.sun_angle(call.t + self._parts, self.check.sun_start)).h.min(axis=0)
        worst = int(h.argmin())
        violated = ~(h >= self._least[spare])
        return concerned(rows, violated, len(u)), f"{rows.labels[worst]} would be {h[worst]:.3g}"


class SimplexImplicit(_Latching):
    """Passes the wanted thrust while a plan after it is proven.

    Parameters
    ----------
    planner : BackupPlanner
    release_distance, release_speed : float
        Least bounds for handing back of distances [m] and of speeds [m/s].
    dwell : float
        [s]
    recovery : Centralized or Decentralized, optional
        As of `Assured`.
    """

    def __init__(
        self,
        planner: BackupPlanner,
        release_distance: float = 2.0,
        release_speed: float = 0.02,
        dwell: float = 30.0,
        recovery: Centralized | Decentralized | None = None,
    ) -> None:
        super().__init__(planner, dwell, recovery)
        distance = non_negative("release_distance", release_distance, "m")
        speed = non_negative("release_speed", release_speed, "m/s")
        self._release = np.where(self.check.about_speed, speed, distance)
        self._release[self.check.about_thrust] = 0.0

    def _troubled(self, call: FilterInput, u: Array, spare: bool) -> tuple[Some, str]:
        if not spare:
            return np.zeros(len(u), dtype=bool), ""  # what is not proven is refused
        proven = self.planner.find(call.t, call.x, u)
        return concerned(self.check, ~(proven.margins >= self._release), len(u)), ""
