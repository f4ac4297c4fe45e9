"""Constraint as filters and judges use it: phi, the barrier h that keeps it, and their derivatives."""

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ...model.checks import of_kind, whole
from ...model.errors import ScenarioError
from ...model.system import Array
from .motion import MotionBound
from .strengthening import PRESETS, Strengthening


class ConstraintKind(NamedTuple):
    """One of the paper's constraints phi1 to phi11 (eqs. 12 to 23): see `Constraint`."""

    family: str
    rank: int
    pair: bool
    meaning: str
    unit: str


KINDS = {
    "phi1": ConstraintKind("chief_separation", 0, False, "separation from the chief", "m"),
    "phi2": ConstraintKind("deputy_separation", 0, True, "separation of deputies", "m"),
    "phi3": ConstraintKind("speed", 2, False, "dynamic speed limit", "m/s"),
    "phi4": ConstraintKind("sun", 4, False, "sun keep-out, towards the chief", "rad"),
    "phi5": ConstraintKind("deputy_sun", 4, True, "sun keep-out, towards a deputy", "rad"),
    "phi6": ConstraintKind("keep_in", 3, False, "keep-in zone", "m"),
    "phi7": ConstraintKind("passive", 1, False, "free flight past the chief", "m"),
    "phi8": ConstraintKind("deputy_passive", 1, True, "free flight of deputies", "m"),
    "phi9": ConstraintKind("velocity", 2, False, "velocity limit, radial", "m^2/s^2"),
    "phi10": ConstraintKind("velocity", 2, False, "velocity limit, along-track", "m^2/s^2"),
    "phi11": ConstraintKind("velocity", 2, False, "velocity limit, cross-track", "m^2/s^2"),
}
CONSTRAINTS = tuple(KINDS)
RESERVED = {kind.family for kind in KINDS.values()} | {"thrust", "h5+", "h5-", *KINDS}
RESERVED |= {name.replace("phi", "h") for name in KINDS}
LAST = 99  # the largest rank
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
        If no input satisfies all conditions, the lower rank gives way later: 0 separations, 1 free
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

    def curvature(self, z: Array, sun: ArrayLike, motion: MotionBound) -> Array:
        """Bound M on ``-d^2 h / dt^2``; ``-inf`` where h cannot become negative within the period."""
        raise TypeError(f"no bound for {type(self).__name__}")

    def check(self) -> None:
        """Refuse attributes of another kind, and functions that do not evaluate states one by one."""
        key_path = f"constraints.{self.label}"
        for name, kind in (("label", str), ("family", str), ("pair", bool), ("alpha", Strengthening)):
            of_kind(f"{key_path}.{name}", getattr(self, name), kind)
        if whole(f"{key_path}.rank", self.rank, 0) > LAST:
            raise ScenarioError(f"{key_path}.rank", self.rank, f"must be at most {LAST}")
        for word in (self.label, self.family or self.label):
            if not word or word in RESERVED or "[" in word or not word.isprintable():
                rule = "must have labels, each different, and families: not the paper's, without brackets"
                raise ScenarioError("constraints", word, rule)
        z = np.linspace([[1.0]], [[300.0]], 36).reshape(2, 3, 6) * np.repeat([1.0, 1e-3], 3)
        z.flags.writeable = False
        for form in dict.fromkeys((self, self.sampled())):
            try:
                batch, one = _evaluated(form, z), _evaluated(form, z[1:, 2:])
                equal = all(np.allclose(batch[k][1:, -form.repeat :], one[k], equal_nan=True) for k in batch)
            except Exception as error:
                rule = "must evaluate states of shape (2, 3, 6) in arrays of numbers"
                raise ScenarioError(key_path, f"{type(error).__name__}: {error}", rule) from error
            if not equal:
                raise ScenarioError(key_path, type(form).__name__, "must evaluate each state separately")


def _evaluated(form: Constraint, z: Array) -> dict[str, Array]:
    """Evaluate a constraint at states (R, K, 6), and raise ValueError if a shape or a type is wrong."""
    sun, count = np.ones((len(z), 1)), (len(z), z.shape[1] * form.repeat)
    h, gradient, change = form(z, sun)
    out = {"value": form.value(z, sun), "h": h, "gradient": np.broadcast_to(gradient, (*count, 6))}
    out["change"] = np.broadcast_to(change, count)
    if type(form).curvature is not Constraint.curvature:
        motion = MotionBound(1.0, *np.full((5, *z.shape[:2]), 0.1))
        out["curvature"] = np.broadcast_to(form.curvature(z, sun, motion), count)
    for name, values in out.items():
        shape = {"value": z.shape[:2], "h": count}.get(name, np.shape(values))
        if np.shape(values) != shape or np.asarray(values).dtype.kind not in "fi":
            raise ValueError(f"{name} has shape {np.shape(values)} and type {np.asarray(values).dtype}")
    return out


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
