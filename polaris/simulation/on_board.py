"""Flight code as a shared library: the compiled step function flies many flights at once."""

import ctypes
import shutil
import subprocess
import tempfile
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from math import ceil, fsum
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from reach.numerics.linear import discretize

from ..certificate.code.answers import CLIPPED
from ..certificate.code.text import FARTHEST, PRECISIONS, Tables, files, parsed
from ..model.errors import PolarisError, ScenarioError
from ..model.system import Array
from ..model.timing import WHOLE
from ..synthesis.schedule.schedule import Schedule

MOST_SENT = 32  # most commands that an observer on board remembers
COMPILERS = "cc", "gcc", "clang"
FLAGS = "-std=c99", "-O2", "-ffp-contract=off", "-shared", "-fPIC"
PAST = 1e-3
SAME = 1e-6  # of the reference, by which that of the code may be rounded
REALS = dict(zip(PRECISIONS, (np.float64, np.float32), strict=True))

LOOP = """#include "{0}.h"
const int32_t sizes[] = {{sizeof({1}), sizeof({0}_input), sizeof({0}_output)}};
void start(int32_t runs, {1} *memory)
{{
    for (int32_t i = 0; i < runs; i++) {{ {2}_start(&memory[i]); }}
}}
void step(int32_t runs, {1} *memory, const {0}_input *input, {0}_output *output)
{{
    for (int32_t i = 0; i < runs; i++) {{ {2}_step(&memory[i], &input[i], &output[i]); }}
}}
"""


class FlightCode:
    """Compiled flight code, and its memory of R flights.

    Parameters
    ----------
    folder : path
        Header and source, as `polaris export c` writes them.

    Attributes
    ----------
    tables : Tables
    precision : str
    online : bool
        True if the online monitor in it decides, instead of the schedule.
    modes : ndarray of int, shape (R,)
        Newest modes that it answered with.
    answers : Counter
        Number of all answers by mode and fault.

    Raises
    ------
    ScenarioError
        If the folder does not hold what `polaris export c` writes.
    PolarisError
        If there is no C compiler, or it refuses the code.
    """

    def __init__(self, folder: str | Path) -> None:
        try:
            (header,) = Path(folder).glob("*.h")
            prefix, source = header.stem, header.with_suffix(".c")
            self.tables, self.precision, _ = parsed(header.read_text(), source.read_text(), prefix)
        except (OSError, ValueError) as error:
            raise ScenarioError("code", str(folder), f"must be a folder of flight code: {error}") from error
        self.online = f"{prefix}_online_step" in header.read_text()
        n, m, real = len(self.tables.range), len(self.tables.limit), REALS[self.precision]
        sensors = [("measured", real, len(self.tables.seen))] if self.tables.seen else []
        inputs = [("period", "i4"), ("controller", "i4"), ("state", real, n), *sensors, ("command", real, m)]
        answer = [("mode", "i4"), ("fault", "u4"), ("command", real, m), ("margin", real)]
        self._input, self._output = np.dtype(inputs, align=True), np.dtype(answer, align=True)
        with tempfile.TemporaryDirectory() as scratch:
            self._library = _compiled(prefix, source, Path(scratch), self.online)
        size, *others = (ctypes.c_int32 * 3).in_dll(self._library, "sizes")
        if others != [self._input.itemsize, self._output.itemsize]:
            raise PolarisError(f"{source}: another layout of structures; export the code again")
        self._settling = np.zeros((0, size), dtype=np.uint8)
        self.modes: NDArray[np.int_] = np.zeros(0, dtype=int)
        self.answers: Counter[tuple[int, int]] = Counter()

    @property
    def asks(self) -> int | None:
        """Controller that asks the online monitor in every step of an attack; None without a monitor."""
        return 1 if self.online else None

    def require_schedule(self, schedule: Schedule) -> "FlightCode":
        """Return the code, unless it is that of another schedule: then raise `ScenarioError`."""
        if self.tables.seen and schedule.safety.problem.system.observer is None:
            raise ScenarioError("code", self.tables.sizes, "has an observer, and the scenario has none")
        reference = np.array(self.tables.waypoints)
        cells = schedule.safety.reference.chi[: len(reference)]
        same = self.tables.modes == schedule.modes.tolist() and reference.shape == cells.shape
        if not same or np.abs(reference - cells).max() > SAME * np.abs(cells).max():
            raise ScenarioError("code", self.tables.sizes, "must be the flight code of this schedule")
        return self

    def start(self, runs: int) -> None:
        """Begin so many flights."""
        self._settling = np.zeros((runs, self._settling.shape[1]), dtype=np.uint8)
        self.modes = np.zeros(runs, dtype=int)
        self._library.start(runs, self._settling.ctypes)

    def step(
        self,
        period: int,
        states: Array,
        controllers: Any,
        commands: Array,
        rows: Any = ...,
        measured: Array | None = None,
    ) -> Array:
        """Answer the call of a control period in some of the flights.

        Parameters
        ----------
        period : int
        states : ndarray, shape (r, n)
            Estimates that the scenario declares.
        controllers : int or ndarray of int, shape (r,)
            Experimental controllers whose commands are handed over; 0 if there is none.
        commands : ndarray, shape (r, m)
            Their commands [N].
        rows : index, optional
            Flights that are called, r of them; default all.
        measured : ndarray, shape (r, o), optional
            Measurements for the observer in the code, NaN where there is none; states are then read in the
            first call alone.

        Returns
        -------
        ndarray, shape (r, m)
            Commands [N]; one of S that was clipped is past its limits by `PAST`, as it must never be.
        """
        inputs, answer = (np.zeros(len(states), dtype=each) for each in (self._input, self._output))
        inputs["period"], inputs["controller"] = period, controllers
        inputs["state"], inputs["command"] = states, commands
        if self.tables.seen and period > 0:
            if measured is None:
                raise ScenarioError("code", self.tables.sizes, "has an observer, which needs measurements")
            inputs["measured"] = measured
        settling = np.ascontiguousarray(self._settling[rows])
        self._library.step(len(inputs), settling.ctypes, inputs.ctypes, answer.ctypes)
        self._settling[rows], self.modes[rows] = settling, answer["mode"]
        self.answers.update(zip(answer["mode"].tolist(), answer["fault"].tolist(), strict=True))
        clipped = (answer["mode"] == 0) & (answer["fault"] & CLIPPED > 0)
        return np.asarray(answer["command"].astype(float) * (1 + PAST * clipped[:, None]))


