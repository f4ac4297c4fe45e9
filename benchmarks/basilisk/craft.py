"""A craft with canted nozzles, a camera and valves that fail, flown in Basilisk: the bundled `cubesat`.

Its run folder is flown as it is. The observer has been at work on camera images for `WARM` periods when the
schedule begins. In every second flight a valve sticks, shut and open by turns, at an instant that is drawn,
for no longer than the scenario says; then it is isolated, and S flies on with the others. Every flight goes
on until the goal is proven to be reached, and is judged by what is proven of it: with a valve stuck no more
than that nothing is entered.
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import expm

from polaris.report.scene.timelines import proven_distance
from polaris.runs.run import read_run
from polaris.simulation.orbit.frame import near_circular
from polaris.synthesis.safety.goal_rows import distance, goal_rows

from .__main__ import Scene, kept_beside
from .onboard import CraftSoftware
from .valves import Stuck
from .world import Errors, Flight, absolute, fly, inertial

WARM = 50
"""Periods before the schedule in which the observer is at work; nothing is commanded then."""

HALF = 0.5
"""Share of the bounds on a settled observer's errors within which the first estimate is drawn."""


@dataclass(frozen=True)
class Flown:
    """One flight beside what was proven of it."""

    stuck: str  # kind of the valve's fault, or ""
    nozzle: int
    begins: float  # [s]
    lasts: float  # [s]
    distance: float  # least to any unsafe set [m], negative inside
    goal: float  # distance from the goal at the claimed time [m]
    delta_v: float  # of all nozzles until then [m/s]
    tube: float  # largest share of the proven tube's half-widths until a valve fails, any state
    thrust: float  # largest share of the limits that S commands
    residual: float  # largest share of w_max that the linear model leaves out in periods without a fault
    seen: float  # largest share of the camera's declared error


def errors_drawn(scenario: Any, nozzles: int, noise: float, rng: np.random.Generator) -> Errors:
    """Errors of one flight: in half of them magnitudes and directions at the edge of what is declared."""
    declared, edge = scenario.model.thrusters, rng.random() < 0.5
    share = rng.choice([-1.0, 1.0], nozzles) if edge else rng.uniform(-1, 1, nozzles)
    axis = rng.normal(size=3)
    angle = (1.0 if edge else rng.random()) * np.radians(declared.misalignment_deg)
    lighter = float(rng.choice([-1.0, 1.0]) if edge else rng.uniform(-1, 1))
    return Errors(
        position=noise,
        thrust=tuple(1 + declared.magnitude_error * share),
        tilt=tuple(angle * axis / np.linalg.norm(axis)),
        mass=1 + declared.mass_error * lighter,
    )


