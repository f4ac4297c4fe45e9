"""What is worth a note in a valid scenario, and may be a mistake."""

import numpy as np
from scipy.linalg import expm

from ..model.system import LinearSystem
from .base import Scenario
from .schedule import ScheduleScenario

FAR = 1.0  # times its own size that a scene is crossed in one step at full thrust: worth a note

MANY_STEPS = 2000  # steps from which a run takes hours rather than minutes: worth a note

FASTEST_ORBIT = 1.25e-3  # mean motion [rad/s] of a circular orbit at the Earth's surface, rounded up


def doubts(scenario: Scenario) -> list[str]:
    """What a user may want to look at again before a long run of a valid scenario, one sentence each."""
    if not isinstance(scenario, ScheduleScenario):
        return []
    system, step, steps = scenario.system(), scenario.step, scenario.steps
    motion = system.mean_motion or 0.0
    (push, shove), size = _pushed(system, step), _size(scenario, system)
    notes = {
        f"horizon: {steps} steps of {step:g} s; planning and sets grow with the number of steps, and bundled"
        " scenes have 60: longer steps, or a shorter flight?": steps > MANY_STEPS,
        f"system.mean_motion_rad_s: {motion:g} rad/s is faster than any orbit of the Earth (at most"
        f" {FASTEST_ORBIT:g}): revolutions per day, or degrees?": motion > FASTEST_ORBIT,
        "disturbance: none, so that a proof holds for a flight that obeys the model exactly; was it"
        " forgotten, or D left at zero?": system.w_max == 0 or not np.any(system.D),
        f"thrust: full thrust moves the chaser {push:.3g} m in one step of {step:g} s, and the scene is"
        f" {size:.3g} m wide: another unit (mN, not N; m, not km), or shorter steps?": push > FAR * size > 0,
        f"disturbance: it moves the chaser up to {shove:.3g} m in one step, and full thrust no more than"
        f" {push:.3g} m: another unit?": shove > push > 0,
    }
    return [note for note, holds in notes.items() if holds]


def _pushed(system: LinearSystem, step: float) -> tuple[float, float]:
    """How far [m] full thrust, and the disturbance, held over one step move the position along an axis."""
    inputs = np.hstack([system.B, system.D])
    block = np.zeros((system.n + inputs.shape[1],) * 2)
    block[: system.n, : system.n], block[: system.n, system.n :] = system.A, inputs
    with np.errstate(over="ignore", invalid="ignore"):
        held = np.abs(system.position @ expm(block * step)[: system.n, system.n :])
    held = np.nan_to_num(held, nan=np.inf)
    push, shove = held[:, : system.m], held[:, system.m :]
    return float((push @ system.u_max).max()), float(np.linalg.norm(shove, axis=1).max() * system.w_max)


def _size(scenario: ScheduleScenario, system: LinearSystem) -> float:
    """Largest distance [m] between the start, the frame's origin and the obstacles; 0 if there is none."""
    origin = np.zeros(system.d)
    places = [origin, system.position @ scenario.initial_set().c]
    for unsafe in scenario.obstacles():
        at = np.asarray(unsafe.centre(0.0, system), dtype=float)
        if np.all(np.isfinite(at)):
            places.append(at)
    return max(float(np.linalg.norm(one - other)) for one in places for other in places)
