"""Reachable sets of the schedule: what each controller may do in a step, enclosed over whole intervals."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

from flint import arb, arb_mat

from .balls import (
    above,
    column,
    diagonal,
    identity,
    largest,
    magnitude,
    plain,
    require,
    row_sums,
    smallest,
    sums,
)
from .limits import Barrier
from .motion import Motion, Plant
from .path import Arc, Path
from .verdict import Rejected
from .zonotopes import Merging, Zonotope

ROUNDS = 5
"""How often the range of a clipped command is narrowed by the thrust that it allows."""


@dataclass(frozen=True, eq=False)
class Pilot:
    """A controller as reachability sees it.

    Parameters
    ----------
    name, kind : str
    plant : Plant
    gain : arb_mat or None
        None for anything within the thrust limits.
    own : list of (arb_mat, arb_mat) or None
        State at the start and input of every step of its own reference; None for the safe reference.
    slopes : list of (list of list of float or None), optional
        By step and period, slopes from 0 to 1 of the lines about which a clipped command is enclosed.
        Any are sound; None for those of the checker's own.
    """

    name: str
    kind: str
    plant: Plant
    gain: arb_mat | None
    own: list[tuple[arb_mat, arb_mat]] | None
    slopes: list[list[list[float]] | None] = field(default_factory=list, repr=False)
    _loops: dict[tuple[float, ...], Motion] = field(default_factory=dict, repr=False)

    def loop(self, slopes: Sequence[float] = ()) -> Motion:
        """Its loop with the gain of every input times a slope; unchanged without slopes."""
        assert self.gain is not None
        key = tuple(slopes)
        if key not in self._loops:
            gain = diagonal(key) * self.gain if key else self.gain
            self._loops[key] = self.plant.loop(gain)
        return self._loops[key]

    @cached_property
    def commands(self) -> arb_mat:
        """Rows of its command and, for the other limit, of the negative one."""
        assert self.gain is not None
        return above(-self.gain, self.gain)

    def stored(self, k: int, i: int) -> list[float] | None:
        """Slopes for its clipped command in a period of a step, if the certificate has any."""
        step = self.slopes[k] if self.slopes else None
        return None if step is None else step[i]


@dataclass(frozen=True, eq=False)
class Period:
    """Motion over one period: ``d' = ... + g + V v`` with ``|v_i| <= bounds[i]``."""

    motion: Motion
    g: arb_mat
    V: arb_mat
    bounds: list[arb]

    def ends(self, d: Zonotope) -> Zonotope:
        """Where the motion without disturbance and without v ends."""
        return d.image(self.motion.phi).moved(self.motion.gamma * self.g)

    def after(self, end: Zonotope) -> Zonotope:
        """The set at the next node, from `ends`."""
        pushed = []
        if self.bounds:
            V = self.V * diagonal(self.bounds)
            held = self.motion.held is not None
            size = magnitude(V) * column([1] * len(self.bounds))
            pushed = [self.motion.gamma * V if held else self.motion.input_set(V, size)]
        return end.grown(*pushed, self.motion.disturbance_set)

    def extra(self, rows: arb_mat, d: Zonotope) -> tuple[list[arb], list[arb]]:
        """Bounds on how far ``row d`` exceeds the chord of its undisturbed end values within the period.

        They belong to the start and the end of the period; in between, their chord is a bound: what v and
        the disturbance have done grows from nothing.
        """
        motion = self.motion
        bend, last = motion.disturbance_along(rows)
        first = sums(motion.bow(rows, d.image(motion.closed).moved(self.g)), bend)
        if self.bounds:
            first = sums(first, motion.input_bend(rows, self.V, self.bounds))
            last = sums(last, motion.input_gain(rows, self.V, self.bounds))
        return first, sums(first, last)

    def within(self, rows: arb_mat, d: Zonotope, at_node: list[arb]) -> list[arb]:
        """Bound on ``row d`` over the whole period; `at_node` is that at its start."""
        first, last = self.extra(rows, d)
        ends = sums(self.ends(d).support(rows), last)
        return [largest(pair) for pair in zip(sums(at_node, first), ends, strict=True)]


@dataclass(frozen=True, eq=False)
class Flown:
    """One step flown.

    Attributes
    ----------
    end : Zonotope
        Errors at the end of the step.
    lower, upper : list of arb
        Bounds on every state over the whole step.
    """

    end: Zonotope
    lower: list[arb]
    upper: list[arb]


def fly(
    pilot: Pilot, start: Zonotope, k: int, path: Path, barrier: Barrier | None, merging: Merging
) -> Flown:
    """Enclose one step of one controller, and check that it stays separate from every unsafe set.

    Parameters
    ----------
    pilot : Pilot
    start : Zonotope
        Errors about the safe reference at the start of the step.
    k : int
        Step.
    path : Path
        The safe reference.
    barrier : Barrier or None
        Separating facets; None under the safety controller, whose separation follows from
        recoverability.
    merging : Merging
        How many generators are kept.

    Raises
    ------
    Rejected
        If the step is not separate, or an unclipped law may exceed the thrust limits.
    """
    kinematics, n = path.kinematics, start.c.nrows()
    base, u = _base(pilot, k, path)
    axes = identity(n)
    heights, bows = base.heights(axes).tolist(), kinematics.bow(axes, base).tolist()
    rows, room = axes, []
    if barrier is not None:
        rows, room = above(axes, barrier.rows), kinematics.room(barrier.rows, barrier.offsets, base)
    d = merging.reduced(start).moved(path.starts[k] - base.nodes[0])
    lows: list[list[arb]] = [[] for _ in range(n)]
    highs: list[list[arb]] = [[] for _ in range(n)]
    for i in range(kinematics.q):
        period = _period(pilot, d, u, k, i)
        end, extra = period.ends(d), period.extra(rows, d)
        for place, z, more in ((i, d, extra[0]), (i + 1, end, extra[1])):
            middle, spread = (rows * z.c).entries(), row_sums(rows * z.G)
            needs = sums(middle, spread, more)
            for axis in range(n):
                at, room_for = heights[axis][place] + middle[axis], spread[axis] + more[axis] + bows[axis][i]
                lows[axis].append(at - room_for)
                highs[axis].append(at + room_for)
            if barrier is not None:
                for name, need, there in zip(barrier.names, needs[n:], room[place], strict=True):
                    if not need <= there:
                        told = f"step {k}, part {i}, under {pilot.name}: {name}, needs {plain(need)}"
                        require("separation", there - need, f"{told} of {plain(there)} m")
        d = period.after(end)
        if d.G.ncols() > 2 * merging.order * n:
            d = merging.reduced(d)
    leave = d.moved(base.nodes[-1] - path.starts[k + 1])
    return Flown(leave, [smallest(x) for x in lows], [largest(x) for x in highs])


