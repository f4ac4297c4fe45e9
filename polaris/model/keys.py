"""Keys of scenario files: the types of their values, and the fields of classes that are tables of a file."""

import re
from dataclasses import dataclass, fields
from functools import cache, cached_property
from typing import Annotated, Any, Literal, get_type_hints

import numpy as np
from pydantic import (
    AfterValidator,
    BeforeValidator,
    Discriminator,
    Field,
    Strict,
    Tag,
    TypeAdapter,
    ValidationError,
)
from pydantic_core import ErrorDetails

from .errors import ScenarioError, counted, exact, quoted

LARGEST = 1e12  # largest magnitude of any number in a scenario: beyond it, double precision loses millimetres

STATES = "m, m/s"  # unit of what has one number for each state

NAME_PATTERN = r"^[A-Za-z0-9][A-Za-z0-9_-]*$"
"""Names become file names and column heads, so they are letters, digits, ``_`` and ``-`` only."""


def _plain(value: Any) -> Any:
    """Accept numpy's arrays and numbers where lists and numbers are meant (scenarios built in Python)."""
    if isinstance(value, (list, tuple)):
        return [_plain(entry) for entry in value]
    return value.tolist() if hasattr(value, "tolist") else value


def printable(text: str, most: int = 200) -> str:
    """One line of printable characters, cut to a length."""
    line = "".join(c if c.isprintable() else quoted(c)[1:-1] for c in " ".join(text.split()))
    return line if len(line) <= most else line[: most - 3] + "..."


def _require_int(value: Any) -> Any:
    """Refuse true and 1.0 where the whole number 1 is meant; they compare equal to it."""
    if type(value) is not int:
        raise ValueError("must be the whole number 1")
    return value


def _rectangular(rows: tuple[tuple[float, ...], ...]) -> tuple[tuple[float, ...], ...]:
    if len({len(row) for row in rows}) > 1:
        raise ValueError("must have rows of equal length")
    return rows


def _by_shape(single: str, vector: str, matrix: str) -> Discriminator:
    """Return the rule that reads a value by its shape: no list, a list, or a list of lists."""

    def tag(value: Any) -> str:
        value = _plain(value)
        if not isinstance(value, (list, tuple)):
            return single
        return matrix if value and isinstance(value[0], (list, tuple)) else vector

    return Discriminator(tag)


# Strict: a number is a number, never true/false or a quoted string; integers are taken for floats.
Real = Annotated[float, Strict(), Field(allow_inf_nan=False)]
"""A finite number whose range the field itself gives."""
Number = Annotated[float, Strict(), Field(ge=-LARGEST, le=LARGEST, allow_inf_nan=False)]
NonNegative = Annotated[float, Strict(), Field(ge=0, le=LARGEST, allow_inf_nan=False)]
Positive = Annotated[float, Strict(), Field(gt=0, le=LARGEST, allow_inf_nan=False)]
NonNegativeOrInf = Annotated[float, Strict(), Field(ge=0)]
Whole = Annotated[int, Strict()]
Index = Annotated[Whole, Field(ge=0, le=99)]
Seed = Annotated[Whole, Field(ge=0, le=2**63 - 1)]
Flag = Annotated[bool, Strict()]
Text = Annotated[str, Strict()]
VersionOne = Annotated[Literal[1], BeforeValidator(_require_int)]
Name = Annotated[str, Strict(), Field(pattern=NAME_PATTERN, max_length=64)]
_READ = rf"^(error|state|time|reference_input|(relative_)?(position|velocity):{NAME_PATTERN[1:-1]})$"
Input = Annotated[str, Strict(), Field(pattern=_READ)]  # what a network may read

_ENTRIES = Field(min_length=1, max_length=100)
Vector = Annotated[tuple[Number, ...], _ENTRIES, BeforeValidator(_plain)]
WidthVector = Annotated[tuple[NonNegative, ...], _ENTRIES, BeforeValidator(_plain)]
LimitVector = Annotated[tuple[Positive, ...], _ENTRIES, BeforeValidator(_plain)]
OpenWidthVector = Annotated[tuple[NonNegativeOrInf, ...], _ENTRIES, BeforeValidator(_plain)]
Matrix = Annotated[
    tuple[Annotated[tuple[Number, ...], _ENTRIES], ...],
    Field(min_length=1, max_length=1000),
    AfterValidator(_rectangular),
    BeforeValidator(_plain),
]
DiagonalOrMatrix = Annotated[
    Annotated[Vector, Tag("vector")] | Annotated[Matrix, Tag("matrix")],
    _by_shape("vector", "vector", "matrix"),
]
PositivePerAxis = Annotated[
    Annotated[Positive, Tag("number")] | Annotated[LimitVector, Tag("vector")],
    _by_shape("number", "vector", "vector"),
]
"""One positive number for all axes, or one per axis."""
NonNegativePerAxis = Annotated[
    Annotated[NonNegative, Tag("number")] | Annotated[WidthVector, Tag("vector")],
    _by_shape("number", "vector", "vector"),
]
"""A number of at least 0."""
WordOrWeights = Annotated[
    Annotated[Literal["auto", "identity"], Tag("word")] | Annotated[LimitVector, Tag("vector")],
    _by_shape("word", "vector", "vector"),
]


