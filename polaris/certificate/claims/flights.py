"""Reachable sets of the schedule: what each controller may do in a step, enclosed over whole intervals."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

from flint import arb, arb_mat

from ..files.parts import Law, Matrix
from ..kernel.arcs import Arc, Path
from ..kernel.balls import column, diagonal, largest, magnitude, matrix, plain, require, smallest, sums
from ..kernel.motion import Motion, Plant, Push
from ..kernel.periods import Period, Spell, around, clip, command_ranges, secant
from ..kernel.verdict import Rejected
from ..kernel.zonotopes import Directions, Merging, Zonotope
from ..model.bodies import Whereabouts
from ..model.limits import Barrier
from ..model.networks import Policy
from ..model.timing import late, measured_error
from .drift import Departures

GUESSES = 1e-3, 4e-3, 2e-2
"""How much more than found is guessed of commands of a period, in turn."""
GUESSED = "safety", "affine", "saturated_affine"  # kinds of laws of which they are


@dataclass(frozen=True, eq=False)
class Pilot:
    """A controller as reachability sees it."""

    law: Law
    plant: Plant
    slopes: list[Matrix | None]
    """By step and period, slopes from 0 to 1 of the lines about which a clipped command is enclosed.

    Any are sound; None for those of the checker's own.
    """
    fits: list[list[Matrix] | None] = field(default_factory=list)
    """By step and period, the affine functions that samples of a black box say its commands are near."""
    told: Whereabouts | None = None
    """Of the bodies that a network reads."""
    before: list[arb] | None = None
    """Bounds on the commands whose errors are not measured yet, if they are known."""
    _loops: dict[tuple[float, ...], Motion] = field(default_factory=dict, repr=False)

    @cached_property
    def gain(self) -> arb_mat:
        """Of any law but ``any_thrust``."""
        assert self.law.gain is not None
        return matrix(self.law.gain)

    def loop(self, slopes: Sequence[float] = ()) -> Motion:
        """Its loop with the gain of every input times a slope; unchanged without slopes."""
        key = tuple(slopes)
        if key not in self._loops:
            self._loops[key] = self.plant.loop(diagonal(key) * self.gain if key else self.gain)
        return self._loops[key]

    def knowing(self, estimate: list[float]) -> "Pilot":
        """The same where estimates are off by no more than that."""
        known = tuple(estimate)
        return (
            self if known == self.plant.estimate else replace(self, plant=replace(self.plant, estimate=known))
        )

    @cached_property
    def policy(self) -> Policy:
        """Of a network."""
        assert self.told is not None
        return Policy(self.law, self.plant, self.told)

    @cached_property
    def noise(self) -> list[arb]:
        """Bounds on what errors of the estimate add to its command."""
        if self.before is None:
            return self.plant.command_error(self.gain)
        return sums(measured_error(self.plant, self.gain), late(self.plant, self.gain, self.before))

    def after(self, told: Sequence[Sequence[arb]]) -> "Pilot":
        """The same after periods of a step with bounds on their commands, those of the last one last."""
        hidden = self.plant.hidden
        if not 0 < hidden <= len(told) or self.law.kind not in GUESSED:
            return self
        return replace(self, before=[largest(each) for each in zip(*told[-hidden:], strict=True)])

    @cached_property
    def fed(self) -> Directions:
        """Rows of what it feeds back."""
        return Directions(self.gain)

    def base(self, k: int, path: Path) -> Arc:
        """The arc of a step about which its motion is described."""
        if self.law.kind == "any_thrust":  # free motion, and every thrust is an uncertain input about zero
            return Arc.of(self.plant, path.arcs[k].nodes[0], arb_mat(self.plant.B.ncols(), 1))
        if self.law.states is None or self.law.inputs is None:
            return path.arcs[k]
        return Arc.of(self.plant, column(self.law.states[k]), column(self.law.inputs[k]))

    def spell(self, period: Period, d: Zonotope, u: arb_mat, k: int) -> Spell:
        """The thrust over a period of step k from a set about the base arc."""
        plant, tops = self.plant, self.plant.u_max
        if period.most is not None:
            tops = [smallest(pair) for pair in zip(tops, period.most, strict=True)]
        elif self.law.kind not in ("any_thrust", "black_box"):
            tops = self.clipped(command_ranges(u, self.fed, d))
        linear = self.law.kind == "safety" or (self.law.kind in GUESSED and self.slopes[k] is None)
        linear = linear and period.push is None and not plant.jitter
        errors = (self.noise, plant.thruster_error(tops)) if linear else ()
        return Spell(plant.spent(tops), u - self.gain * d.c if linear else u, errors)

    def clipped(self, ranges: list[tuple[arb, arb]]) -> list[arb]:
        """Bounds on its commands after the clip, on any estimate, from their ranges on the exact state."""
        parts = zip(ranges, self.plant.u_max, self.noise, strict=True)
        return [smallest((top, (largest((-lo, hi)) + noise).upper())) for (lo, hi), top, noise in parts]

    def period(self, d: Zonotope, base: Arc, k: int, i: int) -> Period:
        """Motion over a period of a step from a set about the base arc.

        Errors of the thrusters are those of commands up to a guess, which is one if what is found keeps below
        it: no flight can be the first to exceed it.
        """
        plant, u = self.plant, base.u
        if self.law.kind == "any_thrust":
            tops = sums(plant.u_max, plant.thruster_error(plant.u_max))
            return Period(plant.open, arb_mat(d.c.nrows(), 1), Push.in_box(plant.B, tops))
        if self.law.kind == "neural":
            command = self.policy.command(d, *self.policy.known(base, k, i))
            push = Push.in_zonotope(plant.B, command.V)
            error = plant.push(plant.thruster_error(command.most))
            return Period(plant.loop(-command.K), plant.B * (command.c - u), push, error, command.most)
        fit = self.fits[k] if self.law.kind == "black_box" else None
        if fit is not None:
            n, rows = d.c.nrows(), fit[i]
            K, c = matrix([row[:n] for row in rows]), column([row[n] for row in rows])
            bands = [arb(row[n + 1]) for row in rows]
            ranges = zip(plant.u_max, command_ranges(c, Directions(-K), d), bands, strict=True)
            most = [smallest((top, largest((-lo, hi)) + band)) for top, (lo, hi), band in ranges]
            error, push = plant.push(plant.thruster_error(most)), Push.in_box(plant.B, bands)
            return Period(plant.loop(-K), plant.B * (c - u), push, error, most)
        found = self.clipped(command_ranges(u, self.fed, d))
        for more in GUESSES if plant.thrusters else ():
            guess = [
                smallest((top, x.upper() * (1 + more) + top * more / 20))
                for top, x in zip(plant.u_max, found, strict=True)
            ]
            period, found = self._under(guess, d, u, k, i)
            if all(x < y or y == top for x, y, top in zip(found, guess, plant.u_max, strict=True)):
                return replace(period, commands=guess)
        return replace(self._under(plant.u_max, d, u, k, i)[0], commands=plant.u_max)

    def _under(self, most: list[arb], d: Zonotope, u: arb_mat, k: int, i: int) -> tuple[Period, list[arb]]:
        """Motion over a period under errors of the thrusters for commands up to `most`, and its commands."""
        kind, plant = self.law.kind, self.plant
        error = plant.push(sums(self.noise, plant.thruster_error(most)))
        linear = Period(self.loop(), arb_mat(d.c.nrows(), 1), None, error)
        ranges = command_ranges(u, self.fed, d)
        # What an error of the estimate adds to a command comes after the clip; without one, it counts.
        noise = self.noise if kind == "affine" else [arb(0)] * len(most)
        room = [top - x for top, x in zip(plant.u_max, noise, strict=True)]
        # Within the limits nothing clips; the safety controller keeps to them, as is shown of it elsewhere.
        if kind == "safety" or all(max(-lo, hi) <= top for (lo, hi), top in zip(ranges, room, strict=True)):
            return linear, self.clipped(ranges)
        if kind == "affine":
            raise Rejected(
                "controllers", f"{self.law.name} may exceed the thrust limits, unclipped, in step {k}"
            )
        step = self.slopes[k]
        return _clipped(self, d, u, None if step is None else step[i], error)


@dataclass(frozen=True, eq=False)
class Flown:
    """One step flown."""

    pilot: Pilot
    start: Zonotope  # errors at its start
    end: Zonotope  # errors at its end
    spells: list[Spell]
    nodes: list[Zonotope]  # errors at the nodes within it


def fly(
    pilot: Pilot,
    start: Zonotope,
    k: int,
    path: Path,
    barrier: Barrier | None,
    merging: Merging,
    departures: Departures | None = None,
    upsets: Sequence[arb_mat] = (),
) -> Flown:
    """Enclose step k of one controller, and check that it stays separate from every unsafe set.

    `start` are the errors about the safe reference at its start. There is no barrier of separating facets
    under the safety controller, whose separation follows from recoverability. Departures, if any, are
    shown to hold where thrust may stop. One of the boxes `upsets` holds what a fault adds until isolated.
    """
    base = pilot.base(k, path)
    room, unit = list[list[arb]](), pilot.plant.unit
    bows = base.bows(unit.M) if departures is not None else []
    if barrier is not None:
        rows, room = barrier.rows.M, base.room(barrier.rows.M, barrier.offsets)
        added = [[arb(0)] * rows.nrows(), *((magnitude(rows) * x).entries() for x in upsets)]
        most = [largest(each) for each in zip(*added, strict=True)]
        room = [[there - taken for there, taken in zip(node, most, strict=True)] for node in room]
    d = merging.reduced(start).moved(path.arcs[k].nodes[0] - base.nodes[0])
    spells, nodes, since = list[Spell](), list[Zonotope](), list[list[arb]]()
    for i in range(pilot.plant.q):
        knowing = pilot.after(since)
        period = knowing.period(d, base, k, i)
        since.append(period.commands or pilot.plant.u_max)
        spells.append(knowing.spell(period, d, base.u, k))
        end = period.ends(d)
        if departures is not None:
            moved = d.image(period.motion.phi - unit.M).moved(period.motion.gamma * period.g)
            extra = zip(*period.extra(unit, d), bows, strict=True)
            departures.check(i, base, d, moved, end, [largest((a, b)) + bow[i] for a, b, bow in extra])
        if barrier is not None:
            where = f"step {k}, part {i}, under {pilot.law.name}"
            for place, z, more in zip((i, i + 1), (d, end), period.extra(barrier.rows, d), strict=True):
                _separate(barrier, z, more, room[place], where)
        d = merging.after(period.after(end))
        nodes.append(d.moved(base.nodes[i + 1] - path.arcs[k].nodes[i + 1]))
    leave = d.moved(base.nodes[-1] - path.starts[k + 1])
    return Flown(pilot, start, leave, spells, nodes[:-1])


def _separate(barrier: Barrier, z: Zonotope, more: list[arb], room: list[arb], where: str) -> None:
    """Check that a set, and more along each facet, is within the room there."""
    along = z.through(barrier.rows)
    needs = sums(along.c.entries(), along.widths, more)
    if not all(need <= there for need, there in zip(needs, room, strict=True)):
        needs = sums(along.c.entries(), z.spread(barrier.rows.M), more)  # to the last digits
    for name, need, there in zip(barrier.names, needs, room, strict=True):
        if not need <= there:
            require("separation", there - need, f"{where}: {name}, needs {plain(need)} of {plain(there)} m")


def _clipped(
    pilot: Pilot, d: Zonotope, u: arb_mat, stored: list[float] | None, error: Push | None
) -> tuple[Period, list[arb]]:
    """A clipped law over a period, as a linear one and an input within a band; and its commands at most.

    With the slopes of whoever stored them, and a range that is no wider, the motion found here lies within
    the one found there. With other slopes neither need contain the other.
    """
    plant = pilot.plant
    commands = list(zip(plant.u_max, u.entries(), strict=True))
    ranges = command_ranges(u, pilot.fed, d)
    slopes = stored or [secant(*ends, top) for ends, top in zip(ranges, plant.u_max, strict=True)]
    known, bands = [], []
    for slope, (lo, hi), (top, x) in zip(slopes, ranges, commands, strict=True):
        # The clip less a line is piecewise affine: its extremes are at the ends and at the limits.
        places = [lo, hi, *(y for y in (-top, top) if lo < y < hi)]
        rests = [clip(y, top) - slope * y for y in places]
        middle_rest, band = around(smallest(rests), largest(rests))
        known.append(slope * x + middle_rest - x)
        bands.append(band)
    period = Period(pilot.loop(slopes), plant.B * column(known), Push.in_box(plant.B, bands), error)
    return period, pilot.clipped(ranges)
