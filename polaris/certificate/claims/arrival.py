"""Claims of the goal and of the velocity change, derived again from the sets of the argument."""

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from flint import arb, arb_mat

from ..files.document import Document
from ..kernel.balls import (
    above,
    column,
    diagonal,
    largest,
    magnitude,
    matrix,
    maxima,
    plain,
    require,
    smallest,
    sums,
)
from ..kernel.verdict import Rejected, Undecided
from ..kernel.zonotopes import Merging
from ..model.craft.tightening import Tightening
from .continuation import Continuation, HandOver
from .flights import ControllerModel, FlownStep, enclose_step
from .goal_rows import WeightedRows
from .recovery import CLAIM_SLACK
from .spending import spent

SHARE, SOON = 0.05, 0.25
"""Share of the goal's size that counts as reached; of the horizon, in which a velocity is a length."""
HELD = 2
"""Largest tolerance, as a multiple of what S needs for ever, where the scenario gives none."""
SAME = 1e-9  # relative difference by which numbers that two programs derive alike may differ: rounding
MOST = 300  # nodes at which a distance is looked for that is claimed of none in particular


@dataclass(frozen=True, eq=False)
class Arrival:
    """S along the tail.

    `starts` are sets that each hold all errors, at the last hand-over to S and at T; `cost` bounds the
    velocity change until T [m/s].
    """

    flight: Continuation
    starts: tuple[HandOver, ...]
    cost: arb
    controller: ControllerModel | None = None  # S, where it is flown on
    merging: Merging | None = None  # of the sets that it flies
    before: Sequence[FlownStep] = ()  # steps until T
    _steps: list[FlownStep] = field(default_factory=list, repr=False)
    _until: dict[int, arb] = field(default_factory=dict, repr=False)
    _by_spell: list[arb] = field(default_factory=lambda: [arb(0)], repr=False)
    _summed: list[arb] = field(default_factory=lambda: [arb(0)], repr=False)

    @cached_property
    def document(self) -> Document:
        """Return the certificate, with the path for its reference."""
        return self.flight.document

    def check(self, claim: dict[str, Any], spec: dict[str, Any]) -> str:
        """Refuse a claim that does not hold; return the confirmed facts.

        Distance, drift and velocity change are those of one node of the tail: the one that is named, if the
        goal is claimed to be reached, else any.
        """
        reached, by = claim["reached"] is True, claim["by_s"]
        if reached == (by is None):
            raise Rejected("goal", "by_s must be given exactly where the goal is claimed to be reached")
        rows = WeightedRows.from_goal(spec, self.velocity_time, self.document)
        tightenings = Tightening(self.flight.tracker.craft, self.flight.tracker.settling, rows.rows)
        self.tolerated(claim["tolerance_m"], spec, rows.scale, self.holding(tightenings))
        seconds = claim["velocity_time_s"]
        if (seconds is None) != (rows.seconds is None):
            raise Rejected("goal", "velocity_time_s belongs to goals with velocity conditions")
        if rows.seconds is not None:
            slack = rows.seconds * SAME - abs(rows.seconds - seconds)
            reason = f"velocities count as the length of {plain(rows.seconds)} s, not {seconds} s"
            require("goal", slack, reason)
        nodes = [self.node_at(by)] if by is not None else self._likely(rows, tightenings, claim)
        refusals: list[Rejected | Undecided] = []
        for node in nodes:
            try:
                distance = self.distance(rows, tightenings, node)
                self.require_bound("distance from the goal", claim["distance_m"], distance)
                if reached:
                    margin = claim["tolerance_m"] - largest((distance, arb(claim["distance_m"])))
                    require("goal", margin, f"{plain(distance)} m off, more than is tolerated")
                self._drift(claim["drift_m_per_orbit"], node)
                delta_v = self.delta_v_until(node) if reached else self.cost + self.correcting(node)
                self.require_bound("velocity change", claim["delta_v_max_m_s"], delta_v)
            except (Rejected, Undecided) as error:
                refusals.append(error)
            else:
                outcome = f"reached by {by:.6g} s" if reached else "not claimed to be reached"
                return f"{outcome}, within {claim['distance_m']:.4g} m"
        raise refusals[0]

    def keeps(self, claim: dict[str, Any], budget: float) -> str:
        """Refuse a schedule that may spend more than the scenario allows; return the confirmed facts."""
        if claim["reached"] is True:
            delta_v, event = self.delta_v_until(self.node_at(claim["by_s"])), "the goal"
        else:
            delta_v, event = self.cost, "T: the goal is not claimed to be reached"
        text = f"{plain(delta_v)} m/s until {event}; the scenario allows {budget:g} m/s"
        require("schedule", budget - delta_v, text)
        return f"at most {text}"

    @property
    def velocity_time(self) -> arb:
        """Time in which a velocity is a length [s]."""
        return arb(SOON) * self.document.steps * self.document.delta

    def holding(self, tightenings: Tightening) -> arb:
        """Return S's tightening along rows for ever, without the jump into the tail, with a fault if any."""
        offsets = (magnitude(tightenings.rows) * column(self.document.at_nodes)).entries()
        tightening = sums(tightenings.settled_tightening, offsets, *tightenings.fault[-1:])
        return largest(
            sums(tightening, self.flight.from_thrust(tightenings, self._first + self._last))
            if self.flight.scheduled
            else tightening
        )

    def tolerated(self, tolerance: float, spec: dict[str, Any], scale: float, settled: arb) -> None:
        """Refuse a tolerance of more than the scenario gives; or more than its default may be."""
        limit = spec.get("tolerance_m")
        allowed = largest((arb(SHARE) * scale * (1 + SAME), settled * HELD)) if limit is None else arb(limit)
        require("goal", allowed - tolerance, "the tolerance is more than the scenario's")

    def node_at(self, by: float) -> int:
        """Return the node of the tail at an instant [s]."""
        doc = self.document
        T = doc.steps * doc.delta
        if T * (1 - 1e-9) <= by <= doc.cells * doc.delta * (1 + 1e-9):
            node = min(max(round((by - T) / doc.delta * doc.q), 0), self._last)
            if abs((doc.steps + arb(node) / doc.q) * doc.delta - by) <= 1e-9 * by:
                return node
        raise Rejected("goal", f"by_s = {by:.6g} s is no node of the tail")

    @property
    def _first(self) -> int:
        """Return the node at T."""
        return self.document.steps * self.document.q

    @property
    def _last(self) -> int:
        """Return the last node of the tail."""
        return (self.document.cells - self.document.steps) * self.document.q

    def _likely(self, rows: WeightedRows, tightenings: Tightening, claim: dict[str, Any]) -> list[int]:
        """Nodes until which flights may spend as much as is claimed, those nearest to the goal first."""
        limit, horizon = arb(claim["delta_v_max_m_s"]) * (1 + CLAIM_SLACK), 1
        while horizon < self._last and not self.cost + self.correcting(horizon) > limit:
            horizon *= 2
        nodes = range(min(horizon, self._last) + 1)
        count = bisect_right(nodes, limit, key=lambda node: self.cost + self.correcting(node))

        def near(node: int) -> float:
            tightening = self.flight.tightening(tightenings, self.starts, self._first + node)
            return float(rows.distance(sums(rows.over(self.state(node)), tightening)).mid())

        return sorted(nodes[: max(count, 1)], key=near)[:MOST]

    def require_bound(self, quantity: str, claimed: float, derived: arb) -> None:
        """Refuse a stated bound below the derived one by more than figures are exact to."""
        slack = arb(claimed) * (1 + CLAIM_SLACK) - derived
        require("goal", slack, f"{quantity}: {claimed:.6g} claimed, {plain(derived)} derived")

    def fly_tail(self, nodes: int) -> list[FlownStep]:
        """S from T on, for at least so many periods."""
        doc = self.document
        jump = diagonal(self.flight.jump.entries())
        reached = self.starts[-1].errors.plus(self.flight.tracker.craft.lifted(jump))
        assert self.controller is not None and self.merging is not None
        while len(self._steps) * doc.q < nodes:
            k, start = doc.steps + len(self._steps), self._steps[-1].end if self._steps else reached
            self._steps.append(enclose_step(self.controller, start, k, self.flight.path, None, self.merging))
        return self._steps

    def error_bounds(self, tightenings: Tightening, node: int) -> list[arb]:
        """Bound errors along rows at a node after T."""
        bounds = self.flight.tightening(tightenings, self.starts, self._first + node)
        if self.controller is None or not self.document.feedback_bound or node == self._last:
            return bounds
        pairs = zip(bounds, self._set_bounds(tightenings.rows, node), strict=True)
        return [smallest(pair) for pair in pairs]

    def _set_bounds(self, rows: arb_mat, node: int) -> list[arb]:
        """Bound errors along rows at a node after T by the sets that S flies then."""
        cell, place = divmod(node, self.document.q)
        step = self.fly_tail(node + 1)[cell]
        z = step.nodes[place - 1] if place else step.start
        whole = self.flight.tracker.craft.pad(rows)
        return sums(z.support(whole), (magnitude(rows) * column(self.document.at_nodes)).entries())

    def state(self, node: int) -> arb_mat:
        """State of the reference at a node of the tail."""
        cell, place = divmod(node, self.document.q)
        arcs, at = self.flight.path.arcs, self.document.steps + cell
        return arcs[at].nodes[place] if at < len(arcs) else arcs[-1].nodes[-1]

    def distance(self, rows: WeightedRows, tightenings: Tightening, node: int) -> arb:
        """Return the largest distance of a flight from the goal at a node."""
        return rows.distance(sums(rows.over(self.state(node)), self.error_bounds(tightenings, node)))

    def _drift(self, claimed: float | None, node: int) -> None:
        if claimed is None:
            return
        if self.document.system_kind != "clohessy_wiltshire":
            raise Rejected("goal", "a drift per orbit needs Hill's frame")
        rows = self._drifting.rows
        bound = largest(sums((rows * self.state(node)).entries(), self.error_bounds(self._drifting, node)))
        self.require_bound("drift per orbit", claimed, 6 * arb.pi() * bound)

    @cached_property
    def _drifting(self) -> Tightening:
        row = [arb(2), *[arb(0)] * 3, 1 / arb(self.document.mean_motion or 0.0), arb(0)]
        tracker = self.flight.tracker
        return Tightening(tracker.craft, tracker.settling, above(matrix([row]), -matrix([row])))

    def correcting(self, nodes: int) -> arb:
        """Bound on S's velocity change over periods after T, each for itself [m/s]."""
        for node in range(len(self._summed) - 1, nodes):
            impulse = self.flight.spending(self._commands, self.starts, self._first + node)
            self._summed.append(self._summed[-1] + impulse)
        steps = self.fly_tail(nodes)
        for node in range(len(self._by_spell) - 1, nodes):
            step, place = divmod(node, self.document.q)
            self._by_spell.append(self._by_spell[-1] + steps[step].spells[place].impulse)
        return smallest([self._summed[nodes], self._by_spell[nodes]]) / self.document.mass

    def delta_v_until(self, node: int) -> arb:
        """Bound on the velocity change until a node after T [m/s]."""
        if node not in self._until:
            steps, jump = (
                [*self.before, *self.fly_tail(node)],
                self.flight.tracker.craft.lifted(self.flight.jump),
            )
            arguments = self._first + node, self.document.weights, (self.document.steps, jump)
            summed = self.cost + self.correcting(node)
            combined = spent(steps, *arguments) / self.document.mass if self.document.weights else summed
            self._until[node] = smallest([summed, combined])
        return self._until[node]

    def max_commands(self, node: int) -> list[arb]:
        """Bound S's commands in the period after a node [N]."""
        return self.flight.commanded(self._commands, self.starts, self._first + node)

    def tops_before(self, node: int) -> list[arb]:
        """Bound S's commands from a node long after T on, and those before that errors remember [N]."""
        craft = self.flight.tracker.craft
        if not craft.lag < node:
            return craft.plant.u_max
        last = max(node, self.flight.tracker.settling.periods + 1)
        tops = maxima(*map(self.max_commands, range(node - craft.lag - 1, last + 1)))
        return [smallest(pair) for pair in zip(tops, craft.plant.u_max, strict=True)]

    def states(self, tightenings: Tightening, node: int) -> list[arb]:
        """Bounds along rows of the loop state at a node long after T, from boxes of states handed to S."""
        return self.flight.tightening(
            tightenings, self.boxes, self._first + node, around=True
        )  # not displaced

    @cached_property
    def boxes(self) -> tuple[HandOver, ...]:
        """Boxes of states handed to S, at the last hand-over and at T."""
        return tuple(HandOver.within(each.errors.size(), each.first, each.last) for each in self.starts)

    @cached_property
    def _commands(self) -> Tightening:
        return Tightening(
            self.flight.tracker.craft, self.flight.tracker.settling, self.flight.tracker.commands
        )
