"""Warnings about valid but suspicious scenario values: units and scales that seem mixed up."""

import numpy as np
from scipy.linalg import expm

from ..model.scene.state_limits import StateLimit
from ..model.system import LinearSystem
from .base import Scenario
from .mission import MissionScenario
from .schedule import ScheduleScenario

WEAK = 0.5  # largest ratio of what the disturbance and full thrust move the position by
FAR = 1.0  # largest ratio of the distance covered in one step at full thrust to the size of the scene

MANY_STEPS = 2000  # steps above which a run takes hours rather than minutes

ORBITS = 2e-6, 1.25e-3
"""Mean motions [rad/s] of circular orbits of the Earth: slower than the Moon's, and at its surface."""

FAST = 50.0  # largest ratio of the distance that a velocity covers to the length that stands beside it

SHARP, SMALL = 30_000.0, 0.02
"""Largest ratio of the scene's size to the initial set's, least ratio of an unsafe set's size to it."""


def scenario_warnings(scenario: Scenario) -> list[str]:
    """Return warnings about a valid scenario to look at before a long run, one sentence each."""
    if isinstance(scenario, MissionScenario):
        return [f"leg {leg.name}: {note}" for leg in scenario.legs() for note in scenario_warnings(leg)]
    if not isinstance(scenario, ScheduleScenario):
        return []
    system, step, steps = scenario.system(), scenario.step, scenario.steps
    motion = system.mean_motion or 0.0
    (push, shove), size = _step_distances(system, step), _size(scenario, system)
    notes = {
        f"horizon: {steps} steps of {step:g} s take long (bundled scenes have 60 steps); use longer steps or"
        " a shorter flight?": steps > MANY_STEPS,
        f"system.mean_motion_rad_s: {motion:g} rad/s is faster than any orbit of the Earth (at most"
        f" {ORBITS[1]:g}): revolutions per day, or degrees?": motion > ORBITS[1],
        f"system.mean_motion_rad_s: {motion:g} rad/s is slower than the Moon (at least {ORBITS[0]:g}):"
        " another unit?": 0 < motion < ORBITS[0],
        "disturbance: zero, so that the proof covers only flights that obey the model exactly; was it"
        " forgotten, or D left at zero?": system.unbiased.w_max == 0 or not np.any(system.D),
        f"thrust: full thrust moves the chaser {push:.3g} m in one step of {step:g} s, and the scene is"
        f" {size:.3g} m wide: another unit (mN, not N; m, not km), or shorter steps?": push > FAR * size > 0,
        f"disturbance: it moves the chaser up to {shove:.3g} m in one step, and full thrust"
        f" {push:.3g} m: another unit?": shove > WEAK * push > 0,
    }
    return [*(note for note, holds in notes.items() if holds), *_scales(scenario, system, size)]


def _scales(scenario: ScheduleScenario, system: LinearSystem, size: float) -> list[str]:
    """Return warnings about lengths that do not go with the velocities or lengths beside them."""
    period = scenario.step * scenario.steps
    time = min(period, 1 / system.mean_motion) if system.mean_motion else period
    theta, C, V = scenario.initial_set(), system.position, system.velocity
    spreads = {"initial_set": np.abs(theta.G).sum(axis=1)}  # half widths of uncertain states
    speeds = {"initial_set": float(np.linalg.norm(V @ theta.c))}
    lengths = {}
    for path, part in scenario.model.scene_parts():
        if (state := getattr(part, "state", None)) is not None:
            spreads[path] = np.array(getattr(part, "state_half_widths", ()))
            speeds[path] = float(np.linalg.norm(V @ state))
        elif (velocity := getattr(part, "velocity_m_s", None)) is not None:
            speeds[path] = float(np.linalg.norm(velocity))
        if (length := getattr(part, "radius_m", None) or getattr(part, "half_widths_m", None)) is not None:
            lengths[path] = float(np.max(length))
    notes, start = [], float((np.abs(C) @ spreads["initial_set"]).max())
    for path, widths in spreads.items():
        drift, length = float((np.abs(V) @ widths).max()) * time, float((np.abs(C) @ widths).max())
        if drift > FAST * length > 0:
            text = f"its velocities are uncertain by {drift:.3g} m in {time:.4g} s"
            notes.append(f"{path}: {text}, its positions by {length:.3g} m only: m, not km?")
    for path, speed in speeds.items():
        if speed * time > FAST * size > 0:
            text = f"{speed:.3g} m/s covers {speed * time:.3g} m in {time:.4g} s"
            notes.append(f"{path}: {text}, and the scene is {size:.3g} m wide: m, not km?")
    for path, length in lengths.items():
        if length < SMALL * start:
            text = f"is {length:.3g} m in size, and the initial position is uncertain by {start:.3g} m"
            notes.append(f"{path}: it {text}: m, not km?")
    if 0 < SHARP * start < size:
        text = f"is known to {start:.3g} m in a scene of {size:.3g} m"
        notes.append(f"initial_set: the position {text}: m, not km?")
    return notes


def _step_distances(system: LinearSystem, step: float) -> tuple[float, float]:
    """Return the distances [m] that full thrust, and the disturbance, move the position in one step."""
    inputs = np.hstack([system.B, system.D])
    block = np.zeros((system.n + inputs.shape[1],) * 2)
    block[: system.n, : system.n], block[: system.n, system.n :] = system.A, inputs
    with np.errstate(over="ignore", invalid="ignore"):
        response = np.abs(system.position @ expm(block * step)[: system.n, system.n :])
    response = np.nan_to_num(response, nan=np.inf)
    push, shove = response[:, : system.m], response[:, system.m :] * system.unbiased.w_max
    return float((push @ system.u_max).max()), float(np.linalg.norm(shove, axis=1).max())


def _size(scenario: ScheduleScenario, system: LinearSystem) -> float:
    """Largest distance [m] between the start, the frame's origin and the obstacles; 0 if there is none."""
    places = [np.zeros(system.d), system.position @ scenario.initial_set().c]
    for unsafe in scenario.obstacles():
        if isinstance(unsafe, StateLimit):
            continue
        at = np.asarray(unsafe.centre(0.0, system), dtype=float)
        if np.all(np.isfinite(at)):
            places.append(at)
    return max(float(np.linalg.norm(one - other)) for one in places for other in places)
