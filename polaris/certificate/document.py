"""The certificate as a file: JSON, floats as exact hexadecimal text, and a digest of itself."""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from .assumptions import SATELLITES, assumptions
from .decoding import listed, name, number, one_of, table, vector, whole
from .file_keys import CERTIFICATE
from .files import contents
from .structure import conform, strict_json
from .verdict import Rejected, Undecided

FORMAT = "polaris-certificate"
VERSION = 1

KINDS = ("safety", "affine", "saturated_affine", "any_thrust")
"""Kinds of controllers."""

UNIT = 4e-9
"""How far the square of a unit normal may be off 1."""
MOST_NODES = 100_000
"""Most periods in a step."""
MOST_NODES_IN_ALL = 2_000_000
"""Most periods in all steps, those of the tail included."""
MOST_GENERATORS = 1000
"""Most generators of the initial set."""
MOST_STATES = 32
"""Most states of a system: Lyapunov's equation is solved as n^2 linear ones."""


def digest(data: dict[str, Any]) -> str:
    """SHA-256 of the canonical JSON text of all fields but ``digest``."""
    rest = {key: value for key, value in data.items() if key != "digest"}
    return hashlib.sha256(canonical(rest).encode()).hexdigest()


def canonical(data: Any) -> str:
    """The one JSON text of the data: keys sorted, no spaces, ASCII."""
    return json.dumps(data, sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False)


@dataclass(frozen=True)
class UnsafeSet:
    """One timed polytope: ``normals p <= b(t)``, b linear within each cell.

    Attributes
    ----------
    name : str
    keep_in : bool
        Whether it is the outside of one facet of a keep-in set.
    normals : list of list of float
    start, end : list (cells) of list (F) of float
        b at the start and the end of every cell.
    """

    name: str
    keep_in: bool
    normals: list[list[float]]
    start: list[list[float]]
    end: list[list[float]]

    @property
    def resting(self) -> bool:
        """Whether the offsets are the same at all times."""
        return all(b == self.start[0] for b in (*self.start, *self.end))


@dataclass(frozen=True)
class Law:
    """One controller; gain and own reference are None for ``any_thrust``, the latter also for S."""

    name: str
    kind: str
    gain: list[list[float]] | None
    states: list[list[float]] | None
    inputs: list[list[float]] | None


