"""Bounds on the velocity change, period by period or for all periods of a linear loop, and its price."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.linalg import expm

from reach.numerics.linear import discretize, growth, powers

from ...model.system import Array
from ...model.tolerances import ROUNDING
from ..controllers.controllers import AffineController, Controller, TubeSegment
from ..controllers.neural import NeuralController
from ..tracker.loop import Channel, ClosedLoop

LONGEST = 4000  # periods of a loop that are looked at all at once, at most
SQUARED = 4  # how often the power of a response is squared whose coefficients bound its peak


@dataclass(frozen=True, eq=False)
class Spell:
    """The thrust in the q periods of one step."""

    law: Controller
    tube: TubeSegment
    middle: Array  # commanded along the middle of the tube [N], (q, m)
    most: Array  # bound on what is applied on average in every period [N], (q, m)
    sizes: tuple[Array, ...] = ()
    """Bounds on the values of the loop's channels in every period, (q, k) each; none where the law is not
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
        here, system, known, sizes = law.in_step(k), law.system, list[Array](), list[list[Array]]()
        centre, spread = here.commanded(tube.states - here.whole_offset(k), tube.bow, k)
        lag = max((channel.lag for channel in here.closed.loop.channels), default=0)
        for i in range(q + 1):
            before = np.max(known[i - lag :], axis=0) if i >= lag > 0 else None  # Proposition 7 (b)
            top = (np.abs(centre[i]) + spread[i] + here.noise_after(before)) * (1 + ROUNDING)
            known.append(np.minimum(top, system.u_max))
            channels = here.closed.loop.channels
            sizes.append([here.sizes(c, before if c.lag else known[-1]) for c in channels])
        middle, most = np.minimum(np.abs(centre), system.u_max), system.spent(np.array(known))
        alone = tube.slopes is None and not system.timing.jitter
        each = tuple(map(np.array, zip(*sizes[:-1], strict=True))) if alone else ()
        return cls(law, tube, middle[:-1], most[:-1], each)


def spent(spells: Sequence[Spell], periods: int | None = None) -> float:
    """Bound on the thrust of so many periods on end [N], the first that the spells are of.

    Where a loop is linear for several steps, the lesser of the sum of its periods' bounds and `together`.
    """
    total, left = 0.0, sum(len(spell.most) for spell in spells) if periods is None else periods
    for (_, linear), parts in groupby(spells, lambda spell: (id(spell.law), len(spell.sizes) > 0)):
        run = list(parts)
        most = np.concatenate([spell.most for spell in run])[:left]
        left, apart = left - len(most), float(most.sum())
        total += min(apart, together(run, len(most))) if linear and 0 < len(most) <= LONGEST else apart
    return total * (1 + ROUNDING)


def together(run: Sequence[Spell], count: int) -> float:
    """Bound on the thrust of the first periods of a run under one linear law [N] (Proposition 14 (c))."""
    law = run[0].law
    assert isinstance(law, AffineController)
    system, closed = law.system, law.in_step(0).closed
    middle = np.concatenate([spell.middle for spell in run])[:count]
    rows = closed.K @ powers(closed.F, count - 1)
    base = middle + np.abs(rows @ run[0].tube.states[0].G).sum(axis=-1)
    total, made = 0.0, not system.timing.carried  # whether bounds are on what is made, not on commands
    for i, channel in enumerate(closed.loop.channels):
        sizes = np.concatenate([spell.sizes[i] for spell in run])[:count]
        rate = channel.rate
        of_inputs = rate is not None and not channel.ball and np.array_equal(rate, closed.loop.B)
        if rate is not None and not of_inputs:
            base[1:] += np.cumsum(closed.gains(channel, rows[:-1]) @ channel.size, axis=0)
            continue
        energy = np.sqrt(count * np.sum(sizes**2, axis=0))
        for answers, once, rest in _answers(closed, channel, rows, made):
            most = _amplified(answers, once)
            if of_inputs:  # what they differ from their means in a part is made besides
                most = np.sqrt(most**2 + once * (1 - once))
            total += float((most + rest).sum(axis=0) @ energy)
        if of_inputs and not made:  # errors of what is made add to what is commanded
            total += float(sizes.sum())
    if made:
        total += count * system.m * (system.thrusters.bit - system.prompt.thrusters.bit)
    return float((base.sum() + total) * (1 + ROUNDING))


def _answers(
    closed: ClosedLoop, channel: Channel, rows: Array, made: bool
) -> Iterator[tuple[Array, Array, Array]]:
    """Yield the commands by age that answer a unit of a channel's values, (count, m, k), and what is beside.

    That is what they add in their own period, (m, k), and what measurable values add that differ from their
    means, each part of a period for itself.
    """
    loop = closed.loop
    if channel.rate is None:
        own = np.zeros((loop.m, len(channel.size)))
        if channel.noise is not None:
            own = own - closed.gain @ channel.noise
        if channel.push is not None and made:
            own = own + channel.push
        yield -rows[:-1] @ closed.sampled(channel), own, 0 * own
        return
    A, rate = loop.A, channel.rate
    for start, end, enters in loop.enter:
        length, carried = end - start, enters @ expm(loop.A * (loop.h - end))
        within = length**2 / 2 * np.abs(A) @ growth(A, length) @ np.abs(rate)
        seen = rows[:-1] @ carried
        answers = -seen @ discretize(A, rate, length)[1]
        yield answers, np.eye(loop.m) * (length / loop.h * made), np.abs(seen).sum(axis=0) @ within


def _amplified(answers: Array, once: Array) -> Array:
    """Bound the amplification of every value into every command, in the 2-norm over time, shape (m, k)."""
    found = np.abs(answers).sum(axis=0) + np.abs(once)
    for a, j in np.ndindex(found.shape):
        most = max(peak(np.append(once[a, j], answers[:, a, j])), abs(once[a, j]))
        found[a, j] = min(found[a, j], most)
    return np.asarray(found)


def peak(response: Array) -> float:
    """Bound on the largest amplification of any frequency by a response (k,): by a power of its spectrum."""
    power, root = np.convolve(response, response[::-1]), 2.0
    for _ in range(SQUARED):
        count = 2 * len(power) - 1
        size = next_fast_len(count, real=True)
        spectrum = rfft(power, size)
        with np.errstate(over="ignore", invalid="ignore"):  # of a law that runs away: no bound
            power, root = irfft(spectrum * spectrum, size)[:count], 2 * root
    return float(np.abs(power).sum() ** (1 / root))
