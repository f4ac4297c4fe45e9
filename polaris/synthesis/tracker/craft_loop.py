"""Loop of a craft as its system declares it: tracking error, delay, observer, and every channel."""

from functools import partial

import numpy as np
from scipy.linalg import expm

from ...model.prediction import between_nodes
from ...model.system import LinearSystem
from ...model.thrusters import Thrusters
from ..sources.delay import Delay
from ..sources.disturbance import Disturbance
from ..sources.estimate import Estimate
from ..sources.impulse_bit import CarriedImpulse
from ..sources.observer import Filter
from ..sources.thrusters import ThrusterErrors
from .loop import Array, Channel, Loop


def remembers(system: LinearSystem) -> bool:
    """Return True if delay and observer are states of the loop, False if a box stands for the estimate.

    A box it is where any of several patterns of measurements may be met, and beside faults.
    """
    late, by_phase = system.timing.delay > 0, system.error_by_step is not None and system.observer is None
    return not (system.timing.missed or system.transients or (late and by_phase))


def craft_loop(system: LinearSystem, h: float) -> Loop:
    """Build the loop of a craft whose law is renewed every h [s].

    Errors of navigation that depend on the step of the flight count with their least (`step_errors`).
    """
    loop, known = Loop.of(system.A, system.B, h), system.calmest
    if not remembers(system):
        loop = _estimated(loop, known, system.timing.hidden)
    else:
        away = system.displaced_at_nodes - system.carried_away
        if any(system.timing.pulsed):
            away = away + between_nodes(system.timing, h) * np.array(system.timing.pulsed)
        loop, seen = Delay(system.timing.delay).extend(loop), system.observer
        if system.timing.carried:
            loop = CarriedImpulse(system.timing.carried, system.thrusters.along).extend(loop)
        if seen is not None:
            noise = seen.noise + np.abs(seen.measures) @ away
            loop = Filter(seen.measures, noise, seen.gain).extend(loop)
        elif system.timing.delay > 0:
            loop = Estimate(np.array(system.timing.measured) + away).extend(loop)
        elif np.any(known.navigation):
            loop = Estimate(np.maximum(known.navigation - system.carried_away, 0.0)).extend(loop)
    loop = Disturbance(system.D, system.w_max).extend(loop)
    if system.timing.carried and not remembers(system):
        drift = system.adrift
        loop = loop.with_channels(Channel("carried impulse", np.ones(drift.shape[1]), rate=drift))
    return ThrusterErrors(system.thrusters).extend(loop)


def _estimated(loop: Loop, known: LinearSystem, lag: int) -> Loop:
    """Add estimates within a box that grows with the commands of some periods before."""
    least = known.estimate_off(np.zeros(known.m))
    if np.all(known.estimate_off(known.u_max) == least):
        return Estimate(least).extend(loop) if np.any(least) else loop
    unseen = np.array(known.timing.unseen)
    grows = Channel(
        "estimate",
        least,
        noise=loop.carry,
        share=partial(_grown, thrusters=known.thrusters, unseen=unseen),
        lag=lag,
    )
    return loop.with_channels(grows)


def _grown(u: Array, thrusters: Thrusters, unseen: Array) -> Array:
    """Bounds on what commands u (..., m) add to errors of estimates until it is measured, (..., n)."""
    return np.asarray(thrusters.part(u) @ unseen.T)


def step_errors(system: LinearSystem) -> Array:
    """Bounds on what estimates are off by in each step, and ever after, beside the loop's own, (K + 1, n)."""
    if system.error_by_step is None:
        return np.zeros((1, system.n))
    if remembers(system) and system.observer is not None and system.observer.fading is not None:
        carried = (
            np.abs(expm(system.A * system.timing.delay)) if system.timing.delay > 0 else np.eye(system.n)
        )
        return np.asarray(system.observer.fading @ carried.T)
    return np.asarray(system.error_by_step - system.error_by_step.min(axis=0))
