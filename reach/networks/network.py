"""Feed-forward networks as functions, and sound enclosures of their images of a zonotope."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from ..numerics.checks import Array, as_vector, checked, per_row, require_single
from ..numerics.errors import ReachError, Unresolved
from ..numerics.rounding import gamma
from ..sets.zonotope import Zonotope
from ..short_repr import short_repr
from .layers import Activation, Affine, Diagonal
from .precision import FORMATS, MORE, READ, Rounding

MOST_ENTRIES = 2**26  # most numbers in the generators of one enclosure: 512 MiB


@short_repr
@dataclass(frozen=True, eq=False)
class Network:
    """A chain of affine or elementwise layers and activations.

    Parameters
    ----------
    layers : sequence of Affine, Diagonal or Activation
        In the order in which they are applied.
    precision : {"real", "float32", "float64"}
        Arithmetic in which it is evaluated. Enclosures of "real" hold the values without rounding. Those of
        a floating-point format hold what any runtime computes in it: inputs rounded to it, IEEE 754 rounding
        to nearest, sums in any order, with or without fused multiply-add, and tanh and sigmoid to 8 unit
        roundoffs.

    Raises
    ------
    ReachError
        If there is no layer of weights, two of them do not fit together, or the precision is unknown.
    """

    layers: tuple[Affine | Diagonal | Activation, ...]
    precision: str = "real"

    def __post_init__(self) -> None:
        layers = self.layers if isinstance(self.layers, list | tuple) else ()
        if not all(isinstance(layer, Affine | Diagonal | Activation) for layer in layers):
            raise ReachError("layers must each be an Affine, a Diagonal or an Activation")
        object.__setattr__(self, "layers", tuple(layers))
        if not self._weighted:
            raise ReachError("a network needs at least one affine layer")
        for before, after in pairwise(self._weighted):
            if after.shape[1] != before.shape[0]:
                sizes = before.shape[0], after.shape[1]
                raise ReachError(f"a layer of {sizes[0]} outputs is followed by one of {sizes[1]} inputs")
        self.rounding  # noqa: B018  an unknown precision is refused here

    @cached_property
    def _weighted(self) -> list[Affine | Diagonal]:
        return [layer for layer in self.layers if not isinstance(layer, Activation)]

    @cached_property
    def rounding(self) -> Rounding | None:
        """Bounds on the rounding of its evaluation; None in real arithmetic."""
        return Rounding.from_precision(self.precision)

    @property
    def inputs(self) -> int:
        """Number of inputs."""
        return self._weighted[0].shape[1]

    @property
    def outputs(self) -> int:
        """Number of outputs."""
        return self._weighted[-1].shape[0]

    def __call__(self, x: ArrayLike) -> Array:
        """Outputs, shape (..., outputs), for inputs of shape (..., inputs), computed in the precision.

        Real arithmetic is computed in double precision.
        """
        y = as_vector(x, self.inputs).astype(FORMATS.get(self.precision, float), copy=False)
        with np.errstate(over="ignore" if self.rounding else "warn"):
            for layer in self.layers:
                y = layer(y)
        return np.asarray(y, dtype=float)

    def pullback(self, x: ArrayLike, weights: ArrayLike) -> Array:
        """Gradient of ``weights . network(x)`` by x, shape (..., inputs), for weights (..., outputs).

        By the chain rule, layer by layer from the output back; not enclosed, and at a kink one of several.
        """
        y, gradient = as_vector(x, self.inputs), as_vector(weights, self.outputs)
        layer_inputs = []
        for layer in self.layers:
            layer_inputs.append(y)
            y = layer(y)
        for layer, y in zip(self.layers[::-1], layer_inputs[::-1], strict=True):
            gradient = gradient * layer.slope(y) if isinstance(layer, Activation) else layer.back(gradient)
        return np.asarray(gradient)

    def steepest(self, M: Array) -> Array:
        """Bound the entries of its derivative times a matrix (inputs, k), shape (outputs, k).

        The part of the rounding that is proportional to a difference of inputs is included.
        """
        roundoff = self.rounding

        def grown(count: int) -> float:
            return 1.0 if roundoff is None else 1 + roundoff.relative(count)

        absolute = roundoff is not None  # before anything bends or rounds, products of signed weights hold
        M = np.abs(M) * grown(READ) if absolute else M
        for layer in self.layers:
            if isinstance(layer, Activation):
                M, absolute = np.abs(M) * layer.steepest * grown(2), True
            else:
                M = (layer.sizes(M) if absolute else layer.times(M)) * grown(layer.terms + MORE)
        return np.abs(M)

    @checked
    def enclose(self, inputs: Zonotope, error: ArrayLike = 0.0) -> Zonotope:
        """Enclose the outputs over a (single) set of inputs, each still tied to the input it belongs to.

        Every activation is replaced by an affine band over the range of its argument (zonotope
        propagation, Singh et al. 2018). The first generators correspond to those of the set of inputs, one to
        one: for ``x = c + G a`` the output is ``c' + G'[:, :g] a + G'[:, g:] b``, all ``|b_i| <= 1``. The
        rounding of this enclosure and, in a floating-point precision, that of the network are added.

        Parameters
        ----------
        inputs : Zonotope
            Of dimension `inputs`.
        error : array_like, shape (inputs,)
            Largest error of every input beside that, elementwise.

        Raises
        ------
        ReachError
            If the dimension does not fit.
        Unresolved
            If the numbers lead beyond floating point, or there would be too many of them.
        """
        require_single("a set of inputs", inputs)
        if inputs.dim != self.inputs:
            raise ReachError(f"the network has {self.inputs} inputs, the set has dimension {inputs.dim}")
        c, G, roundoff = inputs.c, inputs.G, self.rounding
        errors = np.abs(per_row("error", error, inputs.dim))
        if roundoff is not None:
            errors = errors + roundoff.read(np.abs(c) + np.abs(G).sum(axis=1) + errors)
        for layer in self.layers:
            extent = np.abs(c) + np.abs(G).sum(axis=1)
            if isinstance(layer, Activation):
                entries = len(c) * (G.shape[1] + len(c))
                if entries > MOST_ENTRIES:
                    detail = f"its enclosure has {entries:,} numbers, more than {MOST_ENTRIES:,}"
                    raise Unresolved(f"the network is too wide or too deep: {detail}")
                spread = (extent - np.abs(c)) * (1 + gamma(G.shape[1])) + errors
                lo, hi = c - spread, c + spread
                slope, offset, radius = layer.band(lo, hi)
                # An interval's ends round as well; where the band is exact they do not matter.
                radius = radius + slope * errors
                errors = gamma(2) * (slope * extent + np.abs(offset))
                if roundoff is not None:
                    errors = errors + roundoff.bent(layer, np.maximum(np.abs(layer(lo)), np.abs(layer(hi))))
                c, G = slope * c + offset, np.hstack([slope[:, None] * G, np.diag(radius)])
            else:
                rounding, size = gamma(layer.terms), layer.sizes(extent) + np.abs(layer.b)
                sum_error = 0.0 if roundoff is None else roundoff.summed(layer, extent + errors)
                errors = (layer.sizes(errors) + rounding * size) * (1 + rounding) + sum_error
                c, G = layer(c), layer.times(G)
        return Zonotope(c, np.hstack([G, np.diag(errors * (1 + gamma(len(errors))))]))
