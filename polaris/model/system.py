"""The linear control system of section II: ``x' = A x + B u + D w`` with its bounds."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from reach.brief import brief
from reach.numerics.linear import discretize

from .acceleration import acceleration_input
from .errors import ScenarioError
from .thrusters import Thrusters
from .timing import WHOLE, Observer, Timing, Transient

Array = NDArray[np.float64]

HILL_AXES = ("radial", "along-track", "cross-track")
"""Axes of Hill's frame, in the order of position, velocity and thrust."""
AT_ONCE: dict[str, Any] = {"timing": Timing(), "error_by_step": None, "observer": None}
"""Fields of a system whose commands rest on what is measured right then."""


def as_finite(name: str, value: ArrayLike, ndim: int) -> Array:
    """Convert to a float array of the given dimension, refusing NaN and infinity.

    Raises
    ------
    ScenarioError
        If the value is not numeric, has the wrong number of dimensions, or is not finite.
    """
    try:
        if np.asarray(value).dtype.kind in "USmMc":  # numbers in quotes, times, complex numbers
            raise ScenarioError(name, value, "must be numbers")
        array = np.array(value, dtype=float)
    except (TypeError, ValueError, OverflowError) as error:
        raise ScenarioError(name, value, "must be numbers") from error
    if array.ndim != ndim:
        rule = f"must have {ndim} dimension(s), has {array.ndim}" if ndim else "must be one number"
        raise ScenarioError(name, value, rule)
    if not np.all(np.isfinite(array)):
        raise ScenarioError(name, value, "must be finite numbers")
    array.setflags(write=False)
    return array


