"""Write the scenario formats' JSON Schemas and their reference page from the models.

Run ``python -m docs.generate.scenario_docs`` after a change to the models; a test compares the files.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from functools import reduce
from operator import or_
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from polaris.scenario.scenario import KINDS, InspectionScenario
from polaris.scenario.tables import ScenarioModel

INSPECTIONS = {name: kind.MODEL for name, kind in KINDS.items() if issubclass(kind, InspectionScenario)}
"""Model of each kind of scenario of the inspection problem."""

SCHEMA_FILE = "scenario.schema.json"
INSPECTION_FILE = "inspection.schema.json"
REFERENCE_FILE = "scenario-reference.md"

_INTRODUCTION = """\
# Scenario reference

<!-- Generated from the models by `python -m docs.generate.scenario_docs`. Do not edit. -->

A scenario is one TOML file. Unknown keys are refused, numbers must be finite, and units stand in
the names of the fields or in the tables below. States are written in the order of the system's
state vector; in Hill's frame that is `[r_x, r_y, r_z, v_x, v_y, v_z]` (x radial, y along-track, z
cross-track) in m and m/s. A system has *n* states, *m* inputs and *d* position coordinates (6, 3
and 3 in Hill's frame).

`polaris check FILE` validates a file and does nothing else. `polaris run FILE --set
planner.solver=gurobi` replaces single values; lists count from 0, as in `--set
obstacles[0].radius_m=25`. Editors that know JSON Schema complete and check the file when its first
line is `#:schema ` followed by the path of [`scenario.schema.json`](scenario.schema.json).

The planner keeps 1 mm more clearance of every unsafe set than the proof needs, whatever the size of the
scene. Where the clearances themselves are of that size (a scene of millimetres, or kilometres given as
numbers near 1), it finds nothing: state such a scene in another unit, with `kind = "linear"`, so that its
clearances are numbers well above 0.001. Nothing else depends on the unit.

**The same from Python.** Classes take what the tables hold under the same names without the unit at
the end, in SI units: `center_m` is `center`, `thrust_accel_max_m_s2` is `thrust_accel_max`,
`min_dwell_steps` is `min_dwell`. Other names: `normals` and `offsets_m` are `H` and `b` ($Hp\\le
b$), `half_angle_deg` is `half_angle_rad`; `horizon.duration_s` and `step_s` become `K` and `delta`,
and `input_max`, `disturbance_max` of a system are `u_max`, `w_max`. Messages name the field of the
file, from Python too.
"""


_INSPECTION = """\
# Scenarios of the inspection problem

A file with a key `kind` at the top describes no switching schedule but deputies that inspect a chief
([inspection](inspection.md)). States are those of Hill's frame. `polaris check`, `--set` and the errors are
the same; the schema is [`inspection.schema.json`](inspection.schema.json). Defaults are the values of Table 1
of [[DVH23](references.md#dvh23)] where the paper prints one.
"""


def schema() -> dict[str, Any]:
    """JSON Schema of the scenario format; every field carries its unit under ``unit``."""
    found: dict[str, Any] = _tidy(ScenarioModel.model_json_schema())
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **found,
        "title": "Polaris scenario",
    }


def inspection_schema() -> dict[str, Any]:
    """JSON Schema of the scenarios of the inspection problem, one model for each kind."""
    found: dict[str, Any] = _tidy(TypeAdapter(reduce(or_, INSPECTIONS.values())).json_schema())
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "oneOf": found["anyOf"],
        "$defs": found["$defs"],
        "title": "Polaris inspection scenario",
    }


def _tidy(node: Any) -> Any:
    """Drop the titles that only repeat the keys, and OpenAPI's ``discriminator``."""
    if isinstance(node, list):
        return [_tidy(entry) for entry in node]
    if not isinstance(node, dict):
        return node
    kept = {}
    for key, value in node.items():
        if key in ("properties", "$defs"):
            kept[key] = {name: _tidy(entry) for name, entry in value.items()}
        elif key not in ("title", "discriminator"):
            kept[key] = _tidy(value)
    return kept


def schema_text() -> str:
    """The schema as it is written to the file."""
    return json.dumps(schema(), indent=2, ensure_ascii=False) + "\n"


def inspection_schema_text() -> str:
    """The schema of the inspection problem as it is written to the file."""
    return json.dumps(inspection_schema(), indent=2, ensure_ascii=False) + "\n"


# -- the reference page -----------------------------------------------------------------------------


def reference_text() -> str:
    """The reference page as Markdown."""
    whole = schema()
    tables = whole["$defs"]
    lines = [_INTRODUCTION, "## Top level", "", *_fields(whole, tables, whole["required"])]
    for key, node in whole["properties"].items():
        members = list(_members(node, tables))
        if not members:
            continue
        heading = f"[[{key}]]" if node.get("type") == "array" else f"[{key}]"
        lines += ["", f"## `{heading}`"]
        if len(members) > 1:
            lines += ["", node["description"]]
        for member in members:
            lines += _section(member, tables, heading)
            reference = member["properties"].get("reference")
            if reference:
                lines += ["", "#### `reference` of a controller"]
                for choice in _members(reference, tables):
                    lines += _section(choice, tables, "reference")
    return "\n".join([*lines, "", *_inspection_lines()]) + "\n"


def _inspection_lines() -> Iterator[str]:
    """The part on the inspection problem: top level by kind, then every table once."""
    tables = inspection_schema()["$defs"]
    yield _INSPECTION.rstrip("\n")
    seen: dict[str, str] = {}
    for kind, model in INSPECTIONS.items():
        whole = tables[model.__name__]
        yield from ("", f'## `kind = "{kind}"`', "", whole["description"], "")
        yield from _fields(whole, tables, whole["required"])
        for key, node in whole["properties"].items():
            members = list(_members(node, tables))
            heading = f"[[{key}]]" if node.get("type") == "array" else f"[{key}]"
            names = json.dumps(members, sort_keys=True)
            if not members:
                continue
            yield from ("", f"### `{heading}` of `{kind}`")
            if names in seen:
                yield from ("", f"As `{heading}` of `{seen[names]}`.")
                continue
            seen[names] = kind
            if len(members) > 1:
                yield from ("", node["description"])
            for member in members:
                yield from _section(member, tables, "reference")
            if key == "strengthening":
                yield from ("", "#### Function of one kind of constraint")
                yield from _section(tables["Alpha"], tables, heading)


def _section(member: dict[str, Any], tables: dict[str, Any], heading: str) -> Iterator[str]:
    """One table of the file: its kind, what it is, its fields."""
    kind = member["properties"].get("kind")
    if kind and heading != "[recoverable]":
        words = " or ".join(f'`kind = "{word}"`' for word in _words(kind))
        level = "#####" if heading == "reference" else "###"
        yield from ("", f"{level} {words}")
    yield from ("", member["description"], "")
    yield from _fields(member, tables, member.get("required", []))


def _members(node: dict[str, Any], tables: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """Table classes a field may hold."""
    if "$ref" in node:
        yield tables[node["$ref"].rpartition("/")[2]]
    for key in ("oneOf", "anyOf"):
        for choice in node.get(key, ()):
            yield from _members(choice, tables)
    if node.get("type") == "array" and isinstance(node.get("items"), dict):
        yield from _members(node["items"], tables)


def _fields(table: dict[str, Any], tables: dict[str, Any], required: list[str]) -> Iterator[str]:
    yield "| Field | Value | Unit | Default | Meaning |"
    yield "|---|---|---|---|---|"
    for key, node in table["properties"].items():
        shown = _default(node) if key not in required else "required"
        cells = (f"`{key}`", _value(node, tables), node["unit"], shown, node["description"])
        yield "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _default(node: dict[str, Any]) -> str:
    if "default" not in node or node["default"] is None:
        return "none" if "default" in node else "see below"
    default = node["default"]
    return "none" if default in ("", []) else f"`{json.dumps(default)}`"


def _words(node: dict[str, Any]) -> list[str]:
    return [str(node["const"])] if "const" in node else [str(word) for word in node.get("enum", ())]


def _value(node: dict[str, Any], tables: dict[str, Any]) -> str:
    """What may be written, in words."""
    if _words(node):
        return ", ".join(f"`{word}`" for word in _words(node))
    if any(_members(node, tables)):
        return "list of tables" if node.get("type") == "array" else "table"
    choices = [choice for choice in node.get("oneOf", node.get("anyOf", ())) if choice.get("type") != "null"]
    if choices:
        return " or ".join(_value(choice, tables) for choice in choices)
    match node.get("type"):
        case "array":
            inner = _value(node["items"], tables)
            if inner.startswith("list of "):
                return "rows of " + inner.removeprefix("list of ")
            return "list of " + inner.replace("number", "numbers", 1)
        case "number" | "integer":
            return ("whole number" if node["type"] == "integer" else "number") + _range(node)
        case "boolean":
            return "true or false"
        case _:
            return "text"


def _range(node: dict[str, Any]) -> str:
    """Bounds of a number; those every number has are left out."""
    words = {"exclusiveMinimum": ">", "minimum": ">=", "exclusiveMaximum": "<", "maximum": "<="}
    bounds = [f"{sign} {node[key]:g}" for key, sign in words.items() if key in node and abs(node[key]) < 1e12]
    return " " + ", ".join(bounds) if bounds else ""


def write(folder: Path) -> tuple[Path, Path, Path]:
    """Write all files into a folder; return their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = folder / SCHEMA_FILE, folder / INSPECTION_FILE, folder / REFERENCE_FILE
    texts = schema_text(), inspection_schema_text(), reference_text()
    for path, text in zip(paths, texts, strict=True):
        path.write_text(text, encoding="utf-8", newline="\n")
    return paths


if __name__ == "__main__":
    target = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parents[1]
    for written in write(target):
        print(written)
