"""What is measured on a trace."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..model.system import Array
from ..runs.tables import strict


def weights(t: Array) -> Array:
    """Weight of every sample in a mean over time (trapezoidal), shape (N,); they add up to 1."""
    gaps = np.diff(t)
    total = np.r_[gaps, 0.0] + np.r_[0.0, gaps]
    return np.asarray(total / total.sum() if total.sum() > 0 else np.full(len(t), 1 / len(t)))


@dataclass(frozen=True)
class Spread:
    """A quantity over the samples of a trace."""

    min: float
    mean: float  # over time (trapezoidal); inf as soon as one value is
    max: float
    at: float  # when the least value was reached first [s]; nan if it is inf throughout
    share: float  # of the time with a finite value

    @classmethod
    def of(cls, values: Array, t: Array) -> Spread:
        """Of values (N,) at times t (N,), inf among them."""
        finite, weight = np.isfinite(values), weights(t)
        mean = float(np.sum(values * weight)) if finite.all() else np.inf
        when = float(t[np.argmin(values)]) if finite.any() else np.nan
        share = float(np.sum(weight[finite]))
        return cls(float(values.min()), mean, float(values.max()), when, min(share, 1.0))


@dataclass(frozen=True)
class Separation:
    """One agent against one unsafe set, or another agent, whose kind is ``agent``."""

    name: str
    kind: str
    distance: Spread | None  # signed [m], negative inside; None if the two were never there at the same time
    ttc: Spread | None  # time to collision [s] along a straight ray; None if a velocity is not known
    drift_ttc: Spread | None = None  # the same along free drift; None if no system is given

    def _plain(self) -> dict[str, Any]:
        spreads = {"distance_m": self.distance, "ttc_s": self.ttc, "drift_ttc_s": self.drift_ttc}
        return {"kind": self.kind} | {key: None if of is None else vars(of) for key, of in spreads.items()}


@dataclass(frozen=True)
class AgentMetrics:
    """Metrics of one agent."""

    samples: int  # rows of its trace
    duration: float  # from the first stamp to the last [s]
    velocity: str  # where its velocity comes from
    unsafe: tuple[Separation, ...]
    others: tuple[Separation, ...]  # against every other agent
    usage: dict[str, float]  # share of time per mode: normal, untrusted, safety, unknown
    switches: int  # changes of a known mode inside the run
    running_times: tuple[float, float, float] | None  # mean, largest and smallest wall time of a decision [s]

    def _plain(self) -> dict[str, Any]:
        spent = self.running_times
        return {
            "samples": self.samples,
            "duration_s": self.duration,
            "velocity": self.velocity,
            "unsafe": {item.name: item._plain() for item in self.unsafe},
            "agents": {item.name: item._plain() for item in self.others},
            "usage": self.usage,
            "switches": self.switches,
            "running_time_s": spent and dict(zip(("mean", "max", "min"), spent, strict=True)),
        }


@dataclass(frozen=True)
class TraceMetrics:
    """Metrics of a trace.

    Attributes
    ----------
    dims : int or None
        Axes of position.
    agents : dict of str to AgentMetrics
    notes : tuple of str
        What a reader of the numbers should know.
    """

    dims: int | None
    agents: dict[str, AgentMetrics]
    notes: tuple[str, ...]

    def summary(self) -> dict[str, Any]:
        """All numbers as plain data for strict JSON; times to collision that are inf are null."""
        agents = {name: agent._plain() for name, agent in self.agents.items()}
        out: dict[str, Any] = strict({"dims": self.dims, "agents": agents, "notes": list(self.notes)})
        return out
