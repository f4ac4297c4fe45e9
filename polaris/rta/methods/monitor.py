"""The online Polaris monitor: U flies as long as S could still take over when the next decision takes effect.

From the measured state and its error bound, the reachable set of U at the end of the next decision
interval, latency included, must be recoverable; else S flies. U is taken at nothing but the thrust limits,
or, where that is asked for, at its declared model as long as its command cannot be clipped.

Why this is a proof: whoever flies, the state is recoverable when a decision takes effect. If S is chosen,
it stays safe for ever. If U is, every state that it can reach at the nodes up to the next moment of effect
meets the facets there, the path between nodes too (`polaris.rta.recovery`), and at that moment the state
is recoverable again.
"""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...model.checks import non_negative, whole
from ...model.errors import NotCertified, ScenarioError
from ...model.system import Array
from ...synthesis.controllers.controllers import AffineController
from ..decision_grid import DecisionGrid
from ..flight import Conditions, fly
from ..method import Choice, Method, Observation, Option
from ..permission import ErrorMotion, Permission
from ..recovery import Recovery

TRUST = ("declared", "thrust_limits")
REENTRIES, DWELLS = (0.0, 0.02, 0.05, 0.1, 0.2), (1, 3, 10, 30, 100)
"""Values that the benchmark of the comparison page tries."""
REENTRY = 0.1  # default of the share of the clearance to be left: chosen by ``benchmarks/comparison.py``


_dwell = partial(whole, least=1)


def _reentry(field: str, value: object) -> float:
    """Check the share of the clearance that U must leave to take over from S."""
    share = non_negative(field, value, "")
    if share >= 1:
        raise ScenarioError(field, value, "must be a share of the margin, at least 0 and below 1")
    return share


