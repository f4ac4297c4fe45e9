"""Experimental controllers as a scenario describes them."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..model.errors import OutOfTime, ScenarioError
from ..model.hill import elliptical_nmt
from ..model.system import Array, LinearSystem, as_finite
from ..model.tolerances import SOLVER_BOOK_INPUT
from ..planning.problem import PlanProblem
from ..planning.reference import Reference
from ..planning.solve import plan
from ..synthesis.controllers import AffineController, AnyThrust, Controller
from ..synthesis.get_safety import Safety
from ..synthesis.problem import Problem
from ..synthesis.tracking import lqr_gain
from .scene_tables import Affine, Experimental, hill_rate
from .scene_tables import AnyThrust as AnyThrustTable
from .tables import ScenarioModel


def gain_of(spec: Affine, system: LinearSystem, path: str) -> Array:
    """Gain of an affine controller, shape (m, n): given, or LQR from its weights."""
    if spec.gain is not None:
        return as_finite(f"{path}.gain", spec.gain, 2)
    assert spec.Q is not None and spec.R is not None  # checked on loading
    return lqr_gain(system, spec.Q, spec.R)


def gains_of(model: ScenarioModel, system: LinearSystem) -> tuple[Array, ...]:
    """Gains of all controllers that have one."""
    return tuple(
        gain_of(spec, system, path) for path, spec in model.controllers() if isinstance(spec, Affine)
    )


def build_controllers(model: ScenarioModel, safety: Safety) -> tuple[Controller, ...]:
    """Controllers as a scenario describes them; see `ScheduleScenario.controllers`."""
    return tuple(_build(spec, path, safety) for path, spec in model.controllers())


def _build(spec: Experimental, path: str, safety: Safety) -> Controller:
    system = safety.problem.system
    if isinstance(spec, AnyThrustTable):
        return AnyThrust(spec.name, system, safety.reference, safety.tracking)
    gain = gain_of(spec, system, path)
    own = own_reference(spec.reference, gain, safety, f"{path}.reference")
    clips = spec.kind == "saturated_affine"
    return AffineController(spec.name, system, gain, safety.reference, own, safety.tracking, clips)


def own_reference(spec: Any, gain: Array, safety: Safety, path: str) -> Reference:
    """What an experimental controller follows, as a trajectory that obeys the dynamics."""
    problem: Problem = safety.problem
    system, K, delta = problem.system, problem.K, problem.delta
    if spec.kind == "shared":
        return safety.reference
    if spec.kind == "nmt":
        x0 = elliptical_nmt(hill_rate(system, f"{path}.kind", spec.kind), **spec.arguments())
        return Reference.propagate(system, delta, x0, np.zeros((K, system.m)))
    if spec.kind == "setpoint":
        return _settled(system, gain, as_finite(f"{path}.state", spec.state, 1), K, delta, path)
    limit = np.broadcast_to(system.u_max * (1 - SOLVER_BOOK_INPUT), (K, system.m))
    asked = PlanProblem(system, problem.initial_set.c, K, delta, (), (), limit, problem.goal, "fuel")
    found = plan(asked, problem.planner)
    if found.cut_by_clock:
        raise OutOfTime(
            f"{path}: the cheapest plan of this reference was not found in the time given "
            f"(planner.time_limit_s = {problem.planner.time_limit:g})"
        )
    return Reference.propagate(system, delta, problem.initial_set.c, found.nu)


def _settled(system: LinearSystem, gain: Array, state: Array, K: int, delta: float, path: str) -> Reference:
    """Where ``u = K (state - x)`` comes to rest: a constant trajectory with a constant input.

    About it the law is the same feedback, so ``u = u_eq + K (x_eq - x)`` exactly.
    """
    closed = system.A - system.B @ gain
    if np.linalg.matrix_rank(closed) < system.n:
        rule = "the controller never comes to rest (singular loop)"
        raise ScenarioError(f"{path}.state", state.tolist(), rule)
    rest = np.linalg.solve(closed, -system.B @ gain @ state)
    u = gain @ (state - rest)
    # Rounding must not set the constant trajectory drifting: chi is constant by construction.
    return Reference(system, delta, np.repeat(rest[None], K + 1, axis=0), np.repeat(u[None], K, axis=0))
