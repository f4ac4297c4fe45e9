"""The verbs of campaigns: many runs of switching schedules, or of the inspection problem; their replay."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

from typer import Argument, Option

from ..model.errors import ScenarioError
from .shell import Assignments, BlackBoxes, Force, Json, Output, echo, print_result, verb

if TYPE_CHECKING:
    from ..runs.campaign.folder import CampaignFolder
    from ..runs.campaign.plan import CampaignPlan
    from ..runs.campaign.workers import Workers
    from ..runs.stages import Stages
    from ..scenario.scenario import Scenario, ScheduleScenario


@dataclass
class CampaignOptions:
    """Options of ``polaris campaign``."""

    runs: int | None = Option(None, min=1, help="Runs per case and mode; default 1000 for schedules.")
    workers: int | None = Option(None, min=1, help="Number of processes; default one per processor.")
    scheduler: str | None = Option(None, metavar="tcp://HOST:PORT", help="Run on a Dask cluster instead.")
    seed: int | None = Option(None, min=0, help="Seed; equal seeds give equal runs; default 0.")
    grid: list[str] = Option([], metavar="KEY=V1,V2,...", help="Values to combine; repeatable.")
    assignments: Assignments = None
    mode: list[str] = Option([], help="Controller: polaris (default), safety, experimental, ...; repeatable.")
    out: str | None = Option(None, metavar="DIR", help="Folder; default runs/<scenario>-campaign.")
    batch: int | None = Option(None, min=1, help="Runs per task; default 250.")
    initial: str | None = Option(None, help="Initial states: mixed (default), random, corners, center.")
    disturbance: str | None = Option(None, help="failing (default), mixed, random, worst, none.")
    worst: int = Option(5, min=0, help="Number of worst runs listed per case and mode.")
    resume: bool = Option(True, "--resume/--fresh", help="Fly only missing runs, or replace the folder.")


SCHEDULES_ONLY = ("seed", "grid", "mode", "batch", "initial", "disturbance")
"""Options that do not apply to inspection scenarios, whose files hold these values."""


@verb("campaign")
def campaign_command(
    options: CampaignOptions,
    output: Output,
    programs: BlackBoxes,
    scenarios: list[str] = Argument(..., metavar="NAME_OR_FILE...", help="Bundled scenarios, or files."),
) -> int | None:
    """Fly many runs over scenarios and grids of values, and count the violations.

    A campaign that was stopped resumes. An inspection scenario is flown under each of its filters from
    random initial conditions instead.
    """
    from ..runs.campaign.workers import cluster, local
    from ..scenario.scenario import ScheduleScenario, load_scenario

    if options.workers is not None and options.scheduler is not None:
        rule = "must be left out with --scheduler, whose cluster has its own workers"
        raise ScenarioError("--workers", options.workers, rule)
    stages, scheduler = output.stages, options.scheduler
    crew = nullcontext(local(options.workers)) if scheduler is None else cluster(scheduler)
    with stages.stage("load"):
        loaded = [load_scenario(name) for name in scenarios]
    inspections = [one for one in loaded if not isinstance(one, ScheduleScenario)]
    if inspections and programs.black_box:
        raise ScenarioError("--black-box", programs.black_box, "must be left out for inspections")
    if inspections:
        _fly_inspection(loaded, inspections[0], options, output, crew)
        return None
    from ..runs.campaign import run_campaign
    from ..runs.campaign.folder import check_place

    if programs.commands:
        if options.workers or scheduler:
            rule = "must be left out with --black-box, because one process asks the black boxes"
            raise ScenarioError("--workers, --scheduler", scheduler or options.workers, rule)
        crew = nullcontext(local(1))
    plan = _plan(loaded, options, list(programs.commands), stages)
    names = {case.scenario for case in plan.cases}
    out = options.out or (f"runs/{names.pop()}-campaign" if len(names) == 1 else "runs/campaign")
    check_place(out, fresh=not options.resume)
    with programs.running() as boxes, crew as executor, stages.stage("runs"):
        stages.note("waiting for the first batch")
        progress, plan = stages.counting("{:,} of {:,} runs"), plan.asking(boxes)
        folder = run_campaign(
            plan, out, executor=executor, fresh=not options.resume, worst=options.worst, progress=progress
        )
    return _finish(folder, output)


@verb("campaign-replay")
def replay_command(
    programs: BlackBoxes,
    campaign: str = Argument(..., metavar="DIR", help="Folder of a campaign."),
    case: int | None = Option(None, min=0, help="Number of the case."),
    batch: int | None = Option(None, min=0, help="Number of the batch."),
    run: int | None = Option(None, min=0, help="Number of the run in its batch."),
    worst: int | None = Option(
        None, metavar="K", min=1, help="Run with the K-th smallest distance, of the case or of all."
    ),
    mode: str | None = Option(None, help="Controller; default the first mode of the campaign."),
    out: str | None = Option(None, metavar="FILE", help="File of the trajectory, .csv or .npz."),
    force: Force = False,
    as_json: Json = False,
) -> None:
    """Repeat one run of a campaign bit for bit, and write its trajectory."""
    from ..runs.campaign.batch import check_trajectory
    from ..runs.campaign.drive import find_worst, replay_run
    from ..runs.campaign.folder import read_campaign
    from .show.schedule import show_run

    if out is not None:
        check_trajectory(out, force)
    if worst is not None and (batch is not None or run is not None):
        raise ScenarioError("--worst", worst, "must be left out with --batch or --run")
    if worst is None and (case is None or batch is None or run is None):
        raise ScenarioError("campaign-replay", None, "must have --case, --batch and --run, or --worst")
    with programs.running() as boxes:
        folder = read_campaign(campaign)
        if worst is not None:
            chosen = find_worst(folder, worst, mode, case)
        else:
            assert case is not None and batch is not None and run is not None
            chosen = case, batch, run
        replayed = replay_run(replace(folder, plan=folder.plan.asking(boxes)), *chosen, mode)
    print_result(replayed.row, as_json, partial(show_run, replayed.row))
    if out is not None:
        echo(f"Written: {replayed.write(out, force=force)}", err=True)


def _plan(
    scenarios: Sequence[ScheduleScenario], options: CampaignOptions, boxes: Sequence[str], stages: Stages
) -> CampaignPlan:
    """Return the campaign of schedules that the options ask for."""
    from ..runs.campaign import CampaignPlan, ScheduleRuns, make_cases, parse_grid

    choices = {name: getattr(options, name) for name in ("initial", "disturbance") if getattr(options, name)}
    sized = {"batch": options.batch} if options.batch else {}
    with stages.stage("cases"):
        kind = ScheduleRuns(tuple(options.mode or ["polaris"]), **choices)
        cases = make_cases(scenarios, parse_grid(options.grid), options.assignments or (), boxes)
        return CampaignPlan(cases, options.runs or 1000, options.seed or 0, kind=kind, **sized)


def _fly_inspection(
    scenarios: Sequence[Scenario],
    scenario: Scenario,
    options: CampaignOptions,
    output: Output,
    crew: AbstractContextManager[Workers],
) -> None:
    """Fly one inspection scenario, and print the summary of its run folder."""
    from ..runs.run import run
    from ..scenario.scenario import MonteCarloScenario

    if len(scenarios) > 1:
        raise ScenarioError("scenario", scenario.name, "is an inspection scenario, which must be alone")
    for name in SCHEDULES_ONLY:
        value = getattr(options, name)
        if value is not None and value != []:
            rule = f"must be left out for the inspection scenario {scenario.name}; use --set instead"
            raise ScenarioError(f"--{name}", value, rule)
    if not isinstance(scenario, MonteCarloScenario):
        raise ScenarioError("scenario", scenario.name, "is a single flight; use polaris run")
    overrides = list(options.assignments or [])
    overrides += [f"campaign.runs={options.runs}"] if options.runs is not None else []
    settings: dict[str, Any] = {"draw": output.draw, "stages": output.stages, "fresh": not options.resume}
    with crew as executor:
        folder = run(scenario, options.out, overrides=overrides, executor=executor, **settings)
    output.finish(folder)


def _finish(folder: CampaignFolder, output: Output) -> int:
    """Print the summary; returns the exit code: that of the first case if no case has a schedule."""
    summary = folder.summary
    if output.as_json:
        sys.stdout.write((folder.path / "summary.json").read_text(encoding="utf-8"))
    elif not output.quiet:
        from .show.schedule import show_campaign

        show_campaign(summary, str(folder.path))
        if summary["flown"]:
            command = f"polaris campaign-replay {shlex.quote(str(folder.path))} --worst 1 --out worst.csv"
            echo(f"Closest approach in detail: {command}")
    if summary["flown"]:
        return 0
    first = summary["cases"][0]
    echo(f"error: no case has a schedule; {first['label']}: {first['failure']}", err=True)
    return int(first["exit_code"])
