"""Measures of runs: distance, time to collision, share of time per mode, switches.

Everything is vectorised over runs and times: arrays are shaped (..., T) with the time axis last
(before the axes of a vector), and per-obstacle results have the obstacle axis first.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ..errors import ScenarioError
from ..system import Array, LinearSystem
from .obstacle import Obstacle
from .state_limits import StateLimit

UNKNOWN = -1  # mode number of samples whose mode is not known

States = Mapping[str, ArrayLike]


def signed_distances(
    obstacles: Sequence[Obstacle],
    t: ArrayLike,
    p: ArrayLike,
    system: LinearSystem | None = None,
    states: States | None = None,
) -> Array:
    """Distance (O, ...) [m] of positions p (..., d) at times t (...) to true unsafe sets, negative inside.

    Keep-in sets count as the distance to leaving them. A system is needed if another satellite is among the
    obstacles; `states` are true states (..., n) of these by name, by default their nominal ones. Limits on
    the whole state need states (..., n) of the system for p, and count as their slack.
    """
    out = np.empty((len(obstacles), *np.broadcast_shapes(np.shape(t), np.shape(p)[:-1])))
    of_state = system is not None and system.n != system.d and np.shape(p)[-1] == system.n
    place = np.asarray(p) @ system.position.T if of_state and system is not None else p
    for o, obstacle in enumerate(obstacles):
        at = p if isinstance(obstacle, StateLimit) else place
        out[o] = obstacle.signed_distance(t, at, system, (states or {}).get(obstacle.name))
    return out


def ray_ttc(
    obstacles: Sequence[Obstacle],
    t: ArrayLike,
    p: ArrayLike,
    v: ArrayLike,
    system: LinearSystem | None = None,
    states: States | None = None,
) -> Array:
    """Seconds (O, ...) until straight rays enter each obstacle, both keeping their velocity of time t.

    Velocities v of the chaser are (..., d) [m/s], all else is as in `signed_distances`. 0 if inside, inf if
    never. An obstacle counts while it holds (`Obstacle.span`): at the instant of the entry.
    """
    shape = np.broadcast_shapes(np.shape(t), np.shape(p)[:-1], np.shape(v)[:-1])
    out = np.empty((len(obstacles), *shape))
    for o, obstacle in enumerate(obstacles):
        out[o] = obstacle.entry_time(t, p, v, system, (states or {}).get(obstacle.name))
    return out


@dataclass(frozen=True, eq=False)
class SampledApproach:
    """Closest approach of every run, at the sampled times; shapes (...,)."""

    distance: Array  # smallest signed distance [m]; inf where there is no obstacle
    time: Array  # when it was reached first [s]; nan where there is no obstacle
    obstacle: np.ndarray[tuple[int, ...], np.dtype[np.int64]]  # its index; -1 if there is none


def closest(distances: ArrayLike, t: ArrayLike) -> SampledApproach:
    """Minimum over obstacles and time of `signed_distances` (O, ..., T) at times (T,) or (..., T) [s].

    Between samples a run may come closer by at most half of what it travels relative to the obstacle from one
    sample to the next.
    """
    values = np.asarray(distances, dtype=float)
    if values.ndim < 2 or values.shape[-1] == 0:
        rule = "must be (obstacles, ..., times), with at least one time"
        raise ScenarioError("distances", values.shape, rule)
    runs, times = values.shape[1:-1], np.broadcast_to(np.asarray(t, dtype=float), values.shape[1:])
    if len(values) == 0:
        return SampledApproach(np.full(runs, np.inf), np.full(runs, np.nan), np.full(runs, -1))
    nearest = values.min(axis=0)
    node = np.argmin(nearest, axis=-1)[..., None]
    which = np.take_along_axis(np.argmin(values, axis=0), node, axis=-1)[..., 0]
    distance = np.take_along_axis(nearest, node, axis=-1)[..., 0]
    return SampledApproach(distance, np.take_along_axis(times, node, axis=-1)[..., 0], which.astype(np.int64))


def _durations(t: ArrayLike, count: int) -> Array:
    """Return the time for which each of `count` samples holds [s], shape (..., count).

    Given one time more than samples, the last is the end; given as many, the last sample holds
    for no time.
    """
    times = np.asarray(t, dtype=float)
    if times.ndim == 0 or times.shape[-1] not in (count, count + 1):
        raise ScenarioError("t", times.shape, f"must hold {count} times (or {count + 1}, the end included)")
    if not np.all(np.isfinite(times)):
        raise ScenarioError("t", "nan or inf", "must be finite numbers [s]")
    lengths = np.diff(times, axis=-1)
    if np.any(lengths < 0):
        raise ScenarioError("t", float(lengths.min()), "must not run backwards")
    if times.shape[-1] == count:
        lengths = np.concatenate([lengths, np.zeros((*lengths.shape[:-1], 1))], axis=-1)
    return np.asarray(lengths)


def _modes(modes: ArrayLike) -> np.ndarray[tuple[int, ...], np.dtype[np.int64]]:
    array = np.asarray(modes)
    if array.ndim == 0 or array.shape[-1] == 0 or not np.issubdtype(array.dtype, np.integer):
        raise ScenarioError("modes", modes, "must be whole numbers, at least one per run")
    return array.astype(np.int64)


def mode_shares(t: ArrayLike, modes: ArrayLike) -> dict[int, Array]:
    """Share of the time in each mode that occurs (0 is S, 1 is U, `UNKNOWN` stays its own), each (...,).

    Modes (..., K) begin at t (..., K), or (..., K+1) with the end of the run [s]. Shares add up to 1; a run
    of no length counts its samples.
    """
    values = _modes(modes)
    lengths = _durations(t, values.shape[-1])
    values, lengths = np.broadcast_arrays(values, lengths)
    total = lengths.sum(axis=-1, keepdims=True)
    lengths = np.where(total > 0, lengths, 1.0)
    lengths = lengths / lengths.sum(axis=-1, keepdims=True)
    return {int(mode): np.where(values == mode, lengths, 0.0).sum(axis=-1) for mode in np.unique(values)}


def stretches(flags: ArrayLike) -> list[tuple[int, int]]:
    """First and one-past-last index of every stretch of True."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], np.asarray(flags, dtype=int), [0]])))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


def count_switches(
    modes: ArrayLike, t: ArrayLike | None = None
) -> np.ndarray[tuple[int, ...], np.dtype[np.int64]]:
    """Count changes of mode inside the run, shape (...,).

    The mode a run starts in is no switch. Samples of `UNKNOWN` mode are passed over: known modes on
    either side count once if they differ. With times given (as in `mode_shares`), so are samples
    that hold for no time, the last excepted.
    """
    values = _modes(modes)
    skipped = values == UNKNOWN
    if t is not None:
        lengths = np.broadcast_to(_durations(t, values.shape[-1]), values.shape).copy()
        lengths[..., -1] = 1.0
        skipped = skipped | (lengths == 0)
    # carry the last known mode forward, the first known one backward
    index = np.where(skipped, -1, np.arange(values.shape[-1]))
    index = np.maximum.accumulate(index, axis=-1)
    first = np.argmax(~skipped, axis=-1)[..., None]
    carried = np.take_along_axis(values, np.maximum(index, first), axis=-1)
    return np.asarray((np.diff(carried, axis=-1) != 0).sum(axis=-1), dtype=np.int64)
