"""Neural networks over sets of states, in ball arithmetic: each activation within an affine band.

Of a network that is evaluated in floating point each layer adds a box for its rounding: sums in any order,
with or without fused multiply-add, are off by at most ``gamma_k (|W| |x| + |b|)`` (theory, Theorem 10).
"""

from dataclasses import dataclass
from functools import cached_property
from operator import mul

from flint import arb, arb_mat

from ..files.entries import Law, Layer
from ..kernel.arcs import Arc
from ..kernel.balls import (
    above,
    absolute,
    beside,
    column,
    diagonal,
    identity,
    largest,
    matrix,
    row_sums,
    scaled,
    smallest,
    sums,
)
from ..kernel.motion import Plant
from ..kernel.verdict import Rejected
from ..kernel.zonotopes import Zonotope
from .obstacle_boxes import ObstacleBoxes

FLATTEST = 1e-30  # slopes of bands below it are taken for 0
OWN = 3  # generators per input that stand for what all bands of a network leave open
FORMATS = {"float32": (24, 126), "float64": (53, 1022)}
"""Digits, and the exponent of the least normal number, negative."""
FOLDED = 8  # roundings of a term beside additions: of weight and product, and of factors that a runtime folds
CURVED = 8  # error of tanh and sigmoid in unit roundoffs


@dataclass(frozen=True, eq=False)
class CommandBound:
    """``u = K d + c + V v`` with every ``|v_i| <= 1``, and bounds on ``|u|``."""

    K: arb_mat
    c: arb_mat
    V: arb_mat
    size: list[arb]


@dataclass(frozen=True)
class Rounding:
    """Bounds on rounding to nearest in one floating-point format, with gradual underflow or without."""

    u: arb  # unit roundoff
    tiny: arb  # least normal number
    top: arb  # size up to which neither a number nor its inverse leaves the normal ones

    @classmethod
    def from_precision(cls, precision: str) -> "Rounding | None":
        """Return the bounds of a precision; None for real arithmetic."""
        if precision == "real":
            return None
        digits, small = FORMATS[precision]
        return cls(arb(2) ** -digits, arb(2) ** -small, arb(2) ** small)

    def relative(self, count: int) -> arb:
        """Relative error of so many roundings in a row."""
        return count * self.u / (1 - count * self.u)

    def read(self, size: list[arb]) -> list[arb]:
        """Rounding of inputs up to a size: of the number, of its scale and of the product."""
        self.require_finite(size)
        return [self.relative(3) * x + 2 * self.tiny for x in size]

    def summed(self, size: list[arb], weights: list[arb], inputs: list[arb], terms: int) -> list[arb]:
        """Rounding of sums, given those of their absolute terms, of absolute weights, and absolute inputs."""
        relative, all_inputs = self.relative(terms + FOLDED), sum(inputs, arb(0))
        self.require_finite([*weights, *(x * (1 + relative) for x in size)])
        underflow = [2 * self.tiny * (2 * terms + 2 + w + all_inputs) for w in weights]
        return [relative * x + extra for x, extra in zip(size, underflow, strict=True)]

    def bent(self, layer: Layer, values: list[arb]) -> list[arb]:
        """Rounding of an activation with values up to some sizes."""
        self.require_finite(values)
        curved = CURVED * self.u if layer.kind in ("tanh", "sigmoid") else arb(0)
        return [self.relative(2) * x + curved + 2 * self.tiny * (1 + layer.steepest) for x in values]

    def require_finite(self, size: list[arb]) -> None:
        """Refuse numbers of sizes that may be infinite once they are rounded."""
        if not all(x <= self.top for x in size):
            raise Rejected("controllers", "a number in a network may overflow in its floating-point format")


