"""Limits on the whole state: the certificate's sets of states contain those that the scenario describes."""

import math
from itertools import product
from typing import Any

from flint import arb, arb_mat

from ..files.document import ROUNDED, Document
from ..files.entries import UnsafeSet
from ..kernel.balls import absolute_dot, cross, dot, identity, magnitude, matrix, require
from ..kernel.verdict import Rejected
from .navigation import holding

KINDS = "states", "speed", "speed_polygon", "turning"
"""Kinds of sets of states, which the tables of obstacles and of keep-in sets have."""

Facet = tuple[arb_mat, arb_mat, arb]
"""Row of the state (1, n), sizes (1, n) that its rounding is relative to, and bound: ``row x <= bound``."""


def check_states(document: Document, items: list[UnsafeSet], spec: dict[str, Any], inside: bool) -> None:
    """Check that sets of states cover the complement of a limit to stay `inside`, or a set to stay out of.

    In every step in which it holds; each grows by how far true states may be from the model's within it.
    """
    name, begins, ends = spec["name"], spec.get("from_s", 0.0), spec.get("until_s", math.inf)
    T, shift = document.steps * document.delta, document.state_offset
    if begins >= min(T, ends) or (ends < math.inf and ends > T * (1 + ROUNDED)):
        raise Rejected("unsafe_sets", f"{name} does not begin and end within {T:g} s")
    if spec["kind"] == "turning":
        _check_turning(document, items, spec)
        return
    polytopes = _polytopes(document, spec, inside)
    if len(items) != len(polytopes):
        raise Rejected("unsafe_sets", f"{name} has {len(items)} sets of states, not {len(polytopes)}")
    for item, facets in zip(items, polytopes, strict=True):
        if not item.of_state or len(item.normals) != len(facets):
            raise Rejected("unsafe_sets", f"{item.name} must be a set of states with {len(facets)} facets")
        for f, facet in enumerate(facets):
            share = _share(item.normals[f], facet, item.name)
            bound, growth = share * facet[2], absolute_dot([arb(x) for x in item.normals[f]], shift)
            for k in range(len(item.start)):
                if holding(document, begins, ends, min(k, document.steps)):
                    for offset in (item.start[k][f], item.end[k][f]):
                        slack = offset - bound - growth + (abs(bound) + growth) * ROUNDED
                        require("unsafe_sets", slack, f"{item.name}, facet {f}, in step {k}")


def _check_turning(document: Document, items: list[UnsafeSet], spec: dict[str, Any]) -> None:
    """Check that three rows keep each side of a corridor that turns, in every step by a facet of its own.

    In a step a normal turns by `wide` to either side of its middle direction about the axis, with errors.
    Its arc lies in the triangle of both ends and of the corner of the tangents there.
    """
    name, b = spec["name"], [arb(x) for x in spec["offsets_m"]]
    steps = [
        k for k in range(document.steps) if holding(document, spec.get("from_s", 0.0), spec["until_s"], k)
    ]
    if document.drift is not None or document.powered is not None:
        raise Rejected("unsafe_sets", f"{name} turns, and aborts are not covered with it")
    sides, axis = [[arb(x) for x in row] for row in spec["normals"]], spec.get("axis")
    if (
        len(sides[0]) != len(document.C)
        or len(document.C) not in (2, 3)
        or (axis is None) == (len(document.C) == 3)
    ):
        raise Rejected("unsafe_sets", f"{name} must have an axis in space")
    if len(items) != 3 * len(sides) or any(len(item.normals) != len(steps) for item in items):
        raise Rejected("unsafe_sets", f"{name} must have three rows a side, and {len(steps)} facets each")
    rate, delta, clock = arb(spec["rate_rad_s"]), arb(document.delta), arb(document.timing.get("clock", 0.0))
    C, first = matrix(document.C), [item.name for item in document.unsafe].index(items[0].name)
    error = arb(spec.get("angle_error_deg", 0.0)) * arb.pi() / 180
    for j, k in enumerate(steps):
        wide = abs(rate) * (delta / 2 + clock) + error
        wide = wide + arb(spec.get("rate_error_rad_s", 0.0)) * ((k + 1) * delta + clock)
        require("unsafe_sets", arb.pi() / 2 - wide, f"{name} turns too far in step {k}")
        middle = rate * (k + arb(0.5)) * delta
        for f, side in enumerate(sides):
            along, across, tangent = _split(side, axis)
            ends = [rotate(side, axis, x) for x in (middle - wide, middle + wide)]
            c, s = middle.cos() / wide.cos(), middle.sin() / wide.cos()
            length = dot(side, side).sqrt()
            for i, normal in enumerate((*ends, _sum((1, along), (c, across), (s, tangent)))):
                item, sizes = items[3 * f + i], matrix([[1.0] * len(normal)]) * magnitude(C) * (2 * length)
                if not item.of_state or document.facets[k][first + 3 * f + i] != j:
                    raise Rejected("unsafe_sets", f"{item.name} must be kept by facet {j} in step {k}")
                share = _share(item.normals[j], (-(_row(normal) * C), sizes, b[f]), item.name)
                growth = absolute_dot([arb(x) for x in item.normals[j]], document.state_offset)
                bound = growth + share * length * document.chaser_radius - share * b[f]
                for offset in (item.start[k][j], item.end[k][j]):
                    slack = offset - bound + (abs(share * b[f]) + growth) * ROUNDED
                    require("unsafe_sets", slack, f"{item.name} in step {k}")


def _split(side: list[arb], axis: list[float] | None) -> tuple[list[arb], list[arb], list[arb]]:
    """Return the part of a normal along an axis, the rest, and the rest after a quarter of a turn."""
    if axis is None:
        return [arb(0)] * 2, side, [-side[1], side[0]]
    about = [arb(x) for x in axis]
    size = dot(about, about).sqrt()
    about = [x / size for x in about]
    along = [x * dot(side, about) for x in about]
    return along, [x - y for x, y in zip(side, along, strict=True)], cross(about, side)


