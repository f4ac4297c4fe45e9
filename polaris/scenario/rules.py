"""The rules that join several fields of a scenario, or need arithmetic.

Each check raises `ScenarioError` with the field as in the TOML, what was given, and the rule. They
run in an order in which each may rely on those before it (shapes before anything that multiplies).
"""

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from reach.sets.zonotope import Zonotope

from ..model.checks import MAX_STEPS
from ..model.errors import ScenarioError
from ..model.keys import keys_of
from ..model.scene.keep_in import KeepIn
from ..model.scene.obstacle import Obstacle, directions
from ..model.scene.satellite import SatelliteObstacle
from ..model.scene.state_limits import StateLimit
from ..model.scene.turning import TurningKeepIn
from ..model.system import Array, LinearSystem
from ..model.tolerances import TIME
from .tables import scene as scene
from .tables import schedule as models
from .tables.fields import check_length, in_file_terms, whole_parts
from .tables.goals import StationaryGoal, hill_rate

MAX_SPEED_M_S = 100.0
"""Fastest relative motion [m/s] of an obstacle: beyond it this is conjunction screening, not
proximity operations, and one step of the plan would jump over it."""

HILL_RANGE_M = 1e5  # range [m] within which Hill's linear equations are taken to hold


_TOUCH_M = 1e-9
"""Depth [m] from which an overlap counts: touching is left to the planner, which adds its margins."""


def check_system(model: models.ScenarioModel) -> None:
    """Check which states are the position; all other shapes are checked where the system is built."""
    spec = model.system
    if isinstance(spec, models.ClohessyWiltshire):
        return
    if model.orbit is not None:
        raise ScenarioError("orbit", spec.kind, "needs Hill's frame (system.kind = 'clohessy_wiltshire')")
    n, C, chosen = len(spec.A), spec.C, spec.position_states
    if C is not None and chosen is not None:
        raise ScenarioError("system.C", C, "must be left out with position_states")
    if C is not None and not (len(C[0]) == n and len(C) <= 3):
        shape = f"{len(C)} x {len(C[0])} numbers"
        raise ScenarioError("system.C", shape, f"must have one to three rows of {n} numbers")
    if C is not None and np.linalg.matrix_rank(np.array(C)) < len(C):
        raise ScenarioError("system.C", C, "must have linearly independent rows")
    if chosen is not None and not (len(set(chosen)) == len(chosen) and max(chosen) < n):
        raise ScenarioError("system.position_states", list(chosen), f"must be different numbers below {n}")
    if C is None and chosen is None and n > 7:
        rule = f"is required for a system of {n} states (positions have one to three coordinates)"
        raise ScenarioError("system.position_states", None, rule)


def check_shapes(model: models.ScenarioModel, system: LinearSystem) -> None:
    """Check each vector and matrix against the system's n states, m inputs, d position coordinates."""
    n, m, d = system.n, system.m, system.d
    start = model.initial_set
    if isinstance(start, models.InitialZonotope):
        for i, generator in enumerate(start.generators):
            check_length(f"initial_set.generators[{i}]", generator, n)
    if isinstance(model.tracking.weight, tuple):
        check_length("tracking.weight", model.tracking.weight, n)
    for name in ("center", "half_widths"):
        check_length(f"initial_set.{name}", getattr(start, name, range(n)), n)
    for path, part in (("goal", model.goal), *model.scene_parts()):
        for key in keys_of(part.MAKES).values():
            value, count = getattr(part, key.name), d if key.per == "axis" else n
            if key.name == "normals":
                for row, normal in enumerate(value):
                    check_length(f"{path}.normals[{row}]", normal, d)
                check_length(f"{path}.offsets_m", part.offsets_m, len(value))
            elif key.per and value is not None:
                vectors = {f"{path}.{key.name}": value}
                if isinstance(value[0], tuple):
                    vectors = {f"{path}.{key.name}[{row}]": each for row, each in enumerate(value)}
                for field, each in vectors.items():
                    check_length(field, each, count)
            elif key.name == "max_m_s" and isinstance(value, tuple):
                check_length(f"{path}.max_m_s", value, d)
            elif key.name == "bounds":
                check_length(f"{path}.bounds", value, len(part.rows))
    for path, spec in model.controllers():
        if not isinstance(spec, scene.AffineTable):
            continue
        if spec.reference.kind == "setpoint":
            check_length(f"{path}.reference.state", spec.reference.state, n)
        if spec.reference.kind == "nmt":
            hill_rate(system, f"{path}.reference.kind", "nmt")
        if spec.gain is not None and (len(spec.gain), len(spec.gain[0])) != (m, n):
            shape = f"{len(spec.gain)} x {len(spec.gain[0])} numbers"
            raise ScenarioError(f"{path}.gain", shape, f"must be {m} x {n} numbers")


