"""A feed-forward network as experimental controller, evaluated once a control period, clipped by thrusters.

Its tube is that of `reach.networks.loop.NetworkLoop` in error coordinates about the safe reference; the
proposition and its proof stand in docs/theory.md.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from reach.networks.bands import Activation
from reach.networks.loop import ORDER, NetworkLoop
from reach.networks.network import Affine, Network
from reach.numerics.errors import Unresolved
from reach.numerics.rounding import gamma
from reach.sets.zonotope import Zonotope

from ..model.errors import ScenarioError
from ..model.system import Array, LinearSystem
from ..model.tolerances import ROUNDING
from ..planning.reference import Reference
from .controllers import AffineController, TubeSegment
from .tracking import Feedback, Tracking

WIDER = 0.02
"""Share by which what the bands leave open is booked wider: a certificate's check merges generators
otherwise, so that its bands are others than these."""


def stacked(inputs: tuple[str, ...], parts: dict[str, Array]) -> Array:
    """Arrays by name side by side, of broadcastable leading shapes."""
    chosen = [parts[name] for name in inputs]
    lead = np.broadcast_shapes(*(part.shape[:-1] for part in chosen))
    return np.concatenate([np.broadcast_to(part, (*lead, part.shape[-1])) for part in chosen], axis=-1)


@dataclass(frozen=True, eq=False)
class Policy:
    """``u = output_scale * network(input_scale * z)``, before the thrusters clip it.

    Parameters
    ----------
    network : reach.networks.network.Network
    inputs : tuple of str
        What z is made of, in order: "error" (own reference - x), "state", "time" (start of the step [s]),
        "reference_input" (of the own reference).
    input_scale : ndarray, shape (r,)
    output_scale : ndarray, shape (m,)
        Positive, in units of the input.
    """

    network: Network
    inputs: tuple[str, ...]
    input_scale: Array
    output_scale: Array

    def check(self, system: LinearSystem, field: str) -> None:
        """Refuse, with the fields of a scenario's table `field`, what does not fit a system."""
        sizes = {"error": system.n, "state": system.n, "time": 1, "reference_input": system.m}
        read = sum(sizes[name] for name in self.inputs)
        if len(set(self.inputs)) < len(self.inputs):
            raise ScenarioError(f"{field}.inputs", list(self.inputs), "must name each input once")
        if self.network.inputs != read:
            rule = f"must be {self.network.inputs} numbers, as the network reads; these are {read}"
            raise ScenarioError(f"{field}.inputs", list(self.inputs), rule)
        if self.network.outputs != system.m:
            rule = f"must be a network of {system.m} outputs, one per input; has {self.network.outputs}"
            raise ScenarioError(f"{field}.path", None, rule)
        for name, given, size in (
            ("input_scale", self.input_scale, read),
            ("output_scale_N", self.output_scale, system.m),
        ):
            if np.shape(given) != (size,):
                raise ScenarioError(f"{field}.{name}", np.size(given), f"must have {size} numbers")

    def stack(self, parts: dict[str, Array]) -> Array:
        """Scaled inputs, shape (..., r), from arrays by name, of broadcastable leading shapes."""
        return stacked(self.inputs, parts) * self.input_scale


