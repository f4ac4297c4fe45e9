"""Inspection flights for policies that learn: their observations, rewards and shield."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...inspection.backup.brake import Brake
from ...inspection.constraints.allowable_set import allowable
from ...inspection.flights.sampling import InitialConditions
from ...inspection.flights.simulation import BatchFilter, SampledErrors
from ...model.checks import of_kind
from ...model.system import Array
from ...rta.one_call import RunTimeFilter
from ...rta.projection import DESIRED
from ...scenario.inspection import FlightScenario
from ...scenario.tables.filters import AssuredFilter, BarrierFilter, CentralizedFilter, ImplicitFilter

STATUSES = np.array(["desired", "filtered", "short", "backup"])  # names of the barrier filter's answers


class InspectionFlights:
    """R flights of a scenario of one flight. A policy commands all deputies' thrust for a control period.

    It reads, per deputy, its position as a share of r_max and its velocity as one of v_max, then the
    direction of the sun (cosine and sine of its angle), and the share of the flight that is over. A period
    is worth ``period / duration * (mean over deputies of 1 / (1 + |distance - wanted| / wanted) -
    effort * mean(|u| / u_max))``, and one less if a constraint phi1 to phi6 or phi9 to phi11 is violated in
    its middle or at its end.

    Parameters
    ----------
    scenario : FlightScenario
    runs : int
    wanted_m : float
        Distance from the chief that is wanted [m].
    effort : float
        Price of full thrust.

    Attributes
    ----------
    k : ndarray of int, shape (R,)
        Periods flown.
    x, sun : ndarray, shapes (R, N, 6) and (R,)
        States; angles of the sun at the start [rad].
    """

    failed = "violated"  # flag of flights that have lost safety, as `advance` returns it

    def __init__(self, scenario: Any, runs: int, wanted_m: float = 100.0, effort: float = 0.05) -> None:
        of_kind("scenario", scenario, FlightScenario, "polaris.load_scenario of one inspection flight")
        self.scenario: FlightScenario = scenario
        self.runs, self.distance, self.effort = runs, wanted_m, effort
        self.inspection, flight = scenario.inspection(), scenario.model.flight
        self.period, self.count = flight.period_s, round(flight.duration_s / flight.period_s)
        self._parts = tuple((part, *self.inspection.discretize(self.period * part)) for part in (0.5, 1.0))
        self.k, self.sun = np.zeros(runs, dtype=int), np.zeros(runs)
        self.x = self.seen = np.zeros((runs, self.inspection.deputies, 6))
        count = 3 * self.inspection.deputies
        self.limit, self.reads = np.full(count, self.inspection.thrust_max), 2 * count + 3
        self._drawn: list[tuple[Array, float]] = []
        self._unknown = scenario.uncertainty()
        self._errors: SampledErrors | None = None
        self._make: Callable[[float], RunTimeFilter] | None = None
        self._each: dict[int, RunTimeFilter] = {}
        self._batch: BatchFilter | None = None

    def shield(self, proven: bool = True) -> None:
        """Let a filter decide, from the next episode on.

        An assured one if `proven`, the scenario's own or ``implicit``: one proof after the other. Otherwise
        the barrier filter, the scenario's own or ``centralized``: one batch for all flights, whose answers
        hold for their period only, and where its program has a solution.
        """
        spec, alpha, period = self.scenario.model.filter, self.scenario.strengthening(), self.period
        self._make, self._each, self._batch = None, {}, None
        if proven:
            chosen = spec if isinstance(spec, AssuredFilter) else ImplicitFilter(kind="implicit")
            brake = Brake(self.inspection, period, self._unknown)
            self._make = lambda sun: chosen.start(brake, alpha, sun)
        else:
            spec = spec if isinstance(spec, BarrierFilter) else CentralizedFilter(kind="centralized")
            self._batch = self.scenario.filter(spec, period)

    def restart(self, chosen: NDArray[np.bool_], rng: np.random.Generator, fresh: bool = False) -> None:
        """Begin some flights (R,) anew, at the scenario's states, or at others where they are drawn.

        They are drawn many at a time and used one by one; `fresh` throws away what is left.
        """
        if fresh or (self._errors is None and not self._unknown.exact):
            self._drawn, number = [], int(rng.integers(2**31))
            bounds = self._unknown
            self._errors = None if bounds.exact else SampledErrors(bounds, self.inspection, number)
        x = self.x.copy()
        for run in np.flatnonzero(chosen).tolist():
            x[run], self.sun[run] = self._start(rng)
            if self._make:
                self._each[run] = self._make(float(self.sun[run]))
        self.x, self.k[chosen] = x, 0
        if chosen.any():
            self.seen = np.where(chosen[:, None, None], self._estimated(), self.seen)

    def _start(self, rng: np.random.Generator) -> tuple[Array, float]:
        if self.scenario.model.initial.kind == "states":
            return self.scenario.initial()
        if not self._drawn:
            drawn = InitialConditions(self.scenario.families(), int(rng.integers(2**31)), block=1024)
            drawn.first(1)
            self._drawn = list(zip(drawn.x, drawn.sun.tolist(), strict=True))
        return self._drawn.pop()

    def _estimated(self) -> Array:
        return self.x if self._errors is None else self._errors.estimated(self.x)

    def observe(self) -> Array:
        """Return the observations of policies, shape (R, 6 N + 3)."""
        q, sun = self.inspection, self.inspection.sun_angle(self.k * self.period, self.sun)
        scaled = self.seen / np.repeat([q.distance_max, q.speed_max], 3)
        return np.column_stack([scaled.reshape(self.runs, -1), np.cos(sun), np.sin(sun), self.k / self.count])

    def advance(self, u: Array, moving: NDArray[np.bool_] | None = None) -> dict[str, NDArray[Any]]:
        """Fly a period with thrust (R, 3 N) [N]; some flights may stand still. Thrust not finite is 0.

        Returns
        -------
        dict of str to ndarray, shape (R,)
            ``reward``; ``violated``; ``ended`` (the flight); ``least`` (value of a constraint);
            ``intervened`` (share of deputies whose thrust was changed); ``proven`` (for all time) and
            ``status`` of the answer; ``delta_v_m_s`` (spent).
        """
        q, moving = self.inspection, np.ones(self.runs, dtype=bool) if moving is None else moving
        u, columns = self._shielded(u.reshape(self.runs, -1, 3), moving)
        u = np.clip(np.where(np.isfinite(u), u, 0.0), -q.thrust_max, q.thrust_max)
        acting = u if self._errors is None else self._errors.acting(u)
        least, t, x = np.full(self.runs, np.inf), self.k * self.period, self.x
        for part, Phi, Gamma in self._parts:
            x = self.x @ Phi.T + acting @ Gamma.T
            values = allowable(q, x, q.sun_angle(t + part * self.period, self.sun)).values()
            least = np.minimum.reduce([least, *(value.min(axis=1, initial=np.inf) for value in values)])
        self.x, self.k = np.where(moving[:, None, None], x, self.x), self.k + moving
        self.seen = self._estimated()
        deviation = np.abs(np.linalg.norm(self.x[..., :3], axis=2) - self.distance) / self.distance
        reward = (1 / (1 + deviation)).mean(axis=1) - self.effort * np.abs(u).mean(axis=(1, 2)) / q.thrust_max
        violated = (least < 0) & moving
        return columns | {
            "reward": np.where(moving, reward / self.count - violated, 0.0),
            "violated": violated,
            "ended": moving & (self.k == self.count),
            "least": least,
            "delta_v_m_s": np.where(moving, np.abs(u).sum(axis=(1, 2)) * self.period / q.mass, 0.0),
        }

    def _shielded(self, u: Array, moving: NDArray[np.bool_]) -> tuple[Array, dict[str, NDArray[Any]]]:
        """Return the thrusts (R, N, 3) that the shield applies, and its verdicts."""
        share, proven, t = np.zeros(self.runs), np.zeros(self.runs, dtype=bool), self.k * self.period
        status = np.full(self.runs, "desired", dtype="U8")
        if self._batch is not None:
            finite, sun = np.isfinite(u), self.inspection.sun_angle(t, self.sun)
            answer = self._batch.batch(self.seen, sun, np.where(finite, u, 0.0))
            changed = (answer.status > DESIRED) | ~finite.all(axis=2)
            u, share, status = answer.u, changed.mean(axis=1) * moving, STATUSES[answer.status.max(axis=1)]
        for run in np.flatnonzero(moving & bool(self._each)).tolist():
            decision = self._each[run].filter(float(t[run]), self.seen[run], u[run])
            u[run], status[run] = decision.u, decision.status
            share[run], proven[run] = decision.intervened.mean(), not decision.unproven
        return u, {"intervened": share, "proven": proven, "status": status}
