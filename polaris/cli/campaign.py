"""The verbs of campaigns: many runs of switching schedules, or of the inspection problem; their replay."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..model.errors import ScenarioError
from .shell import Assignments, Json, Quiet, drawing, finish, print_json, verb

if TYPE_CHECKING:
    from ..runs.campaign.folder import CampaignFolder
    from ..runs.campaign.plan import CampaignPlan
    from ..runs.folder import RunFolder
    from ..runs.stages import Stages
    from ..scenario.scenario import Scenario, ScheduleScenario


class Mode(StrEnum):
    """Who flies."""

    polaris = "polaris"
    safety = "safety"
    experimental = "experimental"


@verb("campaign")
def campaign_command(
    scenarios: Annotated[
        list[str], typer.Argument(metavar="NAME_OR_FILE...", help="Bundled scenarios, or files.")
    ],
    runs: Annotated[
        int | None, typer.Option(min=1, help="Runs per case and mode; default 1000 (schedules).")
    ] = None,
    workers: Annotated[int | None, typer.Option(min=1, help="Processes; default one per processor.")] = None,
    scheduler: Annotated[
        str | None, typer.Option(metavar="tcp://HOST:PORT", help="Fly on a Dask cluster instead.")
    ] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="Same seed, same runs; default 0.")] = None,
    grid: Annotated[
        list[str] | None,
        typer.Option("--grid", metavar="KEY=V1,V2,...", help="Values to combine; repeatable."),
    ] = None,
    assignments: Assignments = None,
    modes: Annotated[
        list[Mode] | None, typer.Option("--mode", help="Who flies; repeatable; default polaris.")
    ] = None,
    out: Annotated[
        str | None, typer.Option("--out", metavar="DIR", help="Folder; default runs/<scenario>-campaign.")
    ] = None,
    batch: Annotated[int | None, typer.Option(min=1, help="Runs per task; default 250.")] = None,
    initial: Annotated[
        str | None, typer.Option(help="Initial states: mixed (default), random, corners, center.")
    ] = None,
    disturbance: Annotated[
        str | None, typer.Option(help="Disturbances: mixed (default), random, worst, none.")
    ] = None,
    worst: Annotated[int, typer.Option(min=0, help="Worst runs told per case and mode.")] = 5,
    resume: Annotated[
        bool, typer.Option("--resume/--fresh", help="Fly only what is missing, or replace what is there.")
    ] = True,
    figures: Annotated[
        bool, typer.Option("--figures/--no-figures", help="Draw the figures (inspection only).")
    ] = True,
    as_json: Json = False,
    quiet: Quiet = False,
) -> int | None:
    """Fly many runs over scenarios and grids of values, and count the violations.

    A campaign that was stopped goes on where it was. A scenario of the inspection problem is flown from
    drawn initial conditions under each of its filters instead.
    """
    from ..scenario.scenario import ScheduleScenario, load_scenario
    from .console import ShownStages

    if workers is not None and scheduler is not None:
        rule = "must not be given with --scheduler: the cluster has its own"
        raise ScenarioError("--workers", workers, rule)
    stages, overrides = ShownStages(quiet or as_json), list(assignments or [])
    own = {
        "--seed": seed,
        "--grid": grid,
        "--mode": modes,
        "--batch": batch,
        "--initial": initial,
        "--disturbance": disturbance,
    }
    crew = _flying(workers, scheduler, not resume, stages)
    with stages.stage("load"):
        loaded = [load_scenario(name) for name in scenarios]
    inspected = [one for one in loaded if not isinstance(one, ScheduleScenario)]
    if inspected:
        _only_inspection(loaded, inspected[0], own)
        overrides += [f"campaign.runs={runs}"] if runs is not None else []
        told = _fly_inspection(loaded[0], out, overrides, figures, crew, stages)
        from .show import show_campaign

        finish(told, show_campaign, figures, as_json, quiet)
        return None
    from ..runs.campaign import run_campaign

    plan = _plan(loaded, overrides, runs or 1000, own, stages)
    with crew as options:
        folder = run_campaign(plan, out or _default_folder(plan), worst=worst, **options)
    return _finish(folder, as_json, quiet)


@verb("campaign-replay")
def replay_command(
    campaign: Annotated[str, typer.Argument(metavar="DIR", help="Folder of a campaign.")],
    case: Annotated[int | None, typer.Option(min=0, help="Number of the case.")] = None,
    batch: Annotated[int | None, typer.Option(min=0, help="Number of the batch.")] = None,
    run: Annotated[int | None, typer.Option(min=0, help="Number of the run in its batch.")] = None,
    worst: Annotated[
        int | None,
        typer.Option(metavar="K", min=1, help="The run that came K-th closest, of the case or of all."),
    ] = None,
    mode: Annotated[str | None, typer.Option(help="Who flies; default the first that flew.")] = None,
    out: Annotated[
        str | None, typer.Option("--out", metavar="FILE", help="Trajectory, as .csv or .npz.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Fly one run of a campaign again, bit for bit, and write its trajectory."""
    from ..runs.campaign.folder import read_campaign
    from ..runs.campaign.replay import check_trajectory, find_worst, replay_run
    from .show.campaign import show_run

    if out is not None:
        check_trajectory(out)
    folder = read_campaign(campaign)
    if worst is not None:
        if batch is not None or run is not None:
            raise ScenarioError("--worst", worst, "stands instead of --batch and --run")
        chosen = find_worst(folder, worst, mode, case)
    elif case is None or batch is None or run is None:
        raise ScenarioError("campaign-replay", None, "needs --case, --batch and --run, or --worst")
    else:
        chosen = case, batch, run
    found = replay_run(folder, *chosen, mode)
    if as_json:
        print_json(found.row)
    else:
        show_run(found.row)
    if out is not None:
        typer.echo(f"Written: {found.write(out)}", err=True)


