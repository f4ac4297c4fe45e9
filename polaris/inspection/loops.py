"""Barrier conditions in loops over single states, for numba to compile.

Formulas are those of `polaris.inspection.constraints`, which are what these loops are tested against, to
rounding; the accounts of what they mean are there.

Of `rows`, `table` (M, 2) has a row's formula and its place in the stack of deputies and `pairs` (P, 2);
`values` (M, 9) its radius or axis, acceleration, side, and strengthening. `numbers` are n, 1 / m, the depth
of the layer, the speed back, the cone's half-angle, least lengths for directions and velocities, nu_0,
nu_1, v_max and the closest approach that need not be exact; of sampled data, else 0, the period, the
share, the growth, the largest acceleration by thrust, and of free flights the bow per amplitude, its
margin, and how thrust turns them. `about` (R, N + P, 5) is what `approaches` found, or for sampled data
`motions`, and `flights` (S + 2, 4, 6) has the maps of free flights to S places, with their norms, and to
the circle's vectors.
"""

import numpy as np

from ..model.compiled import compiled, inlined
from ..model.system import Array

SPHERE, CONE, PASSIVE, SPEED, VELOCITY, SEGMENTS = range(6)
FORMULAS = {"Radial": SPHERE, "SunCone": CONE, "Passive": PASSIVE, "Speed": SPEED, "Velocity": VELOCITY}
FORMULAS |= {"SpeedInSquares": SPEED, "VelocitySide": VELOCITY, "PassiveSegments": SEGMENTS}
"""Formulas of rows, by the class that is their account."""

Parts = tuple[Array, Array, Array]


@compiled
def rows(
    x: Array,
    sun: Array,
    about: Array,
    pairs: Array,
    table: Array,
    values: Array,
    numbers: Array,
    flights: Array,
) -> Parts:
    """Values (R, M), ``G`` (R, M, 3) and bounds (R, M) at states x (R, N, 6) and sun angles (R,) [rad]."""
    runs, deputies, count, n = x.shape[0], x.shape[1], len(table), numbers[0]
    h, G, bound = np.empty((runs, count)), np.empty((runs, count, 3)), np.empty((runs, count))
    z, gradient, geometry = np.empty((deputies + len(pairs), 6)), np.empty(6), np.zeros(3)
    s, v, motion, tight = np.empty(6), np.empty(9), np.empty(5), numbers[11] > 0  # copies: quicker than views
    for r in range(runs):
        z[:deputies] = x[r]
        for k in range(len(pairs)):
            for j in range(6):
                z[deputies + k, j] = x[r, pairs[k, 0], j] - x[r, pairs[k, 1], j]
        cone, m = (np.cos(sun[r]), np.sin(sun[r]), np.cos(numbers[4]), np.sin(numbers[4])), 0
        while m < count:
            formula, at, change, curvature = table[m, 0], table[m, 1], 0.0, 0.0
            for j in range(9):
                v[j] = values[m, j]
            for j in range(6):
                s[j] = z[at, j]
            for j in range(5):
                motion[j] = about[r, at, j]
            if formula == SEGMENTS:
                last = m + 2 * len(flights) - 6
                part = h[r, m:last], G[r, m:last], bound[r, m:last]
                _segments(s, motion, v, numbers, flights, part)
                m = last
                continue
            if formula == SPHERE:
                value = _sphere(s, v, numbers, gradient, geometry)
            elif formula == CONE:
                value, change = _cone(s, cone, v, numbers, gradient, geometry)
            elif formula == PASSIVE:
                value = motion[0] - v[0]
                _passive(motion, numbers[10], numbers[0], gradient)
            elif formula == SPEED:
                value, curvature = _speed(s, tight, motion, numbers, gradient)
            else:
                value, curvature = _velocity(s, int(v[0]), tight, motion, numbers, gradient)
            if tight and formula <= CONE:
                curvature = _curvature(s, geometry, formula == CONE, motion, v, numbers)
            h[r, m] = value
            for j in range(3):
                G[r, m, j] = gradient[3 + j] * numbers[1]
            rate = change + gradient[0] * s[3] + gradient[1] * s[4] + gradient[2] * s[5]
            rate += gradient[3] * (3 * n**2 * s[0] + 2 * n * s[4]) - gradient[4] * 2 * n * s[3]
            bound[r, m] = _least(rate - gradient[5] * n**2 * s[2], value, curvature, v, numbers)
            m += 1
    return h, G, bound


@inlined
def _least(rate: float, h: float, curvature: float, values: Array, numbers: Array) -> float:
    """The bound of a row whose value has a rate without thrust, tightened for sampled data."""
    alpha, D = _alpha(h, values), numbers[11]
    bound = -rate - alpha
    if D > 0:
        bound += (max(alpha - h * (numbers[12] / D), 0.0) if h > 0 else 0.0) + curvature * (D / 2)
    return float(bound)


