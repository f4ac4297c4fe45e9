"""Bounds on the velocity change, period by period or for all periods of a linear loop, and its price."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from reach.numerics.linear import powers

from ...model.system import Array
from ...model.tolerances import ROUNDING
from ..controllers.controllers import AffineController, Controller, TubeSegment
from ..controllers.neural import NeuralController

LONGEST = 4000  # periods of a loop that are looked at all at once, at most
SQUARED = 4  # how often the power of a response is squared whose coefficients bound its peak


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
        if not isinstance(law, (AffineController, NeuralController)):
            limit = getattr(law, "system", None)
            most = np.tile(np.full(1, np.inf) if limit is None else limit.spent(limit.u_max), (q, 1))
            return cls(law, tube, most, most)
        system = law.system
        centre, spread = law.commanded(tube.nodes - law.offset[k], tube.bow, k)
        middle, known = np.minimum(np.abs(centre), system.u_max), 0 * spread
        told, hidden, at = centre + 0.0, system.timing.hidden, system.at_step(k)
        for i in range(q + 1):
            if isinstance(law, AffineController):  # a network flies on exact states
                before = told[i - hidden : i].max(axis=0) if i >= hidden > 0 else None  # Proposition 7 (b)
                known[i] = at.command_error(law.gain, before)
            top = (np.abs(centre[i]) + spread[i] + known[i]) * (1 + ROUNDING)
            told[i] = np.minimum(top, system.u_max)
        most = system.spent(told)
        alone = isinstance(law, AffineController) and tube.slopes is None and not system.timing.jitter
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


def together(run: Sequence[Spell], count: int) -> float:
    """Bound on the thrust of the first periods of a run under one linear law [N] (Proposition 14 (c))."""
    law, start = run[0].law, run[0].tube.nodes[0]
    assert isinstance(law, AffineController)
    system, m = law.system, law.system.m
    middle, known, made = (
        np.concatenate(each)[:count] for each in zip(*((s.middle, *s.errors) for s in run), strict=True)
    )
    flow = law.feedback.flow(system, law.gain, law.reference.delta)  # but for errors of inputs
    rows = law.gain @ powers(flow.phi, count - 1)
    base = middle + np.abs(rows @ start.G).sum(axis=-1) + flow.disturbance_support(law.gain, count)[:-1]
    answers = -rows @ flow.input_map(system.B)
    within = flow.h**2 / 2 * np.abs(system.A) @ flow.growth @ np.abs(system.B)
    commanded = np.abs(answers).sum(axis=0)
    applied, axes = commanded + np.eye(m), np.arange(m)
    for a in axes:
        commanded[a, a] = min(commanded[a, a], peak(answers[:, a, a]))
        applied[a, a] = min(applied[a, a], max(peak(np.append(1.0, answers[:, a, a])), 1.0))
    rest = np.abs(rows).sum(axis=0) @ within
    size, off = (np.sqrt(count * np.sum(each**2, axis=0)) for each in (known, made))
    if system.timing.carried:  # what is commanded, and the errors of what is made of it
        told, more = applied @ size + (commanded + rest) @ off, made.sum()
    else:  # what is applied, but for errors that stand for pulses
        told = (applied + rest) @ (size + off)
        more = count * m * (system.thrusters.bit - system.prompt.thrusters.bit)
    return float((base.sum() + told.sum() + more) * (1 + ROUNDING))


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
