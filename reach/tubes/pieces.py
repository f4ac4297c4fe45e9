"""Input sets that change at given times: sums over the lags at which each of them acts."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .systems import LinearSystem

Array = NDArray[np.float64]


def piece_starts(system: LinearSystem, times: Array, parts: int) -> tuple[list[int], float]:
    """Node at which every input set begins, and by how much all breaks lie off their nodes together.

    Between a break and the node it is moved to, the wrong set is taken: what that may add is booked.
    """
    starts, missed = [0], 0.0
    for b in system.breaks:
        if b >= times[-1]:
            starts.append(len(times))
            continue
        k = parts * int(np.argmin(np.abs(times[::parts] - b)))
        starts.append(k)
        missed += float(abs(times[k] - b))
    return starts, missed


def totals(steps: Array, starts: list[int]) -> Array:
    """Integral of the inputs at every node from what the steps add per input set, shape (K+1, r).

    At time t the set that begins at b and ends at e has acted over the lags ``t - e`` to ``t - b``.
    """
    K, pieces, r = steps.shape
    sums = np.concatenate([np.zeros((1, pieces, r)), np.cumsum(steps, axis=0)])
    out, k = np.zeros((K + 1, r)), np.arange(K + 1)
    for i in range(pieces):
        out += sums[np.maximum(k - starts[i], 0), i]
        if i + 1 < pieces:
            out -= sums[np.maximum(k - starts[i + 1], 0), i]
    return out


def bends(bend: Array, starts: list[int]) -> Array:
    """Bow of the integral between nodes, shape (K, r): the rates at both ends of every set's lags."""
    K, pieces, r = bend.shape
    out = np.zeros((K, r))
    for i in range(pieces):
        for start in starts[i : i + 2]:
            out[start:] += bend[: max(K - start, 0), i]
    return out
