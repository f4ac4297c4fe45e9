"""Parts of a certificate: unsafe sets, controllers and their networks, claims of drifts."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from flint import arb_mat

from ..kernel.balls import matrix
from ..kernel.verdict import Rejected


@dataclass(frozen=True)
class Layer:
    """Layer of a network: weights and biases, scales and biases of an elementwise one, or an activation.

    Of scales, and of biases beside them, one number stands for as many equal ones as there are components.
    """

    kind: str  # affine, diagonal, relu, tanh, sigmoid or clip
    W: list[list[float]] = field(default_factory=list)
    b: list[float] = field(default_factory=list)
    scale: list[float] = field(default_factory=list)
    low: float = 0.0  # slope of a relu below 0, or lower limit of a clip
    high: float = 0.0

    @property
    def steepest(self) -> float:
        """Largest slope of an activation."""
        return max(self.low, 1.0) if self.kind == "relu" else 1.0


def network_of(law: dict[str, Any]) -> dict[str, Any]:
    """Fields of a law that is a network, its layers of sizes that fit."""
    if law["kind"] != "neural":
        return {}
    layers, width = [Layer(**layer) for layer in law["layers"]], len(law["input_scale"])
    for layer in layers:
        if layer.kind == "affine":
            if not layer.W or len(layer.W) != len(layer.b) or any(len(row) != width for row in layer.W):
                raise ValueError(f"layers of {law['name']} do not fit one another")
            width = len(layer.W)
        elif layer.kind == "diagonal":
            if not {len(layer.scale), len(layer.b)} <= {1, width}:
                raise ValueError(f"layers of {law['name']} do not fit one another")
        elif (layer.kind == "relu" and layer.low < 0) or (layer.kind == "clip" and layer.low > layer.high):
            raise ValueError(f"{law['name']} has a {layer.kind} that decreases")
    if width != len(law["output_scale"]) or len(set(law["inputs"])) < len(law["inputs"]):
        raise ValueError(f"inputs or outputs of {law['name']} do not fit")
    scales = {name: law[name] for name in ("input_scale", "output_scale")}
    defaults = {"bodies": law.get("obstacles", []), "precision": law.get("precision", "real")}
    return {"reads": law["inputs"], "layers": layers, **defaults, **scales}


UNIT = 4e-9  # how far the square of a unit normal may be off 1

Vector = list[float]
Matrix = list[list[float]]


@dataclass(frozen=True)
class UnsafeSet:
    """One timed polytope: ``normals p <= b(t)``, b linear within each cell, p the position or the state."""

    name: str
    keep_in: bool  # whether it is the outside of one facet of a keep-in set
    normals: Matrix
    start: Matrix  # b at the start of every cell, shape (cells, F)
    end: Matrix  # and at its end
    of_state: bool = False  # whether it lies in the state

    def rows(self, position: arb_mat, facets: Sequence[int] | None = None) -> arb_mat:
        """Return some or all normals as rows of the state, shape (F, n)."""
        normals = self.normals if facets is None else [self.normals[f] for f in facets]
        return matrix(normals) if self.of_state else matrix(normals) * position

    @property
    def resting(self) -> bool:
        """Return True if the offsets are the same at all times."""
        return self.rests_from(0)

    def rests_from(self, cell: int) -> bool:
        """Return True if the offsets are the same from the start of a cell on."""
        return all(b == self.start[cell] for b in (*self.start[cell:], *self.end[cell:]))


@dataclass(frozen=True)
class Law:
    """One controller; gain and own reference are None for ``any_thrust``, the latter also for S.

    A network has no gain, but what it reads, its layers, and what its inputs and outputs are multiplied by.
    """

    name: str
    kind: str  # safety, affine, saturated_affine, any_thrust, neural or black_box
    gain: Matrix | None = None
    states: Matrix | None = None
    inputs: Matrix | None = None
    reads: list[str] = field(default_factory=list)
    input_scale: Vector = field(default_factory=list)
    output_scale: Vector = field(default_factory=list)
    layers: list[Layer] = field(default_factory=list)
    bodies: list[dict[str, Any]] = field(default_factory=list)  # that it reads, and how each moves
    precision: str = "real"  # arithmetic in which a network is evaluated: real, float32 or float64

    @classmethod
    def from_item(cls, law: Any) -> "Law":
        """Build a law from its item."""
        return cls(
            *map(law.get, ("name", "kind", "gain", "reference_states", "reference_inputs")), **network_of(law)
        )

    @property
    def work(self) -> tuple[int, int]:
        """Products of two numbers that one enclosure of the network takes; most numbers in its generators."""
        products, peak, size, generators = 0, 0, len(self.input_scale), len(self.input_scale)
        for layer in self.layers:
            if layer.kind == "affine":
                products, size = products + len(layer.W) * size * generators, len(layer.W)
            elif layer.kind != "diagonal":
                generators += size
            products, peak = products + size * generators, max(peak, size * generators)
        return products, peak


@dataclass(frozen=True)
class Departure:
    """A parallelotope around where thrust may stop in some periods of a step, as of the start of the step."""

    periods: int
    center: Vector
    axes: Matrix  # one generator after another
    facets: list[list[list[int]]]  # of every unsafe set: for how many parts of a step, and which


@dataclass(frozen=True)
class DriftClaim:
    """Claim of the drift after all thrust stops."""

    horizon: float  # [s]
    keep_in: bool  # whether keep-in sets count
    parts: int  # of a step
    steps: list[list[Departure] | None]  # None of those from which nothing is claimed


@dataclass(frozen=True)
class AbortBranch:
    """A reference that leaves the schedule's at the start of a step, towards the orbit of an abort."""

    step: int
    inputs: Matrix  # of its steps until it coasts
    facets: list[list[int]]  # in every cell from the start of the flight on
    tail: Vector  # the state from which it coasts
    tolerance: float  # what counts as reached [m]
    horizon: str  # as that of the schedule

    def claim_end(self, delta: float) -> float | None:
        """Last instant of the claim [s]; steps are `delta` long."""
        return last_instant(self.horizon, self.step + len(self.inputs), len(self.facets), delta)


