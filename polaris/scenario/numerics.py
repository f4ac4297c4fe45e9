"""Rules of a scenario that need arithmetic: stabilisability, definite weights, a suitable step."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ..model.errors import ScenarioError
from ..model.system import Array, LinearSystem
from . import scene_tables as scene
from . import tables as models


def full_weight(weight: ArrayLike) -> Array:
    """Weight matrix from its diagonal or from itself, made exactly symmetric."""
    matrix = np.asarray(weight, dtype=float)
    if matrix.ndim == 1:
        return np.diag(matrix)
    return np.asarray((matrix + matrix.T) / 2)


def check_numerics(model: models.ScenarioModel, system: LinearSystem) -> None:
    """The step suits the dynamics, and the inputs can stabilise them."""
    modes, delta = np.linalg.eigvals(system.A), model.horizon.step_s
    fastest, growth = float(np.max(np.abs(modes))), float(np.max(modes.real))
    if fastest * delta > 1e3 or growth * delta > 20:
        rule = f"is too long for the system's fastest mode ({fastest:.3g} rad/s); at most {20 / fastest:.3g}"
        raise ScenarioError("horizon.step_s", delta, rule)
    stuck = _missed_mode(system.A, system.B)
    if stuck is not None:
        field = "system.B" if model.system.kind == "linear" else "system"
        rule = (
            f"must reach all modes that do not decay by themselves (not stabilisable: eigenvalue {stuck:.4g})"
        )
        raise ScenarioError(field, system.B.tolist(), rule)


def _missed_mode(A: np.ndarray, B: np.ndarray) -> complex | None:
    """An eigenvalue with real part >= 0 that B does not reach (Popov-Belevitch-Hautus), or None."""
    A_scale = max(float(np.abs(A).max()), np.finfo(float).tiny)
    reach = B / np.maximum(np.linalg.norm(B, axis=0), np.finfo(float).tiny)
    for mode in np.linalg.eigvals(A):
        if mode.real < -1e-7 * A_scale:
            continue
        test = np.hstack([(A - mode * np.eye(len(A))) / A_scale, reach])
        if np.linalg.svd(test, compute_uv=False)[-1] < 1e-7:
            return complex(mode)
    return None


def weights(model: models.ScenarioModel) -> Iterator[tuple[str, Any, Any]]:
    """Every pair of LQR weights with its path in the file; a controller has these or a gain."""
    yield "tracking", model.tracking.Q, model.tracking.R
    for path, spec in model.controllers():
        if not isinstance(spec, scene.Affine):
            continue
        if spec.gain is None and (
            missing := next((name for name in "QR" if getattr(spec, name) is None), "")
        ):
            raise ScenarioError(f"{path}.{missing}", None, "is required (Q and R, or gain)")
        if spec.gain is None:
            yield path, spec.Q, spec.R
        elif spec.Q is not None or spec.R is not None:
            raise ScenarioError(f"{path}.gain", spec.gain, "give gain or Q and R, not both")


def check_weights(path: str, Q: Any, R: Any, system: LinearSystem) -> None:
    """Q semidefinite, R definite, and their Riccati equation has a stabilising solution."""
    from scipy.linalg import LinAlgError, solve_continuous_are

    for name, value, size in (("Q", Q, system.n), ("R", R, system.m)):
        field, matrix = f"{path}.{name}", np.asarray(value, dtype=float)
        if matrix.shape not in ((size,), (size, size)):
            given = " x ".join(str(s) for s in matrix.shape) + " numbers"
            rule = f"must have {size} numbers (the diagonal) or be {size} x {size}"
            raise ScenarioError(field, given, rule)
        scale = float(np.abs(matrix).max())
        if matrix.ndim == 2 and np.abs(matrix - matrix.T).max() > 1e-9 * scale:
            raise ScenarioError(field, matrix.tolist(), "must be symmetric")
        least = float(np.linalg.eigvalsh(full_weight(matrix)).min())
        if name == "R" and not least > 1e-12 * scale:
            rule = f"must be positive definite (least eigenvalue {least:.3g})"
            raise ScenarioError(field, matrix.tolist(), rule)
        if name == "Q" and not least >= -1e-12 * scale:
            rule = f"must be positive semidefinite (least eigenvalue {least:.3g})"
            raise ScenarioError(field, matrix.tolist(), rule)
    Qm, Rm = full_weight(Q), full_weight(R)
    unseen = _missed_mode(system.A.T, Qm)
    if unseen is not None:
        rule = f"must weigh every mode that does not decay by itself (eigenvalue {unseen:.4g} is not)"
        raise ScenarioError(f"{path}.Q", np.asarray(Q).tolist(), rule)
    try:
        P = solve_continuous_are(system.A, system.B, Qm, Rm)
        loop = system.A - system.B @ np.linalg.solve(Rm, system.B.T @ P)
        stable = bool(np.linalg.eigvals(loop).real.max() < 0)
    except (LinAlgError, ValueError):
        stable = False
    if not stable:
        rule = "must, with R, give a solvable Riccati equation; the weights are too far apart to compute with"
        raise ScenarioError(f"{path}.Q", np.asarray(Q).tolist(), rule)
