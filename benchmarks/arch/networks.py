"""Plants that are linear, or nearly so, under neural networks: cruise control, docking, double integrator.

Plants, networks and specifications of the ARCH-COMP category on neural network control systems (its public
repository `verivital/ARCH-COMP2023` has no licence: the networks are not copied here), and the double
integrator of Hu, Fazlyab, Morari and Pappas, "Reach-SDP" (CDC 2020; `mahyarfazlyab/ReachSDP`, MIT). `--data`
names a folder with `controller_5_20.onnx` (of ACC), `model.onnx` (of the docking) and `nnmpc_nets_di_1.mat`;
what is not there is left out.

Every instance is also flown from its corners and at random, exactly or by a fine Runge-Kutta scheme; a flight
that breaks the specification is the verdict "violated". Initial sets are halved until every part is proven.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import product
from pathlib import Path
from time import perf_counter

import numpy as np

from benchmarks.arch.row import Row, Verdict
from reach import Affine, Network, NetworkLoop, Zonotope, read_onnx
from reach.networks.layers import Activation
from reach.numerics.linear import discretize

Array = np.ndarray
PARTS = 3000
"""Most parts of an initial set."""
ORDER = 30.0
"""Generators per dimension of the docking's sets."""
FLIGHTS = 4000


def halved(
    proves: Callable[[Zonotope], bool], low: Array, high: Array, scale: Array
) -> tuple[bool, int, int]:
    """Prove every part of a box, halving those that fail across their longest side.

    Returned are whether all are proven, how many parts there are, and how many attempts it took.
    """
    waiting, proven, tried = [((low + high) / 2, (high - low) / 2)], 0, 0
    while waiting and tried < PARTS:
        c, h = waiting.pop()
        tried += 1
        if proves(Zonotope.box(c, h)):
            proven += 1
            continue
        shift = np.where(np.arange(len(h)) == np.argmax(h / scale), h / 2, 0.0)
        waiting += [(c - shift, h - shift), (c + shift, h - shift)]
    return not waiting, proven, tried


def starts(low: Array, high: Array) -> Array:
    """All corners, and states at random."""
    corners = np.array(list(product(*zip(low, high, strict=True))))
    return np.vstack(
        [np.unique(corners, axis=0), np.random.default_rng(0).uniform(low, high, (FLIGHTS, len(low)))]
    )


# -- adaptive cruise control --------------------------------------------------------------------------

FRICTION, LEAD, GAP, SET, PERIOD = 1e-4, -2.0, 1.4, 30.0, 0.1
SPEEDS = (22.0, 33.0), (20.0, 31.0)
"""Speeds of both cars [m/s] about whose middles the friction is linear; checked afterwards."""
SEEN = np.zeros((5, 7))
SEEN[[0, 1, 2, 3, 3, 4, 4], [6, 6, 4, 0, 3, 1, 4]] = SET, GAP, 1, 1, -1, 1, -1
ROOM = np.array([[1.0, 0, 0, -1, -GAP, 0, 0]])


def cruise(network: Network) -> NetworkLoop:
    """Build the loop of both cars, and a 1 for constants: ``v^2`` is its tangent, the rest disturbs."""
    A, D = np.zeros((7, 7)), np.zeros((7, 2))
    A[[0, 1, 3, 4], [1, 2, 4, 5]] = 1.0
    A[[2, 5], [2, 5]] = -2.0
    for place, (i, (slow, fast)) in enumerate(zip((2, 5), SPEEDS, strict=True)):
        middle, half = (slow + fast) / 2, (fast - slow) / 2
        A[i, i - 1], A[i, 6] = -2 * FRICTION * middle, FRICTION * (middle**2 - half**2 / 2)
        D[i, place] = FRICTION * half**2 / 2  # (v - middle)^2 lies between 0 and half^2
    A[2, 6] += 2 * LEAD
    B = np.zeros((7, 1))
    B[5] = 2.0
    return NetworkLoop(A, B, D, np.sqrt(2.0), PERIOD, network, SEEN)


def acc(file: Path) -> Row:
    """Distance less 1.4 s of speed stays above 10 m for 5 s while the car in front brakes."""
    network = read_onnx(file)
    low, high = np.array([90, 32, 0, 10, 30, 0, 1.0]), np.array([110, 32.2, 0, 11, 30.2, 0, 1.0])
    x, least = starts(low, high), np.inf

    def rate(x: Array, u: Array) -> Array:
        lead, ego = 2 * LEAD - FRICTION * x[:, 1] ** 2, 2 * u - FRICTION * x[:, 4] ** 2
        parts = (x[:, 1], x[:, 2], lead - 2 * x[:, 2], x[:, 4], x[:, 5], ego - 2 * x[:, 5], 0 * x[:, 6])
        return np.stack(parts, axis=1)

    for _ in range(50):
        u, h = network(x @ SEEN.T)[:, 0], PERIOD / 10
        for _ in range(10):
            first = rate(x, u)
            second = rate(x + h / 2 * first, u)
            third = rate(x + h / 2 * second, u)
            x = x + h / 6 * (first + 2 * second + 2 * third + rate(x + h * third, u))
            least = min(least, float((x @ ROOM.T).min()))
    start = perf_counter()
    tube = cruise(network).tube(Zonotope.box((low + high) / 2, (high - low) / 2), 50)
    bound = -float(tube.support(-ROOM).max())
    axes = np.eye(7)[[1, 4]]
    extremes = tube.support(np.vstack([axes, -axes])).max(axis=0)
    within = all(-extremes[i + 2] >= slow and extremes[i] <= fast for i, (slow, fast) in enumerate(SPEEDS))
    proven: Verdict = "proven" if within and bound >= 10 else "unknown"
    verdict: Verdict = "violated" if least < 10 else proven
    note = "room [m], to stay above; published: verified (JuliaReach)"
    return Row("ACC", "ReLU 5x20", verdict, "proven", bound, 10.0, least, perf_counter() - start, note)


