"""Wall time from a scenario to a run folder, by stage, and its growth.

python benchmarks/pipeline.py            # both tables
python benchmarks/pipeline.py --part run # process start to run folder
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from polaris.scenario.scenario import load_scenario
from polaris.synthesis.safety.get_safety import get_safety
from polaris.synthesis.schedule.synthesize import synthesize


def timed(code: list[str]) -> float:
    start = time.perf_counter()
    subprocess.run([sys.executable, *code], check=True, capture_output=True)
    return time.perf_counter() - start


def runs(repeats: int) -> None:
    importing = min(timed(["-c", "import polaris"]) for _ in range(repeats))
    print(f"import polaris: {importing:.2f} s (interpreter included)")
    print(
        f"{'scenario':<12}{'bounds':>8}{'plan':>8}{'recover.':>9}{'schedule':>9}"
        f"{'sum - plan':>11}{'process':>9}   [s]"
    )
    for name in ("static", "dynamic", "keep_out", "hold_point", "robot"):
        best, total = None, float("inf")
        for _ in range(repeats):
            with tempfile.TemporaryDirectory() as folder:
                out = Path(folder) / name
                elapsed = timed(["-m", "polaris", "run", name, "--out", str(out), "--quiet"])
                stages = json.loads((out / "summary.json").read_text())["synthesis"]["seconds"]
            if elapsed < total:
                best, total = stages, elapsed
        others = sum(best[k] for k in ("bounds", "recoverable", "schedule"))
        row = "".join(
            f"{best[k]:>{w}.3f}" for k, w in (("bounds", 8), ("plan", 8), ("recoverable", 9), ("schedule", 9))
        )
        print(f"{name:<12}{row}{others:>11.3f}{total:>9.2f}", flush=True)


def growth() -> None:
    print(
        f"\n{'K':>5}{'obstacles':>10}{'bounds':>8}{'plan':>8}{'recover.':>9}{'schedule':>9}{'share':>8}   [s]"
    )
    base = load_scenario("static")
    for K, count in [(30, 1), (60, 1), (120, 1), (240, 1), (60, 2), (60, 4), (60, 8)]:
        boxes = [base.to_dict()["obstacles"][0]]
        for i in range(1, count):
            # further bodies on either side of the transfer, in the way of other paths but not of all
            boxes.append(
                {
                    "kind": "box",
                    "name": f"body_{i}",
                    "half_widths_m": [15.0, 15.0, 15.0],
                    "center_m": [200.0 + 25.0 * (i % 3), 330.0 - 60.0 * i, 40.0 * (-1) ** i],
                }
            )
        scenario = base.with_overrides({"horizon.step_s": 1800.0 / K, "obstacles": boxes})
        safety = get_safety(scenario)
        schedule = synthesize(scenario, safety, scenario.controllers(safety))
        t = schedule.seconds
        print(
            f"{K:>5}{count:>10}{t['bounds']:>8.3f}{t['plan']:>8.3f}{t['recoverable']:>9.3f}{t['schedule']:>9.3f}"
            f"{schedule.share():>8.1%}",
            flush=True,
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--part", choices=["run", "growth", "all"], default="all")
    parser.add_argument("--repeats", type=int, default=3)
    options = parser.parse_args()
    if options.part in ("run", "all"):
        runs(options.repeats)
    if options.part in ("growth", "all"):
        growth()
