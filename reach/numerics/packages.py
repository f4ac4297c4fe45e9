"""Packages that the project needs: their tested ranges, and the hint where one is missing or untested.

The ranges stand in the project file; an installed copy reads them from its metadata.
"""

import ast
import sys
from collections.abc import Callable
from functools import cache
from importlib import import_module, metadata
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from .errors import ReachError

DISTRIBUTION = "polaris-rta"
TOOLS = ("test", "docs", "bench")  # extras for work on the project itself: no hint names them


@cache
def project() -> dict[str, Any]:
    """Read version, requirements and extras, from a checkout's project file or from the installed copy.

    Returns
    -------
    dict
        ``version``, a string; ``dependencies``, strings as pip takes them; ``optional-dependencies``, such
        lists by the names of extras.
    """
    file = Path(__file__).resolve().parents[2] / "pyproject.toml"
    if file.is_file():
        import tomllib

        declared: dict[str, Any] = tomllib.loads(file.read_text(encoding="utf-8")).get("project", {})
        if declared.get("name") == DISTRIBUTION:
            return declared
    about = metadata.metadata(DISTRIBUTION)
    extras: dict[str, list[str]] = {name: [] for name in about.get_all("Provides-Extra") or ()}
    needed: list[str] = []
    for text in about.get_all("Requires-Dist") or ():
        requirement, _, marker = text.partition(";")
        names = [name for name in extras if f"'{name}'" in marker.replace('"', "'")]
        (extras[names[0]] if names else needed).append(requirement.strip())
    return {"version": about["Version"], "dependencies": needed, "optional-dependencies": extras}


def untested(requirement: str) -> str:
    """Say which version of a package is installed that a requirement excludes; empty if none is.

    Without the package `packaging`, of which `reach` has no need, versions are not checked.
    """
    try:
        from packaging.requirements import Requirement
    except ModuleNotFoundError:
        return ""
    required = Requirement(requirement)
    try:
        version = metadata.version(required.name)
    except metadata.PackageNotFoundError:  # its import says so, or it came without its metadata
        return ""
    if required.specifier.contains(version, prereleases=True):
        return ""
    tested = ",".join(sorted(map(str, required.specifier), reverse=True))
    return f"{required.name} {version} is installed, but only {required.name}{tested} is tested"


def unusable(package: str) -> str:
    """Say why an optional package cannot be used, and which one to install; empty if it can.

    Parameters
    ----------
    package : str
        Name of a package that an extra of the project declares, and of the module that it brings.
    """
    from packaging.requirements import Requirement

    for extra, needed in project()["optional-dependencies"].items():
        for requirement in needed if extra not in TOOLS else ():
            if Requirement(requirement).name == package:
                missing = "" if find_spec(package) else f"needs the package {package}"
                problem = missing or untested(requirement)
                return f"{problem}: pip install '{DISTRIBUTION}[{extra}]'" if problem else ""
    raise KeyError(package)


@cache
def check() -> None:
    """Raise `ReachError` if a required package is installed in a version that was not tested."""
    faults = [fault for requirement in project()["dependencies"] if (fault := untested(requirement))]
    if faults:
        raise ReachError(f"{'; '.join(faults)}: pip install {DISTRIBUTION}")


def attach(package: str, file: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Attach the names of a package's stub to it; versions are checked when the first name is used.

    Parameters
    ----------
    package, file : str
        Its ``__name__`` and ``__file__``.

    Returns
    -------
    tuple
        ``__getattr__``, ``__dir__`` and ``__all__`` of the package.
    """
    stub = ast.parse(Path(file).with_suffix(".pyi").read_text(encoding="utf-8"))
    imports = [node for node in stub.body if isinstance(node, ast.ImportFrom)]
    homes = {alias.name: f"{package}.{node.module}" for node in imports for alias in node.names}

    def find(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        check()  # first of all: the import itself may fail with another version
        value = vars(sys.modules[package])[name] = getattr(import_module(homes[name]), name)
        return value

    return find, lambda: sorted(homes), sorted(homes)
