"""The certificate as a file: JSON, floats as exact hexadecimal text, and a digest of itself."""

import hashlib
import json
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import Any

from ..assumptions import SATELLITES, Assumptions
from ..kernel.verdict import Rejected, Undecided
from .entries import (
    Law,
    Matrix,
    Powered,
    UnsafeSet,
    Vector,
    abort_of,
    check_law,
    last_instant,
    powered_of,
    unsafe_set,
)
from .file_keys import CERTIFICATE, REPEATED
from .structure import Lengths, conform, contents, strict_json

FORMAT = "polaris-certificate"
VERSION = 7

ROUNDED = 1e-12  # rounding of what is worked out from numbers of the file or the scenario, relative to them
MOST_NODES = 100_000  # most periods in a step
MOST_NODES_IN_ALL = 2_000_000  # most periods in all steps, those of the tail included
MOST_GENERATORS = 1000  # most generators of the initial set
MOST_WORK = 10**10  # most products of numbers that all enclosures of a network may take
MOST_ENTRIES = 10**7  # most numbers in the generators of one of them: about 1 GB
MOST_FLIGHTS = 10**7  # most flights of a statement
MOST_STATES = 32  # most states of a system: Lyapunov's equation is solved as n^2 linear ones


def digest(data: dict[str, Any]) -> str:
    """SHA-256 of the canonical JSON text of all fields but ``digest``."""
    content = {key: value for key, value in data.items() if key != "digest"}
    return hashlib.sha256(canonical(content).encode()).hexdigest()


def canonical(data: Any) -> str:
    """Return the one JSON text of the data: keys sorted, no spaces, ASCII."""
    return json.dumps(data, sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False)


