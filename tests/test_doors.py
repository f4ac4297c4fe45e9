"""The doors of the packages: each public name is written once, in a stub, and found by all who look there."""

import ast
import importlib
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
STUBS = sorted(path for name in ("polaris", "reach") for path in (ROOT / name).rglob("__init__.pyi"))
PACKAGES = [".".join(stub.parent.relative_to(ROOT).parts) for stub in STUBS]


def homes(package):
    """Module of every name that the stub of a package declares."""
    stub = ROOT.joinpath(*package.split("."), "__init__.pyi")
    tree = ast.parse(stub.read_text(encoding="utf-8"))
    assert all(isinstance(node, ast.ImportFrom) for node in tree.body)
    names = [(alias, node.module) for node in tree.body for alias in node.names]
    # Without `as`, a name in a stub is for the stub alone, and type checkers do not see it.
    assert all(alias.asname == alias.name for alias, _ in names)
    assert len({alias.name for alias, _ in names}) == len(names)
    return {alias.name: f"{package}.{module}" for alias, module in names}


def test_doors_with_a_stub_are_those_that_use_it():
    doors = [path for name in ("polaris", "reach") for path in (ROOT / name).rglob("__init__.py")]
    users = [path for path in doors if " = attach(" in path.read_text("utf-8")]
    assert {"polaris", "polaris.inspection"} <= set(PACKAGES)
    assert sorted(users) == [stub.with_suffix(".py") for stub in STUBS]


@pytest.mark.parametrize("package", PACKAGES)
def test_no_module_is_called_like_a_public_name(package):
    """Else the module would hide the name once it has been imported."""
    folder = ROOT.joinpath(*package.split("."))
    inside = {path.stem for path in folder.iterdir() if path.suffix in ("", ".py")}
    assert inside.isdisjoint(homes(package))


@pytest.mark.parametrize("package", PACKAGES)
def test_public_names_are_those_of_the_stub_and_resolve(package):
    door = importlib.import_module(package)
    assert sorted(door.__all__) == sorted(dir(door)) == sorted(homes(package))
    for name, home in homes(package).items():
        assert getattr(door, name) is getattr(importlib.import_module(home), name)


@pytest.mark.parametrize("package", PACKAGES)
def test_unknown_name_is_an_attribute_error(package):
    with pytest.raises(AttributeError, match="nonsense"):
        _ = importlib.import_module(package).nonsense


@pytest.mark.slow
def test_type_checkers_see_the_types(tmp_path):
    names = [f"{package}.{name}" for package in PACKAGES for name in homes(package)]
    lines = [f"import {package}" for package in PACKAGES] + [f"reveal_type({name})" for name in names]
    file = tmp_path / "names.py"
    file.write_text("\n".join(lines) + "\n", encoding="utf-8")
    command = [sys.executable, "-m", "mypy", "--strict", "--no-error-summary", str(file)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=600, check=False)
    revealed = [line for line in done.stdout.splitlines() if "Revealed type is" in line]
    assert (done.returncode, len(revealed)) == (0, len(names)), done.stdout
    assert not [line for line in revealed if line.endswith('"Any"')]
