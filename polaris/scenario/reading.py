"""From a file to a validated model: every way this can fail ends in one `ScenarioError`."""

import json
import re
from collections.abc import Iterable, Mapping, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Any, TypeVar

import tomli_w
from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from reach.numerics.files import read_regular

from ..model import files
from ..model.errors import ScenarioError
from ..model.keys import broken_rule, printable

MAX_BYTES = 1_000_000  # largest scenario file read; the largest sensible one is a hundred times smaller

Model = TypeVar("Model", bound=BaseModel)

_BARE_KEY = re.compile(r"[A-Za-z0-9_-]{1,60}")


def did_you_mean(word: object, words: Iterable[str], cutoff: float = 0.6) -> str:
    """Return a hint at the known word nearest to another, ``; did you mean x?``, or an empty string."""
    matches = get_close_matches(word, list(words), n=1, cutoff=cutoff) if isinstance(word, str) else []
    return f"; did you mean {matches[0]}?" if matches else ""


class _Nothing:
    """Stands for a value that was not given, and reads so in messages."""

    def __repr__(self) -> str:
        return "nothing"


NOTHING = _Nothing()


def join_path(path: Sequence[str | int]) -> str:
    """Write a location as it would be written in TOML and in ``--set``: ``obstacles[0].radius_m``."""
    text = ""
    for part in path:
        if isinstance(part, int):
            text += f"[{part}]"
        else:
            key = part if _BARE_KEY.fullmatch(part) else printable(json.dumps(part), 60)
            text += f".{key}" if text else key
    return text or "file"


def read_document(path: Path) -> tuple[dict[str, Any], str]:
    """Return data and text of a TOML file; `ScenarioError` if it is unreadable, too large or no TOML."""
    name = printable(str(path))
    try:
        data = read_regular(path, MAX_BYTES)
    except FileNotFoundError as error:
        raise ScenarioError("file", name, "there is no such file") from error
    except OSError as error:
        raise ScenarioError("file", name, f"cannot be read: {error.strerror}") from error
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise ScenarioError("file", name, f"must be UTF-8 text; byte {error.start} is not") from error
    if not text.strip():
        raise ScenarioError("file", name, "must not be empty")
    return parse_toml(text, name), text


def parse_toml(text: str, source: str) -> dict[str, Any]:
    """Parse TOML text, with one error for everything that is not TOML."""
    try:
        return files.parse_toml(text)
    except ValueError as error:  # TOMLDecodeError, and what int() and datetime() refuse
        raise ScenarioError("file", source, f"must be TOML: {printable(str(error))}") from error


def validate(model: type[Model], document: Mapping[str, Any], source: str | None = None) -> Model:
    """Validate the fields of a document one by one; `ScenarioError` names field, value and rule."""
    try:
        return model.model_validate(document)
    except ValidationError as error:
        problems = error.errors(include_url=False)
    except RecursionError:
        raise ScenarioError("file", NOTHING, "must have fewer nested brackets", source) from None
    located = [one for one in (_located(problem, document) for problem in problems) if one]
    # An unknown key explains a missing one (a slip of the pen), so it comes first.
    located.sort(key=lambda one: not one[2].startswith("unknown key"))
    path, value, rule = located[0]
    others = list(dict.fromkeys(other[0] for other in located[1:] if other[0] != path))
    if others:
        names = ", ".join(others[:3]) + (", ..." if len(others) > 3 else "")
        rule += f" (and {len(others)} more to correct: {names})"
    raise ScenarioError(path, _safe(value), rule, source) from None


def _safe(value: Any) -> Any:
    """Return something whose ``repr`` cannot fail (huge integers have none)."""
    try:
        repr(value)
    except (ValueError, RecursionError):
        return "a number of thousands of digits" if isinstance(value, int) else "(too large to show)"
    return value


def _located(problem: ErrorDetails, document: Mapping[str, Any]) -> tuple[str, Any, str] | None:
    """Location in the document (union tags dropped), the value there, and the rule; None if spurious."""
    kind, context = problem["type"], problem.get("ctx") or {}
    path: list[str | int] = []
    value: Any = document
    for part in problem["loc"]:
        present = (isinstance(value, Mapping) and part in value) or (
            isinstance(value, (list, tuple)) and isinstance(part, int) and part < len(value)
        )
        if present:
            value = value[part]
            path.append(part)
    if kind == "missing":
        return join_path([*path, problem["loc"][-1]]), NOTHING, "is required"
    if kind == "unknown_key":
        key, keys = context["key"], context["known"]
        hint = did_you_mean(key, keys, 0.5) or f"; known here: {', '.join(keys)}"
        return join_path([*path, key]), value[key], context["gone"] or f"unknown key{hint}"
    if kind == "union_tag_invalid":
        rule = f"must be one of {context['expected_tags']}"
        return join_path([*path, "kind"]), value.get("kind", NOTHING), rule
    if kind == "too_short" and len(value) >= context["min_length"]:
        return None  # pydantic counts valid entries only; the invalid one has its own message
    return join_path(path), value, broken_rule(problem, value)


write_toml = tomli_w.dumps  # values first, then its tables, then its lists of tables