def check_time(model: models.ScenarioModel) -> None:
    """Check that steps divide the horizon, periods divide steps, and that neither are too many."""
    horizon = model.horizon
    T, delta = horizon.duration_s, horizon.step_s
    if T / delta > MAX_STEPS:
        rule = f"must give at most {MAX_STEPS} steps, but gives {T / delta:.4g}"
        raise ScenarioError("horizon.step_s", delta, rule)
    K = whole_parts(T, delta)
    if not K:
        rule = f"must divide duration_s = {T:g} (a whole number of steps)"
        raise ScenarioError("horizon.step_s", delta, rule)
    if model.schedule.min_dwell_steps > K:
        rule = f"must be at most the number of steps, {K}"
        raise ScenarioError("schedule.min_dwell_steps", model.schedule.min_dwell_steps, rule)
    if (period := model.feedback.period_s) is not None:
        if T / period > MAX_STEPS:
            rule = f"must give at most {MAX_STEPS} periods in all, but gives {T / period:.4g}"
            raise ScenarioError("feedback.period_s", period, rule)
        if not whole_parts(delta, period):
            raise ScenarioError("feedback.period_s", period, f"must divide step_s = {delta:g}")


def check_names(model: models.ScenarioModel) -> None:
    """Check that names are unique: obstacles and keep-in sets together, controllers among themselves."""
    for group in (model.scene_parts(), model.controllers()):
        path_by_name: dict[str, str] = {}
        for path, part in group:
            if part.name in path_by_name:
                rule = f"must be unique; {path_by_name[part.name]} has it too"
                raise ScenarioError(f"{path}.name", part.name, rule)
            path_by_name[part.name] = path
    for path, controller in model.controllers():
        if controller.name in ("safety", "polaris"):
            rule = "must not be 'safety' or 'polaris', which the results use"
            raise ScenarioError(f"{path}.name", controller.name, rule)


def check_scene(model: models.ScenarioModel, unsafe: Sequence[Obstacle], system: LinearSystem) -> None:
    """Check that there is something to be safe from, and that proximity operations deal with it."""
    if not unsafe:
        raise ScenarioError("obstacles", [], "must hold at least one obstacle, unless there is a keep-in set")
    for (path, part), item in zip(model.scene_parts(), unsafe, strict=False):  # those of navigation come last
        moving, velocity = "velocity_m_s", getattr(part, "velocity_m_s", None) or 0.0
        if isinstance(item, SatelliteObstacle):
            moving, velocity = "state", system.velocity @ np.asarray(item.state)
            with in_file_terms(path, part):
                item.pushes(system)
                directions(system.d, item.facets)
        T = model.horizon.duration_s
        if isinstance(item, StateLimit) and max(item.begins * (1 + TIME), item.ends or 0.0) > T * (1 + TIME):
            rule = f"must begin and end within duration_s = {T:g} (without until_s it holds for ever)"
            raise ScenarioError(f"{path}.from_s", [item.begins, item.ends], rule)
        if isinstance(item, TurningKeepIn) and model.abort is not None:
            rule = f"must be left out with the turning set {path}: drifts and aborts are not proven for it"
            raise ScenarioError("abort", "a table", rule)
        if (speed := float(np.linalg.norm(velocity))) > MAX_SPEED_M_S:
            rule = f"must move at most at {MAX_SPEED_M_S:g} m/s"
            raise ScenarioError(f"{path}.{moving}", f"{speed:.4g} m/s", rule)
    if system.mean_motion is not None:
        reach = float(np.linalg.norm(system.position @ np.array(model.initial_set.center)))
        if reach > HILL_RANGE_M:
            rule = f"must start within {HILL_RANGE_M:g} m of the target, where Hill's linear equations hold"
            raise ScenarioError("initial_set.center", f"{reach:.4g} m away", rule)
        speed = float(np.linalg.norm(system.velocity @ np.array(model.initial_set.center)))
        if speed > MAX_SPEED_M_S:
            rule = f"must be at most {MAX_SPEED_M_S:g} m/s past the target; is the chaser on another orbit?"
            raise ScenarioError("initial_set.center", f"{speed:.4g} m/s", rule)


