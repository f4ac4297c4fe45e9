"""Known keys of a file, their types and ranges; anything else is refused, not passed over.

Files are read once and within bounds: whoever made the folder may not exhaust the checker. Raised are
`Rejected` (claim ``artefacts``) for a folder, or a device or pipe, whose end may never come; `Undecided` for
a file that is too large; `OSError` for one that cannot be read.

A shape is one of the classes below, ``bool``, ``None``, ``object`` for what is no claim, whatever it is, or a
table of keys and their shapes, in which keys that may be missing end in a question mark.
"""

import hashlib
import json
import math
import os
import re
import stat
from collections.abc import Mapping
from dataclasses import dataclass
from io import BufferedReader
from pathlib import Path
from typing import Any

from ..kernel.verdict import Rejected, Undecided

LARGEST = 1e12  # largest magnitude of a number in a scenario

Shape = Any
Lengths = dict[str, dict[int, str]]
"""Of every named length those that were found, each with a place that has it."""


@dataclass(frozen=True)
class Real:
    """A number, neither true nor quoted, within limits; `above` and `below` themselves are outside."""

    least: float = -LARGEST
    most: float = LARGEST
    above: float | None = None
    below: float | None = None


@dataclass(frozen=True)
class Int:
    """A whole number: 2, neither 2.0 nor true."""

    least: int = 0
    most: float = math.inf


@dataclass(frozen=True)
class Hexadecimal:
    """The one text that `float.hex` makes of a finite float: "10" is neither 10 nor 16."""

    within: Real = Real(least=-math.inf, most=math.inf)


@dataclass(frozen=True)
class Text:
    """Words: any, or some known ones, or of a pattern."""

    known: tuple[str, ...] = ()
    pattern: str = ""


@dataclass(frozen=True)
class Name:
    """A name that is printed as it is: no line breaks, nothing that a terminal obeys."""


@dataclass(frozen=True)
class Items:
    """A list of so many items of one shape; `even` if these are lists of one length.

    Lists with the same `size`, a name, are to be equally long: `conform` collects their lengths.
    """

    item: Shape
    least: int = 0
    most: float = math.inf
    even: bool = False
    size: str = ""


@dataclass(frozen=True)
class Named:
    """A table whose keys are names, all of one shape."""

    item: Shape


@dataclass(frozen=True)
class OneOf:
    """One of several tables, told apart by the word under ``kind``, which stands in each besides."""

    tables: Mapping[str, dict[str, Shape]]


@dataclass(frozen=True)
class AnyOf:
    """Any of several shapes."""

    shapes: tuple[Shape, ...]


def every(item: Shape, words: str) -> dict[str, Shape]:
    """Keys of one shape, named in a row."""
    return dict.fromkeys(words.split(), item)


def conform(value: Any, shape: Shape, claim: str, place: str, lengths: Lengths | None = None) -> Any:
    """Return a value read from JSON or TOML, hexadecimal texts as floats; `Rejected` if not of a shape.

    `place` is the file; named lengths of lists are noted in `lengths`.
    """
    try:
        return _read(value, shape, place, {} if lengths is None else lengths)
    except ValueError as error:
        raise Rejected(claim, str(error)) from error


def _read(value: Any, shape: Shape, place: str, lengths: Lengths) -> Any:
    match shape:
        case dict():
            return _read_table(value, shape, place, lengths)
        case OneOf(tables):
            kind = value.get("kind") if isinstance(value, dict) else None
            if not isinstance(kind, str) or kind not in tables:
                raise ValueError(f"{place}.kind: {shown(kind)} is not one of {', '.join(tables)}")
            return _read_table(value, {"kind": Text(), **tables[kind]}, place, lengths)
        case Named(item):
            entries = _typed(dict, value, place).items()
            return {name: _read(entry, item, f"{place}.{shown(name)}", lengths) for name, entry in entries}
        case Items(item, least, most, even, size):
            if not least <= len(_typed(list, value, place)) <= most:
                raise ValueError(f"{place} has {len(value)} items, of {least} to {most}")
            items = [_read(entry, item, f"{place}[{i}]", lengths) for i, entry in enumerate(value)]
            if even and len(set(map(len, items))) > 1:
                raise ValueError(f"{place} has rows of different lengths")
            if size:
                lengths.setdefault(size, {})[len(items)] = place
            return items
        case AnyOf(shapes):
            reasons = []
            for one in shapes:
                try:
                    return _read(value, one, place, lengths)
                except ValueError as error:
                    reasons.append(str(error))
            raise ValueError("; ".join(reasons))
        case Hexadecimal(within):
            return _read(number(value), within, place, lengths)
    if not _is(value, shape):
        raise ValueError(f"{place}: {shown(value)} is no {shape}")
    return value


