"""What is given as numbers, vectors, maps and sets, checked: one clear error for each."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import ReachError

Array = NDArray[np.float64]
Index = NDArray[np.intp]


def as_numbers(name: str, value: Any) -> Array:
    """An array of floats, or one clear error."""
    if isinstance(value, np.ndarray) and value.dtype == float:
        return value
    try:
        found = np.asarray(value)
        if found.dtype.kind not in "biufO":
            raise TypeError("they are not real numbers")
        return np.asarray(found, dtype=float)
    except (TypeError, ValueError, OverflowError) as exc:
        raise ReachError(f"{name} must be numbers, got {type(value).__name__}: {exc}") from None


def as_vector(value: ArrayLike, n: int) -> Array:
    """A finite vector (or stack of them) of n entries, or one clear error."""
    vector = as_numbers("a vector", value)
    if vector.ndim == 0 or vector.shape[-1] != n:
        raise ReachError(f"expected vectors of {n} entries, got shape {vector.shape}")
    if not np.all(np.isfinite(vector)):
        raise ReachError("a vector must have finite entries, got nan or inf")
    return vector


def as_rows(value: ArrayLike, n: int, batch: tuple[int, ...]) -> Array:
    """Finite rows (..., r, n), or one vector (n,), that go together with a stack of sets."""
    D = as_vector(value, n)
    if batch and D.ndim > 2:
        require_alike(D.shape[:-2], batch)
    return D


def as_one_vector(value: ArrayLike, n: int) -> Array:
    """A finite vector of n entries, or one clear error."""
    vector = as_vector(value, n)
    if vector.ndim != 1:
        raise ReachError(f"expected one vector of {n} entries, got shape {vector.shape}")
    return vector


def as_map(value: ArrayLike, n: int) -> Array:
    """A finite matrix (or stack of them) that acts on dimension n, or one clear error."""
    M = as_numbers("a map", value)
    if M.ndim < 2 or M.shape[-1] != n:
        raise ReachError(f"cannot apply a map of shape {M.shape} to a set of dimension {n}")
    if not np.all(np.isfinite(M)):
        raise ReachError("a map must have finite entries, got nan or inf")
    return M


def as_matrix(value: ArrayLike, n: int) -> Array:
    """A finite matrix with n columns, or one clear error."""
    M = as_map(value, n)
    if M.ndim != 2:
        raise ReachError(f"a map of a single set must be one matrix, got shape {M.shape}")
    return M


def as_factor(value: float, name: str = "a factor") -> float:
    """A finite number, or one clear error."""
    number = as_numbers(name, value)
    if number.ndim != 0 or not np.isfinite(number):
        raise ReachError(f"{name} must be one finite number, got {value!r}")
    return float(number)


def as_count(name: str, value: Any) -> int:
    """A whole number >= 0, or one clear error."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 0:
        raise ReachError(f"{name} must be a whole number >= 0, got {value!r}")
    return int(value)


def require_same_dim(a: Any, b: Any) -> None:
    """Refuse what is no set, and sets of different dimensions."""
    require_sets(a, b)
    if a.dim != b.dim:
        raise ReachError(f"sets of dimensions {a.dim} and {b.dim} do not go together")


def is_set(value: Any) -> bool:
    """Whether a value answers as a convex set does (see `reach.ConvexSet`)."""
    return hasattr(type(value), "support") and hasattr(type(value), "interval_hull")


def require_sets(*values: Any) -> None:
    """Refuse what is not a convex set."""
    for value in values:
        if not is_set(value):
            raise ReachError(f"a convex set is needed, got {type(value).__name__}")


def as_alike(first: str, a: ArrayLike, second: str, b: ArrayLike) -> tuple[Array, Array]:
    """Two arrays of numbers broadcast with each other, at least vectors."""
    one, other = as_numbers(first, a), as_numbers(second, b)
    try:
        one, other = np.broadcast_arrays(one, other)
    except ValueError:
        raise ReachError(
            f"{first} and {second} do not go together: shapes {one.shape}, {other.shape}"
        ) from None
    return one, other


def require_alike(*shapes: tuple[int, ...]) -> None:
    """Refuse stacks that do not broadcast with each other."""
    try:
        np.broadcast_shapes(*shapes)
    except ValueError:
        raise ReachError(f"stacks of shapes {', '.join(map(str, shapes))} do not go together") from None


def require_stackable(parts: Any, kind: type) -> None:
    """Refuse what is not a sequence of sets of one kind and shape."""
    good = isinstance(parts, list | tuple) and parts and all(isinstance(part, kind) for part in parts)
    if not good or len({(part.dim, part.batch) for part in parts}) > 1:
        raise ReachError(f"a stack needs a sequence of {kind.__name__} of one dimension and shape")


def stacked(values: Array, index: Any) -> Array:
    """What an index selects from a stack, or one clear error."""
    try:
        return np.asarray(values[index])
    except (IndexError, TypeError, ValueError) as exc:
        raise ReachError(f"an index selects from the batch axes: {exc}") from None


def require_single(X: Any, what: str) -> None:
    """Refuse a stack of sets."""
    if getattr(X, "batch", ()):
        raise ReachError(f"{what} asks a single set, got a stack of shape {X.batch}")


def selector(dims: Sequence[int], n: int) -> Array:
    """Rows of the identity that pick coordinates, shape (len(dims), n)."""
    try:
        picked = [as_count("an entry of dims", i) for i in dims]
    except TypeError:
        raise ReachError(f"dims must be a sequence of numbers, got {dims!r}") from None
    if not picked or len(set(picked)) != len(picked) or not all(0 <= i < n for i in picked):
        raise ReachError(f"dims must be different numbers from 0 to {n - 1}, got {picked}")
    return np.asarray(np.eye(n)[picked])


def single_set(name: str, value: Any) -> None:
    """Refuse what is not one convex set."""
    if not is_set(value):
        raise ReachError(f"{name} must be a convex set, got {type(value).__name__}")
    if getattr(value, "batch", ()):
        raise ReachError(f"{name} must be a single set, got a stack of shape {value.batch}")


def is_positive(value: Any) -> bool:
    """Whether a value is one finite number above zero."""
    real = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
    return bool(real and 0 < value < np.inf)


def require_positive(name: str, value: float) -> None:
    """Refuse what is not one finite number above zero."""
    if not is_positive(value):
        raise ReachError(f"the {name} must be a finite number > 0, got {value!r}")


def per_row(name: str, value: ArrayLike, r: int) -> Array:
    """One number for each of r rows."""
    numbers = as_numbers(f"the {name}", value)
    if numbers.shape not in ((), (1,), (r,)) or np.any(np.isnan(numbers)):
        raise ReachError(f"the {name} must be a number or {r} of them, got {value!r}")
    return np.broadcast_to(numbers, (r,))


def as_directions(name: str, value: ArrayLike, n: int) -> Array:
    """Finite rows (r, n), at least one; a single vector is one row."""
    D = np.atleast_2d(as_numbers(name, value))
    if D.ndim != 2 or D.shape[1] != n or len(D) == 0 or not np.all(np.isfinite(D)):
        raise ReachError(f"{name} must be finite rows of length {n}, got shape {D.shape}")
    return D


def as_frame(value: ArrayLike | None, n: int) -> Array:
    """An invertible matrix of n columns; the coordinate axes if none is given."""
    F = np.eye(n) if value is None else as_numbers("frame", value)
    if F.shape != (n, n) or not np.all(np.isfinite(F)) or np.linalg.matrix_rank(F) < n:
        raise ReachError(f"the frame must be an invertible matrix of {n} rows")
    return F