def check_start_and_goal(
    model: models.ScenarioModel, unsafe: Iterable[Obstacle], system: LinearSystem, theta: Zonotope
) -> None:
    """Refuse a start or a hold point that is unsafe as it stands.

    The initial set must not reach into an obstacle or out of a keep-in set at t = 0, nor a hold point lie in
    an obstacle at its arrival or out of a keep-in set.
    """
    place, end = system.position @ theta, model.horizon.duration_s
    for (path, _), item in zip(model.scene_parts(), unsafe, strict=False):  # those of navigation hold later
        if isinstance(item, StateLimit):
            spots = {"initial_set.center": (model.initial_set.center, item.begins > 0)}
            if isinstance(model.goal, StationaryGoal):
                spots["goal.state"] = (model.goal.state, item.ends is not None)
            for field, (state, later) in spots.items():
                slack = float(item.slack(np.array(state), system))
                if not later and slack < -_TOUCH_M:
                    rule = f"must be a state that {path} ({item.name}) allows; it is {-slack:.4g} m beyond"
                    raise ScenarioError(field, list(state), rule)
            continue
        inward = isinstance(item, KeepIn)
        side, into, wrong = ("inside", "out of it", "outside") if inward else ("outside", "into it", "inside")
        region = f"{side} {path} ({item.name})"
        if (depth := unsafe_depth(item, Zonotope.point(place.c), 0.0, system)) > _TOUCH_M:
            rule = f"must be {region}; the start is {depth:.4g} m {wrong}"
            raise ScenarioError("initial_set.center", list(model.initial_set.center), rule)
        if (depth := unsafe_depth(item, place, 0.0, system)) > _TOUCH_M:
            rule = f"must keep the initial set {region}; the set reaches {depth:.4g} m {into}"
            raise ScenarioError(*_size_of(model), rule)
        # Where another satellite is at the end is uncertain; the planner decides.
        if isinstance(model.goal, StationaryGoal) and not isinstance(item, SatelliteObstacle):
            spot = Zonotope.point(system.position @ np.array(model.goal.state))
            if (depth := unsafe_depth(item, spot, end, system)) > _TOUCH_M:
                rule = f"must be {region}{'' if inward else ' at the end'}; it is {depth:.4g} m {wrong}"
                raise ScenarioError("goal.state", list(model.goal.state), rule)


def _size_of(model: models.ScenarioModel) -> tuple[str, Any]:
    """Return the field that gives the initial set its size, and its value."""
    spec = model.initial_set
    field = next(key for key in ("half_widths", "position_radius_m", "generators") if hasattr(spec, key))
    return f"initial_set.{field}", np.array(getattr(spec, field)).tolist()


def unsafe_depth(item: Obstacle, place: Zonotope, time: float, system: LinearSystem) -> float:
    """Largest depth [m] to which some point of a set of positions is unsafe; negative if none is."""
    spans = place.G
    if isinstance(item, SatelliteObstacle):  # it may be anywhere in its own box
        spans = np.hstack([spans, system.position @ np.diag(np.asarray(item.state_half_widths))])
    return item.shape.overlap(Zonotope(place.c - item.centre(time, system), spans))


def full_weight(weight: ArrayLike) -> Array:
    """Weight matrix from its diagonal or from itself, made exactly symmetric."""
    matrix = np.asarray(weight, dtype=float)
    if matrix.ndim == 1:
        return np.diag(matrix)
    return np.asarray((matrix + matrix.T) / 2)


