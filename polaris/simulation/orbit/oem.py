"""Orbit ephemeris messages (CCSDS 502.0, KVN): a strict reader, a writer, and interpolation.

Epochs are whole nanoseconds since 2000-01-01T00:00:00 in the time system of the file.
"""

import re
from bisect import bisect_left, bisect_right
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Literal, get_args

import numpy as np
from scipy.interpolate import KroghInterpolator

from ...model.errors import ScenarioError
from ...model.files import read_text
from ...model.keys import printable
from ...model.system import Array
from ...model.version import version

LARGEST_FILE = 100_000_000  # bytes
Frame = Literal["EME2000", "GCRF", "ICRF", "J2000", "TEME", "TOD", "MOD"]
FRAMES: tuple[str, ...] = get_args(Frame)
"""Reference frames that do not turn with the Earth."""
TimeSystem = Literal["UTC", "TAI", "TT", "TDB", "GPS"]
TIME_SYSTEMS: tuple[str, ...] = get_args(TimeSystem)
NODES = 8  # states about an epoch between which positions and velocities are interpolated
APART_S = 600.0  # longest time between states about an epoch: beyond it the polynomial is off by metres
SECOND = 1_000_000_000

_KEYS = {
    "header": "CCSDS_OEM_VERS CREATION_DATE ORIGINATOR CLASSIFICATION MESSAGE_ID",
    "meta": "OBJECT_NAME OBJECT_ID CENTER_NAME REF_FRAME REF_FRAME_EPOCH TIME_SYSTEM START_TIME"
    " USEABLE_START_TIME USEABLE_STOP_TIME STOP_TIME INTERPOLATION INTERPOLATION_DEGREE",
    "covariance": "EPOCH COV_REF_FRAME",
}
_NEEDED = "OBJECT_NAME OBJECT_ID CENTER_NAME REF_FRAME TIME_SYSTEM START_TIME STOP_TIME"
_BEGIN = datetime(2000, 1, 1)


def parse_epoch(text: str) -> int:
    """Return the epoch [ns] of a calendar or ordinal date with time; `ValueError` if it is none."""
    match = re.fullmatch(r"(\d{4})-(\d{3}|\d\d-\d\d)T(\d\d:\d\d:\d\d)(?:\.(\d{1,15}))?Z?", text)
    if not match:
        raise ValueError("must be of the form 2026-01-31T12:00:00.000")
    year, day, clock, part = match.groups()
    form = "%Y-%m-%d" if "-" in day else "%Y-%j"
    try:
        moment = datetime.strptime(f"{year}-{day} {clock}", f"{form} %H:%M:%S")
    except ValueError:
        raise ValueError("must be a date and a time that exist; leap seconds are not read") from None
    elapsed = moment - _BEGIN
    return (elapsed.days * 86400 + elapsed.seconds) * SECOND + int((part or "0").ljust(9, "0")[:9])


def epoch_text(epoch: int) -> str:
    """Return an epoch [ns] as text, to the microsecond if that is exact: some readers know no more."""
    seconds, remainder = divmod(epoch, SECOND)
    share = f"{remainder:09d}" if remainder % 1000 else f"{remainder // 1000:06d}"
    return f"{(_BEGIN + timedelta(seconds=seconds)).isoformat()}.{share}"


