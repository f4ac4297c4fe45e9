"""The joint of two legs: at the nodes of GO every state under S is in the next leg's start set."""

from dataclasses import dataclass
from functools import cached_property

from flint import arb, arb_mat

from ..kernel.balls import above, absolute, column, exponential, identity, largest, magnitude, require, sums
from ..kernel.verdict import Rejected
from ..model.craft.tightening import Tightening
from .arrival import Arrival

Windows = list[list[int]]


@dataclass(frozen=True)
class Joint:
    """Claim of a joint; nodes count from the end of the leg's horizon."""

    center: list[float]  # of the next leg's start set
    half_widths: list[float]
    go: list[float]  # half-widths of the box in which estimates give GO
    first: Windows  # nodes of the tail, from the first of a pair to the last
    later: Windows  # phases of a turn, in periods, at which nodes of all later turns may lie
    assured: bool  # every estimate is in the GO box at these nodes


@dataclass(frozen=True, eq=False)
class _Check:
    arrival: Arrival
    joint: Joint

    @property
    def last(self) -> int:
        """Return the last node of the tail."""
        doc = self.arrival.document
        return (doc.cells - doc.steps) * doc.q

    @cached_property
    def tightenings(self) -> Tightening:
        one, tracker = identity(len(self.joint.center)), self.arrival.flight.tracker
        return Tightening(tracker.craft, tracker.settling, above(one, -one))

    @cached_property
    def errors(self) -> list[arb]:
        """Bounds on estimate errors at a node after T, twice, as the rows are."""
        doc = self.arrival.document
        errors = doc.errors_in(doc.steps) or [0.0] * len(doc.A)
        return [arb(x) + y for x, y in zip(errors, doc.at_nodes, strict=True)] * 2

    def inside(self, node: int, tightening: list[arb], context: str) -> None:
        """Refuse a node at which states need more along a row than the start set leaves."""
        n, spec = len(self.joint.center), self.joint
        along = (self.tightenings.rows * self.arrival.state(node)).entries()
        if spec.assured:
            tightening = sums(tightening, [2 * x for x in self.errors])
        for i, (at, needed) in enumerate(zip(along, tightening, strict=True)):
            sign = 1 if i < n else -1
            clearance = sign * arb(spec.center[i % n]) + spec.half_widths[i % n] - at
            subject = "estimates" if spec.assured else "states"
            require(
                "joint",
                clearance - needed,
                f"{subject} {context}, coordinate {i % n}: beyond the next leg's start set",
            )

    def run(self) -> str:
        doc, spec, flight = self.arrival.document, self.joint, self.arrival.flight
        for half, go, off in zip(spec.half_widths, spec.go, self.errors, strict=False):
            require("joint", arb(half) - off - go, "the GO box and errors of estimates exceed the start set")
            if not go > 0:
                raise Rejected("joint", "the next leg's start set is too small for the estimate errors")
        for first, final in [*spec.first, *spec.later]:
            if not 0 <= first <= final <= self.last:
                raise Rejected("joint", f"nodes {first} to {final} are not in the tail")
        for first, final in spec.first:
            for node in range(first, final + 1):
                self.inside(
                    node, self.arrival.error_bounds(self.tightenings, node), f"{node} periods after T"
                )
        if spec.later:
            if doc.horizon != "infinite":
                raise Rejected("joint", "GO in later revolutions needs safety for all time")
            begin = doc.steps * doc.q + max(self.last, flight.tracker.settling.periods + 2) + 1
            settled = sums(flight.tightening(self.tightenings, self.arrival.starts, begin), self.between * 2)
            for first, final in spec.later:
                for node in range(first, final + 1):
                    self.inside(node, settled, f"in later turns, {node} periods after one begins")
        count = sum(final - first + 1 for first, final in spec.first)
        return (
            f"in the next leg's start set at {count} nodes of the first turn, {len(spec.later)} spans later"
        )

    @cached_property
    def between(self) -> list[arb]:
        """Bound how far the reference may leave its chord within a period of the tail, by state."""
        plant = self.arrival.flight.tracker.craft.plant
        A, n = plant.A, len(self.joint.center)
        growth = exponential(absolute(A), plant.h)[0]
        by_node = [magnitude(A * A * self.arrival.state(node)).entries() for node in range(self.last + 1)]
        curvature = column([largest(x) for x in zip(*by_node, strict=True)]) if by_node else arb_mat(n, 1)
        return [x * plant.h * plant.h / 8 for x in (growth * curvature).entries()]


def check_joint(arrival: Arrival, joint: Joint) -> str:
    """Refuse a joint that does not follow from the sets of the leg; return the confirmed facts."""
    if not (joint.first or joint.later):
        raise Rejected("joint", "GO must be given at some node")
    return _Check(arrival, joint).run()
