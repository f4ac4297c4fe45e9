"""Run folders of the inspection problem: written beside and renamed into place, like those of schedules.

A run folder of one flight holds

================== ==================================================================================
scenario.toml      the scenario, with the overrides applied
summary.json       least value of every constraint, answers of the filter, guarantee, times
constraints.csv    the same least values as a table
flight.npz         states, thrust wanted and applied, status and barriers of every control period
figures/           PDF and PNG, drawn from the files above alone
================== ==================================================================================

The same scenario gives the same bytes, but for the times in the summary: ``created``, ``seconds`` and
``filter_seconds``.
"""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..inspection.flights.judge import JudgedRun
from ..inspection.flights.simulation import InspectionRun
from ..model.errors import ScenarioError
from ..scenario.inspection import InspectionScenario, load_inspection
from . import inspection_summary as report
from .arrays import read_arrays
from .atomic import check_target, replacing
from .folder import read_json, readable, scenario_text
from .tables import json_text, write_csv, write_text

DATA_FILES = {
    "inspection": ("scenario.toml", "constraints.csv", "flight.npz"),
    "fuel_limit": ("scenario.toml", "fuel.npz"),
    "monte_carlo": ("scenario.toml", "failures.csv", "manifest.json"),
}
"""What a run folder holds besides the summary, by kind of scenario."""


@dataclass(frozen=True, eq=False)
class InspectionFolder:
    """A run folder on disk.

    Attributes
    ----------
    path : Path
        Where it lies.
    scenario : InspectionScenario
        As it was run, overrides included.
    """

    path: Path
    scenario: InspectionScenario

    @property
    def summary(self) -> dict[str, Any]:
        """Contents of ``summary.json``."""
        return read_json(self.path / "summary.json")

    def flight(self) -> InspectionRun:
        """The flight, read from its file.

        Raises
        ------
        ScenarioError
            If the file is damaged.
        """
        with readable(self.path):
            return read_flight(self.path / "flight.npz", self.scenario)

    def draw(self) -> list[Path]:
        """Redraw the figures from the files; the old ones stay until all are drawn."""
        folder = self.path / "figures"
        with replacing(folder) as beside:
            names = [path.name for path in self._draw(beside)]
        return [folder / name for name in names]

    def _draw(self, folder: Path) -> list[Path]:
        from ..report.figures.inspection import draw_campaign, draw_flight, draw_fuel_run
        from .monte_carlo import read_picture

        if self.scenario.kind == "fuel_limit":
            from .fuel_limit import read_fuel

            with readable(self.path):
                flown = read_fuel(self.path / "fuel.npz", self.scenario)
            return draw_fuel_run(flown, folder)
        if self.scenario.kind == "monte_carlo":
            with readable(self.path):
                picture = read_picture(self.path)
            return draw_campaign(picture, folder)
        return draw_flight(self.flight(), folder)


# -- one flight -------------------------------------------------------------------------------------


def write_run(
    out: str | Path,
    scenario: InspectionScenario,
    flown: JudgedRun,
    *,
    overrides: Sequence[str] = (),
    seconds: Mapping[str, float] | None = None,
    figures: bool = True,
    progress: Callable[[str], None] = lambda what: None,
) -> InspectionFolder:
    """Write the run folder of one flight, replacing an older one once everything is written.

    Parameters
    ----------
    out : path
    scenario : InspectionScenario
    flown : JudgedRun
        Result of `polaris.inspection.flights.judge.fly_scenario` on it.
    overrides : sequence of str
        Texts ``key=value`` that changed the scenario, noted in the copy.
    seconds : mapping, optional
        Wall times by stage, for the summary.
    figures : bool
        Whether to draw the figures; `InspectionFolder.draw` can do so later.
    progress : callable, optional
        Called with the name of what is being done.

    Raises
    ------
    ScenarioError
        If `out` is something else than a run folder, or cannot be written.
    """

    def contents(folder: Path) -> dict[str, Any]:
        rows = report.constraint_rows(flown.constraints) + report.barrier_rows(flown.barriers)
        write_csv(folder / "constraints.csv", report.COLUMNS, [_cells(row) for row in rows])
        write_flight(folder / "flight.npz", flown.run)
        return report.summary(scenario, flown, seconds or {})

    return write_folder(out, scenario, contents, overrides, figures, progress)


def write_folder(
    out: str | Path,
    scenario: InspectionScenario,
    contents: Callable[[Path], dict[str, Any]],
    overrides: Sequence[str] = (),
    figures: bool = True,
    progress: Callable[[str], None] = lambda what: None,
) -> InspectionFolder:
    """Write a run folder: the scenario, what `contents` writes, its summary, and the figures."""
    target = check_target(out)
    with replacing(target) as folder:
        progress("files")
        write_text(folder / "scenario.toml", scenario_text(scenario, overrides))
        write_text(folder / "summary.json", json_text(contents(folder)))
        if figures:
            progress("figures")
            (folder / "figures").mkdir()
            InspectionFolder(folder, scenario)._draw(folder / "figures")
    return InspectionFolder(target, scenario)


def _cells(row: Mapping[str, Any]) -> list[Any]:
    """Cells of one line of the table; deputies as in ``0 3``."""
    return [" ".join(map(str, row[key])) if key == "deputies" else row[key] for key in report.COLUMNS]


def write_flight(path: Path, run: InspectionRun) -> None:
    """Write everything a flight consists of."""
    np.savez(path, **run.arrays())


def read_flight(path: Path, scenario: InspectionScenario) -> InspectionRun:
    """Read what `write_flight` wrote, bit for bit."""
    arrays = read_arrays(path)
    names = ("t_s", "states", "sun_rad", "thrust_N", "desired_N", "status", "barriers")
    t, x, sun, u, desired, status, h = (arrays[name] for name in names)
    q = scenario.inspection()
    K, N = len(t) - 1, q.deputies
    shapes = (sun.shape, x.shape, u.shape, desired.shape, status.shape, h.shape[:1])
    if shapes != ((K + 1,), (K + 1, N, 6), (K, N, 3), (K, N, 3), (K, N), (K,)):
        raise ValueError("flight.npz: arrays of the wrong shape")
    if not all(np.isfinite(values).all() for values in (t, x, sun, u)):
        raise ValueError("flight.npz: numbers that are not finite")
    return InspectionRun(q, t, x, sun, u, desired, status, h)


# -- reading ----------------------------------------------------------------------------------------


def is_inspection(folder: str | Path) -> bool:
    """Whether a folder is one of the inspection problem's, by the scenario in it."""
    path = Path(folder) / "scenario.toml"
    try:
        return "kind" in tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return False


def read_run(path: str | Path) -> InspectionFolder:
    """Open a run folder.

    Raises
    ------
    ScenarioError
        If it is none, or its scenario cannot be read.
    """
    folder = Path(path)
    scenario = load_inspection(folder / "scenario.toml")
    missing = [name for name in DATA_FILES[scenario.kind] if not (folder / name).is_file()]
    if missing:
        raise ScenarioError("run folder", str(path), f"must be a run folder; it has no {missing[0]}")
    return InspectionFolder(folder, scenario)
