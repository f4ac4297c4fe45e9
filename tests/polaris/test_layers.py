"""Who may import whom: the rank of every room, and no circle between files, over all imports there are.

Imports inside functions and under ``TYPE_CHECKING`` count as well: a file that needs another one only now and
then, or only for its types, still cannot be read or moved without it. So do the stubs of lazy doors.
"""

import ast
from collections import defaultdict
from functools import cache
from pathlib import Path

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

ROOT = Path(__file__).parents[2]

RANKS = {
    "reach": 0,
    "polaris.certificate": 0,  # a leaf: it imports nothing of either package
    "polaris.model": 1,
    "polaris.planning": 2,
    "polaris.synthesis": 3,
    "polaris.simulation": 4,
    "polaris.rta": 5,
    "polaris.inspection": 6,
    "polaris.scenario": 7,
    "polaris.runs": 8,
    "polaris.flight": 9,
    "polaris.report": 9,
    "polaris.traces": 9,
    "polaris.cli": 10,
    "polaris": 11,  # the door of the package
}
"""A room imports from itself and from rooms of lower rank."""

TOGETHER = ("reach.sets.",)
"""Files that know one another: the operations of a pair of sets are found from either of the two."""


def module(path):
    """Dotted name of a file given relative to the root."""
    parts = path.with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imports(root, packages=("polaris", "reach")):
    """All imports between files of some packages: {(importer, imported): names}."""
    paths = [path for p in packages for path in (root / p).rglob("*.py*") if path.suffix in (".py", ".pyi")]
    files, edges = {module(path.relative_to(root)) for path in paths}, defaultdict(set)
    for path in paths:
        name = module(path.relative_to(root))
        package = name.split(".") if path.stem == "__init__" else name.split(".")[:-1]
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                targets = [(alias.name, "") for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                above = package[: len(package) + 1 - node.level] if node.level else []
                base = ".".join([*above, *([node.module] if node.module else [])])
                names = [(f"{base}.{alias.name}", alias.name) for alias in node.names]
                targets = [(inner if inner in files else base, member) for inner, member in names]
            else:
                continue
            for target, symbol in targets:
                if target in files and target != name:
                    edges[name, target].add(symbol)
    return dict(edges)


def room(name):
    """Room of a module: its folder below the package, or the package itself."""
    inner = ".".join(name.split(".")[:2])
    return inner if inner in RANKS else name.split(".")[0]


def upward(found):
    """Imports from a room of the same rank or a higher one, the room itself aside."""
    return {(a, b) for a, b in found if room(a) != room(b) and RANKS[room(a)] <= RANKS[room(b)]}


def circular(found):
    """Imports that lie on a circle of files, those among files that belong together aside."""
    names = sorted({name for edge in found for name in edge})
    at = {name: i for i, name in enumerate(names)}
    edges = np.array([(at[a], at[b]) for a, b in found], dtype=int).reshape(-1, 2)
    graph = coo_array((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(len(names), len(names)))
    _, circle = connected_components(graph, directed=True, connection="strong")
    together = {(a, b) for a, b in found if any(a.startswith(p) and b.startswith(p) for p in TOGETHER)}
    return {(a, b) for a, b in found if circle[at[a]] == circle[at[b]]} - together


def told(edges, found):
    return "\n".join(f"{a} imports {', '.join(sorted(found[a, b]))} from {b}" for a, b in sorted(edges))


@cache
def of_the_tree():
    return imports(ROOT)


def test_no_room_imports_upwards_and_no_files_import_in_a_circle():
    edges = of_the_tree()
    broken = upward(edges) | circular(edges)
    assert not broken, f"these imports go upwards or in a circle:\n{told(broken, edges)}"


def test_a_room_has_at_most_fifteen_files_at_one_level():
    folders = [path for package in ("polaris", "reach") for path in (ROOT / package).rglob("*/")]
    counts = {str(f.relative_to(ROOT)): len(set(f.glob("*.py")) - {f / "__init__.py"}) for f in folders}
    assert len(counts) > 20 and not {name: count for name, count in counts.items() if count > 15}


def test_there_are_at_most_thirteen_rooms_and_nothing_lies_between_them():
    rooms = {path.name for path in (ROOT / "polaris").iterdir() if path.is_dir() and any(path.glob("*.py"))}
    assert {f"polaris.{name}" for name in rooms} == {name for name in RANKS if name.startswith("polaris.")}
    assert len(rooms) <= 13
    assert {path.name for path in (ROOT / "polaris").glob("*.py")} == {"__init__.py", "__main__.py"}


def test_the_certificate_imports_nothing_of_the_packages_it_judges():
    edges = of_the_tree()
    assert not [edge for edge in edges if room(edge[0]) == "polaris.certificate" != room(edge[1])]
