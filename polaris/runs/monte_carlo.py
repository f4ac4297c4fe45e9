"""The Monte Carlo of the inspection problem, from a scenario to a run folder (figure 8).

The folder holds ``scenario.toml``, ``summary.json``, ``failures.csv`` (every failure of every study),
``campaign.npz`` (initial conditions and results of every run) and ``figures/``.
"""

from __future__ import annotations

import multiprocessing
from collections import Counter
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..simulation.intervals import CONFIDENCE, lower_bound
from .arrays import read_arrays
from .tables import write_csv
from ..model.system import Array
from ..model.version import versions
from ..inspection.flights.outcome import Outcome
from ..inspection.flights.outcome import Study as Filtering
from .inspection import (InspectionFolder, write_folder)
from ..inspection.constraints.motion import SampledData
from ..inspection.flights.sampling import initial_conditions
from ..scenario.inspection import InspectionScenario
from ..scenario.filter_tables import DecentralizedFilter
from ..scenario.inspection_tables import MonteCarloModel
from ..inspection.flights.studies import monte_carlo

if TYPE_CHECKING:
    from ..cli.console import Stages

FAILURE_COLUMNS = ("study", "run", "what", "deputies", "time_s", "value")


def run_campaign(
    out: str | Path,
    scenario: InspectionScenario,
    workers: int = 1,
    overrides: Sequence[str] = (),
    figures: bool = True,
    stages: Stages | None = None,
) -> InspectionFolder:
    """Draw initial conditions, fly all studies from them, and write the run folder.

    Parameters
    ----------
    out : path
    scenario : InspectionScenario
        Of the kind ``monte_carlo``.
    workers : int
        Processes; their number does not change the results.
    overrides : sequence of str
        Texts ``key=value`` that changed the scenario, noted in its copy.
    figures : bool
    stages : Stages, optional
        Shows progress.
    """
    from ..cli.console import Stages

    stages = stages or Stages(quiet=True)
    model = scenario.model
    assert isinstance(model, MonteCarloModel)
    plan = model.campaign
    with stages.stage("initial conditions"):
        x, sun, acceptance = initial_conditions(scenario.families(), plan.runs, plan.seed)
    with stages.stage("runs"):
        told = stages

        def progress(done: int, total: int) -> None:
            told.note(f"runs: block {done} of {total}", done, total)

        options = (scenario.inspection(), x, sun, filterings(scenario), plan.duration_s, plan.period_s)
        if workers > 1:
            context = multiprocessing.get_context("spawn")
            with ProcessPoolExecutor(workers, mp_context=context) as executor:
                found = monte_carlo(*options, executor=executor, progress=progress)
        else:
            found = monte_carlo(*options, progress=progress)

    def contents(folder: Path) -> dict[str, Any]:
        write_csv(folder / "failures.csv", FAILURE_COLUMNS, failure_rows(found))
        write_campaign(folder / "campaign.npz", x, sun, found)
        return summary(scenario, found, acceptance, stages.seconds)

    with stages.stage("run folder"):
        return write_folder(out, scenario, contents, overrides, figures, stages.note)


def filterings(scenario: InspectionScenario) -> list[Filtering]:
    """The studies of a scenario."""
    model = scenario.model
    assert isinstance(model, MonteCarloModel)
    alpha, period = scenario.strengthening(), model.campaign.period_s
    return [
        Filtering(
            study.name,
            study.filter.sharing if isinstance(study.filter, DecentralizedFilter) else "centralized",
            tuple(study.filter.without),
            alpha,
            SampledData(period, study.filter.sampled_data_share) if study.filter.sampled_data else None,
        )
        for study in model.studies
    ]


# -- in numbers -------------------------------------------------------------------------------------


def failure_rows(found: Mapping[str, Outcome]) -> list[list[Any]]:
    """Lines of ``failures.csv``."""
    rows: list[list[Any]] = []
    for name, outcome in found.items():
        for one in outcome.failures():
            who = one["deputies"]
            assert isinstance(who, tuple)
            rows.append([name, one["run"], one["what"], " ".join(map(str, who)), one["time"], one["value"]])
    return rows