_UNIT = re.compile("_(m_s2|m_s|rad_s|1_s|rad|deg|kg|N|m|s)$")
_PYTHON_NAMES = {"normals": "H", "offsets": "b", "half_angle": "half_angle_rad"}


def python_name(key: str) -> str:
    """Return the name of a key in Python: without its unit, but for three."""
    bare = _UNIT.sub("", key)
    return _PYTHON_NAMES.get(bare, bare)


@dataclass(frozen=True)
class Key:
    """Key of a scenario file that gives a field of a class, with the unit and the type of its value."""

    name: str
    unit: str
    type: Any
    per: str = (
        ""  # of a list, or of the rows of a matrix: "axis" of position or "state", if one number for each
    )
    required: bool = False  # in a file, though the class has a default

    @cached_property
    def adapter(self) -> TypeAdapter[Any]:
        """Validator of a value."""
        return TypeAdapter(self.type)


@cache
def keys_of(cls: type) -> dict[str, Key]:
    """Return the keys of a dataclass by the names of its fields; fields without one are not in files."""
    hints = get_type_hints(cls, include_extras=True)
    marks = {name: getattr(hint, "__metadata__", ()) for name, hint in hints.items()}
    keys = {name: [mark for mark in metadata if isinstance(mark, Key)] for name, metadata in marks.items()}
    return {field.name: keys[field.name][0] for field in fields(cls) if keys[field.name]}


_RULES = {
    "greater_than": "must be > {gt}",
    "greater_than_equal": "must be >= {ge}",
    "less_than": "must be < {lt}",
    "less_than_equal": "must be <= {le}",
    "float_type": "must be a number",
    "int_type": "must be a whole number",
    "int_from_float": "must be a whole number",
    "int_parsing_size": "must be a whole number",
    "string_type": "must be text in quotes",
    "tuple_type": "must be a list",
    "list_type": "must be a list",
    "string_pattern_mismatch": "must be of the form {pattern}",
    "string_too_short": "must not be empty",
    "model_type": "must be a table",
    "model_attributes_type": "must be a table",
    "dict_type": "must be a table",
}
"""The rule that was broken, by pydantic's name of it, where there are plainer words than its own."""


def broken_rule(problem: ErrorDetails, value: Any) -> str:
    """Return the rule that a value broke, in plain words."""
    kind, context, message = problem["type"], problem.get("ctx") or {}, problem["msg"]
    if kind == "float_type" and type(value) is int and abs(value) > LARGEST:
        return f"must be a number of at most {LARGEST:g}"
    if kind == "too_short":
        return f"must have at least {counted(context['min_length'], 'entry', 'entries')}"
    if context.get("pattern") == NAME_PATTERN:
        return f"must consist of letters, digits, _ and -, as in {NAME_PATTERN}"
    if kind == "value_error":
        return printable(str(context.get("error", message)))
    if kind in _RULES:
        return _RULES[kind].format(**{k: exact(v) if isinstance(v, float) else v for k, v in context.items()})
    return printable(re.sub(r"^[A-Z]\w* should", "must", message))


def check_fields(instance: Any, path: str = "") -> None:
    """Check the fields of an object made in Python by the rules of a file, and turn lists into arrays.

    Raises `ScenarioError`, which names the field after `path`, if one is given.
    """
    cls: type = type(instance)
    sizes: dict[str, tuple[str, int]] = {}  # of the first field per axis or state
    for name, key in keys_of(cls).items():
        raw, field = getattr(instance, name), f"{path}.{name}".lstrip(".")
        if raw is None and getattr(cls, name, ...) is None:
            continue
        in_degrees = key.name.endswith("_deg") and isinstance(raw, int | float | np.number)
        raw = float(np.degrees(raw)) if in_degrees else raw
        try:
            value = key.adapter.validate_python(_plain(raw))
        except ValidationError as error:
            problem = error.errors(include_url=False)[0]
            rule = broken_rule(problem, problem["input"]) + ("" if key.unit == "-" else f" [{key.unit}]")
            raise ScenarioError(field, raw, rule) from None
        if isinstance(value, tuple):
            value = np.array(value, dtype=float)
            value.setflags(write=False)
            first, size = sizes.setdefault(key.per or name, (name, value.shape[-1]))
            if value.shape[-1] != size:
                raise ScenarioError(field, raw, f"must be {size} numbers, as {first} has")
            if key.per == "axis" and size > 3:
                rule = "must be 1, 2 or 3 numbers, one per axis of position"
                raise ScenarioError(field, raw, rule)
        if not in_degrees:
            object.__setattr__(instance, name, value)
