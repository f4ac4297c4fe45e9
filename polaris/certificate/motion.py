"""One period of a linear motion with uncertain inputs, between two instants at which it is known as a set.

``x' = X x + g + V v + D w`` with measurable v in a box about zero and ``norm(w, 2) <= w_max``. Under
sampled feedback the input of the period is fixed at its start, so ``x(s) = M(s) x(0) + ...`` with
``M'' = X e^{X s} A_c`` and ``A_c = A - B K``; under continuous feedback ``X = A_c`` and ``M(s) = e^{X s}``.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

from flint import arb, arb_mat

from .balls import beside, column, diagonal, exponential, exponential_over, magnitude, norms, row_sums
from .zonotopes import Zonotope, ball_cover


@dataclass(frozen=True, eq=False)
class Plant:
    """What is controlled: matrices, limits, and the period between two nodes.

    Parameters
    ----------
    A, B, D, C : arb_mat
        System matrices, and the position as a function of the state.
    u_max : list of arb
        Input limits.
    w_max : arb
        Bound on the 2-norm of the disturbance.
    h : arb
        Length of a period [s].
    sampled : bool
        Whether inputs are held over a period.
    """

    A: arb_mat
    B: arb_mat
    D: arb_mat
    C: arb_mat
    u_max: list[arb]
    w_max: arb
    h: arb
    sampled: bool

    def loop(self, gain: arb_mat) -> Motion:
        """Motion under ``u = -gain x``."""
        closed = self.A - self.B * gain
        if not self.sampled:
            return Motion(self, closed, closed)
        return Motion(self, self.A, closed, gain)

    @cached_property
    def open(self) -> Motion:
        """Motion under inputs that do not depend on the state."""
        return Motion(self, self.A, self.A)


@dataclass(frozen=True, eq=False)
class Motion:
    """One period of it.

    Parameters
    ----------
    plant : Plant
    X : arb_mat
        Matrix of the motion within the period.
    closed : arb_mat
        ``A_c``.
    held : arb_mat or None
        The gain, if its input is held.
    """

    plant: Plant
    X: arb_mat
    closed: arb_mat
    held: arb_mat | None = None
    _asked: dict[int, tuple[arb_mat, list[arb], list[arb]]] = field(default_factory=dict, repr=False)

    @cached_property
    def _exponentials(self) -> tuple[arb_mat, arb_mat]:
        return exponential(self.X, self.plant.h)

    @cached_property
    def phi(self) -> arb_mat:
        """``M(h)``: from one node to the next."""
        phi, gamma = self._exponentials
        return phi if self.held is None else phi - gamma * self.plant.B * self.held

    @property
    def gamma(self) -> arb_mat:
        """``int_0^h e^{X s} ds``."""
        return self._exponentials[1]

    @cached_property
    def over(self) -> arb_mat:
        """Enclosure of ``e^{X s}`` for all s of the period."""
        return exponential_over(self.X, self.plant.h)

    def bend(self, rows: arb_mat) -> arb_mat:
        """Bound on ``(h^2/8) |row X e^{X s}|``, entry by entry, for all s of the period.

        By the chord lemma ``row x(s)`` differs from the chord of its end values by at most this times
        the size of ``A_c x(0) + g``.
        """
        return magnitude(rows * self.X * self.over * (self.plant.h**2 / 8))

    def bow(self, rows: arb_mat, rate: Zonotope) -> list[arb]:
        """Bound on how far ``row x(s)`` leaves the chord of its end values; `rate` is ``A_c x(0) + g``.

        The lesser of ``|row X e^{X s}| |rate|`` and ``|row e^{X s}| |X rate|``: X commutes with ``e^{X s}``.
        """
        return self.lesser_bow(rows, rate.size(), rate.image(self.X).size())

    def lesser_bow(self, rows: arb_mat, rate: arb_mat, turned: arb_mat) -> list[arb]:
        """The same from bounds on ``|rate|`` and ``|X rate|``, shapes (n, 1)."""
        first = self.bend(rows) * rate
        second = magnitude(rows * self.over * (self.plant.h**2 / 8)) * turned
        return [a if a <= b else b for a, b in zip(first.entries(), second.entries(), strict=True)]

    # -- uncertain inputs ---------------------------------------------------------------------------

    def input_set(self, V: arb_mat, size: arb_mat) -> arb_mat:
        """Generators that enclose ``int_0^h e^{X s} V v(s) ds`` for measurable v.

        The mean of v lies in its (convex) set; the rest is at most ``(h^2/3) |X| sup|e^{X s}| |V v|``.

        Parameters
        ----------
        V : arb_mat
            Generators of the set of ``V v``.
        size : arb_mat, shape (n, 1)
            Bound on ``|V v|``.
        """
        rest = magnitude(self.X) * magnitude(self.over) * size * (self.plant.h**2 / 3)
        return beside(self.gamma * V, diagonal(rest.entries()))

    @cached_property
    def disturbance_set(self) -> arb_mat:
        """Generators that enclose what the disturbance adds over one period."""
        D, w = self.plant.D, self.plant.w_max
        size = column([length * w for length in norms(D)])
        return self.input_set(D * ball_cover(D.ncols(), w), size)

    def disturbance_gain(self, rows: arb_mat) -> list[arb]:
        """Bound on ``w_max int_0^h norm(row e^{X s} D, 2) ds`` for every row.

        The norm of a smooth vector lies below its chord plus that of the vector's bend: the trapezoid
        rule and ``h^3/12`` times a bound on the second derivative are an upper bound.
        """
        h, D = self.plant.h, self.plant.D
        left, right = norms(rows * D), norms(rows * (self._exponentials[0] * D))
        bent = norms(magnitude(rows * self.X * self.X * self.over * D))
        return [
            self.plant.w_max * (h / 2 * (a + b) + h**3 / 12 * c)
            for a, b, c in zip(left, right, bent, strict=True)
        ]

    def input_gain(self, rows: arb_mat, V: arb_mat, bounds: list[arb]) -> list[arb]:
        """Bound on ``|int_0^s row e^{X r} V v dr|`` for ``|v_i| <= bounds[i]`` and any s of the period.

        By the same rule as `disturbance_gain`, for every column of V.
        """
        h = self.plant.h
        ends = magnitude(rows * V) + magnitude(rows * (self._exponentials[0] * V))
        second = magnitude(rows * self.X * self.X * self.over * V)
        return ((ends * (h / 2) + second * (h**3 / 12)) * column(bounds)).entries()

    def input_bend(self, rows: arb_mat, V: arb_mat, bounds: list[arb]) -> list[arb]:
        """Bound on how far `input_gain` over a part of the period exceeds that part of the whole period's.

        ``P(s) = int_0^s |row e^{X r} V v| dr`` starts at 0, and its slope changes by no more than
        ``sup |row X e^{X r} V v|`` in a unit of time: the chord lemma applies.
        """
        second = magnitude(rows * self.X * self.over * V) * (self.plant.h**2 / 8)
        return (second * column(bounds)).entries()

    def disturbance_bend(self, rows: arb_mat) -> list[arb]:
        """The same for the disturbance."""
        rates = norms(magnitude(rows * self.X * self.over * self.plant.D))
        return [self.plant.w_max * self.plant.h**2 / 8 * rate for rate in rates]

    def disturbance_along(self, rows: arb_mat) -> tuple[list[arb], list[arb]]:
        """`disturbance_bend` and `disturbance_gain`, once for the same rows: every period of a step asks."""
        if id(rows) not in self._asked:
            self._asked[id(rows)] = rows, self.disturbance_bend(rows), self.disturbance_gain(rows)
        return self._asked[id(rows)][1:]

    @cached_property
    def disturbance_box(self) -> arb_mat:
        """Bound on what the disturbance adds to each state within a period, shape (n, 1)."""
        sizes = row_sums(magnitude(self.over * self.plant.D))
        return magnitude(column([s * self.plant.w_max * self.plant.h for s in sizes]))