def _compiled(prefix: str, source: Path, scratch: Path, online: bool) -> ctypes.CDLL:
    compiler = next(filter(None, map(shutil.which, COMPILERS)), None)
    if compiler is None:
        raise PolarisError(f"flight code needs a C compiler, but none of {', '.join(COMPILERS)} is installed")
    loop, out = scratch / "loop.c", scratch / "flight.so"
    entry = f"{prefix}_online" if online else prefix
    loop.write_text(LOOP.format(prefix, entry if online else f"{prefix}_memory", entry))
    command = [compiler, *FLAGS, f"-I{source.parent}", str(source), str(loop), "-o", str(out)]
    process = subprocess.run(command, capture_output=True, text=True, check=False)
    if process.returncode:
        raise PolarisError(f"{source}: the compiler says {process.stderr.strip()[:200]}")
    return ctypes.CDLL(str(out))


def code_of(schedule: Schedule, precision: str = "double", observer: bool = False) -> FlightCode:
    """Compile the flight code of a proved schedule, whose certificate is not asked for.

    With the `observer` of the system, if it has one, in the code.

    Raises
    ------
    ScenarioError
        If the schedule is not proved, or a thrust limit is 0.
    PolarisError
        As of `FlightCode`.
    """
    safety = schedule.safety
    tracking, reference = safety.tracking, safety.reference
    system, forever = tracking.system, safety.end.horizon != "none"
    check_flyable(schedule.guarantee, system.u_max.tolist())
    plan = schedule.modes.tolist(), reference.chi.tolist(), reference.nu.tolist()
    sampling = tracking.flow.h, tracking.feedback.nodes_per_cell
    tables = tables_of(system.A, system.B, *sampling, *plan, tracking.gain.tolist(), system.u_max, forever)
    if observer and system.observer is not None:
        gains, timing = (system.observer.gain, *system.observer.after), (sampling[0], system.timing.delay)
        observed = observer_tables(system.A, system.B, *timing, system.observer.measures, gains, tables.range)
        tables = replace(tables, **observed)
    with tempfile.TemporaryDirectory() as scratch:
        for name, text in files(tables.rounded(precision), "flown", precision, "0" * 64).items():
            (Path(scratch) / name).write_text(text)
        return FlightCode(scratch)


