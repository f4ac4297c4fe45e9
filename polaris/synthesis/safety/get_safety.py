"""Algorithm 1, GetSafety: the safety controller and its recoverable sets (docs/theory.md, Theorem 1)."""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

from numpy.typing import ArrayLike

from reach.sets.zonotope import Zonotope
from reach.short_repr import short_repr

from ...model.errors import NotCertified, SynthesisInfeasible
from ...model.timing import Transient
from ...planning.problem import Plan
from ...planning.reference import Reference
from ..controllers.controllers import AffineController, construct_s
from ..tracker.error_bounds import ErrorBounds, get_err_bounds
from ..tracker.tracking import Tracking
from .attempts import Attempts, StageClock
from .ball_sets import BallSets
from .clearance import Clearance, best_facets
from .continuation import Continuation
from .end_condition import EndCondition
from .passive import FreeFlight
from .problem import Problem, as_problem
from .recoverable import Margin, RecoverableSet, quantity

SHARES = (0.5, 1.0)
"""Shares of the thrust limits that are tried for S's feedback where errors of thrusters grow with it."""
LESSER = (0.35, 0.25, 0.15)
"""The same where no safe reference is found with the first of them: the less feedback, the less errors."""


@short_repr
@dataclass(frozen=True, eq=False)
class Safety:
    """Output of Algorithm 1.

    Attributes
    ----------
    problem : Problem
        Problem to solve.
    tracking : Tracking
        Gain Lambda, error dynamics, contraction norm.
    bounds : ErrorBounds
        Constants of Lemma 1.
    plan : Plan
        Waypoints chi, inputs nu, and how they were found.
    reference : Reference
        xi and mu, followed by the coasting tail.
    controller : AffineController
        S.
    recoverable : RecoverableSet
        In error coordinates, at every node of the grid.
    start : Zonotope
        Theta minus the reference's first state.
    start_margin : Margin
        How far Theta is inside the first recoverable set.
    end : EndCondition
        Proof for the time after T.
    seconds : mapping
        Wall time by stage.
    cut_by_clock : tuple of str
        Stages of the planning that the wall clock ended early (`Plan.cut_by_clock`); on another machine,
        or again, the result may be another.
    """

    problem: Problem
    tracking: Tracking
    bounds: ErrorBounds
    plan: Plan
    reference: Reference
    clearance: Clearance
    controller: AffineController
    recoverable: RecoverableSet
    start: Zonotope
    start_margin: Margin
    end: EndCondition
    seconds: Mapping[str, float] = field(default_factory=dict)
    cut_by_clock: tuple[str, ...] = ()

    @cached_property
    def free_flight(self) -> FreeFlight | None:
        """Return the free motion after all thrust stops; None if nothing is asked of it."""
        problem, sets = self.problem, self.clearance.unsafe
        if problem.abort is None:
            return None
        return FreeFlight(problem.abort, problem.system, sets, problem.delta)

    def recoverable_with(self, faults: tuple[Transient, ...]) -> RecoverableSet:
        """Return the recoverable sets along the same reference if these faults alone were isolated late."""
        system = replace(self.problem.system, transients=faults)
        clearance = replace(self.clearance, tracking=replace(self.tracking, system=system))
        return get_recover(self.recoverable.kind, clearance, self.bounds)


def get_safety(
    problem: Any,
    initial_set: Zonotope | None = None,
    unsafe: tuple[Any, ...] = (),
    K: int | None = None,
    delta: float | None = None,
    Q: ArrayLike | None = None,
    R: ArrayLike | None = None,
    *,
    along: Plan | None = None,
    **options: Any,
) -> Safety:
    """Algorithm 1: ARE, error bounds, safe reference, S, recoverable sets.

    Parameters
    ----------
    problem : Scenario, Problem, LinearSystem or control.StateSpace
        A scenario or problem says everything; a system needs the arguments below.
    initial_set, unsafe, K, delta, Q, R
        See `Problem`.
    along : Plan, optional
        A certified plan to take for line 4, instead of looking for one.
    **options
        Further fields of `Problem`; a bare system needs ``goal``. A ``control.StateSpace`` also needs
        ``u_max`` and ``C``, what the position is, in which unsafe sets lie: its outputs are what is measured
        (and takes ``w_max``, ``D`` and ``mass``).

    Returns
    -------
    Safety

    Raises
    ------
    ScenarioError
        If an argument is malformed.
    SynthesisInfeasible
        If no safe reference exists, or Theta is not inside the first recoverable set.
    NotCertified
        If none was found in the time given, or its plan failed its re-check.
    """
    arguments = {"initial_set": initial_set, "unsafe": unsafe, "K": K, "delta": delta, "Q": Q, "R": R}
    problem = as_problem(problem, arguments, options)
    try:
        return find_safety(problem, along)
    except SynthesisInfeasible as error:
        if along is not None or not problem.system.transients:
            raise
        raise _naming_faults(error, problem) from error


