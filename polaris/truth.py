"""Where other satellites really are, in runs that judge what is known of them only in part."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from reach.linear import discretize, powers

from .obstacles import Obstacle, SatelliteObstacle
from .system import Array, LinearSystem


def true_states(
    obstacles: Sequence[Obstacle], system: LinearSystem, times: Array, runs: int, rng: np.random.Generator
) -> dict[str, Array]:
    """States of other satellites that what is known of them allows, by name, shape (R, N+1, n).

    Half of the runs start them in corners of the known box and give them their largest
    acceleration; it is constant in each run.
    """
    out: dict[str, Array] = {}
    h = float(times[1] - times[0])
    for satellite in (o for o in obstacles if isinstance(o, SatelliteObstacle)):
        spread = rng.uniform(-1.0, 1.0, (runs, system.n))
        spread[: runs - runs // 2] = np.where(spread[: runs - runs // 2] < 0, -1.0, 1.0)
        x0 = np.asarray(satellite.state) + spread * np.asarray(satellite.state_half_widths)
        push = rng.normal(size=(runs, system.p))
        push /= np.linalg.norm(push, axis=1, keepdims=True)
        push[runs - runs // 2 :] *= rng.random((runs // 2, 1))
        push *= satellite.thrust_accel_max + system.w_max
        Ad, Dd = discretize(system.A, system.D, h)
        free = powers(Ad, len(times) - 1)
        forced = np.concatenate([np.zeros((1, *Dd.shape)), np.cumsum(free[:-1] @ Dd, axis=0)])
        out[satellite.name] = np.einsum("tij,rj->rti", free, x0) + np.einsum("tij,rj->rti", forced, push)
    return out
