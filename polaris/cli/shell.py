"""Application, options and exit codes shared by the commands."""

from __future__ import annotations

import os
import shlex
import signal
import sys
import traceback
import warnings
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, fields, is_dataclass
from functools import cached_property, wraps
from inspect import Parameter, Signature, signature
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn, get_type_hints

import typer
from typer.core import TyperGroup

from reach.numerics import packages
from reach.numerics.errors import ReachError

from ..model.errors import ClockWarning, PolarisError, ScenarioError, escape_controls, failed

if TYPE_CHECKING:
    from ..runs.files.folder import RunFolder
    from ..runs.stages import Stages
    from ..synthesis.controllers.black_box import Ask


class _Verbs(TyperGroup):
    """Verbs by name, which may be two words, as in ``export oem``."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Take two words for one verb, if there is one."""
        pair = " ".join(args[:2])
        return super().resolve_command(ctx, [pair, *args[2:]] if pair in self.commands else args)


app = typer.Typer(
    name="polaris",
    cls=_Verbs,
    help="Switching schedules between a safety controller and experimental ones, proven before the flight.",
    epilog="Exit codes: 0 success; 2 bad input; 3 no safe schedule found; 4 not certified within the limits"
    " of effort; 5 refuted: a counterexample, a bound or certificate that does not hold, or a violated"
    " constraint of an inspection flight; 6 certificate undecided; 7 certificate rests on samples.",
    rich_markup_mode=None,  # markup swallows [m/s] or <scenario>
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)

REFUTED = 5  # exit code: a counterexample was found, a declared bound does not hold, a flight was not safe

# -- options ----------------------------------------------------------------------------------------


def complete_scenario(incomplete: str) -> list[str]:
    """Names of bundled scenarios and of files that a shell may complete a word to."""
    from ..scenario.scenario import bundled_files

    names = [name for name in bundled_files() if name.startswith(incomplete)]
    folder, slash, start = incomplete.rpartition("/")
    try:
        entries = sorted(Path(folder + slash or ".").iterdir())
    except OSError:
        return names
    matches = [one for one in entries if one.name.startswith(start) and one.name[0] != "."]
    files = [one for one in matches if one.is_dir() or one.suffix == ".toml"]
    return names + [f"{folder}{slash}{one.name}{'/' if one.is_dir() else ''}" for one in files]


Name = Annotated[
    str,
    typer.Argument(
        metavar="NAME_OR_FILE",
        help="A bundled scenario (see `polaris scenarios`) or a scenario file.",
        autocompletion=complete_scenario,
    ),
]
Target = Annotated[
    str,
    typer.Argument(
        metavar="RUN_OR_SCENARIO",
        help="A run folder, whose schedule is read, or a scenario, whose schedule is synthesised.",
        autocompletion=complete_scenario,
    ),
]
Assignments = Annotated[
    list[str] | None,
    typer.Option(
        "--set", metavar="KEY=VALUE", help="Override a value, such as planner.gap=0.01; repeatable."
    ),
]
Figures = Annotated[bool, typer.Option("--figures/--no-figures", help="Draw figures; later: `polaris plot`.")]
Json = Annotated[bool, typer.Option("--json", help="Print only the result, as JSON.")]
Force = Annotated[bool, typer.Option("--force", help="Replace an existing file that is not a result.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print only errors.")]


@dataclass
class BlackBoxes:
    """Options that name the programs of black boxes."""

    black_box: list[str] | None = typer.Option(
        None, metavar="NAME=COMMAND", help="Program of the black box NAME; repeatable."
    )
    answer_within: float = typer.Option(10.0, help="Time limit of each answer of a black box [s].")

    @property
    def commands(self) -> dict[str, list[str]]:
        """Words of every command, by the name of its black box."""
        commands: dict[str, list[str]] = {}
        for text in self.black_box or ():
            name, equals, command = text.partition("=")
            if not equals or name in commands:
                raise ScenarioError("--black-box", text, "must be NAME=COMMAND, with each NAME at most once")
            try:
                commands[name] = shlex.split(command)
            except ValueError as error:
                raise ScenarioError("--black-box", text, f"has an unreadable command: {error}") from error
        return commands

    @contextmanager
    def running(self) -> Iterator[dict[str, Ask]]:
        """Start the programs, which end with the ``with`` statement; yield their callers, by name."""
        from ..runs.black_box_program import black_box_program

        with ExitStack() as programs:
            pairs = self.commands.items()
            started = {name: black_box_program(words, self.answer_within) for name, words in pairs}
            yield {name: programs.enter_context(each) for name, each in started.items()}


