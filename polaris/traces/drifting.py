"""Time to collision of a trace's agents along free drift."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..model.errors import ScenarioError
from ..model.free_drift import drift_ttc
from ..model.shapes import Shape
from ..model.system import Array, LinearSystem
from ..simulation.run_metrics import drift_horizon
from .model import AgentTrace, Trace
from .placing import Part, Placed

MOST_SAMPLES = 200
"""Samples of one agent from which free drift is followed."""

TOLERANCE = 0.05
"""Passes less deep [m] than this may be missed."""


@dataclass(frozen=True, eq=False)
class Moving:
    """A part of a set at some times, as `polaris.model.free_drift.drift_ttc` asks for it."""

    name: str
    shape: Shape
    centre: Array
    velocity: Array

    def relative_drift(
        self, t: ArrayLike, x: Array, system: LinearSystem, state: ArrayLike | None = None
    ) -> tuple[Array, Array, Array]:
        """See `polaris.model.obstacle.Obstacle.relative_drift`."""
        return x, self.centre, self.velocity


class Drift:
    """Free drift of the agents of a trace under one system.

    Raises
    ------
    ScenarioError
        If the states of an agent are not those of the system.
    """

    def __init__(self, trace: Trace, system: LinearSystem, d: int | None) -> None:
        for name, agent in trace.agents.items():
            if agent.n != system.n:
                place = f"agents.{name}.state_trace[0]"
                rule = f"must be the {system.n} states of the system that drifts (--mean-motion)"
                raise ScenarioError(place, f"{agent.n} states", rule)
        if d is not None and not np.array_equal(system.position, np.eye(d, system.n)):
            given = f"{d} axes of position"
            raise ScenarioError("--dims", given, "must be the first states of the system that drifts")
        longest = max(float(np.ptp(agent.times)) for agent in trace.agents.values())
        self.system = system
        self.horizon = drift_horizon(system, longest)
        if not self.horizon > 0:
            raise ScenarioError("system", longest, "a trace that takes no time gives free drift no horizon")

    @property
    def note(self) -> str:
        """What a reader should know."""
        return (
            f"free drift looks {self.horizon:.6g} s ahead, from at most {MOST_SAMPLES} samples of each agent"
        )

    def entry_times(self, agent: AgentTrace, placed: Placed) -> tuple[NDArray[np.int64], Array]:
        """Samples chosen, evenly over the rows, and seconds from each until drift enters; inf if never."""
        count = len(agent.times)
        chosen = np.unique(np.linspace(0, count - 1, min(count, MOST_SAMPLES)).round().astype(np.int64))
        found = [self._part(agent, part, chosen) for part in placed.parts]
        return chosen, np.asarray(np.min(found, axis=0))

    def _part(self, agent: AgentTrace, part: Part, chosen: NDArray[np.int64]) -> Array:
        groups = [chosen] if part.rigid else [chosen[i : i + 1] for i in range(len(chosen))]
        out = []
        for rows in groups:
            body = Moving("set", part.shape(int(rows[0])), part.centre[rows], part.velocity[rows])
            t, x = agent.times[rows], agent.states[rows]
            out.append(drift_ttc([body], self.system, t, x, self.horizon, tolerance=TOLERANCE)[0])
        return np.concatenate(out)
