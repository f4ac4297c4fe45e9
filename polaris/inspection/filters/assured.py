"""Filters that always have a proven answer: a plan that brakes and holds is proven before it is needed.

Each period something is proposed: the wanted thrust, the nearest that keeps every barrier, or something on
the way to the backup. It is applied if, after it, a plan is safe for all time; otherwise the plan that was
proven before is flown on. Proofs are in ``docs/inspection-theory.md``, section 6.
"""

from abc import abstractmethod

import numpy as np
from numpy.typing import NDArray

from ...model.checks import non_negative, whole
from ...model.errors import ScenarioError
from ...model.system import Array
from ...rta.one_call import Answer, CallByCall, Switch, named
from ...rta.received import Received
from ..backup.all_time import AllTime
from ..backup.planner import Planner, Proven
from ..constraints.families import Families
from ..vectors import length
from .explicit import Centralized, Decentralized

Some = NDArray[np.bool_]
Tried = tuple[Array, Proven, Some]  # thrust, what is known of it, and whose proposal it is

HALVINGS = 6  # halvings of the way from the backup's thrust to the wanted one
FAR = 1e-6  # how much farther from its plan a state may be by rounding [m]; a thousandth of it in m/s


class Assured(CallByCall):
    """What the four filters share: the plan that is proven, and that nothing is applied before its rest is.

    ``status``: "desired", "filtered", "backup" (some fly their plan), "coast" (no state known). ``margins``
    are lower bounds, over all time, of the constraints along what will be flown if the backup takes over
    after the period. A deputy whose state is not known flies its plan. `Decision.unproven` is false once a
    plan has been proven, as long as the states are known within their bounds and calls come each period;
    without errors of any kind states may be missing, too. ``log`` holds the switches of filters that latch.
    """

    def __init__(self, planner: Planner) -> None:
        self.planner, self.brake, self.check = planner, planner.brake, planner.check
        self.inspection, self.period = self.brake.inspection, self.brake.period
        super().__init__(self.inspection, self.period)
        self.log: list[Switch] = []
        self.take_over(None, np.nan)

    def take_over(self, plan: Proven | None, t: float) -> None:
        """From the time t [s] on a plan is flown that has been proven."""
        self.plan, self._due = plan, t

    @abstractmethod
    def _proposal(self, got: Received, able: Some, backup: Array) -> tuple[Array, Some]:
        """Thrust (N, 3) and whose of it is to be tried; the others fly their plan."""

    def _refused(self, got: Received, who: Some, reason: str) -> None:
        """Those whose proposal is not proven."""
        return

    def _answer(self, got: Received) -> Answer:
        notes: list[str] = []
        kept = self._kept(got, notes)
        if kept is None and not got.estimated.any():
            every = np.ones(len(got.u), dtype=bool)
            return Answer(np.zeros_like(got.u), every, ~every, every, {}, notes, unproven=True)
        sure, alone = kept is not None, kept is None and self.planner.mixed
        kept = kept or self.planner.find(got.t, got.x)
        x = np.where(got.known[:, None], got.x, kept.plan[0])
        backup = self.brake.follow(x, kept.plan)
        able = got.known & got.given
        proposed, who = self._proposal(got, able, backup)
        u, found, flown = self._tried(got, x, proposed, who & able, backup, kept)
        # A state that is not known is where its plan has it, if that was proven and nothing else acts.
        # So is none that begins anew, where others may go on as before.
        sure = found.good and not alone and bool((got.known | (sure & self.brake.uncertainty.exact)).all())
        if not sure:
            notes.append("no plan is known to be safe for all time")
        after, tube = self.planner.extended(found, 3)
        self.take_over(found._replace(plan=after[1:], tube=tube[1:]) if sure else None, got.t + self.period)
        labels = np.array(self.check.labels)
        active = tuple(labels[found.margins < 0].tolist()) if not found.good else ()
        intervened = (u != got.wanted).any(axis=1) | ~able
        none, margins = np.zeros(len(u), dtype=bool), named(self.check.labels, found.margins)
        return Answer(u, intervened, ~flown, none, margins, notes, active, unproven=not sure)

    def _kept(self, got: Received, notes: list[str]) -> Proven | None:
        """The plan that was proven, from now on; None where there is none, or a state is not within it."""
        plan = self.plan
        if plan is None or abs(got.t - self._due) > 1e-6 * self.period:
            return None
        if (self.near(got.x, plan) | ~got.known).all():
            return plan
        notes.append("a state is farther from its plan than is possible")
        return None

    def near(self, x: Array, plan: Proven) -> Some:
        """Whether estimates (N, 6) are as near to their plans as what is not known allows."""
        off, error = np.abs(x - plan.plan[0]), self.brake.uncertainty.estimate
        near = length(off[:, :3]) <= plan.tube[0, :, 0] + length(error[:3]) + FAR
        return np.asarray(near & (length(off[:, 3:]) <= plan.tube[0, :, 1] + length(error[3:]) + 1e-3 * FAR))

    def _tried(
        self, got: Received, x: Array, proposed: Array, who: Some, backup: Array, kept: Proven
    ) -> Tried:
        """The proposal of as many as it is proven for."""
        while who.any():
            u = np.where(who[:, None], proposed, backup)
            found = self.planner.find(got.t, x, u, kept, ~who)
            if found.good:
                return u, found, who
            concerned = _concerned(self.check, found.margins < 0, len(who)) & who
            dropped = concerned if concerned.any() else who
            worst = int(found.margins.argmin())
            reason = f"{self.check.labels[worst]} would be {found.margins[worst]:.3g}"
            self._refused(got, dropped, reason)
            who = who & ~dropped
        return backup, kept, who


