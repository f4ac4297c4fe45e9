"""Reference arcs, enclosed, and the room between them and the separating facets."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from flint import arb, arb_mat

from .balls import beside, column, exponential, largest, magnitude
from .motion import Plant


@dataclass(frozen=True, eq=False)
class Arc:
    """One step of undisturbed motion under a constant input.

    Parameters
    ----------
    nodes : list of arb_mat, shape (n, 1)
        States at the q+1 nodes.
    rates : arb_mat, shape (n, q)
        ``x'`` at the start of each period.
    """

    nodes: list[arb_mat]
    rates: arb_mat

    def heights(self, rows: arb_mat) -> arb_mat:
        """``row x`` at the nodes, shape (rows, q+1)."""
        return rows * beside(*self.nodes)


@dataclass(frozen=True, eq=False)
class Kinematics:
    """Exact zero-order-hold steps of a plant.

    Parameters
    ----------
    plant : Plant
    q : int
        Periods per step.
    """

    plant: Plant
    q: int

    @cached_property
    def _steps(self) -> list[tuple[arb_mat, arb_mat]]:
        parts = [exponential(self.plant.A, self.plant.h * i) for i in range(self.q + 1)]
        return [(phi, gamma * self.plant.B) for phi, gamma in parts]

    def arc(self, start: arb_mat, u: arb_mat) -> Arc:
        """The step that starts at a state under a constant input."""
        nodes = [phi * start + gamma * u for phi, gamma in self._steps]
        push = self.plant.B * u
        return Arc(nodes, beside(*(self.plant.A * x + push for x in nodes[:-1])))

    def bow(self, rows: arb_mat, arc: Arc) -> arb_mat:
        """Bound on how far ``row x(t)`` leaves its chord in each period, shape (rows, q)."""
        bent = self.plant.open.bend(rows)
        return bent * magnitude(arc.rates)

    def room(self, rows: arb_mat, offsets: list[tuple[arb, arb]], arc: Arc) -> list[list[arb]]:
        """Room of the arc beyond facets, ``[node][facet]``: ``-row x - b(t)`` less the bow next to it.

        Parameters
        ----------
        rows : arb_mat
            ``-n C``, one per facet.
        offsets : list of (arb, arb)
            b at the start and the end of the step; linear in between.
        arc : Arc
        """
        heights, bows = arc.heights(rows).tolist(), self.bow(rows, arc).tolist()
        found = []
        for i in range(self.q + 1):
            s = arb(i) / self.q
            found.append(
                [
                    -height[i] - (first * (1 - s) + last * s) - largest(bow[max(i - 1, 0) : i + 1])
                    for height, bow, (first, last) in zip(heights, bows, offsets, strict=True)
                ]
            )
        return found


@dataclass(frozen=True, eq=False)
class Path:
    """The safe reference: planned steps, then the coasting tail.

    Parameters
    ----------
    kinematics : Kinematics
    planned : int
        Number K of planned steps.
    starts : list of arb_mat
        Exact state at the start of every step, and at the end.
    inputs : list of arb_mat
        Input of every step.
    jump : arb_mat, shape (n, 1)
        Step of the reference at the start of the tail.
    """

    kinematics: Kinematics
    planned: int
    starts: list[arb_mat]
    inputs: list[arb_mat]
    jump: arb_mat

    @classmethod
    def propagate(
        cls,
        kinematics: Kinematics,
        x0: list[float],
        inputs: list[list[float]],
        planned: int,
        tail: list[float],
        closed: bool,
    ) -> Path:
        """Propagate from the first state and the inputs; a tail starts at a state of its own.

        Parameters
        ----------
        tail : list of float
            State from which the tail starts.
        closed : bool
            Hill's frame: the tail's velocity along the track is ``-2 eta r_x`` exactly.
        """
        states, at, jump = [], column(x0), column([0] * len(x0))
        pushes = [column(u) for u in inputs]
        for k, u in enumerate(pushes):
            if k == planned:
                start = column(tail)
                if closed:
                    start[4, 0] = -kinematics.plant.A[3, 4] * start[0, 0]
                jump, at = start - at, start
            states.append(at)
            at = kinematics.arc(at, u).nodes[-1]
        return cls(kinematics, planned, [*states, at], pushes, jump)

    @property
    def cells(self) -> int:
        """Number of steps, those of the tail included."""
        return len(self.inputs)

    @cached_property
    def arcs(self) -> list[Arc]:
        """Every step as an arc."""
        return [self.kinematics.arc(x, u) for x, u in zip(self.starts[:-1], self.inputs, strict=True)]
