"""A linear system under a network that reads it once a period: reachable sets, sound in continuous time.

Each period the network is enclosed over the set of states of that instant, its output still tied to the state
(`Network.enclose`), so that the contraction of the loop is kept: intervals alone would lose it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..numerics.checks import Array, as_count, as_directions, check_fields, checked, per_row, require_single
from ..numerics.errors import ReachError
from ..numerics.linear import require_square
from ..numerics.rounding import gamma
from ..sets.zonotope import Zonotope
from ..tubes.flow import LinearFlow
from ..tubes.tubes import locate
from .network import Network

ORDER = 90.0  # generators per dimension of a tube: what was long ago must have decayed before it is merged
OWN_ORDER = 3.0  # generators per input that stand for what the bands of one enclosure leave open
NOISE_ORDER = 3.0  # generators per dimension for disturbance and rounding of one period


@dataclass(frozen=True, eq=False)
class NetworkTube:
    """Sets that hold the states of a loop at its samples, and over every period between them.

    Attributes
    ----------
    times : ndarray, shape (K+1,)
        Samples [s], from 0.
    nodes : Zonotope, batch (K+1,)
    intersample : ndarray, shape (K, n)
        Over the period after node k the state leaves the hull of corresponding points of the two nodes by no
        more than this, elementwise.
    inputs : Zonotope, batch (K,)
        Commands of the network in each period.
    """

    times: Array
    nodes: Zonotope
    intersample: Array
    inputs: Zonotope

    def support(self, directions: ArrayLike) -> Array:
        """Bounds on ``d x(t)`` over every period for rows d, shape (K, r) for rows (r, n)."""
        D = as_directions(directions, self.nodes.dim)
        nodes = self.nodes.support(D)
        return np.asarray(np.maximum(nodes[1:], nodes[:-1]) + self.intersample @ np.abs(D).T)

    def at(self, t: ArrayLike) -> Zonotope:
        """Boxes that hold the state at given times, batch (len(t),)."""
        k, _ = locate(self.times, t)
        n = self.nodes.dim
        rows = np.vstack([np.eye(n), -np.eye(n)])
        bounds = self.support(rows)[k]
        return Zonotope.box((bounds[:, :n] - bounds[:, n:]) / 2, (bounds[:, :n] + bounds[:, n:]) / 2)


def held_step(flow: LinearFlow, B: Array, states: Zonotope, inputs: Zonotope) -> tuple[Zonotope, Array]:
    """One period of open-loop motion under held inputs whose first generators are those of the states.

    Returned are the states at the next sample, not reduced, and the intersample bound as in `NetworkTube`.
    """
    A, phi, input_map, drive = flow.A_x, flow.phi, flow.input_map(B), inputs.c
    G = np.pad(states.G, ((0, 0), (0, inputs.G.shape[1] - states.G.shape[1])))
    after = Zonotope(phi @ states.c + input_map @ drive, phi @ G + input_map @ inputs.G)
    size = np.abs(phi) @ states.extent + np.abs(input_map) @ (np.abs(drive) + inputs.half_widths)
    noise = flow.period_zonotope.inflate(gamma(len(phi) + len(drive)) * size)
    # x'' = e^{A s} A (A x + B u), states and inputs taken together.
    curvature = np.abs(A @ (A @ G + B @ inputs.G)).sum(axis=1) + np.abs(A @ (A @ states.c + B @ drive))
    intersample = flow.h**2 / 8 * flow.growth @ curvature + flow.period_box
    return after + noise.reduce(NOISE_ORDER), intersample


@dataclass(frozen=True, eq=False)
class NetworkLoop:
    """``x' = A x + B (u + v) + D w``, where ``u = network(C x + s)`` is renewed every h and held.

    v and s are known and may differ from period to period; ``norm(w, 2) <= w_max``, any function of time.

    Parameters
    ----------
    A, B, D : ndarray, shapes (n, n), (n, m), (n, p)
    w_max : float
    h : float
        Period [s].
    network : Network
        With m outputs; any limits of the input are its last activation.
    C : ndarray, shape (r, n)
        Map from states to the inputs of the network.
    error : ndarray, shape (n,), optional
        Largest error of each state that it reads, in every period anew; none by default.

    Raises
    ------
    ReachError
        If shapes do not fit.
    """

    A: Array
    B: Array
    D: Array
    w_max: float
    h: float
    network: Network
    C: Array
    error: Array | None = None

    def __post_init__(self) -> None:
        check_fields(self)
        require_square("A", self.A)
        if self.B.shape != (len(self.A), self.network.outputs):
            raise ReachError(f"B must have shape {(len(self.A), self.network.outputs)}, got {self.B.shape}")
        if np.shape(self.C) != (self.network.inputs, len(self.A)):
            shape = (self.network.inputs, len(self.A))
            raise ReachError(f"C must have shape {shape}, got {np.shape(self.C)}")
        if self.error is not None and (self.error.shape != (len(self.A),) or np.any(self.error < 0)):
            raise ReachError(f"error must be {len(self.A)} numbers >= 0")
        self.flow  # noqa: B018  what it refuses is refused here

    @cached_property
    def flow(self) -> LinearFlow:
        """Motion between two samples, the input apart."""
        return LinearFlow.continuous(self.A, self.D, self.w_max, self.h)

    def command(
        self, states: Zonotope, s: ArrayLike | float = 0.0, input_error: Any = 0.0, spread: Any = None
    ) -> Zonotope:
        """The network over a set of states: the first generators are theirs, the others few."""
        s = per_row("offset of what is read", s, self.network.inputs)
        inputs, extent = self.C @ states + s, states.extent
        if self.error is not None:
            inputs = Zonotope(inputs.c, np.hstack([inputs.G, self.C * self.error]))
            extent = extent + self.error
        if spread is not None:
            inputs = inputs + Zonotope(np.zeros(inputs.dim), spread)
        rounding = gamma(states.dim) * (np.abs(self.C) @ extent + np.abs(s)) + input_error
        out = self.network.enclose(inputs, rounding)
        g = states.order_count
        bands = Zonotope(np.zeros(out.dim), out.G[:, g:]).reduce(OWN_ORDER)
        return Zonotope(out.c, np.hstack([out.G[:, :g], bands.G]))

    @checked
    def step(
        self, states: Zonotope, s: Any = 0.0, v: Any = 0.0, input_error: Any = 0.0, spread: Any = None
    ) -> tuple[Zonotope, Array, Zonotope]:
        """One period from a (single) set of states.

        Parameters
        ----------
        states : Zonotope
        s, v : array_like, shapes (r,) and (m,)
            Offsets of the network's inputs, and of its commands.
        input_error : array_like, shape (r,)
            Largest errors of its inputs, elementwise.
        spread : ndarray, shape (r, g), optional
            Generators of what is added to what it reads and known as a set alone, as where another body is.

        Returns
        -------
        after : Zonotope
            States at the next sample, not reduced.
        intersample : ndarray, shape (n,)
            As in `NetworkTube`, disturbance included.
        command : Zonotope
            Commands of the network.
        """
        require_single("the states", states)
        command = self.command(states, s, input_error, spread)
        drive = command.c + per_row("known input", v, command.dim)
        return *held_step(self.flow, self.B, states, Zonotope(drive, command.G)), command

    @checked
    def tube(self, initial: Zonotope, periods: int, order: float = ORDER) -> NetworkTube:
        """Reachable sets over a number of periods, with at most ``order * n`` generators each.

        Reducing wraps what turns, so it is done late and then by much.

        Raises
        ------
        Unresolved
            If the sets grow beyond floating point.
        """
        require_single("the initial set", initial)
        nodes, intersamples, inputs = [initial], [], []
        for _ in range(as_count("periods", periods)):
            after, intersample, command = self.step(nodes[-1])
            nodes.append(after if after.order_count <= order * after.dim else after.reduce(order / 3))
            intersamples.append(intersample)
            inputs.append(command)
        times = np.arange(len(nodes)) * np.float64(self.h)
        return NetworkTube(times, Zonotope.stack(nodes), np.array(intersamples), Zonotope.stack(inputs))
