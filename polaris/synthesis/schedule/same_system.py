"""Checks that the parts of a schedule speak of one system, one time grid and one reference.

A tube says nothing about a flight under other limits, other disturbances or another period. What comes
out of one `Problem` belongs together by construction; a part assembled by hand, or taken from another
scenario, is looked at here before anything is proven with it.
"""

from dataclasses import fields, is_dataclass, replace
from typing import Any

import numpy as np

from reach.sets.zonotope import Zonotope

from ...model.craft import Craft
from ...model.errors import ScenarioError, SynthesisInfeasible
from ...model.system import Array
from ...model.tolerances import REFERENCE, ROUNDING
from ..controllers.black_box import BlackBox
from ..controllers.controllers import AffineController, AnyThrust, Controller, TubeSegment
from ..controllers.neural import NeuralController
from ..safety.get_safety import Safety, get_safety
from ..safety.problem import Problem

UNPROVEN = ("problem", "plan", "start_margin", "seconds", "cut_by_clock", "_relaxed", "_levels")
"""Fields that no proof rests on: the problem's request, its search, and reports or caches."""


def check_safety(safety: Safety, problem: Problem) -> None:
    """Refuse a `Safety` that differs from Algorithm 1's of a problem along the same plan.

    Its kind of recoverable set and its share of thrust may be others than the problem asks for.

    Raises `ScenarioError`, naming the part, its value, and the required value.
    """
    _equal("safety.plan.nu", np.shape(safety.plan.nu), (problem.K, problem.system.m), "shape of the inputs")
    _equal_parts("safety.tracking.system", safety.tracking.system, problem.system)
    try:
        kind, share = safety.recoverable.kind, safety.problem.thrust_share
        derived = get_safety(replace(problem, recoverable=kind, thrust_share=share), along=safety.plan)
    except SynthesisInfeasible as error:
        rule = "must contain the initial set at the start"
        raise ScenarioError("safety.recoverable", str(error), rule) from error
    _equal_parts("safety", safety, derived)


def check_controller(controller: Controller, safety: Safety) -> None:
    """Refuse an experimental controller over another system, time grid or safe reference.

    Of a user-defined class only its attributes can be compared: `system`, `reference`, `tracking`, `own`.

    Raises `ScenarioError`, naming the controller, its value, and the required value.
    """
    if not isinstance(getattr(controller, "name", None), str) or not callable(
        getattr(controller, "propagate", None)
    ):
        rule = "must be a Controller: a name in text, and fly and command (AnyThrust is one)"
        raise ScenarioError("experimental", type(controller).__name__, rule)
    name, problem, K = controller.name, safety.problem, safety.problem.K
    reference = getattr(controller, "reference", safety.reference)
    tracking = getattr(controller, "tracking", safety.tracking)
    if reference is not safety.reference or tracking is not safety.tracking:
        rule = "must be built on the reference of this Safety, not of another one"
        raise ScenarioError("experimental", name, rule)
    system, own = getattr(controller, "system", problem.system), getattr(controller, "own", reference)
    _equal_parts(f"{name}.system", Craft.from_system(system), problem.system)
    for fault in problem.system.transients:
        within = isinstance(controller, AffineController) and np.all(np.abs(controller.gain) <= fault.gains)
        if isinstance(controller, NeuralController) and fault.networks is not None:
            within = np.all(controller.policy.steepest(problem.system, problem.unsafe) <= fault.networks)
        anything = isinstance(controller, AnyThrust) or (isinstance(controller, BlackBox) and fault.boxes)
        if not within and not anything:
            rule = f"must be any thrust or a law known to the problem, as {fault.name} is isolated late"
            raise ScenarioError(f"{name}.gain", type(controller).__name__, rule)
    _equal_parts(f"{name}.own.system", Craft.from_system(own.system), problem.system)
    _equal(f"{name}.own.delta", own.delta, problem.delta, "step of the problem")
    shapes = (max(own.cells, K) + 1, problem.system.n), (max(own.cells, K), problem.system.m)
    own_shapes = np.shape(own.chi), np.shape(own.nu)
    _equal(f"{name}.own.chi and nu", own_shapes, shapes, f"shapes of a path of {K} steps or more")
    if not (np.all(np.isfinite(own.chi)) and np.all(np.isfinite(own.nu))):
        raise ScenarioError(f"{name}.own", "nan or inf", "must be finite numbers")


def check_segment(controller: Controller, start: Zonotope, tube: Any, safety: Safety) -> TubeSegment:
    """Check the tube of a user-defined controller: sets of the right shapes that contain the start.

    Raises `ScenarioError` if it is no tube from that start over one step.
    """
    if type(controller) in (AffineController, AnyThrust, NeuralController) and isinstance(tube, TubeSegment):
        return tube
    name, n, q = f"{controller.name}.fly", safety.problem.system.n, safety.tracking.feedback.nodes_per_cell
    if not isinstance(tube, TubeSegment):
        raise ScenarioError(name, type(tube).__name__, "must return a polaris.TubeSegment")
    _equal(f"{name}.states", tube.states.c.shape, (q + 1, n), "one set per node of the step")
    _equal(f"{name}.intersample", np.shape(tube.intersample), (q, n), "one row per part of the step")
    _equal(f"{name}.end", tube.end.c.shape, (n,), "one set of states")
    if tube.refused:
        return tube
    if not np.all(tube.intersample >= 0):
        raise ScenarioError(f"{name}.intersample", float(np.min(tube.intersample)), "must not be negative")
    rows = np.vstack([np.eye(n), -np.eye(n)])
    for part, inner, outer in (("states", start, tube.states[0]), ("end", tube.states[-1], tube.end)):
        size = inner.extent
        short = inner.support(rows) - outer.support(rows) - ROUNDING * np.concatenate([size, size])
        if not np.all(short <= 0):
            rule = "must contain " + ("the set it starts from" if part == "states" else "its last node")
            raise ScenarioError(f"{name}.{part}", f"{float(np.nanmax(short)):.3g} short", rule)
    return tube


def _equal_parts(field: str, actual: Any, needed: Any) -> None:
    """Refuse a value that differs from the required one in kind or parts, its arrays beyond rounding."""
    if actual is needed:
        return
    if is_dataclass(needed):
        if type(actual) is not type(needed):
            raise ScenarioError(field, type(actual).__name__, f"must be of the kind {type(needed).__name__}")
        for part in fields(needed):
            if part.name not in UNPROVEN:
                _equal_parts(f"{field}.{part.name}", getattr(actual, part.name), getattr(needed, part.name))
    elif isinstance(needed, tuple) and isinstance(actual, tuple) and len(actual) == len(needed):
        for i, (one, other) in enumerate(zip(actual, needed, strict=True)):
            _equal_parts(f"{field}[{i}]", one, other)
    elif not (isinstance(needed, np.ndarray) and _close(actual, needed)):
        _equal(field, actual, needed, "one that its problem and plan lead to")


def _close(actual: Any, needed: Array) -> bool:
    same = isinstance(actual, np.ndarray) and actual.shape == needed.shape
    return same and bool(np.all(np.abs(actual - needed) <= REFERENCE * np.max(np.abs(needed), initial=0.0)))


def _equal(field: str, actual: Any, needed: Any, label: str) -> None:
    if np.array_equal(np.asarray(actual, dtype=object), np.asarray(needed, dtype=object)):
        return
    a, b = (np.asarray(value).tolist() if np.size(value) <= 12 else "an array" for value in (actual, needed))
    raise ScenarioError(field, a, f"must be the {label}, {b}" if a != b else f"must be the {label}")
