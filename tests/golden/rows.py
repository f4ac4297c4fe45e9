"""Rows of the golden table: what one scene proves, made anew or read from the table."""

import json
import os
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from polaris.certificate.checker import verify
from polaris.model.errors import PolarisError
from polaris.runs.schedule import write_run
from polaris.simulation.metrics import finite
from polaris.synthesis.schedule.schedule import Schedule
from polaris.synthesis.schedule.synthesize import synthesize
from reach.numerics.errors import ReachError
from tests.golden.scenes import Scene

Row = dict[str, Any]

TABLE = Path(__file__).with_name("table.json")
"""The table: a list of rows, one on each line."""


def make_row(scene: Scene) -> tuple[Row, str]:
    """Return the row of a scene, and the message if it has no schedule or is not verified."""
    row: Row = {"name": scene.name}
    with TemporaryDirectory() as folder:
        try:
            row["scene"] = scene.digest()
            scenario = scene.load(Path(folder))
            schedule = synthesize(scenario)
            verdict = verify(write_run(Path(folder) / "run", scenario, schedule).path)
        except PolarisError as error:
            return row | {"exit_code": error.exit_code}, str(error)
        except ReachError as error:
            return row | {"exit_code": 4}, str(error)
        except Exception as error:  # `polaris run` makes one message of it, too
            return row | {"exit_code": 1}, f"{type(error).__name__}: {error}"
    message = f"{verdict.claim}: {verdict.witness}" if verdict.exit_code else ""
    return row | {"exit_code": 0, "verdict": verdict.outcome, **proven(schedule)}, message


def proven(schedule: Schedule) -> Row:
    """Return what a schedule proves: modes, least margins, end condition, goal, and the size of U's tubes."""
    widths = [step.tube.nodes.half_widths for step in schedule.steps if step.mode]
    margins = [step.margin.value for step in schedule.steps if step.mode]
    safety, goal = schedule.safety, schedule.arrival
    return {
        "modes": "".join("U" if mode else "S" for mode in schedule.modes),
        "share": schedule.share(),
        "margin": finite(float(min(margins))) if margins else None,
        "start_margin": finite(float(safety.start_margin.value)),
        "end": safety.end.horizon,
        "goal": goal.reached,
        "goal_tolerance_m": goal.tolerance,
        "goal_by_s": goal.by,
        "goal_distance_m": finite(goal.distance),
        "tube": np.max([np.max(half, axis=0) for half in widths], axis=0).tolist() if widths else None,
    }


def read_table() -> dict[str, Row]:
    """Return the stored rows by name."""
    rows = json.loads(TABLE.read_text(encoding="utf-8")) if TABLE.exists() else []
    return {row["name"]: row for row in rows}


def write_table(rows: dict[str, Row]) -> None:
    """Store rows; a table is replaced as a whole, so that none is lost if the machine stops."""
    lines = ",\n".join(json.dumps(row, allow_nan=False) for row in rows.values())
    temporary = TABLE.with_suffix(".new")
    temporary.write_text(f"[\n{lines}\n]\n", encoding="utf-8", newline="\n")
    os.replace(temporary, TABLE)
