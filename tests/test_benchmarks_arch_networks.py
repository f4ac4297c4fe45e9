"""The benchmarks under neural networks, on networks made here: those of others are not in the project."""

import numpy as np
import pytest
from scipy.io import savemat

from benchmarks.arch import networks
from reach.sets.zonotope import Zonotope

pytest.importorskip("onnx")


def saved(path, gain, offset=0.0):
    """A network of tanh layers close to an affine function."""
    from benchmarks.policies import write_onnx

    gain, small = np.atleast_2d(gain), 1e-3
    n, m = gain.shape[1], len(gain)
    weights = [small * np.eye(n), np.eye(n), gain / small, np.zeros(n), np.zeros(n), np.full(m, offset)]
    write_onnx(path, [np.asarray(w, dtype=float) for w in weights])
    return path


def test_halving_ends_with_parts_that_cover_the_box():
    proved = []

    def proves(z: Zonotope) -> bool:
        small = bool(np.all(z.half_widths <= [0.26, 1.1]))
        proved.extend([z] if small else [])
        return small

    done, parts, tried = networks.halved(proves, np.zeros(2), np.array([2.0, 2.0]), np.ones(2))
    assert done and parts == len(proved) and tried == 2 * parts - 1
    assert sum(4 * np.prod(z.half_widths) for z in proved) == pytest.approx(4.0)


@pytest.mark.parametrize(("push", "verdict"), [(-1.0, "proven"), (15.0, "violated")])
def test_cruise_control(tmp_path, push, verdict):
    row = networks.acc(saved(tmp_path / "net.onnx", 1e-3 * np.ones(5), push))
    assert row.verdict == verdict
    assert row.bound <= row.reached + 1e-9


def test_docking(tmp_path):
    gain = np.hstack([np.zeros((2, 2)), -0.5 * np.eye(2)])
    row = networks.docking(saved(tmp_path / "net.onnx", gain), 0.05, "")
    assert row.verdict == "proven" and row.reached <= row.bound <= 0.2
    row = networks.docking(saved(tmp_path / "net.onnx", -4 * gain), 0.05, "")
    assert row.verdict == "violated" and row.reached > 0.2


def test_double_integrator(tmp_path):
    rng, stored = np.random.default_rng(0), np.empty((1, 2), dtype=object)
    weights, biases = stored.copy(), stored.copy()
    weights[0, 0], biases[0, 0] = rng.normal(size=(6, 2)), rng.normal(size=(6, 1))
    weights[0, 1], biases[0, 1] = -0.1 * rng.random((1, 6)), np.zeros((1, 1))
    savemat(tmp_path / "net.mat", {"weights": weights, "biases": biases})
    whole, parts = (networks.double_integrator(tmp_path / "net.mat", n) for n in (1, 3))
    assert whole.verdict == parts.verdict == "proven"
    assert 0 <= parts.bound <= whole.bound
