"""Scenes of the golden table: bundled scenarios and random ones, each with and without declared errors."""

import hashlib
import json
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from polaris.scenario.scenario import ScheduleScenario, bundled_files, load_scenario
from tests.polaris.random_scenarios import random_scenario

SLOW = (3, 15, 29, 30, 32, 44, 47, 50, 54, 58, 62, 65)
"""Seeds that are left out, because their scenes take long."""

SEEDS = tuple(seed for seed in range(72) if seed not in SLOW)
"""Seeds of the 60 random scenes."""

SMALL = ("infeasible", "random-45", "random-46", "random-46+errors", "random-35+errors")
"""Rows of the small part: the cheapest ones."""

ALWAYS = {"simulation.runs": 1, "planner.time_limit_s": 1e6}
"""Overrides of every scene: flights are not compared, and no wall clock may end a search."""

CARRIED = ("keep_out", "static")
"""Bundled scenarios whose errors carry the rest of an impulse to the next period, as odd random scenes do."""

PARTS, FEWER = 8, 5
"""Most control periods in a step of scenes with errors, and how many there are instead if there are more."""

ERRORS = "+errors"
"""Ending of the name of a scene with declared errors."""


@dataclass(frozen=True)
class Scene:
    """Scenario of one row."""

    name: str
    text: Callable[[], str]
    carried: bool

    def overrides(self) -> dict[str, Any]:
        """Return the values that replace those of the scenario file."""
        if not self.name.endswith(ERRORS):
            return ALWAYS
        scenario = ScheduleScenario.from_dict(tomllib.loads(self.text()))
        return ALWAYS | errors(scenario) | ({"thrusters.remainder": "carried"} if self.carried else {})

    def digest(self) -> str:
        """Return what tells whether the scene is still the same, words about it and last digits aside."""
        document = tomllib.loads(self.text())
        content = {key: value for key, value in document.items() if key not in ("title", "description")}
        text = json.dumps(_rounded([content, self.overrides()]), sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:12]

    def load(self, folder: Path) -> ScheduleScenario:
        """Write the scenario file into a folder, and load it with its errors."""
        path = folder / f"{self.name.removesuffix(ERRORS)}.toml"
        path.write_text(self.text(), encoding="utf-8")
        return load_scenario(path, self.overrides(), only=ScheduleScenario)


def errors(scenario: ScheduleScenario) -> dict[str, Any]:
    """Return overrides with errors that are in proportion to a scenario which declares none.

    Recoverable sets are polytopes, because balls seldom hold so much. Periods are longer where a step has
    many, because the cost of a check grows faster than their number.
    """
    problem, system = scenario.problem(), scenario.system()
    period = problem.period or problem.delta / PARTS
    if round(problem.delta / period) > PARTS:
        period = problem.delta / FEWER
    state_error = (0.03 * scenario.initial_set().half_widths).tolist()
    overrides: dict[str, Any] = {"recoverable.kind": "polytope", "feedback.period_s": period}
    overrides |= {"timing.delay_s": period, "thrusters.magnitude_error": 0.01, "thrusters.mass_error": 0.005}
    overrides |= {"thrusters.impulse_bit_N_s": 0.01 * period * float(np.min(system.u_max))}
    if system.mean_motion is None:
        return overrides | {"navigation.state_error": state_error}
    parts = {"position_error_m": state_error[: system.d], "velocity_error_m_s": state_error[system.d :]}
    overrides |= {f"navigation.{name}": part for name, part in parts.items()}
    return overrides | {"thrusters.misalignment_deg": 0.5}


def _rounded(value: Any) -> Any:
    """Return data with six digits of each number, because more depend on the machine."""
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_rounded(item) for item in value]
    return f"{round(value, 12) + 0.0:.6g}" if isinstance(value, float) else value


@cache
def scenes() -> dict[str, Scene]:
    """Return the scenes of all rows by name: bundled, then random."""
    table: dict[str, Scene] = {}
    for name, path in bundled_files().items():
        if isinstance(scenario := load_scenario(path), ScheduleScenario):
            _add(table, name, lambda path=path: path.read_text(encoding="utf-8"), name in CARRIED)
            if scenario.model.navigation or scenario.model.thrusters:
                del table[name + ERRORS]  # it declares errors itself
    for seed in SEEDS:
        _add(table, f"random-{seed}", lambda seed=seed: random_scenario(seed), seed % 2 == 1)
    return table


def _add(table: dict[str, Scene], name: str, text: Callable[[], str], carried: bool) -> None:
    table |= {each: Scene(each, text, carried) for each in (name, name + ERRORS)}
