"""A linear system with errors of its navigation, timing and thrusters."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from functools import cached_property
from typing import Any

import numpy as np

from reach.numerics.linear import discretize
from reach.short_repr import short_repr

from .checks import of_kind
from .errors import ScenarioError
from .system import Array as Array  # for the many that need both
from .system import LinearSystem, as_finite
from .thrusters import Nozzles, Thrusters
from .timing import WHOLE, Lead, Observer, Timing, Transient


@short_repr
@dataclass(frozen=True, eq=False)
class Craft(LinearSystem):
    """A linear system with errors of its navigation, timing and thrusters; by default none.

    It takes the parameters of `LinearSystem`, and besides:

    Parameters
    ----------
    estimate_error : array_like, shape (n,), optional
        Bounds on the errors of the estimate that controllers act on, at any time and however they change,
        those of a prediction included (`polaris.model.estimates.prediction`).
    thrusters : Thrusters
        Errors of what is applied.
    timing : Timing
        Delays, of which `estimate_error` holds the effect, and errors of clocks.
    error_by_step : array_like, shape (K + 1, n), optional
        Bounds in each step of a schedule and from its end on, of which `estimate_error` is the largest.
    observer : Observer, optional
        Source of the estimates, where their errors are worked out from those of measurements.
    transients : tuple of Transient
        Faults that are isolated late, of which at most one occurs.
    sights : array_like, shape (K + 1, 5) or (1, 5), optional
        Errors of range [m] and bearing [rad], and the part of the bounds on the position (3,) that they make.
    nozzles : Nozzles, optional
        Layout of thrusters from whose errors one by one `thrusters` was worked out.
    """

    estimate_error: Array | None = None
    thrusters: Thrusters = Thrusters()
    timing: Timing = Timing()
    error_by_step: Array | None = None
    observer: Observer | None = None
    transients: tuple[Transient, ...] = ()
    nozzles: Nozzles | None = None
    sights: Array | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        assign, eta = object.__setattr__, self.estimate_error
        if self.sights is not None and not np.any(self.sights):
            assign(self, "sights", None)
        if self.error_by_step is not None:
            assign(self, "error_by_step", as_finite("navigation", self.error_by_step, 2))
            eta = np.max(self.error_by_step, axis=0)
        assign(self, "estimate_error", as_finite("navigation", np.zeros(self.n) if eta is None else eta, 1))
        if self.navigation.shape != (self.n,) or np.any(self.navigation < 0):
            raise ScenarioError("navigation", self.navigation.tolist(), f"must be {self.n} numbers >= 0")

    @classmethod
    def from_system(cls, system: LinearSystem) -> Craft:
        """Return a craft as it is, and any other linear system as a craft without errors."""
        if isinstance(system, cls):
            return system
        of_kind("system", system, LinearSystem)
        return cls(*(getattr(system, part.name) for part in fields(LinearSystem)))

    @property
    def navigation(self) -> Array:
        """Bound on the error of the estimate of every state, shape (n,)."""
        assert self.estimate_error is not None
        return self.estimate_error

    @property
    def measured(self) -> Array:
        """Bounds on the errors of measured states, those of the estimate where no others are known, (n,)."""
        return np.array(self.timing.measured_error or self.navigation)

    @property
    def proportional(self) -> bool:
        """True if errors of applied inputs depend on commands."""
        return self.thrusters.proportional or self.timing.lead is not None

    @property
    def ideal(self) -> bool:
        """True if laws see the exact state and their commands are applied exactly, without late faults."""
        return self.thrusters.exact and not np.any(self.navigation) and not self.transients

    @property
    def state_offset(self) -> Array:
        """State offset: bounds on the distance of the true state from the modelled one (`Timing`), (n,)."""
        return np.array(self.timing.state_offset or np.zeros(self.n))

    @property
    def state_offset_at_nodes(self) -> Array:
        """State offset at nodes, where pulses displace nothing, shape (n,)."""
        return np.asarray(self.state_offset - np.array(self.timing.intersample_offset or 0.0))

    @cached_property
    def impulse_rates(self) -> Array:
        """Rates of the states by carried impulses, their errors, and jitter, as generators (n, ...)."""
        if not self.timing.carried_impulse:
            return self.shifting
        mean_B = discretize(self.A, self.B, self.timing.period)[1] / self.timing.period
        errors = [self.thrusters.along * self.B] if self.thrusters.along > 0 else []
        carried = self.timing.carried_impulse * self.A @ np.hstack([mean_B, *errors])
        return np.hstack([carried, self.shifting])

    @property
    def shifted(self) -> Array:
        """Bounds on the impulses that jitter and edges bring forward or put off, of inputs [N s], (m,)."""
        timing, time_shift = self.timing, self.timing.jitter + self.timing.edge
        if not time_shift > 0:
            return np.zeros(self.m)
        thrust = self.u_max + (2 * timing.carried_impulse / timing.period if timing.carried_impulse else 0.0)
        largest = 2 * np.array(timing.pulse_thrust) if timing.pulse_thrust else thrust
        return np.asarray(time_shift * (largest + self.on_time.error(largest)) * (1 + 1e-9))

    @property
    def shifting(self) -> Array:
        """Rates of the states by `shifted` impulses, as generators (n, m); (n, 0) without any."""
        return np.asarray((self.A @ self.B * self.shifted)[:, : self.m * bool(np.any(self.shifted))])

    @cached_property
    def unknown(self) -> Array:
        """Rates of the states by carried impulses, leads of pulses and the constant beside w, (n, ...)."""
        lead = self.timing.lead
        led = [] if lead is None else [self.A @ self.B * np.add(lead.fixed, lead.cap)]
        return np.hstack([self.impulse_rates, *led, self.biases])

    @cached_property
    def carry_offset(self) -> Array:
        """Bounds on the displacement of states by carried impulses and errors of them, shape (n,)."""
        if not self.timing.carried_impulse:
            return np.zeros(self.n)
        mean_B = discretize(np.abs(self.A), np.abs(self.B), self.timing.period)[1] / self.timing.period
        per_impulse = mean_B.sum(axis=1) + self.thrusters.along * np.abs(self.B).sum(axis=1)
        return np.asarray(per_impulse * self.timing.carried_impulse * (1 + 1e-9))

    @property
    def without_delay(self) -> Craft:
        """Craft whose commands take effect at once: with the errors of measurements."""
        if self.timing == Timing():
            return self
        craft = self.with_estimate_error(self.measured)
        return replace(craft, observer=None, timing=Timing(), thrusters=self.on_time)

    @property
    def on_time(self) -> Thrusters:
        """Return the errors of thrusters without those that stand for jitter and pulses."""
        return self.thrusters if self.timing == Timing() else self.timing.on_time

    def as_ideal(self) -> Craft:
        """Return the craft without errors of estimates and thrusters, and without late faults."""
        return self if self.ideal else Craft(*(getattr(self, part.name) for part in fields(LinearSystem)))

    def at_step(self, k: int) -> Craft:
        """Return the craft with the errors of estimates that there may be in step k."""
        steps = self.error_by_step
        return self if steps is None else self.with_estimate_error(steps[min(k, len(steps) - 1)])

    def with_estimate_error(self, error: Array) -> Craft:
        """Return the craft with errors of estimates, shape (n,), that are those of every step."""
        return replace(self, estimate_error=error, error_by_step=None)

    @property
    def matrix(self) -> Array:
        """Bounds on a matrix of errors of thrusters that is constant in a flight, (m, m); 0 where none is.

        Without a layout of thrusters and jitter, whose errors vary (docs/theory.md, Proposition 14 (c)).
        """
        errors = self.thrusters
        counts = errors.constant and errors.along < 1 and self.longest == 1
        return errors.summed(np.eye(self.m)) * counts

    def estimate_bound(self, most: Array | None = None) -> Array:
        """Return bounds on the errors of the estimate, shape (..., n).

        `most` (..., m) bounds the commands of the periods before whose errors are not measured yet, if known
        (docs/theory.md, Proposition 7 (b)).
        """
        if most is None:
            return self.navigation
        spare = self.proportional_errors(self.u_max) - self.proportional_errors(np.minimum(most, self.u_max))
        unseen = sum(map(np.transpose, self.by_lag.values()), 0 * self.entering.T)
        return np.asarray(self.navigation - spare @ unseen)

    @property
    def by_lag(self) -> dict[int, Array]:
        """Return `Timing.unseen` by periods, (n, k) each; nothing where faults are isolated late."""
        return {} if self.transients else {age: np.array(added) for age, added in self.timing.by_lag}

    @property
    def entering(self) -> Array:
        """Rates of the states by errors of inputs, and by leads of pulses if there are any, (n, k)."""
        return self.B if self.timing.lead is None else np.hstack([self.B, self.A @ self.B])

    def proportional_errors(self, most: Array) -> Array:
        """Return parts of the errors `entering` that grow with commands up to `most` (..., m), (..., k)."""
        part, lead = self.thrusters.part(most), self.timing.lead
        return part if lead is None else np.concatenate([part, lead.part(most)], axis=-1)

    def input_error(self, gain: Array, most: Array) -> Array:
        """Bound the difference of applied inputs from a clipped law's commands on the exact state, (m,).

        Clipped commands, up to `most` (m,), differ no more than unclipped (docs/theory.md, Proposition 5).
        """
        return np.asarray(np.abs(gain) @ self.navigation + self.thrusters.error(most))

    @property
    def weights(self) -> Array:
        """Return how much of velocity change a unit of each input counts, (m,): the sum of all thrusters."""
        return np.ones(self.m) if self.nozzles is None else self.nozzles.weights

    def spending(self, most: Array) -> Array:
        """Return bounds on applied inputs, on average over time, under commands up to `most`, (..., m).

        Each by its weight: the sum bounds what counts of velocity change.
        """
        return np.asarray(self.longest * (most + self.on_time.error(most)) * self.weights)

    @property
    def carried_impulse(self) -> float:
        """Return the largest carried impulse of all inputs [N s], with its errors."""
        sides = 1 if self.nozzles is None else 2  # each way thrusters of their own
        return self.longest * self.on_time.made(sides * self.m * self.timing.carried_impulse)

    @property
    def longest(self) -> float:
        """Longest time for which a command may be in force, as a share of its period."""
        jitter, h = self.timing.jitter + self.timing.edge, self.timing.period
        return 1 + 2 * jitter / h * (1 + WHOLE) if jitter else 1.0

    def error_map(self, error: Array) -> Array | None:
        """Return errors of inputs and `unknown`, as generators of the rate of the states, or None."""
        parts = [self.B * error] * bool(np.any(error)) + [self.unknown] * bool(self.unknown.size)
        return np.hstack(parts) if parts else None


def lead_of(system: Craft, h: float) -> Lead | None:
    """Return the leads of a craft's pulses with a period of h [s]; None if its pulses are centred.

    A pulse of thrust f that takes the share g of a period leads by at most ``h/2 f g (1 - g)``.
    """
    timing, errors, layout, m = system.timing, system.on_time, system.nozzles, system.m
    if not timing.pulse_place:
        return None
    fired = np.array(timing.pulse_thrust)
    if layout is None:
        shares = np.eye(m) + errors.table(m)
        fixed = shares.sum(axis=1) * timing.carried_impulse / h + errors.bit
    else:
        allocation = layout.allocation
        side = np.max(np.abs(allocation.directions) / allocation.lengths[:, None], axis=0)
        shares = (np.outer(side, layout.weights) + layout.bounds[:-1]) / (1 - layout.mass)
        remainder = layout.bit / h * layout.carried
        fixed = remainder * allocation.at_once(np.abs(allocation.directions)) + errors.bit
    largest = h / 8 * (fired + errors.part(fired)) - h / 2 * fixed
    sizes = h / 2 * shares, h / 2 * fixed, np.maximum(largest, 0.0)
    return Lead(*(_as_tuples(size * (1 + 1e-9)) for size in sizes))


def _as_tuples(values: Array) -> tuple[Any, ...]:
    each = values.tolist()
    return tuple(tuple(row) if isinstance(row, list) else row for row in each)
