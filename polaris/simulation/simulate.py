"""Closed-loop simulation, vectorised over runs, with random and worst-case disturbances."""

from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from ..model.checks import of_kind, one_of, whole
from ..model.errors import ScenarioError
from ..model.scene.satellite import true_states
from ..model.system import Array
from ..synthesis.schedule.schedule import Schedule
from .delayed import Predicting, flies
from .disturbances import Disturbance, disturbances, limit_rows
from .fault_times import in_every_second
from .integration import Integrator
from .on_board import FlightCode
from .run_metrics import Runs

Initial = Literal["center", "random", "corners", "mixed"]
DISTURBANCES, INITIALS = get_args(Disturbance), get_args(Initial)


def simulate(
    schedule: Schedule,
    n: int = 100,
    seed: int = 0,
    *,
    mode: int | None = None,
    initial: Initial = "mixed",
    disturbance: Disturbance = "failing",
    tail: bool = False,
    substeps: int = 1,
    code: FlightCode | None = None,
) -> Runs:
    """Fly the schedule, or one controller alone, many times at once.

    Parameters
    ----------
    schedule : Schedule
        Result of `synthesize`.
    n, seed : int
        Number of runs; same seed, same runs.
    mode : int, optional
        Fly this controller alone (0 is S) instead of the schedule.
    initial : {"mixed", "center", "random", "corners"}
        States drawn from Theta; ``mixed`` takes corners for half of the runs.
    disturbance : {"failing", "mixed", "none", "random", "worst"}
        ``worst``: in closed form for a random facet and instant; ``random``: half of it on the bound;
        ``mixed``: half each; ``failing``: besides, in every second run a fault, if any is isolated late.
    tail : bool
        Fly S on along the coasting tail after T.
    substeps : int, optional
        Steps per control period, over each of which a disturbance is constant. All are exact, pulses too.
    code : FlightCode, optional
        Compiled flight code that decides and commands in place of the schedule.

    Returns
    -------
    Runs
        By exact zero-order hold. An observer is flown as it would be on board.
    """
    of_kind("schedule", schedule, Schedule, "polaris.synthesize")
    for name, value, least in (("runs", n, 1), ("seed", seed, 0), ("substeps", substeps, 1)):
        whole(f"simulation.{name}", value, least)
    one_of("simulation.initial", initial, INITIALS)
    one_of("simulation.disturbance", disturbance, DISTURBANCES)
    if mode is not None and whole("simulation.mode", mode, 0) >= len(schedule.controllers):
        raise ScenarioError("simulation.mode", mode, f"must be below {len(schedule.controllers)}")
    if code is not None and code.online != bool(mode):
        rule = "must name a controller if the flight code has an online monitor, and be left out otherwise"
        raise ScenarioError("simulation.mode", mode, rule)
    rng = np.random.default_rng(seed)
    flight = flies(schedule.safety.problem.system)(schedule, flown_modes(schedule, tail, mode), substeps)
    flight.code = code and code.require_schedule(schedule)
    if isinstance(flight, Predicting):
        flight.prepare(n, rng)
    x0 = initial_states(schedule, n, rng, initial)
    w, adjoint = disturbances(flight, n, rng, disturbance)
    if initial in ("corners", "mixed") and len(adjoint):
        # The worst disturbance strikes hardest from the corner that lies furthest in its direction.
        x0[: len(adjoint)] = schedule.safety.problem.initial_set.support_vector(adjoint)
    if disturbance != "none":
        _show_bodies(flight, n, rng)
    if disturbance == "failing":
        flight.faults = in_every_second(schedule, substeps, limit_rows(schedule), flight.steps, n, rng)
    return flight.run(x0, w)


def _show_bodies(flight: Integrator, n: int, rng: np.random.Generator) -> None:
    """Show the truth to networks that read where others are."""
    if flight.columns[-1].start < flight.columns[-1].stop:
        safety = flight.schedule.safety
        times = np.asarray(np.arange(len(flight.modes) * flight.q + 1) * safety.tracking.flow.h, dtype=float)
        flight.bodies = true_states(safety.problem.unsafe, safety.problem.system, times, n, rng)


def flown_modes(schedule: Schedule, tail: bool, mode: int | None = None) -> NDArray[np.int_]:
    """Mode of every cell: those of the schedule, or one throughout; after T, where that is asked for, S."""
    K, cells = schedule.safety.problem.K, schedule.safety.reference.cells
    modes = np.zeros(cells if tail else K, dtype=int)
    modes[:K] = schedule.modes if mode is None else mode
    return modes


def initial_states(schedule: Schedule, n: int, rng: np.random.Generator, initial: Initial) -> Array:
    """States drawn from Theta, shape (n, states); ``mixed`` takes corners for half of them."""
    theta = schedule.safety.problem.initial_set
    if initial == "center":
        return np.repeat(theta.c[None], n, axis=0)
    b = rng.uniform(-1, 1, (n, theta.order_count))
    if initial in ("corners", "mixed"):
        count = n if initial == "corners" else n - n // 2
        b[:count] = np.where(b[:count] < 0, -1.0, 1.0)
    return np.asarray(theta.c + b @ theta.G.T)
