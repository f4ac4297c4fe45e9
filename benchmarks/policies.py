"""Small networks that imitate known laws, as ONNX files: what the tests and the documentation fly.

    python -m benchmarks.policies [FOLDER]

NumPy alone, seeds fixed. Trained with Adam and weight decay: a smooth imitation is what a tube stays narrow
around. Each reads the error, scaled to about 1, `yielding` the relative position of another body besides, and
its output 1 stands for full thrust.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import polaris
from polaris.model.system import Array, LinearSystem
from polaris.synthesis.tracker.lqr import lqr_gain

FOLDER = Path(__file__).resolve().parents[1] / "scenarios" / "policies"
TINY = Path(__file__).resolve().parents[1] / "tests" / "polaris" / "data" / "tiny.toml"
STEPS, BATCH, RATE, DECAY = 3000, 512, 3e-3, 1.0
SCALES = (0.1, 0.5, 1.0, 2.0)
PLACES = (0.2, 0.5, 1.0, 2.0)
"""Sizes of the errors, and of the relative positions, trained on, as shares of the scale."""


Law = Callable[[Array], Array]
"""Commands (R, m), as shares of the limits, for what is read (R, r)."""


def first_law(name: str | Path) -> tuple[LinearSystem, Array]:
    """System of a scenario and gain of its first law, an affine one with weights Q and R."""
    scenario = polaris.load_scenario(name)
    system, law = scenario.system(), scenario.model.experimental[0]
    return system, lqr_gain(system, law.Q, law.R)


def shortcut() -> tuple[LinearSystem, Array]:
    """Return the robot in the plane of the tour, and a law for it."""
    A, B = np.eye(4, k=2), np.eye(4)[:, 2:]
    system = LinearSystem(A, B, u_max=np.ones(2), D=B, w_max=0.02, C=np.eye(4)[:2])
    return system, lqr_gain(system, np.ones(4), np.ones(2))


def tracking(system: LinearSystem, gain: Array) -> tuple[Law, int]:
    """``clip(gain error)``, and its number of outputs."""
    return lambda inputs: np.clip(inputs @ gain.T / system.u_max, -1, 1), system.m


def yielding() -> tuple[Law, int]:
    """Return the first law of `dynamic`; while another body is near it aims higher, cross-track."""
    law, m = tracking(*first_law("dynamic"))

    def aside(inputs: Array) -> Array:
        error = inputs[:, :6].copy()
        error[:, 2] += 130.0 * np.exp(-np.sum(inputs[:, 6:] ** 2, axis=1) / (2 * 170.0**2))
        return law(error)

    return aside, m


ASKED: dict[str, tuple[Callable[[], tuple[Law, int]], list[float], int]] = {
    "fuel_saver": (lambda: tracking(*first_law("static")), [60.0, 60.0, 60.0, 1.0, 1.0, 1.0], 32),
    "hasty": (lambda: tracking(*first_law(TINY)), [1.0, 1.0, 1.0, 1.0], 16),
    "shortcut": (lambda: tracking(*shortcut()), [1.0, 1.0, 1.0, 1.0], 64),
    "yielding": (yielding, [60.0, 60.0, 60.0, 1.0, 1.0, 1.0, 600.0, 600.0, 600.0], 32),
}
"""By name of the file: what is imitated, size of what is read, width of the layers."""


def train(law: Law, m: int, size: Array, width: int, decay: float = DECAY) -> list[Array]:
    """Weights and biases of two tanh layers and a linear one that imitate a law of errors, and of a place."""
    rng, errors = np.random.default_rng(0), min(len(size), 6)
    dims = [len(size), width, width, m]
    W = [rng.normal(size=(b, a)) / np.sqrt(a) for a, b in zip(dims, dims[1:], strict=False)]
    P = [*W, *(np.zeros(d) for d in dims[1:])]
    first, second = [0 * p for p in P], [0 * p for p in P]
    for step in range(STEPS):
        z = rng.uniform(-1, 1, (BATCH, len(size)))
        z[:, :errors] *= rng.choice(SCALES, (BATCH, 1))
        if len(size) > errors:
            z[:, errors:] *= rng.choice(PLACES, (BATCH, 1))
        target = law(z * size)
        a = np.tanh(z @ P[0].T + P[3])
        b = np.tanh(a @ P[1].T + P[4])
        residual = (b @ P[2].T + P[5] - target) / BATCH
        back = residual @ P[2] * (1 - b * b)
        front = back @ P[1] * (1 - a * a)
        slopes = [front.T @ z, back.T @ a, residual.T @ b, front.sum(0), back.sum(0), residual.sum(0)]
        rate = RATE * 0.5 * (1 + np.cos(np.pi * step / STEPS))
        for i, slope in enumerate(slopes):
            first[i] = 0.9 * first[i] + 0.1 * slope
            second[i] = 0.999 * second[i] + 0.001 * slope**2
            update = first[i] / (1 - 0.9 ** (step + 1))
            update = update / (np.sqrt(second[i] / (1 - 0.999 ** (step + 1))) + 1e-8)
            P[i] = P[i] - rate * (update + (decay * P[i] if i < 3 else 0))
    return P


def write_onnx(path: Path, weights: list[Array]) -> None:
    """Write two tanh layers and a linear one, in single precision."""
    from onnx import TensorProto, checker, helper, numpy_helper, save_model

    names = ["W0", "W1", "W2", "b0", "b1", "b2"]
    stored = [numpy_helper.from_array(w.astype(np.float32), n) for w, n in zip(weights, names, strict=True)]
    nodes, at = [], "x"
    for i in range(3):
        nodes.append(helper.make_node("Gemm", [at, f"W{i}", f"b{i}"], [f"y{i}"], transB=1))
        if i < 2:
            nodes.append(helper.make_node("Tanh", [f"y{i}"], [f"a{i}"]))
        at = f"a{i}"
    ends: list[Any] = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, [1, width])
        for name, width in (("x", weights[0].shape[1]), ("y2", weights[2].shape[0]))
    ]
    graph = helper.make_graph(nodes, path.stem, ends[:1], ends[1:], stored)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)
    checker.check_model(model)
    save_model(model, path)


def main(folder: Path = FOLDER) -> None:
    """Train and write all policies."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, (imitated, size, width) in ASKED.items():
        decay = 1.5 if name == "yielding" else DECAY
        write_onnx(folder / f"{name}.onnx", train(*imitated(), np.array(size), width, decay))
        print(name, (folder / f"{name}.onnx").stat().st_size, "bytes")


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:2]))
