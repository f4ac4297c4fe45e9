"""The command ``polaris``: run a scenario, check one, list those that come along, redraw figures.

Exit codes: 0 done, 1 fault of the program, 2 bad input, 3 no safe synthesis exists, 4 none certified
in the time given, 5 a counterexample was found, or a declared bound does not hold. Results go to standard
output, progress and errors to standard error. A run that proves nothing (only the option ``paper_ball``
does) ends with 0 and a warning on standard error.
"""

from __future__ import annotations

import os
import shlex
import signal
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from enum import StrEnum
from typing import Annotated, Any, NoReturn

import typer

from reach.numerics.errors import ReachError

from ..model.errors import ClockWarning, PolarisError
from .attacks import add_commands
from .campaign import add_campaign
from .compare import add_compare
from .inspection import run_inspection, told_valid
from .report import add_report
from .traces import add_traces
from .verify import add_verify

app = typer.Typer(
    name="polaris",
    help="Switching schedules between a safety controller and experimental ones, proven before the flight.",
    epilog="Exit codes: 0 done, 2 bad input, 3 no safe synthesis, 4 not certified in the time given,"
    " 5 a counterexample, a bound or a certificate that does not hold, 6 a certificate not decided."
    " Code 0 with a warning on standard error: done, but nothing is proven (recoverable kind paper_ball).",
    rich_markup_mode=None,  # markup swallows [m/s] or <scenario>
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)


class Solver(StrEnum):
    """Who decides in the planner."""

    facets = "facets"
    highs = "highs"
    gurobi = "gurobi"


class Kind(StrEnum):
    """Kinds of recoverable sets."""

    polytope = "polytope"
    time_varying_ball = "time_varying_ball"
    ball = "ball"
    paper_ball = "paper_ball"


def complete_scenario(incomplete: str) -> list[str]:
    """Names of bundled scenarios and of files that a shell may complete a word to."""
    from ..scenario.scenario import bundled_files

    names = [name for name in bundled_files() if name.startswith(incomplete)]
    folder, _, start = incomplete.rpartition("/")
    try:
        here = sorted(
            os.scandir(folder or ("/" if incomplete.startswith("/") else ".")), key=lambda one: one.name
        )
    except OSError:
        return names
    prefix = incomplete[: len(incomplete) - len(start)]
    files = [
        f"{prefix}{one.name}{'/' if one.is_dir() else ''}"
        for one in here
        if one.name.startswith(start) and (one.is_dir() or one.name.endswith(".toml")) and one.name[0] != "."
    ]
    return names + files


Name = Annotated[
    str,
    typer.Argument(
        metavar="NAME_OR_FILE",
        help="A bundled scenario (see `polaris scenarios`) or a file.",
        autocompletion=complete_scenario,
    ),
]
Assignments = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Override a value, as in planner.gap=0.01; repeatable."),
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print nothing but errors.")]


def _version(wanted: bool) -> None:
    if wanted:
        from ..model.version import version

        typer.echo(f"polaris {version()}")
        raise typer.Exit


