"""The paper's Monte Carlo: flights of a block of runs under one filter, and what comes of each."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reach.short_repr import short_repr

from ...model.system import Array
from ...rta.projection import SHORT
from ..constraints.allowable_set import allowable
from ..constraints.constraint import CONSTRAINTS
from ..constraints.families import Families
from .evaluation import keepers
from .simulation import BatchFilter, BatchStep, FlightBatch, Observer, fly

BETWEEN = 1  # instants inside each period at which the constraints are looked at too
NEAR = 60.0
"""Closest approaches in free flight [m] up to which they are told exactly; beyond, a lower bound is told."""


@short_repr
@dataclass(frozen=True, eq=False)
class BlockOutcome:
    """Results of R runs under one filter.

    Attributes
    ----------
    columns : mapping of str to ndarray, shape (R,)
        ``success`` (no constraint became negative and every program had a solution); ``short_s``, when a
        program first had no solution [s], nan if all had, and ``short_deputies``, whose that was;
        ``interventions_share`` of the inputs (deputies and periods) that were changed; ``delta_v_0_m_s``
        and so on, spent by each deputy; ``least_phi1``, ``time_phi1_s`` and ``deputies_phi1`` and so on, the
        least value over the run, samples and between them, when [s] and for whom (as in ``0 3``). nan or
        empty for constraints that the filter leaves out.
    """

    columns: Mapping[str, Any]

    @property
    def least(self) -> dict[str, Array]:
        """Least value of each constraint that is judged, shape (R,)."""
        minima = {name[6:]: values for name, values in self.columns.items() if name.startswith("least_")}
        return {name: values for name, values in minima.items() if not np.isnan(values).all()}

    @property
    def success(self) -> NDArray[np.bool_]:
        """Runs in which no constraint became negative and every program had a solution, shape (R,)."""
        return np.asarray(self.columns["success"])

    @property
    def delta_v(self) -> Array:
        """Spent velocity change [m/s], shape (R, N)."""
        return np.stack([self.columns[name] for name in self.columns if name.startswith("delta_v_")], axis=1)

    def failures(self) -> list[dict[str, Any]]:
        """Every failure: run, kind, deputies, time [s], value (nan for a program without solution)."""
        columns, short = self.columns, self.columns["short_s"]
        none = np.full(len(short), np.nan)
        rows = [("no solution", ~np.isnan(short), columns["short_deputies"], short, none)]
        rows += [
            (name, least < 0, columns[f"deputies_{name}"], columns[f"time_{name}_s"], least)
            for name, least in self.least.items()
        ]
        return [
            {
                "run": run,
                "what": kind,
                "deputies": tuple(map(int, deputies[run].split())),
                "time": float(time[run]),
                "value": float(value[run]),
            }
            for run in np.flatnonzero(~self.success).tolist()
            for kind, failed, deputies, time, value in rows
            if failed[run]
        ]


class Recorder:
    """Observer of `fly` that judges all runs by the constraints that the families keep."""

    def __init__(self, flights: FlightBatch, families: Families) -> None:
        runs, N = flights.x.shape[:2]
        self.flights, self.families, self.keepers = flights, families, keepers(families, runs)
        self.short, self.short_deputies = np.full(runs, np.nan), [""] * runs
        self.changed, self.delta_v, self.steps = np.zeros(runs), np.zeros((runs, N)), 0

    def __call__(self, step: BatchStep) -> None:
        """Take in one control period."""
        q, period = self.flights.inspection, self.flights.period
        states, status = (step.x, *step.after[:-1]), step.filtered.status
        for b, x in enumerate(states):
            t = step.t + period * b / len(states)
            self.judge(x, step.sun - q.mean_motion * (t - step.t), t)
        for run in np.flatnonzero((status >= SHORT).any(axis=1) & np.isnan(self.short)):
            self.short[run] = step.t
            self.short_deputies[run] = " ".join(map(str, np.flatnonzero(status[run] >= SHORT)))
        self.changed += (status > 0).mean(axis=1)
        self.delta_v += np.abs(step.filtered.u).sum(axis=2) * (period / q.mass)
        self.steps += 1

    def judge(self, x: Array, sun: Array, t: float) -> None:
        """Look at all constraints, phi7 and phi8 included, at one instant."""
        q = self.flights.inspection
        values = allowable(q, x, sun)
        if {"phi7", "phi8"} & self.keepers.keys():
            distance = self.families.approach(self.families.stack(x), NEAR).distance
            values["phi7"] = distance[:, : q.deputies] - q.separation
            values["phi8"] = distance[:, q.deputies :] - q.deputy_separation
        for name, keeper in self.keepers.items():
            keeper.see(np.array([t]), values[name][:, None])

    def outcome(self) -> BlockOutcome:
        """Return the results of the runs."""
        runs = len(self.short)
        nothing, nobody = np.full(runs, np.nan), np.zeros(runs, dtype="U1")
        violated = np.any([keeper.value < 0 for keeper in self.keepers.values()], axis=0)
        columns = {
            "success": ~violated & np.isnan(self.short),
            "short_s": self.short,
            "short_deputies": np.array(self.short_deputies),
            "interventions_share": self.changed / self.steps,
            **{f"delta_v_{i}_m_s": delta_v for i, delta_v in enumerate(self.delta_v.T)},
        }
        for name in dict.fromkeys((*CONSTRAINTS, *self.keepers)):
            log = self.keepers.get(name)
            columns[f"least_{name}"] = nothing if log is None else log.value
            columns[f"time_{name}_s"] = nothing if log is None else log.time
            names = nobody if log is None else np.array([" ".join(map(str, log.who(r))) for r in range(runs)])
            columns[f"deputies_{name}"] = names
        return BlockOutcome(columns)


def fly_block(flights: FlightBatch, filtering: BatchFilter, *observers: Observer) -> BlockOutcome:
    """Fly some initial conditions under one filter, and judge them by the constraints that it keeps.

    Parameters
    ----------
    flights : FlightBatch
        The initial conditions as from `InitialConditions`.
    filtering : BatchFilter
        `Centralized` or `Decentralized`.
    *observers : callable
        As in `fly`.
    """
    recorder, end = Recorder(flights, filtering.families), flights.duration
    final = fly(flights, filtering, recorder, *observers, between=BETWEEN)
    recorder.judge(final, flights.inspection.sun_angle(end, flights.sun), end)
    return recorder.outcome()
