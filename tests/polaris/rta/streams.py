"""Measurement streams with everything that can be wrong with them, and flights under them."""

from dataclasses import dataclass, field
from functools import cache

import numpy as np

from polaris.rta.decision_grid import DecisionGrid
from polaris.rta.flight import Conditions, Engine
from polaris.rta.methods.monitor import Monitor
from polaris.rta.online.estimate import Measurement
from tests.polaris.rta.scenes import robot as robot_schedule

HALF = 0.01


@cache
def robot(latency=0.0, trust="thrust_limits", half=HALF):
    """Monitor on the bundled scenario ``robot``: 300 decisions every 0.05 s."""
    return Monitor(DecisionGrid.from_schedule(robot_schedule(), latency=latency, half_widths=half), trust)


@dataclass
class Delivery:
    """Data that arrive at one decision, and the families of faults that must explain them."""

    now: float
    stamp: object
    state: object
    planned: np.ndarray
    half: object = None
    missing: bool = False
    call: bool = True
    families: set = field(default_factory=set)

    @property
    def measurement(self):
        return None if self.missing else Measurement(self.stamp, self.state, self.half)


def as_array(state):
    return state if isinstance(state, np.ndarray) and state.dtype == float else None


class Operator:
    """Corrupts deliveries in one window of decisions."""

    family = "measurement"
    certain = True  # every single corruption must be explained
    alone = False  # no other operator on this stream

    def __init__(self, rng, decisions, n):
        self.rng, self.n = rng, n
        self.first = int(rng.integers(2, decisions - 60))
        self.last = self.first + int(rng.integers(10, 60))
        self.set_up()

    def set_up(self):
        pass

    def __call__(self, k, delivery, past):
        no_state = delivery.missing or np.shape(as_array(delivery.state)) != (self.n,)
        if no_state or not self.first <= k < self.last:
            return  # not now, or there is no state left to corrupt
        if self.corrupt(k, delivery, past) is not False and self.certain:
            delivery.families.add(self.family)

    def corrupt(self, k, delivery, past):
        raise AssertionError


class Missing(Operator):
    def corrupt(self, k, delivery, past):
        delivery.missing = self.rng.random() < 0.5
        return delivery.missing


class Old(Operator):
    """One of the last five measurements: delayed, out of order or once more."""

    def corrupt(self, k, delivery, past):
        delay = int(self.rng.integers(0, 6))
        if not 0 < delay <= k:
            return False
        delivery.stamp, delivery.state = past[k - delay]


class Frozen(Operator):
    def corrupt(self, k, delivery, past):
        delivery.state = past[self.first][1]
        delivery.families.clear()  # what was wrong with the other state
        return k > self.first and self.alone  # only a state that has been accepted can be repeated


class FrozenWithNoise(Operator):
    family, certain = "estimate", False

    def corrupt(self, k, delivery, past):
        delivery.state = past[self.first][1] + self.rng.uniform(-HALF, HALF, self.n)
        delivery.families.clear()


class Spiking(Operator):
    family = "estimate"

    def corrupt(self, k, delivery, past):
        if self.rng.random() < 0.7:
            return False
        size = self.rng.uniform(3, 50) * self.rng.choice([-1, 1])
        delivery.state = delivery.state + size * (np.arange(self.n) == self.rng.integers(self.n))


class Malformed(Operator):
    """A state, a stamp or half widths that are none, absurd or not finite."""

    def corrupt(self, k, delivery, past):
        x, one = delivery.state, np.arange(self.n) == self.rng.integers(self.n)
        states = [None, "x", x[:-1], x[None], [[0.0], [1.0, 2.0]], x.astype(complex), {}, object(), 3.0]
        states += [np.where(one, odd, x) for odd in (np.nan, np.inf, -np.inf)]
        states += [x * 10.0 ** self.rng.integers(8, 300)]
        stamps = [None, "now", np.nan, np.inf, -np.inf, past[k][0] + self.rng.uniform(0.001, 0.2)]
        half = [np.where(one, odd, HALF) for odd in (2 * HALF, -HALF, np.nan, np.inf)]
        field, choices = [("state", states), ("stamp", stamps), ("half", half)][int(self.rng.integers(3))]
        setattr(delivery, field, choices[int(self.rng.integers(len(choices)))])


class Drifting(Operator):
    family, certain = "estimate", False

    def set_up(self):
        self.last = max(self.last, self.first + 30)
        self.rate = self.rng.uniform(0.5, 5) * HALF * self.rng.choice([-1, 1], self.n)

    def corrupt(self, k, delivery, past):
        delivery.state = delivery.state + self.rate * (k - self.first + 1)


class Flattering(Operator):
    """Tells that the flight is on the reference, where U is always welcome."""

    family, certain = "estimate", False

    def set_up(self):
        self.first = int(self.rng.integers(10, 130))
        self.last = self.first + 170

    def corrupt(self, k, delivery, past):
        delivery.state = delivery.planned + self.rng.uniform(-HALF, HALF, self.n)
        delivery.families.clear()


