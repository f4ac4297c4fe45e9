"""Start sets in Hill's frame from the ephemerides of two craft."""

import numpy as np

from ...model.errors import ScenarioError
from ...model.system import Array
from .inertial import hill_axes, to_hill
from .oem import Ephemeris, epoch_text

LOCAL = ("RTN", "RSW", "UVW", "RIC")
"""Frames of covariances: radial, along-track and normal to the orbit of the craft itself."""
ROUND_OFF = 1e-6  # share by which spans are widened


def start_set(
    target: Ephemeris, chaser: Ephemeris, epoch: int, sigma: float, rotating: bool
) -> tuple[Array, Array, str]:
    """Return centre (6,), generators (6, 6) [m, m/s], and the assumption that the set rests on.

    The zonotope contains all errors whose Mahalanobis distance is at most `sigma`. Covariances of both craft
    are carried into Hill's frame by the derivatives of the relative state, which counts how the target's
    error turns the frame, and are added.

    Parameters
    ----------
    target, chaser : Ephemeris
    epoch : int [ns]
    sigma : float
    rotating : bool
        Whether velocities of covariances in local frames are those of an observer who turns with the frame.

    Raises
    ------
    ScenarioError
        If the files differ in frame or time system, do not cover the epoch, or have no covariance for it.
    """
    for name in ("frame", "time_system"):
        if getattr(target, name) != getattr(chaser, name):
            mismatch = f"{getattr(chaser, name)}, but {getattr(target, name)} in the target's"
            rule = "must be the same in both ephemerides"
            raise ScenarioError(
                "initial_set.ephemeris", mismatch, f"has another {name}: it {rule}", chaser.source
            )
    target_state, chaser_state = target.states_at([epoch])[0], chaser.states_at([epoch])[0]
    covariance = _inertial(chaser, epoch, chaser_state, rotating)
    if covariance is None:
        dates = ", ".join(epoch_text(one) for one in sorted(chaser.covariances)[:3]) or "none"
        rule = f"must have a covariance at the time 0 of the scenario; it has {dates}: choose orbit.epoch"
        raise ScenarioError("initial_set.ephemeris", epoch_text(epoch), rule, chaser.source)
    carried = _derivative(target_state, chaser_state)
    spread = carried[:, 6:] @ covariance @ carried[:, 6:].T
    target_covariance = _inertial(target, epoch, target_state, rotating)
    if target_covariance is not None:
        spread = spread + carried[:, :6] @ target_covariance @ carried[:, :6].T
    size = np.sqrt(np.diag(spread))
    scale = np.where(size > 0, size, 1.0)
    values, vectors = np.linalg.eigh(spread / np.outer(scale, scale))
    root = vectors * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
    spans = sigma * (1 + ROUND_OFF) * scale[:, None] * root
    kind = "velocities that turn with it" if rotating else "inertial velocities along its axes"
    sources = (
        "errors of both files independent"
        if target_covariance is not None
        else "the target's file has no covariance: exact"
    )
    assumption = (
        f"assumption: the start set covers {sigma:g} sigma of the covariance at {epoch_text(epoch)}"
        f" {target.time_system} ({sources}; a covariance in RTN is of {kind})"
    )
    return to_hill(target_state, chaser_state), spans, assumption


def _inertial(ephemeris: Ephemeris, epoch: int, state: Array, rotating: bool) -> Array | None:
    """Covariance (6, 6) at an epoch in inertial axes, if there is one."""
    frame, matrix = ephemeris.covariances.get(epoch, (None, None))
    if matrix is None or frame is None or frame == ephemeris.frame:
        return matrix
    if frame.upper() not in LOCAL:
        rule = f"must have covariances in {ephemeris.frame} or one of {', '.join(LOCAL)}"
        raise ScenarioError("ephemeris", frame, rule, ephemeris.source)
    axes, omega = hill_axes(state)
    turn = np.kron(np.eye(2), axes.T)
    if rotating:
        turn[3:, :3] = axes.T @ _cross(omega)
    return np.asarray(turn @ matrix @ turn.T)


def _cross(omega: Array) -> Array:
    """Matrix of the cross product with a vector."""
    x, y, z = omega
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def _derivative(target: Array, chaser: Array) -> Array:
    """Derivative (6, 12) of the state in Hill's frame by the inertial states of target and chaser."""
    steps = np.array([1.0, 1.0, 1.0, 1e-3, 1e-3, 1e-3])
    columns = []
    for k in range(12):
        push = np.zeros(12)
        push[k] = steps[k % 6]
        ahead, back = (to_hill(target + s * push[:6], chaser + s * push[6:]) for s in (1, -1))
        columns.append((ahead - back) / (2 * push[k]))
    return np.stack(columns, axis=1)