def _base(pilot: Pilot, k: int, path: Path) -> tuple[Arc, arb_mat]:
    """The arc about which a controller's motion is described, and its input."""
    if pilot.gain is None:  # free motion, and every thrust is an uncertain input about zero
        rest = column([0] * pilot.plant.B.ncols())
        return path.kinematics.arc(path.starts[k], rest), rest
    if pilot.own is None:
        return path.arcs[k], path.inputs[k]
    state, u = pilot.own[k]
    return path.kinematics.arc(state, u), u


def _period(pilot: Pilot, d: Zonotope, u: arb_mat, k: int, i: int) -> Period:
    """Motion over the next period from a set about the base arc."""
    plant = pilot.plant
    still = arb_mat(d.c.nrows(), 1)
    if pilot.gain is None:
        return Period(plant.open, still, plant.B, plant.u_max)
    linear = Period(pilot.loop(), still, plant.B, [])
    if pilot.kind == "safety":
        return linear
    command = _linear_command(pilot, linear, d, u)
    if all(max(-lo, hi) <= top for (lo, hi), top in zip(command, plant.u_max, strict=True)):
        return linear
    if pilot.kind == "affine":
        raise Rejected("controllers", f"{pilot.name} may exceed the thrust limits, unclipped, in step {k}")
    return _clipped(pilot, d, u, pilot.stored(k, i))


def _linear_command(pilot: Pilot, linear: Period, d: Zonotope, u: arb_mat) -> list[tuple[arb, arb]]:
    """Range of every command over the period if nothing clips, which is proven if it is within the limits."""
    rows = pilot.commands
    most = d.support(rows)
    if not pilot.plant.sampled:
        most = linear.within(rows, d, most)
    return _ranges(u, most)


def _ranges(u: arb_mat, most: list[arb]) -> list[tuple[arb, arb]]:
    """Ranges of ``u + y`` from bounds on y and on -y, as exact numbers."""
    m = u.nrows()
    return [((u[i, 0] - most[m + i]).lower(), (u[i, 0] + most[i]).upper()) for i in range(m)]


def _clipped(pilot: Pilot, d: Zonotope, u: arb_mat, stored: list[float] | None) -> Period:
    """A clipped law over a period, as a linear one and an input within a band.

    The range of the command comes from what any thrust known so far may do within the period, and a
    range of the command limits that thrust: each round of this is valid because the one before was.

    With the slopes of whoever stored them, and a range that is no wider, the motion found here lies within
    the one found there. With other slopes neither need contain the other.
    """
    plant, rows, m = pilot.plant, pilot.commands, u.nrows()
    at_node = d.support(rows)
    ranges = _ranges(u, at_node)
    if not plant.sampled:
        pushes = [(-top - x, top - x) for top, x in zip(plant.u_max, u.entries(), strict=True)]
        for _ in range(ROUNDS):
            middle = [((lo + hi) / 2).mid() for lo, hi in pushes]
            spread = [largest((hi - x, x - lo)) for (lo, hi), x in zip(pushes, middle, strict=True)]
            free = Period(plant.open, plant.B * column(middle), plant.B, spread)
            ranges = _ranges(u, free.within(rows, d, at_node))
            pushes = [
                (_clip(lo, top) - x, _clip(hi, top) - x)
                for (lo, hi), top, x in zip(ranges, plant.u_max, u.entries(), strict=True)
            ]
    slopes = stored or [_secant(*ends, top) for ends, top in zip(ranges, plant.u_max, strict=True)]
    middles, bands = [], []
    for slope, (lo, hi), top in zip(slopes, ranges, plant.u_max, strict=True):
        # The clip less a line is piecewise affine: its extremes are at the ends and at the limits.
        places = [lo, hi, *(x for x in (-top, top) if lo < x < hi)]
        rests = [_clip(y, top) - slope * y for y in places]
        high, low = largest(rests), -largest(-x for x in rests)
        middles.append(((high + low) / 2).mid())
        bands.append(largest((high - middles[-1], middles[-1] - low)))
    known = [
        slope * u[i, 0] + middle - u[i, 0]
        for i, (slope, middle) in enumerate(zip(slopes, middles, strict=True))
    ]
    return Period(pilot.loop(slopes), plant.B * column(known), plant.B, bands if m else [])


def _secant(lo: arb, hi: arb, top: arb) -> float:
    """Slope of the clip between two commands."""
    width = hi - lo
    return float(((_clip(hi, top) - _clip(lo, top)) / width).mid()) if width > 0 else 1.0


def _clip(y: arb, top: arb) -> arb:
    """The command y limited to ``[-top, top]``."""
    if y > top:
        return top
    return -top if y < -top else y