@dataclass
class Output:
    """Options about printed output and figures."""

    figures: Figures = True
    as_json: Json = False
    quiet: Quiet = False

    @cached_property
    def stages(self) -> Stages:
        """Progress on standard error, unless nothing else than the result may be printed."""
        from .console import ShownStages

        return ShownStages(self.quiet or self.as_json)

    @property
    def draw(self) -> Any:
        """Return the function that draws figures, or None if none are wanted."""
        if not self.figures:
            return None
        from ..report.figures import draw_run

        return draw_run

    def finish(self, folder: RunFolder) -> None:
        """Print the summary of a run folder, and the command that draws its figures if they are missing."""
        if self.as_json:
            sys.stdout.write((folder.path / folder.kind.summary).read_text(encoding="utf-8"))
        elif not self.quiet:
            from .show import comparison, inspection, mission, schedule

            show: dict[str, Callable[[Any, str], None]] = {
                "schedule": schedule.show_summary,
                "inspection": inspection.show_flight,
                "fuel_limit": inspection.show_fuel,
                "monte_carlo": inspection.show_campaign,
                "mission": mission.show_mission,
                "comparison": comparison.show_comparison,
                "tradeoff": comparison.show_tradeoff,
            }
            show[folder.kind.name](folder.summary, str(folder.path))
            if not self.figures:
                echo(f"To draw the figures: polaris plot {shlex.quote(str(folder.path))}")


def _version(requested: bool) -> None:
    if requested:
        from ..model.version import version

        echo(f"polaris {version()}")
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


# -- what verbs have in common ----------------------------------------------------------------------


def verb(name: str, **options: Any) -> Callable[[Callable[..., int | None]], Callable[..., None]]:
    """Add a verb, `options` as typer takes it; it returns its exit code, or nothing where it went well.

    Fields of its parameters that are dataclasses become options of their own.
    """

    def add(work: Callable[..., int | None]) -> Callable[..., None]:
        hints = get_type_hints(work, include_extras=True)
        groups: dict[str, Any] = {key: hint for key, hint in hints.items() if is_dataclass(hint)}

        @wraps(work)
        def guarded(**values: Any) -> None:
            for key, group in groups.items():
                values[key] = group(**{one.name: values.pop(one.name) for one in fields(group)})
            with answering():
                try:
                    packages.check()
                except ReachError as error:  # versions that nobody tested
                    raise failed(str(error), 2) from None
                code = work(**values)
            if code:
                raise typer.Exit(code)

        parameters: list[Parameter] = []
        for key, one in signature(work).parameters.items():
            group = groups.get(key)
            types = get_type_hints(group, include_extras=True) if group else hints
            for item in fields(group) if group else [one]:
                attributes = {"default": item.default, "annotation": types[item.name]}
                parameters.append(Parameter(item.name, Parameter.KEYWORD_ONLY, **attributes))
        vars(guarded)["__signature__"] = Signature(parameters)
        app.command(name, **options)(guarded)
        return guarded

    return add


def echo(text: str, err: bool = False) -> None:
    """Print lines to standard output, or to standard error; no terminal obeys a name in them."""
    typer.echo(escape_controls(text), err=err)


def print_result(data: object, as_json: bool, show: Callable[[], None]) -> None:
    """Print a result as JSON, or show it."""
    from ..runs.files.tables import json_text

    if as_json:
        sys.stdout.write(json_text(data))
    else:
        show()


# -- how it ends ------------------------------------------------------------------------------------


@contextmanager
def answering() -> Iterator[None]:
    """Turn everything that can go wrong into one message and an exit code; tell of a clock that struck."""
    stop_signals = [signal.SIGTERM, *([signal.SIGHUP] if hasattr(signal, "SIGHUP") else [])]
    signals = [number for number in stop_signals if signal.getsignal(number) != signal.SIG_IGN]  # nohup
    handlers = {number: signal.signal(number, _terminated) for number in signals}
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
        _fail("out of memory; reduce the number of steps, runs or obstacles", 1)
    except OSError as error:
        _fail(f"{error.filename or 'the system'}: {error.strerror or error}", 2)
    except ReachError as error:  # numbers beyond floating point
        _fail(f"not certified: {error}", 4)
    except (typer.Exit, typer.Abort):
        raise
    except Exception as error:  # a fault of the program: still one message, with where it happened
        *_, (frame, line) = traceback.walk_tb(error.__traceback__)
        location = f"{frame.f_globals.get('__name__', '?')}:{line}"
        _fail(f"internal fault ({location}): {type(error).__name__}: {error}", 1)
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)


@contextmanager
def _warning() -> Iterator[None]:
    """Warnings of the planner's clock on standard error, each once, even if asked to be quiet."""
    caught: list[warnings.WarningMessage] = []
    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always", ClockWarning)
            yield
    finally:
        for text, one in {str(one.message): one for one in caught}.items():
            if issubclass(one.category, ClockWarning):
                echo(f"warning: {text}", err=True)
            else:
                warnings.warn_explicit(one.message, one.category, one.filename, one.lineno)


def _terminated(number: int, frame: Any) -> NoReturn:
    """Leave like after an error, so that nothing half-written stays."""
    raise SystemExit(128 + number)


def _fail(message: str, code: int) -> NoReturn:
    echo(f"error: {' '.join(message.split())}", err=True)
    raise typer.Exit(code) from None
