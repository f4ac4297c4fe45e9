"""Overriding single values of a scenario: ``--set key=value`` and `Scenario.set`."""

from __future__ import annotations

import re
import tomllib
from typing import Any

from ..model.errors import ScenarioError
from .reading import NOTHING, join_path, printable

_KEY_PART = re.compile(r"([A-Za-z0-9_-]+)((?:\[\d{1,4}\])*)")


def parse_assignment(text: str) -> tuple[str, Any]:
    """Key and value of a text ``key=value``; a value that is not TOML is taken for text."""
    key, equals, value = text.partition("=")
    if not equals or not key.strip():
        raise ScenarioError("--set", printable(text), "must be key=value")
    try:
        parsed = tomllib.loads(f"value = {value.strip()}")
    except (ValueError, RecursionError):
        parsed = {}
    return key.strip(), parsed["value"] if set(parsed) == {"value"} else value.strip()


def _split(key: str) -> list[str | int]:
    """Parts of a dotted key; ``a[0].b`` and ``a.0.b`` mean the same."""
    parts: list[str | int] = []
    for piece in key.split("."):
        match = _KEY_PART.fullmatch(piece)
        if not match:
            raise ScenarioError("--set", printable(key), "must name a key, as in planner.solver=highs")
        parts.append(int(match[1]) if match[1].isdigit() else match[1])
        parts += [int(index) for index in re.findall(r"\d+", match[2])]
    return parts


def put(document: dict[str, Any], key: str, value: Any, where: str | None) -> None:
    """Replace (or, with None, remove) the value at a dotted key; tables are made as needed."""
    parts = _split(key)
    holder: Any = document
    for i, part in enumerate(parts):
        last = i == len(parts) - 1
        if isinstance(holder, dict) and isinstance(part, str):
            if last:
                holder.pop(part, None) if value is None else holder.__setitem__(part, value)
                return
            holder = holder.setdefault(part, {})
        elif isinstance(holder, list) and isinstance(part, int):
            if part >= len(holder):
                rule = f"there are only {len(holder)} entries (counted from 0)"
                raise ScenarioError(join_path(parts[: i + 1]), NOTHING, rule, where)
            if last:
                holder[part] = value
                return
            holder = holder[part]
        else:
            kind = (
                "a list" if isinstance(holder, list) else "a table" if isinstance(holder, dict) else "a value"
            )
            rule = f"no such key: {join_path(parts[:i])} is {kind}"
            raise ScenarioError(join_path(parts), value, rule, where)
