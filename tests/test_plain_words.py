"""Plain words: openers of docstrings and names of locals that say nothing are refused, in every room.

A docstring begins with a verb or with the thing that it defines, a local is named by what it holds.
"""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]

OPENERS = re.compile(r"\s*(What|Whether|Where|When|How|The same)\b")

LOCALS = re.compile(
    "asked|begun|bent|booked|come|doubt|found|gained|gone|got|grown|handed|heard|how|lack|lasting|made|met|"
    "mine|most|moved|noted|pushed|put|said|seen|taken|told|turned|wanted|what|when|who"
)
"""Names that do not say what a local holds."""

FUNCTIONS = ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda


def unclear(source):
    """Return the lines and texts of docstrings with such an opener and of locals with such a name."""
    texts, pending = set(), [(ast.parse(source), False)]
    while pending:
        node, inside = pending.pop()
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            text = ast.get_docstring(node, clean=False) or ""
            if OPENERS.match(text):
                texts.add((node.body[0].lineno, text.strip().splitlines()[0]))
        if isinstance(node, FUNCTIONS) and (inside or getattr(node, "name", "_").startswith("_")):
            arguments = {each for each in ast.walk(node.args) if isinstance(each, ast.arg)}
            texts |= {(each.lineno, each.arg) for each in arguments if LOCALS.fullmatch(each.arg)}
        inside = (inside or isinstance(node, FUNCTIONS)) and not isinstance(node, ast.ClassDef)
        if (
            inside
            and isinstance(node, ast.Name)
            and isinstance(node.ctx, ast.Store)
            and LOCALS.fullmatch(node.id)
        ):
            texts.add((node.lineno, node.id))
        pending += [(child, inside) for child in ast.iter_child_nodes(node)]
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


def private_names(path):
    """Return uses of private names of modules outside the test's room, unless their line says why."""
    source, (_, *folders) = path.read_text(encoding="utf-8"), path.relative_to(ROOT).parts[:-1]
    room, lines, homes, uses = ".".join(folders[:2]) or "none", source.splitlines(), {}, []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom) and str(node.module).split(".")[0] in ("polaris", "reach"):
            homes |= {each.asname or each.name: node.module for each in node.names}
            uses += [(node.lineno, node.module, each.name) for each in node.names]
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in homes:
            uses.append((node.lineno, homes[node.value.id], node.attr))
    return [
        f"{path.relative_to(ROOT)}:{line}: {module}.{name}"
        for line, module, name in uses
        if re.match("_[^_]", name)
        and not f"{module}.".startswith(f"{room}.")
        and "# private: " not in lines[line - 1]
    ]


def test_tests_use_no_private_names_of_other_rooms():
    uses = [use for path in sorted((ROOT / "tests").rglob("*.py")) for use in private_names(path)]
    assert not uses, "test them in their room, or say why: '# private: ...'\n" + "\n".join(uses)
