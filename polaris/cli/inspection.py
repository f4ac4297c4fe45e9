"""What the command ``polaris run`` does for the inspection problem."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import typer

from ..model.errors import ScenarioError

if TYPE_CHECKING:
    from ..runs.inspection import InspectionFolder
    from ..scenario.inspection import InspectionScenario
    from .console import Stages


def run_inspection(
    name: str, out: str | None, overrides: list[str], figures: bool, as_json: bool, quiet: bool
) -> None:
    """Fly a scenario of the inspection problem, write its run folder, and print what it came to."""
    from .console import Stages

    stages = Stages(quiet or as_json)
    with stages.stage("load"):
        from ..runs.atomic import check_target
        from ..scenario.inspection import load_inspection

        scenario = load_inspection(name).with_assignments(overrides)
        target = str(check_target(out if out is not None else f"runs/{scenario.name}"))
    if scenario.kind == "monte_carlo":
        raise ScenarioError("scenario", name, "is a campaign of many flights: polaris campaign runs it")
    if scenario.kind == "fuel_limit":
        _run_fuel(scenario, target, overrides, figures, as_json, quiet, stages)
        return
    with stages.stage("flight"):
        from ..inspection.flights.judge import fly_scenario

        flown = fly_scenario(
            scenario, lambda done, total: stages.note(f"flight: {done} of {total} periods", done, total)
        )
    with stages.stage("run folder"):
        from ..runs.inspection import write_run

        folder = write_run(
            target,
            scenario,
            flown,
            overrides=overrides,
            seconds=stages.seconds,
            figures=figures,
            progress=stages.note,
        )
    if not quiet:
        from .inspection_text import show_flight

        finish(folder, as_json, figures, show_flight)


def _run_fuel(
    scenario: InspectionScenario,
    target: str,
    overrides: list[str],
    figures: bool,
    as_json: bool,
    quiet: bool,
    stages: Stages,
) -> None:
    """Fly one deputy into its fuel limit."""
    with stages.stage("flight"):
        from ..runs.fuel_limit import fly_fuel_scenario, write_fuel_run

        flown = fly_fuel_scenario(scenario)
    with stages.stage("run folder"):
        folder = write_fuel_run(
            target,
            scenario,
            flown,
            overrides=overrides,
            seconds=stages.seconds,
            figures=figures,
            progress=stages.note,
        )
    if not quiet:
        from .inspection_text import show_fuel

        finish(folder, as_json, figures, show_fuel)


def finish(folder: InspectionFolder, as_json: bool, figures: bool, show: Callable[[Any, str], None]) -> None:
    """Print what a run came to."""
    if as_json:
        sys.stdout.write((folder.path / "summary.json").read_text(encoding="utf-8"))
        return
    show(folder.summary, str(folder.path))
    if not figures:
        typer.echo(f"To draw the figures: polaris plot {shlex.quote(str(folder.path))}")


def told_valid(name: str, overrides: list[str]) -> str:
    """One line on a scenario of the inspection problem that is valid."""
    from ..scenario.inspection import load_inspection

    scenario = load_inspection(name).with_assignments(overrides)
    return f"{scenario.name} is valid: {scenario.outline()}"
