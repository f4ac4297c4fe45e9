"""Short texts for results in a session or a notebook, however large the arrays in them are."""

from collections.abc import Iterator, Mapping, Set
from dataclasses import fields, is_dataclass
from html import escape
from typing import Any, TypeVar

import numpy as np

MOST_VALUE, MOST_TEXT = 60, 600  # longest text of one value, and of all of them
FEW = 6  # numbers of an array that are written out

Class = TypeVar("Class", bound=type)


def short_repr(cls: Class) -> Class:
    """Give a dataclass a short ``repr``, and a table of the same values for notebooks.

    The values are its fields, or what its method ``_brief`` returns as a mapping.
    """
    setattr(cls, "__repr__", _text)  # noqa: B010 - assigning to a method is an error for type checkers
    setattr(cls, "_repr_html_", _table)  # noqa: B010
    return cls


def _values(result: Any) -> Iterator[tuple[str, str]]:
    brief = getattr(result, "_brief", None)
    if brief is not None:
        yield from ((name, short(value)) for name, value in brief().items())
        return
    for one in fields(result):
        if one.repr:
            yield one.name, short(getattr(result, one.name, None))


def _text(self: Any) -> str:
    text = ", ".join(f"{name}={value}" for name, value in _values(self))
    return f"{type(self).__name__}({_cut(text, MOST_TEXT)})"


def _table(self: Any) -> str:
    rows = "".join(
        f'<tr><th style="text-align: left">{escape(name.replace("_", " "))}</th>'
        f'<td style="text-align: left">{escape(value)}</td></tr>'
        for name, value in _values(self)
    )
    return f"<table><caption>{escape(type(self).__name__)}</caption><tbody>{rows}</tbody></table>"


def short(value: Any) -> str:
    """Return a text of at most `MOST_VALUE` letters: small values written out, of others kind and size."""
    if isinstance(value, np.ndarray):
        if value.size <= FEW and value.dtype != object:
            return _cut(np.array2string(value, precision=6, separator=", ").replace("\n", ""), MOST_VALUE)
        return f"array of shape {value.shape}"
    if isinstance(value, str):
        return _cut(" ".join(value.split()), MOST_VALUE)
    if isinstance(value, (float, np.floating)):
        return f"{value:.6g}"
    if is_dataclass(value) and not isinstance(value, type):
        return type(value).__name__
    if isinstance(value, Mapping):
        return "{" + _cut(", ".join(map(str, list(value)[:FEW])), MOST_VALUE - 5) + "}"
    if isinstance(value, (tuple, list, Set)):
        if all(isinstance(one, (str, int, float)) for one in value) and len(value) <= FEW:
            return _cut(repr(value), MOST_VALUE)
        kinds = sorted({type(one).__name__ for one in value})
        return _cut(f"{len(value)} of {' and '.join(kinds)}", MOST_VALUE)
    text = getattr(value, "__qualname__", None) if callable(value) else repr(value)
    return _cut(text or type(value).__name__, MOST_VALUE)


def _cut(text: str, limit: int) -> str:
    return text if len(text) <= limit else text[: limit - 1] + "\N{HORIZONTAL ELLIPSIS}"
