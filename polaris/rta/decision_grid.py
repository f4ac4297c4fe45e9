"""The scene on which run-time assurance methods meet: one time grid, one reference, the same controllers."""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from reach.numerics.linear import discretize
from reach.short_repr import short_repr

from ..model.checks import non_negative, of_kind, positive
from ..model.craft import Array, Craft
from ..model.errors import ScenarioError
from ..model.scene.timed_polytope import TimedPolytope
from ..synthesis.controllers.black_box import BlackBox
from ..synthesis.controllers.controllers import Controller
from ..synthesis.controllers.neural import NeuralController
from ..synthesis.safety.clearance import Clearance
from ..synthesis.safety.continuation import Continuation
from ..synthesis.safety.problem import Problem
from ..synthesis.schedule.schedule import Schedule
from ..synthesis.sources.late_faults import undetected
from ..synthesis.tracker.tracking import Tracking

WHOLE = 1e-9  # relative tolerance on "divides"


@short_repr
@dataclass(frozen=True, eq=False)
class DecisionGrid:
    """A schedule's scene, on the nodes at which decisions are made and take effect.

    Parameters
    ----------
    schedule : Schedule
        As synthesised.
    period : float
        Time between decisions [s]; divides the planning step.
    latency : float
        Time from a measurement to the moment the decision on it takes effect [s], at most the period.
    half_widths : ndarray, shape (n,)
        Largest error of the state estimate that decisions are made on, per entry.
    tracking : Tracking
        S, its faults as late as decisions meet them.
    clearance : Clearance
        Clearance around the reference.
    nodes, delay : int
        Nodes per decision, and per latency.
    """

    schedule: Schedule
    period: float
    latency: float
    half_widths: Array
    tracking: Tracking
    clearance: Clearance
    nodes: int
    delay: int

    @classmethod
    def from_schedule(
        cls, schedule: Schedule, period: float | None = None, latency: float = 0.0, half_widths: Any = None
    ) -> "DecisionGrid":
        """Lay the grid.

        Parameters
        ----------
        schedule : Schedule
        period : float, optional
            [s]; by default the control period.
        latency : float
            [s]
        half_widths : array_like, optional
            Largest error of the state estimate that decisions are made on, one number or one per state; 0
            where it is exact. By default that of the estimate that S and U act on (``[navigation]``, or that
            of predictions with ``[timing]``). By what jitter displaces states they grow, and by what faults
            that are isolated late add to predictions.

        Raises
        ------
        ScenarioError
            If the period does not fit into the planning step, it or the latency is no multiple of the
            control period, or the latency is longer than the period.
        """
        of_kind("schedule", schedule, Schedule, "polaris.synthesize")
        safety = schedule.safety
        base = safety.tracking
        period, half = check_decisions(safety.problem, period, latency, half_widths)
        nodes, delay = round(period / base.flow.h), round(latency / base.flow.h)
        system = met_by_decisions(base.system, nodes, delay, base.flow.h)
        tracking = Tracking(system, base.gain, base.feedback, base.delta)
        old = safety.clearance
        clearance = Clearance(tracking, old.reference, old.unsafe, old.facets, old.planned, old.jump)
        offset = 0.0 if half_widths is None else base.system.state_offset
        half = half + offset + undetected(system, base.gain, base.flow.h)
        return cls(schedule, period, latency, half, tracking, clearance, nodes, delay)

    def with_feedback_bound(self) -> "DecisionGrid":
        """Return the grid tightened by S's thruster errors as the schedule is: by those of falling commands.

        Otherwise it is tightened by those of full thrust, which leaves S all of its commands.
        """
        tracking = replace(self.tracking, level=self.schedule.safety.tracking.level)
        return replace(self, tracking=tracking, clearance=replace(self.clearance, tracking=tracking))

    def inflated(self, buffer: float) -> "DecisionGrid":
        """Return the grid with perceived unsafe sets that reach `buffer` [m] further along every facet."""
        if buffer == 0:
            return self
        unsafe = tuple(replace(one, offsets=one.offsets + buffer) for one in self.unsafe)
        return replace(self, clearance=replace(self.clearance, unsafe=unsafe))

    @property
    def system(self) -> Craft:
        """Craft that is controlled."""
        return self.tracking.system

    @property
    def controllers(self) -> tuple[Controller, ...]:
        """Indexed by mode."""
        return self.schedule.controllers

    @property
    def unsafe(self) -> tuple[TimedPolytope, ...]:
        """Perceived unsafe sets."""
        return self.clearance.unsafe

    @property
    def half_width(self) -> float:
        """Largest half width of the initial set in position [m]."""
        start = self.schedule.safety.problem.initial_set
        return float(np.abs(self.system.position @ start.G).sum(axis=1).max())

    @property
    def h(self) -> float:
        """Spacing of the nodes [s]."""
        return self.tracking.flow.h

    @property
    def decisions(self) -> int:
        """Number of decisions up to T."""
        return self.last // self.nodes

    @property
    def last(self) -> int:
        """The node at T."""
        return self.clearance.planned * self.clearance.q

    @cached_property
    def fine_schedule(self) -> Schedule:
        """Schedule with the grid's own S, for integration."""
        safety = replace(
            self.schedule.safety,
            tracking=self.tracking,
            clearance=self.clearance,
            recoverable=Continuation(self.clearance),
        )
        return replace(self.schedule, safety=safety)

    @cached_property
    def xi(self) -> Array:
        """The safe reference at every node up to the end of the tail, shape (nodes + 1, n)."""
        return _at_nodes(self.clearance.nodes)

    @cached_property
    def mu(self) -> Array:
        """The reference input over the period after every node, shape (nodes, m)."""
        return np.repeat(self.clearance.reference.nu, self.clearance.q, axis=0)

    @cached_property
    def own_references(self) -> dict[int, Array]:
        """The experimental controllers' own references at every node up to T, by mode."""
        out = {}
        for mode, law in enumerate(self.controllers):
            reference = getattr(law, "own", self.clearance.reference)
            if reference is not self.clearance.reference:
                out[mode] = _at_nodes(reference.fine(self.clearance.q))
        return out

    @cached_property
    def facets(self) -> tuple[Array, Array, NDArray[np.intp]]:
        """All facets of all perceived unsafe sets.

        Returns
        -------
        rows : ndarray, shape (F, n)
            Their normals as rows of the state.
        offsets : ndarray, shape (nodes + 1, F)
            At every node [m].
        first : ndarray of int, shape (o,)
            Index of each set's first facet.
        """
        polytopes = self.unsafe
        first = np.cumsum([0, *(len(unsafe.normals) for unsafe in polytopes)])[:-1]
        none, system = np.zeros((len(self.xi), 0)), self.system
        rows = np.vstack([np.zeros((0, system.n)), *(unsafe.rows(system) for unsafe in polytopes)])
        # Sets may be perceived for longer than the reference and its tail last.
        fine = (unsafe.fine(self.clearance.q)[: self.clearance.cells] for unsafe in polytopes)
        offsets = [_at_nodes(arcs) for arcs in fine]
        return rows, np.hstack([none, *offsets]), first.astype(np.intp)

    def nearest(self, clearance: Array) -> Array:
        """Distance to the nearest unsafe set, by its farthest facet, from those to all facets (..., F)."""
        if not self.unsafe:
            return np.full(clearance.shape[:-1], np.inf)
        return np.asarray(np.maximum.reduceat(clearance, self.facets[2], axis=-1).min(axis=-1))

    def command(self, mode: int, node: int, x: Array) -> Array:
        """Command of a controller at a node, before clipping, shape (..., m)."""
        cells = self.clearance.cells if mode == 0 else self.clearance.planned
        k = min(node // self.clearance.q, cells - 1)
        reference = self.own_references[mode][node] if mode in self.own_references else self.xi[node]
        law, arguments = self.controllers[mode], (k, self.xi[node], reference, x)
        if isinstance(law, BlackBox | NeuralController):
            return law.command(*arguments, (node - k * self.clearance.q) * self.h)
        return law.command(*arguments)

    def clipped(self, mode: int, node: int, x: Array) -> Array:
        """Return the command of a controller at a node as the thrusters apply it: clipped, shape (..., m)."""
        return np.asarray(np.clip(self.command(mode, node, x), -self.system.u_max, self.system.u_max))

    @cached_property
    def discrete(self) -> tuple[Array, Array, Array]:
        """Transition from node to node, and the effects of an input and a disturbance held meanwhile."""
        Ad, Bd = discretize(self.system.A, self.system.B, self.h)
        return Ad, Bd, discretize(self.system.A, self.system.D, self.h)[1]


def check_decisions(
    problem: Problem, period: float | None = None, latency: float = 0.0, half_widths: Any = None
) -> tuple[float, Array]:
    """Check arguments of `DecisionGrid.from_schedule` before the synthesis.

    Returns the period [s] and half widths, shape () or (n,).
    """
    n, delta = problem.system.n, problem.delta
    h = problem.period or delta / problem.feedback.nodes_per_cell
    met_by_decisions(problem.system, 1, 0, h)  # refuses faults
    period = positive("period", h if period is None else period, "s")
    _check_parts("period", period, delta / period, f"must divide the planning step of {delta:g} s")
    if not 0 <= non_negative("latency", latency, "s") <= period:
        raise ScenarioError("latency", latency, f"must be at most the decision period of {period:g} s")
    half = np.asarray(problem.system.navigation if half_widths is None else half_widths, dtype=float)
    if half.shape not in ((), (n,)) or not (np.all(np.isfinite(half)) and np.all(half >= 0)):
        raise ScenarioError("half_widths", half.tolist(), f"must be one or {n} finite numbers >= 0")
    rule = f"must be a multiple of the control period of {h:g} s"
    _check_parts("period", period, period / h, rule)
    _check_parts("latency", latency, latency / h, rule)
    return period, half


def _at_nodes(arcs: Array) -> Array:
    """Values at the nodes of every cell (cells, q+1, ...) in one row; at a border the later cell's."""
    return np.concatenate([arcs[:, :-1].reshape(-1, *arcs.shape[2:]), arcs[-1, -1:]])


def met_by_decisions(system: Craft, nodes: int, delay: int, h: float) -> Craft:
    """Faults as decisions of so many periods of h [s] meet them, which take effect `delay` periods late."""
    if not (faults := system.transients):
        return system
    if system.observer is not None:
        rule = "must be isolated at once with navigation.measurement, for run-time methods: leave out one of"
        rule += " them, or fly S, U and the schedule with both by `polaris run`"
        raise ScenarioError("faults", faults[0].name, rule)
    wait, after = h * (nodes - 1), h * max(delay, 1) * bool(system.timing.delay or system.timing.missed)
    lasts = (fault.lasts + wait * bool(len(fault.thrust)) for fault in faults)
    pairs = zip(faults, lasts, strict=True)
    transients = tuple(replace(fault, lasts=x, after=after, missed=nodes + delay) for fault, x in pairs)
    return replace(system, transients=transients)


def _check_parts(name: str, value: float, count: float, rule: str) -> None:
    if not abs(round(count) - count) <= WHOLE * max(count, 1.0):
        raise ScenarioError(name, value, rule)
