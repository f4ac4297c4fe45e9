"""Table formats of campaign parts: Parquet, and numpy's archives where pyarrow is not installed."""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from reach.numerics.files import open_regular
from reach.numerics.packages import unusable

from ...model.errors import ScenarioError
from ..files.arrays import LARGEST, read_arrays
from .batch import Columns

KEY = "polaris"  # where a part says which campaign, case, batch and schedule it belongs to


class Parquet:
    """Parquet files, which pandas, polars and others read as one table."""

    def write(self, path: Path, columns: Columns, text: str) -> None:
        """Write columns and a text about them; same data, same bytes."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        encoded = {
            name: pa.array(values.tolist(), pa.string()) if values.dtype.kind == "U" else values
            for name, values in columns.items()
        }
        pq.write_table(pa.table(encoded).replace_schema_metadata({KEY: text}), path, write_page_checksum=True)

    def read(self, path: Path, names: Sequence[str] | None = None) -> Columns:
        """Some columns, or all of them."""
        with self._opened(path) as file:
            table = file.read(columns=None if names is None else list(names))
        return {name: table[name].to_numpy() for name in table.column_names}

    def check(self, path: Path) -> tuple[str, int]:
        """Return the text and the number of rows, once all of it has been read against its checksums."""
        with self._opened(path) as file:
            table = file.read()
        return (table.schema.metadata or {})[KEY.encode()].decode(), table.num_rows

    @contextmanager
    def _opened(self, path: Path) -> Iterator[Any]:
        """Open a file whose columns are not larger than they may be; a damaged one is a `ValueError`."""
        import pyarrow as pa
        import pyarrow.parquet as pq

        try:
            with open_regular(path, LARGEST) as stream:
                file = pq.ParquetFile(stream, page_checksum_verification=True)
                if file.metadata.num_rows * file.metadata.num_columns > LARGEST // 8:
                    raise ValueError(f"{path.name}: its columns take more than {LARGEST} bytes")
                yield file
        except pa.ArrowException as error:
            raise ValueError(str(error)) from error


class Npz:
    """numpy's files, for installs without pyarrow."""

    def write(self, path: Path, columns: Columns, text: str) -> None:
        """Write columns and a text to a file, as `Parquet.write` does."""
        arrays: dict[str, Any] = {KEY: np.array(text), **columns}
        np.savez(path, **arrays)

    def read(self, path: Path, names: Sequence[str] | None = None) -> Columns:
        """Read columns of a file, as `Parquet.read` does."""
        arrays = read_arrays(path)
        return {name: arrays[name] for name in names or arrays if name != KEY}

    def check(self, path: Path) -> tuple[str, int]:
        """Check a file, as `Parquet.check` does; reading a zip file compares its checksums."""
        arrays = read_arrays(path)
        return str(arrays.pop(KEY)), len(next(iter(arrays.values())))


FORMATS: dict[str, Parquet | Npz] = {"parquet": Parquet(), "npz": Npz()}
"""Formats of tables by the endings of their files, the preferred one first."""


def usable(formats: Iterable[str] = FORMATS) -> str:
    """Return the first of some formats that this install can use; `ScenarioError` if it can use none."""
    for name in formats:
        if name != "parquet" or not unusable("pyarrow"):
            return name
    raise ScenarioError("format of the campaign", "parquet", f"it cannot be read: {unusable('pyarrow')}")
