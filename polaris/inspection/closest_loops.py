"""Closest approaches of free flights, and motions within a period, in loops for numba to compile.

Formulas are those of `polaris.inspection.closest` and `polaris.inspection.constraints.motion`, which are what
these loops are tested against, to rounding; the accounts of what they mean are there.
"""

import numpy as np

from ..model.compiled import compiled
from ..model.system import Array

TOLERANCE, NEWTON, HALVINGS = 1e-6, 40, 40  # as in `polaris.inspection.closest`
Two = tuple[float, float]


@compiled
def approaches(x: Array, pairs: Array, beyond: float, flight: Array) -> Array:
    """Closest approaches of deputies at states x (R, N, 6) and of `pairs` (P, 2), relative to each other.

    Distances, times, and places of those that are not beyond, (R, N + P, 5).
    """
    runs, deputies, n, z = len(x), x.shape[1], flight[0, 0], np.empty(6)
    out = np.zeros((runs, deputies + len(pairs), 5))
    for r in range(runs):
        for k in range(deputies + len(pairs)):
            first = k if k < deputies else pairs[k - deputies, 0]
            for j in range(6):
                z[j] = x[r, first, j] - (x[r, pairs[k - deputies, 1], j] if k >= deputies else 0.0)
            distance, time = closest(z, beyond, flight)
            out[r, k, 0], out[r, k, 1] = distance, time
            if distance <= beyond:
                angle = n * time
                _position(_parts(z, n), time, 2 * np.sin(angle / 2) ** 2, np.sin(angle), out[r, k, 2:])
    return out


@compiled
def motions(x: Array, pairs: Array, inputs: Array, numbers: Array) -> Array:
    """Bounds as of `Motion`, (R, N + P, 5); of known thrust if it is `inputs` (R, N, 3), not (1, 0, 3).

    For `numbers` see `polaris.inspection.loops.rows`.
    """
    runs, deputies, n, D, growth = len(x), x.shape[1], numbers[0], numbers[11], numbers[13]
    out, has_inputs = np.empty((runs, deputies + len(pairs), 5)), inputs.shape[1] > 0
    z, push = np.empty(6), np.zeros(3)
    for r in range(runs):
        for k in range(deputies + len(pairs)):
            thrust, spread = (1.0 if k < deputies else 2.0) * numbers[14], 1 - 1 / np.sqrt(3)
            one, two = (k, -1) if k < deputies else (pairs[k - deputies, 0], pairs[k - deputies, 1])
            for j in range(6):
                z[j] = x[r, one, j] - (x[r, two, j] if two >= 0 else 0.0)
            if has_inputs:
                for j in range(3):
                    push[j] = (inputs[r, one, j] - (inputs[r, two, j] if two >= 0 else 0.0)) * numbers[1]
                thrust, spread = np.sqrt(push[0] ** 2 + push[1] ** 2 + push[2] ** 2), 0.0
            ax, ay = 3 * n**2 * z[0] + 2 * n * z[4] + push[0], push[1] - 2 * n * z[3]
            a = np.sqrt(ax**2 + ay**2 + (push[2] - n**2 * z[2]) ** 2) + (0.0 if has_inputs else thrust)
            speed = np.sqrt(z[3] ** 2 + z[4] ** 2 + z[5] ** 2)
            a = (a + 3 * n**2 * speed * D) * growth
            fastest = speed + a * D
            out[r, k, 0], out[r, k, 1], out[r, k, 2] = fastest, a, 3 * n**2 * fastest + 2 * n * a
            out[r, k, 3], out[r, k, 4] = thrust, a - spread * thrust
    return out


@compiled
def _parts(z: Array, n: float) -> Array:
    """Return p(0), b, c, d of ``p(0) + b t - c (1 - cos(n t)) + d sin(n t)``, shape (4, 3)."""
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
def closest(z: Array, beyond: float, flight: Array) -> Two:
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
    distance, time, length = np.sqrt(squares[nearest]), flight[nearest + 1, 0], flight[2, 0]
    speed_bound = flight[0, 1] * np.sqrt(z[0] ** 2 + z[1] ** 2 + z[2] ** 2)
    speed_bound += flight[0, 2] * np.sqrt(z[3] ** 2 + z[4] ** 2 + z[5] ** 2)
    bound = distance - speed_bound * (length / 2)
    if bound > beyond:
        return bound, time
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
            distance, time = _searched(parts, n, quartic, span, distance, time)
        rate, speed = after, speed_after
    return distance, time


@compiled
def _searched(parts: Array, n: float, quartic: float, span: Two, distance: float, time: float) -> Two:
    """The least distance on a segment and its time, if it is less than the one found so far."""
    starts, ends, depths = np.empty(HALVINGS + 2), np.empty(HALVINGS + 2), np.zeros(HALVINGS + 2, np.int64)
    starts[0], ends[0], pending = span[0], span[1], 1
    while pending:
        pending -= 1
        start, end, depth = starts[pending], ends[pending], depths[pending]
        length, third = end - start, (end - start) / 3
        half_1, rate_1, bend_1, _ = _ends(parts, n, start)
        half_2, rate_2, bend_2, _ = _ends(parts, n, end)
        convex, instant = min(bend_1, bend_2) > quartic * (length**2 / 8), (start + end) / 2
        if convex:
            if not (rate_1 < 0 and rate_2 > 0):
                continue
            instant = _newton(parts, n, start, end, start + length * rate_1 / (rate_1 - rate_2))
        else:
            lower = min(min(half_1, half_2), min(half_1 + rate_1 * third, half_2 - rate_2 * third))
            if not lower - quartic * (length**4 / 384) < max(distance - TOLERANCE, 0.0) ** 2 / 2:
                continue
        trial = np.sqrt(2 * _ends(parts, n, instant)[0])
        if trial < distance:
            distance, time = trial, instant
        if not convex and depth < HALVINGS - 1:
            starts[pending], ends[pending], depths[pending] = start, instant, depth + 1
            starts[pending + 1], ends[pending + 1], depths[pending + 1] = instant, end, depth + 1
            pending += 2
    return distance, time


@compiled
def _newton(parts: Array, n: float, low: float, high: float, time: float) -> float:
    """Minimum of a convex q between two times, where its rate changes its sign."""
    for _ in range(NEWTON):
        _, rate, bend, _ = _ends(parts, n, time)
        if rate < 0:
            low = time
        else:
            high = time
        step = time - rate / bend if bend > 0 else low
        after = step if bend > 0 and low <= step <= high else (low + high) / 2
        change, time = abs(after - time), after
        if change < 1e-7:
            break
    return time
