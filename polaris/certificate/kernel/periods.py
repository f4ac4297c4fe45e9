"""One period of a flight as a linear motion with an input within bands, and bounds on a clipped command."""

from dataclasses import dataclass

from flint import arb, arb_mat

from .balls import largest, sums
from .motion import InputSet, RowIntersample
from .zonotopes import Directions, Zonotope


@dataclass(frozen=True, eq=False)
class Period:
    """Motion of a loop state z over one period: ``z+ = F z + shift``, and ``e' = rates z + g`` at its start.

    Generators enclose what uncertain inputs that are `held`, and others, have `added` by its end; within it
    they push the error.
    """

    F: arb_mat
    shift: arb_mat
    rates: Directions
    g: arb_mat
    held: list[arb_mat]
    added: list[arb_mat]
    constant: list[InputSet]  # that are held, and others; besides those of every period
    pushes: list[InputSet]
    bounds: list[arb]  # on the commands

    @property
    def columns(self) -> int:
        """Generators that it adds."""
        return sum(part.ncols() for part in (*self.held, *self.added))

    def ends(self, z: Zonotope) -> Zonotope:
        """Return the set at the end of the period without uncertain inputs."""
        return z.image(self.F).translate(self.shift)

    def next_set(self, end: Zonotope) -> Zonotope:
        """Return the set at the next node, from `ends`: the support of one along rows serves the other."""
        return end.plus(*self.held, *self.added)

    def extra(self, bounds: RowIntersample, z: Zonotope, held: bool = True) -> tuple[list[arb], list[arb]]:
        """Bounds on how far rows of the error exceed the chord of its undisturbed end values in the period.

        They belong to the start and the end of the period; in between, their chord is a bound: what uncertain
        inputs have done grows from nothing. What `held` ones have done may be part of the end values.
        """
        motion, rows = bounds.motion, bounds.rows
        curvature, last = bounds.disturbance
        first = sums(bounds.intersample(z.through(self.rates).translate(self.g)), curvature)
        for push in (*self.constant, *self.pushes):
            first = sums(first, motion.push_curvature(rows, push))
        for push in (*(self.constant if held else ()), *self.pushes):
            last = sums(last, motion.push_gain(rows, push))
        return first, sums(first, last)


@dataclass(frozen=True, eq=False)
class Spell:
    """The thrust in one period of a controller."""

    impulse: arb  # bound on its integral over the period, in the 1-norm
    middle: arb_mat  # commanded in the middle of the set, (m, 1)
    bounds: list[arb]  # on the commands
    K: arb_mat  # the command is ``middle + K y + v`` at a loop state y from the middle of the set
    bands: list[arb]  # bounds on v, input by input


def command_ranges(u: arb_mat, gain: Directions, d: Zonotope) -> list[tuple[arb, arb]]:
    """Ranges of ``u - K x`` over a set, as exact numbers."""
    feedback = d.through(gain)
    middles = (u - feedback.c).entries()
    return [((x - w).lower(), (x + w).upper()) for x, w in zip(middles, feedback.widths, strict=True)]


def around(low: arb, high: arb) -> tuple[arb, arb]:
    """Return an exact middle of two numbers, and how far both are from it at most."""
    middle = ((low + high) / 2).mid()
    return middle, largest((high - middle, middle - low))


def secant(lo: arb, hi: arb, top: arb) -> float:
    """Slope of the clip between two commands."""
    width = hi - lo
    return float(((clip(hi, top) - clip(lo, top)) / width).mid()) if width > 0 else 1.0


def clip(y: arb, top: arb) -> arb:
    """Return the command y limited to ``[-top, top]``."""
    if y > top:
        return top
    return -top if y < -top else y
