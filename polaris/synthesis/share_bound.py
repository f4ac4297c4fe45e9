"""How much of the time any schedule could leave to U: what U's own path already forbids.

Without disturbance and from the middle of the initial set, a flight must keep clear of the unsafe sets at the
ends of all steps: where U flies it moves as U's law has it, where S flies by any thrust within the limits.
If that is impossible although S flies a set of steps, it is so with any part of them. So each set that is
proven impossible demands a step more, and an integer program tells how few steps meet every demand
(docs/theory.md, Proposition 20).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import Bounds, LinearConstraint, milp
from scipy.sparse import coo_array

from reach.numerics.errors import ReachError
from reach.sets.zonotope import Zonotope
from reach.tubes.flow import LinearFlow

from ..model.errors import NotCertified
from ..model.system import Array
from ..model.tolerances import ROUNDING
from ..planning.lp import GrowingLP
from .controllers import AffineController
from .planning_problem import perceive_unsafe
from .problem import Problem
from .saturation import clipped_map
from .schedule import Schedule
from .search import SwitchingRules
from .tracking import at_nodes

FREE = 0
"""A step in which any thrust within the limits is allowed, as under S."""
PARTS = 4
"""Held inputs in which the thrust of a free step is enclosed (Lemma 11 covers the rest)."""
EACH = 60
"""Most linear programs for one question; left open, it counts as possible."""
STRETCH = (8, 4, 2, 1)
"""Steps by which a window of an impossible flight is stretched, one after the other."""
NODES = 2000
"""Most nodes of an integer program; what it has proven until then is used."""
ROWS, STEPS = 20_000, 500
"""Most rows that state the dwell time, and most steps of a schedule, for which an integer program is made."""
OPEN = 1e-6
"""Share of the scene's size by which a path may miss a facet that its linear program does not state."""

Held = tuple[int, ...]
"""Mode whose law every step obeys, or `FREE`."""


@dataclass(frozen=True)
class ShareBound:
    """Proven bound on the share of the time under experimental controllers, over all schedules of a scene.

    Attributes
    ----------
    share : float
        No schedule that keeps clear of the unsafe sets as perceived has more, along whatever reference and
        with whatever safety controller, on the same steps and by the same dwell time and cap.
    programs : int
        Linear programs solved and flights looked at.
    demands : int
        Sets of steps that were proven too few.
    ended : {"reached", "effort_limit", "none"}
        Whether as many steps under S as the bound leaves could not be refuted, the effort ran out before, or
        nothing was there to bound.
    """

    share: float
    programs: int = 0
    demands: int = 0
    ended: str = "none"


