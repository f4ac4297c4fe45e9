"""Filters that always have a proven answer: a plan that brakes and holds is proven before it is needed.

Each period something is proposed: the wanted thrust, the nearest that keeps every barrier, or something on
the way to the backup. It is applied if, after it, a plan is safe for all time; otherwise the plan that was
proven before is flown on. Proofs are in ``docs/inspection-theory.md``, section 6.
"""

from abc import abstractmethod
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ...model.checks import of_kind
from ...model.errors import ScenarioError
from ...model.system import Array
from ...rta.filter_input import FilterInput
from ...rta.one_call import CallByCall, RawDecision, Switch, by_name
from ..backup.all_time import AllTime
from ..backup.planner import BackupPlanner, Proven
from ..constraints.families import Families
from ..constraints.motion import SampledData
from ..vectors import length
from .asif import ActiveSetFilter
from .explicit import Centralized, Decentralized

Some = NDArray[np.bool_]
Tried = tuple[Array, Proven, Some]  # thrust, what is known of it, and whose proposal it is

HALVINGS = 6  # halvings of the way from the backup's thrust to the wanted one
RETURN = 40.0
"""Time [s] in which `Explicit` goes back from a plan to what it proposes; less is rougher."""
FAR = 1e-6  # how much farther from its plan a state may be by rounding [m]; a thousandth of it in m/s


