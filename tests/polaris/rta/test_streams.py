"""Corrupted measurement streams, flown closed loop: U flies only where S can still take over."""

from collections import Counter
from functools import cache

import numpy as np
import pytest

from polaris.rta.online.runtime import OnlineMonitor
from polaris.rta.online.runtime_options import OnlineDecision, RuntimeOptions
from tests.polaris.rta import streams
from tests.polaris.rta.streams import HALF, fly_streams, inside_unsafe, plans, recovery_tightening, robot

PATIENT = RuntimeOptions(deadline=1e3, budget=1e3)  # a busy machine must not decide
LATENCIES = [0.0, 0.05]


@cache
def flown(latency):
    """(monitor, operators, steps, states) of the streams of one latency; every second has two clocks."""
    monitor = robot(latency)
    scene = monitor.grid
    operators = plans(int(latency > 0), scene.decisions, scene.system.n)
    deciders = [OnlineMonitor(monitor, PATIENT).step for _ in operators]
    runs = len(operators)
    # A lie that is a possible flight is found only where the inputs are known.
    flattered = {
        run for run, chain in enumerate(operators) if any(isinstance(o, streams.Flattering) for o in chain)
    }
    options = {"second_clock": range(0, runs, 2), "applied": flattered.union(range(0, runs, 3))}
    return monitor, operators, *fly_streams(monitor, operators, deciders, 7, **options)


@pytest.mark.parametrize("latency", LATENCIES)
def test_u_only_flies_where_s_can_still_take_over(latency):
    """At the moment of effect, and at the moment at which the permission ends."""
    monitor, _, steps, states = flown(latency)
    scene = monitor.grid
    tightening = np.array([recovery_tightening(monitor, node, x) for node, x in enumerate(states)])
    checked = 0
    for run, run_steps in enumerate(steps):
        honoured = True
        for step in run_steps:
            if step.answer.mode:
                used = step.delivery.measurement
                age = step.k * scene.period - used.stamp
                # Without faults a measurement is used; one that is delayed was true at its stamp.
                honoured &= bool(age > 1e-9 or (np.abs(used.state - step.state) <= HALF * (1 + 1e-9)).all())
                node = step.k * scene.nodes + scene.delay
                if honoured:
                    assert tightening[node, run] <= 1 and tightening[node + scene.nodes, run] <= 1
                    checked += 1
    assert checked > 5000


@pytest.mark.parametrize("latency", LATENCIES)
def test_every_answer_has_a_reason_and_every_fault_its_family(latency):
    _, operators, steps, _ = flown(latency)
    explained = Counter()
    for chain, run in zip(operators, steps, strict=True):
        for step in run:
            answer, expected = step.answer, set(step.delivery.families)
            assert answer.reason
            assert (answer.mode > 0) <= all(fault.harmless for fault in answer.faults)
            families = {fault.family for fault in answer.faults}
            if latency and any(isinstance(operator, streams.Jitter) for operator in chain):
                expected.discard("clock")  # what the latency allows for is no fault
            if expected:
                expected = expected if answer.k >= 0 else {"clock"}  # nothing else can be judged then
                assert families & expected, (step.k, [type(o).__name__ for o in chain], answer)
                explained.update(families & expected)
        first, *others = chain
        if others:
            continue
        if isinstance(first, (streams.Drifting, streams.Flattering)):  # lies that grow are found
            hit = [s.answer.faults for s in run if first.first <= s.k < first.last]
            assert any(fault.family == "estimate" for faults in hit for fault in faults)
        if isinstance(first, streams.Frozen):
            texts = {s.answer.reason for s in run if first.first < s.k < first.last}
            assert texts == {"measurement: frozen: the same state as before with a new stamp"}
    assert min(explained[family] for family in ("measurement", "estimate", "clock")) > 20


def test_without_the_checks_the_same_streams_do_harm():
    """The monitor on whatever arrived last, at whatever the clock says: shows that the tests can fail."""
    monitor = robot()
    scene = monitor.grid

    class Unchecked:
        def __init__(self):
            self.state, self.k, self.flown = scene.xi[0], 0, 0

        def step(self, now, measurement, applied, reference):
            arrived = None if measurement is None else streams.as_array(measurement.state)
            if arrived is not None and arrived.shape == self.state.shape:
                self.state = np.where(np.isfinite(arrived), arrived, self.state)
            if isinstance(now, float) and np.isfinite(now):
                self.k = int(np.clip(round(now / scene.period), 0, scene.decisions - 1))
            e = np.clip(self.state, -1e6, 1e6) - scene.xi[self.k]
            mode, margin = monitor.judge_one(self.k, e, self.flown)
            self.flown = mode
            return OnlineDecision(self.k, mode, margin, np.inf, "")

    operators = plans(0, scene.decisions, scene.system.n, each=8, mixed=0)
    operators = [chain for chain in operators if isinstance(chain[0], (streams.Flattering, streams.Drifting))]
    _, states = fly_streams(monitor, operators, [Unchecked().step for _ in operators], 7)
    tightening = np.array([recovery_tightening(monitor, node, x) for node, x in enumerate(states)])
    assert (tightening > 1).any(axis=0).sum() >= 3
    assert inside_unsafe(scene, states).any()


@pytest.mark.parametrize("latency", LATENCIES)
def test_no_stream_leads_into_an_unsafe_set_and_both_controllers_fly(latency):
    monitor, operators, steps, states = flown(latency)
    assert not inside_unsafe(monitor.grid, states).any() and len(operators) > 50
    assert {type(operator) for chain in operators for operator in chain} == set(streams.OPERATORS)
    assert 0.3 < np.mean([step.answer.mode > 0 for run in steps for step in run]) < 0.9
