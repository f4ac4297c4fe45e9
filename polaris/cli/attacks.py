"""The commands that try to prove a run wrong: falsify, replay, model-error."""

from __future__ import annotations

import math
import shlex
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from ..simulation.falsification.search import Falsification
    from ..simulation.orbit.model_error import ModelError

REFUTED = 5
"""Exit code: a counterexample was found, or a declared bound does not hold."""

Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON, and nothing else.")]
Guard = Callable[[], AbstractContextManager[None]]


def add_commands(app: typer.Typer, guard: Guard) -> None:
    """Add the commands to the application; `guard` turns errors into messages and exit codes."""

    @app.command("model-error")
    def model_error_command(
        scenario: Annotated[
            str, typer.Argument(metavar="NAME_OR_FILE", help="A bundled scenario or a file, with [orbit].")
        ],
        fit: Annotated[
            bool, typer.Option("--fit", help="Find a disturbance bound that covers its own model error.")
        ] = False,
        as_json: Json = False,
    ) -> None:
        """Bound what the linear model leaves out, and compare it with the disturbance bound."""
        with guard():
            from ..scenario.scenario import load_scenario
            from ..simulation.orbit.model_error import justify, model_error

            loaded = load_scenario(scenario)
            found = justify(loaded) if fit else model_error(loaded)
            if as_json:
                _print_json(found.summary())
            else:
                _show_model_error(found)
        if not found.covered:
            raise typer.Exit(REFUTED)

    @app.command("falsify")
    def falsify_command(
        target: Annotated[
            str, typer.Argument(metavar="RUN_OR_SCENARIO", help="A run folder, a bundled scenario or a file.")
        ],
        runs: Annotated[int, typer.Option(min=1, help="Trajectories to fly.")] = 10_000,
        seed: Annotated[int, typer.Option(min=0, help="Same seed, same search.")] = 0,
        out: Annotated[
            str | None,
            typer.Option("--out", metavar="FILE", help="Where a case goes; default <scenario>.case.json."),
        ] = None,
        as_json: Json = False,
    ) -> None:
        """Search for a run that breaks what a schedule claims; save it as a case."""
        with guard():
            from ..runs.atomic import check_file
            from ..runs.case import load_target, write_case
            from ..simulation.falsification.search import falsify

            if out is not None:
                check_file(out, endings=(".json",))
            scenario, schedule = load_target(target)
            check_file(out or f"{scenario.name}.case.json")
            found = falsify(schedule, runs, seed)
            if as_json:
                _print_json(found.summary())
            else:
                _show_falsification(scenario.name, found)
            if found.failure is not None:
                path = write_case(out or f"{scenario.name}.case.json", scenario, found)
                typer.echo(f"Saved: polaris replay {shlex.quote(str(path))}", err=True)
        if found.failure is not None:
            raise typer.Exit(REFUTED)

    @app.command("replay")
    def replay_command(
        case: Annotated[str, typer.Argument(metavar="CASE", help="A case that `polaris falsify` saved.")],
    ) -> None:
        """Fly a saved case again and say what it violates and when."""
        with guard():
            from ..runs.case import replay

            failure, scenario = replay(case)
            if failure is None:
                typer.echo(f"{scenario.name}: this case violates nothing")
            else:
                typer.echo(f"{scenario.name}: {failure}")
        if failure is not None:
            raise typer.Exit(REFUTED)


def _show_falsification(name: str, found: Falsification) -> None:
    from ..synthesis.recoverable import directed

    told = found.summary()
    typer.echo(f"{name}: {told['runs']} trajectories, {told['runs_per_s']:.0f} per second")
    typer.echo(f"{'limit':24} {'least margin':>13} {'proven':>11} {'proven/least':>13} {'at':>9}")
    for row in told["limits"]:
        proven = directed(row["proven"], ".4g") if math.isfinite(row["proven"]) else "nothing"
        share = f"{row['proven_share']:.0%}" if math.isfinite(row["proven_share"]) else "-"
        typer.echo(f"{row['limit']:24} {row['least']:13.4g} {proven:>11} {share:>13} {row['time_s']:7g} s")
    typer.echo("No violation." if found.failure is None else f"VIOLATED: {found.failure}")


def _print_json(data: object) -> None:
    from ..runs.tables import json_text

    sys.stdout.write(json_text(data))


def _show_model_error(found: ModelError) -> None:
    told = found.summary()
    worst = told["worst"]
    typer.echo(f"{told['scenario']}: what the linear model leaves out where the schedule flies [m/s^2]")
    for name, value in told["parts_m_s2"].items():
        typer.echo(f"  {name.replace('_', ' '):16} {value:9.3g}")
    typer.echo(f"  {'bound':16} {told['bound_m_s2']:9.3g}   (sampled: {told['sampled_share']:.0%} of it)")
    typer.echo(
        f"  {'declared':16} {told['declared_m_s2']:9.3g}   {'covers it' if found.covered else 'TOO SMALL'}"
    )
    typer.echo(
        f"Largest at t = {worst['time_s']:g} s under {worst['controller']}: within"
        f" {worst['distance_m']:.0f} m of the target, {worst['radial_m']:.0f} m in height,"
        f" {worst['speed_m_s']:.2f} m/s."
    )
    for name, time in told["satellites_covered_until_s"].items():
        until = "as long as it is perceived" if time is None else f"until t = {time:g} s"
        typer.echo(f"The motion declared for {name} covers its own model error {until}.")