class Monitor(Method):
    """The online monitor as a method of the arena.

    It judges the state at the decision's own instant. With ``[timing]`` it must be handed the state predicted
    for that instant: the measured state, which is older, is outside of the bounds that the proof rests on.

    Parameters
    ----------
    grid : DecisionGrid
    trust : {"declared", "thrust_limits"}
        Assumptions on U: by default nothing but the thrust limits, so that no fault of U can break the
        proof; ``declared``: its law (and its thrust limits where the law would clip). Controllers that may do
        anything are always taken at the limits.
    dwell : int
        Decisions for which S keeps control once it has it.
    reentry : float
        Share of the clearance that must be left for U to take over from S: whoever gets control with
        more than none to spare does not lose it again at once.

    Raises
    ------
    ScenarioError
        If an option has no such value, or a law counts for nothing because faults are isolated late.
    NotCertified
        If the initial set is not inside the first of its recoverable sets.
    """

    key, name, place, proven = "monitor", "Polaris online monitor", 3, True
    how = (
        "all that any thrust can reach until the next decision takes effect is recoverable"
        " ([more](online-monitor.md))"
    )
    options = (
        Option(
            "reentry",
            "share of the clearance that U must leave to take over from S",
            "0.1",
            REENTRIES,
            check=_reentry,
        ),
        Option("dwell", "decisions for which S keeps control", "1", DWELLS, "decisions", _dwell),
    )
    reasons = ("U is recoverable", "U is not recoverable", "S keeps control: dwell or re-entry margin")

    def __init__(
        self, grid: DecisionGrid, trust: str = "thrust_limits", dwell: int = 1, reentry: float = REENTRY
    ) -> None:
        if trust not in TRUST:
            raise ScenarioError("trust", trust, f"must be one of {', '.join(TRUST)}")
        super().__init__(grid)
        late = bool(grid.system.transients)  # then U may act on worse estimates until the answer takes effect
        if trust == "declared" and late and grid.nodes + grid.delay > 1:
            rule = "must be 'thrust_limits' with faults isolated late, unless decisions are made every"
            raise ScenarioError("trust", trust, f"{rule} control period, without latency")
        self.trust = trust
        self.dwell = _dwell("dwell", dwell)
        self.reentry = _reentry("reentry", reentry)
        self.settings = {"reentry": self.reentry, "dwell": float(self.dwell)}
        self.modes = tuple(range(1, len(grid.controllers)))  # who may fly beside S, in order of preference
        self.chosen = ""
        self.recovery = Recovery.certified(grid)
        # By controller (0: anything within the thrust limits) and by who flies until a decision takes effect.
        self.prospects: dict[tuple[int, int], Permission] = {}
        any_thrust = ErrorMotion.any_thrust(self.recovery)
        safe = any_thrust if late else ErrorMotion.declared(self.recovery, 0)
        legs = {0: any_thrust}
        for mode, law in enumerate(grid.controllers):
            if mode and self.trust == "declared" and isinstance(law, AffineController):
                legs[mode] = ErrorMotion.declared(self.recovery, mode)
        for mode, leg in legs.items():
            for flying, before in enumerate((safe, any_thrust)):
                self.prospects[mode, flying] = Permission(self.recovery, before if grid.delay else None, leg)
        self._since = np.zeros(0, dtype=int)

    @property
    def reach(self) -> str:
        """Assumptions of the proof: the estimate error, and U's model."""
        assumption = "its declared model" if self.trust == "declared" else "nothing but its thrust limits"
        return f"state estimate within its error bound, U obeys {assumption}{self.chosen}"

    @classmethod
    def on(cls, grid: DecisionGrid, **options: Any) -> "Monitor":
        """A monitor along that safe reference, the schedule's or one of its library, of largest objective.

        Of several experimental controllers it lets all fly, or one alone, by the larger objective. Each is
        flown beforehand, from the middle of Theta and undisturbed. S must then fly that reference too: that
        of the monitor's own `grid`.

        Raises
        ------
        NotCertified
            If the initial set is not inside the first recoverable set of any.
        """
        monitors, refused = [], None
        for i, schedule in enumerate((grid.schedule, *grid.schedule.library)):
            base = (
                DecisionGrid.from_schedule(schedule, grid.period, grid.latency, grid.half_widths)
                if i
                else grid
            )
            for one in (base, base.with_feedback_bound()) if grid.system.proportional else (base,):
                try:
                    monitors.append(cls(one, **options))
                except NotCertified as error:
                    refused = refused or error
        if not monitors:
            raise refused or NotCertified("nothing is proven")
        monitor, everyone, objective = monitors[0], monitors[0].modes, grid.schedule.objective
        singles = [(mode,) for mode in everyone] if len(everyone) > 1 else []
        choices = [(one, modes) for one in monitors for modes in (everyone, *singles)]
        if objective and len(choices) > 1:
            monitor, modes = max(choices, key=lambda choice: choice[0].objective(objective, choice[1]))
            monitor.modes = modes
        if monitor.grid.schedule is not grid.schedule:
            monitor.chosen = ", along a safe reference of its own, proven like the schedule's"
        if monitor.modes != everyone:
            monitor.chosen += f"; only {grid.controllers[monitor.modes[0]].name} flies, of greater objective"
        return monitor

    def objective(
        self, priced: Callable[[Mapping[int, float], float, float], float], modes: tuple[int, ...] = ()
    ) -> float:
        """Return the objective of the undisturbed flight from the initial set's middle, with these modes."""
        self.modes = modes or self.modes
        flight = fly(self.grid, self, Conditions.undisturbed(self.grid))
        modes = flight.modes[0]
        shares = np.bincount(modes) / len(modes)
        switches = int(np.count_nonzero(np.diff(modes)))
        return priced(dict(enumerate(shares.tolist())), float(flight.delta_v[0]), switches)

    def start(self, runs: int) -> None:
        """Begin with no run that dwells in S."""
        self._since = np.full(runs, self.dwell)

    def decide(self, observed: Observation) -> Choice:
        """The first controller that is recoverable, in order of preference; else S."""
        e = observed.estimate - self.grid.xi[observed.k * self.grid.nodes]
        if len(e) == 1:
            return self._decide_one(observed.k, e[0], int(observed.mode[0]))
        mode, margin = self.judge(observed.k, e, observed.mode)
        mode = np.where((observed.mode == 0) & (self._since < self.dwell), 0, mode)
        reasons = np.where(mode > 0, 0, np.where(margin >= 0, 2, 1))
        self._since = np.where(mode > 0, self.dwell, np.where(observed.mode > 0, 1, self._since + 1))
        return Choice(mode, margin, reasons)

    def _decide_one(self, k: int, e: Array, flying: int) -> Choice:
        """`decide` of one run: the same without arrays, which take longer than the decision itself."""
        mode, margin = self.judge_one(k, e, flying)
        since = int(self._since[0])
        mode = 0 if flying == 0 and since < self.dwell else mode
        reason = 0 if mode else 2 if margin >= 0 else 1
        self._since[0] = self.dwell if mode else (1 if flying else since + 1)
        return Choice(np.array([mode]), np.array([margin]), np.array([reason]))

    def judge(self, k: int, e: Array, flying: NDArray[np.int_]) -> tuple[NDArray[np.int_], Array]:
        """Mode and margin (least share of clearance left, of the controller chosen or the best refused).

        Parameters
        ----------
        k : int
        e : ndarray, shape (R, n)
            Errors ``x - xi`` as measured.
        flying : ndarray of int, shape (R,)
            Modes that fly until the decision takes effect.
        """
        R = len(e)
        mode, margin = np.zeros(R, dtype=int), np.full(R, -np.inf)
        limit = np.where(flying == 0, self._limit(k), 1.0)
        for candidate in self.modes:
            share = np.full(R, np.inf)
            for before in (0, 1) if self.grid.delay else (0,):
                matching = ((flying != 0) == before) if self.grid.delay else np.ones(R, dtype=bool)
                if matching.any():
                    share[matching] = self._share(k, e[matching], candidate, before)
            undecided = mode == 0
            margin = np.where(undecided, np.maximum(margin, 1 - share), margin)
            mode = np.where(undecided & (share <= limit), candidate, mode)
        return mode, margin

    def _limit(self, k: int) -> float:
        """Share of the clearance that U may need to take over from S; at the start nobody has flown."""
        return 1 - self.reentry if k else 1.0

    def _share(self, k: int, e: Array, candidate: int, before: int) -> Array:
        cautious = self.prospects[0, before]
        share, holds = self.prospects.get((candidate, before), cautious).share(k, e)
        if not holds.all():
            share[~holds] = cautious.share(k, e[~holds])[0]
        return share

    def judge_one(self, k: int, e: Array, flying: int) -> tuple[int, float]:
        """`judge` of one run, e of shape (n,): the quick way through."""
        return self._quickest(k, e, flying)[:2]

    def explained(self, k: int, state: Array, flying: int) -> tuple[int, float, str]:
        """Return `judge_one` of a state, and its reason: the tightest limit, and when S would meet it."""
        mode, margin, nearest = self._quickest(k, state - self.grid.xi[k * self.grid.nodes], flying)
        if nearest is None:
            return mode, margin, "there is no experimental controller"
        note = "" if mode or not margin >= 0 else "; less clearance than U needs to take over from S"
        return mode, margin, f"nearest limit: {nearest[0].limit(k, nearest[1])}{note}"

    def _quickest(self, k: int, e: Array, flying: int) -> tuple[int, float, tuple[Permission, int] | None]:
        """Mode; margin and tightest limit of the controller chosen, or of the best refused."""
        before, lowest, nearest = 1 if self.grid.delay and flying else 0, np.inf, None
        limit = 1.0 if flying else self._limit(k)
        for candidate in self.modes:
            cautious = self.prospects[0, before]
            prospect = self.prospects.get((candidate, before), cautious)
            share, index, holds = prospect.share_one(k, e)
            if not holds:
                prospect = cautious
                share, index, _ = prospect.share_one(k, e)
            if share <= limit:
                return candidate, 1 - share, (prospect, index)
            if nearest is None or share < lowest:
                lowest, nearest = share, (prospect, index)
        return 0, 1 - lowest, nearest


class DeclaredMonitor(Monitor):
    """`Monitor` that trusts U's declared law."""

    key, name, place = "monitor_declared", "Polaris online monitor, U at its declared law", 4
    how = "all that U can reach at its declared law is recoverable"

    def __init__(self, grid: DecisionGrid, dwell: int = 1, reentry: float = REENTRY) -> None:
        super().__init__(grid, "declared", dwell, reentry)