class Explicit(Assured):
    """The nearest thrust that keeps every barrier (eq. 5), where a plan after it is proven.

    Parameters
    ----------
    planner : Planner
    filtering : Centralized or Decentralized
    """

    def __init__(self, planner: Planner, filtering: Centralized | Decentralized) -> None:
        super().__init__(planner)
        self.filtering = filtering

    def _proposal(self, got: Received, able: Some, backup: Array) -> tuple[Array, Some]:
        q = self.inspection
        wanted = np.where(able[:, None], np.clip(got.wanted, -1e6 * q.thrust_max, 1e6 * q.thrust_max), backup)
        sun = q.sun_angle([got.t], self.check.sun_start)
        found = self.filtering.batch(got.x[None], sun, wanted[None])
        good = np.isfinite(found.u[0]).all(axis=1)  # also where a barrier had to give way: the proof decides
        return np.where(good[:, None], found.u[0], backup), good


class Implicit(Assured):
    """What is wanted, and otherwise as far on the way to it, from the backup's thrust, as is proven.

    Parameters
    ----------
    planner : Planner
    """

    def _proposal(self, got: Received, able: Some, backup: Array) -> tuple[Array, Some]:
        return np.where(able[:, None], got.u, backup), able

    def _tried(
        self, got: Received, x: Array, proposed: Array, who: Some, backup: Array, kept: Proven
    ) -> Tried:
        u, found, passed = super()._tried(got, x, proposed, who, backup, kept)
        back = who & ~passed
        low, high = 0.0, 1.0
        for _ in range(HALVINGS if back.any() else 0):
            share = (low + high) / 2
            part = np.where(back[:, None], backup + share * (proposed - backup), proposed)
            part = np.where(who[:, None], part, backup)
            tried = self.planner.find(got.t, x, part, kept, ~who)
            if tried.good:
                u, found, passed, low = part, tried, who, share
            else:
                high = share
        return u, found, passed


