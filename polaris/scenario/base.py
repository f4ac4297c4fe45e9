"""Base of scenarios of every kind: data, overrides, and objects that are built once and kept."""

import copy
import json
import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import Any, ClassVar, Self, TypeVar

from reach.short_repr import short_repr

from ..model.errors import ScenarioError
from ..model.files import parse_toml
from ..model.keys import printable
from .reading import NOTHING, did_you_mean, join_path, validate, write_toml
from .tables.fields import ScenarioPart

KINDS: dict[str, type["Scenario"]] = {}
"""Class of every kind, by the key ``kind`` at the top of the file; `polaris.scenario.scenario` fills it."""

_KEY = re.compile(r"[A-Za-z0-9_-]+(\[\d{1,4}\])*(\.[A-Za-z0-9_-]+(\[\d{1,4}\])*)*")

SCHEDULE = "schedule"  # kind of a file without the key ``kind``

Owner = TypeVar("Owner")
Built = TypeVar("Built")


def cached(build: Callable[[Owner], Built]) -> Callable[[Owner], Built]:
    """Make a method without arguments keep its result: values that rules asked for are built once."""
    name = f"_kept_{build.__name__}"

    @wraps(build)
    def method(self: Owner) -> Built:
        if name not in vars(self):
            vars(self)[name] = build(self)
        built: Built = vars(self)[name]
        return built

    return method


@short_repr
@dataclass(frozen=True, eq=False)
class Scenario(ABC):
    """A validated scenario; subclasses, one for each kind, build the described objects.

    Parameters
    ----------
    model : ScenarioPart
        The fields as in the file.
    source : str or None
        Where it came from, for messages.
    text : str or None
        The file's text, comments included; None once a value has been overridden.
    overrides : tuple of str
        Texts ``key=value`` that changed it, which are noted in copies of it.
    folder : Path or None
        Where other files that it names lie; the current folder without it.
    derived : tuple of str
        A line on each thing that followed from files or elements, which are noted in copies of it.

    Raises
    ------
    ScenarioError
        If a rule that joins several fields is broken.
    """

    model: Any
    source: str | None = None
    text: str | None = None
    overrides: tuple[str, ...] = ()
    folder: Path | None = None
    derived: tuple[str, ...] = ()

    MODEL: ClassVar[type[ScenarioPart]]

    def __post_init__(self) -> None:
        try:
            self._check()
        except ScenarioError as error:
            value = NOTHING if error.given is None else error.given
            raise ScenarioError(error.field, value, error.rule, error.where or self.source) from error

    @abstractmethod
    def _check(self) -> None:
        """Check the rules that join several fields; raises `ScenarioError` at the first that is broken."""

    @classmethod
    def from_dict(cls, document: Mapping[str, Any], source: str | None = None, **known: Any) -> Self:
        """Validate nested data shaped like the TOML file; its key ``kind`` says of which class.

        What else is `known` of it, its `text`, `overrides` or `folder`, is kept.

        Raises
        ------
        ScenarioError
            If it is not valid, or of another kind than the class it is asked of.
        """
        kind = document.get("kind", SCHEDULE)
        scenario_class = KINDS.get(kind) if isinstance(kind, str) else None
        if scenario_class is None or document.get("kind") == SCHEDULE:
            names = [name for name in KINDS if name != SCHEDULE]
            rule = f"must be one of {', '.join(map(repr, names))}, or left out for a schedule"
            rule += did_you_mean(kind, names, 0.5)
            raise ScenarioError("kind", kind, rule, source)
        if not issubclass(scenario_class, cls):
            allowed = [name for name, known in KINDS.items() if issubclass(known, cls)]
            rule = f"must be a scenario of the kind {' or '.join(map(repr, allowed))} here"
            raise ScenarioError("kind", kind, rule, source)
        full, derived = scenario_class.with_sources(document, known.get("folder"), source)
        if derived:
            known |= {"text": None, "derived": (*known.get("derived", ()), *derived)}
        return scenario_class(validate(scenario_class.MODEL, full, source), source, **known)

    @classmethod
    def with_sources(
        cls, document: Mapping[str, Any], folder: Path | None, source: str | None
    ) -> tuple[Mapping[str, Any], tuple[str, ...]]:
        """Return a document with numbers in place of their sources, and a line on each."""
        return document, ()

    def set(self, key: str, value: Any) -> Self:
        """Return a copy with one value replaced.

        Parameters
        ----------
        key : str
            Where, as in ``planner.solver`` or ``obstacles[0].radius_m``. A whole table may be given
            too: ``scenario.set("goal", {"kind": "box", ...})``. None removes an optional value.
        value : object
            The new value.

        Raises
        ------
        ScenarioError
            If there is no such key or the result is not a valid scenario.
        """
        return self.with_overrides({key: value})

    def with_overrides(self, values: Mapping[str, Any]) -> Self:
        """Return a copy with several values replaced together, as in `set`; checked once, at the end."""
        return self._changed(values, ()) if values else self

    def with_assignments(self, assignments: Iterable[str]) -> Self:
        """Return a copy changed by texts ``key=value`` as given to ``--set``, which it notes.

        The value is read as TOML (``0.5``, ``[1, 2]``, ``true``, ``{ kind = "ball" }``); what is not
        TOML is taken for text, so ``planner.solver=gurobi`` needs no quotes.
        """
        texts = list(assignments)
        values = dict(map(parse_assignment, texts))
        return self._changed(values, (*self.overrides, *texts)) if texts else self

    def _changed(self, values: Mapping[str, Any], overrides: tuple[str, ...]) -> Self:
        changed = overridden(self.to_dict(), values, self.source)
        attributes = {"overrides": overrides, "folder": self.folder, "derived": self.derived}
        return self.from_dict(changed, self.source, **attributes)

    @property
    def name(self) -> str:
        """Short name."""
        return str(self.model.name)

    @property
    def title(self) -> str:
        """One line for figures and tables."""
        return str(self.model.title)

    @property
    def kind(self) -> str:
        """Return the key ``kind`` at the top of the file, ``schedule`` without it."""
        return str(getattr(self.model, "kind", SCHEDULE))

    @abstractmethod
    def outline(self) -> str:
        """Describe the scenario on one line."""

    def to_dict(self) -> dict[str, Any]:
        """All values, defaults included, as nested plain data."""
        data: dict[str, Any] = json.loads(json.dumps(self.model.model_dump(exclude_none=True)))  # no tuples
        return data

    def to_toml(self) -> str:
        """All values, defaults included, as TOML that loads back to the same scenario."""
        return write_toml(self.to_dict())

    def files(self) -> list[Path]:
        """Files besides its own that it names; a run folder holds copies."""
        return []

    def text_elsewhere(self) -> str:
        """TOML that loads to the same scenario from any folder."""
        return self.to_toml()

    def _copied(self) -> str:
        """Text of a copy beside copies of its `files`, but for notes."""
        return self.text if self.text is not None else self.to_toml()

    def copy_text(self) -> str:
        """Text of its copy in a run folder: its own, or all values under a note of the changes."""
        text = self._copied()
        for cause, lines in (("with these overrides", self.overrides), ("with what followed", self.derived)):
            if lines:
                notes = "".join(f"#   {' '.join(line.split())}\n" for line in lines)
                text = f"# Written {cause}, which the values below include:\n{notes}\n{text}"
        return text