class CraftScene(Scene):
    """Run folder of a craft with a camera, a layout of nozzles and valves that may fail."""

    @cached_property
    def proven(self) -> dict[str, float]:
        """Least distance under the schedule; distance from the goal, tolerance, velocity change and when."""
        run = read_run(self.folder)
        promised, goal = proven_distance(run.plot_data()), run.json("schedule.json")["guarantee"]["goal"]
        assert promised is not None  # there is an unsafe set
        names = {"goal": "distance_m", "tolerance": "tolerance_m", "delta_v": "delta_v_max_m_s", "by": "by_s"}
        return {"distance": float(promised.min()), **{key: goal[name] for key, name in names.items()}}

    def stuck(self, seed: int, software: CraftSoftware, rng: np.random.Generator) -> Stuck | None:
        """Draw a valve that sticks in flights of odd numbers, at a node in half of them."""
        if seed % 2 == 0:
            return None
        kind, h = software.faults[seed // 2 % len(software.faults)], software.period
        lasts = next(fault["isolation_s"] for fault in software.scenario["faults"] if fault["kind"] == kind)
        begins = rng.uniform(0.0, len(self.modes) * software.step)
        begins = h * round(begins / h) if rng.random() < 0.5 else begins
        isolated = int((begins + lasts) / h + 1e-9)
        return Stuck(kind, int(rng.integers(len(software.tops))), begins, isolated)

    def fly_craft(self, seed: int) -> Flown:
        """One flight with all that is drawn from a seed: half of them start in corners of the initial set."""
        rng, env, theta = np.random.default_rng(seed), self.env, self.scenario.initial_set()
        software = CraftSoftware(self.folder)
        errors = errors_drawn(self.scenario, len(software.tops), float(software.noise.min()), rng)
        share = rng.uniform(-1, 1, theta.order_count)
        start = theta.c + theta.G @ (np.sign(share) if rng.random() < 0.5 else share)
        latitude = rng.uniform(0, 2 * np.pi)
        tilt = rng.uniform(0, 1) * (env.inclination_max - 1e-3)
        target = inertial(env, latitude, near_circular(env, np.array(latitude), np.array(tilt)))
        area = env.ballistic, env.ballistic + rng.choice([-1.0, 1.0]) * env.ballistic_difference
        stuck = self.stuck(seed, software, rng)
        estimate_error = HALF * software.settled * rng.uniform(-1, 1, 6)
        back = expm(-self.system.A * WARM * software.period)
        first = back @ start
        for aiming in (True, False):  # a coasting flight tells where to begin
            bodies = target, absolute(target, first)
            late = expm(-self.system.A * (software.period + software.delay))
            software = CraftSoftware(self.folder, self.code)
            software.estimate = late @ (first + estimate_error)
            duration = 0.0 if aiming else self.proven["by"]
            fault = None if aiming else stuck
            flight = fly(software, env, self.system.mass, bodies, area, errors, duration, seed, fault, WARM)
            first = first - back @ (flight.states[0] - start)
        return self.judge_craft(flight, software, errors.mass, stuck, rng)

    def judge_craft(
        self,
        flight: Flight,
        software: CraftSoftware,
        mass: float,
        stuck: Stuck | None,
        rng: np.random.Generator,
    ) -> Flown:
        """Set what was flown beside what was proven."""
        from .__main__ import residuals

        system, x, h = self.system, flight.states, software.period
        steps, per_step = len(self.modes), round(software.step / software.period)
        at = np.arange(len(x))
        per_node = np.minimum(at // per_step, steps - 1)
        middle, half = (self.upper + self.lower)[per_node] / 2, (self.upper - self.lower)[per_node] / 2
        fails, ends = (len(x), len(x)) if stuck is None else (int(stuck.begins / h), stuck.isolated)
        tube_share = (np.abs(x - middle) / half)[: min(fails, steps * per_step) + 1]
        ticks = at[:-1]
        safe = (ticks >= min(ends, steps * per_step)) | (self.modes[per_node[:-1]] == 0)
        calm = (ticks < fails) | (ticks >= ends)
        residual = residuals(system, flight, mass) / system.w_max
        problem = self.scenario.problem()
        rows, sides = goal_rows(problem)
        camera_error = (flight.seen - flight.shown) @ software.measures.T / software.noise
        return Flown(
            stuck.kind if stuck else "",
            stuck.nozzle if stuck else -1,
            stuck.begins if stuck else 0.0,
            stuck.isolated * h - stuck.begins if stuck else 0.0,
            self.distance(flight.times, x, rng),
            float(distance(problem.goal.conditions, x[-1:] @ rows.T - sides)[0]),
            float(flight.pushed.sum() / (system.mass * mass)),
            float(tube_share.max()),
            float(np.max(np.abs(flight.asked)[safe] / system.u_max, initial=0.0)),
            float(residual[calm].max()),
            float(np.abs(camera_error).max()),
        )


def table(scene: CraftScene, flights: list[Flown]) -> list[str]:
    """Return rows of figures of flights without a fault, and with a valve stuck either way."""
    proven, rows = scene.proven, []
    for kind, name in (("", "all valves work"), ("stuck_off", "stuck shut"), ("stuck_on", "stuck open")):
        group = [one for one in flights if one.stuck == kind]
        if not group:
            continue
        least, goal = min(one.distance for one in group), max(one.goal for one in group)
        reached = sum(one.goal <= proven["tolerance"] for one in group)
        delta_v = np.array([one.delta_v for one in group])
        cells = [name, str(len(group)), str(sum(one.distance <= 0 for one in group)), f"{least:.2f}"]
        cells += [f"{reached}", f"{goal:.2f}", f"{delta_v.mean():.2f}", f"{delta_v.max():.2f}"]
        cells += [
            f"{max(getattr(one, of) for one in group):.0%}" for of in ("tube", "thrust", "residual", "seen")
        ]
        rows.append("| " + " | ".join(cells).replace("%", " %") + " |")
    limits = [f"{proven['distance']:.2f}", "", f"{proven['goal']:.2f}", "", f"{proven['delta_v']:.2f}"]
    return [*rows, "| proven without a fault | | 0 | " + " | ".join(limits) + " |" + " 100 % |" * 4]


COLUMNS = (
    *("valves", "flights", "entered", "least distance [m]", "at the goal", "furthest from it [m]"),
    *("m/s", "at most", "tube", "thrust of S", "residual", "camera"),
)


def fly_scene(
    name: str, flights: int, folder: Path, settings: list[str], precision: str | None = None
) -> tuple[CraftScene, list[Flown]]:
    """Flights of a craft, a line each in a file beside its run folder; what is there is not flown again."""
    scene, log_file = CraftScene(name, folder, settings, precision), kept_beside(folder, precision)
    lines = log_file.read_text().splitlines() if log_file.is_file() else []
    with log_file.open("a") as file:
        for seed in range(len(lines), flights):
            lines.append(json.dumps(vars(scene.fly_craft(seed))))
            print(lines[-1], file=file, flush=True)
    if scene.code is not None:
        print(f"answers of the code by mode and fault: {dict(scene.code.answers)}", file=sys.stderr)
    return scene, [Flown(**json.loads(line)) for line in lines[:flights]]
