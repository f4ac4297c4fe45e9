"""Recourse: a safe reference that is the flight itself, U's own path wherever U may fly it.

The printed Algorithm 1 plans one reference before U is known; U is then pulled back as soon as S could no
longer return to it. Here the reference is planned with U in view: it follows U's predicted path, leaves it
only in a few windows in which S flies, and ends at the goal. U then stays beside the reference by its own
tube alone, so that S, taking over at any node, starts where it wants to be. Which windows, and on which
side of an obstacle they lead, is decided by the schedule's objective. Nothing in the proof changes: any
reference will do for Theorem 2, and each candidate passes both algorithms whole.
"""

from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise
from time import perf_counter

import numpy as np

from reach.sets.zonotope import Zonotope

from ...model.errors import NotCertified, PolarisError, ScenarioError
from ...model.scene.distances import stretches
from ...model.system import Array
from ...planning.following import Followed, FollowingSearch
from ...planning.problem import REPLAN, Plan, PlanProblem
from ...planning.recheck import certified
from ...planning.reference import Reference
from ...planning.rows import Key, PlanRows
from ...planning.search import Candidate, CheckedPath
from ..controllers.controllers import AffineController, Controller, propagate_states
from ..controllers.neural import NeuralController
from ..safety.attempts import plan_problem
from ..safety.carried_rows import error_tube
from ..safety.goal_rows import inset
from ..tracker.tracking import Tracking
from .hand_over import HandOvers, reached_sets
from .objective import Mask, Objective
from .schedule import Schedule

STICKING = (20.0, 3.0)
"""Prices of a departure from U's path, in units of its fuel's cost, at which windows are looked for."""
SOFT = 5.0  # the same where U's own command leaves S no clearance above it: the reference goes on with less
DEPARTS = 1e-2  # share of full thrust from which on a departure from U's path is one
SHORT = 1e4  # price of a lacking length, beside that of fuel
PROGRAMS = 120  # most windows tried from each start
STARTS, ATTEMPTS = 3, 4  # sets of windows that are improved, and attempts to prove each
APART = tuple((i, j) for i in (3, 5, 7, 9) for j in (3, 5, 7, 9))  # steps left of a window that is split
SETTLED = 12  # steps after which S has done with the initial set
SIDES = 8  # sides of unsafe sets in U's way that are tried as starts: those that a path takes most cheaply
SPARE = 2.0  # by how much more than was lacking the clearance is raised from one attempt to the next

Prove = Callable[[Plan, tuple[int, ...]], Schedule | None]
"""What both algorithms make of a plan and the modes intended along it; None if nothing is proven."""


def in_windows(parts: list[tuple[int, int]], K: int) -> Mask:
    """Return the steps within windows, shape (K,)."""
    mask = np.zeros(K, dtype=bool)
    for a, b in parts:
        mask[max(a, 0) : min(b, K)] = True
    return mask


def neighbours(mask: Mask, splits: Iterable[tuple[int, int]] = ()) -> Iterator[Mask]:
    """Windows a little shorter, longer, earlier, later, split or joined."""
    parts, K = stretches(mask), len(mask)
    for i, (a, b) in enumerate(parts):
        before, after = parts[:i], parts[i + 1 :]
        for size in (4, 2, 1):
            for first, last in ((size, 0), (0, -size), (size, size), (-size, -size), (-size, 0), (0, size)):
                shifted = [(a + first, b + last)] if a + first < b + last else []
                yield in_windows(before + shifted + after, K)
        for left in (4, 2):
            if b - a > 2 * left:
                yield in_windows([*before, (a, a + left), (b - left, b), *after], K)
        for left, right in splits:
            if b - a > left + right + 2:
                yield in_windows([*before, (a, a + left), (b - right, b), *after], K)
        if b - a >= 4:
            middle = (a + b) // 2
            yield in_windows([*before, (a, middle), (middle + 1, b), *after], K)
    for i, ((a, _), (_, d)) in enumerate(pairwise(parts)):
        yield in_windows([*parts[:i], (a, d), *parts[i + 2 :]], K)


