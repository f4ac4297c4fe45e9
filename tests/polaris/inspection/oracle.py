"""The inspection paper's formulas, one state at a time, as plainly as they are printed.

They take complex numbers, so that they can be differentiated by a complex step. Theory notes 14 and 16
are followed: eq. 19 has a norm, the cone turns at -n, and the square roots get the layer of
`polaris.inspection.constraints.barriers.Braking`, written out here once more.
"""

import numpy as np

STEP = 1e-30


def norm(vector):
    """2-norm that keeps an imaginary part (no conjugation)."""
    return np.sqrt(np.sum(vector * vector))


def sun_direction(theta):
    return np.array([np.cos(theta), np.sin(theta), 0.0 * theta])


def angle_between(a, b):
    """Eqs. 16 and 18: arc cosine of the product of unit vectors."""
    return np.arccos(np.clip(np.dot(a, b) / (np.linalg.norm(a) * np.linalg.norm(b)), -1, 1))


def phi(q, x, theta):
    """phi1 to phi6 and phi9 to phi11 for all deputies; phi5 for both orders of each pair."""
    p, v = x[:, :3], x[:, 3:]
    N = len(x)
    pairs = [(i, j) for i in range(N) for j in range(i + 1, N)]
    sun = sun_direction(theta)
    out = {
        "phi1": [np.linalg.norm(p[i]) - (q.deputy_radius + q.chief_radius) for i in range(N)],
        "phi2": [np.linalg.norm(p[i] - p[j]) - 2 * q.deputy_radius for i, j in pairs],
        "phi3": [q.docking_speed + q.nu_1 * np.linalg.norm(p[i]) - np.linalg.norm(v[i]) for i in range(N)],
        "phi4": [angle_between(-p[i], sun) - q.field_of_view / 2 for i in range(N)],
        "phi5": [
            min(angle_between(p[i] - p[j], sun), angle_between(p[j] - p[i], sun)) - q.field_of_view / 2
            for i, j in pairs
        ],
        "phi6": [q.distance_max - np.linalg.norm(p[i]) for i in range(N)],
    }
    for k in range(3):
        out[f"phi{9 + k}"] = [q.speed_max**2 - v[i, k] ** 2 for i in range(N)]
    return {name: np.array(values) for name, values in out.items()}


def free_flight(z, n, t):
    """Eq. 20 and its derivative, for one state."""
    x, y, zz, vx, vy, vz = z
    s, c = np.sin(n * t), np.cos(n * t)
    return np.array(
        [
            (4 - 3 * c) * x + s / n * vx + 2 / n * (1 - c) * vy,
            6 * (s - n * t) * x + y - 2 / n * (1 - c) * vx + (4 * s - 3 * n * t) / n * vy,
            zz * c + vz / n * s,
        ]
    )


def motion(z, n):
    """The right-hand side of eq. 8 without thrust."""
    x, _, zz, vx, vy, vz = z
    return np.array([vx, vy, vz, 3 * n**2 * x + 2 * n * vy, -2 * n * vx, -(n**2) * zz])


def braked(delta, a, depth, back=0.2):
    """``sqrt(2 a delta)`` of eqs. 29, 30, 35 and 36, with the layer, and the way back from outside."""
    k = np.sqrt(a / depth)
    if np.real(delta) < 0:
        return k * delta / (1 - k * delta / back)
    if np.real(delta) <= depth:
        return k * delta
    return np.sqrt(2 * a * (delta - depth / 2))


def h_outside(z, radius, a, depth, root=braked):
    """Eqs. 26 and 29, or 30 and 31 (with 2 a_max for a)."""
    p, v = z[:3], z[3:]
    return root(norm(p) - radius, a, depth) + np.sum(v * p) / norm(p)


def h_inside(z, radius, a, depth, root=braked):
    """Eq. 36."""
    p, v = z[:3], z[3:]
    return root(radius - norm(p), a, depth) - np.sum(v * p) / norm(p)


def h_speed(z, nu_0, nu_1):
    """Eq. 14."""
    return nu_0 + nu_1 * norm(z[:3]) - norm(z[3:])


def cone_projection(p, axis, half_angle):
    """Eqs. 33 and 34."""
    s, c = np.sin(half_angle), np.cos(half_angle)
    along = np.sum(p * axis)
    perp = p - along * axis
    return p + s * c * (norm(perp) * axis + along * perp / norm(perp)) - c**2 * perp - s**2 * along * axis


def h_cone(z, theta, half_angle, n, a, depth, side=1.0, root=braked):
    """Eq. 35 with v_c = [0, 0, -n] x p_c; inside the cone the distance counts negative."""
    p, v = z[:3], z[3:]
    axis = -side * sun_direction(theta)
    p_c = cone_projection(p, axis, half_angle)
    gap = p - p_c
    along = np.sum(p * axis)
    perp = p - along * axis
    sign = np.sign(np.real(np.cos(half_angle) * norm(perp) - np.sin(half_angle) * along))
    v_c = np.array([n * p_c[1], -n * p_c[0], 0.0 * p_c[2]])
    return root(sign * norm(gap), a, depth) + sign * np.sum((v - v_c) * gap) / norm(gap)


def h_velocity(z, axis, limit):
    """Eq. 23."""
    return limit**2 - z[3 + axis] ** 2


def gradient(function, z):
    """By complex steps, exact to rounding."""
    out = np.empty(len(z))
    for k in range(len(z)):
        point = z.astype(complex)
        point[k] += 1j * STEP
        out[k] = np.imag(function(point)) / STEP
    return out


def slope(function, t):
    return np.imag(function(t + 1j * STEP)) / STEP
