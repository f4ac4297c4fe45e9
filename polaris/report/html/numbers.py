"""Numbers on their way into a page: short, and never NaN, infinity or null in front of a reader."""

from __future__ import annotations

import html
import json
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

DIGITS = 6
"""Significant digits of what is drawn; tables show the folder's numbers with four."""

NONE = '<span class="none" title="no value">none</span>'

ABSENT: Mapping[str, tuple[str, str]] = {
    "min_distance_m": ("none", "there is no unsafe set"),
    "min_distance_mean_m": ("none", "there is no unsafe set"),
    "min_ttc_s": ("∞", "no run was ever on a collision course"),
    "min_ttc_free_drift_s": ("∞", "no run was ever on a collision course with its thrusters off"),
    "max_thrust_ratio_safety": ("none", "this controller never flew"),
    "max_thrust_ratio_experimental": ("none", "this controller never flew"),
    "until_s": ("∞", "for all time"),
}
"""What null says, by key: see the table in ``docs/guarantees.md``."""


def plain(values: ArrayLike) -> Any:
    """Nested lists of short numbers; what is not finite is None.

    Parameters
    ----------
    values : array_like
        Of numbers, any shape.
    """
    array = np.asarray(values)
    if array.dtype.kind in "iub":
        return array.tolist()
    return _short(array.astype(float))


def _short(array: NDArray[np.float64]) -> Any:
    if array.ndim == 0:
        return float(f"{float(array):.{DIGITS}g}") if np.isfinite(array) else None
    if array.ndim > 1:
        return [_short(part) for part in array]
    finite = np.isfinite(array).tolist()
    return [
        _whole(float(f"{value:.{DIGITS}g}")) if known else None
        for value, known in zip(array.tolist(), finite, strict=True)
    ]


def _whole(value: float) -> float | int:
    """The same number without ``.0``: it is written many thousand times."""
    return int(value) if value.is_integer() and abs(value) < 1e15 else value


def script_json(data: Any) -> str:
    """JSON that is inert inside ``<script>``: no text in it can end the element."""
    text = json.dumps(data, allow_nan=False, ensure_ascii=False, separators=(",", ":"))
    for mark in ("<", ">", "&", "\u2028", "\u2029"):
        text = text.replace(mark, f"\\u{ord(mark):04x}")
    return text


def escaped(text: Any) -> str:
    """Text from a file as HTML, in elements and in attributes."""
    return html.escape(str(text), quote=True)


def shown(value: Any, key: str = "", form: str = ".4g", unit: str = "") -> str:
    """A value of a file as HTML.

    Parameters
    ----------
    value : any
        A number, text, truth value, list of those, or None.
    key : str
        Its key in the file, which says what null means there (`ABSENT`).
    form : str
        Format of numbers.
    unit : str
        Written after a number.
    """
    if value is None:
        text, title = ABSENT.get(key, ("none", "no value"))
        return f'<span class="none" title="{escaped(title)}">{text}</span>'
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, (list, tuple)):
        return ", ".join(shown(item, key, form) for item in value) + (f" {unit}" if value and unit else "")
    if isinstance(value, (int, float)):
        return _number(value, form, unit)
    return escaped(value)


def _number(value: float, form: str, unit: str) -> str:
    if np.isnan(value):
        return NONE
    if np.isinf(value):
        sign = "" if value > 0 else "−"
        return f'<span class="none" title="{"" if value > 0 else "minus "}infinite">{sign}∞</span>'
    text = f"{value:d}" if isinstance(value, int) and form == ".4g" else f"{value:{form}}"
    return text + (f" {unit}" if unit else "")
