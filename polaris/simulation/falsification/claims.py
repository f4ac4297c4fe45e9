"""Proven margins of a schedule at every instant, and distances of runs from every limit."""

from dataclasses import dataclass
from functools import cached_property
from math import floor

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from ...model.craft import Array, Craft
from ...model.scene.timed_polytope import TimedPolytope
from ...synthesis.safety.carried_rows import error_tube
from ...synthesis.safety.clearance import facet_clearance
from ...synthesis.safety.feedforward import command_errors
from ...synthesis.schedule.schedule import Schedule
from ..allocating import thrusts_of
from ..fault_times import FaultTimes
from ..firing import begins
from ..run_metrics import Runs, period_path
from ..simulate import flown_modes

PARTS = 8  # parts of a period in which it is looked at closely
LOOKED_AT = 4  # periods of each run that are looked at so closely: those with the least margins at their ends
EXACT_M = 1e-3  # length [m] by which simulated margins may fall short of proven ones: the integration's error
EXACT_INPUT = 1e-6  # the same for inputs, as a share of their limits


@dataclass(frozen=True, eq=False)
class Claims:
    """Proven margins of one schedule, period by period.

    The limits are the timed polytopes, one each (margin in m: how far outside the best facet), and then
    the inputs, one each (margin in N: thrust left while S flies). S's flight after T is included with `tail`.
    Of flights with `faults`, or a controller `asks` the online monitor of flight code in
    every step, no more is claimed than that no limit is violated.
    """

    schedule: Schedule
    tail: bool
    faults: bool = False
    asks: int | None = None

    @property
    def system(self) -> Craft:
        """Return the craft that flies."""
        return self.schedule.safety.problem.system

    @property
    def q(self) -> int:
        """Periods per cell."""
        return self.schedule.safety.clearance.q

    @property
    def h(self) -> float:
        """Length of a period [s]."""
        return self.schedule.safety.tracking.flow.h

    @property
    def cells(self) -> int:
        """Number of cells that are looked at."""
        return len(self.modes)

    @property
    def unsafe(self) -> tuple[TimedPolytope, ...]:
        """Return the timed polytopes."""
        return self.schedule.safety.clearance.unsafe

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the limits."""
        return (*(u.name for u in self.unsafe), *self.system.input_names)

    @cached_property
    def modes(self) -> NDArray[np.int_]:
        """Mode of every cell, S after T."""
        return flown_modes(self.schedule, self.tail, self.asks)

    @cached_property
    def impulse_offset(self) -> Array:
        """Return how far carried impulses take flights at nodes from where the proof has them, shape (n,)."""
        return self.system.state_offset_at_nodes * bool(self.system.timing.carried_impulse)

    def growth(self, u: TimedPolytope, size: Array) -> Array:
        """Return by how much a polytope grows [m] where states are so far from the proof's, (n,)."""
        span = np.abs(u.rows(self.system)) @ size
        return span if u.of_state else np.full_like(span, np.linalg.norm(np.abs(self.system.position) @ size))

    @cached_property
    def offsets(self) -> list[tuple[Array, Array]]:
        """Offsets of every polytope at the beginning and the end of every period, (periods, F) each [m].

        Without what the polytopes are grown by because of what is carried: that is flown.
        """
        fine = [u.fine(self.q)[: self.cells] - self.growth(u, self.impulse_offset) for u in self.unsafe]
        return [(self._flat(part[:, :-1]), self._flat(part[:, 1:])) for part in fine]

    @cached_property
    def facets(self) -> list[Array]:
        """Lower bounds on the margin of every facet over each period, (periods, F) each [m]."""
        safety, out = self.schedule.safety, []
        for u in self.unsafe:
            clearance = facet_clearance(safety.tracking, safety.reference, u)[: self.cells]
            tightening, intersample = self._tightenings(-u.rows(self.system))
            slack = clearance - tightening
            out.append(self._flat(np.minimum(slack[:, :-1], slack[:, 1:]) - intersample))
        return out

    @cached_property
    def floor(self) -> Array:
        """Proven margin of every limit over each period, (periods, limits); -inf where there is none.

        While S flies no margin can be negative, whatever its tube shows: S took over from a recoverable set.
        """
        safety, m, o = self.schedule.safety, self.system.m, len(self.unsafe)
        gain = safety.tracking.gain
        tightening, intersample = self._tightenings(np.vstack([gain, -gain]))
        nu = safety.reference.nu[: self.cells]
        wrong = command_errors(self.system, gain, self.cells, safety.problem.K)
        clearance = np.tile(self.system.u_max - wrong, 2) + np.hstack([nu, -nu])
        slack = np.min((clearance[:, None, :] - tightening).reshape(self.cells, self.q + 1, 2, m), axis=2)
        thrust = np.minimum(slack[:, :-1], slack[:, 1:]) - intersample.reshape(self.cells, self.q, 2, m).max(
            axis=2
        )
        out = np.column_stack([*(part.max(axis=1) for part in self.facets), self._flat(thrust)])
        by_s = np.repeat(self.modes == 0, self.q)
        out[by_s] = np.maximum(out[by_s], 0.0)
        out[~by_s, o:] = -np.inf  # what U demands is limited by its own model alone
        claimed = self.schedule.guarantee == "proved" and not self.faults and self.asks is None
        return out if claimed else np.full(out.shape, -np.inf)

    def _flat(self, parts: Array) -> Array:
        """One row per period, out of (cells, q, columns)."""
        return parts.reshape(self.cells * self.q, -1)

    def _tightenings(self, rows: Array) -> tuple[Array, Array]:
        """Largest ``row e`` at the nodes (cells, q+1, r), and the possible addition between (cells, q, r)."""
        safety, q = self.schedule.safety, self.q
        tightening = np.empty((self.cells, q + 1, len(rows)))
        intersample = np.zeros((self.cells, q, len(rows)))
        for k, step in enumerate(self.schedule.steps):
            tightening[k] = step.tube.nodes.support(rows)
            intersample[k] = step.tube.intersample @ np.abs(rows).T
        K = len(self.schedule.steps)
        if self.cells > K:
            tube = error_tube(safety.tracking, safety.clearance.after_jump(self.schedule.final), rows)
            ages = np.arange(self.cells - K)[:, None] * q + np.arange(q + 1)
            tightening[K:] = tube.at_ages(ages) + safety.clearance.scheduled(rows)[K : self.cells]
        return tightening, intersample

    def period_at(self, time: float) -> int:
        """Number of the period that holds an instant [s]."""
        return min(max(floor(time / self.h * (1 + 1e-12)), 0), self.cells * self.q - 1)


