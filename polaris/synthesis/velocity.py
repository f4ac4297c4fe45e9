"""Velocity change of a schedule before it is flown: along the middle of its tubes, and at most."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from ..model.tolerances import ROUNDING
from .controllers import AffineController, Controller, TubeSegment


def velocity_change(law: Controller, tube: TubeSegment, k: int, delta: float) -> tuple[float, float]:
    """Integral of the 1-norm of the thrust over a step [N s]: along the middle of a tube, and at most.

    A controller of which only the thrust limits are known is charged all of them.
    """
    if not isinstance(law, AffineController):
        limit = getattr(law, "system", None)
        tops = None if limit is None else limit.u_max + limit.thrusters.error(limit.u_max)
        most = np.inf if tops is None else float(np.sum(tops)) * delta
        return most, most
    u_max = law.system.u_max
    centre, spread = law.commanded(tube.nodes - law.offset[k], tube.bow, k)
    middle = np.minimum(np.abs(centre), u_max)
    spread = spread + law.system.command_error(law.gain)
    highest = np.minimum((np.abs(centre) + spread) * (1 + ROUNDING), u_max)
    highest = highest + law.system.thrusters.error(highest)
    h = delta / (len(centre) - 1)
    held = middle[:-1] if law.feedback.sampled else (middle[:-1] + middle[1:]) / 2
    return float(held.sum()) * h, float(np.maximum(highest[:-1], highest[1:]).sum()) * h


def of_steps(
    steps: Iterable[tuple[Controller, TubeSegment]], delta: float, mass: float
) -> tuple[float, float]:
    """Velocity change over steps [m/s]: along the middle of the tubes, and at most, for any flight."""
    parts = [velocity_change(law, tube, k, delta) for k, (law, tube) in enumerate(steps)]
    middle, most = np.sum(np.reshape(parts, (-1, 2)), axis=0) / mass
    return float(middle), float(most) * (1 + ROUNDING)
