"""Faults that are isolated late as they are flown: one in each flight, when it is worst or at random."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..model.system import Array
from ..synthesis.schedule.schedule import Schedule

CASE_KEYS = "begins", "ends", "thrust", "share", "outage"
"""Fields of a fault that a saved case holds."""

KINDS = "navigation_lost", "stuck_on", "loss", "stuck_off"  # in the order in which `columns` tells them apart


@dataclass(frozen=True, eq=False)
class FaultTimes:
    """Faults of R flights: steps of the integration in which each begins and ends; S flies from then on.

    Thrust (R, m) that a thruster makes at its limit, none where navigation is lost; the share of it that is
    lost, or -1 if it pushes unasked. While navigation is lost S flies on predictions, which are `gap` off.
    """

    begins: NDArray[np.int_]
    ends: NDArray[np.int_]
    thrust: Array
    share: Array
    outage: NDArray[np.bool_]
    gap: Array = field(repr=False)
    latched: bool = field(default=True, kw_only=True)  # S flies to the end, else nobody because of it

    def pick(self, chosen: NDArray[np.intp] | slice | list[int]) -> "FaultTimes":
        """Return the faults of some of the flights."""
        values = {name: getattr(self, name)[chosen] for name in CASE_KEYS}
        return FaultTimes(**values, gap=0 * self.gap[chosen], latched=self.latched)

    def table(self) -> dict[str, Any]:
        """Return the first of the flights, as `from_table` reads it."""
        return {name: getattr(self, name)[0].tolist() for name in CASE_KEYS}

    @classmethod
    def from_table(cls, table: dict[str, Any], n: int) -> "FaultTimes":
        """One flight with n states from a `table`."""
        values: dict[str, Any] = {name: np.array([table[name]]) for name in CASE_KEYS}
        return cls(**values, gap=np.zeros((1, n)))

    def on(self, step: int) -> NDArray[np.bool_]:
        """Return True where the fault lasts."""
        return np.asarray((self.begins <= step) & (step < self.ends))

    def missing(self, steps: NDArray[Any]) -> NDArray[np.bool_]:
        """Return True where the measurement in some steps (R,) is lost."""
        return np.asarray(self.outage & (self.begins <= steps) & (steps < self.ends))

    def by_s(self, step: int | NDArray[np.int_]) -> NDArray[np.bool_]:
        """Return True where S flies because of it."""
        return np.asarray(self.latched & (np.where(self.outage, self.begins, self.ends) <= step))

    def at_nodes(self, per_node: int) -> "FaultTimes":
        """Return the faults in nodes, with so many steps to a node."""
        return replace(self, begins=-(-self.begins // per_node), ends=self.ends // per_node)

    def columns(self, times: Array) -> dict[str, Array]:
        """Return each flight's kind of fault, its begin and end [s], nodes being at times (N+1,)."""
        faulty, kinds = self.begins < (last := len(times) - 1), [self.outage, self.share < 0, self.share < 1]
        at = (times[np.minimum(nodes, last)] for nodes in (self.begins, self.ends))
        begins, ends = (np.where(faulty, time, np.nan) for time in at)
        names = np.where(faulty, np.select(kinds, KINDS[:3], KINDS[3]), "")
        return {"fault": names, "fault_begins_s": begins, "fault_ends_s": ends}

    def relieved(self, k: int, effect: int) -> NDArray[np.bool_]:
        """Return True where S flies from the node `effect` on, whichever decision follows the measurement.

        Nothing is measured, or it was before a fault was isolated.
        """
        before = ~self.outage & (k < self.ends) & (self.ends <= effect)
        return np.asarray(before | (self.outage & self.on(k)))

    def added(self, u: Array, step: int) -> Array:
        """Return the thrust a failing thruster adds to commands u, which ask of it their part along it."""
        size = np.maximum(np.sum(self.thrust**2, axis=1), 1e-300)
        demand = np.clip(np.sum(u * self.thrust, axis=1) / size, 0.0, 1.0)
        level = np.where(self.share < 0, 1.0, -self.share * demand)
        return np.asarray((level * self.on(step))[:, None] * self.thrust)

    def predict(self, step: int, carried: Array, wrong: Array, eta: Array | float) -> None:
        """Carry the errors of predictions on over a step, which end when measurements come again."""
        started = (self.begins == step + 1) & self.outage
        running = self.on(step + 1) & self.outage & ~started
        self.gap[:] = np.where(running[:, None], self.gap @ carried.T - wrong, 0.0)
        self.gap[started] = np.broadcast_to(eta, self.gap.shape)[started]


def drawn(
    schedule: Schedule, per_node: int, rows: Array, targets: NDArray[np.int_], rng: np.random.Generator
) -> FaultTimes:
    """One fault per flight; half of them are the worst along a row.

    Rows are (R, n), targets (R,) instants as numbers of steps, so many per node. S flies on at nodes.
    """
    tracking, count = schedule.safety.tracking, len(rows)
    system, worst = tracking.system, rng.random(count) < 0.5
    which = rng.integers(0, len(system.transients), count)
    ends, length = np.where(worst, targets, rng.integers(1, targets + 1)), np.zeros(count, dtype=int)
    thrust, share, outage = np.zeros((count, system.m)), np.ones(count), np.zeros(count, dtype=bool)
    kicks = np.einsum("lrn,nm->rlm", rows @ tracking.transitions, system.B)
    for number, fault in enumerate(system.transients):
        group, thrusters, stuck = np.flatnonzero(which == number), len(fault.thrust), fault.name == "stuck_on"
        length[group] = np.clip(int(fault.lasts / tracking.flow.h * per_node + 1e-9), 1, targets.max())
        outage[group] = not thrusters
        if thrusters and len(group):
            along = kicks[group] @ fault.thrust.T * (1 if stuck else -1)
            age, best = np.divmod(along.reshape(len(group), -1).argmax(axis=1), thrusters)
            chosen = np.where(worst[group], best, rng.integers(0, thrusters, len(group)))
            ends[group] -= np.where(worst[group], np.minimum(age * per_node, ends[group] - 1), 0)
            thrust[group], share[group] = fault.thrust[chosen], -1.0 if stuck else fault.share
    ends = -(-np.maximum(ends, length) // per_node) * per_node
    return FaultTimes(ends - length, ends, thrust, share, outage, np.zeros((count, system.n)))


def in_every_second(
    schedule: Schedule, per_node: int, rows: Array, steps: int, runs: int, rng: np.random.Generator
) -> FaultTimes | None:
    """Draw the faults of the runs of odd numbers, and their times; half of them at the worst along a row."""
    if not schedule.safety.tracking.system.transients:
        return None
    targets = rng.integers(1, steps + 1, runs)
    faults = drawn(schedule, per_node, rows[rng.integers(0, len(rows), runs)], targets, rng)
    never = np.where(np.arange(runs) % 2, 0, steps + per_node)
    return replace(faults, begins=faults.begins + never, ends=faults.ends + never)