@dataclass(frozen=True, eq=False)
class Attained:
    """Least margins of R runs at every limit [m, N], when [s], and how far below the proven bound.

    The margin is inf where a limit was never looked at (inputs if S never flies); `below` is the largest
    amount by which a margin fell short of the proven one of its period, negative if none did.
    """

    margin: Array
    when: Array
    below: Array


def attained(claims: Claims, runs: Runs, faults: FaultTimes | None = None) -> Attained:
    """Measure runs against the limits of a schedule; where something fails, one step per node was flown."""
    system, shape = claims.system, (len(runs.states), len(claims.names))
    out = Attained(np.full(shape, np.inf), np.zeros(shape), np.full(shape, -np.inf))
    x = runs.states.reshape(-1, system.n).T
    # How far a path may depart from its chords, by the accelerations seen.
    change = np.abs(np.diff(runs.states, axis=1) @ system.A.T).max(axis=1) * claims.h / 4
    change = change + (np.array(system.timing.intersample_offset) if system.timing.pulse_thrust else 0.0)
    index = np.arange(shape[0])
    for o, u in enumerate(claims.unsafe):
        along = (u.rows(system) @ x).reshape(-1, *runs.states.shape[:2])
        before, after = claims.offsets[o]
        at = np.max(along[:, :, :-1] - before.T[:, None], axis=0)
        ends = np.minimum(at, np.max(along[:, :, 1:] - after.T[:, None], axis=0))
        best = np.argmin(ends, axis=1)
        out.margin[:, o] = ends[index, best]
        out.when[:, o] = runs.times[np.where(at[index, best] <= ends[index, best], best, best + 1)]
        out.below[:, o] = np.max(claims.floor[:, o] - ends, axis=1)
        few, intersample = (
            min(LOOKED_AT, ends.shape[1]),
            (change @ np.abs(u.rows(system)).T).max(axis=1, keepdims=True),
        )
        near = np.argpartition(ends, few - 1, axis=1)[:, :few]
        run, place = np.nonzero(np.take_along_axis(ends, near, axis=1) < out.margin[:, o, None] + intersample)
        _margins_within(claims, runs, o, run, near[run, place], out)
    if claims.asks is not None:  # flight code says where it clips S
        slack = np.where(runs.demanded > 1, 1 - runs.demanded, np.inf)
        out.margin[:, len(claims.unsafe) :] = slack.min(axis=1, keepdims=True) * system.u_max
        out.when[:, len(claims.unsafe) :] = runs.times[slack.argmin(axis=1)][:, None]
        return out
    by_s = np.repeat(claims.modes == 0, claims.q)[:, None]
    if faults is not None:
        by_s = by_s | np.array([faults.by_s(period) for period in range(len(by_s))])
    periods = np.flatnonzero(by_s.any(axis=1))
    if len(periods):
        _measure_thrust(claims, runs, periods, by_s[periods].T, out)
    return out


