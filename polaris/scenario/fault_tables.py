"""The scenario file's models of faults of thrusters."""

from __future__ import annotations

from typing import Annotated, Literal

from ..model.allocation import Fault as Failed
from . import fields as f
from .fields import ScenarioPart, unit


class StuckOff(ScenarioPart):
    """Any one thruster gives nothing, from any time on. It is known at once, and the others are allocated."""

    kind: Literal["stuck_off"] = unit("-", "A thruster that does not open.")

    def build(self) -> Failed:
        """What is left of the thruster."""
        return Failed("stuck_off", 0.0)


class Loss(ScenarioPart):
    """Any one thruster loses a share of its thrust, from any time on. It is known at once."""

    kind: Literal["loss"] = unit("-", "A thruster that is weaker than it was.")
    share: f.Real = unit("-", "Share of its thrust that is lost.", gt=0, lt=1)

    def build(self) -> Failed:
        """What is left of the thruster."""
        return Failed("loss", 1 - self.share)


Fault = Annotated[StuckOff | Loss, *f.BY_KIND]
