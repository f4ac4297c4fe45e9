"""How far the state that flight software predicts may be from the true one; what instants and pulses add."""

from contextlib import suppress
from dataclasses import replace

import numpy as np
from scipy.linalg import expm, solve_discrete_are

from reach.numerics.errors import ReachError
from reach.numerics.linear import powers
from reach.tubes.flow import LinearFlow

from .craft import Array, Craft, lead_of
from .errors import ScenarioError
from .timing import Observer, Timing

PARTS = 32  # parts of a prediction over each of which integrals are bounded by the trapezoid rule

IN_PERIOD = 4  # the same of a control period of an observer

ROUNDED = 1e-9  # relative round-off of a bound, upwards

SCATTER = 0.4
"""Share of their bounds by which measurements scatter in the design of a gain; any gain is sound."""

ROUNDS, SPARE = 100, 1e-3
"""Most rounds until a bound holds that allows for the errors which it causes, and what each adds to it."""

LEFT_OVER, LONGEST = 1e-2, 4096
"""What of an error counts as forgotten, as a share of itself, and the most periods that may take."""

SHARES, CALM = (1.0, 0.3, 0.1, 0.05, 0.03), 0.02
"""Shares of the thrust for whose errors gains are designed, and the one at which S flies once settled."""

UNSEEN = 1e-6  # share of the thrust limits that is taken for unknown, so that every gain forgets

AT_NODES = 1e-6
"""Share of what pulses displace at most within a billionth of a period of its ends, where it is nothing."""

PLACES = {"": (8, 32, 62), "start": (4, 54, 96), "staggered": (4, 32, 62)}
"""By place of pulses, divisors of ``f h``, ``f h^2`` and ``f h^3`` that bound the impulse by which pulses of
thrust f differ from held inputs, its integral without the mean, and the integral of the size of that."""


def prediction_error(system: Craft, estimate: Array, thruster: Array, tau: float) -> Array:
    """Bound on the error of the state predicted over tau [s] from an estimate, shape (n,).

    The prediction follows the model under the commands in force, which are known: what is left is the error
    of the estimate (n,) carried along, the disturbance, and errors of what is applied (m,), each at its
    worst (docs/theory.md, Proposition 7 (a)). Rounded upwards; the estimate itself for tau = 0.
    """
    if not tau > 0:
        return estimate
    E = system.error_map(thruster)
    flow = LinearFlow.continuous(system.A, system.D, system.w_max, tau / PARTS, E)
    pushed = flow.disturbance_support(np.eye(system.n), PARTS)[-1]
    carried = np.abs(np.linalg.matrix_power(flow.phi, PARTS)) @ estimate
    return np.asarray((carried + pushed) * (1 + ROUNDED))


def unseen_by(system: Craft, tau: float) -> Array:
    """What a unit of errors that are `entering` may add to a prediction over tau [s], shape (n, k)."""
    if not tau > 0:
        return np.zeros(system.entering.shape)
    flow = LinearFlow.continuous(system.A, system.D, system.w_max, tau / PARTS)
    gains = flow.input_gains(np.eye(system.n), system.entering, PARTS).sum(axis=0)
    return np.asarray(gains * (1 + 10 * ROUNDED))


