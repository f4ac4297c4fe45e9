"""The scenario file's models of navigation: bounds on errors, by phase of the flight, or an observer's."""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from ...model import keys as f
from ...model.craft import Craft
from ...model.errors import ScenarioError
from ...model.estimates.observer import design, observing
from ...model.scene.keep_in import INSTANT, KeepInPolytope, during
from ...model.system import Array, LinearSystem
from ...model.timing import Timing
from ...model.tolerances import ROUNDING
from .fields import ScenarioPart, check_length, per_axis, unit

PATH = "navigation.measurement"
MOST_MISSED = 20  # most periods without a measurement that an observer is designed for


class EstimateTable(ScenarioPart):
    """Bounds on estimate errors: of position and velocity in Hill's frame, else of states."""

    position_error_m: f.NonNegativePerAxis = unit("m", "Error per axis.", default=0.0)
    velocity_error_m_s: f.NonNegativePerAxis = unit("m/s", "Error per axis.", default=0.0)
    state_error: f.WidthVector | None = unit("SI", "Error of each state.", default=None)

    def build(self, system: LinearSystem, path: str = "navigation") -> Array:
        """Bounds on the error of every state, shape (n,)."""
        if system.mean_motion is None:
            if np.any(self.position_error_m) or np.any(self.velocity_error_m_s):
                rule = "needs Hill's frame (system.kind = 'clohessy_wiltshire'); give state_error"
                raise ScenarioError(f"{path}.position_error_m", self.position_error_m, rule)
            state_error = (0.0,) * system.n if self.state_error is None else self.state_error
            check_length(f"{path}.state_error", state_error, system.n)
            return np.array(state_error)
        if self.state_error is not None:
            rule = "must be left out in Hill's frame; give position_error_m and velocity_error_m_s"
            raise ScenarioError(f"{path}.state_error", self.state_error, rule)
        fields = ("position_error_m", self.position_error_m), ("velocity_error_m_s", self.velocity_error_m_s)
        return np.concatenate([per_axis(f"{path}.{name}", value, 3) for name, value in fields])


class Sight(ScenarioPart):
    """Errors along and across the line of sight to the target, which turn with it and grow with the range."""

    range_error_m: f.NonNegative = unit("m", "Error of the distance to the target.", default=0.0)
    bearing_error_deg: f.Real = unit("deg", default=0.0, ge=0, le=45)
    """Angular error of the line of sight. Range and bearing errors need Hill's frame and `within_m`, and add
    to `position_error_m`."""
    within_m: f.PositivePerAxis | None = unit("m", default=None)
    """Half-widths of a box about the target in which the bounds hold: for as long a keep-in zone of the whole
    chaser, assumed before the start. Outputs name it `within`, in later phases `within-0`, `within-1`, ..."""

    def sight(self, system: LinearSystem, path: str) -> Array:
        """Errors of range [m] and bearing [rad], and bounds on those of the position, shape (5,)."""
        range_error, angle = self.range_error_m, float(np.deg2rad(self.bearing_error_deg))
        if range_error == 0 and angle == 0:
            return np.zeros(5)
        if system.mean_motion is None or self.within_m is None:
            rule = "needs Hill's frame (system.kind = 'clohessy_wiltshire') and within_m"
            raise ScenarioError(
                f"{path}.range_error_m, bearing_error_deg", (range_error, self.bearing_error_deg), rule
            )
        half = per_axis(f"{path}.within_m", self.within_m, 3)
        across = np.sqrt(np.sum(half**2) - half**2)
        bounds = range_error + (1 - np.cos(angle)) * half + np.sin(angle) * across
        return np.array([range_error, angle, *bounds * (1 + ROUNDING)])


class Phase(EstimateTable, Sight):
    """Bounds until the next phase."""

    from_s: f.Positive = unit("s", "Start on the schedule's clock, increasing.")


