"""One period of a flight as a linear motion with an input within bands, and what a clipped command may be."""

from dataclasses import dataclass

from flint import arb, arb_mat

from .balls import largest, sums
from .motion import Motion, Push
from .zonotopes import Directions, Zonotope


@dataclass(frozen=True, eq=False)
class Period:
    """Motion over one period: ``d' = ... + g + V v`` with v of a push, held or not, and errors of inputs."""

    motion: Motion
    g: arb_mat
    push: Push | None = None
    error: Push | None = None
    most: list[arb] | None = None  # bounds on the thrust, where they are known already
    commands: list[arb] | None = None  # bounds on what is commanded, where errors are booked for them

    def ends(self, d: Zonotope) -> Zonotope:
        """Where the motion without disturbance and without v ends."""
        return d.image(self.motion.phi).moved(self.motion.gamma * self.g)

    def after(self, end: Zonotope) -> Zonotope:
        """The set at the next node, from `ends`: what is known of one along rows serves the other."""
        motion, push = self.motion, self.push
        if push is not None and motion.held is not None:  # its mean is all of it
            end, push = end.grown(motion.gamma * push.V * push.cover), None
        pushes = [each for each in (push, self.error) if each is not None]
        return end.grown(motion.pushed(*pushes, *motion.disturbances) if pushes else motion.disturbance_set)

    def extra(self, rows: Directions, d: Zonotope) -> tuple[list[arb], list[arb]]:
        """Bounds on how far ``row d`` exceeds the chord of its undisturbed end values within the period.

        They belong to the start and the end of the period; in between, their chord is a bound: what v and
        the disturbance have done grows from nothing.
        """
        motion, along = self.motion, self.motion.along(rows)
        bend, last = along.disturbance
        first = sums(along.bow(d.through(motion.rates).moved(self.g)), bend)
        for push in (self.push, self.error):
            if push is not None:
                first = sums(first, motion.push_bend(rows.M, push))
                last = sums(last, motion.push_gain(rows.M, push))
        return first, sums(first, last)


@dataclass(frozen=True, eq=False)
class Spell:
    """The thrust in one period of a controller."""

    spent: arb  # bound on its integral over the period, in the 1-norm
    middle: arb_mat  # commanded in the middle of the set, (m, 1)
    errors: tuple[list[arb], ...] = ()
    """Bounds on those of estimates and of thrusters, as inputs; none where the law is not linear, or late."""


def command_ranges(u: arb_mat, gain: Directions, d: Zonotope) -> list[tuple[arb, arb]]:
    """Ranges of ``u - K x`` over a set, as exact numbers."""
    fed = d.through(gain)
    middles = (u - fed.c).entries()
    return [((x - w).lower(), (x + w).upper()) for x, w in zip(middles, fed.widths, strict=True)]


def around(low: arb, high: arb) -> tuple[arb, arb]:
    """An exact middle of two numbers, and how far both are from it at most."""
    middle = ((low + high) / 2).mid()
    return middle, largest((high - middle, middle - low))


def secant(lo: arb, hi: arb, top: arb) -> float:
    """Slope of the clip between two commands."""
    width = hi - lo
    return float(((clip(hi, top) - clip(lo, top)) / width).mid()) if width > 0 else 1.0


def clip(y: arb, top: arb) -> arb:
    """The command y limited to ``[-top, top]``."""
    if y > top:
        return top
    return -top if y < -top else y
