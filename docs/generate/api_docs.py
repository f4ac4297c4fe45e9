"""Write the pages of the Python interfaces, ``docs/*api.md``, from the docstrings of the public names.

Run ``python -m docs.generate.api_docs`` after a change to a public name; a test compares the files.
"""

from __future__ import annotations

import dataclasses
import functools
import inspect
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import polaris
import polaris.inspection
import reach

from .api_groups import ASIF_GROUPS, ASIF_INTRODUCTION, GROUPS, INTRODUCTION, REACH_GROUPS, REACH_INTRODUCTION

_INTERNAL = ("path",)
"""Arguments that only say what messages call a thing."""

_SECTIONS = ("Parameters", "Attributes", "Returns", "Raises", "Notes")


@dataclasses.dataclass(frozen=True)
class Page:
    """One page: the file, the package, what stands first, and its names in groups."""

    file: str
    package: ModuleType
    introduction: str
    groups: dict[str, tuple[str, ...]]

    def text(self) -> str:
        """The page as Markdown."""
        lines = [self.introduction]
        for group, names in self.groups.items():
            things = [getattr(self.package, name) for name in names]
            lines += [f"## {group}", "", "| | |", "|---|---|"]
            for name, thing in zip(names, things, strict=True):
                lines.append(f"| [`{name}`](#{name.lower()}) | {_cell(_summary(thing))} |")
            lines.append("")
            for name, thing in zip(names, things, strict=True):
                lines += [*_entry(name, thing), ""]
        return "\n".join(lines).rstrip() + "\n"


PAGES = (
    Page("api.md", polaris, INTRODUCTION, GROUPS),
    Page("reach-api.md", reach, REACH_INTRODUCTION, REACH_GROUPS),
    Page("asif-api.md", polaris.inspection, ASIF_INTRODUCTION, ASIF_GROUPS),
)


def _summary(thing: Any) -> str:
    return _code(_doc(thing).split("\n\n", 1)[0])


def _doc(thing: Any) -> str:
    return inspect.getdoc(thing) or ""


def _code(text: str) -> str:
    """Docstring markup as Markdown, on one line."""
    text = " ".join(text.split())
    return re.sub(r"(?<!`)``(?!`)(.+?)``", r"`\1`", text)


def _cell(text: str) -> str:
    return text.replace("|", "\\|")


def _entry(name: str, thing: Any) -> list[str]:
    """One name: signature, description, tables of parameters and members."""
    text, sections = _sections(_doc(thing))
    lines = [f"### {name}", "", "```python", _signature(name, thing), "```", ""]
    lines += [line for paragraph in text.split("\n\n") for line in (_code(paragraph), "")]
    for title in ("Parameters", "Attributes"):
        if title in sections:
            lines += [f"| {title[:-1]} | Type | Meaning |", "|---|---|---|"]
            rows = [item for item in _items(sections[title]) if item[0] not in _INTERNAL or item[1] == "Path"]
            lines += [f"| {_names(n)} | {_cell(_code(t))} | {_cell(_code(m))} |" for n, t, m in rows]
            lines.append("")
    if "Returns" in sections:
        lines += [f"Returns: {_prose(sections['Returns'])}", ""]
    if "Raises" in sections:
        lines += ["| Raises | When |", "|---|---|"]
        for kind, _, meaning in _items(sections["Raises"]):
            lines.append(f"| {_names(kind)} | {_cell(_code(meaning))} |")
        lines.append("")
    if "Notes" in sections:
        lines += [_code(paragraph) for paragraph in sections["Notes"].split("\n\n")] + [""]
    members = list(_members(thing))
    if members:
        lines += ["| Member | Meaning |", "|---|---|"]
        lines += [f"| `{label}` | {_cell(meaning)} |" for label, meaning in members]
    return lines[:-1] if lines[-1] == "" else lines


def _names(text: str) -> str:
    return ", ".join(f"`{name.strip()}`" for name in text.split(","))


def _prose(block: str) -> str:
    """A Returns section in one line."""
    parts = [f"`{kind}`" + (f", {_code(meaning)}" if meaning else "") for kind, _, meaning in _items(block)]
    return "; ".join(parts).rstrip(".") + "."


def _sections(doc: str) -> tuple[str, dict[str, str]]:
    """Description, and the text of every section of a NumPy docstring."""
    found = re.split(rf"(?m)^({'|'.join(_SECTIONS)})\n-+\n", doc)
    return found[0].strip(), {
        title: body.strip("\n") for title, body in zip(found[1::2], found[2::2], strict=True)
    }


def _items(block: str) -> Iterator[tuple[str, str, str]]:
    """Name, type and meaning of every entry of a section."""
    for entry in re.split(r"\n(?=\S)", block):
        head, _, body = entry.partition("\n")
        name, _, kind = head.partition(" : ")
        yield name.strip(), kind.strip(), inspect.cleandoc(body)


def _signature(name: str, thing: Any) -> str:
    """Names and defaults, without the annotations; the tables give the types."""
    if isinstance(thing, type) and getattr(thing, "_is_protocol", False):
        return f"class {name}(Protocol)"
    if isinstance(thing, type) and issubclass(thing, Exception) and "__init__" not in vars(thing):
        return f"class {name}({thing.__bases__[0].__name__})"
    parameters, keyword_only = [], False
    for key, parameter in inspect.signature(thing).parameters.items():
        if key.startswith("_") or key in _INTERNAL:
            continue
        if parameter.kind is parameter.KEYWORD_ONLY and not keyword_only:
            parameters.append("*")
            keyword_only = True
        prefix = "**" if parameter.kind is parameter.VAR_KEYWORD else ""
        default = "" if parameter.default is parameter.empty else f"={_default(parameter.default)}"
        parameters.append(f"{prefix}{key}{default}")
    return f"{name}({', '.join(parameters)})"


def _default(value: Any) -> str:
    return "..." if repr(value).startswith("<") else repr(value)


def _members(thing: Any) -> Iterator[tuple[str, str]]:
    """Public methods and properties with the first sentence of their docstrings; fields are in the tables."""
    if not isinstance(thing, type) or issubclass(thing, Exception):
        return
    fields = {field.name for field in dataclasses.fields(thing)} if dataclasses.is_dataclass(thing) else set()
    for key, member in vars(thing).items():
        if key.startswith("_") or key in fields:
            continue
        if isinstance(member, property | functools.cached_property):
            yield key, _summary(member)
        elif isinstance(member, classmethod | staticmethod):
            yield f"{thing.__name__}.{_signature(key, getattr(thing, key))}", _summary(member.__func__)
        elif inspect.isfunction(member):
            yield _signature(key, member).replace("(self, ", "(").replace("(self)", "()"), _summary(member)


def write(folder: Path) -> list[Path]:
    """Write the pages into a folder; returns their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    for page in PAGES:
        (folder / page.file).write_text(page.text(), encoding="utf-8", newline="\n")
    return [folder / page.file for page in PAGES]


def main() -> None:
    """Write into ``docs`` beside the package, or into the folder given as an argument."""
    folder = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parents[1]
    print(*write(folder), sep="\n")


if __name__ == "__main__":
    main()
