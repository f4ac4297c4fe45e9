"""Write the scenario formats' JSON Schemas, and the lists of their reference page, from the models.

The page is committed, and a test compares it with the models; the schemas are made when pages are built.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterator
from functools import reduce
from operator import or_
from pathlib import Path
from textwrap import wrap
from typing import Any

from pydantic import TypeAdapter

from polaris.model.checks import exact
from polaris.scenario.scenario import KINDS, InspectionScenario
from polaris.scenario.tables.orbit import OrbitSource, StartSource
from polaris.scenario.tables.schedule import ScenarioModel

INSPECTIONS = {name: kind.MODEL for name, kind in KINDS.items() if issubclass(kind, InspectionScenario)}
"""Model of each kind of scenario of the inspection problem."""

SCHEMA_FILE = "scenario.schema.json"
INSPECTION_FILE = "inspection.schema.json"
REFERENCE_FILE = "scenario-reference.md"

WIDTH = 100  # columns of a line of Markdown
LARGE = 360  # from which on a bound of a number is a sanity check, which its message explains
OF_STATES = {"m, m/s", "SI"}  # units that the text of the page tells for all
MOST_WORDS = 5  # words of a list that are enumerated; the description of longer ones says where they are
DOCS = Path(__file__).resolve().parents[1]


def schema() -> dict[str, Any]:
    """JSON Schema of the scenario format; every field carries its unit under ``unit``."""
    tables: dict[str, Any] = _tidy(ScenarioModel.model_json_schema())
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **tables, "title": "Polaris scenario"}


def file_schema() -> dict[str, Any]:
    """JSON Schema of a file, whose orbit and start set may follow from sources that it names."""
    root, sources = schema(), _tidy(TypeAdapter(OrbitSource | StartSource).json_schema()["$defs"])
    tables = root["$defs"]
    orbit, start = tables["Orbit"], sources["StartSource"]
    orbit["properties"] |= sources["OrbitSource"]["properties"]
    orbit["required"] = [
        key for key in orbit["required"] if not key.endswith(("deviation_max_m", "_m_s", "deviation_max"))
    ]
    tables["ClohessyWiltshire"]["required"].remove("mean_motion_rad_s")
    tables["StartSource"] = start
    root["properties"]["initial_set"]["oneOf"].append({"$ref": "#/$defs/StartSource"})
    return root


def inspection_schema() -> dict[str, Any]:
    """JSON Schema of the scenarios of the inspection problem, one model for each kind."""
    tables: dict[str, Any] = _tidy(TypeAdapter(reduce(or_, INSPECTIONS.values())).json_schema())
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "oneOf": tables["anyOf"],
        "$defs": tables["$defs"],
        "title": "Polaris inspection scenario",
    }


def _tidy(node: Any) -> Any:
    """Drop the titles that only repeat the keys, and OpenAPI's ``discriminator``."""
    if isinstance(node, list):
        return [_tidy(entry) for entry in node]
    if not isinstance(node, dict):
        return node
    tidied = {}
    for key, value in node.items():
        if key in ("properties", "$defs"):
            tidied[key] = {name: _tidy(entry) for name, entry in value.items()}
        elif key == "description" and "unit" in node:  # of a field: one line, however it is broken there
            tidied[key] = " ".join(value.split())
        elif key not in ("title", "discriminator"):
            tidied[key] = _tidy(value)
    return tidied


# -- the reference page -----------------------------------------------------------------------------


def reference_text() -> str:
    """The reference page: the committed text with both of its generated parts made anew."""
    text = (DOCS / REFERENCE_FILE).read_text(encoding="utf-8")
    for part, lines in (("schedule", _schedule_lines()), ("inspection", _inspection_lines())):
        pattern = rf"(<!-- {part}: .+? -->\n\n).*?(\n\n<!-- end -->)"
        section = "\n".join(lines).strip("\n")
        text = re.sub(pattern, lambda match, section=section: match[1] + section + match[2], text, flags=re.S)
    return text


