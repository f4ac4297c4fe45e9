"""Schedules along a reference planned with U in view, beside those of the printed algorithms.

    python -m benchmarks.schedules                    bundled scenarios
    python -m benchmarks.schedules static robot
    python -m benchmarks.schedules crowded            static, 120 steps long, with 8 obstacles that matter
    python -m benchmarks.schedules static --gains     the same with other gains of the safety controller
    python -m benchmarks.schedules --random 100       random scenes of the tests as well (some minutes)

For each scene: share of time under the experimental controllers, switches, mean velocity change of
simulated runs (of the middle of the tubes in random scenes), that of S alone, and whether the goal is proven
reached. Times are CPU seconds of the whole synthesis; the printed one is a part of it.
"""

from __future__ import annotations

import argparse
import time
import warnings
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from polaris.model.errors import PolarisError
from polaris.scenario.scenario import ScheduleScenario, load_scenario
from polaris.simulation.simulate import simulate
from polaris.synthesis.safety.get_safety import get_safety
from polaris.synthesis.schedule.schedule import Schedule
from polaris.synthesis.schedule.synthesize import synthesize

BUNDLED = ("static", "dynamic", "keep_out", "hold_point", "robot")
PRINTED = "recoverable.recourse=none"
RUNS = 100


def crowded(count: int = 8, steps: int = 120) -> ScheduleScenario:
    """`static` with more steps, and boxes strung along the way that U would fly, on either side in turn.

    The way is inside each box, 3 m from its nearer side.
    """
    longer = load_scenario("static").with_assignments([f"horizon.duration_s={30 * steps}"])
    path = get_safety(replace(longer.problem(), unsafe=())).reference.chi[: steps + 1, :3]
    boxes = []
    for i, k in enumerate(np.linspace(0.12 * steps, 0.62 * steps, count).astype(int)):
        tangent = path[k + 1] - path[k]
        normal = np.array([-tangent[1], tangent[0], 0.0]) / np.hypot(tangent[0], tangent[1])
        place = (path[k] + 12.0 * (-1) ** i * normal).round(1).tolist()
        boxes.append(
            f'{{kind="box", name="box-{i + 1}", center_m={place}, half_widths_m=[15.0, 15.0, 15.0]}}'
        )
    return longer.with_assignments([f"obstacles=[{', '.join(boxes)}]"])


def timed(scenario: ScheduleScenario) -> tuple[Schedule, float]:
    """Return the schedule, and the CPU time that it took [s]."""
    start = time.process_time()
    return synthesize(scenario), time.process_time() - start


def spent(schedule: Schedule, mode: int | None = None) -> float:
    """Mean velocity change of simulated runs [m/s]; of one controller alone with a mode."""
    return float(simulate(schedule, RUNS, 0, mode=mode).delta_v.mean())


def row(name: str) -> str:
    """Return a bundled scene: printed, and with U in view."""
    scenario = crowded() if name == "crowded" else load_scenario(name)
    printed, first = timed(scenario.with_assignments([PRINTED]))
    searched, total = timed(scenario)
    cells = [f"{name:11s}  S alone {spent(printed, 0):6.3f} m/s"]
    for schedule, seconds in ((printed, first), (searched, total)):
        goal = schedule.arrival
        arrives = f"by {goal.by:.6g} s" if goal.by is not None else str(goal.reached)
        text = (
            f"{schedule.share():6.1%} {schedule.switches:3d} {spent(schedule):7.3f} m/s  goal {arrives:12s}"
        )
        cells.append(f"{text} {seconds:5.1f} s")
    return "  |  ".join(cells)


def gains(name: str) -> list[str]:
    """Compare gains of S: the weight R of thrust times some factors, one schedule each.

    Worth is that of the scene's own rules, in units of what the cheapest safe reference costs.
    """
    scenario = load_scenario(name)
    unit = synthesize(scenario.with_assignments([PRINTED])).safety.plan.delta_v
    weights, rules = np.asarray(scenario.to_dict()["tracking"]["R"]), scenario.switching_rules()
    lines = []
    for factor in (0.3, 1.0, 3.0, 10.0):
        trial = synthesize(scenario.set("tracking.R", (factor * weights).tolist()))
        objective = trial.share() - rules.delta_v_price * trial.delta_v[0] / unit
        objective -= rules.switch_price * trial.switches
        numbers = (
            f"{trial.share():6.1%} {trial.switches:3d} {trial.delta_v[0]:7.3f} m/s, worth {objective:.4f}"
        )
        lines.append(f"{name:11s} R x {factor:4g}  {numbers}")
    return lines


def random_scenes(count: int) -> str:
    """Compare the schedules of the first `count` random scenes that are proved."""
    from tests.polaris.random_scenarios import random_scenario

    pairs: list[tuple[Schedule, Schedule]] = []
    seed = 0
    with TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        while len(pairs) < count:
            path = Path(folder) / "scene.toml"
            path.write_text(random_scenario(seed), encoding="utf-8")
            seed += 1
            try:
                scenario = load_scenario(path)
                printed = synthesize(scenario.with_assignments([PRINTED]))
                if printed.guarantee == "proved":
                    pairs.append((printed, synthesize(scenario)))
            except PolarisError:
                continue
    fuel_of = [(old.safety.plan.delta_v, old.delta_v[0], new.delta_v[0]) for old, new in pairs]
    share = sum(new.share() >= old.share() for old, new in pairs)
    fuel = sum(new <= old * (1 + 1e-9) for _, old, new in fuel_of)
    ratio = np.median([new / alone for alone, _, new in fuel_of if alone > 0])
    goal = sum(new.arrival.reached is True for _, new in pairs)
    raised = sum(new.share() > old.share() for old, new in pairs)
    return (
        f"{count} random scenes (of {seed}): share at least the printed one's in {share} (more in {raised}),"
        f" velocity change at most its in {fuel}, median of (velocity change / S alone) {ratio:.2f},"
        f" goal proven in {goal}"
    )


def main() -> None:
    """Run it."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", default=[])
    parser.add_argument("--gains", action="store_true")
    parser.add_argument("--random", type=int, default=0, metavar="N")
    options = parser.parse_args()
    print("scene, S alone | printed: share, switches, velocity change, goal, time | the same in view")
    for name in options.names or BUNDLED:
        print(row(name), flush=True)
        for line in gains(name) if options.gains else ():
            print(line, flush=True)
    if options.random:
        print(random_scenes(options.random))


if __name__ == "__main__":
    main()
