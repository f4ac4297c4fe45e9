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

import json
import os
import secrets
import shutil
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .errors import ScenarioError
from .scenario import Scenario, load_scenario
from .version import versions

if TYPE_CHECKING:
    from .comparison import Flown
    from .figures.picture import Picture
    from .schedule import Schedule

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


@dataclass(frozen=True, eq=False)
class RunFolder:
    """A run folder on disk.

    Attributes
    ----------
    path : Path
    scenario : Scenario
        As it was run, overrides included.
    """

    path: Path
    scenario: Scenario

    @property
    def summary(self) -> dict[str, Any]:
        """Contents of ``summary.json``."""
        return _read_json(self.path / "summary.json")

    @property
    def schedule(self) -> dict[str, Any]:
        """Contents of ``schedule.json``."""
        return _read_json(self.path / "schedule.json")

    def picture(self) -> Picture:
        """What the figures are drawn from, read from the files.

        Raises
        ------
        ScenarioError
            If a file is missing or not what it should be.
        """
        from . import runfiles as files
        from .figures.picture import Picture

        schedule, system = self.schedule, self.scenario.system()
        with _readable(self.path):
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
                np.array([-np.inf if step["margin"] is None else step["margin"] for step in steps], dtype=float),
                tuple(step["limit"] for step in steps),
                files.read_flights(self.path / "trajectories.npz"),
                files.read_tube(self.path / "tubes.npz", system.position),
                files.read_slices(self.path / "sets.npz"),
            )

    def draw(self) -> list[Path]:
        """Redraw the figures from the files; the old ones stay until all are drawn."""
        from .figures import draw_figures

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
    progress: Callable[[str], None] | None = None,
) -> RunFolder:
    """Write a run folder, replacing an older one once everything is written.

    Parameters
    ----------
    out : path
        The folder; its parents are made.
    scenario : Scenario
    schedule : Schedule
        Result of `synthesize` on it.
    flown : mapping, optional
        Result of `compare`; flown here as the scenario's ``[simulation]`` says if not given.
    overrides : sequence of str
        Texts ``key=value`` that changed the scenario, noted in the copy.
    seconds : mapping, optional
        Further wall times by stage, for the summary.
    progress : callable, optional
        Called with the name of what is being done.

    Raises
    ------
    ScenarioError
        If `out` is something else than a run folder, or cannot be written.
    """
    from . import runfiles as files
    from .comparison import compare
    from .figures import draw_figures

    target = check_target(out)
    if flown is None:
        flown = compare(schedule, scenario.simulation.runs, scenario.simulation.seed)
    rules = asdict(scenario.switching_rules())
    with replacing(target) as folder:
        note = progress or (lambda what: None)
        note("files")
        begun = time.perf_counter()
        files.write_text(folder / "scenario.toml", _scenario_text(scenario, overrides))
        files.write_schedule(folder, schedule, rules, guarantee(schedule))
        files.write_reference(folder / "reference.csv", schedule.safety.reference)
        files.write_text(folder / "gains.json", files.json_text(files.gains(schedule)))
        files.write_sets(folder / "sets.npz", schedule)
        files.write_tubes(folder / "tubes.npz", schedule)
        files.write_flights(folder / "trajectories.npz", {key: item.flights for key, item in flown.items()})
        written = time.perf_counter()
        note("figures")
        (folder / "figures").mkdir()
        draw_figures(RunFolder(folder, scenario).picture(), folder / "figures")
        spent = {"files": written - begun, "figures": time.perf_counter() - written}
        found = summary(scenario, schedule, flown, {**(seconds or {}), **spent})
        files.write_text(folder / "summary.json", files.json_text(found))
    return RunFolder(target, scenario)


