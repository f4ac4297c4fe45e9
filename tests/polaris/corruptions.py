"""Corruptions of a valid certificate, each with the claims that may be named when it is rejected."""

import copy
import math
from contextlib import suppress
from functools import partial

from polaris.certificate.assumptions import Assumptions
from polaris.certificate.files.document import digest
from polaris.certificate.files.entries import last_instant


def plain(value):
    """Hexadecimal text to floats, in nested lists."""
    return [plain(item) for item in value] if isinstance(value, list) else float.fromhex(value)


def hexed(value):
    return [hexed(item) for item in value] if isinstance(value, list) else float(value).hex()


def scaled(value, factor):
    if isinstance(value, list):
        return [scaled(item, factor) for item in value]
    return (float.fromhex(value) * factor).hex()


negated, tenth, tenfold, larger, thousandth = (
    partial(scaled, factor=x) for x in (-1.0, 0.1, 10.0, 1.01, 1e-3)
)


def restate(data):
    """The assumptions that the format prescribes for changed data: whoever forges it can write them too."""
    sampling, offsets = data["sampling"], [item["offsets"] for item in data["unsafe_sets"]]
    step = float.fromhex(sampling["step"])
    until = last_instant(data["horizon"], sampling["steps"], len(data["facets"]), step)
    period = step / sampling["nodes_per_step"]
    data["assumptions"] = Assumptions(
        float.fromhex(data["system"]["disturbance_max"]),
        period,
        resting=any(all(b == pairs[0][0] for pair in pairs for b in pair) for pairs in offsets),
        satellites=any(line.startswith("other satellites") for line in data["assumptions"]),
        horizon=data["horizon"],
        until=until,
        position=plain(data["system"]["C"]),
    ).sentences()


class Corruptor:
    """Makes changed copies of one certificate, their digest recomputed."""

    def __init__(self, data):
        self.data = data
        self.K = data["sampling"]["steps"]
        self.cells = len(data["reference"]["inputs"])

    def changed(self, *path, to):
        """A copy with one item replaced by a value, or by a function of it."""
        data = copy.deepcopy(self.data)
        place = data
        for key in path[:-1]:
            place = place[key]
        place[path[-1]] = to(place[path[-1]]) if callable(to) else to
        if path[0] in ("horizon", "unsafe_sets"):
            with suppress(TypeError, ValueError, KeyError, IndexError, AttributeError):  # malformed
                restate(data)
        data["digest"] = digest(data)
        return data

    def with_bound(self, factor):
        """Another disturbance bound, the assumptions saying so too."""
        data = self.changed("system", "disturbance_max", to=lambda x: scaled(x, factor))
        restate(data)
        data["digest"] = digest(data)
        return data


