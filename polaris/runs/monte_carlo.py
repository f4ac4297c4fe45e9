"""The Monte Carlo of the inspection problem: a campaign whose folder is a run folder too (figure 8).

Besides what every campaign holds (see `polaris.runs.campaign.folder`), the folder holds ``scenario.toml``,
``failures.csv`` (every failure of every study) and ``figures/``.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..model.errors import PolarisError
from ..model.system import Array
from ..scenario.scenario import MonteCarloScenario
from .atomic import replacing_file, write_whole
from .campaign.drive import run_campaign
from .campaign.folder import CampaignFolder, read_campaign
from .campaign.inspections import BLOCK, InspectionRuns, case_of, initial_states, outcomes
from .campaign.plan import CampaignPlan
from .campaign.workers import Workers
from .folder import SCENARIO, RunKind
from .tables import write_csv

FAILURE_COLUMNS = ("study", "run", "what", "deputies", "time_s", "value")


def run_monte_carlo(
    out: str | Path,
    scenario: MonteCarloScenario,
    *,
    executor: Executor | Workers | None = None,
    fresh: bool = False,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> CampaignFolder:
    """Fly all studies from drawn initial conditions, and write the run folder, without figures.

    Parameters
    ----------
    out : path
        If it holds the same campaign, only what is missing is flown.
    scenario : MonteCarloScenario
    executor : concurrent.futures.Executor or Workers, optional
        Who flies, as in `run_campaign`; does not change the results.
    fresh : bool
        Replace another campaign.
    progress : callable
        Told the runs done and all of them, per study.

    Raises
    ------
    ScenarioError
        If the folder holds something else.
    PolarisError
        If no initial conditions are found, or workers are lost again and again.
    """
    model = scenario.model
    kind = InspectionRuns(tuple(study.name for study in model.studies))
    plan = CampaignPlan((case_of(scenario),), model.campaign.runs, model.campaign.seed, BLOCK, kind)
    folder = run_campaign(plan, out, executor=executor, fresh=fresh, progress=progress)
    for failure in folder.failures().values():
        error = PolarisError(failure["message"])
        error.exit_code = failure["exit_code"]
        raise error
    write_whole(folder.path / SCENARIO, scenario.copy_text())
    rows = [
        [name, one["run"], one["what"], " ".join(map(str, one["deputies"])), one["time"], one["value"]]
        for name, outcome in outcomes(folder.plan.cases[0], folder.read(0)).items()
        for one in outcome.failures()
    ]
    with replacing_file(folder.path / "failures.csv") as beside:
        write_csv(beside, FAILURE_COLUMNS, rows)
    return folder


@dataclass(frozen=True, eq=False)
class CampaignPicture:
    """What the figures of a campaign show.

    Attributes
    ----------
    x : ndarray, shape (R, N, 6)
        Initial states.
    studies : tuple of str
    success : ndarray of bool, shape (S, R)
    failed : ndarray of bool, shape (S, R, N)
        Deputies that a failure concerns.
    whats : tuple of str
        Kinds of failure.
    counts : ndarray of int, shape (S, kinds)
        Runs with each.
    """

    x: Array
    studies: tuple[str, ...]
    success: NDArray[np.bool_]
    failed: NDArray[np.bool_]
    whats: tuple[str, ...]
    counts: NDArray[np.intp]


def _read(path: Path, scenario: MonteCarloScenario) -> CampaignPicture:
    folder = read_campaign(path, same_version=False)
    columns = folder.read(0)
    found, x = outcomes(folder.plan.cases[0], columns), initial_states(columns)
    failures = [outcome.failures() for outcome in found.values()]
    whats = sorted({one["what"] for rows in failures for one in rows})
    failed = np.zeros((len(found), *x.shape[:2]), dtype=bool)
    counts = np.zeros((len(found), len(whats)), dtype=np.intp)
    for s, rows in enumerate(failures):
        for one in rows:
            failed[s, one["run"], list(one["deputies"])] = True
            counts[s, whats.index(one["what"])] += 1
    success = np.array([outcome.success for outcome in found.values()])
    return CampaignPicture(x, tuple(found), success, failed, tuple(whats), counts)


MONTE_CARLO = RunKind("monte_carlo", (SCENARIO, "failures.csv", "manifest.json"), None, None, _read)
"""What many flights leave; `run_monte_carlo` writes it, as they are flown."""