class Document:
    """A certificate, its shapes checked and its numbers decoded.

    Parameters
    ----------
    data : dict
        The JSON object.

    Raises
    ------
    Rejected
        Naming the claim ``format`` or ``digest``.
    Undecided
        If the version is not known.
    """

    def __init__(self, data: dict[str, Any]) -> None:
        self.data = data
        if data.get("format") != FORMAT:
            raise Rejected("format", f"the field format is {data.get('format')!r}, not {FORMAT!r}")
        version = data.get("schema_version")
        if isinstance(version, bool) or not isinstance(version, int) or version != VERSION:
            raise Undecided("format", f"schema_version {data.get('schema_version')!r} is not {VERSION}")
        try:
            found = digest(data)
        except (ValueError, TypeError, RecursionError) as error:
            raise Rejected("format", f"has no canonical text: {error}") from error
        if data.get("digest") != found:
            raise Rejected("digest", f"the certificate was changed: its digest is {found}")
        conform(data, CERTIFICATE, "format", "certificate")
        try:
            self._decode(data)
        except (KeyError, TypeError, ValueError, IndexError, AttributeError, OverflowError) as error:
            raise Rejected("format", f"{type(error).__name__}: {error}") from error

    def _decode(self, data: dict[str, Any]) -> None:
        self._decode_system(data["system"], data["sampling"])
        self._decode_scene(data)
        self._decode_schedule(data)
        self._decode_bounds(data)
        self._decode_words(data)

    def _decode_system(self, system: dict[str, Any], sampling: dict[str, Any]) -> None:
        self.steps, self.q = whole(sampling["steps"], 1), whole(sampling["nodes_per_step"], 1)
        if self.q > MOST_NODES:
            raise ValueError(f"more than {MOST_NODES} periods in a step")
        self.delta, feedback = number(sampling["step"]), one_of(sampling["kind"], ("continuous", "sampled"))
        self.sampled = feedback == "sampled"
        if not self.delta > 0:
            raise ValueError("the step must be positive")
        self.system_kind = str(system["kind"])
        n = len(system["A"])
        if n > MOST_STATES:
            raise Undecided("system", f"{n} states, more than {MOST_STATES}")
        self.A, self.B = table(system["A"], n, n), table(system["B"], n)
        m = len(self.B[0])
        self.D, self.C = table(system["D"], n), table(system["C"], None, n)
        self.u_max, self.w_max = vector(system["input_max"], m), number(system["disturbance_max"])
        if not (min(self.u_max) > 0 and self.w_max >= 0 and 1 <= len(self.C) <= 3):
            raise ValueError("limits must be positive, and positions have one to three axes")
        self.mass, eta = number(system["mass"]), system["mean_motion"]
        self.mean_motion = None if eta is None else number(eta)
        if not (self.mass > 0 and (self.mean_motion is None or self.mean_motion > 0)):
            raise Rejected("system", "mass and mean motion must be positive")
        self.input_names = [name(one) for one in listed(system["input_names"])]

    def _decode_scene(self, data: dict[str, Any]) -> None:
        n, m, d = len(self.A), len(self.u_max), len(self.C)
        self.center = vector(data["initial_set"]["center"], n)
        self.generators = table(data["initial_set"]["generators"], None, n)
        if len(self.generators) > MOST_GENERATORS:
            raise Undecided("initial_set", f"more than {MOST_GENERATORS} generators")
        reference = data["reference"]
        self.states, self.inputs = table(reference["states"], None, n), table(reference["inputs"], None, m)
        self.cells = len(self.inputs)
        if self.cells * self.q > MOST_NODES_IN_ALL:
            raise Undecided("sampling", f"more than {MOST_NODES_IN_ALL} periods")
        if len(self.states) != self.cells + 1 or self.cells < self.steps or len(self.input_names) != m:
            raise ValueError("the reference must have one state more than inputs, and cover every step")
        cells = self.cells
        self.unsafe = [_unsafe(item, d, cells) for item in data["unsafe_sets"]]
        self.facets = [[whole(f, 0) for f in listed(row)] for row in listed(data["facets"])]
        counts = [len(item.normals) for item in self.unsafe]
        if len(self.facets) != cells or any(
            len(row) != len(counts) or any(f >= c for f, c in zip(row, counts, strict=True))
            for row in self.facets
        ):
            raise ValueError("facets must name one facet of every unsafe set in every cell")

    def _decode_schedule(self, data: dict[str, Any]) -> None:
        n, m = len(self.A), len(self.u_max)
        self.laws = [_law(item, m, n, self.steps) for item in data["controllers"]]
        kinds = [law.kind for law in self.laws]
        if kinds[:1] != ["safety"] or "safety" in kinds[1:]:
            raise ValueError("mode 0, and no other, must be the safety controller")
        schedule, K = data["schedule"], self.steps
        self.modes = [whole(mode, 0) for mode in listed(schedule["modes"])]
        self.margins = [-math.inf if x is None else number(x) for x in listed(schedule["margins"])]
        if len(self.modes) != K or len(self.margins) != K or max(self.modes) >= len(self.laws):
            raise ValueError("modes and margins must have one entry per step, of a known mode")

    def _decode_bounds(self, data: dict[str, Any]) -> None:
        n, m, d, K = len(self.A), len(self.u_max), len(self.C), self.steps
        bounds, sets, boxes = data["error_bounds"], data["recoverable"], data["enclosures"]
        self.tube = table(bounds["per_step"], K, 2 * (d + m))
        self.settled = vector(bounds["settled"], 2 * (d + m))
        self.peaks = table(data["thrust"]["peak"], K, m)
        self.recoverable = one_of(sets["kind"], ("polytope", "time_varying_ball", "ball", "paper_ball"))
        self.weight = table(sets["weight"], n, n)
        self.radius = _radii(sets["radius"], K, self.cells > K)
        self.box_center = table(boxes["center"], K + 1, n)
        self.box_half = table(boxes["half_widths"], K + 1, n)
        self.lower, self.upper = table(boxes["lower"], K, n), table(boxes["upper"], K, n)
        self.slopes = _slopes(boxes["slopes"], K, self.q, m)

    def _decode_words(self, data: dict[str, Any]) -> None:
        end = data["end"]
        self.horizon = one_of(end["horizon"], ("infinite", "one_period", "none"))
        self.until = None if end["until"] is None else number(end["until"])
        self.reason = end["reason"]
        self.guarantee = str(data["guarantee"])
        self.satellites = SATELLITES in data["assumptions"]  # a scenario beside it must agree
        self.assumptions = assumptions(
            self.w_max,
            self.delta / self.q if self.sampled else None,
            resting=any(item.resting for item in self.unsafe),
            satellites=self.satellites,
            horizon=self.horizon,
            until=self.until,
        )
        if data["assumptions"] != self.assumptions:
            raise Rejected(
                "assumptions", "the certificate rests on other assumptions than those of its format"
            )
        self.scenario = name(data["scenario"]["name"])
        self.artefacts = {str(name): str(known) for name, known in data["artefacts"].items()}


