"""Containment of the sets that the scenario describes in the timed polytopes, at all times.

A polytope contains a set if each of its facets lies beyond the set's support in that direction. All
supports are worked out here anew, from the scenario's numbers.
"""

import math
from collections.abc import Callable
from typing import Any

from flint import arb

from ..files.document import ROUNDED, Document
from ..files.entries import UnsafeSet
from ..kernel.balls import absolute, absolute_dot, column, cross, dot, matrix, norms, require
from ..kernel.verdict import Rejected
from .allocation import per_axis
from .navigation import holding
from .satellites import Satellite
from .state_limits import KINDS, check_states

SLOPE = 1e-6  # least sine of the angle of a cone, and of the angle between two of its facets


def check_unsafe(document: Document, scenario: dict[str, Any]) -> int:
    """Check every unsafe set of the certificate, in the scenario's order; returns their number."""
    pending, radius = list(document.unsafe), scenario.get("chaser", {}).get("radius_m", 0.0)
    if document.chaser_radius != radius:
        text = f"the chaser's radius is {document.chaser_radius} in the certificate, {radius} in the scenario"
        raise Rejected("unsafe_sets", text)
    clock = arb(document.timing.get("clock", 0.0))  # compared before, as what jitter displaces
    offset = norms((absolute(matrix(document.C)) * column(document.state_offset)).transpose())[0]
    obstacles = scenario.get("obstacles", ())
    keep_in = [_shrunk(spec, radius + offset) for spec in scenario.get("keep_in", ())]
    has_others = any(spec["kind"] == "satellite" for spec in obstacles)
    if document.satellites != has_others:
        article, assumed = ("", "nothing") if has_others else ("no ", "something")
        text = f"the scenario has {article}other satellites, but {assumed} is assumed of them"
        raise Rejected("assumptions", text)
    for spec in obstacles:
        if not pending or pending[0].name != spec["name"] or pending[0].keep_in:
            raise Rejected("unsafe_sets", f"{spec['name']} is missing")
        if spec["kind"] in KINDS:
            check_states(document, [pending.pop(0)], spec, inside=False)
        else:
            _check_obstacle(document, pending.pop(0), spec, radius + offset + clock * _speed(spec, clock))
    for spec in keep_in:
        facets: list[UnsafeSet] = []
        while pending and pending[0].keep_in and pending[0].name == f"{spec['name']}[{len(facets)}]":
            facets.append(pending.pop(0))
        if spec["kind"] in KINDS:
            check_states(document, facets, spec, inside=True)
            continue
        for item in facets:
            if item.of_state or len(item.normals) != 1 or not item.resting:
                raise Rejected("unsafe_sets", f"{item.name} must be one halfspace at rest")
        _check_keep_in(document, facets, spec)
    navigation = scenario.get("navigation", {})
    phases = navigation.get("phases", ())
    first = {"from_s": 0.0} | navigation.get("measurement", navigation)
    end_times = [*(phase["from_s"] for phase in phases), math.inf]
    names = ["within", *(f"within-{i}" for i in range(len(phases)))]
    for name, spec, ends in zip(names, (first, *phases), end_times, strict=True):
        if "within_m" in spec:
            facets, pending = pending[: 2 * len(document.C)], pending[2 * len(document.C) :]
            _check_within(document, facets, name, spec, ends, radius + offset)
    if pending:
        raise Rejected("unsafe_sets", f"{pending[0].name} is not in the scenario")
    return len(document.unsafe)


def _speed(spec: dict[str, Any], clock: arb) -> arb:
    """Return the speed of a set."""
    if spec["kind"] == "satellite" and clock > 0:
        raise Rejected("unsafe_sets", f"{spec['name']} is not bounded under clock errors")
    return _length([arb(x) for x in spec.get("velocity_m_s") or [0.0]])


def _shrunk(spec: dict[str, Any], radius: arb) -> dict[str, Any]:
    """Return the scenario's entry of a keep-in set, its facets moved inwards by a radius."""
    if radius == 0 or spec["kind"] in KINDS:
        return spec
    if spec["kind"] == "polytope":
        lengths = [_length([arb(x) for x in normal]) for normal in spec["normals"]]
        return spec | {
            "offsets_m": [b - radius * size for b, size in zip(spec["offsets_m"], lengths, strict=True)]
        }
    inwards = radius / (arb(spec["half_angle_deg"]) * arb.pi() / 180).sin()
    axis = [arb(x) for x in spec["axis"]]
    length = _length(axis)
    apex = [a + inwards * x / length for a, x in zip(spec["apex_m"], axis, strict=True)]
    cut = spec.get("length_m")
    return spec | {"apex_m": apex} | ({} if cut is None else {"length_m": cut - radius - inwards})


# -- obstacles --------------------------------------------------------------------------------------