@inlined
def _curvature(z: Array, geometry: Array, cone: bool, motion: Array, values: Array, numbers: Array) -> float:
    """As `Braking.curvature`; `geometry` holds the signed distance, its rate and the distance."""
    delta, rate, distance, D = geometry[0], geometry[1], geometry[2], numbers[11]
    v, push, jerk = motion[0], motion[1], motion[2]
    n, depth, centre, a = numbers[0], numbers[2], numbers[5], values[1]
    outside, share = cone or values[2] > 0, np.cos(numbers[4]) if cone else 1.0
    if cone:  # everything as seen from the turning cone
        far = _rounded(z[0], z[1], z[2], 0.0)[0] + v * D
        v, first = v + n * far, push
        push += 2 * n * v + n**2 * far
        jerk += n * first + 2 * n * push + n**2 * v
    nearest = distance - v * D
    near = max(nearest, centre)
    centripetal = share * v**2 / near
    low, high = (push, push + centripetal) if outside else (push + centripetal, push)
    slowest, quickest = rate - low * D, rate + high * D
    closest, farthest = delta + min(slowest, 0.0) * D, delta + max(quickest, 0.0) * D
    if closest >= 0 and _braking(closest, a, depth, numbers[3])[0] + slowest >= 0:
        return -np.inf
    if not nearest > centre:
        return np.inf
    fastest, root = max(abs(slowest), abs(quickest)), np.sqrt(2 * a * max(closest - depth / 2, depth / 2))
    bend = 0.0 if farthest <= depth else a**2 / root**3
    steepest = _braking(min(max(0.0, closest), farthest), a, depth, numbers[3])[1]
    third = share * (3 * v * push / near + 1.155 * v**3 / near**2) + jerk
    return float(bend * fastest**2 + steepest * low + third)


@inlined
def _segments(z: Array, motion: Array, values: Array, numbers: Array, flights: Array, out: Parts) -> None:
    """All rows of a free flight, as `PassiveSegments`."""
    S, intersample, margin, turn, (h, G, bound) = len(flights) - 2, numbers[15], numbers[16], numbers[17], out
    n, places, growth, o = numbers[0], np.zeros((S + 2, 6)), np.zeros(4), np.empty(3)
    drift = z[3], z[4], z[5], 3 * n**2 * z[0] + 2 * n * z[4], -2 * n * z[3], -(n**2) * z[2]
    for s in range(S + 2):  # where each map leads, and how that changes without thrust
        for i in range(3):
            for j in range(6):
                places[s, i] += flights[s, i, j] * z[j]
                places[s, 3 + i] += flights[s, i, j] * drift[j]
    amplitude = np.sqrt((places[S:, :3] ** 2).sum() + margin**2)
    for s in range(S, S + 2):
        for i in range(3):
            part = intersample / amplitude * places[s, i]
            growth[3] += part * places[s, 3 + i]
            for j in range(3):
                growth[j] += part * flights[s, i, 3 + j]
    rate = turn * motion[3]
    turning = intersample * (rate**2 / max(amplitude - rate * numbers[11], margin) + n * rate)
    for s in range(S - 1):
        along = across = 0.0
        for i in range(3):
            chord = places[s + 1, i] - places[s, i]
            along, across = along - places[s, i] * chord, across + chord**2
        part = min(max(along / max(across, 1e-30), 0.0), 1.0)
        for i in range(3):
            o[i] = places[s, i] + part * (places[s + 1, i] - places[s, i])
        by = _rounded(o[0], o[1], o[2], 1e-9)[1]
        for i in range(3):
            o[i] /= by
        for k in range(2 * s, 2 * s + 2):
            at, gain = s + k % 2, flights[s + k % 2]
            value, rate = -values[0] - intersample * amplitude, -growth[3]
            for i in range(3):
                value, rate = value + o[i] * places[at, i], rate + o[i] * places[at, 3 + i]
            for j in range(3):
                turns = o[0] * gain[0, 3 + j] + o[1] * gain[1, 3 + j] + o[2] * gain[2, 3 + j]
                G[k, j] = (turns - growth[j]) * numbers[1]
            curvature = motion[1] * gain[3, 0] + motion[2] * gain[3, 1] + turning
            h[k], bound[k] = value, _least(rate, value, curvature, values, numbers)


@inlined
def _alpha(h: float, values: Array) -> float:
    s = h - values[6]
    size = abs(s)
    alpha = s * (values[3] + size * (values[4] + size * values[5]))
    return float(values[7] * alpha - values[8] if s < 0 else alpha)


@inlined
def _rounded(a: float, b: float, c: float, least: float) -> tuple[float, float]:
    """Length, and the divisor for a direction."""
    exact = np.sqrt(a * a + b * b + c * c)
    if not exact < least:
        return exact, exact
    return exact + (least - exact) ** 2 / (2 * least), least


@inlined
def _braking(delta: float, a: float, depth: float, back: float) -> tuple[float, float]:
    """Speed at a signed distance, and its slope."""
    k, half = np.sqrt(a / depth), depth / 2
    root = np.sqrt(2 * a * max(delta - half, half))
    speed, slope = min(root, k * delta), a / root
    if delta < 0:
        fade = 1 + k / back * -delta
        return speed / fade, slope / fade**2
    return speed, slope


