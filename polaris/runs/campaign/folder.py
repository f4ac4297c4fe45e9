"""Campaign folders: manifest, parts, cases without a schedule, summary.

=============== ====================================================================================
manifest.json   cases (whole scenarios as text), runs, seed, batch; the digest results are known by
runs/           one table per batch, one row per run
failed/         one JSON file per case that cannot be flown, with the reason
summary.json    statistics of the kind of run
=============== ====================================================================================
"""

import json
import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from reach.short_repr import short_repr

from ...model.errors import NotCertified, ScenarioError
from ...model.files import parse_json
from ...model.version import version
from ..files.atomic import CAMPAIGN as MANIFEST
from ..files.atomic import adding, check_target, refuse_taken, replacing, try_writing
from ..files.folder import provenance, read_json
from ..files.ownership import OwnedPaths, read_list, tidy
from ..files.tables import json_text, write_text
from .batch import Batch, Columns, Task, joined
from .formats import FORMATS, usable
from .plan import CampaignPlan


@short_repr
@dataclass(frozen=True)
class CampaignFolder:
    """A campaign on disk.

    Attributes
    ----------
    path : Path
    plan : CampaignPlan
    table : str
        Format of the tables, one of `FORMATS`.
    """

    path: Path
    plan: CampaignPlan
    table: str

    @property
    def summary(self) -> dict[str, Any]:
        """Contents of ``summary.json``."""
        return read_json(self.path / "summary.json")

    def write_summary(self, worst: int) -> None:
        """Write ``summary.json``, once all parts are there."""
        self._add("summary.json", json_text(self.plan.kind.summarise(self, worst)))

    def part(self, task: Task) -> Path:
        """Return the path of a batch: ``runs/case-0000-batch-00000.parquet`` and so on."""
        return self.path / "runs" / f"case-{task.case:04d}-batch-{task.batch:05d}.{self.table}"

    def write(self, task: Task, batch: Batch) -> None:
        """Write a batch: whole, or not at all."""
        count, case = task.runs * len(self.plan.kind.modes), self.plan.cases[task.case]
        columns: Columns = {
            "case": np.full(count, task.case, dtype=np.int32),
            "scenario": np.full(count, case.scenario),
        }
        for key, kind in self.plan.parameter_types().items():
            value = dict(case.parameters)[key]
            columns[key] = np.repeat(np.array(str(value) if kind is str else value, dtype=kind), count)
        columns["batch"] = np.full(count, task.batch, dtype=np.int32)
        head = self._ids(task) | {"schedule": batch.schedule}
        with adding(self.path, "runs", "kept") as draft:
            FORMATS[self.table].write(draft / self.part(task).name, columns | batch.columns, json.dumps(head))

    def check(self, task: Task) -> str | None:
        """Schedule (its SHA-256) of a part that is whole and belongs here; None if it must be flown again."""
        try:
            text, rows = FORMATS[self.table].check(self.part(task))
            head = parse_json(text)
            schedule = str(head.pop("schedule"))
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
            return None
        return schedule if head == self._ids(task) and rows == task.runs * len(self.plan.kind.modes) else None

    def read(self, case: int, names: Sequence[str] | None = None) -> Columns:
        """Some columns of all runs of a case, in order; all columns if not said."""
        tasks = (self.plan.task(case, batch) for batch in range(self.plan.batches))
        return joined([FORMATS[self.table].read(self.part(task), names) for task in tasks])

    def row(self, task: Task, mode: str, run: int) -> dict[str, Any]:
        """Return the row of one run in the table, by column."""
        place = self.plan.kind.modes.index(mode) * task.runs + run
        row = {name: values[place] for name, values in FORMATS[self.table].read(self.part(task)).items()}
        return {name: value.item() if isinstance(value, np.generic) else value for name, value in row.items()}

    def _ids(self, task: Task) -> dict[str, Any]:
        return {"campaign": self.plan.digest, "case": task.case, "batch": task.batch}

    def failures(self) -> dict[int, dict[str, Any]]:
        """Cases that cannot be flown, by number, with ``message`` and ``exit_code``."""
        failures = {}
        for case in range(len(self.plan.cases)):
            path = self._failure(case)
            if path.is_file():
                failure = read_json(path)
                if failure.get("campaign") == self.plan.digest:
                    failures[case] = failure
        return failures

    def fail(self, case: int, batch: Batch) -> None:
        """Note why a case cannot be flown."""
        failure = {
            "case": case,
            "label": self.plan.cases[case].label,
            "message": batch.failure,
            "exit_code": batch.code,
            "campaign": self.plan.digest,
        }
        self._add(f"failed/{self._failure(case).name}", json_text(failure))

    def _add(self, name: str, text: str) -> None:
        """Write a text file; one of the user that has its name is kept with ``.kept``."""
        subfolder, _, file_name = name.rpartition("/")
        with adding(self.path, subfolder, "kept") as draft:
            write_text(draft / file_name, text)

    def _failure(self, case: int) -> Path:
        return self.path / "failed" / f"case-{case:04d}.json"


