"""A program that answers one line of JSON for each line of JSON: a black box in any language.

A question is ``{"t": 12.5, "x": [[...], ...], "reference": [...]}``: time [s], states of any number of
flights, and the state of the safe reference there. The answer is ``{"u": [[...], ...]}``, a command for each.
A question with t = 0 begins new flights, one per row: what is kept in mind of others is to be forgotten.
"""

import json
import os
import signal
import subprocess
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from queue import Empty, Queue
from typing import Any

from ..model.checks import positive
from ..model.errors import NoAnswer, ScenarioError
from ..model.system import Array
from ..synthesis.controllers.black_box import Ask

LONGEST = 10_000_000  # most bytes of an answer
HEARD = 4096  # bytes of complaints that are kept
PATIENCE = 1.0  # seconds that the rest of them may take
GRACE = 0.05  # seconds before new flights in which nothing may be answered


class _Program:
    """A running program that is asked; see `black_box_program`."""

    def __init__(self, command: Sequence[str], seconds: float) -> None:
        self.shown, self.seconds = " ".join(command)[:100], positive("seconds", seconds, "s")
        pipes: dict[str, Any] = dict.fromkeys(("stdin", "stdout", "stderr"), subprocess.PIPE)
        self.lines, self.heard = Queue[bytes](2), bytearray()
        try:
            self.process: Any = subprocess.Popen(command, start_new_session=True, **pipes)
        except (OSError, ValueError, IndexError) as error:
            raise ScenarioError("black box", self.shown, f"cannot be started: {error}") from error
        self.listening = threading.Thread(target=self._listen, daemon=True)
        self.listening.start()
        threading.Thread(target=self._read, daemon=True).start()

    def __call__(self, t: float, x: Array, xi: Array) -> Any:
        question = json.dumps({"t": t, "x": x.tolist(), "reference": xi.tolist()}) + "\n"
        if t == 0:  # time to show what else it has to say
            time.sleep(GRACE)
        early = not self.lines.empty()
        if not early:
            threading.Thread(target=self._write, args=(question.encode(),), daemon=True).start()
        try:
            line = self.lines.get(timeout=self.seconds)
        except Empty:
            raise self._refused(f"must answer within {self.seconds:g} s") from None
        if not line.endswith(b"\n"):
            raise self._refused("must answer each line, but ended or wrote too much")
        if early:
            raise self._refused("must answer each line with one line, but wrote more")
        try:
            return json.loads(line)["u"]
        except (ValueError, TypeError, KeyError, RecursionError):
            raise self._refused(f'must answer {{"u": [[...], ...]}}; answered {line[:60]!r}') from None

    def end(self) -> None:
        """End the program, and those it has started."""
        if self.process.returncode is None:
            with suppress(OSError):
                os.killpg(self.process.pid, signal.SIGKILL) if hasattr(os, "killpg") else self.process.kill()
            self.process.wait()
        with suppress(OSError):
            self.process.stdin.close()

    def _refused(self, rule: str) -> NoAnswer:
        self.end()
        self.listening.join(PATIENCE)
        words = self.heard.decode(errors="replace").strip().splitlines()[-1:]
        last_words = "".join(f" (its last words: {word[:100]!r})" for word in words)
        return NoAnswer("black box", self.shown, rule + last_words)

    def _listen(self) -> None:
        with self.process.stderr as stream:
            while chunk := stream.read1(HEARD):
                self.heard[:] = (self.heard + chunk)[-HEARD:]

    def _read(self) -> None:
        with self.process.stdout as stream:
            line = b"\n"
            while line.endswith(b"\n"):
                line = stream.readline(LONGEST)
                self.lines.put(line)  # whoever writes without being asked waits here

    def _write(self, question: bytes) -> None:
        with suppress(OSError, ValueError):  # it has ended; whoever asked says so
            self.process.stdin.write(question)
            self.process.stdin.flush()


@contextmanager
def black_box_program(command: Sequence[str], seconds: float = 10.0) -> Iterator[Ask]:
    """Yield a black box to ask for as long as the ``with`` statement lasts; no shell reads the command.

    What it has started ends with it. `ScenarioError` where it cannot be started, `NoAnswer` where it ends,
    needs more than so many seconds for an answer, or answers something else than a line of JSON with "u".
    """
    running = _Program(command, seconds)
    try:
        yield running
    finally:
        running.end()