def _schedule_lines() -> Iterator[str]:
    """Yield the top level, then every table with its keys."""
    root = schema()
    tables = root["$defs"]
    homes = _homes(root)
    yield from ("## Top level", "", *_top(root, tables))
    described = False  # what a controller follows is described once
    for key, node in root["properties"].items():
        members = list(_members(node, tables))
        if not members:
            continue
        heading = _heading(key, node)
        rows: dict[str, str] = {}
        inner_tables: dict[str, Any] = {}
        if len(members) == 1:
            fields = members[0]["properties"]
            inner_tables = {name: inner for name, inner in fields.items() if any(_members(inner, tables))}
            plain = {name: inner for name, inner in fields.items() if name not in inner_tables}
            members = [{**members[0], "properties": plain}]
        yield from ("", f"## `{heading}`")
        yield from _choices(node, members, tables, "" if key == "recoverable" else "###", heading, rows)
        for name, inner in inner_tables.items():
            if parts := list(_members(inner, tables)):
                title = _heading(f"{key}.{name}", inner)
                yield from ("", f"### `{title}`")
                local = [part for part in parts if json.dumps(part, sort_keys=True) not in homes]
                if local != parts:
                    yield from ("", inner["description"])
                yield from _choices(inner if local == parts else {}, local, tables, "####", title, rows)
                elsewhere: dict[str, list[str]] = {}
                for part in parts:
                    if part not in local:
                        elsewhere.setdefault(homes[json.dumps(part, sort_keys=True)], []).append(_kinds(part))
                for place, kinds in elsewhere.items():
                    yield from ("", *_wrapped(f"{', '.join(kinds)}: as in `{place}`."))
        for member in members:
            reference = member["properties"].get("reference")
            if reference and not described:
                described = True
                yield from ("", "#### `reference` of a controller")
                yield from _choices({}, list(_members(reference, tables)), tables, "#####", "reference")


def _homes(root: dict[str, Any]) -> dict[str, str]:
    """Return the headings of tables at the top level of schedules' scenarios, by their contents."""
    return {
        json.dumps(member, sort_keys=True): _heading(key, node)
        for key, node in root["properties"].items()
        for member in _members(node, root["$defs"])
    }


def _inspection_lines() -> Iterator[str]:
    """Yield the top level of each kind, then every table once."""
    tables, homes = inspection_schema()["$defs"], _homes(schema())
    written = set[str]()
    tops: dict[str, str] = {}
    for kind, model in INSPECTIONS.items():
        root = tables[model.__name__]
        yield from ("", f'## `kind="{kind}"`', "", root["description"], "")
        yield from _top(root, tables, f'`kind="{kind}"`', tops)
        earlier: dict[str, list[str]] = {}
        parts: list[str] = []
        for key, node in root["properties"].items():
            members = list(_members(node, tables))
            names = key + json.dumps(members, sort_keys=True)
            if not members:
                continue
            heading = _heading(key, node)
            if names in written:
                earlier.setdefault("above", []).append(f"`{heading}`")
                continue
            if len(members) == 1 and (place := homes.get(json.dumps(members[0], sort_keys=True))):
                assert place == heading
                earlier.setdefault("for schedules", []).append(f"`{heading}`")
                continue
            written.add(names)
            parts += ["", f"### `{heading}`"]
            parts += _choices(node, members, tables, "#####", heading)
            if key == "strengthening":
                parts += ["", "#### Function of one kind of constraint"]
                parts += _choices({}, [tables["Alpha"]], tables, "", heading)
        if earlier:
            text = "; ".join(f"{', '.join(headings)}: as {place}" for place, headings in earlier.items())
            yield from ("", *_wrapped(f"{text}."))
        yield from parts


def _heading(key: str, node: dict[str, Any]) -> str:
    return f"[[{key}]]" if node.get("type") == "array" else f"[{key}]"