class Flights:
    """Undisturbed flights from the middle of the initial set, and whether one keeps clear.

    Parameters
    ----------
    problem : Problem
    laws : sequence of AffineController
        Those of modes 1, 2, ...
    """

    def __init__(self, problem: Problem, laws: Sequence[AffineController]) -> None:
        system, K = problem.system, problem.K
        self.system, self.laws = system, laws
        flow = LinearFlow.continuous(system.A, system.D, 0.0, problem.delta / PARTS)
        push = flow.input_zonotope(system.B, np.diag(system.u_max), np.abs(system.B) @ system.u_max).G
        moved = [np.linalg.matrix_power(flow.phi, j) for j in range(PARTS + 1)]
        self.moved, self.push = moved[PARTS], np.hstack([part @ push for part in moved[:PARTS]])
        sets = perceive_unsafe(problem, K)
        self.normals = [unsafe.normals for unsafe in sets]
        ends = [unsafe.offsets[np.minimum(np.arange(K), unsafe.cells - 1)] for unsafe in sets]
        # The set of both cells that meet at a node: less than either.
        self.offsets = [np.minimum(b[:, 1], np.vstack([b[1:, 0], b[-1:, 1]])) for b in ends]
        start = np.asarray(problem.initial_set.c)
        self._first = start, np.zeros((system.n, 0)), np.abs(start)
        self._held: Held = ()
        self._found: list[tuple[Array, Array, Array]] = []
        self.programs = 0

    def fly(self, held: Held) -> tuple[Array, Array, Array]:
        """States at the ends of the first steps: centres (k, n), generators (k, n, N), sizes met on the way."""
        same = 0
        while same < min(len(held), len(self._held)) and held[same] == self._held[same]:
            same += 1
        found = self._found[:same]
        c, G, size = found[-1] if found else self._first
        for k in range(same, len(held)):
            if held[k] == FREE:
                c, G = self.moved @ c, np.hstack([self.moved @ G, self.push])
            else:
                law = self.laws[held[k] - 1]
                own = law.own.chi[k : k + 2]
                c, G = self._under(law, k, Zonotope(c - own[0], G))
                c, size = c + own[1], np.maximum(size, np.abs(own).max(axis=0))
            size = np.maximum(size, np.abs(c) + np.abs(G).sum(axis=1))
            found.append((c, G, size))
        self._held, self._found = held, found
        whole = np.zeros((len(held), self.system.n, G.shape[1]))
        for k, (_, part, _) in enumerate(found):
            whole[k, :, : part.shape[1]] = part
        return np.array([c for c, _, _ in found]), whole, np.array([size for *_, size in found])

    def _under(self, law: AffineController, k: int, d: Zonotope) -> tuple[Array, Array]:
        """Deviation from the law's own reference after step k: as the law moves it, or clipped."""
        mu, q, flow = law.own.nu[k], law.feedback.nodes_per_cell, law.flow
        nodes = law.powers @ d
        image = law.gain @ (nodes[:-1] if law.feedback.sampled else nodes)
        command = np.abs(mu - image.c) + image.half_widths
        if not law.feedback.sampled:
            command = command + at_nodes(flow.bow(nodes[:-1])) @ np.abs(law.gain).T
        if np.all(command * (1 + ROUNDING) <= self.system.u_max):
            return nodes.c[-1], nodes.G[-1]
        for _ in range(q):
            phi, known, push, _ = clipped_map(law, d, mu)
            d = Zonotope(phi @ d.c + known, np.hstack([phi @ d.G, push.G]))
        return d.c, d.G

    def impossible(self, held: Held) -> bool:
        """Whether it is proven that no flight keeps clear, as far as the steps are given."""
        self.programs += 1
        try:
            flown = self.fly(held)
            if not all(np.all(np.isfinite(part)) for part in flown):
                return False
            asked = _Clear(self, *flown)
            found = asked.impossible()
        except (NotCertified, ReachError):  # no answer, or numbers beyond floating point
            return False
        self.programs += asked.programs
        return found

    def widened(self, held: Held) -> Held:
        """An impossible flight, cut off as early and with as long windows of free steps as it stays so."""
        short, long = 0, len(held)
        while long - short > 1:
            middle = (short + long) // 2
            if self.impossible(held[:middle]):
                long = middle
            else:
                short = middle
        held = held[:long]
        free = np.flatnonzero(np.array(held) == FREE).tolist()
        for edge, way in [(k, way) for k in free for way in (1, -1) if k + way not in free]:
            for size in STRETCH:
                a, b = max(min(edge, edge + way * size), 0), max(edge, edge + way * size) + 1
                longer = (*held[:a], *(FREE,) * (b - a), *held[b:])[: len(held)]
                if longer != held and self.impossible(longer):
                    held, edge = longer, edge + way * size
        return held


