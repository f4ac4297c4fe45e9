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
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from reach.brief import brief

from ...model.errors import NotCertified, ScenarioError
from ...model.version import version
from ..arrays import read_arrays
from ..atomic import check_file, check_target, replacing, replacing_file, write_whole
from ..folder import provenance, read_json
from ..ownership import RESULTS, tidy_all
from ..tables import json_text
from .batch import Batch, Columns, Results, Task, joined
from .plan import CampaignPlan

MANIFEST = "manifest.json"


@brief
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
        plan = self.plan
        results = Results(plan.cases, plan.runs, plan.seed, plan.batch, self.failures(), self.read)
        write_whole(self.path / "summary.json", json_text(plan.kind.summarise(results, worst)))

    def part(self, task: Task) -> Path:
        """Where a batch goes: ``runs/case-0000-batch-00000.parquet`` and so on."""
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
        who = self._who(task) | {"schedule": batch.schedule}
        with replacing_file(self.part(task)) as beside:
            FORMATS[self.table].write(beside, columns | batch.columns, json.dumps(who))

    def check(self, task: Task) -> str | None:
        """Schedule (its SHA-256) of a part that is whole and belongs here; None if it must be flown again."""
        try:
            text, rows = FORMATS[self.table].check(self.part(task))
            told = json.loads(text)
            schedule = str(told.pop("schedule"))
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
            return None
        return schedule if told == self._who(task) and rows == task.runs * len(self.plan.kind.modes) else None

    def read(self, case: int, names: Sequence[str] | None = None) -> Columns:
        """Some columns of all runs of a case, in order; all columns if not said."""
        tasks = (self.plan.task(case, batch) for batch in range(self.plan.batches))
        return joined([FORMATS[self.table].read(self.part(task), names) for task in tasks])

    def row(self, task: Task, mode: str, run: int) -> dict[str, Any]:
        """Everything the table says of one run."""
        place = self.plan.kind.modes.index(mode) * task.runs + run
        row = {name: values[place] for name, values in FORMATS[self.table].read(self.part(task)).items()}
        return {name: value.item() if isinstance(value, np.generic) else value for name, value in row.items()}

    def _who(self, task: Task) -> dict[str, Any]:
        return {"campaign": self.plan.digest, "case": task.case, "batch": task.batch}

    def failures(self) -> dict[int, dict[str, Any]]:
        """Cases that cannot be flown, by number, with ``message`` and ``exit_code``."""
        found = {}
        for case in range(len(self.plan.cases)):
            path = self._failure(case)
            if path.is_file():
                told = read_json(path)
                if told.get("campaign") == self.plan.digest:
                    found[case] = told
        return found

    def fail(self, case: int, batch: Batch) -> None:
        """Note why a case cannot be flown."""
        told = {
            "case": case,
            "label": self.plan.cases[case].label,
            "message": batch.failure,
            "exit_code": batch.code,
            "campaign": self.plan.digest,
        }
        write_whole(self._failure(case), json_text(told))

    def _failure(self, case: int) -> Path:
        return self.path / "failed" / f"case-{case:04d}.json"


def open_campaign(out: str | Path, plan: CampaignPlan, fresh: bool = False) -> CampaignFolder:
    """Make a folder for a campaign, or take up the one that is there; `ScenarioError` if something else is.

    What is half written is removed, and failures that more time might change are forgotten.
    """
    path = Path(out).resolve()
    table = usable(plan.kind.formats)
    known = _manifest(path) if (path / MANIFEST).is_file() else None
    if known is None or fresh:
        check_target(out, campaign=known is not None)
        if known is None and (path / "summary.json").is_file():
            raise ScenarioError("--out", str(out), "is a run folder; a campaign needs one of its own")
        with replacing(path, RESULTS) as beside:
            for name in ("runs", "failed"):
                (beside / name).mkdir()
            _write_manifest(beside, plan, table)
        return CampaignFolder(path, plan, table)
    check_file(path / "summary.json")
    if known.get("digest") != plan.digest:
        data = plan.data()
        names = [name for name in data if name != "runs" and known.get(name) != data[name]]
        differs = "other " + ", ".join(names) if names else "its manifest was changed"
        rule = f"holds another campaign ({differs}); --fresh replaces it"
        raise ScenarioError("--out", str(out), rule)
    if known["runs"] > plan.runs:
        rule = f"the campaign in {path} has {known['runs']} already; ask for as many or more, or --fresh"
        raise ScenarioError("--runs", plan.runs, rule)
    folder = CampaignFolder(path, plan, usable([known.get("table", table)]))
    for name in ("runs", "failed"):
        (path / name).mkdir(exist_ok=True)
    if known["runs"] < plan.runs:
        _write_manifest(path, plan, folder.table)
    for half in (path, path / "runs", path / "failed"):
        tidy_all(half)
    for case, told in folder.failures().items():
        if told["exit_code"] == NotCertified.exit_code:
            folder._failure(case).unlink()
    return folder


