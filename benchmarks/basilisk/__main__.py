"""Proven schedules flown in Basilisk, an independent simulation of spacecraft.

    pip install '.[basilisk]'
    python -m benchmarks.basilisk                          static, dynamic, hold_point, 200 flights each
    python -m benchmarks.basilisk static --flights 20 --set thrusters.magnitude_error=0.1

Each scene is synthesised with feedback every two seconds and the errors below, written as a run folder, and
flown by flight software that reads the folder (`onboard.py`) in a world of two craft (`world.py`): J2, drag,
pulsed thrusters with errors of magnitude, direction and mass, noisy navigation, commands a period late,
everything drawn within what the scenario declares. The table sets what was measured beside what was proven.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from polaris.runs.schedule import fly_schedule, write_run
from polaris.runs.stages import Stages
from polaris.scenario.scenario import load_scenario
from polaris.simulation.orbit.environment import Environment
from polaris.simulation.orbit.frame import near_circular
from polaris.simulation.run_metrics import Runs, evaluate
from polaris.simulation.simulate import initial_states

from .onboard import FlightSoftware, held
from .world import Errors, Flight, absolute, fly, inertial

SCENES = ("static", "dynamic", "hold_point")
REAL = (
    "feedback.kind=sampled",
    "feedback.period_s=2",
    "navigation.position_error_m=0.05",
    "navigation.velocity_error_m_s=0.002",
    "timing.delay_s=2",
    "thrusters.pulse=centred",
    "thrusters.remainder=carried",
    "thrusters.impulse_bit_N_s=0.005",
    "thrusters.magnitude_error=0.05",
    "thrusters.misalignment_deg=2",
    "thrusters.mass_error=0.03",
)
"""What every scene is synthesised with, unless told otherwise."""


@dataclass(frozen=True)
class Row:
    """One scene's flights: the worst of each, beside what was proven."""

    scene: str
    flights: int
    share: float  # of time under experimental controllers
    violations: int  # flights that entered an unsafe set
    distance: float  # least to any unsafe set [m]
    tube: float  # largest share of the proven tube's half-widths, any state, any instant
    thrust: float  # largest share of the limits that S commands: 1 is proven never to be exceeded
    residual: float  # largest share of w_max that the linear model left out
    away: float  # from the target where it did [m]
    seen: float  # largest share of the declared error of navigation
    delta_v: float  # mean [m/s]


def draw(scenario: Any, rng: np.random.Generator) -> Errors:
    """Errors of one flight: in half of them magnitudes and directions at the edge of what is declared."""
    navigation, thrusters = scenario.model.navigation, scenario.model.thrusters
    edge = rng.random() < 0.5
    share = rng.choice([-1.0, 1.0], 6) if edge else rng.uniform(-1, 1, 6)
    axis = rng.normal(size=3)
    turn = (
        (1.0 if edge else rng.random()) * np.radians(thrusters.misalignment_deg) * axis / np.linalg.norm(axis)
    )
    return Errors(
        float(np.min(navigation.position_error_m)),
        float(np.min(navigation.velocity_error_m_s)),
        tuple(1 + thrusters.magnitude_error * share),
        tuple(turn),
        1 + thrusters.mass_error * float(rng.choice([-1.0, 1.0]) if edge else rng.uniform(-1, 1)),
    )


def residuals(system: Any, flight: Flight, mass: float) -> np.ndarray:
    """Norm of the acceleration [m/s^2] that the linear model leaves out, mean over each control period."""
    h = float(flight.times[1] - flight.times[0])
    half = held(system.A, system.B, h / 2)[0]
    pulses = flight.impulse @ system.B.T + flight.spread / 2 @ (system.A @ system.A @ system.B).T
    expected = flight.states[:-1] @ (half @ half).T + pulses / mass @ half.T
    return np.asarray(np.linalg.norm((flight.states[1:] - expected)[:, 3:], axis=1) / h)


def numbers(value: Any) -> np.ndarray:
    """Arrays of a certificate, whose numbers are hexadecimal."""
    return np.array([[float.fromhex(x) for x in row] for row in value])


