"""The scenario file's models of faults of thrusters and of navigation."""

from typing import Annotated, Literal

from ...model import keys as f
from ...model.allocation import Fault as Failed
from .fields import BY_KIND, ScenarioPart, unit


class StuckOff(ScenarioPart):
    """Any one thruster gives nothing, from any time on, and the others are allocated once that is known."""

    kind: Literal["stuck_off"] = unit("-", "A thruster that does not open.")
    isolation_s: f.NonNegative = unit("s", default=0.0)
    """After how long at the latest S flies, to the end, with the thrusters that are left. If it is 0 the
    fault is known at once, and the schedule goes on."""

    def build(self) -> Failed:
        """Return what is left of the thruster."""
        return Failed("stuck_off", 0.0, self.isolation_s)


class Loss(ScenarioPart):
    """Any one thruster loses a share of its thrust, from any time on."""

    kind: Literal["loss"] = unit("-", "A thruster that is weaker than it was.")
    share: f.Real = unit("-", "Share of its thrust that is lost.", gt=0, lt=1)
    isolation_s: f.NonNegative = unit("s", "As with `stuck_off`.", default=0.0)

    def build(self) -> Failed:
        """Return what is left of the thruster."""
        return Failed("loss", 1 - self.share, self.isolation_s)


class StuckOn(ScenarioPart):
    """Any one thruster pushes with up to all its thrust, from any time on, and then with nothing."""

    kind: Literal["stuck_on"] = unit("-", "A thruster that does not close, until its valve is shut.")
    isolation_s: f.Positive = unit("s", "Until its valve is shut and S flies, to the end, with the others.")

    def build(self) -> Failed:
        """Return what is left of the thruster."""
        return Failed("stuck_on", 0.0, self.isolation_s)


class NavigationLost(ScenarioPart):
    """There is no measurement for some time, once: S takes over at once, and flies on predictions."""

    kind: Literal["navigation_lost"] = unit("-", "An outage of navigation.")
    lasts_s: f.Real = unit("s", "For how long at most.", gt=0, le=1e4)

    def build(self) -> Failed:
        """Return a fault in which no thruster fails."""
        return Failed("navigation_lost", 1.0, self.lasts_s)


Fault = Annotated[StuckOff | Loss | StuckOn | NavigationLost, *BY_KIND]