class _Latching(Assured):
    """A deputy whose wanted thrust is not passed is on backup until it would have been for some time."""

    def __init__(self, planner: Planner, dwell: float) -> None:
        super().__init__(planner)
        self.dwell = non_negative("dwell", dwell, "s")
        self.latched = np.zeros(self.inspection.deputies, dtype=bool)
        self._clear_since = np.full(self.inspection.deputies, np.nan)

    @abstractmethod
    def _troubled(self, got: Received, u: Array, spare: bool) -> tuple[Some, str]:
        """Deputies (N,) that a period of thrust (N, 3) takes to their margin, or to their release; what."""

    def _proposal(self, got: Received, able: Some, backup: Array) -> tuple[Array, Some]:
        proposed = np.where(able[:, None], got.u, backup)
        clear = self.latched & able
        if clear.any():
            clear &= ~self._troubled(got, proposed, spare=True)[0]
        if not got.steady:
            self._clear_since[:] = np.nan  # nothing has lasted across a break of the clock
        since = np.where(np.isnan(self._clear_since), got.t, self._clear_since)
        self._clear_since = np.where(clear, since, np.nan)
        self._switch(clear & (got.t - since >= self.dwell), got.t, "desired", f"clear for {self.dwell:g} s")
        while (who := able & ~self.latched).any():
            troubled, what = self._troubled(got, np.where(who[:, None], proposed, backup), spare=False)
            if not troubled.any():
                break
            self._switch(troubled & who if (troubled & who).any() else who, got.t, "backup", what)
        return proposed, who

    def _refused(self, got: Received, who: Some, reason: str) -> None:
        self._switch(who, got.t, "backup", reason)

    def _switch(self, who: Some, t: float, to: str, reason: str) -> None:
        self.latched[who] = to == "backup"
        self._clear_since[who] = np.nan
        self.log += [Switch(t, int(i), to, reason) for i in np.flatnonzero(who)]


class SimplexExplicit(_Latching):
    """Passes the wanted thrust while barriers stay at their margin, and a plan after it is proven.

    Parameters
    ----------
    planner : Planner
    families : Families
        The constraints h1 to h11.
    margin, release : float
        Least value of every h, in its unit, for passing and for handing back.
    dwell : float
        For so long all must have been at `release` before a deputy is handed back [s].
    looks : int
        Instants in the coming period at which h is evaluated, evenly spaced, its end among them.
    """

    def __init__(
        self,
        planner: Planner,
        families: Families,
        margin: float = 0.0,
        release: float = 0.05,
        dwell: float = 30.0,
        looks: int = 2,
    ) -> None:
        super().__init__(planner, dwell)
        if release < margin:
            raise ScenarioError("release", release, "must be at least the margin")
        self.families, self._least = families, (margin, release)
        self._parts = self.period * np.arange(1, whole("looks", looks, 1) + 1) / looks
        self._moves = [self.inspection.held(float(part)) for part in self._parts]

    def _troubled(self, got: Received, u: Array, spare: bool) -> tuple[Some, str]:
        rows = self.families
        states = np.stack([got.x @ Phi.T + u @ Gamma.T for Phi, Gamma in self._moves])
        h = rows(states, self.inspection.sun_angle(got.t + self._parts, self.check.sun_start)).h.min(axis=0)
        worst = int(h.argmin())
        bad = ~(h >= self._least[spare])
        return _concerned(rows, bad, len(u)), f"{rows.labels[worst]} would be {h[worst]:.3g}"


class SimplexImplicit(_Latching):
    """Passes the wanted thrust while a plan after it is proven.

    Parameters
    ----------
    planner : Planner
    release_distance, release_speed : float
        Least bounds for handing back of distances [m] and of speeds [m/s].
    dwell : float
        [s]
    """

    def __init__(
        self,
        planner: Planner,
        release_distance: float = 2.0,
        release_speed: float = 0.02,
        dwell: float = 30.0,
    ) -> None:
        super().__init__(planner, dwell)
        distance = non_negative("release_distance", release_distance, "m")
        speed = non_negative("release_speed", release_speed, "m/s")
        self._release = np.where(self.check.about_speed, speed, distance)
        self._release[self.check.about_thrust] = 0.0

    def _troubled(self, got: Received, u: Array, spare: bool) -> tuple[Some, str]:
        if not spare:
            return np.zeros(len(u), dtype=bool), ""  # what is not proven is refused
        found = self.planner.find(got.t, got.x, u)
        return _concerned(self.check, ~(found.margins >= self._release), len(u)), ""


def _concerned(rows: AllTime | Families, chosen: Some, deputies: int) -> Some:
    """Deputies of the chosen rows, shape (N,)."""
    return np.isin(np.arange(deputies), np.concatenate([rows.first[chosen], rows.second[chosen]]))
