"""Strengthening functions alpha of the barrier conditions (eq. 7): odd polynomials, given by numbers."""

from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from ...model.checks import one_of
from ...model.errors import ScenarioError
from ...model.keys import Key, NonNegative, Real, check_fields
from ...model.system import Array

Coefficients = Annotated[tuple[NonNegative, ...], Field(min_length=3, max_length=3)]


@dataclass(frozen=True)
class Strengthening:
    """One strengthening function, `c_1 s + c_2 |s| s + c_3 s^3` with `s = h - bias`.

    Where `s < 0`, outside or within the bias, the condition demands recovery: `recovery * alpha - push`.

    Parameters
    ----------
    coefficients : tuple of 3 floats
        c_1, c_2 and c_3.
    bias : float
        Margin to the boundary h = 0.
    recovery : float
        Factor where s < 0.
    push : float
        Least growth of h where s < 0.

    Raises
    ------
    ScenarioError
        If a number is out of range.
    """

    coefficients: Annotated[tuple[float, float, float], Key("coefficients", "1/s, ...", Coefficients)]
    bias: Annotated[float, Key("bias", "unit of h", NonNegative)] = 0.0
    recovery: Annotated[float, Key("recovery", "-", Annotated[Real, Field(ge=1, le=1e6)])] = 1.0
    push: Annotated[float, Key("push", "unit of h per second", NonNegative)] = 0.0

    def __post_init__(self) -> None:
        coefficients = self.coefficients
        check_fields(self)
        object.__setattr__(self, "coefficients", tuple(map(float, self.coefficients)))
        if not any(self.coefficients):
            raise ScenarioError("coefficients", coefficients, "must be three numbers >= 0, not all zero")

    def __call__(self, h: ArrayLike) -> Array:
        """The values alpha(h), same shape as h."""
        return evaluate(np.asarray(h, dtype=float), *np.array(self.numbers))

    @property
    def numbers(self) -> tuple[float, ...]:
        """c_1, c_2, c_3, bias, recovery, push."""
        return (*self.coefficients, self.bias, self.recovery, self.push)

    def reaches(self, rate: float) -> float:
        """The least h at which ``alpha(h) >= rate`` (rate > 0)."""
        c = self.coefficients
        roots = np.roots([c[2], c[1], c[0], -rate])
        real = roots[(np.abs(roots.imag) < 1e-9 * np.abs(roots)) & (roots.real > 0)].real
        return float(real.min()) * (1 + 1e-9) + self.bias


def evaluate(h: Array, *numbers: Array | float) -> Array:
    """Many strengthening functions at once; their `Strengthening.numbers` broadcast against h."""
    c1, c2, c3, bias, recovery, push = numbers
    s = h - bias
    size = np.abs(s)
    alpha = s * (c1 + size * (c2 + size * c3))
    outside = s < 0
    if outside.any():
        alpha = np.where(outside, recovery * alpha - push, alpha)
    return np.asarray(alpha)


_CUBIC = (0.01, 0.0, 0.001)
_FAR = Strengthening(_CUBIC, 0.0, 10.0, 0.01)
_AFRL = {
    "chief_separation": _FAR,
    "deputy_separation": _FAR,
    "speed": Strengthening((0.0, 0.0, 0.1), 2e-3, 10.0, 0.01),
    "sun": Strengthening((0.001, 0.0, 0.0001), 1e-3, 10.0, 0.01),
    "deputy_sun": Strengthening((0.0, 0.0, 0.1), 1e-3, 10.0, 0.01),
    "keep_in": replace(_FAR, bias=1e-3),
    "passive": _FAR,
    "deputy_passive": _FAR,
    "velocity": Strengthening((0.1, 0.0, 0.01), 1e-3, 10.0, 0.01),
}
FAMILIES = tuple(_AFRL)
PRESETS: dict[str, dict[str, Strengthening]] = {
    "afrl": _AFRL,
    "afrl-one": {**_AFRL, "speed": Strengthening((0.05, 0.0, 0.005), 1e-3, 10.0, 0.01)},
    "afrl-five": {**_AFRL, "keep_in": _FAR},
    "polaris": {**_AFRL, "velocity": Strengthening((0.5, 0.0, 0.01), 1e-3, 10.0, 0.01)},
    "linear": {family: Strengthening((0.3, 0.0, 0.0)) for family in FAMILIES},
}
"""Named sets of strengthening functions; the paper prints none.

``afrl-one`` and ``afrl-five``: those of its authors' library, in its code for one deputy and in that for
five, which differ in the speed limit and in the bias of the keep-in zone. ``afrl``: the speed of the one
for five, the bias of that for one. ``polaris``: as ``afrl`` with quicker velocity limits; those of ``afrl``
hold back thrust that other constraints need, at speeds far from the limit; for conditions that hold between
samples (`SampledData`) it is ``linear``, as functions that are flat near the boundary let the thrust chatter
then. ``linear``: ``0.3 h`` throughout.
"""


def preset(name: str, sampled: bool) -> dict[str, Strengthening]:
    """Return the functions of a named set, by family, for conditions between samples or at samples only."""
    one_of("strengthening", name, PRESETS)
    return dict(PRESETS["linear" if sampled and name == "polaris" else name])
