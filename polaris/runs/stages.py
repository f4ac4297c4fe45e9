"""The stages of a piece of work: how long each took, and how far it is."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ..planning.problem import Progress


class Stages:
    """Times stages and shows nothing; the command line has one that shows them.

    Attributes
    ----------
    seconds : dict of str to float
        Wall time by stage; a stage named twice adds up.
    """

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self.start = time.perf_counter()

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time one stage."""
        start = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.perf_counter() - start

    def beside(self) -> Stages:
        """Return stages that show nothing and go on from here, to time parts of a stage that is under way."""
        stages = Stages()
        stages.seconds, stages.start = dict(self.seconds), self.start
        return stages

    def to_dict(self) -> dict[str, float]:
        """Return the seconds of every stage, those outside of all (``other``) and the sum (``total``)."""
        total = time.perf_counter() - self.start
        return {**self.seconds, "other": total - sum(self.seconds.values()), "total": total}

    def note(self, text: str, done: int = 0, total: int | None = None) -> None:
        """Take note of the stage's present work, and how far it is if that is known."""

    def counting(self, form: str) -> Callable[[int, int], None]:
        """Callback of a counter; `form` names the counted items, as in ``schedule: step {} of {}``."""
        return lambda done, total: self.note(form.format(done, total), done, total)

    def planner(self, progress: Progress) -> None:
        """Callback of `polaris.planning.PlannerOptions`."""
        self.note(planner_line(progress))


def planner_line(progress: Progress) -> str:
    """One line on how far the planner is."""
    forms = {"best {:.4g}": progress.incumbent, "bound {:.4g}": progress.bound, "gap {:.2%}": progress.gap}
    parts = [form.format(value) for form, value in forms.items() if abs(value) < float("inf")]
    return ", ".join([f"plan: {progress.stage}", *parts])
