"""The tracking controller of section III-A: its error dynamics, and the tight error tube."""

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain

import numpy as np

from reach.brief import brief
from reach.numerics.errors import ReachError
from reach.numerics.linear import powers, summed
from reach.tubes.flow import LinearFlow

from ...model.errors import ScenarioError
from ...model.system import Array, LinearSystem
from ...model.tolerances import ROUNDING
from .feedback import Feedback
from .profile import profile
from .transients import answered, lost, misled, moved

LEFT_OVER = 1e-3
"""Share of an error (contraction norm) below which one ball collects all limits. Smaller: more rows."""


@brief
@dataclass(frozen=True, eq=False)
class Tracking:
    """The tracker, and everything about its error that later stages need.

    Parameters
    ----------
    system : LinearSystem
        What is controlled.
    gain : ndarray, shape (m, n)
        Lambda.
    feedback : Feedback
        The control period, as a number of nodes per step.
    delta : float
        Planning step [s].
    level : float, optional
        Share of the thrust limits from which what S's feedback commands after a hand-over falls, where errors
        of thrusters grow with it (`profile`). Without it they are booked for all
        that the thrusters have, at all times.
    """

    system: LinearSystem
    gain: Array
    feedback: Feedback
    delta: float
    level: float | None = None

    @property
    def error(self) -> Array:
        """Bounds on the errors of what S applies, shape (m,); without those that the profile bounds."""
        most = self.system.u_max if self.level is None else np.zeros(self.system.m)
        return self.system.calmest.command_error(self.gain, most) + self.system.thrusters.error(most)

    def caused(self, profile: Array, before: Array | None = None) -> Array:
        """Errors of the inputs by period that commands within a profile (L, m) cause, shape (L, m).

        Both what they are off by, and what that does to later ones until it is measured (Lemma 44). Before a
        hand-over what is commanded is within `before`, else within all that there is.
        """
        system, first = self.system, self.system.u_max if before is None else before
        hidden = min(system.timing.hidden, len(profile))
        known = np.vstack([np.tile(first, (hidden, 1)), profile[: len(profile) - hidden]])
        late = system.command_error(self.gain, known) - system.command_error(self.gain, 0 * profile)
        return np.asarray(system.thrusters.part(profile) + late)

    @property
    def varies(self) -> bool:
        """Whether some errors of inputs are booked by the time of the flight, not since a hand-over."""
        return self.profile is not None or self.system.error_by_step is not None

    @cached_property
    def profile(self) -> Array | None:
        """Bound on what S's feedback commands after a hand-over, period by period, shape (memory + 2, m).

        None where errors of thrusters do not depend on it, or are booked for more.
        """
        if self.level is None or not self.system.thrusters.proportional:
            return None
        gain, u_max = self.gain, self.system.u_max
        norms = np.linalg.norm(gain @ self.transitions @ self.W_inverse, axis=-1)
        left = self.forgotten(gain, float(np.min(u_max / norms[0])))
        noise = self.system.calmest.command_error(gain)
        return profile(norms, self.level * u_max, left, u_max, lambda found: self.pushed(gain, found) + noise)

    @property
    def most(self) -> Array:
        """What S's feedback commands at most, shape (m,)."""
        return self.system.u_max if self.profile is None else self.profile[0]

    @cached_property
    def flow(self) -> LinearFlow:
        """Error dynamics of the safety controller."""
        flow = self.feedback.flow(self.system, self.gain, self.delta, self.error)
        try:
            flow.lyapunov  # noqa: B018  an unstable sampled loop is refused here, with its reason
        except ReachError as error:
            raise ScenarioError("feedback.period_s", flow.h, f"must give a stable loop: {error}") from error
        if not np.all(np.isfinite(flow.growth)):
            rule = (
                "is too long for the fastest motion of the system: what happens within it cannot be bounded"
            )
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
    def memory(self) -> int:
        """Number of periods after which less than `LEFT_OVER` of any error (in the norm W) is left."""
        factor = self.flow.lyapunov[1]
        most = int(np.ceil(np.log(LEFT_OVER) / np.log(factor))) + 1
        norms = self.flow.norms(min(most, 5000))
        below = np.flatnonzero(norms <= LEFT_OVER)
        return int(below[0]) if len(below) else len(norms) - 1

    @cached_property
    def transitions(self) -> Array:
        """``phi^l`` for l = 0 ... memory + 1, shape (memory + 2, n, n)."""
        return powers(self.flow.phi, self.memory + 1)

    @cached_property
    def decay(self) -> Array:
        """``norm(W phi^l W^-1, 2)`` for l = 0 ... memory + 1."""
        return self.flow.norms(self.memory + 1)

    @cached_property
    def decay_before(self) -> Array:
        """`decay` one period earlier: what weighs the bookings on both sides of a node."""
        return np.concatenate([self.decay[:1], self.decay[:-1]])

    @cached_property
    def misled(self) -> list[Array]:
        """How far each fault that is isolated late misleads an observer, shapes (J, memory + 2, n)."""
        system = self.system
        return [misled(system, fault, self.flow.h, self.memory + 2) for fault in system.transients]

    @cached_property
    def upsets(self) -> Array:
        """Boxes of states, one of which holds what a fault that is isolated late has added, shape (J, n)."""
        system, h, found = self.system, self.flow.h, [np.zeros((0, self.system.n))]
        try:
            with np.errstate(over="raise", invalid="raise"):
                for fault, off in zip(system.transients, self.misled, strict=True):
                    if len(fault.thrust):
                        found.append(moved(system, fault, self.gain, h, off[:, 0]))
                    else:
                        found.append(lost(system, fault, h, self.left))
        except (ReachError, FloatingPointError) as error:
            told = [(fault.name, fault.lasts) for fault in system.transients]
            raise ScenarioError("faults", told, "isolated so late are bounded by nothing") from error
        return np.vstack(found)

    def left(self, rows: Array, boxes: Array) -> Array:
        """What errors in boxes (J, n) need along rows up to l periods later, shape (memory + 2, r, J)."""
        size = np.linalg.norm(boxes @ np.abs(self.W).T, axis=1)
        reach = np.maximum.accumulate(np.abs(rows @ self.transitions) @ boxes.T)
        beyond = np.linalg.norm(rows @ self.W_inverse, axis=-1)[:, None] * self.decay[-1] * size
        return np.asarray(np.maximum(reach, beyond) + self.curvature(rows)[:, None] * size)

    def upset(self, rows: Array) -> Array:
        """What faults that are isolated late need along rows up to l periods later, shape (memory + 2, r)."""
        most = self.left(rows, self.upsets)
        gains = self.flow.input_gains(rows, self.system.B, self.memory + 2)
        for j, off in enumerate(chain.from_iterable(self.misled) if self.system.observer else ()):
            errors = off @ np.abs(self.gain).T  # S answers what its estimates are off by
            most[..., j] += answered(gains, errors) + sum(self.late(rows, errors[0])) + np.abs(rows) @ off[0]
        return np.asarray(most.max(axis=-1, initial=0.0) * (1 + ROUNDING))

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
        """Booking between nodes per unit of ``norm(W e)``, for each row, shape (..., r).

        ``(h^2/8) sup_s norm(row M''(s) W^-1, 2)``, with ``M'' = A_x e^{A_x s} A_c``.
        """
        flow = self.flow
        bend = np.abs(rows @ flow.A_x) @ flow.growth @ np.abs(flow.A_c @ self.W_inverse)
        return np.asarray(flow.h**2 / 8 * np.linalg.norm(bend, axis=-1))

    def forgotten(self, rows: Array, radius: float) -> Array:
        """What errors up to ``norm(W e) = radius`` still need along rows beyond the memory, shape (r,)."""
        weight = np.linalg.norm(rows @ self.W_inverse, axis=-1) + self.curvature(rows)
        return np.asarray(weight * self.decay[-1] * radius)

    def late(self, rows: Array, error: Array) -> tuple[Array, Array]:
        """What input errors up to some size add beyond the memory, and between nodes, each of shape (r,)."""
        box = replace(self.flow, w_max=0.0, E=self.system.B * error).period_box
        size, factor = float(np.linalg.norm(np.abs(self.W) @ box)), self.flow.lyapunov[1]
        tail = np.linalg.norm(rows @ self.W_inverse, axis=-1) * self.decay[-1] * size / (1 - factor)
        return tail, self.curvature(rows) * size * (self.accumulated + 1.0)

    def disturbance(self, rows: Array, failing: bool = True) -> Array:
        """What the disturbance adds along each row until L periods have passed, shape (memory + 3, r).

        Entry L holds for every instant up to and including the (L+1)-st period, so that between
        nodes nothing is missing. The last entry holds for all time.
        """
        return self.pushed(rows, self.profile, failing)

    def responses(self, rows: Array, count: int, settled: bool = False) -> Array:
        """What the disturbance adds along each row by node L = 0 ... count, count <= memory + 2.

        Where S is settled, its feedback has commanded no more than the last of its profile all along.
        """
        sums = self.flow.disturbance_support(rows, count)
        if self.profile is not None:
            gains = self.flow.input_gains(rows, self.system.B, count)
            last, most = None, self.profile
            if settled:
                last, most = most[-1], np.broadcast_to(most[-1], most.shape)
            sums = sums + summed(gains, self.caused(most, last))[: count + 1]
        return np.asarray(sums)

    def pushed(self, rows: Array, profile: Array | None, failing: bool = True) -> Array:
        """The same as `disturbance` under the errors of commands within a profile, shape (memory + 2, m)."""
        sums = self.flow.disturbance_support(rows, self.memory + 2)
        first = sums[1]
        booked = self.curvature(rows) * self.disturbance_radius
        until = sums[1:] + first + booked
        factor = self.flow.lyapunov[1]
        tail = np.linalg.norm(rows @ self.W_inverse, axis=-1) * self.decay[-1]
        tail *= self.period_gain / (1 - factor)
        found = np.vstack([until, until[-1] + tail])
        if failing and self.system.transients:
            found += self.upset(rows)[np.minimum(np.arange(len(found)) + 2, self.memory + 1)]
        if profile is None:
            return found
        errors = self.caused(profile)
        gains = self.flow.input_gains(rows, self.system.B, self.memory + 2)
        sums, within = summed(gains, errors), errors @ gains[0].T
        more = np.maximum(sums[:-1] + within, sums[1:])
        tail, curved = self.late(rows, errors[0])
        return np.asarray(found + curved + np.vstack([more, sums[-1:] + within[-1:] + tail]))