class ClockStep(Operator):
    family = "clock"

    def set_up(self):
        self.by = self.rng.choice([-40, -1, 1, 2, 3, 60]) * 0.05 + self.rng.choice([0.0, 0.01])

    def corrupt(self, k, delivery, past):
        delivery.now = past[k][0] + self.by


class ClockGone(Operator):
    family = "clock"

    def corrupt(self, k, delivery, past):
        delivery.now = [np.nan, np.inf, -np.inf, None, "noon"][int(self.rng.integers(5))]


class Jitter(Operator):
    family = "clock"

    def corrupt(self, k, delivery, past):
        delivery.now = past[k][0] + self.rng.choice([-1, 1]) * self.rng.uniform(0.01, 0.02)


class Skipped(Operator):
    """No call at all for a while: what flew may fly no longer than its permission, then S."""

    certain = False

    def set_up(self):
        self.last = self.first + int(self.rng.integers(1, 15))

    def corrupt(self, k, delivery, past):
        delivery.call = False


OPERATORS = [
    Missing, Old, Frozen, FrozenWithNoise, Spiking, Malformed, Drifting, Flattering, ClockStep, ClockGone,
    Jitter, Skipped,
]  # fmt: skip


def plans(seed, decisions, n, each=1, mixed=39):
    """Lists of operators: every one alone, then random combinations of two to five."""
    rng = np.random.default_rng(seed)
    chosen = [[kind] for kind in OPERATORS for _ in range(each)]
    chosen += [list(rng.choice(OPERATORS, rng.integers(2, 6), replace=False)) for _ in range(mixed)]
    out = [[kind(rng, decisions, n) for kind in kinds] for kinds in chosen]
    for operators in out:
        operators[0].alone = len(operators) == 1
    return out


@dataclass
class Step:
    """One call and what came of it."""

    k: int
    delivery: Delivery
    answer: object
    state: np.ndarray  # true, at the decision


def fly_streams(monitor, operators, deciders, seed, second_clock=(), applied=()):
    """All streams at once, one decider each, S and U acting on the true state.

    Returns
    -------
    steps : list (runs) of lists of Step
    states : ndarray, shape (nodes + 1, R, n)
    """
    scene, runs = monitor.grid, len(operators)
    conditions, engine = Conditions.draw(scene, runs, seed), Engine(scene)
    c = scene.nodes
    x, past = conditions.x0, [[] for _ in range(runs)]
    states, steps = [x], [[] for _ in range(runs)]
    flying, until = np.zeros(runs, dtype=int), np.full(runs, -np.inf)
    applied_u, u = np.zeros((runs, scene.system.m)), np.zeros((runs, scene.system.m))
    for k in range(scene.decisions):
        decided, expiry = np.zeros(runs, dtype=int), np.full(runs, -np.inf)
        for run in range(runs):
            instant = k * scene.period
            honest = x[run] + conditions.errors[k, run]
            past[run].append((instant, honest))
            delivery = Delivery(instant, instant, honest, scene.xi[k * c])
            for operator in operators[run]:
                operator(k, delivery, past[run])
            if not delivery.call:
                continue
            answer = deciders[run](
                delivery.now,
                delivery.measurement,
                applied_u[run].copy() if run in applied and k and c == 1 else None,
                1e4 + instant if run in second_clock else None,
            )
            decided[run], expiry[run] = answer.mode, answer.until
            steps[run].append(Step(k, delivery, answer, x[run].copy()))
        for i in range(c):
            node = k * c + i
            if i == scene.delay:  # the answers take effect; without one, U has no permission any more
                flying, until = decided, expiry
            flying = np.where(node * scene.h < until - 1e-9, flying, 0)
            x, applied_u, _, _ = engine.step(node, flying, u, x, conditions.w[node])
            states.append(x)
        if scene.delay == c:
            flying, until = decided, expiry
    return steps, np.array(states)


def inside_unsafe(scene, states):
    """Which runs were inside an unsafe polytope at some node, shape (R,)."""
    hit, q = np.zeros(states.shape[1], dtype=bool), scene.clearance.q
    for unsafe in scene.unsafe:
        offsets = unsafe.fine(q)
        for node, x in enumerate(states):
            cell = min(node // q, len(offsets) - 1)
            p = x @ scene.system.position.T
            hit |= (p @ unsafe.normals.T <= offsets[cell, node - cell * q]).all(axis=1)
    return hit


def recovery_tightening(monitor, node, x):
    """Share of the room that S needs from exact states (R, n) at a node; above 1: not recoverable."""
    scene, recovery = monitor.grid, monitor.recovery
    e = x - scene.xi[node]
    exact = recovery.demand(np.zeros((scene.system.n, 1)))
    return recovery.share(node, e, np.linalg.norm(e @ scene.tracking.W.T, axis=-1), exact)