def _kinds(member: dict[str, Any]) -> str:
    """Return the lines of TOML that choose a table, or nothing."""
    kind = member["properties"].get("kind")
    return " or ".join(f'`kind="{word}"`' for word in _words(kind)) if kind else ""


def _top(
    root: dict[str, Any], tables: dict[str, Any], place: str = "", rows: dict[str, str] | None = None
) -> Iterator[str]:
    """Yield the keys of a file's top level, then the names of its tables."""
    nested = {key: node for key, node in root["properties"].items() if any(_members(node, tables))}
    plain = {key: node for key, node in root["properties"].items() if key not in nested}
    yield from _fields({**root, "properties": plain}, tables, place, rows)
    required = [f"`{_heading(key, node)}`" for key, node in nested.items() if key in root["required"]]
    if required:
        text = f"Required {'table' if len(required) == 1 else 'tables'}: {', '.join(required)}."
        yield from ("", *_wrapped(f"{text} The others are optional."))


def _choices(
    node: dict[str, Any],
    members: list[dict[str, Any]],
    tables: dict[str, Any],
    level: str,
    heading: str,
    rows: dict[str, str] | None = None,
) -> Iterator[str]:
    """Yield every table that a field may hold: its kind (none without a level), its meaning, its fields.

    Fields that all of several tables share come first.
    """
    rows = {} if rows is None else rows
    if len(members) > 1 and node and not _named(heading, node["description"]):
        yield from ("", *_wrapped(node["description"]))
    first, *others = members
    shared = {
        key: entry
        for key, entry in first["properties"].items()
        if others and key != "kind" and all(_row(m, key, tables) == _row(first, key, tables) for m in others)
    }
    if shared:
        yield from ("", *_fields({**first, "properties": shared}, tables))
    for member in members:
        kinds = _kinds(member) if level else ""
        if kinds:
            yield from ("", f"{level} {kinds}")
        for paragraph in member["description"].split("\n\n"):
            yield from ("", *_wrapped(" ".join(paragraph.split())))
        unique = {key: entry for key, entry in member["properties"].items() if key not in shared}
        if fields := list(_fields({**member, "properties": unique}, tables, kinds or f"`{heading}`", rows)):
            yield from ("", *fields)


