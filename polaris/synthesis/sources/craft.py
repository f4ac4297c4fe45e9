"""The one list of sources of uncertainty, and the loop of a craft that they extend."""

from functools import reduce

from ...model.craft import Craft
from ..tracker.loop import Loop
from .delay import Delay
from .disturbance import Disturbance
from .estimate import Estimate
from .impulse_bit import CarriedImpulse, ImpulseDrift
from .observer import Filter
from .source import Source
from .thrusters import ThrusterErrors

SOURCES = (Delay, CarriedImpulse, Filter, Estimate, Disturbance, ImpulseDrift, ThrusterErrors)
"""In the order in which they extend a loop: navigation carries what came before it. Faults that are isolated
late act once in a flight and extend none (`late_faults`)."""


def sources(system: Craft, h: float) -> tuple[Source, ...]:
    """Return the sources that a system declares, its law renewed every h [s], in the order of `SOURCES`."""
    kinds: tuple[type[Source], ...] = SOURCES
    return tuple(source for kind in kinds if (source := kind.of(system, h)) is not None)


def craft_loop(system: Craft, h: float) -> Loop:
    """Build the loop of a craft whose law is renewed every h [s].

    Errors of navigation that depend on the step of the flight count with their least (`step_errors`).
    """
    plain = Loop.of(system.A, system.B, h)
    return reduce(lambda loop, source: source.extend(loop), sources(system, h), plain)
