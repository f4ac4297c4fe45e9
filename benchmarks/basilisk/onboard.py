"""Flight software of a chaser: it reads a run folder, and nothing of the toolkit that wrote it.

Every control period it takes the navigation solution and answers with the thrust that the scheduled
controller asks for, in Hill's frame. Where the scenario declares a delay, a solution is that old when its
command takes effect; the software then carries it forward by the linear model and the commands it has issued.
What thrusters are to make of a command is an impulse, a multiple of the declared bit.

`CraftSoftware` flies a craft with a camera and a layout of nozzles: an observer estimates the state from
positions, and the allocation that the run declares shares commands out among the nozzles that work.

Given compiled flight code, its answers are what is commanded: it is called once a control period with the
estimate for that instant, and with the command of U where U is due.
"""

from __future__ import annotations

import csv
import json
import tomllib
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy.linalg import expm
from scipy.optimize import linprog

MIXES, PAIRS, PROGRAM = "least_thrust_mixes", "pseudo_inverse", "linear_program"  # allocations that are flown


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
        A run folder of a switching schedule. After its end the safety controller goes
        on along the reference's coasting tail.
    code : polaris.simulation.on_board.FlightCode, optional
        Compiled flight code of that run.
    """

    def __init__(self, folder: Path, code: Any = None) -> None:
        self.code = code
        if code is not None:
            code.start(1)
        gains = json.loads((folder / "gains.json").read_text())
        scenario = tomllib.loads((folder / "scenario.toml").read_text())
        self.A, self.B = (np.array(gains["system"][name]) for name in "AB")
        self.limit = np.array(gains["system"]["input_max"])
        self.period = float(gains["sampling"]["step"]) / gains["sampling"]["nodes_per_step"]
        self.delay = float(scenario.get("timing", {}).get("delay_s", 0.0))
        with (folder / "schedule.csv").open() as file:
            self.modes = [int(row["mode"]) for row in csv.DictReader(file)]
        table = np.genfromtxt(folder / "reference.csv", delimiter=",", skip_header=1)
        self.step = float(table[1, 0] - table[0, 0])
        self.laws = {}
        for mode, law in enumerate(gains["controllers"]):
            states = np.array(law.get("reference_states", table[:, 1:7]))
            inputs = np.array(law.get("reference_inputs", table[:, 7:10]))
            self.laws[mode] = np.array(law["gain"]), states, inputs
        self.issued: list[np.ndarray] = []  # one per period; the last `late` are not in effect yet
        thrusters = scenario.get("thrusters", {})
        if (pulse := thrusters.get("pulse")) in ("start", "staggered"):
            raise ValueError(f"{folder}: this software centres pulses, they are {pulse} in the scenario")
        self.bit = float(thrusters.get("impulse_bit_N_s", 0.0))
        self.carries, self.left = thrusters.get("remainder") == "carried", np.zeros(3)
        self.held = cache(lambda h: held(self.A, self.B, h))
        self.scenario, self.system = scenario, gains["system"]
        self.late = round(self.delay / self.period)
        self.since = 0.0  # of a period [s], when navigation is asked
        self.nozzles = np.kron(np.diag(self.limit), [[1.0], [-1.0]])  # thrust of each, open, (6, 3) [N]
        if "directions" in thrusters and "observer" not in self.system:
            raise ValueError(
                f"{folder}: this software flies layouts of nozzles (thrusters.directions) with an"
                " observer alone (navigation.measurement)"
            )
        self._check_delay(folder)

    def _check_delay(self, folder: Path) -> None:
        if abs(self.late * self.period - self.delay) > 1e-9 * self.period:
            raise ValueError(f"{folder}: this software knows delays of whole periods, not {self.delay:g} s")

    @classmethod
    def of(cls, folder: Path, code: Any = None) -> FlightSoftware:
        """Return the software for a run folder: with an observer where one is on board."""
        system = json.loads((folder / "gains.json").read_text())["system"]
        return CraftSoftware(folder, code) if "observer" in system else cls(folder, code)

    def command(self, tick: int, state: np.ndarray) -> np.ndarray:
        """Thrust [N] in Hill's frame, shape (3,), that takes effect at tick `tick`, the first being 0.

        `state` is the relative state [m, m/s] as navigation has it at that tick. From it follows what takes
        effect `late` periods after; from the first one what does before that, too.
        """
        phi, gamma = self.held(self.period)
        x = state
        for u in self.issued[tick:]:
            x = phi @ x + gamma @ u
        for due in range(len(self.issued), tick + self.late + 1):
            u = np.clip(self.law(due, x), -self.limit, self.limit)
            x = phi @ x + gamma @ u
            self.issued.append(u)
        return self.issued[tick]

    def impulse(self, u: np.ndarray) -> np.ndarray:
        """Impulses [N s] along the thrusters' axes, shape (3,), for a period's command u [N] along them.

        The nearest multiples of the bit; where the rest is carried, those of what is due and was left before,
        rounded towards zero. What the limits do not allow is left as well.
        """
        limit = self.period * self.limit
        due = np.clip(self.period * u, -limit, limit) + self.left
        if self.bit > 0 and self.carries:
            impulse = self.bit * np.floor(np.abs(due) / self.bit * (1 + 1e-12))
        else:
            impulse = self.bit * np.round(np.abs(due) / self.bit) if self.bit > 0 else np.abs(due)
        impulse = np.sign(due) * np.minimum(impulse, limit)
        self.left = (due - impulse) * self.carries
        return np.asarray(impulse)

    def on_times(self, u: np.ndarray) -> np.ndarray:
        """Times [s] for which the nozzles are to be open, (6,), for a command u [N] along their axes."""
        share = self.impulse(u) / self.limit
        return np.stack([np.maximum(share, 0.0), np.maximum(-share, 0.0)], axis=1).ravel()

    def law(self, tick: int, x: np.ndarray) -> np.ndarray:
        """Return the scheduled controller's command [N] at the instant of a tick, shape (3,)."""
        t = tick * self.period
        k = int((t + 1e-6 * self.period) // self.step)
        mode = self.modes[k] if k < len(self.modes) else 0
        gain, states, inputs = self.laws[mode]
        last = len(states) - 2
        k, elapsed = min(k, last), t - min(k, last) * self.step
        phi, gamma = self.held(round(elapsed, 9))
        u = np.asarray(inputs[k] + gain @ (phi @ states[k] + gamma @ inputs[k] - x))
        return u if self.code is None else np.asarray(self.code.step(tick, x[None], mode, u[None])[0])


class CraftSoftware(FlightSoftware):
    """Flight software with a layout of nozzles, an observer of positions, and valves that are isolated.

    The camera is asked `delay` before a command takes effect, less than a period. Before tick 0 the observer
    is at work already, and nothing is commanded.

    Attributes
    ----------
    estimate : ndarray, shape (6,)
        State as the observer has it at the last measurement; to be set a period and `delay` before the first
        command.
    """

    def __init__(self, folder: Path, code: Any = None) -> None:
        super().__init__(folder, code)
        layout, observer = self.system["allocation"], self.system["observer"]
        self.mixes, self.tops = np.array(layout["mixes"]), np.array(layout["limits"])
        self.directions, self.kind = np.array(layout["directions"]), layout.get("kind", MIXES)
        if self.kind not in (MIXES, PAIRS, PROGRAM):
            kinds = ", ".join((MIXES, PAIRS, PROGRAM))
            raise ValueError(
                f"{folder}: thrusters.allocation is {self.kind}, but this software flies {kinds} alone"
            )
        self.nozzles = self.directions * self.tops[:, None]
        self.measures, self.gain = np.array(observer["measures"]), np.array(observer["gain"])
        self.settled, self.noise = (
            np.array(each) for each in (self.system["timing"]["measured_error"], observer["noise"])
        )
        self.faults = [fault["kind"] for fault in self.scenario.get("faults", [])]
        self.case, self.left = 0, np.zeros(len(self.tops))
        self.isolated = np.zeros(len(self.tops), dtype=bool)
        self.since = (self.period - self.delay) % self.period
        self.estimate, self.before, self.last = np.zeros(6), np.zeros(3), np.zeros(3)

    def _check_delay(self, folder: Path) -> None:
        if not 0 <= self.delay < self.period:
            raise ValueError(
                f"{folder}: this software knows delays of less than a period, not {self.delay:g} s"
            )

    def isolate(self, kind: str, nozzle: int) -> None:
        """Shut the valve of a nozzle that has failed: S flies on with the others."""
        self.case = 1 + self.faults.index(kind) * len(self.tops) + nozzle
        self.isolated[nozzle], self.modes = True, [0] * len(self.modes)
        self.left[nozzle] = 0.0

    def command(self, tick: int, state: np.ndarray | None) -> np.ndarray:
        """Thrust [N] in Hill's frame, shape (3,), that takes effect at a tick.

        `state` is the relative state as navigation had it `delay` before, of which the observer takes what is
        measured; None without a measurement.
        """
        x = self.estimate
        for span, u in ((self.delay, self.before), (self.period - self.delay, self.last)):
            phi, gamma = self.held(span)
            x = phi @ x + gamma @ u
        x = x if state is None else x + self.gain @ self.measures @ (state - x)
        phi, gamma = self.held(self.delay)
        predicted = phi @ x + gamma @ self.last
        u = np.clip(self.law(tick, predicted), -self.limit, self.limit) if tick >= 0 else np.zeros(3)
        self.estimate, self.before, self.last = x, self.last, u
        return u

    def thrusts(self, u: np.ndarray) -> np.ndarray:
        """Return the thrust [N] asked of each nozzle, (N,), by the declared allocation for commands u."""
        D, f = self.directions, np.zeros(len(self.tops))
        if self.kind == MIXES:
            forth, back = self.mixes[self.case]
            return np.asarray(np.maximum(u, 0) @ forth + np.maximum(-u, 0) @ back)
        if self.kind == PAIRS:
            nozzles = self.paired()
            f[nozzles] = 2 * np.maximum(u @ np.linalg.pinv(D[nozzles]), 0.0)
            return f
        tops = np.where(self.isolated, 0.0, self.tops)
        bounds, scaled = np.column_stack([0 * tops, tops]), D.T / self.limit[:, None]
        lengths = np.linalg.norm(D, axis=1)
        return np.asarray(linprog(lengths, A_eq=scaled, b_eq=u / self.limit, bounds=bounds).x)

    def paired(self) -> list[int]:
        """Return the nozzles that work and have an opposite one that works, as many either way of a line."""
        pairs: list[int] = []
        working = np.flatnonzero(~self.isolated).tolist()
        for j in working:
            same = [i for i in working if np.array_equal(self.directions[i], self.directions[j])]
            other = [i for i in working if np.array_equal(self.directions[i], -self.directions[j])]
            pairs += [j] * (same.index(j) < len(other))
        return pairs

    def on_times(self, u: np.ndarray) -> np.ndarray:
        """Times [s] for which the nozzles are to be open, (N,), for a command u [N] in the axes of the craft.

        Every nozzle makes whole bits of what it owes, and carries the rest to its next pulse.
        """
        owed = self.period * self.thrusts(u) + self.left
        rounded = self.bit * np.floor(owed / self.bit * (1 + 1e-12)) if self.bit > 0 else owed
        impulse = np.minimum(rounded, self.period * self.tops)
        self.left = np.where(self.isolated | (not self.carries), 0.0, owed - impulse)
        return np.asarray(np.where(self.isolated, 0.0, impulse / self.tops))
