"""A feed-forward network as experimental controller, evaluated once a control period, clipped by thrusters.

Its tube is that of `reach.networks.loop.NetworkLoop` in error coordinates about the safe reference
(docs/theory.md, Theorem 10).
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from reach.networks.layers import Activation, Affine
from reach.networks.loop import ORDER, NetworkLoop
from reach.networks.network import Network
from reach.numerics.errors import Unresolved
from reach.numerics.rounding import gamma
from reach.sets.zonotope import Zonotope
from reach.short_repr import short_repr
from reach.tubes.flow import LinearFlow

from ...model.craft import Array, Craft
from ...model.scene.obstacle import Obstacle
from ...model.tolerances import ROUNDING
from ...planning.reference import Reference
from ..tracker.feedback import Feedback
from ..tracker.tracking import Tracking
from .controllers import AffineController, TubeSegment
from .policy import Policy, Senses

WIDER = 0.02
"""Share by which the remainder beside the bands is widened: a certificate's check merges generators
otherwise, so that its bands are others than these."""


@short_repr
@dataclass(frozen=True, eq=False)
class NeuralController:
    """``u = clip(policy)``, renewed at the start of every control period and held.

    Parameters
    ----------
    name : str
        Name in tables and figures.
    system : Craft or LinearSystem
        Controlled system.
    policy : Policy
    reference, own : Reference
        The safe reference, and the one that the policy reads (the same object if shared).
    tracking : Tracking
        The safety tracker, whose nodes are the policy's.
    unsafe : tuple of obstacles
        The scene's, some of which the policy may read. What it is told of one is any state that this one's
        motion allows at the instant.

    Raises
    ------
    ScenarioError
        If the policy does not fit the system or the scene.
    """

    name: str
    system: Craft
    policy: Policy
    reference: Reference
    own: Reference
    tracking: Tracking
    unsafe: tuple[Obstacle, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "system", Craft.from_system(self.system))
        self.policy.check(self.senses, self.name)

    @property
    def feedback(self) -> Feedback:
        """Return the feedback of the safety controller."""
        return self.tracking.feedback

    def with_reference(self, reference: Reference, tracking: Tracking) -> "NeuralController":
        """Return it beside another safe reference, which is its own too if it shares the present one."""
        own_reference = reference if self.own is self.reference else self.own
        return replace(self, reference=reference, own=own_reference, tracking=tracking)

    @cached_property
    def senses(self) -> Senses:
        """Return the quantities that the network can read."""
        return Senses.from_inputs(self.system, self.policy.inputs, self.unsafe, f"{self.name}.inputs")

    @cached_property
    def obstacle_motion(self) -> tuple[Array, Array]:
        """Return the motion of bodies at every node: middle and half-widths, (K, q+1, 2d per body)."""
        cells, q = len(self.offset), self.feedback.nodes_per_cell
        at = q * np.arange(cells)[:, None] + np.arange(q + 1)
        middle, half = self.senses.state_boxes(self.tracking.flow.h, cells * q + 1)
        return middle[at], half[at]

    @cached_property
    def sight(self) -> Array:
        """Return the derivative of the policy's inputs by the motion of bodies, shape (r, 2d per body)."""
        unit = np.eye(self.obstacle_motion[0].shape[-1])
        return self._slopes(np.zeros((len(unit), self.system.n)), unit)

    def _slopes(self, x: Array, bodies: Array) -> Array:
        """Return the change of the policy's inputs per row of states and obstacle motion, shape (r, rows)."""
        zeros = (np.zeros((len(x), size)) for size in (1, self.system.m))
        return self._stack(0 * x, x, *zeros, bodies).T

    def _stack(self, *values: Array) -> Array:
        return self.policy.stack(self.senses.parts(*values))

    @cached_property
    def offset(self) -> Array:
        """``xi_U - xi`` at the nodes of every cell, shape (K, q+1, n)."""
        q, cells = self.feedback.nodes_per_cell, min(self.own.cells, self.reference.cells)
        return self.own.fine(q)[:cells] - self.reference.fine(q)[:cells]

    @cached_property
    def loop(self) -> NetworkLoop:
        """Return the closed loop in error coordinates, limits and scales included."""
        system, policy, zeros = self.system, self.policy, np.zeros(self.system.m)
        reads = self._slopes(np.eye(system.n), np.zeros((system.n, self.obstacle_motion[0].shape[-1])))
        limited = (
            Affine(np.diag(policy.output_scale / system.u_max), zeros),
            Activation("clip", -1.0, 1.0),
            Affine(np.diag(system.u_max), zeros),
        )
        network = Network((*policy.network.layers, *limited), policy.network.precision)
        A, B, D = system.A, system.B, system.D
        eta = system.navigation if np.any(system.navigation) else None
        return NetworkLoop(A, B, D, system.w_max, self.tracking.flow.h, network, reads, eta)

    @cached_property
    def reference_input(self) -> tuple[Array, Array]:
        """Return the policy's inputs at zero error, at every node, and bounds on their errors (K, q+1, r)."""
        cells, q = len(self.offset), self.feedback.nodes_per_cell
        times = np.repeat(np.arange(cells)[:, None, None] * np.float64(self.reference.delta), q + 1, axis=1)
        nu = np.repeat(self.own.nu[:cells, None], q + 1, axis=1)
        xi_U, xi = self.own.fine(q)[:cells], self.reference.fine(q)[:cells]
        bodies, C = self.obstacle_motion[0], np.abs(self.loop.C)
        read = self._stack(xi_U, xi, times, nu, bodies)
        # The two references are stored states: their inputs are known up to their round-off.
        errors = self._stack(self.own.rounding[:cells, None], 0 * xi, 0 * times, 0 * nu, 0 * bodies)
        errors = np.abs(errors) + self.reference.rounding[:cells, None] @ C.T
        return read, errors + gamma(self.system.n + 4) * (np.abs(read) + np.abs(xi) @ C.T)

    @property
    def slope(self) -> AffineController:
        """Return the clipped affine law that it is to first order at the start of its reference: no bound."""
        start, m = self.own.chi[0], self.system.m
        gain = -self.pullback(0, start, np.repeat(start[None], m, axis=0), np.eye(m)) @ self.loop.C
        references = self.reference, self.own, self.tracking
        return AffineController(self.name, self.system, gain, *references, clips=True)

    @cached_property
    def rounding(self) -> Array:
        """Return the round-off of scaling the output, as part of the state at the next node, shape (n,)."""
        return np.asarray(ROUNDING * np.abs(self.loop.flow.input_map(self.system.B)) @ self.system.u_max)

    def command(
        self, k: int, xi: Array, own: Array, x: Array, later: float = 0.0, scene: Array | None = None
    ) -> Array:
        """Thrust command before clipping, shape (..., m), some seconds after the start of step k.

        Obstacle data (..., 2d per body) are the middle of their range if they are left out.
        """
        return np.asarray(self.policy.network(self._read(k, own, x, later, scene)) * self.policy.output_scale)

    def pullback(self, k: int, own: Array, x: Array, weights: Array, later: float = 0.0) -> Array:
        """Gradient of ``weights . command`` by the policy's inputs, shape (..., r), for weights (..., m)."""
        read = self._read(k, own, x, later)
        return self.policy.network.pullback(read, weights * self.policy.output_scale)

    def _read(self, k: int, own: Array, x: Array, later: float, bodies: Array | None = None) -> Array:
        bodies = self.obstacle_motion[0][k, self.node(later)] if bodies is None else bodies
        read = self._stack(own, x, np.array([k * self.reference.delta]), self.own.nu[k], bodies)
        return np.broadcast_to(read, (*x.shape[:-1], read.shape[-1]))

    def node(self, later: float) -> int:
        """Number of the node of a step some seconds after its start."""
        return min(round(later / self.tracking.flow.h), self.feedback.nodes_per_cell)

    def propagate(self, start: Zonotope, k: int) -> TubeSegment:
        """Reachable set over step k from a set in error coordinates; refused where its numbers overflow."""
        nodes, intersamples, mu = [start], [], self.reference.nu[k]
        read, errors = self.reference_input
        try:
            for i in range(self.feedback.nodes_per_cell):
                spread = self.sight * self.obstacle_motion[1][k, i]
                after, intersample, command = self.loop.step(nodes[-1], read[k, i], -mu, errors[k, i], spread)
                band = np.abs(command.G[:, nodes[-1].order_count :]).sum(axis=1)
                widening = np.abs(self.loop.flow.input_map(self.system.B)) @ band * WIDER
                commanded = np.abs(command.c) + command.half_widths * (1 + WIDER)
                push, within = thruster_offset(self.system, self.loop.flow, commanded)
                nodes.append(reduced(after.inflate(widening + self.rounding) + push))
                intersamples.append(intersample + widening + within)
        except Unresolved as error:
            return TubeSegment(*no_tube(start, self.feedback.nodes_per_cell), str(error))
        rounding = self.reference.rounding[k] + self.own.rounding[k]
        end = reduced(nodes[-1].inflate(rounding))
        return TubeSegment(Zonotope.stack(nodes), np.array(intersamples) + rounding, end)

    def commanded(self, nodes: Zonotope, intersample: Array, k: int) -> tuple[Array, Array]:
        """Command in step k, its middle and spread at every node [N], shapes (q+1, m).

        `nodes` are errors about the law's own reference. The command at a node is held from there on.
        """
        error, spread = nodes + self.offset[k], self.sight * self.obstacle_motion[1][k, :, None]
        inputs = zip(*(part[k] for part in self.reference_input), spread, strict=True)
        sets = [self.loop.command(error[i], *node_inputs) for i, node_inputs in enumerate(inputs)]
        return np.array([z.c for z in sets]), np.array([z.half_widths for z in sets]) * (1 + WIDER)


def thruster_offset(system: Craft, flow: LinearFlow, level: Array) -> tuple[Zonotope, Array]:
    """Return the effect of thruster errors at the next node and until then, (n,), commands up to `level`."""
    if system.thrusters.exact and not system.unknown.size:
        return Zonotope(np.zeros(system.n), np.zeros((system.n, 0))), np.zeros(system.n)
    error, drift = system.thrusters.error(level), system.unknown
    size = np.abs(system.B) @ error
    effect = flow.input_zonotope(system.B, np.diag(error), size)
    if drift.size:
        carried = np.abs(drift).sum(axis=1)
        effect, size = effect + flow.input_zonotope(drift, np.eye(drift.shape[1]), carried), size + carried
    return effect, flow.h * flow.growth @ size


def no_tube(start: Zonotope, q: int) -> tuple[Zonotope, Array, Zonotope]:
    """Return the nodes, intersample bound and end of a refused `TubeSegment` of q parts."""
    return Zonotope.stack([start] * (q + 1)), np.zeros((q, start.dim)), start


def reduced(z: Zonotope) -> Zonotope:
    """Reduce a set with too many generators to few; done late, as it over-approximates rotating sets."""
    return z if z.order_count <= ORDER * z.dim else z.reduce(ORDER / 3)