class Assured(CallByCall):
    """Base of the four filters: they apply nothing before a plan after it is proven.

    ``status``: "desired", "filtered", "backup" (some fly their plan), or that of the recovery. ``margins``
    are lower bounds, over all time, of the constraints along what will be flown if the backup takes over
    after the period. ``log`` holds the switches of filters that latch.

    `Decision.unproven` is false once a plan has been proven, as long as states are known within their
    bounds and calls come in time, within `Uncertainty.jitter`. A deputy whose state is not known flies its
    plan. Where everything is exact its state follows from the last one that was known, and the plan is proven
    for `polaris.rta.filter_input.MEMORY` seconds.

    Where no plan is proven, as from outside of the constraints, the answer is that of the `recovery` filter,
    unproven, until a plan is proven.

    Parameters
    ----------
    planner : BackupPlanner
    recovery : Centralized or Decentralized, optional
        Default: `Centralized`, preset ``linear``, for sampled data.

    Raises
    ------
    ScenarioError
        If an argument is of another kind, or the recovery is for another problem, period or other families.
    """

    def __init__(self, planner: BackupPlanner, recovery: Centralized | Decentralized | None = None) -> None:
        of_kind("planner", planner, BackupPlanner)
        self.planner, self.brake, self.check = planner, planner.brake, planner.check
        self.inspection, self.period = self.brake.inspection, self.brake.period
        late = 2 * self.brake.uncertainty.jitter
        if recovery is None:
            sampled = SampledData(self.period + late)
            recovery = Centralized(Families(self.inspection, "linear", self.check.without, sampled))
        of_kind("filtering", recovery, Centralized | Decentralized)
        self._check_families(recovery.families)
        tightened = recovery.families.sampled
        if tightened and not -1e-9 * self.period <= tightened.period - self.period <= late + 1e-9:
            rule = f"must be the planner's, {self.period:g} s, or up to {late:g} s more"
            raise ScenarioError("filtering.families.sampled.period", tightened.period, rule)
        self.recovery = ActiveSetFilter(recovery, sun_start=self.check.sun_start)
        super().__init__(self.inspection, self.period, late)
        self.log: list[Switch] = []
        self._applied = np.zeros((self.inspection.deputies, 3))
        self._sure = np.zeros(self.inspection.deputies, dtype=bool)  # whose states were surely known
        self.take_over(None)

    @property
    def settings(self) -> tuple[object, ...]:
        """Return all that answers depend on beside the calls: alike for filters that answer alike."""
        filtering, unknown = self.recovery.filtering, self.brake.uncertainty
        rows, sharing = filtering.families, getattr(filtering, "sharing", "")
        errors = (*unknown.estimate.tolist(), unknown.disturbance, unknown.thrusters, unknown.jitter)
        plans = (self.inspection, self.period, errors, self.check.sun_start, self.check.labels)
        return type(self), *plans, sharing, rows.labels, rows.alpha, rows.sampled

    def _check_families(self, families: Families) -> None:
        """Refuse families of another problem than the planner's."""
        of_kind("families", families, Families)
        if families.inspection != self.inspection:
            rule = "must be the planner's problem: the same deputies and parameters"
            raise ScenarioError("families.inspection", families.inspection, rule)

    def take_over(self, plan: Proven | None) -> None:
        """Fly a plan that has been proven, from its time on."""
        self.plan, self._followed = plan, np.ones(self.inspection.deputies, dtype=bool)

    @abstractmethod
    def _proposal(self, call: FilterInput, valid: Some, backup: Array) -> tuple[Array, Some]:
        """Thrust (N, 3) and whose of it is to be tried; the others fly their plan."""

    def _refused(self, call: FilterInput, deputies: Some, reason: str) -> None:
        """Take note of those whose proposal is not proven."""
        return

    def _answer(self, call: FilterInput) -> RawDecision:
        notes: list[str] = []
        received, (call, prior, within) = call, self._kept(call, notes)
        if prior is None and not call.estimated.any():
            self.take_over(None)
            everyone = np.ones(len(call.u), dtype=bool)
            return RawDecision(np.zeros_like(call.u), everyone, ~everyone, everyone, {}, notes, unproven=True)
        alone = prior is None and self.planner.mixed
        prior = prior or self.planner.find(call.t, call.x)
        x = np.where((call.known | self._sure)[:, None], call.x, prior.plan[0])
        backup = self.brake.follow(x, prior.plan)
        valid = call.known & call.given
        proposed, group = self._proposal(call, valid, backup)
        u, proven, passed = self._tried(call, received, x, proposed, group & valid, backup, prior)
        # Nobody who begins anew is sure of others, who may go on as before.
        sure = proven.good and not alone and bool(within.all())
        if not sure:
            notes.append("no plan is known to be safe for all time")
        labels = np.array(self.check.labels)
        active = tuple(labels[proven.margins < 0].tolist()) if not proven.good else ()
        margins = by_name(self.check.labels, proven.margins)
        after, tube = self.planner.extended(proven, 3)
        later = Proven(after[1:], tube[1:], proven.margins, proven.t + self.period)
        self.take_over(later if proven.good else None)
        self._followed = within
        if proven.good:
            none, intervened = np.zeros(len(u), dtype=bool), (u != call.wanted).any(axis=1) | ~valid
            answer = RawDecision(u, intervened, ~passed, none, margins, notes, active, unproven=not sure)
        else:
            recovery = self.recovery.decide(received)
            notes += recovery.notes
            answer = replace(recovery, margins=margins, notes=notes, active=active, unproven=True)
        self._applied = answer.u
        return answer

    def _kept(self, call: FilterInput, notes: list[str]) -> tuple[FilterInput, Proven | None, Some]:
        """Return the call as of the time at which it was due, the plan, and who is surely within its tube.

        No plan where there is none, the call is out of time, or a state is known not to be within the tube.
        A state is sure if it is known, or follows exactly from one that was, by calls in time (lemma B2).
        """
        plan, unknown = self.plan, self.brake.uncertainty
        in_time = plan is not None and abs(call.t - plan.t) <= max(unknown.jitter, 1e-6 * self.period)
        follows = self._sure & call.estimated & (in_time and unknown.exact)
        self._sure = (call.known | follows) & call.timed
        if plan is None or not in_time:
            return call, None, self._sure
        shifted = call
        if call.t != plan.t:  # where the thrust of the period before leads, or came from
            Phi, Gamma = self.inspection.discretize(plan.t - call.t)
            shifted = replace(call, t=plan.t, x=call.x @ Phi.T + self._applied @ Gamma.T)
        if not (self.near(shifted.x, plan) | ~call.known).all():
            notes.append("a state is farther from its plan than is possible")
            self._sure = call.known & call.timed  # motion or thrust is not exact
            return call, None, self._sure
        within = self._sure & self._followed
        return (call, None, self._sure) if self._sure.all() and not within.all() else (shifted, plan, within)

    def near(self, x: Array, plan: Proven) -> Some:
        """Return whose estimates (N, 6) are as near to their plans as their errors allow."""
        gap, error = np.abs(x - plan.plan[0]), self.brake.estimate
        near = length(gap[:, :3]) <= plan.tube[0, :, 0] + length(error[:3]) + FAR
        return np.asarray(near & (length(gap[:, 3:]) <= plan.tube[0, :, 1] + length(error[3:]) + 1e-3 * FAR))

    def _find(
        self, call: FilterInput, received: FilterInput, x: Array, u: Array, prior: Proven, group: Some
    ) -> Proven:
        """A plan after thrust u; where nobody keeps the one there was, from the time of the call."""
        if group.all() and not self.planner.mixed:
            return self.planner.find(received.t, received.x, u)
        before = None if received.t == call.t else self._applied
        return self.planner.find(call.t, x, u, prior, ~group, before)

    def _tried(
        self,
        call: FilterInput,
        received: FilterInput,
        x: Array,
        proposed: Array,
        group: Some,
        backup: Array,
        prior: Proven,
    ) -> Tried:
        """The proposal of as many as it is proven for."""
        while group.any():
            u = np.where(group[:, None], proposed, backup)
            proven = self._find(call, received, x, u, prior, group)
            if proven.good:
                return u, proven, group
            dropped = concerned(self.check, proven.margins < 0, len(group)) & group
            dropped = dropped if dropped.any() else group
            worst = int(proven.margins.argmin())
            reason = f"{self.check.labels[worst]} would be {proven.margins[worst]:.3g}"
            self._refused(call, dropped, reason)
            group = group & ~dropped
        return backup, prior, group