@contextmanager
def _flying(
    workers: int | None, scheduler: str | None, fresh: bool, stages: Stages
) -> Iterator[dict[str, Any]]:
    """Options of `run_campaign` while the workers are there."""
    from ..runs.campaign.drive import time_left
    from ..runs.campaign.workers import cluster, local

    crew = nullcontext(local(workers)) if scheduler is None else cluster(scheduler)
    with crew as executor, stages.stage("runs"):
        stages.note("waiting for the first batch")
        yield {"executor": executor, "fresh": fresh, "progress": time_left(stages.note)}


def _plan(
    scenarios: Sequence[ScheduleScenario],
    overrides: Sequence[str],
    runs: int,
    own: dict[str, Any],
    stages: Stages,
) -> CampaignPlan:
    """The campaign of schedules that the options ask for."""
    from ..runs.campaign import CampaignPlan, ScheduleRuns, make_cases, parse_grid
    from ..runs.campaign.formats import usable

    given = {name: own[f"--{name}"] for name in ("initial", "disturbance") if own[f"--{name}"]}
    sized = {"batch": own["--batch"]} if own["--batch"] else {}
    with stages.stage("cases"):
        usable(ScheduleRuns.formats)
        cases = make_cases(scenarios, parse_grid(own["--grid"] or []), overrides)
        modes = tuple(mode.value for mode in own["--mode"] or [Mode.polaris])
        return CampaignPlan(cases, runs, own["--seed"] or 0, kind=ScheduleRuns(modes, **given), **sized)


def _default_folder(plan: CampaignPlan) -> str:
    names = {case.scenario for case in plan.cases}
    return f"runs/{names.pop()}-campaign" if len(names) == 1 else "runs/campaign"


def _fly_inspection(
    scenario: Scenario,
    out: str | None,
    overrides: list[str],
    figures: bool,
    crew: AbstractContextManager[dict[str, Any]],
    stages: Stages,
) -> RunFolder:
    """Fly the Monte Carlo of a scenario of the inspection problem, and write its run folder."""
    from ..runs.monte_carlo import run_monte_carlo
    from ..runs.run import read_run
    from ..scenario.scenario import MonteCarloScenario

    if not isinstance(scenario, MonteCarloScenario):
        raise ScenarioError("scenario", scenario.name, "is one flight: polaris run flies it")
    scenario = scenario.with_assignments(overrides)
    with crew as options:
        flown = run_monte_carlo(out or f"runs/{scenario.name}", scenario, **options)
    folder, draw = read_run(flown.path), drawing(figures)
    if draw is not None:
        with stages.stage("figures"):
            draw(folder)
    return folder


def _only_inspection(scenarios: Sequence[Scenario], one: Scenario, own: dict[str, Any]) -> None:
    """Refuse what campaigns of the inspection problem do not have."""
    if len(scenarios) > 1:
        raise ScenarioError("scenario", one.name, "is of the inspection problem: one campaign, one scenario")
    for option, value in own.items():
        if value is not None and value != []:
            given = [str(item) for item in value] if isinstance(value, list) else value
            rule = f"is for switching schedules; {one.name} says so itself, see --set"
            raise ScenarioError(option, given, rule)


def _finish(folder: CampaignFolder, as_json: bool, quiet: bool) -> int:
    """Print the summary; returns the exit code: that of the first case if no case has a schedule."""
    summary = folder.summary
    if as_json:
        sys.stdout.write((folder.path / "summary.json").read_text(encoding="utf-8"))
    elif not quiet:
        from .show.campaign import show_campaign

        show_campaign(summary, str(folder.path))
        if summary["flown"]:
            command = f"polaris campaign-replay {shlex.quote(str(folder.path))} --worst 1 --out worst.csv"
            typer.echo(f"The closest approach in detail: {command}")
    if summary["flown"]:
        return 0
    first = summary["cases"][0]
    typer.echo(f"error: no case has a schedule; {first['label']}: {first['failure']}", err=True)
    return int(first["exit_code"])
