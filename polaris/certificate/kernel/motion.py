"""One period of a linear motion with uncertain inputs, between two instants at which it is known as a set.

``x' = A x + B u + g + V v + D w`` with measurable v in a box about zero and ``norm(w, 2) <= w_max``. The
input u is fixed at the period's start, so the undisturbed motion has ``x'' = A e^{A s} x'(0)``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import accumulate, pairwise

from flint import arb, arb_mat

from .balls import (
    above,
    beside,
    column,
    diagonal,
    dot,
    exponential,
    exponential_over,
    identity,
    largest,
    lengths,
    magnitude,
    matrix,
    root,
    sums,
    widths,
)
from .pulse_lead import Lead
from .zonotopes import Directions, Zonotope, ball_cover

PARTS = 32
"""Parts of a prediction over each of which integrals are bounded by the trapezoid rule."""


@dataclass(frozen=True, eq=False)
class InputSet:
    """An uncertain input ``V v``, v measurable and at every instant in a convex set about zero."""

    V: arb_mat
    cover: arb_mat  # generators that enclose v
    along: Callable[[arb_mat], list[arb]]  # bounds on |row v|, for the rows of a matrix
    radius: arb | None = None  # of the set, if it is a ball

    @classmethod
    def in_box(cls, V: arb_mat, bounds: list[arb]) -> InputSet:
        """``|v_i| <= bounds[i]``."""
        return cls(V, diagonal(bounds), lambda rows: (magnitude(rows) * column(bounds)).entries())

    @classmethod
    def in_zonotope(cls, V: arb_mat, generators: arb_mat) -> InputSet:
        """``v = generators b``, every ``|b_i| <= 1``."""
        return cls(V, generators, lambda rows: widths(rows * generators))

    @classmethod
    def in_ball(cls, V: arb_mat, radius: arb) -> InputSet:
        """``norm(v, 2) <= radius``."""
        return cls(V, ball_cover(V.ncols(), radius), lambda rows: [radius * x for x in lengths(rows)], radius)


@dataclass(frozen=True, eq=False)
class Plant:
    """Controlled plant: matrices, limits, and the period between two nodes."""

    A: arb_mat
    B: arb_mat
    D: arb_mat
    C: arb_mat  # the position as a function of the state
    u_max: list[arb]
    w_max: arb  # bound on the 2-norm of the disturbance
    h: arb  # length of a period [s]
    q: int = 1  # periods per step
    along: arb | float = 0.0  # error of an input as a share of its own command; of a layout in `shares`
    across: arb | float = 0.0  # error as a share of the 2-norm of the other commands
    shares: Sequence[Sequence[arb]] = ()  # errors (rows) as shares of each command, of a layout
    constant: bool = False  # whether what is spent counts those of inputs as one matrix in a whole flight
    bits: Sequence[float] = ()  # error of each input whatever is commanded [N]; empty: all zero
    on_time: Plant | None = None  # with errors of inputs without jitter and pulses
    jitter: float | arb = 0.0  # by which what is made may come too early or late [s]
    carried: float = 0.0  # impulse of an input that may be left to the next period [N s]
    weights: tuple[arb, ...] = ()  # of inputs in what is spent, of a layout of thrusters; else 1 each
    unmeasured: arb = field(default_factory=lambda: arb(0))  # for how long errors may be [s]
    bias: list[InputSet] = field(default_factory=list)  # inputs that are constant in a whole flight
    by_lag: list[tuple[int, arb_mat]] = field(default_factory=list)
    """Bounds on estimate errors per unit thruster error of up to so many periods before a command, (n, k),
    where commands of the meantime are told apart."""
    shifted: tuple[arb, ...] = ()  # impulses of inputs that jitter brings forward or puts off [N s], if any
    lead: Lead | None = None  # of pulses that are not centred

    @cached_property
    def predicted(self) -> arb_mat:
        """Bound the prediction error per unit of thruster error until it is measured, (n, k)."""
        if not self.unmeasured > 0:
            return arb_mat(self.B.nrows(), self.entering.ncols())
        return replace(self, h=self.unmeasured / PARTS).open.unit_gains(identity(self.B.nrows()), PARTS)

    @cached_property
    def turning(self) -> Directions:
        """Return A, as rows of a rate."""
        return Directions(self.A)

    @cached_property
    def carry_pushes(self) -> list[InputSet]:
        """Return the pushes of impulses carried to the next period, and of those that jitter moves."""
        size, rates = [arb(self.carried)] * self.B.ncols(), [self.A * self.open.gamma * self.B * (1 / self.h)]
        rates += [self.A * self.B * self.along] if self.along > 0 else []
        return [*(InputSet.in_box(rate, size) for rate in rates if self.carried), *self.shifting]

    @property
    def shifting(self) -> list[InputSet]:
        """Return the pushes of impulses that jitter moves, if there are any."""
        return [InputSet.in_box(self.A * self.B, list(self.shifted))] if self.shifted else []

    @property
    def without_delay(self) -> Plant:
        """Return the plant without the input errors that stand for jitter and pulses."""
        return self.on_time or self

    def disturbances(self, error: list[arb]) -> list[InputSet]:
        """Return the pushes of w, constants, carried impulses, and errors of the inputs up to some sizes."""
        return [self.disturbance, *self.bias, *self.carry_pushes, *self.push(error)]

    @cached_property
    def entering(self) -> arb_mat:
        """Rates of the states by errors of thrusters, (n, k): of inputs, then by leads of pulses, if any."""
        return self.B if self.lead is None else beside(self.B, self.A * self.B)

    def thruster_error(self, commands: Sequence[arb]) -> list[arb]:
        """Bounds on errors of thrusters, see `entering`, under commands up to some sizes, (k)."""
        bits = [*(map(arb, self.bits) if self.bits else [arb(0)] * len(commands))]
        if self.lead is not None:
            bits += self.lead.fixed
        elif not self.bits:
            return self.thruster_part(commands)
        return sums(self.thruster_part(commands), bits)

    def thruster_part(self, commands: Sequence[arb]) -> list[arb]:
        """Return the command-proportional part of errors: that of a sum is at most the sum of the parts."""
        return [*self._input_part(commands), *([] if self.lead is None else self.lead.part(commands))]

    def _input_part(self, commands: Sequence[arb]) -> list[arb]:
        if self.shares:
            return [dot(row, commands) for row in self.shares]
        others = [[*commands[:i], *commands[i + 1 :]] if self.across else [] for i in range(len(commands))]
        return [self.along * x + self.across * root(dot(y, y)) for x, y in zip(commands, others, strict=True)]

    @cached_property
    def table(self) -> arb_mat:
        """Bounds on the error of each input, rows, by a unit of each command, shape (m, m)."""
        m = self.B.ncols()
        if self.shares:
            return arb_mat([list(row) for row in self.shares])
        return diagonal([arb(self.along)] * m) + arb_mat(m, m, [arb(self.across)] * m * m)

    @property
    def every_table(self) -> arb_mat:
        """Bounds on the errors of `entering`, rows, by a unit of each command, shape (k, m)."""
        return self.table if self.lead is None else above(self.table, matrix(self.lead.shares))

    @property
    def alone(self) -> arb_mat:
        """Error of each input, rows, by a unit of one command alone, shape (m, m)."""
        m = self.B.ncols()
        return self.table if self.shares else self.table - diagonal([arb(self.across)] * m)

    @cached_property
    def matrix(self) -> list[tuple[int, int, arb]]:
        """Row, column and bound of entries of a constant matrix of errors of thrusters; none without one."""
        each = self.alone.tolist() if self.constant else []
        return [(i, j, x) for i, row in enumerate(each) for j, x in enumerate(row) if x > 0]

    def spending(self, commands: Sequence[arb]) -> arb:
        """Bound on the thrusters' spending in a period under commands up to `commands`, by their weights."""
        applied = sums(commands, self.without_delay.thruster_error(commands))
        return self.weighted(applied) * (self.h + 2 * arb(self.jitter))

    def weighted(self, sizes: Sequence[arb]) -> arb:
        """Sum of sizes of inputs, each by its weight."""
        return dot(sizes, self.weights or [1.0] * len(sizes))

    def push(self, error: list[arb]) -> list[InputSet]:
        """Errors of thrusters (k), or of inputs alone (m), as input sets, if there are any."""
        rates = self.B if len(error) == self.B.ncols() else self.entering
        return [InputSet.in_box(rates, error)] if any(x > 0 for x in error) else []

    @cached_property
    def open(self) -> Motion:
        """Motion under inputs that do not depend on the state."""
        return Motion(self)

    @cached_property
    def disturbance(self) -> InputSet:
        """Return the disturbance."""
        return InputSet.in_ball(self.D, self.w_max)

    @cached_property
    def steps(self) -> list[tuple[arb_mat, arb_mat]]:
        """``e^{A t}`` and ``int_0^t e^{A s} ds B`` to every node of a step but its first."""
        parts = (exponential(self.A, self.h * i) for i in range(1, self.q + 1))
        return [(phi, gamma * self.B) for phi, gamma in parts]