def overridden(document: dict[str, Any], values: Mapping[str, Any], source: str | None) -> dict[str, Any]:
    """Return the document, with values replaced in it."""
    for key, value in values.items():
        set_key(document, key, copy.deepcopy(value), source)
    return document


def parse_assignment(text: str) -> tuple[str, Any]:
    """Key and value of a text ``key=value``; a value that is not TOML is taken for text."""
    key, equals, value = text.partition("=")
    if not equals or not key.strip():
        raise ScenarioError("--set", printable(text), "must be key=value")
    try:
        parsed = parse_toml(f"value = {value.strip()}")
    except ValueError:
        parsed = {}
    return key.strip(), parsed["value"] if set(parsed) == {"value"} else value.strip()


def _split(key: str) -> list[str | int]:
    """Parts of a dotted key; ``a[0].b`` and ``a.0.b`` mean the same."""
    if not _KEY.fullmatch(key):
        raise ScenarioError("--set", printable(key), "must name a key, as in planner.solver=highs")
    return [int(part) if part.isdigit() else part for part in re.findall(r"[\w-]+", key)]


def set_key(document: dict[str, Any], key: str, value: Any, source: str | None) -> None:
    """Replace (or, with None, remove) the value at a dotted key; tables are made as needed."""
    parts = _split(key)
    holder: Any = document
    for i, part in enumerate(parts):
        if not isinstance(holder, {str: dict, int: list}[type(part)]):
            kind = {"list": "a list", "dict": "a table"}.get(type(holder).__name__, "a value")
            rule = f"no such key: {join_path(parts[:i])} is {kind}"
            raise ScenarioError(join_path(parts), value, rule, source)
        if isinstance(holder, list) and part >= len(holder):
            rule = f"must be below {len(holder)}, the number of entries (counted from 0)"
            raise ScenarioError(join_path(parts[: i + 1]), NOTHING, rule, source)
        if i < len(parts) - 1:
            holder = holder.setdefault(part, {}) if isinstance(holder, dict) else holder[part]
        elif value is None and isinstance(holder, dict):
            holder.pop(part, None)
        else:
            holder[part] = value
