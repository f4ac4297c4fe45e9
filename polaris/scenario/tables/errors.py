"""The scenario file's models of what is not exact: thrusters, timing, the chaser's size; and of an abort."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated, Literal

import numpy as np

from ...model import keys as f
from ...model.allocation import MIXES, Allocation, axis_pairs
from ...model.checks import MAX_STEPS
from ...model.craft import Craft
from ...model.errors import ScenarioError
from ...model.estimates.prediction import predicting
from ...model.system import Array, LinearSystem
from ...model.thrusters import Nozzles
from ...model.thrusters import Thrusters as Errors
from ...model.timing import Timing as Delays
from ...model.timing import Transient
from ...synthesis.safety.passive import DriftRequirement as AbortOptions
from ...synthesis.safety.problem import PoweredAbort
from .faults import Fault
from .fields import BY_KIND, Described, ScenarioPart, per_axis, unit
from .goals import EllipticalNMTGoal, LinearNMTGoal, StationaryGoal


class ThrustersTable(ScenarioPart):
    """Bounds on the difference of applied and commanded thrust, at any time and in any direction."""

    magnitude_error: f.Real = unit("-", "Largest relative error of the thrust.", default=0.0, ge=0, lt=0.5)
    misalignment_deg: f.Real = unit("deg", default=0.0, ge=0, le=45)
    """Largest angular error of the whole thrust (1.5 times that of single nozzles along the axes), with
    `directions` of each nozzle. Hill's frame only."""
    mass_error: f.Real = unit("-", default=0.0, ge=0, lt=0.5)
    """Largest relative error of `system.mass_kg`, spent propellant included."""
    GONE = {"varies": "is now called errors_vary"}
    errors_vary: Literal["always", "never"] = unit("-", default="always")
    """`always`, or `never`: the three errors above are constant in a flight, which reduces the delta-v bound.
    With `directions`, thruster faults, jitter, `rise_s` or `fall_s` the bound is that of `always`."""
    impulse_bit_N_s: f.NonNegative = unit("N s", default=0.0)
    """Impulse bit, of each thruster with `directions`; impulses are rounded to the nearest multiple."""
    remainder: Literal["dropped", "carried"] = unit("-", default="dropped")
    """Use of the remainder, the part of a command that rounding leaves out. `dropped`: it is lost. `carried`:
    it is added to the next command, and the sum is rounded towards zero within the limits; it starts at 0."""
    resolution: Literal["bit", "continuous"] = unit("-", default="bit")
    """Possible impulses: multiples of one `bit`, or `continuous` from one bit on."""
    pulse: Literal["held", "centred", "start", "staggered"] = unit("-", default="held")
    """`held`: constant thrust in a period. Otherwise one pulse of full thrust per period: `centred`, at its
    `start`, or `staggered`, one thruster after another in their order. Staggered pulses of m inputs have m
    times the input limit; with `directions`, input limits shrink to what fits into a period. Thruster errors
    are constant in a period of pulses."""
    rise_s: f.NonNegative = unit("s", default=0.0)
    """Longest rise or fall time of a pulse, of any shape that keeps the impulse."""
    fall_s: f.NonNegative = unit("s", default=0.0)
    """Longest rise or fall time of a pulse, of any shape that keeps the impulse."""
    directions: f.Matrix | None = unit("-", default=None)
    """Direction of each thruster, one number per input. By default a pair along every input."""
    thrust_max_N: f.PositivePerAxis | None = unit("N", default=None)
    """Largest thrust of each; required with `directions`. Input limits then shrink in proportion to the
    largest box that the thrusters can make."""
    allocation: Literal["least_thrust_mixes", "pseudo_inverse", "linear_program", "nearest"] = unit(
        "-", default="least_thrust_mixes"
    )
    """Allocation to `directions`. `least_thrust_mixes`: a fixed mix of least total thrust per input and sign.
    `pseudo_inverse`: twice the positive part of pseudo-inverse times command, for opposite pairs; a failed
    thruster disables its pair. `linear_program`, `nearest`: least sum of thrusts times length of direction,
    or least 2-norm, within the limits."""

    def nozzles(self, allocation: Allocation | None) -> Nozzles | None:
        """Return the thrusters of a layout with their errors; None where none is given."""
        if self.directions is None or allocation is None:
            return None
        errors = self.magnitude_error, float(np.deg2rad(self.misalignment_deg)), self.mass_error
        carried = self.remainder == "carried"
        return Nozzles.from_errors(allocation, *errors, self.impulse_bit_N_s, carried, self.pulse != "held")

    def in_turn(self, base: Allocation | None, period: float, faults: Sequence[Fault]) -> Allocation | None:
        """Return an allocation whose box is as large as pulses one after another fill a `period` [s].

        A thruster that is weaker by a fault fires for longer.
        """
        layout = self.nozzles(base)
        if self.pulse != "staggered" or base is None or layout is None:
            return base
        longest, rounded = (x / min(strengths(faults)) for x in layout.in_turn(period))
        if not rounded < 0.5:
            rule = f"must let rounding of staggered pulses take less than half of the period of {period:g} s"
            raise ScenarioError("thrusters.impulse_bit_N_s", self.impulse_bit_N_s, rule)
        return replace(base, u_max=base.u_max * min(1.0, (1 - rounded) / longest * (1 - 1e-6)))

    def build(self, system: Craft, period: float, separate: bool = True) -> Errors:
        """Bound the errors of the inputs, by the layout of the system's thrusters if it has one.

        They vary unless each input has thrusters of its own, `separate` in making it whatever fails.
        """
        layout = system.nozzles
        limits = system.u_max if layout is None else layout.allocation.limits
        if self.misalignment_deg > 0 and (system.mean_motion is None or system.m != 3):
            rule = "needs Hill's frame (system.kind = 'clohessy_wiltshire')"
            raise ScenarioError("thrusters.misalignment_deg", self.misalignment_deg, rule)
        if self.impulse_bit_N_s > (largest := float(limits.min()) * period):
            rule = f"must be at most what full thrust makes in a period, {largest:.6g} N s"
            raise ScenarioError("thrusters.impulse_bit_N_s", self.impulse_bit_N_s, rule)
        if layout is not None:
            return layout.errors(period)
        bit, angle = self.impulse_bit_N_s / (2 * period), float(np.deg2rad(self.misalignment_deg))
        dropped = self.remainder == "dropped"
        errors = Errors.from_errors(self.magnitude_error, angle, self.mass_error, bit * dropped, system.m)
        if not dropped:
            carried = 2 * bit * errors.across * float(np.sqrt(system.m - 1)) * (1 + 1e-9)
            errors = replace(errors, bit=carried)
        return replace(errors, constant=separate and self.errors_vary == "never" and errors.proportional)


