"""From scenario models to the domain's objects: system, initial set, goal, obstacles, keep-in sets."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from reach.sets.ellipsoid import ball_generators
from reach.sets.zonotope import Zonotope

from ..model.checks import counted
from ..model.errors import ScenarioError
from ..model.hill import clohessy_wiltshire
from ..model.system import Array, LinearSystem
from ..model.tolerances import TIME
from . import tables as models

if TYPE_CHECKING:
    pass


def whole_parts(total: float, part: float) -> int | None:
    """How many times `part` goes into `total`; None if not a whole number of times."""
    ratio = total / part
    if not math.isfinite(ratio):
        return None
    count = round(ratio)
    return count if abs(ratio - count) <= TIME * max(count, 1) else None


def build_system(spec: models.System) -> LinearSystem:
    """The controlled system."""
    if isinstance(spec, models.ClohessyWiltshire):
        limit = _limits("system.thrust_max_N", spec.thrust_max_N, 3)
        return clohessy_wiltshire(spec.mean_motion_rad_s, spec.mass_kg, limit, spec.disturbance_max_m_s2)
    limit = _limits("system.input_max", spec.input_max, len(spec.B[0]))
    C = None if spec.C is None else np.array(spec.C)
    if spec.position_states is not None:
        C = np.eye(len(spec.A))[list(spec.position_states)]
    return LinearSystem(
        np.array(spec.A), np.array(spec.B), np.array(spec.D), limit, spec.disturbance_max, C, spec.mass_kg
    )


def check_length(field: str, vector: Sequence[Any], count: int) -> None:
    """Refuse a list of another length."""
    if len(vector) != count:
        raise ScenarioError(field, list(vector), f"must have {counted(count, 'number')}, has {len(vector)}")


def _limits(field: str, given: float | tuple[float, ...], count: int) -> Array:
    """Limits of all inputs, shape (count,), from one number for all or one each."""
    if isinstance(given, tuple):
        check_length(field, given, count)
    return np.broadcast_to(np.asarray(given, dtype=float), (count,)).copy()


def position_states(system: LinearSystem) -> list[int] | None:
    """Indices of the states that are the position, or None if the position is no choice of states."""
    C = system.position
    if not (np.all((C == 0) | (C == 1)) and np.all(C.sum(axis=1) == 1) and np.all(C.sum(axis=0) <= 1)):
        return None
    return [int(row.argmax()) for row in C]


def build_initial_set(spec: models.InitialSet, system: LinearSystem) -> Zonotope:
    """The initial set Theta as a zonotope; a ball is enclosed."""
    center = np.array(spec.center, dtype=float)
    if isinstance(spec, models.InitialBox):
        return Zonotope.box(center, spec.half_widths)
    if isinstance(spec, models.InitialZonotope):
        return Zonotope(center, np.array(spec.generators, dtype=float).T)
    place = position_states(system)
    if place is None:
        rule = "a ball needs a position that is a choice of states; use a box or a zonotope"
        raise ScenarioError("initial_set.kind", spec.kind, rule)
    rest = [i for i in range(system.n) if i not in place]
    blocks = [
        np.eye(system.n)[:, states] @ ball_generators(len(states), radius)
        for states, radius in ((place, spec.position_radius_m), (rest, spec.velocity_radius_m_s))
        if states
    ]
    return Zonotope(center, np.hstack(blocks))


def full_weight(weight: ArrayLike) -> Array:
    """Weight matrix from its diagonal or from itself, made exactly symmetric."""
    matrix = np.asarray(weight, dtype=float)
    if matrix.ndim == 1:
        return np.diag(matrix)
    return np.asarray((matrix + matrix.T) / 2)