@dataclass(frozen=True, eq=False)
class Ephemeris:
    """Inertial states of one object at increasing epochs, and covariances at some.

    Attributes
    ----------
    name, frame, time_system : str
    epochs : tuple of int [ns]
    states : ndarray, shape (N, 6) [m, m/s]
    covariances : dict
        By epoch [ns] the frame and the matrix (6, 6) [m, m/s].
    breaks : tuple of int
        Where in `epochs` segments begin: nothing is interpolated across.
    source : str
        File, for messages.
    """

    name: str
    frame: str
    time_system: str
    epochs: tuple[int, ...]
    states: Array
    covariances: dict[int, tuple[str, Array]]
    breaks: tuple[int, ...] = (0,)
    source: str = ""

    def states_at(self, epochs: Sequence[int]) -> Array:
        """States (M, 6) at epochs [ns], between those of the file by Hermite's polynomial of 8 states.

        Raises
        ------
        ScenarioError
            If an epoch is outside of the file, or states about it are too far apart.
        """
        return np.array([self._at(epoch) for epoch in epochs])

    def _at(self, epoch: int) -> Array:
        if not self.epochs[0] <= epoch <= self.epochs[-1]:
            rule = f"covers {epoch_text(self.epochs[0])} to {epoch_text(self.epochs[-1])} alone"
            raise ScenarioError("ephemeris", epoch_text(epoch), f"{rule}; choose another epoch", self.source)
        after = bisect_left(self.epochs, epoch)
        if self.epochs[after] == epoch:
            return np.asarray(self.states[after])
        edges = [*self.breaks, len(self.epochs)]
        part = bisect_right(edges, after) - 1
        first, end = edges[part], edges[part + 1]
        if after == first:
            rule = "lies between two segments of the file; choose an epoch within one"
            raise ScenarioError("ephemeris", epoch_text(epoch), rule, self.source)
        low = max(first, min(after - NODES // 2, end - NODES))
        window = range(low, min(low + NODES, end))
        gap_s = max(self.epochs[i + 1] - self.epochs[i] for i in window[:-1]) / SECOND
        if gap_s > APART_S:
            rule = f"lies in a gap: states about it are {gap_s:g} s apart, at most {APART_S:g} s are allowed"
            raise ScenarioError("ephemeris", epoch_text(epoch), rule, self.source)
        # Times as shares of their span keep the divided differences in range.
        span = (self.epochs[window[-1]] - self.epochs[window[0]]) / SECOND
        times = np.repeat([(self.epochs[i] - epoch) / SECOND / span for i in window], 2)
        values = np.array([row for i in window for row in (self.states[i, :3], self.states[i, 3:] * span)])
        polynomial = KroghInterpolator(times, values)
        return np.concatenate([polynomial(0.0), polynomial.derivative(0.0) / span])


# -- reading ----------------------------------------------------------------------------------------


class _Fault(ValueError):
    """Line and rule of a file that is no OEM."""


def read_oem(path: Path) -> Ephemeris:
    """Return the ephemeris of an OEM file in KVN, in km and km/s as the standard has it.

    Raises
    ------
    ScenarioError
        In one sentence, at the first line that is not as the standard or this reader wants it.
    """
    name = printable(path.name)
    try:
        lines = read_text(path, LARGEST_FILE).removeprefix("\ufeff").splitlines()
    except FileNotFoundError:
        raise ScenarioError("ephemeris", name, "there is no such file") from None
    except (OSError, ValueError) as error:
        raise ScenarioError("ephemeris", name, f"cannot be read: {error}") from None
    try:
        return _parsed(lines, name)
    except ValueError as error:
        raise ScenarioError("ephemeris", name, printable(str(error))) from None


def _parsed(lines: list[str], source: str) -> Ephemeris:
    block, meta = "header", dict[str, str]()
    head, epochs, rows, breaks = dict[str, str](), list[int](), list[list[float]](), list[int]()
    first_meta: dict[str, str] = {}
    covariances: dict[int, tuple[str, Array]] = {}
    triangle: list[list[float]] = []
    for number, line in enumerate((line.strip() for line in lines), 1):
        try:
            if not line or line.startswith("COMMENT"):
                continue
            if number == 1 and line.startswith("<"):
                raise _Fault("is XML: only key-value notation (KVN) is read")
            if line == "META_START" and block in ("header", "data"):
                block, meta = "meta", {}
            elif line == "META_STOP" and block == "meta":
                block = "data"
                _check_meta(meta, first_meta)
                first_meta, breaks = first_meta or meta, [*breaks, len(epochs)]
            elif line == "COVARIANCE_START" and block == "data":
                block, meta = "covariance", {}
            elif line == "COVARIANCE_STOP" and block == "covariance" and not triangle:
                block = "data"
            elif "=" in line and block != "data":
                key, _, value = (part.strip() for part in line.partition("="))
                if not head and key != "CCSDS_OEM_VERS":
                    raise _Fault("must begin with CCSDS_OEM_VERS: it is no orbit ephemeris message")
                if key not in _KEYS[block].split():
                    raise _Fault(f"unknown key {key}")
                (head if block == "header" else meta)[key] = value
                if "EPOCH" in key or key.endswith("_TIME"):
                    parse_epoch(value)
            elif block == "data":
                epoch, *values = line.split()
                moment, row = parse_epoch(epoch), _numbers(values, (6, 9))
                _check_state(row)
                if len(epochs) > breaks[-1] and moment <= epochs[-1]:
                    raise _Fault("epochs must increase")
                epochs.append(moment)
                rows.append(row[:6])
            elif block == "covariance" and "EPOCH" in meta:
                triangle.append(_numbers(line.split(), (len(triangle) + 1,)))
                if len(triangle) == 6:
                    frame = meta.get("COV_REF_FRAME", first_meta["REF_FRAME"])
                    covariances[parse_epoch(meta["EPOCH"])] = frame, _covariance(triangle)
                    triangle = []
                    del meta["EPOCH"]
            else:
                missing = ": META_STOP is missing before it" if block == "meta" else ""
                raise _Fault(f"is out of place{missing}")
        except ValueError as error:
            raise _Fault(f"line {number} ({line[:60]!r}): {error}") from None
    if "CCSDS_OEM_VERS" not in head:
        raise _Fault("must begin with CCSDS_OEM_VERS: it is no orbit ephemeris message")
    if block != "data" or len(rows) < 2:
        raise _Fault("ends too early: it must hold metadata and two or more states")
    if any(epochs[i] < epochs[i - 1] for i in breaks[1:]):
        raise _Fault("has segments that overlap or are out of order")
    states = np.array(rows) * 1e3
    identity = first_meta["OBJECT_NAME"], first_meta["REF_FRAME"], first_meta["TIME_SYSTEM"]
    return Ephemeris(*identity, tuple(epochs), states, covariances, tuple(breaks), source)


def _numbers(texts: list[str], counts: tuple[int, ...]) -> list[float]:
    if len(texts) not in counts:
        raise _Fault(f"must have {' or '.join(map(str, counts))} numbers, has {len(texts)}")
    numbers = [float(text) for text in texts]
    if not np.isfinite(numbers).all():
        raise _Fault("numbers must be finite")
    return numbers


def _check_meta(meta: dict[str, str], before: dict[str, str]) -> None:
    """Refuse metadata that is incomplete, of another frame or time, or of another object than before."""
    missing = [key for key in _NEEDED.split() if key not in meta]
    if missing:
        raise _Fault(f"the metadata before it must have {missing[0]}")
    for key, allowed in (("CENTER_NAME", ("EARTH",)), ("REF_FRAME", FRAMES), ("TIME_SYSTEM", TIME_SYSTEMS)):
        if meta[key].upper() not in allowed:
            raise _Fault(f"{key} is {meta[key]}; it must be one of {', '.join(allowed)}")
        meta[key] = meta[key].upper()
    for key in ("OBJECT_NAME", "REF_FRAME", "TIME_SYSTEM"):
        if before and meta[key] != before[key]:
            raise _Fault(f"{key} is {meta[key]}, but {before[key]} in the segment before: it must not change")


def _check_state(row: list[float]) -> None:
    """Refuse states that cannot be in km and km/s about the Earth."""
    distance, speed = float(np.linalg.norm(row[:3])), float(np.linalg.norm(row[3:6]))
    if not 6378 <= distance <= 1e6 or not 0.05 <= speed <= 12:
        rule = "outside of an orbit of the Earth; positions must be in km and velocities in km/s"
        raise _Fault(f"{distance:.6g} km from its centre at {speed:.6g} km/s is {rule}")


def _covariance(triangle: list[list[float]]) -> Array:
    """Return the matrix (6, 6) [m, m/s] of its lower triangle [km, km/s]; refuse any other table."""
    lower = np.zeros((6, 6))
    for i, row in enumerate(triangle):
        lower[i, : i + 1] = row
    matrix = (lower + np.tril(lower, -1).T) * 1e6
    sigma = np.sqrt(np.maximum(np.diag(matrix), 0.0))
    scale = np.where(sigma > 0, sigma, 1.0)
    least = float(np.linalg.eigvalsh(matrix / np.outer(scale, scale)).min())
    if np.any(np.diag(matrix) < 0) or least < -1e-6:
        raise _Fault("the covariance that ends here must be positive semidefinite")
    return np.asarray(matrix)


# -- writing ----------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Track:
    """Name of an object, times [s] since the epoch, shape (N,), and inertial states (N, 6) [m, m/s]."""

    name: str
    times: Array
    states: Array
    comment: str = ""


def oem_lines(track: Track, epoch: int, frame: str, time_system: str) -> Iterator[str]:
    """Yield the lines of a message in version 2.0, in km to 1 um and km/s to 1 nm/s."""
    stamps = [epoch_text(epoch + round(float(t) * SECOND)) for t in track.times]
    yield "CCSDS_OEM_VERS = 2.0"
    yield from _comments(f"Written by Polaris {version()}", track.comment)
    yield f"CREATION_DATE = {datetime.now(UTC).strftime('%Y-%m-%dT%H:%M:%S')}"
    yield "ORIGINATOR = POLARIS"
    yield ""
    yield "META_START"
    meta = {
        "OBJECT_NAME": track.name,
        "OBJECT_ID": track.name,
        "CENTER_NAME": "EARTH",
        "REF_FRAME": frame,
        "TIME_SYSTEM": time_system,
        "START_TIME": stamps[0],
        "STOP_TIME": stamps[-1],
        "INTERPOLATION": "HERMITE",
        "INTERPOLATION_DEGREE": "3",
    }
    yield from (f"{key} = {value}" for key, value in meta.items())
    yield "META_STOP"
    yield ""
    for stamp, x in zip(stamps, track.states / 1e3, strict=True):
        yield " ".join([stamp, *(f"{value:.9f}" for value in x[:3]), *(f"{value:.12f}" for value in x[3:])])


def _comments(*texts: str) -> Iterable[str]:
    return (f"COMMENT {line}" for text in texts for line in text.splitlines() if line)