def check_flyable(guarantee: str, limits: Sequence[float]) -> None:
    """Raise `ScenarioError` if a guarantee is not "proved", or a thrust limit is 0."""
    if guarantee != "proved":
        rule = "must be 'proved' to fly; steps of black boxes rest on samples"
        raise ScenarioError("guarantee", guarantee, rule)
    if not min(limits) > 0:
        raise ScenarioError("input_max", list(limits), "must be above 0 in every input to fly")


def tables_of(
    A: Any,
    B: Any,
    h: float,
    q: int,
    modes: list[int],
    states: list[list[float]],
    inputs: list[list[float]],
    gain: list[list[float]],
    limit: Any,
    forever: bool,
) -> Tables:
    """Return the tables of a schedule in double precision, whose steps are q control periods of h [s].

    Raises `ScenarioError` if the reference is so far away that the code would take its states for errors.
    """
    if 2 * (largest := float(np.abs(states).max())) > FARTHEST:
        rule = f"must keep within {FARTHEST / 2:g}, half of what the code accepts; use larger units"
        raise ScenarioError("reference", largest, rule)
    parts = [discretize(np.array(A), np.array(B), h * i) for i in range(q)]
    cells, steps = len(inputs), len(modes)
    return Tables(
        covered=(cells if forever else steps) * q,
        modes=modes,
        waypoints=states[:cells],
        feed=inputs[:steps],
        moved=[Ad.tolist() for Ad, _ in parts],
        pushed=[Bd.tolist() for _, Bd in parts],
        gain=gain,
        limit=list(map(float, limit)),
        range=booked_range(np.array(states), np.array(gain), np.array(limit)).tolist(),
    )


def observer_tables(
    A: Any, B: Any, h: float, delay: float, measures: Any, gains: Any, reach: Sequence[float]
) -> dict[str, Any]:
    """Return tables of an observer by their names, see `Tables`, whose measurements are `delay` [s] old.

    States are within `reach` (n,). Raises `ScenarioError` if the delay is of too many periods.
    """
    A, B, measures = (np.array(M) for M in (A, B, measures))
    back, ahead = expm(-A * delay), expm(A * delay)
    count = max(ceil(delay / h * (1 - WHOLE)), 1)
    if count > MOST_SENT:
        raise ScenarioError("timing.delay_s", delay, f"must be at most {MOST_SENT} periods for flight code")
    parts = [min(h, max(delay - h * age, 0.0)) for age in range(count)]
    later = [
        measures @ expm(A * (h * age - delay)) @ discretize(A, B, part)[1] for age, part in enumerate(parts)
    ]
    Ad, Bd = discretize(A, B, h)
    return {
        "held": Ad.tolist(),
        "force": Bd.tolist(),
        "seen": (measures @ back).tolist(),
        "later": [part.tolist() for part in later],
        "updates": [(ahead @ np.array(gain)).tolist() for gain in gains],
        "heard": [fsum(abs(x) * y for x, y in zip(row, reach, strict=True)) for row in measures.tolist()],
    }


def booked_range(states: Array, gain: Array, limit: Array) -> Array:
    """Return the range of states for which rounding is bounded: the reference's, and errors about it.

    Errors (n,) are twice those of each state that alone would ask for a thrust limit.
    """
    with np.errstate(divide="ignore"):
        errors = (2 * limit[:, None] / np.abs(gain)).min(axis=0)
    return np.asarray(np.minimum(np.abs(states).max(axis=0) + errors, FARTHEST))
