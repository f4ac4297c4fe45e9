"""The monitor's re-entry margin, and the safe references it may choose from: calmer, and as proven."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest

from polaris.model.errors import NotCertified, PolarisError
from polaris.rta.decision_grid import DecisionGrid
from polaris.rta.flight import Conditions, fly
from polaris.rta.method_result import measure
from polaris.rta.methods.monitor import Monitor
from polaris.synthesis.controllers.controllers import AnyThrust
from reach.sets.zonotope import Zonotope
from tests.polaris.random_scenarios import synthesised
from tests.polaris.rta.scenes import corridor, scene
from tests.sizes import fewer


class Whimsical(Monitor):
    """Hands over to S at any decision, and takes back whenever the monitor lets it."""

    def start(self, runs):
        super().start(runs)
        self.rng = np.random.default_rng(5)

    def decide(self, observed):
        choice = super().decide(observed)
        return replace(choice, mode=np.where(self.rng.random(len(choice.mode)) < 0.3, 0, choice.mode))


def kept(monitor, runs=8, seed=1):
    """Nothing is hit, and S is asked for no more than there is; switches per run."""
    conditions = Conditions.draw(monitor.grid, runs, seed)  # worst cases against this very reference
    metrics = measure(monitor.grid, fly(monitor.grid, monitor, conditions), conditions, "monitor")
    assert metrics.min_distance.min() > 0
    assert np.nanmax(np.append(metrics.max_thrust_ratio_safety, 0.0)) <= 1 + 1e-9
    return metrics.switches.mean()


@cache
def choice():
    """A small schedule with safe references to choose from, on all of which the monitor's proof starts."""
    with TemporaryDirectory() as folder:
        return synthesised(5034, Path(folder))[1]


def members(schedule):
    """The scene along every reference on which the monitor's proof starts."""
    for one in (schedule, *schedule.library):
        try:
            yield Monitor(DecisionGrid.from_schedule(one))
        except NotCertified:
            continue


@pytest.mark.parametrize("runs", [1, 6])
def test_u_takes_over_from_s_with_room_to_spare_alone(runs):
    grid = scene("robot")
    drawn, margins, flights = Conditions.draw(grid, 6, 2), [], {}
    conditions = drawn if runs > 1 else drawn.only(0)
    for reentry in (0.0, 0.1):
        flight = fly(grid, Monitor(grid, reentry=reentry), conditions)
        modes = flight.modes[:, :: grid.nodes]
        returns = (modes[:, :-1] == 0) & (modes[:, 1:] > 0)
        margins.append(flight.margins[:, 1:][returns].min(initial=1.0))
        flights[reentry] = np.abs(np.diff(modes)).sum()
        staying = (modes[:, :-1] > 0) & (modes[:, 1:] > 0)
        assert flight.margins[:, 1:][staying].min() < 0.1  # no more is asked of a U that flies
        assert ((flight.why == 2) == ((modes == 0) & (flight.margins >= 0))).all()
        assert reentry or not (flight.why == 2).any()
    assert margins[0] < 0.1 <= margins[1] and flights[0.1] < flights[0.0]


def test_hand_over_at_any_decision_is_covered():
    for grid in (scene("robot"), scene(period=0.25, latency=0.25)):
        assert kept(Whimsical(grid, reentry=0.0)) > kept(Monitor(grid, reentry=0.0))


def test_every_reference_of_the_library_keeps_the_promise():
    schedule = choice()
    assert schedule.library and all(not one.library for one in schedule.library)
    for one in schedule.library:
        assert one.safety.problem is schedule.safety.problem
        assert one.safety.end.until >= schedule.safety.end.until
        assert one.arrival.reached is True or schedule.arrival.reached is not True
    assert sum(kept(one) >= 0 for one in members(schedule)) > 2


def test_the_reference_that_is_worth_most_is_flown():
    schedule = choice()
    pool = list(members(schedule))
    choices = [[one.modes, *((mode,) for mode in one.modes)] for one in pool]  # all controllers, or one alone

    def worths_of(priced):
        pairs = zip(pool, choices, strict=True)
        return [max(one.objective(priced, modes) for modes in each) for one, each in pairs]

    default = Monitor.on(DecisionGrid.from_schedule(schedule))
    objectives = worths_of(schedule.objective)
    assert default.objective(schedule.objective) == max(objectives) and len(set(np.round(objectives, 6))) > 1
    for sign in (1.0, -1.0):  # whatever it is that counts
        priced = replace(schedule, objective=lambda shares, delta_v, switches, sign=sign: sign * delta_v)
        best = Monitor.on(DecisionGrid.from_schedule(priced))
        costs = worths_of(priced.objective)
        assert best.objective(priced.objective) == max(costs)
        in_library = best.grid.schedule is not priced
        assert in_library == any(best.grid.schedule is one for one in schedule.library)
        assert in_library == ("a safe reference of its own" in best.claim.reach) == (np.argmax(costs) > 0)
        kept(best)
    alone = Monitor.on(DecisionGrid.from_schedule(corridor()))
    assert alone.grid.schedule is corridor() and not corridor().library


def test_of_several_controllers_one_alone_flies_if_that_is_worth_more():
    schedule = corridor()
    safety, (s_law, straight) = schedule.safety, schedule.controllers
    anything = AnyThrust("anything", safety.problem.system, safety.reference, safety.tracking)
    both = replace(schedule, controllers=(s_law, anything, straight))
    thrifty = replace(both, objective=lambda shares, delta_v, switches: -delta_v)
    best = Monitor.on(DecisionGrid.from_schedule(thrifty))
    assert best.modes == (2,) and "only straight flies" in best.claim.reach
    conditions = Conditions.draw(best.grid, 4, 0)
    assert set(np.unique(fly(best.grid, best, conditions).modes)) == {0, 2}
    assert set(np.unique(fly(best.grid, best, conditions.only(0)).modes)) == {0, 2}
    kept(best)
    first = replace(both, objective=lambda shares, delta_v, switches: shares.get(1, 0.0))
    for one in (both, first):  # nothing is known of its worth; or no other is worth more
        best = Monitor.on(DecisionGrid.from_schedule(one))
        assert best.modes == (1, 2) and "only" not in best.claim.reach
        assert 1 in fly(best.grid, best, conditions).modes


def test_a_reference_on_which_no_proof_starts_is_not_flown():
    schedule = choice()
    theta = schedule.safety.problem.initial_set
    wide = [
        replace(one, safety=replace(one.safety, start=Zonotope(one.safety.start.c, 1e3 * theta.G)))
        for one in (schedule, *schedule.library)
    ]
    broken = replace(wide[0], library=schedule.library)
    assert any(
        Monitor.on(DecisionGrid.from_schedule(broken)).grid.schedule is one for one in schedule.library
    )
    with pytest.raises(NotCertified, match="initial set"):
        Monitor.on(DecisionGrid.from_schedule(replace(broken, library=tuple(wide[1:]))))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(fewer(24, 8)))
def test_random_scenes_keep_the_promise_along_every_reference(seed, tmp_path):
    unflown = (0, 14, 15, 16, 18)  # without a schedule, without U, or too long
    try:
        _, schedule = synthesised(seed, tmp_path)
    except PolarisError as error:
        assert seed in unflown, error
        pytest.skip("refused")
    if len(schedule.controllers) < 2 or DecisionGrid.from_schedule(schedule).decisions > 2500:
        assert seed in unflown
        pytest.skip("no U, or too long")
    for monitor in members(schedule):
        kept(monitor, 6, seed)
        kept(Whimsical(monitor.grid, reentry=0.0), 6, seed)
