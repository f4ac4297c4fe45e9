"""The command ``polaris verify``: check the certificate of a run."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Annotated

import typer


def add_verify(app: typer.Typer, guard: Callable[[], AbstractContextManager[None]]) -> None:
    """Add the command to the application; `guard` turns errors into messages and exit codes."""

    @app.command()
    def verify(
        run: Annotated[str, typer.Argument(metavar="RUN", help="A run folder, or a certificate file.")],
    ) -> None:
        """Check the certificate of a run, independently of how it was made.

        Exit codes: 0 VERIFIED, 5 REJECTED, 6 UNKNOWN, 2 nothing to check.
        """
        from ..certificate.__main__ import main
        from ..model.errors import ScenarioError

        with guard():
            place = Path(run)
            if not (place / "certificate.json" if place.is_dir() else place).is_file():
                there = "it has no certificate.json" if place.is_dir() else "there is no such file or folder"
                raise ScenarioError("run", run, f"must be a run folder or a certificate; {there}")
            code = main([run])
        raise typer.Exit(code)
