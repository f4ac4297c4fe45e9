"""Honest runs of the smallest scene with sources of error drawn at random: what is claimed is confirmed."""

import numpy as np
import pytest

pytest.importorskip("flint")

from polaris.certificate.checker import verify
from polaris.model.errors import PolarisError
from polaris.runs.schedule import write_run
from polaris.scenario.scenario import load_scenario
from polaris.synthesis.schedule.synthesize import synthesize
from tests.polaris.tiny import TINY

SOURCES = {
    "estimate": ["navigation.state_error=[0.002,0.002,0.0004,0.0004]"],
    "phases": ["navigation.phases=[{from_s=5.07,state_error=[0.002,0.002,0.0004,0.0004]}]"],
    "camera": [
        f"navigation.measurement.matrix={np.eye(4).tolist()}",
        "navigation.measurement.error=[0.002,0.002,0.0004,0.0004]",
    ],
    "constant camera": [
        f"navigation.measurement.matrix={np.eye(4)[:2].tolist()}",
        *("navigation.measurement.error=[0.002,0.002]", "navigation.measurement.constant_share=0.9"),
    ],
    "delay": ["timing.delay_s=0.5"],
    "part of a period": ["timing.delay_s=0.08"],
    "missed periods": ["timing.missed_periods=1"],
    "jitter": ["timing.jitter_s=0.005"],
    "magnitude": ["thrusters.magnitude_error=0.03"],
    "mass": ["thrusters.mass_error=0.005"],
    "constant magnitude": ["thrusters.magnitude_error=0.03", "thrusters.errors_vary=never"],
    "bit": ["thrusters.impulse_bit_N_s=0.004"],
    "carried bit": ["thrusters.impulse_bit_N_s=0.004", "thrusters.remainder=carried"],
    "coarse carried bit": ["thrusters.impulse_bit_N_s=0.05", "thrusters.remainder=carried"],
    "pulses": ["thrusters.pulse=centred"],
    "pulses at the start": ["thrusters.pulse=start"],
    "staggered pulses": ["thrusters.pulse=staggered"],
    "fault": ['faults=[{kind="loss",share=0.1,isolation_s=0.5}]'],
    "outage": ['faults=[{kind="navigation_lost",lasts_s=0.8}]'],
    "tank": ["tank.delta_v_m_s=60.0"],
    "bias": ["system.bias_max=[0.004,0.0]"],
}
"""Declarations by name."""

REFUSED_ONCE = (
    (("phases", "part of a period", "jitter"), 1 / 3, 0.02, 20),
    (("camera", "missed periods", "jitter"), 1 / 3, 0.002, 150),
    (("coarse carried bit",), 0.5, 0.0, 40),
    (("jitter",), 0.5, 0.002, 150),
    (("carried bit", "staggered pulses", "magnitude"), 0.5, 0.0, 20),
)
"""Sources, control period [s], disturbance and weight of thrust of runs that held and were refused."""


def outcome(folder, names, period, disturbance, weight):
    """Return the schedule and the verdict of a run with some sources."""
    sources = {text.split("=", 1)[0]: text for name in names for text in SOURCES[name]}
    sources = [*sources.values(), f"system.disturbance_max={disturbance}", f"tracking.R=[{weight},{weight}]"]
    scenario = load_scenario(TINY, [f"feedback.period_s={period}", "simulation.runs=1", *sources])
    schedule = synthesize(scenario)
    return schedule, verify(write_run(folder, scenario, schedule).path)


@pytest.mark.parametrize("case", REFUSED_ONCE, ids=lambda case: "-".join(case[0]))
def test_runs_that_hold_are_confirmed(case, tmp_path):
    schedule, verdict = outcome(tmp_path / "run", *case)
    assert schedule.upkeep is not None and verdict.outcome == "VERIFIED", verdict.text()


@pytest.mark.slow
def test_runs_with_any_sources_that_hold_are_confirmed(tmp_path):
    rng, confirmed = np.random.default_rng(0), 0
    for i in range(30):
        names = rng.choice(list(SOURCES), rng.integers(1, 4), replace=False)
        sizes = rng.choice([0.25, 1 / 3, 0.5]), rng.choice([0.0, 0.002, 0.02]), rng.choice([2, 20, 60, 150])
        try:
            schedule, verdict = outcome(tmp_path / str(i), names, *sizes)
        except PolarisError as error:
            assert error.exit_code in (2, 3), f"{names}, {sizes}: {error}"
            continue
        assert verdict.outcome == "VERIFIED", f"{names}, {sizes}: {verdict.text()}"
        confirmed += schedule.upkeep is not None
    assert confirmed >= 12


@pytest.mark.slow
@pytest.mark.parametrize("delay", [0.0, 1.0])
def test_a_camera_on_a_craft_with_weak_thrusters_is_confirmed(delay, tmp_path):
    """U flies long with an observer: sets keep too few generators for all of their fresh noise."""
    weak = ["system.mass_kg=12.0", "system.thrust_max_N=0.04", "system.mean_motion_rad_s=0.00113"]
    start = "initial_set.center=[0.0,400.0,0.0,0.226,0.0,0.0]"
    camera = ["navigation.measurement.position_error_m=0.1", f"timing.delay_s={delay}", "simulation.runs=1"]
    scenario = load_scenario("static", [*weak, start, *camera])
    schedule = synthesize(scenario)
    assert schedule.share() >= 0.8
    assert verify(write_run(tmp_path / "run", scenario, schedule).path).outcome == "VERIFIED"
