"""The commands of campaigns: many runs of switching schedules, or of the inspection problem; their replay."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..model.errors import ScenarioError
from .shell import answering, app, drawing, finish

if TYPE_CHECKING:
    from ..runs.campaign.folder import CampaignFolder
    from ..runs.campaign.workers import Workers
    from ..runs.stages import Stages

Guard = Callable[[], AbstractContextManager[None]]


class Mode(StrEnum):
    """Who flies."""

    polaris = "polaris"
    safety = "safety"
    experimental = "experimental"


Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON, and nothing else.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")]


def add_campaign(app: typer.Typer, guard: Guard) -> None:
    """Add the commands to the application; `guard` turns errors into messages and exit codes."""

    @app.command("campaign")
    def campaign_command(
        scenarios: Annotated[
            list[str], typer.Argument(metavar="NAME_OR_FILE...", help="Bundled scenarios, or files.")
        ],
        runs: Annotated[
            int | None, typer.Option(min=1, help="Runs per case and mode; default 1000 (schedules).")
        ] = None,
        workers: Annotated[
            int | None, typer.Option(min=1, help="Processes; default one per processor (inspection: 1).")
        ] = None,
        scheduler: Annotated[
            str | None, typer.Option(metavar="tcp://HOST:PORT", help="Fly on a Dask cluster instead.")
        ] = None,
        seed: Annotated[int | None, typer.Option(min=0, help="Same seed, same runs; default 0.")] = None,
        grid: Annotated[
            list[str] | None,
            typer.Option("--grid", metavar="KEY=V1,V2,...", help="Values to combine; repeatable."),
        ] = None,
        assignments: Annotated[
            list[str] | None,
            typer.Option("--set", metavar="KEY=VALUE", help="Override a value; repeatable."),
        ] = None,
        modes: Annotated[
            list[Mode] | None, typer.Option("--mode", help="Who flies; repeatable; default polaris.")
        ] = None,
        out: Annotated[
            str | None,
            typer.Option("--out", metavar="DIR", help="Folder; default runs/<scenario>-campaign."),
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
            bool,
            typer.Option("--resume/--fresh", help="Fly only what is missing, or replace what is there."),
        ] = True,
        figures: Annotated[
            bool,
            typer.Option("--figures/--no-figures", help="Draw the figures (inspection only)."),
        ] = True,
        as_json: Json = False,
        quiet: Quiet = False,
    ) -> None:
        """Fly many runs over scenarios and grids of values, and count the violations.

        A campaign that was stopped goes on where it was. A scenario of the inspection problem is flown from
        drawn initial conditions under each of its filters instead.
        """
        overrides = list(assignments or [])
        with guard():
            from ..scenario.scenario import ScheduleScenario, load_scenario

            own = {
                "--scheduler": scheduler,
                "--seed": seed,
                "--grid": grid,
                "--mode": modes,
                "--batch": batch,
                "--initial": initial,
                "--disturbance": disturbance,
            }
            inspected = [one for one in scenarios if not isinstance(load_scenario(one), ScheduleScenario)]
            if inspected:
                _only_inspection(scenarios, inspected[0], own)
                if runs is not None:
                    overrides.append(f"campaign.runs={runs}")
                _fly_inspection(scenarios[0], workers or 1, out, overrides, figures, as_json, quiet)
                return

            options = {
                "seed": seed or 0,
                "modes": [mode.value for mode in modes or [Mode.polaris]],
                "fresh": not resume,
                "worst": worst,
                **{
                    name: own[f"--{name}"] for name in ("batch", "initial", "disturbance") if own[f"--{name}"]
                },
            }
            from .console import ShownStages

            stages = ShownStages(quiet or as_json)
            _check_workers(workers, scheduler)
            folder = _fly(
                scenarios, grid or [], overrides, runs or 1000, out, workers, scheduler, options, stages
            )
            code = _finish(folder, as_json, quiet)
        if code:
            raise typer.Exit(code)

    @app.command("campaign-replay")
    def replay_command(
        campaign: Annotated[str, typer.Argument(metavar="DIR", help="Folder of a campaign.")],
        case: Annotated[int | None, typer.Option(min=0, help="Number of the case.")] = None,
        batch: Annotated[int | None, typer.Option(min=0, help="Number of the batch.")] = None,
        run: Annotated[int | None, typer.Option(min=0, help="Number of the run in its batch.")] = None,
        worst: Annotated[
            int | None,
            typer.Option(metavar="K", min=1, help="The run that came K-th closest, of the case or of all."),
        ] = None,
        mode: Annotated[Mode | None, typer.Option(help="Who flies; default the first that flew.")] = None,
        out: Annotated[
            str | None, typer.Option("--out", metavar="FILE", help="Trajectory, as .csv or .npz.")
        ] = None,
        as_json: Json = False,
    ) -> None:
        """Fly one run of a campaign again, bit for bit, and write its trajectory."""
        with guard():
            from ..runs.campaign.folder import read_campaign
            from ..runs.campaign.replay import check_trajectory, find_worst, replay_run
            from ..runs.tables import json_text
            from .show.campaign import show_run

            if out is not None:
                check_trajectory(out)
            folder = read_campaign(campaign)
            who = folder.plan.modes[0] if mode is None else mode.value
            if worst is not None:
                if batch is not None or run is not None:
                    raise ScenarioError("--worst", worst, "stands instead of --batch and --run")
                chosen = find_worst(folder, worst, who, case)
            elif case is None or batch is None or run is None:
                raise ScenarioError("campaign-replay", None, "needs --case, --batch and --run, or --worst")
            else:
                chosen = case, batch, run
            found = replay_run(folder, *chosen, who)
            if as_json:
                sys.stdout.write(json_text(found.row))
            else:
                show_run(found.row)
            if out is not None:
                typer.echo(f"Written: {found.write(out)}", err=True)


def _fly(
    scenarios: Sequence[str],
    grid: Sequence[str],
    overrides: Sequence[str],
    runs: int,
    out: str | None,
    workers: int | None,
    scheduler: str | None,
    options: dict[str, Any],
    stages: Stages,
) -> CampaignFolder:
    """Everything from the names of scenarios to the summary."""
    from ..runs.campaign.cases import make_cases, parse_grid
    from ..runs.campaign.drive import run_campaign, time_left
    from ..runs.campaign.workers import cluster, local

    with stages.stage("load"):
        cases = make_cases(scenarios, parse_grid(grid), overrides)
    if out is None:
        names = {case.scenario for case in cases}
        out = f"runs/{names.pop()}-campaign" if len(names) == 1 else "runs/campaign"
    crew: AbstractContextManager[Workers] = (
        cluster(scheduler) if scheduler is not None else nullcontext(local(workers))
    )
    with crew as flying, stages.stage("runs"):
        stages.note("waiting for the first batch")
        progress = time_left(stages.note)
        return run_campaign(cases, runs, out, executor=flying, progress=progress, **options)


def _check_workers(workers: int | None, scheduler: str | None) -> None:
    if workers is not None and scheduler is not None:
        raise ScenarioError(
            "--workers", workers, "must not be given with --scheduler: the cluster has its own"
        )


def _only_inspection(scenarios: Sequence[str], name: str, own: dict[str, Any]) -> None:
    """Refuse what campaigns of the inspection problem do not have."""
    if len(scenarios) > 1:
        raise ScenarioError("scenario", name, "is of the inspection problem: one campaign, one scenario")
    for option, value in own.items():
        if value is not None and value != []:
            given = [str(item) for item in value] if isinstance(value, list) else value
            raise ScenarioError(
                option, given, f"is for switching schedules; {name} says so itself, see --set"
            )


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


def _fly_inspection(
    name: str,
    workers: int,
    out: str | None,
    overrides: list[str],
    figures: bool,
    as_json: bool,
    quiet: bool,
) -> None:
    """Fly the Monte Carlo of a scenario, write its run folder, and print what it came to."""
    from ..runs.atomic import check_target
    from ..runs.monte_carlo import run_campaign
    from ..scenario.scenario import MonteCarloScenario, load_scenario
    from .console import ShownStages
    from .show import show_campaign

    loaded = load_scenario(name, overrides)
    if not isinstance(loaded, MonteCarloScenario):
        raise ScenarioError("scenario", name, "is one flight: polaris run flies it")
    target = check_target(out if out is not None else f"runs/{loaded.name}")
    folder = run_campaign(target, loaded, workers, drawing(figures), ShownStages(quiet or as_json))
    finish(folder, show_campaign, figures, as_json, quiet)


add_campaign(app, answering)