@dataclass(frozen=True, eq=False)
class Motion:
    """One period of it."""

    plant: Plant

    @property
    def A(self) -> arb_mat:
        """Matrix of the motion within the period."""
        return self.plant.A

    @cached_property
    def _exponentials(self) -> tuple[arb_mat, arb_mat]:
        return exponential(self.A, self.plant.h)

    @property
    def phi(self) -> arb_mat:
        """``e^{A h}``: from one node to the next."""
        return self._exponentials[0]

    @property
    def gamma(self) -> arb_mat:
        """``int_0^h e^{A s} ds``."""
        return self._exponentials[1]

    @cached_property
    def over(self) -> arb_mat:
        """Enclosure of ``e^{A s}`` for all s of the period."""
        return exponential_over(self.A, self.plant.h)

    def curvature(self, rows: arb_mat) -> arb_mat:
        """Bound on ``(h^2/8) |row A e^{A s}|``, entry by entry, for all s of the period.

        By the chord lemma ``row x(s)`` differs from the chord of its end values by at most this times
        the size of ``x'(0)``.
        """
        return magnitude(rows * self.A * self.over * (self.plant.h**2 / 8))

    # -- uncertain inputs ---------------------------------------------------------------------------

    def effect(self, *pushes: InputSet) -> arb_mat:
        """Generators that enclose the sum of ``int_0^h e^{A s} V v(s) ds`` for measurable v of each push.

        The mean of v lies in its (convex) set; the rest is in a box, `uneven`.
        """
        means = (self.gamma * push.V * push.cover for push in pushes)
        return beside(*means, diagonal(self.uneven(*pushes).entries()))

    def uneven(self, *pushes: InputSet) -> arb_mat:
        """Bound on the effect of pushes beside their means, ``(h^2/3) |A| sup|e^{A s}| |V v|``, (n, 1)."""
        size = column(sums(*(push.along(push.V) for push in pushes)))
        return magnitude(self.A) * magnitude(self.over) * size * (self.plant.h**2 / 3)

    def push_gain(self, rows: arb_mat, push: InputSet) -> list[arb]:
        """Bound on ``int_0^s |row e^{A r} V v| dr`` for every row, and any s of the period.

        The bound on ``|row e^{A r} V v|`` lies below its chord plus the curvature of ``row e^{A r} V``:
        the trapezoid rule and ``h^3/12`` times a bound on the second derivative are an upper bound.
        """
        h, V = self.plant.h, push.V
        left, right = push.along(rows * V), push.along(rows * (self._exponentials[0] * V))
        curvature = push.along(magnitude(rows * self.A * self.A * self.over * V))
        return [h / 2 * (a + b) + h**3 / 12 * c for a, b, c in zip(left, right, curvature, strict=True)]

    def constant_gain(self, rows: arb_mat, push: InputSet, later: int) -> list[arb]:
        """Bound a constant's effect along rows, which follow one another by a period, by any time of each.

        It begins at the start, or up to so many periods `later`. At the ends of periods it is the sum of the
        rows; between them it leaves the chord by no more than `push_curvature`.
        """
        each = (rows * (self.gamma * push.V)).tolist()
        totals = accumulate(each, sums, initial=[arb(0)] * push.V.ncols())
        ends = push.along(matrix(list(totals)))
        each_part = sums([largest(pair) for pair in pairwise(ends)], self.push_curvature(rows, push))
        return [largest(each_part[max(j - later, 0) : j + 1]) for j in range(len(each_part))]

    def gains_over(self, rows: arb_mat, pushes: Sequence[InputSet], count: int) -> tuple[list[arb], arb_mat]:
        """`push_gain` of several over so many periods, and the rows carried over all of them."""
        gains = [arb(0)] * rows.nrows()
        for _ in range(count):
            gains = sums(gains, *(self.push_gain(rows, push) for push in pushes))
            rows = rows * self.phi
        return gains, rows

    def unit_gains(self, rows: arb_mat, count: int) -> arb_mat:
        """Bound the effect along rows of a unit of each thruster error alone, shape (r, k)."""
        units = (InputSet.in_box(column(each), [arb(1)]) for each in self.plant.entering.transpose().tolist())
        return arb_mat([self.gains_over(rows, [push], count)[0] for push in units]).transpose()

    def push_curvature(self, rows: arb_mat, push: InputSet) -> list[arb]:
        """Bound on how far `push_gain` over a part of the period exceeds that part of the whole period's.

        ``P(s) = int_0^s |row e^{A r} V v| dr`` starts at 0, and its slope changes by no more than
        ``sup |row A e^{A r} V v|`` in a unit of time: the chord lemma applies.
        """
        rates = push.along(magnitude(rows * self.A * self.over * push.V))
        return [self.plant.h**2 / 8 * rate for rate in rates]