def summary(
    scenario: Scenario, schedule: Schedule, flown: Mapping[str, Flown], seconds: Mapping[str, float]
) -> dict[str, Any]:
    """Contents of ``summary.json``."""
    from .evaluation import DEFINITIONS

    safety, found = schedule.safety, schedule.safety.plan
    stages = dict(schedule.seconds)
    return {
        "schema_version": 1,
        "scenario": scenario.name,
        "title": scenario.model.title,
        **{key: item.metrics.summary() for key, item in flown.items()},
        "synthesis": {
            "recoverable": safety.recoverable.kind,
            "experimental_share": schedule.share(),
            "switches": schedule.switches,
            "start_margin": safety.start_margin.value,
            "start_limit": safety.start_margin.limit,
            "planner": {
                "status": found.status,
                "solver": found.solver,
                "gap": found.gap,
                "delta_v_m_s": found.delta_v,
                "margin_m": found.margin,
                "size": found.stats,
            },
            "seconds": {**stages, "total": sum(stages.values()), "plan_parts": found.seconds, **seconds},
        },
        "guarantee": guarantee(schedule),
        "definitions": DEFINITIONS,
        "seed": scenario.simulation.seed,
        "versions": versions(),
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
    }


def guarantee(schedule: Schedule) -> dict[str, Any]:
    """What is claimed, until when, why, and on what assumptions."""
    end = schedule.safety.end
    return {
        "kind": schedule.guarantee,
        "horizon": end.horizon,
        "until_s": end.until if np.isfinite(end.until) else None,
        "reason": end.reason,
        "assumptions": list(schedule.assumptions),
    }


def _scenario_text(scenario: Scenario, overrides: Sequence[str]) -> str:
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
        If it is none, or its scenario cannot be read.
    """
    folder = Path(path)
    missing = [name for name in DATA_FILES if not (folder / name).is_file()]
    if missing:
        what = f"must be a run folder; it has no {missing[0]}" if folder.is_dir() else "there is no such folder"
        raise ScenarioError("run folder", str(path), what)
    return RunFolder(folder, load_scenario(folder / "scenario.toml"))


def _read_json(path: Path) -> dict[str, Any]:
    with _readable(path):
        data = json.loads(path.read_text(encoding="utf-8"))
        if not isinstance(data, dict):
            raise ValueError("not an object")
    return data


@contextmanager
def _readable(path: Path) -> Iterator[None]:
    """Turn whatever a damaged file causes into one message."""
    import zipfile

    try:
        yield
    except (OSError, ValueError, KeyError, IndexError, TypeError, zipfile.BadZipFile, EOFError) as error:
        if isinstance(error, ScenarioError):
            raise
        told = " ".join(str(error).split()) or type(error).__name__
        raise ScenarioError("run folder", str(path), f"a file in it is damaged ({told}); run the scenario again") from error


# -- the folder as a whole ----------------------------------------------------------------------------


def check_target(out: str | Path) -> Path:
    """Whether a run folder may be written there; returns the absolute path.

    Raises
    ------
    ScenarioError
        If there is something else, which must not be replaced, or the place is not writable.
    """
    try:
        target = Path(out).resolve()
        if target == Path.cwd() or target in Path.cwd().parents:
            raise ScenarioError("--out", str(out), "must not be the current folder or one above it")
        if target.exists():
            if not target.is_dir():
                raise ScenarioError("--out", str(out), "is a file; must be a folder")
            if any(target.iterdir()) and not (target / "summary.json").is_file():
                raise ScenarioError("--out", str(out), "is a folder with other contents; it will not be replaced")
        nearest = next(parent for parent in target.parents if parent.exists())
        if not nearest.is_dir() or not os.access(nearest, os.W_OK | os.X_OK):
            raise ScenarioError("--out", str(out), f"cannot be made: {nearest} is not a writable folder")
    except (OSError, ValueError) as error:
        raise ScenarioError("--out", str(out), f"must be a usable path ({error})") from error
    return target


@contextmanager
def replacing(target: Path) -> Iterator[Path]:
    """A new folder beside `target` that takes its place if all goes well, and is removed if not.

    An older folder is moved aside and deleted last; killed in between, it is whole, under a name
    that begins with a dot.
    """
    token = secrets.token_hex(4)
    beside, aside = (target.with_name(f".{target.name}.{word}-{token}") for word in ("new", "old"))
    try:
        beside.mkdir(parents=True)
    except OSError as error:
        raise ScenarioError("--out", str(target), f"cannot be made: {error.strerror}") from error
    try:
        yield beside
        if target.exists():
            target.rename(aside)
        try:
            beside.rename(target)
        except OSError:
            if aside.exists():
                aside.rename(target)
            raise
    except BaseException:
        shutil.rmtree(beside, ignore_errors=True)
        raise
    shutil.rmtree(aside, ignore_errors=True)