@brief
@dataclass(frozen=True, eq=False)
class LinearSystem:
    """A linear control system with bounded input and bounded disturbance (section II).

    Parameters
    ----------
    A, B, D : array_like, shapes (n, n), (n, m), (n, p)
        System matrices, SI units.
    u_max : array_like, shape (m,)
        Input limits per axis, ``|u_i| <= u_max[i]`` [N for a spacecraft].
    w_max : float
        Disturbance bound, ``norm(w, 2) <= w_max`` [m/s^2 for a spacecraft].
    C : array_like, shape (d, n), optional
        Selects the position, in which obstacles live [m]. Default: the first n/2 states.
    mass : float, optional
        Mass [kg] that turns an integral of ``|u|`` into a velocity change; 1 where the input
        is an acceleration.
    mean_motion : float, optional
        Orbital rate [rad/s] if the frame is Hill's, else None.
    estimate_error : array_like, shape (n,), optional
        How far each state may be from the estimate that controllers act on, at any time and however the
        difference changes, a prediction included (`polaris.model.prediction`); zero by default.
    error_by_step : array_like, shape (K + 1, n), optional
        The same in each step of a schedule, and from its end on, of which `estimate_error` is the largest.
    observer : Observer, optional
        What makes the estimates, where their errors are worked out from those of measurements.
    thrusters : Thrusters
        How far what is applied may be from what is commanded; not at all by default.
    timing : Timing
        What `estimate_error` holds of delays, and how far clocks may be apart; at once by default.
    transients : tuple of Transient
        Faults that are isolated late, of which at most one occurs; none by default.

    Raises
    ------
    ScenarioError
        On wrong shapes, non-finite entries or negative bounds.
    """

    A: Array
    B: Array
    D: Array
    u_max: Array
    w_max: float = 0.0
    C: Array | None = field(default=None)
    mass: float = 1.0
    mean_motion: float | None = None
    state_names: tuple[str, ...] = ()
    estimate_error: Array | None = None
    thrusters: Thrusters = Thrusters()
    timing: Timing = Timing()
    error_by_step: Array | None = None
    observer: Observer | None = None
    transients: tuple[Transient, ...] = ()

    def __post_init__(self) -> None:
        put = object.__setattr__
        for name in ("A", "B", "D"):
            put(self, name, as_finite(f"system.{name}", getattr(self, name), 2))
        n = self.A.shape[0]
        if self.A.shape != (n, n):
            raise ScenarioError("system.A", self.A.shape, "must be square")
        for name in ("B", "D"):
            matrix = getattr(self, name)
            if matrix.shape[0] != n or matrix.shape[1] == 0:
                rule = f"must have {n} rows, as A has, and at least one column"
                raise ScenarioError(f"system.{name}", matrix.shape, rule)
        put(self, "u_max", as_finite("system.u_max", self.u_max, 1))
        if self.u_max.shape != (self.m,) or np.any(self.u_max <= 0):
            raise ScenarioError("system.u_max", self.u_max.tolist(), f"must be {self.m} positive numbers")
        for name, least in (("w_max", ">="), ("mass", ">"), ("mean_motion", ">")):
            if name == "mean_motion" and self.mean_motion is None:
                continue
            value = float(as_finite(f"system.{name}", getattr(self, name), 0))
            if value < 0 or (value == 0 and least == ">"):
                raise ScenarioError(f"system.{name}", value, f"must be a finite number {least} 0")
            put(self, name, value)
        C = np.eye(n)[: max(n // 2, 1)] if self.C is None else self.C
        put(self, "C", as_finite("system.C", C, 2))
        if self.position.shape[1] != n or not 1 <= self.position.shape[0] <= 3:
            raise ScenarioError("system.C", self.position.shape, f"must be (d, {n}) with d = 1, 2 or 3")
        eta = np.zeros(n) if self.estimate_error is None else self.estimate_error
        if self.error_by_step is not None:
            put(self, "error_by_step", as_finite("navigation", self.error_by_step, 2))
            eta = np.max(self.error_by_step, axis=0)
        put(self, "estimate_error", as_finite("navigation", eta, 1))
        if self.navigation.shape != (n,) or np.any(self.navigation < 0):
            raise ScenarioError("navigation", self.navigation.tolist(), f"must be {n} numbers >= 0")
        if not self.state_names:
            put(self, "state_names", tuple(f"x{i}" for i in range(n)))

    @property
    def n(self) -> int:
        """Number of states."""
        return int(self.A.shape[0])

    @property
    def m(self) -> int:
        """Number of inputs."""
        return int(self.B.shape[1])

    @property
    def p(self) -> int:
        """Number of disturbance channels."""
        return int(self.D.shape[1])

    @property
    def navigation(self) -> Array:
        """Bound on the error of the estimate of every state, shape (n,)."""
        assert self.estimate_error is not None
        return self.estimate_error

    @property
    def measured(self) -> Array:
        """Bounds on the errors of measured states, those of estimates where nothing else is known, (n,)."""
        return np.array(self.timing.measured or self.navigation)

    @property
    def ideal(self) -> bool:
        """Whether laws see the exact state, and what they command is what is applied, without late faults."""
        return self.thrusters.exact and not np.any(self.navigation) and not self.transients

    @property
    def displaced(self) -> Array:
        """How far each state may be from where all sets say it is (`Timing`), shape (n,)."""
        return np.array(self.timing.displaced or np.zeros(self.n))

    @property
    def displaced_at_nodes(self) -> Array:
        """The same at nodes, where pulses displace nothing, shape (n,)."""
        return np.asarray(self.displaced - np.array(self.timing.pulsed or 0.0))

    @cached_property
    def adrift(self) -> Array:
        """Rates of the states by impulses that are carried, and by their errors, as generators (n, ...)."""
        if not self.timing.carried:
            return np.zeros((self.n, 0))
        held = discretize(self.A, self.B, self.timing.period)[1] / self.timing.period
        wrong = [self.thrusters.along * self.B] if self.thrusters.along > 0 else []
        return np.asarray(self.timing.carried * self.A @ np.hstack([held, *wrong]))

    @cached_property
    def carried_away(self) -> Array:
        """Bounds on the displacement of states by carried impulses and errors of them, shape (n,)."""
        if not self.timing.carried:
            return np.zeros(self.n)
        held = discretize(np.abs(self.A), np.abs(self.B), self.timing.period)[1] / self.timing.period
        away = held.sum(axis=1) + self.thrusters.along * np.abs(self.B).sum(axis=1)
        return np.asarray(away * self.timing.carried * (1 + 1e-9))

    @property
    def prompt(self) -> LinearSystem:
        """The same system if commands took effect at once: with the errors of measurements."""
        if self.timing == Timing():
            return self
        own = replace(self.thrusters, bit=self.timing.bit)
        return replace(self, estimate_error=self.measured, thrusters=own, **AT_ONCE)

    def as_ideal(self) -> LinearSystem:
        """The same system without errors of estimates and thrusters, and without faults known late."""
        if self.ideal:
            return self
        return replace(self, estimate_error=None, thrusters=Thrusters(), transients=(), **AT_ONCE)

    def at_step(self, k: int) -> LinearSystem:
        """Return the system with the errors of estimates that there may be in step k."""
        steps = self.error_by_step
        return self if steps is None else self.known_to(steps[min(k, len(steps) - 1)])

    def known_to(self, error: Array) -> LinearSystem:
        """Return the system with errors of estimates, shape (n,), that are those of every step."""
        return replace(self, estimate_error=error, error_by_step=None)

    def estimate_off(self, most: Array | None = None) -> Array:
        """Bounds on the errors of the estimate, shape (..., n).

        `most` (..., m) bounds the commands of the periods before whose errors are not measured yet, if known
        (docs/theory.md, Proposition 7 (b)).
        """
        if most is None or not self.timing.hidden or self.transients:
            return self.navigation if most is None else self.navigation + np.zeros((*most.shape[:-1], 1))
        spare = self.thrusters.part(self.u_max) - self.thrusters.part(np.minimum(most, self.u_max))
        return np.asarray(self.navigation - spare @ np.array(self.timing.unseen).T)

    def input_error(self, gain: Array, most: Array) -> Array:
        """By how much what is applied may differ from what a law, clipped, would command on the exact state.

        Under commands up to `most`, shape (m,). Two clipped commands differ by no more than the commands do
        (docs/theory.md, Proposition 5).
        """
        return np.asarray(np.abs(gain) @ self.navigation + self.thrusters.error(most))

    def spent(self, most: Array) -> Array:
        """Bounds on what is applied, on average over time, under commands up to `most`, shape (..., m)."""
        jitter, h = self.timing.jitter, self.timing.period
        longer = 2 * jitter / h * (1 + WHOLE) if jitter else 0.0  # share of a period that a command may last
        return np.asarray((1 + longer) * (most + self.prompt.thrusters.error(most)))

    def error_map(self, error: Array) -> Array | None:
        """Errors of inputs, and what is carried, as generators of the rate of the states; None for none."""
        parts = [self.B * error] * bool(np.any(error)) + [self.adrift] * bool(self.timing.carried)
        return np.hstack(parts) if parts else None

    @property
    def input_names(self) -> tuple[str, ...]:
        """What messages and figures call the inputs: thrust along Hill's axes, or inputs by number."""
        if self.mean_motion is not None and self.m == 3:
            return tuple(f"{axis} thrust" for axis in HILL_AXES)
        return tuple(f"input {i}" for i in range(self.m))

    @property
    def d(self) -> int:
        """Dimension of position space."""
        return int(self.position.shape[0])

    @property
    def position(self) -> Array:
        """The position selector C, shape (d, n)."""
        assert self.C is not None
        return self.C

    @cached_property
    def velocity(self) -> Array:
        """``C A``, shape (d, n): the rate of the position when ``C B = 0`` (mechanical systems)."""
        return self.position @ self.A

    @cached_property
    def acceleration_input(self) -> Array:
        """How an acceleration of the position enters the state, (n, d): `polaris.model.acceleration`."""
        return acceleration_input(self.A, self.position)

    @classmethod
    def from_statespace(
        cls,
        sys: Any,
        u_max: ArrayLike,
        w_max: float = 0.0,
        D: ArrayLike | None = None,
        *,
        C: ArrayLike,
        **kwargs: Any,
    ) -> LinearSystem:
        """Build from a ``control.StateSpace``: its A and B; D defaults to B's columns, unit scaled.

        Its outputs are what is measured, of any kind, and are not used: ``C`` says what the position is, in
        which unsafe sets lie, shape (d, n) with d = 1, 2 or 3.
        """
        A, B = np.asarray(sys.A, dtype=float), np.asarray(sys.B, dtype=float)
        if getattr(sys, "dt", 0) not in (0, None):
            raise ScenarioError("system", f"discrete time, dt = {sys.dt}", "must be a continuous-time system")
        if C is None:
            raise ScenarioError("system.C", None, "must say which states are the position, one row per axis")
        if D is None:
            D = B / np.maximum(np.linalg.norm(B, axis=0), np.finfo(float).tiny)
        limit = as_finite("system.u_max", u_max, 1)
        return cls(A, B, np.asarray(D, dtype=float), limit, w_max, as_finite("system.C", C, 2), **kwargs)
