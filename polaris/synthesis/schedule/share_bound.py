"""Bound on the share of time that any schedule could leave to U, given the conflicts of U's own path.

Without disturbance and from the middle of the initial set, a flight must keep clear of the unsafe sets at the
ends of all steps: where U flies it moves as U's law has it, where S flies by any thrust within the limits.
If that is impossible although S flies a set of steps, it is so with any part of them. So each set that is
proven impossible demands a step more, and an integer program tells how few steps meet every demand
(docs/theory.md, Proposition 13).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import Bounds, LinearConstraint, milp
from scipy.sparse import coo_array

from ..controllers.controllers import AffineController
from .rules import SwitchingRules
from .schedule import Schedule
from .undisturbed import FREE, Held, UndisturbedFlights

NODES = 2000  # most nodes of an integer program; its bound until then is used
SLACK = 1e-4  # steps by which its bound is lowered, for its tolerances
ROWS, STEPS = 20_000, 500
"""Most rows that state the dwell time, and most steps of a schedule, for which an integer program is made."""


@dataclass(frozen=True)
class ShareBound:
    """Proven bound on the share of the time under experimental controllers, over all schedules of a scene.

    No schedule that keeps clear of the unsafe sets as perceived has more, along any reference and with
    any safety controller, on the same steps and by the same dwell time and cap. It is ``reached`` where
    as many steps under S as the bound leaves could not be refuted; else the effort ran out, or nothing was to
    bound.
    """

    share: float
    objective: float  # the same of the shares of all modes, each weighted by the objective of its steps
    programs: int = 0  # linear programs solved and flights looked at
    demands: int = 0  # sets of steps that were proven too few
    ended: str = "none"  # reached, effort_limit or none


class Master:
    """The integer program: fewest steps under S by the rules of the schedule and the demands made so far.

    Its variables are whether a mode flies a step, and whether one is switched to; see `demand`.
    """

    def __init__(self, K: int, modes: int, rules: SwitchingRules) -> None:
        self.K, self.modes = K, modes
        self.size = K * modes + K
        self.rows: list[tuple[dict[int, float], float]] = []
        for k in range(K):
            ones = dict.fromkeys(range(k * modes, (k + 1) * modes), 1.0)
            self.rows += [(ones, 1.0), (dict.fromkeys(ones, -1.0), -1.0)]
        dwell, cap = rules.min_dwell, rules.max_switches
        dwell = dwell if K * modes * dwell <= ROWS else 1
        for k in range(1, K):
            for mode in range(modes):
                current, before = self._at(k, mode), self._at(k - 1, mode)
                self.rows.append(({K * modes + k: 1.0, current: -1.0, before: 1.0}, 0.0))
                for later in range(k + 1, min(k + dwell, K)):
                    self.rows.append(({self._at(later, mode): 1.0, current: -1.0, before: 1.0}, 0.0))
        if cap is not None:  # the return to S from a last step under U is held back
            switched = dict.fromkeys(range(K * modes, K * modes + K), -1.0)
            self.rows.append((switched | {self._at(K - 1, FREE): 1.0}, 1.0 - cap))

    def _at(self, k: int, mode: int) -> int:
        return k * self.modes + mode

    def demand(self, modes: Held) -> None:
        """Demand that at least one of the steps held is flown otherwise."""
        at = [self._at(k, mode) for k, mode in enumerate(modes) if mode != FREE]
        self.rows.append((dict.fromkeys(at, -1.0), 1.0 - len(at)))

    def _cheapest(self, prices: Sequence[float]) -> tuple[float, Any]:
        """Proven bound on the cost of all steps, priced by mode, infinite if impossible; and the answer."""
        entries = [(i, at, value) for i, (row, _) in enumerate(self.rows) for at, value in row.items()]
        i, at, value = (np.array(part) for part in zip(*entries, strict=True))
        A = coo_array((value, (i, at)), shape=(len(self.rows), self.size)).tocsr()
        cost, integral = np.zeros(self.size), np.ones(self.size)
        cost[: self.K * self.modes] = np.tile(prices, self.K)
        integral[self.K * self.modes :] = 0.0
        answer = milp(
            cost,
            integrality=integral,
            bounds=Bounds(0.0, 1.0),
            constraints=LinearConstraint(A, [bound for _, bound in self.rows]),
            options={"node_limit": NODES},
        )
        if answer.status == 2:
            return np.inf, answer
        bound = answer.mip_dual_bound
        return 0.0 if bound is None or not np.isfinite(bound) else max(float(bound) - SLACK, 0.0), answer

    def solve(self) -> tuple[int, Held | None]:
        """Proven number of steps under S, K + 1 if there is no schedule; and modes with as few, if found."""
        bound, answer = self._cheapest([float(mode == FREE) for mode in range(self.modes)])
        fewest = self.K + 1 if np.isinf(bound) else int(np.ceil(bound))
        if answer.x is None:
            return fewest, None
        choice = answer.x[: self.K * self.modes].reshape(self.K, self.modes)
        return fewest, tuple(int(mode) for mode in choice.argmax(axis=1))

    def objective_bound(self, objectives: Sequence[float]) -> float:
        """Proven bound on the mean objective of a step, by that of each mode; 0 if there is no schedule."""
        largest = max(objectives)
        bound = self._cheapest([1.0 - objective / largest for objective in objectives])[0]
        return largest * max(1.0 - bound / self.K, 0.0)


def share_bound(schedule: Schedule, rules: SwitchingRules, limit: int) -> ShareBound:
    """Bound the share of the time under experimental controllers, with at most about `limit` programs."""
    safety = schedule.safety
    problem, laws = safety.problem, schedule.controllers[1:]
    affine = [law for law in laws if isinstance(law, AffineController) and law.own is not law.reference]
    objectives = rules.mode_values(len(laws) + 1)
    if limit == 0 or len(affine) < len(laws) or problem.K > STEPS:
        return ShareBound(1.0, max(objectives))
    flights, master = UndisturbedFlights(safety, affine), Master(problem.K, len(laws) + 1, rules)
    demands, proven, ended = 0, 0, "effort_limit"
    while flights.programs < limit:
        fewest, modes = master.solve()
        proven = max(proven, fewest)
        if modes is None:
            break
        if not flights.impossible(modes):
            ended = "reached"
            break
        master.demand(flights.widened(modes))
        demands += 1
    share = 1.0 - min(proven, problem.K) / problem.K
    objective = (
        share * max(objectives) if len(set(objectives[1:])) <= 1 else master.objective_bound(objectives)
    )
    return ShareBound(share, min(objective, share * max(objectives)), flights.programs, demands, ended)
