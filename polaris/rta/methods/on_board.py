"""Flight code as methods: the schedule in C, and the online monitor in C."""

import numpy as np

from ...certificate.code.answers import RANGE, OnlineStep
from ...model.errors import ScenarioError
from ...model.system import Array
from ...simulation.on_board import FlightCode, code_of
from ..decision_grid import DecisionGrid
from ..method import Choice, Method, Observation
from .fixed import PrecomputedSchedule
from .monitor import Monitor


class Compiled(PrecomputedSchedule):
    """The schedule and S as compiled flight code, called at every node, whose commands are flown.

    It is compiled here unless a `code` of the schedule is handed over.
    """

    key, name, place = "code", "Flight code in C", 2
    how = "the schedule, and S, as [compiled C](flight-code.md)"

    def __init__(self, grid: DecisionGrid, code: FlightCode | None = None) -> None:
        super().__init__(grid)
        self.code = (
            code_of(grid.schedule) if code is None or code.online else code.require_schedule(grid.schedule)
        )

    @property
    def reach(self) -> str:
        """That of the schedule, but for rounding."""
        return f"rounding on board takes a small share of the disturbance bound; {super().reach}"


class MonitorOnBoard(Method):
    """The online monitor of flight code.

    In a comparison the compiled code decides and commands at every node; U asks in all of them. Behind
    `OnlineMonitor` its tables decide in Python, as `polaris.certificate.code.answers.OnlineStep` defines it:
    to the last bit as the code, in either precision, on the same state, period and mode before.

    Parameters
    ----------
    grid : DecisionGrid
        With a decision in every control period, without latency, and with errors of estimates that are at
        most those of the scenario.
    code : FlightCode
        Of ``polaris export c --monitor``.

    Raises
    ------
    ScenarioError
        If the grid is another one, or the code is missing, has no monitor or is of another schedule.
    NotCertified
        As of `Monitor`.
    """

    key, name, place, proven = "monitor_code", "Polaris online monitor in C", 3, True
    how = "the monitor of flight code (`--code`), by [compact tables](flight-code.md#the-online-monitor)"
    reasons = ("U asks",)

    def __init__(self, grid: DecisionGrid, code: FlightCode | None = None) -> None:
        super().__init__(grid)
        if code is None or not code.online:
            raise ScenarioError("code", code and code.tables.sizes, "must be flight code with the monitor")
        self.code, base = code.require_schedule(grid.schedule), DecisionGrid.from_schedule(grid.schedule)
        if (grid.nodes, grid.delay) != (1, 0) or (grid.half_widths > base.half_widths).any():
            rule = "must be the control period, without latency and with no more errors than declared"
            raise ScenarioError("period", grid.period, f"{rule}, where the code decides")
        self.monitor = Monitor(grid)

    @property
    def reach(self) -> str:
        """That of the monitor, if the checker confirms the code."""
        return f"`polaris verify --code` confirms the code; {self.monitor.reach}"

    def decide(self, observed: Observation) -> Choice:
        """Let U ask; the code answers."""
        R = len(observed.estimate)
        modes = np.full(R, self.monitor.modes[0])
        return Choice(modes, np.full(R, np.nan), np.zeros(R, dtype=int))

    def explained(self, k: int, state: Array, flying: int) -> tuple[int, float, str]:
        """Return the mode that the code decides for, and margin and limit of `Monitor.explained`."""
        assert self.code is not None
        mode, margin, reason = self.monitor.explained(k, state, flying)
        step = OnlineStep(self.code.tables, self.code.precision)
        step.safe.last, step.flown = k - 1, flying
        answer = step.step(k, state.tolist(), self.monitor.modes[0], [0.0] * self.grid.system.m)
        if mode and not answer.mode:
            detail = "the state is beyond the code's range" if answer.fault & RANGE else "the code needs more"
            reason = f"{reason}; {detail}"
        return answer.mode, margin, reason
