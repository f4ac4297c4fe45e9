"""Flight software of a sampled tracking law, coded by itself: the oracle of the bounds on its loop.

Its state holds real quantities: the plant's error, the computer's estimates, the commands that it issued, the
remainder of its impulses. Nothing here comes from `polaris.synthesis`.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

CELLS = 20  # equal parts of a period; measurements fall on their ends


def hold(A, B, t):
    """Return ``e^{A t}`` and ``int_0^t e^{A s} ds B``."""
    n, m = B.shape
    E = expm(np.block([[A, B], [np.zeros((m, n + m))]]) * t)
    return E[:n, :n], E[:n, n:]


@dataclass(frozen=True, eq=False)
class Software:
    """Law, observer and thrusters on a plant ``x' = A x + B u + D w`` (errors from the reference)."""

    A: np.ndarray
    B: np.ndarray
    D: np.ndarray
    h: float
    gain: np.ndarray
    delay: float = 0.0  # seconds
    measures: np.ndarray | None = None  # with an observer: what is measured, and the gain of its correction
    correction: np.ndarray | None = None
    bit: float = 0.0  # impulse bit that is carried
    u_max: float = np.inf

    @property
    def periods(self):
        """Age of a measurement in periods, rounded up, and the time [s] from it to the next node."""
        periods = int(np.ceil(self.delay / self.h - 1e-9))
        return periods, self.delay - (periods - 1) * self.h if periods else 0.0

    def fly(
        self, periods: int, runs: int, kicks: np.ndarray, noise: np.ndarray, remainder: np.ndarray, first: int
    ) -> tuple[list[np.ndarray], list[np.ndarray]]:
        """Fly from rest; return states at nodes and feedback, by node, (runs, .) each.

        `kicks` (CELLS, runs, n) move the state in the middle of the cells of period 0, `noise` (runs, .)
        belongs to the measurement used at node `first`, `remainder` is the impulse that period 0 leaves.
        """
        (n, m), h, (age, late) = self.B.shape, self.h, self.periods
        phase, cell = round((h - late) / h * CELLS) if age else 0, self.h / CELLS
        steps = np.array([expm(self.A * cell * j) for j in range(CELLS + 1)])
        responses = np.array([hold(self.A, self.B, cell * (j + 1))[1] for j in range(CELLS)])
        whole, tail, head = (hold(self.A, self.B, t) for t in (h, late, h - late))
        x, c, estimate = np.zeros((runs, n)), np.zeros((runs, m)), np.zeros((runs, n))
        measured, past = [np.zeros((runs, n))] * age, [np.zeros((runs, m))] * (age + 1)  # newest last
        nodes, feedback = [x], []
        for k in range(periods):
            latest, wrong = measured[-age] if age else x, noise * (k == first)
            if self.measures is None:
                estimate = latest + wrong if noise.shape[1] else latest
            else:  # from the last measurement to this one, then the correction
                if age:
                    estimate = estimate @ tail[0].T + past[-age - 1] @ tail[1].T
                    estimate = estimate @ head[0].T + past[-age] @ head[1].T
                else:
                    estimate = estimate @ whole[0].T + past[-1] @ whole[1].T
                y = latest @ self.measures.T + wrong
                estimate = estimate + (y - estimate @ self.measures.T) @ self.correction.T
            predicted = estimate
            if age:  # prediction under the commands that were issued
                predicted = predicted @ tail[0].T + past[-age] @ tail[1].T
                for back in range(age - 1, 0, -1):
                    predicted = predicted @ whole[0].T + past[-back] @ whole[1].T
            u = -predicted @ self.gain.T
            rest = remainder * (k == 0)
            v, c = u + (c - rest) / h, rest
            past = [*past[1:], u]  # what is left of impulses is not known
            ends = x @ steps[1:].transpose(0, 2, 1) + v @ responses.transpose(0, 2, 1)
            for j in range(CELLS if k == 0 else 0):
                kick = kicks[j] @ expm(self.A * cell / 2).T
                ends[j:] += kick @ steps[: CELLS - j].transpose(0, 2, 1)
            measured = [*measured[1:], ends[phase - 1] if phase else x] if age else []
            x = ends[-1]
            nodes.append(x)
            feedback.append(u)
        return nodes, feedback