# -- docking ------------------------------------------------------------------------------------------

MEAN, MASS = 0.001027, 12.0
ANGLES = np.arange(64) * np.pi / 32
FASTEST = np.stack([np.cos(ANGLES), np.sin(ANGLES)], axis=1) / np.cos(np.pi / 64)


def docking(file: Path, speed: float, note: str) -> Row:
    """Speed stays below 0.2 m/s and 2 n times the distance, for 40 s; positions from 70 to 106 m."""
    A = np.zeros((4, 4))
    A[[0, 1], [2, 3]] = 1.0
    A[2, 0], A[2, 3], A[3, 2] = 3 * MEAN**2, 2 * MEAN, -2 * MEAN
    B, network = np.vstack([np.zeros((2, 2)), np.eye(2) / MASS]), read_onnx(file)
    loop = NetworkLoop(A, B, np.zeros((4, 1)), 0.0, 1.0, network, np.eye(4))
    low, high = np.array([70, 70, -speed, -speed]), np.array([106, 106, speed, speed])

    def excess(x: Array) -> float:
        return float((np.linalg.norm(x[:, 2:], axis=1) - 2 * MEAN * np.linalg.norm(x[:, :2], axis=1)).max())

    x, (Ad, Bd) = starts(low, high), discretize(A, B, 0.1)
    reached = excess(x)
    for _ in range(40):
        u = network(x)
        for _ in range(10):
            x = x @ Ad.T + u @ Bd.T
            reached = max(reached, excess(x))
    bounds = []

    def proves(node: Zonotope) -> bool:
        largest = -np.inf
        for _ in range(40):
            next_set, intersample, _ = loop.step(node)
            towards = (node.c + next_set.c)[:2]
            position_rows = np.tile(-2 * MEAN * towards / np.linalg.norm(towards), (len(FASTEST), 1))
            rows = np.hstack([position_rows, FASTEST])  # at least 2 n |p|, at most |v|: one row for both
            levels = np.maximum(node.support(rows), next_set.support(rows)) + np.abs(rows) @ intersample
            largest = max(largest, float(levels.max()))
            if largest > 0.2:
                return False
            node = next_set if next_set.order_count <= ORDER * 4 else next_set.reduce(ORDER / 3)
        bounds.append(largest)
        return True

    start = perf_counter()
    scale = np.array([100, 100, 0.5, 0.5])
    complete, parts, tried = (False, 0, 0) if reached > 0.2 else halved(proves, low, high, scale)
    proven: Verdict = "proven" if complete else "unknown"
    verdict: Verdict = "violated" if reached > 0.2 else proven
    text = f"excess speed [m/s], {parts} parts of {tried} tried; {note}"
    bound, seconds = (max(bounds) if complete else None), perf_counter() - start
    return Row("docking", f"+-{speed} m/s", verdict, "proven", bound, 0.2, reached, seconds, text)


# -- double integrator ---------------------------------------------------------------------------------


def double_integrator(file: Path, parts: int) -> Row:
    """Box of the states after 5 steps, and by how much its area exceeds that of a fine grid of flights."""
    from scipy.io import loadmat

    stored = loadmat(file)
    layers: list[Affine | Activation] = []
    for W, b in zip(stored["weights"].ravel(), stored["biases"].ravel(), strict=True):
        layers += [Affine(W, b.ravel()), Activation("relu")]
    network = Network((*layers[:-1], Activation("clip", -1.0, 1.0)))
    A, B = np.eye(2, k=1), np.array([[0.0], [1.0]])
    loop = NetworkLoop(A, B, np.zeros((2, 1)), 0.0, 1.0, network, np.eye(2))
    low, high, (Ad, Bd) = np.array([2.5, -0.25]), np.array([3.0, 0.25]), discretize(A, B, 1.0)
    grid = np.linspace(0.0, 1.0, 400)
    x = low + (high - low) * np.array(list(product(grid, grid)))
    for _ in range(5):
        x = x @ Ad.T + network(x) @ Bd.T
    start, half, final_sets = perf_counter(), (high - low) / (2 * parts), []
    for place in product(range(parts), repeat=2):
        final_sets.append(loop.tube(Zonotope.box(low + half * (2 * np.array(place) + 1), half), 5).nodes[5])
    seconds = perf_counter() - start
    below = np.min([z.c - z.half_widths for z in final_sets], axis=0)
    above = np.max([z.c + z.half_widths for z in final_sets], axis=0)
    holds = bool(np.all(below <= x.min(axis=0)) and np.all(x.max(axis=0) <= above))
    error = float(np.prod(above - below) / np.prod(np.ptp(x, axis=0)) - 1)
    note = "error of the last box; published of another such network: 206 and 848, in parts 19 and 20"
    verdict: Verdict = "proven" if holds else "violated"
    return Row(
        "double integrator", f"{parts} x {parts} parts", verdict, "proven", error, None, 0.0, seconds, note
    )


def rows(data: Path | None) -> Iterator[Row]:
    """Yield the rows that the files in a folder allow."""
    if data is None:
        return
    if (data / "controller_5_20.onnx").is_file():
        yield acc(data / "controller_5_20.onnx")
    if (data / "nnmpc_nets_di_1.mat").is_file():
        yield from (double_integrator(data / "nnmpc_nets_di_1.mat", parts) for parts in (1, 2, 4))
    if (data / "model.onnx").is_file():
        yield docking(data / "model.onnx", 0.14, "published: verified (JuliaReach, this smaller set)")
        yield docking(data / "model.onnx", 0.28, "the set as proposed")
