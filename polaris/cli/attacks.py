"""The verbs that try to prove a run wrong: model-error, falsify, replay, verify."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated

import typer

from .shell import REFUTED, Json, print_json, verb


@verb("model-error")
def model_error_command(
    scenario: Annotated[
        str, typer.Argument(metavar="NAME_OR_FILE", help="A bundled scenario or a file, with [orbit].")
    ],
    fit: Annotated[
        bool, typer.Option("--fit", help="Find a disturbance bound that covers its own model error.")
    ] = False,
    as_json: Json = False,
) -> int | None:
    """Bound what the linear model leaves out, and compare it with the disturbance bound."""
    from ..scenario.scenario import ScheduleScenario, load_scenario
    from ..simulation.orbit.model_error import justify, model_error
    from .show.attacks import show_model_error

    loaded = load_scenario(scenario, only=ScheduleScenario)
    found = justify(loaded) if fit else model_error(loaded)
    if as_json:
        print_json(found.summary())
    else:
        show_model_error(found)
    return None if found.covered else REFUTED


@verb("falsify")
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
) -> int | None:
    """Search for a run that breaks what a schedule claims; save it as a case."""
    from ..runs.atomic import check_file
    from ..runs.case import load_target, write_case
    from ..simulation.falsification.search import falsify
    from .show.attacks import show_falsification

    if out is not None:
        check_file(out, endings=(".json",))
    scenario, schedule = load_target(target)
    check_file(out or f"{scenario.name}.case.json")
    found = falsify(schedule, runs, seed)
    if as_json:
        print_json(found.summary())
    else:
        show_falsification(scenario.name, found)
    if found.failure is not None:
        path = write_case(out or f"{scenario.name}.case.json", scenario, found)
        typer.echo(f"Saved: polaris replay {shlex.quote(str(path))}", err=True)
    return REFUTED if found.failure is not None else None


@verb("replay")
def replay_command(
    case: Annotated[str, typer.Argument(metavar="CASE", help="A case that `polaris falsify` saved.")],
) -> int | None:
    """Fly a saved case again and say what it violates and when."""
    from ..runs.case import replay

    failure, scenario = replay(case)
    typer.echo(f"{scenario.name}: {failure or 'this case violates nothing'}")
    return REFUTED if failure is not None else None


@verb("verify")
def verify(
    run: Annotated[str, typer.Argument(metavar="RUN", help="A run folder, or a certificate file.")],
) -> int:
    """Check the certificate of a run, independently of how it was made.

    Exit codes: 0 VERIFIED, 5 REJECTED, 6 UNKNOWN, 2 nothing to check.
    """
    from ..certificate.__main__ import main
    from ..model.errors import ScenarioError

    place = Path(run)
    if not (place / "certificate.json" if place.is_dir() else place).is_file():
        there = "it has no certificate.json" if place.is_dir() else "there is no such file or folder"
        raise ScenarioError("run", run, f"must be a run folder or a certificate; {there}")
    return main([run])