class _Clear:
    """The facets beyond which one flight can be, as rows ``a g >= need`` over the shares g of its generators."""

    def __init__(self, flights: Flights, c: Array, G: Array, size: Array) -> None:
        position = flights.system.position
        centre, spread, reach = c @ position.T, position @ G, size @ np.abs(position).T
        self.unit, self.programs, self.never = float(reach.max()), 0, False
        self.ways: list[tuple[Array, Array]] = []
        only = [(np.zeros((0, G.shape[2])), np.zeros(0))]
        for normals, offsets in zip(flights.normals, flights.offsets, strict=True):
            a, b = np.einsum("fd,kdg->kfg", normals, spread), offsets[: len(c)]
            need, most = b - centre @ normals.T, np.abs(a).sum(axis=2)
            need = need - ROUNDING * (reach @ np.abs(normals).T + np.abs(b) + most)
            can, open_ = most >= need, np.all(-most < need, axis=1)
            self.never |= bool(np.any(~np.any(can, axis=1)))
            one = open_ & (np.sum(can, axis=1) == 1)
            only.append((a[one][can[one]] / self.unit, need[one][can[one]] / self.unit))
            for k in np.flatnonzero(open_ & (np.sum(can, axis=1) > 1)):
                self.ways.append((a[k, can[k]] / self.unit, need[k, can[k]] / self.unit))
        self.only = tuple(np.concatenate(parts) for parts in zip(*only, strict=True))
        ones = np.ones(2 * G.shape[2])
        self.lp = GrowingLP(ones, 0 * ones, ones)

    def impossible(self) -> bool:
        """Whether some node is inside a set whatever is flown, or every choice of facets is refuted."""
        return self.never or bool(self.ways or len(self.only[1])) and self._refuted()

    def _state(self, a: Array, need: Array) -> None:
        self.lp.add(np.hstack([a, -a]), need, np.inf)

    def _refuted(self) -> bool:
        """Whether no path keeps the facets stated, those without alternative, and one of every other node's."""
        if self.programs == EACH:
            return False
        self.programs += 1
        answer = self.lp.solve(np.inf)
        if answer is None:
            return self._certain()
        g, known = np.subtract(*np.split(answer[1], 2)), self.lp.rows
        a, need = self.only
        short = need - a @ g > OPEN
        if np.any(short):
            self._state(a[short], need[short])
            return self._back(self._refuted(), known)
        lack = [float(np.min(need - a @ g)) for a, need in self.ways]
        if max(lack, default=0.0) <= OPEN:
            return False
        a, need = self.ways[int(np.argmax(lack))]
        for f in np.argsort(need - a @ g):
            self._state(a[f : f + 1], need[f : f + 1])
            if not self._back(self._refuted(), known):
                return False
        return True

    def _back(self, found: bool, rows: int) -> bool:
        self.lp.take_back(rows)
        return found

    def _certain(self) -> bool:
        """Whether a sum of rows, each weighed by what the solver answers, asks for more than there is."""
        ray, rows, need = self.lp.ray(), *self.lp.stated()
        for weights in (np.maximum(ray, 0.0), np.maximum(-ray, 0.0)):
            most = np.abs(weights @ rows)[: rows.shape[1] // 2].sum()
            if weights @ need - most > ROUNDING * (weights @ (np.abs(need) + np.abs(rows).sum(axis=1))):
                return True
        return False


class Master:
    """The integer program: fewest steps under S by the rules of the schedule and the demands made so far.

    Its variables are whether a mode flies a step, and whether one is switched to; see `demand`.
    """

    def __init__(self, K: int, modes: int, rules: SwitchingRules) -> None:
        self.K, self.modes = K, modes
        self.size = K * modes + K
        self.rows: list[tuple[dict[int, float], float]] = []
        for k in range(K):
            one = dict.fromkeys(range(k * modes, (k + 1) * modes), 1.0)
            self.rows += [(one, 1.0), (dict.fromkeys(one, -1.0), -1.0)]
        dwell, cap = rules.min_dwell, rules.max_switches
        dwell = dwell if K * modes * dwell <= ROWS else 1
        for k in range(1, K):
            for mode in range(modes):
                here, before = self._at(k, mode), self._at(k - 1, mode)
                self.rows.append(({K * modes + k: 1.0, here: -1.0, before: 1.0}, 0.0))
                for later in range(k + 1, min(k + dwell, K)):
                    self.rows.append(({self._at(later, mode): 1.0, here: -1.0, before: 1.0}, 0.0))
        if cap is not None:  # the return to S from a last step under U is held back
            switched = dict.fromkeys(range(K * modes, K * modes + K), -1.0)
            self.rows.append((switched | {self._at(K - 1, FREE): 1.0}, 1.0 - cap))

    def _at(self, k: int, mode: int) -> int:
        return k * self.modes + mode

    def demand(self, held: Held) -> None:
        """At least one of the steps held is flown otherwise."""
        at = [self._at(k, mode) for k, mode in enumerate(held) if mode != FREE]
        self.rows.append((dict.fromkeys(at, -1.0), 1.0 - len(at)))

    def solve(self) -> tuple[int, Held | None]:
        """Proven number of steps under S, K + 1 if there is no schedule; and modes with as few, if found."""
        entries = [(i, at, value) for i, (row, _) in enumerate(self.rows) for at, value in row.items()]
        i, at, value = (np.array(part) for part in zip(*entries, strict=True))
        A = coo_array((value, (i, at)), shape=(len(self.rows), self.size)).tocsr()
        cost, whole = np.zeros(self.size), np.ones(self.size)
        cost[FREE : self.K * self.modes : self.modes] = 1.0
        whole[self.K * self.modes :] = 0.0
        answer = milp(
            cost,
            integrality=whole,
            bounds=Bounds(0.0, 1.0),
            constraints=LinearConstraint(A, [least for _, least in self.rows]),
            options={"node_limit": NODES},
        )
        if answer.status == 2:
            return self.K + 1, None
        least = answer.mip_dual_bound
        fewest = 0 if least is None or not np.isfinite(least) else int(np.ceil(least - 1e-4))
        if answer.x is None:
            return max(fewest, 0), None
        flown = answer.x[: self.K * self.modes].reshape(self.K, self.modes)
        return max(fewest, 0), tuple(int(mode) for mode in flown.argmax(axis=1))


def share_bound(schedule: Schedule, rules: SwitchingRules, limit: int) -> ShareBound:
    """Bound the share of the time under experimental controllers, with at most about `limit` programs."""
    safety = schedule.safety
    problem, laws = safety.problem, schedule.controllers[1:]
    own = [law for law in laws if isinstance(law, AffineController) and law.own is not law.reference]
    if limit == 0 or len(own) < len(laws) or safety.guarantee != "proved" or problem.K > STEPS:
        return ShareBound(1.0)
    flights, master = Flights(problem, own), Master(problem.K, len(laws) + 1, rules)
    demands, least, ended = 0, 0, "effort_limit"
    while flights.programs < limit:
        fewest, held = master.solve()
        least = max(least, fewest)
        if held is None:
            break
        if not flights.impossible(held):
            ended = "reached"
            break
        master.demand(flights.widened(held))
        demands += 1
    return ShareBound(1.0 - min(least, problem.K) / problem.K, flights.programs, demands, ended)
