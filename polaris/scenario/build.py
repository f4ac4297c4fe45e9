"""From scenario models to the domain's objects: system, initial set, goal, obstacles, keep-in sets."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from reach.sets.ellipsoid import ball_generators
from reach.sets.zonotope import Zonotope

from ..model.errors import ScenarioError
from ..model.hill import clohessy_wiltshire
from ..model.system import Array, LinearSystem
from ..model.tolerances import TIME
from . import scene_tables as scene
from . import tables as models

if TYPE_CHECKING:
    from ..model.obstacle import Obstacle


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
        return clohessy_wiltshire(
            spec.mean_motion_rad_s, spec.mass_kg, spec.thrust_max_N, spec.disturbance_max_m_s2
        )
    n, m = len(spec.A), len(spec.B[0])
    C = None if spec.C is None else np.array(spec.C)
    if spec.position_states is not None:
        C = np.eye(n)[list(spec.position_states)]
    return LinearSystem(
        A=np.array(spec.A),
        B=np.array(spec.B),
        D=np.array(spec.D),
        u_max=np.broadcast_to(np.asarray(spec.input_max, dtype=float), (m,)).copy(),
        w_max=spec.disturbance_max,
        C=C,
        mass=spec.mass_kg,
    )


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


def in_file_terms(error: ScenarioError, path: str, spec: scene.Obstacle | scene.KeepIn) -> ScenarioError:
    """The domain's own error with the field's name in the file (``H`` is called normals there)."""
    name = error.field.rpartition(".")[2]
    name = {"H": "normals", "b": "offsets_m"}.get(name, name)
    known = [field for field in type(spec).model_fields if field == name or field.startswith(f"{name}_")]
    rule = error.rule.replace("H p <= b", "normals p <= offsets_m")
    return ScenarioError(f"{path}.{known[0]}" if known else path, error.given, rule, error.where)


def build_obstacles(model: models.ScenarioModel) -> tuple[Obstacle, ...]:
    """Every unsafe set: obstacles first, then keep-in sets.

    Raises
    ------
    ScenarioError
        If one of them is not a set the perception oracle can deal with.
    """
    made = []
    for path, part in model.scene_parts():
        try:
            made.append(part.build(path))
        except ScenarioError as error:
            raise in_file_terms(error, path, part) from error
    return tuple(made)