def scene(name: str, flights: int, folder: Path, settings: list[str], seed: int = 0) -> Row:
    """Synthesise, write, fly and judge one scene."""
    scenario = load_scenario(name, settings)
    schedule = fly_schedule(scenario, Stages()).schedule
    write_run(folder, scenario, schedule)
    system, env, rng = scenario.system(), Environment.of(scenario), np.random.default_rng(seed)
    proven = json.loads((folder / "certificate.json").read_text())
    lower, upper = (numbers(proven["enclosures"][side]) for side in ("lower", "upper"))
    modes = np.asarray(schedule.modes)
    flown, worst, away = [], dict.fromkeys(("tube", "thrust", "residual", "seen"), 0.0), 0.0
    noisy = np.array(system.timing.measured or system.navigation)
    starts = initial_states(schedule, flights, rng, "mixed")
    for i in range(flights):
        software, errors = FlightSoftware(folder), draw(scenario, rng)
        latitude = rng.uniform(0, 2 * np.pi)
        tilt = rng.uniform(0, 1) * (env.inclination_max - 1e-3)
        target = inertial(env, latitude, near_circular(env, np.array(latitude), np.array(tilt)))
        other = env.ballistic + rng.choice([-1.0, 1.0]) * env.ballistic_difference
        bodies, area = (target, absolute(target, starts[i])), (env.ballistic, other)
        flight = fly(software, env, system.mass, bodies, area, errors, len(modes) * software.step, seed + i)
        flown.append(flight)
        q = round(software.step / software.period)
        per_node = np.minimum(np.arange(len(flight.states)) // q, len(modes) - 1)
        middle, half = (upper + lower)[per_node] / 2, (upper - lower)[per_node] / 2
        safe = modes[per_node[:-1]] == 0
        shares = {
            "tube": np.abs(flight.states - middle) / half,
            "thrust": np.abs(flight.asked)[safe] / system.u_max,
            "residual": residuals(system, flight, errors.mass) / system.w_max,
            "seen": np.abs(flight.seen - flight.states[:-1])[:, noisy > 0] / noisy[noisy > 0],
        }
        if shares["residual"].max() > worst["residual"]:
            away = float(np.linalg.norm(flight.states[shares["residual"].argmax(), :3]))
        for what, share in shares.items():
            worst[what] = max(worst[what], float(np.max(share, initial=0.0)))
    states = np.array([flight.states for flight in flown])
    asked = np.array([flight.asked for flight in flown])
    change = np.abs(asked).sum(axis=(1, 2)) * software.period / system.mass
    limits = (np.abs(asked) / system.u_max).max(axis=2)
    runs = Runs(schedule, flown[0].times, states, asked, limits, change, modes)
    found = evaluate(runs, seed)
    return Row(
        name,
        flights,
        float(np.mean(modes > 0)),
        int(np.sum(found.collided)),
        float(np.min(found.min_distance)),
        delta_v=float(change.mean()),
        away=away,
        **worst,
    )


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scenes", nargs="*", default=SCENES)
    parser.add_argument("--flights", type=int, default=200)
    parser.add_argument(
        "--set", action="append", default=[], help="a scenario field, as `polaris run` takes it"
    )
    parser.add_argument("--out", type=Path, help="where to keep the run folders")
    given = parser.parse_args()
    columns = "scene", "flights", "U", "entered", "least distance [m]", "tube", "thrust of S", "residual"
    print("| " + " | ".join([*columns, "at [m]", "navigation", "m/s"]) + " |\n" + "|---" * 11 + "|")
    with tempfile.TemporaryDirectory() as scratch:
        for name in given.scenes:
            row = scene(name, given.flights, (given.out or Path(scratch)) / name, [*REAL, *given.set])
            per_cent = [row.share, row.tube, row.thrust, row.residual, row.seen]
            share, *shares = (f"{100 * x:.0f} %" for x in per_cent)
            shares.insert(3, f"{row.away:.0f}")
            cells = [f"`{name}`", str(row.flights), share, str(row.violations), f"{row.distance:.2f}"]
            print("| " + " | ".join([*cells, *shares, f"{row.delta_v:.2f}"]) + " |", flush=True)


if __name__ == "__main__":
    main()