def find_safety(problem: Problem, along: Plan | None = None, like: Safety | None = None) -> Safety:
    """Synthesize S as `get_safety` does, without finding the late faults that cannot be survived.

    A safety `like` it is of a problem that differs in what the planner is asked alone: its tracker serves
    again.
    """
    try:
        return _with_share(problem, along, like)
    except SynthesisInfeasible:
        if along is not None or problem.thrust_share is not None or not problem.system.proportional:
            raise
        for share in (*LESSER, *SHARES[1:]):
            with suppress(SynthesisInfeasible, NotCertified):
                return _with_share(replace(problem, thrust_share=share), None)
        raise


def _with_share(problem: Problem, along: Plan | None, like: Safety | None = None) -> Safety:
    """Return `find_safety` with the share of the thrust limits given for S's feedback, or the first."""
    clock, share = StageClock(), problem.thrust_share or SHARES[0]
    if like is not None and like.tracking.level == share:
        return _proven(problem, like.bounds, Attempts(problem, like.tracking, clock, along), like.controller)
    # Lines 1 and 2: solveARE, Lambda.
    tracking = Tracking(problem.system, problem.gain, problem.feedback, problem.delta, share)
    bounds = get_err_bounds(tracking, problem.bound, problem.weight)  # line 3: getErrBounds
    return _proven(problem, bounds, Attempts(problem, tracking, clock, along))


def _naming_faults(error: SynthesisInfeasible, problem: Problem) -> SynthesisInfeasible:
    """Name in the error the faults that cannot be survived, and the shortfall with each alone."""

    def under(*faults: Transient) -> Safety | None:
        try:
            return find_safety(replace(problem, system=replace(problem.system, transients=faults)))
        except (SynthesisInfeasible, NotCertified):
            return None

    faults, free = problem.system.transients, under()
    if free is None:
        text = f"{error.condition} Without faults that are isolated late no safe reference is found, either."
        return SynthesisInfeasible(text, error.shortfall, error.relax)
    text = f"{error.condition} A safe reference exists without faults that are isolated late."
    for fault in faults:
        sets, start = free.recoverable_with((fault,)), free.start
        if start.dim != sets.clearance.tracking.loop.N:  # a box stands for estimates beside this fault
            start = free.tracking.true_error(start)
        margin = sets.margin_at(0, start)
        short = quantity(margin.limit, margin.tightening - margin.clearance)
        step = margin.time / problem.delta
        place = f"{margin.limit} {short} short in step {int(step + 1e-9)} (t = {margin.time:.6g} s)"
        text += f" Along it {fault.name} ({fault.lasts:g} s) leaves {'enough' if margin.inside else place};"
        alone = under(fault) if len(faults) > 1 else None
        text += f" with this fault alone {'none' if alone is None else 'one'} is found."
    return SynthesisInfeasible(text, error.shortfall, f"{error.relax} Or isolate faults sooner.")


def _proven(
    problem: Problem, bounds: ErrorBounds, attempts: Attempts, s: AffineController | None = None
) -> Safety:
    """Prove lines 4 to 10: for the first reference along which enough is proven, or the last.

    A safety controller `s` along another reference is turned.
    """
    clock, tracking = attempts.clock, attempts.tracking
    for reference, jump in attempts:  # line 4: safeConstraints; lines 5 and 6: D2C of states and inputs
        s = (
            s.with_reference(reference, tracking) if s else construct_s(tracking, reference)
        )  # line 7: constructS
        # Line 8: not one r_min over all time, but the clearance along a facet of every set at every time.
        facets = best_facets(tracking, reference, attempts.unsafe, attempts.start)
        clearance = Clearance(tracking, reference, attempts.unsafe, facets, problem.K, jump)
        recoverable = get_recover(problem.recoverable, clearance, bounds)  # line 9: GetRecover
        if attempts.record(reference, recoverable):
            break
    assert s is not None
    attempts.require_start(recoverable)
    clock.lap("recoverable")
    proven = attempts.start, attempts.margin, attempts.end, clock.laps, attempts.cut_by_clock
    # Line 10.
    return Safety(problem, tracking, bounds, attempts.plan, reference, clearance, s, recoverable, *proven)


def get_recover(kind: str, clearance: Clearance, bounds: ErrorBounds) -> RecoverableSet:
    """Build the recoverable sets of one kind (the paper's GetRecover, line 9)."""
    if kind == "polytope":
        return Continuation(clearance)
    if kind == "ball":
        return BallSets(clearance, bounds)
    raise ValueError(f"unknown kind of recoverable set: {kind}")
