"""Bounds on the velocity change: period by period, or of all periods of linear laws at once."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby

import numpy as np
from scipy.linalg import block_diag

from reach.sets.zonotope import Zonotope

from ...model.craft import Craft
from ...model.system import Array
from ...model.tolerances import ROUNDING
from ..controllers.controllers import AffineController, Controller, TubeSegment
from ..controllers.neural import NeuralController
from ..safety.continuation import HandOver, PathRows
from ..safety.feedforward import command_noise
from ..tracker import storage
from ..tracker.affine_law import clip_band
from ..tracker.long_flight import Inputs, carried_across
from ..tracker.loop import ClosedLoop
from ..tracker.storage import LinearStep, Weights

LONGEST = 40_000  # periods of linear laws that are looked at all at once, at most
EXACT = 1e-4  # share by which a checker's storage may be larger


@dataclass(frozen=True, eq=False)
class Spell:
    """The thrust in the q periods of one step."""

    law: Controller
    tube: TubeSegment
    k: int
    middle: Array  # size of commands along the middle of the tube [N], (q, m)
    thrust: Array  # bound on the mean thrust in every period [N], (q, m)
    commands: Array | None = None  # bound on commands, where the law is affine [N], (q, m)

    @classmethod
    def from_tube(cls, law: Controller, tube: TubeSegment, k: int) -> "Spell":
        """Build the spell of step k; a controller known by its thrust limits alone is charged all of them."""
        q = len(tube.intersample)
        if isinstance(law, NeuralController):  # it flies on exact states
            centre, spread = law.commanded(tube.nodes - law.offset[k], tube.intersample, k)
            largest = np.minimum((np.abs(centre) + spread) * (1 + ROUNDING), law.system.u_max)
            middle = np.minimum(np.abs(centre), law.system.u_max)
            return cls(law, tube, k, middle[:-1], law.system.spending(largest)[:-1])
        if not isinstance(law, AffineController):
            limit = getattr(law, "system", None)
            thrust = np.tile(np.full(1, np.inf) if limit is None else limit.spending(limit.u_max), (q, 1))
            return cls(law, tube, k, thrust, thrust)
        step_law, system = law.in_step(k), law.system
        centre, spread = step_law.commanded(tube.states - step_law.loop_offset(k), tube.intersample, k)
        largest = centre + 0.0
        for i in range(q + 1):
            top = (np.abs(centre[i]) + spread[i] + _noise(step_law, largest, i)) * (1 + ROUNDING)
            largest[i] = np.minimum(top, system.u_max)
        middle = np.minimum(np.abs(centre), system.u_max)
        return cls(law, tube, k, middle[:-1], system.spending(largest)[:-1], largest[:-1])

    @cached_property
    def start(self) -> Zonotope:
        """Loop states at the start, ahead of a constant matrix of errors of thrusters where one counts."""
        states, law = self.tube.states[0], self.law
        if not isinstance(law, AffineController) or not np.any(law.system.matrix):
            return states
        G = np.hstack([states.G, carried_across(law.in_step(self.k).closed.loop, law.system)])
        sizes = law.system.matrix[np.nonzero(law.system.matrix)]
        return Zonotope(np.concatenate([states.c, 0 * sizes]), block_diag(G, np.diag(sizes)))

    @cached_property
    def linear(self) -> LinearStep | None:
        """Return the step as a loop about the tube's middle; None if only sets of true errors are known."""
        if self.commands is None:
            return None
        law = self.law
        assert isinstance(law, AffineController)
        step_law, mu, q = law.in_step(self.k), law.own.nu[self.k], len(self.tube.intersample)
        d, rounding = self.tube.states - step_law.loop_offset(self.k), law.reference.rounding[self.k]
        limits = self.commands.max(axis=0), law.system.u_max
        cache: dict[bytes, Inputs] = {}
        inputs, middles = list[Inputs](), mu - d.c[:q] @ step_law.closed.K.T
        for i in range(q):
            closed, bands = step_law.closed, _noise(step_law, self.commands, i)
            if self.tube.slopes is not None:
                slope, offset, radius = clip_band(step_law, d[i], mu)
                closed, bands = ClosedLoop(closed.loop, slope[:, None] * step_law.gain), bands + radius
                middles[i] = slope * middles[i] + offset
            key = closed.gain.tobytes() + bands.tobytes()
            if key not in cache:
                cache[key] = Inputs.from_loop(closed, law.system, limits, 0 * rounding, rounding, bands)
            inputs.append(cache[key])
        if np.any(law.system.matrix):
            loop = step_law.closed.loop
            inputs = [each.about(loop, middle) for each, middle in zip(inputs, middles, strict=True)]
            middles = np.hstack([middles, 0 * middles])
        return LinearStep(tuple(inputs), middles)