@dataclass(frozen=True, eq=False)
class Policy:
    """A network as a function of the state relative to the reference that it reads."""

    law: Law
    plant: Plant
    obstacles: ObstacleBoxes

    @cached_property
    def reads(self) -> arb_mat:
        """Return the derivative of its inputs by the state relative to its reference, shape (r, n)."""
        n, m = self.plant.A.nrows(), self.plant.B.ncols()
        blocks = {"error": -identity(n), "state": identity(n)}
        blocks |= {"time": arb_mat(1, n), "reference_input": arb_mat(m, n)}
        blocks |= {name: self.obstacles.less(name, identity(n)) for name in self.law.reads if ":" in name}
        return diagonal(self.law.input_scale) * above(*(blocks[name] for name in self.law.reads))

    @cached_property
    def rounding(self) -> Rounding | None:
        """Bounds on the rounding of its evaluation; None in real arithmetic."""
        return Rounding.from_precision(self.law.precision)

    @cached_property
    def layers(self) -> list["Weights | Layer"]:
        """Weights and biases, or activations, the thrust limits last."""
        layers, width = list["Weights | Layer"](), len(self.law.input_scale)
        for layer in self.law.layers:
            if layer.kind == "affine":
                layers.append(Weights(matrix(layer.W), column(layer.b)))
                width = len(layer.W)
            elif layer.kind == "diagonal":
                scale, b = (x * width if len(x) == 1 else x for x in (layer.scale, layer.b))
                layers.append(Weights(list(map(arb, scale)), column(b)))
            else:
                layers.append(layer)
        none, tops = arb_mat(len(self.plant.u_max), 1), self.plant.u_max
        into = [arb(x) / top for x, top in zip(self.law.output_scale, tops, strict=True)]
        return [*layers, Weights(into, none), Layer("clip", low=-1.0, high=1.0), Weights(list(tops), none)]

    def reference_input(self, base: Arc, k: int, i: int) -> tuple[arb_mat, arb_mat]:
        """Return the network's scaled inputs on its reference at node i of step k, and their generators."""
        n = self.plant.A.nrows()
        time = self.plant.h * self.plant.q * k
        parts = {"error": arb_mat(n, 1), "state": base.nodes[i], "time": column([time])}
        parts["reference_input"] = base.u
        spread = {name: arb_mat(part.nrows(), self.obstacles.width) for name, part in parts.items()}
        for name in (name for name in self.law.reads if ":" in name):
            middle, spread[name] = self.obstacles.at_node(name, k * self.plant.q + i)
            parts[name] = middle + self.obstacles.less(name, base.nodes[i])
        scale = diagonal(self.law.input_scale)
        c, V = (scale * above(*(table[name] for name in self.law.reads)) for table in (parts, spread))
        return c, V

    def command(self, d: Zonotope, inputs: arb_mat, generators: arb_mat) -> CommandBound:
        """Enclose the command over a set of estimated states relative to the reference."""
        M, c, V = self.reads, inputs, generators
        model, exact = self.rounding, self.layers[-1]
        error = [] if model is None else model.read(extent(M, c, V, d))
        for layer in self.layers:
            if isinstance(layer, Weights):
                image = error
                if model is not None:
                    size = sums(extent(M, c, V, d), error)
                    image = layer.sizes(error)
                    image = image if layer is exact else sums(image, layer.rounding(model, size))
                M, c, V, error = layer.times(M), layer.times(c) + layer.b, layer.times(V), image
                continue
            spread = sums(row_sums(M * d.G), row_sums(V))
            spread = sums(spread, error) if error else spread
            middle = (M * d.c + c).entries()
            ends = [((at - x).lower(), (at + x).upper()) for at, x in zip(middle, spread, strict=True)]
            slopes, offsets, radii = zip(*(band(layer, lo, hi) for lo, hi in ends), strict=True)
            open_ = list(radii)
            if model is not None:
                open_ = sums(radii, map(mul, slopes, error))
                error = model.bent(layer, [largest((-value(layer, lo), value(layer, hi))) for lo, hi in ends])
            M, c = scaled(slopes, M), scaled(slopes, c) + column(offsets)
            V = beside(scaled(slopes, V), diagonal(open_))
        V = beside(V, diagonal(error)) if error else V
        spread, middle = sums(row_sums(M * d.G), row_sums(V)), (M * d.c + c).entries()
        bounds = [largest([abs(at) + x]) for at, x in zip(middle, spread, strict=True)]
        reduced = Zonotope(arb_mat(M.nrows(), 1), V).reduced(OWN * M.nrows()).G
        return CommandBound(M, c, reduced, bounds)


@dataclass(frozen=True, eq=False)
class Weights:
    """A layer ``W x + b``; the entries of W if it is diagonal."""

    W: arb_mat | list[arb]
    b: arb_mat

    @property
    def terms(self) -> int:
        """Number of products summed in one output."""
        return self.W.ncols() if isinstance(self.W, arb_mat) else 1

    @cached_property
    def size(self) -> "Weights":
        """Absolute values."""
        sizes = absolute(self.W) if isinstance(self.W, arb_mat) else list(map(abs, self.W))
        return Weights(sizes, absolute(self.b))

    def times(self, M: arb_mat) -> arb_mat:
        """Product of the weights and a matrix."""
        return self.W * M if isinstance(self.W, arb_mat) else scaled(self.W, M)

    def sizes(self, x: list[arb]) -> list[arb]:
        """Product of the absolute weights and a vector."""
        return list(self.size.times(column(x)).entries())

    def rounding(self, model: Rounding, x: list[arb]) -> list[arb]:
        """Rounding of this layer for inputs up to some sizes."""
        size = sums(self.sizes(x), self.size.b.entries())
        return model.summed(size, self.sizes([arb(1)] * len(x)), x, self.terms)


def extent(M: arb_mat, c: arb_mat, V: arb_mat, d: Zonotope) -> list[arb]:
    """Bounds on the absolute values of ``M d + c + V v``."""
    return sums(map(abs, (M * d.c + c).entries()), row_sums(M * d.G), row_sums(V))


def band(layer: Layer, lo: arb, hi: arb) -> tuple[float, arb, arb]:
    """Slope, offset and radius of an affine band that holds an activation over [lo, hi], exact numbers.

    Of the slope any will do, and the secant's is taken; what is left, ``f(y) - slope y``, has its extremes at
    the ends, at kinks, and where ``f' = slope``. A place that may lie outside costs width, not soundness.
    """
    width = hi - lo
    slope = float(((value(layer, hi) - value(layer, lo)) / width).mid()) if width > 0 else 0.0
    slope = min(max(slope, 0.0), layer.steepest) if slope >= FLATTEST else 0.0
    places = [lo, hi, *(y for y in _turns(layer, slope) if not (y < lo or y > hi))]
    rests = [value(layer, y) - slope * y for y in places]
    low, high = smallest(rests), largest(rests)
    middle = ((low + high) / 2).mid()
    return slope, middle, largest((high - middle, middle - low))


def value(layer: Layer, y: arb) -> arb:
    """Return the activation at a number: an exact one, where it has kinks."""
    if layer.kind == "relu":
        return y if y >= 0 else layer.low * y
    if layer.kind == "clip":
        return arb(layer.low) if y <= layer.low else arb(layer.high) if y >= layer.high else y
    return y.tanh() if layer.kind == "tanh" else ((y / 2).tanh() + 1) / 2


def _turns(layer: Layer, slope: float) -> list[arb]:
    """Return enclosures of the points at which ``f(y) - slope y`` may turn."""
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
