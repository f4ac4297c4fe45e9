"""Results of a campaign on disk: one Parquet file per batch, written beside and renamed into place."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from ..atomic import replacing_file
from .batch import Batch, Task
from .plan import Plan

KEY = b"polaris"
"""Where a part says which campaign, case, batch and schedule it belongs to."""

TEXTS = ("mode", "controller", "closest_set")


@dataclass(frozen=True)
class Parts:
    """The parts of a campaign, ``runs/case-0000-batch-00000.parquet`` and so on.

    Attributes
    ----------
    folder : Path
        Where they lie.
    plan : Plan
    """

    folder: Path
    plan: Plan

    def path(self, task: Task) -> Path:
        """Where a batch goes."""
        return self.folder / f"case-{task.case:04d}-batch-{task.batch:05d}.parquet"

    def write(self, task: Task, batch: Batch) -> None:
        """Write a batch: whole, or not at all."""
        with replacing_file(self.path(task)) as beside:
            pq.write_table(self._table(task, batch), beside, write_page_checksum=True)

    def check(self, task: Task) -> str | None:
        """Schedule (its SHA-256) of a part that is whole and belongs here; None if it must be flown again.

        All of it is read, against the checksums of its pages.
        """
        try:
            table = pq.ParquetFile(self.path(task), page_checksum_verification=True).read()
            told = json.loads((table.schema.metadata or {})[KEY])
        except (OSError, ValueError, KeyError, pa.ArrowException):
            return None
        same = told.get("campaign") == self.plan.digest and (told.get("case"), told.get("batch")) == (
            task.case,
            task.batch,
        )
        if not same or table.num_rows != task.runs * len(task.modes):
            return None
        return str(told["schedule"])

    def read(self, case: int, columns: Sequence[str]) -> pa.Table:
        """Some columns of all runs of a case, in order."""
        tasks = (self.plan.task(case, batch) for batch in range(self.plan.batches))
        return pa.concat_tables([pq.read_table(self.path(task), columns=list(columns)) for task in tasks])

    def row(self, task: Task, mode: str, run: int) -> dict[str, Any]:
        """Everything the table says of one run."""
        table = pq.read_table(self.path(task))
        row: dict[str, Any] = table.slice(task.modes.index(mode) * task.runs + run, 1).to_pylist()[0]
        return row

    def _table(self, task: Task, batch: Batch) -> pa.Table:
        count = task.runs * len(task.modes)
        case = self.plan.cases[task.case]
        names = pa.array([case.scenario])
        columns: dict[str, Any] = {
            "case": np.full(count, task.case, dtype=np.int32),
            "scenario": pa.DictionaryArray.from_arrays(np.zeros(count, dtype=np.int32), names),
        }
        for key, kind in self.kinds().items():
            value = dict(case.parameters)[key]
            columns[key] = pa.array([str(value) if kind == pa.string() else value] * count, kind)
        columns["batch"] = np.full(count, task.batch, dtype=np.int32)
        columns["seed"] = np.full(count, task.seeds[0], dtype=np.int64)
        columns["seed_truth"] = np.full(count, task.seeds[1], dtype=np.int64)
        for name, values in batch.columns.items():
            columns[name] = pa.array(values.tolist(), pa.string()) if name in TEXTS else values
        who = {
            "campaign": self.plan.digest,
            "case": task.case,
            "batch": task.batch,
            "schedule": batch.schedule,
        }
        return pa.table(columns).replace_schema_metadata({KEY: json.dumps(who).encode()})

    def kinds(self) -> dict[str, pa.DataType]:
        """Type of each parameter's column: the same in all parts."""
        values: dict[str, list[Any]] = {}
        for case in self.plan.cases:
            for key, value in case.parameters:
                values.setdefault(key, []).append(value)
        return {key: _kind(given) for key, given in values.items()}


def _kind(values: Sequence[Any]) -> pa.DataType:
    found = {type(value) for value in values}
    if found == {bool}:
        return pa.bool_()
    if found == {int}:
        return pa.int64()
    return pa.float64() if found <= {int, float} else pa.string()
