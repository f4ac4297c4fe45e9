"""One-sided comparison of a row of today with the stored one: better passes, worse is a fault."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from tests.golden.rows import Row

WORSE, BETTER, OTHER = "worse", "better", "other"

POINT = 0.01
"""Largest fall of the share of U that passes."""

ROUNDING = 1e-9
"""Relative difference of two numbers that count as equal; margins are shares, theirs is absolute."""

EXITS = {1: 0, 2: 1, 3: 2, 4: 2, 0: 3}
"""Rank of exit codes: an internal fault, a refusal, no schedule, a schedule."""

RANKS: dict[str, tuple[Any, ...]] = {
    "verdict": ("REJECTED", "UNKNOWN", "STATISTICAL", "VERIFIED"),
    "end": ("none", "one_period", "infinite"),
    "goal": (False, "not_proven", True),
}
"""Answers from the weakest to the strongest."""

GOAL = ("goal_tolerance_m", "goal_by_s", "goal_distance_m")
"""Numbers of the goal's claim: the first that differs decides, the smaller one is better."""


@dataclass(frozen=True)
class Difference:
    """One difference between the stored row of a scene and that of today."""

    name: str
    quantity: str
    stored: Any
    today: Any
    kind: str

    def __str__(self) -> str:
        return f"{self.kind:6} {self.name}: {self.quantity} was {self.stored}, is {self.today}"


def compare(stored: Row, today: Row) -> list[Difference]:
    """Return all differences between two rows of one scene.

    Where U flies more than it did, its schedule is another one: smaller margins, wider tubes and a later goal
    are then no fault, as long as everything proven stays proven.
    """
    kinds = [("scene", OTHER)] if stored["scene"] != today.get("scene") else []
    kinds += _ranked("exit_code", EXITS, stored, today)
    if stored["exit_code"] or today["exit_code"]:
        return _made(kinds, stored, today)
    for quantity, order in RANKS.items():
        kinds += _ranked(quantity, {answer: i for i, answer in enumerate(order)}, stored, today)
    gain = today["share"] - stored["share"]
    if today["modes"] != stored["modes"]:
        kinds.append(("modes", OTHER))
    if abs(gain) > ROUNDING:
        kinds.append(("share", BETTER if gain > 0 else WORSE if gain < -POINT - ROUNDING else OTHER))
    numbers = [*_margins(stored, today), *_goal(stored, today), *_tube(stored, today)]
    if gain > ROUNDING:
        numbers = [(quantity, OTHER if kind == WORSE else kind) for quantity, kind in numbers]
    return _made(kinds + numbers, stored, today)


def _made(kinds: list[tuple[str, str]], stored: Row, today: Row) -> list[Difference]:
    return [Difference(stored["name"], each, stored.get(each), today.get(each), kind) for each, kind in kinds]


def _ranked(quantity: str, rank: dict[Any, int], stored: Row, today: Row) -> Iterator[tuple[str, str]]:
    if stored[quantity] != today[quantity]:
        gain = rank[today[quantity]] - rank[stored[quantity]]
        yield quantity, BETTER if gain > 0 else WORSE if gain < 0 else OTHER


def _margins(stored: Row, today: Row) -> Iterator[tuple[str, str]]:
    if stored["margin"] is not None and today["margin"] is not None:  # else U flies in one of them only
        yield from _smaller("margin", today["margin"], stored["margin"], ROUNDING)
    old, new = (-np.inf if row["start_margin"] is None else row["start_margin"] for row in (stored, today))
    yield from _smaller("start_margin", new, old, ROUNDING)


def _goal(stored: Row, today: Row) -> Iterator[tuple[str, str]]:
    if stored["goal"] != today["goal"]:
        return
    for quantity in GOAL:
        old, new = (np.inf if row[quantity] is None else row[quantity] for row in (stored, today))
        if worse := [*_smaller(quantity, old, new, ROUNDING * min(abs(old), abs(new)))]:
            yield from worse
            return


def _smaller(quantity: str, low: float, high: float, rounding: float) -> Iterator[tuple[str, str]]:
    """Report a quantity as worse if `low` is below `high`, as better if it is above."""
    if low != high and not abs(low - high) <= rounding:
        yield quantity, WORSE if low < high else BETTER


def _tube(stored: Row, today: Row) -> Iterator[tuple[str, str]]:
    if stored["tube"] is None or today["tube"] is None:
        return
    pairs = list(zip(stored["tube"], today["tube"], strict=True))
    if any(new > old * (1 + ROUNDING) for old, new in pairs):
        yield "tube", WORSE
    elif any(new < old * (1 - ROUNDING) for old, new in pairs):
        yield "tube", BETTER
