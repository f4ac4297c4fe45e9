"""The one list of sources of uncertainty, and the loop of a craft that they extend."""

from dataclasses import astuple
from functools import reduce

import numpy as np

from ...certificate.assumptions import Assumptions
from ...model.craft import Craft
from ..tracker.loop import Loop
from .delay import Delay
from .disturbance import Bias, Disturbance
from .estimate import Estimate
from .impulse_bit import CarriedImpulse, ImpulseDrift
from .observer import Filter
from .pulses import PulseLead
from .source import Source
from .thrusters import ThrusterErrors

SOURCES = (
    Delay,
    CarriedImpulse,
    Filter,
    Estimate,
    Disturbance,
    Bias,
    ImpulseDrift,
    ThrusterErrors,
    PulseLead,
)
"""In the order in which they extend a loop: navigation carries what came before it. Faults that are isolated
late act once in a flight and extend none (`late_faults`)."""


def sources(system: Craft, h: float) -> tuple[Source, ...]:
    """Return the sources that a system declares, its law renewed every h [s], in the order of `SOURCES`."""
    kinds: tuple[type[Source], ...] = SOURCES
    return tuple(source for kind in kinds if (source := kind.from_system(system, h)) is not None)


def craft_loop(system: Craft, h: float) -> Loop:
    """Build the loop of a craft whose law is renewed every h [s].

    Errors of navigation that depend on the step of the flight count with their least (`step_errors`).
    """
    plain = Loop.from_plant(system.A, system.B, h)
    return reduce(lambda loop, source: source.extend(loop), sources(system, h), plain)


def assumed(system: Craft, h: float) -> Assumptions:
    """Return the assumptions on a system and on all its sources, with a law renewed every h [s]."""
    prompt, observer, each = system.without_delay, system.observer, system.nozzles or system.on_time
    return Assumptions(
        system.w_max,
        h,
        bias=system.bias.tolist(),
        estimate=prompt.navigation.tolist(),
        by_step=system.error_by_step is not None,
        observer=() if observer is None else observer.noise.tolist(),
        initial=() if observer is None or observer.initial is None else observer.initial.tolist(),
        constant=() if observer is None or observer.constant is None else observer.constant.tolist(),
        timing=astuple(system.timing)[:4],
        thrusters=(each.along, each.across, getattr(each, "mass", 0.0), float(np.max(system.on_time.bit))),
        same_shares=system.on_time.constant,
        pulses=system.timing.pulse_thrust,
        placed=system.timing.pulse_place,
        edge=system.timing.edge,
        fine=system.timing.fine,
        carried=system.timing.carried_impulse,
        layout="" if system.nozzles is None else system.nozzles.allocation.kind,
        late=[(fault.name, fault.lasts) for fault in system.transients],
        position=system.position.tolist(),
    )
