"""Feed-forward networks as functions, and sound enclosures of what they make of a zonotope.

An activation is held by an affine band, ``|f(y) - (slope y + offset)| <= radius`` for every y in [lo, hi]. It
may have any slope; that of the secant is taken, and what is left, ``f(y) - slope y``, has its extremes at the
ends of the interval, at kinks, and where ``f' = slope``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from ..brief import brief
from ..numerics.checks import Array, as_vector, check_fields, checked, finite_fields, per_row, require_single
from ..numerics.errors import ReachError
from ..numerics.rounding import gamma
from ..sets.zonotope import Zonotope

SLACK = 16 * float(np.finfo(float).eps)  # relative rounding booked on the values a band is made from


@dataclass(frozen=True)
class Activation:
    """A scalar function, applied to every component: never decreasing, of slope at most 1.

    Parameters
    ----------
    kind : {"relu", "tanh", "sigmoid", "clip"}
        ``relu`` lets a share `low` of what is negative through (0 for the plain one), ``clip`` limits to
        [low, high].
    low, high : float

    Raises
    ------
    ReachError
        If the kind is unknown, a number not finite, or the function would decrease.
    """

    kind: str
    low: float = 0.0
    high: float = 0.0

    def __post_init__(self) -> None:
        check_fields(self)
        if self.kind not in _FUNCTIONS:
            raise ReachError(f"an activation must be one of {', '.join(_FUNCTIONS)}, got {self.kind!r}")
        if not (np.isfinite(self.low) and np.isfinite(self.high)):
            raise ReachError(f"{self.kind} needs finite numbers, got {self.low!r} and {self.high!r}")
        if self.kind == "relu" and not 0 <= self.low <= 1:
            raise ReachError(f"the slope of a leaky relu must lie in [0, 1], got {self.low!r}")
        if self.kind == "clip" and not self.low <= self.high:
            raise ReachError(f"a clip needs low <= high, got {self.low!r} and {self.high!r}")

    def __call__(self, y: Array) -> Array:
        """Values, shape of y."""
        return _FUNCTIONS[self.kind](self, np.asarray(y))

    def slope(self, y: Array) -> Array:
        """Derivative at y; at a kink one of the two."""
        if self.kind == "relu":
            return np.where(y < 0, self.low, 1.0)
        if self.kind == "clip":
            return np.where((y < self.low) | (y > self.high), 0.0, 1.0)
        value = self(y)
        return np.asarray(1 - value**2 if self.kind == "tanh" else value * (1 - value))

    def band(self, lo: Array, hi: Array) -> tuple[Array, Array, Array]:
        """Slope, offset and radius of a band over [lo, hi], elementwise; exact where f is affine there.

        Parameters
        ----------
        lo, hi : ndarray
            Of one shape, ``lo <= hi``.
        """
        top, bottom, width = self(hi), self(lo), hi - lo
        slope = np.divide(top - bottom, width, out=np.zeros_like(width), where=width > 0)
        slope = np.clip(slope, 0.0, 1.0)
        places = np.stack([lo, hi, *(np.clip(y, lo, hi) for y in self._turns(slope))])
        rest = self(places) - slope * places
        most, least = rest.max(axis=0), rest.min(axis=0)
        scale = np.maximum(np.abs(top), np.abs(bottom)) + np.maximum(np.abs(lo), np.abs(hi))
        return slope, (most + least) / 2, (most - least) / 2 + SLACK * scale

    def _turns(self, slope: Array) -> list[Array | float]:
        """Where ``f(y) - slope y`` may turn: kinks, and where f has that slope."""
        if self.kind == "relu":
            return [0.0]
        if self.kind == "clip":
            return [self.low, self.high]
        # 1 / cosh(y)^2 = slope for tanh; the sigmoid is (1 + tanh(y / 2)) / 2, and its slope at most 1/4.
        stretch = 2.0 if self.kind == "sigmoid" else 1.0
        y = stretch * np.arccosh(1 / np.sqrt(np.clip(slope * stretch**2, 1e-300, 1.0)))
        return [y, -y]


_FUNCTIONS: dict[str, Callable[[Activation, Array], Array]] = {
    "relu": lambda f, y: np.where(y < 0, f.low * y, y),
    "tanh": lambda _, y: np.tanh(y),
    "sigmoid": lambda _, y: np.asarray(0.5 + 0.5 * np.tanh(0.5 * y)),
    "clip": lambda f, y: np.clip(y, f.low, f.high),
}


@brief
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


@brief
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
