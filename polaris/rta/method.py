"""The one protocol of all run-time assurance methods, their registry, and their answers."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from ..model.checks import non_negative, number
from ..model.errors import NotCertified
from ..model.system import Array
from ..simulation.on_board import FlightCode
from ..synthesis.controllers.black_box import BlackBox
from .decision_grid import DecisionGrid

FILTERED = -1  # mode of a period in which neither S nor U flies but an input that a filter has chosen
METHODS: dict[str, type["Method"]] = {}
"""Every method by its key, in the order of tables; classes put themselves in."""


@dataclass(frozen=True, eq=False)
class Observation:
    """Data that a method decides on at one decision; R runs are decided at once.

    Attributes
    ----------
    k : int
        Number of the decision; it is made at ``k`` periods.
    estimate : ndarray, shape (R, n)
        Absolute states as estimated for this instant; with ``[timing]`` as predicted for it.
    desired : ndarray, shape (R, m)
        Input that the preferred experimental controller wants, clipped to the limits [N].
    mode : ndarray of int, shape (R,)
        Modes of the period before: 0 is S, 1, 2, ... U, `FILTERED`.
    """

    k: int
    estimate: Array
    desired: Array
    mode: NDArray[np.int_]


@dataclass(frozen=True, eq=False)
class Choice:
    """Decision on who flies until the next one takes effect.

    Attributes
    ----------
    mode : ndarray of int, shape (R,)
        0 is S, 1, 2, ... an experimental controller, `FILTERED` the input given here.
    margin : ndarray, shape (R,)
        Margin of the decision in the method's own measure: negative where it refused; nan if it has none.
    why : ndarray of int, shape (R,)
        Reason, an index into `Method.reasons`.
    u : ndarray, shape (R, m), or None
        Inputs held over the period where the mode is `FILTERED` [N].
    """

    mode: NDArray[np.int_]
    margin: Array
    why: NDArray[np.int_]
    u: Array | None = None

    @classmethod
    def between(cls, inside: NDArray[np.bool_], margin: Array) -> "Choice":
        """U where it is accepted (reason 0), S elsewhere (reason 1)."""
        return cls(np.where(inside, 1, 0), margin, np.where(inside, 0, 1))


@dataclass(frozen=True)
class Claim:
    """Promise of a method.

    Attributes
    ----------
    kind : {"proved", "none"}
    reach : str
        Extent and basis of the promise; for ``none`` what is missing.
    """

    kind: str
    reach: str


@dataclass(frozen=True)
class Option:
    """Tuning option of a method: a keyword of its class, ``--tune KEY.NAME=VALUE`` for commands."""

    name: str
    meaning: str  # for the documentation, as is the default
    default: str
    values: tuple[float, ...]  # what the benchmark of the comparison page tries
    unit: str = ""  # of those: "", "decisions", "per duration", "of the duration" or "half widths of Θ"
    check: Callable[[str, Any], float] = number  # from field and value; raises `ScenarioError`


BUFFER = Option(
    "buffer",
    "distance kept from perceived unsafe sets [m]",
    "0",
    (0.0, 0.2, 0.5),
    "half widths of Θ",
    partial(non_negative, unit="m"),
)
"""Keep-clear buffer: decisions are made against grown unsafe sets; S and its reference stay as they are."""


def keep_clear(widths: float) -> Option:
    """Return the option of a keep-clear buffer with another default (`Method.apart`)."""
    return replace(BUFFER, default=f"{widths:g} {BUFFER.unit}")


class Method(ABC):
    """A run-time assurance method on one grid; a class with a `key` registers itself.

    Parameters
    ----------
    grid : DecisionGrid
    buffer : float, optional
        Distance that decisions keep from perceived unsafe sets [m], for methods with the option `BUFFER`;
        default `apart` times the largest half width of the initial set in position.

    Attributes
    ----------
    grid : DecisionGrid
        With unsafe sets grown by the buffer.
    key, name : str
        On the command line, and for people.
    how : str
        Rule by which it decides, for the documentation.
    proven : bool
        True if its promise is proved.
    reasons : tuple of str
        Reasons, of which `Choice.why` has the indices.
    options : tuple of Option
        Options that it can be tuned by.
    delayed : bool
        True if it decides on a measurement, so that the latency passes before a decision takes effect.
    predicts : bool
        True if it asks U what it would command elsewhere, which a black box with memory must not be.
    place : int
        Key by which tables are sorted.
    settings : dict of str to float
        Values that it was tuned with.
    code : FlightCode or None
        Compiled flight code that decides and commands at every node.
    """

    key: str
    name: str
    how: ClassVar[str]
    proven: ClassVar[bool] = False
    reasons: ClassVar[tuple[str, ...]]
    options: ClassVar[tuple[Option, ...]] = ()
    apart: ClassVar[float] = 0.0
    """Default buffer in half widths of the initial set: chosen by ``benchmarks/comparison.py``."""
    delayed: ClassVar[bool] = True
    predicts: ClassVar[bool] = False
    place: ClassVar[int] = 100
    code: FlightCode | None = None

    def __init_subclass__(cls) -> None:
        if "key" in vars(cls):
            METHODS[cls.key] = cls
            ordered = sorted(METHODS.items(), key=lambda item: item[1].place)
            METHODS.clear()
            METHODS.update(ordered)

    def __init__(self, grid: DecisionGrid, buffer: float | None = None) -> None:
        self.buffer = self.apart * grid.half_width if buffer is None else BUFFER.check("buffer", buffer)
        self.grid = grid.inflated(self.buffer)
        buffered = any(option.name == BUFFER.name for option in self.options)
        self.settings: dict[str, float] = {BUFFER.name: self.buffer} if buffered else {}

    @classmethod
    def on(cls, grid: DecisionGrid, **options: Any) -> "Method":
        """The method as it flies in a comparison, on a grid of its own if that suits it better."""
        if cls.predicts and any(isinstance(law, BlackBox) and law.memory for law in grid.controllers):
            reason = "it predicts U, which is not possible for a black box with memory"
            raise NotCertified(reason)
        try:
            return cls(grid, **options)
        except NotCertified:
            if not grid.system.proportional:
                raise
            return cls(grid.with_feedback_bound(), **options)

    @property
    def claim(self) -> Claim:
        """Promise of the method on this grid; a proof also rests on S at the end."""
        if self.proven:
            return Claim("proved", f"{self.reach}; {self.grid.schedule.safety.end.reason}")
        return Claim("none", self.reach)

    @property
    @abstractmethod
    def reach(self) -> str:
        """Basis of the method's proof, or the condition that is missing for one."""

    def start(self, runs: int) -> None:  # noqa: B027
        """Forget everything; so many runs will be decided at once."""

    @abstractmethod
    def decide(self, observed: Observation) -> Choice:
        """Decide who flies until the next decision takes effect."""


class Latched(Method):
    """U as long as `margin` has never been negative; then S to the end."""

    reasons = ("inside", "leaving", "latched in S")

    options = (BUFFER,)

    def __init__(self, grid: DecisionGrid, buffer: float | None = None) -> None:
        super().__init__(grid, buffer)
        self._latched: NDArray[np.bool_] = np.zeros(0, dtype=bool)

    def start(self, runs: int) -> None:
        """Begin with no run latched."""
        self._latched = np.zeros(runs, dtype=bool)

    @abstractmethod
    def margin(self, observed: Observation) -> Array:
        """Return the margin that decides, shape (R,): S takes over where it is not >= 0."""

    def decide(self, observed: Observation) -> Choice:
        """Switch once."""
        margin = self.margin(observed)
        leaving = ~(margin >= 0)  # what cannot be worked out is not inside
        reasons = np.where(self._latched, 2, np.where(leaving, 1, 0))
        self._latched = self._latched | leaving
        return Choice(np.where(self._latched, 0, 1), margin, reasons)
