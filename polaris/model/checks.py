"""Checks of single arguments: each refuses with one message naming field, value and rule."""

import math
from collections.abc import Collection
from types import UnionType
from typing import get_args

import numpy as np
from numpy.typing import ArrayLike

from .errors import ScenarioError
from .errors import counted as counted
from .errors import exact as exact
from .system import Array, as_finite

MAX_STEPS = 100_000  # most steps of one scenario; a plan of more could not be solved anyway
MOST_ROWS = 100  # most facets of one polytope: its faces are enumerated for exact distances


def number(field: str, value: object, rule: str = "must be a finite number", least: float = -np.inf) -> float:
    """Check one finite number, at least `least`."""
    try:
        result = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError) as error:
        raise ScenarioError(field, value, rule) from error
    if isinstance(value, (str, bytes)) or not np.isfinite(result) or result < least:
        raise ScenarioError(field, value, rule)
    return result


def positive(field: str, value: object, unit: str) -> float:
    """Check one finite number > 0."""
    return number(field, value, f"must be a finite number > 0 [{unit}]", math.ulp(0.0))


def non_negative(field: str, value: object, unit: str) -> float:
    """Check one finite number >= 0."""
    return number(field, value, f"must be a finite number >= 0 [{unit}]", 0.0)


def whole(field: str, value: object, least: int) -> int:
    """Check one whole number >= `least`."""
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, np.integer)) or value < least:
        raise ScenarioError(field, value, f"must be a whole number >= {least}")
    return int(value)


def one_of(field: str, value: object, allowed: Collection[str]) -> None:
    """Check one word."""
    if not isinstance(value, str) or value not in allowed:
        raise ScenarioError(field, value, f"must be one of {', '.join(map(repr, allowed))}")


def shaped(field: str, value: ArrayLike, shape: tuple[int, ...]) -> Array:
    """Check a finite array of one shape."""
    array = as_finite(field, value, len(shape))
    if array.shape != shape:
        raise ScenarioError(field, array.shape, f"must have shape {shape}")
    return array


def vector(field: str, value: ArrayLike, size: int, like: str = "") -> Array:
    """Check a finite vector of `size` numbers."""
    array = as_finite(field, value, 1)
    if len(array) != size:
        raise ScenarioError(field, value, f"must be {size} numbers" + (f", as {like}" if like else ""))
    return array


def halfspaces(field: str, H: ArrayLike, b: ArrayLike) -> tuple[Array, Array]:
    """Scale rows ``H p <= b`` to unit normals, shapes (F, d) and (F,)."""
    rows = as_finite(f"{field}.H", H, 2)
    count, d = rows.shape
    if not 1 <= d <= 3:
        raise ScenarioError(f"{field}.H", rows.shape, "must have 1, 2 or 3 columns, one per axis of position")
    if not 1 <= count <= MOST_ROWS:
        raise ScenarioError(f"{field}.H", rows.shape, f"must have 1 to {MOST_ROWS} rows")
    offsets = vector(f"{field}.b", b, count, "H has rows")
    peak = np.abs(rows).max(axis=1, keepdims=True)  # first, so that the norm cannot under- or overflow
    if np.any(peak < 1e-150):
        row = int(np.argmin(peak))
        raise ScenarioError(f"{field}.H", rows[row].tolist(), f"row {row} must not be zero")
    length = np.linalg.norm(rows / peak, axis=1, keepdims=True)
    with np.errstate(over="ignore"):
        scaled = offsets / peak[:, 0] / length[:, 0]
    if not np.all(np.isfinite(scaled)):
        raise ScenarioError(f"{field}.b", offsets.tolist(), "must be finite once the rows of H have length 1")
    return np.asarray(rows / peak / length), np.asarray(scaled)


def of_kind(field: str, value: object, kind: type | UnionType, made_by: str = "") -> None:
    """Check the type of an argument; `made_by` names the function that returns such a value."""
    if not isinstance(value, kind):
        names = " or a ".join(one.__name__ for one in get_args(kind) or (kind,))
        rule = f"must be a {names}" + (f", as {made_by} returns" if made_by else "")
        raise ScenarioError(field, type(value).__name__, rule)
