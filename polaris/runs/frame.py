"""Which coordinates a figure shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..model.system import Array, LinearSystem


@dataclass(frozen=True)
class Frame:
    """Which coordinates a figure shows, and what they are called.

    Attributes
    ----------
    axes : tuple of int
        Position coordinates, horizontal one first. In Hill's frame along-track is drawn to the
        right and radial (outward) upward, neither reversed; the third is cross-track.
    labels : tuple of str
        Axis labels with units, in the same order.
    """

    axes: tuple[int, ...]
    labels: tuple[str, ...]

    @classmethod
    def of(cls, system: LinearSystem) -> Frame:
        """Frame of a system: Hill's, or plain position coordinates."""
        if system.mean_motion is not None and system.d == 3:
            names = ("Along-track (m)", "Radial (m)", "Cross-track (m)")
            return cls((1, 0, 2), names)
        letters = "xyz"
        return cls(tuple(range(system.d)), tuple(f"Position {letters[i]} (m)" for i in range(system.d)))

    @property
    def flat(self) -> list[int]:
        """The two coordinates (or the one) of a plane view."""
        return list(self.axes[:2])


def directions(count: int = 32) -> Array:
    """Unit vectors all round, shape (count, 2)."""
    angle = 2 * np.pi * np.arange(count) / count
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)
