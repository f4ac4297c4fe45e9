"""Plain look-ahead: predict U for a while, and let it fly if the prediction keeps clear.

Neither method asks whether S could still take over when the prediction turns bad: that is what they are
here to show.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..model.checks import positive
from ..model.system import Array
from ..synthesis.controllers import AffineController
from .method import Choice, Claim, Memoryless, Seen, accept
from .scene import Scene


@dataclass(frozen=True, eq=False)
class Predictor:
    """Undisturbed flight of one controller from measured states, on every `stride`-th node.

    Parameters
    ----------
    scene : Scene
    horizon : float
        How far it looks [s].
    """

    scene: Scene
    horizon: float

    @cached_property
    def stride(self) -> int:
        """Nodes per step: a tenth of the fastest time constant, at least one."""
        fastest = self.scene.fastest
        if self.scene.tracking.feedback.sampled or fastest == 0:
            return 1
        return max(int(0.1 / fastest / self.scene.h), 1)

    @property
    def count(self) -> int:
        """Number of steps."""
        return max(int(np.ceil(self.horizon / (self.stride * self.scene.h))), 1)

    @cached_property
    def _held(self) -> tuple[Array, Array]:
        Ad, Bd, _ = self.scene.held
        phi, gamma = np.eye(len(Ad)), np.zeros_like(Bd)
        for _ in range(self.stride):
            phi, gamma = Ad @ phi, Ad @ gamma + Bd
        return phi, gamma

    def step(self, mode: int, node: int, x: Array) -> Array:
        """States a step later, the clipped command of the middle held: second order in the step."""
        phi, gamma = self._held
        u = self.scene.clipped(mode, node, x)
        if not self.scene.tracking.feedback.sampled:
            after = min(node + self.stride, self._limit(mode))
            u = (u + self.scene.clipped(mode, after, x @ phi.T + u @ gamma.T)) / 2
        return np.asarray(x @ phi.T + u @ gamma.T)

    def _limit(self, mode: int) -> int:
        return len(self.scene.own[mode]) - 1 if mode in self.scene.own else len(self.scene.xi) - 1

    def room(self, mode: int, node: int, x: Array, spread: Array | None = None) -> Array:
        """Least distance [m] of the predicted positions to the perceived unsafe sets, (R,).

        Parameters
        ----------
        mode : int
        node : int
            Where the states x (R, n) are.
        spread : ndarray, shape (count + 1, F), optional
            What reachable sets about the prediction add along every facet.
        """
        least = self.facet_room(node, x, None if spread is None else spread[0])
        for i in range(1, self.count + 1):
            if node + self.stride > self._limit(mode):
                break
            x = self.step(mode, node, x)
            node += self.stride
            least = np.minimum(least, self.facet_room(node, x, None if spread is None else spread[i]))
        return least

    def facet_room(self, node: int, x: Array, spread: Array | None = None) -> Array:
        """Distance to the nearest perceived unsafe set at a node, by its farthest facet, (R,)."""
        normals, offsets, _ = self.scene.facets
        out = x @ (normals @ self.scene.system.position).T - offsets[node]
        return self.scene.nearest(out if spread is None else out - spread)


LEAST = 20
"""Decisions that are looked ahead at least."""


class Simulation(Memoryless):
    """Single-trajectory simulation: U flies if its undisturbed flight from the measured state keeps clear.

    Parameters
    ----------
    scene : Scene
    horizon : float, optional
        How far it looks [s]; default `ahead` of the flight's duration, at least `LEAST` decisions.
    """

    key = "simulation"
    name = "Look-ahead by simulation"
    reasons: tuple[str, ...] = (
        "the predicted flight keeps clear",
        "the predicted flight enters an unsafe set",
    )
    ahead = 0.4
    """Share of the duration looked ahead by default: chosen by ``benchmarks/comparison.py``."""

    def __init__(self, scene: Scene, horizon: float | None = None) -> None:
        super().__init__(scene)
        usual = max(self.ahead * scene.last * scene.h, LEAST * scene.period)
        horizon = usual if horizon is None else positive("horizon", horizon, "s")
        self.settings = {"horizon": horizon}
        self.predictor = Predictor(scene, horizon)
        self.spread: Array | None = None

    @property
    def claim(self) -> Claim:
        """None."""
        return Claim(
            "none",
            f"one undisturbed flight of U over {self.predictor.horizon:g} s; nothing says that S can still"
            " take over at its end, or under disturbances",
        )

    def decide(self, seen: Seen) -> Choice:
        """Predict, and look at the least distance [m]."""
        room = self.predictor.room(1, seen.k * self.scene.nodes, seen.estimate, self.spread)
        return accept(room > 0, room)


class ForwardReachability(Simulation):
    """Naive forward reachability: U flies if its reachable set over a while keeps clear.

    The set is that of U's unclipped law about its clipped prediction, for every measured state within
    the error bound and every disturbance.

    Parameters
    ----------
    scene : Scene
    horizon : float, optional
        How far it looks [s]; default `ahead` of the flight's duration, at least `LEAST` decisions.
    """

    key = "reachability"
    name = "Forward reachability of U"
    reasons: tuple[str, ...] = ("U's reachable set keeps clear", "U's reachable set touches an unsafe set")
    ahead = 0.2

    def __init__(self, scene: Scene, horizon: float | None = None) -> None:
        super().__init__(scene, horizon)
        self.spread = self._spread()

    def _spread(self) -> Array:
        """Support of the sets about the prediction along every facet, shape (count + 1, F)."""
        scene, predictor = self.scene, self.predictor
        law = scene.controllers[1]
        gain = law.gain if isinstance(law, AffineController) else np.zeros((scene.system.m, scene.system.n))
        flow = scene.tracking.feedback.flow(scene.system, gain, scene.tracking.delta)
        rows, out = scene.facets[0] @ scene.system.position, []
        added = np.zeros(len(rows))
        for _ in range(predictor.count + 1):
            out.append(np.abs(rows) @ scene.half_widths + added)
            for _ in range(predictor.stride):
                added = added + np.abs(rows @ flow.period_zonotope.G).sum(axis=1)
                rows = rows @ flow.phi
        return np.array(out)

    @property
    def claim(self) -> Claim:
        """None."""
        return Claim(
            "none",
            f"U's reachable set over {self.predictor.horizon:g} s; nothing says that S can still take over"
            " where that set ends, or once it touches an unsafe set",
        )
