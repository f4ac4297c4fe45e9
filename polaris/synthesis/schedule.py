"""The result of Algorithm 2: modes per step, tubes, margins, and what is guaranteed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import astuple, dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from reach.sets.zonotope import Zonotope

from ..certificate.assumptions import assumptions
from ..model.obstacle import chaser_radius
from ..model.satellite import SatelliteObstacle
from ..model.system import Array
from .arrival import Arrival, arrival
from .controllers import Controller, TubeSegment
from .get_safety import Safety
from .recoverable import Margin
from .velocity import of_steps


@dataclass(frozen=True, eq=False)
class Step:
    """One step of the schedule.

    Attributes
    ----------
    mode : int
        0 is S, 1, 2, ... the experimental controllers.
    tube : TubeSegment
        Reachable set over the step, in error coordinates.
    margin : Margin
        How far it is inside the recoverable sets. Steps under S need no margin: from a recoverable
        set S stays safe to the end.
    """

    mode: int
    tube: TubeSegment
    margin: Margin


@dataclass(frozen=True, eq=False)
class Schedule:
    """A switching schedule L with everything its proof rests on.

    Attributes
    ----------
    safety : Safety
        What it was made from.
    controllers : tuple of Controller
        Indexed by mode.
    steps : tuple of Step
        One per planning step.
    final : Zonotope
        Set of errors at T.
    guarantee : {"proved", "none"}
        Whether safety is proven; how far the claim reaches is in ``safety.end``.
    assumptions : tuple of str
        What the guarantee rests on, for a mission to discharge.
    seconds : mapping
        Wall time of the synthesis by stage.
    """

    safety: Safety
    controllers: tuple[Controller, ...]
    steps: tuple[Step, ...]
    final: Zonotope
    guarantee: str
    assumptions: tuple[str, ...]
    seconds: Mapping[str, float] = field(default_factory=dict)

    @cached_property
    def modes(self) -> NDArray[np.int_]:
        """Mode of every step, shape (K,)."""
        return np.array([step.mode for step in self.steps], dtype=int)

    @property
    def times(self) -> Array:
        """Start of every step, and T [s], shape (K+1,)."""
        return np.asarray(np.arange(len(self.steps) + 1) * self.safety.problem.delta, dtype=float)

    @property
    def switches(self) -> int:
        """Number of changes of mode inside the horizon."""
        return int(np.count_nonzero(np.diff(self.modes)))

    @cached_property
    def delta_v(self) -> tuple[float, float]:
        """Velocity change until T [m/s]: along the middle of the tubes, and proven never to be exceeded."""
        problem = self.safety.problem
        steps = ((self.controllers[step.mode], step.tube) for step in self.steps)
        return of_steps(steps, problem.delta, problem.system.mass)

    @cached_property
    def arrival(self) -> Arrival:
        """Whether and by when the goal is proven reached."""
        return arrival(self.safety, self.final, self.delta_v[1])

    def share(self, mode: int | None = None) -> float:
        """Share of time under one mode; without one, under any experimental controller."""
        flying = self.modes > 0 if mode is None else self.modes == mode
        return float(np.mean(flying))

    def mode_at(self, t: float) -> int:
        """The switching logic L(t): mode at a time t [s], at a switch the new one; S after T."""
        k = int(np.floor(t / self.safety.problem.delta + 1e-12))
        return int(self.modes[k]) if 0 <= k < len(self.modes) else 0

    @property
    def margins(self) -> Array:
        """Containment margin of every step, shape (K,); see `polaris.synthesis.recoverable.Margin`.

        The proof needs it to be at least 0 under an experimental controller only. Under S it may be
        negative: the set reached is enclosed afresh at every node, and S, once it has taken over from a
        recoverable set, is safe whatever that enclosure says.
        """
        return np.array([step.margin.value for step in self.steps])


def assumed(safety: Safety) -> list[str]:
    """What run and certificate both rest on, in words."""
    problem, tracking, cells = safety.problem, safety.tracking, safety.reference.cells
    offsets = [unsafe.offsets[:cells] for unsafe in safety.clearance.unsafe]
    return assumptions(
        problem.system.w_max,
        problem.delta / safety.clearance.q if tracking.feedback.sampled else None,
        resting=any(bool(np.all(b == b[0, 0])) for b in offsets),
        satellites=any(isinstance(unsafe, SatelliteObstacle) for unsafe in problem.unsafe),
        horizon=safety.end.horizon,
        until=safety.end.until if np.isfinite(safety.end.until) else None,
        estimate=problem.system.navigation.tolist(),
        thrusters=astuple(problem.system.thrusters),
        chaser=chaser_radius(problem.unsafe),
    )


def assumptions_of(safety: Safety) -> tuple[str, ...]:
    """What a schedule's guarantee rests on; how far it reaches is in `Safety.end`."""
    return *assumed(safety), "arithmetic: in double precision, its round-off covered by booked tolerances"
