"""The motion that a known input signal causes: a trajectory, exact but for rounding."""

from dataclasses import dataclass
from itertools import groupby

import numpy as np

from ..numerics.checks import Array
from ..numerics.exponentials import bordered, times
from .rows import ExponentialRows
from .systems import LinearSystem, Signal

SNAP = 1e-14  # a knot as near to a node as this share of the horizon is the node
ENTRIES = 2_000_000  # entries of all states that are computed together


@dataclass(frozen=True, eq=False)
class KnownResponse:
    """The part of ``d x(t)`` that a known signal causes, for r rows d."""

    values: Array  # at the nodes, (K+1, r)
    intersample: Array  # path and chord between two nodes differ by at most 4 s (1 - s) intersample, (K, r)
    kinks: Array  # by how much its slope jumps at the nodes, (K+1, r)
    states: Array  # the trajectory itself, (K+1, n)


def known_response(system: LinearSystem, D: Array, nodes: Array, steps: Array) -> KnownResponse:
    """Follow ``y' = A y + B u_0(t)``, ``y(0) = 0``, over nodes whose distances are `steps`.

    Where the signal jumps by J in the slope between nodes, the line is left by J times a quarter of the step.
    """
    K, r, signal = len(steps), len(D), system.nominal
    assert signal is not None
    if system.discrete:
        force, y = times(signal(nodes), system.B.T), np.zeros((K + 1, system.dim))
        for k in range(K):
            y[k + 1] = system.A @ y[k] + force[k]
        return KnownResponse(times(y, D.T), np.zeros((K, r)), np.zeros((K + 1, r)), y)
    substeps = _Substeps(signal, nodes, steps)
    first = np.nonzero(substeps.starts)[0]
    y, curve = _follow(system, D, substeps)
    # The input before and after every border between two sub-steps.
    before = substeps.u[:-1] + substeps.w[:-1] * substeps.length[:-1, None]
    jump = np.zeros((len(substeps.length) + 1, r))
    jump[1:-1] = np.abs(times(substeps.u[1:] - before, np.asarray(D @ system.B).T))
    at_node = np.r_[substeps.starts, True]
    kinks, inside = jump[at_node], np.where(at_node[:, None], 0.0, jump)[:-1]
    intersample = steps[:, None] ** 2 / 8 * np.maximum.reduceat(curve, first, axis=0)
    intersample += steps[:, None] / 4 * np.add.reduceat(inside, first, axis=0)
    y = y[at_node]
    return KnownResponse(times(y, D.T), intersample, kinks, y)


class _Substeps:
    """Steps cut at the knots of the signal: lengths, segments, and the input ``u + w s`` in each."""

    def __init__(self, signal: Signal, nodes: Array, steps: Array) -> None:
        begin, end = nodes[0], nodes[-1]
        knots = np.unique(signal.times[(signal.times > begin) & (signal.times < end)])
        after = np.searchsorted(nodes, knots)  # between 1 and len(nodes) - 1
        near = np.minimum(np.abs(knots - nodes[after]), np.abs(knots - nodes[after - 1]))
        knots = knots[near > SNAP * end]
        points = np.concatenate([nodes, knots])
        order = np.argsort(points, kind="stable")
        points, is_node = points[order], order < len(nodes)
        self.starts = is_node[:-1]
        self.length = np.diff(points)
        uncut = self.starts & is_node[1:]
        self.length[uncut] = steps[np.searchsorted(nodes, points[:-1][uncut], side="right") - 1]
        middle = (points[:-1] + points[1:]) / 2
        self.segment = np.searchsorted(signal.times, middle, side="right")
        self.w = signal.slope(middle)
        self.u = signal(middle) - self.w * self.length[:, None] / 2


def _follow(system: LinearSystem, D: Array, substeps: _Substeps) -> tuple[Array, Array]:
    """The trajectory at the ends of all sub-steps, and its largest second derivative along D in each."""
    n, m = system.dim, system.inputs
    A = bordered(bordered(system.A, system.B), np.eye(n + m, m, -n))  # of states, inputs and their slopes
    forward, across = ExponentialRows(LinearSystem(A)), ExponentialRows(LinearSystem(A.T))
    D2 = times(times(np.hstack([D, np.zeros((len(D), 2 * m))]), A), A)
    D4 = np.abs(times(times(D2, A), A)) * forward.scale
    y, curve = np.zeros((len(substeps.length) + 1, n)), np.empty((len(substeps.length), len(D)))
    chunk = max(ENTRIES // (n + 2 * m), 64)
    runs = groupby(range(len(substeps.length)), key=lambda i: (substeps.length[i], substeps.segment[i]))
    for indices in (list(run) for _, run in runs):
        for k in range(0, len(indices), chunk):
            i, count = indices[k], len(indices[k : k + chunk])
            h = float(substeps.length[i])
            z = np.concatenate([y[i], substeps.u[i], substeps.w[i]])
            Z = across.carry(z[None] * across.scale, h, count)[:, 0] / across.scale
            y[i + 1 : i + 1 + count] = Z[1:, :n]
            size = np.abs(Z @ D2.T)
            sizes = forward.closing(h, (np.abs(Z[:-1]) / forward.scale).T)
            curve[i : i + count] = np.maximum(size[1:], size[:-1]) + h**2 / 8 * (D4 @ sizes).T
    return y, curve
