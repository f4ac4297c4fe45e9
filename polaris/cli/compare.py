"""The command ``polaris compare``: every run-time assurance method on the same scene."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from typing import Annotated, Any

import typer

from ..model.errors import ScenarioError

Guard = Callable[[], AbstractContextManager[None]]


def add_compare(app: typer.Typer, guard: Guard) -> None:
    """Add the command to the application; `guard` turns errors into messages and exit codes."""

    @app.command("compare")
    def compare_command(
        scenario: Annotated[
            str, typer.Argument(metavar="NAME_OR_FILE", help="A bundled scenario of a schedule, or a file.")
        ],
        runs: Annotated[int, typer.Option(min=1, help="Runs per method.")] = 50,
        seed: Annotated[int, typer.Option(min=0, help="What the runs' conditions are drawn from.")] = 0,
        methods: Annotated[
            str | None, typer.Option(help="Methods by key, separated by commas; default all.")
        ] = None,
        period: Annotated[
            float | None,
            typer.Option(help="Time between decisions [s]; default the control period, or about 1 s."),
        ] = None,
        latency: Annotated[
            float, typer.Option(help="Time from measurement to effect of a decision [s].")
        ] = 0.0,
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
                help="Tune a method: monitor.dwell, monitor_declared.dwell, asif_explicit.alpha,"
                " asif_implicit.slope, simulation.horizon, reachability.horizon; repeatable.",
            ),
        ] = None,
        out: Annotated[
            str | None,
            typer.Option("--out", metavar="DIR", help="Folder; default runs/<scenario>-comparison."),
        ] = None,
        assignments: Annotated[
            list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Override a value; repeatable.")
        ] = None,
        figures: Annotated[bool, typer.Option("--figures/--no-figures", help="Draw the figures.")] = True,
        as_json: Annotated[
            bool, typer.Option("--json", help="Print comparison.json, and nothing else.")
        ] = False,
        quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")] = False,
    ) -> None:
        """Fly every run-time assurance method on one scene, under the same disturbances, and compare.

        Methods: the precomputed schedule, the online monitor (U not trusted, or at its declared law),
        explicit and implicit simplex, explicit and implicit ASIF, look-ahead by simulation and by
        reachability, S alone, U alone.
        """
        with guard():
            from .console import Stages

            stages = Stages(quiet or as_json)
            with stages.stage("load"):
                from ..runs.atomic import check_target
                from ..scenario.scenario import kind_of, load_scenario

                if kind_of(scenario) is not None:
                    rule = "is of the inspection problem; compare takes scenarios of schedules"
                    raise ScenarioError("scenario", scenario, rule)
                loaded = load_scenario(scenario).with_assignments(list(assignments or []))
                target = str(check_target(out if out is not None else f"runs/{loaded.name}-comparison"))
                from ..rta.arena import METHODS, compare_methods
                from ..runs.comparison import write_comparison
                from ..synthesis.synthesize import synthesize

                chosen = tuple(METHODS) if methods is None else tuple(methods.replace(" ", "").split(","))
                half = _numbers(estimate_error)
                tuning = _tuning(tune or [])
            with stages.stage("schedule"):
                schedule = synthesize(loaded)
            with stages.stage("flights"):
                comparison = compare_methods(
                    schedule,
                    runs,
                    seed,
                    methods=chosen,
                    period=period,
                    latency=latency,
                    half_widths=half,
                    tuning=tuning,
                    progress=lambda key, done, total: stages.note(f"flights: {key}", done, total),
                )
            with stages.stage("folder"):
                folder = write_comparison(
                    target,
                    loaded,
                    comparison,
                    overrides=list(assignments or []),
                    figures=figures,
                    progress=stages.note,
                )
            if as_json:
                sys.stdout.write((folder.path / "comparison.json").read_text(encoding="utf-8"))
            elif not quiet:
                show_comparison(folder.table, str(folder.path))


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


SAFETY = (
    ("violations", "viola-\ntions"),
    ("min_distance_m", "least\ndist. m"),
    ("mean_distance_m", "mean\ndist. m"),
    ("min_ttc_s", "least\nTTC s"),
    ("min_ttc_free_drift_s", "drift\nTTC s"),
)
COST = (
    ("experimental_share", "share\nof U"),
    ("switches", "swit-\nches"),
    ("delta_v_m_s", "delta-v\nm/s"),
    ("deviation", "devia-\ntion"),
    ("decision_median_us", "deci-\nsion µs"),
    ("decision_p99_us", "p99\nµs"),
    ("synthesis_s", "offline\ns"),
)
"""Metrics of the two tables, and their heads."""
LEAST = ("min_distance_m", "min_ttc_s", "min_ttc_free_drift_s")


def show_comparison(table: Mapping[str, Any], folder: str) -> None:
    """Print the comparison as a table, and where its folder lies."""
    from rich.box import SIMPLE
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    from ..model.checks import counted

    console = Console(highlight=False)
    protocol = table["protocol"]
    console.print(Text(f"{table['title']}: {counted(protocol['runs'], 'run')} per method", style="bold"))
    flown = [method for method in table["methods"] if method["available"]]
    for columns in (SAFETY, COST):
        shown = Table(pad_edge=False, padding=(0, 1, 0, 0), box=SIMPLE)
        shown.add_column("method", min_width=20, max_width=22)
        if columns is SAFETY:
            shown.add_column("guarantee", no_wrap=True)
        for _, head in columns:
            shown.add_column(head, justify="right", no_wrap=True)
        for method in flown:
            claim = [method["guarantee"]] if columns is SAFETY else []
            cells = [_cell(key, method["metrics"].get(key)) for key, _ in columns]
            shown.add_row(Text(method["name"]), *claim, *cells)
        console.print(shown)
    console.print(Text("Least distance and TTC: worst over all runs. The others: means over runs, whose"))
    console.print(Text("95 % intervals and paired differences are in comparison.json and in the report."))
    for method in table["methods"]:
        if not method["available"]:
            console.print(Text(f"not available: {method['key']} ({method['reach']})"))
    console.print(Text(f"Comparison folder: {folder}"))
    console.print(Text(f"Interactive report: polaris report {shlex.quote(folder)}"))


def _cell(key: str, told: Any) -> str:
    if not isinstance(told, dict):
        return "-" if told is None else _number(told)
    if key in LEAST:
        return "none" if told["worst"] is None else _number(told["worst"])
    if key == "violations":
        return str(told["mean"])
    return "-" if told["mean"] is None else _number(told["mean"])


def _number(value: float) -> str:
    """Three digits; thousands written out, less than a thousandth as 0."""
    if abs(value) < 1e-3:
        return "0"
    return f"{value:.0f}" if abs(value) >= 1000 else f"{value:.3g}"
