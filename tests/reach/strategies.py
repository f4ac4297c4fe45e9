"""Random sets for property tests: eighths, so that sums are exact."""

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from reach.sets.ellipsoid import Ellipsoid
from reach.sets.interval import Interval
from reach.sets.polytope import HPolytope
from reach.sets.zonotope import Zonotope

# Exact in binary, and never so small beside the centre that the points themselves are rounded.
numbers = st.integers(-80, 80).map(lambda v: v / 8)
positive = st.integers(1, 80).map(lambda v: v / 8)


def vectors(n):
    return arrays(float, n, elements=numbers)


@st.composite
def zonotopes(draw, n=None, g=None):
    n = n or draw(st.integers(1, 3))
    g = draw(st.integers(0, 6)) if g is None else g
    return Zonotope(draw(vectors(n)), draw(arrays(float, (n, g), elements=numbers)))


@st.composite
def intervals(draw, n=None):
    n = n or draw(st.integers(1, 3))
    a, b = draw(vectors(n)), draw(vectors(n))
    return Interval(np.minimum(a, b), np.maximum(a, b))


@st.composite
def ellipsoids(draw, n=None):
    n = n or draw(st.integers(1, 3))
    k = draw(st.integers(0, 4))
    return Ellipsoid(draw(vectors(n)), draw(arrays(float, (n, k), elements=numbers)))


@st.composite
def polytopes(draw, n=None):
    """A box cut by a few halfspaces that leave its centre in it."""
    n = n or draw(st.integers(1, 3))
    center, half = draw(vectors(n)), draw(arrays(float, n, elements=positive))
    rows = draw(arrays(float, (draw(st.integers(0, 3)), n), elements=numbers))
    rows = rows[rows.any(axis=1)]
    room = draw(arrays(float, len(rows), elements=positive))
    A = np.vstack([np.eye(n), -np.eye(n), rows])
    return HPolytope(A, A @ center + np.r_[half, half, room])


def sets(n=None):
    return st.one_of(zonotopes(n), intervals(n), ellipsoids(n), polytopes(n))


def directions(n, count=12, seed=1):
    d = np.random.default_rng(seed).normal(size=(count, n))
    return np.vstack([d / np.linalg.norm(d, axis=1, keepdims=True), np.eye(n), -np.eye(n)])


def size(X):
    return 1 + float(np.abs(X.interval_hull().extent).max())


def some_points(X, count=8, seed=0):
    """Points of the set: extreme ones, and mixtures of them."""
    extreme = X.support_vector(directions(X.dim, count, seed))
    weights = np.random.default_rng(seed).dirichlet(np.ones(len(extreme)), count)
    return np.vstack([extreme, weights @ extreme])
