"""Building blocks of the scenario models: the base class, and tables that a class describes."""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import MISSING, fields
from inspect import cleandoc
from typing import TYPE_CHECKING, Any, ClassVar, Literal

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator
from pydantic_core import PydanticCustomError

from ...model import keys as f
from ...model.checks import counted
from ...model.errors import ScenarioError
from ...model.system import Array
from ...model.tolerances import TIME


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

    GONE: ClassVar[Mapping[str, str]] = {}
    """Rules for keys of former versions, and for their values as ``"key=value"``: the names of today."""

    @model_validator(mode="before")
    @classmethod
    def _known_keys(cls, data: Any) -> Any:
        """Refuse an unknown key before anything else: it explains a missing one (a slip of the pen)."""
        for key in data if isinstance(data, Mapping) else ():
            value = data[key] if isinstance(data[key], str) else ""
            rule = cls.GONE.get(key, "") or cls.GONE.get(f"{key}={value}", "")
            if key not in cls.model_fields or rule:
                context = {"key": key, "known": [*cls.model_fields], "gone": rule}
                raise PydanticCustomError("unknown_key", "unknown key", context)
        return data

    @classmethod
    def python_names(cls) -> dict[str, str]:
        """Return the Python names of its keys."""
        return {key: f.python_name(key) for key in cls.model_fields}

    def arguments(self) -> dict[str, Any]:
        """Return the values (without `kind`) by the names that Python has for them, angles in radians."""
        values, names = dict(self), self.python_names()
        return {
            name: math.radians(values[key]) if key.endswith("_deg") else values[key]
            for key, name in names.items()
            if key != "kind"
        }


@contextmanager
def in_file_terms(path: str, part: ScenarioPart, **elsewhere: str) -> Iterator[None]:
    """Let errors of objects built from a table name the field of the file.

    `path` is that of the table; `elsewhere` gives the paths of what other tables hold, by Python's names.
    """
    try:
        yield
    except ScenarioError as error:
        name = error.field.rpartition(".")[2]
        keys = [f"{path}.{key}" for key, python in part.python_names().items() if name in (key, python)]
        field = elsewhere.get(name) or (keys[0] if keys else path)
        rule = error.rule.replace("H p <= b", "normals p <= offsets_m")
        raise ScenarioError(field, error.given, rule, error.where) from error


def check_length(field: str, vector: Sequence[Any], count: int) -> None:
    """Refuse a list of another length."""
    if len(vector) != count:
        raise ScenarioError(field, list(vector), f"must have {counted(count, 'number')}, has {len(vector)}")


def whole_parts(total: float, part: float) -> int | None:
    """Return how many times `part` goes into `total`; None if not a whole number of times."""
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


def _with_kind(value: Any) -> Any:
    """Let a table without a kind be refused as one with a wrong kind is: with the kinds there are."""
    return {"kind": "", **value} if isinstance(value, Mapping) else value


BY_KIND = (Field(discriminator="kind"), BeforeValidator(_with_kind))


class Described(ScenarioPart):
    """Base of tables that a class describes: their fields are those of the class that have a `Key`.

    ``class Ball(Described, makes=BallObstacle, kind="ball", says="Ball.")`` is the table of `BallObstacle`,
    which `kind` chooses, a word that stands for what it `says`. Its docstring and the meaning of its fields
    are taken from the docstrings of the class and of its bases.
    """

    MAKES: ClassVar[Any]

    def __init_subclass__(cls, makes: Any = None, kind: str = "", says: str = "", **options: Any) -> None:
        super().__init_subclass__(**options)
        if makes is None:
            return
        meanings = dict[str, str]()
        for each in makes.__mro__[::-1]:
            text = cleandoc(each.__doc__ or "").replace("H p <= b", "normals p <= offsets_m")
            summary, _, parameters = text.partition("\n\nParameters\n----------\n")
            parts = re.findall(r"^(\w+) : .*\n((?:    .*\n?)+)", parameters.partition("\n\n")[0], re.M)
            meanings |= {field: " ".join(description.split()) for field, description in parts}
        defaults = {field.name: field.default for field in fields(makes)}
        model: dict[str, Any] = {"kind": (Literal[kind], unit("-", says))} if kind else {}
        for field, key in f.keys_of(makes).items():
            default: Any = ... if key.required or defaults[field] is MISSING else defaults[field]
            if key.name.endswith("_deg") and default is not ...:
                default = round(math.degrees(default), 9)
            kinds = key.type | None if default is None else key.type
            model[key.name] = kinds, unit(key.unit, meanings.get(field), default=default)
        cls.MAKES, cls.__doc__ = makes, summary
        for name, (kinds, value) in model.items():  # as if they stood in the body of the class
            cls.__annotations__[name] = kinds
            setattr(cls, name, value)

    if TYPE_CHECKING:

        def __getattr__(self, name: str) -> Any: ...

    @classmethod
    def python_names(cls) -> dict[str, str]:
        """Return the Python names of the class's keys."""
        return {key.name: name for name, key in f.keys_of(cls.MAKES).items()}

    def make(self, path: str, **values: Any) -> Any:
        """Return the object that the table at a path describes; `values` are the file's other values."""
        with in_file_terms(path, self):
            return self.MAKES(**self.arguments(), **values)


def per_axis(field: str, value: float | tuple[float, ...], count: int) -> Array:
    """Numbers of all axes or inputs, shape (count,), from one for all or one each."""
    if isinstance(value, tuple):
        check_length(field, value, count)
    return np.broadcast_to(np.asarray(value, dtype=float), (count,)).copy()


class Head(ScenarioPart):
    """Head of every scenario file."""

    schema_version: f.VersionOne = unit("-", "Schema version.")
    name: f.Name = unit("-", "Name, also of the run folder.")
    title: f.Text = unit("-", "One line for figures and tables.", min_length=1, max_length=200)
    description: f.Text = unit("-", "Description.", default="", max_length=5000)