def check_numerics(model: models.ScenarioModel, system: LinearSystem) -> None:
    """Check that the step suits the dynamics, and that the inputs can stabilise them."""
    modes, delta = np.linalg.eigvals(system.A), model.horizon.step_s
    fastest, growth = float(np.max(np.abs(modes))), float(np.max(modes.real))
    if fastest * delta > 1e3 or growth * delta > 20:
        rule = f"must be at most {20 / fastest:.3g} s for the fastest mode, {fastest:.3g} rad/s"
        raise ScenarioError("horizon.step_s", delta, rule)
    eigenvalue = _missed_mode(system.A, system.B)
    if eigenvalue is not None:
        field = "system.B" if model.system.kind == "linear" else "system"
        rule = f"must control every mode that does not decay (not stabilisable: eigenvalue {eigenvalue:.4g})"
        raise ScenarioError(field, system.B.tolist(), rule)


def _missed_mode(A: np.ndarray, B: np.ndarray) -> complex | None:
    """Return an eigenvalue with real part >= 0 that B does not reach (Popov-Belevitch-Hautus), or None."""
    A_scale = max(float(np.abs(A).max()), np.finfo(float).tiny)
    reach = B / np.maximum(np.linalg.norm(B, axis=0), np.finfo(float).tiny)
    for mode in np.linalg.eigvals(A):
        if mode.real < -1e-7 * A_scale:
            continue
        test = np.hstack([(A - mode * np.eye(len(A))) / A_scale, reach])
        if np.linalg.svd(test, compute_uv=False)[-1] < 1e-7:
            return complex(mode)
    return None


def weights(model: models.ScenarioModel) -> Iterator[tuple[str, Any, Any]]:
    """Yield each pair of LQR weights with its path in the file; a controller has these or a gain."""
    yield "tracking", model.tracking.Q, model.tracking.R
    for path, spec in model.controllers():
        if not isinstance(spec, scene.AffineTable):
            continue
        missing = [name for name in "QR" if getattr(spec, name) is None]
        if spec.gain is None and missing:
            raise ScenarioError(f"{path}.{missing[0]}", None, "must be given: Q and R, or gain")
        if spec.gain is None:
            yield path, spec.Q, spec.R
        elif spec.Q is not None or spec.R is not None:
            raise ScenarioError(f"{path}.gain", spec.gain, "give gain or Q and R, not both")


def check_weights(path: str, Q: Any, R: Any, system: LinearSystem) -> None:
    """Check that Q is semidefinite, R definite, and their Riccati equation has a stabilising solution."""
    from scipy.linalg import LinAlgError, solve_continuous_are

    for name, value, size in (("Q", Q, system.n), ("R", R, system.m)):
        field, matrix = f"{path}.{name}", np.asarray(value, dtype=float)
        if matrix.shape not in ((size,), (size, size)):
            shape = " x ".join(str(s) for s in matrix.shape) + " numbers"
            rule = f"must have {size} numbers (the diagonal) or be {size} x {size}"
            raise ScenarioError(field, shape, rule)
        scale = float(np.abs(matrix).max())
        if matrix.ndim == 2 and np.abs(matrix - matrix.T).max() > 1e-9 * scale:
            raise ScenarioError(field, matrix.tolist(), "must be symmetric")
        least = float(np.linalg.eigvalsh(full_weight(matrix)).min())
        if name == "R" and not least > 1e-12 * scale:
            rule = f"must be positive definite (least eigenvalue {least:.3g})"
            raise ScenarioError(field, matrix.tolist(), rule)
        if name == "Q" and not least >= -1e-12 * scale:
            rule = f"must be positive semidefinite (least eigenvalue {least:.3g})"
            raise ScenarioError(field, matrix.tolist(), rule)
    Qm, Rm = full_weight(Q), full_weight(R)
    eigenvalue = _missed_mode(system.A.T, Qm)
    if eigenvalue is not None:
        rule = f"must weight every mode that does not decay (eigenvalue {eigenvalue:.4g} has no weight)"
        raise ScenarioError(f"{path}.Q", np.asarray(Q).tolist(), rule)
    try:
        P = solve_continuous_are(system.A, system.B, Qm, Rm)
        loop = system.A - system.B @ np.linalg.solve(Rm, system.B.T @ P)
        stable = bool(np.linalg.eigvals(loop).real.max() < 0)
    except (LinAlgError, ValueError):
        stable = False
    if not stable:
        rule = "must give a solvable Riccati equation with R; bring the weights closer together"
        raise ScenarioError(f"{path}.Q", np.asarray(Q).tolist(), rule)
