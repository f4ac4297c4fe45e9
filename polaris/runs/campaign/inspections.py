"""Campaigns of the inspection problem: drawn initial conditions, each flown under every study's filter."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, ClassVar

import numpy as np

from ...inspection.flights.blocks import BlockOutcome, fly_block
from ...inspection.flights.sampling import InitialConditions
from ...inspection.flights.simulation import BatchFilter, FlightBatch, InspectionRun, RunRecorder
from ...model.system import Array
from ...scenario.reading import parse_toml
from ...scenario.scenario import MonteCarloScenario
from ...simulation.metrics import CONFIDENCE, lower_bound
from ..files.arrays import array_fields
from ..files.folder import summary_of
from ..inspections.inspection import ARRAYS
from .batch import Batch, CampaignRuns, Case, Replayed, Task, of_mode

BLOCK = 100  # runs flown together: what fits into fast memory
STATES = ("rx_m", "ry_m", "rz_m", "vx_m_s", "vy_m_s", "vz_m_s")

DEFINITIONS = {
    "success": "no constraint was negative at samples, between them or at the end, and every program had a "
    "solution; constraints left out of the filter are not counted",
    "failures": "number of runs with this failure; a run may have several",
    "acceptance": "share of the drawn initial conditions that satisfied every constraint",
}

GUARANTEE = {
    "kind": "statistical",
    "reason": f"each lower bound on the probability of success holds with {CONFIDENCE:.0%} confidence, for "
    "initial conditions drawn as here, flights of this length, and constraints at the evaluated instants",
    "assumptions": [
        "the initial conditions are independent, which Latin hypercube samples are only approximately"
    ],
}


@dataclass(frozen=True)
class InspectionRuns(CampaignRuns):
    """Runs of a ``monte_carlo`` scenario; the modes are its studies, on the same initial conditions."""

    name: ClassVar[str] = "inspection"
    ranking: ClassVar[str] = ""

    def fly(self, task: Task, mode: str, run: int | None = None) -> Batch:
        """Fly a task, or one run of it (see `CampaignRuns.fly`)."""
        scenario, drawn, filters = _load_case(task.text)
        plan, q = scenario.model.campaign, scenario.inspection()
        x, sun = (values[task.first :] for values in drawn.first(task.first + task.runs))
        flights = FlightBatch(q, x, sun, plan.duration_s, plan.period_s)
        recorders = [] if run is None else [RunRecorder(flights, run)]
        outcome = fly_block(flights, filters[mode], *recorders)
        columns = {
            "run": np.arange(task.runs, dtype=np.int64),
            "mode": np.repeat(mode, task.runs),
            "sun_rad": sun,
            **dict(zip(_names(q.deputies), x.reshape(task.runs, -1).T, strict=True)),
            **outcome.columns,
        }
        return Batch("", columns, trajectory=_trajectory(recorders[0].flight()) if recorders else None)

    def summarise(self, folder: Any, worst: int) -> dict[str, Any]:
        """Summarise the runs of a campaign (see `CampaignRuns.summarise`)."""
        (case,), runs = folder.plan.cases, folder.plan.runs
        scenario = _load_case(case.text)[0]
        plan = scenario.model.campaign
        summary: dict[str, Any] = {
            "runs": runs,
            "deputies": plan.deputies,
            "duration_s": plan.duration_s,
            "period_s": plan.period_s,
            "seed": plan.seed,
        }
        for failure in folder.failures().values():
            summary |= {"failure": failure["message"], "exit_code": failure["exit_code"]}
            return summary_of(scenario, scenario.kind, summary)
        drawn = InitialConditions(scenario.families(), plan.seed)
        drawn.first(runs)
        summary["acceptance"] = drawn.acceptance
        studies = outcomes(case, folder.read(0))
        summary["studies"] = [_study(name, outcome) for name, outcome in studies.items()]
        summary |= {"guarantee": GUARANTEE, "definitions": DEFINITIONS}
        return summary_of(scenario, scenario.kind, summary)


def case_of(scenario: MonteCarloScenario) -> Case:
    """Return the one case of a Monte Carlo; its number of runs is the plan's, so that more runs extend it."""
    return Case(scenario.name, (), scenario.set("campaign.runs", 1).to_toml())


def outcomes(case: Case, columns: Mapping[str, Array]) -> dict[str, BlockOutcome]:
    """Results of every study, from the columns of all runs."""
    studies = _load_case(case.text)[0].model.studies
    return {study.name: BlockOutcome(of_mode(columns, study.name)) for study in studies}


def initial_states(columns: Mapping[str, Array]) -> Array:
    """Initial states of all runs, shape (R, N, 6), from the columns of all runs."""
    first = columns["mode"] == columns["mode"][0]
    rows = [values[first] for name, values in columns.items() if name.startswith("deputy_")]
    return np.stack(rows, axis=1).reshape(int(first.sum()), -1, 6)


@lru_cache(2)
def _load_case(text: str) -> tuple[MonteCarloScenario, InitialConditions, dict[str, BatchFilter]]:
    """Return the scenario of a case, its drawn initial conditions, and its filters by study."""
    scenario = MonteCarloScenario.from_dict(parse_toml(text, "campaign"))
    plan = scenario.model.campaign
    drawn = InitialConditions(scenario.families(), plan.seed)
    filters = {study.name: scenario.filter(study.filter, plan.period_s) for study in scenario.model.studies}
    return scenario, drawn, filters


def _names(deputies: int) -> list[str]:
    return [f"deputy_{i}_{name}" for i in range(deputies) for name in STATES]


def _study(name: str, outcome: BlockOutcome) -> dict[str, Any]:
    runs, successes = len(outcome.success), int(outcome.success.sum())
    return {
        "name": name,
        "successes": successes,
        "success_share": successes / runs,
        "success_share_lower_95": lower_bound(successes, runs),
        "failures": dict(sorted(Counter(str(one["what"]) for one in outcome.failures()).items())),
        "least": {key: float(values.min()) for key, values in outcome.least.items()},
        "interventions_share": float(np.mean(outcome.columns["interventions_share"])),
        "delta_v_mean_m_s": float(outcome.delta_v.mean()),
    }


def _trajectory(run: InspectionRun) -> Replayed:
    """One run; the arrays are those of a flight's run folder."""
    deputies = run.inspection.deputies
    table: dict[str, Any] = {
        "t_s": run.t,
        "sun_rad": run.sun,
        **dict(zip(_names(deputies), run.x.reshape(len(run.t), -1).T, strict=True)),
    }
    for i in range(deputies):
        table |= {f"deputy_{i}_u_{axis}_N": run.u[:, i, k] for k, axis in enumerate("xyz")}
        table[f"deputy_{i}_status"] = run.status[:, i]
    return Replayed(array_fields(run, ARRAYS), table)
