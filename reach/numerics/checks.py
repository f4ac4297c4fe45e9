"""Arguments as they are given, each checked with one clear error: `checked` does so by annotations."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from functools import wraps
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import ReachError, Unresolved

Array = NDArray[np.float64]
Index = NDArray[np.intp]
F = TypeVar("F", bound=Callable[..., Any])


def checked(function: F) -> F:
    """Check and convert arguments by a function's annotations; beyond floating point is `Unresolved`."""
    code = function.__code__
    names = code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]
    kinds = {name: kind for name, kind in function.__annotations__.items() if name in names}

    @wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        positional = [
            as_kind(name, kinds[name], value) if name in kinds else value
            for name, value in zip(names, args, strict=False)
        ]
        positional += args[len(positional) :]
        keywords = {k: as_kind(k, kinds[k], v) if k in kinds else v for k, v in kwargs.items()}
        try:
            with np.errstate(over="raise", invalid="raise", divide="raise"):
                return function(*positional, **keywords)
        except (FloatingPointError, OverflowError) as exc:
            raise Unresolved(f"the numbers given lead beyond floating point: {exc}") from exc

    return cast(F, call)


def check_fields(value: Any) -> None:
    """Check the fields of a dataclass by their annotations, and replace each by its converted value."""
    for field in fields(value):
        converted = as_kind(field.name, str(field.type), getattr(value, field.name))
        object.__setattr__(value, field.name, converted)


def as_kind(name: str, kind: str, value: Any) -> Any:
    """The value in an annotation's type; names of classes that are not in the table are looked for."""
    options = kind.split(" | ")
    if value is None and not {"None", "Any", "Bound"}.isdisjoint(options):
        return None
    needed = []
    for option in options:
        if option in _KINDS:
            words, convert = _KINDS[option]
            converted = convert(value)
            if converted is not _WRONG:
                return converted
            needed.append(words)
        elif option in ("Any",) or not option.isidentifier() or _is_a(value, option):
            return value
        elif option != "None":
            needed.append(option)
    text = repr(value) if isinstance(value, int | float | str | tuple | list | None) else ""
    display = text if 0 < len(text) < 80 else f"an object of type {type(value).__name__}"
    name = "the initial set" if name == "initial" else name
    raise ReachError(f"{name} must be {' or '.join(needed)}, got {display}")


_WRONG: Any = object()


def _is_a(value: Any, *names: str) -> bool:
    """Return True if a value's class, or one it derives from, has one of some names."""
    return any(base.__name__ in names for base in type(value).__mro__)


def _checked(accepts: Callable[[Any], bool]) -> Callable[[Any], Any]:
    return lambda value: value if accepts(value) else _WRONG


def _is_number(value: Any) -> bool:
    numeric = isinstance(value, int | float | np.number | np.ndarray) and not isinstance(value, bool)
    return numeric and not (np.ndim(value) or np.iscomplexobj(value) or np.isnan(value))


def _is_whole(value: Any) -> bool:
    return isinstance(value, int | np.integer) and not isinstance(value, bool)


def _numbers(value: Any) -> Any:
    try:
        return as_numbers("", value)
    except ReachError:
        return _WRONG


def _finite(value: Any) -> Any:
    array = _numbers(value)
    return array if array is not _WRONG and np.isfinite(array).all() else _WRONG


def _is_specs(value: Any) -> bool:
    """Return True if a value maps names of modes to sequences of specifications."""
    if not isinstance(value, Mapping):
        return False
    sequences = all(isinstance(k, str) and isinstance(v, Sequence) for k, v in value.items())
    return sequences and all(_is_a(spec, "Always", "Never") for v in value.values() for spec in v)


def is_set(value: Any) -> bool:
    """Return True if a value answers as a convex set does (see `reach.ConvexSet`)."""
    return hasattr(type(value), "support") and hasattr(type(value), "interval_hull")


_STRING = ("a string", _checked(lambda value: isinstance(value, str)))
_SET = ("a convex set", _checked(is_set))
_KINDS: dict[str, tuple[str, Callable[[Any], Any]]] = {
    "float": ("a number", _checked(_is_number)),
    "int": ("a whole number", _checked(_is_whole)),
    "bool": ("true or false", _checked(lambda value: isinstance(value, bool | np.bool_))),
    "str": _STRING,
    "Policy": _STRING,
    "Method": _STRING,
    "ConvexSet": _SET,
    "SetOperators": _SET,
    "ArrayLike": ("numbers", _numbers),
    "Array": ("an array of finite numbers", _finite),
    "Specs": ("a mapping from names of modes to sequences of Always and Never", _checked(_is_specs)),
    "Bound": ("numbers or a function", lambda value: value if callable(value) else _numbers(value)),
    "Callable[[float], ArrayLike]": ("a function of time", _checked(callable)),
    "np.random.Generator": ("a generator", _checked(lambda value: isinstance(value, np.random.Generator))),
}
"""By annotation: its meaning in words, and its converter, which returns `_WRONG` if it cannot convert."""


def as_numbers(name: str, value: Any) -> Array:
    """An array of floats."""
    if isinstance(value, np.ndarray) and value.dtype == float:
        return value
    try:
        if value is None or isinstance(value, str | bytes | Mapping) or is_set(value):
            raise TypeError("they are not numbers")
        array = np.asarray(value)
        if array.dtype.kind not in "biufO":
            raise TypeError("they are not real numbers")
        return np.asarray(array, dtype=float)
    except (TypeError, ValueError, OverflowError) as exc:
        raise ReachError(f"{name} must be numbers, got {type(value).__name__}: {exc}") from None


