"""Experimental controllers as a scenario describes them."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from reach.networks.onnx_file import read_onnx
from reach.numerics.errors import ReachError

from ..model.craft import Craft
from ..model.errors import OutOfTime, ScenarioError
from ..model.hill import elliptical_nmt
from ..model.scene.obstacle import Obstacle
from ..model.system import Array, LinearSystem, as_finite
from ..model.tolerances import SOLVER_BOOK_INPUT
from ..planning.problem import PlanProblem
from ..planning.reference import Reference
from ..planning.solve import plan
from ..synthesis.controllers.black_box import Ask, BlackBox
from ..synthesis.controllers.controllers import AffineController, AnyThrust, Controller
from ..synthesis.controllers.neural import NeuralController
from ..synthesis.controllers.policy import Policy, Senses
from ..synthesis.safety.get_safety import Safety
from ..synthesis.safety.problem import Problem
from ..synthesis.tracker.lqr import lqr_gain
from .tables.fields import per_axis
from .tables.goals import hill_rate
from .tables.scene import AffineTable, Neural
from .tables.scene import AnyThrustTable as AnyThrustTable
from .tables.scene import BlackBoxTable as BlackBoxTable
from .tables.schedule import ScenarioModel


def gain_of(spec: AffineTable, system: LinearSystem, path: str) -> Array:
    """Gain of an affine controller, shape (m, n): given, or LQR from its weights."""
    if spec.gain is not None:
        return as_finite(f"{path}.gain", spec.gain, 2)
    assert spec.Q is not None and spec.R is not None  # checked on loading
    return lqr_gain(system, spec.Q, spec.R)


def gains_of(model: ScenarioModel, system: LinearSystem) -> tuple[Array, ...]:
    """Gains of all controllers that have one."""
    return tuple(
        gain_of(spec, system, path) for path, spec in model.controllers() if isinstance(spec, AffineTable)
    )


def read_policies(
    model: ScenarioModel, system: Craft, unsafe: Sequence[Obstacle], folder: Path | None
) -> dict[str, tuple[Path, Policy]]:
    """Return networks and their files by controller; `ScenarioError` if one is unreadable or does not fit."""
    policies: dict[str, tuple[Path, Policy]] = {}
    for path, spec in model.controllers():
        if not isinstance(spec, Neural):
            continue
        file = (folder or Path()) / spec.path
        if any(other.name == file.name and other != file for other, _ in policies.values()):
            raise ScenarioError(f"{path}.path", spec.path, "must not have the file name of another network")
        try:
            network = read_onnx(file, spec.precision)
        except ReachError as error:
            raise ScenarioError(f"{path}.path", spec.path, f"cannot be used: {error}") from error
        scale = np.ones(network.inputs) if spec.input_scale is None else np.array(spec.input_scale)
        thrust = per_axis(f"{path}.output_scale_N", spec.output_scale_N, system.m)
        policy = Policy(network, spec.inputs, scale, thrust)
        policy.check(Senses.from_inputs(system, spec.inputs, unsafe, f"{path}.inputs"), path, spec.path)
        policies[spec.name] = file, policy
    return policies


def build_controllers(
    model: ScenarioModel,
    safety: Safety,
    policies: Mapping[str, tuple[Path, Policy]],
    boxes: Mapping[str, Ask | None],
    planned: Mapping[str, Array],
) -> tuple[Controller, ...]:
    """Controllers as a scenario describes them; see `ScheduleScenario.controllers`."""
    controllers: list[Controller] = []
    for path, spec in model.controllers():
        if isinstance(spec, BlackBoxTable):
            ask = boxes[spec.name]
            assert ask is not None  # checked by `ScheduleScenario.check_black_boxes`
            context = safety.problem.system, safety.reference, safety.tracking, ask
            controllers.append(BlackBox(spec.name, *context, seed=model.simulation.seed, memory=spec.memory))
        else:
            controllers.append(_build(spec, path, safety, policies, planned.get(spec.name)))
    return tuple(controllers)


def _build(
    spec: AffineTable | AnyThrustTable | Neural,
    path: str,
    safety: Safety,
    policies: Mapping[str, tuple[Path, Policy]],
    planned: Array | None,
) -> Controller:
    system, shared, tracking = safety.problem.system, safety.reference, safety.tracking
    if isinstance(spec, AnyThrustTable):
        return AnyThrust(spec.name, system, shared, tracking)
    gain = gain_of(spec, system, path) if isinstance(spec, AffineTable) else None
    own = own_reference(spec.reference, gain, safety, f"{path}.reference", planned)
    if isinstance(spec, Neural):
        policy, unsafe = policies[spec.name][1], tuple(safety.problem.unsafe)
        return NeuralController(spec.name, system, policy, shared, own, tracking, unsafe)
    assert gain is not None
    return AffineController(spec.name, system, gain, shared, own, tracking, spec.kind == "saturated_affine")


def own_reference(
    spec: Any, gain: Array | None, safety: Safety, path: str, planned: Array | None = None
) -> Reference:
    """Return the trajectory that an experimental controller follows; a plan has the inputs that are given."""
    problem: Problem = safety.problem
    system, K, delta = problem.system, problem.K, problem.delta
    if spec.kind == "shared":
        return safety.reference
    if spec.kind == "nmt":
        x0 = elliptical_nmt(hill_rate(system, f"{path}.kind", spec.kind), **spec.arguments())
        return Reference.propagate(system, delta, x0, np.zeros((K, system.m)))
    if spec.kind == "setpoint":
        state = as_finite(f"{path}.state", spec.state, 1)
        if gain is None:
            return _still(system, state, K, delta, path)
        return at_rest(system, gain, state, K, delta, path)
    if planned is not None:
        return Reference.propagate(system, delta, problem.initial_set.c, planned)
    limit = np.broadcast_to(system.u_max * (1 - SOLVER_BOOK_INPUT), (K, system.m))
    plan_problem = PlanProblem(system, problem.initial_set.c, K, delta, (), (), limit, problem.goal, "fuel")
    cheapest = plan(plan_problem, problem.planner)
    if cheapest.cut_by_clock:
        raise OutOfTime(
            f"{path}: no fuel-optimal plan was found within planner.time_limit_s = "
            f"{problem.planner.time_limit}; raise it"
        )
    return Reference.propagate(system, delta, problem.initial_set.c, cheapest.nu)


def _still(system: LinearSystem, state: Array, K: int, delta: float, path: str) -> Reference:
    """Return a state kept without thrust: a network's setpoint, about which nothing else is known."""
    if np.any(system.A @ state):
        rule = "must be at rest without thrust (A x = 0) as the setpoint of a network"
        raise ScenarioError(f"{path}.state", state.tolist(), rule)
    return Reference(system, delta, np.repeat(state[None], K + 1, axis=0), np.zeros((K, system.m)))


def at_rest(system: LinearSystem, gain: Array, state: Array, K: int, delta: float, path: str) -> Reference:
    """Return the rest of ``u = K (state - x)``: a constant trajectory with a constant input.

    About it the law is the same feedback, so ``u = u_eq + K (x_eq - x)`` exactly.
    """
    closed = system.A - system.B @ gain
    if np.linalg.matrix_rank(closed) < system.n:
        rule = "must have a state of rest under the controller: A - B K is singular; change the gain"
        raise ScenarioError(f"{path}.state", state.tolist(), rule)
    x_eq = np.linalg.solve(closed, -system.B @ gain @ state)
    u = gain @ (state - x_eq)
    # Rounding must not set the constant trajectory drifting: chi is constant by construction.
    return Reference(system, delta, np.repeat(x_eq[None], K + 1, axis=0), np.repeat(u[None], K, axis=0))
