"""Scenes of the golden table: bundled scenarios and random ones, each with and without declared errors."""

import hashlib
import json
import tomllib
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from polaris.scenario.scenario import ScheduleScenario, bundled_files, load_scenario

from ..polaris.random_scenarios import random_scenario

SLOW = (3, 15, 29, 30, 32, 44, 47, 50, 54, 58, 62, 65)
"""Seeds that are left out, because their scenes take long."""

SEEDS = tuple(seed for seed in range(72) if seed not in SLOW)
"""Seeds of the 60 random scenes."""

SMALL = ("infeasible", "random-46", "random-46+errors", "random-35+errors")
"""Rows of the small part: the cheapest ones."""

ALWAYS = ("simulation.runs=1", "planner.time_limit_s=1e6")
"""Assignments to every scene: flights are not compared, and no wall clock may end a search."""

CARRIED = "thrusters.remainder=carried"
"""Assignment by which the rest of an impulse is carried to the next period, not dropped."""

BUNDLED = {"keep_out": (CARRIED,), "static": (CARRIED,)}
"""Assignments to bundled scenarios with errors besides those of all; odd random scenes carry rests, too."""

PARTS, FEWER = 8, 5
"""Most control periods in a step of scenes with errors, and how many there are instead if there are more."""

ERRORS = "+errors"
"""Ending of the name of a scene with declared errors."""


@dataclass(frozen=True)
class Scene:
    """Scenario of one row.

    Attributes
    ----------
    name : str
        Name of the bundled scenario or of the random scene; it ends in `ERRORS` if errors are declared.
    text : callable
        Returns the text of the scenario file.
    more : tuple of str
        Assignments besides those of `errors`, if errors are declared.
    """

    name: str
    text: Callable[[], str]
    more: tuple[str, ...]

    def digest(self) -> str:
        """Return what tells whether the scenario file still says the same, words about it aside."""
        document = tomllib.loads(self.text())
        said = {key: value for key, value in document.items() if key not in ("title", "description")}
        return hashlib.sha256(json.dumps(said, sort_keys=True).encode()).hexdigest()[:12]

    def load(self, folder: Path) -> ScheduleScenario:
        """Write the scenario file into a folder, and load it with its errors."""
        path = folder / f"{self.name.removesuffix(ERRORS)}.toml"
        path.write_text(self.text(), encoding="utf-8")
        scenario = load_scenario(path, ALWAYS, only=ScheduleScenario)
        if not self.name.endswith(ERRORS):
            return scenario
        return load_scenario(path, [*ALWAYS, *errors(scenario), *self.more], only=ScheduleScenario)


def errors(scenario: ScheduleScenario) -> list[str]:
    """Return assignments of errors that are in proportion to a scenario which declares none.

    Estimates are off by 3 % of the initial set, commands are late by one period, thrust is wrong by 1 %, the
    mass by 0.5 % and, in Hill's frame, the direction by 0.5 degrees. An impulse bit is 1 % of what full
    thrust makes in a period. Recoverable sets are polytopes, because balls seldom hold so much. Periods are
    longer where a step has many, because the cost of a check grows faster than their number.
    """
    problem, system = scenario.problem(), scenario.system()
    period = problem.period or problem.delta / PARTS
    if round(problem.delta / period) > PARTS:
        period = problem.delta / FEWER
    known = 0.03 * scenario.initial_set().half_widths
    if system.mean_motion is None:
        found = [f"navigation.state_error={known.tolist()}"]
    else:
        found = [f"navigation.position_error_m={known[: system.d].tolist()}"]
        found += [f"navigation.velocity_error_m_s={known[system.d :].tolist()}"]
        found += ["thrusters.misalignment_deg=0.5"]
    found += ["thrusters.magnitude_error=0.01", "thrusters.mass_error=0.005"]
    found += [f"thrusters.impulse_bit_N_s={0.01 * period * float(np.min(system.u_max))!r}"]
    late = [f"feedback.period_s={period!r}", f"timing.delay_s={period!r}"]
    return [*found, *late, "recoverable.kind=polytope"]


@cache
def scenes() -> dict[str, Scene]:
    """Return the scenes of all rows by name: bundled, then random."""
    found: dict[str, Scene] = {}
    for name, path in bundled_files().items():
        if isinstance(load_scenario(path), ScheduleScenario):
            more = BUNDLED.get(name, ())
            _add(found, name, lambda path=path: path.read_text(encoding="utf-8"), more)
    for seed in SEEDS:
        _add(found, f"random-{seed}", lambda seed=seed: random_scenario(seed), (CARRIED,) * (seed % 2))
    return found


def _add(found: dict[str, Scene], name: str, text: Callable[[], str], more: tuple[str, ...]) -> None:
    found |= {each: Scene(each, text, more) for each in (name, name + ERRORS)}