def as_shaped(name: str, value: Any, needed: str, fits: Callable[[tuple[int, ...]], bool]) -> Array:
    """An array of finite floats whose shape fits the wanted one."""
    array = as_numbers(name, value)
    shaped = fits(array.shape)
    if not shaped or not np.isfinite(array).all():
        raise ReachError(f"{name} must be {needed}, got {'nan or inf' if shaped else f'shape {array.shape}'}")
    return array


def as_array(name: str, value: Any, *shape: int) -> Array:
    """An array of finite floats of one shape."""
    needed = f"{' x '.join(map(str, shape))} finite numbers"
    return as_shaped(name, value, needed, lambda actual: actual == shape)


def finite_fields(X: Any, *names: str) -> tuple[Array, ...]:
    """Fields of a frozen dataclass as arrays of finite floats, which replace the given values."""
    arrays = tuple(as_numbers(name, getattr(X, name)) for name in names)
    for name, values in zip(names, arrays, strict=True):
        if not np.isfinite(values).all():
            raise ReachError(f"{' and '.join(names)} must be finite numbers")
        object.__setattr__(X, name, values)
    return arrays


def as_vector(value: ArrayLike, n: int, single: bool = False) -> Array:
    """A finite vector of n entries, or a stack of them if there need not be a single one."""
    axes = 1 if single else np.inf
    return as_shaped("vectors", value, f"of {n} finite entries", lambda s: s[-1:] == (n,) and len(s) <= axes)


def as_map(value: ArrayLike, n: int, single: bool = False) -> Array:
    """A finite matrix that acts on dimension n, or a stack of them if there need not be a single one."""
    needed, axes = f"finite and act on dimension {n}", 2 if single else np.inf
    return as_shaped("a map", value, needed, lambda s: s[-1:] == (n,) and 2 <= len(s) <= axes)


def as_frame(value: ArrayLike | None, n: int) -> Array:
    """An invertible matrix of n columns; the coordinate axes if none is given."""
    F = np.eye(n) if value is None else as_array("the frame", value, n, n)
    if np.linalg.matrix_rank(F) < n:
        raise ReachError(f"the frame must be an invertible matrix of {n} rows")
    return F


def as_directions(value: ArrayLike, n: int) -> Array:
    """Finite rows (r, n), at least one; a single vector is one row."""
    D = np.atleast_2d(as_numbers("directions", value))
    return as_shaped("directions", D, f"finite rows of length {n}", lambda s: s[1:] == (n,) and s[0] > 0)


def per_row(name: str, value: ArrayLike, r: int) -> Array:
    """One number for each of r rows."""
    numbers = as_numbers(f"the {name}", value)
    if numbers.shape not in ((), (1,), (r,)) or np.any(np.isnan(numbers)):
        raise ReachError(f"the {name} must be a number or {r} of them, got {value!r}")
    return np.broadcast_to(numbers, (r,))


def as_factor(value: float, name: str = "a factor", least: float = -np.inf) -> float:
    """A finite number, not below the least allowed."""
    number = as_numbers(name, value)
    if number.ndim != 0 or not np.isfinite(number):
        raise ReachError(f"{name} must be one finite number, got {value!r}")
    if number < least:
        raise ReachError(f"{name} must be >= {least:g}, got {float(number)!r}")
    return float(number)


def as_count(name: str, value: Any) -> int:
    """A whole number >= 0."""
    if not _is_whole(value) or value < 0:
        raise ReachError(f"{name} must be a whole number >= 0, got {value!r}")
    return int(value)


def require_positive(name: str, value: Any) -> None:
    """Refuse all but one finite number above zero."""
    if not (_is_number(value) and 0 < value < np.inf):
        raise ReachError(f"the {name} must be a finite number > 0, got {value!r}")


def require_same_dim(a: Any, b: Any) -> None:
    """Refuse values that are no sets, and sets of different dimensions."""
    require_sets(a, b)
    if a.dim != b.dim:
        raise ReachError(f"sets of dimensions {a.dim} and {b.dim} do not go together")


def require_sets(*values: Any) -> None:
    """Refuse all but convex sets."""
    for value in values:
        if not is_set(value):
            raise ReachError(f"a convex set is needed, got {type(value).__name__}")


def require_single(name: str, value: Any, n: int | None = None) -> None:
    """Refuse all but one convex set, of dimension n if that is given."""
    if not is_set(value):
        raise ReachError(f"{name} must be a convex set, got {type(value).__name__}")
    if getattr(value, "batch", ()):
        raise ReachError(f"{name} must be a single set, got a stack of shape {value.batch}")
    if n is not None and value.dim != n:
        raise ReachError(f"{name} must have dimension {n}, got {value.dim}")


def require_alike(*shapes: tuple[int, ...]) -> None:
    """Refuse stacks that do not broadcast with each other."""
    try:
        np.broadcast_shapes(*shapes)
    except ValueError:
        raise ReachError(f"stacks of shapes {', '.join(map(str, shapes))} do not go together") from None


def selector(dims: Sequence[int], n: int) -> Array:
    """Rows of the identity that pick coordinates, shape (len(dims), n)."""
    try:
        picked = [as_count("an entry of dims", i) for i in dims]
    except TypeError:
        raise ReachError(f"dims must be a sequence of numbers, got {dims!r}") from None
    if not picked or len(set(picked)) != len(picked) or not all(0 <= i < n for i in picked):
        raise ReachError(f"dims must be different numbers from 0 to {n - 1}, got {picked}")
    return np.asarray(np.eye(n)[picked])
