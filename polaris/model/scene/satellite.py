"""Another spacecraft: an uncertain state carried by the same dynamics, freely or under bounded thrust."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import expm

from reach.numerics.errors import Unresolved
from reach.numerics.linear import discretize, growth, powers

from ..errors import ScenarioError
from ..keys import STATES, Key, NonNegative, Positive, Vector, WidthVector
from ..system import Array, LinearSystem
from ..tolerances import ROUNDING
from .obstacle import FACETS, NAME, Obstacle, directions
from .shapes import BallShape, PolytopeShape
from .timed_polytope import TimedPolytope

MOST_PARTS = 256  # most parts into which a cell is divided to follow the curved motion


@dataclass(frozen=True, eq=False)
class SatelliteObstacle(Obstacle):
    """Another spacecraft, known within bounds: ``x' = A x + D w`` of the system, plus its own acceleration.

    Parameters
    ----------
    name : str
        Name.
    state : array_like, shape (n,) [m, m/s]
        Estimated state at t = 0.
    state_half_widths : array_like, shape (n,) [m, m/s]
        Error of each state.
    radius : float [m]
        Collision distance from its centre.
    thrust_accel_max : float [m/s^2]
        Bound on the 2-norm of its own acceleration. Its place grows uncertain by about
        ``(thrust_accel_max + disturbance_max) t^2 / 2``, and faster after a tenth of an orbit.
    facets : int, optional
        Facets for the planner: 6, 14, 18 or 26 (default) in space, any number in the plane (default 12).

    Notes
    -----
    The timed polytope holds for every initial state, disturbance and acceleration within their bounds. Runs
    are judged by the true set: the ball about the true centre (given as `state`), or the nominal one.
    """

    name: Annotated[str, NAME]
    state: Annotated[ArrayLike, Key("state", STATES, Vector, "state")]
    state_half_widths: Annotated[ArrayLike, Key("state_half_widths", STATES, WidthVector, "state")]
    radius: Annotated[float, Key("radius_m", "m", Positive)]
    thrust_accel_max: Annotated[float, Key("thrust_accel_max_m_s2", "m/s^2", NonNegative)] = 0.0
    facets: Annotated[int | None, FACETS] = None

    @cached_property
    def _x0(self) -> Array:
        return np.asarray(self.state, dtype=float)

    @cached_property
    def shape(self) -> BallShape:
        """The ball about the true centre."""
        return BallShape(self.radius)

    def _inflated(self, radius: float) -> "SatelliteObstacle":
        return replace(self, radius=self.radius + radius)

    @property
    def drawn(self) -> BallShape:
        """The ball."""
        return self.shape

    def timed_polytopes(self, system: LinearSystem, delta: float, cells: int) -> tuple[TimedPolytope, ...]:
        """One timed polytope; offsets cover all of every cell (docs/theory.md, Lemma 16; see `_cover`)."""
        self._check_cells(system, delta, cells, system.d)
        self._fits(system)
        normals = self._normals(system)
        tolerance, parts, intersample = max(1e-3, 1e-4 * self.radius), 1, np.inf
        rule = f"must stay finite when propagated over {cells * delta:g} s"
        try:
            with np.errstate(over="ignore", invalid="ignore"):
                while not intersample <= tolerance and parts <= MOST_PARTS:
                    offsets, intersample, _ = self._cover(
                        system, normals @ system.position, delta, cells, parts
                    )
                    parts *= 2
        except Unresolved as error:  # beyond floating point
            raise ScenarioError(f"{self.path}.state", self._x0.tolist(), rule) from error
        if not np.all(np.isfinite(offsets)):
            raise ScenarioError(f"{self.path}.state", self._x0.tolist(), rule)
        return (TimedPolytope(self.name, normals, offsets, static=False),)

    def _cover(
        self, system: LinearSystem, rows: Array, delta: float, cells: int, parts: int
    ) -> tuple[Array, float, Array]:
        """Offsets (cells, 2, F) that hold over cells, the largest intersample bound, supports at nodes.

        For a row c (``C' n`` of a facet), the support of the states at t is
        ``c' e^{At} x0 + |c' e^{At}| dx + radius`` and, for every input M with its bound a (`pushes`),
        ``a int_0^t norm(c' e^{As} M) ds``.
        Between nodes h apart, each term is at most its chord plus: ``h^2/8`` times the largest
        second derivative of the (vector inside the) first two; for the integral, whose integrand g
        is at most its own chord plus ``h^2/8 sup norm(v'')``, ``h max(g_j - g_{j+1}, 0)/8`` plus
        what is added to the trapezoid, ``h^3/12 sup norm(v'')``. The cell's two offsets are the
        chord of its nodes, lifted until it is above them all.
        """
        A, h = system.A, delta / parts
        coarse, fine = powers(expm(A * delta), cells - 1), powers(expm(A * h), parts)
        carried = rows @ coarse[:, None] @ fine  # (cells, parts+1, F, n)
        half, exp_bound = np.asarray(self.state_half_widths), growth(A, h)
        middle = carried @ self._x0
        nominal = np.abs((fine @ (coarse @ self._x0)[:, None, :, None])[:, :-1, :, 0])
        curvature = np.abs(carried[:, :-1] @ A @ A) @ exp_bound
        intersample = h**2 / 8 * (curvature @ half + nominal @ (np.abs(rows @ A @ A) @ exp_bound).T)
        node = middle + np.abs(carried) @ half + self.radius
        size = np.abs(carried) @ (np.abs(self._x0) + half) + self.radius
        for M, accel in self.pushes(system):
            rate = accel * np.linalg.norm(carried @ M, axis=-1)
            excess = h**3 / 12 * accel * np.linalg.norm(curvature @ np.abs(M), axis=-1)
            each = (h / 2 * (rate[:, :-1] + rate[:, 1:]) + excess).reshape(-1, len(rows))
            integral = np.vstack([np.zeros(len(rows)), np.cumsum(each, axis=0)])
            steps = np.arange(cells)[:, None] * parts + np.arange(parts + 1)
            node = node + integral[steps]
            size = size + integral[steps]
            intersample = intersample + h / 8 * np.maximum(rate[:, :-1] - rate[:, 1:], 0.0) + excess
        node = node + ROUNDING * size
        lifted = node.copy()
        lifted[:, :-1] += intersample
        lifted[:, 1:] = np.maximum(lifted[:, 1:], node[:, 1:] + intersample)
        s = np.linspace(0.0, 1.0, parts + 1)[:, None]
        chord = lifted[:, :1] * (1 - s) + lifted[:, -1:] * s
        lift = np.maximum((lifted - chord).max(axis=1), 0.0)
        return (
            np.stack([lifted[:, 0] + lift, lifted[:, -1] + lift], axis=1),
            float(intersample.max()),
            node[:, 0],
        )

    def state_boxes(self, system: LinearSystem, h: float, count: int) -> tuple[Array, Array]:
        """Box of position [m] and velocity [m/s] every h [s]: middle and half-widths, (count, 2d)."""
        rows = np.vstack([system.position, system.velocity])
        reach = self._cover(system, np.vstack([rows, -rows]), h, count, 1)[2] - self.radius
        high, low = reach[:, : len(rows)], -reach[:, len(rows) :]
        return (high + low) / 2, (high - low) / 2

    def pushes(self, system: LinearSystem) -> tuple[tuple[Array, float], ...]:
        """Inputs that move it, each with the bound on its 2-norm: the disturbance, and its own thrust.

        Raises
        ------
        ScenarioError
            If it has thrust, but the system no acceleration of the position.
        """
        pushes = [(system.D, system.w_max)] if system.w_max > 0 else []
        pushes += [(column[:, None], 1.0) for column in system.biases.T]  # one of its own, or the chaser's
        if self.thrust_accel_max > 0:
            try:
                pushes.append((system.acceleration_input, self.thrust_accel_max))
            except ScenarioError as error:
                rule = f"must be 0 in this system: the position {error.rule}"
                raise ScenarioError(f"{self.path}.thrust_accel_max", self.thrust_accel_max, rule) from error
        return tuple(pushes)

    def nominal(self, t: ArrayLike, system: LinearSystem) -> Array:
        """Undisturbed state at times t [s], shape (..., n)."""
        self._fits(system)
        return free_motion(system.A, self._x0, np.asarray(t, dtype=float))

    def motion(
        self, t: ArrayLike, system: LinearSystem | None = None, state: ArrayLike | None = None
    ) -> tuple[Array, Array]:
        """Position [m] and velocity [m/s]: of the true `state` (..., n) if given, else of the nominal one."""
        states, system = self._require_inputs(t, system, state)
        return np.asarray(states @ system.position.T), np.asarray(states @ system.velocity.T)

    def relative_drift(
        self, t: ArrayLike, x: Array, system: LinearSystem, state: ArrayLike | None = None
    ) -> tuple[Array, Array, Array]:
        """Return the relative state: both drift under the same dynamics, so their difference does."""
        states, _ = self._require_inputs(t, system, state)
        zero = np.zeros(system.d)
        return x - states, zero, zero

    def outline(self, t: float, system: LinearSystem) -> Array:
        """Vertices [m] of the over-approximating polytope at time t, shape (V, d)."""
        self._fits(system)
        normals = self._normals(system)
        rows = normals @ system.position
        if t > 0:
            return PolytopeShape(normals, self._cover(system, rows, t, 1, 64)[0][0, 1]).vertices()
        spread = np.abs(rows) @ np.asarray(self.state_half_widths)
        return PolytopeShape(normals, rows @ self._x0 + spread + self.radius).vertices()

    def _normals(self, system: LinearSystem) -> Array:
        return directions(system.d, self.facets, f"{self.path}.facets")

    def _require_inputs(
        self, t: ArrayLike, system: LinearSystem | None, state: ArrayLike | None
    ) -> tuple[Array, LinearSystem]:
        if system is None:
            raise ScenarioError(f"{self.path}.system", None, "must be given to propagate another satellite")
        if state is None:
            return self.nominal(t, system), system
        states = np.asarray(state, dtype=float)
        if states.ndim == 0 or states.shape[-1] != system.n or not np.all(np.isfinite(states)):
            rule = f"must be finite, its last axis the {system.n} states of the system"
            raise ScenarioError(f"{self.path}.state", states.shape, rule)
        return states, system

    def _fits(self, system: LinearSystem) -> None:
        if len(self._x0) != system.n:
            rule = f"must be {system.n} numbers, as the system has states"
            raise ScenarioError(f"{self.path}.state", self._x0.tolist(), rule)


def free_motion(A: Array, x0: Array, t: Array) -> Array:
    """Return ``e^{A t} x0`` for many times t [s], any shape; shape (..., n).

    From the nearest of a few exact nodes, a quarter of the fastest time constant apart or less, by
    a Taylor series to round-off.
    """
    flat = t.reshape(-1)
    if not np.all(np.isfinite(flat)):
        raise ScenarioError("t", "nan or inf", "must be finite numbers [s]")
    if flat.size == 0:
        return np.empty((*t.shape, len(x0)))
    low, span = float(flat.min()), float(np.ptp(flat))
    fastest = float(np.max(np.abs(np.linalg.eigvals(A))))
    count = int(np.clip(np.ceil(span * fastest / 0.25), 1, 100_000))
    h = span / count
    nodes = powers(expm(A * h), count) @ (expm(A * low) @ x0)
    index = np.minimum(((flat - low) / h).astype(int), count) if span > 0 else np.zeros(flat.size, dtype=int)
    elapsed = (flat - low - index * h)[:, None]
    total = nodes[index]
    term = total
    for k in range(1, 100):
        term = term @ A.T * (elapsed / k)
        total = total + term
        if not np.abs(term).max() > 1e-17 * np.abs(total).max():
            break
    return np.asarray(total.reshape(*t.shape, len(x0)))


def true_states(
    obstacles: Sequence[Obstacle], system: LinearSystem, times: Array, runs: int, rng: np.random.Generator
) -> dict[str, Array]:
    """States of other satellites within their declared errors, by name, shape (R, N+1, n).

    Half of the runs start them in corners of the known box and give them their largest
    acceleration; it is constant in each run, and so is a disturbance that pushes them the same way.
    """
    out: dict[str, Array] = {}
    h = float(times[1] - times[0])
    for satellite in (o for o in obstacles if isinstance(o, SatelliteObstacle)):
        spread = rng.uniform(-1.0, 1.0, (runs, system.n))
        spread[: runs - runs // 2] = np.where(spread[: runs - runs // 2] < 0, -1.0, 1.0)
        x0 = np.asarray(satellite.state) + spread * np.asarray(satellite.state_half_widths)
        direction = rng.normal(size=(runs, system.d))
        share = np.ones((runs, 1))
        share[runs - runs // 2 :] = rng.random((runs // 2, 1))
        free = powers(discretize(system.A, system.D, h)[0], len(times) - 1)
        states = np.einsum("tij,rj->rti", free, x0)
        for M, bound in satellite.pushes(system):
            # What accelerates the position in that direction; any input, if none accelerates it at once.
            push = direction @ system.velocity @ M
            idle = np.linalg.norm(push, axis=1) == 0
            push[idle] = rng.normal(size=(int(idle.sum()), push.shape[1]))
            push *= bound * share / np.linalg.norm(push, axis=1, keepdims=True)
            Bd = discretize(system.A, M, h)[1]
            forced = np.concatenate([np.zeros((1, *Bd.shape)), np.cumsum(free[:-1] @ Bd, axis=0)])
            states = states + np.einsum("tij,rj->rti", forced, push)
        out[satellite.name] = states
    return out
