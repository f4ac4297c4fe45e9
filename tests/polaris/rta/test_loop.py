"""The flight loop: answers in time, permissions that end, S wherever U has none; corrupted in every way."""

from functools import cache

import numpy as np
import pytest

from polaris.model.errors import ScenarioError
from polaris.rta.decision_grid import DecisionGrid
from polaris.rta.methods.monitor import Monitor
from polaris.rta.online.estimate import Measurement
from polaris.rta.online.loop import FlightLoop
from polaris.rta.online.runtime import OnlineMonitor
from polaris.rta.online.runtime_options import RuntimeOptions
from tests.polaris.rta import oddities
from tests.polaris.rta.streams import inside_unsafe, recovery_tightening, robot_schedule

PATIENT = RuntimeOptions(deadline=1e3, budget=1e3, latch=None, latch_conflicts=None)
HALF = 0.005
SETTINGS = {"no latency": (0.05, 0.0), "late": (0.25, 0.1), "a whole period late": (0.05, 0.05)}


@cache
def monitor(setting="no latency"):
    period, latency = SETTINGS[setting]
    return Monitor(DecisionGrid.from_schedule(robot_schedule(), period, latency, HALF))


def loop(setting="no latency", laws=None):
    return FlightLoop(OnlineMonitor(monitor(setting), PATIENT), laws)


