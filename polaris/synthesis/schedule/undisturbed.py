"""Feasibility test for undisturbed flights: U's law in some steps and any thrust in others.

The flight is a zonotope whose generators are shared by all instants: the thrust of free steps in parts and
the difference of a clipped command from its band. Where every choice of facets is refuted, no flight keeps
clear (docs/theory.md, Proposition 13).
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from reach.numerics.errors import ReachError
from reach.sets.zonotope import Zonotope
from reach.tubes.flow import LinearFlow

from ...model.errors import NotCertified
from ...model.system import Array
from ...model.tolerances import REFERENCE, ROUNDING
from ...planning.lp import GrowingLP
from ..controllers.controllers import AffineController
from ..safety.get_safety import Safety
from ..tracker.affine_law import clipped_map

FREE = 0  # a step in which any thrust within the limits is allowed, as under S
PARTS = 4  # held inputs in which the thrust of a free step is enclosed (Proposition 9 (c) covers the rest)
EACH = 60  # most linear programs for one question; left open, it counts as possible
OPEN = 1e-6  # share of the scene's size by which a path may miss a facet that its program does not state
STRETCH = (8, 4, 2, 1)  # steps by which a window of an impossible flight is stretched, one after the other
Held = tuple[int, ...]  # mode whose law every step obeys, or `FREE`


class UndisturbedFlights:
    """Undisturbed flights from the middle of the initial set, and whether one keeps clear.

    Parameters
    ----------
    safety : Safety
        Its problem, and the unsafe sets as its proof has them: over fewer steps others may be perceived.
    laws : sequence of AffineController
        Those of modes 1, 2, ...
    """

    def __init__(self, safety: Safety, laws: Sequence[AffineController]) -> None:
        problem, sets = safety.problem, safety.clearance.unsafe
        system, K = problem.system, problem.K
        ideal = system.as_ideal()
        tracking = replace(safety.tracking, system=ideal)
        self.system, self.laws = (
            system,
            [replace(law, system=ideal, tracking=tracking, _levels={}) for law in laws],
        )
        flow = LinearFlow.continuous(system.A, system.D, 0.0, problem.delta / PARTS)
        push = flow.input_zonotope(system.B, np.diag(system.u_max), np.abs(system.B) @ system.u_max).G
        powers = [np.linalg.matrix_power(flow.phi, j) for j in range(PARTS + 1)]
        self.phi, self.push = powers[PARTS], np.hstack([part @ push for part in powers[:PARTS]])
        self.rows = [unsafe.rows(system) for unsafe in sets]
        ends = [unsafe.offsets[:K] for unsafe in sets]
        # The set of both cells that meet at a node: less than either.
        self.offsets = [np.minimum(b[:, 1], np.vstack([b[1:, 0], b[-1:, 1]])) for b in ends]
        start = np.asarray(problem.initial_set.c)
        self._first = start, np.zeros((system.n, 0)), np.abs(start), np.zeros(system.n)
        self._modes: Held = ()
        self._states: list[tuple[Array, Array, Array, Array]] = []
        self.programs = 0

    def propagate(self, modes: Held) -> tuple[Array, Array, Array]:
        """States at the ends of some steps: centres (k, n), generators (k, n, N), sizes met on the way.

        Only as many as round-off is covered by `ROUNDING` of the sizes: an unstable law makes it grow.
        """
        same = 0
        while same < min(len(modes), len(self._modes)) and modes[same] == self._modes[same]:
            same += 1
        states = self._states[:same]
        c, G, size, error = states[-1] if states else self._first
        for k in range(same, len(modes)):
            if modes[k] == FREE:
                c, G, growth = self.phi @ c, np.hstack([self.phi @ G, self.push]), np.abs(self.phi)
            else:
                law = self.laws[modes[k] - 1]
                xi_U = law.own.chi[k : k + 2]
                c, G, growth = self._under(law, k, Zonotope(c - xi_U[0], G), ROUNDING * size)
                c, size = c + xi_U[1], np.maximum(size, np.abs(xi_U).max(axis=0))
            size = np.maximum(size, np.abs(c) + np.abs(G).sum(axis=1))
            error = growth @ error + REFERENCE * size
            states.append((c, G, size, error))
        self._modes, self._states = modes, states
        generators = np.zeros((len(modes), self.system.n, G.shape[1]))
        for k, (_, part, *_) in enumerate(states):
            generators[k, :, : part.shape[1]] = part
        centres, sizes, errors = (np.array([state[i] for state in states]) for i in (0, 2, 3))
        inexact = np.any(~(errors <= ROUNDING * sizes), axis=1)
        count = int(np.argmax(inexact)) if np.any(inexact) else len(modes)
        return centres[:count], generators[:count], sizes[:count]

    def _under(self, law: AffineController, k: int, d: Zonotope, error: Array) -> tuple[Array, Array, Array]:
        """Deviation from the law's own reference after step k, and how errors grow in it.

        `error`, shape (n,), bounds the round-off in d.
        """
        mu, q = law.own.nu[k], law.feedback.nodes_per_cell
        nodes = law.powers @ d
        image = law.gain @ nodes[:-1]
        command = np.abs(mu - image.c) + image.half_widths
        if np.all(command * (1 + ROUNDING) + np.abs(law.gain) @ error <= self.system.u_max):
            return nodes.c[-1], nodes.G[-1], np.abs(law.powers[-1])
        growth = np.eye(self.system.n)
        for _ in range(q):
            phi, constant, push, _ = clipped_map(law, Zonotope(d.c, np.hstack([d.G, np.diag(error)])), mu)
            d, growth = Zonotope(phi @ d.c + constant, np.hstack([phi @ d.G, push])), phi @ growth
        return d.c, d.G, np.abs(growth)

    def impossible(self, modes: Held) -> bool:
        """Return True if it is proven that no flight keeps clear, as far as the steps are given."""
        self.programs += 1
        try:
            flight = self.propagate(modes)
            if not all(part.size and np.all(np.isfinite(part)) for part in (flight[0], flight[2])):
                return False
            query = _Clear(self, *flight)
            refuted = query.impossible()
        except (NotCertified, ReachError):  # no answer, or numbers beyond floating point
            return False
        self.programs += query.programs
        return refuted

    def widened(self, modes: Held) -> Held:
        """Return an impossible flight cut off as early, and with as long free windows, as it stays so."""
        short, long = 0, len(modes)
        while long - short > 1:
            middle = (short + long) // 2
            if self.impossible(modes[:middle]):
                long = middle
            else:
                short = middle
        modes = modes[:long]
        free = np.flatnonzero(np.array(modes) == FREE).tolist()
        for edge, sign in [(k, sign) for k in free for sign in (1, -1) if k + sign not in free]:
            for size in STRETCH:
                a, b = max(min(edge, edge + sign * size), 0), max(edge, edge + sign * size) + 1
                longer = (*modes[:a], *(FREE,) * (b - a), *modes[b:])[: len(modes)]
                if longer != modes and self.impossible(longer):
                    modes, edge = longer, edge + sign * size
        return modes


class _Clear:
    """The facets beyond which a flight can be: rows ``a g >= need`` over the shares g of its generators."""

    def __init__(self, flights: UndisturbedFlights, c: Array, G: Array, size: Array) -> None:
        reach = size @ np.abs(flights.system.position).T
        self.unit, self.programs, self.never = float(reach.max()), 0, False
        self.ways: list[tuple[Array, Array]] = []
        forced = [(np.zeros((0, G.shape[2])), np.zeros(0))]
        for rows, offsets in zip(flights.rows, flights.offsets, strict=True):
            a, b = np.einsum("fd,kdg->kfg", rows, G), offsets[: len(c)]
            tightening, largest = b - c @ rows.T, np.abs(a).sum(axis=2)
            tightening = tightening - ROUNDING * (size @ np.abs(rows).T + np.abs(b) + largest)
            possible, open_ = largest >= tightening, np.all(-largest < tightening, axis=1)
            self.never |= bool(np.any(~np.any(possible, axis=1)))
            one = open_ & (np.sum(possible, axis=1) == 1)
            forced.append((a[one][possible[one]] / self.unit, tightening[one][possible[one]] / self.unit))
            for k in np.flatnonzero(open_ & (np.sum(possible, axis=1) > 1)):
                self.ways.append((a[k, possible[k]] / self.unit, tightening[k, possible[k]] / self.unit))
        self.only = tuple(np.concatenate(parts) for parts in zip(*forced, strict=True))
        ones = np.ones(2 * G.shape[2])
        self.lp = GrowingLP(ones, 0 * ones, ones)

    def impossible(self) -> bool:
        """Return True if a node is inside a set in every flight, or all choices of facets are refuted."""
        return self.never or bool(self.ways or len(self.only[1])) and self._refuted()

    def _state(self, a: Array, tightening: Array) -> None:
        self.lp.add(np.hstack([a, -a]), tightening, np.inf)

    def _refuted(self) -> bool:
        """Return True if no path keeps the facets stated, and one of every other node's."""
        if self.programs == EACH:
            return False
        self.programs += 1
        answer = self.lp.solve(np.inf)
        if answer is None:
            return self._certain()
        g, count = np.subtract(*np.split(answer[1], 2)), self.lp.rows
        a, tightening = self.only
        short = tightening - a @ g > OPEN
        if np.any(short):
            self._state(a[short], tightening[short])
            return self._back(self._refuted(), count)
        shortfalls = [float(np.min(tightening - a @ g)) for a, tightening in self.ways]
        if max(shortfalls, default=0.0) <= OPEN:
            return False
        a, tightening = self.ways[int(np.argmax(shortfalls))]
        for f in np.argsort(tightening - a @ g):
            self._state(a[f : f + 1], tightening[f : f + 1])
            if not self._back(self._refuted(), count):
                return False
        return True

    def _back(self, refuted: bool, rows: int) -> bool:
        self.lp.take_back(rows)
        return refuted

    def _certain(self) -> bool:
        """Return True if a sum of rows, weighed by the solver's answer, asks for more than there is."""
        ray, rows, tightening = self.lp.ray(), *self.lp.constraints()
        for weights in (np.maximum(ray, 0.0), np.maximum(-ray, 0.0)):
            available = np.abs(weights @ rows)[: rows.shape[1] // 2].sum()
            if weights @ tightening - available > ROUNDING * (
                weights @ (np.abs(tightening) + np.abs(rows).sum(axis=1))
            ):
                return True
        return False
