"""What thrusters spend at most: period by period from sets, and in linear loops all periods at once."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import accumulate, groupby, islice

from flint import arb, arb_mat, arb_poly

from ..kernel.balls import above, column, identity, largest, magnitude, row_sums, smallest
from ..kernel.periods import Spell
from .flights import Flown

LONGEST, SQUARED, REST = 4000, 4, 1e-3
"""Most periods that are looked at all at once; how often the power of a response is squared for its peak, and
the share of it, the last part, that counts by its sum instead."""

TOP = 2 ** (SQUARED + 1)  # the power of the response that it is


def spent(flights: Iterable[Flown], periods: int | None = None) -> arb:
    """Bound on the integral of the thrust over so many periods on end, of flights that follow each other."""
    total, left = arb(0), periods
    alike = groupby(flights, lambda one: (one.pilot.law.name, all(spell.errors for spell in one.spells)))
    for (_, linear), parts in alike:
        run = list(parts)
        spells = list(islice((spell for one in run for spell in one.spells), left))
        left = None if left is None else left - len(spells)
        apart = sum((spell.spent for spell in spells), arb(0))
        joint = linear and 0 < len(spells) <= LONGEST
        total += smallest([apart, together(run[0], spells)]) if joint else apart
    return total


def together(first: Flown, spells: Sequence[Spell]) -> arb:
    """Bound the integral of the thrust under one linear law, all periods at once (Proposition 14 (c))."""
    craft, count = first.pilot.craft, len(spells)
    plant, m = craft.plant, craft.plant.B.ncols()
    rows = list(accumulate(range(count - 1), lambda row, _: row * craft.F, initial=craft.commands))
    stacked = above(*rows)
    pushes = craft.disturbed(stacked)
    since = accumulate(
        (plant.weighted(pushes[i * m : (i + 1) * m]) for i in range(count - 1)), initial=arb(0)
    )
    base = sum((plant.weighted(list(map(abs, spell.middle.entries()))) for spell in spells), arb(0))
    begun = row_sums(stacked * first.start.G)
    base = sum([*(plant.weighted(begun[i * m : (i + 1) * m]) for i in range(count)), *since], base)
    known_of, made_of = ([-(row * way) for row in rows] for way in (craft.held, craft.turned))
    rest = sum(map(magnitude, rows[1:]), magnitude(rows[0])) * craft.uneven
    known, made = (
        column([_long(each, count) for each in zip(*part, strict=True)])
        for part in zip(*(spell.errors for spell in spells), strict=True)
    )
    if plant.carried or plant.weights:  # what is commanded, and the errors of what is made of it
        most, more = _amplified(known_of, arb(1)) * known + (_amplified(made_of) + rest) * made, arb(0)
        more += sum((plant.weighted(spell.errors[1]) for spell in spells), more)
    else:  # what is applied, but for errors that stand for pulses
        apart = [arb(x) - arb(y) for x, y in zip(plant.bits, plant.prompt.bits, strict=True)]
        more = count * plant.weighted(apart or [arb(0)] * m)
        most = _amplified(known_of, arb(1)) * known + (_amplified(made_of, arb(1)) + rest) * made
    return (base + plant.weighted(most.entries()) + more) * plant.h


def _amplified(answers: Sequence[arb_mat], *own: arb) -> arb_mat:
    """Bound the 2-norm over all periods of answers to inputs, per unit of theirs, with their `own` share."""
    size = sum(map(magnitude, answers[1:]), magnitude(answers[0]))
    size = size + identity(size.nrows()) if own else size
    for a in range(size.nrows()):
        most = peak([*own, *(answer[a, a] for answer in answers)])
        size[a, a] = smallest([size[a, a], largest([most, *own])])
    return size


def _long(sizes: Iterable[arb], count: int) -> arb:
    """Square root of a count times the sum of squares."""
    return (sum((x * x for x in sizes), arb(0)) * count).sqrt()


def peak(*responses: Sequence[arb]) -> arb:
    """Bound on the largest amplification of any frequency by a response: by a power of its spectrum.

    Of several, as long as each other, it is that of values of which the 2-norm in each period is known.
    """
    each = list(zip(*responses, strict=True))
    since = list(accumulate(sum(map(abs, values), arb(0)) for values in reversed(each)))
    late = sum(x < REST * since[-1] for x in since)
    parts = [list(one) for one in zip(*each[: len(each) - late], strict=True)]
    power = sum((arb_poly(one) * arb_poly(one[::-1]) for one in parts), arb_poly())
    for _ in range(SQUARED):
        power = power * power
    bound = sum((x.abs_upper() for x in power.coeffs()), arb(0))
    return (bound.root(TOP) if bound > 0 else bound) + (since[late - 1] if late else 0)