def rotate(side: list[arb], axis: list[float] | None, angle: arb) -> list[arb]:
    """Return a normal turned by an angle [rad] about an axis; in the plane about the origin."""
    along, across, tangent = _split(side, axis)
    return _sum((1, along), (angle.cos(), across), (angle.sin(), tangent))


def _sum(*terms: tuple[arb | int, list[arb]]) -> list[arb]:
    """Return the sum of vectors times numbers."""
    return [
        sum((x * v for x, v in zip([x for x, _ in terms], entries, strict=True)), arb(0))
        for entries in zip(*(v for _, v in terms), strict=True)
    ]


def _share(normal: list[float], facet: Facet, name: str) -> arb:
    """Return how many times as long as the scenario's row a normal is; both point the same way."""
    row, sizes = (part.entries() for part in facet[:2])
    lengths = [float(abs(x).mid()) for x in row]
    at = lengths.index(max(lengths))
    share = normal[at] / row[at]
    require("unsafe_sets", share, f"a row of {name} is turned around")
    for x, entry, size in zip(normal, row, sizes, strict=True):
        require("unsafe_sets", ROUNDED * share * size - abs(x - share * entry), f"a row of {name} is turned")
    return share


def _polytopes(document: Document, spec: dict[str, Any], inside: bool) -> list[list[Facet]]:
    """Return polytopes of states, by facets, whose union is unsafe."""
    if spec["kind"] == "states":
        limits = zip(spec["rows"], spec["bounds"], strict=True)
        facets = [(matrix([row]), magnitude(matrix([row])), arb(bound)) for row, bound in limits]
        return [[(-row, size, -bound)] for row, size, bound in facets] if inside else [facets]
    C, A = matrix(document.C), matrix(document.A)
    for input_map in (matrix(document.B), matrix(document.D)):
        if any(not x.is_zero() for x in (C * input_map).entries()):
            raise Rejected("unsafe_sets", f"{spec['name']} limits a velocity that is no part of the state")
    d, V, growth = len(document.C), C * A, arb(spec.get("per_distance_1_s", 0.0))
    sizes, top = matrix([[1.0] * d]) * magnitude(V), spec["max_m_s"]
    if spec["kind"] == "speed_polygon":
        first, second = spec.get("axes", (0, 1))
        if first == second or max(first, second) >= d:
            raise Rejected("unsafe_sets", f"{spec['name']} has no two axes of the velocity")
        sides = int(spec.get("sides", 8))
        E = [[x * (i == first) + y * (i == second) for i in range(d)] for x, y in _around(sides)]
        return [[(-(_row(e) * V), sizes, -arb(top))] for e in E]
    count = spec.get("facets")
    if isinstance(top, list):
        E, share = [*identity(d).tolist(), *(-identity(d)).tolist()], arb(1)
        tops = [arb(x) for x in top * 2]
        if len(top) != d:
            raise Rejected("unsafe_sets", f"{spec['name']} must have {d} speeds")
    else:
        E, share = directions(d, count)
        tops = [arb(top)] * len(E)
    if growth.is_zero():
        return [[(-(_row(e) * V), sizes, -share * top)] for e, top in zip(E, tops, strict=True)]
    aims = spec["towards"] if "towards" in spec else directions(d, count)[0]
    aims = [[arb(x) for x in aim] for aim in aims]
    growth_rows = [_row([x * share * growth / dot(aim, aim).sqrt() for x in aim]) * C for aim in aims]
    sizes = sizes + matrix([[1.0] * d]) * magnitude(C) * growth
    pairs = zip(E, tops, strict=True)
    return [[(row - _row(e) * V, sizes, -share * top) for row in growth_rows] for e, top in pairs]


def _row(entries: list[arb]) -> arb_mat:
    return arb_mat(1, len(entries), entries)


def _around(count: int) -> list[tuple[arb, arb]]:
    """Return unit vectors at equal angles in a plane."""
    angles = [2 * arb.pi() * i / count for i in range(count)]
    return [(angle.cos(), angle.sin()) for angle in angles]


def directions(d: int, facets: int | None) -> tuple[list[list[arb]], arb]:
    """Return unit vectors e and c: v has a length of at most 1 if ``e v <= c`` for all of them.

    In space they are those of a cube's faces, corners and edges. All signs and orders of their entries are
    among them, so the largest e v is that of the e with entries in v's order; and for v in the cone
    x >= y >= z >= 0 these three bounds leave a polytope whose longest corner is 1/c.
    """
    if d == 1:
        return [[arb(1)], [arb(-1)]], arb(1)
    if d == 2:
        count = facets or 12
        return [[x, y] for x, y in _around(count)], (arb.pi() / count).cos()
    one, two, three = arb(1), arb(2).sqrt(), arb(3).sqrt()
    table = {
        6: ((1,), 3 * one),
        14: ((1, 3), 1 + (three - 1) ** 2),
        18: ((1, 2), arb(3) / 2),
        26: ((1, 2, 3), 1 + (two - 1) ** 2 + (three - two) ** 2),
    }
    count = facets or 26
    if count not in table:
        raise Rejected("unsafe_sets", f"{count} directions in space, not 6, 14, 18 or 26")
    nonzeros, longest = table[count]
    grid = [signs for signs in product((1, 0, -1), repeat=3) if sum(map(abs, signs)) in nonzeros]
    grid.sort(key=lambda signs: sum(map(abs, signs)))
    return [[arb(x) / arb(sum(map(abs, signs))).sqrt() for x in signs] for signs in grid], 1 / longest.sqrt()