def _members(node: dict[str, Any], tables: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Table classes a field may hold."""
    if "$ref" in node:
        yield tables[node["$ref"].rpartition("/")[2]]
    for key in ("oneOf", "anyOf"):
        for choice in node.get(key, ()):
            yield from _members(choice, tables)
    if node.get("type") == "array" and isinstance(node.get("items"), dict):
        yield from _members(node["items"], tables)


def _fields(
    table: dict[str, Any], tables: dict[str, Any], place: str = "", rows: dict[str, str] | None = None
) -> Iterator[str]:
    """Yield items for the fields but a `kind` in the heading, and the places of those in `rows` already.

    Fields in sequence with equal values and descriptions share an item.
    """
    rows = {} if rows is None else rows
    items: list[tuple[list[str], str | None]] = []
    elsewhere: dict[str, list[str]] = {}
    for key, node in table["properties"].items():
        if key == "kind" and place and len(_words(node)) == 1:
            continue
        row = _row(table, key, tables)
        if rows.setdefault(f"{key}{row}", place) != place:
            elsewhere.setdefault(rows[f"{key}{row}"], []).append(f"`{key}`")
        elif items and items[-1][1] == row:
            items[-1][0].append(f"`{key}`")
        else:
            items.append(([f"`{key}`"], row))
    for keys, row in items:
        yield from _wrapped(f"- {', '.join(keys)}{row}", "  ")
    if items and elsewhere:
        yield ""
    if elsewhere:
        yield from _wrapped(
            "; ".join(f"{', '.join(keys)}: as in {at}" for at, keys in elsewhere.items()) + "."
        )


def _row(table: dict[str, Any], key: str, tables: dict[str, Any]) -> str | None:
    """Return the value of a field and its description, unless the key says that; None if there is none."""
    node = table["properties"].get(key)
    if node is None:
        return None
    status = "required" if key in table.get("required", ()) else _default(node)
    text = node["description"]
    words = _words(node)
    kinds = "" if words and all(f"`{word}`" in text for word in words) else _value(node, tables)
    if node.get("type") == "boolean" or kinds == "number":
        kinds = ""
    if not key.endswith(_ending(node["unit"])) and node["unit"] not in OF_STATES:
        kinds += f" [{node['unit']}]"
    value = ", ".join(filter(None, (kinds.strip(), status)))
    return (f" ({value})" if value else "") + ("" if _named(key, text) else f": {text}")


def _named(key: str, text: str) -> bool:
    """Return True if a description says no more than its key."""
    return set(re.findall(r"\w+", text.lower())) <= {*re.findall("[a-z0-9]+", key.lower()), "of", "the"}


def _ending(unit: str) -> str:
    """Return the end of a key that says a unit."""
    if unit == "-":
        return ""
    return "_" + re.sub("[ /]", "_", unit.replace("^", ""))


def _wrapped(text: str, indent: str = "") -> list[str]:
    """Return the lines of a paragraph, or of an item with its `indent`."""
    return wrap(text, WIDTH, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)


def _default(node: dict[str, Any]) -> str:
    """Return the default of a field that may be left out, or nothing if the description says it."""
    default = node.get("default")
    number = isinstance(default, int | float) and not isinstance(default, bool)
    text = exact(default) if number else f"`{json.dumps(default)}`"
    return "" if default in (None, "", []) else f"default {text}"


def _words(node: dict[str, Any]) -> list[str]:
    return [str(node["const"])] if "const" in node else [str(word) for word in node.get("enum", ())]


def _value(node: dict[str, Any], tables: dict[str, Any]) -> str:
    """Return the values that may be written, in words."""
    if _words(node):
        return ", ".join(f"`{word}`" for word in _words(node))
    if any(_members(node, tables)):
        return "list of tables" if node.get("type") == "array" else "table"
    choices = [choice for choice in node.get("oneOf", node.get("anyOf", ())) if choice.get("type") != "null"]
    values = [_value(choice, tables) for choice in choices]
    if len(values) == 2 and values[1] == f"list {values[0]}".replace(" number", ""):
        return f"{values[0]} or list"
    if values:
        return " or ".join(values)
    match node.get("type"):
        case "array":
            inner = _value(node["items"], tables)
            if len(_words(node["items"])) > MOST_WORDS:
                return "list of text"
            if inner.startswith("list"):
                return "matrix"
            return f"list {inner}".replace(" number", "") if inner != "text" else "list of text"
        case "number" | "integer":
            return _range(node) or "number"
        case "boolean":
            return "true or false"
        case _:
            return "text"


def _range(node: dict[str, Any]) -> str:
    """Return the bounds of a number, without those that its meaning or an error message tells well enough."""
    words = {"exclusiveMinimum": ">", "minimum": "≥", "exclusiveMaximum": "<", "maximum": "≤"}
    limits = [(key, sign) for key, sign in words.items() if key in node]
    bounds = [f"{sign}{exact(node[key])}" for key, sign in limits if 1e-2 < node[key] < LARGE]
    return ", ".join(bound for bound in bounds if bound != "≥1")


def texts() -> dict[str, str]:
    """Return the contents of the files, by their names."""
    schemas = {SCHEMA_FILE: file_schema(), INSPECTION_FILE: inspection_schema()}
    written = {name: json.dumps(node, indent=2, ensure_ascii=False) + "\n" for name, node in schemas.items()}
    return {**written, REFERENCE_FILE: reference_text()}


def write(folder: Path) -> list[Path]:
    """Write the files that changed into a folder; return the paths of all."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in texts().items():
        path = folder / name
        if not path.is_file() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8", newline="\n")
    return [folder / name for name in texts()]


if __name__ == "__main__":
    target = Path(sys.argv[1]) if len(sys.argv) > 1 else DOCS
    for written in write(target):
        print(written)