def filtered(system: Craft, observer: Observer, h: float, moved: Array | float = 0.0) -> Array:
    """Bound on the errors of the estimates of an observer that has long been at work, shape (n,).

    Just after a measurement, with every pattern of missed periods that may be. `moved` bounds by how much
    states are displaced when they are measured (docs/theory.md, Proposition 7 (c)).

    Raises
    ------
    ScenarioError
        If errors are not forgotten.
    """
    noise = observer.noise + np.abs(observer.measures) @ np.broadcast_to(moved, (system.n,))
    loop, last, count = forgetting(system, observer, h)
    left, updates = powers(loop, count + len(observer.after)), len(observer.after) + 1
    E = system.error_map(system.thrusters.error(system.u_max))
    flow = LinearFlow.continuous(system.A, system.D, system.w_max, h / IN_PERIOD, E)
    come, turned = [], []  # what an update adds so many periods later, and makes otherwise than the loop
    for j, (gain, rest) in enumerate(zip((observer.gain, *observer.after), observer.rests, strict=True)):
        pushed = flow.disturbance_support((left @ rest).reshape(-1, system.n), IN_PERIOD * (j + 1))[-1]
        come.append(pushed.reshape(left.shape[:2]) + np.abs(left @ gain) @ noise)
        other = rest @ expm(system.A * h * (j + 1)) - np.linalg.matrix_power(loop, j + 1)
        turned.append(np.abs(left @ other) if j else 0 * left)

    def most(known: Array) -> Array:
        """Errors if those so many periods before were within `known`, by the worst pattern."""
        sums = np.zeros((count + updates, system.n))
        each = [more + off @ known for more, off in zip(come, turned, strict=True)]
        for age in range(count):
            for j, more in enumerate(each):
                sums[age + j + 1] = np.maximum(sums[age + j + 1], sums[age] + more[age])
        sums[count:] += np.abs(left[count:]) @ known
        if updates > 1 and observer.initial is not None:  # from the first estimate on, and then for ever
            sums[:count] += np.abs(left[:count]) @ observer.initial
        return np.asarray(np.max(sums[0 if updates > 1 else count :], axis=0) * (1 + ROUNDED))

    found = np.asarray(np.linalg.solve(np.eye(system.n) - last, most(np.zeros(system.n))) * (1 + ROUNDED))
    for _ in range(ROUNDS if updates > 1 else 0):
        if np.all((more := most(found)) <= found):
            return found
        found = np.maximum(found, more * (1 + SPARE))
    if updates > 1:
        raise ScenarioError("timing.missed_periods", updates - 1, "leave errors that no observer forgets")
    return found


def forgetting(system: Craft, observer: Observer, h: float) -> tuple[Array, Array, int]:
    """What a period makes of errors of the estimate, and bounds on what so many periods leave of them.

    Raises what `filtered` does.
    """
    loop, count = observer.rest @ np.asarray(expm(system.A * h)), 1
    while True:
        with np.errstate(over="ignore", invalid="ignore"):
            last = np.abs(np.linalg.matrix_power(loop, count))
        if np.all(np.isfinite(last)) and np.max(np.abs(np.linalg.eigvals(last))) <= LEFT_OVER:
            return loop, last, count
        if count >= LONGEST or not np.all(np.isfinite(last)):
            rule = "leave errors of the estimate that no filter forgets"
            raise ScenarioError("navigation.measurement", observer.measures.tolist(), rule)
        count *= 2


def fading(system: Craft, observer: Observer, h: float, steps: int, periods: int) -> Array:
    """What the first errors of an observer still add in steps of some periods, and ever after, (K + 1, n).

    Raises what `filtered` does.
    """
    (loop, last, count), first = forgetting(system, observer, h), steps * periods
    left = np.abs(powers(loop, first + count - 1)) @ np.asarray(observer.initial) * (1 + ROUNDED)
    ever = np.linalg.solve(np.eye(system.n) - last, left[first:].max(axis=0)) * (1 + ROUNDED)
    return np.vstack([left[:first].reshape(steps, periods, -1).max(axis=1), ever])


def observing(system: Craft, observer: Observer, h: float, moved: Array | float = 0.0) -> Craft:
    """The system whose estimates are those of an observer; `moved` and errors are those of `filtered`."""
    found = filtered(system, observer, h, moved)
    if (left := observer.fading) is None:
        return replace(system, observer=observer, estimate_error=found)
    return replace(system, observer=replace(observer, settled=found), error_by_step=found + left)


