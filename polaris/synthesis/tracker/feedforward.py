"""Feedforward error: what scheduled commands add to later errors, by the time of the flight."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from reach.numerics.linear import summed

from ...model.errors import ScenarioError
from ...model.tolerances import ROUNDING
from .loop import Array, Channel
from .tightening import Tightening

ROUNDS, SPARE = 500, 1e-6
"""Most rounds of the bound for ever, and what each adds to it."""


@dataclass(frozen=True, eq=False)
class Feedforward:
    """Errors caused by the reference's own commands, in every period of a flight.

    The command of S splits into feedback, bounded since the hand-over, and a scheduled part, bounded by the
    time of the flight: the reference's input, and what earlier scheduled commands have made wrong. Commands
    are held, so the bound of a period rests on those before it alone.

    Parameters
    ----------
    tightening : Tightening
    inputs : ndarray, shape (periods, m)
        Inputs of the reference, period by period; 0 for ever after.
    """

    tightening: Tightening
    inputs: Array

    @cached_property
    def bound(self) -> tuple[Array, Array]:
        """Bound on the scheduled part of the commands, (periods, m), and for ever after, (m,)."""
        responses, bound = self._responses(self.tightening.closed.K), np.abs(self.inputs)
        N, caused = self.tightening.horizon, [np.zeros((len(bound), g.shape[-1])) for _, g, _ in responses]
        oldest, ever = np.zeros((2, bound.shape[1]))
        if not responses:
            return bound, ever
        for k in range(len(bound)):
            if k > N:
                oldest = np.maximum(oldest, bound[k - N - 1])
            more = np.zeros(bound.shape[1])
            for (channel, gains, older), sizes in zip(responses, caused, strict=True):
                recent = sizes[max(k - N, 0) : k][::-1]
                more += np.einsum("lrk,lk->r", gains[: len(recent)], recent) + older @ _share(channel, oldest)
            bound[k] += more * (1 + ROUNDING)
            for (channel, _, _), sizes in zip(responses, caused, strict=True):
                sizes[k] = _share(channel, bound[k])
        largest = bound.max(axis=0, initial=0.0)
        for _ in range(ROUNDS):
            last = np.maximum(ever, bound[-N:].max(axis=0, initial=0.0))
            more = self._for_ever(responses, last, np.maximum(largest, ever))
            if np.all(more <= ever):
                return bound, ever
            ever = more * (1 + SPARE)
        rule = "errors that grow with the commands feed on themselves"
        raise ScenarioError("thrusters", ever.tolist(), rule)

    def _responses(self, rows: Array) -> list[tuple[Channel, Array, Array]]:
        """Proportional channels; their gains along rows by age (N, r, k), and of all that is older (r, k)."""
        tightening, N = self.tightening, self.tightening.horizon
        carried, parts = tightening.carried(rows), []
        for channel, reach in zip(tightening.closed.loop.channels, tightening.reach, strict=True):
            if channel.share is not None:
                gains = tightening.closed.gains(channel, carried[:N])
                parts.append((channel, gains, np.abs(carried[N]) @ reach))
        return parts

    def _for_ever(self, responses: list[tuple[Channel, Array, Array]], last: Array, largest: Array) -> Array:
        """Bound rows once the last N commands are within `last`, and all within `largest`."""
        total = (
            gains.sum(axis=0) @ _share(channel, last) + older @ _share(channel, largest)
            for channel, gains, older in responses
        )
        return np.asarray(np.sum(list(total), axis=0) * (1 + ROUNDING))

    def along(self, rows: Array) -> Array:
        """Return what scheduled commands add along rows at every node, and ever after, (periods + 2, r)."""
        (bound, ever), N = self.bound, self.tightening.horizon
        responses, total = self._responses(rows), np.zeros((len(bound) + 1, len(rows)))
        for channel, gains, older in responses:
            padded = np.zeros((max(len(bound), N), *gains.shape[1:]))
            padded[:N] = gains
            total += summed(padded[: len(bound)], _share(channel, bound))
            total[N + 1 :] += older @ _share(channel, bound.max(axis=0))
        last = np.maximum(ever, bound[-N:].max(axis=0, initial=0.0))
        largest = np.maximum(ever, bound.max(axis=0, initial=0.0))
        after = self._for_ever(responses, last, largest) if responses else np.zeros(len(rows))
        return np.vstack([total * (1 + ROUNDING), after])


def _share(channel: Channel, bound: Array) -> Array:
    assert channel.share is not None
    return np.asarray(channel.share(bound))
