"""Another satellite: every place where it may be, against the timed polytope that stands for it."""

from typing import Any

from flint import arb, arb_mat, fmpq, fmpq_mat

from ..files.document import Document
from ..files.entries import UnsafeSet
from ..kernel.balls import (
    absolute,
    column,
    exponential,
    exponential_over,
    kinds,
    lengths,
    matrix,
    norms,
    require,
    rows_of,
    spans,
    sums,
)
from ..kernel.verdict import Rejected
from .plants import plant_of

ROUNDED = 1e-9  # rounding of offsets, relative to the numbers they are made from

MOST_PARTS = 256  # most parts into which a step is divided to follow it


class Satellite:
    """Support of every place where another satellite may be, and a ball around it, over each step.

    ``c(t) z_0 + |c(t)| dz + radius`` and, for every input M with its bound a (the disturbance, and its own
    acceleration), ``a int_0^t norm(c(s) M) ds``, with ``c(t) = n C e^{A t}``. Between two instants each term
    is at most its chord plus its intersample bound.
    """

    def __init__(self, document: Document, item: UnsafeSet, spec: dict[str, Any]) -> None:
        self.document, self.item = document, item
        plant = plant_of(document)
        self.A = plant.A
        normals = matrix(item.normals)
        first, self.facets = kinds(normals)
        self.rows = rows_of(normals, *first) * matrix(document.C)
        self.state = column(spec["state"])
        self.half = column(spec["state_half_widths"])
        self.radius = [length * spec["radius_m"] for length in norms(normals)]
        self.pushes = [(plant.D, arb(document.w_max))]
        columns = zip(plant.D.transpose().tolist(), document.bias, strict=False)
        self.pushes += [(column(each), arb(bound)) for each, bound in columns if bound]
        thrust = spec.get("thrust_accel_max_m_s2", 0.0)
        if thrust:
            self.pushes.append((acceleration_input(document, item.name), arb(thrust)))

    def check(self) -> None:
        """Check all steps; each is divided until its polytope is shown to do, or no further."""
        step = exponential(self.A, arb(self.document.delta))[0]
        carried, state = self.rows, self.state
        integral, parts = [arb(0)] * self.rows.nrows(), 1
        for cell in range(len(self.item.start)):
            while True:
                final = parts >= MOST_PARTS
                after = self._step(cell, parts, carried, state, integral, final)
                if after is not None:
                    break
                parts *= 2
            integral, carried, state = after, carried * step, step * state

    def _step(
        self, cell: int, parts: int, carried: arb_mat, state: arb_mat, integral: list[arb], final: bool
    ) -> list[arb] | None:
        """Check one step in parts; the integral so far at its end, or None if it needs more parts."""
        h = arb(self.document.delta) / parts
        small = exponential(self.A, h)[0]
        over = self.A * self.A * exponential_over(self.A, h)
        first, last = self.item.start[cell], self.item.end[cell]
        size = [abs(a) + abs(b) for a, b in zip(map(arb, first), map(arb, last), strict=True)]
        values, margins, integral = [], [], list(integral)
        current = [norms(carried * M) for M, _ in self.pushes]
        for part in range(parts + 1):
            spread = (absolute(carried) * self.half).entries()
            middle = (carried * self.state).entries()
            around = sums(spread, integral)
            facets = zip(self.facets, self.radius, strict=True)
            values.append([sign * middle[i] + around[i] + radius for (i, sign), radius in facets])
            if part == parts:
                break
            second, following = carried * over, carried * small
            curvature = (absolute(second * self.state) + spans(second, self.half)) * (h**2 / 8)
            margin = curvature.entries()
            later = [norms(following * M) for M, _ in self.pushes]
            for (M, accel), g, after in zip(self.pushes, current, later, strict=True):
                for f, (x, y, z) in enumerate(zip(g, after, lengths(second * M), strict=True)):
                    margin[f] += accel * (h / 8 * max(x - y, arb(0)) + h**3 / 12 * z)
                    integral[f] += accel * (h / 2 * (x + y) + h**3 / 12 * z)
            margins.append(margin)
            carried, current = following, later
        for part, value in enumerate(values):
            adjacent = margins[max(part - 1, 0) : part + 1]
            s = arb(part) / parts
            for f, support in enumerate(value):
                gap = first[f] * (1 - s) + last[f] * s - support + size[f] * ROUNDED
                for margin in adjacent:
                    slack = gap - margin[self.facets[f][0]]
                    if slack >= 0:
                        continue
                    if not final:
                        return None
                    require("unsafe_sets", slack, f"{self.item.name}, facet {f}, in step {cell}")
        return integral


def acceleration_input(document: Document, name: str) -> arb_mat:
    """Return how an acceleration of the position enters the state: E with ``C E = 0``, ``C A E = I``.

    In rational arithmetic, on the stored matrices; in Hill's frame they tell nothing else than the exact.
    `Rejected` if the position obeys no equation of second order.
    """
    d, A, C = len(document.C), _rational(document.A), _rational(document.C)
    velocity = C * A
    outputs = fmpq_mat([*C.tolist(), *velocity.tolist()])
    if outputs.rank() < 2 * d:
        raise Rejected("unsafe_sets", f"{name} has thrust, but the position of this system no acceleration")
    if fmpq_mat([*outputs.tolist(), *(velocity * A).tolist()]).rank() > 2 * d:
        text = "the acceleration of this system's position depends on more than position and rate"
        raise Rejected("unsafe_sets", f"{name} has thrust, but {text}")
    # Any solution will do: what follows of the position depends on its products with C and C A only.
    right_inverse = outputs.transpose() * (outputs * outputs.transpose()).inv()
    return matrix([[arb(x) for x in row[d:]] for row in right_inverse.tolist()])


def _rational(rows: list[list[float]]) -> fmpq_mat:
    return fmpq_mat([[fmpq(*x.as_integer_ratio()) for x in row] for row in rows])
