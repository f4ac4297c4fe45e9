"""Reachable sets of the schedule: each controller's flights in a step, enclosed over whole intervals.

They are sets of the loop state z of the craft, which begins with the error. What the flight computer
remembers besides moves by itself, whatever law flies. A law answers to what it sees of z.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from flint import arb, arb_mat

from ..files.document import Document
from ..files.entries import Law
from ..kernel.arcs import Arc, Path
from ..kernel.balls import (
    beside,
    column,
    diagonal,
    identity,
    largest,
    magnitude,
    matrix,
    maxima,
    plain,
    require,
    scaled,
    smallest,
    sums,
)
from ..kernel.motion import InputSet, Plant
from ..kernel.periods import Period, Spell, around, clip, command_ranges, secant
from ..kernel.verdict import Rejected
from ..kernel.zonotopes import Directions, Merging, Zonotope
from ..model.craft.craft import Craft
from ..model.limits import Barrier
from ..model.networks import Policy
from ..model.obstacle_boxes import ObstacleBoxes
from .drift import Departures


@dataclass(frozen=True, eq=False)
class PeriodCommand:
    """Command of a law in a period: the input of a base arc, and ``c + K z + v`` with v held."""

    K: arb_mat
    c: arb_mat
    v: list[InputSet]  # of the inputs
    bounds: list[arb]  # on |u|, at most the thrust limits


@dataclass(frozen=True, eq=False)
class ControllerModel:
    """A controller as reachability sees it."""

    law: Law
    craft: Craft  # the loop under its gain; unused of laws without one
    document: Document
    obstacles: ObstacleBoxes | None = None
    """Of the obstacles that a network reads."""

    @classmethod
    def for_law(cls, law: Law, craft: Craft, document: Document) -> "ControllerModel":
        """Build the model of a controller from the loop under any law."""
        loop = craft if law.gain is None else craft.with_gain(matrix(law.gain))
        return cls(law, loop, document, ObstacleBoxes.from_document(document, law, craft.plant))

    @property
    def plant(self) -> Plant:
        """Return the craft."""
        return self.craft.plant

    @cached_property
    def policy(self) -> Policy:
        """Return the policy of a network."""
        assert self.obstacles is not None
        return Policy(self.law, self.plant, self.obstacles)

    @cached_property
    def feedback_rows(self) -> Directions:
        """Rows of the feedback commands."""
        return Directions(self.craft.commands)

    def base(self, k: int, path: Path) -> Arc:
        """Return the arc of a step about which its motion is described."""
        if self.law.kind == "any_thrust":  # free motion, and every thrust is an uncertain input about zero
            return Arc.from_state(self.plant, path.arcs[k].nodes[0], arb_mat(self.plant.B.ncols(), 1))
        if self.law.states is None or self.law.inputs is None:
            return path.arcs[k]
        return Arc.from_state(self.plant, column(self.law.states[k]), column(self.law.inputs[k]))

    def estimate_bounds(self, k: int, before: Sequence[list[arb]]) -> list[arb]:
        """Bounds on errors of estimates in step k beyond those of the loop, from commands earlier in it."""

        def most(periods: int) -> Sequence[arb]:
            return maxima(*before[-periods:]) if periods <= len(before) else self.plant.u_max

        return sums(self.craft.extra(self.document, k), self.craft.lag_error_since(most))

    def period(
        self, z: Zonotope, base: Arc, k: int, i: int, before: Sequence[list[arb]] = ()
    ) -> tuple[Period, Spell]:
        """Motion and thrust over a period of a step from a set about the base arc.

        `before` bounds the commands of the periods of this step before it. Errors that grow with commands are
        those of the commands of the period itself, which were made at its start.
        """
        craft, plant, excess = self.craft, self.plant, self.estimate_bounds(k, before)
        answer = self.answer(z, base, k, i, excess)
        g = plant.B * answer.c
        v, error = answer.v, plant.thruster_error(answer.bounds)
        held_inputs = [] if self.law.kind == "any_thrust" else v  # that need not be held
        free_inputs = [] if held_inputs else v
        period = Period(
            craft.free + craft.held_map * answer.K,
            craft.lifted(craft.motion.gamma * g),
            Directions(craft.drifts + plant.B * answer.K),
            g,
            [craft.lifted(craft.motion.gamma * push.V * push.cover) for push in held_inputs],
            [*(craft.lifted(craft.motion.effect(push)) for push in free_inputs), *craft.added(error)],
            held_inputs,
            [*free_inputs, *plant.push(error)],
            answer.bounds,
        )
        middle, bands = base.u + answer.c + answer.K * z.c, [arb(0)] * plant.B.ncols()
        for push in v:
            bands = sums(bands, push.along(identity(len(bands))))
        return period, Spell(plant.spending(answer.bounds), middle, answer.bounds, answer.K, bands)

    def answer(self, z: Zonotope, base: Arc, k: int, i: int, excess: list[arb]) -> PeriodCommand:
        """Enclose the command from a set; errors of estimates exceed those of the loop by `excess` (n)."""
        craft, plant, u, kind = self.craft, self.plant, base.u, self.law.kind
        n, states, tops = plant.A.nrows(), craft.free.nrows(), plant.u_max
        if kind == "any_thrust":
            return PeriodCommand(arb_mat(len(tops), states), 0 * u, [InputSet.in_box(plant.B, tops)], tops)
        missed = craft.missed(excess)
        spread = craft.carry * diagonal(missed) if any(x > 0 for x in missed) else arb_mat(n, 0)
        if kind == "neural":
            read, G = self.policy.reference_input(base, k, i)
            command = self.policy.command(z.image(craft.sees), read, beside(G, self.policy.reads * spread))
            bounds = [smallest(pair) for pair in zip(tops, command.size, strict=True)]
            inputs = [InputSet.in_zonotope(plant.B, command.V)]
            return PeriodCommand(command.K * craft.sees, command.c - u, inputs, bounds)
        fit = self.document.fits[k] if kind == "black_box" else None
        if fit is not None:
            K, c = craft.pad(matrix([row[:n] for row in fit[i]])), column([row[n] for row in fit[i]])
            bands = [arb(row[n + 1]) for row in fit[i]]
            axes = zip(tops, command_ranges(c, Directions(-K), z), bands, strict=True)
            bounds = [smallest((top, largest((-lo, hi)) + band)) for top, (lo, hi), band in axes]
            return PeriodCommand(K, c - u, [InputSet.in_box(plant.B, bands)], bounds)
        ranges, noise = command_ranges(u, self.feedback_rows, z), craft.noise(excess)
        sizes = list(zip(ranges, tops, noise, strict=True))
        bounds = [smallest((top, (largest((-lo, hi)) + error).upper())) for (lo, hi), top, error in sizes]
        inside = kind == "safety" or all(max(-lo, hi) <= top - error for (lo, hi), top, error in sizes)
        # What errors of estimates add to a command comes after the clip, which lets less of it through. The
        # safety controller keeps to the limits, as is shown of it elsewhere.
        if inside or (kind != "affine" and all(max(-lo, hi) <= top for (lo, hi), top, _ in sizes)):
            noise_map = -(craft.gain * spread)
            v = [InputSet.in_zonotope(plant.B, noise_map) if inside else InputSet.in_box(plant.B, noise)]
            return PeriodCommand(-craft.commands, 0 * u, v if spread.ncols() else [], bounds)
        if kind == "affine":
            text = f"{self.law.name} may exceed the thrust limits, unclipped, in step {k}"
            raise Rejected("controllers", text)
        step = self.document.slopes[k]
        slopes, offset, bands = _clipped(ranges, tops, u, None if step is None else step[i])
        v = [InputSet.in_box(plant.B, sums(bands, noise))]
        return PeriodCommand(-scaled(slopes, craft.commands), offset, v, bounds)


@dataclass(frozen=True, eq=False)
class FlownStep:
    """One step flown."""

    controller: ControllerModel
    start: Zonotope  # loop states at its start
    end: Zonotope  # loop states at its end
    spells: list[Spell]
    nodes: list[Zonotope]  # loop states at the nodes within it


def enclose_step(
    controller: ControllerModel,
    start: Zonotope,
    k: int,
    path: Path,
    barrier: Barrier | None,
    merging: Merging,
    departures: Departures | None = None,
    upsets: Sequence[arb_mat] = (),
) -> FlownStep:
    """Enclose step k of one controller, and check that it stays separate from every unsafe set.

    `start` are loop states about the safe reference at its start. There is no barrier of separating facets
    under the safety controller, whose separation follows from recoverability. Departures, if any, are
    shown to hold where thrust may stop. One of the boxes `upsets` holds what a fault adds until isolated.
    """
    base, craft = controller.base(k, path), controller.craft
    clearance, (unit, whole) = list[list[arb]](), craft.intersample(craft.unit)
    intersamples = base.intersamples(unit.rows) if departures is not None else []
    if barrier is not None:
        rows, clearance = barrier.rows.M, base.clearance(barrier.rows.M, barrier.offsets)
        weights = magnitude(craft.pad(rows))
        tightenings = maxima([arb(0)] * rows.nrows(), *((weights * x).entries() for x in upsets))
        clearance = [
            [limit - upset for limit, upset in zip(node, tightenings, strict=True)] for node in clearance
        ]
    z = start.translate(craft.lifted(path.arcs[k].nodes[0] - base.nodes[0]))
    if z.count > merging.limit:
        z = merging.at_start(z, controller.period(z, base, k, 0)[0].columns * controller.plant.q)
    spells, nodes, commands = list[Spell](), list[Zonotope](), list[list[arb]]()
    for i in range(controller.plant.q):
        period, spell = controller.period(z, base, k, i, commands)
        commands.append(period.bounds)
        spells.append(spell)
        end = period.ends(z)
        if departures is not None:
            change = z.image(whole.M * period.F - whole.M).translate(whole.M * period.shift)
            extra = zip(*period.extra(unit, z, held=False), intersamples, strict=True)
            held_inputs = [whole.M * each for each in period.held]
            ends = z.through(whole), change.plus(*held_inputs), end.through(whole).plus(*held_inputs)
            departures.check(
                i, base, *ends, [largest((a, b)) + intersample[i] for a, b, intersample in extra]
            )
        if barrier is not None:
            context = f"step {k}, part {i}, under {controller.law.name}"
            along, rows_of = craft.intersample(barrier.rows)
            for place, x, bounds in zip((i, i + 1), (z, end), period.extra(along, z), strict=True):
                _separate(barrier, rows_of, x, bounds, clearance[place], context)
        z = merging.within(period.next_set(end))
        nodes.append(z.translate(craft.lifted(base.nodes[i + 1] - path.arcs[k].nodes[i + 1])))
    exit_set = z.translate(craft.lifted(base.nodes[-1] - path.starts[k + 1]))
    return FlownStep(controller, start, exit_set, spells, nodes[:-1])


def _separate(
    barrier: Barrier, rows: Directions, z: Zonotope, bounds: list[arb], clearance: list[arb], context: str
) -> None:
    """Check that a set, and more along each facet, is within the clearance there."""
    along = z.through(rows)
    tightenings = sums(along.c.entries(), along.widths, bounds)
    if not all(tightening <= limit for tightening, limit in zip(tightenings, clearance, strict=True)):
        tightenings = sums(along.c.entries(), z.spread(rows.M), bounds)  # to the last digits
    for name, tightening, limit in zip(barrier.names, tightenings, clearance, strict=True):
        if not tightening <= limit:
            require(
                "separation",
                limit - tightening,
                f"{context}: {name}, needs {plain(tightening)} of {plain(limit)} m",
            )


def _clipped(
    ranges: list[tuple[arb, arb]], tops: list[arb], u: arb_mat, stored: list[float] | None
) -> tuple[list[float], arb_mat, list[arb]]:
    """Slopes of a clipped law within some ranges, its offset, and the largest error of both.

    With the slopes of whoever stored them, and a range that is no wider, the motion found here lies within
    the one found there. With other slopes neither need contain the other.
    """
    slopes = stored or [secant(*ends, top) for ends, top in zip(ranges, tops, strict=True)]
    offsets, bands = [], []
    for slope, (lo, hi), top, x in zip(slopes, ranges, tops, u.entries(), strict=True):
        # The clip less a line is piecewise affine: its extremes are at the ends and at the limits.
        places = [lo, hi, *(y for y in (-top, top) if lo < y < hi)]
        residuals = [clip(y, top) - slope * y for y in places]
        middle_rest, band = around(smallest(residuals), largest(residuals))
        offsets.append(slope * x + middle_rest - x)
        bands.append(band)
    return slopes, column(offsets), bands