def design(
    system: Craft, measures: Array, noise: Array, h: float, missed: int = 0, boxed: bool = False
) -> Observer:
    """Design the observer of measurements (r, n) off by `noise` (r,) at most, with a steady Kalman gain.

    Of gains made for shares of the thrust it takes the one whose errors nearly without thrust are the least
    beside those of the best; if `boxed`, those at full thrust count too, as a box for all that may be
    commanded stands for the estimate then. After some of up to `missed` periods without any
    measurement, either the gain that does at once what it would have done in each of them, or the Kalman
    gain of then: whichever leaves smaller errors.

    Raises
    ------
    ScenarioError
        If measurements do not see a motion that does not decay.
    """
    first, *others = SHARES if system.thrusters.proportional else SHARES[:1]
    found = [_designed(system, measures, noise, h, missed, first)]
    for share in others:
        with suppress(ScenarioError):
            found.append(_designed(system, measures, noise, h, missed, share))
    if len(found) == 1:
        return found[0]
    known = [replace(system, u_max=CALM * system.u_max), *[system] * boxed]
    sizes = np.array([[filtered(each, one, h) for each in known] for one in found])
    worse = (sizes / np.maximum(sizes.min(axis=0), 1e-300)).sum(axis=(1, 2))
    return found[int(np.argmin(worse))]


def _designed(system: Craft, measures: Array, noise: Array, h: float, missed: int, share: float) -> Observer:
    """Design an observer for errors of thrusters under a share of their limits."""
    unknown = np.hstack([system.D * system.w_max, system.B * system.thrusters.error(share * system.u_max)])
    unknown = np.hstack([unknown, system.B * (UNSEEN * system.u_max)])
    step, excited = expm(system.A * h), expm(system.A * h / 2) @ unknown * h
    covariance = np.diag((noise * SCATTER) ** 2)
    try:
        P = solve_discrete_are(step.T, measures.T, excited @ excited.T, covariance)
        steady = Observer(measures, noise, _kalman(P, measures, covariance))
    except (np.linalg.LinAlgError, ValueError) as error:
        rule = f"must see every motion that does not decay: there is no steady gain ({error})"
        raise ScenarioError("navigation.measurement", measures.tolist(), rule) from error
    if not missed:
        return steady
    loop, prompt, later = steady.rest @ step, [], []
    for j in range(2, missed + 2):
        P = step @ P @ step.T + excited @ excited.T
        later.append(_kalman(P, measures, covariance))
        whole = np.eye(system.n) - np.linalg.matrix_power(loop, j) @ expm(-system.A * h * j)
        prompt.append(whole @ np.linalg.pinv(measures))
    plain, found = filtered(system, steady, h), list[tuple[float, Observer]]()
    for after in (prompt, later):
        observer = replace(steady, after=tuple(after))
        with suppress(ScenarioError):
            size = filtered(system, observer, h) / np.maximum(plain, 1e-300)
            found.append((float(size.sum()), observer))
    return min(found, key=lambda each: each[0])[1] if found else observer


def _kalman(P: Array, measures: Array, covariance: Array) -> Array:
    """The gain of a Kalman filter with covariances of what is predicted and of what is measured."""
    return np.asarray(np.linalg.solve(measures @ P @ measures.T + covariance, measures @ P).T)


def pulse_error(system: Craft, fired: Array, h: float) -> tuple[float, Array]:
    """Bound what pulses of the thrust `fired` (m,) add to inputs held for h [s], leads apart.

    Errors of the thrusters hold for a period.

    Returns
    -------
    error : float
        Of every input [N].
    within : ndarray, shape (n,)
        Displacement within a period, none at its ends.

    Raises
    ------
    ScenarioError
        If inputs that are linear in time cannot do that: too few of them for the states.
    """
    A, B, m = system.A, system.B, system.m
    each = (fired * (h**power / by) for power, by in enumerate(PLACES[system.timing.placed], 1))
    speed, way, lasting = (part + system.thrusters.part(part) for part in each)
    inverse = _spreading(system, h)
    growth, bent = expm(np.abs(A) * h), A @ A @ B
    shape = np.abs(inverse @ bent) + h / 2 * np.abs(inverse) @ np.abs(A) @ growth @ np.abs(bent)
    spread = (shape[:m] + shape[m:]) @ lasting * (1 + ROUNDED)
    within = np.abs(B) @ speed + np.abs(A @ B) @ way + h * growth @ (np.abs(bent) @ way + np.abs(B) @ spread)
    rounding = float(np.finfo(float).eps * fired.max())  # where next to nothing is left of larger numbers
    return float(spread.max()) + rounding, np.asarray(within * (1 + ROUNDED))


