"""What a file may hold: known keys, their types and ranges; anything else is refused, not passed over."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from .verdict import Rejected

LARGEST = 1e12
"""Largest magnitude of a number in a scenario."""


@dataclass(frozen=True)
class Real:
    """A number, neither true nor quoted, within limits; `above` and `below` themselves are outside."""

    least: float = -LARGEST
    most: float = LARGEST
    above: float | None = None
    below: float | None = None


@dataclass(frozen=True)
class Whole:
    """A whole number: 2, not 2.0."""

    least: int = 0
    most: int | None = None


@dataclass(frozen=True)
class Text:
    """Words: any, or some known ones, or of a pattern."""

    known: tuple[str, ...] = ()
    pattern: str = ""


@dataclass(frozen=True)
class Flag:
    """True or false."""


@dataclass(frozen=True)
class Null:
    """Nothing."""


@dataclass(frozen=True)
class Anything:
    """Whatever it is, it is no claim."""


@dataclass(frozen=True)
class Rows:
    """A list of so many items of one shape; `even` if these are lists of one length."""

    item: Shape
    least: int = 0
    most: int | None = None
    even: bool = False


@dataclass(frozen=True)
class Table:
    """Keys and what they hold; the optional ones may be missing."""

    keys: Mapping[str, Shape]
    optional: Mapping[str, Shape] = field(default_factory=dict)


@dataclass(frozen=True)
class Named:
    """A table whose keys are names, all of one shape."""

    item: Shape


@dataclass(frozen=True)
class Kinds:
    """One of several tables, told apart by the word under ``kind``."""

    tables: Mapping[str, Table]


@dataclass(frozen=True)
class Either:
    """Any of several shapes."""

    shapes: tuple[Shape, ...]


Shape = Real | Whole | Text | Flag | Null | Anything | Rows | Table | Named | Kinds | Either


def keyed(keys: Mapping[str, Any]) -> Table:
    """A table from one mapping, in which the keys that may be missing end in a question mark."""
    needed = {key: item for key, item in keys.items() if not key.endswith("?")}
    return Table(needed, {key[:-1]: item for key, item in keys.items() if key.endswith("?")})


def kinds(tables: Mapping[str, Mapping[str, Any]]) -> Kinds:
    """Several tables, from the keys that each has besides ``kind``."""
    return Kinds({kind: keyed({"kind": Text((kind,)), **keys}) for kind, keys in tables.items()})


def every(item: Shape, words: str) -> dict[str, Shape]:
    """Keys of one shape, named in a row."""
    return dict.fromkeys(words.split(), item)


def conform(value: Any, shape: Shape, claim: str, where: str) -> None:
    """Refuse a value that is not of a shape.

    Parameters
    ----------
    value : object
        As read from JSON or TOML.
    shape : Shape
    claim : str
        Claim to name.
    where : str
        The file, then the place in it.

    Raises
    ------
    Rejected
    """
    match shape:
        case Table():
            _conform_table(value, shape, claim, where)
        case Kinds(tables):
            kind = value.get("kind") if isinstance(value, dict) else None
            if not isinstance(kind, str) or kind not in tables:
                raise Rejected(claim, f"{where}.kind: {shown(kind)} is not one of {', '.join(tables)}")
            _conform_table(value, tables[kind], claim, where)
        case Named(item):
            if not isinstance(value, dict):
                raise Rejected(claim, f"{where}: {shown(value)} is no table")
            for name, entry in value.items():
                conform(entry, item, claim, f"{where}.{shown(name)}")
        case Rows(item, least, most, even):
            if not isinstance(value, list):
                raise Rejected(claim, f"{where}: {shown(value)} is no list")
            if len(value) < least or (most is not None and len(value) > most):
                raise Rejected(claim, f"{where} has {len(value)} items, of {least} to {most}")
            for i, entry in enumerate(value):
                conform(entry, item, claim, f"{where}[{i}]")
            if even and len({len(entry) for entry in value}) > 1:
                raise Rejected(claim, f"{where} has rows of different lengths")
        case Either(shapes):
            reasons = []
            for one in shapes:
                try:
                    return conform(value, one, claim, where)
                except Rejected as error:
                    reasons.append(error.witness)
            raise Rejected(claim, "; ".join(reasons))
        case _:
            if not _is(value, shape):
                raise Rejected(claim, f"{where}: {shown(value)} is no {shape}")


def _conform_table(value: Any, shape: Table, claim: str, where: str) -> None:
    if not isinstance(value, dict):
        raise Rejected(claim, f"{where}: {shown(value)} is no table")
    for key in value:
        if key not in shape.keys and key not in shape.optional:
            raise Rejected(claim, f"{where}: the key {shown(key)} is not known, so nothing was made of it")
    for key, item in shape.keys.items():
        if key not in value:
            raise Rejected(claim, f"{where}: the key {key!r} is missing")
        conform(value[key], item, claim, f"{where}.{key}")
    for key, item in shape.optional.items():
        if key in value:
            conform(value[key], item, claim, f"{where}.{key}")


def _is(value: Any, shape: Shape) -> bool:
    """Whether a value that is neither table nor list is of a shape."""
    match shape:
        case Real(least, most, above, below):
            if isinstance(value, bool) or not isinstance(value, (int, float)):
                return False
            inside = least <= value <= most  # false for NaN
            return inside and (above is None or value > above) and (below is None or value < below)
        case Whole(least, most):
            if isinstance(value, bool) or not isinstance(value, int):
                return False
            return value >= least and (most is None or value <= most)
        case Text(known, pattern):
            if not isinstance(value, str) or (known and value not in known):
                return False
            return not pattern or re.fullmatch(pattern, value, re.ASCII) is not None
        case Flag():
            return isinstance(value, bool)
        case Null():
            return value is None
    return isinstance(shape, Anything)


def shown(value: Any, most: int = 80) -> str:
    """A value in a message: printable, and not long."""
    text = ascii(value)
    return text if len(text) <= most else f"{text[: most - 3]}..."


def floats(values: Any) -> list[float]:
    """Numbers of a scenario, whole ones too, as floats."""
    return [float(x) for x in values]


def float_rows(rows: Any) -> list[list[float]]:
    """Rows of such numbers."""
    return [floats(row) for row in rows]


# -- JSON -------------------------------------------------------------------------------------------


def strict_json(data: bytes) -> Any:
    """Read JSON in UTF-8 in which every key stands once and every number is finite.

    In UTF-8 and without a mark at its start, so that every reader reads the same.

    Raises
    ------
    ValueError
        If it is not that.
    """
    text = data.decode("utf-8")
    try:
        return json.loads(text, object_pairs_hook=_once, parse_constant=_no_number, parse_float=_finite)
    except RecursionError as error:
        raise ValueError("nested too deeply") from error


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for key in keys if keys.count(key) > 1)
        raise ValueError(f"the key {shown(twice)} stands more than once")
    return found


def _no_number(text: str) -> Any:
    raise ValueError(f"{text} is no number")


def _finite(text: str) -> float:
    value = float(text)
    if not math.isfinite(value):
        raise ValueError(f"{text} is too large")
    return value
