"""Metrics of a method's flights, and differences between two methods run by run."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reach.short_repr import short_repr

from ..model.scene.distances import count_switches
from ..model.system import Array
from ..simulation.metrics import Metrics, finite, mean_interval, possible, violation_interval
from ..simulation.run_metrics import Runs, evaluate, experimental_share, peak
from .decision_grid import DecisionGrid
from .flight import Conditions, Flight
from .method import FILTERED, Claim

UNCHANGED = 0  # reason of a filter's decision that lets the desired input pass (`Method.reasons`)

DEFINITIONS = {
    "min_distance_m": "minimum signed distance of each run to a true keep-out zone; negative inside",
    "mean_distance_m": "signed distance to the nearest true keep-out zone, mean over time",
    "min_ttc_s": "minimum time of each run to a keep-out zone, straight at the present velocity;"
    " no mean if some run is never on a collision course",
    "min_ttc_free_drift_s": "minimum time to collision with thrusters off from the start of each step",
    "experimental_share": "share of time in which the experimental controller's input is applied unchanged",
    "switches": "changes between S, U and filtered inputs within a run",
    "delta_v_m_s": "delta-v: integral of the 1-norm of the input over the mass",
    "deviation": "mean over time of the 2-norm of applied minus desired input (N for a spacecraft)",
    "violations": "runs that entered a true keep-out zone; the interval is that of Clopper and Pearson for"
    " the probability, times the number of runs",
    "decision_median_us": "wall time of one decision for one run, median over its decisions",
    "decision_p99_us": "wall time of one decision for one run, 99th percentile",
    "synthesis_s": "wall time before the flight: Algorithm 1 where the method needs S, Algorithm 2 for the"
    " schedule, and preparation of the method",
    "mean, low, high": "mean over runs and its 95 % interval (Student's t, cut to possible values), for"
    " runs drawn as here, half of them under worst cases, not for real flights",
    "worst": "minimum of distances, times to collision and shares; maximum of the others",
}
"""Meaning of each number of a comparison."""

LEAST = ("min_distance_m", "mean_distance_m", "min_ttc_s", "min_ttc_free_drift_s", "experimental_share")
"""Metrics of which little is bad."""

PER_RUN = (*LEAST, "switches", "delta_v_m_s", "deviation")  # metrics of which every run has its own


@short_repr
@dataclass(frozen=True, eq=False)
class MethodResult:
    """All flights of one method.

    Attributes
    ----------
    key, name : str
    claim : Claim
    metrics : Metrics
        Per run; shares and switches count filtered inputs as neither S nor U.
    deviation : ndarray, shape (R,)
    decision_s : (float, float)
        Median and 99th percentile of the time of one decision [s].
    synthesis_s : float
        Wall time before the flight.
    reasons : mapping
        Number of decisions taken for each reason.
    settings : mapping
        Values that the method was tuned with.
    """

    key: str
    name: str
    claim: Claim
    metrics: Metrics
    deviation: Array
    decision_s: tuple[float, float]
    synthesis_s: float
    reasons: dict[str, int]
    settings: dict[str, float] = field(default_factory=dict)

    @property
    def columns(self) -> dict[str, Array]:
        """One number per run, by metric."""
        columns = self.metrics.columns() | {"deviation": self.deviation}
        return {name: columns[name].astype(float) for name in PER_RUN}

    def summary(self) -> dict[str, Any]:
        """The numbers of a comparison; null where there is none."""
        out: dict[str, Any] = {}
        for name, values in self.columns.items():
            worst = values.min() if name in LEAST else values.max()
            mean, low, high = _interval(values, possible(name))
            out[name] = {"mean": mean, "low": low, "high": high, "worst": finite(worst)}
        collided, runs = int(self.metrics.collided.sum()), len(self.metrics.collided)
        low, high = (part * runs for part in violation_interval(collided, runs))
        out["violations"] = {"mean": collided, "low": low, "high": high, "worst": collided}
        out["decision_median_us"], out["decision_p99_us"] = (1e6 * part for part in self.decision_s)
        out["synthesis_s"] = self.synthesis_s
        return out

    def against(self, other: "MethodResult") -> list[dict[str, Any]]:
        """Differences to another method, run by run, with 95 % intervals of their means."""
        rows = []
        columns, others = self.columns, other.columns
        for name in columns:
            with np.errstate(invalid="ignore"):  # of two infinite times there is no difference
                mean, low, high = _interval(columns[name] - others[name], possible(name, difference=True))
            labels = {"method": self.key, "against": other.key, "metric": name}
            rows.append(labels | {"difference": mean, "low": low, "high": high})
        return rows


def measure(grid: DecisionGrid, flight: Flight, conditions: Conditions, name: str) -> Metrics:
    """Metrics of the flights of one method against the true unsafe sets."""
    planned = np.zeros(grid.clearance.planned, dtype=int)  # modes differ from run to run: counted below
    records = flight.times, flight.states, flight.inputs, flight.demanded, flight.delta_v
    runs = Runs(grid.schedule, *records, planned)
    metrics = evaluate(runs, conditions.seed, name)
    modes = executed_modes(grid, flight)
    return replace(
        metrics,
        experimental_share=experimental_share(flight.times, modes),
        # A filtered input is not an unknown mode: changes to it and from it count.
        switches=count_switches(np.where(modes == FILTERED, len(grid.controllers), modes)),
        max_thrust_ratio_safety=peak(flight.demanded, modes == 0),
        max_thrust_ratio_experimental=peak(flight.demanded, modes > 0),
    )


def executed_modes(grid: DecisionGrid, flight: Flight) -> NDArray[np.int_]:
    """Return the modes after every node, shape (R, N): filtered inputs equal to the desired count as U's."""
    codes = np.repeat(flight.why, grid.nodes, axis=1)
    if grid.delay:
        codes = np.concatenate([codes[:, :1].repeat(grid.delay, axis=1), codes[:, : -grid.delay]], axis=1)
    return np.where((flight.modes == FILTERED) & (codes == UNCHANGED), 1, flight.modes)


def _interval(values: Array, within: tuple[float, float]) -> tuple[float | None, float | None, float | None]:
    if not np.all(np.isfinite(values)):
        return None, None, None
    mean, low, high = mean_interval(values, within=within)
    return mean, low, high
