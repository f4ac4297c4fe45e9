"""The Monte Carlo of the inspection problem: a campaign whose folder is a run folder too (figure 8).

Besides what every campaign holds (see `polaris.runs.campaign.folder`), the folder holds ``scenario.toml``,
``failures.csv`` (every failure of every study) and ``figures/``.
"""

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...model.errors import failed
from ...model.system import Array
from ...scenario.scenario import MonteCarloScenario
from ..campaign.drive import run_campaign
from ..campaign.folder import CampaignFolder, read_campaign
from ..campaign.inspections import BLOCK, InspectionRuns, case_of, initial_states, outcomes
from ..campaign.plan import CampaignPlan
from ..campaign.workers import Workers
from ..files.atomic import adding
from ..files.folder import SCENARIO, RunKind
from ..files.tables import write_csv, write_text

FAILURE_COLUMNS = ("study", "run", "what", "deputies", "time_s", "value")


def run_monte_carlo(
    out: str | Path,
    scenario: MonteCarloScenario,
    *,
    executor: Executor | Workers | None = None,
    fresh: bool = False,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> CampaignFolder:
    """Fly all studies from drawn initial conditions, as `run_campaign` does, and write the run folder."""
    model = scenario.model
    kind = InspectionRuns(tuple(study.name for study in model.studies))
    plan = CampaignPlan((case_of(scenario),), model.campaign.runs, model.campaign.seed, BLOCK, kind)
    folder = run_campaign(plan, out, executor=executor, fresh=fresh, progress=progress)
    for failure in folder.failures().values():
        raise failed(failure["message"], failure["exit_code"])
    rows = [
        {"study": name, "time_s": one.pop("time"), **one, "deputies": " ".join(map(str, one["deputies"]))}
        for name, outcome in outcomes(folder.plan.cases[0], folder.read(0)).items()
        for one in outcome.failures()
    ]
    with adding(folder.path, policy="kept") as draft:
        write_text(draft / SCENARIO, scenario.copy_text())
        write_csv(draft / "failures.csv", rows, FAILURE_COLUMNS)
    return folder


@dataclass(frozen=True, eq=False)
class CampaignData:
    """Plot data of a campaign: R runs of N deputies in S studies."""

    x: Array  # (R, N, 6), initial states
    studies: tuple[str, ...]
    success: NDArray[np.bool_]  # (S, R)
    failed: NDArray[np.bool_]  # (S, R, N): deputies that a failure concerns
    whats: tuple[str, ...]  # kinds of failure
    counts: NDArray[np.intp]  # (S, kinds): runs with each


def _read(path: Path, scenario: MonteCarloScenario) -> CampaignData:
    folder = read_campaign(path, same_version=False)
    columns = folder.read(0)
    results, x = outcomes(folder.plan.cases[0], columns), initial_states(columns)
    failures = [outcome.failures() for outcome in results.values()]
    kinds = sorted({one["what"] for rows in failures for one in rows})
    failed = np.zeros((len(results), *x.shape[:2]), dtype=bool)
    counts = np.zeros((len(results), len(kinds)), dtype=np.intp)
    for s, rows in enumerate(failures):
        for one in rows:
            failed[s, one["run"], list(one["deputies"])] = True
            counts[s, kinds.index(one["what"])] += 1
    success = np.array([outcome.success for outcome in results.values()])
    return CampaignData(x, tuple(results), success, failed, tuple(kinds), counts)


MONTE_CARLO = RunKind("monte_carlo", (SCENARIO, "failures.csv", "manifest.json"), None, None, _read)
"""Run folder of many flights; `run_monte_carlo` writes it, as they are flown."""
