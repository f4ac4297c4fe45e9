"""What can go wrong in flight: families of faults, and the checks of single values that arrive."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..system import Array

FAMILIES = ("clock", "measurement", "estimate", "controller", "monitor", "log", "rule")
"""Where faults come from; ``rule``: no fault of its own, but S is kept (dwell, latch, re-acquisition)."""


class Fault(NamedTuple):
    """One fault.

    Attributes
    ----------
    family : str
        One of `FAMILIES`.
    text : str
        What it was; begins with the same words for the same kind of fault.
    """

    family: str
    text: str

    def __str__(self) -> str:
        return f"{self.family}: {self.text}"


def real(value: object) -> float | None:
    """A number as a float, nan and infinities included; None for anything else."""
    if type(value) is float:
        return value
    if isinstance(value, np.ndarray) and value.ndim == 0:
        value = value[()]
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, float, np.integer, np.floating)):
        return None
    try:
        return float(value)
    except OverflowError:
        return None


def numbers(value: object, shape: tuple[int, ...]) -> Array | None:
    """Real numbers of one shape as an array of floats, nan included; None for anything else."""
    if type(value) is not np.ndarray or value.dtype != np.float64:
        try:
            value = np.asarray(value)
            if value.dtype.kind not in "iuf":
                return None
            value = value.astype(float)
        except (TypeError, ValueError, OverflowError):
            return None
    return value if value.shape == shape else None


def largest(values: list[float]) -> float:
    """Largest magnitude in a list of floats; nan if one of them is, or their sum overflows."""
    if not values:
        return 0.0
    total = sum(values)
    if total - total != 0.0:  # only for nan and infinities
        return float("nan")
    return max(max(values), -min(values))
