"""Algorithm 2, Polaris: which controller flies when, decided before the flight."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from .controllers import Controller
from .get_safety import Safety, get_safety
from .schedule import Schedule
from .search import Branch, Search, SwitchingRules


def synthesize(
    scenario: Any,
    safety: Safety | None = None,
    experimental: Sequence[Controller] | None = None,
    rules: SwitchingRules | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Schedule:
    """Algorithm 2: the switching schedule, proven before the flight.

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

    Returns
    -------
    Schedule

    Raises
    ------
    ScenarioError, SynthesisInfeasible, NotCertified
        See `get_safety`.
    """
    if isinstance(scenario, Safety):
        safety, scenario = scenario, scenario.problem
    safety = get_safety(scenario) if safety is None else safety  # lines 1 and 2: K steps; GetSafety
    search = Search.over(scenario, safety, experimental, rules, progress)
    branch = Branch(safety.start)  # lines 4 to 6: no mode decided; line 3, U's tube, is made step by step
    while branch.k < safety.problem.K:  # line 7; t1 and t2 of lines 8 and 9 are the ends of step k
        for mode, steps in search.options(branch):  # lines 10 and 16: U is tried first, else S
            ahead = search.fly(branch, mode, steps)  # lines 12 and 18: GetReach from the set reached
            if ahead is not None:  # line 13: inside C_S over all of [t1, t2]; S needs no such test
                branch = ahead  # lines 11 and 17: Theta; 14 and 19: the mode; 20 and 21: the next step
                break
    return search.schedule(branch)  # lines 22 and 23: the switching logic, with S
