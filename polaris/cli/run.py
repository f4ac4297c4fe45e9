"""Commands about scenarios and run folders: run, check, scenarios, plot, report, export."""

from typing import Any, Literal

from typer import Argument, Option

from .shell import REFUTED, Assignments, BlackBoxes, Force, Name, Output, Quiet, echo, verb

FOLDER = Argument(..., metavar="RUN_OR_COMPARISON", help="A run folder, or a folder of polaris compare.")


@verb("run")
def run(
    scenario: Name,
    programs: BlackBoxes,
    output: Output,
    out: str | None = Option(None, metavar="DIR", help="Run folder; default runs/<name of the scenario>."),
    assignments: Assignments = None,
    solver: Literal["facets", "highs", "gurobi"] | None = Option(
        None, help="Short for --set planner.solver=...; default facets."
    ),
    recoverable: Literal["polytope", "ball"] | None = Option(
        None, help="Short for --set recoverable.kind=...; default polytope."
    ),
) -> int:
    """Synthesise a schedule, prove it, simulate it, and write a run folder.

    An inspection scenario is flown under its filter instead, a Monte Carlo on all processors. A single
    flight that violates a constraint or its fuel limit ends with exit code 5.
    """
    shortcuts = {"planner.solver": solver, "recoverable.kind": recoverable}
    overrides = [*(assignments or []), *(f"{key}={value}" for key, value in shortcuts.items() if value)]
    stages = output.stages
    with stages.stage("load"):
        from ..runs.campaign.workers import local
        from ..runs.run import run as run_scenario
        from ..scenario.scenario import load_scenario

        loaded = load_scenario(scenario, overrides)
        if not output.quiet:
            _show_warnings(loaded, err=True)
    with programs.running() as boxes:
        settings: dict[str, Any] = {"draw": output.draw, "stages": stages, "executor": local()}
        folder = run_scenario(loaded, out, black_boxes=boxes, **settings)
    if folder.kind.name == "schedule" and folder.summary["guarantee"]["kind"] == "statistical":
        echo("warning: the guarantee is statistical, as steps of black boxes rest on samples", err=True)
    if not folder.summary.get("model_error", {"covered": True})["covered"]:
        text = "the disturbance bound does not cover the model error, so the proof holds for the linear model"
        hint = "raise system.disturbance_max_m_s2 (see polaris model-error --fit)"
        echo(f"warning: {text} only; {hint}", err=True)
    output.finish(folder)
    return 0 if folder.summary.get("safe", True) else REFUTED


@verb("check")
def check(file: Name, assignments: Assignments = None) -> None:
    """Validate a scenario without running it, and note values whose unit or scale looks wrong."""
    from ..scenario.scenario import load_scenario

    scenario = load_scenario(file, assignments or ())
    echo(f"{scenario.name} is valid: {scenario.outline()}")
    _show_warnings(scenario)


def _show_warnings(scenario: Any, err: bool = False) -> None:
    from ..scenario.scenario_warnings import scenario_warnings

    for note in (*scenario.derived, *scenario_warnings(scenario)):
        echo(f"note: {note}", err=err)


@verb("scenarios")
def scenarios() -> None:
    """List the bundled scenarios."""
    from ..scenario.reading import read_document
    from ..scenario.scenario import bundled_files

    bundled = bundled_files()
    width = max(map(len, bundled), default=0)
    for name, path in bundled.items():
        echo(f"{name:{width}}  {read_document(path)[0]['title']}")


@verb("plot")
def plot(folder: str = FOLDER, quiet: Quiet = False) -> None:
    """Redraw the figures of a run folder from its files."""
    from ..report.figures import draw_run
    from ..runs.run import read_run
    from .console import ShownStages

    with ShownStages(quiet).stage("figures"):
        paths = draw_run(read_run(folder))
    if not quiet:
        echo("\n".join(str(path) for path in paths))


@verb("report")
def report(
    folder: str = FOLDER,
    out: str | None = Option(
        None, metavar="FILE", help="Output file; default report.html or dossier.pdf in the folder."
    ),
    dossier: bool = Option(
        False,
        "--dossier",
        help="PDF of at most twelve pages: the checked evidence of the run, clause by clause.",
    ),
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Write an interactive report as one offline HTML file, or a dossier as PDF."""
    from ..report import write_report
    from .console import ShownStages

    with ShownStages(quiet).stage("report"):
        path = write_report(folder, out, dossier=dossier, force=force)
    if not quiet:
        echo(str(path))


@verb("export oem")
def export_oem_command(
    run: str = Argument(..., metavar="RUN", help="A run folder whose scenario has [orbit.elements]."),
) -> None:
    """Write target, reference, branches and flights of a run as CCSDS OEM files in inertial axes.

    The files are written to the subfolder oem of the run folder.
    """
    from ..runs.files.ephemerides import export_oem

    echo("\n".join(map(str, export_oem(run))))


@verb("export c")
def export_c_command(
    run: str = Argument(..., metavar="RUN", help="A run folder with a proven schedule."),
    out: str = Option(..., metavar="DIR", help="Folder for the code."),
    precision: Literal["double", "float"] = Option("double", help="Floating-point type of the code."),
    prefix: str | None = Option(None, help="Prefix of names; default polaris_ and the scenario's name."),
    glue: Literal["fprime", "cfs"] | None = Option(None, help="Add an F' component or cFS application."),
    name: str | None = Option(None, help="Name of the component or application; default from the prefix."),
    module: str = Option("Components", help="Module of the F' component."),
    monitor: bool = Option(False, "--monitor", help="Include the online monitor."),
    observer: bool = Option(False, "--observer", help="Include the observer, fed by measurements."),
) -> None:
    """Write safety controller, schedule and reference of a run as C99 with a self-test."""
    from ..flight.export import export_c

    echo("\n".join(map(str, export_c(run, out, precision, prefix, glue, name, module, monitor, observer))))
