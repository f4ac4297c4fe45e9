"""Run folders: everything one synthesis found, written beside and renamed into place.

A run folder holds

================== ==================================================================================
scenario.toml      the scenario, with the overrides applied
schedule.csv/json  who flies each step, with its containment margin and what limits it
reference.csv      states and inputs of the safe reference, coasting tail included
gains.json         system, gains, error bounds
sets.npz           what the recoverable sets are made from
tubes.npz          reachable sets of every step
trajectories.npz   some simulated runs of S, U and Polaris
summary.json       metrics, guarantee, times
figures/           PDF and PNG, drawn from the files above alone
================== ==================================================================================

The same scenario and seed give the same bytes, but for ``created`` and ``synthesis.seconds`` in the summary.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from ..model.checks import of_kind
from ..model.errors import ScenarioError
from ..scenario.scenario import Scenario, load_scenario
from .atomic import check_target, replacing

if TYPE_CHECKING:
    from ..simulation.baselines import Flown
    from ..synthesis.schedule import Schedule
    from .picture import Picture

CERTIFICATE = "certificate.json"

DATA_FILES = (
    "scenario.toml",
    "schedule.csv",
    "schedule.json",
    "reference.csv",
    "gains.json",
    "sets.npz",
    "tubes.npz",
    "trajectories.npz",
)


class Written(Protocol):
    """What a scenario's copy is written from."""

    @property
    def text(self) -> str | None:
        """The file's text; None once a value has been overridden."""
        ...

    def to_toml(self) -> str:
        """All values as TOML."""
        ...


@dataclass(frozen=True, eq=False)
class RunFolder:
    """A run folder on disk.

    Attributes
    ----------
    path : Path
        Where it lies.
    scenario : Scenario
        As it was run, overrides included.
    """

    path: Path
    scenario: Scenario

    @property
    def summary(self) -> dict[str, Any]:
        """Contents of ``summary.json``."""
        return read_json(self.path / "summary.json")

    @property
    def schedule(self) -> dict[str, Any]:
        """Contents of ``schedule.json``."""
        return read_json(self.path / "schedule.json")

    def picture(self) -> Picture:
        """What the figures are drawn from, read from the files.

        Raises
        ------
        ScenarioError
            If a file is missing or not what it should be.
        """
        from . import arrays
        from . import tables as files
        from .picture import Picture

        schedule, system = self.schedule, self.scenario.system()
        with readable(self.path):
            steps = schedule["steps"]
            return Picture(
                self.scenario.model.title,
                system,
                self.scenario.obstacles(),
                self.scenario.goal(),
                self.scenario.initial_set(),
                files.read_reference(self.path / "reference.csv", system, self.scenario.step),
                len(steps),
                tuple(controller["name"] for controller in schedule["controllers"]),
                np.array(schedule["modes"], dtype=int),
                np.array(
                    [-np.inf if step["margin"] is None else step["margin"] for step in steps], dtype=float
                ),
                tuple(step["limit"] for step in steps),
                arrays.read_flights(self.path / "trajectories.npz"),
                arrays.read_tube(self.path / "tubes.npz", system.position),
                arrays.read_slices(self.path / "sets.npz"),
            )

    def draw(self) -> list[Path]:
        """Redraw the figures from the files; the old ones stay until all are drawn."""
        from ..report.figures import draw_figures

        picture = self.picture()
        folder = self.path / "figures"
        with replacing(folder) as beside:
            names = [path.name for path in draw_figures(picture, beside)]
        return [folder / name for name in names]


# -- writing ----------------------------------------------------------------------------------------


