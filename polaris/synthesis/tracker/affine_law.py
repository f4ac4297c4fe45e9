"""An affine feedback law: its data, and a period of it clipped, as a set."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from reach.numerics.linear import discretize, powers
from reach.numerics.relaxation import clip_relaxation
from reach.sets.zonotope import Zonotope
from reach.tubes.flow import LinearFlow

from ...model.errors import ScenarioError
from ...model.system import Array, LinearSystem
from ...planning.reference import Reference
from .feedback import Feedback
from .tracking import Tracking

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
        """The safety controller's."""
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

    def command(self, k: int, xi: Array, own: Array, x: Array) -> Array:
        """Thrust command before clipping, shape (..., m)."""
        return np.asarray(self.own.nu[k] + (own - x) @ self.gain.T)


def clipped_step(law: AffineLaw, d: Zonotope, mu: Array) -> tuple[Zonotope, Array]:
    """Enclose the next node of ``d' = A d + B (clip(mu - Lambda_U d) - mu) + D w``.

    d is relative to the law's own reference, mu, shape (m,), that reference's input. Returned with the set
    are the slopes of the band, shape (m,): what the set rests on, and a certificate repeats.
    """
    phi, known, push, slope = clipped_map(law, d, mu)
    out = phi @ d + known + law.flow.period_zonotope
    return (out + push if np.any(push.G) else out).reduce(6), slope


def clipped_map(law: AffineLaw, d: Zonotope, mu: Array) -> tuple[Array, Array, Zonotope, Array]:
    """What `clipped_step` makes of d but for the disturbance, ``phi d + known + push``, and the slopes.

    The clip is replaced by an affine band over the range of the command at the node, which is then held.
    """
    system = law.system
    image = law.gain @ d
    lo, hi = mu - image.c - image.half_widths, mu - image.c + image.half_widths
    slope, offset, radius = clip_relaxation(lo, hi, system.u_max)
    Ah, Bh = discretize(system.A, system.B, law.flow.h)
    known = Bh @ (slope * mu + offset - mu)
    return Ah - Bh @ (slope[:, None] * law.gain), known, Zonotope(np.zeros(system.n), Bh * radius), slope