def inner(corrupt):
    """Corruptions that the argument itself must notice, with no other file at hand."""
    data, K, cells = corrupt.data, corrupt.K, corrupt.cells
    change = corrupt.changed
    for k in range(1, cells + 1):
        for i in (0, 3):
            if float.fromhex(data["reference"]["states"][k][i]):
                turned_over = change("reference", "states", k, i, to=negated)
                yield f"sign of state {i} at step {k}", turned_over, REFERENCE
    for k in range(K):
        altered = change("reference", "inputs", k, 0, to=lambda u: hexed(plain(u) + 1e-3))
        yield f"input {k} off by a thousandth", altered, REFERENCE
        for axis in (0, 1):
            new_input = change("reference", "inputs", k, axis, to=lambda u: hexed(plain(u) - 2e-3))
            yield f"input {axis} of step {k} less", new_input, REFERENCE
        for i in (1, 2):
            altered = change("reference", "states", k + 1, i, to=lambda x: hexed(plain(x) + 1e-6))
            yield f"state {i} after step {k} off by a millionth", altered, REFERENCE
    for k in range(0, K, 3):
        beyond = change("reference", "inputs", k, 0, to=(1.01).hex())
        yield f"input {k} beyond the limit", beyond, REFERENCE | {"thrust"}
    for cell in range(K, cells):
        for axis in (0, 1):
            new_input = change("reference", "inputs", cell, axis, to=(1e-4).hex())
            yield f"input {axis} of the tail's cell {cell}", new_input, REFERENCE
    for cell in range(0, cells, 2):
        for o, item in enumerate(data["unsafe_sets"]):
            other = opposite(plain(item["normals"]), data["facets"][cell][o])
            yield f"other side of {o} in cell {cell}", change("facets", cell, o, to=other), SEPARATION
    for name in ("states", "inputs"):
        yield f"{name} shifted by a step", change("reference", name, to=shifted), REFERENCE
        yield f"{name} in kilometres", change("reference", name, to=thousandth), REFERENCE
    exchanged = change("facets", to=lambda x: [[1 - f if f < 2 else f for f in r] for r in x])
    yield "facets shifted", exchanged, SEPARATION
    yield "positions rotated", change("reference", "states", to=turned), REFERENCE
    yield "frame rotated", change("system", "C", to=lambda C: C[::-1]), {"assumptions"}
    yield "U in every step", change("modes", to=lambda x: [1] * len(x)), FLIGHT
    yield "a tail that starts elsewhere", change("reference", "states", K, to=negated), REFERENCE
    for mode, factor in ((0, 0.2), (0, -0.5), (1, -1.0), (1, 5.0)):
        scale = change("controllers", mode, "gain", to=lambda x, by=factor: scaled(x, by))
        yield f"gain {mode} times {factor}", scale, FLIGHT
    yield "start enlarged", change("initial_set", "generators", to=tenfold), FLIGHT
    yield "start moved", change("initial_set", "center", 0, to=(0.1).hex()), REFERENCE
    yield "start in kilometres", change("initial_set", "generators", to=lambda x: scaled(x, 1e3)), FLIGHT
    yield "thrust limit lowered", change("system", "input_max", to=tenth), {"thrust", "recoverable"}
    yield "disturbance tenfold", corrupt.with_bound(10.0), FLIGHT
    yield "disturbance shrunk, not said", change("system", "disturbance_max", to=tenth), {"assumptions"}
    yield "an assumption dropped", change("assumptions", to=lambda x: x[1:]), {"assumptions"}
    for key in ("A", "B"):
        yield f"{key} negated", change("system", key, to=negated), {"reference", "goal"}
        yield f"{key} larger", change("system", key, to=larger), REFERENCE
    yield "D tenfold", change("system", "D", to=tenfold), FLIGHT
    yield "step doubled", change("sampling", "step", to=lambda x: scaled(x, 2.0)), REFERENCE | {"assumptions"}
    for mode in (0, 1):
        yield f"gain {mode} negated", change("controllers", mode, "gain", to=negated), FLIGHT
        yield f"gain {mode} tenfold", change("controllers", mode, "gain", to=tenfold), FLIGHT
    yield "own reference shifted", change("controllers", 1, "reference_states", to=shifted), FLIGHT
    anything = change("controllers", 1, to=lambda x: {"name": x["name"], "kind": "any_thrust"})
    yield "anything", anything, FLIGHT
    yield "obstacle in kilometres", change("unsafe_sets", 0, "offsets", to=thousandth), SEPARATION
    yield "obstacle larger", change("unsafe_sets", 0, "offsets", to=lambda x: scaled(x, 1.5)), SEPARATION
    yield "claim for ever", change("horizon", to="infinite"), {"end"}
    yield "no guarantee", change("guarantee", to="none"), {"guarantee"}


def against_files(corrupt):
    """Corruptions that the other files of the run folder give away."""
    data, K, change = corrupt.data, corrupt.K, corrupt.changed
    for name in data["artefacts"]:
        yield f"hash of {name}", change("artefacts", name, to=lambda x: x[::-1]), {"artefacts"}
        dropped = change("artefacts", to=lambda x, name=name: {k: v for k, v in x.items() if k != name})
        if name in ("scenario.toml", "schedule.json", "reference.csv", "gains.json"):
            yield f"no hash of {name}", dropped, {"artefacts"}
    for k in range(K):
        yield f"mode {k}", change("modes", k, to=lambda m: 1 - m), {"schedule"}
    for key in ("A", "B", "C", "D", "input_max", "disturbance_max", "mass"):
        claims = {"system", "assumptions"} if key in ("C", "disturbance_max") else {"system"}
        yield f"{key} tenfold", change("system", key, to=tenfold), claims
    yield "thrust limit raised", change("system", "input_max", to=larger), {"system"}
    yield "disturbance bound shrunk", corrupt.with_bound(0.1), {"system"}
    yield "start enlarged", change("initial_set", "generators", to=larger), {"initial_set"}
    yield "start shrunk", change("initial_set", "generators", to=tenth), {"initial_set"}
    yield "start moved", change("initial_set", "center", 1, to=(0.01).hex()), {"initial_set"}
    yield "kind of feedback", change("sampling", to=lambda x: x | {"kind": "continuous"}), {"format"}
    yield "coarser nodes", change("sampling", "nodes_per_step", to=lambda q: q + 1), {"sampling", "format"}
    for mode in (0, 1):
        yield f"gain of {mode}", change("controllers", mode, "gain", to=larger), {"controllers"}
        yield f"name of {mode}", change("controllers", mode, "name", to="other"), {"controllers"}
    altered = change("controllers", 1, "reference_inputs", 3, 0, to=(0.01).hex())
    yield "own reference", altered, {"controllers"}
    yield "unclipped", change("controllers", 1, "kind", to="affine"), {"controllers"}
    yield "kind of sets", change("recoverable", to="ball"), {"recoverable_sets"}
    yield "other scenario", change("scenario", "name", to="other"), {"system"}
    yield "sooner end", change("horizon", to="none"), {"end"}
    for o, item in enumerate(data["unsafe_sets"]):
        yield f"obstacle {o} dropped", without(change, o), {"unsafe_sets"}
        yield f"obstacle {o} renamed", change("unsafe_sets", o, "name", to="other"), {"unsafe_sets"}
        yield f"obstacle {o} turned", change("unsafe_sets", o, "normals", to=turned), {"unsafe_sets"}
        yield f"obstacle {o} a keep-in set", change("unsafe_sets", o, "keep_in", to=True), {"unsafe_sets"}
        yield f"a facet of {o} dropped", without_facet(change, o, len(item["normals"]) - 1), {"unsafe_sets"}
        yield f"obstacle {o} a step later", change("unsafe_sets", o, "offsets", to=later), {"unsafe_sets"}
        for cell in range(0, corrupt.cells, 3):
            at = ("unsafe_sets", o, "offsets", cell, 0)
            smaller = change(*at, to=lambda b: [hexed(x - 1e-3) for x in plain(b)])
            yield f"obstacle {o} smaller in cell {cell}", smaller, {"unsafe_sets"}


