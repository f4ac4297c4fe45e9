"""Hybrid automata with affine dynamics: modes, transitions, and refused cases."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..numerics.checks import Array, as_array, as_numbers, check_fields, require_single
from ..numerics.errors import ReachError
from ..sets.convex import ConvexSet
from ..sets.polytope import HPolytope
from ..sets.zonotope import Zonotope
from ..short_repr import short_repr
from ..tubes.systems import LinearSystem


@short_repr
@dataclass(frozen=True, eq=False)
class Mode:
    """One way of moving: an affine system, and the region in which it may go on.

    Parameters
    ----------
    name : str
    system : LinearSystem
        Continuous, with one set of inputs at most and no nominal input.
    invariant : HPolytope, optional
        A trajectory stays in this mode only while it is inside; where it would leave it must take a
        transition, and without one it ends there. None: everywhere.

    Raises
    ------
    ReachError
        If the system is discrete or has a nominal input, its input set changes in time, or dimensions differ.
    """

    name: str
    system: LinearSystem
    invariant: HPolytope | None = None

    def __post_init__(self) -> None:
        check_fields(self)
        if self.system.discrete:
            raise ReachError(f"mode {self.name!r} needs a system in continuous time")
        if len(self.system.U) > 1:
            raise ReachError(f"mode {self.name!r} needs one set of inputs, it has {len(self.system.U)}")
        if self.system.nominal is not None:
            raise ReachError(f"mode {self.name!r} must have no nominal input, which the tube would leave out")
        if self.invariant is not None:
            require_single(f"the invariant of mode {self.name!r}", self.invariant, self.system.dim)


@short_repr
@dataclass(frozen=True, eq=False)
class Transition:
    """A jump ``x+ = R x + r + w`` from one mode to another.

    It may be taken whenever everything given holds: the state is in the guard, absolute time is in
    the window, and the time since the mode was entered is in `dwell`. May-semantics: a trajectory
    may also pass by. It must jump only where the invariant ends (so an urgent guard is written as
    a guard and an invariant that share a face), or, if the transition is `urgent`, by the end of
    its window or dwell time.

    Parameters
    ----------
    source, target : str
        Names of modes.
    guard : HPolytope, optional
    window : (float, float), optional
        Absolute times.
    dwell : (float, float), optional
        Times since the source was entered.
    R, r : array_like, optional
        Reset; by default the state is kept.
    uncertain : ConvexSet, optional
        Set of w (a zonotope; of any other set the interval hull is taken).
    urgent : bool
        The source is left by the end of the window or dwell time at the latest (of a window, if the
        source was entered before).

    Raises
    ------
    ReachError
        If nothing triggers the transition, a time interval is reversed or negative, or shapes do
        not fit.
    """

    source: str
    target: str
    guard: HPolytope | None = None
    window: tuple[float, float] | None = None
    dwell: tuple[float, float] | None = None
    R: Any = None
    r: Any = None
    uncertain: ConvexSet | None = None
    urgent: bool = False

    def __post_init__(self) -> None:
        check_fields(self)
        label = f"the transition {self.source!r} -> {self.target!r}"
        if self.guard is None and self.window is None and self.dwell is None:
            raise ReachError(f"{label} needs a guard, a window or a dwell time")
        if self.urgent and self.window is None and self.dwell is None:
            raise ReachError(f"{label} is urgent: it needs a window or a dwell time that ends")
        for name in ("window", "dwell"):
            value = getattr(self, name)
            if value is None:
                continue
            ends = as_numbers(name, value)
            if ends.shape != (2,) or not (np.all(np.isfinite(ends)) and 0 <= ends[0] <= ends[1]):
                raise ReachError(f"the {name} of {label} must be two times 0 <= t0 <= t1, got {value!r}")
            object.__setattr__(self, name, (float(ends[0]), float(ends[1])))

    def __str__(self) -> str:
        return f"{self.source} -> {self.target}"


@dataclass(frozen=True, eq=False)
class HybridAutomaton:
    """Modes, the transitions between them, and the mode in which every trajectory starts.

    Parameters
    ----------
    modes : sequence of Mode
        Different names; dimensions may differ where resets change them.
    transitions : sequence of Transition
    start : str, optional
        Name of the initial mode; the first one by default.

    Raises
    ------
    ReachError
        If a name is unknown or given twice, or a guard or a reset does not fit.
    """

    modes: Sequence[Mode]
    transitions: Sequence[Transition] = ()
    start: str | None = None

    def __post_init__(self) -> None:
        for role, parts, kind in (("modes", self.modes, Mode), ("transitions", self.transitions, Transition)):
            if not isinstance(parts, list | tuple) or not all(isinstance(one, kind) for one in parts):
                raise ReachError(f"{role} must be a sequence of {kind.__name__}, got {parts!r}")
        if not self.modes:
            raise ReachError("an automaton needs a mode")
        object.__setattr__(self, "modes", tuple(self.modes))
        names = [mode.name for mode in self.modes]
        if len(set(names)) < len(names):
            raise ReachError(f"modes need different names, got {names}")
        if not isinstance(self.start, str | None):
            raise ReachError(f"start must be the name of a mode, got {self.start!r}")
        if self.start is None:
            object.__setattr__(self, "start", names[0])
        for name in (self.start, *(name for t in self.transitions for name in (t.source, t.target))):
            self[str(name)]
        object.__setattr__(self, "transitions", tuple(self._complete(t) for t in self.transitions))

    def _complete(self, t: Transition) -> Transition:
        """The transition with its reset filled in, after checks against its modes."""
        n, m = self[t.source].system.dim, self[t.target].system.dim
        for role, body, dim in (("guard", t.guard, n), ("uncertain part", t.uncertain, m)):
            if body is not None:
                require_single(f"the {role} of {t}", body, dim)
        R = np.eye(n) if t.R is None else as_array(f"R of {t}", t.R, m, n)
        r = np.zeros(m) if t.r is None else as_array(f"r of {t}", t.r, m)
        if R.shape != (m, n):
            raise ReachError(f"{t} needs a reset R of shape {(m, n)}")
        w = t.uncertain
        if w is not None and not isinstance(w, Zonotope):
            w = w.interval_hull().to_zonotope()
        return replace(t, R=R, r=r, uncertain=w)

    def __getitem__(self, name: str) -> Mode:
        """The mode of a name."""
        matches = [mode for mode in self.modes if mode.name == name]
        if not matches:
            raise ReachError(f"there is no mode {name!r}")
        return matches[0]

    def leaving(self, name: str) -> list[Transition]:
        """Transitions out of a mode."""
        return [t for t in self.transitions if t.source == name]

    def longest_stay(self, name: str, first: Array | float, last: Array | float) -> Array:
        """Return the longest stay (...) that urgent transitions allow in a mode entered in [first, last]."""
        stay = np.full(np.shape(first), np.inf)
        for t in self.leaving(name):
            if t.urgent and t.window is not None:
                stay = np.minimum(stay, np.where(last <= t.window[1], t.window[1] - first, np.inf))
            if t.urgent and t.dwell is not None:
                stay = np.minimum(stay, t.dwell[1])
        return np.asarray(stay)
