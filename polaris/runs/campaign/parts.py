"""Results of a campaign on disk: one table per batch, written beside and renamed into place."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from ...model.errors import ScenarioError
from ...model.system import Array
from ..arrays import read_arrays
from ..atomic import replacing_file
from .batch import Batch, Task
from .plan import CampaignPlan

KEY = "polaris"
"""Where a part says which campaign, case, batch and schedule it belongs to."""

Columns = dict[str, Array]


class Parquet:
    """Parquet files, which pandas, polars and others read as one table."""

    def write(self, path: Path, columns: Mapping[str, Array], told: str) -> None:
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

    def write(self, path: Path, columns: Mapping[str, Array], told: str) -> None:
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
    """The first of some formats that this install can write.

    Raises
    ------
    ScenarioError
        If it can write none of them.
    """
    for name in formats:
        if name != "parquet" or find_spec("pyarrow") is not None:
            return name
    rule = "must be a package that is installed, to write Parquet files: pip install '.[campaign]'"
    raise ScenarioError("pyarrow", None, rule)


@dataclass(frozen=True)
class Parts:
    """The parts of a campaign, ``runs/case-0000-batch-00000.parquet`` and so on.

    Attributes
    ----------
    folder : Path
        Where they lie.
    plan : CampaignPlan
    ending : str
        One of `FORMATS`.
    """

    folder: Path
    plan: CampaignPlan
    ending: str

    @property
    def table(self) -> Parquet | Npz:
        """How they are read and written."""
        return FORMATS[self.ending]

    def path(self, task: Task) -> Path:
        """Where a batch goes."""
        return self.folder / f"case-{task.case:04d}-batch-{task.batch:05d}.{self.ending}"

    def write(self, task: Task, batch: Batch) -> None:
        """Write a batch: whole, or not at all."""
        who = {
            "campaign": self.plan.digest,
            "case": task.case,
            "batch": task.batch,
            "schedule": batch.schedule,
        }
        with replacing_file(self.path(task)) as beside:
            self.table.write(beside, self._columns(task, batch), json.dumps(who))

    def check(self, task: Task) -> str | None:
        """Schedule (its SHA-256) of a part that is whole and belongs here; None if it must be flown again."""
        try:
            text, rows = self.table.check(self.path(task))
            told = json.loads(text)
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile):
            return None
        same = (told.get("campaign"), told.get("case"), told.get("batch")) == (
            self.plan.digest,
            task.case,
            task.batch,
        )
        return str(told["schedule"]) if same and rows == task.runs * len(self.plan.kind.modes) else None

    def read(self, case: int, names: Sequence[str] | None = None) -> Columns:
        """Some columns of all runs of a case, in order; all columns if not said."""
        tasks = (self.plan.task(case, batch) for batch in range(self.plan.batches))
        parts = [self.table.read(self.path(task), names) for task in tasks]
        return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}

    def row(self, task: Task, mode: str, run: int) -> dict[str, Any]:
        """Everything the table says of one run."""
        place = self.plan.kind.modes.index(mode) * task.runs + run
        row = {name: values[place] for name, values in self.table.read(self.path(task)).items()}
        return {name: value.item() if isinstance(value, np.generic) else value for name, value in row.items()}

    def _columns(self, task: Task, batch: Batch) -> Columns:
        count, case = task.runs * len(self.plan.kind.modes), self.plan.cases[task.case]
        columns: Columns = {
            "case": np.full(count, task.case, dtype=np.int32),
            "scenario": np.full(count, case.scenario),
        }
        for key, kind in self._kinds().items():
            value = dict(case.parameters)[key]
            columns[key] = np.repeat(np.array(str(value) if kind is str else value, dtype=kind), count)
        return columns | {"batch": np.full(count, task.batch, dtype=np.int32)} | batch.columns

    def _kinds(self) -> dict[str, type]:
        """Type of each parameter's column: the same in all parts."""
        values: dict[str, set[type]] = {}
        for case in self.plan.cases:
            for key, value in case.parameters:
                values.setdefault(key, set()).add(type(value))
        return {key: _kind(found) for key, found in values.items()}


def _kind(found: set[type]) -> type:
    if len(found) == 1 and found <= {bool, int}:
        return found.pop()
    return float if found <= {int, float} else str
