"""Bound on S's corrections over a whole flight along one path (docs/theory.md, Proposition 15 (d)).

A correction is S's command beside the inputs of its path. One part answers to disturbances in every
period: a storage function bounds its mean. The other part answers to single errors and those known before
the flight: sums of impulse responses bound it.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from reach.sets.zonotope import Zonotope

from ...model.system import Array
from ...model.timing import Transient
from ...model.tolerances import ROUNDING
from ..sources.late_faults import touched
from ..sources.outages import OutageDifference
from ..sources.pulses import PULSES
from ..sources.thrusters import THRUSTERS
from ..tracker.long_flight import Inputs
from ..tracker.tracking import Tracking


@dataclass(frozen=True, eq=False)
class Corrections:
    """Bounds on sums over periods of S's corrections, along any path."""

    tracking: Tracking

    @cached_property
    def _inputs(self) -> Inputs:
        """Values that enter in every period of any step, under any commands."""
        tracking, system = self.tracking, self.tracking.system
        estimate_error = tracking.step_errors.max(axis=0)
        return Inputs.from_loop(
            tracking.tightening.closed, system, (system.u_max,) * 2, estimate_error, np.zeros(system.n)
        )

    @cached_property
    def mean(self) -> float | None:
        """Bound on the thrust that answers to them on average [N], None if there is no bound."""
        storage, system = self._inputs.storage(), self.tracking.system
        if storage is None or self._amplified is None:
            return None
        return storage[1] + float(np.sum(system.weights * system.on_time.bit))

    @cached_property
    def _answers(self) -> Array:
        """Commands by a unit of the loop state l periods before, ``K F^l``, shape (horizon, m, N)."""
        limits = self.tracking.tightening
        return limits.carried(limits.closed.K)[: limits.horizon]

    @cached_property
    def _summed(self) -> Array:
        """Sums of the sizes of the answers, shape (m, N)."""
        return np.asarray(np.abs(self._answers).sum(axis=0))

    @cached_property
    def _by_error(self) -> Array:
        """Sum of the answers to a unit error of each input in one period, then of each lead, shape (m, k)."""
        limits, sums = self.tracking.tightening, {THRUSTERS: np.zeros((self.tracking.system.m,) * 2)}
        for channel in limits.closed.loop.channels:
            if channel.name in (THRUSTERS, PULSES):
                response = self.tracking.response(channel, limits.closed.K)
                sums[channel.name] = response.gains.sum(axis=0) + response.older
        return np.hstack(list(sums.values()))

    def _errors(self, commands: Array) -> Array:
        """Bound errors that are proportional to commands up to some sizes (..., m), as in `_by_error`."""
        system = self.tracking.system
        lead, parts = system.timing.lead, [system.thrusters.part(commands)]
        return np.concatenate([*parts, *([] if lead is None else [lead.part(commands)])], axis=-1)

    @cached_property
    def _amplified(self) -> Array | None:
        """Sum of commands by a sum of commands, errors of thrusters that they cause included, (m, m)."""
        system = self.tracking.system
        tables, lead = [system.thrusters.table(system.m)], system.timing.lead
        fed = self._by_error @ np.vstack([*tables, *([] if lead is None else [lead.shares])])
        if not fed.sum(axis=1).max() < 1:
            return None
        return np.asarray(np.linalg.inv(np.eye(len(fed)) - fed))

    def _spending(self, sums: Array) -> float:
        """Thrust by sums of answers (m,) from which errors of thrusters are left out."""
        assert self._amplified is not None
        return float(self._inputs.spends @ self._amplified @ sums) * (1 + ROUNDING)

    def _later(self, sizes: Array, count: int) -> Array:
        """Sums of the rest, beyond the settling horizon, of loop states up to some sizes (N,), (m,)."""
        limits = self.tracking.tightening
        remainder = limits.remainder(limits.closed.K) * np.max(sizes / limits.v)
        return np.asarray(remainder * max(count - limits.horizon, 0))

    def planned(self, inputs: Array) -> float:
        """Bound the thrust of inputs of a path, and of corrections of their errors [N].

        `inputs` (periods, m) are those of every period.
        """
        errors = self._errors(np.abs(inputs)).sum(axis=0)
        thrust = float(self._inputs.spends @ np.abs(inputs).sum(axis=0))
        return thrust + self._spending(self._by_error @ errors)

    def once(self, sets: Zonotope, count: int) -> float:
        """Bound the thrust in so many periods that answers to one loop state in any of the sets [N]."""
        sets = self.tracking.loop_state(sets)
        answers, largest = self._answers.reshape(-1, sets.dim), 0.0
        for c, G in zip(sets.c, sets.G, strict=True):
            each = (np.abs(answers @ c) + np.abs(answers @ G).sum(axis=-1)).reshape(len(self._answers), -1)
            later = self._later(np.abs(c) + np.abs(G).sum(axis=-1), count)
            largest = max(largest, self._spending(each.sum(axis=0) + later))
        return largest

    def answer_bound(self, size: Array, count: int) -> float:
        """Bound the thrust that answers to errors up to some size, shape (n,) [N]."""
        size = np.pad(size, (0, self.tracking.loop.N - len(size)))
        return self._spending(self._summed @ size + self._later(size, count))

    def late_fault_thrust(self, count: int) -> float:
        """Bound the thrust of a transient fault, and of the answers to it [N].

        Until isolation every command answers to no more than the motion by then. What an observer that
        misses periods has not learned in an outage may add to every later command.
        """
        system, h, largest = self.tracking.system, self.tracking.flow.h, 0.0
        for fault, difference, wrong in self._faults():
            sums = difference.support(self._answers).sum(axis=0)
            sums = sums + self._later(difference.support(np.eye(self.tracking.loop.N)), count)
            until = fault.lasts + system.timing.delay + h * (2 * system.timing.missed + 1)
            periods = touched(until, h)
            if not len(fault.thrust) and self.tracking.loop.settled is None:
                periods = 0 if system.observer is None else max(count, periods)
            sums = sums + periods * difference.support(self._answers[0])
            largest = max(largest, self._spending(sums) + wrong * fault.lasts / h)
        return largest

    def _faults(self) -> Iterator[tuple[Transient, OutageDifference, float]]:
        """Return faults, the effect of each kind of wrong thrust on the loop state, and its sum [N]."""
        differences = iter(self.tracking.transients)
        for fault in self.tracking.system.transients:
            wrong = fault.wrong(self.tracking.system.thrusters).sum(axis=1) if len(fault.thrust) else [0.0]
            for each in wrong:
                yield fault, next(differences), float(each)
