"""A program that answers one line of JSON for each line of JSON: a black box in any language.

A question is ``{"t": 12.5, "x": [[...], ...], "reference": [...]}``: time [s], states of any number of
flights, and the state of the safe reference there. The answer is ``{"u": [[...], ...]}``, a command for each.
"""

from __future__ import annotations

import json
import subprocess
import tempfile
import threading
from collections.abc import Sequence
from types import TracebackType
from typing import Any, Self

from ..model.checks import positive
from ..model.errors import ScenarioError
from ..model.system import Array

LONGEST = 100_000_000  # most bytes of an answer


class Program:
    """A black box to ask, for as long as the ``with`` statement lasts.

    Parameters
    ----------
    command : sequence of str
        The program and its arguments; no shell reads them.
    seconds : float
        Time it has for each answer.

    Raises
    ------
    ScenarioError
        If it cannot be started, ends, is silent for too long, or answers something else than JSON with "u".
    """

    def __init__(self, command: Sequence[str], seconds: float = 10.0) -> None:
        self.command, self.seconds = list(command), positive("seconds", seconds, "s")
        self._heard: Any = tempfile.TemporaryFile()  # noqa: SIM115  closed with the program
        pipe, shown = subprocess.PIPE, " ".join(self.command)[:100]
        try:
            self._process = subprocess.Popen(self.command, stdin=pipe, stdout=pipe, stderr=self._heard)
        except (OSError, ValueError, IndexError) as error:
            self._heard.close()
            raise ScenarioError("black box", shown, f"cannot be started: {error}") from error

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._process.kill()
        self._process.communicate()
        self._heard.close()

    def __call__(self, t: float, x: Array, xi: Array) -> Any:
        """Commands for states (R, n) at a time, beside the state of the safe reference."""
        question = json.dumps({"t": t, "x": x.tolist(), "reference": xi.tolist()}) + "\n"
        found: list[bytes] = []
        asking = threading.Thread(target=self._ask, args=(question.encode(), found), daemon=True)
        asking.start()
        asking.join(self.seconds)
        if asking.is_alive():
            self._process.kill()
            raise self._refused(f"must answer within {self.seconds:g} s")
        if not found or not found[0].endswith(b"\n"):
            self._process.kill()
            raise self._refused(f"must answer each line; it ended, or wrote too much{self._last_words()}")
        try:
            return json.loads(found[0])["u"]
        except (ValueError, TypeError, KeyError, RecursionError):
            raise self._refused(f'must answer {{"u": [[...], ...]}}; answered {found[0][:60]!r}') from None

    def _ask(self, question: bytes, found: list[bytes]) -> None:
        assert self._process.stdin is not None and self._process.stdout is not None
        try:
            self._process.stdin.write(question)
            self._process.stdin.flush()
            found.append(self._process.stdout.readline(LONGEST))
        except (OSError, ValueError):  # it has ended; whoever asked says so
            return

    def _last_words(self) -> str:
        self._process.wait()
        self._heard.seek(0)
        lines = self._heard.read().decode(errors="replace").strip().splitlines()
        return f" (its last words: {lines[-1][:100]!r})" if lines else ""

    def _refused(self, rule: str) -> ScenarioError:
        return ScenarioError("black box", " ".join(self.command)[:100], rule)
