"""Algorithm 2, Polaris: which controller flies when, decided before the flight."""

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cached_property
from typing import Any

from ...model.errors import ClockWarning, NotCertified, SynthesisInfeasible
from ...planning.problem import Plan
from ..controllers.controllers import AffineController, AnyThrust, Controller
from ..controllers.neural import NeuralController
from ..safety.attempts import StageClock
from ..safety.get_safety import LESSER, SHARES, Safety, find_safety, get_safety
from ..safety.recoverable import directed
from .look_ahead import SAFETY
from .objective import Objective, is_as_good
from .recourse import views
from .rules import CHECKED, SwitchingRules
from .schedule import Schedule, Step
from .search import PartialSchedule, ScheduleSearch

LARGE = 0.15  # errors of thrusters, as a share of commands, from which on less feedback is tried too
DEARER = (0.0, 0.3, 3.0)  # added in turn to the price of velocity change while no schedule keeps the budget


def synthesize(
    scenario: Any,
    safety: Safety | None = None,
    experimental: Sequence[Controller] | None = None,
    rules: SwitchingRules | None = None,
    progress: Callable[[int, int], None] | None = None,
    recourse: bool | None = None,
) -> Schedule:
    """Return the schedule proven before the flight: Algorithm 2, along the reference that makes most of it.

    With recourse the reference may be planned with U in view; the printed algorithms' schedule is then one
    candidate among others (see `with_recourse`).

    Parameters
    ----------
    scenario : Scenario, Problem or Safety
        A `Safety` stands for its own problem (then give the experimental controllers).
    safety : Safety, optional
        Result of `get_safety`; computed if not given.
    experimental : sequence of Controller, optional
        In order of preference; a scenario brings its own.
    rules : SwitchingRules, optional
        A scenario brings its own.
    progress : callable, optional
        Called with (step, steps), once per step.
    recourse : bool, optional
        Whether another reference than that of `safety` may be flown, if the problem asks for recourse; by
        default where no `safety` is given.

    Raises
    ------
    ScenarioError, SynthesisInfeasible, NotCertified
        See `get_safety`. `NotCertified` also where no schedule is found that keeps the budget, and both where
        an abort with thrust is required, but not proven from the one that is found.
    """
    if isinstance(scenario, Safety):
        safety, scenario = scenario, scenario.problem
    recourse = safety is None if recourse is None else recourse
    fits, clock = safety is None, StageClock()
    if experimental is None and hasattr(scenario, "check_black_boxes"):
        scenario.check_black_boxes(())
    if safety is None:
        safety = get_safety(scenario)
        clock.lap("safety controller")
        clock.laps["safety controller"] -= sum(safety.seconds.values())
    search = ScheduleSearch.from_scenario(scenario, safety, experimental, rules, progress, fits, clock)
    clock.lap("experimental controllers")
    replan = recourse and safety.problem.recourse != "none"
    best = best_schedule(search, replan)
    free = recourse and safety.problem.thrust_share is None and safety.tracking.feedback_bound is not None
    best = best_share(search, best, replan) if free else best
    if best.powered is not None:
        best.powered.require()
        clock.lap("powered abort")
    return replace(best, seconds=clock.with_earlier(safety.seconds))


def laws_turn(search: ScheduleSearch) -> bool:
    """Return True if all laws are known to fly beside another reference, too."""
    kinds = AffineController, AnyThrust, NeuralController
    return all(isinstance(law, kinds) for law in search.controllers[1:])


def with_safety(search: ScheduleSearch, safety: Safety) -> ScheduleSearch:
    """Return the search along the reference of another `Safety`; all its laws must turn (see `laws_turn`)."""
    laws: Any = search.controllers[1:]
    adapted = [law.with_reference(safety.reference, safety.tracking) for law in laws]
    return replace(search, safety=safety, controllers=(safety.controller, *adapted))


def best_share(search: ScheduleSearch, first: Schedule, recourse: bool) -> Schedule:
    """Return the best of a schedule and those with other shares of thrust reserved for errors of S."""
    best, problem = first, search.safety.problem
    errors = problem.system.thrusters.table(problem.system.m).max()
    shares = SHARES[1:] + (LESSER[:2] if errors > LARGE else ())
    objective = Objective.beside(first, search.rules, search.safety)  # `first` may fly another reference
    for share in shares if laws_turn(search) else ():
        with suppress(SynthesisInfeasible, NotCertified):
            safety = find_safety(replace(problem, thrust_share=share), like=search.safety)
            search.clock.lap("thrust shares")
            other = best_schedule(with_safety(search, safety), recourse)
            best = max(best, other, key=lambda schedule: objective.alone(schedule, recourse))
    search.clock.lap("thrust shares")
    return best


