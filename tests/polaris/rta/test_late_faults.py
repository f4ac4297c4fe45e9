"""Run-time methods in flights with a fault that is isolated late, at every instant, and U at its worst."""

from contextlib import nullcontext
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from polaris.model.errors import NotCertified, ScenarioError
from polaris.rta.arena import compare_methods
from polaris.rta.decision_grid import DecisionGrid, met_by_decisions
from polaris.rta.flight import Conditions, fly
from polaris.rta.method_result import measure
from polaris.rta.methods import METHODS
from polaris.rta.methods.monitor import Monitor
from polaris.rta.online.estimate import Measurement
from polaris.rta.online.loop import FlightLoop
from polaris.rta.online.runtime import OnlineMonitor
from polaris.scenario.scenario import load_scenario
from polaris.simulation.fault_times import FaultTimes
from polaris.synthesis.controllers.black_box import BlackBox
from polaris.synthesis.schedule.synthesize import synthesize
from polaris.synthesis.sources.late_faults import wrong_thrust
from polaris.synthesis.tracker.loop import Loop
from tests.polaris.synthesis.sources.test_transients import SOFT, made
from tests.polaris.tiny import TINY
from tests.sizes import fewer

TWOS = [f"thrusters.directions={[[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]] * 2}"]
TWOS += ["thrusters.thrust_max_N=1.0", "horizon.duration_s=16.0", "tracking.R=[400.0,400.0]"]
ON, LOST = 'kind="stuck_on",isolation_s=0.3', 'kind="navigation_lost",lasts_s=2.0'
WEAK = 'kind="loss",share=0.1,isolation_s=0.3'
PROVEN = ("monitor", "monitor_declared", "simplex_explicit", "asif_implicit")


@cache
def tiny(fault):
    """A small scene with a fault that is isolated late."""
    return synthesize(load_scenario(TINY).with_assignments([*SOFT, *TWOS, f"faults=[{{{fault}}}]"]))


def hostile(schedule, seed=0):
    """U at full thrust: towards the first obstacle where seed is 0, else some way for a while."""
    tracking, rng = schedule.safety.tracking, np.random.default_rng(seed)
    system, ways = tracking.system, rng.choice([-1.0, 1.0], (5, 10_000, tracking.system.m))

    def ask(t, x, xi):
        if seed:
            return (
                system.u_max
                * ways[int(5 * t / (schedule.steps[-1].k * schedule.safety.tracking.delta + 1)) % 5, : len(x)]
            )
        return np.sign(np.array([4.0, 3.0]) - x[:, :2]) * system.u_max

    box = BlackBox("hostile", system, schedule.safety.reference, tracking, ask)
    return replace(schedule, controllers=(schedule.controllers[0], box, *schedule.controllers[2:]))


def everywhere(grid, every=1):
    """Conditions in which every thruster fails at every instant, or navigation is lost."""
    (fault,) = grid.schedule.safety.problem.system.transients
    n, starts = grid.system.n, np.arange(0, grid.decisions * grid.nodes, every)
    thrust = fault.thrust if len(fault.thrust) else np.zeros((1, grid.system.m))
    begins, count = np.repeat(starts, len(thrust)), len(starts) * len(thrust)
    share = np.full(count, -1.0 if fault.name == "stuck_on" else fault.share)
    length = max(int(fault.lasts / grid.h + 1e-9), 1)
    lost = np.full(count, not len(fault.thrust))
    thrust = np.tile(thrust, (len(starts), 1))
    faults = FaultTimes(begins, begins + length, thrust, share, lost, np.zeros((count, n)))
    return replace(Conditions.draw(grid, count, 0), faults=faults)


def flown(grid, key, conditions):
    """Metrics of one method."""
    method = METHODS[key].on(grid)
    return measure(method.grid, fly(method.grid, method, conditions), conditions, key)


