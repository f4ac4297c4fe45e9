"""The safe reference: steps of undisturbed motion under constant inputs, and the facets it stays clear of."""

from dataclasses import dataclass

from flint import arb, arb_mat

from .balls import beside, column, largest, magnitude
from .motion import Plant


@dataclass(frozen=True, eq=False)
class Arc:
    """One step of undisturbed motion under a constant input."""

    plant: Plant
    u: arb_mat  # shape (m, 1)
    nodes: list[arb_mat]  # states at the q+1 nodes, shape (n, 1)
    rates: arb_mat  # x' at the start of each period, shape (n, q)

    @classmethod
    def from_state(cls, plant: Plant, start: arb_mat, u: arb_mat) -> "Arc":
        """Return the exact zero-order-hold step that starts at a state."""
        nodes, push = [start, *(phi * start + gamma * u for phi, gamma in plant.steps)], plant.B * u
        return cls(plant, u, nodes, beside(*(plant.A * x + push for x in nodes[:-1])))

    def heights(self, rows: arb_mat) -> list[list[arb]]:
        """``row x`` at the nodes, ``[row][node]``."""
        heights: list[list[arb]] = (rows * beside(*self.nodes)).tolist()
        return heights

    def intersamples(self, rows: arb_mat) -> list[list[arb]]:
        """Bound on how far ``row x(t)`` leaves its chord in each period, ``[row][period]``."""
        intersamples: list[list[arb]] = (self.plant.open.curvature(rows) * magnitude(self.rates)).tolist()
        return intersamples

    def clearance(self, rows: arb_mat, offsets: list[tuple[arb, arb]]) -> list[list[arb]]:
        """Clearance beyond facets, ``[node][facet]``: ``-row x - b(t)`` less its intersample bound.

        `rows` are ``-n C``, one per facet; `offsets` b at both ends of the step, linear in between.
        """
        facets = list(zip(self.heights(rows), self.intersamples(rows), offsets, strict=True))
        clearances = []
        for i in range(self.plant.q + 1):
            s = arb(i) / self.plant.q
            clearances.append(
                [
                    -height[i] - (first * (1 - s) + last * s) - largest(intersample[max(i - 1, 0) : i + 1])
                    for height, intersample, (first, last) in facets
                ]
            )
        return clearances


@dataclass(frozen=True, eq=False)
class Path:
    """The safe reference: planned steps, then the coasting tail."""

    plant: Plant
    planned: int  # number of steps before the tail
    arcs: list[Arc]
    jump: arb_mat  # step of the reference at the start of the tail, shape (n, 1)

    @classmethod
    def propagate(cls, plant: Plant, x0: arb_mat, inputs: list[list[float]], K: int, tail: arb_mat) -> "Path":
        """Propagate from the first state and the inputs; after K steps from the tail's own first state."""
        arcs: list[Arc] = []
        state, jump = x0, arb_mat(x0.nrows(), 1)
        for k, u in enumerate(inputs):
            if k == K:
                jump, state = tail - state, tail
            arcs.append(Arc.from_state(plant, state, column(u)))
            state = arcs[-1].nodes[-1]
        return cls(plant, K, arcs, jump)

    @property
    def starts(self) -> list[arb_mat]:
        """State at the start of every step, and at the end."""
        return [*(arc.nodes[0] for arc in self.arcs), self.arcs[-1].nodes[-1]]
