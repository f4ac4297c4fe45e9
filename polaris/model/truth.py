"""Where other satellites really are, in runs that judge what is known of them only in part."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from reach.numerics.linear import discretize, powers

from .obstacles import Obstacle, SatelliteObstacle
from .system import Array, LinearSystem


def true_states(
    obstacles: Sequence[Obstacle], system: LinearSystem, times: Array, runs: int, rng: np.random.Generator
) -> dict[str, Array]:
    """States of other satellites that what is known of them allows, by name, shape (R, N+1, n).

    Half of the runs start them in corners of the known box and give them their largest
    acceleration; it is constant in each run, and so is a disturbance that pushes them the same way.
    """
    out: dict[str, Array] = {}
    h = float(times[1] - times[0])
    for satellite in (o for o in obstacles if isinstance(o, SatelliteObstacle)):
        spread = rng.uniform(-1.0, 1.0, (runs, system.n))
        spread[: runs - runs // 2] = np.where(spread[: runs - runs // 2] < 0, -1.0, 1.0)
        x0 = np.asarray(satellite.state) + spread * np.asarray(satellite.state_half_widths)
        way = rng.normal(size=(runs, system.d))
        share = np.ones((runs, 1))
        share[runs - runs // 2 :] = rng.random((runs // 2, 1))
        free = powers(discretize(system.A, system.D, h)[0], len(times) - 1)
        states = np.einsum("tij,rj->rti", free, x0)
        for M, bound in satellite.pushes(system):
            # What accelerates the position in that direction; any input, if none accelerates it at once.
            push = way @ system.velocity @ M
            idle = np.linalg.norm(push, axis=1) == 0
            push[idle] = rng.normal(size=(int(idle.sum()), push.shape[1]))
            push *= bound * share / np.linalg.norm(push, axis=1, keepdims=True)
            held = discretize(system.A, M, h)[1]
            forced = np.concatenate([np.zeros((1, *held.shape)), np.cumsum(free[:-1] @ held, axis=0)])
            states = states + np.einsum("tij,rj->rti", forced, push)
        out[satellite.name] = states
    return out