def strengths(faults: Sequence[Fault]) -> list[float]:
    """Return the shares of its thrust that a thruster may have, if it has any."""
    return [1.0, *(share for fault in faults if 0 < (share := fault.build().left) < 1)]


class TimingTable(Described, makes=Delays):
    """See `polaris.model.timing.Timing`."""


def timed(
    system: Craft,
    timing: Delays,
    period: float,
    thrusters: ThrustersTable | None,
    limits: Array,
    faults: Sequence[Fault],
) -> Craft:
    """Return the system whose controllers act on predictions; `limits` [N] of inputs are those before faults.

    Raises
    ------
    ScenarioError
        If pulses do not fit into a period.
    """
    table, layout = thrusters or ThrustersTable(), system.nozzles
    _require_whole(table, limits if layout is None else layout.allocation.limits, period, faults)
    in_turn = table.pulse == "staggered"
    fired = () if table.pulse == "held" else tuple((limits * (len(limits) if in_turn else 1)).tolist())
    carried = table.impulse_bit_N_s if table.remainder == "carried" else 0.0
    if layout is not None:
        fired, carried = layout.fired, layout.max_carried
    edges = table.rise_s + table.fall_s
    if edges and not fired:
        raise ScenarioError("thrusters.rise_s, fall_s", edges, "must be 0 without pulses (thrusters.pulse)")
    if timing.jitter + edges > period / 2:
        rule = f"must be at most half of the period of {period:g} s, with rise_s and fall_s added"
        raise ScenarioError("timing.jitter_s", timing.jitter + edges, rule)
    placed = table.pulse if table.pulse in ("start", "staggered") else ""
    fine = table.resolution == "continuous" and table.impulse_bit_N_s > 0
    timing = replace(timing, fine=fine, pulse_thrust=fired, pulse_place=placed, carried_impulse=carried)
    timing = replace(timing, edge=max(table.rise_s, table.fall_s))
    return system if timing == Delays() else predicting(system, timing, period)


