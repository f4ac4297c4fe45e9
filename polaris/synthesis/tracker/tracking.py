"""The tracking controller of section III-A: its error dynamics, and the tight error tube."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from reach.numerics.errors import ReachError
from reach.numerics.linear import powers
from reach.sets.zonotope import Zonotope
from reach.short_repr import short_repr

from ...model.errors import ScenarioError
from ...model.system import Array
from ...model.tolerances import ROUNDING
from ..sources.craft import craft_loop
from ..sources.estimate import step_errors
from ..sources.late_faults import touched, wrong_thrust
from ..sources.outages import OutageDifference, outage_errors, unlearned, unmade
from ..sources.source import remembers
from .channel import Channel
from .contraction import Contraction
from .feedback_bound import feedback_bound
from .loop import Loop
from .tightening import Response, Tightening


@short_repr
@dataclass(frozen=True, eq=False)
class Tracking(Contraction):
    """The tracker, and everything about its error that later stages need.

    Fields are those of `Contraction`, which bounds the error under S on exact states.
    """

    @cached_property
    def loop(self) -> Loop:
        """Loop of the craft, of which the tracking error is the first part, under any law."""
        return craft_loop(self.system, self.delta / self.feedback.nodes_per_cell)

    @cached_property
    def tightening(self) -> Tightening:
        """Bounds on the loop under S."""
        scale = np.resize(np.linalg.norm(self.W_inverse, axis=1), self.loop.N)
        return Tightening(self.loop.close(self.gain), self.system.u_max, scale)

    @cached_property
    def tables(self) -> dict[Any, Any]:
        """Tables of rows carried back through the loop, by their key (`CarriedRows.from_tracking`)."""
        return {}

    @property
    def commands(self) -> Array:
        """Rows of the loop state that bound S's feedback on both sides, ``K`` and ``-K``, (2 m, N)."""
        return np.vstack([self.tightening.closed.K, -self.tightening.closed.K])

    @property
    def estimate_error_rows(self) -> Array:
        """Rows of the loop state that are errors of the estimate a law acts on, shape (n, N)."""
        return np.asarray(self.loop.sensed - self.pad(np.eye(self.system.n)))

    def unremembered(self, most: Array) -> Array:
        """Bound estimate errors that no loop state holds, under commands within a bound (m,), shape (n,)."""
        system = self.system
        limits = self.tightening
        total = self.step_errors.max(axis=0) + system.state_offset_at_nodes
        for each in limits.closed.loop.channels:
            if each.noise is not None:
                total = total + np.abs(each.noise) @ limits.largest(each, most)
        return np.asarray(total)

    def error(self, sets: Zonotope) -> Zonotope:
        """Return the tracking errors of sets of the loop state, or of errors."""
        n = self.system.n
        return sets if sets.dim == n else Zonotope(sets.c[..., :n], sets.G[..., :n, :])

    def true_error(self, sets: Zonotope) -> Zonotope:
        """Return errors of true states, without impulses that are carried, from sets of the loop state."""
        errors = self.error(sets)
        return errors.inflate(self.state_offset) if np.any(self.state_offset) else errors

    @cached_property
    def noise(self) -> Array:
        """Bound on the estimate noise in a command of the same period that `commands` omits, shape (m,)."""
        return np.asarray(self.tightening.noise(self.system.u_max))

    @property
    def worst_noise(self) -> Array:
        """Bound on `noise`, errors of any step of the flight included, shape (m,)."""
        return np.asarray(self.noise + np.abs(self.gain) @ self.step_errors.max(axis=0))

    @cached_property
    def step_errors(self) -> Array:
        """Bounds on the estimate errors of each step and ever after, beside the loop's own, (K + 1, n)."""
        return step_errors(self.system)

    @cached_property
    def remembered(self) -> Array:
        """Bounds on the loop states beside the tracking error, after any law, shape (N - n,)."""
        n, observer = self.system.n, self.system.observer
        sizes = np.array(self.tightening.from_rest(np.eye(self.loop.N)[n:], self.system.u_max)[-1])
        if observer is not None and self.loop.settled is not None:  # no source after the observer adds states
            sizes[-n:] = self.loop.settled + (0.0 if observer.fading is None else observer.fading.max(axis=0))
        return sizes

    @cached_property
    def at_start(self) -> Array:
        """Bounds on the same at the start of a flight, where the first estimate is known, shape (N - n,)."""
        observer, bounds = self.system.observer, self.remembered.copy()
        if observer is not None and self.loop.settled is not None and observer.initial is not None:
            bounds[-self.system.n :] = observer.initial + self.system.carry_offset  # it sees states with that
        return bounds

    @property
    def state_offset(self) -> Array:
        """Largest distance of a true state from that of the loop, shape (n,).

        Sets of errors of true states leave out impulses that are carried; the loop holds them.
        """
        system = self.system
        along = system.thrusters.along * system.timing.carried_impulse * np.abs(system.B).sum(axis=1)
        offset = (system.carry_offset + along) * (1 + ROUNDING)
        return np.asarray(offset if remembers(system) else 0 * offset)

    @property
    def unmodelled(self) -> Array:
        """Largest distance at nodes of a true state from the one that sets of the loop hold, shape (n,)."""
        states = self.system.carry_offset if remembers(self.system) else 0.0
        return np.asarray(self.system.state_offset_at_nodes - states + self.loop.offset_at_nodes)

    def loop_state(self, sets: Zonotope, others: Array | None = None) -> Zonotope:
        """Return sets of the loop state that hold sets of the tracking error, all else within bounds.

        Parameters
        ----------
        sets : Zonotope
            Of dimension n, or N: these are returned as they are.
        others : ndarray, shape (N - n,), optional
            Bounds on the other loop states at the start of a flight. Without them those count that there may
            be after any law, and errors are those of true states.
        """
        n, N = self.system.n, self.loop.N
        if sets.dim == N:
            return sets
        bounds = (self.state_offset, self.remembered) if others is None else (0 * self.state_offset, others)
        box = np.concatenate(bounds)
        batch, g = sets.batch, sets.G.shape[-1]
        c, G = np.zeros((*batch, N)), np.zeros((*batch, N, g + N))
        c[..., :n], G[..., :n, :g], G[..., np.arange(N), g + np.arange(N)] = sets.c, sets.G, box
        return Zonotope(c, G)

    @property
    def varies(self) -> bool:
        """Return True if some errors of inputs count by the time of the flight, not since a hand-over."""
        return self.feedback_bound is not None or bool(np.any(self.step_errors))

    @cached_property
    def feedback_bound(self) -> Array | None:
        """Bound on S's feedback after a hand-over, period by period, shape (settling + 2, m).

        None where errors of thrusters do not depend on it, or are bounded for full thrust.
        """
        if self.level is None or not self.system.proportional:
            return None
        u_max, norms = (
            self.system.u_max,
            np.linalg.norm(self.gain @ self.transitions @ self.W_inverse, axis=-1),
        )
        tail = self.after_settling(self.gain, float(np.min(u_max / norms[0])))
        rows = self.commands[: len(u_max)]
        others = (self.per_state(rows) + self.between_per_state(rows[:, : self.system.n])) @ self.remembered
        return feedback_bound(
            norms, self.level * u_max, tail, u_max, lambda P: self._tightenings(rows, P) + others + self.noise
        )

    @property
    def max_feedback(self) -> Array:
        """Return the largest command of S's feedback, shape (m,)."""
        return self.system.u_max if self.feedback_bound is None else self.feedback_bound[0]

    @cached_property
    def transients(self) -> list[OutageDifference]:
        """Differences of loop states, one for each kind of late fault, that it makes until S knows of it."""
        system, h, differences = self.system, self.flow.h, list[OutageDifference]()
        try:
            with np.errstate(over="raise", invalid="raise"):
                for fault in system.transients:
                    if len(fault.thrust):
                        differences += map(
                            OutageDifference.within, wrong_thrust(system, fault, self.gain, self.loop)
                        )
                    elif system.observer is None:
                        differences.append(
                            OutageDifference.within(
                                outage_errors(system, fault, h, self.difference_tightening)
                            )
                        )
                    elif self.loop.settled is None:
                        differences.append(OutageDifference.within(unlearned(system, fault, self.tightening)))
                    else:
                        differences.append(self._unmade(touched(fault.lasts, h)))
        except (ReachError, FloatingPointError) as error:
            faults = [(fault.name, fault.lasts) for fault in system.transients]
            raise ScenarioError("faults", faults, "must be isolated sooner to be bounded") from error
        return differences

    def _unmade(self, count: int) -> OutageDifference:
        """Return the difference that up to so many updates in a row make which the observer does not make."""
        system, observer = self.system, self.system.observer
        assert observer is not None
        blind = craft_loop(replace(system, observer=replace(observer, gain=0 * observer.gain)), self.flow.h)
        return unmade(self.tightening.closed, blind.close(self.gain), system.u_max, self.remembered, count)

    def difference_tightening(self, rows: Array, sets: Sequence[OutageDifference]) -> Array:
        """Return the tightening of rows by differences of loop states, up to l periods later.

        Shape (settling + 3, r, sets), by age and ever after, with the intersample bound.
        """
        limits, plant = self.tightening, rows[:, : self.system.n]
        norms = [np.max(each.support(np.eye(self.loop.N)) / limits.v) for each in sets]

        def reach(rows: Array) -> Array:
            each, ever = [some.support(limits.carried(rows)) for some in sets], limits.remainder(rows)
            return np.concatenate([np.stack(each, axis=-1), np.multiply.outer(ever, norms)[None]])

        between = limits.curvature(plant) @ reach(limits.closed.rates).max(axis=0)
        return np.asarray(self._by_age(np.maximum.accumulate(reach(self.pad(rows)))) + between)

    def transient_tightening(self, rows: Array) -> Array:
        """Return the tightening of rows by transient faults, up to l periods later, (settling + 3, r)."""
        if not self.transients:
            return np.zeros((self.settling + 3, len(rows)))
        return np.asarray(self.difference_tightening(rows, self.transients).max(axis=-1) * (1 + ROUNDING))

    def pad(self, rows: Array) -> Array:
        """Pad rows of the tracking error, shape (r, n), to rows of the loop state, (r, N)."""
        return np.pad(rows, ((0, 0), (0, self.loop.N - rows.shape[1])))

    def _since(self, feedback_bound: Array | None) -> Array:
        """Bound on S's commands for as many periods as the loop remembers; the last one holds for ever."""
        count = self.tightening.horizon + 2
        if feedback_bound is None:
            return np.tile(self.system.u_max, (count, 1))
        return feedback_bound[np.minimum(np.arange(count), len(feedback_bound) - 1)]

    def _by_age(self, tightenings: Array) -> Array:
        """Return tightenings (N + 3, ...), by node, for the settling horizon and ever after."""
        count = min(self.settling + 2, len(tightenings) - 1)
        ever = tightenings[count:].max(axis=0)
        return np.concatenate(
            [tightenings[:count], np.tile(ever, (self.settling + 3 - count, *[1] * ever.ndim))]
        )

    def responses(self, rows: Array, feedback_bound: Array | None) -> Array:
        """Return the tightening of rows at node L after a hand-over and ever after, without the handed state.

        Parameters
        ----------
        rows : ndarray, shape (r, n) or (r, N)
            Of the tracking error, or of the loop state.
        feedback_bound : ndarray, shape (settling + 2, m), optional
            Bound on the commands since; the limits of the thrusters without one.

        Returns
        -------
        ndarray, shape (settling + 3, r)
        """
        return self._by_age(self.tightening.from_rest(self.pad(rows), self._since(feedback_bound)))

    def settled_tightening(self, rows: Array) -> Array:
        """Return the tightening of rows for ever once S keeps to the end of its feedback bound, (r,)."""
        rows, limits = self.pad(rows), self.tightening
        last = self._since(self.feedback_bound)[-1]
        older = np.abs(limits.carried(rows)[limits.horizon]) @ limits.reached(
            self._since(self.feedback_bound)
        )
        remainder = limits.remainder(rows) * np.max(
            np.concatenate([self.state_offset, self.remembered]) / limits.v
        )
        return np.asarray(limits.from_rest(rows, last)[-2] + older + remainder)

    @property
    def long(self) -> int:
        """Periods after a hand-over from which on `settled_tightening` bounds the disturbance."""
        return self.settling + self.tightening.horizon + 2 + self.lag

    @property
    def lag(self) -> int:
        """Number of periods for which commands count in errors of estimates, beside the loop's states."""
        return max((channel.lag for channel in self.loop.channels), default=0)

    @cached_property
    def loop_transitions(self) -> Array:
        """``F^l`` for l = 0 ... settling + 1, shape (settling + 2, N, N)."""
        if self.system.n == self.loop.N:
            return self.transitions
        return powers(self.tightening.closed.F, self.settling + 1)

    def per_state(self, rows: Array) -> Array:
        """Return the tightening of rows at nodes per unit of every loop state beside the handed error.

        Shape (settling + 3, r, N - n), by age and ever after.
        """
        limits, n, rows = self.tightening, self.system.n, self.pad(rows)
        ever = limits.remainder(rows)[:, None] / limits.v[n:]
        return self._by_age(np.concatenate([np.abs(limits.carried(rows))[..., n:], ever[None]]))

    def between_per_state(self, rows: Array) -> Array:
        """Return the intersample bound to add to `per_state` next to a node, for error rows (r, n)."""
        rates = self.per_state(self.tightening.closed.rates)
        before = np.concatenate([rates[:1], rates[:-1]])
        return np.asarray(self.tightening.curvature(rows) @ np.maximum(rates, before))

    def disturbance(self, rows: Array, faults: bool = True) -> Array:
        """Return the tightening of rows without the handed state, by age and ever after, (settling + 3, r).

        Entry L belongs to node L after the hand-over. Between two nodes a tightening is at most the chord of
        their entries; the last one holds for all later time. Rows of `commands`, shape (r, N), count
        without the `noise` of their own period.
        """
        return self._tightenings(rows, self.feedback_bound, faults)

    def _tightenings(self, rows: Array, feedback_bound: Array | None, faults: bool = True) -> Array:
        """Bound the tightening of rows under commands within a feedback bound, see `disturbance`."""
        plant = rows[:, : self.system.n]
        tightenings = (
            self.responses(rows, feedback_bound)
            + self.tightening.between(plant, self._since(feedback_bound))[0]
        )
        if faults and self.system.transients:
            ages = np.minimum(np.arange(len(tightenings)) + 2, len(tightenings) - 1)
            tightenings = tightenings + self.transient_tightening(rows)[ages]
        return tightenings

    def response(self, channel: Channel, rows: Array) -> Response:
        """Return the response to a channel of rows of the error or of the loop state, (r, n) or (r, N)."""
        return self.tightening.response(channel, self.pad(rows), rows[:, : self.system.n])
