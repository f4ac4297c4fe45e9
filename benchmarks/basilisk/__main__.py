"""Proven schedules flown in Basilisk, an independent simulation of spacecraft.

    pip install '.[basilisk]'
    python -m benchmarks.basilisk                          static, dynamic, hold_point, 200 flights each
    python -m benchmarks.basilisk static --flights 20 --set thrusters.magnitude_error=0.1
    python -m benchmarks.basilisk cubesat                  200 flights, a valve stuck in every second one
    python -m benchmarks.basilisk cubesat --code float     the same, flown by the C code

Each scene is synthesised with feedback every two seconds and the errors below, written as a run folder, and
flown by flight software that reads the folder (`onboard.py`) in a world of two craft (`world.py`): J2, drag,
pulsed thrusters with errors of magnitude, direction and mass, noisy navigation, commands a period late,
everything drawn within what the scenario declares. The table sets what was measured beside what was proven.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from polaris.certificate.code.text import PRECISIONS
from polaris.flight.export import export_c
from polaris.model.scene.distances import signed_distances
from polaris.model.scene.satellite import true_states
from polaris.runs.files.arrays import read_arrays
from polaris.runs.schedule import fly_schedule, write_run
from polaris.runs.stages import Stages
from polaris.scenario.scenario import load_scenario
from polaris.simulation.on_board import FlightCode
from polaris.simulation.orbit.environment import Environment
from polaris.simulation.orbit.frame import near_circular
from polaris.simulation.run_metrics import period_path

from .onboard import FlightSoftware, held
from .world import Errors, Flight, absolute, fly, inertial

SCENES = ("static", "dynamic", "hold_point")
REAL = (
    "feedback.period_s=2",
    "navigation.position_error_m=0.05",
    "navigation.velocity_error_m_s=0.002",
    "thrusters.impulse_bit_N_s=0.005",
    "thrusters.magnitude_error=0.05",
    "thrusters.misalignment_deg=2",
    "thrusters.mass_error=0.03",
    "timing.delay_s=2",
    "thrusters.pulse=centred",
    "thrusters.remainder=carried",
)
"""Overrides of every scene, unless others are given."""


@dataclass(frozen=True)
class Found:
    """One flight, or the worst of several, beside what was proven."""

    distance: float  # least to any unsafe set [m], negative inside
    tube: float  # largest share of the proven tube's half-widths, any state, any instant
    thrust: float  # largest share of the limits that S commands: 1 is proven never to be exceeded
    residual: float  # largest share of w_max that the linear model left out
    away: float  # from the target where it did [m]
    seen: float  # largest share of the declared error of navigation
    delta_v: float  # [m/s]

    @classmethod
    def worst(cls, flights: list[Found]) -> Found:
        """Return the worst of each value, and the mean velocity change."""
        columns = {name: [getattr(one, name) for one in flights] for name in cls.__dataclass_fields__}
        worst = {name: max(column) for name, column in columns.items()}
        at = columns["residual"].index(worst["residual"])
        others = {"distance": min(columns["distance"]), "away": columns["away"][at]}
        return cls(**worst | others | {"delta_v": float(np.mean(columns["delta_v"]))})


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


class Scene:
    """A run folder, and what its flights are judged by; it is written if it is not there."""

    def __init__(self, name: str, folder: Path, settings: list[str], precision: str | None = None) -> None:
        self.scenario, self.folder = load_scenario(name, settings), folder
        if not folder.is_dir():
            write_run(folder, self.scenario, fly_schedule(self.scenario, Stages()).schedule)
        if (folder / "scenario.toml").read_text() != self.scenario.copy_text():
            raise ValueError(f"{folder}: is of another scenario, or of other settings")
        self.system, self.env = self.scenario.system(), Environment.from_scenario(self.scenario)
        tubes = read_arrays(folder / "tubes.npz")
        half, intersample = (
            np.abs(tubes["generators"]).sum(axis=1).transpose(1, 0, 2),
            tubes["intersample"].max(axis=1),
        )
        self.lower = (tubes["center"] - half).min(axis=1) - intersample
        self.upper = (tubes["center"] + half).max(axis=1) + intersample
        self.modes = np.array(FlightSoftware.of(folder).modes)
        self.code = None
        if precision is not None:
            code = folder.with_name(f"{folder.name}-{precision}")
            export_c(folder, code, precision)
            self.code = FlightCode(code)

    def fly(self, seed: int) -> Found:
        """One flight with all that is drawn from a seed: half of them start in corners of the initial set."""
        rng, env, theta = np.random.default_rng(seed), self.env, self.scenario.initial_set()
        software, errors = FlightSoftware(self.folder, self.code), draw(self.scenario, rng)
        share = rng.uniform(-1, 1, theta.order_count)
        start = theta.c + theta.G @ (np.sign(share) if rng.random() < 0.5 else share)
        latitude = rng.uniform(0, 2 * np.pi)
        tilt = rng.uniform(0, 1) * (env.inclination_max - 1e-3)
        target = inertial(env, latitude, near_circular(env, np.array(latitude), np.array(tilt)))
        other = env.ballistic + rng.choice([-1.0, 1.0]) * env.ballistic_difference
        bodies, area = (target, absolute(target, start)), (env.ballistic, other)
        duration = len(self.modes) * software.step
        flight = fly(software, env, self.system.mass, bodies, area, errors, duration, seed)
        return self.judge(flight, round(software.step / software.period), errors.mass, rng)

    def judge(self, flight: Flight, periods: int, mass: float, rng: np.random.Generator) -> Found:
        """Set what was flown, so many control periods a step, beside what was proven."""
        system, x = self.system, flight.states
        per_node = np.minimum(np.arange(len(x)) // periods, len(self.modes) - 1)
        middle, half = (self.upper + self.lower)[per_node] / 2, (self.upper - self.lower)[per_node] / 2
        safe = self.modes[per_node[:-1]] == 0
        residual = residuals(system, flight, mass) / system.w_max
        noisy = np.array(system.timing.measured_error or system.navigation)
        error_share = np.abs(flight.seen - flight.shown)[:, noisy > 0] / noisy[noisy > 0]
        h = float(flight.times[1])
        return Found(
            self.distance(flight.times, x, rng),
            float(np.max(np.abs(x - middle) / half)),
            float(np.max(np.abs(flight.asked)[safe] / system.u_max, initial=0.0)),
            float(residual.max()),
            float(np.linalg.norm(x[residual.argmax(), :3])),
            float(error_share.max()),
            float(np.abs(flight.asked).sum() * h / system.mass),
        )

    def distance(self, times: np.ndarray, x: np.ndarray, rng: np.random.Generator) -> float:
        """Least to any unsafe set [m], along held inputs between the control periods."""
        h, s = times[1], np.linspace(0, 1, 8, endpoint=False)
        path = period_path(self.system, h, x[:-1], x[1:], s)[..., :3].reshape(1, -1, 3)
        instants = (times[:-1, None] + h * s).ravel()
        sets = self.scenario.obstacles()
        truth = true_states(sets, self.system, instants, 1, rng)
        return float(signed_distances(sets, instants, path, self.system, truth).min())


def kept_beside(folder: Path, precision: str | None) -> Path:
    """File of flights beside a run folder, of flight code or of its model in Python."""
    return folder.with_name(folder.name + (f"-{precision}" if precision else "") + ".jsonl")


def scene(
    name: str, flights: int, folder: Path, settings: list[str], precision: str | None = None
) -> list[Found]:
    """Flights of one scene, a line each in a file beside its run folder; what is there is not flown again."""
    case, log_file = Scene(name, folder, settings, precision), kept_beside(folder, precision)
    lines = log_file.read_text().splitlines() if log_file.is_file() else []
    with log_file.open("a") as file:
        for seed in range(len(lines), flights):
            lines.append(json.dumps(asdict(case.fly(seed))))
            print(lines[-1], file=file, flush=True)
    if case.code is not None:
        print(f"answers of the code by mode and fault: {dict(case.code.answers)}", file=sys.stderr)
    return [Found(**json.loads(line)) for line in lines[:flights]]


def fly_cubesat(flights: int, out: Path | None, settings: list[str], precision: str | None) -> None:
    """Fly the craft as it is built, and print a table of its flights."""
    from .craft import COLUMNS, fly_scene, table

    with tempfile.TemporaryDirectory() as scratch:
        folder = (out or Path(scratch)) / "cubesat"
        scene, records = fly_scene("cubesat", flights, folder, settings, precision)
        print("| " + " | ".join(COLUMNS) + " |\n" + "|---" * len(COLUMNS) + "|")
        print("\n".join(table(scene, records)))


def main() -> None:
    """Run what the command line asks for."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scenes", nargs="*", default=SCENES)
    parser.add_argument("--flights", type=int, default=200)
    parser.add_argument(
        "--set", action="append", default=[], help="a scenario field, as `polaris run` takes it"
    )
    parser.add_argument(
        "--code", choices=PRECISIONS, help="fly the exported C code, with numbers of this type"
    )
    parser.add_argument("--out", type=Path, help="where to keep run folders and flights")
    options = parser.parse_args()
    if "cubesat" in options.scenes:  # it declares errors itself, and has a table of its own
        options.scenes = [name for name in options.scenes if name != "cubesat"]
        fly_cubesat(options.flights, options.out, options.set, options.code)
        if not options.scenes:
            return
    columns = "scene", "flights", "U", "entered", "least distance [m]", "tube", "thrust of S", "residual"
    print("| " + " | ".join([*columns, "at [m]", "navigation", "m/s"]) + " |\n" + "|---" * 11 + "|")
    with tempfile.TemporaryDirectory() as scratch:
        for name in options.scenes:
            folder = (options.out or Path(scratch)) / name
            flights = scene(name, options.flights, folder, [*REAL, *options.set], options.code)
            share = np.mean(np.array(FlightSoftware(folder).modes) > 0)
            worst, entered = Found.worst(flights), sum(one.distance <= 0 for one in flights)
            cells = [f"`{name}`", str(len(flights)), f"{share:.0%}", str(entered), f"{worst.distance:.2f}"]
            cells += [f"{worst.tube:.1%}", f"{worst.thrust:.0%}", f"{worst.residual:.0%}"]
            cells += [f"{worst.away:.0f}", f"{worst.seen:.0%}", f"{worst.delta_v:.2f}"]
            print("| " + " | ".join(cells).replace("%", " %") + " |", flush=True)


if __name__ == "__main__":
    main()