def _check_obstacle(
    document: Document, item: UnsafeSet, spec: dict[str, Any], radius: arb | float = 0.0
) -> None:
    """Check that a timed polytope contains an obstacle with a ball of a radius [m] about each of its points.

    The support of that sum is the sum of both supports, so a kind states that of its own shape alone.
    """
    if item.of_state:
        raise Rejected("unsafe_sets", f"{item.name} is a set of positions, not of states")
    if spec["kind"] == "satellite":
        _check_count(item, _directions(document, spec))
        Satellite(document, item, spec | {"radius_m": spec["radius_m"] + radius}).check()
        return
    d, (facets, support) = len(document.C), RIGID[spec["kind"]]
    v, anchor = (spec.get(key) or [0.0] * d for key in ("velocity_m_s", "center_m"))
    _check_count(item, facets(document, spec))
    if not any(v) and not item.resting:
        raise Rejected("unsafe_sets", f"{item.name} is at rest in the scenario, but moves in the certificate")
    for f, normal in enumerate(item.normals):
        n = [arb(x) for x in normal]
        extent = support(document, item, spec, f) + radius * _length(n)
        base, rate = extent + dot(n, anchor), dot(n, v)
        size, speed = abs(extent) + absolute_dot(n, anchor), absolute_dot(n, v)
        for cell in range(len(item.start)):
            for place in (0, 1):
                t, offset = arb(cell + place) * document.delta, (item.start, item.end)[place][cell][f]
                witness = f"{item.name}, facet {f}, at the {('start', 'end')[place]} of step {cell}"
                require("unsafe_sets", offset - (base + rate * t) + (size + speed * t) * ROUNDED, witness)


def _box_support(document: Document, item: UnsafeSet, spec: dict[str, Any], f: int) -> arb:
    return dot([abs(arb(x)) for x in item.normals[f]], spec["half_widths_m"])


def _ball_support(document: Document, item: UnsafeSet, spec: dict[str, Any], f: int) -> arb:
    return _length([arb(x) for x in item.normals[f]]) * arb(spec["radius_m"])


def _polytope_support(document: Document, item: UnsafeSet, spec: dict[str, Any], f: int) -> arb:
    return _row_support(item.normals[f], spec, f, item.name)


def _check_count(item: UnsafeSet, count: int) -> None:
    if len(item.normals) != count:
        raise Rejected("unsafe_sets", f"{item.name} has {len(item.normals)} facets, not {count}")


def _directions(document: Document, spec: dict[str, Any]) -> int:
    """Number of facets about a ball."""
    d = len(document.C)
    return 2 if d == 1 else int(spec.get("facets") or {2: 12, 3: 26}[d])


RIGID: dict[str, tuple[Callable[[Document, dict[str, Any]], int], Callable[..., arb]]] = {
    "box": (lambda document, spec: 2 * len(document.C), _box_support),
    "ball": (_directions, _ball_support),
    "polytope": (lambda document, spec: len(spec["normals"]), _polytope_support),
}
"""By kind of an obstacle that keeps its shape: how many facets it has, and its support along one of them,
at t = 0 and from its centre (from the origin without one)."""


def _length(n: list[arb]) -> arb:
    return dot(n, n).sqrt()


def _row_support(normal: list[float], spec: dict[str, Any], f: int, name: str) -> arb:
    """Support of a facet of a polytope along its normal, which is the scenario's up to rounding."""
    row = [arb(x) for x in spec["normals"][f]]
    length = _length(row)
    error = sum((abs(n - x / length) for n, x in zip(normal, row, strict=True)), arb(0))
    require("unsafe_sets", ROUNDED - error, f"a normal of {name} is turned")
    return arb(spec["offsets_m"][f]) / length


# -- keep-in sets -----------------------------------------------------------------------------------


def _check_keep_in(document: Document, facets: list[UnsafeSet], spec: dict[str, Any]) -> None:
    """Check that the polytope that the facets leave lies inside the set."""
    name = spec["name"]
    rows = [[-x for x in item.normals[0]] for item in facets]
    offsets = [-item.start[0][0] for item in facets]
    if spec["kind"] == "polytope":
        if len(facets) != len(spec["normals"]):
            raise Rejected("unsafe_sets", f"{name} has {len(facets)} facets, not {len(spec['normals'])}")
        for f, (row, offset) in enumerate(zip(rows, offsets, strict=True)):
            reach = _row_support(row, spec, f, name)
            slack = reach - offset + abs(reach) * ROUNDED
            require("unsafe_sets", slack, f"{name}, facet {f}, is too far out")
        return
    d = len(document.C)
    sides = (2 if d == 2 else int(spec.get("facets", 12))) + (spec.get("length_m") is not None)
    if len(facets) != sides:
        raise Rejected("unsafe_sets", f"{name} has {len(facets)} facets, not {sides}")
    _check_cone(rows, offsets, spec)


