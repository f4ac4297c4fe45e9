"""Sets in exact arithmetic: fractions instead of floats, for what must never be refuted."""

from fractions import Fraction
from itertools import product

import numpy as np

from reach import AffineImage, Ellipsoid, HPolytope, Intersection, Interval, MinkowskiSum, Zonotope


def exact(values):
    """Return numbers as fractions, in an object array."""
    values = np.asarray(values)
    out = np.empty(values.shape, dtype=object)
    for i in np.ndindex(values.shape):
        out[i] = values[i] if isinstance(values[i], Fraction) else Fraction(float(values[i]))
    return out


def solve(A, b):
    """Solution of a square system of fractions; None if it is singular."""
    n = len(A)
    rows = [[*map(Fraction, A[i]), Fraction(b[i])] for i in range(n)]
    for j in range(n):
        at = next((i for i in range(j, n) if rows[i][j]), None)
        if at is None:
            return None
        rows[j], rows[at] = rows[at], rows[j]
        for i in range(n):
            if i != j and rows[i][j]:
                share = rows[i][j] / rows[j][j]
                rows[i] = [a - share * p for a, p in zip(rows[i], rows[j], strict=True)]
    return np.array([rows[i][n] / rows[i][i] for i in range(n)], dtype=object)


def points(X):
    """Points whose hull is the set, or (of a round one) that lie in it, as fractions."""
    if isinstance(X, Interval):
        return [np.array(p, dtype=object) for p in product(*zip(exact(X.lo), exact(X.hi), strict=True))]
    if isinstance(X, Zonotope):
        c, G = exact(X.c), exact(X.G)
        return [c + G @ np.array(s, dtype=object) for s in product((-1, 1), repeat=G.shape[1])]
    if isinstance(X, HPolytope):
        return vertices(exact(X.A), exact(X.b))
    if isinstance(X, Ellipsoid):
        c, L, m = exact(X.c), exact(X.L), X.L.shape[1]
        # Rational points of the unit circle, in every pair of coordinates.
        out = [c]
        for i, j in product(range(m), repeat=2):
            for t in map(Fraction, (0, 1, -1, Fraction(1, 3), -3, Fraction(7, 5))):
                u = np.array([Fraction(0)] * m, dtype=object)
                u[i] = (1 - t * t) / (1 + t * t) if i != j else Fraction(1)
                if i != j:
                    u[j] = 2 * t / (1 + t * t)
                out += [c + L @ u, c - L @ u]
        return out
    if isinstance(X, AffineImage):
        M, v = exact(X.M), exact(X.v)
        return [M @ p + v for p in points(X.base)]
    if isinstance(X, MinkowskiSum):
        return [sum(group[1:], group[0]) for group in product(*map(points, X.parts))]
    if isinstance(X, Intersection):
        flat = [rows(part) for part in X.parts]
        if all(one is not None for one in flat):
            return vertices(np.vstack([A for A, _ in flat]), np.concatenate([b for _, b in flat]))
        return [p for part in X.parts for p in points(part) if all(inside(one, p) for one in X.parts)]
    raise AssertionError(type(X))


def vertices(A, b):
    """Vertices of ``{A x <= b}`` in two dimensions or one."""
    n, out = A.shape[1], []
    for group in product(range(len(A)), repeat=n):
        if list(group) == sorted(set(group)):
            p = solve(A[list(group)], b[list(group)])
            if p is not None and all(A[i] @ p <= b[i] for i in range(len(A))):
                out.append(p)
    return out


def rows(X):
    """Inequalities of a planar set with flat faces, as fractions; None for others."""
    if isinstance(X, HPolytope):
        return exact(X.A), exact(X.b)
    if isinstance(X, Interval):
        eye = exact(np.eye(X.dim))
        return np.vstack([eye, -eye]), np.concatenate([exact(X.hi), -exact(X.lo)])
    if isinstance(X, Zonotope) and X.dim == 2:
        G, c, normals = exact(X.G), exact(X.c), []
        for g in G.T:
            if any(g):
                normals += [[g[1], -g[0]], [-g[1], g[0]]]
        # A flat one has ends too.
        normals += [[g[0], g[1]] for g in (*G.T, *-G.T) if any(g)]
        A = np.array(normals, dtype=object)
        return A, A @ c + np.array([sum(abs(a @ g) for g in G.T) for a in A], dtype=object)
    if isinstance(X, AffineImage) and (base := rows(X.base)) is not None:
        M, v, (A, b) = exact(X.M), exact(X.v), base
        back = [solve(M, e) for e in exact(np.eye(len(M)))] if M.shape[0] == M.shape[1] else [None]
        if any(column is None for column in back):
            return None
        W = np.stack(back, axis=1)
        return A @ W, b + A @ W @ v
    if isinstance(X, Intersection):
        parts = [rows(part) for part in X.parts]
        if all(part is not None for part in parts):
            return np.vstack([A for A, _ in parts]), np.concatenate([b for _, b in parts])
    return None


def inside(X, p):
    """Return True if a point of fractions is in a set, without rounding; None if that is not known here."""
    if isinstance(X, Ellipsoid):
        u = solve(exact(X.L), p - exact(X.c)) if X.L.shape[0] == X.L.shape[1] else None
        return None if u is None else bool(u @ u <= 1)
    if isinstance(X, Intersection):
        each = [inside(part, p) for part in X.parts]
        return False if False in each else None if None in each else True
    if isinstance(X, AffineImage) and rows(X) is None and X.M.shape[0] == X.M.shape[1]:
        x = solve(exact(X.M), p - exact(X.v))
        return None if x is None else inside(X.base, x)
    flat = rows(X)
    return None if flat is None else bool(all(a @ p <= b for a, b in zip(*flat, strict=True)))


def refuted(outer, inner):
    """A point of the inner set that is provably not in the outer one, or None."""
    return next((p for p in points(inner) if inside(outer, p) is False), None)


def shared(X, Y):
    """A point that is provably in both sets, or None."""
    for A, B in ((X, Y), (Y, X)):
        for p in points(A):
            if inside(B, p) and inside(A, p) is not False:
                return p
    flat = rows(X), rows(Y)
    if all(one is not None for one in flat):
        A, b = np.vstack([flat[0][0], flat[1][0]]), np.concatenate([flat[0][1], flat[1][1]])
        return next(iter(vertices(A, b)), None)
    return None
