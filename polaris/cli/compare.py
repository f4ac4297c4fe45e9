"""The verbs that fly one scene in many ways: compare (every method), tradeoff (prices, or other values)."""

import warnings
from dataclasses import dataclass
from typing import Any

from typer import Option
from typer.core import TyperCommand, TyperOption

from ..model.errors import ClockWarning, ScenarioError
from .shell import Assignments, BlackBoxes, Name, Output, Target, verb


class _Compare(TyperCommand):
    """Command that reads the methods and their tuning options only for its help."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Complete the help of two options."""
        from ..rta.arena import tunable
        from ..rta.methods import METHODS

        values = {"methods": METHODS, "tune": tunable()}
        for one in self.params:
            if isinstance(one, TyperOption) and one.name in values:
                one.help = f"{one.help} Known: {', '.join(values[one.name])}."
        super().format_help(ctx, formatter)


@dataclass
class CompareOptions:
    """Options of ``polaris compare``."""

    runs: int = Option(50, min=1, help="Runs per method.")
    seed: int = Option(0, min=0, help="Seed of the random conditions.")
    methods: str | None = Option(None, help="Keys of methods, separated by commas; default all.")
    period: float | None = Option(None, help="Time between decisions [s]; default the period or about 1 s.")
    latency: float = Option(0.0, help="Delay from a measurement to the effect of its decision [s].")
    estimate_error: str | None = Option(
        None,
        metavar="E[,E...]",
        help="Largest error of the state estimate, one number or one per state; default from [navigation].",
    )
    tune: list[str] = Option([], metavar="METHOD.OPTION=VALUE", help="Set an option of a method; repeatable.")
    code: str | None = Option(None, metavar="DIR", help="Flight code to fly, from polaris export c.")
    out: str | None = Option(None, metavar="DIR", help="Folder; default runs/<scenario>-comparison.")
    assignments: Assignments = None


@verb("compare", cls=_Compare)
def compare_command(target: Target, options: CompareOptions, programs: BlackBoxes, output: Output) -> None:
    """Compare run-time assurance methods on one scenario under equal disturbances."""
    stages = output.stages
    error_text, tuning = options.estimate_error, _tuning(options.tune)
    numbers = None if error_text is None else _numbers("--estimate-error", error_text)
    methods = None if options.methods is None else options.methods.replace(" ", "").split(",")
    with stages.stage("load"):
        import numpy as np

        from ..rta.arena import compare_methods, selected
        from ..rta.decision_grid import DecisionGrid, check_decisions
        from ..runs.case import load_target
        from ..runs.comparison import COMPARISON, write_comparison
        from ..runs.files.atomic import check_target
        from ..simulation.on_board import FlightCode

        selected(methods, tuning)  # here and below: what is wrong is refused before the synthesis
        loaded = load_target(target, options.assignments or ())
        scenario = loaded.scenario
        out = options.out if options.out is not None else f"runs/{scenario.name}-comparison"
        place = check_target(out, COMPARISON.names)
        half = None if numbers is None else np.squeeze(numbers)
        code = None if options.code is None else FlightCode(options.code)
        check_decisions(scenario.problem(), options.period, options.latency, half)
    with programs.running() as boxes:
        with stages.stage("schedule"):
            schedule = loaded.schedule(boxes)
        with stages.stage("flights"):
            grid = DecisionGrid.from_schedule(schedule, options.period, options.latency, half)
            settings: dict[str, Any] = {"methods": methods, "tuning": tuning, "code": code}
            settings["progress"] = lambda key, done, total: stages.note(f"flights: {key}", done, total)
            comparison = compare_methods(grid, options.runs, options.seed, **settings)
        with stages.stage("folder"):
            folder = write_comparison(place, scenario, comparison, draw=output.draw, stages=stages)
    output.finish(folder)


def _numbers(option: str, text: str) -> list[float]:
    try:
        return [float(part) for part in text.split(",")]
    except ValueError:
        raise ScenarioError(option, text, "must be numbers separated by commas") from None


def _tuning(assignments: list[str]) -> dict[str, float]:
    tuning = {}
    for text in assignments:
        name, _, value = text.partition("=")
        try:
            tuning[name.strip()] = float(value)
        except ValueError:
            raise ScenarioError("--tune", text, "must be METHOD.OPTION=NUMBER") from None
    return tuning


@dataclass
class TradeoffOptions:
    """Options of ``polaris tradeoff``."""

    out: str | None = Option(None, metavar="DIR", help="Folder; default runs/<scenario>-tradeoff.")
    prices: str | None = Option(
        None, metavar="P[,P...]", help="Values of schedule.delta_v_price; default 0,0.02,0.06,0.1,0.2,0.5."
    )
    sweep: list[str] = Option(
        [],
        metavar="KEY=V[,V...]",
        help="Values of one number of the scenario; or LOW:HIGH:COUNT in equal ratios. Repeatable.",
    )
    share: float = Option(0.9, help="Share of U for which the limit of a --sweep value is reported.")
    workers: int | None = Option(None, min=1, help="Processes; default one per processor.")
    assignments: Assignments = None


@verb("tradeoff")
def tradeoff_command(scenario: Name, options: TradeoffOptions, programs: BlackBoxes, output: Output) -> None:
    """Trade the share of time under U against delta-v and switches: one run folder per price.

    With --sweep, vary numbers of the scenario instead. A trade-off that was stopped resumes.
    """
    from ..runs.campaign.workers import local
    from ..runs.tradeoff import PRICES, tradeoff

    if options.sweep and options.prices is not None:
        raise ScenarioError("--prices", options.prices, "must be left out with --sweep")
    prices = PRICES if options.prices is None else _numbers("--prices", options.prices)
    with programs.running() as boxes:
        workers = None if boxes else local(options.workers)
        settings: dict[str, Any] = {"draw": output.draw, "stages": output.stages, "executor": workers}
        settings |= {"share": options.share, "overrides": options.assignments or (), "black_boxes": boxes}
        folder = tradeoff(scenario, options.out, dict(map(read_sweep, options.sweep)) or prices, **settings)
    cut = [point["folder"] for point in folder.summary["points"] if point["cut_by_clock"]]
    if cut:
        text = f"planner.time_limit_s ended the search early ({', '.join(cut)})"
        advice = "another machine or run may find another plan; raise the limit"
        warnings.warn(f"{text}: {advice}", ClockWarning, stacklevel=2)
    output.finish(folder)


def read_sweep(text: str) -> tuple[str, list[float]]:
    """Key and values of a text ``key=0.1,0.2`` or ``key=0.1:10:5``, rounded to six digits."""
    import numpy as np

    key, equals, values = text.partition("=")
    ends = values.split(":")
    if not equals or len(ends) not in (1, 3):
        raise ScenarioError("--sweep", text, "must be KEY=V,V,... or KEY=LOW:HIGH:COUNT")
    if len(ends) == 1:
        return key.strip(), _numbers("--sweep", values)
    low, high, count = (_numbers("--sweep", end)[0] for end in ends)
    if not (0 < low < high < np.inf and 2 <= count <= 1000 and count == int(count)):
        raise ScenarioError("--sweep", text, "must be 0 < LOW < HIGH and a COUNT of 2 to 1000")
    return key.strip(), [float(f"{value:.6g}") for value in np.geomspace(low, high, int(count))]
