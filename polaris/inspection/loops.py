"""Barrier conditions and closest approaches in loops over single states, for numba to compile.

Formulas are those of `polaris.inspection.constraints` and `polaris.inspection.closest`, which are what these
loops are tested against, to rounding; the accounts of what they mean are there.
"""

from __future__ import annotations

import numpy as np

from ..model.compiled import compiled
from ..model.system import Array

SPHERE, CONE, PASSIVE, SPEED, VELOCITY = range(5)
FORMULAS = {"Radial": SPHERE, "SunCone": CONE, "Passive": PASSIVE, "Speed": SPEED, "Velocity": VELOCITY}
"""Formulas of rows, by the class that is their account."""

TOLERANCE, NEWTON, HALVINGS = 1e-6, 40, 40  # as in `polaris.inspection.closest`


@compiled
def rows(
    x: Array, sun: Array, pairs: Array, table: Array, values: Array, numbers: Array, flight: Array
) -> tuple[Array, Array, Array]:
    """Values (R, M), ``G`` (R, M, 3) and bounds (R, M) at states x (R, N, 6) and sun angles (R,) [rad].

    `table` (M, 2) has a row's formula and its place in the stack of deputies and `pairs` (P, 2); `values`
    (M, 9) its radius or axis, acceleration, side, and strengthening. `numbers` are n, 1 / m, the depth of
    the layer, the speed back, the cone's half-angle, least lengths for directions and velocities, nu_0,
    nu_1, v_max and the closest approach that need not be exact; `flight` is as in `closest`.
    """
    runs, deputies, count = x.shape[0], x.shape[1], len(table)
    h, G, bound = np.empty((runs, count)), np.empty((runs, count, 3)), np.empty((runs, count))
    z, gradient = np.empty((deputies + len(pairs), 6)), np.empty(6)
    n = numbers[0]
    for r in range(runs):
        z[:deputies] = x[r]
        for k in range(len(pairs)):
            for j in range(6):
                z[deputies + k, j] = x[r, pairs[k, 0], j] - x[r, pairs[k, 1], j]
        cosine, sine = np.cos(sun[r]), np.sin(sun[r])
        for m in range(count):
            s, change = z[table[m, 1]], 0.0
            if table[m, 0] == SPHERE:
                value = _sphere(s, values[m], numbers, gradient)
            elif table[m, 0] == CONE:
                value, change = _cone(s, cosine, sine, values[m], numbers, gradient)
            elif table[m, 0] == PASSIVE:
                value = _passive(s, values[m, 0], numbers[10], flight, gradient)
            elif table[m, 0] == SPEED:
                value = _speed(s, numbers, gradient)
            else:
                value = _velocity(s, int(values[m, 0]), numbers[9], gradient)
            rate = gradient[0] * s[3] + gradient[1] * s[4] + gradient[2] * s[5]
            rate += gradient[3] * (3 * n**2 * s[0] + 2 * n * s[4]) - gradient[4] * 2 * n * s[3]
            rate += change - gradient[5] * n**2 * s[2]
            for j in range(3):
                G[r, m, j] = gradient[3 + j] * numbers[1]
            h[r, m], bound[r, m] = value, -rate - _alpha(value, values[m])
    return h, G, bound


@compiled
def _alpha(h: float, values: Array) -> float:
    s = h - values[6]
    size = abs(s)
    alpha = s * (values[3] + size * (values[4] + size * values[5]))
    return float(values[7] * alpha - values[8] if s < 0 else alpha)


@compiled
def _rounded(a: float, b: float, c: float, least: float) -> tuple[float, float]:
    """Length, and what to divide by for a direction."""
    exact = np.sqrt(a * a + b * b + c * c)
    if not exact < least:
        return exact, exact
    return exact + (least - exact) ** 2 / (2 * least), least


@compiled
def _braking(delta: float, a: float, depth: float, back: float) -> tuple[float, float]:
    """Speed at a signed distance, and its slope."""
    k, half = np.sqrt(a / depth), depth / 2
    root = np.sqrt(2 * a * max(delta - half, half))
    speed, slope = min(root, k * delta), a / root
    if delta < 0:
        fade = 1 + k / back * -delta
        return speed / fade, slope / fade**2
    return speed, slope


@compiled
def _sphere(z: Array, values: Array, numbers: Array, gradient: Array) -> float:
    centre, side = numbers[5], values[2]
    distance, by = _rounded(z[0], z[1], z[2], centre)
    speed, slope = _braking(side * (distance - values[0]), values[1], numbers[2], numbers[3])
    away = 0.0
    for j in range(3):
        gradient[3 + j] = z[j] / by
        away += gradient[3 + j] * z[3 + j]
    along, over = (away, distance) if distance > centre else (0.0, max(distance, centre))
    for j in range(3):
        toward = gradient[3 + j]
        gradient[j] = side * (slope * toward + (z[3 + j] - along * toward) / over)
        gradient[3 + j] = side * toward
    return float(speed + side * away)


