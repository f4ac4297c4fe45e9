"""Bound on S's corrections over a whole flight along one path (docs/theory.md, Proposition 15 (d)).

A correction is S's command beside the inputs of its path. One part answers to what disturbs in every
period: a storage function bounds its mean. The other part answers to what happens once or is known before
the flight: sums of impulse responses bound it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import ceil
from typing import Any

from flint import arb, arb_mat

from ..kernel.balls import (
    above,
    beside,
    column,
    diagonal,
    identity,
    largest,
    magnitude,
    maxima,
    row_sums,
    sums,
    widths,
)
from ..kernel.zonotopes import Zonotope, times
from ..model.craft.states import remembers
from ..model.craft.tightening import Differences, Tightening, difference_along
from ..model.plants import WHOLE
from .continuation import Tracker
from .mean_spending import MeanCommands

NEAR = 2
"""Part of the settling horizon, one over it, in which generators of a set are followed; then its box is."""


@dataclass(frozen=True, eq=False)
class Corrections:
    """Bounds on sums over periods of S's corrections, along any path."""

    tracker: Tracker

    @cached_property
    def _loop(self) -> MeanCommands:
        """Values that enter in every period of any step, under any commands."""
        doc, craft = self.tracker.document, self.tracker.craft
        steps = (craft.extra(doc, k) for k in range(doc.steps + 1))
        errors = sums(maxima(*steps), craft.lag_error(craft.plant.u_max))
        noise = craft.gain * craft.carry * diagonal(craft.missed(errors))
        return MeanCommands(craft, craft.plant.thruster_error(craft.plant.u_max), noise)

    @cached_property
    def mean(self) -> arb | None:
        """Bound on the thrust that answers to them on average [N], None if there is no bound."""
        plant, storage = self.tracker.craft.plant, self._loop.storage()
        if storage is None or self._amplified is None:
            return None
        return storage.cost + plant.weighted(
            list(map(arb, plant.without_delay.bits or [0.0] * len(plant.u_max)))
        )

    @cached_property
    def _tightenings(self) -> Tightening:
        """Tightening of limits on commands."""
        return Tightening(self.tracker.craft, self.tracker.settling, self.tracker.craft.commands)

    @cached_property
    def _summed(self) -> arb_mat:
        """Sums over the settling horizon of the sizes of commands by a unit of each loop state, (m, N)."""
        first, *others = map(magnitude, self._tightenings.carried[: self.tracker.settling.periods])
        return sum(others, first)

    @cached_property
    def _by_error(self) -> arb_mat:
        """Sum of the answers to a unit error of thrusters in one period, see `Plant.entering`, (m, k)."""
        craft, tightenings, columns = self.tracker.craft, self._tightenings, list[arb_mat]()
        for unit in identity(craft.plant.entering.ncols()).tolist():
            box = craft.thrust_gains(identity(craft.F.nrows())) * column(unit)
            columns.append(column(sums(tightenings.thrust.always(unit), tightenings.tail_bound(box))))
        return beside(*columns)

    @cached_property
    def _amplified(self) -> arb_mat | None:
        """Sum of commands by a sum of commands, errors of thrusters that they cause included, (m, m)."""
        loop_gain = self._by_error * self.tracker.craft.plant.every_table
        if not largest(row_sums(loop_gain)) < 1:
            return None
        return (identity(loop_gain.nrows()) - loop_gain).inv()

    def _spending(self, answers: Sequence[arb]) -> arb:
        """Thrust by sums of answers (m,) from which errors of thrusters are left out."""
        assert self._amplified is not None
        commands = self._amplified * column([x.upper() for x in answers])
        return sum((s * x for s, x in zip(self._loop.spends, commands.entries(), strict=True)), arb(0))

    def _later(self, size: arb_mat, count: int) -> list[arb]:
        """Sums of the rest, beyond the settling horizon, of loop states up to some sizes (N, 1), (m,)."""
        remaining = max(count - self.tracker.settling.periods, 0)
        return [x * remaining for x in self._tightenings.tightening_after_settling(size)]

    def planned(self, inputs: Sequence[Sequence[float]], q: int) -> arb:
        """Bound the thrust of inputs of a path, and of corrections of their errors [N].

        `inputs` (steps, m) are those of steps of q periods.
        """
        plant, m = self.tracker.craft.plant, len(self.tracker.craft.plant.u_max)
        sizes = [[abs(arb(x)) for x in u] for u in inputs]
        total = sums([arb(0)] * m, *sizes)
        parts = (plant.thruster_part(u) for u in sizes if any(x > 0 for x in u))
        errors = sums([arb(0)] * plant.entering.ncols(), *parts)
        thrust = sum((s * x for s, x in zip(self._loop.spends, total, strict=True)), arb(0))
        return (thrust + self._spending((self._by_error * column(errors)).entries())) * q

    @cached_property
    def _near(self) -> tuple[arb_mat, arb_mat]:
        """Answers in the first part of the settling horizon, and sums of the sizes of the rest."""
        carried, count = (
            self._tightenings.carried[: self.tracker.settling.periods],
            self.tracker.settling.periods // NEAR,
        )
        first, *others = map(magnitude, carried[count:])
        return above(*carried[:count]), sum(others, first)

    def once(self, sets: Sequence[Zonotope], count: int) -> arb:
        """Bound the thrust in so many periods that answers to one loop state in any of the sets [N]."""
        near, far = self._near
        m, thrusts = far.nrows(), list[arb]()
        for z in sets:
            answers = [abs(x).upper() for x in (near * z.c).entries()]
            for part in z.parts:
                answers = sums(answers, widths(times(near, part)))
            size = z.size()
            totals = [sum(answers[i::m], arb(0)) for i in range(m)]
            thrusts.append(self._spending(sums(totals, (far * size).entries(), self._later(size, count))))
        return largest(thrusts)

    def answer_bound(self, size: arb_mat, count: int) -> arb:
        """Bound the thrust that answers to errors up to some size, shape (n, 1) [N]."""
        size = self.tracker.craft.lifted(size)
        return self._spending(sums((self._summed * size).entries(), self._later(size, count)))

    def late_fault_thrust(self, count: int) -> arb:
        """Bound the thrust of a transient fault and of the commands that answer to it [N].

        Until then every command answers to no more than what it has moved by then. What an observer that
        misses periods has not learned in an outage may add to every later command.
        """
        tightenings, plant, thrusts = self._tightenings, self.tracker.craft.plant, [arb(0)]
        carried = tightenings.carried[: self.tracker.settling.periods]
        for fault, flights, wrong in self._faults():
            commands = [difference_along(rows, flights) for rows in carried]
            size = column(difference_along(identity(carried[0].ncols()), flights))
            periods, doc = self._until(fault), self.tracker.document
            if not fault.get("pushes") and not remembers(doc):
                periods = 0 if doc.observer is None else max(count, periods)
            answers = sums(*commands, self._later(magnitude(size), count), [x * periods for x in commands[0]])
            thrusts.append(self._spending(answers) + wrong * arb(fault["lasts"]) / plant.h)
        return largest(thrusts)

    def _until(self, fault: dict[str, Any]) -> int:
        """Number of periods in which commands may answer to a fault before it is isolated."""
        timing, h = self.tracker.document.timing, self.tracker.craft.plant.h
        duration = fault["lasts"] + timing.get("delay", 0.0) + h * (2 * timing.get("missed", 0) + 1)
        return ceil(float((duration / h).mid()) * (1 - WHOLE))

    def _faults(self) -> Iterator[tuple[dict[str, Any], Differences, arb]]:
        """Return faults, the change of the loop state by each kind of wrong thrust, and its sum [N]."""
        tracker = self.tracker
        plant, boxes, outages = tracker.craft.plant, iter(tracker.upsets), iter(tracker.outages)
        for fault in tracker.document.transients:
            if not fault.get("pushes"):
                yield fault, next(outages), arb(0)
            for push in fault.get("pushes") or []:
                box, size = tracker.craft.lifted(next(boxes)), list(map(arb, push))
                wrong = sum(sums(size, plant.without_delay.thruster_part(size)), arb(0))
                yield fault, [(diagonal(box.entries()), arb_mat(box.nrows(), 0))], wrong
