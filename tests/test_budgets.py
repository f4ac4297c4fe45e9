"""Budgets of the packages as a ratchet: lines of code per room, and modules that define one public name.

A room may shrink, and its limit in the table is then lowered to what it has. Aims are no limits: no room has
reached its own yet, the kernel of the checker aside, which may grow up to its aim.
"""

import ast
from collections import Counter
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]

PACKAGES = ("polaris", "reach")

LINES = {
    # rooms: (limit, aim)
    ("reach",): (9243, 8400),
    ("polaris/certificate",): (12198, 4600),
    ("polaris/certificate/kernel",): (2000, 2000),
    ("polaris/synthesis",): (9459, 5000),
    ("polaris/model", "polaris/simulation"): (9544, 5200),
    ("polaris/rta",): (5015, 4300),
    ("polaris/inspection",): (5438, 4500),
    ("polaris/scenario", "polaris/runs"): (10008, 7500),
    ("polaris/report", "polaris/cli", "polaris/traces"): (8387, 6400),
    ("polaris/planning",): (2531, 2200),
    ("polaris", "reach"): (72642, 48000),
}
"""Most lines of Python in each group of rooms, and the aim of each."""

MODULES = 3
"""Most modules in which one public function or class may be defined."""


def lines(folder):
    """Return the number of lines of all Python files in a folder and below it."""
    return sum(path.read_bytes().count(b"\n") for path in folder.rglob("*.py"))


def public_names(source):
    """Return the names of the public functions and classes that a module defines at its level."""
    names, pending = set(), list[ast.AST](ast.parse(source).body)
    while pending:
        node = pending.pop()
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            names.add(node.name)
        elif isinstance(node, ast.If | ast.Try | ast.ExceptHandler):  # in any of its branches
            pending += list(ast.iter_child_nodes(node))
    return {name for name in names if not name.startswith("_")}


def repeated(root, packages):
    """Return the public names that more than `MODULES` modules of the packages define, and how many do."""
    files = [path for package in packages for path in (root / package).rglob("*.py")]
    counts = Counter(name for path in files for name in public_names(path.read_text(encoding="utf-8")))
    return {name: count for name, count in counts.items() if count > MODULES}


@pytest.mark.parametrize("rooms", LINES, ids=" + ".join)
def test_a_room_has_no_more_lines_than_its_limit(rooms):
    limit, aim = LINES[rooms]
    count = sum(lines(ROOT / room) for room in rooms)
    assert count <= limit, f"{count} lines in {' + '.join(rooms)}, at most {limit} (aim {aim}): cut something"


def test_a_public_name_is_defined_in_few_modules():
    counts = repeated(ROOT, PACKAGES)
    assert not counts, f"defined in too many modules, at most {MODULES}: {counts}; rename some"