def _require_whole(thrusters: ThrustersTable, limits: Array, period: float, faults: Sequence[Fault]) -> None:
    """Refuse pulses whose nearest multiple of the bit may be more than full thrust makes in a period."""
    bit, table = thrusters.impulse_bit_N_s, thrusters
    fits = table.directions is not None and table.pulse == "staggered"  # bits are counted in `in_turn`
    if not bit or table.pulse == "held" or (table.remainder, table.resolution) != ("dropped", "bit") or fits:
        return
    for limit in np.outer(strengths(faults), limits).ravel() * period:
        if np.floor(limit / bit + 0.5 + 1e-9) * bit > limit * (1 + 1e-9):
            rule = f"must not round up the impulse of full thrust in a period, {limit:.6g} N s: choose a bit"
            rule += " that divides it, or thrusters.remainder = 'carried'"
            raise ScenarioError("thrusters.impulse_bit_N_s", bit, rule)


def allocation(thrusters: ThrustersTable | None, faults: Sequence[Fault], u_max: Array) -> Allocation | None:
    """Return the allocation of inputs to thrusters in every fault; None where nothing is said of them."""
    failed = [fault for fault in (fault.build() for fault in faults) if fault.left < 1]
    directions, limits = (thrusters.directions, thrusters.thrust_max_N) if thrusters else (None, None)
    if (directions is None) != (limits is None):
        rule = "must be given together"
        raise ScenarioError("thrusters.directions, thrust_max_N", (directions, limits), rule)
    if directions is None or limits is None:
        if thrusters is not None and thrusters.allocation != MIXES:
            raise ScenarioError("thrusters.allocation", thrusters.allocation, "needs thrusters.directions")
        return Allocation.from_directions(*axis_pairs(u_max), u_max, failed) if failed else None
    largest = per_axis("thrusters.thrust_max_N", limits, len(directions))
    return Allocation.from_directions(
        np.array(directions), largest, u_max, failed, thrusters.allocation if thrusters else MIXES
    )


def transients(
    faults: Sequence[Fault],
    allocation: Allocation | None,
    gains: Sequence[Array],
    networks: Sequence[Array],
    boxes: bool,
    times: int,
) -> tuple[Transient, ...]:
    """Return the transients of late faults, by gains of laws and networks; `boxes`: with black boxes.

    Thrusters push `times` as hard as their limits say, where one at a time has power.
    """
    feedback = np.max(np.abs(gains), axis=0), boxes, np.max(networks, axis=0) if len(networks) else None
    late = []
    for fault in (fault.build() for fault in faults):
        thrust = np.zeros((0, gains[0].shape[0]))
        if fault.left < 1 and allocation is not None:
            thrust = allocation.directions * allocation.limits[:, None] * times
        if fault.isolation > 0:
            late.append(Transient(fault.name, fault.isolation, thrust, 1 - fault.left, *feedback))
    return tuple(late)


class GoalOrbit(ScenarioPart):
    """The goal of the schedule, along the reference."""

    kind: Literal["goal"] = unit("-", "The goal of the schedule.")


Orbit = Annotated[GoalOrbit | EllipticalNMTGoal | LinearNMTGoal | StationaryGoal, *BY_KIND]


