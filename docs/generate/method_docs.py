"""Write the tables of run-time methods and of their options in ``docs/comparison.md`` from the registry.

Run ``python -m docs.generate.method_docs`` after a change to a method; a test compares the page.
"""

from __future__ import annotations

import re
from pathlib import Path

from polaris.rta.methods import METHODS

PAGE = Path(__file__).parents[1] / "comparison.md"


def put(text: str, name: str, table: str) -> str:
    """The page with one generated part replaced."""
    pattern = rf"(<!-- table {name} -->\n\n).*?(\n\n<!-- end -->)"
    page, count = re.subn(pattern, lambda match: match[1] + table + match[2], text, flags=re.S)
    if count != 1:
        raise SystemExit(f"{PAGE}: no place for the table {name}")
    return page


def tables() -> dict[str, str]:
    """Both tables, by the name of their place."""
    methods = ["| Key | Method | How it decides | Proven |", "|---|---|---|---|"]
    options: dict[tuple[str, str], list[str]] = {}  # keys by meaning and default
    for key, one in METHODS.items():
        proven = "yes" if one.proven else "no"
        methods.append(f"| `{key}` | {one.name} | {one.how} | {proven} |")
        for option in one.options:
            options.setdefault((option.meaning, option.default), []).append(f"`{key}.{option.name}`")
    tuning = ["| Options | Meaning | Default |", "|---|---|---|"]
    for (meaning, default), keys in options.items():
        tuning.append(f"| {', '.join(keys)} | {meaning} | {default} |")
    return {"methods": "\n".join(methods), "tuning": "\n".join(tuning)}


def main() -> None:
    """Rewrite the page if a table changed."""
    before = text = PAGE.read_text(encoding="utf-8")
    for name, table in tables().items():
        text = put(text, name, table)
    if text != before:
        PAGE.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
