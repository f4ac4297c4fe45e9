"""The one call of every run-time filter: receive, decide, put into words; and what a backup controller is.

Beside it, `polaris.rta.method` is the protocol by which many runs are decided at once.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..model.system import Array
from .filter_input import FilterInput, Formation, InputCheck, commanded


@dataclass(frozen=True, eq=False)
class Decision:
    """One answer of a filter.

    Attributes
    ----------
    u : ndarray, shape (N, m)
        Thrust to apply [N]: always finite and within the limits.
    intervened : ndarray of bool, shape (N,)
        Whose input differs from the desired one.
    active : tuple of str
        Constraints that hold with equality, or the rule that decided.
    margins : dict of str to float
        Values of the constraints, by name (``h2[0,3]``), nan where not known.
    status : str
        ``desired``, ``filtered``, ``short`` (no input satisfies all conditions: the one that violates them
        least, see `priorities`), ``backup`` (the backup controller's), ``coast`` (no thrust).
    fallback : str or None
        Reason why the answer is not the filter's regular one; None if it is.
    missed : dict of str to float
        Conditions that the answer does not meet, by name, and by how much [N]; inf where no input changes it.
    on_backup : ndarray of bool, shape (N,)
        Whose input is the backup controller's, or none.
    unproven : bool
        A filter that rests on its backup could not show that even this keeps the constraints.
    """

    u: Array
    intervened: NDArray[np.bool_]
    active: tuple[str, ...]
    margins: dict[str, float] = field(repr=False)
    status: str
    fallback: str | None = None
    missed: dict[str, float] = field(default_factory=dict, repr=False)
    on_backup: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=bool), repr=False)
    unproven: bool = False


class RunTimeFilter(Protocol):
    """Anything between a primary controller and the thrusters."""

    def filter(self, t: float, x: ArrayLike, u_des: ArrayLike | None) -> Decision:
        """Decide on the inputs of the next control period.

        Parameters
        ----------
        t : float
            Time [s]. Whatever it is, there is an answer: that it is no number, stands still, runs backwards
            or jumps is noted in the decision (see `InputCheck`).
        x : array_like, shape (N, n)
            States; not finite where unknown. What is no such numbers is unknown.
        u_des : array_like, shape (N, m), or None
            Desired thrust [N]; None if it came too late. What is no such numbers did not come at all.
        """


class Backup(Protocol):
    """A controller to fall back to."""

    def __call__(self, t: float, x: Array) -> Array:
        """Thrust [N], shape (N, m), within the limits, for finite states of shape (N, n)."""


@dataclass(frozen=True)
class Switch:
    """One entry of the log of a filter that switches: when [s], whom, to ``backup`` or ``desired``, why."""

    t: float
    deputy: int
    to: str
    reason: str


@dataclass
class RawDecision:
    """Decision of a filter before it is put into words: see `Decision`.

    `backup` and `coasting` say whose input is the backup's, and whose is none because nothing else is
    possible; `notes` what is not regular; `short` that no input satisfies all conditions; `regular` that no
    input is the backup's or none.
    """

    u: Array
    intervened: NDArray[np.bool_]
    backup: NDArray[np.bool_]
    coasting: NDArray[np.bool_]
    margins: dict[str, float]
    notes: list[str]
    active: tuple[str, ...] = ()
    missed: dict[str, float] = field(default_factory=dict)
    short: bool = False
    unproven: bool = False
    regular: bool = False

    @property
    def status(self) -> str:
        """Status of all deputies in one word."""
        if not self.regular and self.coasting.all():
            return "coast"
        if self.short:
            return "short"
        if not self.regular and (self.backup & ~self.coasting).any():
            return "backup"
        return "filtered" if True in self.intervened.tolist() else "desired"  # quicker than any()


class CallByCall(ABC):
    """A `RunTimeFilter`: takes in each call, has a subclass decide, words the decision, remembers the thrust.

    The period [s] is the time for which an answer is held; default any. A call may be `late` [s].
    """

    def __init__(self, craft: Formation, period: float | None, late: float = 0.0) -> None:
        self._receiver = InputCheck(craft, period, late)

    def filter(self, t: float, x: ArrayLike, u_des: ArrayLike | None) -> Decision:
        """Decide on the inputs of the next control period; see `RunTimeFilter`."""
        call = self._receiver.receive(t, x, u_des)
        answer = self._answer(call)
        self._receiver.applied(answer.u)
        fallback = "; ".join(note for note in (call.fallback(), *answer.notes) if note) or None
        return Decision(
            answer.u,
            answer.intervened,
            answer.active,
            answer.margins,
            answer.status,
            fallback,
            answer.missed,
            answer.backup.copy() if answer.regular else answer.backup | answer.coasting,
            answer.unproven,
        )

    @abstractmethod
    def _answer(self, call: FilterInput) -> RawDecision:
        """Decide on the inputs received."""

    def _backed_up(self, backup: Backup | None, call: FilterInput, notes: list[str]) -> Array:
        """The backup controller's input; no thrust where it has none to give, which is recorded."""
        no_thrust = np.zeros(call.u.shape)
        if backup is None:
            return no_thrust
        u, fault = commanded(backup, (call.t, call.x), no_thrust.shape)
        if fault:
            notes.append(f"the backup controller failed: {fault}")
        limit = self._receiver.craft.thrust_max
        return no_thrust if u is None else np.where(np.isfinite(u), np.clip(u, -limit, limit), 0.0)


def by_name(labels: Sequence[str], values: Array) -> dict[str, float]:
    """Values by their names."""
    return dict(zip(labels, values.tolist(), strict=True))