def _check_within(
    document: Document, facets: list[UnsafeSet], name: str, spec: dict[str, Any], ends: float, size: arb
) -> None:
    """Check that the chaser is kept where a phase's bounds on errors of estimates hold, while it lasts."""
    d, begins = len(document.C), spec["from_s"]
    half = per_axis(spec["within_m"], d)
    if begins >= document.steps * document.delta or len(half) != d:
        raise Rejected("unsafe_sets", f"within_m of {name}: from {begins:g} s on, with {len(half)} sides")
    for f, item in enumerate(facets):
        outward = [(-1.0 if f < d else 1.0) * (j == f % d) for j in range(d)]
        if item.name != f"{name}[{f}]" or item.of_state or not item.keep_in or item.normals != [outward]:
            raise Rejected("unsafe_sets", f"{item.name} is no side of the box within_m of {name}")
        inner = half[f % d] - size
        for k in range(len(item.start)):
            if holding(document, begins, ends, min(k, document.steps)):
                for offset in (item.start[k][0], item.end[k][0]):
                    require("unsafe_sets", inner + offset + half[f % d] * ROUNDED, f"{item.name}, step {k}")
    if len(facets) != 2 * d:
        raise Rejected("unsafe_sets", f"sides of the box within_m of {name} are missing")


def _check_cone(rows: list[list[float]], offsets: list[float], spec: dict[str, Any]) -> None:
    """Check that edges of the polyhedral cone are on or inside the circular one, and facets pass its apex.

    A pointed polyhedral cone is spanned by its edges, and the circular cone is convex. In order about
    the axis, once around, each facet meets the next in an edge.
    """
    name, axis = spec["name"], [arb(x) for x in spec["axis"]]
    length = _length(axis)
    axis = [x / length for x in axis]
    apex = spec["apex_m"]
    if spec.get("length_m") is not None:
        cut = spec["length_m"]
        error = sum((abs(a - b) for a, b in zip(rows[-1], axis, strict=True)), arb(0))
        require("unsafe_sets", ROUNDED - error, f"the end of {name} is turned")
        height, scale = dot(axis, apex) + cut, absolute_dot(axis, apex) + cut
        require("unsafe_sets", height - offsets[-1] + scale * ROUNDED, f"the end of {name} is too far out")
        rows, offsets = rows[:-1], offsets[:-1]
    size = sum(abs(x) for x in apex)
    for f, (row, offset) in enumerate(zip(rows, offsets, strict=True)):
        height = dot(map(arb, row), apex)
        require("unsafe_sets", height - offset + size * ROUNDED, f"{name}, facet {f}, is beyond the apex")
    slope = (arb(spec["half_angle_deg"]) * arb.pi() / 180).cos()
    edges = _edges(rows, axis, name)
    for f, edge in enumerate(edges):
        forward = dot(edge, axis) / _length(edge)
        witness = f"an edge of {name} next to facet {f} lies outside the cone"
        require("unsafe_sets", forward - slope + ROUNDED, witness)
        for other, row in enumerate(rows):
            beyond = dot(edge, row) / _length(edge)
            require("unsafe_sets", ROUNDED - beyond, f"facets {f} and {other} of {name} are out of order")


def _edges(rows: list[list[float]], axis: list[arb], name: str) -> list[list[arb]]:
    """Directions of the edges between one facet and the next, pointing away from the apex."""
    balls = [[arb(x) for x in row] for row in rows]
    for f, row in enumerate(balls):
        closing = -dot(row, axis)
        require("unsafe_sets", closing - SLOPE, f"facet {f} of {name} does not close around the axis")
    if len(axis) == 2:
        turn = balls[0][0] * balls[1][1] - balls[0][1] * balls[1][0]
        require("unsafe_sets", abs(turn) - SLOPE, f"the facets of {name} are parallel")
        pairs = ((balls[0], balls[1]), (balls[1], balls[0]))
        edges = [([-a[1], a[0]], b) for a, b in pairs]
        return [[-x for x in e] if dot(e, b) > 0 else e for e, b in edges]
    angle, edges3 = arb(0), []
    for a, b in zip(balls, [*balls[1:], balls[0]], strict=True):
        edge = cross(a, b)
        forward, level = dot(edge, axis), dot(a, b) - dot(a, axis) * dot(b, axis)
        angle += arb.atan2(forward, level)
        edges3.append((edge, forward))
    sign = 1 if edges3[0][1] > 0 else -1
    for f, (_, forward) in enumerate(edges3):
        require("unsafe_sets", sign * forward - SLOPE**2, f"facets of {name} are out of order at {f}")
    require("unsafe_sets", 3 * arb.pi() - abs(angle), f"the facets of {name} go around more than once")
    return [[sign * x for x in edge] for edge, _ in edges3]
