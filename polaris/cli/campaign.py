"""The commands of campaigns: many runs of switching schedules, or of the inspection problem; their replay."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ..model.errors import ScenarioError
from .inspection import finish

if TYPE_CHECKING:
    from ..runs.campaign.folder import CampaignFolder
    from ..runs.campaign.plan import CampaignPlan
    from ..runs.inspection import InspectionFolder
    from .console import Stages

Guard = Callable[[], AbstractContextManager[None]]


class Mode(StrEnum):
    """Who flies."""

    polaris = "polaris"
    safety = "safety"
    experimental = "experimental"


Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON, and nothing else.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")]
Scenarios = Annotated[
    list[str], typer.Argument(metavar="NAME_OR_FILE...", help="Bundled scenarios, or files.")
]
Runs = Annotated[int | None, typer.Option(min=1, help="Runs per case and mode; default 1000 (schedules).")]
Processes = Annotated[int | None, typer.Option(min=1, help="Processes; default one per processor.")]
Scheduler = Annotated[
    str | None, typer.Option(metavar="tcp://HOST:PORT", help="Fly on a Dask cluster instead.")
]
Seed = Annotated[int | None, typer.Option(min=0, help="Same seed, same runs; default 0.")]
Grid = Annotated[
    list[str] | None,
    typer.Option("--grid", metavar="KEY=V1,V2,...", help="Values to combine; repeatable."),
]
Assignments = Annotated[
    list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Override a value; repeatable.")
]
Modes = Annotated[list[Mode] | None, typer.Option("--mode", help="Who flies; repeatable; default polaris.")]
Out = Annotated[
    str | None, typer.Option("--out", metavar="DIR", help="Folder; default runs/<scenario>-campaign.")
]
BatchSize = Annotated[int | None, typer.Option(min=1, help="Runs per task; default 250.")]
InitialStates = Annotated[
    str | None, typer.Option(help="Initial states: mixed (default), random, corners, center.")
]
Disturbances = Annotated[str | None, typer.Option(help="Disturbances: mixed (default), random, worst, none.")]
Worst = Annotated[int, typer.Option(min=0, help="Worst runs told per case and mode.")]
Resume = Annotated[
    bool, typer.Option("--resume/--fresh", help="Fly only what is missing, or replace what is there.")
]
Figures = Annotated[bool, typer.Option("--figures/--no-figures", help="Draw the figures (inspection only).")]


def add_campaign(app: typer.Typer, guard: Guard) -> None:
    """Add the commands to the application; `guard` turns errors into messages and exit codes."""

    @app.command("campaign")
    def campaign_command(
        scenarios: Scenarios,
        runs: Runs = None,
        workers: Processes = None,
        scheduler: Scheduler = None,
        seed: Seed = None,
        grid: Grid = None,
        assignments: Assignments = None,
        modes: Modes = None,
        out: Out = None,
        batch: BatchSize = None,
        initial: InitialStates = None,
        disturbance: Disturbances = None,
        worst: Worst = 5,
        resume: Resume = True,
        figures: Figures = True,
        as_json: Json = False,
        quiet: Quiet = False,
    ) -> None:
        """Fly many runs over scenarios and grids of values, and count the violations.

        A campaign that was stopped goes on where it was. A scenario of the inspection problem is flown from
        drawn initial conditions under each of its filters instead.
        """
        code = 0
        with guard():
            from ..scenario.scenario import kind_of
            from .console import Stages

            if workers is not None and scheduler is not None:
                rule = "must not be given with --scheduler: the cluster has its own"
                raise ScenarioError("--workers", workers, rule)
            stages = Stages(quiet or as_json)
            overrides = list(assignments or [])
            own = {
                "--seed": seed,
                "--grid": grid,
                "--mode": modes,
                "--batch": batch,
                "--initial": initial,
                "--disturbance": disturbance,
            }
            crew = _flying(workers, scheduler, not resume, stages)
            inspected = [name for name in scenarios if kind_of(name) is not None]
            if inspected:
                _only_inspection(scenarios, inspected[0], own)
                overrides += [f"campaign.runs={runs}"] if runs is not None else []
                told = _fly_inspection(scenarios[0], out, overrides, figures, crew, stages)
                if not quiet:
                    from .inspection_text import show_campaign

                    finish(told, as_json, figures, show_campaign)
            else:
                from ..runs.campaign import run_campaign

                plan = _plan(scenarios, overrides, runs or 1000, own, stages)
                with crew as options:
                    folder = run_campaign(plan, out or _default_folder(plan), worst=worst, **options)
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
        mode: Annotated[str | None, typer.Option(help="Who flies; default the first that flew.")] = None,
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
            from .campaign_text import show_run

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
                sys.stdout.write(json_text(found.row))
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
    scenarios: Sequence[str], overrides: Sequence[str], runs: int, own: dict[str, Any], stages: Stages
) -> CampaignPlan:
    """The campaign of schedules that the options ask for."""
    from ..runs.campaign import CampaignPlan, ScheduleRuns, make_cases, parse_grid
    from ..runs.campaign.parts import usable

    given = {name: own[f"--{name}"] for name in ("initial", "disturbance") if own[f"--{name}"]}
    sized = {"batch": own["--batch"]} if own["--batch"] else {}
    with stages.stage("load"):
        usable(ScheduleRuns.formats)
        cases = make_cases(scenarios, parse_grid(own["--grid"] or []), overrides)
        modes = tuple(mode.value for mode in own["--mode"] or [Mode.polaris])
        return CampaignPlan(cases, runs, own["--seed"] or 0, kind=ScheduleRuns(modes, **given), **sized)


def _default_folder(plan: CampaignPlan) -> str:
    names = {case.scenario for case in plan.cases}
    return f"runs/{names.pop()}-campaign" if len(names) == 1 else "runs/campaign"


def _fly_inspection(
    name: str,
    out: str | None,
    overrides: list[str],
    figures: bool,
    crew: AbstractContextManager[dict[str, Any]],
    stages: Stages,
) -> InspectionFolder:
    """Fly the Monte Carlo of a scenario of the inspection problem, and write its run folder."""
    from ..runs.inspection import read_run
    from ..runs.monte_carlo import run_monte_carlo
    from ..scenario.inspection import load_inspection

    with stages.stage("load"):
        scenario = load_inspection(name).with_assignments(overrides)
        if scenario.kind != "monte_carlo":
            raise ScenarioError("scenario", name, "is one flight: polaris run flies it")
    with crew as options:
        flown = run_monte_carlo(out or f"runs/{scenario.name}", scenario, overrides=overrides, **options)
    folder = read_run(flown.path)
    if figures:
        with stages.stage("figures"):
            folder.draw()
    return folder


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
        from .campaign_text import show_campaign

        show_campaign(summary, str(folder.path))
        if summary["flown"]:
            command = f"polaris campaign-replay {shlex.quote(str(folder.path))} --worst 1 --out worst.csv"
            typer.echo(f"The closest approach in detail: {command}")
    if summary["flown"]:
        return 0
    first = summary["cases"][0]
    typer.echo(f"error: no case has a schedule; {first['label']}: {first['failure']}", err=True)
    return int(first["exit_code"])
