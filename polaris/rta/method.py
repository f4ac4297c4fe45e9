"""The one protocol of all run-time assurance methods, and what they answer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..model.system import Array
from .scene import Scene

FILTERED = -1
"""Mode of a period in which neither S nor U flies but an input that a filter has chosen."""


@dataclass(frozen=True, eq=False)
class Seen:
    """What a method is told at one decision; R runs are decided at once.

    Attributes
    ----------
    k : int
        Number of the decision; it is made at ``k`` periods.
    estimate : ndarray, shape (R, n)
        Absolute states as measured.
    desired : ndarray, shape (R, m)
        Input that the preferred experimental controller wants, clipped to the limits [N].
    mode : ndarray of int, shape (R,)
        What flew in the period before: 0 is S, 1, 2, ... U, `FILTERED`.
    """

    k: int
    estimate: Array
    desired: Array
    mode: NDArray[np.int_]


@dataclass(frozen=True, eq=False)
class Choice:
    """What flies until the next decision takes effect.

    Attributes
    ----------
    mode : ndarray of int, shape (R,)
        0 is S, 1, 2, ... an experimental controller, `FILTERED` the input given here.
    margin : ndarray, shape (R,)
        What the method decided by, in its own measure: negative where it refused; nan if it has none.
    why : ndarray of int, shape (R,)
        Reason, an index into `Method.reasons`.
    u : ndarray, shape (R, m), or None
        Inputs held over the period where the mode is `FILTERED` [N].
    """

    mode: NDArray[np.int_]
    margin: Array
    why: NDArray[np.int_]
    u: Array | None = None


@dataclass(frozen=True)
class Claim:
    """What a method promises.

    Attributes
    ----------
    kind : {"proved", "none"}
    reach : str
        How far that goes and what it rests on; for ``none`` what is missing.
    """

    kind: str
    reach: str


class Method(Protocol):
    """A run-time assurance method on one scene."""

    key: str
    name: str
    reasons: tuple[str, ...]
    delayed: bool
    """Whether it decides on a measurement, so that the latency passes before a decision takes effect."""

    @property
    def claim(self) -> Claim:
        """What it promises."""
        ...

    def start(self, runs: int) -> None:
        """Forget everything; so many runs will be decided at once."""
        ...

    def decide(self, seen: Seen) -> Choice:
        """Decide who flies until the next decision takes effect."""
        ...


class Memoryless:
    """A method that remembers nothing from one decision to the next."""

    delayed = True

    def __init__(self, scene: Scene) -> None:
        self.scene = scene

    def start(self, runs: int) -> None:
        """Nothing to forget."""


def accept(inside: NDArray[np.bool_], margin: Array, mode: int = 1) -> Choice:
    """U where it is accepted (reason 0), S elsewhere (reason 1)."""
    return Choice(np.where(inside, mode, 0), margin, np.where(inside, 0, 1))
