"""Which declarations of errors go together: every pair of them, and triples drawn at random."""

from functools import cache
from itertools import combinations

import pytest

from polaris import load_scenario

CANTED = [[x, y, z] for x in (-0.8, 0.8) for y in (-0.6, 0.6) for z in (0.0,)]
CANTED += [[0.0, x, y] for x in (-0.8, 0.8) for y in (-0.6, 0.6)] + [
    [y, 0.0, x] for x in (-0.8, 0.8) for y in (-0.6, 0.6)
]
"""Twelve thrusters in three planes, of which any one may fail."""

SOURCES = {
    "estimate": ["navigation.position_error_m=0.05", "navigation.velocity_error_m_s=0.002"],
    "phases": ["navigation.phases=[{from_s=600.0,position_error_m=0.02,velocity_error_m_s=0.001}]"],
    "camera": ["navigation.measurement.position_error_m=0.1"],
    "first estimate": [
        "navigation.measurement.position_error_m=0.1",
        "navigation.measurement.initial={position_error_m=0.3,velocity_error_m_s=0.01}",
    ],
    "delay": ["timing.delay_s=2.0"],
    "part of a period": ["timing.delay_s=3.0"],
    "missed periods": ["timing.missed_periods=2"],
    "jitter": ["timing.jitter_s=0.01"],
    "clock": ["timing.clock_error_s=0.5"],
    "magnitude": ["thrusters.magnitude_error=0.05"],
    "direction": ["thrusters.misalignment_deg=2.0"],
    "mass": ["thrusters.mass_error=0.03"],
    "bit": ["thrusters.impulse_bit_N_s=0.005"],
    "carried bit": ["thrusters.impulse_bit_N_s=0.005", 'thrusters.remainder="carried"'],
    "least impulse": ["thrusters.impulse_bit_N_s=0.005", 'thrusters.resolution="continuous"'],
    "pulses": ['thrusters.pulse="centred"'],
    "pulses at the start": ['thrusters.pulse="start"'],
    "staggered pulses": ['thrusters.pulse="staggered"'],
    "rise and fall": ['thrusters.pulse="centred"', "thrusters.rise_s=0.02", "thrusters.fall_s=0.03"],
    "layout": [f"thrusters.directions={CANTED}", "thrusters.thrust_max_N=0.15"],
    "chaser": ["chaser.radius_m=0.5"],
    "weak thruster": ['faults=[{kind="loss",share=0.2}]'],
    "weak thruster, late": ['faults=[{kind="loss",share=0.2,isolation_s=4.0}]'],
    "lost navigation": ['faults=[{kind="navigation_lost",lasts_s=20.0}]'],
    "constant shares": ["thrusters.magnitude_error=0.05", "thrusters.errors_vary=never"],
    "bias": ["system.bias_max_m_s2=[0.0,1e-6,0.0]"],
}
"""Declarations by name."""

ALTERNATIVES = (
    {"estimate", "camera"},
    {"estimate", "first estimate"},
    {"phases", "camera"},
    {"phases", "first estimate"},
)
"""An observer works out what estimates are off by: nobody declares both."""


@cache
def static():
    """Load the static scene with a control period, in which sources are declared."""
    return load_scenario("static", ["feedback.period_s=2.0"])


def build(*names):
    """Build the problem of the static scene with some sources declared."""
    assignments = {text.split("=", 1)[0]: text for name in names for text in SOURCES[name]}
    return static().with_assignments(list(assignments.values())).problem()


def same_table(names):
    """Return True if two of the names are the same declaration, or replace one another."""
    keys = [{text.split("=", 1)[0] for text in SOURCES[name]} for name in names]
    twice = any(a & b for a, b in combinations(keys, 2))
    return twice or any(each <= set(names) for each in ALTERNATIVES)


@pytest.mark.parametrize("pair", [pair for pair in combinations(SOURCES, 2) if not same_table(pair)])
def test_every_pair_of_declarations_is_accepted(pair):
    assert build(*pair).system.n == 6
