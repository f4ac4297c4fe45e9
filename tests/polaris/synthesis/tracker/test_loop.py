"""Theorem 3 against flight software coded by itself: exact at nodes, never below a flight."""

from dataclasses import replace
from functools import cache, lru_cache
from itertools import product

import numpy as np
import pytest
from scipy.linalg import expm, solve_continuous_are, solve_discrete_are

from polaris.model.errors import ScenarioError
from polaris.model.thrusters import Thrusters
from polaris.model.timing import Observer
from polaris.synthesis.sources.delay import Delay
from polaris.synthesis.sources.disturbance import Disturbance
from polaris.synthesis.sources.estimate import Estimate
from polaris.synthesis.sources.impulse_bit import CarriedImpulse
from polaris.synthesis.sources.observer import Filter
from polaris.synthesis.sources.thrusters import ThrusterErrors
from polaris.synthesis.tracker.loop import Loop
from polaris.synthesis.tracker.tightening import Tightening
from reach.numerics.linear import powers
from tests.polaris.flight_software import CELLS, Software


def hill():
    n, A = 0.005, np.zeros((6, 6))
    A[:3, 3:] = np.eye(3)
    A[3, 0], A[3, 4], A[4, 3], A[5, 2] = 3 * n**2, 2 * n, -2 * n, -(n**2)
    push = np.vstack([np.zeros((3, 3)), np.eye(3)])
    return A, push / 10, push, 2.0, [1.0] * 3 + [50.0] * 3, 4e3


def chain():
    return np.eye(2, k=1), np.array([[0], [0.5]]), np.array([[0], [1.0]]), 1.0, [0.002, 0.06], 10.0


def lagging():
    """Actuator that follows its command within 1.5 s."""
    A = np.eye(3, k=1)
    A[2, 2] = -1 / 1.5
    return A, np.array([[0], [0], [1 / 1.5]]), np.array([[0], [1.0], [0]]), 1.0, [2e-4, 0.01, 0.0], 5.0


def plane():
    """Two axes that meet through the errors of thrusters alone."""
    push = np.vstack([np.zeros((2, 2)), np.eye(2)])
    return np.eye(4, k=2), push / 2, push, 1.0, [0.002] * 2 + [0.06] * 2, 10.0


PLANTS = {"hill": hill, "chain": chain, "lagging": lagging, "plane": plane}
W, BIT = 1e-3, 5e-3  # disturbance, impulse bit
SOURCES = [  # navigation, delay in periods, impulses carried
    ("", 0, False),
    ("estimate", 0, False),
    *(("estimate", d, False) for d in (1, 3, 0.5, 1.4)),
    *(("observer", d, False) for d in (0, 1, 0.5, 1.4)),
    ("", 0, True),
    ("estimate", 1.4, True),
    ("observer", 1.4, True),
]


