"""The verb ``polaris tradeoff``: what the time of U costs, at several prices of velocity change."""

from __future__ import annotations

import warnings

import typer
from typer import Option

from ..model.errors import ClockWarning, ScenarioError
from .shell import Assignments, Figures, Json, Name, Quiet, drawing, finish, verb


@verb("tradeoff")
def tradeoff_command(
    scenario: Name,
    out: str | None = Option(None, metavar="DIR", help="Folder; default runs/<scenario>-tradeoff."),
    prices: str = Option(
        "0,0.02,0.06,0.1,0.2,0.5", metavar="P[,P...]", help="Values of schedule.delta_v_price."
    ),
    workers: int | None = Option(None, min=1, help="Processes; default one per processor."),
    assignments: Assignments = None,
    figures: Figures = True,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Find the front of share of U against velocity change against switches: a run folder for each price.

    A trade-off that was stopped goes on where it was.
    """
    from ..runs.campaign.workers import local
    from ..runs.tradeoff import tradeoff
    from .console import ShownStages

    try:
        values = [float(part) for part in prices.split(",")]
    except ValueError:
        raise ScenarioError("--prices", prices, "must be numbers separated by commas") from None
    folder = tradeoff(
        scenario,
        out,
        values,
        overrides=assignments or (),
        draw=drawing(figures),
        stages=ShownStages(quiet or as_json),
        executor=local(workers),
    )
    unproven = [point["folder"] for point in folder.summary["points"] if point["guarantee"] != "proved"]
    if unproven:  # even if asked to be quiet
        typer.echo(f"warning: NOTHING IS PROVEN by {', '.join(unproven)}", err=True)
    cut = [point["folder"] for point in folder.summary["points"] if point["cut_by_clock"]]
    if cut:
        told = (
            f"the planner's wall clock ended its search early ({', '.join(cut)}): another machine, or another"
        )
        warnings.warn(f"{told} run, may find another plan; allow more time", ClockWarning, stacklevel=2)
    finish(folder, figures, as_json, quiet)
