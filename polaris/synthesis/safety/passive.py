"""Passive safety: where the chaser drifts if all thrust stops, at any instant of a step.

The drift is no `Continuation`: it has facets of its own for every start, because with those of S, one for
each time, far fewer steps are clear.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from reach.numerics.linear import growth, powers
from reach.sets.zonotope import Zonotope
from reach.tubes.flow import LinearFlow

from ...model.scene.distances import stretches
from ...model.scene.timed_polytope import TimedPolytope
from ...model.system import Array, LinearSystem
from ...model.tolerances import ROUNDING

SPARE = 0.03
"""Share by which starts of the drift are enclosed wider than found: others merge generators otherwise."""
GROUPS = 6  # groups of periods whose starts are enclosed one by one where the step as a whole is not clear
FINE = 0.1  # largest angle [rad] by which the fastest mode turns in one part of a step


@dataclass(frozen=True)
class DriftRequirement:
    """Requirement on the drift after all thrust stops."""

    horizon: float  # for how long the drift must stay clear [s]
    required: bool = False  # whether only schedules are kept whose drift stays clear from all their steps
    keep_in: bool = True  # whether it must stay inside the keep-in sets as well

    def cells(self, delta: float) -> int:
        """Steps from the start of that in which thrust stops until the horizon is over, wherever it does."""
        return int(np.ceil(self.horizon / delta * (1 - 1e-12))) + 1


@dataclass(frozen=True, eq=False)
class Drift:
    """Drift of all flights whose thrust stops in some periods of one step.

    The start is a parallelotope around the states at the start of the step from which free motion leads to
    the states in which thrust stops (docs/theory.md, Proposition 15 (a)).
    """

    periods: int  # how many, one after another
    start: Zonotope
    facets: NDArray[
        np.int_
    ]  # of every set with most clearance in each part from the step's start on, (o, parts)
    clearance: Array  # distance from that facet at least [m], (o, parts)
    middle: Array  # the same of the undisturbed drift from the start's middle, at the ends of the parts

    @property
    def clear(self) -> bool:
        """Return True if the drift is proven to stay clear of every unsafe set."""
        return bool(np.all(self.clearance > 0))


@dataclass(frozen=True, eq=False)
class FreeFlight:
    """Free motion of a system over a horizon, and the unsafe sets as far ahead."""

    abort: DriftRequirement
    system: LinearSystem
    unsafe: tuple[TimedPolytope, ...]  # as far ahead as the drift from the last step is followed
    delta: float  # step of the schedule [s]

    @property
    def cells(self) -> int:
        """Steps over which the drift from one step is followed."""
        return self.abort.cells(self.delta)

    @cached_property
    def parts(self) -> int:
        """Parts of a step over which the drift is all but straight."""
        fastest = float(np.max(np.abs(np.linalg.eigvals(self.system.A))))
        return max(1, int(np.ceil(self.delta * fastest / FINE)))

    @cached_property
    def sets(self) -> tuple[TimedPolytope, ...]:
        """Return the unsafe sets that the drift must stay clear of."""
        return tuple(item for item in self.unsafe if self.abort.keep_in or not item.keep_in)

    @cached_property
    def _powers(self) -> Array:
        return powers(expm(self.system.A * self.delta / self.parts), self.cells * self.parts)

    @cached_property
    def _weight(self) -> tuple[Array, Array]:
        """Root L of the Gramian, ``L L'``: how far states move the position over the horizon; its inverse."""
        positions = self.system.position @ self._powers
        gram = np.einsum("tdi,tdj->ij", positions, positions) / len(positions)
        L = np.linalg.cholesky(gram + 1e-9 * np.diag(np.diag(gram)) + 1e-12 * np.eye(len(gram)))
        return L, np.asarray(np.linalg.inv(L))

    @cached_property
    def _rows(self) -> tuple[Array, Array, Array]:
        """Rows ``-n C e^{A t}`` of sets, intersample bound of a part per state, disturbance at its end."""
        system, h = self.system, self.delta / self.parts
        rows = -np.vstack([np.zeros((0, system.n)), *(item.rows(system) for item in self.sets)])
        flow, carried = LinearFlow.continuous(system.A, system.D, system.w_max, h), rows @ self._powers
        curvature = h**2 / 8 * np.abs(rows @ system.A @ system.A) @ growth(system.A, h)
        disturbance = flow.disturbance_support(rows, len(carried) - 1)[1:]
        if (biases := system.biases).size:  # constant all along: the effect of one may cancel
            ends = np.cumsum(carried[:-1] @ flow.input_map(biases), axis=0)
            ends = np.abs(np.concatenate([0 * ends[:1], ends])).sum(axis=-1)
            bias_rate = np.abs(carried[:-1] @ system.A) @ flow.growth @ np.abs(biases).sum(axis=1)
            each = np.maximum(ends[:-1], ends[1:]) + h**2 / 8 * bias_rate
            shifted = [np.pad(each, ((j, 0), (0, 0)))[: len(each)] for j in range(self.parts + 1)]
            disturbance = disturbance + np.max(shifted, axis=0)  # thrust stops up to a step later
        return carried, curvature, disturbance

    def drifts(self, k: int, nodes: Zonotope, intersample: Array) -> tuple[Drift, ...]:
        """Return the drifts of flights whose thrust stops in step k: one of all, or groups if not clear.

        `nodes` is a stack of q+1 sets of states, on chords between them up to `intersample`, (q, n).
        """
        q, drifts = len(intersample), []
        for groups in (1, min(GROUPS, q)):
            ends = [round(q * i / groups) for i in range(groups + 1)]
            drifts = [
                self._drift(k, b - a, self._start(nodes[a : b + 1], intersample[a:b], a, q))
                for a, b in pairwise(ends)
            ]
            if clear(drifts):
                break
        return tuple(drifts)

    def _start(self, nodes: Zonotope, intersample: Array, first: int, q: int) -> Zonotope:
        """Enclose the states in which thrust may stop, carried to the start of the step (Proposition 15 (a)).

        In the periods between some nodes of a step of q periods, the first of them its node `first`.
        """
        system = self.system
        h = self.delta / q
        back = powers(expm(-system.A * h), first + len(intersample))[first:]
        centre, spread = np.einsum("qij,qj->qi", back, nodes.c), back @ nodes.G
        half, growth_map = nodes.half_widths, growth(system.A, h)
        largest = np.maximum((np.abs(nodes.c) + half)[:-1], (np.abs(nodes.c) + half)[1:])
        travel = np.abs(np.diff(nodes.c, axis=0)) + half[:-1] + half[1:]
        curvature = h / 8 * (h * largest @ np.abs(system.A @ system.A).T + 2 * travel @ np.abs(system.A).T)
        beyond = (intersample + curvature) @ growth_map.T
        L, inverse = self._weight
        columns = np.hstack([*spread, (centre - centre.mean(axis=0)).T])
        _, axes = np.linalg.eigh(L.T @ (columns @ columns.T + np.diag(beyond.max(0) ** 2)) @ L)
        T, rows = inverse.T @ axes, axes.T @ L.T
        at, reach = centre @ rows.T, np.abs(rows @ spread).sum(-1)
        extra = np.einsum("qij,qj->qi", np.abs(rows @ back[:-1]), beyond)
        low = np.min(np.stack([(at - reach)[:-1], (at - reach)[1:]]) - extra, axis=(0, 1))
        high = np.max(np.stack([(at + reach)[:-1], (at + reach)[1:]]) + extra, axis=(0, 1))
        half = (high - low) / 2 * (1 + SPARE) + ROUNDING * (np.abs(low) + np.abs(high)) + 1e-12
        return Zonotope(T @ ((low + high) / 2), T * half)

    def _drift(self, k: int, periods: int, start: Zonotope) -> Drift:
        """Return the drift of a set of starts at the beginning of step k."""
        (rows, curvature, disturbance), shape = self._rows, (len(self.sets), self.cells * self.parts)
        fine = [item.fine(self.parts)[k : k + self.cells] for item in self.sets]
        offsets = np.concatenate([np.zeros((self.cells, self.parts + 1, 0)), *fine], axis=-1)
        ends = np.stack([offsets[:, :-1], offsets[:, 1:]]).reshape(2, shape[1], len(rows[0]))
        size = np.abs(self._powers @ start.c) + np.abs(self._powers @ start.G).sum(-1)
        at, reach = rows @ start.c, np.abs(rows @ start.G).sum(-1)
        chord, upper, large = size[:-1] @ curvature.T + disturbance, at + reach, np.abs(at) + reach
        rounded = ROUNDING * (np.abs(ends) + np.maximum(large[:-1], large[1:]) + chord)
        clearance = (-ends - (np.stack([upper[:-1], upper[1:]]) + chord) - rounded).min(axis=0)
        last = np.cumsum([len(item.normals) for item in self.sets])[:-1].astype(int)
        clearances, middles = (
            np.split(part, last, axis=1)[: shape[0]] for part in (clearance, -ends[1] - at[1:])
        )
        facets = [part.argmax(axis=1) for part in clearances]
        by_set = facets, [part.max(axis=1) for part in clearances], [part.max(axis=1) for part in middles]
        return Drift(periods, start, *(np.array(each).reshape(shape) for each in by_set))