@pytest.mark.parametrize("told", [ON, LOST])
def test_a_fault_at_any_instant_is_survived_under_the_monitor(told):
    schedule = hostile(tiny(told))
    grid = DecisionGrid.from_schedule(schedule)
    metrics = flown(grid, "monitor", conditions := everywhere(grid, 2))
    assert metrics.experimental_share.mean() > 0.1
    assert metrics.min_distance.min() >= 0 and np.nanmax(metrics.max_thrust_ratio_safety) <= 1
    if told == ON:  # what the same flights do to a monitor whose proof leaves the fault out
        left_out = replace(schedule.safety.tracking.system, transients=())
        tracking = replace(schedule.safety.tracking, system=left_out)
        naive = DecisionGrid.from_schedule(
            replace(schedule, safety=replace(schedule.safety, tracking=tracking))
        )
        metrics = flown(naive, "monitor", conditions)
        assert np.nanmax(metrics.max_thrust_ratio_safety) > 1.05


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(5000, fewer(5024, 5006)))
def test_random_scenes_survive_faults_under_every_method_that_promises_it(seed):
    if (schedule := made(seed, seed % 3 == 0)) is None:
        pytest.skip("no schedule is found")
    schedule, feedback = hostile(schedule, seed), schedule.safety.tracking.feedback
    for latency, nodes in ((0, 1), (1, 1), (1, 2)):
        if feedback.nodes_per_cell % nodes == 0:
            h = schedule.safety.tracking.flow.h
            grid = DecisionGrid.from_schedule(schedule, nodes * h, latency * h)
            conditions = everywhere(grid, max(grid.decisions * grid.nodes // 10, 1))
            for key in PROVEN:
                try:
                    metrics = flown(grid, key, conditions)
                except (NotCertified, ScenarioError) as error:
                    assert isinstance(error, NotCertified) or (key == PROVEN[1] and latency + nodes > 1)
                    continue
                assert metrics.min_distance.min() >= 0, key
                assert np.all(~(metrics.max_thrust_ratio_safety > 1)), key


def test_a_law_that_late_faults_make_worthless_is_not_trusted():
    """While a late fault acts on decisions that last, a declared law may answer anything: say so."""
    schedule = tiny(WEAK)
    h = schedule.safety.tracking.flow.h
    for period, latency, trusted in ((h, 0.0, True), (h, h, False), (2 * h, 0.0, False)):
        grid = DecisionGrid.from_schedule(schedule, period, latency)
        refused = pytest.raises(ScenarioError, match="trust.*thrust_limits.*isolated late")
        with nullcontext() if trusted else refused:
            Monitor(grid, "declared")
    refused = compare_methods(grid, 2, methods=["monitor", PROVEN[1]]).refused
    assert list(refused) == [PROVEN[1]] and "trust" in refused[PROVEN[1]]


def test_comparisons_fly_a_fault_in_every_second_run():
    grid = DecisionGrid.from_schedule(tiny(ON))
    drawn = Conditions.draw(grid, 20, 0)
    on = [drawn.faults.on(node) for node in range(grid.last)]
    assert np.array_equal(np.any(on, axis=0), np.arange(20) % 2 == 1)
    schedule, method = (METHODS[key].on(grid) for key in ("schedule", "monitor"))
    after = np.arange(grid.last) >= drawn.faults.ends[1::2, None]
    assert not np.any(fly(grid, schedule, drawn).modes[1::2][after])  # S to the end
    assert np.any(fly(grid, method, drawn).modes[1::2][after])


def test_what_a_fault_does_is_no_lie_and_isolation_ends_what_was_decided_before():
    h = tiny(WEAK).safety.tracking.flow.h
    grid = DecisionGrid.from_schedule(tiny(WEAK), latency=h)
    loop, x, (Ad, Bd, _) = FlightLoop(OnlineMonitor(Monitor(grid))), grid.xi[0], grid.discrete
    for k in range(10):
        answer = loop.decide(k, k * h, Measurement(k * h, x), applied=grid.mu[max(k - 1, 0)])
        command = loop.command(k * h, x)
        assert not answer.faults and (k < 6 or answer.mode == command.mode == 1)
        x = Ad @ x + Bd @ (grid.mu[k] - [0.0, 0.09 * (k > 7)])  # less than is commanded
    loop.isolated()
    assert loop.command(10 * h, x).mode == 0
    assert loop.decide(10, 10 * h, Measurement(10 * h, x), applied=grid.mu[9]).mode == 1
    assert loop.command(11 * h, x).mode == 1


@pytest.mark.parametrize(("hidden", "latency"), [(1, 1), (3, 0)])
def test_decisions_on_predictions_that_did_not_know_of_a_fault_are_allowed_for_to_their_end(hidden, latency):
    """No law answers: what a fault that the decision did not know has done when the next takes effect."""
    system = tiny(WEAK).safety.tracking.system
    h = tiny(WEAK).safety.tracking.flow.h
    late = replace(system.timing, delay=hidden * h)
    (fault,) = system.transients
    calm = replace(fault, lasts=h, gains=0 * fault.gains)
    timed = met_by_decisions(replace(system, timing=late, transients=(calm,)), 1, latency, h)
    loop = Loop.from_plant(system.A, system.B, h)
    bound = wrong_thrust(timed, timed.transients[0], 0 * fault.gains, loop).max(axis=0)
    Ad, Bd, _ = DecisionGrid.from_schedule(tiny(WEAK)).discrete
    assert np.all(np.abs(np.linalg.matrix_power(Ad, hidden + latency) @ Bd @ fault.pushes[-1]) <= bound)


def test_where_navigation_may_be_lost_an_older_measurement_is_none():
    """S would fly on an estimate that is older than what is booked for it."""
    for fault, mode in ((LOST, 0), (WEAK, 1)):
        schedule = tiny(fault)
        grid, h = DecisionGrid.from_schedule(schedule, half_widths=0.02), schedule.safety.tracking.flow.h
        loop, x, (Ad, Bd, _) = FlightLoop(OnlineMonitor(Monitor(grid))), grid.xi[0], grid.discrete
        for k in range(10):
            before, x = x, Ad @ x + Bd @ grid.mu[k]
            assert loop.decide(k, k * h, Measurement(k * h, before)).mode == (k > 0) or k < 8
        between = (before + x) / 2
        old = Measurement(9.5 * h, between, [1e-4] * 4)
        answer = loop.decide(10, 10 * h, old, applied=grid.mu[9])
        assert answer.mode == mode and (mode or "stale" in str(answer.faults[0])), answer
