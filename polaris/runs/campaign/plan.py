"""What a campaign is: its cases, runs and seeds, and the digest by which its results are recognised."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, cast

from ...model.checks import whole
from ...model.errors import ScenarioError
from ...model.version import version
from ...simulation.disturbances import Disturbance
from ...simulation.simulate import DISTURBANCES, INITIALS, Initial
from .batch import MODES, Task
from .cases import Case

FORMAT, VERSION = "polaris campaign", 1

BATCH = 250
"""Runs per task: enough to be worth sending, few enough to lose little with a worker."""


@dataclass(frozen=True)
class Plan:
    """A campaign, as its manifest keeps it.

    Attributes
    ----------
    cases : tuple of Case
    runs : int
        Per case and mode.
    seed : int
    batch : int
        Runs per task; another size is another campaign, for every batch has a seed of its own.
    modes : tuple of str
        ``polaris``, ``safety``, ``experimental``.
    initial, disturbance : str
        As in `polaris.simulate`.

    Raises
    ------
    ScenarioError
        If a value is not allowed.
    """

    cases: tuple[Case, ...]
    runs: int
    seed: int = 0
    batch: int = BATCH
    modes: tuple[str, ...] = ("polaris",)
    initial: Initial = "mixed"
    disturbance: Disturbance = "mixed"

    def __post_init__(self) -> None:
        whole("--runs", self.runs, 1)
        whole("--seed", self.seed, 0)
        whole("--batch", self.batch, 1)
        for name, given, allowed in (
            *(("--mode", mode, tuple(MODES)) for mode in self.modes),
            ("--initial", self.initial, INITIALS),
            ("--disturbance", self.disturbance, DISTURBANCES),
        ):
            if given not in allowed:
                raise ScenarioError(name, given, f"must be one of {', '.join(allowed)}")
        if not self.modes or len(set(self.modes)) < len(self.modes):
            raise ScenarioError("--mode", list(self.modes), "must name at least one mode, each once")
        if not self.cases:
            raise ScenarioError("cases", [], "must hold at least one")

    @property
    def batches(self) -> int:
        """Tasks per case."""
        return -(-self.runs // self.batch)

    @property
    def digest(self) -> str:
        """SHA-256 of all that the results hang on but the number of runs, which may grow."""
        data = self.data()
        del data["runs"]
        text = json.dumps(data, sort_keys=True, ensure_ascii=True)
        return hashlib.sha256(text.encode()).hexdigest()

    def task(self, case: int, batch: int) -> Task:
        """One task.

        Raises
        ------
        ScenarioError
            If there is no such case or batch.
        """
        if not 0 <= case < len(self.cases):
            raise ScenarioError("--case", case, f"must be from 0 to {len(self.cases) - 1}")
        if not 0 <= batch < self.batches:
            raise ScenarioError("--batch", batch, f"must be from 0 to {self.batches - 1}")
        runs = min(self.batch, self.runs - batch * self.batch)
        text = self.cases[case].text
        return Task(case, batch, text, runs, self.seed, self.modes, self.initial, self.disturbance, version())

    def tasks(self) -> Iterator[Task]:
        """All tasks, one case after the other."""
        for case in range(len(self.cases)):
            for batch in range(self.batches):
                yield self.task(case, batch)

    def data(self) -> dict[str, Any]:
        """Plain data, from which `from_data` makes the same plan."""
        cases = [
            {"scenario": case.scenario, "parameters": dict(case.parameters), "toml": case.text}
            for case in self.cases
        ]
        return {
            "format": FORMAT,
            "format_version": VERSION,
            "version": version(),
            "runs": self.runs,
            "seed": self.seed,
            "batch": self.batch,
            "modes": list(self.modes),
            "initial": self.initial,
            "disturbance": self.disturbance,
            "cases": cases,
        }

    @classmethod
    def from_data(cls, data: dict[str, Any]) -> Plan:
        """The plan of a manifest; raises ValueError, KeyError or TypeError if it is none."""
        if data.get("format") != FORMAT or data.get("format_version") != VERSION:
            raise ValueError(f"not a {FORMAT} of version {VERSION}")
        cases = tuple(
            Case(str(item["scenario"]), tuple(item["parameters"].items()), str(item["toml"]))
            for item in data["cases"]
        )
        modes = tuple(str(mode) for mode in data["modes"])
        return cls(
            cases,
            data["runs"],
            data["seed"],
            data["batch"],
            modes,
            cast(Initial, data["initial"]),
            cast(Disturbance, data["disturbance"]),
        )