def last_instant(horizon: str, steps: int, cells: int, delta: float) -> float | None:
    """Last instant of a claim about a reference whose tail begins after so many steps [s]; None for ever."""
    return None if horizon == "infinite" else (cells if horizon == "one_period" else steps) * delta


@dataclass(frozen=True)
class AbortStep:
    """Claim of an abort in one step: its branch, and the cell at whose start it has arrived."""

    branch: int
    cell: int


@dataclass(frozen=True)
class Powered:
    """Claims of aborts with thrust."""

    within: float | None  # [s]
    budget: float | None  # [m/s]
    branches: list[AbortBranch]
    steps: list[AbortStep | None]  # None of those of which nothing is claimed


def powered_of(item: dict[str, Any], delta: float, sets: list[int]) -> Powered:
    """Return the claims of aborts with thrust; `sets` are the numbers of facets of the unsafe sets."""
    branches = [AbortBranch(**each) for each in item["branches"]]
    steps = [None if abort is None else AbortStep(**abort) for abort in item["steps"]]
    within, budget = item["within"], item["budget"]
    for branch in branches:
        if not branch.step + len(branch.inputs) <= len(branch.facets) or not branch.step <= len(steps):
            raise ValueError("a branch must leave within the schedule, and have facets in all of its cells")
        if any(f >= count for row in branch.facets for f, count in zip(row, sets, strict=True)):
            raise ValueError("facets of a branch must name one facet of every unsafe set in every cell")
    for k, abort in enumerate(steps):
        if abort is None:
            continue
        if not (abort.branch < len(branches) and branches[abort.branch].step > k):
            raise ValueError(f"the abort in step {k} must be along a branch that leaves later")
        if within is not None and not (abort.cell - k) * delta <= within * (1 + 1e-9):
            raise Rejected("powered_abort", f"the abort in step {k} takes more than {within:g} s")
    return Powered(within, budget, branches, steps)


def unsafe_set(item: dict[str, Any], n: int, d: int) -> UnsafeSet:
    """Return a timed polytope of n states or d positions; normals of positions have length 1."""
    normals, offsets, of_state = item["normals"], item["offsets"], item.get("of_state") or False
    for normal in normals:
        if len(normal) != (n if of_state else d):
            raise ValueError(f"normals of {item['name']} have {len(normal)} numbers")
        # Everything measures distances along normals, and slacks are relative to them.
        if not of_state and not abs(math.fsum(x * x for x in normal) - 1) <= UNIT:
            raise Rejected("unsafe_sets", f"a normal of {item['name']!r} is no unit vector")
    if any(len(row) != len(normals) for pair in offsets for row in pair):
        raise ValueError(f"offsets of {item['name']} must have one number for every normal")
    first, last = ([pair[place] for pair in offsets] for place in (0, 1))
    return UnsafeSet(item["name"], item["keep_in"], normals, first, last, of_state)


def abort_of(drift: dict[str, Any], q: int) -> DriftClaim:
    """Return the claims of drifts, from their item and the number of periods in a step."""
    steps = [None if parts is None else [Departure(**part) for part in parts] for parts in drift["steps"]]
    covered = {sum(part.periods for part in parts) for parts in steps if parts is not None}
    if not covered <= {q}:
        raise ValueError("a drift must have departures in every period of a step")
    return DriftClaim(drift["horizon"], drift["keep_in"], drift["parts"], steps)


def check_law(law: Law, steps: int, reads: int) -> None:
    """Check that the parts of a law fit each other and the schedule; `reads` is a network's input size."""
    if (law.states is None) != (law.inputs is None):
        raise ValueError(f"{law.name} has half a reference of its own")
    if any(part is not None and len(part) < steps for part in (law.states, law.inputs)):
        raise ValueError(f"the reference of {law.name} must cover every step")
    if reads != len(law.input_scale):
        raise ValueError(f"{law.name} reads another number of values than it scales")
    _check_bodies(law)


def _check_bodies(law: Law) -> None:
    """Check that a network is told of each body that it reads, once: where it goes or how it is known."""
    read = dict.fromkeys(name.partition(":")[2] for name in law.reads if ":" in name)
    if [body["name"] for body in law.bodies] != list(read):
        raise ValueError(f"{law.name} must say of each body that it reads, and of no other, how it moves")
    for body in law.bodies:
        rigid, half = body["state"] is None, body["state_half_widths"]
        if (half is None) != rigid or not (rigid or body["center_m"] is body["velocity_m_s"] is None):
            raise ValueError(f"{body['name']} must move either by a velocity or as a satellite does")
        if rigid and body["thrust_accel_max_m_s2"]:
            raise ValueError(f"{body['name']} must have no thrust where it moves by a velocity")