class AbortTable(ScenarioPart):
    """Aborts at any instant until T: passive (the drift stays clear), or powered (S reaches an orbit)."""

    drift_orbits: f.Real | None = unit("-", default=None, gt=0, le=100)
    """Duration of the disturbed drift in orbits. Hill's frame only."""
    drift_s: f.Positive | None = unit("s", default=None)
    """Its duration as a time, instead."""
    required: f.Flag = unit("-", default=False)
    """Accept only schedules with aborts from all steps; otherwise exit code 3, or 4 if only the budget is
    exceeded. `false`: report the steps."""
    keep_in: f.Flag = unit("-", "The drift must also stay inside keep-in sets.", default=True)
    orbit: Orbit | None = unit("-", default=None)
    """Target of powered aborts."""
    within_s: f.Positive | None = unit("s", default=None)
    """Longest time from the abort to the orbit; required for another orbit."""
    delta_v_max_m_s: f.Positive | None = unit("m/s", "Delta-v budget of a powered abort.", default=None)

    def check(self, system: LinearSystem, step: float) -> None:
        """Refuse isolation that takes too long, and combinations that are not covered."""
        drift, within = self.build(system), self.within_s
        self.powered(system)
        if drift is not None and drift.cells(step) > MAX_STEPS:
            durations = self.drift_orbits, self.drift_s
            raise ScenarioError("abort", durations, f"must be at most {MAX_STEPS} steps of {step:g} s")
        if within is not None and not 2 * step <= within <= MAX_STEPS * step:
            rule = f"must be at least two steps of {step:g} s, and at most {MAX_STEPS}"
            raise ScenarioError("abort.within_s", within, rule)

    def powered(self, system: LinearSystem) -> PoweredAbort | None:
        """Return the requirement on an abort with thrust; None if there is none."""
        if self.orbit is None:
            limit = self.within_s or self.delta_v_max_m_s
            if limit is not None:
                raise ScenarioError("abort", limit, "must have an orbit with within_s or delta_v_max_m_s")
            return None
        orbit = None if isinstance(self.orbit, GoalOrbit) else self.orbit
        if orbit is not None and self.within_s is None:
            raise ScenarioError("abort.within_s", None, "must be given unless the orbit is the goal")
        abort = PoweredAbort(None, None, self.within_s, self.delta_v_max_m_s, self.required)
        if orbit is None:
            return abort
        distance, speed = orbit.tolerance_m, orbit.velocity_tolerance_m_s
        return replace(abort, goal=orbit.build(system), tolerance=distance, velocity_tolerance=speed)

    def build(self, system: LinearSystem) -> AbortOptions | None:
        """Return the requirement on the drift; None if there is none."""
        if self.drift_orbits is None and self.drift_s is None and self.orbit is not None:
            return None
        if (self.drift_orbits is None) == (self.drift_s is None):
            durations = self.drift_orbits, self.drift_s
            raise ScenarioError("abort", durations, "must have one of drift_orbits and drift_s, or an orbit")
        horizon = self.drift_s
        if self.drift_orbits is not None:
            if system.mean_motion is None:
                rule = "needs Hill's frame (system.kind = 'clohessy_wiltshire'); give drift_s"
                raise ScenarioError("abort.drift_orbits", self.drift_orbits, rule)
            horizon = self.drift_orbits * 2 * np.pi / system.mean_motion
        assert horizon is not None
        return AbortOptions(float(horizon), self.required, self.keep_in)


class Tank(ScenarioPart):
    """Propellant, for which a run reports how long S can fly on; it limits powered aborts, too."""

    delta_v_m_s: f.Positive = unit("m/s")
    """Available delta-v from the start on, summed over axes."""


class Chaser(ScenarioPart):
    """Size of the chaser, added to every unsafe set."""

    radius_m: f.NonNegative = unit("m")
    """Radius of a ball about the navigated point that contains the chaser. Reported distances are from its
    surface."""