@inlined
def _sphere(z: Array, values: Array, numbers: Array, gradient: Array, geometry: Array) -> float:
    """Value; `geometry` are the signed distance, its rate and the distance."""
    centre, side = numbers[5], values[2]
    distance, by = _rounded(z[0], z[1], z[2], centre)
    delta = side * (distance - values[0])
    speed, slope = _braking(delta, values[1], numbers[2], numbers[3])
    rate = 0.0
    for j in range(3):
        gradient[3 + j] = z[j] / by
        rate += gradient[3 + j] * z[3 + j]
    along, over = (rate, distance) if distance > centre else (0.0, max(distance, centre))
    for j in range(3):
        toward = gradient[3 + j]
        gradient[j] = side * (slope * toward + (z[3 + j] - along * toward) / over)
        gradient[3 + j] = side * toward
    geometry[0], geometry[1], geometry[2] = delta, side * rate, distance
    return float(speed + side * rate)


@inlined
def _cone(
    z: Array, cone: tuple[float, ...], values: Array, numbers: Array, gradient: Array, geometry: Array
) -> tuple[float, float]:
    """Value, and its change with time: the cone turns at -n; `geometry` as in `_sphere`."""
    n, centre, (cosine, sine, c, s) = numbers[0], numbers[5], cone
    ax, ay = -values[2] * cosine, -values[2] * sine
    along = z[0] * ax + z[1] * ay
    px, py = z[0] - along * ax, z[1] - along * ay
    radius, by = _rounded(px, py, z[2], centre)
    ox, oy, oz = px / by, py / by, z[2] / by
    nx, ny, nz = c * ox - s * ax, c * oy - s * ay, c * oz
    delta = c * radius - s * along
    speed, slope = _braking(delta, values[1], numbers[2], numbers[3])
    vx, vy, vz = z[3] - n * z[1], z[4] + n * z[0], z[5]  # relative to the turning cone
    forward = vx * ax + vy * ay
    wx, wy = vx - forward * ax, vy - forward * ay
    radial = ox * wx + oy * wy + oz * vz
    faded, over = (radial, radius) if radius > centre else (0.0, max(radius, centre))
    gradient[0] = slope * nx + n * ny + c * ((wx - faded * ox) / over)
    gradient[1] = slope * ny - n * nx + c * ((wy - faded * oy) / over)
    gradient[2] = slope * nz + c * ((vz - faded * oz) / over)
    gradient[3], gradient[4], gradient[5] = nx, ny, nz
    change = gradient[1] * z[0] - gradient[0] * z[1] + ny * z[3] - nx * z[4]
    rate = c * radial - s * forward
    geometry[0], geometry[1], geometry[2] = delta, rate, radius
    return speed + rate, n * change


@inlined
def _speed(z: Array, tight: bool, motion: Array, numbers: Array, gradient: Array) -> tuple[float, float]:
    """Value and curvature, the latter of the form in squares."""
    distance, by = _rounded(z[0], z[1], z[2], numbers[5])
    speed, over = _rounded(z[3], z[4], z[5], numbers[6])
    slope, limit, M = numbers[8], numbers[7] + numbers[8] * distance, 0.0
    inner, outer = slope / by, 1 / over
    if tight:
        D, w, change = numbers[11], limit + speed, slope * motion[0] * numbers[11]
        inner, outer = 2 * limit * slope / by / w, 2 / w
        M = 2 * (limit + change) * slope * motion[1] + 2 * motion[1] ** 2 + 2 * motion[0] * motion[2]
        M = M / w - 2 * max(limit - change - motion[0], 0.0) / D**2
    for j in range(3):
        gradient[j], gradient[3 + j] = inner * z[j], -outer * z[3 + j]
    return limit - speed, M


@inlined
def _velocity(
    z: Array, axis: int, tight: bool, motion: Array, numbers: Array, gradient: Array
) -> tuple[float, float]:
    """Value and curvature, the latter of the form on the nearer side."""
    limit, along, M = numbers[9], z[3 + axis], 0.0
    for j in range(6):
        gradient[j] = 0.0
    gradient[3 + axis] = -2 * along
    if tight:
        speed, change = abs(along), motion[4] * numbers[11]
        gradient[3 + axis] = -np.copysign(limit + speed, along)
        M = (limit + speed) * motion[2] if change < limit + speed else np.inf
        M = -np.inf if speed + change <= limit else M
    return limit**2 - along**2, M


@inlined
def _passive(approach: Array, beyond: float, n: float, gradient: Array) -> None:
    for j in range(6):
        gradient[j] = 0.0
    if approach[0] <= beyond:  # farther, the row allows every input
        time = approach[1]
        s, c = np.sin(n * time), np.cos(n * time)
        _, by = _rounded(approach[2], approach[3], approach[4], 1e-9)
        x, y, z = approach[2] / by, approach[3] / by, approach[4] / by
        gradient[0], gradient[1] = x * (4 - 3 * c) + y * 6 * (s - n * time), y
        gradient[2], gradient[5] = z * c, z * s / n
        gradient[3] = (x * s - y * 2 * (1 - c)) / n
        gradient[4] = x * 2 * (1 - c) / n + y * (4 * s / n - 3 * time)
