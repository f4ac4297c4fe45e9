"""The simplex architecture: U until the first sign of danger, then S for good (latched)."""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..model.system import Array
from .method import Choice, Claim, Seen
from .prospect import Leg, Prospect
from .recovery import Recovery
from .scene import Scene


class Latched(ABC):
    """U as long as `margin` has never been negative; then S to the end."""

    reasons: tuple[str, ...] = ("inside", "leaving", "latched in S")
    delayed = True

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self._latched: NDArray[np.bool_] = np.zeros(0, dtype=bool)

    def start(self, runs: int) -> None:
        """Nobody is latched."""
        self._latched = np.zeros(runs, dtype=bool)

    @abstractmethod
    def margin(self, seen: Seen) -> Array:
        """What is judged by, shape (R,)."""

    def decide(self, seen: Seen) -> Choice:
        """Switch once."""
        margin = self.margin(seen)
        leaving = ~(margin >= 0)  # what cannot be worked out is not inside
        why = np.where(self._latched, 2, np.where(leaving, 1, 0))
        self._latched = self._latched | leaving
        return Choice(np.where(self._latched, 0, 1), margin, why)


class ExplicitSimplex(Latched):
    """Explicit simplex: the region is written down beforehand, a ball of the tracker's norm per instant.

    U flies as long as everything it can reach until the next decision takes effect, at its thrust limits,
    lies in the largest ball inside the recoverable set there.

    Parameters
    ----------
    scene : Scene

    Raises
    ------
    NotCertified
        If the initial set is not inside the first recoverable set.
    """

    key = "simplex_explicit"
    name = "Explicit simplex"

    def __init__(self, scene: Scene) -> None:
        super().__init__(scene)
        self.recovery = Recovery.certified(scene)
        leg = Leg.any_thrust(self.recovery)
        self.prospect = Prospect(self.recovery, leg if scene.delay else None, leg, scene.half_widths)

    @cached_property
    def radii(self) -> Array:
        """Radius of the ball at the moment after each decision, shape (D,)."""
        scene, recovery = self.scene, self.recovery
        demand = recovery.demand(np.zeros((scene.system.n, 1)))
        size = np.linalg.norm(demand.tall[:, : scene.system.n] @ scene.tracking.W_inverse, axis=1)
        slope = size * (1 + 1e-9) + demand.tall[:, scene.system.n]
        out = np.empty(scene.decisions)
        for k in range(scene.decisions):
            node = k * scene.nodes + scene.delay + scene.nodes
            if node > scene.last:
                out[k] = -np.inf
                continue
            window = recovery.window(node)
            limit = np.divide(1.0, window, out=np.full(len(window), np.inf), where=window > 0)
            out[k] = min(float(((limit - demand.tall[:, -1]) / slope).min()), recovery.far(node))
        return out

    @property
    def claim(self) -> Claim:
        """Proved, as the online monitor is: balls inside its sets."""
        end = self.scene.schedule.safety.end.reason
        return Claim("proved", f"state estimate within its error bound, U within the thrust limits; {end}")

    def margin(self, seen: Seen) -> Array:
        """Share of the radius left."""
        e = seen.estimate - self.scene.xi[seen.k * self.scene.nodes]
        radius = self.radii[seen.k]
        size = self.prospect.size(seen.k, e)
        left = 1 - size / radius if radius > 0 else np.full(len(e), -np.inf)
        if self.prospect.inner:  # the ball is that of the last node; facets count at those before too
            left = np.minimum(left, 1 - self.prospect.share(seen.k, e)[0])
        return np.asarray(left)


class ImplicitSimplex(Latched):
    """Implicit simplex: S is flown, in prediction, from where U would be at the next decision.

    U flies as long as that undisturbed flight keeps clear of the perceived unsafe sets and within the
    thrust limits.

    Parameters
    ----------
    scene : Scene
    """

    key = "simplex_implicit"
    name = "Implicit simplex"

    def __init__(self, scene: Scene) -> None:
        super().__init__(scene)
        tracking, system = scene.tracking, scene.system
        normals, offsets, _ = scene.facets
        self.lags = len(tracking.transitions)
        facets = normals @ system.position
        self.facets = (facets @ tracking.transitions).reshape(-1, system.n).T.copy()
        self.thrust = (tracking.gain @ tracking.transitions).reshape(-1, system.n).T.copy()
        # Of the reference itself; beyond the end of the tail the last instant counts.
        pad = [(0, self.lags), (0, 0)]
        self.clear = np.pad(scene.xi @ facets.T - offsets, pad, mode="edge")
        self.mu = np.pad(scene.mu, [(0, self.lags + 1), (0, 0)])

    @property
    def claim(self) -> Claim:
        """None: one undisturbed flight per decision."""
        span = self.lags * self.scene.h
        return Claim("none", f"one undisturbed flight of S over {span:g} s; disturbances are ignored")

    def margin(self, seen: Seen) -> Array:
        """Least distance of the predicted flight [m]; -inf where S would ask for too much thrust."""
        scene, x = self.scene, seen.estimate
        node = seen.k * scene.nodes
        if node + scene.nodes + scene.delay > scene.last:
            return np.full(len(x), -np.inf)
        Ad, Bd, _ = scene.held
        for _ in range(scene.nodes + scene.delay):
            x = x @ Ad.T + scene.clipped(1, node, x) @ Bd.T
            node += 1
        e = x - scene.xi[node]
        window = slice(node, node + self.lags)
        room = scene.nearest((e @ self.facets).reshape(len(x), self.lags, -1) + self.clear[window])
        command = self.mu[window].reshape(-1) - e @ self.thrust
        strained = np.abs(command) > np.tile(scene.system.u_max, self.lags)
        return np.where(strained.any(axis=1), -np.inf, room.min(axis=1))