def _typed(kind: type, value: Any, place: str) -> Any:
    if not isinstance(value, kind):
        raise ValueError(f"{place}: {shown(value)} is no {'table' if kind is dict else 'list'}")
    return value


def _read_table(value: Any, shape: dict[str, Shape], place: str, lengths: Lengths) -> dict[str, Any]:
    shapes = {key.removesuffix("?"): item for key, item in shape.items()}
    for key in _typed(dict, value, place):
        if key not in shapes:
            raise ValueError(f"{place}: the key {shown(key)} is not known, so nothing was made of it")
    for key in shape:
        if not key.endswith("?") and key not in value:
            raise ValueError(f"{place}: the key {key!r} is missing")
    return {key: _read(value[key], shapes[key], f"{place}.{key}", lengths) for key in shapes if key in value}


def _is(value: Any, shape: Shape) -> bool:
    """Return True if a value that is neither table nor list is of a shape."""
    match shape:
        case Real(least, most, above, below):
            if isinstance(value, bool) or not isinstance(value, (int, float)) or not least <= value <= most:
                return False  # NaN is within no limits
            return (above is None or value > above) and (below is None or value < below)
        case Int(least, most):
            return isinstance(value, int) and not isinstance(value, bool) and least <= value <= most
        case Text(known, pattern):
            if not isinstance(value, str) or (known and value not in known):
                return False
            return not pattern or re.fullmatch(pattern, value, re.ASCII) is not None
        case Name():
            return isinstance(value, str) and value.isprintable() and len(value) <= 200
        case None:
            return value is None
    return isinstance(value, shape)


def number(text: Any) -> float:
    """Decode one finite float from the one hexadecimal text that stands for it."""
    if not isinstance(text, str):
        raise ValueError(f"{shown(text)} is not hexadecimal text")
    try:
        value = float.fromhex(text)
    except OverflowError as error:
        raise ValueError(f"{shown(text)} is too large") from error
    if not math.isfinite(value):
        raise ValueError(f"{shown(text)} is not finite")
    if value.hex() != text:
        raise ValueError(f"{shown(text)} is not written {value.hex()}")
    return value


def shown(value: Any, most: int = 80) -> str:
    """Return a value in a message: printable, and not long."""
    text = ascii(value)
    return text if len(text) <= most else f"{text[: most - 3]}..."


def strict_json(data: bytes) -> Any:
    """Read JSON in which every key stands once and every number is finite; else raise `ValueError`.

    In UTF-8 and without a mark at its start, so that every reader reads the same.
    """
    try:
        text = data.decode("utf-8")
        return json.loads(text, object_pairs_hook=_once, parse_constant=_finite, parse_float=_finite)
    except RecursionError as error:
        raise ValueError("nested too deeply") from error


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    table = dict(pairs)
    if len(table) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for key in keys if keys.count(key) > 1)
        raise ValueError(f"the key {shown(twice)} stands more than once")
    return table


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{shown(text)} is no number, or too large")
    return value


LARGEST_READ = 256 * 2**20  # largest file whose contents are read [bytes]
LARGEST_SCENARIO = 4 * 2**20  # largest scenario file [bytes]
LARGEST_HASHED = 16 * 2**30  # largest file that is hashed [bytes]


def contents(path: Path, most: int = LARGEST_READ) -> bytes:
    """Return the bytes of a regular file, or of the target of a link to one."""
    with _opened(path, most) as file:
        size = os.fstat(file.fileno()).st_size
        data = file.read(min(size, most) + 1)  # a reader of more would set that much memory aside
    if len(data) > size:
        raise Undecided("artefacts", f"{ascii(path.name)} grew while it was read")
    return data


def exists(path: Path) -> bool:
    """Return True if a folder has an entry of this name, be it a link that leads nowhere."""
    return path.exists() or path.is_symlink()


def sha256(path: Path) -> str:
    """SHA-256 of a file, piece by piece."""
    with _opened(path, LARGEST_HASHED) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _opened(path: Path, limit: int) -> BufferedReader:
    """Open a regular file of a bounded size, without waiting for the other end of a pipe."""
    wait = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    if path.is_symlink() and not path.exists():
        raise Rejected("artefacts", f"{ascii(path.name)} is no regular file")
    descriptor = os.open(path, os.O_RDONLY | wait)
    status = os.fstat(descriptor)
    if stat.S_ISREG(status.st_mode) and status.st_size <= limit:
        return os.fdopen(descriptor, "rb")
    os.close(descriptor)
    if not stat.S_ISREG(status.st_mode):
        raise Rejected("artefacts", f"{ascii(path.name)} is no regular file")
    raise Undecided("artefacts", f"{ascii(path.name)} is larger than {limit} bytes")