class World:
    """The robot under the loop's commands, the worst of its disturbance, and what goes wrong in flight.

    At every decision one of `missed` (no call), `jitter`, `clock` (set for this call), `number`, `odd`
    (a measurement that is none), at every node one of `back` (the clock runs backwards), `gone`, `odd`,
    by their probabilities; `fails`: how often a call of U raises or returns nonsense.
    """

    def __init__(self, flying, seed, rates, fails=0.0):
        self.loop, self.grid = flying, flying.grid
        self.rng, self.rates, self.fails = np.random.default_rng(seed), rates, fails
        self.modes, self.answers, self.states, self.strict = [], {}, [], True

    def happens(self, event):
        return self.rng.random() < self.rates.get(event, 0.0)

    def law(self, t, x):
        if self.rng.random() < self.fails:
            if self.rng.random() < 0.3:
                raise [ValueError, SystemExit, KeyboardInterrupt][int(self.rng.integers(3))]
            odd = {**oddities.unreadable(2), **oddities.not_finite(2)}
            return odd[list(odd)[int(self.rng.integers(len(odd)))]]
        u = 3 * self.grid.command(1, min(int((t + 1e-9) / self.grid.h), len(self.grid.mu) - 1), x)
        x += np.nan  # U may spoil what it is given
        return u

    def decide(self, k, t, x):
        scene, rng = self.grid, self.rng
        if self.happens("missed"):
            return
        clock, number = t, k
        if self.happens("jitter"):
            clock = t + rng.uniform(-0.3, 0.3) * scene.period
        if self.happens("clock"):
            clock = t + rng.choice([-3, -1, 1, 5, np.nan]) * scene.period
        if clock is t and self.happens("number"):  # two that lie alike cannot be told from the truth
            number = [k + 1, k - 1, None, 0.5, "k"][int(rng.integers(5))]
        measured = Measurement(t, x + rng.uniform(-1, 1, len(x)) * HALF)
        if self.happens("odd"):
            measured = [None, oddities.Raises(), Measurement(t, oddities.NeedsGradient())][
                int(rng.integers(3))
            ]
        self.answers[k] = self.loop.decide(number, clock, measured)

    def fly(self):
        scene, rng = self.grid, self.rng
        Ad, Bd, Dd = scene.discrete
        theta = scene.schedule.safety.problem.initial_set
        x = theta.c + theta.G @ rng.choice([-1, 1], theta.G.shape[1])
        self.states.append(x)
        for node in range(scene.decisions * scene.nodes):
            self.t = t = node * scene.h
            if node % scene.nodes == 0:
                self.decide(node // scene.nodes, t, x)
            clock, state = t, x.copy()
            if self.happens("back"):
                clock = t - scene.h * rng.choice([1, 1.3, 7, 40])  # of the last reading, or before
            if self.happens("gone"):
                clock = [None, np.nan, oddities.Raises()][int(rng.integers(3))]
            mode, u, until = self.loop.command(clock, state)
            assert (np.abs(u) <= scene.system.u_max).all()
            assert mode == 0 or until > t or clock is not t or not self.strict
            self.modes.append(mode)
            w = rng.normal(size=Dd.shape[1])
            x = Ad @ x + Bd @ u + Dd @ (w * scene.system.w_max / max(np.linalg.norm(w), 1e-9))
            self.states.append(x)
        return self

    def permitted(self):
        """By mode: what the answers of the flight allow at every node, by hand."""
        scene, out = self.grid, np.zeros(len(self.modes), dtype=int)
        for k, answer in self.answers.items():
            first = k * scene.nodes + scene.delay
            out[first : first + scene.nodes] = answer.mode
        return out


def world(setting, seed, rates, fails=0.0):
    scene, worlds = monitor(setting).grid, []
    plan = loop(setting).laws[0]  # S has a clock of its own

    def safe(t, x):
        return plan(worlds[0].t, x)

    flying = loop(setting, [safe, *[lambda t, x: worlds[0].law(t, x)] * (len(scene.controllers) - 1)])
    worlds.append(World(flying, seed, rates, fails))
    return worlds[0]


ALL = {"missed": 0.05, "jitter": 0.1, "clock": 0.03, "number": 0.03, "odd": 0.05, "back": 0.03, "gone": 0.03}
STREAMS = {}, {"missed": 0.3}, {"jitter": 0.5}, {"clock": 0.2, "number": 0.2}, {"back": 0.1, "gone": 0.1}, ALL


def check(setting, seed, rates, fails):
    scene = monitor(setting).grid
    flight = world(setting, seed, rates, fails).fly()
    states = np.array(flight.states)
    assert not inside_unsafe(scene, states[:, None]).any()
    permitted, modes = flight.permitted(), np.array(flight.modes)
    assert ((modes == 0) | (modes == permitted)).all()
    if not fails and not {"back", "gone", "clock", "number", "jitter"} & set(rates):
        np.testing.assert_array_equal(modes, permitted)
    at = np.arange(scene.delay, len(modes) + 1, scene.nodes)  # moments of effect
    tightening = [recovery_tightening(monitor(setting), node, states[node][None])[0] for node in at]
    assert max(tightening) <= 1
    assert (modes > 0).any()


@pytest.mark.parametrize("setting", ["late", pytest.param("a whole period late", marks=pytest.mark.slow)])
def test_u_flies_only_with_a_permission_and_s_can_always_take_over(setting):
    for seed, rates in enumerate(STREAMS):
        check(setting, seed, rates, 0.02 * (seed % 2))


def measured(flying, k):
    """Number, time and exact measurement of a decision, on the reference, where U is always welcome."""
    scene = flying.grid
    return k, k * scene.period, Measurement(k * scene.period, scene.xi[k * scene.nodes])


def test_a_loop_that_ignores_the_end_of_permissions_does_harm():
    """Shows that the streams can find what a wrong loop lets through."""
    harm = 0
    for seed in range(6):
        flight = world("no latency", seed, {"missed": 0.3})
        take, flight.strict = flight.loop._take_effect, False

        def endless(t, loop=flight.loop, take=take):
            mode = loop._mode
            take(t)
            loop._mode = loop._mode or (mode if not loop._waiting else 0)

        flight.loop._take_effect = endless
        states = np.array(flight.fly().states)
        tightening = recovery_tightening(monitor(), len(states) - 1, states[-1][None])[0]
        harm += bool(inside_unsafe(monitor().grid, states[:, None]).any() or tightening > 1)
    assert harm


@pytest.mark.parametrize("setting", SETTINGS)
def test_missed_calls_cost_only_what_they_would_have_allowed(setting):
    """U at its declared law, undisturbed by anything else: with and without missed calls."""
    flying, modes, missed = loop(setting), [], {3, 11, 12, 20}
    scene = flying.grid
    quiet = range(scene.nodes * 26)
    for node in quiet:
        k, within = divmod(node, scene.nodes)
        if within == 0 and k not in missed:
            assert flying.decide(*measured(flying, k)).mode == 1
        modes.append(flying.command(node * scene.h, scene.xi[node]).mode)
    allowed = [(node - scene.delay) // scene.nodes not in missed and node >= scene.delay for node in quiet]
    assert modes == allowed


def permitted_loop(laws=None):
    """A loop in which U has just been allowed to fly, for the whole of a period."""
    flying = loop("late", laws=laws)
    scene = flying.grid
    assert [flying.decide(*measured(flying, k)).mode for k in (0, 1)][-1] == 1
    return flying, scene.period + scene.latency, scene.xi[scene.nodes + scene.delay].copy()


def test_an_answer_that_comes_after_its_moment_is_too_late():
    flying = loop("late")
    scene = flying.grid
    assert flying.command(scene.latency, scene.xi[scene.delay]).mode == 0
    assert flying.decide(0, 0.0, Measurement(0.0, scene.xi[0])).mode == 1
    assert flying.command(scene.latency + scene.h / 2, scene.xi[scene.delay]).mode == 0


def test_answers_wait_for_their_moment():
    flying = loop("late")
    scene = flying.grid
    period, first = scene.period, scene.latency
    x = scene.xi[scene.delay]
    assert flying.decide(*measured(flying, 0)).mode == 1
    assert flying.command(first - 0.01, x)[::2] == (0, first)
    assert flying.command(first, x)[::2] == (1, period + first)
    assert flying.decide(*measured(flying, 1)).mode == 1
    assert flying.command(period, x)[::2] == (1, period + first)
    assert flying.command(period + first, x).until == pytest.approx(2 * period + first)
    assert flying.command(2 * period + first, x)[::2] == (0, np.inf)
    late = loop("late")  # an answer that comes after its moment
    assert late.command(first, x).mode == 0
    assert late.decide(*measured(late, 0)).mode == 1
    assert late.command(first, x).mode == 0


@pytest.mark.parametrize("wrong", [None, np.nan, "now", oddities.Raises(), -5.0], ids=range(5))
def test_a_clock_that_cannot_be_read_or_runs_backwards_means_s(wrong):
    flying, effect, x = permitted_loop()
    assert flying.command(effect + 0.1, x).mode == 1
    assert flying.command(wrong, x).mode == 0
    assert flying.command(effect + 0.15, x).mode == 0  # until the next answer
    for back in (0.05, 0.1):  # within the permission, or not on
        flying, effect, x = permitted_loop()
        assert [flying.command(effect + at, x).mode for at in (0.0, 0.1, back, 0.15)] == [1, 1, 0, 0]


def test_a_reading_far_ahead_costs_no_more_than_what_it_ends():
    flying, effect, x = permitted_loop()
    scene = flying.grid
    assert [flying.command(instant, x).mode for instant in (effect, 1e308, effect + 0.05)] == [1, 0, 0]
    for k in (2, 3):
        flying.decide(*measured(flying, k))
    assert flying.command(3 * scene.period, scene.xi[3 * scene.nodes]).mode == 1


@pytest.mark.parametrize("wrong", [oddities.Raises(), np.zeros(3), np.full(4, np.nan), None], ids=range(4))
def test_a_state_that_is_none_means_s_on_the_last_good_one(wrong):
    calls = []

    def safe(t, x):
        calls.append((t, x))
        return [0.0, 1e9]

    flying, effect, x = permitted_loop([safe, *loop().laws[1:]])
    assert flying.command(effect, x).mode == 1
    mode, u, _ = flying.command(effect + 0.05, wrong)
    assert mode == 0 and u.tolist() == [0.0, flying.grid.system.u_max[1]]
    assert calls[0][0] == effect + 0.05 and calls[0][1].tolist() == x.tolist()


def test_u_loses_its_permission_with_its_first_fault():
    calls = []

    def faults(t, x):
        calls.append(t)
        raise SystemExit

    flying, effect, x = permitted_loop([loop().laws[0], *[faults] * (len(monitor().grid.controllers) - 1)])
    assert flying.command(effect, x).mode == flying.command(effect + 0.05, x).mode == 0
    assert calls == [effect]
    reasons = [flying.decide(*measured(flying, k)).reason for k in (2, 3)]
    assert reasons[0] == "controller: raised SystemExit" and reasons[1].startswith("nearest limit")
    with pytest.raises(ScenarioError, match="laws"):
        loop(laws=[faults])
