"""The linear control system of section II: ``x' = A x + B u + D w`` with its bounds."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from reach.short_repr import short_repr

from .errors import ScenarioError

Array = NDArray[np.float64]

ZERO = 1e-12  # share of the terms of an entry of C A below which it counts as zero

HILL_AXES = ("radial", "along-track", "cross-track")  # of position, velocity and thrust, in this order


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


@short_repr
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
    bias_max : array_like, shape (p,), optional
        Bounds on a constant, one of each column of D, that adds to w in a whole flight.

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
    bias_max: Array | None = None

    def __post_init__(self) -> None:
        assign = object.__setattr__
        for name in ("A", "B", "D"):
            assign(self, name, as_finite(f"system.{name}", getattr(self, name), 2))
        n = self.A.shape[0]
        if self.A.shape != (n, n):
            raise ScenarioError("system.A", self.A.shape, "must be square")
        for name in ("B", "D"):
            matrix = getattr(self, name)
            if matrix.shape[0] != n or matrix.shape[1] == 0:
                rule = f"must have {n} rows, as A has, and at least one column"
                raise ScenarioError(f"system.{name}", matrix.shape, rule)
        assign(self, "u_max", as_finite("system.u_max", self.u_max, 1))
        if self.u_max.shape != (self.m,) or np.any(self.u_max <= 0):
            raise ScenarioError("system.u_max", self.u_max.tolist(), f"must be {self.m} positive numbers")
        for name, least in (("w_max", ">="), ("mass", ">"), ("mean_motion", ">")):
            if name == "mean_motion" and self.mean_motion is None:
                continue
            value = float(as_finite(f"system.{name}", getattr(self, name), 0))
            if value < 0 or (value == 0 and least == ">"):
                raise ScenarioError(f"system.{name}", value, f"must be a finite number {least} 0")
            assign(self, name, value)
        bias = np.zeros(self.p) if self.bias_max is None else self.bias_max
        assign(self, "bias_max", as_finite("system.bias_max", bias, 1))
        if self.bias.shape != (self.p,) or np.any(self.bias < 0):
            raise ScenarioError("system.bias_max", self.bias.tolist(), f"must be {self.p} numbers >= 0")
        C = np.eye(n)[: max(n // 2, 1)] if self.C is None else self.C
        assign(self, "C", as_finite("system.C", C, 2))
        if self.position.shape[1] != n or not 1 <= self.position.shape[0] <= 3:
            raise ScenarioError("system.C", self.position.shape, f"must be (d, {n}) with d = 1, 2 or 3")
        if not self.state_names:
            assign(self, "state_names", tuple(f"x{i}" for i in range(n)))

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
    def bias(self) -> Array:
        """Bounds on the constant that adds to w, shape (p,)."""
        assert self.bias_max is not None
        return self.bias_max

    @property
    def biases(self) -> Array:
        """Columns of D times the bounds of the constant, those that are not 0, shape (n, k)."""
        return np.asarray((self.D * self.bias)[:, self.bias > 0])

    @property
    def unbiased(self) -> Self:
        """Return the system with the constant counted in the arbitrary disturbance."""
        more = float(np.linalg.norm(self.bias))
        return replace(self, w_max=self.w_max + more, bias_max=None) if more else self

    @property
    def input_names(self) -> tuple[str, ...]:
        """Names of the inputs in messages and figures: thrust along Hill's axes, or inputs by number."""
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
        """Map from an acceleration of the position to the rate of the state, (n, d)."""
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


def acceleration_input(state: Array, position: Array) -> Array:
    """Return the map E of an acceleration [m/s^2] into the state, ``C E = 0`` and ``C A E = I``.

    Shape (n, d). Decided in exact arithmetic, and the same for the motion of the position whichever
    solution E is.

    Raises
    ------
    ScenarioError
        If the position does not obey an equation of second order, ``p'' = f(p, p') + a``: its rate is
        no free part of the state (first order), or its acceleration depends on more than position
        and rate (third order and higher).
    """
    from flint import fmpq_mat

    A, C, rows = _exact(state), _exact(position), position.tolist()
    outputs = fmpq_mat(C.tolist() + (C * A).tolist())
    gram, reaction = outputs * outputs.transpose(), C * A * A
    if gram.det() == 0:
        rule = "has no acceleration: the rate of the position, C A x, is no free part of the state"
        raise ScenarioError("system.C", rows, rule)
    inverse = outputs.transpose() * gram.inv()  # its last d columns are the least E
    if reaction * inverse * outputs != reaction:
        rule = "has an acceleration that depends on more states than the position and its rate"
        raise ScenarioError("system.C", rows, rule)
    try:
        E = [[int(x.p) / int(x.q) for x in row[len(rows) :]] for row in inverse.tolist()]
    except OverflowError as error:
        rule = "has a rate too small to compute with: an acceleration would move states without bound"
        raise ScenarioError("system.C", rows, rule) from error
    return np.array(E)


def _exact(M: Array) -> Any:
    """A matrix of rationals: whether a position has an acceleration must not depend on rounding."""
    from flint import fmpq, fmpq_mat

    return fmpq_mat([[fmpq(*x.as_integer_ratio()) for x in row] for row in M.tolist()])


def velocities(A: Array, C: Array) -> Array:
    """Return the rate of the position [m/s] that a unit of each velocity makes, shape (d, n).

    Velocities are the states in ``C A`` that are no part of the position; of all others the rate is 0.
    """
    moves = (np.abs(C @ A) > ZERO * (np.abs(C) @ np.abs(A))) & ~np.any(C != 0, axis=0)
    return np.where(moves, C @ A, 0.0)


def speeds(A: Array, C: Array) -> Array:
    """Return the speed of the position [m/s] that a unit of each velocity makes, 0 of other states, (n,)."""
    return np.asarray(np.linalg.norm(velocities(A, C), axis=0))
