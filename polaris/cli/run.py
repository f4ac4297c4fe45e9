"""The verbs about scenarios and run folders: run, check, scenarios, plot, report."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, Any

import typer

from .shell import Assignments, Figures, Json, Name, Quiet, drawing, finish, verb


class Solver(StrEnum):
    """Who decides in the planner."""

    facets = "facets"
    highs = "highs"
    gurobi = "gurobi"


class Kind(StrEnum):
    """Kinds of recoverable sets."""

    polytope = "polytope"
    time_varying_ball = "time_varying_ball"
    ball = "ball"
    paper_ball = "paper_ball"


@verb("run")
def run(
    scenario: Name,
    out: Annotated[
        str | None,
        typer.Option("--out", metavar="DIR", help="Run folder; default runs/<name of the scenario>."),
    ] = None,
    assignments: Assignments = None,
    solver: Annotated[
        Solver | None, typer.Option(help="Short for --set planner.solver=...; default facets.")
    ] = None,
    recoverable: Annotated[
        Kind | None,
        typer.Option(help="Short for --set recoverable.kind=...; with paper_ball nothing is proven."),
    ] = None,
    figures: Figures = True,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Synthesise a schedule, prove it, fly it in simulation, and write a run folder.

    A scenario of the inspection problem is flown under its filter instead.
    """
    from .console import ShownStages

    overrides = list(assignments or [])
    if solver is not None:
        overrides.append(f"planner.solver={solver.value}")
    if recoverable is not None:
        overrides.append(f"recoverable.kind={recoverable.value}")
    stages = ShownStages(quiet or as_json)
    with stages.stage("load"):
        from ..runs.run import run as run_scenario
        from ..scenario.scenario import load_scenario
        from .show import SUMMARIES

        loaded = load_scenario(scenario, overrides)
        if not quiet:
            _tell_doubts(loaded, err=True)
    folder = run_scenario(loaded, out, draw=drawing(figures), stages=stages)
    if folder.kind.name == "schedule":
        claim, kind = folder.summary["guarantee"]["kind"], folder.summary["synthesis"]["recoverable"]
        if claim != "proved":  # even if asked to be quiet
            warning = "NOTHING IS PROVEN by this run, whatever its simulation shows"
            typer.echo(f"warning: {warning} (recoverable kind {kind}, guarantee {claim})", err=True)
    finish(folder, SUMMARIES[folder.kind.name], figures, as_json, quiet)


@verb("check")
def check(file: Name, assignments: Assignments = None) -> None:
    """Validate a scenario without running it, and say what looks like a slip of units or scale."""
    from ..scenario.scenario import load_scenario

    scenario = load_scenario(file, assignments or ())
    typer.echo(f"{scenario.name} is valid: {scenario.outline()}")
    _tell_doubts(scenario)


def _tell_doubts(scenario: Any, err: bool = False) -> None:
    from ..scenario.plausibility import doubts

    for doubt in doubts(scenario):
        typer.echo(f"note: {doubt}", err=err)


@verb("scenarios")
def scenarios() -> None:
    """List the scenarios that come along."""
    from ..scenario.reading import read_document
    from ..scenario.scenario import bundled_files

    bundled = bundled_files()
    width = max(map(len, bundled), default=0)
    for name, path in bundled.items():
        typer.echo(f"{name:{width}}  {read_document(path)[0]['title']}")


@verb("plot")
def plot(
    folder: Annotated[
        str, typer.Argument(metavar="RUN_OR_COMPARISON", help="A run folder, or one of polaris compare.")
    ],
    quiet: Quiet = False,
) -> None:
    """Redraw the figures of a run folder from its files alone."""
    from ..report.figures import draw_run
    from ..runs.run import read_run
    from .console import ShownStages

    with ShownStages(quiet).stage("figures"):
        drawn = draw_run(read_run(folder))
    if not quiet:
        typer.echo("\n".join(str(path) for path in drawn))


@verb("report")
def report(
    folder: Annotated[
        str, typer.Argument(metavar="RUN_OR_COMPARISON", help="A run folder, or one of polaris compare.")
    ],
    out: Annotated[
        str | None, typer.Option("--out", metavar="FILE.html", help="Default report.html in the folder.")
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Write an interactive report: one HTML file that needs no network."""
    from ..report import write_report
    from .console import ShownStages

    with ShownStages(quiet).stage("report"):
        path = write_report(folder, out)
    if not quiet:
        typer.echo(str(path))
