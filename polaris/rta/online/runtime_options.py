"""Faults in flight, tolerances of the online monitor's runtime, and its answers."""

from dataclasses import dataclass
from typing import NamedTuple

from ...model.checks import positive, whole
from ...model.errors import ScenarioError
from ...model.tolerances import FARTHEST
from ..decision_grid import DecisionGrid

HARMLESS = ("missed", "log")
"""Families that do not keep U from flying: what they tell of is over, and no premise of the proof."""


class FlightFault(NamedTuple):
    """One fault: its family, and a text that begins alike for the same kind of fault.

    Families are clock, missed, measurement, estimate, controller, monitor, log, and rule: no fault of its
    own, but S is kept (dwell, latch, re-acquisition).
    """

    family: str
    text: str

    def __str__(self) -> str:
        return f"{self.family}: {self.text}"

    @property
    def harmless(self) -> bool:
        """True if U may fly all the same."""
        return self.family in HARMLESS


@dataclass(frozen=True)
class RuntimeOptions:
    """Tolerances of the runtime; `limits` fills in the defaults.

    Attributes
    ----------
    max_age : float, optional
        Oldest measurement that is used [s]; default one period.
    memory : float, optional
        Time [s] over which a measurement is compared with the next; default ten periods.
    farthest : float
        Entries of the state beyond this are taken for faults, in the units of the state.
    tolerance : float, optional
        Largest time by which a call is early or late [s], below half the period; default the scene's latency
        as far as it is below that, at least a millionth of the period.
    drift : float, optional
        Largest difference of clock and second clock [s]; default a hundredth of the period.
    deadline : float, optional
        Wall time that one call of `OnlineMonitor.step` may take [s], never beyond the moment of effect;
        default the scene's latency, or the period where it has none.
    budget : float, optional
        Wall time that one call of U may take [s]; default one period.
    reacquire : int
        Consecutive measurements that must agree with each other before U flies again after a conflict.
    min_dwell : int
        Decisions for which S keeps control once it has it.
    latch : int or None
        After so many faults of U or of the monitor itself S flies for good; None: never.
    latch_conflicts : int or None
        After so many measurements that contradict earlier ones, if `reacquire` never agreed in between.

    Raises
    ------
    ScenarioError
        If one is out of range.
    """

    max_age: float | None = None
    memory: float | None = None
    farthest: float = FARTHEST
    tolerance: float | None = None
    drift: float | None = None
    deadline: float | None = None
    budget: float | None = None
    reacquire: int = 3
    min_dwell: int = 1
    latch: int | None = 3
    latch_conflicts: int | None = 5

    def __post_init__(self) -> None:
        for name in ("max_age", "memory", "tolerance", "drift", "deadline", "budget"):
            if getattr(self, name) is not None:
                positive(name, getattr(self, name), "s")
        positive("farthest", self.farthest, "units of the state")
        for name in ("reacquire", "min_dwell", "latch", "latch_conflicts"):
            if name in ("reacquire", "min_dwell") or getattr(self, name) is not None:
                whole(name, getattr(self, name), 1)

    def limits(self, grid: DecisionGrid) -> "Durations":
        """Return all options as numbers for one scene.

        Raises
        ------
        ScenarioError
            If the tolerance is half of the scene's period or more.
        """
        period, widest = grid.period, 0.499 * grid.period
        if self.tolerance is not None and self.tolerance > widest:
            raise ScenarioError("tolerance", self.tolerance, f"must be below half the period of {period:g} s")
        max_age = self.max_age or period
        return Durations(
            max_age,
            max(self.memory or 10 * period, max_age, period),
            self.tolerance or max(min(grid.latency, widest), 1e-6 * period),
            self.drift or period / 100,
            self.deadline or grid.latency or period,
            self.budget or period,
        )


@dataclass(frozen=True)
class Durations:
    """The durations among `RuntimeOptions` [s]."""

    max_age: float
    memory: float
    tolerance: float
    drift: float
    deadline: float
    budget: float


@dataclass(frozen=True, slots=True)
class OnlineDecision:
    """Decision on who flies from the moment of effect on.

    Attributes
    ----------
    k : int
        Number of the decision; -1 where the clock does not tell.
    mode : int
        0 is S, 1, 2 ... an experimental controller.
    margin : float
        Share of the clearance left at the tightest limit, of the controller chosen or the best refused;
        nan where no state was good enough to judge.
    until : float
        U may fly no longer than this [s]: without a new answer S takes over then. Minus infinity for S.
    reason : str
        The tightest limit and when S would meet it, or what was wrong.
    faults : tuple of FlightFault
        Everything that was wrong, in the order in which it was found. Any but those of the log keep U
        from flying.
    """

    k: int
    mode: int
    margin: float
    until: float
    reason: str
    faults: tuple[FlightFault, ...] = ()
