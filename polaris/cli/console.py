"""Progress on standard error."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.console import Console
from rich.text import Text

from ..runs.stages import Stages

if TYPE_CHECKING:
    from rich.progress import Progress as Bar

PATIENCE = 1.0
"""Seconds a stage may take before it is shown."""


class ShownStages(Stages):
    """Shows stages that take longer than `PATIENCE`: live on a terminal, one line each when done.

    Parameters
    ----------
    quiet : bool
        Show nothing.
    """

    def __init__(self, quiet: bool = False) -> None:
        super().__init__()
        self.quiet = quiet
        self.console = Console(stderr=True, highlight=False)
        self._text, self._done = "", 0
        self._total: int | None = None
        self._lock = threading.Lock()
        self._bar: Bar | None = None

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time one stage, and show it if it takes long."""
        with self._lock:
            self._text, self._done, self._total = name, 0, None
        timer = threading.Timer(PATIENCE, self._show)
        timer.daemon = True
        if not self.quiet and self.console.is_terminal:
            timer.start()
        try:
            with super().stage(name):
                yield
        finally:
            timer.cancel()
            with self._lock:
                if self._bar is not None:
                    self._bar.stop()
                    self._bar = None
        if not self.quiet and self.seconds[name] > PATIENCE:
            self.console.print(Text(f"{name}: {self.seconds[name]:.1f} s"))

    def _show(self) -> None:
        from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

        columns = (
            SpinnerColumn(),
            TextColumn("{task.description}", markup=False),
            BarColumn(20),
            TimeElapsedColumn(),
        )
        with self._lock:
            if self._bar is None:
                self._bar = Progress(*columns, console=self.console, transient=True)
                self._bar.add_task(self._text, total=self._total, completed=self._done)
                self._bar.start()

    def note(self, text: str, done: int = 0, total: int | None = None) -> None:
        """Say what the stage is doing, and how far it is if that is known."""
        with self._lock:
            self._text, self._done, self._total = text, done, total
            if self._bar is not None:
                self._bar.update(self._bar.task_ids[0], description=text, completed=done, total=total)
