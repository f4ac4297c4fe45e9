"""What the tables of a campaign are kept in: Parquet, or numpy's files where that is not installed."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from ...model.errors import ScenarioError
from ..arrays import read_arrays
from .batch import Columns

KEY = "polaris"
"""Where a part says which campaign, case, batch and schedule it belongs to."""


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