@compiled
def _cone(
    z: Array, cosine: float, sine: float, values: Array, numbers: Array, gradient: Array
) -> tuple[float, float]:
    """Value, and its change with time: the cone turns at -n."""
    n, centre = numbers[0], numbers[5]
    ax, ay = -values[2] * cosine, -values[2] * sine
    along = z[0] * ax + z[1] * ay
    px, py = z[0] - along * ax, z[1] - along * ay
    radius, by = _rounded(px, py, z[2], centre)
    ox, oy, oz = px / by, py / by, z[2] / by
    c, s = np.cos(numbers[4]), np.sin(numbers[4])
    nx, ny, nz = c * ox - s * ax, c * oy - s * ay, c * oz
    speed, slope = _braking(c * radius - s * along, values[1], numbers[2], numbers[3])
    vx, vy, vz = z[3] - n * z[1], z[4] + n * z[0], z[5]  # relative to the turning cone
    forward = vx * ax + vy * ay
    wx, wy = vx - forward * ax, vy - forward * ay
    away = ox * wx + oy * wy + oz * vz
    held, over = (away, radius) if radius > centre else (0.0, max(radius, centre))
    gradient[0] = slope * nx + n * ny + c * ((wx - held * ox) / over)
    gradient[1] = slope * ny - n * nx + c * ((wy - held * oy) / over)
    gradient[2] = slope * nz + c * ((vz - held * oz) / over)
    gradient[3], gradient[4], gradient[5] = nx, ny, nz
    change = gradient[1] * z[0] - gradient[0] * z[1] + ny * z[3] - nx * z[4]
    return speed + c * away - s * forward, n * change


@compiled
def _speed(z: Array, numbers: Array, gradient: Array) -> float:
    distance, by = _rounded(z[0], z[1], z[2], numbers[5])
    speed, over = _rounded(z[3], z[4], z[5], numbers[6])
    for j in range(3):
        gradient[j], gradient[3 + j] = numbers[8] * z[j] / by, -z[3 + j] / over
    return float(numbers[7] + numbers[8] * distance - speed)


@compiled
def _velocity(z: Array, axis: int, limit: float, gradient: Array) -> float:
    gradient[:] = 0.0
    gradient[3 + axis] = -2 * z[3 + axis]
    return float(limit**2 - z[3 + axis] ** 2)


@compiled
def _passive(z: Array, radius: float, beyond: float, flight: Array, gradient: Array) -> float:
    distance, when = closest(z, beyond, flight)
    gradient[:] = 0.0
    if distance <= beyond:  # beyond, the row allows every input
        n, o = flight[0, 0], np.empty(3)
        s, c = np.sin(n * when), np.cos(n * when)
        _position(_parts(z, n), when, 2 * np.sin(n * when / 2) ** 2, s, o)
        _, by = _rounded(o[0], o[1], o[2], 1e-9)
        o /= by
        gradient[0], gradient[1] = o[0] * (4 - 3 * c) + o[1] * 6 * (s - n * when), o[1]
        gradient[2], gradient[5] = o[2] * c, o[2] * s / n
        gradient[3] = (o[0] * s - o[1] * 2 * (1 - c)) / n
        gradient[4] = o[0] * 2 * (1 - c) / n + o[1] * (4 * s / n - 3 * when)
    return float(distance - radius)


@compiled
def approaches(z: Array, beyond: float, flight: Array) -> tuple[Array, Array, Array]:
    """Distances (F,), times (F,) and places (F, 3) of the closest approaches of flights from z (F, 6)."""
    distance, when, place = np.empty(len(z)), np.empty(len(z)), np.empty((len(z), 3))
    n = flight[0, 0]
    for k in range(len(z)):
        distance[k], when[k] = closest(z[k], beyond, flight)
        angle = n * when[k]
        _position(_parts(z[k], n), when[k], 2 * np.sin(angle / 2) ** 2, np.sin(angle), place[k])
    return distance, when, place


@compiled
def _parts(z: Array, n: float) -> Array:
    """As `polaris.inspection.closest.flight_parts`, of one flight, but first where it starts: (4, 3).

    ``p(t) = p(0) + b t - c (1 - cos(n t)) + d sin(n t)`` has no differences of large numbers.
    """
    parts = np.zeros((4, 3))
    parts[0] = z[:3]
    parts[1, 1] = -6 * n * z[0] - 3 * z[4]
    parts[2, 0], parts[2, 1], parts[2, 2] = -3 * z[0] - 2 / n * z[4], 2 / n * z[3], z[2]
    parts[3, 0], parts[3, 1], parts[3, 2] = z[3] / n, 6 * z[0] + 4 / n * z[4], z[5] / n
    return parts


@compiled
def _position(parts: Array, t: float, versine: float, sine: float, place: Array) -> None:
    for j in range(3):
        place[j] = parts[0, j] + parts[1, j] * t - parts[2, j] * versine + parts[3, j] * sine


