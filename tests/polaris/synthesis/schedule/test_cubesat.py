"""A craft as it is built, with every source of error at once: its share, and forgeries of its nozzles."""

import copy
import json

import numpy as np
import pytest

from polaris.runs.run import run
from polaris.scenario.scenario import load_scenario
from polaris.synthesis.schedule.synthesize import synthesize
from tests.polaris.forging import CERTIFICATE, Forger, make

ROUND = [[float(np.cos(a)), float(np.sin(a))] for a in np.arange(16) * np.pi / 8]
"""Sixteen nozzles round a body in the plane."""

CRAFT = (
    *(f"thrusters.directions={ROUND}", "thrusters.thrust_max_N=0.5", "thrusters.impulse_bit_N_s=0.001"),
    *("thrusters.remainder=carried", "thrusters.pulse=centred", "feedback={period_s=0.25}"),
    'faults=[{kind="stuck_off",isolation_s=0.25},{kind="stuck_on",isolation_s=0.25}]',
)
"""The tiny scene with pulses, and valves that stick, shut or open, for a period."""


def exchanged(system):
    """Swap the mixes of two nozzles in the case without a fault."""
    mixes = [mix for way in system["allocation"]["mixes"][0] for mix in way]
    other = next(j for j in range(1, len(mixes[0])) if any(mix[0] != mix[j] for mix in mixes))
    for mix in mixes:
        mix[0], mix[other] = mix[other], mix[0]


def exchanged_after_a_fault(system):
    """Swap them in the case of the last valve that is stuck."""
    mixes = [mix for way in system["allocation"]["mixes"][-1] for mix in way]
    other = next(j for j in range(1, len(mixes[0])) if any(mix[0] != mix[j] for mix in mixes))
    for mix in mixes:
        mix[0], mix[other] = mix[other], mix[0]


def bounded(share):
    """Return a forgery: the thrust of the first nozzle, so many times what it is."""

    def scaled(system):
        limits = system["allocation"]["limits"]
        limits[0] = (share * float.fromhex(limits[0])).hex()

    return scaled


def valve_left_out(system):
    """Leave out what is left to do when the first valve is stuck."""
    del system["allocation"]["mixes"][1]


def opening_left_out(system):
    """Say nothing of the time until a valve that is stuck open is isolated."""
    assert system["transients"].pop()["name"] == "stuck_on"


def thruster_left_out(system):
    """Say that the first nozzle cannot push unasked."""
    del system["transients"][-1]["pushes"][0]


FORGERIES = {
    "mixes exchanged": exchanged,
    "mixes exchanged after a fault": exchanged_after_a_fault,
    "bound raised": bounded(1.01),
    "bound lowered": bounded(0.99),
    "valve left out": valve_left_out,
    "opening left out": opening_left_out,
    "thruster left out": thruster_left_out,
}


def check_forgeries(folder, scratch):
    """Verify an honest folder, and let every forgery of its certificate be refused."""
    forger = Forger(folder, scratch)
    assert forger.judge({}).outcome == "VERIFIED"
    for name, forge in FORGERIES.items():
        data = copy.deepcopy(forger.honest)
        forge(data["system"])
        assert data != forger.honest, name
        verdict = forger.judge({CERTIFICATE: json.dumps(data)})
        assert verdict.outcome == "REJECTED", name
        assert verdict.claim in ("system", "assumptions", "faults"), (name, verdict.text())


def test_forged_nozzles_of_a_small_craft_are_refused(tmp_path):
    check_forgeries(make(CRAFT, tmp_path), tmp_path)


@pytest.mark.slow
def test_cubesat_is_proved_flies_u_for_most_of_the_time_and_its_nozzles_cannot_be_forged(tmp_path):
    made = run("cubesat", tmp_path / "run", overrides=["simulation.runs=2", "schedule.bound_programs=0"])
    claim, synthesis = made.summary["guarantee"], made.summary["polaris"]
    assert (claim["kind"], claim["horizon"], claim["goal"]["reached"]) == ("proved", "infinite", True)
    assert synthesis["experimental_share"] >= 0.7
    check_forgeries(made.path, tmp_path)


@pytest.mark.slow
def test_cubesat_flies_u_with_coarser_sets_too(monkeypatch):
    """Paths that clear what the first plan lacked lead through other windows."""
    monkeypatch.setattr("polaris.synthesis.controllers.controllers.FILTERED", 50.0)
    schedule = synthesize(load_scenario("cubesat", ["schedule.bound_programs=0", "simulation.runs=2"]))
    assert schedule.share() >= 0.7
