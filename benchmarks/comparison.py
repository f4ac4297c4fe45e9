"""The tables of ``docs/comparison.md``, and the sweep of options beside it, from which its defaults follow.

    python -m benchmarks.comparison              print them
    python -m benchmarks.comparison --write      put them, the sweep and the figures into the page

One default per method is used on all scenes. It is chosen by `chosen` from the sweep: of the values with the
fewest violations on all scenes together, those whose deviation from U's input is within two per cent of the
least (as a mean over the scenes of its ratio to the best value of each); of these, the one with the largest
share of U. The monitor changes nothing but who flies: of its values, the one that is worth most at the
scenarios' own prices (as a mean over the scenes). Where another value does better on one scene alone, that
scene's table has a row for it.
"""

from __future__ import annotations

import argparse
import csv
import io
import re
import shutil
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np

from docs.generate.method_docs import PAGE, put
from polaris.report.figures import draw_run
from polaris.rta.arena import compare_methods
from polaris.rta.decision_grid import DecisionGrid
from polaris.rta.method import BUFFER, Method, Option
from polaris.rta.method_result import MethodResult
from polaris.rta.methods import METHODS
from polaris.runs.comparison import write_comparison
from polaris.scenario.scenario import load_scenario
from polaris.synthesis.schedule.schedule import Schedule
from polaris.synthesis.schedule.synthesize import synthesize

SCENES = ("static", "dynamic", "robot")
RUNS, SWEPT_RUNS = 30, 30
SWEEP = PAGE.parent / "figures" / "comparison-sweep.csv"
SWEEP_COLUMNS = ("options", "values", "default", "scene", "violations", "share_of_u", "delta_v_m_s",
                 "deviation", "switches", "objective")  # fmt: skip
FIGURES = {"static": ("paths", "tradeoffs"), "dynamic": ("tradeoffs",)}

MONITORS = ("monitor", "monitor_declared")


def groups(key: str, one: type[Method]) -> Iterable[tuple[Option, ...]]:
    """Options of a method that are swept together: each alone for the monitor, else all combinations."""
    if key in MONITORS:
        return [(option,) for option in one.options] if key == "monitor" else []
    return [one.options] if one.options else []


SWEPT = {
    f"{key}.{', '.join(option.name for option in options)}": options
    for key, one in METHODS.items()
    for options in groups(key, one)
}
VALUES = {name: list(product(*(option.values for option in options))) for name, options in SWEPT.items()}
BETTER = 0.98
"""Deviations that differ by less are alike; a scene's own value gets a row if it is better by more."""
DEARER = 0.01
"""Worths that differ by less are alike."""
MORE = 0.02
"""Shares of U that differ by less are alike, where deviations are alike."""


Values = tuple[float, ...]
"""Of options that are swept together."""


@dataclass(frozen=True)
class Cell:
    """Result of one value of one option on one scene: means over the runs.

    Of methods that change nothing but who flies, the worth at the scenario's prices too.
    """

    violations: int
    share: float
    delta_v: float
    deviation: float
    switches: float = np.nan
    objective: float = np.nan

    def __str__(self) -> str:
        hit = f"**{self.violations} hit**, " if self.violations else ""
        extra = (
            f"; {self.switches:.1f} switches, worth {self.objective:.4f}"
            if np.isfinite(self.objective)
            else ""
        )
        return f"{hit}{100 * self.share:.1f} %, {self.delta_v:.4g}, {self.deviation:.4g}{extra}"


def scaled(scene: DecisionGrid, option: Option, value: float) -> float:
    """Return a value of the sweep in the option's own unit."""
    duration = scene.last * scene.h
    units = {"per duration": 1 / duration, "of the duration": duration, BUFFER.unit: scene.half_width}
    return value * units.get(option.unit, 1.0)


def tuning(scene: DecisionGrid, full: str, values: Values) -> dict[str, float]:
    """Values of options that are swept together, as `compare_methods` takes them."""
    key, pairs = full.partition(".")[0], zip(SWEPT[full], values, strict=True)
    return {f"{key}.{option.name}": scaled(scene, option, value) for option, value in pairs}


