"""Bounds on the thrust spent: period by period from sets, and under affine laws all periods at once."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import groupby

from flint import arb, arb_mat

from ..files.entries import Vector
from ..kernel.balls import smallest
from .flights import FlownStep
from .storage import together


def spent(
    flights: Sequence[FlownStep],
    periods: int,
    weights: Sequence[Vector | None] = (),
    jump: tuple[int, arb_mat] | None = None,
) -> arb:
    """Bound the integral of the thrust over so many periods on end, of flights that follow each other.

    Steps on end with weights are looked at together (Proposition 14 (c)), all others one by one, (b). At the
    start of the step that `jump` names the loop state moves by up to a box.
    """
    total, padded = arb(0), [*weights, *[None] * (len(flights) - len(weights))][: len(flights)]
    for joint, group in groupby(range(len(flights)), lambda k: padded[k] is not None):
        run = list(group)
        count = max(periods - run[0] * len(flights[0].spells), 0)
        spells = [spell for k in run for spell in flights[k].spells][:count]
        bound = sum((spell.impulse for spell in spells), arb(0))
        if joint and spells:
            run_weights = [each for k in run if (each := padded[k]) is not None]
            run_jump = None if jump is None else (jump[0] - run[0], jump[1])
            bound = smallest([bound, together([flights[k] for k in run], run_weights, len(spells), run_jump)])
        total += bound
    return total