def best_schedule(search: ScheduleSearch, recourse: bool) -> Schedule:
    """Return the schedule of one `Safety`, or with recourse the best that it leads to."""
    printed = switching_logic(search)
    search.clock.lap("schedule")
    best = printed
    if recourse:
        search, printed = arriving(search, printed)
        best = with_recourse(search, printed)
        search.clock.lap("recourse")
    if best.keeps(search.rules):
        return best
    best = within_budget(search, [printed, best])
    search.clock.lap("budget")
    return best


def arriving(search: ScheduleSearch, first: Schedule) -> tuple[ScheduleSearch, Schedule]:
    """Return another schedule that is proven to arrive, with no less of U, if the first one is not.

    Its reference ends inside the goal, by all that the first one's flights may be off, or by their shortfall.
    """
    safety, approach = first.safety, first.approach
    goal, shortfall = safety.problem.goal.conditions, approach.distance * (1 + CHECKED) - approach.tolerance
    if approach.reached is True or not goal.inequalities or not laws_turn(search):
        return search, first
    for length in (approach.distance, shortfall):
        with suppress(SynthesisInfeasible, NotCertified):
            deeper = replace(safety.problem, goal_inset=length)
            other = with_safety(search, find_safety(deeper, like=safety))
            second = switching_logic(other)
            if second.approach.reached is True and second.share() >= first.share():
                return other, second
    return search, first


def switching_logic(search: ScheduleSearch) -> Schedule:
    """Algorithm 2, for the controllers and by the rules of a search."""
    safety = search.safety  # lines 1 and 2: K steps; GetSafety
    branch = PartialSchedule(safety.start)  # lines 3 to 6: no mode decided; U's tube is made step by step
    while branch.k < safety.problem.K:  # line 7; t1 and t2 of lines 8 and 9 are the ends of step k
        for mode, steps in search.options(branch):  # lines 10 and 16: U is tried first, else S
            extended = search.extend(branch, mode, steps)  # lines 12 and 18: GetReach from the set reached
            if extended is not None:  # line 13: inside C_S over all of [t1, t2]; S needs no such test
                branch = extended  # lines 11 and 17: Theta; 14 and 19: the mode; 20 and 21: the next step
                break
    return search.schedule(branch)  # lines 22 and 23: the switching logic, with S


def with_recourse(search: ScheduleSearch, printed: Schedule) -> Schedule:
    """Return the best schedule: the printed one, or one along a reference planned with U's path known.

    Each candidate passes both algorithms whole. First come those that keep the budget of velocity change,
    then those proven safe for as long as the printed one, then those that are proven to arrive (`Objective`).
    While none keeps the budget, more are looked for at higher prices of velocity change.
    """
    problem = printed.safety.problem
    if not laws_turn(search):
        return printed

    def prove(plan: Plan, intended: tuple[int, ...]) -> Schedule | None:
        try:
            safety = find_safety(problem, plan, printed.safety)
        except SynthesisInfeasible:
            return None
        return switching_logic(replace(with_safety(search, safety), intended=intended))

    objective, late = Objective.beside(printed, search.rules, printed.safety), False
    best, others = printed, list[Schedule]()

    def compare(other: Schedule) -> None:
        """Keep the better one, and the other without its tubes."""
        nonlocal best
        worse, best = (best, other) if objective(other) > objective(best) else (other, best)
        others.append(Reflown.from_schedule(search, worse))

    for other in with_clearance(search, printed):
        compare(other)
    for dearer in DEARER:
        dear = replace(search.rules, delta_v_price=search.rules.delta_v_price + dearer)
        searches = views(printed, replace(objective, rules=dear))
        for other in (each for view in searches for each in view.schedules(prove)):
            compare(other)
        late |= any(view.cut_by_clock for view in searches)
        if best.keeps(search.rules):
            break
    library = tuple(one for one in others if is_as_good(one, best, search.rules))
    if late:
        text = "planner.time_limit_s ended the search for a reference along U's path early"
        warnings.warn(f"{text}: another machine or run may find another one", ClockWarning, stacklevel=3)
        cut = (*printed.safety.cut_by_clock, "reference with U in view")
        best = replace(best, safety=replace(best.safety, cut_by_clock=cut))
    return replace(best, library=library, objective=objective.prices)


