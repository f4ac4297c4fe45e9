"""One small scene, synthesised and flown once for the tests of everything that comes after."""

from functools import cache
from pathlib import Path

from polaris.scenario.scenario import load_scenario
from polaris.simulation.baselines import compare
from polaris.synthesis.schedule.synthesize import synthesize

TINY = Path(__file__).parent / "data" / "tiny.toml"


@cache
def synthesised():
    """(scenario, schedule)."""
    scenario = load_scenario(TINY)
    return scenario, synthesize(scenario)


@cache
def flown():
    """Result of `compare` on it."""
    scenario, schedule = synthesised()
    return compare(schedule, scenario.simulation.runs, scenario.simulation.seed)
