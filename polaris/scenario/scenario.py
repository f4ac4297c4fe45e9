"""Scenarios of every kind: load one by name or path, override a value, build the domain's objects from it.

>>> import polaris
>>> polaris.load_scenario("static").system().n
6
>>> polaris.load_scenario("inspection").inspection().deputies
5
"""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar, cast, overload

from ..model.errors import ScenarioError
from ..model.keys import printable
from .base import KINDS, SCHEDULE, Scenario, overridden, parse_assignment
from .inspection import FlightScenario, FuelLimitScenario, InspectionScenario, MonteCarloScenario
from .mission import MissionScenario
from .reading import did_you_mean, read_document
from .schedule import ScheduleScenario

__all__ = [
    "KINDS",
    "FlightScenario",
    "FuelLimitScenario",
    "InspectionScenario",
    "MissionScenario",
    "MonteCarloScenario",
    "Scenario",
    "ScheduleScenario",
    "bundled_files",
    "bundled_scenarios",
    "load_scenario",
]

KINDS |= {
    SCHEDULE: ScheduleScenario,
    "inspection": FlightScenario,
    "fuel_limit": FuelLimitScenario,
    "monte_carlo": MonteCarloScenario,
    "mission": MissionScenario,
}

Wanted = TypeVar("Wanted", bound=Scenario)


def scenario_folder() -> Path:
    """Return the folder of bundled scenarios: in the installed package, or beside it in a checkout."""
    package = Path(__file__).resolve().parents[1]
    checkout = package.parent / "scenarios"
    # A checkout's folder comes first, so that an editable installation never reads an old copy.
    return checkout if (package.parent / "pyproject.toml").is_file() else package / "bundled_scenarios"


def bundled_files() -> dict[str, Path]:
    """Path of every scenario file that comes with the package, of every kind, by its name, sorted."""
    return dict(sorted((path.stem, path) for path in scenario_folder().glob("*.toml")))


def bundled_scenarios() -> tuple[str, ...]:
    """Names of the scenarios of switching schedules that come with the package, sorted.

    Those of the inspection problem have a key ``kind`` at the top; ``polaris scenarios`` lists them too.
    """
    return tuple(name for name, path in bundled_files().items() if "kind" not in read_document(path)[0])


def locate(name_or_path: str | Path) -> Path:
    """Path of a bundled scenario, or of one's own; a name wins over a file of the same name."""
    text, bundled = str(name_or_path), bundled_files()
    if isinstance(name_or_path, str) and text in bundled:
        return bundled[text]
    try:
        exists = Path(text).exists()
    except (OSError, ValueError):
        exists = False
    if not exists and re.fullmatch(r"[\w-]+", text):  # a bare word: say what there is
        rule = f"is neither a file nor a bundled scenario ({', '.join(bundled)}){did_you_mean(text, bundled)}"
        raise ScenarioError("scenario", printable(text), rule)
    return Path(name_or_path)


Overrides = Mapping[str, Any] | Sequence[str]


@overload
def load_scenario(name_or_path: str | Path, overrides: Overrides = ()) -> Any: ...
@overload
def load_scenario(name_or_path: str | Path, overrides: Overrides = (), *, only: type[Wanted]) -> Wanted: ...


def load_scenario(
    name_or_path: str | Path, overrides: Overrides = (), *, only: type[Scenario] = Scenario
) -> Scenario:
    """Load a bundled scenario by its name, or one's own by its path.

    Parameters
    ----------
    name_or_path : str or Path
        A name that ``polaris scenarios`` lists or the path of a TOML file. A name wins over a file of the
        same name; write ``./static`` for the file.
    overrides : mapping or sequence of str, optional
        Values to replace before validation, as in `Scenario.set`, or texts ``key=value`` as given to
        ``--set``, which the scenario notes.
    only : type
        Refuse scenarios of other kinds, as in ``only=ScheduleScenario``.

    Returns
    -------
    Scenario
        Of the class that its kind has: `ScheduleScenario`, `FlightScenario`, `FuelLimitScenario` or
        `MonteCarloScenario`.

    Raises
    ------
    ScenarioError
        If there is no such scenario, or it is not valid: names the field, what was given, the rule.
    """
    path = locate(name_or_path)
    (document, text), source = read_document(path), printable(path.name)
    assignments = () if isinstance(overrides, Mapping) else tuple(overrides)
    values = overrides if isinstance(overrides, Mapping) else dict(map(parse_assignment, assignments))
    attributes = {"text": None if values else text, "overrides": assignments, "folder": path.parent}
    return only.from_dict(overridden(document, values, source), source, **attributes)


def loaded(scenario: str | Path | Wanted, overrides: Sequence[str], only: type[Wanted]) -> Wanted:
    """Return a scenario by its name or path, or one that is loaded, under texts ``key=value``."""
    if isinstance(scenario, only):
        return scenario.with_assignments(overrides)
    return load_scenario(cast(str | Path, scenario), overrides, only=only)
