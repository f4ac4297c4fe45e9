"""Explicit ASIF: control barrier functions of the scene's obstacles, at rest or moving.

For every unsafe set one barrier: the closing speed must not exceed that from which full thrust can brake,
``h = d' + s(d)`` with ``s(d) = sqrt(2 a d)`` but for a smooth layer at d = 0. For a ball d is the distance to
it; for any other set, and for what perception says of satellites, that to the facet with the largest h. The
filtered input is the nearest to the desired one with ``h' >= -alpha h`` for every set, the worst disturbance
and errors of thrusters included. Where inputs move the position at once, ``h = d``.
"""

from functools import partial

import numpy as np

from ...model.checks import positive
from ...model.errors import ScenarioError
from ...model.scene.obstacles import BallObstacle
from ...model.system import Array
from ..decision_grid import DecisionGrid
from ..method import BUFFER, FILTERED, Choice, Method, Observation, Option
from ..projection import FILTERED as SOLVED
from ..projection import project

SLOPE = 10.0
"""Slope of the class-K function, per duration of the flight: chosen by ``benchmarks/comparison.py``."""

UNCHANGED = 1e-9  # share of the thrust limits by which an input may differ and still count as the desired one


class ExplicitASIF(Method):
    """The filter; its class-K function has the slope `alpha` [1/s], by default `SLOPE` per flight's duration.

    `ScenarioError` if the thrust cannot brake along some facet, or it takes more than two derivatives of the
    position to meet the input.
    """

    key, name, place = "asif_explicit", "Explicit ASIF", 7
    how = "nearest input by barrier functions of every obstacle (speed from which full thrust can brake)"
    options = (
        Option(
            "alpha",
            "share by which a barrier may fall per second [1/s]",
            f"{SLOPE:g} per duration of the flight",
            (2, 5, 10, 20, 50, 200, 1000),
            "per duration",
            partial(positive, unit="1/s"),
        ),
        BUFFER,
    )
    reasons = ("desired input", "filtered", "no input satisfies all conditions: S")

    def __init__(self, grid: DecisionGrid, alpha: float | None = None, buffer: float | None = None) -> None:
        super().__init__(grid, buffer)
        grid = self.grid
        duration = grid.last * grid.h
        self.alpha = SLOPE / duration if alpha is None else self.options[0].check("alpha", alpha)
        self.settings["alpha"] = self.alpha
        system = grid.system
        C, A = system.position, system.A
        self.direct = bool(np.any(C @ system.B))
        rate = C if self.direct else C @ A
        self.push, self.kick, self.drift = rate @ system.B, rate @ system.D, rate @ A
        self.error = system.thrusters.error(system.u_max)
        if not np.any(self.push):
            rule = "needs inputs that accelerate the position, not only its third derivative"
            raise ScenarioError("method", self.key, rule)
        if states := [u.name for u in grid.unsafe if u.of_state]:
            rule = f"needs sets of positions only, and {states[0]} limits the whole state"
            raise ScenarioError("method", self.key, rule)
        self.balls = [o for o in grid.schedule.safety.problem.unsafe if isinstance(o, BallObstacle)]
        drift_max = float(np.abs(grid.xi @ self.drift.T).max(initial=0.0))
        parts = np.split(grid.facets[1], grid.facets[2][1:], axis=1)
        ball_names = {ball.name for ball in self.balls}
        # Normals, offsets at every node, and how hard full thrust brakes along the normals.
        self.walls = [
            (u.normals, offsets, self._brake(u.name, u.normals, drift_max))
            for u, offsets in zip(grid.unsafe, parts, strict=False)
            if u.name not in ball_names
        ]
        # A ball must be met also where the thrusters push least: along an axis or the diagonal.
        d = system.d
        directions = np.vstack([np.eye(d), np.ones((1, d)) / np.sqrt(d)])
        self.ball_brake = self._brake("balls", directions, drift_max).min() if self.balls else 0.0

    def _brake(self, name: str, normals: Array, span: float) -> Array:
        """Deceleration [m/s^2] by full thrust along normals (F, d), against drift and disturbance."""
        system = self.grid.system
        braking = np.abs(normals @ self.push) @ (system.u_max - self.error) - span
        braking -= np.linalg.norm(normals @ self.kick, axis=1) * system.unbiased.w_max
        if np.any(braking <= 0) and not self.direct:
            raise ScenarioError("method", self.key, f"full thrust must brake before every side of {name}")
        return np.asarray(braking)

    @property
    def reach(self) -> str:
        """Conditions at the decisions only, and programs that may have no solution."""
        return (
            f"barrier conditions hold at the instants of decision, every {self.grid.period:g} s, if the"
            " programs have solutions; neither is proven"
        )

    def decide(self, observed: Observation) -> Choice:
        """Solve one program for every run."""
        x, grid = observed.estimate, self.grid
        R = len(x)
        if not grid.unsafe:
            return Choice(np.full(R, FILTERED), np.full(R, np.inf), np.zeros(R, dtype=int), observed.desired)
        node = observed.k * grid.nodes
        p, v = x @ grid.system.position.T, x @ grid.system.velocity.T
        conditions = [self._facets(*wall, node, x, p, v) for wall in self.walls]
        conditions += [self._ball(ball, node, x, p, v) for ball in self.balls]
        h, rows, bound = (np.stack(part, axis=1) for part in zip(*conditions, strict=True))
        rows = rows * grid.system.u_max
        answer = project(rows, bound, observed.desired / grid.system.u_max, 1.0)
        unsolved = answer.status > SOLVED
        u = np.where(unsolved[:, None], 0.0, answer.u) * grid.system.u_max
        return Choice(
            np.where(unsolved, 0, FILTERED),
            h.min(axis=1),
            np.where(unsolved, 2, (np.abs(u - observed.desired) > UNCHANGED * grid.system.u_max).any(axis=1)),
            u,
        )

    def _facets(
        self, normals: Array, offsets: Array, brakes: Array, node: int, x: Array, p: Array, v: Array
    ) -> tuple[Array, Array, Array]:
        """Barrier (R,), row (R, m) and bound (R,) of one polytope: of its facet with the largest barrier."""
        offset, following = offsets[node], offsets[min(node + 1, len(offsets) - 1)]
        speed = (following - offset) / self.grid.h
        d = p @ normals.T - offset - np.abs(normals @ self.grid.system.position) @ self.grid.half_widths
        error = np.abs(normals @ self.grid.system.velocity) @ self.grid.half_widths
        closing = v @ normals.T - speed - (0.0 if self.direct else error)
        allowed, slope = self._allowed(d, brakes)
        h = d if self.direct else closing + allowed
        facet = h.argmax(axis=1)
        run = np.arange(len(x))
        change = -speed[facet] if self.direct else slope[run, facet] * closing[run, facet]
        return self._condition(x, normals[facet], h[run, facet], change)

    def _ball(
        self, ball: BallObstacle, node: int, x: Array, p: Array, v: Array
    ) -> tuple[Array, Array, Array]:
        """Barrier (R,), row (R, m) and bound (R,) of one ball."""
        system, half = self.grid.system, self.grid.half_widths
        t = node * self.grid.h
        centre, velocity = ball.motion(t)
        offset = p - centre
        distance = np.maximum(np.linalg.norm(offset, axis=1), 1e-9)
        normal = offset / distance[:, None]
        relative = v - velocity
        d = distance - ball.radius - self.buffer - np.linalg.norm(np.abs(system.position) @ half)
        closing = (relative * normal).sum(axis=1)
        if self.direct:
            return self._condition(x, normal, d, -(normal * velocity).sum(axis=1))
        closing = closing - np.linalg.norm(np.abs(system.velocity) @ half)
        allowed, slope = self._allowed(d, np.array(self.ball_brake))
        turning = ((relative**2).sum(axis=1) - (relative * normal).sum(axis=1) ** 2) / distance
        return self._condition(x, normal, closing + allowed, turning + slope * closing)

    def _condition(self, x: Array, normal: Array, h: Array, change: Array) -> tuple[Array, Array, Array]:
        """Barrier, row and bound, from the rate of h along a normal but for input, drift and disturbance."""
        rate = ((x @ self.drift.T) * normal).sum(axis=1)
        rate -= np.linalg.norm(normal @ self.kick, axis=1) * self.grid.system.unbiased.w_max
        rate -= np.abs(normal @ self.push) @ self.error
        return h, normal @ self.push, -self.alpha * h - (rate + change)

    def _allowed(self, d: Array, brake: Array) -> tuple[Array, Array]:
        """Closing speed from which braking ends in time, and its slope; half a linear layer is spare."""
        depth = 4 * np.maximum(brake, 1e-300) * self.grid.period**2
        d = d - depth / 2
        root = np.sqrt(2 * brake * np.maximum(d - depth / 2, depth / 2))
        steep = np.sqrt(brake / depth)
        thick = d > depth
        return np.where(thick, root, steep * d), np.where(thick, brake / np.maximum(root, 1e-300), steep)
