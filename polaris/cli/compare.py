"""The verbs that fly one scene in many ways: compare (every method), tradeoff (several prices)."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import Any

import typer
from typer import Option
from typer.core import TyperCommand, TyperOption

from ..model.errors import ClockWarning, ScenarioError
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


@dataclass
class Options:
    """Of ``polaris compare``."""

    runs: int = Option(50, min=1, help="Runs per method.")
    seed: int = Option(0, min=0, help="What the runs' conditions are drawn from.")
    methods: str | None = Option(None, help="Methods by key, separated by commas; default all.")
    period: float | None = Option(
        None, help="Time between decisions [s]; default the control period, or about 1 s."
    )
    latency: float = Option(0.0, help="Time from measurement to effect of a decision [s].")
    estimate_error: str | None = Option(
        None, metavar="E[,E...]", help="Largest error of the state estimate, one number or one per state."
    )
    tune: list[str] = Option([], metavar="METHOD.OPTION=VALUE", help="Tune a method; repeatable.")
    out: str | None = Option(None, metavar="DIR", help="Folder; default runs/<scenario>-comparison.")
    assignments: Assignments = None
    figures: Figures = True
    as_json: Json = False
    quiet: Quiet = False


@verb("compare", cls=_Compare)
def compare_command(scenario: Name, options: Options) -> None:
    """Fly every run-time assurance method on one scene, under the same disturbances, and compare."""
    from .console import ShownStages

    stages = ShownStages(options.quiet or options.as_json)
    with stages.stage("load"):
        from ..rta.arena import compare_methods, selected
        from ..rta.decision_grid import DecisionGrid
        from ..runs.atomic import check_target
        from ..runs.comparison import write_comparison
        from ..scenario.scenario import ScheduleScenario, load_scenario
        from ..synthesis.synthesize import synthesize

        loaded = load_scenario(scenario, options.assignments or (), only=ScheduleScenario)
        target = check_target(options.out if options.out is not None else f"runs/{loaded.name}-comparison")
        half, tuning = _numbers("--estimate-error", options.estimate_error or "0"), _tuning(options.tune)
        named = None if options.methods is None else options.methods.replace(" ", "").split(",")
        selected(named, tuning)  # what does not exist is refused before the synthesis
    with stages.stage("schedule"):
        schedule = synthesize(loaded)
    with stages.stage("flights"):
        comparison = compare_methods(
            DecisionGrid.of(schedule, options.period, options.latency, half if len(half) > 1 else half[0]),
            options.runs,
            options.seed,
            methods=named,
            tuning=tuning,
            progress=lambda key, done, total: stages.note(f"flights: {key}", done, total),
        )
    with stages.stage("folder"):
        draw = drawing(options.figures)
        folder = write_comparison(target, loaded, comparison, draw=draw, stages=stages)
    finish(folder, True, options.as_json, options.quiet)


def _numbers(option: str, text: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise ScenarioError(option, text, "must be numbers separated by commas") from None


def _tuning(assignments: list[str]) -> dict[str, float]:
    out = {}
    for text in assignments:
        name, _, value = text.partition("=")
        try:
            out[name.strip()] = float(value)
        except ValueError:
            raise ScenarioError("--tune", text, "must be METHOD.OPTION=NUMBER") from None
    return out


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

    folder = tradeoff(
        scenario,
        out,
        _numbers("--prices", prices),
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
