"""The command ``polaris report``."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Annotated

import typer

Guard = Callable[[], AbstractContextManager[None]]


def add_report(app: typer.Typer, guard: Guard) -> None:
    """Add the command to the application; `guard` turns errors into messages and exit codes."""

    @app.command("report")
    def report_command(
        folder: Annotated[
            str,
            typer.Argument(metavar="RUN_OR_COMPARISON", help="A run folder or a folder of polaris compare."),
        ],
        out: Annotated[
            str | None, typer.Option("--out", metavar="FILE.html", help="Default report.html in the folder.")
        ] = None,
        quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Show nothing but errors.")] = False,
    ) -> None:
        """Write an interactive report: one HTML file that needs no network."""
        with guard():
            from ..report import write_report
            from .console import Stages

            with Stages(quiet).stage("report"):
                path = write_report(folder, out)
            if not quiet:
                typer.echo(str(path))
