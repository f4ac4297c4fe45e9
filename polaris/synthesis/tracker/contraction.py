"""Error of the tracker under S, on exact states: its transitions, and the norm in which it contracts."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from reach.numerics.errors import ReachError
from reach.numerics.linear import powers
from reach.tubes.flow import LinearFlow

from ...model.craft import Array, Craft
from ...model.errors import ScenarioError
from .feedback import Feedback

LEFT_OVER, WITH_PROFILE = 1e-3, 1e-5
"""Share of an error (contraction norm) below which one ball collects all limits, without a feedback bound and
with one: it is constant from then on. Smaller: more rows."""


@dataclass(frozen=True, eq=False)
class Contraction:
    """The tracking error under S's feedback, other states of the loop apart.

    Parameters
    ----------
    system : Craft or LinearSystem
        Controlled system; one without errors unless it is a `Craft`.
    gain : ndarray, shape (m, n)
        Lambda.
    feedback : Feedback
        The control period, as a number of nodes per step.
    delta : float
        Planning step [s].
    level : float, optional
        Share of the thrust limits at which S's feedback bound after a hand-over starts to fall, where errors
        of thrusters grow with it (`feedback_bound`). Without it tightenings allow for all
        the errors of full thrust, at all times.
    """

    system: Craft
    gain: Array
    feedback: Feedback
    delta: float
    level: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "system", Craft.from_system(self.system))

    @cached_property
    def flow(self) -> LinearFlow:
        """Error dynamics of the safety controller."""
        flow = self.feedback.flow(self.system, self.gain, self.delta)
        try:
            flow.lyapunov  # noqa: B018  an unstable sampled loop is refused here, with its reason
        except ReachError as error:
            raise ScenarioError("feedback.period_s", flow.h, f"must give a stable loop: {error}") from error
        if not np.all(np.isfinite(flow.growth)):
            rule = "must be shorter: the motion within a step is too fast to be bounded"
            raise ScenarioError("horizon.step_s", self.delta, rule)
        return flow

    @cached_property
    def W(self) -> Array:
        """Weight of the norm ``norm(W e, 2)`` in which the error contracts, shape (n, n)."""
        return self.flow.lyapunov[0]

    @cached_property
    def W_inverse(self) -> Array:
        """Inverse of the weight."""
        return np.asarray(np.linalg.inv(self.W))

    @cached_property
    def settling(self) -> int:
        """Number of periods after which so little of any error (in the norm W) is left, see `LEFT_OVER`."""
        profiled = self.level is not None and self.system.proportional
        share, factor = WITH_PROFILE if profiled else LEFT_OVER, self.flow.lyapunov[1]
        count = int(np.ceil(np.log(share) / np.log(factor))) + 1
        norms = self.flow.norms(min(count, 5000))
        below = np.flatnonzero(norms <= share)
        return int(below[0]) if len(below) else len(norms) - 1

    @cached_property
    def transitions(self) -> Array:
        """``phi^l`` for l = 0 ... settling + 1, shape (settling + 2, n, n)."""
        return powers(self.flow.phi, self.settling + 1)

    @cached_property
    def decay(self) -> Array:
        """``norm(W phi^l W^-1, 2)`` for l = 0 ... settling + 1."""
        return self.flow.norms(self.settling + 1)

    @cached_property
    def decay_before(self) -> Array:
        """Return `decay` one period earlier, the weight of intersample bounds on both sides of a node."""
        return np.concatenate([self.decay[:1], self.decay[:-1]])

    @cached_property
    def period_gain(self) -> float:
        """Bound on ``norm(W e)`` reached within one period from rest by the disturbance."""
        return float(np.linalg.norm(np.abs(self.W) @ self.flow.period_box))

    @cached_property
    def accumulated(self) -> float:
        """Bound on ``norm(W e)`` at any node, however late, per unit of it added in every period."""
        factor = self.flow.lyapunov[1]
        return float(self.decay.sum() + self.decay[-1] * factor / (1 - factor))

    @cached_property
    def disturbance_radius(self) -> float:
        """Bound on ``norm(W e)`` reached by the disturbance alone at any node, however late."""
        return self.period_gain * (self.accumulated + 1.0)

    def curvature(self, rows: Array) -> Array:
        """Intersample bound of each row per unit of ``norm(W e)``, shape (..., r).

        ``(h^2/8) sup_s norm(row M''(s) W^-1, 2)``, with ``M'' = A_x e^{A_x s} A_c``.
        """
        flow = self.flow
        bend = np.abs(rows @ flow.A_x) @ flow.growth @ np.abs(flow.A_c @ self.W_inverse)
        return np.asarray(flow.h**2 / 8 * np.linalg.norm(bend, axis=-1))

    def per_size(self, rows: Array) -> Array:
        """Return the tightening of rows over the next period, per unit of ``norm(W e)``, shape (r,)."""
        return np.asarray(np.linalg.norm(rows @ self.W_inverse, axis=-1) + self.curvature(rows))

    def after_settling(self, rows: Array, radius: float) -> Array:
        """Return the tightening of rows after settling for errors up to ``norm(W e) = radius``, (r,)."""
        return np.asarray(self.per_size(rows) * self.decay[-1] * radius)