def standing(scene: DecisionGrid, method: Method, option: Option) -> float:
    """Return what a method was tuned with, in the sweep's units: the inverse of `scaled`."""
    return method.settings[option.name] / scaled(scene, option, 1.0)


def label(full: str, values: Values) -> str:
    """Values of options that are swept together, with their units."""
    return ", ".join(
        f"{value:g} {option.unit}".strip() for option, value in zip(SWEPT[full], values, strict=True)
    )


Sweep = dict[str, dict[Values, dict[str, Cell]]]
"""By options, values and scene."""


def sweep(schedules: Mapping[str, Schedule], runs: int, options: Iterable[str] = tuple(SWEPT)) -> Sweep:
    """Compare methods with every value of every option on every scene."""
    swept: Sweep = {}
    for full in options:
        key = full.partition(".")[0]
        swept[full] = {value: {} for value in VALUES[full]}
        for name, schedule in schedules.items():
            scene = DecisionGrid.from_schedule(schedule)
            for value in VALUES[full]:
                tuned = tuning(scene, full, value)
                one = compare_methods(schedule, runs, 0, methods=(key,), tuning=tuned).results[key]
                m = one.metrics
                share, delta_v = float(m.experimental_share.mean()), float(m.delta_v.mean())
                cell = Cell(int(m.collided.sum()), share, delta_v, float(one.deviation.mean()))
                if key == "monitor":
                    switches = float(m.switches.mean())
                    objective = schedule.objective({0: 1 - share, 1: share}, delta_v, switches)
                    cell = replace(cell, switches=switches, objective=objective)
                swept[full][value][name] = cell
                print(f"  {full} = {label(full, value)} on {name}: {cell}", flush=True)
    return swept


def chosen(values: Mapping[Values, Mapping[str, Cell]]) -> Values:
    """Return the best value on all scenes that are given: see the top of the file."""
    scenes = next(iter(values.values()))
    hits = {value: sum(cell.violations for cell in cells.values()) for value, cells in values.items()}
    safest = {value: cells for value, cells in values.items() if hits[value] == min(hits.values())}
    objective = {value: sum(cell.objective for cell in cells.values()) for value, cells in safest.items()}
    if np.isfinite(max(objective.values())):
        return max(safest, key=objective.__getitem__)
    minima = {name: min(cells[name].deviation for cells in safest.values()) for name in scenes}
    cost = {
        value: float(np.mean([cell.deviation / minima[name] for name, cell in cells.items()]))
        for value, cells in safest.items()
    }
    closest = [value for value in safest if cost[value] <= min(cost.values()) / BETTER]
    return max(closest, key=lambda value: sum(cell.share for cell in safest[value].values()))


def own(values: Mapping[Values, Mapping[str, Cell]], name: str) -> Values | None:
    """Return the value that is better on one scene alone, if there is one that is worth a row."""
    default = chosen(values)
    local = chosen({value: {name: cells[name]} for value, cells in values.items()})
    ours, theirs = values[default][name], values[local][name]
    nearer = theirs.deviation < BETTER * ours.deviation
    better = theirs.objective > ours.objective + DEARER if np.isfinite(ours.objective) else nearer
    better = better or theirs.violations < ours.violations or theirs.share > ours.share + MORE
    return local if better else None


def sweep_table(swept: Sweep) -> str:
    """Return the sweep as CSV: a row per values of options and scene, marked where they are the default."""
    buffer = io.StringIO()
    rows = csv.writer(buffer, lineterminator="\n")
    rows.writerow(SWEEP_COLUMNS)
    for full, values in swept.items():
        default = chosen(values)
        for value, cells in values.items():
            for name, cell in cells.items():
                numbers = (f"{cell.share:.3f}", f"{cell.delta_v:.4g}", f"{cell.deviation:.4g}")
                extra = (
                    (f"{cell.switches:.1f}", f"{cell.objective:.4f}")
                    if np.isfinite(cell.objective)
                    else ("", "")
                )
                mark = "yes" if value == default else "no"
                rows.writerow((full, label(full, value), mark, name, cell.violations, *numbers, *extra))
    return buffer.getvalue()


