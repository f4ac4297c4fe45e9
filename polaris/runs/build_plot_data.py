"""Plot data of the results of Algorithms 1 and 2, with slices of the recoverable sets."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..model.system import Array
from ..simulation.baselines import FlightEnvelope, fly_nominal
from ..synthesis.safety.get_safety import Safety
from ..synthesis.schedule.schedule import Schedule
from .files.arrays import tube_arrays, tube_pictures
from .plot_data import PlotData, SliceData, directions

SLICES = 240  # decisions, and besides them switches, up to which all get a slice of their recoverable set


def safety_plot_data(safety: Safety, title: str = "Safe reference", **found: Any) -> PlotData:
    """Return plot data of Algorithm 1, results `found` by Algorithm 2, and slices of the recoverable sets."""
    problem = safety.problem
    scene = (problem.system, tuple(problem.unsafe), problem.goal, problem.initial_set)
    picture = PlotData(title, *scene, safety.reference, problem.K, **found)
    return replace(picture, slices=recoverable_slices(safety, picture))


def schedule_plot_data(schedule: Schedule, flights: Mapping[str, FlightEnvelope] | None = None) -> PlotData:
    """Return the plot data of a schedule as flown, by default once without disturbance."""
    if flights is None:
        flights = {"polaris": fly_nominal(schedule, None, "polaris")}
        if len(schedule.controllers) > 1:
            flights["experimental"] = fly_nominal(schedule, 1, schedule.controllers[1].name)
    arrival = schedule.arrival if schedule.guarantee == "proved" else None
    return safety_plot_data(
        schedule.safety,
        "Switching schedule",
        controllers=tuple(controller.name for controller in schedule.controllers),
        modes=schedule.modes,
        margins=schedule.margins,
        limits=tuple(step.margin.limit for step in schedule.steps),
        flights=flights,
        reached=arrival.by if arrival else None,
        delta_v_max=arrival.delta_v if arrival else None,
        **tube_pictures(tube_arrays(schedule), schedule.safety.problem.system.position),
    )


def _slice_nodes(picture: PlotData, q: int) -> NDArray[np.int_]:
    """Nodes that get slices: decisions, switches first, and where the path is closest to an unsafe set."""
    K, switches = picture.planned, np.flatnonzero(np.diff(picture.modes)) + 1
    parts = [np.arange(K), switches]
    steps = [part[np.linspace(0, len(part) - 1, min(SLICES, len(part))).astype(int)] for part in parts]
    instants = np.array([picture.approach(obstacle).time for obstacle in picture.obstacles]) * q
    nodes = np.round(instants / picture.reference.delta)
    closest = nodes[np.abs(instants - nodes * picture.reference.delta) <= 1e-6 * picture.reference.delta]
    return np.unique(np.concatenate([*(q * part for part in steps), closest]).astype(int))


def recoverable_slices(safety: Safety, picture: PlotData) -> SliceData:
    """Slice the recoverable sets through the states of all runs under Polaris, else through the reference.

    Sets are convex and asked only whether they contain points, along rays on ever finer scales.
    """
    system, q, K = picture.system, safety.tracking.feedback.nodes_per_cell, picture.planned
    nodes, reference = _slice_nodes(picture, q), picture.reference
    nodes = nodes[[np.isfinite(safety.recoverable.radius(int(k))) for k in nodes]]  # else all is recoverable
    fine = reference.fine(q)[:K, :-1].reshape(K * q, -1)
    centre = np.vstack([fine, reference.chi[K][None]])[nodes]
    flights = picture.flights.get("polaris")
    if flights is None:
        states = centre[:, None]
    else:
        states = np.swapaxes(flights.states[:, nodes * ((len(flights.times) - 1) // (K * q))], 0, 1)
    flat = picture.frame.flat
    lift = np.asarray(np.linalg.pinv(system.position)[:, flat].T, dtype=float)
    circle: Array = np.array([[1.0], [-1.0]]) if len(flat) == 1 else directions(24)
    errors = states - centre[:, None]
    slices = [_slice(safety, int(k), e, circle, lift) for k, e in zip(nodes, errors, strict=True)]
    places = states @ system.position.T
    outlines = np.array(slices) + places[:, :, None, flat]
    places[np.isnan(outlines).any(axis=(2, 3))] = np.nan
    selected = np.isin(nodes % q, 0) | ~np.isnan(places[:, 0, 0])
    return SliceData(nodes[selected] * reference.delta / q, places[selected], outlines[selected])


def _slice(safety: Safety, node: int, errors: Array, circle: Array, lift: Array) -> Array:
    """Outlines (R, M, e) about the positions of errors (R, n); nan where one is not recoverable."""
    outlines = np.full((len(errors), *circle.shape), np.nan)
    inside = np.flatnonzero(safety.recoverable.contains(node, errors))
    if not len(inside):
        return outlines
    errors = errors[inside]
    rays = np.broadcast_to(circle, (len(errors), *circle.shape))
    shift = np.zeros((len(errors), circle.shape[1]))
    if circle.shape[1] == 2:
        # Seen from near the boundary the far side has few rays: go to the middle of a first outline.
        coarse = rays[:, ::3]
        shift = (_reach(safety, node, errors, coarse @ lift, 2)[..., None] * coarse).mean(axis=1)
        # One ray goes through the place itself, so that the polygon contains it.
        back = -shift / np.maximum(np.linalg.norm(shift, axis=1, keepdims=True), 1e-300)
        back[~np.any(shift, axis=1)] = circle[0]
        turn = np.stack([back, back[:, ::-1] * [-1.0, 1.0]], axis=1)  # rows: first ray, and across it
        rays = circle @ turn
    floor = np.zeros(rays.shape[:2])
    floor[:, 0] = np.linalg.norm(shift, axis=1)
    size = _reach(safety, node, errors + shift @ lift, rays @ lift, 4, floor)
    outlines[inside] = shift[:, None] + size[..., None] * rays
    return outlines


def _reach(
    safety: Safety, node: int, errors: Array, rays: Array, times: int, floor: Array | float = 0.0
) -> Array:
    """Return a lower bound on how far errors (R, n) stay recoverable along rays (R, M, n), shape (R, M)."""
    W = safety.tracking.W
    norm = np.maximum(np.linalg.norm(errors @ W.T, axis=1), safety.recoverable.radius(node))
    scales = (norm[:, None] / np.linalg.norm(rays @ W.T, axis=2))[..., None] * np.geomspace(1e-3, 1e3, 16)
    low, high = np.zeros(rays.shape[:2]) + floor, scales[..., -1]
    for _ in range(times):
        scales, high = np.maximum(scales, low[..., None]), np.maximum(high, low)
        grid = np.concatenate([low[..., None], scales, high[..., None]], axis=2)
        count, last = np.zeros((*low.shape, 1), dtype=int), scales.shape[2]
        for step in 2 ** np.arange(last.bit_length())[::-1]:  # a convex set holds the first so many of them
            candidate = np.minimum(count + step, last)
            tried = errors[:, None] + np.take_along_axis(grid, candidate, axis=2) * rays
            inside = safety.recoverable.contains(node, tried.reshape(-1, errors.shape[1]))
            count = np.where(inside.reshape(count.shape), candidate, count)
        low, high = (np.take_along_axis(grid, count + i, axis=2)[..., 0] for i in (0, 1))
        scales = low[..., None] + (high - low)[..., None] * np.linspace(0, 1, 6)[1:-1]
    return low
