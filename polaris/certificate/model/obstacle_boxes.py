"""Bodies that a network reads: where each may be at the start of every period, in ball arithmetic."""

from dataclasses import dataclass, field
from typing import Any

from flint import arb, arb_mat

from ..files.document import Document
from ..files.entries import Law
from ..kernel.balls import above, absolute, column, sums
from ..kernel.motion import InputSet, Plant
from .satellites import acceleration_input

MOVES = dict.fromkeys(("center_m", "velocity_m_s", "state", "state_half_widths")) | {
    "thrust_accel_max_m_s2": 0.0
}
"""Keys of an obstacle that say how it moves, and the values of missing ones."""


def bodies_of(reads: list[str], scenario: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the obstacles of a scenario that inputs name, in that order, as a certificate states them."""
    specs = {spec["name"]: spec for spec in scenario.get("obstacles", ())}
    names = dict.fromkeys(name.partition(":")[2] for name in reads if ":" in name)
    return [{"name": x, **{key: specs[x].get(key, none) for key, none in MOVES.items()}} for x in names]


@dataclass(frozen=True, eq=False)
class ObstacleBoxes:
    """Motion of bodies that a network is told, as boxes at the nodes, worked out one after the other."""

    plant: Plant
    bodies: dict[str, dict[str, Any]]
    clock: arb  # by how much the time may be off by which rigid ones move
    pushes: dict[str, list[InputSet]]  # what moves each satellite
    _carried: dict[str, list[tuple[arb_mat, list[arb]]]] = field(default_factory=dict, repr=False)

    @classmethod
    def from_document(cls, document: Document, law: Law, plant: Plant) -> "ObstacleBoxes":
        """Return the motion of the bodies that a network of a certificate reads."""
        pushes = {body["name"]: [plant.disturbance, *plant.bias] for body in law.bodies}
        for body in (body for body in law.bodies if body["thrust_accel_max_m_s2"]):
            enters = acceleration_input(document, body["name"])
            pushes[body["name"]].append(InputSet.in_ball(enters, arb(body["thrust_accel_max_m_s2"])))
        clock = arb(document.timing.get("clock", 0.0))
        return cls(plant, {body["name"]: body for body in law.bodies}, clock, pushes)

    @property
    def width(self) -> int:
        """Return how many numbers a network is told: position and velocity of every body."""
        return 2 * self.plant.C.nrows() * len(self.bodies)

    def less(self, name: str, x: arb_mat) -> arb_mat:
        """Return the chaser's part of an input: none, or its negative position or velocity."""
        kind, rows = name.partition(":")[0], self.plant.C
        rows = rows * self.plant.A if kind.endswith("velocity") else rows
        return -rows * x if kind.startswith("relative") else arb_mat(rows.nrows(), x.ncols())

    def at_node(self, name: str, node: int) -> tuple[arb_mat, arb_mat]:
        """Middle (d, 1) of a body's part of an input at a node, and generators, (d, width)."""
        kind, _, body = name.partition(":")
        d, middle, half = self.plant.C.nrows(), *self._box(body, node)
        first = d * kind.endswith("velocity")
        place, spread = 2 * d * list(self.bodies).index(body) + first, arb_mat(d, self.width)
        for i in range(d):
            spread[i, place + i] = half[first + i]
        return column(middle[first : first + d]), spread

    def _box(self, name: str, node: int) -> tuple[list[arb], list[arb]]:
        """Position and velocity of a body at a node, middle and half-widths.

        Of a satellite: the support of all its states along rows C and C A, which `push_gain` adds to.
        """
        body, plant, C = self.bodies[name], self.plant, self.plant.C
        if body["state"] is None:
            center, v = ([*map(arb, body[key] or [0.0] * C.nrows())] for key in ("center_m", "velocity_m_s"))
            place = [x + y * (plant.h * node) for x, y in zip(center, v, strict=True)]
            return [*place, *v], [*(self.clock * abs(x) for x in v), *(0 * x for x in v)]
        start = above(C, C * plant.A), [arb(0)] * (2 * C.nrows())
        carried = self._carried.setdefault(name, [start])
        while len(carried) <= node:
            rows, support = carried[-1]
            gains = (plant.open.push_gain(rows, push) for push in self.pushes[name])
            carried.append((rows * plant.open.phi, sums(support, *gains)))
        rows, support = carried[node]
        initial = absolute(rows) * column(body["state_half_widths"])
        return (rows * column(body["state"])).entries(), sums(support, initial.entries())
