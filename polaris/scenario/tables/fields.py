"""Building blocks of the scenario models: strict numbers, vectors, matrices, and the base class."""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Discriminator,
    Field,
    Strict,
    Tag,
    model_validator,
)
from pydantic_core import PydanticCustomError

from ...model.checks import MAX_STEPS as MAX_STEPS
from ...model.checks import counted
from ...model.errors import ScenarioError
from ...model.system import Array
from ...model.tolerances import TIME

LARGEST = 1e12  # largest magnitude of any number in a scenario: beyond it, double precision loses millimetres

NAME_PATTERN = r"^[A-Za-z0-9][A-Za-z0-9_-]*$"
"""Names become file names and column heads, so they are letters, digits, ``_`` and ``-`` only."""

_UNIT = re.compile("_(m_s2|m_s|rad_s|1_s|rad|deg|kg|N|m|s)$")
_PYTHON_NAMES = {"normals": "H", "offsets": "b", "half_angle": "half_angle_rad"}


def python_name(key: str) -> str:
    """What the Python class that a table describes calls a key: the same without its unit, but for three."""
    bare = _UNIT.sub("", key)
    return _PYTHON_NAMES.get(bare, bare)


class ScenarioPart(BaseModel):
    """Base of every table of a scenario: unknown keys are refused, instances cannot change.

    The description of a field stands in `unit`, or, where it is long, in a string beneath the field.
    """

    model_config = ConfigDict(
        extra="forbid",
        frozen=True,
        hide_input_in_errors=True,
        validate_default=True,
        use_attribute_docstrings=True,
    )

    GONE: ClassVar[Mapping[str, str]] = {}  # keys of former versions, and what to write instead

    @model_validator(mode="before")
    @classmethod
    def _known_keys(cls, data: Any) -> Any:
        """Refuse an unknown key before anything else: it explains a missing one (a slip of the pen)."""
        for key in data if isinstance(data, Mapping) else ():
            if key not in cls.model_fields:
                told = {"key": key, "known": [*cls.model_fields], "gone": cls.GONE.get(key, "")}
                raise PydanticCustomError("unknown_key", "unknown key", told)
        return data

    def arguments(self) -> dict[str, Any]:
        """Its values (without `kind`) by the names that Python has for them, angles in radians."""
        values = {key: value for key, value in self if key != "kind"}
        return {
            python_name(key): math.radians(value) if key.endswith("_deg") else value
            for key, value in values.items()
        }


@contextmanager
def in_file_terms(path: str, part: ScenarioPart, **elsewhere: str) -> Iterator[None]:
    """Let errors of what is built from a table name the field of the file.

    `path` is that of the table; `elsewhere` gives the paths of what other tables hold, by Python's names.
    """
    try:
        yield
    except ScenarioError as error:
        name = error.field.rpartition(".")[2]
        keys = [f"{path}.{key}" for key in type(part).model_fields if name in (key, python_name(key))]
        field = elsewhere.get(name) or (keys[0] if keys else path)
        rule = error.rule.replace("H p <= b", "normals p <= offsets_m")
        raise ScenarioError(field, error.given, rule, error.where) from error


def check_length(field: str, vector: Sequence[Any], count: int) -> None:
    """Refuse a list of another length."""
    if len(vector) != count:
        raise ScenarioError(field, list(vector), f"must have {counted(count, 'number')}, has {len(vector)}")


def whole_parts(total: float, part: float) -> int | None:
    """How many times `part` goes into `total`; None if not a whole number of times."""
    ratio = total / part
    if not math.isfinite(ratio):
        return None
    count = round(ratio)
    return count if abs(ratio - count) <= TIME * max(count, 1) else None


def unit(text: str, description: str | None = None, **rules: Any) -> Any:
    """Field with its unit ("-" if it has none) and what it means, as the JSON Schema and the reference say.

    Without a description the string beneath the field is one; `rules` are those of `pydantic.Field`.
    """
    return Field(description=description, json_schema_extra={"unit": text}, **rules)


def _plain(value: Any) -> Any:
    """Accept numpy arrays where lists are meant (scenarios built in Python)."""
    return value.tolist() if hasattr(value, "tolist") else value


def _whole(value: Any) -> Any:
    """Refuse true and 1.0 where the whole number 1 is meant; they compare equal to it."""
    if type(value) is not int:
        raise ValueError("must be the whole number 1")
    return value


def _rectangular(rows: tuple[tuple[float, ...], ...]) -> tuple[tuple[float, ...], ...]:
    if len({len(row) for row in rows}) > 1:
        raise ValueError("must have rows of equal length")
    return rows


def _by_shape(single: str, vector: str, matrix: str) -> Discriminator:
    """What a value is read as, by its shape: neither list nor array, a list, or a list of lists."""

    def tag(value: Any) -> str:
        value = _plain(value)
        if not isinstance(value, (list, tuple)):
            return single
        return matrix if value and isinstance(value[0], (list, tuple)) else vector

    return Discriminator(tag)


def _with_kind(value: Any) -> Any:
    """Let a table without a kind be refused as one with a wrong kind is: with the kinds there are."""
    return {"kind": "", **value} if isinstance(value, Mapping) else value


BY_KIND = (Field(discriminator="kind"), BeforeValidator(_with_kind))

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
VersionOne = Annotated[Literal[1], BeforeValidator(_whole)]
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
"""The same, zero allowed."""
WordOrWeights = Annotated[
    Annotated[Literal["auto", "identity"], Tag("word")] | Annotated[LimitVector, Tag("vector")],
    _by_shape("word", "vector", "vector"),
]


def per_axis(field: str, given: float | tuple[float, ...], count: int) -> Array:
    """Numbers of all axes or inputs, shape (count,), from one for all or one each."""
    if isinstance(given, tuple):
        check_length(field, given, count)
    return np.broadcast_to(np.asarray(given, dtype=float), (count,)).copy()


class Head(ScenarioPart):
    """What every scenario file starts with."""

    schema_version: VersionOne = unit("-", "Version of this format.")
    name: Name = unit("-", "Short name; the run folder is called after it.")
    title: Text = unit("-", "One line for figures and tables.", min_length=1, max_length=200)
    description: Text = unit("-", "What the scenario shows.", default="", max_length=5000)
