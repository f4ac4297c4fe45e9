"""Feed-forward networks as functions, and sound enclosures of what they make of a zonotope."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from ..numerics.checks import Array, as_vector, checked, finite_fields, per_row, require_single
from ..numerics.errors import ReachError
from ..numerics.rounding import gamma
from ..sets.zonotope import Zonotope
from .bands import Activation


@dataclass(frozen=True, eq=False)
class Affine:
    """A layer ``W x + b``.

    Parameters
    ----------
    W : array_like, shape (m, n)
    b : array_like, shape (m,)

    Raises
    ------
    ReachError
        If the shapes do not fit or a weight is not finite.
    """

    W: Array
    b: Array

    def __post_init__(self) -> None:
        W, b = finite_fields(self, "W", "b")
        if W.ndim != 2 or 0 in W.shape or b.shape != W.shape[:1]:
            raise ReachError(f"a layer needs weights (m, n) and biases (m,), got {W.shape} and {b.shape}")

    def __call__(self, x: Array) -> Array:
        """Values for inputs of shape (..., n)."""
        return np.asarray(x @ self.W.T + self.b)


@dataclass(frozen=True, eq=False)
class Network:
    """A chain of affine layers and activations.

    Parameters
    ----------
    layers : sequence of Affine or Activation
        In the order in which they are applied.

    Raises
    ------
    ReachError
        If there is no affine layer, or two of them do not fit together.
    """

    layers: tuple[Affine | Activation, ...]

    def __post_init__(self) -> None:
        layers = self.layers if isinstance(self.layers, list | tuple) else ()
        if not all(isinstance(layer, Affine | Activation) for layer in layers):
            raise ReachError("layers must each be an Affine or an Activation")
        object.__setattr__(self, "layers", tuple(layers))
        if not self._affine:
            raise ReachError("a network needs at least one affine layer")
        for before, after in zip(self._affine, self._affine[1:], strict=False):
            if after.W.shape[1] != before.W.shape[0]:
                sizes = before.W.shape[0], after.W.shape[1]
                raise ReachError(f"a layer of {sizes[0]} outputs is followed by one of {sizes[1]} inputs")

    @cached_property
    def _affine(self) -> list[Affine]:
        return [layer for layer in self.layers if isinstance(layer, Affine)]

    @property
    def inputs(self) -> int:
        """Number of inputs."""
        return int(self._affine[0].W.shape[1])

    @property
    def outputs(self) -> int:
        """Number of outputs."""
        return int(self._affine[-1].W.shape[0])

    def __call__(self, x: ArrayLike) -> Array:
        """Outputs, shape (..., outputs), for inputs of shape (..., inputs)."""
        y = as_vector(x, self.inputs)
        for layer in self.layers:
            y = layer(y)
        return np.asarray(y)

    def pullback(self, x: ArrayLike, weights: ArrayLike) -> Array:
        """Gradient of ``weights . network(x)`` by x, shape (..., inputs), for weights (..., outputs).

        By the chain rule, layer by layer from the output back; not enclosed, and at a kink one of several.
        """
        y, back = as_vector(x, self.inputs), as_vector(weights, self.outputs)
        before = []
        for layer in self.layers:
            before.append(y)
            y = layer(y)
        for layer, y in zip(self.layers[::-1], before[::-1], strict=True):
            back = back @ layer.W if isinstance(layer, Affine) else back * layer.slope(y)
        return np.asarray(back)

    @checked
    def enclose(self, inputs: Zonotope, error: ArrayLike = 0.0) -> Zonotope:
        """Enclose the outputs over a (single) set of inputs, each still tied to the input it belongs to.

        Every activation is replaced by an affine band over the range of its argument (zonotope
        propagation, Singh et al. 2018). The first generators correspond to those of the set of inputs, one to
        one: for ``x = c + G a`` the output is ``c' + G'[:, :g] a + G'[:, g:] b``, all ``|b_i| <= 1``. What
        rounding may do is booked.

        Parameters
        ----------
        inputs : Zonotope
            Of dimension `inputs`.
        error : array_like, shape (inputs,)
            What every input may be off by, elementwise, beside that.

        Raises
        ------
        ReachError
            If the dimension does not fit.
        Unresolved
            If the numbers lead beyond floating point.
        """
        require_single("a set of inputs", inputs)
        if inputs.dim != self.inputs:
            raise ReachError(f"the network has {self.inputs} inputs, the set has dimension {inputs.dim}")
        c, G = inputs.c, inputs.G
        off = np.abs(per_row("error", error, inputs.dim))
        for layer in self.layers:
            extent = np.abs(c) + np.abs(G).sum(axis=1)
            if isinstance(layer, Affine):
                size = np.abs(layer.W)
                rounding = gamma(len(c))
                off = (size @ off + rounding * (size @ extent + np.abs(layer.b))) * (1 + rounding)
                c, G = layer(c), layer.W @ G
            else:
                spread = (extent - np.abs(c)) * (1 + gamma(G.shape[1])) + off
                slope, offset, radius = layer.band(c - spread, c + spread)
                # An interval's ends round as well; where the band is exact they do not matter.
                radius = radius + slope * off
                off = gamma(2) * (slope * extent + np.abs(offset))
                c, G = slope * c + offset, np.hstack([slope[:, None] * G, np.diag(radius)])
        return Zonotope(c, np.hstack([G, np.diag(off * (1 + gamma(len(off))))]))
