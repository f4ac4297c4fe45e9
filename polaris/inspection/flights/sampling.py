"""Initial conditions of the Monte Carlo: Latin hypercube samples that satisfy every constraint."""

from __future__ import annotations

import numpy as np
from scipy.stats import qmc

from ...model.checks import whole
from ...model.errors import ScenarioError
from ...model.system import Array
from ..constraints.allowable_set import allowable
from ..constraints.families import Families

PATIENCE = 200_000
"""Samples after which a first one must have been accepted, and so on."""


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

    Raises
    ------
    ScenarioError
        If hardly any sample satisfies every constraint (less than one in `PATIENCE`).
    """
    whole("count", count, 1)
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
    drawn = accepted = 0
    while accepted < count:
        if drawn >= PATIENCE and accepted * PATIENCE < drawn:
            rule = (
                f"none or hardly any of {drawn} samples satisfied every constraint; fewer deputies, a slower"
            )
            raise ScenarioError("count", count, f"{rule} or smaller cube have room")
        sample = sampler.random(block)
        x = (wide * (2 * sample[:, :-1] - 1)).reshape(block, N, 6)
        sun = 2 * np.pi * sample[:, -1]
        drawn += block
        # What is quick to see first: h >= 0 alone would not do, it also holds outside, on a fast way back.
        phi = allowable(q, x, sun).values()
        inside = np.flatnonzero(np.all([(values >= 0).all(axis=1) for values in phi], axis=0))
        for part in (inside[k : k + 128] for k in range(0, len(inside), 128)):
            good = part[(families(x[part], sun[part]).h >= 0).all(axis=1)]
            states.append(x[good])
            suns.append(sun[good])
            accepted += len(good)
    found = np.concatenate(states)
    return found[:count], np.concatenate(suns)[:count], len(found) / drawn
