"""Decisions made again from the log of a flight."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import cycle
from typing import Any

from ..methods.monitor import Monitor
from .decision_log import restored
from .faults import Fault
from .runtime import OnlineMonitor
from .runtime_options import OnlineDecision, RuntimeOptions

LATE = "monitor: deadline missed"


def replay_log(
    records: Iterable[dict[str, Any]], monitor: Monitor, options: RuntimeOptions | None = None
) -> list[OnlineDecision]:
    """Feed what a log says arrived to a new runtime with the same options.

    The answers are those of the flight, bit for bit, missed deadlines and faults of U included: the log
    says where they were.

    Parameters
    ----------
    records : iterable of dict
        As `polaris.rta.online.decision_log.read_log` gives them, from the first decision on.
    monitor : Monitor
    options : RuntimeOptions, optional
    """
    wall = _Wall()
    online = OnlineMonitor(monitor, options, timer=wall)
    answers = []
    for record in records:
        wall.late = LATE in record["faults"]
        if record["resynchronised"] is not None:
            online.resynchronise(restored(record["resynchronised"]))
        online.guard.faults += [Fault("controller", text) for text in record["controller"]]
        names = ("now", "measurement", "applied", "reference", "number")
        answers.append(online.step(*(restored(record.get(name)) for name in names)))
    return answers


class _Wall:
    """A clock that is read at the beginning and at the end of every step."""

    def __init__(self) -> None:
        self.late, self._end = False, cycle((False, True))

    def __call__(self) -> float:
        return float("inf") if next(self._end) and self.late else 0.0