class Document:
    """A certificate, its shapes checked and its numbers decoded from the JSON object.

    Raises `Rejected` for ``format`` or ``digest``; `Undecided` for another version, or no end of work.
    """

    def __init__(self, data: dict[str, Any]) -> None:
        if data.get("format") != FORMAT:
            raise Rejected("format", f"the field format is {data.get('format')!r}, not {FORMAT!r}")
        version = data.get("schema_version")
        if isinstance(version, bool) or not isinstance(version, int) or version != VERSION:
            raise Undecided("format", f"schema_version {version!r} is not {VERSION}")
        try:
            computed = digest(data)
        except (ValueError, TypeError, RecursionError) as error:
            raise Rejected("format", f"has no canonical text: {error}") from error
        if data.get("digest") != computed:
            raise Rejected("digest", f"the certificate was changed: its digest is {computed}")
        lengths: Lengths = {}
        read = conform(data, CERTIFICATE, "format", "certificate", lengths)
        self.digest: str = computed
        self.repeated: dict[str, Any] = {key: read[key] for key in REPEATED}
        try:
            self._take_system(read["system"], read["sampling"])
            self._take_scene(read)
            self._compare(lengths, len(read["unsafe_sets"]))
            self._take_claims(read)
        except (TypeError, ValueError, OverflowError) as error:
            raise Rejected("format", f"{type(error).__name__}: {error}") from error

    def _take_system(self, system: dict[str, Any], sampling: dict[str, Any]) -> None:
        self.system = system
        self.steps: int = sampling["steps"]
        self.q: int = sampling["nodes_per_step"]
        self.delta: float = sampling["step"]
        self.system_kind: str = system["kind"]
        self.A: Matrix = system["A"]
        self.B: Matrix = system["B"]
        self.C: Matrix = system["C"]
        self.D: Matrix = system["D"]
        self.u_max: Vector = system["input_max"]
        self.w_max: float = system["disturbance_max"]
        self.bias: Vector = system.get("bias_max") or []  # of each column of D, if any is not 0
        self.mass: float = system["mass"]
        self.estimate: Vector = system.get("estimate_error") or []
        self.thrusters: dict[str, Any] = system.get("thrusters") or {}  # of each thruster, or of the inputs
        self.shares: Vector = [self.thrusters.get(key, 0.0) for key in ("along", "across", "mass")]
        self.same_shares: bool = self.thrusters.get("constant", False)  # in the whole flight
        self.bits: Vector = self._each(self.thrusters.get("bit", 0.0))
        self.error_by_step: Matrix = system.get("error_by_step") or []
        self.observer: dict[str, Any] | None = system.get("observer")
        self.timing: dict[str, Any] = system.get("timing") or {}
        timing, zeros = self.timing, [0.0] * len(self.A)
        self.measured_error: Vector = timing.get("measured_error") or self.estimate
        self.state_offset: Vector = timing.get("state_offset") or zeros
        self.pulse_thrust: Vector = timing.get("pulse_thrust") or []  # empty where inputs are held
        self.pulse_place: str = timing.get("pulse_place", "")  # of pulses; empty where they are centred
        self.edge: float = timing.get("edge", 0.0)  # in which the thrust of pulses comes or goes [s]
        self.intersample_offset: Vector = timing.get("intersample_offset") or zeros  # between nodes only
        self.at_nodes: Vector = [
            x - y for x, y in zip(self.state_offset, self.intersample_offset, strict=True)
        ]
        self.carried_impulse: float = timing.get("carried_impulse", 0.0)  # left to the next period
        # Held inputs may last longer by the jitter: their errors grow with commands.
        self.late: bool = timing.get("jitter", 0.0) > 0 and not self.pulse_thrust
        self.prompt_bits: Vector = self._each(self.timing.get("bit", self.bits))  # without jitter, pulses
        self.mean_motion: float | None = system["mean_motion"]
        self.allocation: dict[str, Any] | None = system.get("allocation")
        self.transients: list[dict[str, Any]] = system.get("transients") or []
        self.input_names: list[str] = system["input_names"]
        if self.q > MOST_NODES:
            raise ValueError(f"more than {MOST_NODES} periods in a step")
        if len(self.A) > MOST_STATES:
            raise Undecided("system", f"{len(self.A)} states, more than {MOST_STATES}")
        if self.estimate and not max(self.estimate) > 0:
            raise ValueError("errors of estimates must not all be zero")
        errors = self.estimate or [0.0] * len(self.A)
        if self.error_by_step and errors != [max(x) for x in zip(*self.error_by_step, strict=True)]:
            raise ValueError("errors of estimates must be the largest of all steps")
        spec = self.observer or {}
        if any(x > top for x, top in zip(spec.get("constant", ()), spec.get("noise", ()), strict=False)):
            raise ValueError("constant errors of what is measured must not exceed its errors")
        if not (self.A and self.u_max and 1 <= len(self.C) <= 3):
            raise ValueError("there must be states and inputs, and positions have one to three axes")

    def _each(self, bit: float | Vector) -> Vector:
        return bit if isinstance(bit, list) else [bit] * len(self.u_max)

    def _take_scene(self, read: dict[str, Any]) -> None:
        self.center: Vector = read["initial_set"]["center"]
        self.generators: Matrix = read["initial_set"]["generators"]
        self.states: Matrix = read["reference"]["states"]
        self.inputs: Matrix = read["reference"]["inputs"]
        self.cells = len(self.inputs)
        self.facets: list[list[int]] = read["facets"]
        self.chaser_radius: float = read.get("chaser_radius") or 0.0
        if len(self.generators) > MOST_GENERATORS:
            raise Undecided("initial_set", f"more than {MOST_GENERATORS} generators")
        if self.cells * self.q > MOST_NODES_IN_ALL:
            raise Undecided("sampling", f"more than {MOST_NODES_IN_ALL} periods")
        if self.cells < self.steps:
            raise ValueError("the reference must cover every step")
        drift = read.get("drift")
        self.drift = None if drift is None else abort_of(drift, self.q)
        sets, powered = [len(item["normals"]) for item in read["unsafe_sets"]], read.get("powered")
        self.powered: Powered | None = None if powered is None else powered_of(powered, self.delta, sets)
        self.laws = [Law.from_item(law) for law in read["controllers"]]

    @property
    def longest(self) -> int:
        """Cells of the longest of all references."""
        branches = () if self.powered is None else self.powered.branches
        return max(self.cells, *(len(branch.facets) for branch in branches), 0)

    @property
    def claim_end(self) -> float | None:
        """Last instant of the claim [s]; None if it is for ever."""
        return last_instant(self.horizon, self.steps, self.cells, self.delta)

    def errors_in(self, k: int) -> Vector:
        """Errors of estimates in step k, or after the last one."""
        return self.error_by_step[min(k, self.steps)] if self.error_by_step else self.estimate

    def moves(self, item: UnsafeSet) -> bool:
        """Return True if an unsafe set moves; limits that hold from or until a step do not, after T."""
        return not (item.rests_from(self.steps) if item.keep_in or item.of_state else item.resting)

    @cached_property
    def calmest(self) -> Vector:
        """Return the least error of each state in any step, also of the schedule that a branch leaves."""
        return [min(each) for each in zip(*self.error_by_step, strict=True)] or self.estimate

    def _compare(self, lengths: Lengths, sets: int) -> None:
        """Check that lists are as long as the sizes of the system, the scene and the schedule say."""
        n, m, d, K = len(self.A), len(self.u_max), len(self.C), self.steps
        sizes = {"n": n, "m": m, "d": d, "2d+2m": 2 * (d + m), "p": len(self.D[0]) if self.D else 0}
        sizes |= {"K": K, "K+1": K + 1, "q": self.q, "cells": self.cells, "cells+1": self.cells + 1}
        covered = next(iter(lengths.get("covered", {self.cells: ""})))
        further = self.drift is not None or self.powered is not None
        if covered < self.longest or (covered > self.cells and not further):
            raise ValueError("unsafe sets must be known for as long as the reference")
        sizes |= {"two": 2, "sets": sets, "n+2": n + 2, "covered": covered}
        sizes["m+1"] = m + 1
        sizes["measured"] = 0 if self.observer is None else len(self.observer["noise"])
        sizes["missed"] = self.timing.get("missed", 0)
        sizes["ages"] = len((self.observer or {}).get("ages") or ())
        sizes["thrusters"] = 0 if self.allocation is None else len(self.allocation["limits"])
        for size, places in lengths.items():
            for length, place in places.items():
                if length != sizes[size]:
                    raise ValueError(f"{place} has {length} items, where {sizes[size]} ({size}) are needed")

    def _take_claims(self, read: dict[str, Any]) -> None:
        self.unsafe = [unsafe_set(item, len(self.A), len(self.C)) for item in read["unsafe_sets"]]
        self.modes: list[int] = read["modes"]
        caused = any(x > 0 for x in self.shares) or self.late or bool(self.pulse_place)
        self.feedback_bound: Matrix = (read.get("feedback_bound") or [self.u_max]) if caused else []
        pairs = pairwise([*self.feedback_bound, [0.0] * len(self.u_max)] if caused else [])
        if any(a < b for one, two in pairs for a, b in zip(one, two, strict=True)):
            raise ValueError("what is commanded after a hand-over must not grow, nor be negative")
        self.recoverable: str = read["recoverable"]
        self.slopes: list[Matrix | None] = read["slopes"]
        self.weights: list[Vector | None] = read.get("weights") or []  # of what is spent, by step
        if len(self.weights) > self.cells:
            raise ValueError("weights are of more steps than the reference has")
        self.horizon: str = read["horizon"]
        self.guarantee: str = read["guarantee"]
        self.scenario: str = read["scenario"]["name"]
        self.artefacts: dict[str, str] = read["artefacts"]
        samples = dict(read.get("samples") or {})
        self.fits: list[list[Matrix] | None] = samples.pop("fits", [None] * self.steps)
        self.sampled_bound: dict[str, Any] = samples
        self.choices: dict[str, Any] = read.get("choices") or {}
        self._check_claims()
        self.satellites = SATELLITES in read["assumptions"]  # a scenario beside it must agree
        self.assumptions = Assumptions(
            self.w_max,
            self.delta / self.q,
            self.bias,
            resting=any(item.resting for item in self.unsafe),
            satellites=self.satellites,
            of_state=any(item.of_state for item in self.unsafe),
            horizon=self.horizon,
            until=self.claim_end,
            estimate=self.measured_error,
            by_step=bool(self.error_by_step),
            observer=(self.observer or {}).get("noise", ()),
            initial=(self.observer or {}).get("initial") or (),
            constant=(self.observer or {}).get("constant") or (),
            timing=[self.timing[key] for key in ("delay", "jitter", "missed", "clock") if self.timing],
            thrusters=(*self.shares, max(self.prompt_bits)),
            same_shares=self.same_shares,
            pulses=self.pulse_thrust,
            placed=self.pulse_place,
            edge=self.edge,
            fine=self.timing.get("fine", False),
            carried=self.carried_impulse,
            chaser=self.chaser_radius,
            allocated=self.allocation is not None,
            layout=(self.allocation or {}).get("kind", ""),
            late=[(each["name"], each["lasts"]) for each in self.transients],
            sampled=self.sampled_bound or None,
            position=self.C,
            networks=[(law.name, law.precision) for law in self.laws if law.kind == "neural"],
        ).sentences()
        if read["assumptions"] != self.assumptions:
            text = "the certificate rests on other assumptions than those of its format"
            raise Rejected("assumptions", text)

    def _check_claims(self) -> None:
        counts = [len(item.normals) for item in self.unsafe]
        if any(f >= count for row in self.facets for f, count in zip(row, counts, strict=True)):
            raise ValueError("facets must name one facet of every unsafe set in every cell")
        kinds = [law.kind for law in self.laws]
        if kinds[0] != "safety" or "safety" in kinds[1:]:
            raise ValueError("mode 0, and no other, must be the safety controller")
        others = (each["modes"] for each in self.choices.get("library", []))
        if any(max(modes) >= len(self.laws) for modes in (self.modes, *others)):
            raise ValueError("modes must be known")
        sizes = {"error": len(self.A), "state": len(self.A), "time": 1, "reference_input": len(self.u_max)}
        for mode, law in enumerate(self.laws):
            check_law(law, self.steps, sum(sizes.get(name, len(self.C)) for name in law.reads))
            work, entries = law.work
            if work * self.q * self.modes.count(mode) > MOST_WORK or entries > MOST_ENTRIES:
                raise Undecided("controllers", f"the network {law.name} would take too long to follow")
        boxes = [self.laws[mode].kind == "black_box" for mode in self.modes]
        if boxes != [fit is not None for fit in self.fits] or any(boxes) != bool(self.sampled_bound):
            raise ValueError("black boxes, and they alone, must have been fitted to samples")
        if self.guarantee != ("statistical" if any(boxes) else "proved"):
            raise Rejected("guarantee", f"{self.guarantee} is claimed; black boxes fly {sum(boxes)} steps")
        if any(row[-1] < 0 for fit in self.fits for node in fit or () for row in node):
            raise ValueError("bands must not be negative")
        if (
            self.sampled_bound
            and not 0 <= self.sampled_bound["outside"] <= self.sampled_bound["flights"] <= MOST_FLIGHTS
        ):
            raise ValueError("more flights are outside than there are, or there are too many")


def read(path: Path) -> Document:
    """Read a certificate; raises as `Document` does, and `OSError`."""
    return Document(untrusted(path))


def untrusted(path: Path) -> dict[str, Any]:
    """Read the JSON object of a file, of which nothing is known yet; raise `Rejected`, `OSError`."""
    raw = contents(path)
    try:
        data = strict_json(raw)
    except ValueError as error:
        raise Rejected("format", f"not JSON: {error}") from error
    if not isinstance(data, dict):
        raise Rejected("format", "not a JSON object")
    return data
