"""Linear systems to try, and the truth about them by other means than the library's."""

import numpy as np
from hypothesis import strategies as st
from scipy.linalg import expm

from reach.sets.ellipsoid import Ellipsoid
from reach.sets.interval import Interval
from reach.sets.zonotope import Zonotope
from reach.tubes.systems import LinearSystem

KINDS = ("random", "stiff", "oscillating", "unstable", "nilpotent", "zero", "units", "triangular")


def matrix(kind, n, rng):
    A = rng.normal(size=(n, n))
    if kind == "stiff":
        return np.diag(-(10.0 ** rng.uniform(-1, 2.5, n))) + np.triu(A, 1)
    if kind == "oscillating":
        return 4 * (A - A.T)
    if kind == "unstable":
        return A + np.eye(n)
    if kind == "nilpotent":
        return np.triu(2 * A, 1)
    if kind == "zero":
        return np.zeros((n, n))
    if kind == "units":
        s = 10.0 ** rng.integers(-6, 7, n)
        return (A - np.eye(n)) * s[:, None] / s
    if kind == "triangular":
        return np.triu(A) - np.diag(rng.uniform(0, 3, n))
    return A - np.eye(n)


def body(kind, n, rng, size=1.0):
    """A bounded set that need neither hold 0 nor be fat."""
    c = rng.normal(size=n) * rng.integers(0, 2) * size
    if kind == "point":
        return Zonotope.point(c)
    if kind == "zonotope":
        return Zonotope(c, size * rng.normal(size=(n, int(rng.integers(1, 4)))))
    if kind == "ellipsoid":
        return Ellipsoid(c, size * rng.normal(size=(n, n)))
    lo = c - rng.uniform(0, 1, n) * size
    return Interval(lo, c + rng.uniform(0, 1, n) * rng.integers(0, 2, n) * size)


BODIES = ("point", "zonotope", "ellipsoid", "interval")


@st.composite
def cases(draw, pieces=None, kinds=KINDS):
    """A system with inputs, an initial set, a horizon of 1 and a seed."""
    kind, n, m = draw(st.sampled_from(kinds)), draw(st.integers(1, 4)), draw(st.integers(0, 2))
    seed = draw(st.integers(0, 2**32 - 1))
    rng = np.random.default_rng(seed)
    A = matrix(kind, n, rng)
    size = np.max(np.abs(A), axis=1, initial=0.0) if kind == "units" else np.ones(n)
    count = pieces or 1
    U = [body(draw(st.sampled_from(BODIES)), m, rng) for _ in range(count)] if m else []
    B = rng.normal(size=(n, m)) * np.where(size > 0, size, 1)[:, None] if m else None
    c = rng.normal(size=n) * size if draw(st.booleans()) else None
    breaks = [k / (4 * count) for k in range(1, count)] if m else ()
    X = body(draw(st.sampled_from(BODIES)), n, rng)
    return LinearSystem(A, B, U or None, c, breaks if U else ()), X, rng


def inputs_at(system, times):
    """Input set in force at each time, as an index."""
    return np.searchsorted(system.breaks, times, side="right")


def simulate(system, x0, times, inputs):
    """Exact response to inputs held from each time to the next: (m+1, N, n) for x0 (N, n), (m, N, p)."""
    n, h = system.dim, np.diff(times)
    out = [x0]
    force = inputs @ system.B.T + system.c
    for i, dt in enumerate(h):
        if i == 0 or not np.isclose(dt, h[i - 1], rtol=1e-12):
            block = np.zeros((2 * n, 2 * n))
            block[:n, :n], block[:n, n:] = system.A, np.eye(n)
            E = expm(block * dt)
        out.append(out[-1] @ E[:n, :n].T + force[i] @ E[:n, n:].T)
    return np.array(out)


def vertices(X, count, rng):
    """Points of a set that lie on its boundary."""
    return np.array([X.support_vector(d) for d in rng.normal(size=(count, X.dim))])


def trajectories(system, X, times, rng, count=12):
    """Admissible trajectories under bang-bang and random piecewise constant inputs, (m+1, N, n)."""
    m, p = len(times) - 1, system.inputs
    u = np.zeros((m, count, p))
    piece = inputs_at(system, (times[:-1] + times[1:]) / 2)
    for i, U in enumerate(system.U):
        for j in range(count):
            run = int(rng.integers(1, 2 + m // 2))
            corners = vertices(U, m // run + 1, rng)
            u[piece == i, j] = np.repeat(corners, run, axis=0)[:m][piece == i]
        u[piece == i, -1] = U.center
    return simulate(system, vertices(X, count, rng), times, u)


def worst(system, X, times, d, count=1):
    """End of the trajectory under the inputs of the maximum principle, held between given times."""
    middle = (times[:-1] + times[1:]) / 2
    rows = np.array([d @ expm(np.asarray(system.A) * (times[-1] - t)) for t in middle])
    u = np.zeros((len(middle), 1, system.inputs))
    piece = inputs_at(system, middle)
    for i, U in enumerate(system.U):
        u[piece == i, 0] = U.support_vector(rows[piece == i] @ system.B)
    x0 = X.support_vector(d @ expm(np.asarray(system.A) * times[-1]))
    return float(d @ simulate(system, x0[None], times, u)[-1, 0])


def exact(system, X, t, D, count=2048):
    """Support of the set reached at t, by quadrature of the closed form, and its error, each (r,)."""
    coarse, fine = (_closed_form(system, X, t, D, k) for k in (count, 2 * count))
    size = np.abs(D) @ np.abs(expm(np.asarray(system.A) * t)) @ X.interval_hull().extent
    return fine, 4 * np.abs(fine - coarse) + 1e-11 * (np.abs(fine) + size)


def _closed_form(system, X, t, D, count):
    h = t / count
    E, half = expm(system.A * h), expm(system.A * h / 2)
    rows = np.empty((count + 1, *D.shape))
    rows[0] = D
    for k in range(count):
        rows[k + 1] = rows[k] @ E
    value = X.support(rows[-1])
    middle = rows[:-1] @ half
    lag = t - (np.arange(count) + 0.5) * h
    ends, mids = rows @ system.c, middle @ system.c
    value = value + h / 6 * (ends[:-1] + 4 * mids + ends[1:]).sum(axis=0)
    piece = inputs_at(system, lag)
    for i, U in enumerate(system.U):
        ends, mids = U.support(rows @ system.B), U.support(middle @ system.B)
        value = value + (h / 6 * (ends[:-1] + 4 * mids + ends[1:]))[piece == i].sum(axis=0)
    return value


def size(system, X, D, horizon=1.0):
    """Return a bound on the values along D, for judging rounding, shape (r,)."""
    times = np.linspace(0, horizon, 9)
    big = np.array([np.abs(D) @ np.abs(expm(np.asarray(system.A) * t)) for t in times]).max(axis=0)
    force = np.abs(system.c)
    for U in system.U:
        force = force + np.abs(system.B) @ U.interval_hull().extent
    return big @ (X.interval_hull().extent + horizon * force)
