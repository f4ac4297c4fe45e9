"""Rows of a trace: from nested lists to tables of numbers, and where the first bad row is."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import chain
from typing import Any

import numpy as np

from ..model.errors import ScenarioError
from ..model.system import Array
from .model import AnySet, BallTrace, PointTrace, PolytopeTrace, RectangleTrace

LARGEST = 1e300  # numbers beyond are refused: their squares are not finite


class Odd(ValueError):
    """Fault of a row, as the rule of an error message."""


def table(place: str, rows: list[Any], flat: Callable[[Any], list[Any]]) -> Array:
    """All rows as one array, shape (rows, columns); `flat` turns a row into a flat list, or raises `Odd`."""
    flattened: list[list[Any]] = []
    for row in rows:
        try:
            flattened.append(flat(row))
        except Odd as error:
            raise ScenarioError(f"{place}[{len(flattened)}]", row, str(error)) from None
    return numbers(place, flattened, rows)


def numbers(place: str, flat: list[list[Any]], rows: Sequence[Any]) -> Array:
    """Flat lists of numbers as one array; messages show `rows`."""
    width = len(flat[0])
    if set(map(len, flat)) != {width}:
        i = next(i for i, row in enumerate(flat) if len(row) != width)
        raise ScenarioError(f"{place}[{i}]", rows[i], f"must be as long as the first row ({width} numbers)")
    if not set(map(type, chain.from_iterable(flat))) <= {int, float}:
        i = next(i for i, row in enumerate(flat) if not set(map(type, row)) <= {int, float})
        raise ScenarioError(f"{place}[{i}]", rows[i], "must hold nothing but numbers")
    try:
        array = np.array(flat, dtype=float)
        invalid = np.flatnonzero(~np.all(np.abs(array) <= LARGEST, axis=1))
        i = int(invalid[0]) if invalid.size else -1
    except OverflowError:
        i = next(i for i, row in enumerate(flat) if any(abs(value) > LARGEST for value in row))
    if i >= 0:
        raise ScenarioError(f"{place}[{i}]", rows[i], f"must hold finite numbers, at most {LARGEST:g}")
    return array


SPAN = "from_s", "until_s"  # optional keys of a set: when it holds [s]

FORMS = {
    "point": "must be a row [t, center]",
    "ball": "must be a row [t, [center, r]]",
    "rectangle": "must be a row [t, [center, dx, dy, dz]] with full lengths, as many as the center has axes",
    "polytope": "must be a row [t, [A, b]] with A p <= b, A a matrix and b a list as long",
}


def rows_of(prefix: str, item: dict[str, Any], form: str) -> list[Any]:
    """The rows of an agent or a set."""
    rows = item.get("state_trace")
    if not isinstance(rows, list) or not rows:
        raise ScenarioError(f"{prefix}.state_trace", rows, f"must be a list of rows {form}, at least one")
    return rows


def set_trace(prefix: str, item: dict[str, Any]) -> AnySet:
    """The stamped definitions of one unsafe set, and when it holds; velocities are read for a ball only."""
    limits = {k: numbers(f"{prefix}.{k}", [[item[k]]], [item[k]]).item() for k in SPAN if k in item}
    span = limits.get("from_s", -np.inf), limits.get("until_s", np.inf)
    return replace(_stamped_set(prefix, item), span=span)


def _stamped_set(prefix: str, item: dict[str, Any]) -> AnySet:
    kind, rows = item.get("set_type"), rows_of(prefix, item, "[t, def]")
    if not isinstance(kind, str) or kind not in FORMS:
        raise ScenarioError(f"{prefix}.set_type", kind, f"must be one of {', '.join(FORMS)}")
    place = f"{prefix}.state_trace"
    if kind == "polytope":
        return _polytopes(prefix, place, rows)
    values = table(place, rows, lambda row: _centred(kind, row))
    t, columns = values[:, 0], values[:, 1:]
    if kind == "point":
        return PointTrace(t, columns, where=prefix)
    if kind == "ball":
        velocities = _velocities(prefix, item.get("velocity_trace"), len(rows))
        return BallTrace(t, columns[:, :-1], columns[:, -1], velocities, where=prefix)
    if columns.shape[1] % 2:
        raise ScenarioError(f"{place}[0]", rows[0], FORMS[kind])
    center, lengths = np.hsplit(columns, 2)
    return RectangleTrace(t, center, lengths, where=prefix)


def _velocities(prefix: str, value: Any, M: int) -> Array | None:
    """The velocities of a ball's centre, one row per stamp; None if none are given."""
    if value is None:
        return None
    place, rule = f"{prefix}.velocity_trace", f"must be a list of rows [vx, vy, vz], {M} as in state_trace"
    rows = value if isinstance(value, list) and all(isinstance(row, list) for row in value) else []
    if len(rows) != M:
        raise ScenarioError(place, value, rule)
    return numbers(place, rows, rows)


def _definition(kind: str, row: Any) -> tuple[Any, Any]:
    """Time and definition of ``[t, def]``; a definition of several parts may lie bare in the row."""
    if not isinstance(row, list) or len(row) < 2:
        raise Odd(FORMS[kind])
    return row[0], row[1] if len(row) == 2 else row[1:]


def _centred(kind: str, row: Any) -> list[Any]:
    """``[t, *center, *sizes]`` of a point, ball or rectangle."""
    if isinstance(row, list) and len(row) > 2 and not any(isinstance(item, list) for item in row):
        return row  # all flat
    t, parts = _definition(kind, row)
    if kind == "point":
        return [t, *parts] if isinstance(parts, list) else [t, parts]
    if not isinstance(parts, list) or len(parts) < 2:
        raise Odd(FORMS[kind])
    center = parts[0] if isinstance(parts[0], list) else parts[:1]
    sizes = parts[1] if len(parts) == 2 and isinstance(parts[1], list) else parts[1:]
    if len(sizes) != (1 if kind == "ball" else len(center)):
        raise Odd(FORMS[kind])
    return [t, *center, *sizes]


def _polytopes(prefix: str, place: str, rows: list[Any]) -> PolytopeTrace:
    shapes: list[tuple[int, int]] = []

    def flat(row: Any) -> list[Any]:
        t, parts = _definition("polytope", row)
        A, b = parts if isinstance(parts, list) and len(parts) == 2 else ([], [])
        facets = isinstance(A, list) and all(isinstance(facet, list) for facet in A)
        if not facets or not isinstance(b, list) or len(b) != len(A) or len(set(map(len, A))) != 1:
            raise Odd(FORMS["polytope"])
        if all(isinstance(item, list) and len(item) == 1 for item in b):
            b = [item[0] for item in b]
        shape = (len(A), len(A[0]))
        if shapes and shape != shapes[0]:
            raise Odd(f"A must be {shapes[0][0]} x {shapes[0][1]}, as in the first row")
        shapes[:] = shapes or [shape]
        return [t, *chain.from_iterable(A), *b]

    values = table(place, rows, flat)
    F, d = shapes[0]
    A = values[:, 1 : 1 + F * d].reshape(len(rows), F, d)
    return PolytopeTrace(values[:, 0], A, values[:, 1 + F * d :], where=prefix)
