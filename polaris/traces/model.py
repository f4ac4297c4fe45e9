"""Trace in memory: the stamped states and modes of agents, the stamped unsafe sets."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from reach.short_repr import short_repr

from ..model.checks import MOST_ROWS
from ..model.errors import ScenarioError
from ..model.scene.distances import UNKNOWN
from ..model.system import Array, as_finite

NORMAL, UNTRUSTED, SAFETY = 1, 2, 3  # mode numbers of a trace; all others are unknown

MODE_NAMES = {NORMAL: "NORMAL", UNTRUSTED: "UNTRUSTED", SAFETY: "SAFETY"}

Modes = NDArray[np.int64]


def _stamps(place: str, times: ArrayLike) -> Array:
    array = as_finite(f"{place}.times", times, 1)
    if len(array) == 0:
        raise ScenarioError(place, [], "must hold at least one row")
    back = np.flatnonzero(np.diff(array) < 0)
    if back.size:
        row = int(back[0]) + 1
        rule = f"must not be earlier than the row before it ({array[row - 1]:g} s)"
        raise ScenarioError(f"{place}[{row}]", float(array[row]), f"its time {rule}")
    return array


def _rows(place: str, name: str, value: ArrayLike, shape: tuple[int | None, ...]) -> Array:
    """A finite array of the given shape (None: any length)."""
    array = as_finite(f"{place}.{name}", value, len(shape))
    if any(size is not None and size != length for size, length in zip(shape, array.shape, strict=True)):
        expected = " x ".join("any" if size is None else str(size) for size in shape)
        raise ScenarioError(f"{place}.{name}", array.shape, f"must have the shape {expected}")
    return array


@short_repr
@dataclass(frozen=True, eq=False)
class AgentTrace:
    """States and modes of one agent over time.

    A mode, of shape (N,) or (N-1,), is in force from its stamp on: 1 NORMAL, 2 UNTRUSTED, 3 SAFETY, all else,
    and the default, unknown. `ScenarioError` on wrong shapes, numbers that are not finite, stamps that run
    backwards; `where` is what it calls the agent.
    """

    times: Array  # stamps [s], shape (N,), N >= 1
    states: Array  # SI units, shape (N, n); the first entries are the position [m]
    modes: Modes = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    running_times: Array = field(default_factory=lambda: np.empty(0))  # of each decision [s], shape (R,)
    limits: tuple[str, ...] = ()  # names of limits on the whole state
    margins: Array = field(default_factory=lambda: np.empty(0))  # clearances [m], (limits, N); inf without
    where: str = field(default="agent", kw_only=True, repr=False)

    def __post_init__(self) -> None:
        assign = object.__setattr__
        assign(self, "times", _stamps(f"{self.where}.state_trace", self.times))
        N = len(self.times)
        assign(self, "states", _rows(f"{self.where}.state_trace", "states", self.states, (N, None)))
        if self.states.shape[1] == 0:
            raise ScenarioError(f"{self.where}.state_trace[0]", [], "must hold a state besides its time")
        modes = np.asarray(self.modes)
        if modes.size == 0:
            modes = np.full(N, UNKNOWN)
        if modes.ndim != 1 or not np.issubdtype(modes.dtype, np.integer) or len(modes) not in (N, N - 1):
            rule = f"must be {N} whole numbers, one per state (or {N - 1}, without the last)"
            raise ScenarioError(f"{self.where}.mode_trace", modes.shape, rule)
        assign(self, "modes", modes.astype(np.int64))
        running = _rows(self.where, "running_times", self.running_times, (None,))
        if np.any(running < 0):
            row = int(np.argmax(running < 0))
            raise ScenarioError(f"{self.where}.running_times[{row}]", float(running[row]), "must be >= 0 [s]")
        assign(self, "running_times", running)
        margins = np.asarray(self.margins, dtype=float) if self.limits else np.empty((0, N))
        if margins.shape != (len(self.limits), N) or np.any(np.isnan(margins) | (margins == -np.inf)):
            rule = f"must hold {N} numbers [m], or null, for each limit"
            raise ScenarioError(f"{self.where}.margin_trace", margins.shape, rule)
        assign(self, "margins", margins)

    @property
    def n(self) -> int:
        """Number of state entries."""
        return int(self.states.shape[1])

    @property
    def known_modes(self) -> Modes:
        """Modes with `polaris.model.scene.distances.UNKNOWN` for all that are not 1, 2 or 3."""
        return np.where(np.isin(self.modes, list(MODE_NAMES)), self.modes, UNKNOWN)


@dataclass(frozen=True, eq=False)
class UnsafeTrace:
    """One unsafe set at its stamps, in 1 to 3 axes d of position: the base of the four kinds."""

    set_type: ClassVar[str]  # point, ball, rectangle or polytope
    times: Array  # stamps [s], shape (M,), M >= 1, not running backwards; one row holds for all times
    where: str = field(default="unsafe set", kw_only=True, repr=False)
    span: tuple[float, float] = field(default=(-np.inf, np.inf), kw_only=True)  # when it holds [s]

    def __post_init__(self) -> None:
        object.__setattr__(self, "times", _stamps(f"{self.where}.state_trace", self.times))
        if not self.span[0] < self.span[1]:
            rule = f"must be after from_s = {self.span[0]:g}"
            raise ScenarioError(f"{self.where}.until_s", self.span[1], rule)

    @property
    def _trace(self) -> str:
        return f"{self.where}.state_trace"

    def _sizes(self, name: str, value: Array) -> None:
        if np.any(value < 0):
            row = int(np.argwhere(value < 0)[0][0])
            raise ScenarioError(f"{self._trace}[{row}]", value[row].tolist(), f"its {name} must be >= 0 [m]")


@dataclass(frozen=True, eq=False)
class CentredTrace(UnsafeTrace):
    """A set about a centre, `centers` of shape (M, d) [m]."""

    centers: Array

    def __post_init__(self) -> None:
        super().__post_init__()
        rows = _rows(self._trace, "centers", self.centers, (len(self.times), None))
        if not 1 <= rows.shape[1] <= 3:
            raise ScenarioError(f"{self._trace}[0]", rows[0].tolist(), "must have 1, 2 or 3 axes")
        object.__setattr__(self, "centers", rows)

    @property
    def d(self) -> int:
        """Axes of position."""
        return int(self.centers.shape[1])


@short_repr
@dataclass(frozen=True, eq=False)
class PointTrace(CentredTrace):
    """A point to stay away from; `centers` has shape (M, d) [m]."""

    set_type: ClassVar[str] = "point"


@short_repr
@dataclass(frozen=True, eq=False)
class BallTrace(CentredTrace):
    """A ball; `centers` has shape (M, d), `radii` (M,) [m], >= 0.

    `velocities` (M, d) [m/s], where they are known, are those of the centres at their stamps. Without them
    differences of the centres stand for them, wrong by their spacing squared where a motion is curved.
    """

    set_type: ClassVar[str] = "ball"
    radii: Array
    velocities: Array | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "radii", _rows(self._trace, "radii", self.radii, (len(self.times),)))
        self._sizes("radius", self.radii)
        if self.velocities is not None:
            rows = _rows(f"{self.where}.velocity_trace", "velocities", self.velocities, self.centers.shape)
            object.__setattr__(self, "velocities", rows)


@short_repr
@dataclass(frozen=True, eq=False)
class RectangleTrace(CentredTrace):
    """An axis-aligned box; `centers` and full `lengths` have shape (M, d) [m], lengths >= 0."""

    set_type: ClassVar[str] = "rectangle"
    lengths: Array

    def __post_init__(self) -> None:
        super().__post_init__()
        object.__setattr__(self, "lengths", _rows(self._trace, "lengths", self.lengths, self.centers.shape))
        self._sizes("lengths", self.lengths)


@short_repr
@dataclass(frozen=True, eq=False)
class PolytopeTrace(UnsafeTrace):
    """``A p <= b``, bounded or not.

    `A` has shape (M, F, d), or (1, F, d) if it is the same at all stamps; `b` has shape (M, F). Rows
    of `A` need not have unit length. Emptiness is refused where it is evaluated.
    """

    set_type: ClassVar[str] = "polytope"
    A: Array
    b: Array

    def __post_init__(self) -> None:
        super().__post_init__()
        assign = object.__setattr__
        A = as_finite(f"{self._trace}.A", self.A, 3)
        count, F, d = A.shape
        if count not in (1, len(self.times)):
            raise ScenarioError(f"{self._trace}.A", A.shape, f"must hold 1 or {len(self.times)} matrices")
        if not 1 <= d <= 3:
            raise ScenarioError(f"{self._trace}[0]", A.shape[1:], "A must have 1, 2 or 3 columns")
        if not 1 <= F <= MOST_ROWS:
            raise ScenarioError(f"{self._trace}[0]", A.shape[1:], f"A must have 1 to {MOST_ROWS} rows")
        flat = np.argwhere(np.abs(A).max(axis=-1) < 1e-150)
        if flat.size:
            row, facet = flat[0].tolist()
            rule = f"row {facet} of A must not be zero"
            raise ScenarioError(f"{self._trace}[{row}]", A[row].tolist(), rule)
        if count > 1 and np.all(A[0] == A):
            A = A[:1]
        assign(self, "A", A)
        assign(self, "b", _rows(self._trace, "b", self.b, (len(self.times), F)))

    @property
    def d(self) -> int:
        """Axes of position."""
        return int(self.A.shape[2])


AnySet = PointTrace | BallTrace | RectangleTrace | PolytopeTrace


@short_repr
@dataclass(frozen=True, eq=False)
class Trace:
    """Agents, at least one, and unsafe sets, by name."""

    agents: Mapping[str, AgentTrace]
    unsafe: Mapping[str, AnySet] = field(default_factory=dict)
    ignored: tuple[str, ...] = ()  # places in the file that say nothing known, and were passed over

    def __post_init__(self) -> None:
        if not self.agents:
            raise ScenarioError("agents", {}, "must hold at least one agent")

    def same_as(self, other: "Trace") -> bool:
        """Return True if both hold the same names, in the same order, and the same numbers."""
        pairs = (self.agents, other.agents), (self.unsafe, other.unsafe)
        return all(list(a) == list(b) and all(map(_equal_fields, a.values(), b.values())) for a, b in pairs)


def _equal_fields(one: object, other: object) -> bool:
    fields, other_fields = vars(one) | {"where": ""}, vars(other) | {"where": ""}
    return type(one) is type(other) and all(np.array_equal(fields[key], other_fields[key]) for key in fields)
