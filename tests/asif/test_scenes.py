"""The bundled scenes from end to end: figures 6 and 7 of the paper keep every constraint for 3,000 s."""

from __future__ import annotations

import numpy as np
import pytest

from polaris.inspection.constraints.catalogue import CONSTRAINTS
from polaris.rta.projection import SHORT
from polaris.runs.inspection import fly_flight
from polaris.scenario.scenario import load_scenario


@pytest.mark.slow
@pytest.mark.parametrize("name", ["inspection", "inspection-decentralized"])
def test_every_constraint_is_kept_for_the_whole_flight(name):
    flown = fly_flight(load_scenario(name))
    assert set(flown.constraints) == set(CONSTRAINTS)
    assert flown.run.t[-1] == 3000.0
    for constraint, least in flown.constraints.items():
        assert least.value >= 0 and least.violated_share == 0, constraint
    assert flown.run.status.max() < SHORT
    assert np.abs(flown.run.u).max() <= flown.run.inspection.thrust_max