@dataclass(frozen=True, eq=False)
class NeuralController:
    """``u = clip(policy)``, renewed at the start of every control period and held.

    Parameters
    ----------
    name : str
        Name in tables and figures.
    system : LinearSystem
        What it controls.
    policy : Policy
    reference, own : Reference
        The safe reference, and the one that the policy reads (the same object if shared).
    tracking : Tracking
        The safety tracker, whose feedback must be sampled.

    Raises
    ------
    ScenarioError
        If feedback is not sampled, or the policy does not fit the system.
    """

    name: str
    system: LinearSystem
    policy: Policy
    reference: Reference
    own: Reference
    tracking: Tracking

    def __post_init__(self) -> None:
        if not self.feedback.sampled:
            raise ScenarioError("feedback.kind", "continuous", NEEDS_SAMPLES)
        self.policy.check(self.system, self.name)

    @property
    def feedback(self) -> Feedback:
        """Sampled, as the safety controller's."""
        return self.tracking.feedback

    def along(self, reference: Reference, tracking: Tracking) -> NeuralController:
        """The same beside another safe reference; one that shares the safe reference shares that one."""
        own = reference if self.own is self.reference else self.own
        return replace(self, reference=reference, own=own, tracking=tracking)

    @cached_property
    def offset(self) -> Array:
        """``xi_U - xi`` at the nodes of every cell, shape (K, q+1, n)."""
        q, cells = self.feedback.nodes_per_cell, min(self.own.cells, self.reference.cells)
        return self.own.fine(q)[:cells] - self.reference.fine(q)[:cells]

    @cached_property
    def loop(self) -> NetworkLoop:
        """The closed loop in error coordinates, limits and scales included."""
        system, policy, n = self.system, self.policy, self.system.n
        none = {"time": 1, "reference_input": system.m}
        parts = {"error": -np.eye(n), "state": np.eye(n), **{k: np.zeros((n, v)) for k, v in none.items()}}
        zeros = np.zeros(system.m)
        limited = (
            Affine(np.diag(policy.output_scale / system.u_max), zeros),
            Activation("clip", -1.0, 1.0),
            Affine(np.diag(system.u_max), zeros),
        )
        network = Network((*policy.network.layers, *limited))
        A, B, D = system.A, system.B, system.D
        eta = system.navigation if np.any(system.navigation) else None
        return NetworkLoop(A, B, D, system.w_max, self.tracking.flow.h, network, policy.stack(parts).T, eta)

    @cached_property
    def known(self) -> tuple[Array, Array]:
        """What is read where the error is 0, at every node, and by how much it may be off: (K, q+1, r)."""
        cells, m = len(self.offset), self.system.m
        times: Array = np.arange(cells, dtype=float)[:, None, None] * np.float64(self.reference.delta)
        nu = self.own.nu[:cells, None]
        safe = self.reference.fine(self.feedback.nodes_per_cell)[:cells]
        read = self.policy.stack({"error": self.offset, "state": safe, "time": times, "reference_input": nu})
        steps = self.reference.rounding[:cells, None], self.own.rounding[:cells, None]
        # The two references are stored states: their difference and their sums are known up to round-off.
        off = {
            "error": steps[0] + steps[1],
            "state": steps[0],
            "time": 0 * times,
            "reference_input": np.zeros((cells, 1, m)),
        }
        return read, np.abs(self.policy.stack(off)) + gamma(4) * np.abs(read)

    @property
    def slope(self) -> AffineController:
        """The clipped affine law that it is, to first order, where its own reference starts: no bound."""
        own, m = self.own.chi[0], self.system.m
        gain = -self.pullback(0, own, np.repeat(own[None], m, axis=0), np.eye(m))
        known = self.reference, self.own, self.tracking
        return AffineController(self.name, self.system, gain, *known, clips=True)

    @cached_property
    def booked(self) -> Array:
        """What scaling the output rounds to, as part of the state at the next node, shape (n,)."""
        return np.asarray(ROUNDING * np.abs(self.loop.flow.input_map(self.system.B)) @ self.system.u_max)

    def command(self, k: int, xi: Array, own: Array, x: Array) -> Array:
        """Thrust command before clipping, shape (..., m), in step k."""
        return np.asarray(self.policy.network(self._read(k, own, x)) * self.policy.output_scale)

    def pullback(self, k: int, own: Array, x: Array, weights: Array) -> Array:
        """Gradient of ``weights . command`` by x, shape (..., n), for weights (..., m)."""
        read = self._read(k, own, x)
        return self.policy.network.pullback(read, weights * self.policy.output_scale) @ self.loop.C

    def _read(self, k: int, own: Array, x: Array) -> Array:
        time = np.array([k * self.reference.delta])
        parts = {"error": own - x, "state": x, "time": time, "reference_input": self.own.nu[k]}
        return self.policy.stack(parts)

    def fly(self, start: Zonotope, k: int) -> TubeSegment:
        """Reachable set over step k from a set in error coordinates; refused where its numbers overflow."""
        nodes, bows, mu = [start], [], self.reference.nu[k]
        read, off = self.known
        try:
            for i in range(self.feedback.nodes_per_cell):
                after, bow, command = self.loop.step(nodes[-1], read[k, i], -mu, off[k, i])
                open_ = np.abs(command.G[:, nodes[-1].order_count :]).sum(axis=1)
                wider = np.abs(self.loop.flow.input_map(self.system.B)) @ open_ * WIDER
                push, within = self._misapplied(command)
                nodes.append(reduced(after.inflate(wider + self.booked) + push))
                bows.append(bow + wider + within)
        except Unresolved as error:
            return TubeSegment(*no_tube(start, self.feedback.nodes_per_cell), str(error))
        rounding = self.reference.rounding[k] + self.own.rounding[k]
        end = reduced(nodes[-1].inflate(rounding))
        return TubeSegment(Zonotope.stack(nodes), np.array(bows) + rounding, end)

    def _misapplied(self, command: Zonotope) -> tuple[Zonotope, Array]:
        """What errors of thrusters under a held command add by the next node, and until then, (n,)."""
        flow, B = self.loop.flow, self.system.B
        if self.system.thrusters.exact and not self.system.timing.carried:
            return Zonotope(np.zeros(self.system.n), np.zeros((self.system.n, 0))), np.zeros(self.system.n)
        error = self.system.thrusters.error(np.abs(command.c) + command.half_widths * (1 + WIDER))
        drift = self.system.adrift
        size = np.abs(B) @ error
        moved = flow.input_zonotope(B, np.diag(error), size)
        if drift.size:
            carried = np.abs(drift).sum(axis=1)
            moved, size = moved + flow.input_zonotope(drift, np.eye(drift.shape[1]), carried), size + carried
        return moved, flow.h * flow.growth @ size

    def commanded(self, nodes: Zonotope, bow: Array, k: int) -> tuple[Array, Array]:
        """Command in step k, its middle and spread at every node [N], shapes (q+1, m).

        `nodes` are errors about the law's own reference. What is commanded at a node is held from there on.
        """
        read, off = self.known
        error = nodes + self.offset[k]
        sets = [self.loop.command(error[i], read[k, i], off[k, i]) for i in range(len(read[k]))]
        return np.array([z.c for z in sets]), np.array([z.half_widths for z in sets]) * (1 + WIDER)


NEEDS_SAMPLES = "must be sampled where a network or a black box flies: it is asked once a control period"
"""What a scenario with one of them must have."""


def check_exact(system: LinearSystem) -> None:
    """Refuse errors of estimates and of thrusters: no tube of a black box knows of them."""
    if not system.ideal:
        field = "navigation" if np.any(system.prompt.navigation) else "thrusters"
        field = field if system.timing.instant else "timing"
        raise ScenarioError(
            field, None, "must be left out where a black box flies: its tube knows of no such error"
        )


def no_tube(start: Zonotope, q: int) -> tuple[Zonotope, Array, Zonotope]:
    """What stands in a refused `TubeSegment` of q parts: nodes, bow and end."""
    return Zonotope.stack([start] * (q + 1)), np.zeros((q, start.dim)), start


def reduced(z: Zonotope) -> Zonotope:
    """With few generators, if it has too many: reducing wraps what turns, so it is done late and by much."""
    return z if z.order_count <= ORDER * z.dim else z.reduce(ORDER / 3)