class Reflown(Sequence[Step]):
    """Steps of a schedule that are propagated again on first access: their tubes take much memory."""

    def __init__(self, search: ScheduleSearch, modes: tuple[int, ...]) -> None:
        self.search, self.modes = search, modes

    @classmethod
    def from_schedule(cls, search: ScheduleSearch, schedule: Schedule) -> Schedule:
        """Return a schedule without its tubes, but with the values that compare it."""
        steps = cls(with_safety(search, schedule.safety), tuple(schedule.modes.tolist()))
        light = replace(schedule, steps=steps)
        cached = {"modes", "approach", "spending", "delta_v_middle", "passive"} & vars(schedule).keys()
        vars(light).update({name: vars(schedule)[name] for name in cached})
        return light

    def __len__(self) -> int:
        return len(self.modes)

    def __getitem__(self, place: Any) -> Any:
        return self._flown[place]

    def __reduce__(self) -> Any:
        return tuple, (self._flown,)  # a search is not pickled, what it flew is

    @cached_property
    def _flown(self) -> Sequence[Step]:
        search = replace(self.search, rules=SwitchingRules(), progress=None, intended=self.modes)
        steps = switching_logic(search).steps
        if tuple(step.mode for step in steps) != self.modes:
            raise NotCertified("a second proof in its modes does not confirm the schedule")
        return steps


def with_clearance(search: ScheduleSearch, first: Schedule) -> Iterator[Schedule]:
    """Yield the schedule along a reference that adds the clearance that U lacked along the first one."""
    problem, names = first.safety.problem, {body.name for body in first.safety.clearance.unsafe}
    refused = (step.margin for step in first.steps if step.mode == SAFETY and step.margin.limit in names)
    shortfall = max((margin.tightening - margin.clearance for margin in refused), default=0.0)
    if shortfall > 0:
        extra = problem.extra_margin + shortfall
        with suppress(SynthesisInfeasible, NotCertified):
            wider = replace(problem, objective="margin_then_fuel", extra_margin=extra)
            yield switching_logic(with_safety(search, find_safety(wider, like=first.safety)))


def within_budget(search: ScheduleSearch, over: Sequence[Schedule]) -> Schedule:
    """Return the longest beginning of a schedule after which S alone keeps the rules.

    Of several the best by objective: budget of velocity change, and the requirement on the drift.
    `SynthesisInfeasible` if S alone keeps the budget, but its drift is not clear, along any of their
    references; `NotCertified` if not even S alone keeps the budget along any of them.
    """
    truncated, cheapest, witness = [], min(schedule.spent for schedule in over), None
    for schedule in over:
        along = replace(search, safety=schedule.safety, controllers=schedule.controllers)
        K, modes = len(schedule.steps), tuple(schedule.modes.tolist())
        few, many, best = -1, K, None
        while many - few > 1:
            tried = (few + many) // 2 if best else 0  # S alone first
            trial = switching_logic(replace(along, intended=modes[:tried] + (SAFETY,) * (K - tried)))
            cheapest = min(cheapest, trial.spent)
            if trial.affords(search.rules) and trial.passive is not None:
                witness = witness or trial.passive.witness()
            if trial.keeps(search.rules):
                few, best = tried, trial
            elif best is None:
                break
            else:
                many = tried
        truncated += [best] if best else []
    if not truncated and witness is not None:
        raise passive_safety_error(witness)
    if not truncated:
        tightening = directed(cheapest * (1 + CHECKED), ".4g", up=True)
        raise NotCertified(
            f"no schedule within schedule.delta_v_max_m_s = {search.rules.delta_v_max:g}: the smallest proven"
            f" delta-v is {tightening} m/s; raise the budget, or give more time or a wider goal"
        )
    return max(truncated, key=Objective.beside(over[0], search.rules, search.safety))


def passive_safety_error(witness: Mapping[str, Any]) -> SynthesisInfeasible:
    """Build the error raised when passive safety is required but not proven."""
    return SynthesisInfeasible(
        f"passive safety is required, but not proven under S alone: if all thrust stops {in_words(witness)}.",
        -witness["distance_m"],
        "shorten abort.drift_orbits (drift_s), raise planner.extra_margin_m, or lower the disturbance bound.",
    )


def in_words(witness: Mapping[str, Any]) -> str:
    """Describe a drift that is not clear: its step, the unsafe set, time and distance."""
    enters = witness["middle_m"] <= 0
    verb = "enters the perceived set of" if enters else "is not proven to stay clear of"
    distance = directed(witness["middle_m"] if enters else witness["distance_m"], ".4g")
    return (
        f"in step {witness['step']} (from {witness['t_s']:g} s) the drift {verb} {witness['unsafe_set']}"
        f" within {witness['after_s']:.6g} s (distance {distance} m)"
    )
