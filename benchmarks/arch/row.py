"""One line of the benchmark table."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Verdict = Literal["proven", "violated", "unknown"]


@dataclass(frozen=True)
class Row:
    """Result of one benchmark instance.

    Attributes
    ----------
    benchmark, instance : str
        Names of the competition, such as ``"rendezvous"`` and ``"SRNA01"``.
    verdict : {"proven", "violated", "unknown"}
        "violated" only with a concrete trajectory that was replayed.
    expected : {"proven", "violated", "unknown"}
        Verdict that the competition states; "unknown" if it states nothing.
    bound : float or None
        The quantity of the specification, enclosed by us over the whole horizon.
    known : float or None
        Its limit in the specification, or the best value known.
    reached : float or None
        Value that a replayed trajectory reaches: the exact value is no better than this.
    seconds : float
        Run time of the verification, model construction excluded.
    note : str
        Meaning of the numbers, and what was not shown.
    """

    benchmark: str
    instance: str
    verdict: Verdict
    expected: Verdict
    bound: float | None
    known: float | None
    reached: float | None
    seconds: float
    note: str = ""

    @property
    def right(self) -> bool:
        """True unless the verdict is the opposite of the expected one; "unknown" is never wrong."""
        return "unknown" in (self.verdict, self.expected) or self.verdict == self.expected