@dataclass(frozen=True, eq=False)
class PassiveSafety:
    """Steps of a flight from which the drift stays clear, all thrust stopping at any instant of them."""

    flight: FreeFlight
    drifts: tuple[tuple[Drift, ...], ...]  # of every step, one for all or one after another

    @cached_property
    def clear(self) -> NDArray[np.bool_]:
        """Return True for each step from which the drift is proven to stay clear, shape (K,)."""
        return np.array([clear(parts) for parts in self.drifts])

    @property
    def kept(self) -> bool:
        """Return True if the drift stays clear from all steps, or need not."""
        return not self.flight.abort.required or bool(np.all(self.clear))

    @property
    def least(self) -> float | None:
        """Least distance [m] that is proven of the drift from the steps that are clear; None without any."""
        clearances = [
            part.clearance.min()
            for parts in self.drifts
            if clear(parts)
            for part in parts
            if part.clearance.size
        ]
        return float(min(clearances)) * (1 - ROUNDING) if clearances else None

    def to_dict(self) -> dict[str, Any]:
        """Return a run's claims of passive safety."""
        abort, delta = self.flight.abort, self.flight.delta
        return {
            "drift_s": abort.horizon,
            "keep_in": abort.keep_in,
            "clear_s": [[a * delta, b * delta] for a, b in stretches(self.clear)],  # steps, joined
            "least_m": self.least,
            "witness": self.witness(),
        }

    def witness(self) -> dict[str, Any] | None:
        """Return the step from which the drift enters an unsafe set, or is soonest not shown to stay clear.

        None if it is clear from all. ``distance_m`` is the proven distance then (negative: by how
        much sets overlap), and ``middle_m`` that of the undisturbed drift from the middle of where thrust may
        stop: if it is not positive, the drift does enter.
        """
        if np.all(self.clear):
            return None
        flight = self.flight
        drifts = [(k, part) for k, parts in enumerate(self.drifts) for part in parts if not part.clear]
        step, drift = min(drifts, key=lambda item: float(item[1].middle.min()))
        o, part = np.unravel_index(int(np.argmin(drift.middle)), drift.middle.shape)
        if drift.middle[o, part] > 0:
            step, drift = min(drifts, key=lambda item: int(np.argmax(np.any(item[1].clearance <= 0, axis=0))))
            part = np.argmax(np.any(drift.clearance <= 0, axis=0))
            o = np.argmin(drift.clearance[:, part])
        return {
            "step": step,
            "t_s": step * flight.delta,
            "unsafe_set": flight.sets[o].name,
            "after_s": float(part + 1) * flight.delta / flight.parts,
            "distance_m": float(drift.clearance[o, part]),
            "middle_m": float(drift.middle[o, part]),
        }


def clear(parts: Sequence[Drift]) -> bool:
    """Return True if the drift is proven to stay clear from all of a step."""
    return all(part.clear for part in parts)
