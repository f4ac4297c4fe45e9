"""What the command line shows: progress on standard error, the result as a table."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from ..model.checks import counted
from ..synthesis.recoverable import directed

if TYPE_CHECKING:
    from rich.progress import Progress as Bar

    from ..planning.problem import Progress

PATIENCE = 1.0
"""Seconds a stage may take before it is shown."""


class Stages:
    """Shows stages that take longer than `PATIENCE`: live on a terminal, one line each when done.

    Parameters
    ----------
    quiet : bool
        Show nothing.
    """

    def __init__(self, quiet: bool = False) -> None:
        self.quiet = quiet
        self.console = Console(stderr=True, highlight=False)
        self.seconds: dict[str, float] = {}
        self._text, self._done = "", 0
        self._total: int | None = None
        self._lock = threading.Lock()
        self._bar: Bar | None = None

    @contextmanager
    def stage(self, name: str) -> Iterator[Stages]:
        """Time one stage, and show it if it takes long."""
        begun = time.perf_counter()
        with self._lock:
            self._text, self._done, self._total = name, 0, None
        timer = threading.Timer(PATIENCE, self._show)
        timer.daemon = True
        if not self.quiet and self.console.is_terminal:
            timer.start()
        try:
            yield self
        finally:
            timer.cancel()
            with self._lock:
                if self._bar is not None:
                    self._bar.stop()
                    self._bar = None
            self.seconds[name] = time.perf_counter() - begun
        if not self.quiet and self.seconds[name] > PATIENCE:
            self.console.print(Text(f"{name}: {self.seconds[name]:.1f} s"))

    def _show(self) -> None:
        from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

        columns = (
            SpinnerColumn(),
            TextColumn("{task.description}", markup=False),
            BarColumn(20),
            TimeElapsedColumn(),
        )
        with self._lock:
            if self._bar is None:
                self._bar = Progress(*columns, console=self.console, transient=True)
                self._bar.add_task(self._text, total=self._total, completed=self._done)
                self._bar.start()

    def note(self, text: str, done: int = 0, total: int | None = None) -> None:
        """Say what the stage is doing, and how far it is if that is known."""
        with self._lock:
            self._text, self._done, self._total = text, done, total
            if self._bar is not None:
                task = self._bar.task_ids[0]
                self._bar.update(task, description=text, completed=done, total=total)

    # -- callbacks ------------------------------------------------------------------------------

    def planner(self, progress: Progress) -> None:
        """Callback of `polaris.planning.PlannerOptions`."""
        self.note(planner_line(progress))

    def steps(self, done: int, total: int) -> None:
        """Callback of `polaris.synthesize`."""
        self.note(f"schedule: step {done} of {total}", done, total)

    def runs(self, done: int, total: int) -> None:
        """Callback of `polaris.simulation.baselines.compare`."""
        self.note(f"simulation: {done} of {total} runs", done, total)


def planner_line(progress: Progress) -> str:
    """One line on how far the planner is."""
    parts = [f"plan: {progress.stage}"]
    if abs(progress.incumbent) < float("inf"):
        parts.append(f"best {progress.incumbent:.4g}")
    if abs(progress.bound) < float("inf"):
        parts.append(f"bound {progress.bound:.4g}")
    if abs(progress.gap) < float("inf"):
        parts.append(f"gap {progress.gap:.2%}")
    return ", ".join(parts)


# -- the result -------------------------------------------------------------------------------------


def show_summary(summary: Mapping[str, Any], folder: str, console: Console | None = None) -> None:
    """Print the metrics, the guarantee with its assumptions, and where the folder lies."""
    console = console or Console(highlight=False)
    console.print(Text(str(summary["title"]), style="bold"))
    console.print(_metrics_table(summary))
    synthesis, claim = summary["synthesis"], summary["guarantee"]
    seconds, plan = synthesis["seconds"], synthesis["planner"]
    stages = ", ".join(
        f"{name} {seconds[name]:.2f}"
        for name in ("bounds", "plan", "recoverable", "schedule")
        if name in seconds
    )
    reached = (
        f"{plan['delta_v_m_s']:.4g} m/s, clearance {directed(plan['margin_m'], '.4g')} m beyond the tube"
    )
    console.print(Text(f"Plan: {_planned(plan)}, {reached}."), soft_wrap=True)
    start, limit = synthesis["start_margin"], synthesis["start_limit"]
    if start is not None:
        console.print(Text(f"Start: {directed(start, '.1%')} of the room is left, least at {limit}."))
    console.print(Text(f"Synthesis: {seconds['total']:.2f} s ({stages})."))
    proved = claim["kind"] == "proved"
    style = "bold" if proved else "bold red"
    console.print(Text(f"Guarantee: {_claim(claim)}", style=style), soft_wrap=True)
    for assumption in claim["assumptions"] if proved else ():
        console.print(Text(f"  - {assumption}"), soft_wrap=True)
    console.print(Text(f"Run folder: {folder}"), soft_wrap=True)


def _planned(plan: Mapping[str, Any]) -> str:
    """How the planner ended, and who solved it."""
    gap = "" if plan["gap"] is None else f" with a gap of {plan['gap']:.2g}"
    ended = {
        "optimal": "optimal",
        "effort_limit": f"stopped at the limit of its effort{gap}",
        "time_limit": f"stopped by the clock{gap}",
    }[plan["status"]]
    return f"{ended} ({plan['solver_name']})"


def _claim(claim: Mapping[str, Any]) -> str:
    if claim["kind"] != "proved":
        return "none; this option is not sound, and nothing is proven"
    reach = {
        "infinite": "for all time",
        "one_period": f"until {claim['until_s'] or 0:.6g} s",
        "none": "up to the end of the schedule only",
    }[claim["horizon"]]
    return f"{claim['kind']}, safe {reach} ({claim['reason']}), assuming that"


def _metrics_table(summary: Mapping[str, Any]) -> Table:
    shown = [key for key in ("safety", "experimental", "polaris") if key in summary]
    titles = {"safety": "S alone", "experimental": "U alone", "polaris": "Polaris"}
    table = Table(box=None, pad_edge=False, header_style="bold")
    runs = summary[shown[-1]]["runs"]
    table.add_column(f"{counted(runs, 'simulated run')} each")
    for key in shown:
        table.add_column(titles[key], justify="right")
    rows = (
        ("least distance to an unsafe set", "min_distance_m", "{:.4g} m", "no unsafe set"),
        ("least time to collision, straight on", "min_ttc_s", "{:.4g} s", "none"),
        ("least time to collision, free drift", "min_ttc_free_drift_s", "{:.4g} s", "none"),
        ("share of experimental control", "experimental_share", "{:.1%}", ""),
        ("switches", "switches", "{:d}", ""),
        ("velocity change, mean", "delta_v_m_s", "{:.4g} m/s", ""),
        ("largest demand of thrust by S", "max_thrust_ratio_safety", "{:.1%}", "-"),
        ("largest demand of thrust by U", "max_thrust_ratio_experimental", "{:.1%}", "-"),
    )
    for title, key, form, absent in rows:
        values = [summary[who][key] for who in shown]
        table.add_row(title, *(absent if value is None else form.format(value) for value in values))
    hits = [int(summary[who]["collided_runs"]) for who in shown]
    table.add_row(
        "runs that enter an unsafe set",
        *(Text(str(count), style="bold red" if count else "") for count in hits),
    )
    return table
