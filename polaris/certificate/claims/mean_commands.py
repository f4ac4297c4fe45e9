"""Mean of what S commands over any number of periods, by root mean squares (Proposition 14 (d))."""

from __future__ import annotations

from flint import arb, arb_mat

from ..kernel.balls import above, column, diagonal, magnitude, matrix, norms, smallest, sums
from ..kernel.motion import Plant, Push
from ..model.craft.craft import Craft
from ..model.craft.memory import Memory
from .spending import LONGEST, peak

ROUNDS = 100  # times that errors of thrusters are bounded anew by the mean they lead to; each is a bound


def summed_errors(plant: Plant, most: list[arb]) -> list[arb]:
    """Bound sums over periods of what thrusters are off in proportion, by sums of commands."""
    if plant.shares:
        return plant.thruster_part(most)
    return [plant.along * x + plant.across * (sum(most, arb(0)) - x) for x in most]


class MeanCommands:
    """Commands about a reference that coasts, from a node on, by what has entered in each period since.

    `box` bounds loop states at all nodes from then on, (N, 1): alone it counts of what is older than the
    periods looked at, or than the node. Estimates are off by some `more` than errors of the loop, (n).
    """

    def __init__(self, craft: Craft, memory: Memory, box: arb_mat, more: list[arb]) -> None:
        *rows, last = (craft.commands * power for power in memory.powers[: min(memory.periods, LONGEST) + 1])
        self.craft, self.more, self.stacked, self.m = craft, more, above(*rows), last.nrows()
        self.size = sum(map(magnitude, rows[1:]), magnitude(rows[0]))
        self.begun, self.older = (list((size * box).entries()) for size in (self.size, magnitude(last)))

    def answering(self, adds: arb_mat, joint: bool = False, own: arb_mat | None = None) -> list[arb]:
        """Bound the root mean square of commands that answer to values of each period, (m).

        Values with root mean squares up to one, or if `joint` their 2-norm, enter the next loop state by
        `adds` (N, k), and the command of their own period by `own`.
        """
        answers, found = self.stacked * adds, []
        table = (answers if own is None else above(-own, answers)).tolist()
        for axis in range(self.m):
            each = list(zip(*table[axis :: self.m], strict=True))
            groups = [each] if joint else [[response] for response in each]
            norm = (sum(norms(matrix(list(zip(*group, strict=True)))), arb(0)) for group in groups)
            pairs = zip(norm, (peak(*group) for group in groups), strict=True)
            found.append(sum(map(smallest, pairs), arb(0)))
        return found

    def pushed(self, push: Push) -> list[arb]:
        """Bound the root mean square of commands by a push: its mean in each part of a period, and a rest."""
        total, radius = [arb(0)] * self.m, push.radius
        cover = push.cover if radius is None else diagonal([radius] * push.V.ncols())
        for enters, motion in self.craft.spans:
            held = self.answering(enters * motion.gamma * push.V * cover, radius is not None)
            total = sums(total, held, (self.size * (magnitude(enters) * motion.uneven(push))).entries())
        return total

    def bounds(self, tops: list[arb]) -> tuple[list[arb], list[arb]]:
        """Return U and L such that ``|u|`` of every input sums up to ``n U + L`` in any n periods at most.

        `tops` bound it in every period. In each round commands are a part whose root mean square is at most
        U, and one that sums up to L; so are errors of thrusters, and the commands that answer to them.
        """
        craft, plant, m = self.craft, self.craft.plant, self.m
        noise = craft.gain * craft.carry * diagonal(craft.missed(self.more))
        sampled = (self.answering(each.adds * diagonal(each.size)) for each in craft.samples)
        pushed = map(self.pushed, [*craft.steady, *craft.bits])
        given = sums(self.answering(craft.held * noise, own=noise), *sampled, *pushed, self.older)
        units = [Push.in_box(column(each), [arb(1)]) for each in plant.B.transpose().tolist()]
        fed = matrix([self.pushed(unit) for unit in units]).transpose()
        gains = craft.thrust_gains(self.stacked).tolist()
        once = matrix([[sum(each, arb(0)) for each in zip(*gains[a::m], strict=True)] for a in range(m)])
        means, rest = list(tops), [arb(0)] * m
        for _ in range(ROUNDS):
            mean = sums(given, (fed * column(plant.thruster_part(means))).entries())
            more = sums(self.begun, (once * column(summed_errors(plant, rest))).entries())
            for a, top in enumerate(tops):
                less = mean[a] < top
                means[a], rest[a] = (mean[a].upper(), more[a].upper()) if less else (top, arb(0))
        return means, rest
