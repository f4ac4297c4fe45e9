"""Whether everything a schedule is made from speaks of one system, one time grid and one reference.

A tube says nothing about a flight under other limits, other disturbances or another period. What comes
out of one `Problem` belongs together by construction; what is assembled by hand, or taken from another
scenario, is looked at here before anything is proven with it.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from reach.numerics.linear import discretize
from reach.sets.zonotope import Zonotope

from ..model.errors import ScenarioError
from ..model.system import Array, LinearSystem
from ..model.tolerances import ROUNDING
from ..planning.reference import Reference
from .ball_sets import BallSets
from .controllers import AffineController, AnyThrust, Controller, TubeSegment
from .end_condition import judge_end, tail_length
from .error_bounds import get_err_bounds
from .get_safety import Safety
from .planning_problem import perceive_unsafe
from .problem import Problem

SYSTEM = ("A", "B", "D", "u_max", "w_max", "position", "mass", "mean_motion", "navigation", "thrusters")
"""What two systems are compared by."""


def check_safety(safety: Safety, problem: Problem) -> None:
    """Refuse a `Safety` that is not about a problem: changed afterwards, or made for another.

    Raises
    ------
    ScenarioError
        Naming the part, what it has, and what it must have.
    """
    tracking, reference, clearance, s = safety.tracking, safety.reference, safety.clearance, safety.controller
    if type(s) is not AffineController or s.clips:
        raise ScenarioError("safety.controller", type(s).__name__, "must be an AffineController without clip")
    for name, part in (("tracking", tracking), ("reference", reference), ("controller", s)):
        _same_system(f"safety.{name}", part.system, problem.system)
    _same("safety.tracking.delta", tracking.delta, problem.delta, "step of the problem")
    _same("safety.tracking.share", tracking.share, problem.thrust_share, "problem's")
    feedback = tracking.feedback
    _same("safety.tracking.feedback.sampled", feedback.sampled, problem.period is not None, "problem's")
    if problem.period is not None:
        nodes = round(problem.delta / problem.period)
        _same("safety.tracking.feedback.nodes_per_cell", feedback.nodes_per_cell, nodes, "problem's periods")
    _check_reference("safety.reference", reference, problem)
    _same("safety.clearance.planned", clearance.planned, problem.K, "number of steps of the problem")
    parts = (
        ("controller.reference", s.reference, reference),
        ("controller.own", s.own, reference),
        ("controller.tracking", s.tracking, tracking),
        ("clearance.tracking", clearance.tracking, tracking),
        ("clearance.reference", clearance.reference, reference),
        ("recoverable.clearance", getattr(safety.recoverable, "clearance", clearance), clearance),
    )
    for name, found, wanted in parts:
        if found is not wanted:
            raise ScenarioError(f"safety.{name}", type(found).__name__, "must be this Safety's own")
    _same("safety.controller.gain", s.gain, tracking.gain, "gain of its tracking")
    theta = problem.initial_set - reference.chi[0]
    _same("safety.start", safety.start.c, theta.c, "initial set of the problem, about the reference")
    _same("safety.start", safety.start.G, theta.G, "initial set of the problem, about the reference")
    sets = perceive_unsafe(problem, reference.cells)
    _same("safety.clearance.unsafe", [u.name for u in clearance.unsafe], [u.name for u in sets], "problem's")
    for given, asked in zip(clearance.unsafe, sets, strict=True):
        _same(f"the normals of {given.name}", given.normals, asked.normals, "problem's")
        cells = min(given.cells, reference.cells)
        _same(f"the cells of {given.name}", cells, reference.cells, "reference's")
        _same(f"the offsets of {given.name}", given.offsets[:cells], asked.offsets, "problem's")
    _check_proof(safety, problem)


def _check_proof(safety: Safety, problem: Problem) -> None:
    """What `get_safety` proves of a reference and of recoverable sets, worked out again."""
    reference, clearance, recoverable = safety.reference, safety.clearance, safety.recoverable
    _check_motion(reference, problem.K, clearance.jump)
    if isinstance(recoverable, BallSets):
        bounds = get_err_bounds(safety.tracking, problem.bound, problem.weight)
        for name in ("W", "beta", "gamma_position", "gain_position", "gamma_input", "gain_input"):
            rule = "error bound of its own tracking"
            _same(
                f"safety.recoverable.bounds.{name}",
                getattr(recoverable.bounds, name),
                getattr(bounds, name),
                rule,
            )
    if safety.guarantee != "proved":
        return
    margin = recoverable.margin_at(0, safety.start)
    if not margin.inside:
        raise ScenarioError("safety.recoverable", str(margin), "must hold the initial set at the start")
    if not safety.end.proven:
        return
    tail = reference.cells - problem.K
    if tail != tail_length(safety.tracking):
        length = tail_length(safety.tracking)
        rule = f"must be followed by {length} steps without input where {safety.end.horizon} is claimed"
        raise ScenarioError("safety.reference", f"{tail} steps after the end", rule)
    end = judge_end(safety.tracking, reference, problem.K, tail, clearance.unsafe, margin)
    _same("safety.end.horizon", safety.end.horizon, end.horizon, "one that its own parts show")
    _same("safety.end.until", safety.end.until, end.until, "one that its own parts show")


def _check_motion(reference: Reference, planned: int, jump: Array) -> None:
    """The safe reference must move as the system does under its inputs, but for the jump into its tail."""
    Ad, Bd = discretize(reference.system.A, reference.system.B, reference.delta)
    before, after, nu = reference.chi[:-1], reference.chi[1:], reference.nu
    off = np.abs(after - before @ Ad.T - nu @ Bd.T)
    booked = ROUNDING * np.max(
        np.abs(before) @ np.abs(Ad).T + np.abs(nu) @ np.abs(Bd).T + np.abs(after), axis=0
    )
    allowed = np.tile(booked, (len(off), 1))
    if reference.cells > planned:
        allowed[planned - 1] += jump
        if np.any(nu[planned:]):
            raise ScenarioError("safety.reference.nu", "an input after the end", "must be zero from there on")
    k = int(np.argmax(np.max(off - allowed, axis=1)))
    if not np.all(off <= allowed):
        rule = "must move as the system does under its inputs"
        raise ScenarioError("safety.reference.chi", f"{float(off[k].max()):.3g} off in step {k}", rule)


def check_controller(controller: Controller, safety: Safety) -> None:
    """Refuse an experimental controller over another system, time grid or safe reference.

    Of a class of one's own only what it shows can be compared: `system`, `reference`, `tracking`, `own`.

    Raises
    ------
    ScenarioError
        Naming the controller, what it has, and what it must have.
    """
    if not isinstance(getattr(controller, "name", None), str) or not callable(
        getattr(controller, "fly", None)
    ):
        rule = "must be a Controller: a name in text, and fly and command (AnyThrust is one)"
        raise ScenarioError("experimental", type(controller).__name__, rule)
    name, problem = controller.name, safety.problem
    reference = getattr(controller, "reference", safety.reference)
    tracking = getattr(controller, "tracking", safety.tracking)
    if reference is not safety.reference or tracking is not safety.tracking:
        rule = "was built on the reference of another Safety; build it on this one's"
        raise ScenarioError("experimental", name, rule)
    _same_system(name, getattr(controller, "system", problem.system), problem.system)
    _check_reference(f"{name}.own", getattr(controller, "own", reference), problem)


def check_segment(controller: Controller, start: Zonotope, tube: Any, safety: Safety) -> TubeSegment:
    """What a controller of a class of one's own returns: sets of the right shapes that hold the start.

    Raises
    ------
    ScenarioError
        If it is no tube from that start over one step.
    """
    if type(controller) in (AffineController, AnyThrust) and isinstance(tube, TubeSegment):
        return tube
    name, n, q = f"{controller.name}.fly", safety.problem.system.n, safety.tracking.feedback.nodes_per_cell
    if not isinstance(tube, TubeSegment):
        raise ScenarioError(name, type(tube).__name__, "must return a polaris.TubeSegment")
    _same(f"{name}.nodes", tube.nodes.c.shape, (q + 1, n), "one set per node of the step")
    _same(f"{name}.bow", np.shape(tube.bow), (q, n), "one row per part of the step")
    _same(f"{name}.end", tube.end.c.shape, (n,), "one set of states")
    if tube.refused:
        return tube
    if not np.all(tube.bow >= 0):
        raise ScenarioError(f"{name}.bow", float(np.min(tube.bow)), "must not be negative")
    rows = np.vstack([np.eye(n), -np.eye(n)])
    for told, inner, outer in (("nodes", start, tube.nodes[0]), ("end", tube.nodes[-1], tube.end)):
        size = np.abs(inner.c) + inner.half_widths
        short = inner.support(rows) - outer.support(rows) - ROUNDING * np.concatenate([size, size])
        if not np.all(short <= 0):
            rule = "must contain " + ("the set it starts from" if told == "nodes" else "its last node")
            raise ScenarioError(f"{name}.{told}", f"{float(np.nanmax(short)):.3g} short", rule)
    return tube


def _same_system(field: str, found: LinearSystem, wanted: LinearSystem) -> None:
    for name in SYSTEM if found is not wanted else ():
        _same(f"{field}.system.{name}", getattr(found, name), getattr(wanted, name), "problem's own")


def _check_reference(field: str, reference: Reference, problem: Problem) -> None:
    _same_system(field, reference.system, problem.system)
    _same(f"{field}.delta", reference.delta, problem.delta, "step of the problem")
    if reference.cells < problem.K:
        raise ScenarioError(field, f"{reference.cells} steps", f"must cover {problem.K} steps")
    shape = (reference.cells + 1, problem.system.n), (reference.cells, problem.system.m)
    _same(f"{field}.chi and nu", (np.shape(reference.chi), np.shape(reference.nu)), shape, "shapes of a path")
    if not (np.all(np.isfinite(reference.chi)) and np.all(np.isfinite(reference.nu))):
        raise ScenarioError(field, "nan or inf", "must be finite numbers")


def _same(field: str, found: Any, wanted: Any, whose: str) -> None:
    if np.array_equal(np.asarray(found, dtype=object), np.asarray(wanted, dtype=object)):
        return
    a, b = (np.asarray(value).tolist() if np.size(value) <= 12 else "an array" for value in (found, wanted))
    raise ScenarioError(field, a, f"must be the {whose}, {b}" if a != b else f"must be the {whose}")
