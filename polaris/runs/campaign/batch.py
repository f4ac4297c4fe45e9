"""One task of a campaign, and what a kind of run brings to it: flying a batch, statistics, replay.

A task is text and numbers, its result plain arrays: nothing else travels between processes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

from ...model.errors import PolarisError
from ...model.system import Array
from ...model.version import version


@dataclass(frozen=True)
class Case:
    """One scenario with one combination of values, flown many times.

    Attributes
    ----------
    scenario : str
        Name of the scenario.
    parameters : tuple of (str, value)
        Keys of the grid and their values here.
    text : str
        The whole scenario as TOML, overrides and parameters applied.
    """

    scenario: str
    parameters: tuple[tuple[str, Any], ...]
    text: str

    @property
    def label(self) -> str:
        """What tables call it: ``static, planner.extra_margin_m=20``."""
        return ", ".join([self.scenario, *(f"{key}={_shown(value)}" for key, value in self.parameters)])


def _shown(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


@dataclass(frozen=True)
class Task:
    """One batch of runs of one case.

    Attributes
    ----------
    kind : Kind
        Flies it.
    case, batch : int
        Numbers, counted from 0.
    text : str
        Scenario as TOML.
    first : int
        Number of its first run in the case.
    runs : int
        Runs per mode.
    seed : int
        Of the campaign.
    version : str
        Of this package; a worker that has another refuses.
    """

    kind: Kind
    case: int
    batch: int
    text: str
    first: int
    runs: int
    seed: int
    version: str


@dataclass(frozen=True, eq=False)
class Batch:
    """What became of a task.

    Attributes
    ----------
    schedule : str
        SHA-256 of what the schedule that flies does, on which all batches of a case must agree; may be empty.
    columns : dict of str to ndarray, shapes (modes * runs,)
        One entry per run: one mode after the other.
    failure : str
        Why the case cannot be flown; else empty.
    code : int
        Exit code of that.
    """

    schedule: str
    columns: dict[str, Array]
    failure: str = ""
    code: int = 0


@dataclass(frozen=True, eq=False)
class Results:
    """A finished campaign, as statistics see it.

    Attributes
    ----------
    cases : tuple of Case
    runs, seed, batch : int
        As in `CampaignPlan`.
    failures : dict of int to dict
        Cases that cannot be flown, with ``message`` and ``exit_code``.
    read : callable
        Columns of all runs of a case, by its number and their names (None: all), in order.
    """

    cases: tuple[Case, ...]
    runs: int
    seed: int
    batch: int
    failures: Mapping[int, Mapping[str, Any]]
    read: Callable[[int, Sequence[str] | None], dict[str, Array]]


@dataclass(frozen=True, eq=False)
class Trajectory:
    """One run of a batch in full.

    Attributes
    ----------
    arrays : dict of str to ndarray
        By the names they have in an ``.npz`` file, units included.
    table : dict of str to ndarray
        The same as columns of a table; those of control periods are one shorter than those of instants.
    """

    arrays: Mapping[str, Any]
    table: Mapping[str, Array]


class Kind(Protocol):
    """What a kind of run brings to a campaign; plain data, for it travels with every task."""

    name: ClassVar[str]
    """By which a manifest knows it."""

    formats: ClassVar[tuple[str, ...]]
    """What its tables may be kept in, the preferred one first; see `FORMATS`."""

    ranking: ClassVar[str]
    """Column by which its runs are ranked, the least first; empty if they are not."""

    @property
    def modes(self) -> tuple[str, ...]:
        """Who flies; every run is flown once by each."""
        ...

    def data(self) -> dict[str, Any]:
        """Options on which results hang, as plain data for the manifest."""
        ...

    @classmethod
    def from_data(cls, data: Mapping[str, Any]) -> Kind:
        """The same kind from a manifest."""
        ...

    def fly_batch(self, task: Task) -> Batch:
        """Fly and measure one batch; bit for bit the same in every process."""
        ...

    def fly_again(self, task: Task, mode: str, run: int) -> tuple[Batch, Trajectory | None]:
        """Fly one mode of a batch again: its columns, and one of its runs; None if it cannot be flown."""
        ...

    def summarise(self, results: Results, worst: int) -> dict[str, Any]:
        """Contents of ``summary.json``, with at most `worst` of the worst runs per case and mode."""
        ...


def fly_batch(task: Task) -> Batch:
    """Fly one batch, in whatever process.

    Raises
    ------
    PolarisError
        If this process has another version of the package than the campaign.
    """
    if task.version != version():
        rule = f"a worker has version {version()} of this package, the campaign {task.version}"
        raise PolarisError(f"{rule}; install the same everywhere")
    return task.kind.fly_batch(task)
