"""Tube of a hybrid automaton and its segments: stretches of one mode from many start sets."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..numerics.checks import Array, Index
from ..numerics.errors import ReachError
from ..sets.clipping import clip, strips
from ..sets.zonotope import Zonotope
from ..short_repr import short_repr
from ..tubes.flowpipes import Flowpipes
from .automaton import Mode


@short_repr
@dataclass(frozen=True, eq=False)
class Segment:
    """One mode, followed from a stack of N start sets over K time steps.

    Attributes
    ----------
    mode : Mode
    flowpipes : Flowpipes
        Bounds and sets over the steps, at times since the mode was entered.
    entered : ndarray, shape (N, 2)
        Absolute times between which start set i is entered.
    alive : ndarray of bool, shape (K, N)
        True if a trajectory of start i can still be in this mode during step k.
    depth : int
        Transitions taken before.
    """

    mode: Mode
    flowpipes: Flowpipes
    entered: Array
    alive: NDArray[np.bool_]
    depth: int

    @property
    def steps(self) -> tuple[Index, Index]:
        """Indices (k, i) of live segments, each of shape (M,)."""
        k, i = np.nonzero(self.alive)
        return k, i

    def span(self, k: Index, i: Index) -> Array:
        """Absolute times that steps k of starts i may cover, shape (len(k), 2)."""
        low = self.entered[i, 0] + self.flowpipes.times[k]
        return np.stack([low, self.entered[i, 1] + self.flowpipes.times[k + 1]], axis=-1)

    @property
    def intervals(self) -> tuple[Array, Zonotope]:
        """Absolute times (M, 2) and zonotopes, batch (M,): every trajectory is inside.

        They hold ``x(t)`` at every time t a trajectory spends in this mode, cut by the invariant.
        """
        k, i = self.steps
        sets, meets = self.cut(k, i)
        return self.span(k, i)[meets], sets[meets]

    def cut(self, k: Index, i: Index) -> tuple[Zonotope, NDArray[np.bool_]]:
        """Sets over steps k of starts i, cut by the invariant, and whether anything is left of each."""
        return clip(self.flowpipes.sets(k, i), *strips([self.mode.invariant], self.mode.system.dim))

    def support(self, directions: ArrayLike) -> Array:
        """Upper bound of each direction over the whole segment, shape (r,); -inf if it is empty."""
        values = self.flowpipes.support(np.atleast_2d(np.asarray(directions, dtype=float)))
        return np.asarray(np.where(self.alive[..., None], values, -np.inf).max(axis=(0, 1)))


@short_repr
@dataclass(frozen=True, eq=False)
class HybridTube:
    """Segments that together hold every trajectory up to the horizon.

    Attributes
    ----------
    segments : tuple of Segment
    horizon : float
    complete : bool
        False if the limit on jumps cut something off: then later motion is missing.
    """

    segments: tuple[Segment, ...]
    horizon: float
    complete: bool

    def in_mode(self, mode: str) -> list[Segment]:
        """Segments of one mode."""
        return [s for s in self.segments if s.mode.name == mode]

    def at(self, t: float) -> list[tuple[str, Zonotope]]:
        """Modes and stacks of zonotopes that hold the state at a time, one entry per segment.

        Raises
        ------
        ReachError
            If the time lies outside the horizon.
        """
        if not 0 <= t <= self.horizon:
            raise ReachError(f"the time must lie in [0, {self.horizon:g}], got {t!r}")
        sections = []
        for segment in self.segments:
            k, i = segment.steps
            span = segment.span(k, i)
            covering = (span[:, 0] <= t) & (t <= span[:, 1])
            sets, meets = segment.cut(k[covering], i[covering])
            if np.any(meets):
                sections.append((segment.mode.name, sets[meets]))
        return sections

    def support(self, mode: str, directions: ArrayLike) -> Array:
        """Upper bound of each direction over all a mode's segments, shape (r,); -inf if never entered."""
        D = np.atleast_2d(np.asarray(directions, dtype=float))
        bounds = [np.full(len(D), -np.inf), *(segment.support(D) for segment in self.in_mode(mode))]
        return np.asarray(np.max(bounds, axis=0))