class Implicit(Assured):
    """Filter that applies the wanted thrust, else as far on the way to it from the backup's as is proven.

    Parameters
    ----------
    planner : BackupPlanner
    recovery : Centralized or Decentralized, optional
        As of `Assured`.
    """

    def _proposal(self, call: FilterInput, valid: Some, backup: Array) -> tuple[Array, Some]:
        return np.where(valid[:, None], call.u, backup), valid

    def _tried(
        self,
        call: FilterInput,
        received: FilterInput,
        x: Array,
        proposed: Array,
        group: Some,
        backup: Array,
        prior: Proven,
    ) -> Tried:
        u, proven, passed = super()._tried(call, received, x, proposed, group, backup, prior)
        back = group & ~passed
        low, high = 0.0, 1.0
        for _ in range(HALVINGS if back.any() else 0):
            share = (low + high) / 2
            part = np.where(back[:, None], backup + share * (proposed - backup), proposed)
            part = np.where(group[:, None], part, backup)
            tried = self._find(call, received, x, part, prior, group)
            if tried.good:
                u, proven, passed, low = part, tried, group, share
            else:
                high = share
        self._cut = np.where(back, low, 1.0)  # how far towards it those were proven that were not all the way
        return u, proven, passed


class Explicit(Implicit):
    """The nearest thrust that keeps every barrier (eq. 5), where a plan after it is proven.

    Otherwise as far on the way to it as is proven, and from there back to it within `RETURN`: a deputy that
    takes turns with its plan has its thrust change from period to period. Not in a group that loses messages,
    whose members must answer the same to the same messages.

    Parameters
    ----------
    planner : BackupPlanner
    filtering : Centralized or Decentralized
    """

    def __init__(self, planner: BackupPlanner, filtering: Centralized | Decentralized) -> None:
        super().__init__(planner, filtering)
        self.filtering, self._share = filtering, np.ones(self.inspection.deputies)
        self._cut = np.ones(self.inspection.deputies)

    def _proposal(self, call: FilterInput, valid: Some, backup: Array) -> tuple[Array, Some]:
        q = self.inspection
        goal = np.where(valid[:, None], np.clip(call.wanted, -1e6 * q.thrust_max, 1e6 * q.thrust_max), backup)
        sun = q.sun_angle([call.t], self.check.sun_start)
        answer = self.filtering.batch(call.x[None], sun, goal[None])
        good = np.isfinite(answer.u[0]).all(axis=1)  # also where a barrier had to give way: the proof decides
        if not self.planner.mixed:
            self._share = np.minimum(self._share * self._cut + self.period / RETURN, 1.0)
        u, share = np.where(good[:, None], answer.u[0], backup), self._share[:, None]
        return np.where(share < 1, backup + share * (u - backup), u), good


def concerned(rows: AllTime | Families, chosen: Some, deputies: int) -> Some:
    """Deputies of the chosen rows, shape (N,)."""
    return np.isin(np.arange(deputies), np.concatenate([rows.first[chosen], rows.second[chosen]]))