def sizes(nav, n):
    """Bounds on the errors of estimates, or of measured positions."""
    count = {"": 0, "estimate": n, "observer": max(n // 2, 1)}[nav]
    return np.where(np.arange(n) < (n + 1) // 2, 0.05, 0.004)[:count]


@cache
def software(plant, nav="", delay=0, carried=False, u_max=np.inf):
    A, B, D, h, Q, r = PLANTS[plant]()
    n, gain = len(A), B.T @ solve_continuous_are(A, B, np.diag(Q), r * np.eye(B.shape[1])) / r
    soft = Software(A, B, D, h, gain, delay * h, bit=BIT if carried else 0.0, u_max=u_max)
    if nav != "observer":
        return soft
    M, R = np.eye(n)[: max(n // 2, 1)], np.diag(sizes(nav, n) ** 2)
    S = solve_discrete_are(expm(A * h).T, M.T, D @ D.T * 1e-4 + 1e-8 * np.eye(n), R)
    return replace(soft, measures=M, correction=S @ M.T @ np.linalg.inv(M @ S @ M.T + R))


def bounds(soft, nav, w=W, errors=None, noise=None, scale=None):
    """Tightening of the loop of a flight software."""
    n, m = soft.B.shape
    noise = sizes(nav, n) if noise is None else noise
    loop = Loop.from_plant(soft.A, soft.B, soft.h)
    if soft.delay:
        loop = Delay(soft.delay).extend(loop)
    if soft.bit:
        loop = CarriedImpulse(soft.bit, 0.0 if errors is None else errors.along).extend(loop)
    if nav == "estimate":
        loop = Estimate(noise).extend(loop)
    if nav == "observer":
        loop = Filter(Observer(soft.measures, noise, soft.correction), np.zeros(n)).extend(loop)
    loop = Disturbance(soft.D, w).extend(loop)
    if errors is not None:
        more = errors.across * np.sqrt(m - 1) * soft.bit / soft.h  # errors of what is made (Lemma 6 (c))
        loop = ThrusterErrors(replace(errors, bit=errors.bit + more)).extend(loop)
    return Tightening(
        loop.close(soft.gain), np.full(m, soft.u_max), np.ones(loop.N) if scale is None else scale
    )


def rows_of(limits):
    """Rows of all states of the plant, and of the commands."""
    n, N = limits.closed.loop.n, limits.closed.loop.N
    return np.vstack([np.eye(n, N), limits.closed.K])


def unit_flights(soft, nav, periods):
    """Fly a unit of every input of period 0; states and commands at nodes, (periods + 1, inputs, rows)."""
    (n, m), k = soft.B.shape, soft.D.shape[1]
    q = len(sizes(nav, n))
    inputs, first = CELLS * k + q + (m if soft.bit else 0), int(nav == "observer")
    kicks, noise, rest = np.zeros((CELLS, inputs, n)), np.zeros((inputs, q)), np.zeros((inputs, m))
    for j in range(CELLS):
        kicks[j, j * k : (j + 1) * k] = soft.D.T
    noise[CELLS * k : CELLS * k + q] = np.eye(q)
    rest[CELLS * k + q :] = np.eye(m) if soft.bit else 0
    seen = (lambda i: noise * (i == first)) if nav else (lambda i: 0.0)
    flight = soft.fly(periods + 1, inputs, kicks=kicks, noise=seen, remainder=lambda i, s: rest * (i == 0))
    states = np.array(flight.x[: periods * CELLS + 1 : CELLS])
    return np.concatenate([states, np.array(flight.feedback)], axis=2), CELLS * k, q


@pytest.mark.parametrize("plant", ["hill", "chain", "lagging"])
@pytest.mark.parametrize(("nav", "delay", "carried"), SOURCES)
def test_bounds_from_rest_are_the_sum_of_absolute_responses(plant, nav, delay, carried):
    soft = software(plant, nav, delay, carried)
    lags, (n, m) = [1, 2, 10, 100], soft.B.shape
    flown, pushes, q = unit_flights(soft, nav, 100)
    vectors = flown[1:, :pushes].reshape(100, CELLS, -1, n + m)
    forced = W * soft.h / CELLS * np.linalg.norm(vectors, axis=2).sum(axis=1)
    other = np.abs(flown[1:, pushes:])
    sampled = np.tensordot(other[:, :q], sizes(nav, n), (1, 0)) if q else 0.0
    sampled = sampled + BIT * other[:, q:].sum(axis=1)
    limits, still = bounds(soft, nav), bounds(soft, nav, w=0.0)
    answer, calm = limits.from_rest(rows_of(limits)), still.from_rest(rows_of(still))
    for L in lags:
        np.testing.assert_allclose(calm[L], np.broadcast_to(sampled, (100, n + m))[:L].sum(axis=0), rtol=1e-8)
        exact = (forced + sampled)[:L].sum(axis=0)
        assert np.all(answer[L] >= exact * (1 - 1e-6))
        assert np.all(answer[L] <= exact * 1.004), (answer[L] / exact).max()


@lru_cache(maxsize=2)
def responses(soft, nav, periods):
    """Fly a unit of every input, constant in a cell of period 0 or in the measurement of node 0.

    Returns, by name of the input, states at ends of cells (instants, cells, inputs, n) and feedback at nodes.
    """
    m, q = soft.B.shape[1], len(sizes(nav, len(soft.A)))
    shapes = {"w": (CELLS, soft.D.shape[1]), "errors": (CELLS, m), "noise": (1, q), "rest": (1, m)}
    ends = np.cumsum([0] + [cells * size for cells, size in shapes.values()])
    given = {}
    for (name, (cells, size)), first in zip(shapes.items(), ends, strict=False):
        given[name] = np.zeros((cells, ends[-1], size))
        for j in range(cells):
            given[name][j, first + j * size : first + (j + 1) * size] = np.eye(size)
    flight = soft.fly(
        periods + 1,
        ends[-1],
        w=lambda i: given["w"] * (i == 0),
        errors=lambda i, v: given["errors"] * (i == 0),
        noise=(lambda i: given["noise"][0] * (i == 0)) if nav else (lambda i: 0.0),
        remainder=lambda i, s: given["rest"][0] * (i == 0),
    )
    answer = []
    for values in (np.array(flight.x), np.array(flight.feedback)):
        parts = np.split(values, ends[1:-1], axis=1)
        shaped = (
            p.reshape(len(p), *shape, p.shape[2]) for p, shape in zip(parts, shapes.values(), strict=True)
        )
        answer.append(dict(zip(shapes, shaped, strict=True)))
    return answer


def others(v):
    """Return the 2-norm of the other inputs, by input."""
    return np.sqrt(np.maximum((v**2).sum(axis=-1, keepdims=True) - v**2, 0.0))


def adjoint_of_commands(errors, adjoint, v):
    """Push on the commands v (runs, m) by errors that follow their adjoint (cells, runs, m)."""
    weight, ratio = np.abs(adjoint).sum(axis=0), 1 / np.maximum(others(v), 1e-300)
    across = np.abs(v) * ((weight * ratio) @ (1 - np.eye(v.shape[1])))
    return (errors.along * weight + errors.across * across) * np.sign(v)


def attack(soft, nav, targets, errors, rounds=2, before=None, reference=None, turn=None, w=W, noise=None):
    """Fly the worst against targets (row (n,), instant in cells), one a run.

    Every input follows the sign of its adjoint; errors in proportion to commands enter the adjoint with the
    commands of the last round. `before` (periods, function of input, period and runs) flies first: instants
    count from its end. `reference` chooses the reference's input from the adjoints; it fixes the commands.
    """
    (n, m), R = soft.B.shape, len(targets)
    rows, at = np.array([row for row, _ in targets]), np.array([t for _, t in targets])
    noise = sizes(nav, n) if noise is None else noise
    periods, (start, early) = -(-at.max() // CELLS), before or (0, None)
    states, commands = responses(soft, nav, periods)
    flown = None
    for _ in range(rounds):
        lam, push = [{} for _ in range(periods)], np.zeros((periods, R, m))
        for i in range(periods - 1, -1, -1):
            lag = at - i * CELLS
            for name, values in states.items():
                direct = np.einsum("rckn,rn->crk", values[np.maximum(lag, 0)], rows) * (lag > 0)[:, None]
                later = np.tensordot(commands[name][1 : periods - i], push[i + 1 :], ([0, 3], [0, 2]))
                lam[i][name] = direct + later.transpose(0, 2, 1)
            if flown is not None and reference is None:
                push[i] = adjoint_of_commands(errors, lam[i]["errors"], flown[i])
            lam[i]["noise"] = lam[i]["noise"] + push[i] @ commands["noise"][0, 0].T

        def forced(k, lam=lam):
            if k < start:
                return early("w", k, R)
            force = lam[k - start]["w"]
            return w * force / np.maximum(np.linalg.norm(force, axis=2, keepdims=True), 1e-300)

        def seen(k, lam=lam):
            if not nav or (k == 0 and nav == "observer"):  # at rest the first estimate is exact
                return 0.0
            return early("noise", k, R) if k < start else noise * np.sign(lam[k - start]["noise"][0])

        def made(k, v, lam=lam):
            if k < start:
                return early("errors", k, R)
            force = lam[k - start]["errors"]
            if turn is not None:
                return turn(force.mean(axis=0), v)
            return np.sign(force) * (errors.along * np.abs(v) + errors.across * others(v))

        chosen = {} if reference is None else {"reference": lambda k, f, c, lam=lam: reference(k, f, c, lam)}
        flight = soft.fly(start + periods, R, w=forced, noise=seen, errors=made, **chosen)
        flown = np.array(flight.made[start:])
    return flight


def shares(flight, targets, nodes, limits, P, start=0, z=None):
    """Check every instant of flights against the bounds; return the largest share reached at a target.

    The bounds start at the hand-over in the states z (runs, N): the chords of those at nodes, and the
    intersample bound.
    """
    n, N = limits.closed.loop.n, limits.closed.loop.N
    rows = np.eye(n, N)
    fixed, per_size = limits.between(rows[:, :n], np.atleast_2d(P)[0])
    tight, x = limits.from_rest(rows, P)[: nodes + 1], np.array(flight.x[start * CELLS :])
    z = np.zeros((x.shape[1], N)) if z is None else z
    own = np.einsum("lrn,pn->lpr", limits.carried(rows)[: nodes + 1], z)
    norm = np.max(np.abs(z) / limits.v, axis=1)
    f = (np.arange(nodes * CELLS + 1) % CELLS / CELLS)[:, None, None]
    k = np.arange(nodes * CELLS + 1) // CELLS
    after = np.minimum(k + 1, nodes)
    inside = (fixed + norm[:, None] * per_size[k][:, None]) * (f > 0)
    both = []
    for sign in (1, -1):
        bound = sign * own + tight[:, None]
        bound = (1 - f) * bound[k] + f * bound[after] + inside
        excess = sign * x[: len(k)] - bound
        scale = tight[-1] + np.abs(own).max(axis=(0, 1)) + fixed
        assert np.all(excess <= 1e-9 * scale), np.max(excess / scale)
        both.append(bound)
    reached = [
        (row @ x[t, i]) / (np.abs(row) @ both[int(row.sum() < 0)][t, i]) for i, (row, t) in enumerate(targets)
    ]
    return max(reached)


THRUSTERS = Thrusters.from_errors(0.05, np.deg2rad(2), 0.03, 0.0, 3)
CASES = [("", 0), ("estimate", 1.4), ("observer", 0), ("observer", 0.5), ("observer", 1.4)]


def some_targets(n, nodes):
    """Every state, at the last node, and within periods before."""
    instants = [nodes * CELLS, nodes * CELLS - 9]
    return [(row, t) for row, t in product(np.eye(n), instants)]


@pytest.mark.parametrize("plant", ["hill", "chain", "lagging"])
@pytest.mark.parametrize(("nav", "delay"), CASES)
def test_no_flight_exceeds_the_bounds_under_errors_in_proportion_to_commands(plant, nav, delay):
    soft, L = software(plant, nav, delay), 40
    n, m = soft.B.shape
    errors = Thrusters(0.2) if m == 1 else THRUSTERS
    limits, targets = bounds(soft, nav, errors=errors), some_targets(n, L)
    P = limits.settled_bound()
    flight = attack(soft, nav, targets, errors)
    assert np.all(np.abs(flight.feedback) <= P)
    feedback = shares(flight, targets, L, limits, P)

    def full(k, feedback, c, lam):
        return 2 * P - feedback

    flight = attack(soft, nav, targets, errors, rounds=1, reference=full)  # all commands are as large as 2 P
    everything = shares(flight, targets, L, limits, 2 * P)
    print(f"{plant} {nav} {delay}: share {feedback:.3f}, with a reference's input {everything:.3f}")
    assert feedback > 0.5 and everything > 0.99


def turned(rng, mass=0.03, size=0.05, angle=np.pi / 90):
    """Thrusters that apply (1 + a) of the command, turned by an angle, on a chaser of another mass."""

    def turn(aim, v):
        length = np.linalg.norm(v, axis=1, keepdims=True)
        along = v / np.maximum(length, 1e-300)
        if rng is not None:
            aim = rng.normal(size=v.shape)
        away = aim - (aim * along).sum(axis=1, keepdims=True) * along
        away = away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-300)
        up = np.sign((aim * v).sum(axis=1, keepdims=True))
        a, b = (
            (size * up, -mass * up)
            if rng is None
            else rng.uniform(-1, 1, (2, len(v), 1)) * [[[size]], [[mass]]]
        )
        t = angle if rng is None else angle * rng.uniform(size=(len(v), 1))
        return (1 + a) / (1 + b) * (np.cos(t) * v + np.sin(t) * length * away) - v

    return turn


@pytest.mark.parametrize(("nav", "delay"), [("estimate", 1.4), ("observer", 0.5)])
def test_no_flight_exceeds_the_bounds_under_thrusters_that_turn(nav, delay):
    soft, L = software("hill", nav, delay), 40
    limits, targets = bounds(soft, nav, errors=THRUSTERS), some_targets(6, L)
    P = limits.settled_bound()
    for rng in (None, np.random.default_rng(1)):
        flight = attack(soft, nav, targets, THRUSTERS, turn=turned(rng))
        share = shares(flight, targets, L, limits, P)
        print(f"{nav} {delay}: share {share:.3f}")
        assert share > 0.5


def handed_over(soft, nav, rng, size=20.0):
    """Large random signals before a hand-over, by input, the same in all flights."""
    (n, m), k = soft.B.shape, soft.D.shape[1]

    @cache
    def early(name, i, runs):
        shape = {"w": (CELLS, runs, k), "errors": (CELLS, runs, m), "noise": (runs, len(sizes(nav, n)))}[name]
        unit = {"w": W, "errors": W, "noise": sizes(nav, n)}[name]
        return size * unit * rng.uniform(-1, 1, shape)

    return early


def feedback_bound(limits, z, rounds=4):
    """Bounds on commands after a hand-over in z (runs, N), not growing, (N + 2, m)."""
    K, P = limits.closed.K, limits.settled_bound()
    start = np.abs(np.einsum("lmn,pn->lpm", limits.carried(K), z)).max(axis=1)
    while np.any(start + limits.from_rest(K, P)[-1] + limits.noise(P) > P):
        P = P * 1.5
    for _ in range(rounds):
        first = np.atleast_2d(P)[0]
        tight = limits.from_rest(K, P)
        bound = np.maximum(start + tight[:-1], 0) + limits.noise(first)
        last = tight[-1] + np.abs(limits.remainder(K)) * np.max(np.abs(z) / limits.v) + limits.noise(first)
        bound[-1] = np.maximum(bound[-1], last)
        P = np.minimum(np.maximum.accumulate(bound[::-1])[::-1], np.broadcast_to(P, bound.shape))
    return P


@pytest.mark.parametrize(
    ("plant", "nav", "delay"),
    [
        ("hill", "estimate", 1.4),
        ("hill", "observer", 0.5),
        ("hill", "observer", 1.4),
        ("chain", "observer", 0),
        ("chain", "observer", 3),
        ("lagging", "estimate", 1),
        ("lagging", "observer", 1.4),
    ],
)
def test_no_flight_exceeds_the_bounds_after_a_hand_over(plant, nav, delay):
    soft, L, before = software(plant, nav, delay), 40, 6
    n, m = soft.B.shape
    errors = Thrusters(0.2) if m == 1 else THRUSTERS
    targets = some_targets(n, L) * 2
    early, limits = handed_over(soft, nav, np.random.default_rng(7)), bounds(soft, nav, errors=errors)
    flight = attack(soft, nav, targets, errors, before=(before, early))
    z = soft.state(flight, before, nav == "observer")
    P = feedback_bound(limits, z)
    assert np.all(np.max(np.abs(flight.feedback[before:]), axis=1) <= P[:L] * (1 + 1e-12))
    share = shares(flight, targets, L, limits, P, before, z)
    print(f"{plant} {nav} {delay}: share {share:.3f}")
    assert share > 0.5


def quantised(soft, errors, P):
    """Choose commands within P, by the reference's input, that leave the worst remainders for the errors."""
    T = errors.along * np.eye(len(P)) + errors.across * (1 - np.eye(len(P)))
    bit, h, tiny = soft.bit, soft.h, 1e-7 * soft.bit

    def reference(k, feedback, c, lam):
        now = lam[k]["errors"].sum(axis=0)
        later = lam[k + 1]["errors"].sum(axis=0) if k + 1 < len(lam) else 0 * now
        gained = np.abs(later - now) + (np.abs(later) - np.abs(now)) @ T
        sign = np.where(later - now < 0, -1.0, 1.0)
        want = np.where(gained > 0, sign, 0.0) * (bit - tiny)
        sign = np.where(want == 0, np.where(c < 0, -1.0, 1.0), sign)
        multiples = np.maximum(np.floor((P * h - sign * (want - c)) / bit + 1e-3), 0)
        u = (sign * (multiples * bit + tiny / 2) + want - c) / h
        return u - feedback  # at most 2 tiny / h above P

    return reference


CARRIED = [("", 0), ("estimate", 0), ("estimate", 1.4), ("observer", 0.5)]


@pytest.mark.parametrize(
    ("plant", "errors"), [("chain", (0.3, 0)), ("plane", (0, 0.5)), ("plane", (0.2, 0.5)), ("hill", None)]
)
@pytest.mark.parametrize(("nav", "delay"), CARRIED)
def test_no_flight_exceeds_the_bounds_with_carried_impulses(plant, errors, nav, delay):
    """Errors act on what is made. A law that sees the true state needs their offset too (Lemma 6 (c))."""
    errors, L = Thrusters(*errors) if errors else THRUSTERS, 40
    base, reached = software(plant, nav, delay, True), []
    n, m = base.B.shape
    targets = [(row, t) for row, t in some_targets(n, L) if t == L * CELLS]
    for w, bits, spare in ((0.0, 2, 2), (W, 5, 0)):  # the limit of thrust cuts impulses in the second case
        P = np.full(m, bits * base.bit / base.h)
        soft = replace(base, u_max=P[0] * (1 + 1e-6) + spare * base.bit / base.h)
        noise = sizes(nav, n) * (w > 0)
        limits = bounds(soft, nav, w=w, errors=errors, noise=noise)
        choose = quantised(soft, errors, P)
        flight = attack(soft, nav, targets, errors, rounds=1, reference=choose, w=w, noise=noise)
        reached.append(shares(flight, targets, L, limits, P * (1 + 1e-6)))
        assert np.max(np.abs(flight.remainder)) <= soft.bit
    print(f"{plant} {errors} {nav} {delay}: shares {reached[0]:.3f} {reached[1]:.3f}")
    assert min(reached) > 0.4


@pytest.mark.parametrize(("nav", "delay"), CARRIED[1:])
def test_a_remainder_is_handed_over_with_what_its_errors_displaced(nav, delay):
    soft, L, before, errors = software("plane", nav, delay, True), 40, 6, Thrusters(0.2, 0.5)
    n, m = soft.B.shape
    P = np.full(m, 4 * soft.bit / soft.h)
    soft = replace(soft, u_max=P[0])
    choose, rng = quantised(soft, errors, P), np.random.default_rng(3)
    targets, limits = some_targets(n, L), bounds(soft, nav, errors=errors)

    def reference(k, feedback, c, lam):
        free = rng.uniform(-P, P, feedback.shape) - feedback
        return free if k < before else choose(k - before, feedback, c, lam)

    early = handed_over(soft, nav, rng)
    flight = attack(soft, nav, targets, errors, rounds=1, before=(before, early), reference=reference)
    z, N = soft.state(flight, before, nav == "observer"), limits.closed.loop.N
    state_offset = np.zeros((N, m))  # as the last addition before the hand-over
    state_offset[:n] = soft.B
    if delay:
        state_offset[n : 2 * n] = soft.B
    elif nav == "observer":
        state_offset[-n:] = -soft.B
    moved = np.abs(limits.carried(np.eye(n, N))[: L + 1] @ state_offset).sum(axis=2) * soft.bit * 0.7
    x, own = np.array(flight.x[before * CELLS :: CELLS]), limits.carried(np.eye(n, N))[: L + 1] @ z.T
    bound = own.transpose(0, 2, 1) + (limits.from_rest(np.eye(n, N), P)[: L + 1] + moved)[:, None]
    assert np.all(x <= bound + 1e-12)
    assert np.max([x[L, i] / bound[L, i] @ row for i, (row, t) in enumerate(targets) if t == L * CELLS]) > 0.4


@pytest.mark.parametrize(("nav", "delay"), CASES)
def test_an_undisturbed_flight_is_the_transition_and_fades_within_the_remainder(nav, delay):
    soft, before, runs = software("lagging", nav, delay), 6, 3
    early = handed_over(soft, nav, np.random.default_rng(5))
    limits = bounds(soft, nav)
    N = limits.horizon

    def first(name, zero=0.0):
        return lambda k, *v: early(name, k, runs) if k < before + (name == "noise") else zero

    flight = soft.fly(
        before + 5 * N,
        runs,
        w=first("w"),
        errors=first("errors"),
        noise=first("noise") if nav else lambda k: 0.0,
    )
    if nav == "estimate":  # a noise of the command at the hand-over, not of the state there
        return
    z = soft.state(flight, before, nav == "observer")
    rows, x = rows_of(limits), np.array(flight.x[before * CELLS :: CELLS])
    flown = np.concatenate([x[:-1], -np.array(flight.feedback[before:])], axis=2)
    expected = (limits.carried(rows) @ z.T).transpose(0, 2, 1)
    np.testing.assert_allclose(flown[: N + 2], expected, rtol=0, atol=1e-9 * np.abs(expected).max())
    norm = np.max(np.abs(z) / limits.v, axis=1)
    within = np.array(flight.x[before * CELLS : (before + N) * CELLS]).reshape(N, CELLS, runs, -1)
    n, f = len(soft.A), np.linspace(0, 1, CELLS, endpoint=False)[:, None, None]
    chord = (1 - f) * within[:, :1] + f * x[1 : N + 1, None]
    curved = limits.between(np.eye(n))[1][:N, None, None] * norm[:, None]
    assert np.all(np.abs(within - chord) <= curved + 1e-12)
    late = np.abs(flown[N + 1 :]) / norm[:, None] / limits.remainder(rows)
    assert late.max() <= 1
    print(f"{nav} {delay}: share of the remainder {late.max():.3f}")


@pytest.mark.parametrize(
    ("nav", "delay", "carried"), [("", 0, False), ("estimate", 1.4, True), ("observer", 0.5, True)]
)
@pytest.mark.parametrize("power", [6, -6])
def test_bounds_scale_with_the_units_of_the_states(nav, delay, carried, power):
    soft = software("plane", nav, delay, carried)
    unit = 10.0 ** (power * np.array([1, 0, 1, -1]))
    S, back = np.diag(unit), np.diag(1 / unit)
    other = replace(soft, A=S @ soft.A @ back, B=S @ soft.B, D=S @ soft.D, gain=soft.gain @ back)
    noise = sizes(nav, 4)
    if nav == "observer":
        other = replace(other, measures=soft.measures @ back, correction=S @ soft.correction)
    plain = bounds(soft, nav, errors=THRUSTERS, noise=noise)
    loop, m = plain.closed.loop, 2
    lines = 1 + {0: 0, 1.4: 3, 0.5: 1}[delay]
    scale = np.concatenate(
        [np.tile(unit, lines), np.ones(m if carried else 0), unit if nav == "observer" else []]
    )
    assert len(scale) == loop.N
    given = unit * noise if nav == "estimate" else noise
    scaled = bounds(other, nav, errors=THRUSTERS, noise=given, scale=scale)
    P = plain.settled_bound()
    np.testing.assert_allclose(scaled.settled_bound(), P, rtol=1e-5)
    assert scaled.horizon == plain.horizon
    E = np.eye(4, loop.N)
    np.testing.assert_allclose(scaled.from_rest(E, P), plain.from_rest(E, P) * unit, rtol=1e-7)
    for a, b in zip(scaled.between(E[:, :4], P), plain.between(E[:, :4], P), strict=True):
        np.testing.assert_allclose(a, b * unit, rtol=1e-7)
    np.testing.assert_allclose(scaled.remainder(E), plain.remainder(E) * unit, rtol=1e-7)


def test_nothing_uncertain_adds_nothing():
    soft = software("chain", "estimate", 0)
    limits = bounds(soft, "estimate", w=0.0, errors=Thrusters(0.2), noise=np.zeros(2))
    rows = rows_of(limits)
    assert np.all(limits.settled_bound() == 0) and np.all(limits.noise() == 0)
    assert np.all(limits.from_rest(rows, np.zeros(1)) == 0) and np.all(
        limits.between(np.eye(2), np.zeros(1))[0] == 0
    )


def test_intersample_bounds_count_the_rate_at_a_node_and_what_pushes_within_the_period():
    """Both terms of Proposition 9 (d), of a plant whose pushes fade within a period."""
    A, B, D = np.array([[-1, 0.3], [0, -0.5]]), np.array([[0.0], [1]]), np.array([[1.0, 0.2], [0, 0.5]])
    loop = Disturbance(D, W).extend(Loop.from_plant(A, B, 0.4))
    limits = Tightening(loop.close(np.array([[0.1, 0.2]])), np.ones(1), np.ones(2))
    own, rows = W * np.linalg.norm(D, axis=1), np.eye(2)
    rate = limits.from_rest(limits.closed.rates).max(axis=0)
    curvature = 0.4**2 / 8 * np.abs(A)
    assert np.all(limits.between(rows)[0] >= curvature @ (rate + own))
    box = replace(loop.channels[0], ball=False, size=np.full(2, W))
    boxed = replace(limits, closed=replace(loop, channels=(box,)).close(limits.closed.gain))
    assert np.all(boxed.response(box, rows, rows).between @ box.size >= boxed.between(rows)[0] * (1 - 1e-3))
    assert np.all(boxed.between(rows)[0] >= limits.between(rows)[0])


def test_an_offset_of_the_state_counts_as_an_error_of_what_is_measured():
    """A remainder and its errors displace the state by up to alpha |B| I (Lemma 6 (c))."""
    soft, M = software("plane"), np.array([[1.0, 0, -2, 0], [0, 1, 0, 1]])
    loop = CarriedImpulse(BIT, 0.5).extend(Loop.from_plant(soft.A, soft.B, soft.h))
    away = 0.5 * BIT * np.abs(soft.B).sum(axis=1)
    seen = Estimate(sizes("estimate", 4)).extend(loop).channels[-1]
    np.testing.assert_allclose(seen.size, sizes("estimate", 4) + away)
    seen = Observer(M, np.array([0.05, 0.04]), 0.1 * M.T)
    measured = Filter(seen, np.zeros(4)).extend(loop).channels[-1]
    np.testing.assert_allclose(measured.size, np.array([0.05, 0.04]) + np.abs(M) @ away)


def test_the_remainder_bounds_every_state_that_is_left_at_any_later_node():
    """A row may be near zero at the horizon and larger again later, where what hardly damps turns."""
    A, B = np.array([[0, 1], [-1, -0.02]]), np.array([[0.0], [1]])
    limits = Tightening(
        Loop.from_plant(A, B, 0.5).close(np.array([[0, 0.02]])), np.ones(1), np.array([1.0, 0.02])
    )
    rows, N = np.array([[1.0, 0], [0, 1], [1, 1], [1, -1]]), limits.horizon
    left = np.abs(rows @ powers(limits.closed.F, 3 * N)[N:]) @ limits.v
    bound = limits.remainder(rows)
    assert np.all(left.max(axis=0) <= bound) and np.all(bound <= 40 * left.max(axis=0))


def test_a_loop_that_hardly_settles_is_bounded_for_ever_or_refused():
    A, B, h = np.zeros((1, 1)), np.ones((1, 1)), 1.0
    for rate, fades in ((2e-3, True), (2e-4, False)):
        loop = Disturbance(B, W).extend(Loop.from_plant(A, B, h))
        limits = Tightening(loop.close(np.array([[rate]])), np.ones(1), np.ones(1))
        if fades:
            ever = limits.from_rest(np.eye(1))[-1]
            assert W / rate <= ever <= W / rate * 1.01
        else:
            with pytest.raises(
                ScenarioError, match=r"^feedback.period_s: got 1.0; must let errors decay within"
            ):
                limits.from_rest(np.eye(1))


def test_an_unstable_loop_is_refused_in_one_sentence():
    soft = software("chain")
    limits = bounds(replace(soft, gain=-soft.gain), "")
    with pytest.raises(ScenarioError, match=r"^feedback.period_s: got 1.0; must give a stable loop$"):
        limits.settled_bound()


def test_errors_that_feed_on_themselves_leave_no_thrust():
    """Nothing above the limit counts in errors, so a bound above it says that S may clip."""
    soft = replace(software("chain"), u_max=0.02)
    assert bounds(soft, "", errors=Thrusters(0.2)).settled_bound() < soft.u_max
    assert bounds(soft, "", errors=Thrusters(5.0)).settled_bound() > soft.u_max


def test_sources_are_refused_in_an_order_that_would_lose_errors():
    loop = Loop.from_plant(*(software("plane").A, software("plane").B), 1.0)
    seen = Estimate(np.zeros(4)).extend(loop)
    with pytest.raises(ValueError, match="before navigation"):
        Delay(1.0).extend(seen)
    with pytest.raises(ValueError, match="after the sources"):
        CarriedImpulse(BIT, 0.1).extend(seen).close(software("plane").gain)