class MeasurementTable(Sight):
    """Measurements of an observer with a steady Kalman gain, instead of bounds on estimates.

    It measures once a period: in Hill's frame the position, and the velocity if it has a bound.
    """

    position_error_m: f.PositivePerAxis | None = unit("m", "Error per axis.", default=None)
    velocity_error_m_s: f.PositivePerAxis | None = unit("m/s", "Error per axis.", default=None)
    matrix: f.Matrix | None = unit("-", "Measured rows, in other systems.", default=None)
    error: f.LimitVector | None = unit("SI", "Error bound of each row.", default=None)
    constant_share: f.Real = unit("-", default=0.0, ge=0, le=1)
    """Share of these errors, but not of range and bearing, that is an unknown bias, constant in a flight."""
    initial: EstimateTable | None = unit("-", default=None)
    """Error bounds of the first estimate (at t = 0); by default the observer has run long before it."""

    def build(self, system: LinearSystem) -> tuple[Array, Array]:
        """Return the rows that are measured, shape (r, n), and bounds on their errors, shape (r,)."""
        path, sight = PATH, self.sight(system, PATH)
        hill_keys, hill = ("position_error_m", "velocity_error_m_s"), system.mean_motion is not None
        frame = "in Hill's frame" if hill else "outside Hill's frame"
        for name in (*hill_keys, "matrix", "error"):
            value, applies = getattr(self, name), (name in hill_keys) == hill
            if value is not None and not applies:
                raise ScenarioError(f"{path}.{name}", value, f"must be left out {frame}")
            if value is None and applies and name != hill_keys[1] and not np.any(sight):
                raise ScenarioError(f"{path}.{name}", value, f"must be given {frame}")
        if self.matrix is not None and self.error is not None:
            check_length(f"{path}.matrix", self.matrix[0], system.n)
            check_length(f"{path}.error", self.error, len(self.matrix))
            return np.array(self.matrix), np.array(self.error)
        noise = self._fixed()
        noise[:3] += sight[2:]
        return np.eye(6)[: len(noise)], noise

    def _fixed(self) -> Array:
        """Bounds on errors of measurements in Hill's frame, those of range and bearing apart, shape (r,)."""
        parts = {"position_error_m": self.position_error_m or 0.0}
        if self.velocity_error_m_s is not None:
            parts["velocity_error_m_s"] = self.velocity_error_m_s
        return np.concatenate([per_axis(f"{PATH}.{k}", v, 3) for k, v in parts.items()])

    def apply(
        self, system: Craft, horizon: tuple[int, float], period: float, timing: Timing, late: bool
    ) -> Craft:
        """Return the system whose estimates are an observer's; see `Navigation.apply`."""
        if timing.missed > MOST_MISSED:
            rule = f"must be at most {MOST_MISSED} with an observer"
            raise ScenarioError("timing.missed_periods", timing.missed, rule)
        observer = design(system, *self.build(system), period, timing.missed, late or timing.missed > 0)
        if self.constant_share > 0:
            fixed = self.error if system.mean_motion is None else self._fixed()
            if not np.any(fixed):
                rule = "must be 0 where only range and bearing have errors, which turn with the line of sight"
                raise ScenarioError(f"{PATH}.constant_share", self.constant_share, rule)
            observer = replace(observer, constant=np.asarray(fixed) * self.constant_share)
        first = np.zeros(system.n)
        if self.initial is not None:
            first = self.initial.build(system, "navigation.measurement.initial")
        if np.any(first):
            steps, step = horizon
            observer = replace(observer, initial=first, horizon=(steps, max(round(step / period), 1)))
        return replace(observing(system, observer, period), sights=self.sight(system, PATH)[None])


class Navigation(EstimateTable, Sight):
    """Bounds on the errors of the state estimate of every controller, arbitrary in time.

    In Hill's frame the bounds are on position and velocity; with kind = "linear" on each state. They hold
    from t = 0 to the first phase's from_s. Networks and run-time methods use the largest of all phases.
    """

    phases: tuple[Phase, ...] = unit("-", "Later phases of the flight.", default=(), max_length=64)
    measurement: MeasurementTable | None = unit("-", default=None)
    """Measurements of an observer, instead of bounds on estimates."""

    def apply(
        self, system: Craft, horizon: tuple[int, float], period: float, timing: Timing, late: bool
    ) -> Craft:
        """Return the system with these errors; `horizon`: steps, their length [s]; `late`: late faults."""
        declared, sights = self.build(system), [self.sight(system, "navigation")]
        if self.measurement is not None:
            if np.any(declared) or self.within_m or self.phases:
                rule = "must be left out with bounds of estimates, within_m or phases in [navigation]"
                raise ScenarioError("navigation.measurement", None, rule)
            return self.measurement.apply(system, horizon, period, timing, late)
        if not self.phases:
            return replace(system, estimate_error=_with_sight(declared, sights[0]), sights=np.array(sights))
        begin = [0.0, *(phase.from_s for phase in self.phases)]
        if np.any(np.diff(begin) <= 0):
            raise ScenarioError("navigation.phases", begin[1:], "must have increasing from_s")
        later = [phase.build(system, f"navigation.phases[{i}]") for i, phase in enumerate(self.phases)]
        sights += [phase.sight(system, f"navigation.phases[{i}]") for i, phase in enumerate(self.phases)]
        bounds, (steps, step) = np.array(list(map(_with_sight, [declared, *later], sights))), horizon
        oldest = timing.delay + timing.missed * period
        start, last = np.arange(steps + 1, dtype=float) * step, np.arange(steps + 1) == steps
        mask = [during(np.where(last, 0.0, a), b, start, step, oldest) for a, b in pairwise([*begin, np.inf])]
        rows = np.max(np.where(np.array(mask)[..., None], bounds[:, None], 0.0), axis=0)
        phase_index = np.searchsorted(begin, start + INSTANT * step, side="right") - 1
        return replace(system, error_by_step=rows, sights=np.array(sights)[phase_index])

    def kept_within(self, system: LinearSystem, horizon: tuple[int, float]) -> list[KeepInPolytope]:
        """Return the sets to stay inside where bounds of phases hold; `horizon` as for `apply`."""
        sets, T, slack = [], horizon[0] * horizon[1], INSTANT * horizon[1]
        first: Sight = self if self.measurement is None else self.measurement
        parts = [(first, "navigation" if first is self else PATH, "within", 0.0)]
        for i, phase in enumerate(self.phases):
            parts.append((phase, f"navigation.phases[{i}]", f"within-{i}", phase.from_s))
        ends = [*(begins for *_, begins in parts[1:]), np.inf]
        for (part, path, name, begins), end in zip(parts, ends, strict=True):
            if part.within_m is None:
                continue
            if begins >= T - slack:
                rule = f"must be before the end of the schedule ({T:g} s) where within_m is given"
                raise ScenarioError(f"{path}.from_s", begins, rule)
            half = per_axis(f"{path}.within_m", part.within_m, system.d)
            sides = np.vstack([np.eye(system.d), -np.eye(system.d)]), np.tile(half, 2)
            sets.append(KeepInPolytope(name, *sides, begins, np.inf if end > T + slack else end))
        return sets


def _with_sight(bounds: Array, sight: Array) -> Array:
    """Return bounds on errors of states (n,) with those of the position by range and bearing."""
    return np.asarray(bounds + np.pad(sight[2:], (0, len(bounds) - 3))) if np.any(sight) else bounds
