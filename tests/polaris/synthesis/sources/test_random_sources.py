"""Random scenes with errors of every kind: what is proven is confirmed, and holds at its worst."""

import numpy as np
import pytest

from polaris import PolarisError, falsify, synthesize
from tests.polaris.closed_loops import attack
from tests.polaris.model.test_timing import fly_delayed
from tests.polaris.synthesis.safety.test_closed_loops import judge
from tests.polaris.synthesis.sources.test_constants import biased
from tests.polaris.synthesis.sources.test_error_sources import exact, tables
from tests.polaris.synthesis.sources.test_transients import checked, faults, pulsing
from tests.sizes import fewer


def in_balls(scenario, seed):
    """A fault that is isolated late, and balls of recoverable errors."""
    assignments = pulsing(scenario, ("loss", "navigation_lost")[seed % 2])
    return [*(x for x in assignments if not x.startswith("thrusters")), "recoverable.kind=ball"]


def observer(scenario, seed):
    """An observer of the position, known at first or not, and what it goes with."""
    problem = scenario.problem()
    n, widths, hill = problem.system.n, problem.initial_set.half_widths / 20, problem.system.mean_motion
    if not problem.period or n % 2:
        raise PolarisError("an observer needs a period and pairs of states")
    errors = (widths[: n // 2] + 1e-9).tolist()
    if hill is not None:
        return [f"navigation.measurement.position_error_m={errors}"]
    rows = np.eye(n)[: n // 2].tolist()
    first = [f"navigation.measurement.initial.state_error={(3 * widths + 3e-9).tolist()}"] if seed % 3 else []
    return [f"navigation.measurement={{matrix={rows},error={errors}}}", *first]


def observed(scenario, seed):
    """An observer with delays, missed periods, and pulses or impulses that are carried."""
    period, least = scenario.problem().period, scenario.system().u_max.min()
    assignments = [*observer(scenario, seed), f"timing.delay_s={period}", "thrusters.mass_error=0.01"]
    assignments += [f"timing.missed_periods={seed % 3}"] if seed % 5 < 2 else []
    impulse = [f"thrusters.impulse_bit_N_s={0.01 * period * least}", "thrusters.remainder='carried'"]
    return assignments + [["thrusters.pulse='centred'"], impulse, []][seed % 3]


def observed_fault(scenario, seed):
    """An observer, and a fault that is isolated late."""
    late = [f"timing.delay_s={scenario.problem().period!r}"] if seed % 5 == 0 else []
    return [*faults(scenario, seed), *observer(scenario, seed), *late]


def phases(scenario, seed):
    """Errors of estimates in three phases, within a range in the second."""
    problem, rng = scenario.problem(), np.random.default_rng(seed)
    hill, widths = problem.system.mean_motion is not None, problem.initial_set.half_widths / 20
    keys = ("position_error_m", "velocity_error_m_s") if hill else ("state_error",)
    parts = [np.split(widths * size, len(keys)) for size in rng.uniform(0, 1.5, 3)]
    texts = [",".join(f"{k}={v.tolist()}" for k, v in zip(keys, part, strict=True)) for part in parts]
    far, T = 2 * np.abs(problem.system.position @ problem.initial_set.c).max(), problem.K * problem.delta
    within = f"within_m={far}," if seed % 3 and far else ""
    later = f"{{from_s={0.37 * T},{within}{texts[1]}}},{{from_s={0.8 * T},{texts[2]}}}"
    return [f"navigation={{{texts[0]},phases=[{later}]}}"]


def carrying(scenario, seed):
    """Pulses, impulses whose rest is carried, and a delay."""
    period, least = scenario.problem().period, scenario.system().u_max.min()
    if period is None:
        raise PolarisError("pulses need a period")
    impulse = [f"thrusters.impulse_bit_N_s={float(period * least / 20)}", "thrusters.remainder=carried"]
    return [*impulse, "thrusters.pulse=centred", "thrusters.magnitude_error=0.01", f"timing.delay_s={period}"]


def sighted(scenario, seed):
    """Errors of range and bearing of a spacecraft."""
    if scenario.system().mean_motion is None:
        raise PolarisError("no spacecraft")
    half, max_range = scenario.initial_set().half_widths, 3 * np.abs(scenario.initial_set().c[:3]).max()
    errors = {"range_error_m": 0.03 * half[:3].min(), "within_m": max_range}
    errors |= {"bearing_error_deg": np.rad2deg(0.02 * half[:3].min() / max_range)}
    errors |= {"velocity_error_m_s": 0.03 * half[3:].min()}
    assignments = [f"navigation.{key}={float(value)!r}" for key, value in errors.items()]
    return [*assignments, "planner.time_limit_s=1e6"]


def constants(scenario, seed):
    """A constant part of the disturbance, and a drift that is asked for."""
    return [*biased(scenario, seed), f"abort.drift_s={0.5 * scenario.model.horizon.duration_s}"]


KINDS = {
    "tables": (tables, range(5000, fewer(5080, 5012)), 0.5),
    "faults": (faults, range(5000, fewer(5036, 5008)), 0.4),
    "faults and errors": (lambda s, i: [*tables(s, i, 0.05)[:1], *faults(s, i)], range(5000, 5012, 3), 0.2),
    "faults in pulses": (
        lambda s, i: pulsing(s, ("navigation_lost", "loss")[i % 2]),
        range(5003, 5018, 3),
        0.2,
    ),
    "faults in balls": (in_balls, range(5000, 5010), 0.2),
    "observed faults": (observed_fault, range(5000, fewer(5060, 5020)), 0.05),
    "observers": (observed, range(5000, fewer(5080, 5016)), 0.2),
    "phases": (phases, range(5000, fewer(5080, 5010)), 0.3),
    "carried": (carrying, range(5030, fewer(5047, 5038)), 0.2),
    "sighted": (sighted, range(fewer(400, 40)), 0.02),
    "constants": (constants, range(5000, fewer(5060, 5010)), 0.3),
}
"""Assignments of a random scene by its seed, seeds, and the least share of them that is proved."""


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_proofs_of_random_scenes_hold_at_their_worst(kind):
    (assign, seeds, least), proved = KINDS[kind], 0
    for seed in seeds:
        scenario = exact(seed)
        try:
            schedule = synthesize(scenario.with_assignments(assign(scenario, seed)))
        except PolarisError:
            continue
        system, proved = schedule.safety.problem.system, proved + 1
        assert checked(schedule), seed
        assert falsify(schedule, 200, seed).failure is None, seed
        if not system.transients:
            judge(seed, attack(schedule, 60, seed))
        if system.observer is not None and not system.transients:
            assert np.all(fly_delayed(schedule, 20, seed)[1] <= 1 + 1e-6), seed
    assert proved >= least * len(seeds)
