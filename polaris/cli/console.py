"""Progress on standard error."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.console import Console
from rich.text import Text

from ..model.errors import escape_controls
from ..runs.stages import Stages

if TYPE_CHECKING:
    from rich.progress import Progress


PATIENCE = 1.0  # seconds a stage may take before it is shown
WINDOW = 3600.0
"""Seconds over which speed is measured to tell the time left: a batch of a campaign may take minutes."""


class ShownStages(Stages):
    """Shows stages that take longer than `PATIENCE`, live or one line each when done; none if `quiet`."""

    def __init__(self, quiet: bool = False) -> None:
        super().__init__()
        self.quiet = quiet
        self.console = Console(stderr=True, highlight=False)
        self._bar: Progress | None = None

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time one stage, and show it if it takes long."""
        self._bar = bar = None if self.quiet or not self.console.is_terminal else self._make_bar(name)
        timer = threading.Timer(PATIENCE, bar.start if bar else lambda: None)
        timer.daemon = True
        timer.start()
        try:
            with super().stage(name):
                yield
        finally:
            timer.cancel()
            timer.join()
            if bar is not None:
                bar.stop()
            self._bar = None
        if not self.quiet and self.seconds[name] > PATIENCE:
            self.console.print(Text(escape_controls(f"{name}: {self.seconds[name]:.1f} s")))

    def _make_bar(self, name: str) -> Progress:
        from rich import progress

        columns = (
            progress.SpinnerColumn(),
            progress.TextColumn("{task.description}", markup=False),
            progress.BarColumn(20),
            progress.TimeElapsedColumn(),
            progress.TimeRemainingColumn(),
        )
        bar = progress.Progress(*columns, console=self.console, transient=True, speed_estimate_period=WINDOW)
        bar.add_task(name, total=None)
        return bar

    def note(self, text: str, done: int = 0, total: int | None = None) -> None:
        """Print the activity of the stage, and its progress if that is known."""
        if self._bar is not None:
            self._bar.update(self._bar.task_ids[0], completed=done, total=total)
            self._bar.update(self._bar.task_ids[0], description=escape_controls(text))
