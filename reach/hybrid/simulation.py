"""Single trajectories of hybrid automata, by matrix exponentials."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import expm

from ..numerics.checks import Array, as_array, checked
from ..numerics.errors import ReachError
from ..numerics.exponentials import bordered, dense
from ..sets.polytope import HPolytope
from ..short_repr import short_repr
from .automaton import HybridAutomaton, Mode, Transition

TOUCH = 1e-9  # a state this close to a face, relative to the terms of its row, counts as on it
REPLAYED = 1e-6  # the same for a trajectory that is integrated again
BISECTIONS = 40
MOST_SAMPLES = 10_000_000
Policy = Literal["first", "last", "random"]


@short_repr
@dataclass(frozen=True, eq=False)
class Visit:
    """A stay in one mode.

    Attributes
    ----------
    mode : str
    times : ndarray, shape (m,)
        Absolute.
    states : ndarray, shape (m, n)
    input : ndarray, shape (inputs,)
        Held over the visit.
    transition : Transition or None
        Taken at the end; None at the horizon, or where the trajectory ends.
    uncertain : ndarray or None
        Values that the reset added.
    """

    mode: str
    times: Array
    states: Array
    input: Array
    transition: Transition | None = None
    uncertain: Array | None = None


@short_repr
@dataclass(frozen=True, eq=False)
class HybridTrajectory:
    """One trajectory: visits one after the other.

    Attributes
    ----------
    visits : tuple of Visit
    deadlock : bool
        It ends before the horizon: the invariant ends and no transition can be taken.
    """

    visits: tuple[Visit, ...]
    deadlock: bool = False


@checked
def simulate_hybrid(
    automaton: HybridAutomaton,
    x0: ArrayLike,
    horizon: float,
    *,
    dt: float,
    policy: Policy = "last",
    rng: np.random.Generator | None = None,
    jumps: int = 50,
) -> HybridTrajectory:
    """Run one trajectory, sampled every `dt`.

    Parameters
    ----------
    automaton : HybridAutomaton
    x0 : array_like, shape (n,)
    horizon : float
    dt : float
        Guards and invariants are looked at this often, and instants then found by bisection: a
        guard touched between two samples can be missed.
    policy : {"first", "last", "random"}
        Choice among the admissible instants of the transitions.
    rng : numpy.random.Generator, optional
        For "random"; inputs and uncertain resets are then random too, and at their centres otherwise.
    jumps : int
        The trajectory ends after so many.

    Raises
    ------
    ReachError
        If the policy is unknown, or "random" comes without a generator.
    """
    if policy not in ("first", "last", "random"):
        raise ReachError(f"policy must be 'first', 'last' or 'random', got {policy!r}")
    if policy == "random" and rng is None:
        raise ReachError("the policy 'random' needs a random generator")
    if not (0 < dt < np.inf and 0 <= horizon < np.inf) or horizon / dt > MOST_SAMPLES:
        detail = f"got {dt!r}, {horizon!r}"
        raise ReachError(f"dt and horizon must be > 0 and give at most {MOST_SAMPLES:,} samples, {detail}")
    t, name = 0.0, str(automaton.start)
    x = as_array("the initial state", x0, automaton[name].system.dim)
    visits: list[Visit] = []
    while True:
        mode, drawn = automaton[name], rng if policy == "random" else None
        u = _point(mode.system.U[0], drawn) if mode.system.U else np.zeros(0)
        motion = _Motion(mode, x, u, dt)
        remaining, max_stay = horizon - t, float(automaton.longest_stay(name, t, t))
        end, stops = motion.leaves(min(remaining, max_stay))
        stops = stops or max_stay < remaining
        options = _options(automaton, motion, t, end) if len(visits) < jumps else []
        chosen = _choose(options, policy, rng, must_jump=stops)
        if chosen is None:
            visits.append(motion.visit(t, end))
            return HybridTrajectory(tuple(visits), deadlock=stops and end < horizon - t)
        transition, stay = chosen
        w = None if transition.uncertain is None else _point(transition.uncertain, drawn)
        visits.append(replace(motion.visit(t, stay), transition=transition, uncertain=w))
        x = transition.R @ motion.at(stay) + transition.r + (0 if w is None else w)
        t, name = t + stay, transition.target


def _point(body: Any, rng: np.random.Generator | None) -> Array:
    """The centre of a set, or a random point of it: an extreme one, pulled in half of the time."""
    if rng is None:
        return np.asarray(body.center)
    corner = body.support_vector(rng.normal(size=(1, body.dim)))[0]
    share = 1.0 if rng.random() < 0.5 else rng.random()
    return np.asarray(body.center + share * (corner - body.center))


class _Motion:
    """A motion within one mode from one state."""

    def __init__(self, mode: Mode, x: Array, u: Array, dt: float) -> None:
        system = mode.system
        n = system.dim
        self.mode, self.u, self.dt, self.n = mode, u, dt, n
        self.M = bordered(dense(system.A), (np.asarray(system.B @ u).ravel() + system.c)[:, None])
        self.z, self.size = np.r_[x, 1.0], np.abs(x)

    def at(self, s: float) -> Array:
        """State after a time."""
        return np.asarray((expm(self.M * s) @ self.z)[: self.n])

    def samples(self, end: float) -> tuple[Array, Array]:
        """Times from 0 to `end` and states at them."""
        count = int(np.ceil(max(end, 0.0) / self.dt))
        step, states = expm(self.M * self.dt), np.empty((count + 1, self.n + 1))
        states[0] = self.z
        filled, power = 1, step
        while filled <= count:
            added = min(filled, count + 1 - filled)
            states[filled : filled + added] = states[:added] @ power.T
            filled, power = 2 * filled, power @ power
        times = np.minimum(self.dt * np.arange(count + 1), end)
        if count:
            states[-1, : self.n] = self.at(end)
        return times, states[:, : self.n]

    def leaves(self, end: float) -> tuple[float, bool]:
        """Return the last time in the invariant, at most `end`, and True if it is left before."""
        times, states = self.samples(end)
        self.size = np.abs(states).max(axis=0)
        region = self._relaxed()
        outside = ~inside(region, states, self.size)
        if not np.any(outside):
            return end, False
        k = int(np.argmax(outside))
        return (0.0 if k == 0 else self.bisect(times[k - 1], times[k], region, True)), True

    def _relaxed(self) -> HPolytope | None:
        """The invariant; a face that the start is on, or beyond by a replay's tolerance, goes through it."""
        region = self.mode.invariant
        if region is None:
            return None
        values = region.A @ self.z[: self.n]
        near = values <= region.b + REPLAYED / 10 * (np.abs(region.A) @ self.size + np.abs(region.b))
        return HPolytope(region.A, np.where(near, np.maximum(region.b, values), region.b))

    def bisect(self, low: float, high: float, region: HPolytope | None, holds: bool) -> float:
        """Time at which being in a region changes from `holds`; the side on which it is inside."""
        for _ in range(BISECTIONS):
            middle = (low + high) / 2
            if bool(inside(region, self.at(middle)[None], self.size)[0]) == holds:
                low = middle
            else:
                high = middle
        return low if holds else high

    def visit(self, t: float, end: float) -> Visit:
        times, states = self.samples(end)
        return Visit(self.mode.name, t + times, states, self.u)


