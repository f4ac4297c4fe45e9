"""The verbs for traces of RTAEval: evaluate, export."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

import typer

from ..model.errors import ScenarioError
from .shell import Json, Quiet, print_json, verb


class Controller(StrEnum):
    """Who flies in a run folder."""

    polaris = "polaris"
    safety = "safety"
    experimental = "experimental"


@verb("evaluate")
def evaluate_command(
    trace: Annotated[str, typer.Argument(metavar="TRACE", help="A trace, as JSON.")],
    legacy: Annotated[
        bool, typer.Option("--legacy", help="The numbers RTAEval itself gives, defects included.")
    ] = False,
    restamp: Annotated[
        bool, typer.Option("--restamp", help="Undo the stamps of RTAEval's simulator first.")
    ] = False,
    dims: Annotated[
        int | None, typer.Option(min=1, max=3, help="Axes of position; default as the sets have.")
    ] = None,
    velocity: Annotated[
        str | None,
        typer.Option(
            metavar="ENTRIES",
            help="Entries of the states that are the velocity, as in 3,4,5 (from 0), or 'differences' of"
            " positions. Default: what follows the position in 2, 4 or 6 states, if the position changes"
            " so, else differences.",
        ),
    ] = None,
    heading: Annotated[
        str | None,
        typer.Option(
            metavar="ENTRIES", help="Entries that are heading, or heading and pitch [rad], as in 3,4."
        ),
    ] = None,
    speed: Annotated[
        int | None, typer.Option(metavar="ENTRY", min=0, help="The entry that is the speed [m/s].")
    ] = None,
    mean_motion: Annotated[
        float | None,
        typer.Option(metavar="RAD_S", help="The frame is Hill's: time to collision along free drift too."),
    ] = None,
    agent_radius: Annotated[
        float, typer.Option(metavar="M", help="Agents count as having met within this distance.")
    ] = 0.0,
    as_json: Json = False,
    quiet: Quiet = False,
) -> None:
    """Measure a trace: distances, times to collision, usage of modes, switches."""
    from ..model.checks import positive
    from ..model.hill import clohessy_wiltshire
    from ..traces import LegacyMetrics, TraceMetrics, evaluate_legacy, evaluate_trace, read_trace
    from ..traces.settings import parse_velocity
    from .show.traces import show_metrics

    if legacy and (restamp or mean_motion is not None or agent_radius != 0):
        rule = "excludes --restamp, --mean-motion and --agent-radius: RTAEval has none of them"
        raise ScenarioError("--legacy", True, rule)
    system = None
    if mean_motion is not None:
        eta = positive("--mean-motion", mean_motion, "rad/s")
        system = clohessy_wiltshire(eta, mass=1.0, u_max=1.0)
    read, wanted = read_trace(trace), parse_velocity(velocity, heading, speed)
    found: TraceMetrics | LegacyMetrics
    if legacy:
        found = evaluate_legacy(read, dims=dims, velocity=wanted)
    else:
        found = evaluate_trace(
            read, dims=dims, velocity=wanted, restamp=restamp, system=system, agent_radius=agent_radius
        )
    if as_json:
        print_json(found.summary())
    elif not quiet:
        show_metrics(found)


@verb("export")
def export_command(
    run: Annotated[str, typer.Argument(metavar="RUN", help="A run folder, or a comparison folder.")],
    trace: Annotated[str, typer.Argument(metavar="TRACE", help="The trace to write, as JSON.")],
    controller: Annotated[
        Controller | None, typer.Option(help="Whose run of a run folder; default polaris.")
    ] = None,
    method: Annotated[
        str | None,
        typer.Option(
            metavar="KEY",
            help="Whose flight of a comparison folder: schedule (default), monitor, asif_implicit, ...",
        ),
    ] = None,
    label: Annotated[
        str, typer.Option("--run", metavar="LABEL", help="Which run: closest, nominal, 'run 0', ...")
    ] = "closest",
    nominal: Annotated[
        bool,
        typer.Option(
            "--nominal",
            help="Other satellites as balls about where they are nominally, not as polytopes.",
        ),
    ] = False,
    quiet: Quiet = False,
) -> None:
    """Write one flight of a folder, with its unsafe sets, as a trace that RTAEval can read."""
    from ..model.checks import counted
    from ..runs.atomic import check_file
    from ..runs.run import read_run
    from ..traces.export import export_run
    from ..traces.writing import write_trace

    check_file(trace, "trace", (".json",))
    compared = read_run(run).kind.name == "comparison"
    if controller is not None and (compared or method is not None):
        rule = "must be left out for a comparison, which has methods"
        raise ScenarioError("--controller", controller.value, rule)
    if method is not None and not compared:
        raise ScenarioError("--method", method, f"{run} must be a comparison folder")
    pilot = method or ("schedule" if compared else (controller or Controller.polaris).value)
    found = export_run(run, pilot, label, nominal=nominal)
    path = write_trace(trace, found.trace)
    if not quiet:
        agent = next(iter(found.trace.agents.values()))
        typer.echo(
            f"{path}: run {label!r} of {pilot}, {counted(len(agent.times), 'sample')} over"
            f" {agent.times[-1] - agent.times[0]:g} s, unsafe sets: {len(found.trace.unsafe)}"
        )
        for note in found.notes:
            typer.echo(f"note: {note}")