def read_sweep(table: str) -> tuple[Sweep, dict[str, Values]]:
    """Return the sweep of a CSV text, and the values that it marks as defaults."""
    swept: Sweep = {}
    defaults = {}
    for row in csv.DictReader(io.StringIO(table)):
        value = tuple(float(one.split()[0]) for one in row["values"].split(", "))
        means = (float(row[key] or np.nan) for key in SWEEP_COLUMNS[5:])
        cells = swept.setdefault(row["options"], {}).setdefault(value, {})
        cells[row["scene"]] = Cell(int(row["violations"]), *means)
        if row["default"] == "yes":
            defaults[row["options"]] = value
    return swept, defaults


COLUMNS = ("Method", "Violations", "Least distance m", "Share of U", "Switches", "Delta-v m/s", "Deviation")


def row(name: str, one: MethodResult) -> str:
    """One method in a scene's table."""
    summary = one.summary()

    def mean(metric: str) -> str:
        part = summary[metric]
        half = (part["high"] - part["low"]) / 2
        return f"{part['mean']:.4g}" + (f" ± {half:.1g}" if half > 1e-9 else "")

    cells = [
        name,
        f"{summary['violations']['mean']}",
        f"{summary['min_distance_m']['worst']:.3g}",
        *(mean(metric) for metric in ("experimental_share", "switches", "delta_v_m_s")),
        f"{summary['deviation']['mean']:.4g}",
    ]
    return "| " + " | ".join(cells) + " |"


def scene_table(schedule: object, runs: int, tuned: Mapping[str, Values]) -> tuple[str, object]:
    """All methods on one scene, those with a value of this scene's own twice."""
    scene = DecisionGrid.from_schedule(schedule)
    comparison = compare_methods(schedule, runs, 0)
    lines = ["| " + " | ".join(COLUMNS) + " |", "|---" * len(COLUMNS) + "|"]
    for key, one in comparison.results.items():
        lines.append(row(one.name, one))
        for full in (full for full in tuned if full.partition(".")[0] == key):
            own_tuning = tuning(scene, full, tuned[full])
            other = compare_methods(schedule, runs, 0, methods=(key,), tuning=own_tuning).results[key]
            names = full.partition(".")[2]
            lines.append(row(f"{one.name}, {names} = {label(full, tuned[full])}", other))
    return "\n".join(lines), comparison


def blocks(text: str) -> dict[str, str]:
    """Return the generated parts of the page, by name."""
    return dict(re.findall(r"<!-- table ([\w-]+) -->\n\n(.*?)\n\n<!-- end -->", text, flags=re.S))


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--write", action="store_true", help="put tables and figures into the page")
    parser.add_argument("--runs", type=int, default=RUNS, help="per method and scene")
    parser.add_argument("--swept-runs", type=int, default=SWEPT_RUNS, help="per value and scene")
    options = parser.parse_args(arguments)
    scenarios = {name: load_scenario(name) for name in SCENES}
    schedules = {name: synthesize(scenario) for name, scenario in scenarios.items()}
    swept = sweep(schedules, options.swept_runs)
    text = sweep_table(swept)
    print(f"\nsweep\n\n{text}")
    if options.write:
        SWEEP.write_text(text, encoding="utf-8")
    tables = {}
    for name, schedule in schedules.items():
        own_values = {key: own(values, name) for key, values in swept.items()}
        tuned = {key: value for key, value in own_values.items() if value is not None}
        tables[name], comparison = scene_table(schedule, options.runs, tuned)
        if options.write and name in FIGURES:
            with tempfile.TemporaryDirectory() as place:
                folder = write_comparison(Path(place) / "one", scenarios[name], comparison, draw=draw_run)
                for figure in FIGURES[name]:
                    target = PAGE.parent / "figures" / f"comparison-{name}-{figure}.png"
                    shutil.copyfile(folder.path / "figures" / f"{figure}.png", target)
    text = PAGE.read_text(encoding="utf-8")
    for name, table in tables.items():
        print(f"\n{name}\n\n{table}")
        text = put(text, name, table) if options.write else text
    if options.write:
        PAGE.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
