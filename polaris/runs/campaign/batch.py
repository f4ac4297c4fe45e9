"""One task of a campaign, and the contribution of a kind of run; only text and plain arrays travel."""

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from itertools import zip_longest
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np

from reach.short_repr import short_repr

from ...model.errors import NoAnswer, PolarisError
from ...model.system import Array
from ...model.version import version
from ..files.atomic import check_file, replacing_file
from ..files.tables import write_csv

Columns = dict[str, Array]  # results by name, one entry per run: one mode after the other


@dataclass(frozen=True)
class Case:
    """One scenario with one combination of values, flown many times."""

    scenario: str  # its name
    parameters: tuple[tuple[str, Any], ...]  # keys of the grid and their values here
    text: str  # the whole scenario as TOML, overrides and parameters applied

    @property
    def label(self) -> str:
        """Name of the case in tables: ``static, planner.extra_margin_m=20``."""
        settings = [f"{key}={x:g}" if isinstance(x, float) else f"{key}={x}" for key, x in self.parameters]
        return ", ".join([self.scenario, *settings])


@dataclass(frozen=True)
class Task:
    """One batch of runs of one case (TOML); a worker with another `version` of this package refuses."""

    kind: "CampaignRuns"
    case: int
    batch: int
    text: str
    first: int
    runs: int
    seed: int
    version: str


@short_repr
@dataclass(frozen=True, eq=False)
class Replayed:
    """One run of a campaign, flown again."""

    arrays: Mapping[str, Any]  # its trajectory by the names arrays have in an ``.npz`` file, units included
    table: Mapping[str, Array]  # the same as columns: those of periods are one shorter than of instants
    row: Mapping[str, Any] = field(default_factory=dict)  # what the campaign's table says of it

    def write(self, path: str | Path, *, force: bool = False) -> Path:
        """Write the trajectory as CSV or ``.npz``, whole or not at all; `ScenarioError` if it cannot be.

        A file that is there is replaced by `force` only.
        """
        target = check_trajectory(path, force)
        with replacing_file(target, force=force) as draft:
            if target.suffix == ".npz":
                np.savez(draft, **self.arrays)
            else:
                rows = zip_longest(*(values.tolist() for values in self.table.values()))
                write_csv(draft, [dict(zip(self.table, row, strict=True)) for row in rows])
        return target


def check_trajectory(path: str | Path, force: bool = False) -> Path:
    """Return a path, once it is clear that a trajectory may be written there, as CSV or ``.npz``."""
    return check_file(path, endings=(".csv", ".npz"), force=force)


@dataclass(frozen=True, eq=False)
class Batch:
    """Result of a task: columns, shapes (modes * runs,), or the reason why its case cannot be flown.

    All batches of a case must agree on `schedule`, the SHA-256 of what the schedule that flies does.
    """

    schedule: str
    columns: Columns
    failure: str = ""
    code: int = 0  # exit code of the failure
    trajectory: Replayed | None = None


@dataclass(frozen=True)
class CampaignRuns(ABC):
    """Kind of run of a campaign, as plain data. Every run is flown once by each of the `modes`."""

    modes: tuple[str, ...]

    name: ClassVar[str]  # by which a manifest knows it
    ranking: ClassVar[str]  # column by which its runs are ranked, the least first; empty if they are not

    def data(self) -> dict[str, Any]:
        """Options on which results hang, as plain data for the manifest."""
        return vars(self) | {"modes": list(self.modes)}

    @classmethod
    def from_data(cls, data: Mapping[str, Any]) -> Self:
        """Return the kind that a manifest describes."""
        options = {field.name: data[field.name] for field in fields(cls)}
        return cls(**options | {"modes": tuple(map(str, data["modes"]))})

    @abstractmethod
    def fly(self, task: Task, mode: str, run: int | None = None) -> Batch:
        """Fly and measure one mode of a batch, the same in every process, with the trajectory of `run`."""

    @abstractmethod
    def summarise(self, folder: Any, worst: int) -> dict[str, Any]:
        """Contents of ``summary.json`` of a `CampaignFolder`, with `worst` runs at most per case and mode."""


def fly_batch(task: Task) -> Batch:
    """Fly one batch, in whatever process; `PolarisError` if that has another version of the package."""
    if task.version != version():
        rule = f"a worker has Polaris {version()}, the campaign {task.version}"
        raise PolarisError(f"{rule}; install the same version everywhere")
    try:
        parts = [task.kind.fly(task, mode) for mode in task.kind.modes]
    except NoAnswer:
        raise  # another time it may go well
    except PolarisError as error:
        return Batch("", {}, str(error), error.exit_code)
    return Batch(parts[0].schedule, joined([part.columns for part in parts]))


def joined(parts: Sequence[Columns]) -> Columns:
    """Return the rows of several parts, one after the other."""
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def of_mode(columns: Mapping[str, Array], mode: str) -> Columns:
    """Return the rows of one mode."""
    return {name: values[columns["mode"] == mode] for name, values in columns.items()}