def read_campaign(path: str | Path, same_version: bool = True) -> CampaignFolder:
    """Open the folder of a campaign, finished or not.

    Parameters
    ----------
    path : path
    same_version : bool
        Whether it must be of this version of the package, as for flying its runs again.

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
    known = _manifest(folder)
    if same_version and known.get("version") != version():
        raise refuse(f"was made by version {known.get('version')}, this is {version()}: its runs may differ")
    try:
        plan, table = CampaignPlan.from_data(known), str(known["table"])
    except (ValueError, KeyError, TypeError, AttributeError, ScenarioError) as error:
        raise refuse(f"its manifest is damaged ({error})") from error
    if same_version and plan.digest != known.get("digest"):
        raise refuse("its manifest was changed: the digest does not fit")
    return CampaignFolder(folder, plan, usable([table]))


def _write_manifest(folder: Path, plan: CampaignPlan, table: str) -> None:
    data = {**plan.data(), "digest": plan.digest, "table": table, **provenance()}
    write_whole(folder / MANIFEST, json_text(data))


def _manifest(folder: Path) -> dict[str, Any]:
    known = read_json(folder / MANIFEST)
    if not isinstance(known.get("runs"), int):
        raise ScenarioError("campaign", str(folder), "its manifest is damaged (no number of runs)")
    return known


KEY = "polaris"  # where a part says which campaign, case, batch and schedule it belongs to


class Parquet:
    """Parquet files, which pandas, polars and others read as one table."""

    def write(self, path: Path, columns: Columns, told: str) -> None:
        """Write columns and a text about them; same data, same bytes."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        kept = {
            name: pa.array(values.tolist(), pa.string()) if values.dtype.kind == "U" else values
            for name, values in columns.items()
        }
        table = pa.table(kept).replace_schema_metadata({KEY: told})
        pq.write_table(table, path, write_page_checksum=True)

    def read(self, path: Path, names: Sequence[str] | None = None) -> Columns:
        """Some columns, or all of them."""
        import pyarrow.parquet as pq

        table = pq.read_table(path, columns=None if names is None else list(names))
        return {name: table[name].to_numpy() for name in table.column_names}

    def check(self, path: Path) -> tuple[str, int]:
        """The text and the number of rows, once all of it has been read against its checksums."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        try:
            table = pq.ParquetFile(path, page_checksum_verification=True).read()
        except pa.ArrowException as error:
            raise ValueError(str(error)) from error
        return (table.schema.metadata or {})[KEY.encode()].decode(), table.num_rows


class Npz:
    """numpy's files, for installs without pyarrow."""

    def write(self, path: Path, columns: Columns, told: str) -> None:
        """As `Parquet.write`."""
        arrays: dict[str, Any] = {KEY: np.array(told), **columns}
        np.savez(path, **arrays)

    def read(self, path: Path, names: Sequence[str] | None = None) -> Columns:
        """As `Parquet.read`."""
        arrays = read_arrays(path)
        return {name: arrays[name] for name in names or arrays if name != KEY}

    def check(self, path: Path) -> tuple[str, int]:
        """As `Parquet.check`; reading a zip file compares its checksums."""
        arrays = read_arrays(path)
        return str(arrays.pop(KEY)), len(next(iter(arrays.values())))


FORMATS: dict[str, Parquet | Npz] = {"parquet": Parquet(), "npz": Npz()}
"""Formats of tables by the endings of their files."""


def usable(formats: Sequence[str]) -> str:
    """The first of some formats that this install can write; `ScenarioError` if it can write none."""
    for name in formats:
        if name != "parquet" or find_spec("pyarrow") is not None:
            return name
    rule = "must be a package that is installed, to write Parquet files: pip install '.[campaign]'"
    raise ScenarioError("pyarrow", None, rule)
