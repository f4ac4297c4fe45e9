"""Arguments checked by their annotations, so that a wrong one is a `ReachError` that names it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from functools import wraps
from typing import Any, TypeVar

import numpy as np

from .checks import is_set
from .errors import ReachError, Unresolved

F = TypeVar("F", bound=Callable[..., Any])


def checked(function: F) -> F:
    """Check the arguments of a function whose annotations say what they are.

    Arrays are converted to floats. What leaves floating point on the way, where nothing provides for it,
    is `Unresolved`, not a warning of numpy's.
    """
    code = function.__code__
    names = code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]
    kinds = {name: kind for name, kind in function.__annotations__.items() if name in names}

    @wraps(function)
    def call(*args: Any, **more: Any) -> Any:
        given = [
            as_kind(name, kinds[name], value) if name in kinds else value
            for name, value in zip(names, args, strict=False)
        ]
        given += args[len(given) :]
        named = {k: as_kind(k, kinds[k], v) if k in kinds else v for k, v in more.items()}
        try:
            with np.errstate(over="raise", invalid="raise", divide="raise"):
                return function(*given, **named)
        except (FloatingPointError, OverflowError) as exc:
            raise Unresolved(f"the numbers given lead beyond floating point: {exc}") from exc

    return call  # type: ignore[return-value]


def check_fields(value: Any) -> None:
    """The same for the fields of a dataclass, which are replaced by what they are converted to."""
    for field in fields(value):
        given = getattr(value, field.name)
        converted = as_kind(field.name, str(field.type), given)
        if converted is not given:
            object.__setattr__(value, field.name, converted)


def as_kind(name: str, kind: str, value: Any) -> Any:
    """The value as what an annotation asks for.

    Raises
    ------
    ReachError
        If it is something else.
    """
    options = [option.strip() for option in kind.split("|")]
    if value is None and ("None" in options or "Any" in options):
        return None
    for option in options:
        if option == "None":
            continue
        if option not in _KINDS:
            if option[:1].isupper() and option.isidentifier() and option not in _FREE:
                if _is_a(value, option):
                    return value
                continue
            return value
        found = _KINDS[option](value)
        if found is not _WRONG:
            return found
    wanted = " or ".join(_WORDS.get(option, option) for option in options if option != "None")
    raise ReachError(f"{_NAMES.get(name, name)} must be {wanted}, got {_shown(value)}")


def _shown(value: Any) -> str:
    text = repr(value) if isinstance(value, int | float | str | tuple | list | None) else ""
    return text if 0 < len(text) < 80 else f"an object of type {type(value).__name__}"


_WRONG: Any = object()
_FREE = ("Any",)
_NAMES = {"initial": "the initial set"}
_WORDS = {
    "float": "a number",
    "int": "a whole number",
    "bool": "true or false",
    "str": "a string",
    "ConvexSet": "a convex set",
    "SetOperators": "a convex set",
    "ArrayLike": "numbers",
    "Array": "an array of finite numbers",
    "Specs": "a mapping from names of modes to sequences of Always and Never",
}


def _is_a(value: Any, *names: str) -> bool:
    """Whether a value's class, or one it derives from, has one of some names."""
    return any(base.__name__ in names for base in type(value).__mro__)


def _number(value: Any) -> Any:
    if isinstance(value, bool | np.bool_) or not isinstance(value, int | float | np.number | np.ndarray):
        return _WRONG
    if np.ndim(value) or np.iscomplexobj(value) or np.isnan(value):
        return _WRONG
    return value


def _whole(value: Any) -> Any:
    return value if isinstance(value, int | np.integer) and not isinstance(value, bool) else _WRONG


def _flag(value: Any) -> Any:
    return value if isinstance(value, bool | np.bool_) else _WRONG


def _set(value: Any) -> Any:
    return value if is_set(value) else _WRONG


def _numbers(value: Any) -> Any:
    if isinstance(value, np.ndarray) and value.dtype == float:
        return value
    if value is None or isinstance(value, str | bytes | Mapping) or _set(value) is not _WRONG:
        return _WRONG
    try:
        found = np.asarray(value)
        if found.dtype.kind not in "biufO":
            return _WRONG
        return np.asarray(found, dtype=float)
    except (TypeError, ValueError, OverflowError):
        return _WRONG


def _finite(value: Any) -> Any:
    found = _numbers(value)
    return found if found is not _WRONG and np.all(np.isfinite(found)) else _WRONG


def _sequence(value: Any) -> Any:
    return (
        value if isinstance(value, Sequence | np.ndarray) and not isinstance(value, str | bytes) else _WRONG
    )


def _specs(value: Any) -> Any:
    """Sequences of specifications by the names of modes."""
    if not isinstance(value, Mapping):
        return _WRONG
    good = all(isinstance(k, str) and isinstance(v, Sequence) for k, v in value.items())
    return (
        value
        if good and all(_is_a(spec, "Always", "Never") for v in value.values() for spec in v)
        else _WRONG
    )


def _wholes(value: Any) -> Any:
    found = _sequence(value)
    return found if found is not _WRONG and all(_whole(one) is not _WRONG for one in found) else _WRONG


_KINDS: dict[str, Callable[[Any], Any]] = {
    "float": _number,
    "int": _whole,
    "bool": _flag,
    "str": lambda value: value if isinstance(value, str) else _WRONG,
    "ConvexSet": _set,
    "SetOperators": _set,
    "ArrayLike": _numbers,
    "Array": _finite,
    "Sequence[int]": _wholes,
    "Policy": lambda value: value if isinstance(value, str) else _WRONG,
    "Method": lambda value: value if isinstance(value, str) else _WRONG,
    "Specs": _specs,
    "Bound": lambda value: value if value is None or callable(value) else _numbers(value),
    "Callable[[float], ArrayLike]": lambda value: value if callable(value) else _WRONG,
    "np.random.Generator": lambda value: value if isinstance(value, np.random.Generator) else _WRONG,
}
