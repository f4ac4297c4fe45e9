"""A program that answers one line of JSON for each line of JSON: a black box in any language.

A question is ``{"t": 12.5, "x": [[...], ...], "reference": [...]}``: time [s], states of any number of
flights, and the state of the safe reference there. The answer is ``{"u": [[...], ...]}``, a command for each.
"""

from __future__ import annotations

import json
import subprocess
import tempfile
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from ..model.checks import positive
from ..model.errors import NoAnswer, ScenarioError
from ..model.system import Array
from ..synthesis.black_box import Ask

LONGEST = 100_000_000  # most bytes of an answer


@contextmanager
def program(command: Sequence[str], seconds: float = 10.0) -> Iterator[Ask]:
    """A black box to ask for as long as the ``with`` statement lasts; no shell reads the command.

    `ScenarioError` where it cannot be started, `NoAnswer` where it ends, needs more than so many seconds for
    an answer, or answers something else than JSON with "u".
    """
    shown, pipe = " ".join(command)[:100], subprocess.PIPE
    positive("seconds", seconds, "s")

    def refused(rule: str) -> NoAnswer:
        process.kill()
        process.wait()
        heard.seek(0)
        words = heard.read().decode(errors="replace").strip().splitlines()[-1:]
        return NoAnswer("black box", shown, rule + "".join(f" (its last words: {w[:100]!r})" for w in words))

    def exchange(question: bytes, found: list[bytes]) -> None:
        assert process.stdin is not None and process.stdout is not None
        try:
            process.stdin.write(question)
            process.stdin.flush()
            found.append(process.stdout.readline(LONGEST))
        except (OSError, ValueError):  # it has ended; whoever asked says so
            return

    def ask(t: float, x: Array, xi: Array) -> Any:
        question = json.dumps({"t": t, "x": x.tolist(), "reference": xi.tolist()}) + "\n"
        found: list[bytes] = []
        asking = threading.Thread(target=exchange, args=(question.encode(), found), daemon=True)
        asking.start()
        asking.join(seconds)
        if asking.is_alive():
            raise refused(f"must answer within {seconds:g} s")
        if not found or not found[0].endswith(b"\n"):
            raise refused("must answer each line; it ended, or wrote too much")
        try:
            return json.loads(found[0])["u"]
        except (ValueError, TypeError, KeyError, RecursionError):
            raise refused(f'must answer {{"u": [[...], ...]}}; answered {found[0][:60]!r}') from None

    with tempfile.TemporaryFile() as heard:
        try:
            process = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=heard)
        except (OSError, ValueError, IndexError) as error:
            raise ScenarioError("black box", shown, f"cannot be started: {error}") from error
        try:
            yield ask
        finally:
            process.kill()
            process.communicate()
