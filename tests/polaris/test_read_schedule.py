"""Schedules read from run folders: equal to those that were written, without planning."""

import json
from contextlib import contextmanager

import numpy as np
import pytest

pytest.importorskip("flint")

from polaris.runs.certificate import certificate
from polaris.runs.read_schedule import read_schedule
from polaris.runs.schedule import write_run
from polaris.simulation.baselines import compare

from ..kept import scheduled

SEARCHES = (
    "planning.lp.silent_highspy",
    "planning.backends.silent_highspy",
    "synthesis.safety.attempts.plan",
    "synthesis.schedule.powered.plan",
    "scenario.experimental.plan",
    "synthesis.schedule.look_ahead.LookAhead.best",
    "synthesis.schedule.synthesize.most_worthy",
    "synthesis.schedule.synthesize.views",
    "synthesis.schedule.synthesize.within_budget",
)
"""Planners, and searches for modes."""


@contextmanager
def no_search():
    """Make every planner, and every search for modes, fail."""

    def refuse(*args, **options):
        raise AssertionError("something is searched for")

    with pytest.MonkeyPatch.context() as patch:
        for place in SEARCHES:
            patch.setattr(f"polaris.{place}", refuse)
        yield


def written(folder, scenario, schedule):
    """Path of a run folder with two flights of each controller."""
    return write_run(folder / "run", scenario, schedule, compare(schedule, 2, 0)).path


def assert_equal(found, made, scenario):
    """Check that two schedules have the same modes, sets and tubes, to the bit."""
    assert found.modes.tolist() == made.modes.tolist()
    assert [law.name for law in found.controllers] == [law.name for law in made.controllers]
    for one, other in zip(found.steps, made.steps, strict=True):
        assert np.array_equal(one.tube.nodes.c, other.tube.nodes.c)
        assert np.array_equal(one.tube.nodes.G, other.tube.nodes.G)
        assert np.array_equal(one.tube.bow, other.tube.bow)
        assert np.array_equal(one.tube.end.G, other.tube.end.G)
        assert one.margin == other.margin
    assert np.array_equal(found.safety.reference.chi, made.safety.reference.chi)
    assert found.safety.start_margin == made.safety.start_margin
    assert found.arrival == made.arrival and found.delta_v == made.delta_v
    texts = [json.dumps(certificate(each, scenario.name)) for each in (found, made)]
    assert texts[0] == texts[1]


@pytest.mark.parametrize("name", ["static", "dynamic"])
def test_the_schedule_that_is_read_is_the_one_that_was_written(name, tmp_path):
    scenario, schedule = scheduled(name)
    folder = written(tmp_path, scenario, schedule)
    with no_search():
        assert_equal(read_schedule(folder), schedule, scenario)
