"""The verb ``polaris compare``: every run-time assurance method on the same scene."""

from __future__ import annotations

from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperOption

from ..model.errors import ScenarioError
from .shell import Assignments, Figures, Json, Name, Quiet, drawing, finish, verb


class _Compare(TyperCommand):
    """Reads which methods there are, and what they are tuned by, only when help is asked for."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Complete the help of two options."""
        from ..rta.arena import tunable
        from ..rta.methods import METHODS

        known = {"methods": METHODS, "tune": tunable()}
        for one in self.params:
            if isinstance(one, TyperOption) and one.name in known:
                one.help = f"{one.help} Known: {', '.join(known[one.name])}."
        super().format_help(ctx, formatter)


@verb("compare", cls=_Compare)
def compare_command(
    scenario: Name,
    runs: Annotated[int, typer.Option(min=1, help="Runs per method.")] = 50,
    seed: Annotated[int, typer.Option(min=0, help="What the runs' conditions are drawn from.")] = 0,
    methods: Annotated[
        str | None, typer.Option(help="Methods by key, separated by commas; default all.")
    ] = None,
    period: Annotated[
        float | None,
        typer.Option(help="Time between decisions [s]; default the control period, or about 1 s."),
    ] = None,
    latency: Annotated[float, typer.Option(help="Time from measurement to effect of a decision [s].")] = 0.0,
    estimate_error: Annotated[
        str | None,
        typer.Option(
            metavar="E[,E...]", help="Largest error of the state estimate, one number or one per state."
        ),
    ] = None,
    tune: Annotated[
        list[str] | None,
        typer.Option(
            "--tune",
            metavar="METHOD.OPTION=VALUE",
            help="Tune a method; repeatable.",
        ),
    ] = None,
    out: Annotated[
        str | None,
        typer.Option("--out", metavar="DIR", help="Folder; default runs/<scenario>-comparison."),
    ] = None,
    assignments: Assignments = None,
    figures: Figures = True,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Fly every run-time assurance method on one scene, under the same disturbances, and compare."""
    from .console import ShownStages

    stages = ShownStages(quiet or as_json)
    with stages.stage("load"):
        from ..rta.arena import compare_methods
        from ..rta.decision_grid import DecisionGrid
        from ..runs.atomic import check_target
        from ..runs.comparison import write_comparison
        from ..scenario.scenario import ScheduleScenario, load_scenario
        from ..synthesis.synthesize import synthesize
        from .show import show_comparison

        loaded = load_scenario(scenario, assignments or (), only=ScheduleScenario)
        target = check_target(out if out is not None else f"runs/{loaded.name}-comparison")
        chosen = None if methods is None else methods.replace(" ", "").split(",")
        half, tuning = _numbers(estimate_error), _tuning(tune or [])
    with stages.stage("schedule"):
        schedule = synthesize(loaded)
    with stages.stage("flights"):
        comparison = compare_methods(
            DecisionGrid.of(schedule, period, latency, half),
            runs,
            seed,
            methods=chosen,
            tuning=tuning,
            progress=lambda key, done, total: stages.note(f"flights: {key}", done, total),
        )
    with stages.stage("folder"):
        folder = write_comparison(target, loaded, comparison, draw=drawing(figures), stages=stages)
    finish(folder, show_comparison, True, as_json, quiet)


def _numbers(text: str | None) -> Any:
    if text is None:
        return 0.0
    try:
        found = [float(part) for part in text.split(",")]
    except ValueError:
        raise ScenarioError("--estimate-error", text, "must be numbers separated by commas") from None
    return found[0] if len(found) == 1 else found


def _tuning(assignments: list[str]) -> dict[str, float]:
    out = {}
    for text in assignments:
        name, _, value = text.partition("=")
        try:
            out[name.strip()] = float(value)
        except ValueError:
            raise ScenarioError("--tune", text, "must be METHOD.OPTION=NUMBER") from None
    return out
