"""Metrics of traces as tables."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any

from rich.console import Console
from rich.table import Table
from rich.text import Text

from .evaluation import AgentMetrics, Separation, Spread, TraceMetrics
from .legacy import LegacyMetrics, Raises


def show_trace(found: TraceMetrics, console: Console | None = None) -> None:
    """Print the metrics of every agent, and what to know about them."""
    console = console or Console(highlight=False)
    axes = "" if found.dims is None else f", {found.dims} axes"
    for name, agent in found.agents.items():
        heading = f"{name}: {agent.samples} samples over {agent.duration:.6g} s{axes}"
        console.print(Text(heading, style="bold"), soft_wrap=True)
        if agent.unsafe or agent.others:
            console.print(_separations((*agent.unsafe, *agent.others)))
            console.print(Text(f"velocity: {agent.velocity}"), soft_wrap=True)
        else:
            console.print(Text("no unsafe set, no other agent"))
        console.print(Text(_controllers(agent)), soft_wrap=True)
        if agent.running_times is not None:
            mean, most, least = agent.running_times
            console.print(Text(f"decision: mean {mean:.3g} s, max {most:.3g} s, min {least:.3g} s"))
    for note in found.notes:
        console.print(Text(f"note: {note}"), soft_wrap=True)


def _controllers(agent: AgentMetrics) -> str:
    shares = ", ".join(f"{mode} {share:.1%}" for mode, share in agent.usage.items() if share > 0)
    return f"share of time: {shares}; switches: {agent.switches}"


def _separations(rows: Iterable[Separation]) -> Table:
    table = Table(box=None, pad_edge=False, header_style="bold")
    table.add_column("to")
    table.add_column("what")
    heads = ("distance min", "mean", "max", "TTC min", "mean", "max", "drift TTC min", "mean", "max")
    rows = list(rows)
    drifting = any(row.drift_ttc is not None for row in rows)
    for head in heads if drifting else heads[:6]:
        table.add_column(head, justify="right")
    for row in rows:
        cells = [*_cells(row.distance, "m"), *_cells(row.ttc, "s")]
        cells += _cells(row.drift_ttc, "s") if drifting else []
        inside = row.distance is not None and row.distance.min < 0
        table.add_row(Text(row.name, style="bold red" if inside else ""), row.kind, *cells)
    return table


def _cells(spread: Spread | None, unit: str) -> list[str]:
    if spread is None:
        return ["-"] * 3
    return [_number(value, unit) for value in (spread.min, spread.mean, spread.max)]


def _number(value: float, unit: str) -> str:
    return f"{value:.4g} {unit}" if math.isfinite(value) else str(value)


# -- the numbers of RTAEval -------------------------------------------------------------------------

LEGACY_FORMS = {
    "controllerUsage": "untrusted, safety, switches",
    "compute_dists": "min, max, mean per set",
    "compute_agent_dists": "min, max, mean per agent",
    "compute_unsafe_TTC": "min, max, mean per set",
    "compute_agent_TTC": "min, max, mean per agent",
    "running_times": "avg, max, min",
}


def show_legacy(found: LegacyMetrics, console: Console | None = None) -> None:
    """Print what RTAEval's methods return, in their order."""
    console = console or Console(highlight=False)
    for name, methods in found.agents.items():
        console.print(Text(f"{name}: as RTAEval computes it, defects included", style="bold"), soft_wrap=True)
        table = Table(box=None, pad_edge=False, header_style="bold")
        for head in ("method", "returns", "value"):
            table.add_column(head)
        for method, value in methods.items():
            table.add_row(method, LEGACY_FORMS[method], Text(_shown(value)))
        console.print(table)


def _shown(value: Any) -> str:
    if isinstance(value, Raises):
        return str(value)
    if isinstance(value, dict):
        return "{" + ", ".join(f"{name}: {_shown(item)}" for name, item in value.items()) + "}"
    if isinstance(value, tuple):
        return ", ".join(_shown(item) for item in value)
    return f"{value:.6g}"