@compiled
def _ends(parts: Array, n: float, t: float) -> tuple[float, float, float, float]:
    """Half the squared distance at a time, its rate and its bend; the squared speed."""
    sine, cosine, versine = np.sin(n * t), np.cos(n * t), 2 * np.sin(n * t / 2) ** 2
    half = rate = bend = speed = 0.0
    for j in range(3):
        circle = parts[2, j] * cosine + parts[3, j] * sine
        p = parts[0, j] + parts[1, j] * t - parts[2, j] * versine + parts[3, j] * sine
        v = parts[1, j] + n * (parts[3, j] * cosine - parts[2, j] * sine)
        half, rate, bend, speed = half + p * p / 2, rate + p * v, bend - n**2 * p * circle, speed + v * v
    return half, rate, bend + speed, speed


@compiled
def closest(z: Array, beyond: float, flight: Array) -> tuple[float, float]:
    """Distance and time of the closest approach of one flight; beyond a distance only a bound on it.

    `flight` (S + 2, 3) has n and the gains of speed, then of each instant t, 1 - cos(n t) and sin(n t).
    """
    n, count = flight[0, 0], len(flight) - 1
    parts, place, squares = _parts(z, n), np.empty(3), np.empty(count)
    nearest, largest = 0, 0.0
    for k in range(count):
        _position(parts, flight[k + 1, 0], flight[k + 1, 1], flight[k + 1, 2], place)
        squares[k] = place[0] ** 2 + place[1] ** 2 + place[2] ** 2
        largest = max(largest, squares[k])
        if squares[k] < squares[nearest]:
            nearest = k
    distance, when, length = np.sqrt(squares[nearest]), flight[nearest + 1, 0], flight[2, 0]
    gained = flight[0, 1] * np.sqrt(z[0] ** 2 + z[1] ** 2 + z[2] ** 2)
    gained += flight[0, 2] * np.sqrt(z[3] ** 2 + z[4] ** 2 + z[5] ** 2)
    bound = distance - gained * (length / 2)
    if bound > beyond:
        return bound, when
    circle = 0.0
    for j in range(3):
        circle += parts[2, j] ** 2 + parts[3, j] ** 2
    pull = n**2 * np.sqrt(circle)
    reach = np.sqrt(largest) + pull * (length**2 / 8)
    drop = squares[nearest] / 2 + reach * (pull * (length**2 / 8))
    _, rate, _, speed = _ends(parts, n, 0.0)
    for k in range(count - 1):
        _, after, _, speed_after = _ends(parts, n, flight[k + 2, 0])
        half = length / 2
        if squares[k] / 2 - drop + rate * half < 0 or squares[k + 1] / 2 - drop - after * half < 0:
            fastest = np.sqrt(max(speed, speed_after)) + pull * half
            quartic = pull * (3 * pull + n * (4 * fastest + n * reach))
            span = flight[k + 1, 0], flight[k + 2, 0]
            distance, when = _searched(parts, n, quartic, span, distance, when)
        rate, speed = after, speed_after
    return distance, when


@compiled
def _searched(
    parts: Array, n: float, quartic: float, span: tuple[float, float], distance: float, when: float
) -> tuple[float, float]:
    """The least distance on a segment and its time, if it is less than the one found so far."""
    starts, ends, depths = np.empty(HALVINGS + 2), np.empty(HALVINGS + 2), np.zeros(HALVINGS + 2, np.int64)
    starts[0], ends[0], left = span[0], span[1], 1
    while left:
        left -= 1
        start, end, depth = starts[left], ends[left], depths[left]
        length, third = end - start, (end - start) / 3
        half_1, rate_1, bend_1, _ = _ends(parts, n, start)
        half_2, rate_2, bend_2, _ = _ends(parts, n, end)
        convex, at = min(bend_1, bend_2) > quartic * (length**2 / 8), (start + end) / 2
        if convex:
            if not (rate_1 < 0 and rate_2 > 0):
                continue
            at = _newton(parts, n, start, end, start + length * rate_1 / (rate_1 - rate_2))
        else:
            least = min(min(half_1, half_2), min(half_1 + rate_1 * third, half_2 - rate_2 * third))
            if not least - quartic * (length**4 / 384) < max(distance - TOLERANCE, 0.0) ** 2 / 2:
                continue
        here = np.sqrt(2 * _ends(parts, n, at)[0])
        if here < distance:
            distance, when = here, at
        if not convex and depth < HALVINGS - 1:
            starts[left], ends[left], depths[left] = start, at, depth + 1
            starts[left + 1], ends[left + 1], depths[left + 1] = at, end, depth + 1
            left += 2
    return distance, when


@compiled
def _newton(parts: Array, n: float, low: float, high: float, at: float) -> float:
    """Minimum of a convex q between two times, where its rate changes its sign."""
    for _ in range(NEWTON):
        _, rate, bend, _ = _ends(parts, n, at)
        if rate < 0:
            low = at
        else:
            high = at
        step = at - rate / bend if bend > 0 else low
        after = step if bend > 0 and low <= step <= high else (low + high) / 2
        moved, at = abs(after - at), after
        if moved < 1e-7:
            break
    return at
