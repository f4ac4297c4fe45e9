"""Thrusters that push only and may fail: the box of inputs that they make, and who vouches for it."""

import copy
import json
from itertools import product

import numpy as np
import pytest
from scipy.optimize import linprog

from polaris.model.allocation import Allocation, Fault, axis_pairs, cases
from polaris.model.errors import ScenarioError, SynthesisInfeasible
from polaris.runs.certificate import certificate
from polaris.scenario.scenario import load_scenario
from polaris.synthesis.schedule.synthesize import synthesize
from tests.polaris.forging import CERTIFICATE, Forger, make
from tests.polaris.tiny import TINY

ROUND = [[np.cos(a), np.sin(a)] for a in np.arange(5) * 2 * np.pi / 5]
"""Five thrusters round a body in the plane."""


FIVE = (f"thrusters.directions={[[float(x) for x in row] for row in ROUND]}", "thrusters.thrust_max_N=1.5")


def largest_by_mixes(directions, capacity, wanted):
    """Return how many times a box is made by a fixed mix for each input and sign, tops found with them."""
    (N, m), corners = directions.shape, np.array(list(product((0, 1), repeat=len(wanted))))
    makes = np.kron(np.eye(2 * m), directions.T)
    sides = np.array([sign * unit for sign in (1, -1) for unit in np.eye(m) * wanted])
    within = np.zeros((len(corners) * N, 2 * m * N))
    for i, signs in enumerate(corners):
        for a, sign in enumerate(signs):
            within[i * N : (i + 1) * N, (sign * m + a) * N : (sign * m + a + 1) * N] = np.eye(N)
    tops = np.tile(capacity, len(corners))[:, None]
    answer = linprog(  # of the least share of thrust for the whole box
        np.append(np.zeros(2 * m * N), 1.0),
        A_ub=np.hstack([within, -tops]),
        b_ub=np.zeros(len(within)),
        A_eq=np.hstack([makes, np.zeros((len(makes), 1))]),
        b_eq=sides.ravel(),
    )
    return 1 / answer.x[-1]


@pytest.mark.parametrize("seed", [*range(2), *(pytest.param(i, marks=pytest.mark.slow) for i in (2, 3))])
def test_every_input_in_the_box_is_made_whichever_thruster_has_failed(seed):
    """By another program: for random inputs and corners, thrusts that make them; no mixes make more."""
    rng = np.random.default_rng(seed)
    m, count = int(rng.integers(1, 4)), int(rng.integers(9, 13))
    directions, limits = rng.normal(size=(count, m)), rng.uniform(0.5, 2, count)
    faults = [Fault("stuck_off", 0.0), Fault("loss", 0.4)][seed % 2 :]
    made = Allocation.from_directions(directions, limits, wanted := rng.uniform(0.5, 1, m) * 5, faults)
    share = 1.0  # of what is asked
    for _, capacity in cases(limits, faults):
        box = list(zip(np.zeros(count), capacity, strict=True))
        for _ in range(2):
            u = made.u_max * rng.choice([-1, 1, rng.uniform(-1, 1)], m)
            assert linprog(np.ones(count), A_eq=directions.T, b_eq=u * (1 - 1e-9), bounds=box).status == 0
        share = min(share, largest_by_mixes(directions, capacity, wanted))
    assert made.u_max == pytest.approx(share * wanted, rel=1e-6)


def test_a_loss_of_axis_pairs_takes_its_share_and_one_that_is_off_takes_all():
    limits = np.array([1.0, 2.0, 3.0])
    made = Allocation.from_directions(*axis_pairs(limits), limits, [Fault("loss", 0.75)])
    assert made.u_max == pytest.approx(0.75 * limits)
    with pytest.raises(SynthesisInfeasible, match="thruster 0 under the fault stuck_off"):
        Allocation.from_directions(*axis_pairs(limits), limits, [Fault("stuck_off", 0.0)])


def test_without_faults_nothing_changes_and_pairs_stated_are_the_pairs_there_were():
    plain = certificate(synthesize(load_scenario(TINY)), "tiny")
    none = certificate(synthesize(load_scenario(TINY).with_assignments(["faults=[]"])), "tiny")
    assert plain == none and "allocation" not in plain["system"]


@pytest.mark.parametrize(
    ("assignments", "field"),
    [
        ([FIVE[0]], "thrusters.directions"),
        (["thrusters.directions=[[1.0],[-1.0]]", "thrusters.thrust_max_N=1.0"], "thrusters.directions"),
        ([FIVE[0], "thrusters.thrust_max_N=[1.0]"], "thrusters.thrust_max_N"),
        ([*FIVE, "thrusters.misalignment_deg=1.0"], "thrusters.misalignment_deg"),
        ([*FIVE, "thrusters.impulse_bit_N_s=100.0"], "thrusters.impulse_bit_N_s"),
        (['faults=[{kind="loss",share=1.0}]'], "faults"),
        (['faults=[{kind="stuck_on"}]'], "faults"),
    ],
)
def test_bad_tables_are_refused_by_name(assignments, field):
    with pytest.raises(ScenarioError) as error:
        load_scenario(TINY).with_assignments(assignments)
    assert error.value.field.startswith(field)


def test_forged_faults_are_refused(tmp_path):
    forger = Forger(make([*FIVE, 'faults=[{kind="stuck_off"}]'], tmp_path), tmp_path)
    assert forger.judge({}).outcome == "VERIFIED"
    premise = "faults: at most one thruster fails"
    assert any(line.startswith(premise) for line in forger.honest["assumptions"])

    def forged(change):
        data = copy.deepcopy(forger.honest)
        change(data["system"])
        return forger.judge({CERTIFICATE: json.dumps(data)})

    def stronger(system):
        system["input_max"] = [(float.fromhex(x) * 1.01).hex() for x in system["input_max"]]

    def push(system):
        system["allocation"]["limits"][0] = (9.0).hex()

    def turned(system):
        system["allocation"]["directions"][0] = [(0.0).hex(), (1.0).hex()]

    def other(system):
        system["allocation"]["mixes"][0][0] = system["allocation"]["mixes"][0][1]

    def working(system):
        system["allocation"]["mixes"][1] = system["allocation"]["mixes"][2]

    def fewer(system):
        system["allocation"]["mixes"].pop()

    def pairs(system):
        system["allocation"]["layout"] = False

    for change in (stronger, push, turned, other, working, fewer, pairs):
        verdict = forged(change)
        assert (verdict.outcome, verdict.claim) == ("REJECTED", "system"), change.__name__
    assert forged(lambda system: system.pop("allocation")).claim == "assumptions"
    assert forged(lambda system: system["allocation"]["mixes"].clear()).claim == "format"