@dataclass(frozen=True, eq=False)
class RowIntersample:
    """Intersample bounds of a motion along rows, and its pushes in every period."""

    motion: Motion
    rows: arb_mat
    pushes: Sequence[InputSet] = ()

    @cached_property
    def curvatures(self) -> tuple[arb_mat, arb_mat]:
        """`Motion.curvature` of the rows, and the one without A."""
        motion = self.motion
        return motion.curvature(self.rows), magnitude(self.rows * motion.over * (motion.plant.h**2 / 8))

    def intersample(self, rate: Zonotope) -> list[arb]:
        """Bound on how far ``row x(s)`` leaves the chord of its end values; `rate` is ``x'(0)``.

        The lesser of ``|row A e^{A s}| |rate|`` and ``|row e^{A s}| |A rate|``: A commutes with ``e^{A s}``.
        """
        return self.least_bound(rate.size(), rate.through(self.motion.plant.turning).size())

    def tight_intersample(self, rate: Zonotope) -> list[arb]:
        """Lesser of `intersample` and ``|row A rate| + h |row A e^{A s}| |A rate|``: both are bounds."""
        accel, h = rate.image(self.motion.A), self.motion.plant.h
        size, at_start = accel.size(), accel.image(self.rows).size() * (h**2 / 8)
        third = (at_start + self.curvatures[0] * size * h).entries()
        return [a if a <= b else b for a, b in zip(self.least_bound(rate.size(), size), third, strict=True)]

    def least_bound(self, rate: arb_mat, accel: arb_mat) -> list[arb]:
        """Bound as `intersample` does, from bounds on ``|rate|`` and ``|A rate|``, shapes (n, 1)."""
        bounds = (self.curvatures[0] * rate).entries(), (self.curvatures[1] * accel).entries()
        return [a if a <= b else b for a, b in zip(*bounds, strict=True)]

    @cached_property
    def disturbance(self) -> tuple[list[arb], list[arb]]:
        """`Motion.push_curvature` and `Motion.push_gain` of all that pushes in every period."""
        curvatures = [self.motion.push_curvature(self.rows, push) for push in self.pushes]
        return sums(*curvatures), self.motion.gains_over(self.rows, self.pushes, 1)[0]
