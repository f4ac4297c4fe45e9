"""Cases of a campaign: scenarios times every combination of a grid of values, as text."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ...model.errors import ScenarioError
from ...scenario.overrides import parse_assignment
from ...scenario.scenario import Scenario, load_scenario

OPENING, CLOSING = "[{", "]}"


@dataclass(frozen=True)
class Case:
    """One scenario with one combination of values: one schedule, flown many times.

    Attributes
    ----------
    scenario : str
        Name of the scenario.
    parameters : tuple of (str, value)
        Keys of the grid and their values here.
    text : str
        The whole scenario as TOML, overrides and parameters applied.
    """

    scenario: str
    parameters: tuple[tuple[str, Any], ...]
    text: str

    @property
    def label(self) -> str:
        """What tables call it: ``static, planner.extra_margin_m=20``."""
        return ", ".join([self.scenario, *(f"{key}={shown(value)}" for key, value in self.parameters)])


def make_cases(
    scenarios: Sequence[str | Scenario],
    grid: Mapping[str, Sequence[Any]] | None = None,
    overrides: Sequence[str] = (),
) -> tuple[Case, ...]:
    """Every scenario with every combination of the grid's values.

    Parameters
    ----------
    scenarios : sequence of str or Scenario
        Names, paths, or scenarios already loaded.
    grid : mapping, optional
        Values by key, as in ``{"planner.extra_margin_m": [10, 20]}``; the last key changes fastest.
    overrides : sequence of str
        Texts ``key=value`` that hold in all cases.

    Raises
    ------
    ScenarioError
        If there is no such scenario, a value is not valid in it, or two cases are the same.
    """
    if isinstance(scenarios, (str, Scenario)):
        raise ScenarioError("scenarios", type(scenarios).__name__, "must be a list of scenarios, even of one")
    values = dict(grid or {})
    for key, given in values.items():
        if not isinstance(given, Sequence) or isinstance(given, str):
            raise ScenarioError(f"--grid {key}", given, "must be a list of values, even of one")
        if any(parse_assignment(text)[0] == key for text in overrides):
            raise ScenarioError("--grid", key, "must not be given to --set too")
        if not given or any(item in given[:i] for i, item in enumerate(given)):
            raise ScenarioError(f"--grid {key}", list(given), "must have at least one value, each once")
    found: list[Case] = []
    for scenario in scenarios:
        loaded = load_scenario(scenario) if isinstance(scenario, str) else scenario
        loaded = loaded.with_assignments(overrides)
        for combination in itertools.product(*values.values()):
            chosen = dict(zip(values, combination, strict=True))
            text = loaded.with_overrides(chosen).to_toml()
            found.append(Case(loaded.name, tuple(chosen.items()), text))
    if len({case.text for case in found}) < len(found) or not found:
        raise ScenarioError("scenarios", [case.label for case in found], "must be different cases")
    return tuple(found)


def parse_grid(texts: Sequence[str]) -> dict[str, list[Any]]:
    """Values by key from texts ``key=v1,v2,...``; values as for ``--set``, commas in brackets kept."""
    grid: dict[str, list[Any]] = {}
    for text in texts:
        key, equals, rest = text.partition("=")
        key = key.strip()
        if not equals or not key or not rest.strip():
            raise ScenarioError("--grid", text, "must be key=value,value,...")
        if key in grid:
            raise ScenarioError("--grid", key, "is given twice")
        grid[key] = [parse_assignment(f"{key}={part}")[1] for part in _split(rest)]
    return grid


def _split(text: str) -> list[str]:
    """Parts between commas that stand outside brackets and quotes."""
    parts, depth, quote = [""], 0, ""
    for letter in text:
        if quote:
            quote = "" if letter == quote else quote
        elif letter in "\"'":
            quote = letter
        elif letter in OPENING:
            depth += 1
        elif letter in CLOSING:
            depth -= 1
        if letter == "," and depth <= 0 and not quote:
            parts.append("")
        else:
            parts[-1] += letter
    return parts


def shown(value: Any) -> str:
    """A value as text."""
    return f"{value:g}" if isinstance(value, float) else str(value)
