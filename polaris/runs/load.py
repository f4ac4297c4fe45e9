"""What to attack: a scenario, or the schedule of a run folder, made again and compared with it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..model.errors import ScenarioError
from .tables import read_reference
from .folder import (read_run, readable)
from ..scenario.scenario import (Scenario, load_scenario)
from ..synthesis.schedule import Schedule
from ..synthesis.synthesize import synthesize


def load_target(target: str) -> tuple[Scenario, Schedule]:
    """Synthesise a scenario, or that of a run folder.

    Raises
    ------
    ScenarioError
        If there is no such scenario, or the schedule made again is not that of the folder.
    """
    if not Path(target).is_dir():
        scenario = load_scenario(target)
        return scenario, synthesize(scenario)
    folder = read_run(target)
    schedule = synthesize(folder.scenario)
    reference = schedule.safety.reference
    with readable(folder.path):
        kept = read_reference(folder.path / "reference.csv", reference.system, reference.delta)
    same = np.array_equal(kept.chi, reference.chi) and np.array_equal(kept.nu, reference.nu)
    if not same or folder.schedule.get("modes") != schedule.modes.tolist():
        rule = "holds another schedule than its scenario gives here (edited, or other versions)"
        raise ScenarioError("run folder", target, rule)
    return folder.scenario, schedule
