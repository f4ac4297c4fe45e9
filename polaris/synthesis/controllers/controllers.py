"""The safety controller S, and the kinds of experimental controller U that reachability covers.

Every controller flies one planning step at a time in error coordinates ``e = x - xi(t)`` about the
safe reference, so that its tube is compared with the recoverable sets directly. S and affine laws fly sets of
the whole loop state, whose first part is the error.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np

from reach.sets.zonotope import Zonotope
from reach.short_repr import short_repr
from reach.tubes.flow import LinearFlow

from ...model.craft import Array, Craft
from ...model.tolerances import ROUNDING
from ...planning.reference import Reference
from ..tracker.affine_law import LOOP_ALONE, AffineLaw, clipped_step, raised
from ..tracker.intersample import affine_bound, at_nodes, clipped_bound
from ..tracker.tracking import Tracking

ORDER, WIDE, WHOLE, FILTERED = 25.0, 60.0, 50.0, 80.0
"""Generators per dimension of the error kept at the end of a step: without errors, with, of whole loop
states per state of the plant, and of those with an observer, whose noise is fresh in every period. The
checker keeps 64: with more here, it would not confirm some claims."""


@short_repr
@dataclass(frozen=True, eq=False)
class TubeSegment:
    """Reachable set of one controller over a step, sound in continuous time (docs/theory.md, Theorem 10).

    Attributes
    ----------
    states : Zonotope
        Stack of q+1 sets of the loop state, or of errors alone. The errors over ``[t_i, t_{i+1}]`` lie within
        the convex hull of those at the two nodes (corresponding points), up to `intersample`.
    intersample : ndarray, shape (q, n)
        Elementwise bound on the distance from that hull: curvature of the motion, and the disturbance
        since the node.
    end : Zonotope
        Set at the end of the step, reduced, of the same dimension.
    refused : str
        Why this controller must not fly here at all ("" if it may).
    slopes : ndarray or None, shape (q, m)
        Slopes of the bands that a clipped command was enclosed in; None if nothing clips.
    """

    states: Zonotope
    intersample: Array
    end: Zonotope
    refused: str = ""
    slopes: Array | None = None

    @cached_property
    def nodes(self) -> Zonotope:
        """Errors at the nodes, a stack of q+1 sets."""
        n = self.intersample.shape[-1]
        if self.states.dim == n:
            return self.states
        G = self.states.G[:, :n]
        return Zonotope(self.states.c[:, :n], G[..., np.any(G != 0, axis=(0, 1))])


class Controller(Protocol):
    """Interface of a controller to the synthesis. Mode numbers follow section II: 0 is S."""

    @property
    def name(self) -> str:
        """Name in tables and figures."""

    def propagate(self, start: Zonotope, k: int) -> TubeSegment:
        """Return the set reached over step k from a set of errors; of loop states, for S and affine laws."""

    def command(self, k: int, xi: Array, own: Array, x: Array) -> Array:
        """Thrust command, before any clipping, for states x of shape (..., n).

        `xi` and `own` are the states, at the same instant, of the safe reference and of the
        controller's own reference.
        """


@short_repr
@dataclass(frozen=True, eq=False)
class AffineController(AffineLaw):
    """``u = mu_U(t) + Lambda_U (xi_U(t) - x)``, unlimited or clipped to the thrust limits.

    With ``clips=False`` the command itself must respect the limits: where the tube shows that it
    might not, the controller is refused for that step. With ``clips=True`` the saturation is
    part of the model, through a sound relaxation of the clip.

    Parameters
    ----------
    name : str
        Name in tables and figures.
    system : Craft or LinearSystem
        Controlled system.
    gain : ndarray, shape (m, n)
        Lambda_U.
    reference : Reference
        The safe reference, on which the error coordinates rest.
    own : Reference
        The law's own reference (the same object if shared), on the same steps.
    tracking : Tracking
        The safety tracker, whose nodes are the law's.
    clips : bool
        Whether commands beyond the limits are part of the model.
    """

    def propagate(self, start: Zonotope, k: int) -> TubeSegment:
        """Reachable set over step k, with errors of the thrusters as large as its commands allow.

        A tube that is found under errors of commands within some bound, and in which commands keep within it,
        holds every flight: none can be the first to exceed it.
        """
        law, start = self.in_step(k), self.tracking.loop_state(start)
        if not self.system.proportional:
            return law._reach(start, k)[0]
        bound = law.foreseen(start - self.loop_offset(k)[0], k)
        while True:
            tube, commanded = law._like(bound, law.step_error)._reach(start, k)
            if np.all(commanded <= bound):
                return tube
            bound = raised(bound, commanded, self.system.u_max)

    def in_step(self, k: int) -> "AffineController":
        """Return the law with the errors of estimates that there may be in step k."""
        errors = self.tracking.step_errors
        return self._like(self.level, errors[min(k, len(errors) - 1)]) if np.any(errors) else self

    def _like(self, commands: Array | None, estimate_error: Array | None) -> "AffineController":
        """Return the law, made once, with bounds on commands (m,) and on further estimate errors (n,)."""
        key = tuple(b"" if bound is None else bound.tobytes() for bound in (commands, estimate_error))
        law = self._levels.get(key)
        if law is None:
            law = self._levels[key] = replace(self, level=commands, step_error=estimate_error, _levels={})
            if estimate_error is self.step_error:
                vars(law).update(flow=self.flow, closed=self.closed, powers=self.powers)
                vars(law).update(offset=self.offset, _loop_offsets=self._loop_offsets)
        assert isinstance(law, AffineController)
        return law

    def _reach(self, start: Zonotope, k: int) -> tuple[TubeSegment, Array]:
        """Reachable set over step k, and the largest commands in it, shape (m,).

        Where the tube of the unclipped law stays within the thrust limits, the clipped law is the
        same law; only elsewhere is the clip relaxed (or an unclipped controller refused).
        """
        zeta, n = self.loop_offset(k), self.system.n
        d = start - zeta[0]
        nodes = self.powers @ d + self.disturbance
        intersample = affine_bound(self, nodes[:-1], k)
        commanded, refused, slopes = self._at_most(nodes, intersample, k), "", None
        excesses = commanded + self.noise - self.system.u_max
        excess, axis = float(excesses.max()), int(np.argmax(excesses))
        if excess > 0 and self.clips:  # errors of the estimate come after the clip (Proposition 5 (a))
            nodes = self.powers @ d + self.disturbance_if_cut
            intersample = affine_bound(self, nodes[:-1], k)
            commanded = self._at_most(nodes, intersample, k)
        if self.clips and np.any(commanded > self.system.u_max):
            nodes, slopes = self._clipped_nodes(d, k)
            intersample = clipped_bound(self, nodes[:-1], k)
            commanded = self._at_most(nodes, intersample, k)
        elif excess > 0 and not self.clips:
            refused = f"its command may exceed the limit of {self.system.input_names[axis]} by {excess:.3g}"
        # The two references are stored states: their distance is known up to their round-off.
        rounding = self.reference.rounding[k] + self.own.rounding[k]
        states = nodes + zeta
        end = states[-1].inflate(np.pad(rounding, (0, states.dim - n)))
        loop_order = (WHOLE if self.system.observer is None else FILTERED) * n / states.dim
        order = ORDER if self.system.ideal else WIDE if states.dim == n else loop_order
        segment = TubeSegment(states, intersample + rounding, end.reduce(order, "parallel"), refused, slopes)
        return segment, np.minimum(commanded + self.noise, self.system.u_max)

    @cached_property
    def idle(self) -> "AffineController":
        """Return a law without feedback: loop states beside the error move under it as under any law."""
        return replace(self, name="idle", gain=0 * self.gain, _levels={})

    def with_reference(self, reference: Reference, tracking: Tracking) -> "AffineController":
        """Return the law beside another safe reference, which is its own as well if the first one was."""
        own_reference = reference if self.own is self.reference else self.own
        law = replace(self, reference=reference, own=own_reference, tracking=tracking, _levels={})
        if tracking is self.tracking:
            vars(law).update({name: vars(self)[name] for name in LOOP_ALONE & vars(self).keys()})
        return law

    def commanded(self, nodes: Zonotope, intersample: Array, k: int) -> tuple[Array, Array]:
        """Command before clipping in step k, `noise` apart, its middle and spread, shapes (q+1, m) [N].

        `nodes` are loop states about the law's own reference. With the intersample bound on either side
        added, the hull of two nodes contains the commands in the part between them.
        """
        centre = self.own.nu[k] - nodes.c @ self.closed.K.T
        spread = np.abs(self.closed.K @ nodes.G).sum(axis=-1)
        return centre, spread + at_nodes(intersample) @ np.abs(self.gain).T

    def _at_most(self, nodes: Zonotope, intersample: Array, k: int) -> Array:
        """Bound on the unclipped command in the step, `noise` apart [N], shape (m,)."""
        centre, spread = self.commanded(nodes, intersample, k)
        return np.asarray(((np.abs(centre) + spread) * (1 + ROUNDING)).max(axis=0))

    def _clipped_nodes(self, d: Zonotope, k: int) -> tuple[Zonotope, Array]:
        nodes, slopes = [d], []
        for _ in range(self.feedback.nodes_per_cell):
            node, slope = clipped_step(self, nodes[-1], self.own.nu[k])
            nodes.append(node)
            slopes.append(slope)
        return Zonotope.stack(nodes), np.array(slopes)


@dataclass(frozen=True, eq=False)
class AnyThrust:
    """Anything within the thrust limits: covers a black box or a learned policy.

    The input is a set; nothing is assumed of the law but that the thrusters clip it.
    """

    name: str
    system: Craft
    reference: Reference
    tracking: Tracking

    def __post_init__(self) -> None:
        object.__setattr__(self, "system", Craft.from_system(self.system))

    def with_reference(self, reference: Reference, tracking: Tracking) -> "AnyThrust":
        """Return the controller beside another safe reference."""
        return replace(self, reference=reference, tracking=tracking)

    @cached_property
    def flow(self) -> LinearFlow:
        """Open-loop motion of the error."""
        h = self.tracking.flow.h
        E = self.system.error_map(np.zeros(self.system.m))
        return LinearFlow.continuous(self.system.A, self.system.D, self.system.w_max, h, E)

    @cached_property
    def _push(self) -> Zonotope:
        """Return the set that the inputs, centred at zero, add to the state per period."""
        B, u_max = self.system.B, self.system.u_max + self.system.thrusters.error(self.system.u_max)
        return self.flow.input_zonotope(B, np.diag(u_max), np.abs(B) @ u_max)

    def command(self, k: int, xi: Array, own: Array, x: Array) -> Array:
        """Return the worst steering to hand: full thrust towards the frame's origin, shape (..., m)."""
        direction = -(x @ self.system.position.T) @ self.system.position @ self.system.A @ self.system.B
        return np.asarray(np.sign(direction) * self.system.u_max)

    def propagate(self, start: Zonotope, k: int) -> TubeSegment:
        """Reachable set over step k under every input within the limits."""
        push = self._push
        step = -(self.flow.input_map(self.system.B) @ self.reference.nu[k])
        nodes = [start]
        for _ in range(self.tracking.feedback.nodes_per_cell):
            successor = self.flow.phi @ nodes[-1] + step + push + self.flow.period_zonotope
            nodes.append(successor.reduce(ORDER))
        # Between nodes the input's share is that of a part of the period: inside the whole's.
        spread = [node + push for node in nodes[:-1]] + [nodes[-1]]
        stack = Zonotope.stack(spread)
        drift = np.abs(self.system.B @ self.reference.nu[k])  # the known part of the rate
        curvature = (
            self.flow.intersample(stack[:-1])
            + self.flow.h**2 / 8 * np.abs(self.system.A) @ self.flow.growth @ drift
        )
        intersample = curvature + self.flow.period_box
        return TubeSegment(stack, intersample, nodes[-1].inflate(self.reference.rounding[k]).reduce(ORDER))


