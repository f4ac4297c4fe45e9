"""Constraint as filters and judges use it: phi, the barrier h that keeps it, and their derivatives."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ...model.system import Array
from .motion import Motion
from .strengthening import PRESETS, Strengthening


class Kind(NamedTuple):
    """One of the paper's constraints phi1 to phi11 (eqs. 12 to 23): see `Constraint`."""

    family: str
    rank: int
    pair: bool
    meaning: str
    unit: str


KINDS = {
    "phi1": Kind("chief_separation", 0, False, "separation from the chief", "m"),
    "phi2": Kind("deputy_separation", 0, True, "separation of deputies", "m"),
    "phi3": Kind("speed", 2, False, "dynamic speed limit", "m/s"),
    "phi4": Kind("sun", 4, False, "sun keep-out, towards the chief", "rad"),
    "phi5": Kind("deputy_sun", 4, True, "sun keep-out, towards a deputy", "rad"),
    "phi6": Kind("keep_in", 3, False, "keep-in zone", "m"),
    "phi7": Kind("passive", 1, False, "free flight past the chief", "m"),
    "phi8": Kind("deputy_passive", 1, True, "free flight of deputies", "m"),
    "phi9": Kind("velocity", 2, False, "velocity limit, radial", "m^2/s^2"),
    "phi10": Kind("velocity", 2, False, "velocity limit, along-track", "m^2/s^2"),
    "phi11": Kind("velocity", 2, False, "velocity limit, cross-track", "m^2/s^2"),
}
CONSTRAINTS = tuple(KINDS)
PASSIVE = {"phi7": "passive", "phi8": "deputy_passive"}
"""The constraints on free flights: they are their own barriers, and no part of what a backup must keep."""


class Evaluation(NamedTuple):
    """A barrier, or the constraint that it keeps, at some states (..., 6).

    Its value (...), >= 0 inside; the gradient (..., 6) by the state; the partial derivative with respect to
    time [1/s], (...) or a number.
    """

    h: Array
    gradient: Array
    change: Array | float


class Constraint(ABC):
    """A constraint ``phi(t, z) >= 0`` and a control-invariant ``h(t, z) >= 0`` that keeps it.

    It holds for every deputy, z its state, or for every pair, z the state of the first relative to the
    second; shape (..., 6) in Hill's frame. A subclass of one's own gives a label, `value`, `__call__`, and
    `curvature` where conditions are to hold between samples; `Inspection` takes its instances.

    Attributes
    ----------
    label, meaning, unit : str
        Its name, its meaning in words, and the unit of phi.
    family : str
        Its name in tables of strengthening functions and of what is left out; default its label.
    rank : int
        Where no input satisfies all conditions, the lower rank gives way later: 0 separations, 1 free
        flights, 2 speeds, 3 the zone, 4 the sun.
    pair : bool
        True if it is about pairs of deputies.
    alpha : Strengthening
        Used where a table of strengthening functions has none for it; default ``0.3 h``.
    """

    label: str = ""
    meaning: str = ""
    unit: str = "-"
    family: str = ""
    rank: int = 2
    pair: bool = False
    alpha: Strengthening = PRESETS["linear"]["speed"]

    @property
    def row(self) -> str:
        """Name of its rows."""
        return self.label

    @property
    def repeat(self) -> int:
        """Rows per state."""
        return 1

    def sampled(self) -> "Constraint":
        """Return the form whose curvature is bounded."""
        return self

    @abstractmethod
    def value(self, z: Array, sun: ArrayLike = 0.0) -> Array:
        """Return phi (...) at states (..., 6) and sun angles [rad] that broadcast against (...)."""

    @abstractmethod
    def __call__(self, z: Array, sun: ArrayLike = 0.0) -> Evaluation:
        """Evaluate h at states of shape (..., 6) and sun angles [rad] that broadcast against (...)."""

    def curvature(self, z: Array, sun: ArrayLike, motion: Motion) -> Array:
        """Bound M on ``-d^2 h / dt^2``; ``-inf`` where h cannot become negative within the period."""
        raise TypeError(f"no bound for {type(self).__name__}")


@dataclass(frozen=True, eq=False)
class Printed(Constraint):
    """One of the paper's constraints; its label says which.

    Those of one formula are evaluated together: their `COLUMNS` then have a value for each row.
    """

    COLUMNS: ClassVar[tuple[str, ...]] = ()
    label: str = field(default="", kw_only=True)

    def __post_init__(self) -> None:
        for name, value in KINDS[self.label]._asdict().items() if self.label else ():
            object.__setattr__(self, name, value)

    @property
    def row(self) -> str:
        """Name of its rows: that of its barrier."""
        return self.label.replace("phi", "h")


def join(by_position: Array, by_velocity: Array) -> Array:
    """A gradient from its halves, (..., 3) each."""
    return np.concatenate([by_position, by_velocity], axis=-1)
