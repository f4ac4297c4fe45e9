"""Values made by others, read once and without trust: whatever an object does then, nothing is raised.

Converting an object to numbers runs its own code: ``__array__`` of a tensor that requires gradients raises,
``__float__`` may answer differently the second time, and an array may be changed after it was handed over.
So what arrives in flight is turned into plain numbers of our own, once, and only those are used and logged.
"""

from array import array
from collections import deque
from dataclasses import dataclass
from itertools import islice
from typing import Any

import numpy as np

from .system import Array

LONGEST = 1000  # entries of one value that are kept; more are no measurement of anything

LISTS = (list, tuple, deque, range)
BUFFERS = (memoryview, array)


@dataclass(frozen=True, slots=True)
class Unreadable:
    """Stands for a value that is no numbers."""

    kind: str  # name of its type


def kind_of(value: object) -> str:
    """Name of a value's type, without asking the value or its metaclass."""
    return str(type.__dict__["__name__"].__get__(type(value)))[:LONGEST]


def real(value: object) -> float | None:
    """A number as a float, nan and infinities included; None for anything else."""
    if type(value) is float:
        return value
    try:
        if type(value) is np.ndarray and value.ndim == 0:
            value = value[()]
        kind = type(value)
        if issubclass(kind, (bool, np.bool_)):
            return None
        if issubclass(kind, float):
            return float.__float__(value)  # type: ignore[arg-type]
        if issubclass(kind, int):
            return int.__float__(value)  # type: ignore[arg-type]
        if issubclass(kind, (np.integer, np.floating)):
            with np.errstate(all="ignore"):
                return float(value)  # type: ignore[arg-type]
    except BaseException:  # the value's own code has run
        pass
    return None


def numbers(value: object, shape: tuple[int, ...] | None = None) -> Array | None:
    """Real numbers (of one shape) as an array of floats, nan included; None for anything else.

    Read are arrays, what has ``__array__``, and lists of numbers or of such lists; no deeper, as a list may
    hold itself. Masked entries are nan. An array of floats is returned as it is, not copied.
    """
    if type(value) is not np.ndarray or value.dtype != np.float64:
        try:
            value = _converted(value)
        except BaseException:  # the value's own code has run
            return None
        if value is None:
            return None
    return value if shape is None or value.shape == shape else None


def _converted(value: object) -> Array | None:
    kind = type(value)
    number = real(value)
    if number is not None:
        return np.array(number)
    if issubclass(kind, LISTS):
        return _listed(value)
    if not hasattr(kind, "__array__") and kind not in BUFFERS:
        return None
    data = np.asarray(value)
    if data.dtype.kind not in "iuf":
        return None
    with np.errstate(all="ignore"):
        floats = np.array(data, dtype=np.float64, subok=False)
    if isinstance(value, np.ma.MaskedArray):
        floats[np.asarray(np.ma.getmaskarray(value))] = np.nan
    return floats


def _listed(value: Any, deepest: int = 1) -> Array | None:
    values = list(islice(value, LONGEST + 1))  # a list of one's own kind may never end
    if len(values) > LONGEST:
        return None
    rows: list[Array] = []
    for entry in values:
        if issubclass(type(entry), LISTS):
            row = _listed(entry, deepest - 1) if deepest else None
        else:
            row = numbers(entry)
        if row is None or row.ndim > deepest or row.shape != (rows[0].shape if rows else row.shape):
            return None
        rows.append(row)
    return np.array(rows, dtype=float)


def sanitize(value: object) -> Any:
    """A value as it is used and logged: None, a float, an array of floats of our own, or `Unreadable`."""
    if value is None or type(value) is float:
        return value
    number = real(value)
    if number is not None:
        return number
    data = numbers(value)
    return Unreadable(kind_of(value)) if data is None or data.size > LONGEST else data.copy()
