"""A controller known by its answers alone: its reachable sets come from samples.

For every period of a step that the box flies, its command is fitted as an affine function of the error
with a band about it. Whether commands keep to their bands is what sampled flights are asked
(`polaris.simulation.sampled`); the rest is proven of every disturbance (docs/theory.md, Theorem 10).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from reach.networks.loop import held_step
from reach.numerics.linear import discretize
from reach.sets.zonotope import Zonotope
from reach.tubes.flow import LinearFlow

from ...model.craft import Array, Craft
from ...model.errors import NoAnswer, PolarisError
from ...model.tolerances import ROUNDING
from ...planning.reference import Reference
from ..tracker.tracking import Tracking
from .controllers import AnyThrust, Controller, TubeSegment
from .neural import WIDER, NeuralController, no_tube, reduced, thruster_offset

Ask = Callable[[float, Array, Array], Any]
"""Commands (R, m) at a time [s] for states (R, n), beside the state (n,) of the safe reference.

The states are those that the box is told, errors of the estimate included. At time 0 flights begin, one for
each row: until the next question at time 0 a row is always the same flight.
"""

Before = Sequence[tuple[Zonotope, Controller]]  # of the steps so far: where each began, and who flew it

SAMPLES = 400  # starts that shape the sets of a step; that these hold is asked of other flights

BANDS = 2.0  # width of the bands as a multiple of the samples' residuals

NARROW = 1e-7  # share of its size from which on a state varies enough for a command to be fitted to it
FARTHEST = 1e60  # states beyond which nothing is computed


@dataclass(frozen=True, eq=False)
class FittedSegment(TubeSegment):
    """A tube of commands that were fitted to samples."""

    fit: Array | None = None
    """The thrust from node i on is within ``fit[i, :, n + 1]`` of ``fit[i, :, :n] e + fit[i, :, n]``, e
    the error there; shape (q, m, n + 2)."""

    def outside(self, errors: Array, inputs: Array, spread: Array) -> Array:
        """Return how far inputs (R, q, m) are from the fit at errors (R, q, n) within `spread` (n,): (R,).

        In units of their bands.
        """
        assert self.fit is not None
        n = errors.shape[-1]
        fitted = np.einsum("iab,rib->ria", self.fit[..., :n], errors) + self.fit[..., n]
        deviation = np.abs(inputs - fitted) + np.abs(self.fit[..., :n]) @ spread
        return np.asarray((deviation / self.fit[..., n + 1]).max(axis=(1, 2)))


@dataclass(frozen=True, eq=False)
class BlackBox:
    """``u = clip(ask(t, x, xi))``, asked at the start of every control period, its answer held.

    Parameters
    ----------
    name, system, reference, tracking
        As those of a `NeuralController`.
    ask : callable
        See `Ask`. If it has a ``reset``, that is called with the number of flights whenever they begin.
    wider : float
        Scale of the bands, see `BANDS`.
    seed : int
        Of the samples.
    memory : bool
        Whether answers depend on what was asked earlier in a flight. Bands are then fitted to flights
        from the start on; claims about them assume neither.
    fits : mapping
        Bands that are known already, by step, as in `FittedSegment.fit`: nothing is asked for these.

    Raises
    ------
    ScenarioError
        `NoAnswer` on flying, if an answer is none.
    """

    name: str
    system: Craft
    reference: Reference
    tracking: Tracking
    ask: Ask
    wider: float = BANDS
    seed: int = 0
    memory: bool = False
    fits: Mapping[int, Array] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "system", Craft.from_system(self.system))
        if hasattr(self.ask, "reset"):
            object.__setattr__(self, "memory", True)

    @property
    def anything(self) -> AnyThrust:
        """Return the controller that covers this one unasked: any command within its thrust limits."""
        return AnyThrust(self.name, self.system, self.reference, self.tracking)

    def command(self, k: int, xi: Array, own: Array, x: Array, later: float = 0.0) -> Array:
        """Thrust command before clipping, shape (..., m), some seconds after the start of step k."""
        flat, t = x.reshape(-1, self.system.n), k * self.reference.delta + later
        shape = (len(flat), self.system.m)
        try:
            if t == 0 and hasattr(self.ask, "reset"):
                self.ask.reset(len(flat))
            answer = self.ask(t, flat.copy(), xi.copy())
        except PolarisError:
            raise
        except Exception as error:  # whatever it is
            rule = "must return commands, but raised an error"
            raise NoAnswer(f"black box {self.name}", f"{type(error).__name__}: {error}"[:60], rule) from error
        cause = None
        try:
            commands = np.array(answer)
        except Exception as error:  # of any kind: a tensor that is part of a graph, rows of other lengths
            commands, cause = np.zeros(0), error
        if commands.shape != shape or commands.dtype.kind not in "fiu" or not np.all(np.isfinite(commands)):
            rule = f"must return finite numbers, one row of {shape[1]} for each of {shape[0]} states"
            raise NoAnswer(f"black box {self.name}", str(answer)[:60], rule) from cause
        return commands.astype(float).reshape(*x.shape[:-1], self.system.m)

    @cached_property
    def flow(self) -> LinearFlow:
        """Open-loop motion of the error."""
        system = self.system
        return LinearFlow.continuous(system.A, system.D, system.w_max, self.tracking.flow.h)

    def propagate(self, start: Zonotope, k: int, before: Before = ()) -> FittedSegment:
        """Return the reachable set over step k of all that commands within the bands, under any disturbance.

        With memory they are fitted to flights from the initial set on, in which those `before` flew the
        steps so far and the box was asked all along.
        """
        system, fit = self.system, self.fits[k] if k in self.fits else self._fitted(start, k, before)
        n, rounding = system.n, self.reference.rounding[k]
        nodes, intersamples = [start], []
        for row in fit:
            e, K, c, r = nodes[-1], row[:, :n], row[:, n], row[:, n + 1]
            G = np.hstack([K @ e.G, np.diag(r)])
            after, intersample = held_step(
                self.flow, system.B, e, Zonotope(K @ e.c + c - self.reference.nu[k], G)
            )
            commanded = np.abs(K @ e.c + c) + np.abs(G).sum(axis=1) * (1 + WIDER)
            push, within = thruster_offset(system, self.flow, np.minimum(commanded, system.u_max))
            nodes.append(reduced(after + push))
            intersamples.append(intersample + rounding + within)
            if not np.all(nodes[-1].extent < FARTHEST):
                return FittedSegment(*no_tube(start, self._q), "its sets grow beyond all bounds")
        end = reduced(nodes[-1].inflate(rounding))
        return FittedSegment(Zonotope.stack(nodes), np.array(intersamples), end, fit=fit)

    @property
    def _q(self) -> int:
        return self.tracking.feedback.nodes_per_cell

    def _fitted(self, start: Zonotope, k: int, before: Before) -> Array:
        """Affine functions and bands about the commands from all over a set, its corners too."""
        system, rng, q = self.system, np.random.default_rng([self.seed, k]), self._q
        first, laws = before[0][0] if before else start, [*(law for _, law in before), self]
        b = rng.uniform(-1, 1, (SAMPLES, first.order_count))
        b[::2] = np.sign(b[::2])
        tips = first.support_vector(np.vstack([np.eye(system.n), -np.eye(system.n)]))
        e = np.vstack([first.c + b @ first.G.T, tips])
        Ad, Bd = discretize(system.A, system.B, self.flow.h)
        Dd = discretize(system.A, system.D, self.flow.h)[1]
        w = rng.normal(size=(len(laws) * q, len(e), system.p))
        w[:, ::3] = w[:1, ::3]  # the same way all along
        w *= system.w_max / np.maximum(np.linalg.norm(w, axis=2, keepdims=True), 1e-300)
        eta = np.zeros((len(w), 1, system.n))
        if np.any(system.navigation):
            eta = system.navigation * rng.choice([-1.0, 1.0], (len(w), *e.shape))
        fit, boxes = [], {id(law): law for law in laws if isinstance(law, BlackBox)}
        paths = {id(law): part.fine(q) for law in laws if (part := getattr(law, "own", None)) is not None}
        nodes = self.reference.fine(q)[k - len(before) : k + 1, :-1].reshape(-1, system.n)
        for node, xi in enumerate(nodes):
            law, (step, i) = laws[node // q], divmod(node, q)
            step, states = step + k - len(before), e + xi + eta[node]
            commands = {key: box.command(step, xi, xi, states, i * self.flow.h) for key, box in boxes.items()}
            if id(law) in commands:
                u = commands[id(law)]
            else:
                at = step, xi, paths[id(law)][step, i] if id(law) in paths else xi, states
                u = law.command(*at, *([i * self.flow.h] if isinstance(law, NeuralController) else []))
            u = np.clip(u, -system.u_max, system.u_max)
            if node >= len(nodes) - q:
                fit.append(self._line(e, u, xi))
            e = e @ Ad.T + (u - self.reference.nu[step]) @ Bd.T + w[node] @ Dd.T
        return np.array(fit)

    def _line(self, e: Array, u: Array, xi: Array) -> Array:
        """Return the affine function of errors (R, n) nearest to commands (R, m), and their band about it."""
        middle, n = e.mean(axis=0), e.shape[1]
        size, spread = np.abs(xi) + np.abs(e).max(axis=0), np.abs(e - middle).max(axis=0)
        scale = np.where(spread > NARROW * size, spread, np.inf)
        base = np.hstack([(e - middle) / scale, np.ones((len(e), 1))])
        solved = np.linalg.lstsq(base, u, rcond=1e-9)[0]
        K = (solved[:n] / scale[:, None]).T
        residual = np.abs(u - base @ solved).max(axis=0)
        rounding = ROUNDING * (self.system.u_max + np.abs(K) @ size)
        return np.asarray(np.column_stack([K, solved[n] - K @ middle, self.wider * residual + rounding]))


@dataclass(frozen=True)
class SampledBound:
    """Bound from samples on the steps of black boxes, from flights that no band was fitted to.

    Attributes
    ----------
    probability : float
        With which a flight leaves a band at most.
    confidence : float
        With which that is so, over the samples.
    flights, outside : int
        Flights drawn in the last attempt, and those that left.
    seed : int
        Of the samples.
    attempts : int
        Bands that were tried in turn, each wider.
    """

    probability: float
    confidence: float
    flights: int
    outside: int
    seed: int
    attempts: int
