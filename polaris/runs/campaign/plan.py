"""Plan of a campaign: its cases, runs and seeds, and the digest by which its results are recognised."""

import hashlib
import itertools
import json
import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from reach.short_repr import short_repr

from ...model.checks import whole
from ...model.errors import ScenarioError
from ...model.version import version
from ...scenario.base import parse_assignment
from ...scenario.scenario import Scenario, ScheduleScenario, load_scenario
from ...synthesis.controllers.black_box import Ask
from .batch import CampaignRuns, Case, Task
from .inspections import InspectionRuns
from .schedules import Boxes, ScheduleRuns

FORMAT, VERSION = "polaris campaign", 3

KINDS: dict[str, type[CampaignRuns]] = {kind.name: kind for kind in (ScheduleRuns, InspectionRuns)}
"""Kinds of run by the name in a manifest."""

BATCH = 250  # runs per task: enough to be worth sending, few enough to lose little with a worker


@short_repr
@dataclass(frozen=True)
class CampaignPlan:
    """A campaign, as its manifest keeps it.

    Attributes
    ----------
    cases : tuple of Case
        From `make_cases`.
    runs : int
        Per case and mode.
    seed : int
        Same seed and cases, same runs, whoever flies them.
    batch : int
        Runs per task; another size is another campaign, for every batch has a seed of its own.
    kind : CampaignRuns
        Kind of flights of a batch; by default runs of schedules.

    Raises
    ------
    ScenarioError
        If a value is not allowed.
    """

    cases: Sequence[Case]
    runs: int
    seed: int = 0
    batch: int = BATCH
    kind: CampaignRuns = ScheduleRuns()

    def __post_init__(self) -> None:
        whole("--runs", self.runs, 1)
        whole("--seed", self.seed, 0)
        whole("--batch", self.batch, 1)
        if not self.cases:
            raise ScenarioError("cases", [], "must hold at least one")
        if isinstance(self.kind, ScheduleRuns):
            for case in self.cases:
                self.kind.check_case(case.text, case.label)

    @property
    def batches(self) -> int:
        """Tasks per case."""
        return -(-self.runs // self.batch)

    @property
    def digest(self) -> str:
        """SHA-256 of all that the results hang on but the number of runs, which may grow."""
        data = self.data()
        del data["runs"]
        return hashlib.sha256(json.dumps(data, sort_keys=True, ensure_ascii=True).encode()).hexdigest()

    def asking(self, boxes: Mapping[str, Ask] | None) -> "CampaignPlan":
        """Return the plan with functions that ask black boxes, by their names: this process alone flies it.

        No manifest knows more of them than that; to go on, or to fly a run again, give them again.
        """
        if not boxes:
            return self
        if not isinstance(self.kind, ScheduleRuns):
            raise ScenarioError("black box", list(boxes), "must belong to a scenario of a schedule")
        return replace(self, kind=replace(self.kind, boxes=Boxes(boxes)))

    def task(self, case: int, batch: int) -> Task:
        """One task; `ScenarioError` if there is no such case or batch."""
        if not 0 <= case < len(self.cases):
            raise ScenarioError("--case", case, f"must be from 0 to {len(self.cases) - 1}")
        if not 0 <= batch < self.batches:
            raise ScenarioError("--batch", batch, f"must be from 0 to {self.batches - 1}")
        first = batch * self.batch
        runs = min(self.batch, self.runs - first)
        return Task(self.kind, case, batch, self.cases[case].text, first, runs, self.seed, version())

    def tasks(self) -> Iterator[Task]:
        """All tasks, one case after the other."""
        for case in range(len(self.cases)):
            for batch in range(self.batches):
                yield self.task(case, batch)

    def parameter_types(self) -> dict[str, type]:
        """Type of the column of each key of the grid: the same in all parts."""
        values: dict[str, set[type]] = {}
        for case in self.cases:
            for key, value in case.parameters:
                values.setdefault(key, set()).add(type(value))
        exact = ({bool}, {int})
        return {
            key: types.pop() if types in exact else float if types <= {int, float} else str
            for key, types in values.items()
        }

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
            "kind": self.kind.name,
            "runs": self.runs,
            "seed": self.seed,
            "batch": self.batch,
            **self.kind.data(),
            "cases": cases,
        }

    @classmethod
    def from_data(cls, data: dict[str, Any]) -> "CampaignPlan":
        """Return the plan of a manifest; raises ValueError, KeyError or TypeError if it is none."""
        if data.get("format") != FORMAT or data.get("format_version") != VERSION:
            raise ValueError(f"not a {FORMAT} of version {VERSION}")
        cases = tuple(
            Case(str(item["scenario"]), tuple(item["parameters"].items()), str(item["toml"]))
            for item in data["cases"]
        )
        kind = KINDS[data["kind"]].from_data(data)
        return cls(cases, data["runs"], data["seed"], data["batch"], kind)


