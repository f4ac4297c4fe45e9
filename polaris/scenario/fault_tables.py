"""The scenario file's models of thrusters one by one, and of their faults."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal

import numpy as np

from ..model.allocation import Allocation, axis_pairs
from ..model.allocation import Fault as Failed
from ..model.errors import ScenarioError
from ..model.system import Array, LinearSystem
from ..model.thrusters import Thrusters as Errors
from . import fields as f
from .error_tables import Thrusters
from .fields import ScenarioPart, unit


class AllocatedThrusters(Thrusters):
    """How far what is applied may be from what is commanded, and which way each thruster pushes."""

    directions: f.Matrix | None = unit("-", default=None)
    """Which way each thruster pushes: for each one number per input (in Hill's frame the direction of its
    thrust). Without it there is one either way along every input."""
    thrust_max_N: f.PositivePerAxis | None = unit("N", default=None)
    """Largest thrust, one number for all thrusters or one each; needed with `directions`. The limits of the
    inputs are then those of the largest box within the system's own, and of its shape, that they make."""

    def build(self, system: LinearSystem, period: float | None) -> Errors:
        """Bounds on the errors of the inputs."""
        if self.directions is not None and (self.magnitude_error > 0 or self.impulse_bit_N_s > 0):
            given, rule = (self.magnitude_error, self.impulse_bit_N_s), "is not covered with directions"
            raise ScenarioError("thrusters.magnitude_error, impulse_bit_N_s", given, rule)
        return super().build(system, period)


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


def allocation(table: AllocatedThrusters | None, faults: Sequence[Fault], u_max: Array) -> Allocation | None:
    """What the thrusters make of inputs in every fault; None where nothing is said of them."""
    directions = None if table is None else table.directions
    limits = None if table is None else table.thrust_max_N
    if (directions is None) != (limits is None):
        rule = "must be given both or neither"
        raise ScenarioError("thrusters.directions, thrust_max_N", (directions, limits), rule)
    if directions is None or limits is None:
        pairs = axis_pairs(u_max)
        return Allocation.of(*pairs, u_max, [fault.build() for fault in faults]) if faults else None
    most = f.per_axis("thrusters.thrust_max_N", limits, len(directions))
    return Allocation.of(np.array(directions), most, u_max, [fault.build() for fault in faults])
