"""Building blocks of the scenario models: strict numbers, vectors, matrices, and the base class."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Discriminator, Field, Strict, Tag

from ..model.checks import MAX_STEPS as MAX_STEPS

LARGEST = 1e12
"""Largest magnitude of any number in a scenario: beyond it, double precision loses millimetres."""

NAME_PATTERN = r"^[A-Za-z0-9][A-Za-z0-9_-]*$"
"""Names become file names and column heads, so they are letters, digits, ``_`` and ``-`` only."""


class ScenarioPart(BaseModel):
    """Base of every table of a scenario: unknown keys are refused, instances cannot change."""

    model_config = ConfigDict(extra="forbid", frozen=True, hide_input_in_errors=True, validate_default=True)


def unit(text: str, description: str, **rules: Any) -> Any:
    """Field with its description and its unit, both shown in the JSON Schema and the reference.

    Parameters
    ----------
    text : str
        Unit, or "-" where the field has none.
    description : str
        What the field means.
    **rules
        Handed to `pydantic.Field` (default, gt, le, min_length, ...).
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


def _shape_of(value: Any) -> str:
    """Tag of a value that may be a number, a word, a vector or a matrix."""
    value = _plain(value)
    if isinstance(value, (list, tuple)):
        return "matrix" if value and isinstance(value[0], (list, tuple)) else "vector"
    return "word" if isinstance(value, str) else "number"


def _vector_or_matrix(value: Any) -> str:
    return "matrix" if _shape_of(value) == "matrix" else "vector"


def _number_or_vector(value: Any) -> str:
    return "number" if _shape_of(value) in ("number", "word") else "vector"


def _word_or_vector(value: Any) -> str:
    return "vector" if _shape_of(value) in ("vector", "matrix") else "word"


# Strict: a number is a number, never true/false or a quoted string; integers are taken for floats.
Real = Annotated[float, Strict(), Field(allow_inf_nan=False)]
"""A finite number whose range the field itself gives."""
Number = Annotated[float, Strict(), Field(ge=-LARGEST, le=LARGEST, allow_inf_nan=False)]
NonNegative = Annotated[float, Strict(), Field(ge=0, le=LARGEST, allow_inf_nan=False)]
Positive = Annotated[float, Strict(), Field(gt=0, le=LARGEST, allow_inf_nan=False)]
NonNegativeOrInf = Annotated[float, Strict(), Field(ge=0)]
Whole = Annotated[int, Strict()]
Flag = Annotated[bool, Strict()]
Text = Annotated[str, Strict()]
VersionOne = Annotated[Literal[1], BeforeValidator(_whole)]
Name = Annotated[str, Strict(), Field(pattern=NAME_PATTERN, max_length=64)]

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
    Annotated[Vector, Tag("vector")] | Annotated[Matrix, Tag("matrix")], Discriminator(_vector_or_matrix)
]
PositivePerAxis = Annotated[
    Annotated[Positive, Tag("number")] | Annotated[LimitVector, Tag("vector")],
    Discriminator(_number_or_vector),
]
"""One positive number for all axes, or one per axis."""


def word_or_vector(words: Any) -> Any:
    """Type of a field that holds one of a few words, or a list of positive numbers."""
    return Annotated[
        Annotated[words, Tag("word")] | Annotated[LimitVector, Tag("vector")], Discriminator(_word_or_vector)
    ]
