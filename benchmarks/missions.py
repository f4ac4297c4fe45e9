"""Published missions beside what Polaris proves of them: the table and the pictures of docs/missions.md.

    python -m benchmarks.missions [NAME ...]     print rows of the table
    python -m benchmarks.missions --write        put rows and pictures into the documentation as well

Each mission is a file of scenarios/missions. Its run folder is written, read by the independent checker and
drawn. Published figures are constants of this file, with their sources in the scenario files.
"""

from __future__ import annotations

import argparse
import shutil
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from polaris.certificate.checker import verify
from polaris.model.scene.state_limits import SpeedLimit
from polaris.model.system import LinearSystem
from polaris.report.figures import draw_run
from polaris.report.figures.style import new_figure, save_all, style
from polaris.report.scene.palette import BLACK, RED, VERMILION, tint
from polaris.runs.run import read_run
from polaris.runs.schedule import write_run
from polaris.scenario.scenario import load_scenario
from polaris.simulation.baselines import ControllerRuns, compare
from polaris.synthesis.schedule.synthesize import synthesize

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "scenarios" / "missions"
PAGE = ROOT / "docs" / "missions.md"
BEGIN, END = "<!-- missions -->\n", "<!-- /missions -->"
HEADS = (
    *(
        "Mission",
        "Published [m/s]",
        "Ours, mean [m/s]",
        "largest",
        "proven at most",
        "Proven safe",
        "U flies",
    ),
    *("Switches", "Least distance [m], U alone", "under the schedule", "Synthesis [CPU-s]", "Checker"),
)

PUBLISHED = {  # velocity change [m/s]; None where the source prints none
    "sroc-leg1": 0.458,  # two impulses, sum of 2-norms
    "keep-out-sphere": None,
    "adras-j": None,
    "afrl-docking": 45.3,  # measured with the authors' code: thrust over mass, sum of 2-norms
    "arch-rendezvous": None,
}


@dataclass(frozen=True)
class Mission:
    """Results of one mission: its name, the summary of its run, the checker's answer, and CPU time [s]."""

    name: str
    summary: Mapping[str, Any]
    checked: str
    seconds: float

    @property
    def row(self) -> str:
        """Return the row of the table."""
        claim, metrics = self.summary["guarantee"], self.summary["polaris"]
        published, u_alone = PUBLISHED[self.name], self.summary["experimental"]
        until = "for all time" if claim["horizon"] == "infinite" else f"until {claim['until_s']:.0f} s"
        cells = (
            f"[`{self.name}`](#{self.name})",
            "none" if published is None else f"{published:g}",
            f"{metrics['delta_v_m_s']:.3f}",
            f"{metrics['delta_v_max_m_s']:.3f}",
            f"{claim['goal']['delta_v_max_m_s']:.3f}",
            until if claim["kind"] == "proved" else claim["kind"],
            f"{100 * self.summary['synthesis']['experimental_share']:.1f} %",
            str(metrics["switches"]),
            f"{distance(u_alone)}, {u_alone['collided_runs']} of {u_alone['runs']} runs enter",
            distance(metrics),
            f"{self.seconds:.0f}",
            self.checked,
        )
        return f"| {' | '.join(cells)} |"


def distance(metrics: Mapping[str, Any]) -> str:
    """Return the least distance [m] to an unsafe set, or "none" where no place is unsafe, only a speed."""
    return "none" if metrics["min_distance_m"] is None else f"{metrics['min_distance_m']:.1f}"


def run(name: str, out: Path, draw: bool = False) -> Mission:
    """Synthesise, fly and check one mission, and write its run folder."""
    start = time.process_time()
    scenario = load_scenario(FOLDER / f"{name}.toml")
    schedule = synthesize(scenario)
    seconds = time.process_time() - start
    runs = compare(schedule, scenario.simulation.runs, scenario.simulation.seed)
    folder = write_run(out / name, scenario, schedule, runs)
    checked = verify(folder.path).outcome
    if draw:
        draw_run(read_run(folder.path))
        by_distance = [one for one in scenario.obstacles() if getattr(one, "per_distance", 0.0)]
        if by_distance:
            draw_speeds(schedule.safety.problem.system, by_distance[0], runs, folder.path / "figures")
    return Mission(name, folder.summary, checked, seconds)


def draw_speeds(
    system: LinearSystem, limit: SpeedLimit, runs: Mapping[str, ControllerRuns], folder: Path
) -> None:
    """Draw speed over distance, with its limit, in the place of the scene: U alone and under the schedule."""
    with style():
        figure = new_figure(2.4)
        ax = figure.add_subplot()
        top = 1.0
        looks = {"experimental": ("U alone", VERMILION), "polaris": ("under the schedule", BLACK)}
        for key, (label, colour) in looks.items():
            states = runs[key].flights.states[0]  # the nominal flight
            distances = np.linalg.norm(states @ system.position.T, axis=1)
            speed = np.linalg.norm(states @ system.velocity.T, axis=1)
            ax.loglog(distances, speed, color=colour, lw=1.0, label=label)
            top = max(top, distances.max())
        distances = np.geomspace(0.1, top, 200)
        allowed = limit.top + limit.per_distance * distances
        ax.loglog(distances, allowed, color=RED, lw=1.0, ls="--", label="limit")
        ax.fill_between(distances, allowed, 1e3, color=tint(RED, 0.16), lw=0)
        ax.set(xlim=(0.1, top), ylim=(1e-3, 100.0), xlabel="Distance (m)", ylabel="Speed (m/s)")
        ax.legend(loc="lower right")
        ax.grid(True)
    save_all([("scene", figure)], folder)


def table(rows: Mapping[str, str]) -> str:
    """Return the table of missions from their rows."""
    head = f"| {' | '.join(HEADS)} |"
    lines = [rows[name] for name in PUBLISHED if name in rows]
    return "\n".join((head, "|---" * len(HEADS) + "|", *lines)) + "\n"


def page_rows() -> dict[str, str]:
    """Return the rows of the page by mission."""
    text = PAGE.read_text(encoding="utf-8").split(BEGIN)[1].split(END)[0]
    return {row.split("`")[1]: row for row in text.splitlines() if row.startswith("| [`")}


def main(arguments: Sequence[str] | None = None) -> None:
    """Print rows, or write them."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join(PUBLISHED))
    parser.add_argument("--write", action="store_true", help="put rows and pictures into the documentation")
    options = parser.parse_args(arguments)
    if unknown := set(options.names) - set(PUBLISHED):
        parser.error(f"unknown missions: {', '.join(sorted(unknown))}")
    for name in options.names or PUBLISHED:
        with tempfile.TemporaryDirectory() as folder:
            row = run(name, Path(folder), options.write).row
            print(row, flush=True)
            if options.write:
                picture = Path(folder) / name / "figures" / "scene.png"
                shutil.copyfile(picture, PAGE.parent / "figures" / f"mission-{name}.png")
                before, tail = PAGE.read_text(encoding="utf-8").split(BEGIN)
                page = before + BEGIN + table(page_rows() | {name: row}) + END + tail.split(END)[1]
                PAGE.write_text(page, encoding="utf-8")


if __name__ == "__main__":
    main()
