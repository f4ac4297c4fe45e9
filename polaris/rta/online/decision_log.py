"""One line of strict JSON per decision: input, decision, and reason.

The lines hold everything that a decision depends on, so that feeding them again gives the same ones. Wall
times are not among it: the same inputs give the same bytes. What is not a finite number is written as the
text ``nan``, ``inf`` or ``-inf``; what is no number at all as ``{"unreadable": kind}``.
"""

import errno
import json
import re
from contextlib import suppress
from dataclasses import fields
from math import isfinite
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from ...model.checks import whole
from ...model.errors import ScenarioError
from ...model.files import parse_json, read_text
from ...model.untrusted import Unreadable, sanitize
from .estimate import Measurement

LARGEST = 2**30  # largest file of a log that is read [bytes]; a decision takes about 400


class DecisionLog:
    """A file to which decisions are appended as they are made.

    Parameters
    ----------
    target : path-like or text stream
        A new file, or a stream that is open already and that the caller closes.
    flush_every : int
        Lines after which they are handed to the operating system.
    max_bytes : int, optional
        Largest size of a file [bytes]: before the line that would exceed it the log goes on in ``target.1``,
        ``target.2`` and so on. One file by default, however large it becomes.
    max_files : int, optional
        Number of these files that are kept, at least 2: the oldest is deleted, unless it was changed. All by
        default. A log without its oldest decisions cannot be replayed.

    Raises
    ------
    ScenarioError
        If a file of the log exists already or cannot be made: that is found before the flight.
    """

    def __init__(
        self,
        target: str | Path | TextIO,
        flush_every: int = 1,
        max_bytes: int | None = None,
        max_files: int | None = None,
    ) -> None:
        self._every, self._lines, self._size = whole("flush_every", flush_every, 1), 0, 0
        self._limit = None if max_bytes is None else whole("max_bytes", max_bytes, 1)
        self._files = None if max_files is None else whole("max_files", max_files, 2)
        self._own, self._number, self._full = isinstance(target, (str, Path)), 0, list[tuple[Path, object]]()
        if self._limit is None and self._files is not None or not self._own and self._limit is not None:
            raise ScenarioError(
                "max_files, max_bytes", (max_files, max_bytes), "must be of a file with max_bytes"
            )
        if isinstance(target, (str, Path)):
            self._path = Path(target)
            try:
                for _, file in _parts(self._path):
                    raise FileExistsError(errno.EEXIST, f"{file.name} exists")
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
        line = json.dumps(record, allow_nan=False, separators=(",", ":")) + "\n"
        if self._limit is not None and self._size > 0 and self._size + len(line) > self._limit:
            self._go_on()
        self._stream.write(line)
        self._size += len(line)
        self._lines += 1
        if self._lines % self._every == 0:
            self._stream.flush()

    def _go_on(self) -> None:
        """Begin the next file, and delete the oldest ones that are too many."""
        following = self._path.with_name(f"{self._path.name}.{self._number + 1}")
        full, self._stream = self._stream, open(following, "x", encoding="utf-8", newline="\n")  # noqa: SIM115
        self._number, self._size = self._number + 1, 0
        full.close()
        written = Path(full.name)
        self._full.append((written, _identity(written)))
        if self._files is not None and len(self._full) >= self._files:
            oldest, identity = self._full.pop(0)
            if _identity(oldest) == identity:
                oldest.unlink()

    def close(self) -> None:
        """Hand over the remaining lines; a stream of the caller's stays open."""
        if self._own:
            self._stream.close()
        else:
            self._stream.flush()

    def __enter__(self) -> "DecisionLog":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


PARTS = tuple(field.name for field in fields(Measurement))


def jsonable(value: object) -> Any:
    """Return anything that arrived as strict JSON has it, numbers as they are read; raise nothing."""
    if type(value) is Measurement:
        return {name: jsonable(getattr(value, name)) for name in PARTS}
    read = value if type(value) is Unreadable else sanitize(value)
    if isinstance(read, Unreadable):
        return {"unreadable": read.kind}
    return _texts(read.tolist() if isinstance(read, np.ndarray) else read)


def _texts(value: Any) -> Any:
    if isinstance(value, list):
        return [_texts(entry) for entry in value]
    return value if value is None or isfinite(value) else str(value)


def restored(value: Any) -> Any:
    """Return the value that `jsonable` was given, as far as decisions depend on it: arrays as lists."""
    if isinstance(value, list):
        return [restored(entry) for entry in value]
    if isinstance(value, str):
        return float(value)
    if isinstance(value, dict) and "stamp" in value:
        return Measurement(*(restored(value[name]) for name in PARTS))
    return value


def _identity(path: Path) -> tuple[int, ...]:
    """Return numbers that differ once a file is replaced or changed; none without a file."""
    with suppress(FileNotFoundError):
        status = path.lstat()
        return status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns
    return ()


def _parts(path: Path) -> list[tuple[int, Path]]:
    """List the files of a log, oldest first, with their numbers."""
    form = re.compile(rf"{re.escape(path.name)}(?:\.([1-9][0-9]*))?")
    matches = ((form.fullmatch(file.name), file) for file in path.parent.iterdir())
    return sorted((int(match[1] or 0), file) for match, file in matches if match)


def read_log(path: str | Path, *, partial: bool = False) -> list[dict[str, Any]]:
    """Return the lines of a log, oldest first; a last line cut short by a crash is left out.

    Parameters
    ----------
    path : path
        As it was given to `DecisionLog`; the files in which the log goes on are read too.
    partial : bool
        True if files may be missing, as the oldest are with `max_files`.

    Raises
    ------
    ScenarioError
        If a file is missing or cannot be read, has more than 1 GiB, or another line is not JSON.
    """
    try:
        parts = _parts(Path(path)) or [(0, Path(path))]
        if not partial and [number for number, _ in parts] != list(range(len(parts))):
            raise ValueError("some of its files are missing; partial=True reads the others")
        lines = "".join(read_text(part, LARGEST) for _, part in parts).split("\n")
    except (OSError, ValueError) as error:
        raise ScenarioError("log", str(path), f"must be a readable text file ({error})") from error
    records: list[dict[str, Any]] = []
    for number, line in enumerate(lines[:-1], start=1):
        try:
            record = parse_json(line)
        except ValueError as error:
            raise ScenarioError("log", f"{path}, line {number}", "must be one JSON object") from error
        if not isinstance(record, dict):
            raise ScenarioError("log", f"{path}, line {number}", "must be one JSON object")
        records.append(record)
    return records
