"""The scenario file's models of faults of thrusters and of navigation."""

from typing import Annotated, Literal

from ...model import keys as f
from ...model.allocation import Fault as Failed
from .fields import BY_KIND, ScenarioPart, unit


class StuckOff(ScenarioPart):
    """One thruster fails off at any time; commands are then allocated to the others."""

    kind: Literal["stuck_off"] = unit("-", "A thruster that does not open.")
    isolation_s: f.NonNegative = unit("s", default=0.0)
    """Longest time until isolation, after which S flies with the other thrusters. With 0 the fault is known
    at once, and the schedule continues."""

    def build(self) -> Failed:
        """Return the remaining thruster."""
        return Failed("stuck_off", 0.0, self.isolation_s)


class Loss(ScenarioPart):
    """One thruster loses a share of its thrust at any time."""

    kind: Literal["loss"] = unit("-", "A thruster that is weaker than it was.")
    share: f.Real = unit("-", "Lost share.", gt=0, lt=1)
    isolation_s: f.NonNegative = unit("s", "As with `stuck_off`.", default=0.0)

    def build(self) -> Failed:
        """Return the remaining thruster."""
        return Failed("loss", 1 - self.share, self.isolation_s)


class StuckOn(ScenarioPart):
    """One thruster fails on at any time, with any thrust up to its limit, until its valve is shut."""

    kind: Literal["stuck_on"] = unit("-", "A thruster that does not close, until its valve is shut.")
    isolation_s: f.Positive = unit("s", "Longest time until isolation, after which S flies with the others.")

    def build(self) -> Failed:
        """Return the remaining thruster."""
        return Failed("stuck_on", 0.0, self.isolation_s)


class NavigationLost(ScenarioPart):
    """One outage of measurements: S takes over at once and flies on predictions."""

    kind: Literal["navigation_lost"] = unit("-", "An outage of navigation.")
    lasts_s: f.Real = unit("s", "Longest duration.", gt=0, le=1e4)

    def build(self) -> Failed:
        """Return a fault in which no thruster fails."""
        return Failed("navigation_lost", 1.0, self.lasts_s)


Fault = Annotated[StuckOff | Loss | StuckOn | NavigationLost, *BY_KIND]