class ReferenceSearch:
    """Windows for S along the path of one law, and the least velocity change with each.

    `printed` is the printed algorithms' result; the reference follows the law's path outside the windows.
    It keeps S's tightening after any hand-over by U, whose tube is from the start; with errors and sets to
    stay inside it is renewed by each window. Without errors it keeps that from the start and, beyond
    it, U's own tube, which fades.
    """

    def __init__(self, printed: Schedule, law: AffineController, mode: int, objective: Objective) -> None:
        self.safety, self.law, self.mode, self.objective = printed.safety, law, mode, objective
        safety, problem = printed.safety, printed.safety.problem
        tracking, system, self.K, s = safety.tracking, problem.system, problem.K, safety.controller
        sets, tail = safety.clearance.unsafe, safety.reference.cells - problem.K
        self.renewed = not system.ideal and any(body.keep_in for body in sets)
        self.hand_overs = HandOvers(tracking, sets, problem.K)
        reached = reached_sets([law.with_reference(law.own, tracking)] * problem.K, safety.start, s)
        if self.renewed:
            settled = reached_sets([s] * min(SETTLED, problem.K), safety.start, s)[-1]
            reached += reached_sets([law.with_reference(law.own, tracking)] * problem.K, settled, s)
        self.tables, self.feedforward = self.hand_overs.tables(reached), self.hand_overs.feedforward(law.own)
        self.fades = system.ideal
        # Coasting after T that is proven safe along the printed reference shall stay so.
        task = plan_problem(problem, tracking, sets)
        if self.fades:
            both = zip(task.margins, self._fading(), strict=True)
            task = replace(task, margins=tuple(margin + tube for margin, tube in both))
        transition = law.powers[-1][: system.n, : system.n]
        self.followed = Followed.from_law(system, transition, law.own)
        self.closing = np.arange(self.K) >= self.K - (system.n // system.m + 1)
        self._ask(replace(task, objective="fuel", tail_cells=tail), problem.planner.deadline)
        self.limited = np.any(np.abs(law.own.nu[: self.K]) > self.task.u_limit, axis=1)
        z = (safety.plan.nu / system.u_max).ravel()
        self.planned = self.search.look(Candidate(z, 0.0, 0.0, 0.0))

    def _fading(self) -> list[Array]:
        """U's own tube from the start along the facets of every unsafe set, (K, F) each."""
        safety, law, system = self.safety, self.law, self.safety.tracking.system
        demand = np.abs(law.gain @ safety.tracking.error(safety.start).G).sum(axis=-1) / system.u_max
        feedback, delta = safety.tracking.feedback, safety.problem.delta
        tracker, q = Tracking(system, law.gain, feedback, delta, float(demand.max())), feedback.nodes_per_cell
        rows = (-body.rows(system) for body in safety.clearance.unsafe)
        return [error_tube(tracker, safety.start, each).over_cells(self.K, q) for each in rows]

    def _ask(self, task: PlanProblem, deadline: float) -> None:
        """Search paths of a planning problem from now on, until a deadline."""
        self.task, self.rows = task, PlanRows(task)
        self.lacking = [np.zeros((self.K, len(body.normals))) for body in task.unsafe]
        self.search = FollowingSearch(self.rows, deadline, self.followed)
        self.unit = float(self.rows.price.max())
        self.search.set_prices(0.0, 0.0, 0.0, SHORT * self.unit)
        self.candidates: dict[bytes, tuple[float, Candidate | None]] = {}

    def _priced(self, prices: Array, mask: Mask | None = None) -> None:
        """Price departures from U's path, and tighten for its hand-overs beside S's windows, if any."""
        self._book(np.zeros(self.K, dtype=bool) if mask is None else mask)
        limited = np.where(self.limited, np.minimum(prices, SOFT * self.unit), prices)
        self.search.set_prices_of_departure(np.where(self.closing, 0.0, limited))

    def _book(self, mask: Mask) -> None:
        """Tighten by S's errors, beyond its own tube, after hand-overs in all steps outside the windows."""
        row, cells = np.arange(self.K), np.minimum(np.arange(self.task.cells), self.K - 1)
        for end in np.flatnonzero(mask[:-1] & ~mask[1:]) + 1 if self.renewed else ():
            row[end:] = self.K + 1 + np.arange(self.K - end)
        for i, (table, scheduled) in enumerate(zip(self.tables, self.feedforward, strict=True)):
            tightening = np.zeros_like(scheduled)
            for k in () if self.fades else np.flatnonzero(~mask):
                for at in (k, k + 1):  # S may take over at either end of the step
                    tightening[at:] = np.maximum(tightening[at:], table[row[k] + at - k, : self.K - at])
            beyond = np.maximum(tightening + scheduled, self.lacking[i]) - self.task.margins[i]
            self.rows.booking[i][:] = np.maximum(beyond, 0.0)[cells]

    def path(self, mask: Mask) -> tuple[float, Candidate | None]:
        """Cost of the cheapest path found that departs from U's in these windows alone, and the path."""
        key = mask.tobytes()
        if key not in self.candidates and not self.objective.allows(mask):
            return np.inf, None
        if key not in self.candidates:
            self._priced(np.where(mask, 0.0, np.inf), mask)
            path, cost = self.search.best({}), np.inf
            if path is not None:
                switches, s = int(np.count_nonzero(np.diff(mask))), float(mask.mean())
                cost = -self.objective.value({0: s, self.mode: 1.0 - s}, path.fuel, switches)
            self.candidates[key] = cost, path
        return self.candidates[key]

    def starts(self) -> list[tuple[Mask, CheckedPath | None]]:
        """Return windows to begin with, of paths near U's own past every side of each obstacle."""
        self._priced(np.full(self.K, STICKING[0] * self.unit))
        base = self.search.solve({})
        if base is None:
            return []
        sides: list[tuple[dict[Key, int], CheckedPath | None]] = [({}, None), ({}, self.planned)]
        ways: list[tuple[float, int, dict[Key, int]]] = []
        for i, surplus in enumerate(self.search.look(base).surplus):
            cells = np.flatnonzero(surplus[: self.K].max(axis=1) < 0).tolist()
            for f in range(surplus.shape[1]) if cells and surplus.shape[1] > 1 else ():
                path = self.search.solve({(i, k): f for k in cells})
                cost = np.inf if path is None else self.search.value(path)
                ways.append((cost, len(ways), {(i, k): f for k in cells}))
        nearest = sorted(sorted(ways, key=lambda way: way[:2])[:SIDES], key=lambda way: way[1])
        sides += [(way, None) for _, _, way in nearest]
        candidates: list[tuple[float, int, Mask, CheckedPath]] = []
        for choice, guide in sides:
            self.search.guide = guide
            for price in STICKING:
                self._priced(np.full(self.K, price * self.unit))
                path = self.search.improved(self.search.best(choice))
                if path is None:
                    continue
                mask = (self.search.departures(path) > DEPARTS) & ~self.closing & ~self.limited
                self.search.guide = self.search.look(path)
                self.candidates = {}
                candidates.append((self.path(mask)[0], len(candidates), mask, self.search.guide))
                self.search.guide = guide
        candidates.sort(key=lambda item: item[:2])
        candidates.reverse()
        distinct = {(mask.tobytes(), round(cost, 9)): (mask, guide) for cost, _, mask, guide in candidates}
        ranked = sorted(distinct.items(), key=lambda item: (item[0][1], item[0][0]))
        return [start for (_, cost), start in ranked[:STARTS] if np.isfinite(cost)]

    def schedules(self, prove: Prove) -> Iterator[Schedule]:
        """Yield the schedule that is proven along the best path from every start.

        Where the flight turns out to need more, it is planned again with that much more; where S had to fly
        all the same, with those steps free to it.
        """
        tried, first = set(), self.task
        for mask, guide in self.starts():
            if not self.fades:  # the clearance that one start lacked serves the others
                self._ask(first, self.search.deadline)
            self.search.guide, self.candidates = guide, {}
            mask = self._descend(mask)
            if mask.tobytes() in tried:
                continue
            tried.add(mask.tobytes())
            for attempt in range(ATTEMPTS):
                if self.path(mask)[1] is None:  # with that clearance, other windows may do
                    mask = self._descend(mask)
                intended = tuple(np.where(mask, 0, self.mode).tolist())
                plan = self._certified(self.search.improved(self.path(mask)[1]))
                if plan is None:
                    break
                schedule = prove(plan, intended)
                if schedule is not None:
                    yield schedule
                if not self._lacks(plan, intended, schedule):
                    break
                self.candidates = {}
                if schedule is not None and attempt >= ATTEMPTS // 2:
                    mask = mask | (schedule.modes == 0)

    def _lacks(self, plan: Plan, intended: tuple[int, ...], schedule: Schedule | None) -> bool:
        """Add the clearance that the flight along a plan lacks if flown as intended; True if it lacks any."""
        short = schedule is not None and self._inset(schedule)
        if schedule is not None and tuple(schedule.modes.tolist()) == intended:
            return short
        if self.fades:
            return short or (schedule is not None and self._short(schedule, intended))
        tracking, safety = self.hand_overs.tracking, self.safety
        laws: tuple[Controller, ...]
        past_sets = list[Zonotope]()
        if schedule is None:
            start, problem = safety.problem.initial_set.c, safety.problem
            reference = Reference.propagate(problem.system, problem.delta, start, plan.nu)
            laws = (
                safety.controller.with_reference(reference, tracking),
                self.law.with_reference(reference, tracking),
            )
        else:
            reference = schedule.safety.reference
            laws = schedule.controllers[0], schedule.controllers[self.mode]
            as_meant = np.logical_and.accumulate(schedule.modes == intended)
            past_sets = [step.tube.end for step in schedule.steps[: int(as_meant.sum())]]
        sets = reached_sets([laws[mode > 0] for mode in intended], safety.start, safety.controller, past_sets)
        ends = {0}.union(*({k, k + 1} for k, mode in enumerate(intended) if mode)) - {self.K}
        parts = self.hand_overs.tighten(reference, {k: sets[k] for k in sorted(ends)})
        for i, (tightening, shortfall) in enumerate(parts):
            needed = np.where(shortfall > 0, tightening + (SPARE - 1) * shortfall, 0.0)
            self.lacking[i] = np.maximum(self.lacking[i], needed)
        return short or any(np.any(shortfall > 0) for _, shortfall in parts)

    def _short(self, schedule: Schedule, intended: tuple[int, ...]) -> bool:
        """Add the clearance that U lacked where meant to fly, near the limit; True if it lacked any."""
        safety, reached, names = schedule.safety, schedule.safety.start, [u.name for u in self.task.unsafe]
        lacking = np.zeros((len(names), self.K, 1))
        for k, step in enumerate(schedule.steps):
            if step.mode == 0 and intended[k]:
                tube = propagate_states(schedule.controllers[intended[k]], reached, k, safety.controller)
                margin = safety.recoverable.margin(k, tube.states, tube.intersample)
                if not margin.inside and margin.limit in names:
                    cell = min(int(margin.time / safety.problem.delta), self.K - 1)
                    more = lacking[names.index(margin.limit), max(cell - 1, 0) : cell + 2]
                    np.maximum(more, SPARE * (margin.tightening - margin.clearance), out=more)
            reached = step.tube.end
        for i, margins in enumerate(self.task.margins):
            more = np.where(lacking[i] > 0, margins + lacking[i], 0.0)
            self.lacking[i] = np.maximum(self.lacking[i], more)
        return bool(np.any(lacking > 0))

    def _inset(self, schedule: Schedule) -> bool:
        """Ask for an end so far inside the goal that flights meet it, unless they do or U flies too few."""
        approach, goal = schedule.approach, self.task.goal
        arrives = approach.reached is True
        if schedule.share() < self.objective.share or arrives or not goal.conditions.inequalities:
            return False
        guide, lacking = self.search.guide, self.lacking
        deeper = inset(self.safety.problem, goal, approach.distance)
        self._ask(replace(self.task, goal=deeper), self.search.deadline)
        self.search.guide, self.lacking = guide, lacking
        return True

    def _descend(self, mask: Mask) -> Mask:
        cost = self.path(mask)[0]
        improved = True
        while improved and len(self.candidates) < PROGRAMS:
            improved = False
            for other in neighbours(mask, APART if self.renewed else ()):
                other_cost = self.path(other)[0]
                if other_cost < cost - 1e-9:
                    cost, mask, improved = other_cost, other, True
                    break
                if len(self.candidates) >= PROGRAMS:
                    break
        return mask

    @property
    def cut_by_clock(self) -> bool:
        """Return True if the wall clock ended the search early: another machine may find another path."""
        return perf_counter() > self.search.deadline

    def _certified(self, path: Candidate | None) -> Plan | None:
        if path is None:
            return None
        nu = path.z.reshape(self.K, -1) * self.task.system.u_max
        targets = np.zeros((len(self.task.unsafe), self.K))
        try:
            return certified(self.task, nu, targets, path.fuel, -np.inf, REPLAN)
        except NotCertified:
            return None


def followable(printed: Schedule) -> Iterator[tuple[int, AffineController]]:
    """Modes and laws with a path of their own that a reference can follow; a network's is that of its slope.

    A plan with a stand-in is proven with the law itself, or flown by S.
    """
    for mode, controller in enumerate(printed.controllers[1:], start=1):
        law = controller.slope if isinstance(controller, NeuralController) else controller
        if isinstance(law, AffineController) and law.own is not printed.safety.reference:
            with suppress(PolarisError, ValueError, ArithmeticError):
                law.flow.lyapunov  # noqa: B018  a law that is not stable has no path of its own
                yield mode, law


def views(printed: Schedule, objective: Objective) -> list[ReferenceSearch]:
    """Return the searches for windows along the paths of all laws that a reference can follow."""
    searches = []
    for mode, law in followable(printed):
        with suppress(ScenarioError):  # of the loop of a law that S's steps are too long for
            searches.append(ReferenceSearch(printed, law, mode, objective))
    return searches
