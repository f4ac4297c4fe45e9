"""Bounds on the velocity change, period by period or for all periods of a linear loop, and its price."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from reach.numerics.linear import powers

from ...model.system import Array
from ...model.tolerances import ROUNDING
from ..controllers.controllers import AffineController, Controller, TubeSegment
from ..controllers.neural import NeuralController
from ..safety.continuation import HandOver, PathRows
from ..safety.demand import command_noise
from ..sources.thrusters import THRUSTERS
from ..tracker.long_flight import peak

LONGEST = 4000  # periods of a loop that are looked at all at once, at most


@dataclass(frozen=True, eq=False)
class Spell:
    """The thrust in the q periods of one step."""

    law: Controller
    tube: TubeSegment
    middle: Array  # commanded along the middle of the tube [N], (q, m)
    most: Array  # bound on what is applied on average in every period [N], (q, m)
    errors: tuple[Array, ...] = ()
    """Bounds on those of estimates and of thrusters, as inputs [N], (q, m) each; none where the law is not
    linear, or its commands may come early or late."""

    @classmethod
    def of(cls, law: Controller, tube: TubeSegment, k: int) -> "Spell":
        """Of step k; a controller of which only the thrust limits are known is charged all of them."""
        q = len(tube.bow)
        if isinstance(law, NeuralController):  # it flies on exact states
            centre, spread = law.commanded(tube.nodes - law.offset[k], tube.bow, k)
            told = np.minimum((np.abs(centre) + spread) * (1 + ROUNDING), law.system.u_max)
            middle = np.minimum(np.abs(centre), law.system.u_max)
            return cls(law, tube, middle[:-1], law.system.spent(told)[:-1])
        if not isinstance(law, AffineController):
            limit = getattr(law, "system", None)
            most = np.tile(np.full(1, np.inf) if limit is None else limit.spent(limit.u_max), (q, 1))
            return cls(law, tube, most, most)
        here, system = law.in_step(k), law.system
        centre, spread = here.commanded(tube.states - here.whole_offset(k), tube.bow, k)
        told, known = centre + 0.0, 0 * spread
        lag = max((channel.lag for channel in here.closed.loop.channels), default=0)
        for i in range(q + 1):
            before = told[i - lag : i].max(axis=0) if i >= lag > 0 else None  # Proposition 7 (b)
            known[i] = here.noise_after(before)
            top = (np.abs(centre[i]) + spread[i] + known[i]) * (1 + ROUNDING)
            told[i] = np.minimum(top, system.u_max)
        middle, most = np.minimum(np.abs(centre), system.u_max), system.spent(told)
        alone = tube.slopes is None and system.longest == 1
        errors = (known[:-1], system.thrusters.error(told[:-1])) if alone else ()
        return cls(law, tube, middle[:-1], most[:-1], errors)


def spent(spells: Sequence[Spell], periods: int | None = None) -> float:
    """Bound on the thrust of so many periods on end [N], the first that the spells are of.

    Where a loop is linear for several steps, the lesser of the sum of its periods' bounds and `together`.
    """
    total, left = 0.0, sum(len(spell.most) for spell in spells) if periods is None else periods
    for (_, linear), parts in groupby(spells, lambda spell: (id(spell.law), len(spell.errors) > 0)):
        run = list(parts)
        most = np.concatenate([spell.most for spell in run])[:left]
        left, apart = left - len(most), float(most.sum())
        total += min(apart, together(run, len(most))) if linear and 0 < len(most) <= LONGEST else apart
    return total * (1 + ROUNDING)


def commanded(rows: PathRows, held: Sequence[HandOver], first: int, last: int) -> Array:
    """Bound S's commands at both ends of the periods from a node until another, (2, last - first, m) [N].

    The rows are `Tracking.commands`. Each of the sets holds all errors that S may take over.
    """
    clearance, tracking = rows.clearance, rows.clearance.tracking
    need = np.min([rows.needs(each, first, last) for each in held], axis=0)
    noise = command_noise(tracking, clearance.cells, clearance.planned)
    cell = np.minimum(np.arange(first, last) // clearance.q, clearance.cells - 1)
    both = need.reshape(*need.shape[:2], 2, noise.shape[1])
    return np.asarray(both.max(axis=2) + (np.abs(clearance.reference.nu) + noise)[cell])


def tracked(rows: PathRows, held: Sequence[HandOver], first: int, last: int) -> float:
    """Bound S's velocity change in the periods from a node until another [m/s], see `commanded`."""
    system, h = rows.clearance.tracking.system, rows.clearance.tracking.flow.h
    most = system.spent(np.minimum(commanded(rows, held, first, last), system.u_max))
    return float(most.sum(axis=-1).max(axis=0).sum()) * h / system.mass


def together(run: Sequence[Spell], count: int) -> float:
    """Bound on the thrust of the first periods of a run under one linear law [N] (Proposition 14 (c))."""
    law = run[0].law
    assert isinstance(law, AffineController)
    system, closed = law.system, law.in_step(0).closed
    middle, known, made = (
        np.concatenate(each)[:count] for each in zip(*((s.middle, *s.errors) for s in run), strict=True)
    )
    rows = closed.K @ powers(closed.F, count - 1)
    base = middle + np.abs(rows @ run[0].tube.states[0].G).sum(axis=-1)
    for channel in closed.loop.channels:  # but for errors of estimates and of inputs
        if channel.noise is None and channel.name != THRUSTERS:
            base[1:] += np.cumsum(closed.gains(channel, rows[:-1]) @ channel.size, axis=0)
    seen, wrong = (_answered(-rows @ way) for way in (closed.loop.held, closed.loop.made))
    rest = np.abs(rows).sum(axis=0) @ closed.loop.uneven
    size, off = (np.sqrt(count * np.sum(each**2, axis=0)) for each in (known, made))
    if system.timing.carried or system.nozzles:  # what is commanded, and the errors of what is made of it
        told, more = seen[1] @ size + (wrong[0] + rest) @ off, float((made @ system.weights).sum())
    else:  # what is applied, but for errors that stand for pulses
        told = seen[1] @ size + (wrong[1] + rest) @ off
        apart = np.subtract(system.thrusters.bit, system.on_time.bit).max()
        more = count * system.weights.sum() * float(apart)
    return float(((base.sum(axis=0) + told) @ system.weights + more) * (1 + ROUNDING))


def _answered(answers: Array) -> tuple[Array, Array]:
    """Bound the amplification of inputs into commands (count, m, m), without and with themselves, (m, m)."""
    commanded = np.abs(answers).sum(axis=0)
    applied = commanded + np.eye(len(commanded))
    for a in range(len(commanded)):
        commanded[a, a] = min(commanded[a, a], peak(answers[None, :, a, a]))
        applied[a, a] = min(applied[a, a], max(peak(np.append(1.0, answers[:, a, a])[None]), 1.0))
    return commanded, applied
