"""Neural networks over sets of states, in ball arithmetic: each activation within an affine band."""

from dataclasses import dataclass
from functools import cached_property

from flint import arb, arb_mat

from .arcs import Arc
from .balls import above, beside, column, diagonal, identity, largest, matrix, row_sums, smallest, sums
from .bodies import Whereabouts
from .motion import Plant
from .parts import Law, Layer
from .zonotopes import Zonotope

FLATTEST = 1e-30  # slopes of bands below it are taken for 0
OWN = 3  # generators per input that stand for what all bands of a network leave open


@dataclass(frozen=True, eq=False)
class Command:
    """``u = K d + c + V v`` with every ``|v_i| <= 1``, and bounds on ``|u|``."""

    K: arb_mat
    c: arb_mat
    V: arb_mat
    most: list[arb]


@dataclass(frozen=True, eq=False)
class Policy:
    """A network as a function of the state relative to the reference that it reads."""

    law: Law
    plant: Plant
    told: Whereabouts

    @cached_property
    def reads(self) -> arb_mat:
        """How what it reads depends on the state relative to its reference, shape (r, n)."""
        n, m = self.plant.A.nrows(), self.plant.B.ncols()
        blocks = {"error": -identity(n), "state": identity(n)}
        blocks |= {"time": arb_mat(1, n), "reference_input": arb_mat(m, n)}
        blocks |= {name: self.told.less(name, identity(n)) for name in self.law.reads if ":" in name}
        return diagonal(self.law.input_scale) * above(*(blocks[name] for name in self.law.reads))

    @cached_property
    def layers(self) -> list[tuple[arb_mat, arb_mat] | Layer]:
        """Weights and biases, or activations, the thrust limits last."""
        own = [
            (matrix(layer.W), column(layer.b)) if layer.kind == "affine" else layer
            for layer in self.law.layers
        ]
        none, tops = arb_mat(len(self.plant.u_max), 1), self.plant.u_max
        into = diagonal([x / top for x, top in zip(self.law.output_scale, tops, strict=True)])
        return [*own, (into, none), Layer("clip", low=-1.0, high=1.0), (diagonal(tops), none)]

    def known(self, base: Arc, k: int, i: int) -> tuple[arb_mat, arb_mat]:
        """What it reads on its reference itself, at node i of step k, and generators of that."""
        n = self.plant.A.nrows()
        time = self.plant.h * self.plant.q * k
        parts = {"error": arb_mat(n, 1), "state": base.nodes[i], "time": column([time])}
        parts["reference_input"] = base.u
        spread = {name: arb_mat(part.nrows(), self.told.width) for name, part in parts.items()}
        for name in (name for name in self.law.reads if ":" in name):
            middle, spread[name] = self.told.at(name, k * self.plant.q + i)
            parts[name] = middle + self.told.less(name, base.nodes[i])
        scale = diagonal(self.law.input_scale)
        read, rest = (scale * above(*(found[name] for name in self.law.reads)) for found in (parts, spread))
        return read, rest

    def command(self, d: Zonotope, known: arb_mat, rest: arb_mat) -> Command:
        """What it commands over a set of states relative to its reference."""
        M, c, V = self.reads, known, rest
        if self.plant.estimate:
            V = beside(V, M * diagonal(self.plant.estimate))
        for layer in self.layers:
            if isinstance(layer, tuple):
                M, c, V = layer[0] * M, layer[0] * c + layer[1], layer[0] * V
                continue
            spread = sums(row_sums(M * d.G), row_sums(V))
            middle = (M * d.c + c).entries()
            bands = [
                band(layer, (at - off).lower(), (at + off).upper())
                for at, off in zip(middle, spread, strict=True)
            ]
            slopes, offsets, radii = zip(*bands, strict=True)
            S = diagonal(slopes)
            M, c, V = S * M, S * c + column(offsets), beside(S * V, diagonal(radii))
        spread, middle = sums(row_sums(M * d.G), row_sums(V)), (M * d.c + c).entries()
        most = [largest([abs(at) + off]) for at, off in zip(middle, spread, strict=True)]
        few = Zonotope(arb_mat(M.nrows(), 1), V).reduced(OWN * M.nrows()).G
        return Command(M, c, few, most)


def band(layer: Layer, lo: arb, hi: arb) -> tuple[float, arb, arb]:
    """Slope, offset and radius of an affine band that holds an activation over [lo, hi], exact numbers.

    Of the slope any will do, and the secant's is taken; what is left, ``f(y) - slope y``, has its extremes at
    the ends, at kinks, and where ``f' = slope``. A place that may lie outside costs width, not soundness.
    """
    width = hi - lo
    slope = float(((value(layer, hi) - value(layer, lo)) / width).mid()) if width > 0 else 0.0
    slope = min(max(slope, 0.0), 1.0) if slope >= FLATTEST else 0.0
    places = [lo, hi, *(y for y in _turns(layer, slope) if not (y < lo or y > hi))]
    rests = [value(layer, y) - slope * y for y in places]
    low, high = smallest(rests), largest(rests)
    middle = ((low + high) / 2).mid()
    return slope, middle, largest((high - middle, middle - low))


def value(layer: Layer, y: arb) -> arb:
    """The activation at a number: an exact one, where it has kinks."""
    if layer.kind == "relu":
        return y if y >= 0 else layer.low * y
    if layer.kind == "clip":
        return arb(layer.low) if y <= layer.low else arb(layer.high) if y >= layer.high else y
    return y.tanh() if layer.kind == "tanh" else ((y / 2).tanh() + 1) / 2


def _turns(layer: Layer, slope: float) -> list[arb]:
    """Where ``f(y) - slope y`` may turn within."""
    if layer.kind == "relu":
        return [arb(0)]
    if layer.kind == "clip":
        return [arb(layer.low), arb(layer.high)]
    # tanh' = 1 - tanh^2; the sigmoid is (1 + tanh(y / 2)) / 2.
    stretch = 2 if layer.kind == "sigmoid" else 1
    steep = arb(slope) * stretch**2
    if not 0 < steep < 1:
        return []  # it only rises, or only falls
    y = (1 - steep).sqrt().atanh() * stretch
    return [y, -y]
