"""A program that answers one line of JSON for each line of JSON: a black box in any language.

A question is ``{"t": 12.5, "x": [[...], ...], "reference": [...]}``: time [s], states of any number of
flights, and the state of the safe reference there. The answer is ``{"u": [[...], ...]}``, a command for each.
A question with t = 0 begins new flights, one per row: what is kept in mind of others is to be forgotten.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from queue import Empty, Queue
from typing import Any

from ..model.checks import positive
from ..model.errors import NoAnswer, ScenarioError
from ..model.system import Array
from ..synthesis.black_box import Ask

LONGEST = 10_000_000  # most bytes of an answer
HEARD = 4096  # bytes of complaints that are kept
PATIENCE = 1.0  # seconds that the rest of them may take


@contextmanager
def program(command: Sequence[str], seconds: float = 10.0) -> Iterator[Ask]:
    """A black box to ask for as long as the ``with`` statement lasts; no shell reads the command.

    What it has started ends with it. `ScenarioError` where it cannot be started, `NoAnswer` where it ends,
    needs more than so many seconds for an answer, or answers something else than a line of JSON with "u".
    """
    shown, pipe = " ".join(command)[:100], subprocess.PIPE
    positive("seconds", seconds, "s")
    lines, heard = Queue[bytes](2), bytearray()

    def listen() -> None:
        with process.stderr as stream:
            while more := stream.read1(HEARD):
                heard[:] = (heard + more)[-HEARD:]

    def read() -> None:
        with process.stdout as stream:
            line = b"\n"
            while line.endswith(b"\n"):
                line = stream.readline(LONGEST)
                lines.put(line)  # whoever writes without being asked waits here

    def write(question: bytes) -> None:
        with suppress(OSError, ValueError):  # it has ended; whoever asked says so
            process.stdin.write(question)
            process.stdin.flush()

    def end() -> None:
        with suppress(OSError):
            os.killpg(process.pid, signal.SIGKILL) if hasattr(os, "killpg") else process.kill()
        process.wait()

    def refused(rule: str) -> NoAnswer:
        end()
        listening.join(PATIENCE)
        words = heard.decode(errors="replace").strip().splitlines()[-1:]
        return NoAnswer("black box", shown, rule + "".join(f" (its last words: {w[:100]!r})" for w in words))

    def ask(t: float, x: Array, xi: Array) -> Any:
        question = json.dumps({"t": t, "x": x.tolist(), "reference": xi.tolist()}) + "\n"
        early = not lines.empty()
        if not early:
            threading.Thread(target=write, args=(question.encode(),), daemon=True).start()
        try:
            found = lines.get(timeout=seconds)
        except Empty:
            raise refused(f"must answer within {seconds:g} s") from None
        if not found.endswith(b"\n"):
            raise refused("must answer each line; it ended, or wrote too much")
        if early:
            raise refused("must answer each line by one; it wrote more")
        try:
            return json.loads(found)["u"]
        except (ValueError, TypeError, KeyError, RecursionError):
            raise refused(f'must answer {{"u": [[...], ...]}}; answered {found[:60]!r}') from None

    try:
        process: Any = subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, start_new_session=True)
    except (OSError, ValueError, IndexError) as error:
        raise ScenarioError("black box", shown, f"cannot be started: {error}") from error
    listening = threading.Thread(target=listen, daemon=True)
    for thread in (listening, threading.Thread(target=read, daemon=True)):
        thread.start()
    try:
        yield ask
    finally:
        end()
        with suppress(OSError):
            process.stdin.close()
