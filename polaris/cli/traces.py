"""Commands for traces of RTAEval: evaluate, export."""

from dataclasses import dataclass
from functools import partial
from typing import Any

from typer import Argument, Option

from ..model.errors import ScenarioError, quoted
from .shell import Force, Json, Quiet, echo, print_result, verb


@dataclass
class EvaluateOptions:
    """Options of ``polaris evaluate``."""

    legacy: bool = Option(False, "--legacy", help="Compute the numbers of RTAEval itself, defects included.")
    restamp: bool = Option(False, "--restamp", help="Correct the time stamps of RTAEval's simulator first.")
    dims: int | None = Option(None, min=1, max=3, help="Number of position axes; default that of the sets.")
    velocity: str | None = Option(
        None,
        metavar="ENTRIES",
        help="Velocity entries of the state, such as 3,4,5 (counted from 0), or 'differences' of positions."
        " Default: the entries after the position in 2, 4 or 6 states if they agree with its change, else"
        " differences.",
    )
    heading: str | None = Option(None, metavar="ENTRIES", help="Heading, or heading,pitch entries [rad].")
    speed: int | None = Option(None, metavar="ENTRY", min=0, help="Speed entry [m/s].")
    mean_motion: float | None = Option(
        None, metavar="RAD_S", help="Mean motion of Hill's frame; adds times to collision in drift."
    )
    agent_radius: float = Option(0.0, metavar="M", help="Distance at which two agents collide.")
    as_json: Json = False
    quiet: Quiet = False


@verb("evaluate")
def evaluate_command(
    options: EvaluateOptions, trace: str = Argument(..., metavar="TRACE", help="Trace file, JSON.")
) -> None:
    """Evaluate a trace: distances, times to collision, use of modes, switches."""
    from ..model.checks import positive
    from ..model.hill import clohessy_wiltshire
    from ..traces import evaluate_legacy, evaluate_trace, read_trace
    from ..traces.settings import parse_velocity
    from .show.traces import show_legacy, show_metrics

    eta = options.mean_motion
    if options.legacy and (options.restamp or eta is not None or options.agent_radius != 0):
        rule = "must be left out with --restamp, --mean-motion or --agent-radius, which RTAEval does not have"
        raise ScenarioError("--legacy", True, rule)
    system = None
    if eta is not None:
        system = clohessy_wiltshire(positive("--mean-motion", eta, "rad/s"), mass=1.0, u_max=1.0)
    velocity = parse_velocity(options.velocity, options.heading, options.speed)
    axes: dict[str, Any] = {"dims": options.dims, "velocity": velocity}
    loaded = read_trace(trace)
    if options.legacy:
        agents = evaluate_legacy(loaded, **axes)
        summary, show = {"legacy_rtaeval": True, "agents": agents}, partial(show_legacy, agents)
    else:
        radius = options.agent_radius
        metrics = evaluate_trace(loaded, restamp=options.restamp, system=system, agent_radius=radius, **axes)
        summary, show = metrics.summary(), partial(show_metrics, metrics)
    print_result(summary, options.as_json, (lambda: None) if options.quiet else show)


@verb("export")
def export_command(
    run: str = Argument(..., metavar="RUN", help="A run folder, or a comparison folder."),
    trace: str = Argument(..., metavar="TRACE", help="Trace file to write, JSON."),
    controller: str | None = Option(
        None,
        metavar="KEY",
        help="Controller, for a run folder: polaris (default), safety, experimental, experimental_2, ...",
    ),
    method: str | None = Option(
        None,
        metavar="KEY",
        help="Method, for a comparison folder: schedule (default), monitor, asif_implicit, ...",
    ),
    label: str = Option("closest", "--run", help="Run: closest, nominal, 'run 0', ..."),
    nominal: bool = Option(
        False, "--nominal", help="Write satellites as balls about their nominal positions, not polytopes."
    ),
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Write one flight of a folder, with its unsafe sets, as a trace for RTAEval."""
    from ..model.checks import counted
    from ..runs.files.atomic import check_file
    from ..runs.run import read_run
    from ..traces.export import export_run
    from ..traces.reading import write_trace

    check_file(trace, "trace", (".json",), force)
    compared = read_run(run).kind.name == "comparison"
    if controller is not None and (compared or method is not None):
        rule = "must be left out for a comparison folder; use --method"
        raise ScenarioError("--controller", controller, rule)
    if method is not None and not compared:
        raise ScenarioError("--method", method, f"must be left out, as {run} is no comparison folder")
    pilot = method or ("schedule" if compared else controller or "polaris")
    exported = export_run(run, pilot, label, nominal=nominal)
    path = write_trace(trace, exported.trace, force=force)
    if not quiet:
        agent = next(iter(exported.trace.agents.values()))
        echo(
            f"{path}: run {quoted(label)} of {pilot}, {counted(len(agent.times), 'sample')} over"
            f" {agent.times[-1] - agent.times[0]:g} s, keep-out zones: {len(exported.trace.unsafe)}"
        )
        for note in exported.notes:
            echo(f"note: {note}")
