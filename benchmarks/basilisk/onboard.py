"""Flight software of a chaser: it reads a run folder, and nothing of the toolkit that wrote it.

Every control period it takes the navigation solution and answers with the thrust that the scheduled
controller asks for, in Hill's frame. Where the scenario declares a delay, a solution is that old when its
command takes effect; the software then carries it forward by the linear model and the commands it has issued.
"""

from __future__ import annotations

import csv
import json
import tomllib
from pathlib import Path

import numpy as np
from scipy.linalg import expm


def held(A: np.ndarray, B: np.ndarray, h: float) -> tuple[np.ndarray, np.ndarray]:
    """Transition over h [s], and what an input held meanwhile adds."""
    n, m = B.shape
    blocks = expm(np.block([[A, B], [np.zeros((m, n + m))]]) * h)
    return blocks[:n, :n], blocks[:n, n:]


class FlightSoftware:
    """The schedule in a run folder, as a law of time and state.

    Parameters
    ----------
    folder : Path
        A run folder of a switching schedule with sampled feedback. After its end the safety controller goes
        on along the reference's coasting tail.
    """

    def __init__(self, folder: Path) -> None:
        gains = json.loads((folder / "gains.json").read_text())
        scenario = tomllib.loads((folder / "scenario.toml").read_text())
        if not gains["feedback"]["sampled"]:
            raise ValueError(
                f"{folder}: thrusters are commanded periodically; feedback.kind must be 'sampled'"
            )
        self.A, self.B = (np.array(gains["system"][name]) for name in "AB")
        self.limit = np.array(gains["system"]["input_max"])
        self.period = float(gains["feedback"]["node_spacing_s"])
        self.delay = float(scenario.get("timing", {}).get("delay_s", 0.0))
        with (folder / "schedule.csv").open() as file:
            self.modes = [int(row["mode"]) for row in csv.DictReader(file)]
        table = np.genfromtxt(folder / "reference.csv", delimiter=",", skip_header=1)
        self.step = float(table[1, 0] - table[0, 0])
        self.laws = {}
        for law in gains["controllers"]:
            states = np.array(law.get("own_states", table[:, 1:7]))
            inputs = np.array(law.get("own_inputs", table[:, 7:10]))
            self.laws[law["mode"]] = np.array(law["gain"]), states, inputs
        self.issued: list[np.ndarray] = []  # one per period; the last `late` are not in effect yet
        self.late = round(self.delay / self.period)
        if abs(self.late * self.period - self.delay) > 1e-9 * self.period:
            raise ValueError(f"{folder}: this software knows delays of whole periods, not {self.delay:g} s")

    def command(self, tick: int, seen: np.ndarray) -> np.ndarray:
        """Thrust [N] in Hill's frame, shape (3,), that takes effect `late` periods after tick `tick`.

        `seen` is the relative state [m, m/s] as navigation has it at that tick.
        """
        phi, gamma = held(self.A, self.B, self.period)
        x = seen
        for u in self.issued[len(self.issued) - self.late :] if self.late else []:
            x = phi @ x + gamma @ u
        u = np.clip(self.law(tick + self.late, x), -self.limit, self.limit)
        self.issued.append(u)
        return u

    def law(self, tick: int, x: np.ndarray) -> np.ndarray:
        """What the scheduled controller asks for at the instant of a tick."""
        t = tick * self.period
        k = int((t + 1e-6 * self.period) // self.step)
        gain, states, inputs = self.laws[self.modes[k] if k < len(self.modes) else 0]
        last = len(states) - 2
        k, since = min(k, last), t - min(k, last) * self.step
        phi, gamma = held(self.A, self.B, since)
        return np.asarray(inputs[k] + gain @ (phi @ states[k] + gamma @ inputs[k] - x))
