"""Glue of flight code for F' and cFS: a component or an application that calls it, from templates."""

import re
from pathlib import Path

from ..certificate.code.text import KEY, Tables
from ..model.errors import ScenarioError

FILES = {
    "fprime": {
        "{0}/{0}.fpp": "component.fpp",
        "{0}/{0}.hpp": "component.hpp",
        "{0}/{0}.cpp": "component.cpp",
        "{0}/CMakeLists.txt": "component.cmake",
    },
    "cfs": {
        "{0}/CMakeLists.txt": "app.cmake",
        "{0}/fsw/src/{0}_app.h": "app.h",
        "{0}/fsw/src/{0}_app.c": "app.c",
        "{0}/fsw/tables/{0}_tbl.c": "app_table.c",
    },
}
"""Files of every framework beside the flight code, and their templates."""

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
LONGEST = {"fprime": 16, "cfs": 11}  # of names: cFS has 19 characters for the file of a table
MODULE = "Components"


def glue_files(
    tables: Tables,
    prefix: str,
    precision: str,
    framework: str,
    name: str | None = None,
    module: str = MODULE,
    online: bool = False,
) -> dict[str, str]:
    """Return the texts of the glue for a framework by their paths beside the flight code.

    Parameters
    ----------
    tables : Tables
    prefix, precision : str
        Of the flight code.
    framework : {"fprime", "cfs"}
    name : str, optional
        Of the component or application; default from the prefix.
    module : str
        Of the component, for F' alone.
    online : bool
        Call the online monitor in the code instead of the schedule.

    Raises
    ------
    ScenarioError
        If there is no such framework, or names are not usable.
    """
    if framework not in FILES:
        raise ScenarioError("glue", framework, f"must be one of {', '.join(FILES)}")
    name = default_name(prefix, framework) if name is None else name
    for field, value in (("name", name), ("module", module)):
        longest = LONGEST["fprime" if field == "module" else framework]
        if not NAME.fullmatch(value) or len(value) > longest:
            rule = f"must be at most {longest} letters, digits and _, a letter first"
            raise ScenarioError(field, value, rule)
    if name == prefix:
        raise ScenarioError("name", name, "must not be the prefix of the flight code")
    n, m = tables.sizes["N"], tables.sizes["M"]
    values = {"PREFIX": prefix, "GUARD": prefix.upper(), "NAME": name, "APP": name.upper(), "MODULE": module}
    entry = f"{prefix}_online" if online else prefix
    values |= {"ENTRY": entry, "MEMORY": entry if online else f"{prefix}_memory"}
    values |= {"N": str(n), "M": str(m), "REAL": "F64" if precision == "double" else "F32"}
    place = Path(__file__).parent / "templates"
    texts = {path.format(name): (place / one).read_text() for path, one in FILES[framework].items()}
    return {path: KEY.sub(lambda key: values[key[1]], text) for path, text in texts.items()}


def default_name(prefix: str, framework: str) -> str:
    """Return a name made of a prefix: in words with capitals for F', with ``_app`` for cFS."""
    if framework == "fprime":
        return "".join(word.capitalize() for word in prefix.split("_"))[:16]
    return f"{prefix.removeprefix('polaris_')[:7].rstrip('_')}_rta"
