"""Tables of errors, faults and aborts: bad ones are refused by name, and empty ones change nothing."""

import numpy as np
import pytest

from polaris import ScenarioError, load_scenario, synthesize
from polaris.certificate.files.document import canonical
from polaris.runs.certificate import certificate
from tests.polaris.tiny import TINY

SAMPLED = "feedback.period_s=0.25"
FIVE = [[float(np.cos(a)), float(np.sin(a))] for a in np.arange(5) * 2 * np.pi / 5]
LAYOUT = f"thrusters.directions={FIVE}", "thrusters.thrust_max_N=1.5"
PULSED = SAMPLED, "thrusters.pulse=centred"
MATRIX = f"navigation.measurement.matrix={np.eye(4)[:2].tolist()}"
MEASURED = SAMPLED, MATRIX, "navigation.measurement.error=[0.005, 0.005]"
ORBIT = 'orbit={kind="stationary",state=[0.0,6.0,0.0,0.0],tolerance_m=0.5}'
BAD = [
    ("navigation.state_error", "navigation.state_error=[0.1]"),
    ("navigation.state_error", "navigation.state_error=[-0.1, 0.0, 0.0, 0.0]"),
    ("navigation.position_error_m", "navigation.position_error_m=0.1"),
    ("navigation.measurement", *MEASURED, "navigation.state_error=[0.01, 0.01, 0.004, 0.004]"),
    ("navigation.measurement", *MEASURED[:2], "navigation.measurement.error=[1e-300, 1e-300]"),
    ("navigation.measurement.error", *MEASURED[:2]),
    ("navigation.measurement.error", *MEASURED[:2], "navigation.measurement.error=[0.1]"),
    ("navigation.measurement.position_error_m", SAMPLED, "navigation.measurement.position_error_m=0.1"),
    ("navigation.measurement.initial", *MEASURED, "navigation.measurement.initial={position_error_m=1.0}"),
    ("navigation", SAMPLED, "navigation.measurement={matrix=[[0,0,1,0]],error=[0.1]}"),
    ("navigation", SAMPLED, "navigation.measurement={matrix=[[1,0]],error=[0.1]}"),
    ("navigation.phases", "navigation.phases=[{from_s=3.0},{from_s=3.0}]"),
    ("navigation.phases[0].position_error_m", "navigation.phases=[{from_s=3.0,position_error_m=1.0}]"),
    ("navigation.phases[0].from_s", "navigation.phases=[{from_s=12.0,within_m=9.0}]"),
    ("navigation.phases[0].within_m", "navigation.phases=[{from_s=3.0,within_m=[9.0]}]"),
    ("timing.missed_periods", *MEASURED, "timing.missed_periods=21"),
    ("timing.jitter_s", *PULSED, "thrusters.fall_s=0.1", "timing.jitter_s=0.03"),
    ("chaser.radius_m", "chaser.radius_m=-1.0"),
    ("tracking.thrust_share", "tracking.thrust_share=0.0"),
    ("thrusters.magnitude_error", "thrusters.magnitude_error=0.5"),
    ("thrusters.misalignment_deg", "thrusters.misalignment_deg=1.0"),
    ("thrusters.misalignment_deg", *LAYOUT, "thrusters.misalignment_deg=1.0"),
    ("thrusters.impulse_bit_N_s", "thrusters.impulse_bit_N_s=0.2"),
    ("thrusters.impulse_bit_N_s", *LAYOUT, "thrusters.impulse_bit_N_s=100.0"),
    ("thrusters.pulse", SAMPLED, "thrusters.pulse=first"),
    ("thrusters.rise_s", SAMPLED, "thrusters.rise_s=0.01"),
    ("thrusters.directions", LAYOUT[0]),
    ("thrusters.directions", "thrusters.directions=[[1.0],[-1.0]]", LAYOUT[1]),
    ("thrusters.thrust_max_N", LAYOUT[0], "thrusters.thrust_max_N=[1.0]"),
    ("faults", 'faults=[{kind="loss",share=1.0}]'),
    ("faults", 'faults=[{kind="stuck_on"}]'),
    ("faults", 'faults=[{kind="stuck_on",isolation_s=0.0}]'),
    ("faults", 'faults=[{kind="navigation_lost"}]'),
    ("faults", 'faults=[{kind="loss",share=0.1,isolation_s=-1.0}]'),
    ("faults", SAMPLED, 'faults=[{kind="loss",share=0.1,isolation_s=0.01}]'),
    ("faults", *MEASURED, 'faults=[{kind="loss",share=0.1,isolation_s=1.0}]', "timing.missed_periods=1"),
    ("abort", "abort.required=true"),
    ("abort", "abort.drift_s=1.0", "abort.drift_orbits=1.0"),
    ("abort.drift_orbits", "abort.drift_orbits=1.0"),
    ("abort.drift_s", "abort.drift_s=-1.0"),
    ("abort", "abort.drift_s=1e9"),
    ("abort.keep_in", "navigation.phases=[{from_s=3.0,within_m=9.0}]", "abort={drift_s=3.0}"),
    ("abort", "abort={within_s=5.0}"),
    ("abort.within_s", f"abort={{{ORBIT}}}"),
    ("abort.within_s", f"abort={{{ORBIT},within_s=1.5}}"),
    ("goal.kind", 'abort={orbit={kind="linear_nmt",amplitude_max_m=5.0},within_s=5.0}'),
    ("goal.state", 'abort={orbit={kind="stationary",state=[0.0,6.0,1.0,0.0]},within_s=5.0}'),
    ("abort.orbit", 'abort={orbit={kind="box"},within_s=5.0}'),
]
"""Field that an error names, and assignments."""


@pytest.mark.parametrize(("field", "given"), [(field, given) for field, *given in BAD], ids=str)
def test_a_bad_table_is_refused_by_name(field, given):
    if "1e-300" in given[-1]:
        given = [*given, "system.disturbance_max=0.0"]
    with pytest.raises(ScenarioError) as error:
        load_scenario(TINY).with_assignments(given).system()
    assert error.value.field.startswith(field)


SOFT = "tracking.R=[60.0,60.0]", SAMPLED
LOSS = 'faults=[{kind="loss",share=0.1%s}]'
PHASED = "navigation.state_error=[0.01, 0.01, 0.004, 0.004]"
EMPTY = [
    ((), ("navigation.state_error=[0.0, 0.0, 0.0, 0.0]", "chaser.radius_m=0.0")),
    ((), ("thrusters.magnitude_error=0.0", "thrusters.mass_error=0.0", "thrusters.errors_vary=never")),
    ((), ("faults=[]", "system.bias_max=[0.0,0.0]", "thrusters.pulse=held")),
    ((PHASED,), (PHASED, "navigation.phases=[]")),
    ((*SOFT, LOSS % ""), (*SOFT, LOSS % ",isolation_s=0.0")),
]
"""Assignments that have the same certificate."""


@pytest.mark.parametrize(("plain", "same"), EMPTY, ids=str)
def test_a_table_that_declares_nothing_changes_nothing(plain, same):
    first, second = (
        certificate(synthesize(load_scenario(TINY, [*assignments])), "tiny") for assignments in (plain, same)
    )
    assert canonical(first) == canonical(second) and "transients" not in first["system"]
