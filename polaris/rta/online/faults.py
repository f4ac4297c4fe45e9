"""What can go wrong in flight: families of faults."""

from __future__ import annotations

from typing import NamedTuple

FAMILIES = ("clock", "missed", "measurement", "estimate", "controller", "monitor", "log", "rule")
"""Where faults come from; ``rule``: no fault of its own, but S is kept (dwell, latch, re-acquisition)."""

HARMLESS = ("missed", "log")
"""Families that do not keep U from flying: what they tell of is over, and no premise of the proof."""


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

    @property
    def harmless(self) -> bool:
        """Whether U may fly all the same."""
        return self.family in HARMLESS


def largest(values: list[float]) -> float:
    """Largest magnitude in a list of floats; nan if one of them is, or their sum overflows."""
    if not values:
        return 0.0
    total = sum(values)
    if total - total != 0.0:  # only for nan and infinities
        return float("nan")
    return max(max(values), -min(values))
