"""One line of strict JSON per decision: what arrived, what was decided, and why.

The lines hold everything that a decision depends on, so that feeding them again gives the same ones. Wall
times are not among it: the same inputs give the same bytes. What is not a finite number is written as the
text ``nan``, ``inf`` or ``-inf``; what is no number at all as ``{"unreadable": kind}``.
"""

import json
from dataclasses import fields
from math import isfinite
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from ...model.checks import whole
from ...model.errors import ScenarioError
from ...model.foreign import Unreadable, settled
from .estimate import Measurement


class DecisionLog:
    """A file to which decisions are appended as they are made.

    Parameters
    ----------
    target : path-like or text stream
        A new file, or a stream that is open already and that the caller closes.
    flush_every : int
        Lines after which they are handed to the operating system.

    Raises
    ------
    ScenarioError
        If the file exists already or cannot be made: that is found before the flight.
    """

    def __init__(self, target: str | Path | TextIO, flush_every: int = 1) -> None:
        self._every, self._lines = whole("flush_every", flush_every, 1), 0
        self._own = isinstance(target, (str, Path))
        if isinstance(target, (str, Path)):
            try:
                self._stream: TextIO = open(target, "x", encoding="utf-8", newline="\n")  # noqa: SIM115
            except OSError as error:
                raise ScenarioError("log", str(target), f"must be a new file ({error.strerror})") from error
        else:
            self._stream = target

    def write(self, record: dict[str, Any]) -> None:
        """Append one line.

        Raises
        ------
        OSError, ValueError
            If it cannot be written; ValueError also where the stream is closed.
        """
        self._stream.write(json.dumps(record, allow_nan=False, separators=(",", ":")) + "\n")
        self._lines += 1
        if self._lines % self._every == 0:
            self._stream.flush()

    def close(self) -> None:
        """Hand over what is left; a stream of the caller's stays open."""
        if self._own:
            self._stream.close()
        else:
            self._stream.flush()

    def __enter__(self) -> "DecisionLog":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


PARTS = tuple(field.name for field in fields(Measurement))


def plain(value: object) -> Any:
    """What arrived, for strict JSON: numbers as they are read, and whatever it is, nothing is raised."""
    if type(value) is Measurement:
        return {name: plain(getattr(value, name)) for name in PARTS}
    read = value if type(value) is Unreadable else settled(value)
    if isinstance(read, Unreadable):
        return {"unreadable": read.kind}
    return _texts(read.tolist() if isinstance(read, np.ndarray) else read)


def _texts(value: Any) -> Any:
    if isinstance(value, list):
        return [_texts(entry) for entry in value]
    return value if value is None or isfinite(value) else str(value)


def restored(value: Any) -> Any:
    """What `plain` was given, as far as decisions depend on it: arrays as lists."""
    if isinstance(value, list):
        return [restored(entry) for entry in value]
    if isinstance(value, str):
        return float(value)
    if isinstance(value, dict) and "stamp" in value:
        return Measurement(*(restored(value[name]) for name in PARTS))
    return value


def read_log(path: str | Path) -> list[dict[str, Any]]:
    """The lines of a log, oldest first; a last line cut short by a crash is left out.

    Raises
    ------
    ScenarioError
        If the file cannot be read, or another line is not JSON.
    """
    try:
        lines = Path(path).read_text(encoding="utf-8").split("\n")
    except (OSError, UnicodeDecodeError) as error:
        raise ScenarioError("log", str(path), f"must be a readable text file ({error})") from error
    records: list[dict[str, Any]] = []
    for number, line in enumerate(lines[:-1], start=1):
        try:
            record = json.loads(line)
        except ValueError as error:
            raise ScenarioError("log", f"{path}, line {number}", "must be one JSON object") from error
        if not isinstance(record, dict):
            raise ScenarioError("log", f"{path}, line {number}", "must be one JSON object")
        records.append(record)
    return records
