"""Metrics of traces as tables."""

import math
import sys
from collections.abc import Sequence
from typing import Any

from rich.console import Console
from rich.text import Text

from ...model.checks import counted
from ...traces.evaluation import Separation, Spread, TraceMetrics
from ...traces.legacy import Legacy, Raises
from . import print_line, show_table, table, warning_text


def show_metrics(metrics: TraceMetrics) -> None:
    """Print the results of `polaris.traces.evaluate_trace`, as tables."""
    axes = "" if metrics.dims is None else f", {counted(metrics.dims, 'axis', 'axes')}"
    for name, agent in metrics.agents.items():
        print_line(f"{name}: {counted(agent.samples, 'sample')} over {agent.duration:.6g} s{axes}", "bold")
        if agent.unsafe or agent.others:
            _show_separations((*agent.unsafe, *agent.others))
            print_line(f"velocity: {agent.velocity}")
        else:
            print_line("no keep-out zone, no other agent")
        shares = ", ".join(f"{mode} {share:.1%}" for mode, share in agent.usage.items() if share > 0)
        print_line(f"share of time: {shares}; switches: {agent.switches}")
        if agent.running_times is not None:
            mean, largest, least = agent.running_times
            print_line(f"decision: mean {mean:.3g} s, max {largest:.3g} s, min {least:.3g} s")
    for note in metrics.notes:
        print_line(f"note: {note}")


QUANTITIES = (("distance", "distance [m]"), ("ttc", "TTC, straight [s]"), ("drift_ttc", "TTC, drift [s]"))


def _show_separations(items: Sequence[Separation]) -> None:
    grid = table("to", "quantity", "min", "mean", "max", "min at [s]", "on course", words=2, wrap=1)
    titles = [f"{item.name} ({item.kind})" for item in items]
    for item, name in zip(items, titles, strict=True):
        title = Text(name)
        if item.distance is None:
            grid.add_row(title, "never there at the same time")
            title = Text("")
        for key, quantity in QUANTITIES:
            spread: Spread | None = getattr(item, key)
            if spread is None:
                continue
            values = (spread.min, spread.mean, spread.max, spread.at)
            texts = ["-" if math.isnan(value) else f"{value:.5g}" for value in values]
            course = "" if key == "distance" else f"{spread.share:.1%}"
            grid.add_row(title, Text(quantity), warning_text(texts[0], spread.min <= 0), *texts[1:], course)
            title = Text("")
    longest, word = (max(map(len, names)) for names in (titles, " ".join(titles).split()))
    show_table(grid, Console(width=sys.maxsize).measure(grid).maximum - longest + word)


LEGACY_FORMS = {
    "controllerUsage": "untrusted, safety, switches",
    "compute_dists": "min, max, mean per set",
    "compute_agent_dists": "min, max, mean per agent",
    "compute_unsafe_TTC": "min, max, mean per set",
    "compute_agent_TTC": "min, max, mean per agent",
    "running_times": "avg, max, min",
}


def show_legacy(agents: Legacy) -> None:
    """Print the values of RTAEval's methods, in their order."""
    for name, methods in agents.items():
        print_line(f"{name}: as RTAEval computes it, defects included", "bold")
        rows = [(method, LEGACY_FORMS[method], Text(_text(value))) for method, value in methods.items()]
        show_table(table("method", "returns", "value", words=3, rows=rows))


def _text(value: Any) -> str:
    if isinstance(value, Raises):
        return str(value)
    if isinstance(value, dict):
        return "{" + ", ".join(f"{name}: {_text(item)}" for name, item in value.items()) + "}"
    if isinstance(value, tuple):
        return ", ".join(_text(item) for item in value)
    return f"{value:.6g}"
