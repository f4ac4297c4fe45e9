"""Numbers, lists and words of a certificate: each in the one form that stands for it."""

from __future__ import annotations

import math
from typing import Any


def number(text: Any) -> float:
    """Decode one finite float from the one hexadecimal text that stands for it: "10" is neither 10 nor 16."""
    if not isinstance(text, str):
        raise ValueError(f"{text!r} is not hexadecimal text")
    value = float.fromhex(text)
    if not math.isfinite(value):
        raise ValueError(f"{text!r} is not finite")
    if value.hex() != text:
        raise ValueError(f"{text!r} is not written {value.hex()}")
    return value


def listed(items: Any) -> list[Any]:
    """A list, and nothing else that has items."""
    if not isinstance(items, list):
        raise TypeError(f"{ascii(items)[:80]} is no list")
    return items


def vector(items: Any, size: int | None = None) -> list[float]:
    """Decode a list of numbers."""
    values = [number(item) for item in listed(items)]
    if size is not None and len(values) != size:
        raise ValueError(f"{len(values)} numbers where {size} are needed")
    return values


def table(rows: Any, height: int | None = None, width: int | None = None) -> list[list[float]]:
    """Decode a list of lists of numbers, all equally long."""
    width = len(listed(rows)[0]) if width is None else width
    values = [vector(row, width) for row in listed(rows)]
    if height is not None and len(values) != height:
        raise ValueError(f"{len(values)} rows where {height} are needed")
    return values


def name(value: Any) -> str:
    """A name that is printed as it is: no line breaks, nothing that a terminal obeys."""
    if not isinstance(value, str) or not value.isprintable() or len(value) > 200:
        raise ValueError(f"{ascii(value)[:80]} is no name")
    return value


def whole(value: Any, least: int) -> int:
    """A whole number, neither true nor 2.0."""
    if isinstance(value, bool) or not isinstance(value, int) or value < least:
        raise ValueError(f"{value!r} is not a whole number of at least {least}")
    return value


def one_of(value: Any, known: tuple[str, ...]) -> str:
    """One of the words that are known."""
    if value not in known:
        raise ValueError(f"{value!r} is not one of {', '.join(known)}")
    return str(value)
