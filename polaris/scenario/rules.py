"""The rules that join several fields of a scenario.

Each check raises `ScenarioError` with the field as in the TOML, what was given, and the rule. They
run in an order in which each may rely on those before it (shapes before anything that multiplies).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..model.checks import counted
from ..model.errors import ScenarioError
from ..model.obstacle import Obstacle, directions
from ..model.satellite import SatelliteObstacle
from ..model.system import LinearSystem
from . import scene_tables as scene
from . import tables as models
from .build import in_file_terms, whole_parts
from .fields import MAX_STEPS

MAX_SPEED_M_S = 100.0
"""Fastest relative motion [m/s] of an obstacle: beyond it this is conjunction screening, not
proximity operations, and one step of the plan would jump over it."""

HILL_RANGE_M = 1e5
"""Range [m] within which Hill's linear equations are taken to hold."""


PER_STATE = ("center", "half_widths", "state", "state_half_widths")
"""Fields of an initial set, a goal or an unsafe set that hold one number for each state."""

PER_AXIS = ("center_m", "half_widths_m", "velocity_m_s", "apex_m", "axis")
"""Those that hold one number for each position coordinate."""


# -- shapes -----------------------------------------------------------------------------------------


def check_system(spec: models.System) -> None:
    """Shapes of the system's own fields."""
    if isinstance(spec, models.ClohessyWiltshire):
        if isinstance(spec.thrust_max_N, tuple):
            _length("system.thrust_max_N", spec.thrust_max_N, 3)
        return
    n, m = len(spec.A), len(spec.B[0])
    if len(spec.A[0]) != n:
        raise ScenarioError("system.A", f"{n} x {len(spec.A[0])} numbers", "must be square")
    for name, matrix in (("B", spec.B), ("D", spec.D)):
        if len(matrix) != n:
            raise ScenarioError(f"system.{name}", f"{len(matrix)} rows", f"must have {n} rows, as A has")
    if isinstance(spec.input_max, tuple):
        _length("system.input_max", spec.input_max, m)
    if spec.C is not None and spec.position_states is not None:
        raise ScenarioError("system.C", spec.C, "give C or position_states, not both")
    if spec.C is not None and not (len(spec.C[0]) == n and len(spec.C) <= 3):
        shape = f"{len(spec.C)} x {len(spec.C[0])} numbers"
        raise ScenarioError("system.C", shape, f"must have one to three rows of {n} numbers")
    if spec.C is not None and np.linalg.matrix_rank(np.array(spec.C)) < len(spec.C):
        raise ScenarioError("system.C", spec.C, "must have linearly independent rows")
    chosen = spec.position_states
    if chosen is not None and not (len(set(chosen)) == len(chosen) and max(chosen) < n):
        raise ScenarioError("system.position_states", list(chosen), f"must be different numbers below {n}")
    if spec.C is None and chosen is None and not 1 <= max(n // 2, 1) <= 3:
        rule = f"is required for a system of {n} states (positions have one to three coordinates)"
        raise ScenarioError("system.position_states", None, rule)


def check_orbit(model: models.ScenarioModel) -> None:
    """The table of the orbit belongs to a spacecraft."""
    if model.orbit is None or isinstance(model.system, models.ClohessyWiltshire):
        return
    rule = "needs Hill's frame (system.kind = 'clohessy_wiltshire')"
    raise ScenarioError("orbit", model.system.kind, rule)


def check_shapes(model: models.ScenarioModel, system: LinearSystem) -> None:
    """Every vector and matrix against the system's n states, m inputs, d position coordinates."""
    n, m, d = system.n, system.m, system.d
    start = model.initial_set
    if isinstance(start, models.InitialZonotope):
        for i, generator in enumerate(start.generators):
            _length(f"initial_set.generators[{i}]", generator, n)
    if isinstance(model.tracking.weight, tuple):
        _length("tracking.weight", model.tracking.weight, n)
    for path, part in (("initial_set", start), ("goal", model.goal), *model.scene_parts()):
        for names, count in ((PER_STATE, n), (PER_AXIS, d)):
            for name in names:
                if (vector := getattr(part, name, None)) is not None:
                    _length(f"{path}.{name}", vector, count)
    for path, obstacle in model.scene_parts():
        if isinstance(obstacle, scene.PolytopeObstacle | scene.KeepInPolytope):
            for row, normal in enumerate(obstacle.normals):
                _length(f"{path}.normals[{row}]", normal, d)
            _length(f"{path}.offsets_m", obstacle.offsets_m, len(obstacle.normals))
    for i, controller in enumerate(model.experimental):
        if not isinstance(controller, scene.Affine):
            continue
        if isinstance(controller.reference, scene.SetpointReference):
            _length(f"experimental[{i}].reference.state", controller.reference.state, n)
        if controller.gain is not None and (len(controller.gain), len(controller.gain[0])) != (m, n):
            shape = f"{len(controller.gain)} x {len(controller.gain[0])} numbers"
            raise ScenarioError(f"experimental[{i}].gain", shape, f"must be {m} x {n} numbers")


def _length(field: str, vector: tuple[Any, ...], count: int) -> None:
    if len(vector) != count:
        raise ScenarioError(field, list(vector), f"must have {counted(count, 'number')}, has {len(vector)}")


# -- time -------------------------------------------------------------------------------------------


def check_time(model: models.ScenarioModel) -> None:
    """Steps divide the horizon, control periods divide steps, and there are not too many of either."""
    horizon = model.horizon
    T, delta = horizon.duration_s, horizon.step_s
    if T / delta > MAX_STEPS:
        rule = f"must give at most {MAX_STEPS} steps, gives {T / delta:.4g}"
        raise ScenarioError("horizon.step_s", delta, rule)
    K = whole_parts(T, delta)
    if not K:
        raise ScenarioError(
            "horizon.step_s", delta, f"must divide duration_s = {T:g} (a whole number of steps)"
        )
    if model.schedule.min_dwell_steps > K:
        rule = f"must be at most the number of steps, {K}"
        raise ScenarioError("schedule.min_dwell_steps", model.schedule.min_dwell_steps, rule)
    if isinstance(model.feedback, models.SampledFeedback):
        period = model.feedback.period_s
        if T / period > MAX_STEPS:
            rule = f"must give at most {MAX_STEPS} periods in all, gives {T / period:.4g}"
            raise ScenarioError("feedback.period_s", period, rule)
        if not whole_parts(delta, period):
            raise ScenarioError("feedback.period_s", period, f"must divide step_s = {delta:g}")


# -- controllers, names, scene ----------------------------------------------------------------------


def check_controllers(model: models.ScenarioModel, system: LinearSystem) -> None:
    """References that only Hill's frame has."""
    for i, controller in enumerate(model.experimental):
        on_orbit = isinstance(controller, scene.Affine) and controller.reference.kind == "nmt"
        if on_orbit:
            scene.hill_rate(system, f"experimental[{i}].reference.kind", "nmt")


def check_names(model: models.ScenarioModel) -> None:
    """Names are unique: obstacles and keep-in sets together, controllers among themselves."""
    groups: tuple[list[tuple[str, str]], ...] = (
        [(path, part.name) for path, part in model.scene_parts()],
        [(f"experimental[{i}]", controller.name) for i, controller in enumerate(model.experimental)],
    )
    for group in groups:
        seen: dict[str, str] = {}
        for path, name in group:
            if name in seen:
                raise ScenarioError(f"{path}.name", name, f"must be unique; {seen[name]} has it too")
            seen[name] = path
    for i, controller in enumerate(model.experimental):
        if controller.name in ("safety", "polaris"):
            rule = "must not be 'safety' or 'polaris', which the results use"
            raise ScenarioError(f"experimental[{i}].name", controller.name, rule)


def check_scene(model: models.ScenarioModel, unsafe: Sequence[Obstacle], system: LinearSystem) -> None:
    """There is something to be safe from, and it is what proximity operations deal with."""
    if not unsafe:
        raise ScenarioError("obstacles", [], "give at least one obstacle or keep-in set")
    for (path, part), item in zip(model.scene_parts(), unsafe, strict=True):
        moving, velocity = "velocity_m_s", getattr(part, "velocity_m_s", None) or 0.0
        if isinstance(item, SatelliteObstacle):
            moving, velocity = "state", system.velocity @ np.asarray(item.state)
            try:
                item.pushes(system)
                directions(system.d, item.facets, f"{path}.facets")
            except ScenarioError as error:
                raise in_file_terms(error, path, part) from error
        if (speed := float(np.linalg.norm(velocity))) > MAX_SPEED_M_S:
            rule = f"must move at most at {MAX_SPEED_M_S:g} m/s"
            raise ScenarioError(f"{path}.{moving}", f"{speed:.4g} m/s", rule)
    if system.mean_motion is not None:
        reach = float(np.linalg.norm(system.position @ np.array(model.initial_set.center)))
        if reach > HILL_RANGE_M:
            rule = f"must start within {HILL_RANGE_M:g} m of the target, where Hill's linear equations hold"
            raise ScenarioError("initial_set.center", f"{reach:.4g} m away", rule)