def read(path: Path) -> Document:
    """Read a certificate.

    Raises
    ------
    Rejected, Undecided
        See `Document`.
    OSError
        If the file cannot be read.
    """
    found = contents(path)
    try:
        data = strict_json(found)
    except ValueError as error:
        raise Rejected("format", f"not JSON: {error}") from error
    if not isinstance(data, dict):
        raise Rejected("format", "not a JSON object")
    return Document(data)


def _radii(items: Any, steps: int, tail: bool) -> list[float]:
    """Radii at the start of every step and at T; the last is null if nothing follows T."""
    if not tail and len(listed(items)) == steps + 1 and items[-1] is None:
        items = items[:-1]
    else:
        steps += 1
    return vector(items, steps)


def _slopes(items: Any, steps: int, periods: int, m: int) -> list[list[list[float]] | None]:
    """Slopes of the bands about clipped commands, for every period; null for steps without."""
    if len(items) != steps:
        raise ValueError(f"slopes of {len(items)} steps where {steps} are needed")
    found = [None if item is None else table(item, periods, m) for item in items]
    if not all(0 <= x <= 1 for rows in found if rows is not None for row in rows for x in row):
        raise ValueError("slopes must be from 0 to 1")
    return found


def _unsafe(item: dict[str, Any], d: int, cells: int) -> UnsafeSet:
    normals = table(item["normals"], None, d)
    pairs = listed(item["offsets"])
    if len(pairs) != cells or any(len(listed(pair)) != 2 for pair in pairs):
        raise ValueError("offsets must have two rows for every cell")
    first = [vector(pair[0], len(normals)) for pair in pairs]
    last = [vector(pair[1], len(normals)) for pair in pairs]
    for normal in normals:
        # Everything measures distances along normals, and slacks are relative to them.
        if not abs(math.fsum(x * x for x in normal) - 1) <= UNIT:
            raise Rejected("unsafe_sets", f"a normal of {item['name']!r} is no unit vector")
    return UnsafeSet(name(item["name"]), item["keep_in"] is True, normals, first, last)


def _law(item: dict[str, Any], m: int, n: int, steps: int) -> Law:
    kind = one_of(item["kind"], KINDS)
    if kind == "any_thrust":
        return Law(name(item["name"]), kind, None, None, None)
    gain = table(item["gain"], m, n)
    if ("own_states" in item) != ("own_inputs" in item):
        raise ValueError(f"{item['name']} has half a reference of its own")
    if "own_states" not in item:
        return Law(name(item["name"]), kind, gain, None, None)
    states, inputs = table(item["own_states"], None, n), table(item["own_inputs"], None, m)
    if min(len(states), len(inputs)) < steps:
        raise ValueError(f"the reference of {item['name']} must cover every step")
    return Law(name(item["name"]), kind, gain, states, inputs)
