"""What is measured on a trace."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..model.system import Array
from ..runs.tables import strict


def weights(t: Array) -> Array:
    """Weight of every sample in a mean over time (trapezoidal), shape (N,); they add up to 1.

    Samples of a trace that takes no time weigh the same.
    """
    gaps = np.diff(t)
    total = np.r_[gaps, 0.0] + np.r_[0.0, gaps]
    return np.asarray(total / total.sum() if total.sum() > 0 else np.full(len(t), 1 / len(t)))


@dataclass(frozen=True)
class Spread:
    """A quantity over the samples of a trace.

    Attributes
    ----------
    min, mean, max : float
        The mean is over time (trapezoidal); inf as soon as one value is.
    at : float
        When the least value was reached first [s]; nan if it is inf throughout.
    share : float
        Share of the time with a finite value.
    """

    min: float
    mean: float
    max: float
    at: float
    share: float

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
    """One agent against one unsafe set, or another agent.

    Attributes
    ----------
    name, kind : str
        Of the set; the kind of another agent is ``agent``.
    distance : Spread or None
        Signed distance [m], negative inside; None if the two were never there at the same time.
    ttc : Spread or None
        Time to collision [s] along a straight ray; None if a velocity is not known.
    drift_ttc : Spread or None
        The same along free drift; None if no system is given.
    """

    name: str
    kind: str
    distance: Spread | None
    ttc: Spread | None
    drift_ttc: Spread | None = None


@dataclass(frozen=True)
class AgentMetrics:
    """Metrics of one agent.

    Attributes
    ----------
    samples : int
        Rows of its trace.
    duration : float
        From the first stamp to the last [s].
    velocity : str
        Where its velocity comes from.
    unsafe, others : tuple of Separation
        Against every unsafe set, and every other agent.
    usage : dict
        Share of time per mode: normal, untrusted, safety, unknown.
    switches : int
        Changes of a known mode inside the run.
    running_times : tuple of float, or None
        Mean, largest and smallest wall time of a decision [s].
    """

    samples: int
    duration: float
    velocity: str
    unsafe: tuple[Separation, ...]
    others: tuple[Separation, ...]
    usage: dict[str, float]
    switches: int
    running_times: tuple[float, float, float] | None


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
        agents = {name: _plain(agent) for name, agent in self.agents.items()}
        out: dict[str, Any] = strict({"dims": self.dims, "agents": agents, "notes": list(self.notes)})
        return out


def _plain(agent: AgentMetrics) -> dict[str, Any]:
    spent = agent.running_times
    return {
        "samples": agent.samples,
        "duration_s": agent.duration,
        "velocity": agent.velocity,
        "unsafe": {item.name: _separation(item) for item in agent.unsafe},
        "agents": {item.name: _separation(item) for item in agent.others},
        "usage": agent.usage,
        "switches": agent.switches,
        "running_time_s": None if spent is None else dict(zip(("mean", "max", "min"), spent, strict=True)),
    }


def _separation(item: Separation) -> dict[str, Any]:
    spreads = {"distance_m": item.distance, "ttc_s": item.ttc, "drift_ttc_s": item.drift_ttc}
    return {"kind": item.kind} | {key: None if of is None else vars(of) for key, of in spreads.items()}