def write_run(
    out: str | Path,
    scenario: Scenario,
    schedule: Schedule,
    flown: Mapping[str, Flown] | None = None,
    *,
    overrides: Sequence[str] = (),
    seconds: Mapping[str, float] | None = None,
    figures: bool = True,
    progress: Callable[[str], None] | None = None,
) -> RunFolder:
    """Write a run folder, replacing an older one once everything is written.

    Parameters
    ----------
    out : path
        The folder; its parents are made.
    scenario : Scenario
        What was synthesised; it is copied into the folder.
    schedule : Schedule
        Result of `synthesize` on it.
    flown : mapping, optional
        Result of `compare`; flown here as the scenario's ``[simulation]`` says if not given.
    overrides : sequence of str
        Texts ``key=value`` that changed the scenario, noted in the copy.
    seconds : mapping, optional
        Further wall times by stage, for the summary.
    figures : bool
        Whether to draw the figures; `RunFolder.draw` can do so later.
    progress : callable, optional
        Called with the name of what is being done.

    Raises
    ------
    ScenarioError
        If `out` is something else than a run folder, or cannot be written, or the schedule is that of
        another scenario.
    """
    from ..report.figures import draw_figures
    from ..simulation.baselines import compare
    from ..synthesis.same_system import check_safety
    from ..synthesis.schedule import Schedule
    from . import arrays
    from . import tables as files
    from .certificate import write_certificate
    from .summary import guarantee, summary

    of_kind("scenario", scenario, Scenario, "polaris.load_scenario")
    of_kind("schedule", schedule, Schedule, "polaris.synthesize")
    check_safety(schedule.safety, scenario.problem())  # or the folder would tell of a proof of something else
    target = check_target(out)
    if flown is None:
        flown = compare(schedule, scenario.simulation.runs, scenario.simulation.seed)
    rules = asdict(scenario.switching_rules())
    with replacing(target) as folder:
        note = progress or (lambda what: None)
        note("files")
        begun = time.perf_counter()
        files.write_text(folder / "scenario.toml", scenario_text(scenario, overrides))
        files.write_schedule(folder, schedule, rules, guarantee(schedule))
        files.write_reference(folder / "reference.csv", schedule.safety.reference)
        files.write_text(folder / "gains.json", files.json_text(files.gains(schedule)))
        arrays.write_sets(folder / "sets.npz", schedule)
        arrays.write_tubes(folder / "tubes.npz", schedule)
        arrays.write_flights(folder / "trajectories.npz", {key: item.flights for key, item in flown.items()})
        write_certificate(folder, schedule, scenario.name, DATA_FILES)
        written = time.perf_counter()
        note("figures")
        if figures:
            (folder / "figures").mkdir()
            draw_figures(RunFolder(folder, scenario).picture(), folder / "figures")
        spent = {"files": written - begun, "figures": time.perf_counter() - written}
        found = summary(scenario, schedule, flown, {**(seconds or {}), **spent})
        files.write_text(folder / "summary.json", files.json_text(found))
    return RunFolder(target, scenario)


def scenario_text(scenario: Written, overrides: Sequence[str]) -> str:
    """Text of a scenario as it was run, with the overrides noted at the top."""
    text = scenario.text if scenario.text is not None else scenario.to_toml()
    if not overrides:
        return text
    noted = "".join(f"#   {' '.join(line.split())}\n" for line in overrides)
    return f"# Written with these overrides, which the values below include:\n{noted}\n{text}"


# -- reading ----------------------------------------------------------------------------------------


def read_run(path: str | Path) -> RunFolder:
    """Open a run folder.

    Raises
    ------
    ScenarioError
        If it is none, its scenario cannot be read, or a file is no longer what was written with the
        others: what a changed scenario shows was never proven.
    """
    folder = Path(path)
    missing = [name for name in DATA_FILES if not (folder / name).is_file()]
    if missing:
        what = (
            f"must be a run folder; it has no {missing[0]}" if folder.is_dir() else "there is no such folder"
        )
        raise ScenarioError("run folder", str(path), what)
    for name, known in _hashes(folder / CERTIFICATE).items():
        if name in DATA_FILES and hashlib.sha256((folder / name).read_bytes()).hexdigest() != known:
            rule = "is not what was written with the other files (edited, or damaged); run the scenario again"
            raise ScenarioError("run folder", str(folder / name), rule)
    return RunFolder(folder, load_scenario(folder / "scenario.toml"))


def _hashes(path: Path) -> dict[str, Any]:
    """Hashes by file name as a certificate has them; none without one that can be read."""
    try:
        return dict(json.loads(path.read_text(encoding="utf-8"))["artefacts"])
    except (OSError, ValueError, KeyError, TypeError):
        return {}


def read_json(path: Path) -> dict[str, Any]:
    """Read an object from a JSON file."""
    with readable(path):
        if path.exists() and not path.is_file():
            raise ValueError("not a regular file")
        data = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(data, dict):
            raise ValueError("not an object")
    return data


@contextmanager
def readable(path: Path) -> Iterator[None]:
    """Turn whatever a damaged file causes into one message."""
    import zipfile

    try:
        yield
    except (OSError, ValueError, KeyError, IndexError, TypeError, zipfile.BadZipFile, EOFError) as error:
        if isinstance(error, ScenarioError):
            raise
        told = " ".join(str(error).split()) or type(error).__name__
        raise ScenarioError(
            "run folder", str(path), f"a file in it is damaged ({told}); run the scenario again"
        ) from error