def _noise(law: AffineController, commands: Array, i: int) -> Array:
    """Bound the estimate noise in a command of period i of a step, after commands within bounds, (m,)."""
    return law.noise_after(commands[:i])  # Proposition 7 (b)


@dataclass(frozen=True, eq=False)
class FlightSpending:
    """Bounds on the thrust of a flight from its start until any period.

    Attributes
    ----------
    spells : sequence of Spell
        Of its steps.
    periods : int
        Until where `weights` are chosen.
    """

    spells: Sequence[Spell]
    periods: int

    @cached_property
    def runs(self) -> list[list[int]]:
        """Steps on end that are all linear, or all not."""
        groups = groupby(range(len(self.spells)), lambda k: self.spells[k].commands is None)
        return [list(run) for _, run in groups]

    @cached_property
    def weights(self) -> list[Weights | None]:
        """Weights for each step; None where it is not linear, or nothing is gained."""
        weights: list[Weights | None] = [None] * len(self.spells)
        for run in self.runs:
            steps = self._steps(run, self.periods)
            if steps and sum(len(step.middle) for step in steps) <= LONGEST:
                clipped = any(self.spells[k].tube.slopes is not None for k in run)
                chosen = storage.weights(steps, self.spells[run[0]].start, clipped)
                weights[run[0] : run[0] + len(chosen)] = chosen
        return weights

    def _steps(self, run: Sequence[int], periods: int) -> list[LinearStep]:
        """Return the steps of a run as far as so many periods of the flight."""
        steps = []
        for k in run:
            q = len(self.spells[k].thrust)
            remaining, step = periods - k * q, self.spells[k].linear
            if remaining > 0 and step is not None:
                steps.append(step.first_periods(remaining))
        return steps

    def summed(self, periods: int) -> float:
        """Bound the thrust of so many periods, each for itself [N] (Proposition 14 (b))."""
        return float(np.concatenate([spell.thrust for spell in self.spells])[:periods].sum())

    def thrust_bound(self, periods: int) -> float:
        """Bound the thrust of so many periods [N] (Proposition 14 (b), (c))."""
        total = 0.0
        for run in self.runs:
            first = run[0] * len(self.spells[0].thrust)
            bounds = [self.spells[k].thrust for k in run]
            thrust = float(np.concatenate(bounds)[: max(periods - first, 0)].sum())
            steps = self._steps(run, periods)
            weights = [each for k, _ in zip(run, steps, strict=False) if (each := self.weights[k])]
            if steps and len(weights) == len(steps):
                law = self.spells[run[0]].law
                assert isinstance(law, AffineController)
                start = self.spells[run[0]].start
                thrust = min(thrust, together(law.system, steps, weights, start))
            total += thrust
        return total * (1 + ROUNDING)


def together(
    system: Craft, steps: Sequence[LinearStep], weights: Sequence[Weights], start: Zonotope
) -> float:
    """Bound the thrust of linear steps on end, from loop states in a set about its centre [N]."""
    count, bits = sum(len(step.middle) for step in steps), np.sum(system.weights * system.on_time.bit)
    return float(system.longest * (storage.bound(steps, weights, start) * (1 + EXACT) + count * bits))


def commanded(rows: PathRows, hand_overs: Sequence[HandOver], first: int, last: int) -> Array:
    """Bound S's commands at both ends of the periods from a node until another, (2, last - first, m) [N].

    The rows are `Tracking.commands`. Each of the sets holds all errors that S may take over.
    """
    clearance, tracking = rows.clearance, rows.clearance.tracking
    tightening = np.min([rows.tightenings(each, first, last) for each in hand_overs], axis=0)
    noise = command_noise(tracking, clearance.cells, clearance.planned)
    cell = np.minimum(np.arange(first, last) // clearance.q, clearance.cells - 1)
    both = tightening.reshape(*tightening.shape[:2], 2, noise.shape[1])
    return np.asarray(both.max(axis=2) + (np.abs(clearance.reference.nu) + noise)[cell])


def tracked(rows: PathRows, hand_overs: Sequence[HandOver], first: int, last: int) -> float:
    """Bound S's velocity change in the periods from a node until another [m/s], see `commanded`."""
    system, h = rows.clearance.tracking.system, rows.clearance.tracking.flow.h
    thrust = system.spending(np.minimum(commanded(rows, hand_overs, first, last), system.u_max))
    return float(thrust.sum(axis=-1).max(axis=0).sum()) * h / system.mass
