"""One line of strict JSON per decision: what arrived, what was decided, and why.

The lines hold everything that a decision depends on, so that feeding them again gives the same ones. Wall
times are not among it: the same inputs give the same bytes. What is not a finite number is written as the
text ``nan``, ``inf`` or ``-inf``; what is no number at all as ``{"unreadable": kind}``.
"""

from __future__ import annotations

import json
from math import isfinite
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from ...model.checks import whole
from ...model.errors import ScenarioError
from ...model.foreign import LONGEST, Unreadable, kind_of
from .estimate import Measurement

DIGITS = 10_000
"""Binary digits from which on a whole number cannot be written."""


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

    def __enter__(self) -> DecisionLog:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


# -- values that may be anything ---------------------------------------------------------------------


def plain(value: object) -> Any:
    """What arrived, for strict JSON; whatever it is, nothing is raised."""
    try:
        return _plain(value, [LONGEST])
    except BaseException:  # the value's own code has run
        return {"unreadable": kind_of(value)}


def _plain(value: object, left: list[int]) -> Any:
    """The same; `left`: how many entries may still be written, lists that hold themselves included."""
    kind, left[0] = type(value), left[0] - 1
    if value is None or (kind is int and value.bit_length() < DIGITS):  # type: ignore[attr-defined]
        return value
    if kind is float:
        return value if isfinite(value) else str(value)  # type: ignore[arg-type]
    if isinstance(value, Unreadable):
        return {"unreadable": value.kind}
    if isinstance(value, (np.floating, np.integer)):
        return _plain(value.item(), left)
    if kind is np.ndarray and value.size <= LONGEST and value.dtype.kind in "iuf":  # type: ignore[attr-defined]
        return _plain(value.tolist(), [2 * LONGEST])  # type: ignore[attr-defined]
    if kind in (list, tuple) and len(value) <= left[0]:  # type: ignore[arg-type]
        return [_plain(entry, left) for entry in value]  # type: ignore[attr-defined]
    if isinstance(value, Measurement):
        parts = (value.stamp, value.state, value.half_widths)
        return dict(zip(("stamp", "state", "half_widths"), map(plain, parts), strict=True))
    return {"unreadable": kind_of(value)}


def restored(value: Any) -> Any:
    """What `plain` was given, as far as decisions depend on it: arrays as lists."""
    if isinstance(value, list):
        return [restored(entry) for entry in value]
    if isinstance(value, str):
        return float(value)
    if isinstance(value, dict) and "stamp" in value:
        return Measurement(*(restored(value[name]) for name in ("stamp", "state", "half_widths")))
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
