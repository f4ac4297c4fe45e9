"""Initial conditions of the Monte Carlo: Latin hypercube samples that satisfy every constraint."""

from __future__ import annotations

import numpy as np
from scipy.stats import qmc

from ..system import Array
from .allowable import allowable
from .families import Families


def initial_conditions(
    families: Families,
    count: int,
    seed: int = 0,
    position: float | None = None,
    speed: float | None = None,
    block: int = 4096,
) -> tuple[Array, Array, float]:
    """Draw states inside the safe set: those that violate a constraint are removed and drawn again.

    Parameters
    ----------
    families : Families
        ``h >= 0`` and ``phi >= 0`` are asked for all of them.
    count : int
    seed : int
    position, speed : float, optional
        Half-widths of the sampled cube [m], [m/s]; default r_max and v_max.
    block : int
        Samples per Latin hypercube.

    Returns
    -------
    x : ndarray, shape (count, N, 6)
    sun : ndarray, shape (count,)
        Angle of the sun at the start [rad].
    acceptance : float
        Share of the samples that satisfied everything.
    """
    q = families.inspection
    N = q.deputies
    wide = np.tile(
        [q.distance_max if position is None else position] * 3
        + [q.speed_max if speed is None else speed] * 3,
        N,
    )
    sampler = qmc.LatinHypercube(6 * N + 1, rng=np.random.default_rng(seed))
    states: list[Array] = []
    suns: list[Array] = []
    drawn = 0
    while sum(len(part) for part in states) < count:
        sample = sampler.random(block)
        x = (wide * (2 * sample[:, :-1] - 1)).reshape(block, N, 6)
        sun = 2 * np.pi * sample[:, -1]
        drawn += block
        for k in range(0, block, 128):
            part = slice(k, k + 128)
            good = (families(x[part], sun[part]).h >= 0).all(axis=1)
            for values in allowable(q, x[part], sun[part]).values():
                good &= (values >= 0).all(axis=1)  # h >= 0 also holds outside, on a fast way back
            states.append(x[part][good])
            suns.append(sun[part][good])
    found = np.concatenate(states)
    return found[:count], np.concatenate(suns)[:count], len(found) / drawn
