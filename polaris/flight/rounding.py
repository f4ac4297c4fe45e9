"""Rounding on board, worked out in decimal arithmetic: the bound that the header states."""

from collections.abc import Iterator, Sequence
from decimal import Decimal, localcontext
from typing import Any

import numpy as np

from ..certificate.code.text import Tables
from ..certificate.files.document import Document
from ..model.system import Array

DIGITS = 50
MORE = 1.05  # the statement exceeds what is worked out by this: decimal digits, and a checker's own rounding
UNIT = {"double": Decimal(2) ** -53, "float": Decimal(2) ** -24}

Exact = Any  # array of Decimal


def exact(values: Any) -> Exact:
    """Return numbers as decimals."""
    return np.vectorize(Decimal, otypes=[object])(np.array(values, dtype=float))


def stated_rounding(document: Document, tables: Tables, precision: str) -> float:
    """Bound on the error of any command by rounding on board [N], for states within the range.

    Rounding of an observer's estimates is apart. Every entry is followed at its largest, part by part.
    """
    with localcontext() as context:
        context.prec = DIGITS
        u, (gain, limit) = UNIT[precision], (np.abs(exact(x)) for x in (tables.gain, tables.limit))
        input_unit = u if precision == "float" else Decimal(0)
        worst, feed = Decimal(0), np.abs(exact(tables.feed)).max(axis=0)
        for error, gap in _gaps(document, tables, precision):
            spread = gain @ (gap + error) + feed + limit
            worst = max(worst, *(gain @ error + spread * (u * (gain.shape[1] + 3) + 2 * input_unit)))
        return float(worst) * MORE


def gap_error(document: Document, tables: Tables, precision: str) -> Array:
    """Bound on the change of a state's error by rounding on board, for states within the range, (n,)."""
    with localcontext() as context:
        context.prec = DIGITS
        errors = [error for error, _ in _gaps(document, tables, precision)]
        return np.asarray(np.max(errors, axis=0).astype(float) * MORE)


def _gaps(document: Document, tables: Tables, precision: str) -> Iterator[tuple[Exact, Exact]]:
    """Rounding of the error at the nodes of a step, and the size of the error, (n,) each, part by part."""
    n, m, u = len(document.A), len(document.u_max), UNIT[precision]
    input_unit = u if precision == "float" and not tables.seen else Decimal(0)
    reach, path, starts = np.abs(exact(tables.range)), _path(document), exact(tables.waypoints)
    feeds = np.zeros((len(starts), m), dtype=object) * Decimal(0)
    feeds[: len(tables.feed)] = exact(tables.feed)
    for part, (state_map, input_map) in enumerate(zip(tables.moved, tables.pushed, strict=True)):
        Phi, Gamma = exact(state_map), exact(input_map)
        mismatch = np.abs(path[part] - starts @ Phi.T - feeds @ Gamma.T).max(axis=0)
        size = np.abs(Phi) @ np.abs(starts).max(axis=0) + np.abs(Gamma) @ np.abs(feeds).max(axis=0)
        error = mismatch + size * u * (n + m + 2)
        gap = size + error + reach
        yield error + gap * u + reach * input_unit, gap


def as_disturbance(document: Document, error: float) -> float:
    """Share of the disturbance bound that errors of commands take; 0 where nothing covers them."""
    D, B = np.array(document.D), np.array(document.B)
    through = np.linalg.lstsq(D, B, rcond=None)[0]
    if not document.w_max > 0 or not np.allclose(D @ through, B, rtol=0, atol=1e-12 * np.abs(B).max()):
        return 0.0
    sizes = np.abs(through).sum(axis=1) * error
    return float(np.linalg.norm(sizes)) * (1 + sum(document.shares)) / document.w_max


def _path(document: Document) -> list[Exact]:
    """The exact reference at every part of every cell, by part, (cells, n) each."""
    (A, B), centre, tail = plant(document), exact(document.center), exact(document.states[document.steps])
    if document.system_kind == "clohessy_wiltshire" and document.horizon == "infinite":
        tail[4] = -2 * Decimal(document.mean_motion or 0.0) * tail[0]
    h = Decimal(document.delta) / document.q
    each = [held(A, B, h * part) for part in range(document.q + 1)]
    inputs, states = exact(document.inputs), [centre]
    for k, u in enumerate(inputs):
        states[k] = tail if k == document.steps else states[k]
        states.append(each[-1][0] @ states[k] + each[-1][1] @ u)
    return [np.array(states[:-1]) @ Phi.T + inputs @ Gamma.T for Phi, Gamma in each[:-1]]


def plant(document: Document) -> tuple[Exact, Exact]:
    """Return the exact matrices of the motion and of the inputs."""
    A, B = exact(document.A), exact(document.B)
    if document.system_kind == "clohessy_wiltshire":
        rate = Decimal(document.mean_motion or 0.0)
        A[3, 0], A[3, 4], A[4, 3], A[5, 2] = 3 * rate**2, 2 * rate, -2 * rate, -(rate**2)
        B[B != 0] = 1 / Decimal(document.mass)
    return A, B


def held(A: Exact, B: Exact, t: Decimal) -> Sequence[Exact]:
    """``e^{A t}`` and ``int_0^t e^{A s} ds B`` by their Taylor series."""
    term = exact(np.eye(len(A)))
    Phi, Gamma, k = term, term * t, 1
    while np.abs(term).max() > Decimal(10) ** -DIGITS:
        term = term @ A * t / k
        Phi, Gamma, k = Phi + term, Gamma + term * t / (k + 1), k + 1
    return Phi, Gamma @ B