def check_place(out: str | Path, fresh: bool) -> tuple[Path, bool]:
    """Return the absolute path of a campaign and True if it begins there; `ScenarioError` if it cannot."""
    path = Path(out).resolve()
    listed = (read_list(path) if path.is_dir() else None) or {}
    if listed and MANIFEST not in listed:
        raise ScenarioError("--out", str(out), "must not be a run folder, but one of its own")
    if fresh or not listed:
        check_target(out, (MANIFEST, "summary.json"), campaign=True)
    return path, fresh or not listed


def open_campaign(out: str | Path, plan: CampaignPlan, fresh: bool = False) -> CampaignFolder:
    """Make a folder for a campaign, or take up the one that is there; `ScenarioError` if something else is.

    What is half written is removed, and failures that more time might change are forgotten.
    """
    path, is_new = check_place(out, fresh)
    table = usable()
    if is_new:
        with replacing(path) as draft:
            for name in ("runs", "failed"):
                (draft / name).mkdir()
            write_text(draft / MANIFEST, _manifest_text(plan, table))
        return CampaignFolder(path, plan, table)
    refuse_taken(path, (MANIFEST, "summary.json"))
    try_writing(path, "summary.json", out)
    manifest = _manifest(path)
    if manifest.get("digest") != plan.digest:
        data = plan.data()
        names = [name for name in data if name != "runs" and manifest.get(name) != data[name]]
        differs = "other " + ", ".join(names) if names else "its manifest was changed"
        raise ScenarioError("--out", str(out), f"holds another campaign ({differs}); --fresh replaces it")
    if manifest["runs"] > plan.runs:
        rule = f"must be at least {manifest['runs']}, as flown in {path}; or use --fresh"
        raise ScenarioError("--runs", plan.runs, rule)
    folder = CampaignFolder(path, plan, usable([manifest.get("table", table)]))
    if manifest["runs"] < plan.runs:
        folder._add(MANIFEST, _manifest_text(plan, folder.table))
    tidy(path)
    for case, failure in folder.failures().items():
        name = folder._failure(case).relative_to(path).as_posix()
        if failure["exit_code"] == NotCertified.exit_code and name in OwnedPaths(path):
            folder._failure(case).unlink()
    return folder


def read_campaign(path: str | Path, same_version: bool = True) -> CampaignFolder:
    """Open the folder of a campaign, finished or not.

    Parameters
    ----------
    path : path
    same_version : bool
        True if it must be of this version of the package, as for flying its runs again.

    Raises
    ------
    ScenarioError
        If it is none, is damaged, or was made by another version.
    """

    def refuse(rule: str) -> ScenarioError:
        return ScenarioError("campaign", str(path), rule)

    folder = Path(path)
    if not (folder / MANIFEST).is_file():
        raise refuse(f"must be a campaign folder; it has no {MANIFEST}")
    record = _manifest(folder)
    if same_version and record.get("version") != version():
        raise refuse(f"was made by version {record.get('version')}, this is {version()}: its runs may differ")
    try:
        plan, table = CampaignPlan.from_data(record), str(record["table"])
    except (ValueError, KeyError, TypeError, AttributeError, ScenarioError) as error:
        raise refuse(f"its manifest is damaged ({error})") from error
    if same_version and plan.digest != record.get("digest"):
        raise refuse("its manifest was changed: the digest does not fit")
    return CampaignFolder(folder, plan, usable([table]))


def _manifest_text(plan: CampaignPlan, table: str) -> str:
    return json_text({**plan.data(), "digest": plan.digest, "table": table, **provenance()})


def _manifest(folder: Path) -> dict[str, Any]:
    manifest = read_json(folder / MANIFEST)
    if not isinstance(manifest.get("runs"), int):
        raise ScenarioError("campaign", str(folder), "has no number of runs; use --fresh")
    return manifest