def _margins_within(
    claims: Claims, runs: Runs, o: int, run: NDArray[np.intp], period: NDArray[np.intp], out: Attained
) -> None:
    """Note margins within some periods, along held inputs from node to node, and pulses about them."""
    system, h, u = claims.system, claims.h, claims.unsafe[o]
    s, rows = np.linspace(0, 1, PARTS + 1)[1:-1], u.rows(system)
    before, after = runs.states[run, period], runs.states[run, period + 1]
    x = period_path(system, h, before, after, s)
    late = (np.abs(system.B) + h * np.abs(system.A @ system.B)) @ system.shifted  # jitter deviates by no more
    growth = np.abs(rows) @ late
    if system.timing.pulse_thrust:  # not, then, what the polytopes are grown by because of them
        x = x + pulse_offset(system, before[:, None], after[:, None], h, s[:, None])
        sizes = claims.impulse_offset, claims.impulse_offset + np.array(system.timing.intersample_offset)
        growth += np.diff([claims.growth(u, size) for size in sizes], axis=0)[0]
    s = s[:, None]
    start, end = (offsets[period][:, None] for offsets in claims.offsets[o])
    margin = np.max(x @ rows.T - ((1 - s) * start + s * end) + growth, axis=-1)
    best = np.argmin(margin, axis=1)
    least = margin[np.arange(len(margin)), best]
    order = np.argsort(-least)  # the least comes last and stays
    closer = order[least[order] < out.margin[run[order], o]]
    out.when[run[closer], o] = runs.times[period[closer]] + s[best[closer], 0] * h
    out.margin[run[closer], o] = least[closer]
    np.maximum.at(out.below[:, o], run, claims.floor[period, o] - least)


def pulse_offset(system: Craft, before: Array, after: Array, h: float, s: Array) -> Array:
    """Return how far pulses take states from where held inputs have them, at shares s of a period, (R, S, n).

    To the second order in time; the pulses are those that lead from one state (R, 1, n) to the other.
    """
    layout, placed, phi = system.nozzles, system.timing.pulse_place, expm(system.A * h)
    sees = np.eye(system.n) if not placed else system.velocity  # what does not depend on when they are fired
    effect = sees @ expm(system.A * h / 2) @ system.B * h
    fired = np.array(system.timing.pulse_thrust) if layout is None else layout.allocation.limits
    mean = (after - before @ phi.T) @ sees.T @ np.linalg.pinv(effect).T
    mean = mean if layout is None else thrusts_of(layout.allocation, mean)
    on = np.minimum(np.abs(mean) / fired, 1.0)
    begin = begins(on, placed)
    burn = np.clip(s - begin, 0.0, on)
    moment = burn**2 + 2 * on * np.maximum(s - begin - on, 0.0)
    ends = on * (2 - 2 * begin - on)  # where the held path ends
    force = np.sign(mean) * fired * np.array([burn - on * s, (moment - on * s**2 - (ends - on) * s) / 2])
    impulse, force = force if layout is None else force @ layout.allocation.directions
    return np.asarray(impulse @ system.B.T * h + force @ (system.A @ system.B).T * h**2)


def _measure_thrust(
    claims: Claims, runs: Runs, periods: NDArray[np.intp], by_s: NDArray[np.bool_], out: Attained
) -> None:
    """Measure the thrust left at the nodes of the periods that S flies.

    It is that of the commands where delay and observer are states of the loop; else that of any command on an
    estimate that is as wrong as it may be.
    """
    safety, system = claims.schedule.safety, claims.system
    gain = safety.tracking.gain
    wrong = command_errors(system, gain, claims.cells, safety.problem.K)
    limit = system.u_max + np.abs(gain) @ claims.impulse_offset - np.repeat(wrong, claims.q, axis=0)[periods]
    xi = safety.clearance.nodes[: claims.cells, :-1].reshape(-1, system.n)[periods]
    mu = np.repeat(safety.reference.nu[: claims.cells], claims.q, axis=0)[periods]
    slack = limit - np.abs(mu + (xi - runs.states[:, periods]) @ gain.T)
    if safety.tracking.commands.shape[1] > system.n:
        clipped = np.minimum(1 - runs.demanded[:, periods, None], 0.0) * system.u_max
        slack = system.u_max - np.abs(runs.inputs[:, periods]) + clipped
    slack = np.where(by_s[..., None], slack, np.inf)
    inputs = slice(len(claims.unsafe), None)
    out.margin[:, inputs] = slack.min(axis=1)
    out.when[:, inputs] = runs.times[periods][np.argmin(slack, axis=1)]
    out.below[:, inputs] = np.max(claims.floor[periods, inputs] - slack, axis=1)