def inside(region: HPolytope | None, states: Array, size: Array, slack: float = TOUCH) -> NDArray[np.bool_]:
    """Return True for states (m, n) in a polytope, or out of it by `slack` times the size of its terms."""
    if region is None:
        return np.ones(len(states), dtype=bool)
    allowance = slack * (np.abs(region.A) @ size + np.abs(region.b))
    return np.asarray(np.all(states @ region.A.T <= region.b + allowance, axis=1))


def _options(
    automaton: HybridAutomaton, motion: _Motion, t: float, end: float
) -> list[tuple[Transition, float, float]]:
    """Transitions with stretches of time in which they may be taken, in time since entry."""
    options = []
    for transition in automaton.leaving(motion.mode.name):
        window, dwell = transition.window or (0.0, np.inf), transition.dwell or (0.0, np.inf)
        low = max(window[0] - t, dwell[0], 0.0)
        high = min(window[1] - t, dwell[1], end)
        if abs(low - high) < 1e-12 * (1 + t):
            high = low
        if low > high:
            continue
        if transition.guard is None:
            options.append((transition, low, high))
            continue
        times, states = motion.samples(end)
        in_guard = inside(transition.guard, states, motion.size)
        edges = np.flatnonzero(np.diff(np.r_[False, in_guard, False].astype(int)))
        for first, after in edges.reshape(-1, 2):
            begin, stop = times[first], times[after - 1]
            if first > 0:
                begin = motion.bisect(times[first - 1], begin, transition.guard, False)
            if after < len(times):
                stop = motion.bisect(stop, times[after], transition.guard, True)
            if max(begin, low) <= min(stop, high):
                options.append((transition, float(max(begin, low)), float(min(stop, high))))
    return options


def _choose(
    options: list[tuple[Transition, float, float]], policy: Policy, rng: Any, must_jump: bool
) -> tuple[Transition, float] | None:
    """A transition and the time since entry at which it is taken; None if there is, or need be, none."""
    if not options or (policy == "random" and not must_jump and rng.random() < 0.2):
        return None
    if policy == "first":
        return min(((t, low) for t, low, _ in options), key=lambda o: o[1])
    if policy == "last":
        return max(((t, high) for t, _, high in options), key=lambda o: o[1])
    transition, low, high = options[rng.integers(len(options))]
    return transition, float(rng.choice([low, high, rng.uniform(low, high)]))
