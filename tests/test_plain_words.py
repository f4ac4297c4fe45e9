"""Plain words: openers of docstrings and names of locals that say nothing are refused, in every room.

A docstring begins with a verb or with the thing that it defines, a local is named by what it holds.
"""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]

OPENERS = re.compile(r"\s*(What|Whether|Where|When|How|The same)\b")

LOCALS = {"found", "most", "told"}

FUNCTIONS = ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda


def unclear(source):
    """Return the lines and texts of docstrings with such an opener and of locals with such a name."""
    texts, seen = set(), [(ast.parse(source), False)]
    while seen:
        node, inside = seen.pop()
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            text = ast.get_docstring(node, clean=False) or ""
            if OPENERS.match(text):
                texts.add((node.body[0].lineno, text.strip().splitlines()[0]))
        if isinstance(node, FUNCTIONS) and (inside or getattr(node, "name", "_").startswith("_")):
            given = {each for each in ast.walk(node.args) if isinstance(each, ast.arg)}
            texts |= {(each.lineno, each.arg) for each in given if each.arg in LOCALS}
        inside = (inside or isinstance(node, FUNCTIONS)) and not isinstance(node, ast.ClassDef)
        if inside and isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store) and node.id in LOCALS:
            texts.add((node.lineno, node.id))
        seen += [(child, inside) for child in ast.iter_child_nodes(node)]
    return sorted(texts)


def rooms():
    """Return the files of each room: a folder of a package or of the tests, others as a whole."""
    files = {}
    for top in ("polaris", "reach", "benchmarks", "docs", "tests"):
        for path in sorted((ROOT / top).rglob("*.py")):
            parts = path.relative_to(ROOT).parts
            room = "/".join(parts[: 2 if top in ("polaris", "tests") and len(parts) > 2 else 1])
            files.setdefault(room, []).append(path)
    return files


ROOMS = rooms()


@pytest.mark.parametrize("room", ROOMS)
def test_a_room_has_no_unclear_words(room):
    texts = [
        f"{path.relative_to(ROOT)}:{line}: {text}"
        for path in ROOMS[room]
        for line, text in unclear(path.read_text(encoding="utf-8"))
    ]
    assert not texts, "say what it is:\n" + "\n".join(texts)
