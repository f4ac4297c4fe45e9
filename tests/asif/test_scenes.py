"""The bundled scenes from end to end: figures 6 and 7 of the paper keep every constraint for 3,000 s."""

from __future__ import annotations

import numpy as np
import pytest

from polaris.inspection.constraints.catalogue import CONSTRAINTS
from polaris.inspection.flights.judge import fly_scenario
from polaris.rta.projection import SHORT
from polaris.scenario.inspection import load_inspection


@pytest.mark.slow
@pytest.mark.parametrize("name", ["inspection", "inspection-decentralized"])
def test_every_constraint_is_kept_for_the_whole_flight(name):
    flown = fly_scenario(load_inspection(name))
    assert set(flown.constraints) == set(CONSTRAINTS)
    assert flown.run.t[-1] == 3000.0
    for constraint, least in flown.constraints.items():
        assert least.value >= 0 and least.violated_share == 0, constraint
    assert flown.run.status.max() < SHORT
    assert np.abs(flown.run.u).max() <= flown.run.inspection.thrust_max