@app.callback()
def main(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Options that come before the command."""
    # The matrices here are small: threads of the linear algebra library cost more than they give, and
    # one thread adds up in the same order every time. It is read when numpy is first imported.
    for library in ("OPENBLAS", "OMP", "MKL"):
        os.environ.setdefault(f"{library}_NUM_THREADS", "1")


@app.command()
def run(
    scenario: Name,
    out: Annotated[
        str | None,
        typer.Option("--out", metavar="DIR", help="Run folder; default runs/<name of the scenario>."),
    ] = None,
    assignments: Assignments = None,
    solver: Annotated[
        Solver | None, typer.Option(help="Short for --set planner.solver=...; default facets.")
    ] = None,
    recoverable: Annotated[
        Kind | None,
        typer.Option(help="Short for --set recoverable.kind=...; with paper_ball nothing is proven."),
    ] = None,
    figures: Annotated[
        bool, typer.Option("--figures/--no-figures", help="Draw the figures; `polaris plot` can do so later.")
    ] = True,
    as_json: Annotated[
        bool, typer.Option("--json", help="Print the summary as JSON, and nothing else.")
    ] = False,
    quiet: Quiet = False,
) -> None:
    """Synthesise a schedule, prove it, fly it in simulation, and write a run folder.

    A scenario of the inspection problem is flown under its filter instead.
    """
    overrides = list(assignments or [])
    if solver is not None:
        overrides.append(f"planner.solver={solver.value}")
    if recoverable is not None:
        overrides.append(f"recoverable.kind={recoverable.value}")
    with _answering():
        from ..scenario.scenario import kind_of

        if kind_of(scenario) is not None:
            run_inspection(scenario, out, overrides, figures, as_json, quiet)
            return
        folder = _run(scenario, out, overrides, figures, quiet, quiet or as_json)
        claim, kind = folder.summary["guarantee"]["kind"], folder.summary["synthesis"]["recoverable"]
        if claim != "proved":  # even if asked to be quiet
            warning = "NOTHING IS PROVEN by this run, whatever its simulation shows"
            typer.echo(f"warning: {warning} (recoverable kind {kind}, guarantee {claim})", err=True)
        if as_json:
            sys.stdout.write((folder.path / "summary.json").read_text(encoding="utf-8"))
        elif not quiet:
            from .console import show_summary

            show_summary(folder.summary, str(folder.path))
            if not figures:
                typer.echo(f"To draw the figures: polaris plot {shlex.quote(str(folder.path))}")


def _run(name: str, out: str | None, overrides: list[str], figures: bool, quiet: bool, silent: bool) -> Any:
    """All stages, from the scenario file to the run folder."""
    from .console import Stages

    stages = Stages(silent)
    with stages.stage("load"):
        from dataclasses import replace

        from ..runs.atomic import check_target
        from ..runs.folder import write_run
        from ..scenario.scenario import load_scenario

        scenario = load_scenario(name).with_assignments(overrides)
        target = check_target(out if out is not None else f"runs/{scenario.name}")
        if not quiet:
            _tell_doubts(scenario, err=True)
    with stages.stage("safety controller"):
        from ..simulation.baselines import compare
        from ..synthesis.get_safety import get_safety
        from ..synthesis.synthesize import synthesize

        problem = scenario.problem()
        safety = get_safety(replace(problem, planner=replace(problem.planner, progress=stages.planner)))
    with stages.stage("experimental controllers"):
        experimental = scenario.controllers(safety)
    with stages.stage("schedule"):
        schedule = synthesize(scenario, safety, experimental, progress=stages.steps)
    with stages.stage("simulation"):
        flown = compare(schedule, scenario.simulation.runs, scenario.simulation.seed, stages.runs)
    spent = {
        "load": stages.seconds["load"],
        "experimental": stages.seconds["experimental controllers"],
        "simulation": stages.seconds["simulation"],
    }
    with stages.stage("run folder"):
        return write_run(
            target,
            scenario,
            schedule,
            flown,
            overrides=overrides,
            seconds=spent,
            figures=figures,
            progress=stages.note,
        )


@app.command()
def check(file: Name, assignments: Assignments = None) -> None:
    """Validate a scenario without running it, and say what looks like a slip of units or scale."""
    with _answering():
        from ..model.checks import counted
        from ..scenario.scenario import kind_of, load_scenario

        overrides = list(assignments or [])
        if kind_of(file) is not None:
            typer.echo(told_valid(file, overrides))
            return
        scenario = load_scenario(file).with_assignments(overrides)
        system = scenario.system()
        sets = len(scenario.model.obstacles) + len(scenario.model.keep_in)
        typer.echo(
            f"{scenario.name} is valid: {counted(system.n, 'state')}, {counted(system.m, 'input')},"
            f" {counted(scenario.steps, 'step')} of {scenario.step:g} s, unsafe sets: {sets},"
            f" experimental controllers: {len(scenario.experimental_specs())}"
        )
        _tell_doubts(scenario)


def _tell_doubts(scenario: Any, err: bool = False) -> None:
    from ..scenario.plausibility import doubts

    for doubt in doubts(scenario):
        typer.echo(f"note: {doubt}", err=err)


@app.command()
def scenarios() -> None:
    """List the scenarios that come along."""
    with _answering():
        import tomllib

        from ..scenario.scenario import bundled_files, scenario_folder

        names = bundled_files()
        width = max(map(len, names), default=0)
        for name in names:
            text = (scenario_folder() / f"{name}.toml").read_text(encoding="utf-8")
            typer.echo(f"{name:{width}}  {tomllib.loads(text)['title']}")


@app.command()
def plot(
    folder: Annotated[str, typer.Argument(metavar="RUN", help="A run folder.")], quiet: Quiet = False
) -> None:
    """Redraw the figures of a run folder from its files alone."""
    with _answering():
        from ..runs.folder import read_run
        from ..runs.inspection import is_inspection
        from ..runs.inspection import read_run as read_inspection
        from .console import Stages

        with Stages(quiet).stage("figures"):
            drawn = read_inspection(folder).draw() if is_inspection(folder) else read_run(folder).draw()
        if not quiet:
            typer.echo("\n".join(str(path) for path in drawn))


# -- how it ends ------------------------------------------------------------------------------------


@contextmanager
def _answering() -> Iterator[None]:
    """Turn everything that can go wrong into one message and an exit code; tell of a clock that struck."""
    ends = [signal.SIGTERM, *([signal.SIGHUP] if hasattr(signal, "SIGHUP") else [])]
    heard = [number for number in ends if signal.getsignal(number) != signal.SIG_IGN]  # nohup
    before = {number: signal.signal(number, _terminated) for number in heard}
    try:
        with _warning():
            yield
    except PolarisError as error:
        _fail(str(error), error.exit_code)
    except KeyboardInterrupt:
        _fail("interrupted; no run folder was changed", 130)
    except BrokenPipeError:
        raise typer.Exit(0) from None
    except MemoryError:
        _fail("out of memory; fewer steps, runs or obstacles need less", 1)
    except OSError as error:
        _fail(f"{error.filename or 'the system'}: {error.strerror or error}", 2)
    except ReachError as error:  # numbers beyond floating point
        _fail(f"not certified: {error}", 4)
    except Exception as error:  # a fault of the program: still one message, with where it happened
        _fail(f"internal fault ({_where(error)}): {type(error).__name__}: {error}", 1)
    finally:
        for number, known in before.items():
            signal.signal(number, known)


@contextmanager
def _warning() -> Iterator[None]:
    """Warnings of the planner's clock on standard error, each once, even if asked to be quiet."""
    with warnings.catch_warnings():
        told: list[str] = []
        known = warnings.showwarning

        def show(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
            if not issubclass(category, ClockWarning):
                known(message, category, *where, **more)
            elif str(message) not in told:
                told.append(str(message))

        warnings.simplefilter("always", ClockWarning)
        warnings.showwarning = show
        try:
            yield
        finally:
            for text in told:
                typer.echo(f"warning: {text}", err=True)


def _terminated(number: int, frame: Any) -> NoReturn:
    """Leave like after an error, so that nothing half-written stays."""
    raise SystemExit(128 + number)


def _where(error: BaseException) -> str:
    trace = error.__traceback__
    while trace is not None and trace.tb_next is not None:
        trace = trace.tb_next
    return f"{trace.tb_frame.f_globals.get('__name__', '?')}:{trace.tb_lineno}" if trace else "?"


def _fail(message: str, code: int) -> NoReturn:
    typer.echo(f"error: {' '.join(message.split())}", err=True)
    raise typer.Exit(code) from None


add_commands(app, _answering)
add_verify(app, _answering)
add_compare(app, _answering)
add_campaign(app, _answering)
add_report(app, _answering)
add_traces(app, _answering)

if __name__ == "__main__":
    app()