def summary(
    scenario: InspectionScenario,
    found: Mapping[str, Outcome],
    acceptance: float,
    seconds: Mapping[str, float],
) -> dict[str, Any]:
    """Contents of ``summary.json`` of a campaign."""
    model = scenario.model
    assert isinstance(model, MonteCarloModel)
    plan = model.campaign
    return {
        "schema_version": 1,
        "scenario": scenario.name,
        "kind": scenario.kind,
        "title": model.title,
        "runs": plan.runs,
        "deputies": plan.deputies,
        "duration_s": plan.duration_s,
        "period_s": plan.period_s,
        "seed": plan.seed,
        "acceptance": acceptance,
        "studies": [_study(name, outcome) for name, outcome in found.items()],
        "guarantee": {
            "kind": "statistical",
            "reason": f"the lower bounds on the probability of success hold with {CONFIDENCE:.0%} confidence "
            "each, for initial conditions drawn as here and flights of this length, as far as the instants "
            "that were looked at show",
            "assumptions": [
                "the initial conditions count as independent; Latin hypercube samples are so only nearly"
            ],
        },
        "definitions": {
            "success": "no constraint was negative, at the samples, between them and at the end, and every "
            "program had a solution; constraints left out of the filter are left out of this",
            "failures": "runs with that failure; a run may have several",
            "acceptance": "share of the drawn initial conditions that satisfied every constraint",
        },
        "seconds": dict(seconds),
        "versions": versions(),
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
    }


def _study(name: str, outcome: Outcome) -> dict[str, Any]:
    runs, successes = len(outcome.success), int(outcome.success.sum())
    return {
        "name": name,
        "successes": successes,
        "success_share": successes / runs,
        "success_share_lower_95": lower_bound(successes, runs),
        "failures": dict(sorted(Counter(str(one["what"]) for one in outcome.failures()).items())),
        "least": {key: float(values.min()) for key, values in outcome.least.items()},
        "interventions_share": float(outcome.interventions.mean()),
        "delta_v_mean_m_s": float(outcome.delta_v.mean()),
    }


# -- arrays -----------------------------------------------------------------------------------------


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


def write_campaign(path: Path, x: Array, sun: Array, found: Mapping[str, Outcome]) -> None:
    """Write initial conditions and results of every run."""
    failures = [outcome.failures() for outcome in found.values()]
    whats = sorted({str(one["what"]) for rows in failures for one in rows})
    failed = np.zeros((len(found), *x.shape[:2]), dtype=bool)
    counts = np.zeros((len(found), len(whats)), dtype=np.intp)
    for s, rows in enumerate(failures):
        for one in rows:
            run, who = one["run"], one["deputies"]
            assert isinstance(run, int) and isinstance(who, tuple)
            failed[s, run, list(who)] = True
            counts[s, whats.index(str(one["what"]))] += 1
    arrays: dict[str, Any] = {}
    for k, outcome in enumerate(found.values()):
        arrays |= {f"least_{k}_{name}": values for name, values in outcome.least.items()}
        arrays |= {f"interventions_{k}": outcome.interventions, f"delta_v_{k}_m_s": outcome.delta_v}
        arrays[f"short_{k}_s"] = outcome.short
    np.savez(
        path,
        states=x,
        sun_rad=sun,
        studies=np.array(list(found), dtype=str),
        success=np.array([outcome.success for outcome in found.values()]),
        failed=failed,
        whats=np.array(whats, dtype=str),
        counts=counts,
        **arrays,
    )


def read_campaign(path: Path) -> CampaignPicture:
    """Read what the figures need of it."""
    arrays = read_arrays(path)
    x, success, failed, counts = (arrays[name] for name in ("states", "success", "failed", "counts"))
    studies, whats = (tuple(map(str, arrays[name])) for name in ("studies", "whats"))
    shapes = ((len(studies), len(x)), (len(studies), *x.shape[:2]), (len(studies), len(whats)))
    if x.ndim != 3 or (success.shape, failed.shape, counts.shape) != shapes or not np.isfinite(x).all():
        raise ValueError("campaign.npz: arrays of the wrong shape, or not finite")
    return CampaignPicture(x, studies, success.astype(bool), failed.astype(bool), whats, counts)