def _spreading(system: Craft, h: float) -> Array:
    """Which inputs, constant and linear in time over a period of h [s], move the state at its middle."""
    A, B, n = system.A, system.B, system.n
    block = np.zeros((3 * n, 3 * n))
    block[:n, :n], block[:n, n : 2 * n], block[n : 2 * n, 2 * n :] = -A, np.eye(n), np.eye(n)
    once, twice = (expm(block * h)[:n, i * n : (i + 1) * n] for i in (1, 2))
    moments = expm(A * h / 2) @ np.hstack([once @ B, (once - 2 / h * twice) @ B])
    if np.linalg.matrix_rank(moments) < n:
        rule = "is not covered for a system with fewer inputs than half its states, or states that none moves"
        raise ScenarioError("thrusters.pulse", system.timing.placed or "centred", rule)
    return np.linalg.pinv(moments)


def when_measured(timing: Timing, h: float, away: Array) -> Array:
    """Add to displacements at nodes (n,) those by pulses of periods of h [s] when states are measured."""
    off = abs(timing.delay - h * round(timing.delay / h)) > ROUNDED / 2 * h
    return np.asarray(away + (1.0 if off else AT_NODES * bool(timing.delay)) * np.array(timing.pulsed or 0.0))


def predicting(system: Craft, timing: Timing, period: float | None) -> Craft:
    """The system whose controllers act on predictions, of every age that may occur, with jitter or pulses.

    Raises
    ------
    ScenarioError
        If the system is so unstable that nothing bounds a prediction.
    """
    h, exact = period or 0.0, system.thrusters
    late = 0.0 if timing.fired or not timing.jitter else 2 * timing.jitter / h
    layout = None if system.nozzles is None else system.m
    thrusters, timing = exact.stretched(late, layout), replace(timing, on_time=exact, period=h)
    if late and layout:  # which make more than is commanded of what they have left
        thrusters = thrusters.raised(2 * late * timing.carried / h * (1 + ROUNDED))
    system = replace(system, timing=timing, thrusters=thrusters)
    away = moved = system.carried_away + np.abs(system.B) @ system.shifted * (1 + ROUNDED)
    if timing.fired:
        bit, within = pulse_error(system, np.array(timing.fired), h)
        timing = replace(timing, pulsed=tuple(within.tolist()), lead=lead_of(system, h))
        away, moved = when_measured(timing, h, moved), moved + within
        system = replace(system, thrusters=exact.raised(bit))
    timing = replace(timing, displaced=tuple(moved.tolist()))
    system = replace(system, timing=timing)
    if system.observer is not None:  # of the motion under inputs that are held
        system = observing(system, system.observer, h, away)
    steps = system.navigation[None] if system.error_by_step is None else system.error_by_step
    timing = replace(timing, measured=tuple(np.max(steps, axis=0).tolist()))
    least, ages = system.thrusters.error(0 * system.u_max), timing.delay + h * np.arange(timing.missed + 1)
    known, of_step = np.unique(steps + away, axis=0, return_inverse=True)
    still = system if timing.lead is None else replace(system, timing=replace(timing, lead=timing.lead.least))
    try:
        errors = [[prediction_error(still, each, least, age) for each in known] for age in ages.tolist()]
        unseen = unseen_by(system, ages[-1])
    except ReachError as error:
        rule = f"is too long for this system, a prediction over {ages[-1]:g} s has no bound: {error}"
        raise ScenarioError("timing.delay_s", timing.delay, rule) from error
    found = np.max(errors, axis=0) + unseen @ system.grown(system.u_max)
    system = replace(system, timing=replace(timing, unseen=tuple(map(tuple, unseen.tolist()))))
    by_step = None if len(steps) == 1 else found[of_step.ravel()]
    return replace(system, estimate_error=np.max(found, axis=0), error_by_step=by_step)
