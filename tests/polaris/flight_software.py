"""Flight software of a sampled tracking law, coded by itself: the oracle of the bounds on its loop.

Its state holds real quantities: the plant's error, the computer's estimates, the commands that it issued, the
remainder of its impulses. Nothing here comes from `polaris.synthesis`.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from scipy.linalg import expm

CELLS = 20  # equal parts of a period; measurements fall on their ends


def hold(A, B, t):
    """Return ``e^{A t}`` and ``int_0^t e^{A s} ds B``."""
    n, m = B.shape
    E = expm(np.block([[A, B], [np.zeros((m, n + m))]]) * t)
    return E[:n, :n], E[:n, n:]


@dataclass
class Record:
    """Flight of many runs: states at ends of cells (0 is the start), and the computer's variables by node."""

    x: list = field(default_factory=list)  # (1 + periods * CELLS) of (runs, n)
    feedback: list = field(default_factory=list)  # by node, (runs, m)
    made: list = field(default_factory=list)  # by period, (runs, m)
    remainder: list = field(default_factory=list)  # by node, (runs, m)
    misjudged: list = field(default_factory=list)  # estimate less truth at the measured instant, by node
    late: list = field(
        default_factory=list
    )  # what uncertainty added after the instant of measurement, at the
    early: list = field(default_factory=list)  # end of its period, and before it; by period, (runs, n)


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

    @cached_property
    def _spans(self):
        """Transitions over a period, over its part after the instant of measurement, and before it."""
        age, late = self.periods
        return [hold(self.A, self.B, t) for t in (self.h, late, self.h - late)]

    @cached_property
    def _within(self):
        """Maps to the ends of the cells of a period."""
        cell = self.h / CELLS
        steps = np.array([expm(self.A * cell * j) for j in range(CELLS + 1)])
        gap = np.arange(CELLS)[:, None] - np.arange(CELLS)  # from the end of one cell to the end of another
        spread = np.where((gap >= 0)[..., None, None], steps[np.maximum(gap, 0)], 0.0)
        pushed = np.array([hold(self.A, self.B, cell * (j + 1))[1] for j in range(CELLS)])
        held = hold(self.A, np.hstack([self.B, self.D]), cell)[1]
        return held, expm(self.A * cell / 2), steps, spread, pushed

    def fly(
        self,
        periods: int,
        runs: int,
        *,
        w: Callable = lambda k: 0.0,
        noise: Callable = lambda k: 0.0,
        errors: Callable = lambda k, v: 0.0,
        reference: Callable = lambda k, feedback, remainder: 0.0,
        remainder: Callable | None = None,
        kicks: np.ndarray | None = None,
    ) -> Record:
        """Fly from rest.

        w(k) (CELLS, runs, .) and errors(k, v) (CELLS, runs, m) are constant in cells. noise(k) (runs, .)
        belongs to the measurement used at node k. reference(k, ...) is the reference's input. kicks (CELLS,
        runs, n) move the state in the middle of the cells of period 0. remainder(k, s) returns the impulse
        that period k leaves to the next; the default is the rule of the bit.
        """
        (n, m), h, (age, late) = self.B.shape, self.h, self.periods
        phase = round((h - late) / h * CELLS) if age else 0
        cell_held, middle, steps, spread, pushed = self._within
        whole, tail, head = self._spans
        x, c = np.zeros((runs, n)), np.zeros((runs, m))
        estimate, out = np.zeros((runs, n)), Record([np.zeros((runs, n))])
        measured, moved = [np.zeros((runs, n))] * age, [np.zeros((runs, m))] * (age + 1)  # newest last

        def past(back):  # commanded, less the reference's input, `back` periods before the present one
            return moved[-back]

        for k in range(periods):
            seen = measured[-age] if age else x
            if self.measures is None:
                known = seen + noise(k)
                estimate = known
            else:  # from the last measurement to this one, then the correction
                if age:
                    estimate = estimate @ tail[0].T + past(age + 1) @ tail[1].T
                    estimate = estimate @ head[0].T + past(age) @ head[1].T
                else:
                    estimate = estimate @ whole[0].T + past(1) @ whole[1].T
                y = seen @ self.measures.T + noise(k)
                estimate = estimate + (y - estimate @ self.measures.T) @ self.correction.T
            out.misjudged.append(estimate - seen)
            known = estimate
            if age:  # prediction under the commands that were issued
                known = known @ tail[0].T + past(age) @ tail[1].T
                for back in range(age - 1, 0, -1):
                    known = known @ whole[0].T + past(back) @ whole[1].T
            feedback = -known @ self.gain.T
            mu = reference(k, feedback, c)
            s = h * (feedback + mu) + c
            out.remainder.append(c)
            if remainder is not None:
                c = remainder(k, s)
            elif self.bit:
                made = np.minimum(self.bit * np.floor(np.abs(s) / self.bit), h * self.u_max) * np.sign(s)
                c = s - made
            else:
                c = 0 * s
            v = (s - c) / h
            moved = [*moved[1:], feedback] if age else [feedback]  # what is left of impulses is not known
            out.feedback.append(feedback)
            out.made.append(v)
            r, push = np.broadcast_to(errors(k, v), (CELLS, runs, m)), np.asarray(w(k))
            push = np.broadcast_to(push, (CELLS, runs, self.D.shape[1]))
            extra = np.concatenate([r, push], axis=2) @ cell_held.T
            if kicks is not None and k == 0:
                extra = extra + kicks @ middle.T
            ends = np.tensordot(steps[1:], x, (2, 1)) + np.tensordot(pushed, v - mu, (2, 1))
            ends = (ends + np.tensordot(spread, extra, ([1, 3], [0, 2]))).transpose(0, 2, 1)
            here = ends[phase - 1] if phase else x
            x = ends[-1]
            out.x.extend(ends)
            last = spread[-1]  # from the ends of cells to the end of the period
            measured = [*measured[1:], here] if age else []
            left = np.concatenate([np.broadcast_to(v - mu - feedback, r.shape), 0 * push], axis=2)
            extra = extra + left @ cell_held.T
            out.early.append(np.tensordot(extra[:phase], last[:phase], ([0, 2], [0, 2])))
            out.late.append(np.tensordot(extra[phase:], last[phase:], ([0, 2], [0, 2])))
        out.remainder.append(c)
        return out

    def state(self, flight: Record, k: int, observer: bool) -> np.ndarray:
        """Return the loop state at node k: error, additions under way, remainder, error of the estimate."""
        age, late = self.periods
        parts, whole = [flight.x[k * CELLS]], expm(self.A * self.h)
        lines = [(flight.late, age)] + ([(flight.early, age - 1)] if late < self.h * (1 - 1e-9) else [])
        for line, ages in lines:
            for back in range(ages):
                parts.append(line[k - 1 - back] @ np.linalg.matrix_power(whole, back).T)
        if self.bit:
            parts.append(flight.remainder[k])
        if observer:
            parts.append(flight.misjudged[k])
        return np.hstack(parts)
