"""An affine feedback law: its data, and a period of it clipped, as a set."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from reach.numerics.linear import discretize, powers
from reach.numerics.relaxation import clip_relaxation
from reach.sets.zonotope import Zonotope
from reach.tubes.flow import LinearFlow

from ..model.errors import ScenarioError
from ..model.system import Array, LinearSystem
from ..planning.reference import Reference
from .demand import taken_over
from .tracking import Feedback, Tracking

TOGETHER = 5  # periods whose errors are merged in a tube at most; where a step has few, half of them


@dataclass(frozen=True, eq=False)
class AffineLaw:
    """``u = mu_U(t) + Lambda_U (xi_U(t) - x)``, clipped by the thrusters; fields as in `AffineController`."""

    name: str
    system: LinearSystem
    gain: Array
    reference: Reference
    own: Reference
    tracking: Tracking
    clips: bool = False
    most: Array | None = None
    _relaxed: dict[bytes, LinearFlow] = field(default_factory=dict, repr=False)
    _levels: dict[bytes, "AffineLaw"] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        shape = (self.system.m, self.system.n)
        if np.shape(self.gain) != shape or not np.all(np.isfinite(self.gain)):
            raise ScenarioError(f"{self.name}.gain", np.shape(self.gain), f"must be finite, of shape {shape}")
        if self.own.delta != self.reference.delta:
            rule = f"must have steps of {self.reference.delta:g} s, as the safe reference has"
            raise ScenarioError(f"{self.name}.own", self.own.delta, rule)

    @property
    def feedback(self) -> Feedback:
        """Continuous or sampled, as the safety controller."""
        return self.tracking.feedback

    @cached_property
    def flow(self) -> LinearFlow:
        """Error dynamics about the law's own reference, unsaturated."""
        return self.feedback.flow(self.system, self.gain, self.reference.delta, self.error)

    @cached_property
    def error(self) -> Array:
        """Bounds on the errors of what is applied, shape (m,), as long as commands are within `most`."""
        return self.system.input_error(self.gain, self.system.u_max if self.most is None else self.most)

    @cached_property
    def open_flow(self) -> LinearFlow:
        """Motion under a known input: what bounds a clipped law before its command is known."""
        return self._continuous(self.system.A, self.error)

    def _continuous(self, A: Array, error: Array) -> LinearFlow:
        """Continuous motion of some matrix under the disturbance and errors of the inputs."""
        system = self.system
        E = system.error_map(error)
        return LinearFlow.continuous(A, system.D, system.w_max, self.flow.h, E)

    def relaxed_flow(self, slope: Array) -> LinearFlow:
        """Error dynamics where the clip lets a share `slope`, shape (m,), of the feedback through."""
        key = slope.tobytes()
        if key not in self._relaxed:
            A_c = self.system.A - self.system.B @ (slope[:, None] * self.gain)
            self._relaxed[key] = self._continuous(A_c, self.error)
        return self._relaxed[key]

    @cached_property
    def powers(self) -> Array:
        """Transitions from the start of a cell to its nodes, shape (q+1, n, n)."""
        return powers(self.flow.phi, self.feedback.nodes_per_cell)

    @cached_property
    def disturbance(self) -> Zonotope:
        """What the disturbance adds by every node of a cell.

        Until the cell's own commands are all that is not measured yet, estimates may be off by more.
        """
        q, system, hidden = self.feedback.nodes_per_cell, self.system, self.system.timing.hidden
        least = 0 * self.error if self.most is None else system.command_error(self.gain, self.most)
        more = system.command_error(self.gain) - least
        together = 1 if system.ideal else min(TOGETHER, max(q // 2, 1))
        if self.most is None or hidden >= q or not np.any(more > 0):
            return self.flow.disturbance_nodes(q, together=together)
        flow = self.feedback.flow(system, self.gain, self.reference.delta, self.error - more)
        first, n = flow.input_map(system.B) * more, system.n
        early = np.zeros((q + 1, n, hidden * system.m))
        for j in range(hidden):
            early[j + 1 :, :, j * system.m : (j + 1) * system.m] = self.powers[: q - j] @ first
        return flow.disturbance_nodes(q, together=together) + Zonotope(np.zeros((q + 1, n)), early)

    @cached_property
    def offset(self) -> Array:
        """``xi_U - xi`` at the nodes of every cell, shape (K, q+1, n)."""
        q, cells = self.feedback.nodes_per_cell, min(self.own.cells, self.reference.cells)
        return self.own.fine(q)[:cells] - self.reference.fine(q)[:cells]

    @cached_property
    def period_box(self) -> Array:
        """Elementwise bound on what the disturbance adds within a period, shape (n,).

        Whatever the law does meanwhile: unclipped, clipped (the clip has slope at most 1, so nothing
        grows faster than ``|A| + |B| |Lambda_U|`` lets it), or giving way to S at any instant.
        """
        if self.feedback.sampled:
            return self.flow.period_box
        fastest = np.maximum(np.abs(self.flow.A_c), np.abs(self.tracking.flow.A_c))
        if self.clips:
            fastest = np.maximum(fastest, np.abs(self.system.A) + np.abs(self.system.B) @ np.abs(self.gain))
        error = np.maximum(self.error, taken_over(self.tracking, self.reference))
        return self._continuous(fastest, error).period_box

    def command(self, k: int, xi: Array, own: Array, x: Array) -> Array:
        """Thrust command before clipping, shape (..., m)."""
        return np.asarray(self.own.nu[k] + (own - x) @ self.gain.T)


SLOPES = 8  # different slopes of the relaxed clip per axis: each needs its own matrix exponentials, kept


def clipped_step(law: AffineLaw, d: Zonotope, mu: Array) -> tuple[Zonotope, Array]:
    """Enclose the next node of ``d' = A d + B (clip(mu - Lambda_U d) - mu) + D w``.

    d is relative to the law's own reference, mu, shape (m,), that reference's input. Returned with the set
    are the slopes of the band, shape (m,): what the set rests on, and a certificate repeats.
    """
    phi, known, push, slope = clipped_map(law, d, mu)
    noise = law.flow if law.feedback.sampled else law.relaxed_flow(slope)
    out = phi @ d + known + noise.period_zonotope
    return (out + push if np.any(push.G) else out).reduce(6), slope


def clipped_map(law: AffineLaw, d: Zonotope, mu: Array) -> tuple[Array, Array, Zonotope, Array]:
    """What `clipped_step` makes of d but for the disturbance, ``phi d + known + push``, and the slopes.

    The clip is replaced by an affine band over the range of the command: at the node for sampled
    feedback (the input is then held), over the whole period for continuous feedback.
    """
    system = law.system
    image = law.gain @ d
    lo, hi = mu - image.c - image.half_widths, mu - image.c + image.half_widths
    if law.feedback.sampled:
        slope, offset, radius = clip_relaxation(lo, hi, system.u_max)
        Ah, Bh = discretize(system.A, system.B, law.flow.h)
        known = Bh @ (slope * mu + offset - mu)
        return Ah - Bh @ (slope[:, None] * law.gain), known, Zonotope(np.zeros(system.n), Bh * radius), slope
    command = np.maximum(np.abs(mu - lo), np.abs(hi - mu)) + np.maximum(np.abs(mu) - system.u_max, 0)
    moved, _ = clipped_motion(law, d.extent, command, mu)
    drift = np.abs(law.gain) @ moved
    slope, offset, radius = clip_relaxation(lo - drift, hi + drift, system.u_max, SLOPES)
    step = law.relaxed_flow(slope)
    push = step.input_zonotope(system.B, np.diag(radius), np.abs(system.B) @ radius)
    return step.phi, step.input_map(system.B) @ (slope * mu + offset - mu), push, slope


def clipped_motion(law: AffineLaw, extent: Array, command: Array, mu: Array) -> tuple[Array, Array]:
    """How far a clipped law moves within one period, and how hard it can push, elementwise.

    From bounds on ``|d|`` at the node (..., n) and on ``|Lambda_U d|`` there (..., m), plus what mu (m,), the
    law's own input, exceeds the limits by: bounds on ``|d(s) - d(0)|``, disturbance included, and on
    ``|clip(mu - Lambda_U d) - mu|``: at most ``|Lambda_U d|``, as the clip has slope at most 1, and at most
    what the thrusters have.
    """
    system, loose = law.system, law.open_flow
    most = system.u_max + np.abs(mu)
    push = np.broadcast_to(most, command.shape)
    still = extent @ (loose.growth - np.eye(system.n)).T + loose.period_box
    for _ in range(3):
        moved = still + loose.h * push @ np.abs(system.B).T @ loose.growth.T
        push = np.minimum(most, command + moved @ np.abs(law.gain).T)
    return still + loose.h * push @ np.abs(system.B).T @ loose.growth.T, push