def make_cases(
    scenarios: Sequence[str | ScheduleScenario],
    grid: Mapping[str, Sequence[Any]] | None = None,
    overrides: Sequence[str] = (),
    boxes: Collection[str] | None = None,
) -> tuple[Case, ...]:
    """Combine every scenario with every combination of the grid's values.

    Parameters
    ----------
    scenarios : sequence of str or ScheduleScenario
        Names, paths, or scenarios already loaded.
    grid : mapping, optional
        Values by key, as in ``{"planner.extra_margin_m": [10, 20]}``; the last key changes fastest.
    overrides : sequence of str
        Texts ``key=value`` that hold in all cases.
    boxes : collection of str, optional
        Names of the black boxes that will be given; not checked by default.

    Raises
    ------
    ScenarioError
        If there is no such scenario, a value is not valid in it, two cases are the same, or one has other
        black boxes.
    """
    if isinstance(scenarios, (str, Scenario)):
        raise ScenarioError("scenarios", type(scenarios).__name__, "must be a list of scenarios, even of one")
    values = dict(grid or {})
    for key, choices in values.items():
        if not isinstance(choices, Sequence) or isinstance(choices, str):
            raise ScenarioError(f"--grid {key}", choices, "must be a list of values, even of one")
        if any(parse_assignment(text)[0] == key for text in overrides):
            raise ScenarioError("--grid", key, "must be left out of --set")
        if not choices or any(item in choices[:i] for i, item in enumerate(choices)):
            raise ScenarioError(f"--grid {key}", list(choices), "must have at least one value, each once")
    cases: list[Case] = []
    for scenario in scenarios:
        loaded = load_scenario(scenario, only=ScheduleScenario) if isinstance(scenario, str) else scenario
        common = dict(map(parse_assignment, overrides))
        for combination in itertools.product(*values.values()):
            chosen = dict(zip(values, combination, strict=True))
            changed = loaded.with_overrides({**common, **chosen})  # some need each other
            if boxes is not None:
                changed.check_black_boxes(boxes)
            cases.append(Case(loaded.name, tuple(chosen.items()), changed.text_elsewhere()))
    if len({case.text for case in cases}) < len(cases) or not cases:
        raise ScenarioError("scenarios", [case.label for case in cases], "must be different cases")
    return tuple(cases)


def parse_grid(texts: Sequence[str]) -> dict[str, list[Any]]:
    """Values by key from texts ``key=v1,v2,...``; values as for ``--set``, commas in brackets kept."""
    grid: dict[str, list[Any]] = {}
    for text in texts:
        key, equals, value_text = text.partition("=")
        key = key.strip()
        if not equals or not key or not value_text.strip():
            raise ScenarioError("--grid", text, "must be key=value,value,...")
        if key in grid:
            raise ScenarioError("--grid", key, "must be given once")
        grid[key] = [parse_assignment(f"{key}={part}")[1] for part in _split(value_text)]
    return grid


def _split(text: str) -> list[str]:
    """Parts between commas that stand outside brackets and quotes."""
    parts = [""]
    for piece in text.split(","):
        bare = re.sub(r"\"[^\"]*\"|'[^']*'", "", parts[-1])
        quoted = any(bare.count(mark) % 2 for mark in "\"'")
        if quoted or bare.count("[") > bare.count("]") or bare.count("{") > bare.count("}"):
            parts[-1] += f",{piece}"
        else:
            parts.append(piece)
    return parts[1:]