def malformed(corrupt):
    """Corruptions of the format."""
    data, change = corrupt.data, corrupt.changed
    for key in data:
        if key in ("digest", "schema_version", "format"):
            continue
        for value in (None, [], "x", 7):
            claims = {"format", "guarantee", "assumptions", "artefacts"}
            yield f"{key} is {value!r}", change(key, to=value), claims
    yield "format", change("format", to="other"), {"format"}
    for text in ("nan", "inf", "1g", "", None, 1.0, True):
        yield f"a number is {text!r}", change("system", "A", 0, 0, to=text), {"format"}
    yield "a row too few", change("reference", "states", to=lambda x: x[:-1]), {"format"}
    yield "a step too few", change("sampling", "steps", to=lambda x: x - 1), {"format"}
    yield "steps are true", change("sampling", "steps", to=True), {"format"}
    yield "an unknown mode", change("modes", 0, to=9), {"format"}
    yield "an unknown facet", change("facets", 0, 0, to=99), {"format"}
    yield "an obstacle without facets", change("unsafe_sets", to=lambda x: x[1:]), {"format"}
    yield "two safety controllers", change("controllers", 1, "kind", to="safety"), {"format"}
    clipped = [k for k, rows in enumerate(data["slopes"]) if rows]
    for text in ((-0.01).hex(), (1.01).hex(), "nan", "inf", 0.5, None):
        sloping = change("slopes", clipped[0], 0, 0, to=text)
        yield f"a slope is {text!r}", sloping, {"format"}
    yield "slopes of a step too few", change("slopes", to=lambda x: x[:-1]), {"format"}
    yield "a slope too few", change("slopes", clipped[0], to=lambda x: x[:-1]), {"format"}
    yield "an unknown kind", change("controllers", 1, "kind", to="magic"), {"format"}


REFERENCE = {"reference"}
FLIGHT = {"separation", "controllers", "recoverable"}
SEPARATION = {"separation", "recoverable"}


def shifted(rows):
    return [*rows[1:], rows[0]]


def later(offsets):
    """Return the offsets of the next cell, moved towards the set's inside where nothing else would change."""
    next_cells = shifted(offsets)
    if next_cells != offsets:
        return next_cells
    return [[hexed([x - 0.1 for x in plain(b)]) for b in pair] for pair in offsets]


def turned(rows):
    """The first two coordinates of every row turned by 30 degrees."""
    c, s = math.cos(math.pi / 6), math.sin(math.pi / 6)
    return [hexed([c * x - s * y, s * x + c * y, *rest]) for x, y, *rest in plain(rows)]


def opposite(normals, facet):
    """The facet that looks the other way."""
    dots = [sum(a * b for a, b in zip(normals[facet], other, strict=True)) for other in normals]
    return dots.index(min(dots))


def without(change, o):
    data = change("unsafe_sets", to=lambda sets: sets[:o] + sets[o + 1 :])
    data["facets"] = [row[:o] + row[o + 1 :] for row in data["facets"]]
    data["digest"] = digest(data)
    return data


def without_facet(change, o, f):
    data = change("unsafe_sets", o, "normals", to=lambda rows: rows[:f] + rows[f + 1 :])
    item = data["unsafe_sets"][o]
    item["offsets"] = [[b[:f] + b[f + 1 :] for b in pair] for pair in item["offsets"]]
    for row in data["facets"]:
        row[o] = min(row[o], f - 1)
    data["digest"] = digest(data)
    return data