def propagate_states(law: Controller, start: Zonotope, k: int, s: AffineController) -> TubeSegment:
    """Return the tube of a controller over step k from loop states; `s` is the safety controller."""
    if isinstance(law, AffineController):
        return law.propagate(start, k)
    return beside_errors(law.propagate(s.tracking.true_error(start), k), start, s)


def beside_errors(tube: TubeSegment, start: Zonotope, s: AffineController) -> TubeSegment:
    """Return a tube of true errors with the other loop states, which move by themselves from `start` on."""
    if tube.end.dim == start.dim:
        return tube
    idle, n, offset = s.idle, s.system.n, s.tracking.state_offset
    disturbance = Zonotope(idle.disturbance.c[:, n:], idle.disturbance.G[:, n:])
    others = idle.powers[:, n:, n:] @ Zonotope(start.c[n:], start.G[n:]) + disturbance

    def joined(errors: Zonotope, others: Zonotope) -> Zonotope:
        errors = errors.inflate(offset) if np.any(offset) else errors
        G = np.zeros((*errors.batch, start.dim, errors.order_count + others.order_count))
        G[..., :n, : errors.order_count], G[..., n:, errors.order_count :] = errors.G, others.G
        return Zonotope(np.concatenate([errors.c, others.c], axis=-1), G)

    order = (WHOLE if s.system.observer is None else FILTERED) * n / start.dim
    end = joined(tube.end, others[-1]).reduce(order, "parallel")
    return replace(tube, states=joined(tube.states, others), end=end)


def construct_s(tracking: Tracking, reference: Reference) -> AffineController:
    """Return the safety controller S of Algorithm 1: ``s(x, t) = Lambda (xi(t) - x) + mu(t)``."""
    return AffineController("safety", tracking.system, tracking.gain, reference, reference, tracking)
