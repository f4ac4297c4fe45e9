"""Account of the effort and time that a run of the planner has used, and limits on the rest."""

from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter

import numpy as np

from .problem import PlannerOptions, Progress, Stage, relative_gap
from .search import Candidate, PathSearch

Spare = Callable[[Candidate | None], bool]
"""Function that returns True if a stage may be given up early with the path known by then."""


SPARE_SHARE = 0.25
"""Share of the effort left for a stage that can be given up: looking for a first path with the full
margin, and proving that no larger margin exists once a path is known."""


@dataclass(frozen=True)
class Allowance:
    """Limits of a stage: counts of linear programs or nodes, and values of `time.perf_counter`.

    The first of each holds where the stage is `spare`: it may be given up with the path known by then.
    """

    effort: tuple[float, float]
    deadline: tuple[float, float]
    spare: Spare

    def limit_reached(self, path: Candidate | None, used: float) -> str:
        """Return the name of the limit that stops the stage, or an empty string."""
        index = 0 if self.spare(path) else 1
        if used >= self.effort[index]:
            return "effort_limit"
        return "time_limit" if perf_counter() > self.deadline[index] else ""


class SearchEffort:
    """Account of one run: wall time by part [s], counts (`Plan.stats`), and stages so far."""

    def __init__(self, search: PathSearch, options: PlannerOptions, start: float) -> None:
        self.search, self.options, self.start = search, options, start
        self.seconds: dict[str, float] = {}
        self.stats = dict.fromkeys(("rows", "cols", "binaries", "nodes", "rounds", "lps"), 0.0)
        self.stages: list[Stage] = []
        self._last_report = -np.inf

    @property
    def remaining_s(self) -> float:
        """Seconds left."""
        return self.search.deadline - perf_counter()

    @property
    def used(self) -> float:
        """Effort so far: linear programs, or nodes of the back end."""
        return self.search.solves if self.options.solver == "facets" else self.stats["nodes"]

    @property
    def cut_by_clock(self) -> tuple[str, ...]:
        """Stages that the clock ended early; past the deadline, any linear program may have been."""
        cut = tuple(stage.name for stage in self.stages if stage.status == "time_limit")
        return cut or (("path search",) if self.remaining_s <= 0 else ())

    def allow(self, share: float, spare: Spare) -> Allowance:
        """A share of the effort left; `SPARE_SHARE` of it where the stage is spare."""
        options, used, shares = self.options, self.used, np.array([SPARE_SHARE, share])
        limit = options.max_linear_programs if options.solver == "facets" else options.max_nodes
        ends = [perf_counter() + (each * self.remaining_s if each else 0.0) for each in shares.tolist()]
        effort = used + shares * max(limit - used, 0.0)
        return Allowance(tuple(effort.tolist()), (ends[0], ends[1]), spare)

    def report(self, stage: str, incumbent: float = np.inf, bound: float = -np.inf) -> None:
        """Tell the progress callback, a few times a second at most."""
        now = perf_counter()
        if self.options.progress is not None and now - self._last_report > 0.1:
            self._last_report = now
            gap = relative_gap(incumbent, bound)
            self.options.progress(Progress(stage, now - self.start, incumbent, bound, gap))

    def add_time(self, part: str, start: float) -> None:
        """Add the wall time since `start` to a part."""
        self.seconds[part] = self.seconds.get(part, 0.0) + perf_counter() - start
