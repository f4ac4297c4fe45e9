"""Run folders of every kind: written beside and renamed into place, read back as they were written.

The same scenario and seed give the same bytes, but for ``created`` and wall times in the summary.
"""

import csv
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

from reach.short_repr import short_repr

from ...certificate.files.file_keys import RUN_VERSION
from ...model.errors import ScenarioError
from ...model.files import load_json
from ...model.version import versions
from ...scenario.scenario import Scenario
from ..stages import Stages
from .atomic import replacing
from .tables import json_text, write_text

SCENARIO = "scenario.toml"


@dataclass(frozen=True)
class RunKind:
    """Kind of run folder: its files and the functions that write and read them.

    `write` writes the files but for the scenario's copy, `to_summary` gives the summary (both None where a
    campaign writes as it flies), `read` what is drawn; `fly` is what `polaris.run` does with a scenario.
    """

    name: str  # as the scenario's kind, ``comparison`` or ``tradeoff``
    files: tuple[str, ...]  # all but the summary and the certificate
    write: Callable[[Path, Any, Any], None] | None
    to_summary: Callable[[Any, Any, Mapping[str, float]], dict[str, Any]] | None
    read: Callable[[Path, Any], Any]
    fly: Callable[[Any, Stages], Any] | None = None
    summary: str = "summary.json"

    @property
    def names(self) -> tuple[str, ...]:
        """All files that it is known by."""
        return (*self.files, self.summary)


@short_repr
@dataclass(frozen=True, eq=False)
class RunFolder:
    """A run folder on disk.

    Attributes
    ----------
    path : Path
        Where it lies.
    scenario : Scenario
        As it was run, overrides included; of the class that its kind has.
    kind : RunKind
        What it holds.
    """

    path: Path
    scenario: Any
    kind: RunKind

    def json(self, name: str) -> dict[str, Any]:
        """Contents of a JSON file in it, as in ``folder.json("schedule.json")``."""
        return read_json(self.path / name)

    @property
    def summary(self) -> dict[str, Any]:
        """Contents of its summary; a `ScenarioError` if it has another format version."""
        data = self.json(self.kind.summary)
        if (version := data.get("schema_version")) != RUN_VERSION:
            rule = f"has format version {version!r}, not {RUN_VERSION}: run its scenario again"
            raise ScenarioError("run folder", str(self.path), rule)
        return data

    def plot_data(self) -> Any:
        """Return the plot data of figures and pages, read from the files.

        Returns
        -------
        PlotData, InspectionRun, FuelRun, CampaignData, ComparisonData or list
            By kind: a schedule, a flight, a flight into the fuel limit, many flights, a comparison, or the
            rows of a trade-off.

        Raises
        ------
        ScenarioError
            If a file is missing or not what it should be.
        """
        with readable(self.path):
            return self.kind.read(self.path, self.scenario)


Draw = Callable[[RunFolder], object]  # what puts the figures into a folder: `polaris.draw_run`


def write_folder(
    target: Path,
    kind: RunKind,
    scenario: Scenario,
    outcome: Any,
    *,
    draw: Draw | None = None,
    stages: Stages | None = None,
) -> RunFolder:
    """Write the results of a kind's ``fly``, replacing an older run folder once everything is written.

    `target` has been checked by `check_target`; files that the user put there since are kept beside it.
    """
    assert kind.write is not None
    stages = stages or Stages()
    clock = stages.beside()
    with replacing(target) as folder:
        stages.note("files")
        with clock.stage("files"):
            if SCENARIO in kind.files:
                write_text(folder / SCENARIO, scenario.copy_text())
                for file in scenario.files():
                    shutil.copyfile(file, folder / file.name)
            kind.write(folder, scenario, outcome)
        _summarise(folder, kind, scenario, outcome, clock.to_dict())
        if draw is not None:
            stages.note("figures")
            with clock.stage("figures"):
                draw(RunFolder(folder, scenario, kind))
            _summarise(folder, kind, scenario, outcome, clock.to_dict())
    return RunFolder(target, scenario, kind)


def _summarise(
    folder: Path, kind: RunKind, scenario: Scenario, outcome: Any, seconds: Mapping[str, float]
) -> None:
    assert kind.to_summary is not None
    summary = summary_of(scenario, kind.name, kind.to_summary(scenario, outcome, seconds))
    write_text(folder / kind.summary, json_text(summary))


def summary_of(scenario: Scenario, kind: str, entries: Mapping[str, Any]) -> dict[str, Any]:
    """Return a summary: the run, its results, and when and by which version it was made."""
    return {
        "schema_version": RUN_VERSION,
        "scenario": scenario.name,
        **({"kind": kind} if hasattr(scenario.model, "kind") else {}),
        "title": scenario.title,
        **entries,
        **provenance(),
    }


def provenance() -> dict[str, Any]:
    """Versions of all that results hang on, and the time."""
    return {"versions": versions(), "created": datetime.now(UTC).isoformat(timespec="seconds")}


def read_json(path: Path) -> dict[str, Any]:
    """Read an object from a JSON file."""
    with readable(path):
        data = load_json(path)
        if not isinstance(data, dict):
            raise ValueError("not an object")
    return data


@contextmanager
def readable(path: Path) -> Iterator[None]:
    """Turn any error by a damaged file into one message."""
    try:
        yield
    except (OSError, ValueError, LookupError, TypeError, RecursionError, csv.Error, BadZipFile) as error:
        if isinstance(error, ScenarioError):
            raise
        detail = " ".join(str(error).split()) or type(error).__name__
        rule = f"a file in it is damaged ({detail}); run the scenario again"
        raise ScenarioError("run folder", str(path), rule) from error
