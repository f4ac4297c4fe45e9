"""The result of Algorithm 2: modes per step, tubes, margins, and guarantees."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from reach.numerics.linear import growth
from reach.sets.zonotope import Zonotope
from reach.short_repr import short_repr

from ...model.errors import ScenarioError
from ...model.scene.obstacle import chaser_radius
from ...model.scene.satellite import SatelliteObstacle
from ...model.scene.state_limits import StateLimit
from ...model.system import Array
from ..controllers.black_box import FittedSegment, SampledBound
from ..controllers.controllers import Controller, TubeSegment, construct_s
from ..controllers.neural import NeuralController
from ..safety.continuation import HandOver
from ..safety.get_safety import Safety
from ..safety.passive import Drift, PassiveSafety
from ..safety.recoverable import Margin, RecoverableSet
from ..sources.craft import assumed
from .arrival import Arrival, GoalDistance, Spending, Tail, Upkeep, slack_factor
from .powered import KnownBranches, PoweredSafety, powered
from .rules import Prices, SwitchingRules
from .spending import FlightSpending, Spell


@short_repr
@dataclass(frozen=True, eq=False)
class Step:
    """One step of the schedule.

    Attributes
    ----------
    mode : int
        0 is S, 1, 2, ... the experimental controllers.
    tube : TubeSegment
        Reachable set over the step, in error coordinates.
    k : int
        Which step it is.
    recoverable : RecoverableSet
    """

    mode: int
    tube: TubeSegment
    k: int
    recoverable: RecoverableSet

    @cached_property
    def margin(self) -> Margin:
        """Return the margin of the tube inside the recoverable sets.

        Steps under S need no margin: from a recoverable set S stays safe to the end.
        """
        return self.recoverable.margin(self.k, self.tube.states, self.tube.intersample)


@short_repr
@dataclass(frozen=True, eq=False)
class Schedule:
    """A switching schedule L with everything its proof rests on.

    Attributes
    ----------
    safety : Safety
        Safety that it was made from.
    controllers : tuple of Controller
        Indexed by mode.
    steps : sequence of Step
        One per planning step.
    final : Zonotope
        Set of errors at T.
    seconds : mapping
        Wall time of the synthesis by stage.
    library : sequence of Schedule
        Along other references, proven on the way to this one: as long safe, and they arrive if it does.
    objective : Prices, optional
        Objective of a flight at the scenario's prices, a function of its shares of the time by mode, its
        velocity change [m/s] and its number of switches; known where references were planned with U in view.
    sampled_bound : SampledBound, optional
        Results of sampled flights for the steps that black boxes fly.
    branches : KnownBranches, optional
        Branches of aborts with thrust that were planned before; others are planned when they are asked for.
    """

    safety: Safety
    controllers: tuple[Controller, ...]
    steps: Sequence[Step]
    final: Zonotope
    seconds: Mapping[str, float] = field(default_factory=dict)
    library: Sequence["Schedule"] = ()
    objective: Prices | None = None
    sampled_bound: SampledBound | None = None
    branches: KnownBranches | None = None

    def _brief(self) -> Mapping[str, object]:
        """Return the entries that a session and a notebook show."""
        approach = self.approach if self.guarantee == "proved" else None
        return {
            "guarantee": self.guarantee,
            "controllers": tuple(controller.name for controller in self.controllers),
            "share_of_U": f"{self.share():.1%}",
            "switches": self.switches,
            "steps": len(self.steps),
            "duration_s": len(self.steps) * self.safety.problem.delta,
            "goal_reached_by_s": approach.by if approach else None,
        }

    @property
    def guarantee(self) -> str:
        """Return ``proved``, ``statistical`` or ``none`` of safety; until when says ``safety.end``.

        A black box in any step makes all of it ``statistical``, and ``none`` without a `sampled_bound`.
        """
        if not self.sampled_steps:
            return "proved"
        return "none" if self.sampled_bound is None else "statistical"

    @property
    def sampled_steps(self) -> int:
        """Number of steps whose sets come from samples."""
        return sum(isinstance(step.tube, FittedSegment) for step in self.steps)

    @cached_property
    def assumptions(self) -> tuple[str, ...]:
        """Return the assumptions that the guarantee rests on, for a mission to discharge."""
        safety = self.safety
        problem, cells, end = safety.problem, safety.reference.cells, safety.end
        offsets = [unsafe.offsets[:cells] for unsafe in safety.clearance.unsafe]
        premises = replace(
            assumed(problem.system, problem.delta / safety.clearance.q),
            resting=any(bool(np.all(b == b[0, 0])) for b in offsets),
            satellites=any(isinstance(unsafe, SatelliteObstacle) for unsafe in problem.unsafe),
            of_state=any(isinstance(unsafe, StateLimit) for unsafe in problem.unsafe),
            horizon=end.horizon,
            until=end.until if np.isfinite(end.until) else None,
            chaser=chaser_radius(problem.unsafe),
            allocated=problem.allocation is not None,
            sampled=None if self.sampled_bound is None else asdict(self.sampled_bound),
            networks=[
                (law.name, law.policy.network.precision)
                for law in self.controllers
                if isinstance(law, NeuralController)
            ],
        )
        return (
            *premises.sentences(),
            "arithmetic: double precision, its round-off covered by rounding allowances",
        )

    @cached_property
    def modes(self) -> NDArray[np.int_]:
        """Mode of every step, shape (K,)."""
        return np.array([step.mode for step in self.steps], dtype=int)

    @property
    def times(self) -> Array:
        """Start of every step, and T [s], shape (K+1,)."""
        return np.asarray(np.arange(len(self.steps) + 1) * self.safety.problem.delta, dtype=float)

    @property
    def switches(self) -> int:
        """Number of changes of mode inside the horizon."""
        return int(np.count_nonzero(np.diff(self.modes)))

    def keeps(self, rules: SwitchingRules) -> bool:
        """Return True if it keeps the budget, and the requirement on the drift after all thrust stops."""
        return self.affords(rules) and (self.passive is None or self.passive.kept)

    def affords(self, rules: SwitchingRules) -> bool:
        """Return True if it keeps the budget; the tightest bound is computed only if it must be."""
        return rules.delta_v_max is None or rules.affords(self._spent_by_period) or rules.affords(self.spent)

    @cached_property
    def _spells(self) -> list[Spell]:
        return [Spell.from_tube(self.controllers[step.mode], step.tube, step.k) for step in self.steps]

    @cached_property
    def delta_v_middle(self) -> float:
        """Velocity change until T along the middle of the tubes [m/s]."""
        h = self.safety.tracking.flow.h
        return sum(float(spell.middle.sum()) * h for spell in self._spells) / self.safety.problem.system.mass

    @cached_property
    def delta_v(self) -> tuple[float, float]:
        """Velocity change until T [m/s]: along the middle of the tubes, and proven never to be exceeded."""
        return self.delta_v_middle, self.spending.schedule

    @cached_property
    def spending(self) -> Spending:
        """Bounds on the velocity change, and weights by which they are found."""
        return self.tail.spending(self._spells, self.approach)

    @property
    def tail(self) -> Tail:
        """Build S's flight after T; not cached, as its tubes take too much memory."""
        last, q = max((step.k + 1 for step in self.steps if step.mode), default=0), self.safety.clearance.q
        start = self.steps[last - 1].tube.end if last else self.safety.start
        T = len(self.steps) * q
        return Tail(self.safety, starts=(HandOver(start, last * q, last * q), HandOver(self.final, T, T)))

    @cached_property
    def approach(self) -> GoalDistance:
        """Return the proven distance to the goal: reached or not, and by when."""
        return self.tail.approach()

    @cached_property
    def arrival(self) -> Arrival:
        """Proof of the goal, with the velocity change until then."""
        values = {each.name: getattr(self.approach, each.name) for each in fields(self.approach)}
        return Arrival(**values, delta_v=self.spending.goal)

    @cached_property
    def upkeep(self) -> Upkeep | None:
        """Bounds on S's spending after T, for ever, and on the lifetime of the tank, where proven."""
        return self.tail.upkeep(self.spending)

    @cached_property
    def estimate(self) -> dict[str, list[float] | None] | None:
        """Bounds on the errors of an observer's estimates by state, None where there is no observer.

        While experimental controllers fly, and once S has settled after T (`Upkeep.settled`).
        """
        tracking = self.safety.tracking
        if tracking.system.observer is None:
            return None
        rows, extra = tracking.estimate_error_rows, tracking.unremembered(tracking.system.u_max)
        tubes = [tracking.loop_state(step.tube.states) for step in self.steps if step.mode]
        largest = [np.max([sets.support(rows), sets.support(-rows)], axis=(0, 1)) for sets in tubes]
        least = tracking.system.navigation + tracking.system.state_offset_at_nodes  # under any commands
        bounds = {
            "settled": None if self.upkeep is None else self.tail.estimate(tracking.settling + 2),
            "experimental": np.max(largest, axis=0) + extra if tubes else None,
        }
        factor = 1 + slack_factor(tracking)
        return {k: None if x is None else (np.minimum(x, least) * factor).tolist() for k, x in bounds.items()}

    @cached_property
    def passive(self) -> PassiveSafety | None:
        """Return the steps from which the drift stays clear if all thrust stops; None if nothing is asked."""
        flight = self.safety.free_flight
        if flight is None:
            return None
        return PassiveSafety(flight, tuple(drift_of(self.safety, step.tube, step.k) for step in self.steps))

    @cached_property
    def powered(self) -> PoweredSafety | None:
        """Return the steps from which S reaches the orbit of an abort with thrust; None if none is asked."""
        tubes = [(step.mode, step.tube) for step in self.steps]
        impulse = np.array([spell.thrust.sum() for spell in self._spells]) * self.safety.tracking.flow.h
        return powered(self.safety, tubes, impulse / self.safety.problem.system.mass, self.branches)

    def aborted(self, k: int) -> "Schedule":
        """Return the flight that is aborted with thrust at the start of step k: S from there on its branch.

        Raises
        ------
        ScenarioError
            If nothing is proven of an abort in that step.
        """
        way = None if self.powered is None else self.powered.ways[k]
        if self.powered is None or way is None or way.branch is None:
            raise ScenarioError("abort", k, "must be a step in which an abort with thrust is proven")
        safety = self.powered.branches[way.branch].safety
        s = construct_s(safety.tracking, safety.reference)
        steps = [replace(step, recoverable=safety.recoverable) for step in self.steps[:k]]
        reached = steps[-1].tube.end if steps else safety.start
        for later in range(k, safety.problem.K):
            steps.append(Step(0, s.propagate(reached, later), later, safety.recoverable))
            reached = steps[-1].tube.end
        return Schedule(replace(safety, controller=s), (s, *self.controllers[1:]), tuple(steps), reached)

    @property
    def spent(self) -> float:
        """Velocity change [m/s] that is proven never to be exceeded until the goal, or T if it is not proven.

        This is compared with a budget, `SwitchingRules.delta_v_max`.
        """
        until_end = self.spending.schedule * (1 + slack_factor(self.safety.tracking))
        return self.spending.goal if self.approach.reached is True else until_end

    @property
    def _spent_by_period(self) -> float:
        """Bound `spent` by that of every period [m/s], which takes little time."""
        tail, spells = self.tail, self._spells
        scale = tail.safety.tracking.flow.h / tail.safety.problem.system.mass
        delta_v = (
            FlightSpending(spells, tail.T).summed(tail.T) * scale * (1 + slack_factor(tail.safety.tracking))
        )
        return delta_v + (tail.correcting(self.approach.node) if self.approach.reached is True else 0.0)

    def share(self, mode: int | None = None) -> float:
        """Share of time under one mode; without one, under any experimental controller."""
        return float(np.mean(self.modes > 0 if mode is None else self.modes == mode))

    def mode_at(self, t: float) -> int:
        """Return the switching logic L(t): mode at a time t [s], at a switch the new one; S after T."""
        k = int(np.floor(t / self.safety.problem.delta + 1e-12))
        return int(self.modes[k]) if 0 <= k < len(self.modes) else 0

    @property
    def margins(self) -> Array:
        """Containment margin of every step, shape (K,); see `polaris.synthesis.safety.recoverable.Margin`.

        The proof needs it to be at least 0 under an experimental controller only. Under S it may be
        negative: the set reached is enclosed afresh at every node, and S, once it has taken over from a
        recoverable set, is safe regardless of that enclosure.
        """
        return np.array([step.margin.value for step in self.steps])


def drift_of(safety: Safety, tube: TubeSegment, k: int) -> tuple[Drift, ...]:
    """Return the drifts of flights in a tube over step k after all thrust stops; none if nothing is asked."""
    problem, q = safety.problem, safety.clearance.q
    flight = safety.free_flight
    if flight is None:
        return ()
    system, h, arc = problem.system, problem.delta / q, safety.clearance.nodes[k]
    rate = np.abs(arc[:-1] @ system.A.T + safety.reference.nu[k] @ system.B.T)
    intersample = (
        tube.intersample + system.state_offset + h**2 / 8 * rate @ (np.abs(system.A) @ growth(system.A, h)).T
    )
    return flight.drifts(k, tube.nodes + arc, intersample)
